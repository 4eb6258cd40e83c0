"""`python -m benchmarks [NAME ...]`: every figure measured in this run.

With `--page` all topics run and are written to docs/performance.md and docs/performance/.
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from rich.console import Console
from rich.table import Table as RichTable

from .page import PAGE, page_of, write_rows
from .rows import Row, Table
from .topics import TOPICS, measured


def main(names: list[str]) -> None:
    """Run the topics named, all by default."""
    page = "--page" in names
    names = [name for name in names if name != "--page"]
    unknown = [name for name in names if name not in TOPICS]
    if unknown:
        raise SystemExit(f"unknown topic {', '.join(unknown)}; known are {', '.join(TOPICS)}")
    if page and names:
        raise SystemExit("--page runs all topics; name none")
    console, all_found = Console(width=None if sys.stdout.isatty() else 140), {}
    one_by_one = {"mp_context": get_context("spawn"), "max_tasks_per_child": 1}
    with ProcessPoolExecutor(1, **one_by_one) as pool:  # type: ignore[call-overload]
        for topic in names or TOPICS:
            found = all_found[topic] = pool.submit(measured, topic, PAGE.with_suffix("") if page else None).result()
            for table in [as_table(topic, found.rows), *found.tables]:
                show(console, table)
    if page:
        PAGE.write_text(page_of(all_found), encoding="utf-8")
        write_rows(all_found, PAGE.with_suffix("") / "measured.csv")
        console.print("written: docs/performance.md")


def as_table(topic: str, rows: list[Row]) -> Table:
    """Return the figures of a topic."""
    cells = [[row.name, row.value, row.note or ("" if row.measured is not None else "not measured")] for row in rows]
    return Table(topic, ["what", "measured", "note"], cells)


def show(console: Console, table: Table) -> None:
    """Print a table."""
    found = RichTable(title=table.title, title_justify="left")
    for k, column in enumerate(table.header):
        found.add_column(column, justify="left" if k == 0 or column == "note" else "right")
    for cells in table.cells:
        found.add_row(*cells)
    console.print(found)


if __name__ == "__main__":
    main(sys.argv[1:])
