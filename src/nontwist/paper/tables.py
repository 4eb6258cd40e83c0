"""The six tables of the paper, compared with computed numbers.

The paper's invariants are truncated, not rounded, to six decimals: they agree when every printed digit does. Its
second quotients stopped Newton's iteration at 1e-10; they agree within 6e-5.
"""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import astuple, dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..io.whole import written

if TYPE_CHECKING:
    import xarray

QUOTIENT_TOLERANCE = 6e-5


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
    data: dict[str, Any] = json.loads(files(__package__).joinpath("tables.json").read_text(encoding="utf-8"))
    return data


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
