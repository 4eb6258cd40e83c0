"""`python -m benchmarks [NAME ...]`: every figure measured in this run, the goal beside it, met or missed.

With `--page` all topics run and are written to docs/performance.md and docs/performance/.
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from multiprocessing import get_context

from rich.console import Console
from rich.table import Table as RichTable

from .rows import Table
from .topics import PAGE, TOPICS, measured


def main(names: list[str]) -> None:
    """Run the topics named, all by default."""
    page = "--page" in names
    names = [name for name in names if name != "--page"]
    unknown = [name for name in names if name not in TOPICS]
    if unknown:
        raise SystemExit(f"unknown topic {', '.join(unknown)}; known are {', '.join(TOPICS)}")
    if page and names:
        raise SystemExit("--page runs all topics; name none")
    console, lines = Console(width=None if sys.stdout.isatty() else 140), []
    one_by_one = {"mp_context": get_context("spawn"), "max_tasks_per_child": 1}
    with ProcessPoolExecutor(1, **one_by_one) as pool:  # type: ignore[call-overload]
        for topic in names or TOPICS:
            found, written = pool.submit(measured, topic, page).result()
            for table in found:
                show(console, table)
            if page:
                docstring = import_module(f"{__package__}.{topic}").__doc__ or ""
                lines += ["", f"## {topic}", "", docstring.strip(), ""]
                for table in found:
                    lines += markdown(table)
                lines += written
    if page:
        from .machine import words

        PAGE.write_text("\n".join([*HEAD, "", words(), *lines]) + "\n", encoding="utf-8")
        console.print("written: docs/performance.md")


HEAD = (
    "# Performance",
    "",
    "Made by `make bench`: every number is from one run of it on one machine. Times move from run to run and from",
    "machine to machine; tools are compared by ratios within one process, with passes in shuffled order, by medians;",
    "each topic has a process of its own.",
    "A goal is met or missed **in this run**. Where another tool is faster the tables say so.",
)


def show(console: Console, table: Table) -> None:
    """Print a table."""
    found = RichTable(title=table.title, title_justify="left")
    for k, column in enumerate(table.header):
        found.add_column(column, justify="left" if k == 0 or column == "verdict" else "right")
    for cells in table.cells:
        found.add_row(*cells)
    console.print(found)


def markdown(table: Table) -> list[str]:
    """Return the lines of a table on the page."""

    def line(cells: list[str]) -> str:
        return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"

    rule = ["---"] + ["---" if column == "verdict" else "---:" for column in table.header[1:]]
    return ["", f"**{table.title}**", "", line(table.header), line(rule), *map(line, table.cells)]


if __name__ == "__main__":
    main(sys.argv[1:])
