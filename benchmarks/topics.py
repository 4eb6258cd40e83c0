"""The topics, and one of them measured: importable by name, as a process that is spawned for it needs."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from .rows import Row, Table, digits

TOPICS = (
    "workprecision",
    "defaults",
    "outputs",
    "steps",
    "ensembles",
    "sweeps",
    "longruns",
    "startup",
    "frames",
    "files",
    "pages",
)
PAGE = Path(__file__).parent.parent / "docs" / "performance.md"


def measured(topic: str, page: bool) -> tuple[list[Table], list[str]]:
    """Measure a topic, in a process of its own: what other tools leave behind slows the next topic down.

    Returns the tables, and with `page` what else the page has.
    """
    module = import_module(f"{__package__}.{topic}")
    tables = [as_table(topic, module.rows()), *(module.tables() if hasattr(module, "tables") else [])]
    more = ["", *module.write(PAGE.with_suffix(""))] if page and hasattr(module, "write") else []
    return tables, more


def as_table(topic: str, rows: list[Row]) -> Table:
    """Return the figures of a topic as text."""
    cells = []
    for row in rows:
        measured = "–" if row.measured is None else f"{digits(row.measured)} {row.unit}"
        goal = "" if row.goal is None else f"{'≤' if row.at_most else '≥'} {row.goal:g}"
        cells.append([row.name, measured, goal, row.verdict if not row.note else row.note])
    return Table(topic, ["what", "measured", "goal", "verdict"], cells)
