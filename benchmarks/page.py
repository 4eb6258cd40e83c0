"""docs/performance.md: who is faster at what, in three sentences and a figure; all tables; the goals at the end."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from textwrap import fill

from .machine import words
from .peers import ABSENT
from .rows import Row, Table, digits
from .topics import TOPICS, Measured

PAGE = Path(__file__).parent.parent / "docs" / "performance.md"
MOTIONS = {
    "A": "a free non-twisting body",
    "B": "a non-twisting body under a pulse",
    "C": "a free body",
    "T": "a heavy top",
}
FIGURE = """
![Time against error for the four motions](performance/work-precision.svg)

The figure shows the time to reach an error of the attitude at the end of each motion; lower is faster. Colours are
integrators of nontwist, grey and black are other tools; diamonds are methods that are exact to round-off at any step.
The file [work-precision.csv](performance/work-precision.csv) has all points, those of the other integrators included.
"""
ABOUT = """
Every number on this page is from one run of `make bench` on one machine. Times vary from run to run and from machine to
machine. Tools are therefore compared by ratios of median times within one process, with passes in shuffled order. Each
topic runs in a separate process.
"""
GOALS = """
## Goals

The goals of the authors for this version. A goal is met or missed in this run.
"""


def page_of(found: dict[str, Measured]) -> str:
    """Return the page of a run of all topics."""
    sentences, waits = summary({topic: about.rows for topic, about in found.items()})
    lines = [
        "# Performance",
        "",
        sentences,
        FIGURE,
        waits,
        *markdown(table_of(best(found["workprecision"].rows))),
        ABOUT,
        words(),
    ]
    goals = []
    for topic, about in found.items():
        lines += ["", f"## {TOPICS[topic]}", "", about.about]
        shown = [row for row in about.rows if row.measured is not None or row.note != ABSENT]
        cells = [[row.name, row.note if row.measured is None else row.value] for row in shown]
        for table in [Table("", ["what", "measured"], cells), *about.tables]:
            lines += markdown(table)
        goals += [[row.name, row.value, row.bound, row.verdict] for row in about.rows if row.goal is not None]
    lines += [GOALS, *markdown(Table("", ["what", "measured", "goal", "verdict"], goals))]
    return "\n".join(lines) + "\n"


def summary(rows: dict[str, list[Row]]) -> tuple[str, str]:
    """Return three sentences on who is faster, by how much, and one on start-up."""
    precision = rows["workprecision"]
    heyoka = _range(best(precision).values(), "heyoka.py")
    start = {row.name: row.value for row in rows["startup"]}
    batches, outputs = _range(rows["ensembles"], "bodies to 1e-09"), _range(rows["outputs"], "heyoka.py")
    plain, compiled = _range(precision, "SciPy DOP853, NumPy"), _range(precision, "SciPy DOP853, Numba")
    sentences = (
        "The fastest general-purpose solver measured is [heyoka.py](https://bluescarni.github.io/heyoka.py): to reach "
        f"an error of 1e-9 at the end of a motion, it takes {heyoka} times as long as nontwist, and {batches} times "
        "for 32,768 free bodies at once, in batches. SciPy's DOP853 takes "
        f"{plain} times as long to reach 1e-6 with the right-hand side in NumPy, and {compiled} times with one "
        f"compiled by Numba. For 1001 outputs of one run heyoka.py takes {outputs} times as long (below 1 it is "
        "faster), because its outputs are values of a polynomial, and those of nontwist are steps that conserve energy "
        "and momentum."
    )
    waits = (
        f"A new process has its first result after {start['first result, gauss']}, and that of an ensemble after "
        f"{start['first ensemble, gauss']}; `nontwist run FILE` takes {start['nontwist run FILE']}."
    )
    return fill(sentences, width=120, break_long_words=False), fill(waits, width=120, break_long_words=False)


def best(rows: list[Row]) -> dict[str, Row]:
    """Return what the fastest general-purpose solver takes relative to the fastest method here, motion by motion."""
    found = {}
    for key, motion in MOTIONS.items():
        own = [row for row in rows if row.name.startswith(f"{key} at 1e-09: heyoka.py") and row.measured is not None]
        if own:
            found[motion] = max(own, key=lambda row: row.measured or 0.0)
    return found


def table_of(found: dict[str, Row]) -> Table:
    """Return these as a table."""
    cells = [[motion, row.name.split(" / ")[1], row.value] for motion, row in found.items()]
    return Table("", ["motion, to an error of 1e-9 rad", "fastest method of nontwist", "time of heyoka.py"], cells)


def _figures(rows: Iterable[Row], part: str) -> Iterable[float]:
    return (row.measured for row in rows if part in row.name and row.unit == "×" and row.measured is not None)


def _range(rows: Iterable[Row], part: str) -> str:
    found = sorted(_figures(rows, part))
    return f"{digits(found[0])} to {digits(found[-1])}" if found else "(not measured)"


def markdown(table: Table) -> list[str]:
    """Return the lines of a table on the page."""

    def line(cells: list[str]) -> str:
        return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"

    rule = ["---"] + ["---" if column == "verdict" else "---:" for column in table.header[1:]]
    title = ["", f"**{table.title}**"] if table.title else []
    return [*title, "", line(table.header), line(rule), *map(line, table.cells)]
