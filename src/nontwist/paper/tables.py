"""`reproduce`: the three cases of the paper, their tables, figures and runs, in one folder a case, and a page of all.

The paper's invariants are truncated, not rounded, to six decimals: they agree when every printed digit does. Its
second quotients stopped Newton's iteration at 1e-10; they agree within 6e-5.

The page, ``index.html``, shows tables and figures in the order of the paper, what it prints beside what was computed.
It holds all pictures and uses no network. In the dark the pictures are inverted, and turned back in hue, so that
colours stay what they are.
"""

from __future__ import annotations

import base64
import csv
import html
import io
import json
import math
import os
import re
import warnings
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import astuple, dataclass, fields
from functools import cache
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from .. import plot
from ..analysis.statistics import second_quotient
from ..driver.notices import COARSE_STEP
from ..driver.runs import simulate
from ..geometry.arrays import Axes, DataArray, Dataset
from ..geometry.values import among, as_function, as_list, as_path, short_repr
from ..io.run_files import save_run
from ..io.whole import require_free, written
from ..loads import Load, pulse
from ..models.bodies import nontwisting
from ..plot.journals import apart

# The three cases of sec-results: one body, t from 0 to 5 s, h = 0.005 s.
#
# The amplitudes printed for the loads of cases 2 and 3 are 20 times those that give the printed tables: the impulse of
# case 2 is fixed by ∫f dt = 1/2, so 2472.5 would end at Π1 = -1236.25, where the table has -61.749731.

INERTIA = ((3.0, -1 / 7, 0.0), (-1 / 7, 4.0, 0.0), (0.0, 0.0, 5.0))
T_END, STEP = 5.0, 0.005
MISPRINT = 20.0


@dataclass(frozen=True)
class Case:
    """One case: initial material angular velocity (rad/s) and peak of the triangular load (N m), as printed."""

    title: str
    angular_velocity: tuple[float, float, float]
    printed_peak: tuple[float, float, float]

    def load(self, printed: bool = False) -> Load:
        """Return the load, corrected by the factor 1/20 or as `printed` (eq-loads_time_variation)."""
        if not any(self.printed_peak):
            return Load()
        return (1.0 if printed else 1 / MISPRINT) * pulse(self.printed_peak, 0.0, 1.0, shape="triangle", frame="body")


CASES = {
    1: Case("response to nonzero initial conditions", (6.0, -18.0, 0.0), (0.0, 0.0, 0.0)),
    2: Case("response to a vanishing load", (0.0, 0.0, 0.0), (-2472.5, -1075.0, 0.0)),
    3: Case("response to nonzero initial conditions and a vanishing load", (1.5, 4.5, 0.0), (-1236.25, -537.5, 0.0)),
}


# The labels of the paper's equations, sections, figures and tables, and the numbers that LaTeX prints for them.


LABEL = re.compile(r"(?<![\w-])(?:eq|tab|sec|subs|fig)[-_:][A-Za-z][\w:-]*\w")
KINDS = {"eq": "", "sec": "Section ", "subs": "Section ", "fig": "Figure ", "tab": "Table "}


@cache
def printed_numbers() -> dict[str, str]:
    """Return the printed number of each label, as ``"46"`` or ``"2.1"``, in the order of the paper."""
    return _data("labels.json")["labels"]


def printed(label: str, row: str = "") -> str:
    """Return how the paper prints a label: "(46)", or "(46b)" with a row; "Section 2.1", "Figure 3", "Table 4".

    Raises
    ------
    KeyError
        The paper has no such label.
    """
    number, kind = printed_numbers()[label], KINDS[re.split("[-_:]", label)[0]]
    return f"{kind}{number}" if kind else f"({number}{row})"


def _data(name: str) -> dict[str, Any]:
    return json.loads(files(__package__).joinpath(name).read_text(encoding="utf-8"))


QUOTIENT_TOLERANCE = 6e-5
CAPTIONS = {
    "second_quotient": f"Second quotient of precision; agrees within {QUOTIENT_TOLERANCE:g}",
    "invariants": "Motion invariants; printed digits are truncated",
}


@dataclass(frozen=True)
class Row:
    """One printed number and the computed one."""

    time: float
    quantity: str
    unit: str
    printed: float
    computed: float
    difference: float
    agrees: bool


@dataclass(frozen=True)
class Table:
    """One table of the paper."""

    case: int
    name: str
    title: str
    rows: tuple[Row, ...]

    @property
    def agrees(self) -> bool:
        """Whether every number agrees."""
        return all(row.agrees for row in self.rows)

    def write(self, path: Path, *, force: bool = False) -> None:
        """Write the table as CSV; errors as in `save_run`."""
        text = io.StringIO(newline="")
        writer = csv.writer(text)
        writer.writerow(field.name for field in fields(Row))
        writer.writerows(astuple(row) for row in self.rows)
        with written(path, force=force) as file:
            file.write(text.getvalue().encode())


def printed_tables() -> dict[str, Any]:
    """Return the numbers that the paper prints."""
    return _data("tables.json")


def invariants_table(case: int, run: Dataset) -> Table:
    """Compare Π1, Π2 and K with tables tab-invariants_ic, tab-invariants_ml, tab-invariants_c."""
    printed, rows = printed_tables(), []
    for t in printed["time"]:
        state = run.sel(time=t, method="nearest")
        computed = [*state["material_momentum"].values[:2], float(state["kinetic_energy"])]
        expected = [*printed[f"case{case}"]["material_momentum"], printed[f"case{case}"]["kinetic_energy"]]
        for name, unit, p, c in zip(
            ("Π1", "Π2", "K"), ("kg m2 s-1", "kg m2 s-1", "J"), expected, computed, strict=True
        ):
            rows.append(Row(t, name, unit, p, float(c), float(c) - p, math.trunc(c * 1e6) == round(p * 1e6)))
    return Table(case, "invariants", "motion invariants (printed digits are truncated: docs/errata.md, 2)", tuple(rows))


def quotient_table(case: int, quotient: DataArray) -> Table:
    """Compare Q_II with tables tab-sqp_ic, tab-sqp_ml, tab-sqp_c."""
    printed, rows = printed_tables(), []
    for t, p in zip(printed["time"], printed[f"case{case}"]["second_quotient"], strict=True):
        c = float(quotient.sel(time=t, method="nearest"))
        rows.append(Row(t, "Q_II", "1", p, c, c - p, abs(c - p) <= QUOTIENT_TOLERANCE))
    title = f"second quotient of precision (agrees within {QUOTIENT_TOLERANCE:g})"
    return Table(case, "second_quotient", title, tuple(rows))


RUNS = {"h": 1, "h2": 2, "h4": 4}
INDEX = "index.html"


@dataclass(frozen=True)
class Reproduction:
    """The tables with those of the paper, and the folder of all results."""

    tables: tuple[Table, ...]
    folder: Path

    @property
    def page(self) -> Path:
        """The page that shows all."""
        return self.folder / INDEX

    @property
    def agrees(self) -> bool:
        """Whether every number agrees with the paper."""
        return all(table.agrees for table in self.tables)


def reproduce(
    out: str | os.PathLike[str] = "reproduction",
    cases: Iterable[int] = (1, 2, 3),
    *,
    quick: bool = False,
    printed_loads: bool = False,
    force: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Reproduction:
    """Reproduce the numerical part of the paper (sec-results).

    Parameters
    ----------
    out : path
        Folder for the results, created if it does not exist. For each case: ``case1/invariants.csv``,
        ``second_quotient.csv``, the figures ``momenta``, ``energy``, ``second_quotient``, ``path`` as PDF and PNG with
        their numbers in ``*_data.csv``, and the runs ``h.nc``, ``h2.nc``, ``h4.nc``. The page ``index.html`` has every
        table and figure of these cases in the order of the paper, with printed and computed numbers side by side.
    cases : iterable of 1, 2, 3
    quick : bool
        Make only the tables and one figure per case.
    printed_loads : bool
        Use the amplitudes of the loads as printed, 20 times too large, to show the effect on the tables.
    force : bool
        Overwrite existing files.
    progress : callable, optional
        Called with a description of the next step.

    Returns
    -------
    Reproduction

    Raises
    ------
    ValueError
        The paper has no such case.
    FileExistsError
        One of the files exists, and `force` is not set; nothing is computed.
    OSError
        The folder cannot be written, or the disk is full; a partial file is removed.

    Examples
    --------
    The first case, with its tables compared with those of the paper:

    >>> from nontwist import reproduce
    >>> reproduction = reproduce("reproduction", cases=[1], quick=True)
    >>> reproduction.agrees
    True
    >>> sorted(path.name for path in reproduction.folder.glob("case1/*.csv"))
    ['invariants.csv', 'momenta_data.csv', 'second_quotient.csv']
    """
    given = as_list(cases, "cases")
    if unknown := [case for case in given if not among(case, CASES)]:
        raise ValueError(f"the paper has the cases 1, 2, 3; got {short_repr(unknown[0])}")
    chosen = sorted(set(given))
    say = (lambda text: None) if progress is None else as_function(progress, "progress")
    body, folder, tables = nontwisting(INERTIA), as_path(out, "out"), []
    figures = list(FIGURES)[:1] if quick else list(FIGURES)
    for number in chosen:
        place = folder / f"case{number}"
        place.mkdir(parents=True, exist_ok=True)
        require_free(folder / INDEX, *(place / name for name in _files(figures, quick)), force=force)
    for number in chosen:
        case, place = CASES[number], folder / f"case{number}"
        runs = {}
        for name, k in RUNS.items():
            say(f"case {number}: step {STEP / k:g} s")
            with warnings.catch_warnings():  # the paper's steps are what is reproduced
                warnings.filterwarnings("ignore", COARSE_STEP)
                runs[name] = simulate(
                    body,
                    t_end=T_END,
                    step=STEP / k,
                    material_angular_velocity=case.angular_velocity,
                    load=case.load(printed_loads),
                    integrator="energy-momentum",
                    order=2,
                )
        quotient = second_quotient(*runs.values())
        own = [invariants_table(number, runs["h"]), quotient_table(number, quotient)]
        for table in own:
            table.write(place / f"{table.name}.csv", force=force)
        tables += own
        say(f"case {number}: figures")
        for name in figures:
            with apart():
                drawn, columns = FIGURES[name][0](runs["h"], quotient)
            _save(drawn, place / name, columns, force)
        if not quick:
            for name, run in runs.items():
                titled = run.assign_attrs(title=f"Case {number}: {case.title}")
                save_run(titled, place / f"{name}.nc", force=force)
    if chosen:
        with written(folder / INDEX, force=force) as file:
            file.write(page(tables, folder, figures=figures, printed_loads=printed_loads).encode())
    return Reproduction(tuple(tables), folder)


def _files(figures: list[str], quick: bool) -> list[str]:
    """Return the names of what is written for a case."""
    tables = ["invariants.csv", "second_quotient.csv"]
    runs = [] if quick else [f"{name}.nc" for name in RUNS]
    return [*tables, *(f"{name}{end}" for name in figures for end in (".pdf", ".png", "_data.csv")), *runs]


Drawing = tuple[Axes, dict[str, DataArray]]


def _momenta(run: Dataset, quotient: DataArray) -> Drawing:
    left, right = plot.new_axes(columns=2, panels=2)
    plot.momenta(run, left, frame="space")
    drawn = plot.momenta(run, right, frame="body")
    columns = {f"spatial_momentum_{x}": run["spatial_momentum"][:, k] for k, x in enumerate("xyz")}
    columns |= {f"material_momentum_{i + 1}": run["material_momentum"][:, i] for i in range(3)}
    return drawn, {"time": run["time"], **columns}


def _energy(run: Dataset, quotient: DataArray) -> Drawing:
    return plot.energy(run), {"time": run["time"], "kinetic_energy": run["kinetic_energy"]}


def _quotient(run: Dataset, quotient: DataArray) -> Drawing:
    return plot.second_quotient(quotient), {"time": quotient["time"], "second_quotient": quotient}


def _path(run: Dataset, quotient: DataArray) -> Drawing:
    d3 = run["directors"].sel(director=3)
    columns = {f"d3_{x}": d3.sel(axis=x) for x in "xyz"}
    return plot.path(run, great_circle=True), {"time": run["time"], **columns}


# Each figure with its caption. Those of the paper, one column a case, have one or two of them:
#   fig-angular-momentum-ic    fig-angular-momentum-ml    fig-angular-momentum-c
#   fig-energy-precision-ic    fig-energy-precision-ml    fig-energy-precision-c
#   fig-trajectory-ic          fig-trajectory-ml          fig-trajectory-c
FIGURES: dict[str, tuple[Callable[[Dataset, DataArray], Drawing], str]] = {
    "momenta": (_momenta, "Angular momentum over time: a along fixed axes, b along the directors."),
    "energy": (_energy, "Kinetic energy over time."),
    "second_quotient": (_quotient, "Second quotient of precision over time; the line is its limit 4."),
    "path": (_path, "Path of the third director; wide and grey the great circle after the load."),
}
LABELS = {"angular-momentum": ["momenta"], "energy-precision": ["energy", "second_quotient"], "trajectory": ["path"]}
TABLES = {"sqp": "second_quotient", "invariants": "invariants"}
SUFFIX = {1: "ic", 2: "ml", 3: "c"}  # of the paper's labels
HEADS = ("t (s)", "quantity", "printed", "computed", "difference", "")


def _save(drawn: Axes, path: Path, columns: dict[str, DataArray], force: bool) -> None:
    """Write a figure as PDF and PNG, and the numbers it shows as CSV."""
    plot.save(drawn, path.with_suffix(".pdf"), path.with_suffix(".png"), force=force)
    header, table = ",".join(columns), np.column_stack([column.values for column in columns.values()])
    with written(path.with_name(f"{path.name}_data.csv"), force=force) as file:
        np.savetxt(file, table, fmt="%.17g", delimiter=",", header=header, comments="")


def page(tables: Sequence[Table], folder: Path, *, figures: Collection[str], printed_loads: bool) -> str:
    """Return the document for the tables of the cases, and for their figures, which lie in the folders of the cases."""
    rows = [row for table in tables for row in table.rows]
    agreeing = sum(row.agrees for row in rows)
    document = files(__package__).joinpath("page.html").read_text(encoding="utf-8")
    return Template(document).substitute(
        inertia="[" + ", ".join("[" + ", ".join(_number(f"{x:.4g}") for x in row) + "]" for row in INERTIA) + "]",
        t_end=f"{T_END:g}",
        step=f"{STEP:g}",
        loads="Loads of cases 2 and 3 are as printed."
        if printed_loads
        else f"Loads of cases 2 and 3 are those printed over {MISPRINT:g}, which give the printed tables.",
        agreeing=agreeing,
        all=len(rows),
        **{"class": "good" if agreeing == len(rows) else "bad"},
        missing="" if {*figures} >= {*FIGURES} else f"Drawn was {', '.join(figures)} alone: a quick reproduction.",
        cases="\n".join(_case(number, tables, figures, folder) for number in sorted({table.case for table in tables})),
    )


def _case(number: int, tables: Sequence[Table], figures: Collection[str], folder: Path) -> str:
    case, end = CASES[number], SUFFIX[number]
    velocity = _number(", ".join(f"{x:g}" for x in case.angular_velocity))
    parts = [f"<h2>Case {number}: {case.title}</h2>\n<p>Initial material angular velocity ({velocity}) rad/s.</p>"]
    for label, pictures in LABELS.items():
        if there := [name for name in pictures if name in figures]:
            parts.append(_figure(number, printed(f"fig-{label}-{end}"), there, folder))
    for label, name in TABLES.items():
        (table,) = (one for one in tables if (one.case, one.name) == (number, name))
        parts.append(_table(printed(f"tab-{label}_{end}"), table))
    return "\n".join(parts)


def _figure(number: int, title: str, pictures: list[str], folder: Path) -> str:
    images, links = [], []
    for name in pictures:
        place, words = f"case{number}/{name}", FIGURES[name][1]
        data = base64.b64encode((folder / f"{place}.png").read_bytes()).decode("ascii")
        width = 820 if name == "momenta" else 400
        images.append(
            f'<img src="data:image/png;base64,{data}" width="{width}" alt="Case {number}: {html.escape(words)}">'
        )
        links += [f'<a href="{place}.pdf">{name}.pdf</a>', f'<a href="{place}_data.csv">{name}_data.csv</a>']
    caption = f"{title}. {' '.join(FIGURES[name][1] for name in pictures)} {', '.join(links)}"
    return f"<figure><div>{''.join(images)}</div><figcaption>{caption}</figcaption></figure>"


def _table(title: str, table: Table) -> str:
    heads = "".join(f'<th scope="col">{head}</th>' for head in HEADS)
    lines = []
    for row in table.rows:
        name = row.quantity if row.unit == "1" else f"{row.quantity} ({row.unit.replace('m2', 'm²')})"
        verdict = '<td class="good">agrees</td>' if row.agrees else '<td class="bad">differs</td>'
        numbers = (f"{row.printed:.6f}", f"{row.computed:.9f}", f"{row.difference:.1e}")
        cells = "".join(f"<td>{cell}</td>" for cell in (f"{row.time:g}", name, *map(_number, numbers)))
        lines.append(f"<tr>{cells}{verdict}</tr>")
    link = f'<a href="case{table.case}/{table.name}.csv">{table.name}.csv</a>'
    caption = f"<caption>{title}. {CAPTIONS[table.name]}. {link}</caption>"
    body = "\n".join(lines)
    return f'<div class="scroll"><table>{caption}<thead><tr>{heads}</tr></thead>\n<tbody>{body}</tbody></table></div>'


def _number(text: str) -> str:
    return text.replace("-", "−")
