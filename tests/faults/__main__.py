"""`make faults`: every fault, what was done and what happened, on the screen and in docs/faults.md."""

import inspect
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.progress import track
from rich.table import Table

from . import FAULTS, MODULES

PAGE = Path(__file__).parents[2] / "docs" / "faults.md"
HEAD = """# Fault injection

`make faults` injects each fault and prints what was done and what happened; tests assert it (`tests/faults/`). A
damaged or foreign file is refused with a message that names it, an interrupted run saves its completed part, and a file
is written completely or not at all.

| faults | number |
| --- | ---: |"""


def page():
    """Return the page: how many faults there are of each kind."""
    kinds = [(inspect.getdoc(module) or "").partition("\n")[0].removeprefix("Faults of ") for module in MODULES]
    rows = [f"| {kind.rstrip('.')} | {len(module.FAULTS)} |" for kind, module in zip(kinds, MODULES, strict=True)]
    return "\n".join([HEAD, *rows]) + "\n"


def done_by(fault):
    """Return what a fault does, in one line."""
    return " ".join((inspect.getdoc(fault) or "").split())


def main():
    """Run all faults, print the table, write the page."""
    lines, failed = [], []
    for name, fault in track(FAULTS.items(), "faults", console=Console(stderr=True)):
        with tempfile.TemporaryDirectory() as folder:
            try:
                happened = fault(Path(folder))
            except AssertionError as error:
                happened = f"FAILED: {error!r}"
                failed.append(name)
        lines.append((done_by(fault), happened))
    table = Table("what was done", "what happened", title="faults", title_justify="left", show_lines=True)
    for line in lines:
        table.add_row(*line)
    Console(width=None if sys.stdout.isatty() else 140).print(table)
    PAGE.write_text(page(), encoding="utf-8")
    if failed:
        raise SystemExit(f"faults failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
