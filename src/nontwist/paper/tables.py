"""The six tables of the paper, compared with computed numbers.

The paper's invariants are truncated, not rounded, to six decimals: they agree when every printed digit does. Its
second quotients stopped Newton's iteration at 1e-10; they agree within 6e-5.
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
from dataclasses import astuple, dataclass, fields
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..io.whole import written
from ..loads import Load, pulse

if TYPE_CHECKING:
    import xarray

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
    numbers: dict[str, str] = _data("labels.json")["labels"]
    return numbers


@cache
def theorems() -> tuple[str, ...]:
    """Return the printed numbers of the theorems, which have no labels."""
    return tuple(_data("labels.json")["theorems"])


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
    data: dict[str, Any] = json.loads(files(__package__).joinpath(name).read_text(encoding="utf-8"))
    return data


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


def invariants_table(case: int, run: xarray.Dataset) -> Table:
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


def quotient_table(case: int, quotient: xarray.DataArray) -> Table:
    """Compare Q_II with tables tab-sqp_ic, tab-sqp_ml, tab-sqp_c."""
    printed, rows = printed_tables(), []
    for t, p in zip(printed["time"], printed[f"case{case}"]["second_quotient"], strict=True):
        c = float(quotient.sel(time=t, method="nearest"))
        rows.append(Row(t, "Q_II", "1", p, c, c - p, abs(c - p) <= QUOTIENT_TOLERANCE))
    title = f"second quotient of precision (agrees within {QUOTIENT_TOLERANCE:g})"
    return Table(case, "second_quotient", title, tuple(rows))
