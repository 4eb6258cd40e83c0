"""docs/performance.md: one table a topic, with a column for each machine that has a file in docs/performance/."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from textwrap import fill
from typing import NamedTuple

from .rows import TOPICS, Row, digits, machine, processor

PAGE = Path(__file__).parent.parent / "docs" / "performance.md"
FOLDER = PAGE.with_suffix("")
NAMES = ["topic", "what", "measured", "unit", "note"]
SHOWN = {  # topics on the page, and what the names of their figures contain there; all are in the files
    "workprecision": "heyoka|SciPy",
    "outputs": "",
    "ensembles": "heyoka|threads / one",
    "gpu": "the GPU|/ GPU",
    "growth": "power",
    "defaults": "gauss 8",
    "derivatives": "gauss .*Jacobian",
    "startup": "gauss|nontwist",
}
SENTENCES = """
To reach an error of 1e-9 at the end of a motion, heyoka.py takes {one} times as long as nontwist, {batches} times for
32,768 bodies at once, and {outputs} times with 1001 outputs on the way; below 1 it is faster. SciPy's DOP853 with its
right-hand side in Python takes {plain} times as long to reach 1e-6.
"""
ABOUT = """
Tools are compared by ratios of median times within one process, with passes in shuffled order. `make bench` measures
all on your machine and adds it to this page. Numbers of the columns are those of the machines below, whose files have
every figure; × is the time of the other tool over that of nontwist. A is a free non-twisting body, B one under a pulse,
C a free body, T a heavy top.

![Time against error for the four motions](performance/work-precision.svg)

The figure shows the time to reach an error of the attitude at the end of each motion; lower is faster. Colours are
integrators of nontwist; diamonds are methods that are exact to round-off at any step. All points are in
[work-precision.csv](performance/work-precision.csv).
"""


class Measured(NamedTuple):
    """What one machine has measured: for each topic its figures by name."""

    file: Path
    words: str
    version: str
    topics: dict[str, dict[str, Row]]

    def figures(self, topic: str, part: str) -> list[float]:
        """Return the ratios of a topic whose names contain a part."""
        rows = self.topics.get(topic, {}).values()
        return [row.measured for row in rows if part in row.name and row.unit == "×" and row.measured is not None]


def keep(topic: str, rows: Iterable[Row]) -> None:
    """Write the figures of a topic to the file of this machine, in place of those that it had."""
    path = FOLDER / (re.sub(r"\W+", "-", processor().lower()).strip("-") + ".csv")
    FOLDER.mkdir(parents=True, exist_ok=True)
    lines = list(csv.reader(path.open(encoding="utf-8")))[1:] if path.exists() else []
    lines = [line for line in lines if line[0] not in {topic, "machine", "version"}]
    lines += [
        [topic, row.name, "" if row.measured is None else digits(row.measured), row.unit, row.note] for row in rows
    ]
    with path.open("w", newline="", encoding="utf-8") as file:
        about = [["machine", machine(), "", "", ""], ["version", version("nontwist"), "", "", ""]]
        csv.writer(file, lineterminator="\n").writerows([NAMES, *about, *lines])


def read(path: Path) -> Measured:
    """Return what stands in the file of a machine."""
    topics: dict[str, dict[str, Row]] = {}
    for topic, what, value, unit, note in list(csv.reader(path.open(encoding="utf-8")))[1:]:
        topics.setdefault(topic, {})[what] = Row(what, float(value) if value else None, unit, note)
    words, number = (next(iter(topics.pop(key))) for key in ("machine", "version"))
    return Measured(path, words, number, topics)


def write_page() -> None:
    """Write the page from the files of all machines."""
    machines = [read(path) for path in sorted(FOLDER.glob("*.csv")) if path.stem != "work-precision"]
    current = [one for one in machines if one.version == version("nontwist")]
    ranges = {
        "one": between(current, "workprecision", "fastest at 1e-09: heyoka.py"),
        "batches": between(current, "ensembles", "bodies to 1e-09"),
        "outputs": between(current, "outputs", "heyoka.py"),
        "plain": between(current, "workprecision", "SciPy DOP853"),
    }
    text = SENTENCES.format(**ranges).replace("\n", " ").strip()
    lines = ["# Performance", "", fill(text, 120), ABOUT.rstrip(), ""]
    for k, one in enumerate(machines, 1):
        lines.append(f"{k}. {one.words} ([{one.file.name}](performance/{one.file.name}))")
    for topic, part in SHOWN.items():
        title, names = TOPICS[topic], dict.fromkeys(name for one in machines for name in one.topics.get(topic, {}))
        names = dict.fromkeys(name for name in names if re.search(part, name))
        figures = [one.topics.get(topic, {}) for one in machines]
        cells = [[name.strip(), *(one.get(name, Row(name, None, "")).value for one in figures)] for name in names]
        if cells:
            lines += ["", f"## {title}", "", *table(["", *map(str, range(1, len(machines) + 1))], cells)]
    PAGE.write_text("\n".join(lines) + "\n", encoding="utf-8")


def between(machines: Iterable[Measured], topic: str, part: str) -> str:
    """Return the range of ratios over all machines."""
    found = sorted(x for one in machines for x in one.figures(topic, part))
    return f"{digits(found[0])} to {digits(found[-1])}" if found else "(not measured)"


def table(header: list[str], cells: list[list[str]]) -> list[str]:
    """Return the lines of a table on the page."""
    rule = ["---", *("---:" for _ in header[1:])]
    return [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in (header, rule, *cells)]
