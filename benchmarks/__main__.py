"""`python -m benchmarks [TOPIC ...]`: measure topics, all by default, each in a process of its own.

With `--page`, each topic is written to docs/performance/ when it is done, and docs/performance.md last. A topic that
cannot be measured says why, and the others go on.
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from rich.console import Console
from rich.table import Table

from .page import FOLDER, keep, write_page
from .rows import TOPICS, measured


def main(names: list[str]) -> None:
    """Run the topics named, all by default."""
    page = "--page" in names
    topics = [name for name in names if name != "--page"] or list(TOPICS)
    if unknown := [name for name in topics if name not in TOPICS]:
        raise SystemExit(f"unknown topic {', '.join(unknown)}; known are {', '.join(TOPICS)}")
    console = Console(width=None if sys.stdout.isatty() else 140)
    one_by_one = {"mp_context": get_context("spawn"), "max_tasks_per_child": 1}
    with ProcessPoolExecutor(1, **one_by_one) as pool:  # type: ignore[call-overload]
        for topic in topics:
            rows = pool.submit(measured, topic, FOLDER if page else None).result()
            table = Table("what", "measured", "note", title=TOPICS[topic], title_justify="left")
            table.columns[1].justify = "right"
            for row in rows:
                table.add_row(row.name, row.value, row.note)
            console.print(table)
            if page:
                keep(topic, rows)
    if page:
        write_page()


if __name__ == "__main__":
    main(sys.argv[1:])
