"""docs/performance.md: who is faster at what, in three sentences and a figure, and one table a topic."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from itertools import takewhile
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

The figure shows the time to reach an error of the attitude at the end of each motion; lower is faster. Colours are
integrators of nontwist; diamonds are methods that are exact to round-off at any step. All points are in
[work-precision.csv](performance/work-precision.csv).
"""
ABOUT = """
All numbers are from one run of `make bench`. Tools are compared by ratios of median times within one process, with
passes in shuffled order. A range covers as many figures as the number behind it says.
[measured.csv](performance/measured.csv) has each of them, and those of start-up, outputs, single steps, sweeps, frames,
files and pages.
"""
ON_THE_PAGE = ("workprecision", "defaults", "ensembles", "derivatives")


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
    for topic in ON_THE_PAGE:
        about = found[topic]
        lines += ["", f"## {TOPICS[topic]}", "", about.about, *markdown(shown(topic, about))]
    return "\n".join(lines) + "\n"


def shown(topic: str, about: Measured) -> Table:
    """Return the table of a topic."""
    if topic == "workprecision":
        motions = [{method: cells for method, *cells in table.cells} for table in about.tables]
        methods = dict.fromkeys(method for motion in motions for method in motion)
        cells = [[method, *(motion.get(method, NOTHING)[2] or "–" for motion in motions)] for method in methods]
        cells = [line for line in cells if set(line[1:]) != {"–"}]
        titles = [table.title.removesuffix(", end state") for table in about.tables]
        return Table("", ["µs to an error of 1e-9 rad", *titles], cells)
    if topic == "defaults":
        return Table("", about.tables[0].header, about.tables[0].cells)
    found: dict[tuple[str, str], list[Row]] = {}
    for row in about.rows:
        is_beneath = row.name.startswith(" ")
        if row.measured is not None and not is_beneath and row.unit != "MB":
            what = row.name.rpartition(": ")[2].partition(", grows like")[0]
            found.setdefault((what, row.unit), []).append(row)
    return Table("", ["what", "measured"], [together(what, rows) for (what, _), rows in found.items()])


def together(what: str, rows: list[Row]) -> list[str]:
    """Return one line for rows that measure the same, with the words that their names begin with, and their number."""
    if len(rows) == 1:
        return [rows[0].name.strip(), rows[0].value]
    words_of_each = zip(*(row.name.rpartition(": ")[0].split() for row in rows), strict=False)
    head = " ".join(same[0] for same in takewhile(lambda words: len({*words}) == 1, words_of_each)).strip(",:")
    ends = dict.fromkeys(digits(end(row.measured or 0.0 for row in rows)) for end in (min, max))
    parts = [" to ".join(ends), rows[0].unit, f"({len(rows)})"]
    return [f"{head}: {what.strip()}" if head else what.strip(), " ".join(filter(None, parts))]


NOTHING = ["–"] * 5


def write_rows(found: dict[str, Measured], path: Path) -> None:
    """Write every figure of a run of all topics as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["topic", "what", "measured", "unit", "note"])
        for topic, about in found.items():
            for row in about.rows:
                value = "" if row.measured is None else digits(row.measured)
                writer.writerow([topic, row.name.strip(), value, row.unit, row.note])


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
        "faster), because its outputs are values of a polynomial; those of nontwist conserve energy and momentum."
    )
    waits = (
        f"A new process has its first result after {start['gauss: first result']}, and that of an ensemble after "
        f"{start['gauss: first ensemble']}; `nontwist run FILE` takes {start['nontwist run FILE']}."
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

    rule = ["---"] + ["---:" for _ in table.header[1:]]
    title = ["", f"**{table.title}**"] if table.title else []
    return [*title, "", line(table.header), line(rule), *map(line, table.cells)]
