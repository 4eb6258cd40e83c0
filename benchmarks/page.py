"""docs/performance.md: who is faster at what, in three sentences and a figure; all tables; the goals at the end."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from textwrap import fill

from .machine import words
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

Time to reach an error of the attitude at the end of each motion. Diamonds are methods that are exact to round-off at
any step. All points: [work-precision.csv](performance/work-precision.csv).
"""
ABOUT = """
Every number on this page is from one run of `make bench` on one machine. Times move from run to run and from machine to
machine; so tools are compared by ratios within one process, with passes in shuffled order, by medians. Each topic has a
process of its own.
"""
GOALS = """
## Goals

What the authors hold this version to. A goal is met or missed in this run.
"""


def page_of(found: dict[str, Measured]) -> str:
    """Return the page of a run of all topics."""
    lines = ["# Performance", "", summary({topic: about.rows for topic, about in found.items()}), FIGURE, ABOUT]
    lines += [words()]
    goals = []
    for topic, about in found.items():
        lines += ["", f"## {TOPICS[topic]}", "", about.about]
        cells = [[row.name, row.note if row.measured is None else row.value] for row in about.rows]
        for table in [Table("", ["what", "measured"], cells), *about.tables]:
            lines += markdown(table)
        goals += [[row.name, row.value, row.bound, row.verdict] for row in about.rows if row.goal is not None]
    lines += [GOALS, *markdown(Table("", ["what", "measured", "goal", "verdict"], goals))]
    return "\n".join(lines) + "\n"


def summary(rows: dict[str, list[Row]]) -> str:
    """Return the sentences that say who is faster, of what was measured."""
    precision = rows["workprecision"]
    heyoka = [
        f"{digits(max(times))} times (for {motion})"
        for key, motion in MOTIONS.items()
        if (times := list(_figures(precision, f"{key} at 1e-09: heyoka.py")))
    ]
    start = {row.name: row.value for row in rows["startup"]}
    batches, outputs = _range(rows["ensembles"], "bodies to 1e-09"), _range(rows["outputs"], "heyoka.py")
    plain, compiled = _range(precision, "SciPy DOP853, NumPy"), _range(precision, "SciPy DOP853, Numba")
    return fill(
        "The fastest general solver here is [heyoka.py](https://bluescarni.github.io/heyoka.py). To reach an error of "
        f"1e-9 at the end of a motion, it takes {_listed(heyoka)} as long as nontwist; for 32,768 free bodies at once, "
        f"in batches, {batches} times. SciPy's DOP853 takes {plain} times as long to 1e-6 with the right-hand side in "
        f"NumPy, and {compiled} times with one that Numba has compiled. For 1001 outputs of one run heyoka.py takes "
        f"{outputs} times as long (below 1 it is faster): its outputs are values of a polynomial, ours are steps that "
        f"keep energy and momentum. A new process has its first result after {start['first result, gauss']}, that of "
        f"an ensemble after {start['first ensemble, gauss']}; `nontwist run FILE` takes {start['nontwist run FILE']}.",
        width=120,
        break_long_words=False,
    )


def _figures(rows: Iterable[Row], part: str) -> Iterable[float]:
    return (row.measured for row in rows if part in row.name and row.unit == "×" and row.measured is not None)


def _range(rows: Iterable[Row], part: str) -> str:
    found = sorted(_figures(rows, part))
    return f"{digits(found[0])} to {digits(found[-1])}" if found else "(not measured)"


def _listed(parts: list[str]) -> str:
    return f"{', '.join(parts[:-1])} and {parts[-1]}" if parts[1:] else "".join(parts) or "(not measured)"


def markdown(table: Table) -> list[str]:
    """Return the lines of a table on the page."""

    def line(cells: list[str]) -> str:
        return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"

    rule = ["---"] + ["---" if column == "verdict" else "---:" for column in table.header[1:]]
    title = ["", f"**{table.title}**"] if table.title else []
    return [*title, "", line(table.header), line(rule), *map(line, table.cells)]
