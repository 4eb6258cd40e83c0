"""`make faults`: every fault, what was done and what happened, on the screen and in docs/faults.md."""

from __future__ import annotations

import inspect
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.progress import track
from rich.table import Table

from . import FAULTS

PAGE = Path(__file__).parents[2] / "docs" / "faults.md"
HEAD = """# Fault-injection tests

Written by `make faults`, which injects each fault and records what happened. Tests assert it (`tests/faults/`).

| what was done | what happened |
| --- | --- |
"""


def main() -> None:
    """Run all faults, print the table, write the page."""
    lines, failed = [], []
    for name, fault in track(FAULTS.items(), "faults", console=Console(stderr=True)):
        done = " ".join(inspect.getdoc(fault).split())
        with tempfile.TemporaryDirectory() as folder:
            try:
                happened = fault(Path(folder))
            except AssertionError as error:
                happened = f"FAILED: {error!r}"
                failed.append(name)
        lines.append((done, happened))
    table = Table("what was done", "what happened", title="faults", title_justify="left", show_lines=True)
    for line in lines:
        table.add_row(*line)
    Console(width=None if sys.stdout.isatty() else 140).print(table)
    PAGE.write_text(HEAD + "".join(f"| {done} | {happened} |\n" for done, happened in lines), encoding="utf-8")
    if failed:
        raise SystemExit(f"faults failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
