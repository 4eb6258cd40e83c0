"""`reproduce`: the three cases, their tables, figures and runs, in one folder a case, and a page of all."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .. import plot
from ..analysis.precision import second_quotient
from ..driver import simulate
from ..driver.coarseness import COARSE_STEP
from ..geometry.values import among, as_function, as_list, as_path, shown
from ..io import save_run
from ..io.whole import require_free, written
from ..models.catalogue import nontwisting
from ..plot.journals import apart
from .page import page
from .tables import CASES, INERTIA, STEP, T_END, Table, invariants_table, quotient_table

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes

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
        raise ValueError(f"the paper has the cases 1, 2, 3; got {shown(unknown[0])}")
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
                drawn, columns = FIGURES[name](runs["h"], quotient)
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


Drawing = tuple["Axes", "dict[str, xarray.DataArray]"]


def _momenta(run: xarray.Dataset, quotient: xarray.DataArray) -> Drawing:
    left, right = plot.new_axes(columns=2, panels=2)
    plot.momenta(run, left, frame="space")
    drawn = plot.momenta(run, right, frame="body")
    columns = {f"spatial_momentum_{x}": run["spatial_momentum"][:, k] for k, x in enumerate("xyz")}
    columns |= {f"material_momentum_{i + 1}": run["material_momentum"][:, i] for i in range(3)}
    return drawn, {"time": run["time"], **columns}


def _energy(run: xarray.Dataset, quotient: xarray.DataArray) -> Drawing:
    return plot.energy(run), {"time": run["time"], "kinetic_energy": run["kinetic_energy"]}


def _quotient(run: xarray.Dataset, quotient: xarray.DataArray) -> Drawing:
    return plot.second_quotient(quotient), {"time": quotient["time"], "second_quotient": quotient}


def _path(run: xarray.Dataset, quotient: xarray.DataArray) -> Drawing:
    d3 = run["directors"].sel(director=3)
    columns = {f"d3_{x}": d3.sel(axis=x) for x in "xyz"}
    return plot.path(run, great_circle=True), {"time": run["time"], **columns}


# The figures of the paper, one column a case, "energy" and "second_quotient" side by side:
#   fig-angular-momentum-ic    fig-angular-momentum-ml    fig-angular-momentum-c
#   fig-energy-precision-ic    fig-energy-precision-ml    fig-energy-precision-c
#   fig-trajectory-ic          fig-trajectory-ml          fig-trajectory-c
FIGURES = {"momenta": _momenta, "energy": _energy, "second_quotient": _quotient, "path": _path}


def _save(drawn: Axes, path: Path, columns: dict[str, xarray.DataArray], force: bool) -> None:
    """Write a figure as PDF and PNG, and the numbers it shows as CSV."""
    plot.save(drawn, path.with_suffix(".pdf"), path.with_suffix(".png"), force=force)
    header, table = ",".join(columns), np.column_stack([column.values for column in columns.values()])
    with written(path.with_name(f"{path.name}_data.csv"), force=force) as file:
        np.savetxt(file, table, fmt="%.17g", delimiter=",", header=header, comments="")
