"""`python -m benchmarks [NAME ...]`: every figure measured in this run, the goal beside it, met or missed."""

from __future__ import annotations

import sys
from importlib import import_module

from rich.console import Console
from rich.table import Table

TOPICS = ("frames",)


def main(names: list[str]) -> None:
    """Run the topics named, all by default."""
    console = Console()
    for topic in names or TOPICS:
        table = Table(title=topic, title_justify="left")
        for column in ("what", "measured", "goal", "verdict"):
            table.add_column(column, justify="right" if column in ("measured", "goal") else "left")
        for row in import_module(f"{__package__}.{topic}").rows():
            measured = "–" if row.measured is None else f"{row.measured:.3g} {row.unit}"
            goal = "" if row.goal is None else f"{'≤' if row.at_most else '≥'} {row.goal:g}"
            table.add_row(row.name, measured, goal, row.verdict if not row.note else row.note)
        console.print(table)


if __name__ == "__main__":
    main(sys.argv[1:])
