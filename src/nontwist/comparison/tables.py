"""All runs of a comparison, grouped by integrator: `table`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .cells import (
    as_comparison,
    drift_cell,
    empty_table,
    explained,
    failed,
    invariant_drifts,
    invariant_headings,
    invariant_legend,
    milliseconds,
    numbered,
)
from .settings import short

if TYPE_CHECKING:
    import xarray
    from rich.table import Table


def table(comparison: xarray.Dataset) -> Table:
    """Return all runs of a comparison as a table, grouped by integrator; failures are explained below it.

    Parameters
    ----------
    comparison : Dataset
        A result of `nontwist.compare`.

    Returns
    -------
    rich.table.Table
        Largest errors over the shared times, their measured orders n, drifts, and run times in milliseconds. ``<4e-14``
        stands for an error within the error bar of the reference.

    Raises
    ------
    ValueError
        `comparison` is not a comparison.

    Examples
    --------
    >>> from nontwist import compare, comparison, standard
    >>> how = {"material_angular_velocity": (0.5, 2, 0.1), "steps": [0.1, 0.05], "repeats": 1}
    >>> data = compare(standard([3, 4, 5]), t_end=2, integrators=["gauss", "exact"], **how)
    >>> runs = comparison.table(data)  # rich.print(runs) shows it
    >>> [cell.strip() for cell in runs.columns[0].cells]
    ['gauss 8', '0.1', '0.05', 'exact']
    """
    as_comparison(comparison)
    table = empty_table(comparison.attrs["title"], comparison)
    table.add_column("integrator,\nstep (s)", no_wrap=True)
    for heading in ("error Λ\nrad", "n", "error Π\nkg m² s⁻¹", "n", *invariant_headings(comparison), "ms"):
        table.add_column(heading, justify="right", no_wrap=True)
    notes: list[str] = []
    for name in comparison["integrator"].values:
        group, stepping = comparison.sel(integrator=name), bool(comparison["takes_steps"].sel(integrator=name))
        if (group["status"] < 0).all():
            table.add_row(f"{name}{numbered(notes, group['message'].values[0])}", failed(-1), end_section=True)
            continue
        if stepping:
            table.add_row(str(name))
        steps = group["step"].values
        for h in steps if stepping else steps[:1]:
            run = group.sel(step=h)
            first = (f"  {h:.4g}" if stepping else str(name)) + numbered(notes, run["message"].values)
            if run["status"] != 0:
                table.add_row(first, failed(run["status"]))
                continue
            cells = [cell for of in ("attitude", "momentum") for cell in (_error(run, of), _order(run, of))]
            kept = [drift_cell(float(drift)) for drift in invariant_drifts(run)]
            table.add_row(first, *cells, *kept, milliseconds(float(run["run_time"])))
        table.add_section()
    bars = [short(float(comparison[f"{of}_reference_error"])) for of in ("attitude", "momentum")]
    legend = (
        f"Largest errors at {comparison.attrs['shared_times']} times against {comparison.attrs['reference']}, whose "
        f"error bars are {bars[0]} rad, {bars[1]} kg m² s⁻¹. n: order measured from the step before. "
        f"{invariant_legend(comparison)}"
    )
    table.caption = "\n".join(["", *explained(notes), legend])
    return table


def _error(run: xarray.Dataset, of: str) -> str:
    below = bool(run[f"{of}_below_bar"])
    return "<" + short(float(run[f"{of}_reference_error"])) if below else short(float(run[f"{of}_error_max"]))


def _order(run: xarray.Dataset, of: str) -> str:
    order = float(run[f"{of}_order"])
    return "" if np.isnan(order) else f"{order:.1f}"
