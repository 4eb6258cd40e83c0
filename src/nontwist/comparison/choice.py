"""The choice of integrator, a line for each: `summary`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..geometry.arrays import Array, as_positive
from .cells import (
    CONSERVED,
    NONE,
    as_comparison,
    drift_cell,
    empty_table,
    explained,
    failed,
    invariant_drifts,
    invariant_headings,
    invariant_legend,
    largest,
    milliseconds,
    numbered,
)
from .settings import short

if TYPE_CHECKING:
    import xarray
    from rich.table import Table

CLOSE = 1.25
SPOILT = (
    "The steps miss breakpoints of the load, so orders are spoilt and none is the fastest: leave the steps out, and "
    "breakpoints are nodes."
)


def summary(comparison: xarray.Dataset, targets: Sequence[float] = (1e-3, 1e-6, 1e-9)) -> Table:
    """Return a comparison as a table with one line for each integrator, from which to choose.

    Parameters
    ----------
    comparison : Dataset
        A result of `nontwist.compare`.
    targets : sequence of float, rad
        Attitude errors.

    Returns
    -------
    rich.table.Table
        The measured orders of attitude and momentum, at the finest steps that have one; the milliseconds to reach each
        error, and the step for the smallest error (s), both interpolated between two runs on logarithmic scales, with
        ``<`` and ``>`` where the coarsest step is already more accurate; and the largest drifts at any step.

    Raises
    ------
    ValueError
        `comparison` is not a comparison, or a target is not positive.

    Examples
    --------
    >>> from nontwist import compare, comparison, standard
    >>> how = {"material_angular_velocity": (0.5, 2, 0.1), "steps": [0.1, 0.05], "repeats": 1}
    >>> data = compare(standard([3, 4, 5]), t_end=2, integrators=[("gauss", 4), "exact"], **how)
    >>> choice = comparison.summary(data, targets=[1e-3])  # rich.print(choice) shows it
    >>> list(choice.columns[1].cells)  # the order of the attitude
    ['4.0', '–']
    """
    as_comparison(comparison)
    targets = as_positive(targets, "targets", (None,), "rad").tolist()
    table = empty_table(f"{comparison.attrs['title']}: integrators compared", comparison)
    table.add_column("integrator", no_wrap=True)
    to = [*(f"ms to\n{short(target)}" for target in targets), f"step\nfor\n{short(min(targets))}"]
    for heading in ("order\nΛ", "order\nΠ", *to, *invariant_headings(comparison)):
        table.add_column(heading, justify="right", no_wrap=True)
    times = {target: times_to(comparison, target) for target in targets}
    steps = times_to(comparison, min(targets), "step")
    notes: list[str] = []
    meets_kinks = bool(comparison.attrs.get("meets_kinks", 1))
    for name in comparison["integrator"].values:
        runs = comparison.sel(integrator=name)
        if (runs["status"] != 0).all():
            table.add_row(f"{name}{numbered(notes, runs['message'].values[0])}", failed(runs["status"][0]))
            continue
        cells = [_last(runs[f"{of}_order"].values) for of in ("attitude", "momentum")]
        for target, reached in times.items():
            coarse = bool(runs["takes_steps"]) and float(runs["attitude_error_max"][0]) <= target
            cell = ("<" if coarse else "") + milliseconds(reached.get(name, np.nan))
            is_fastest = meets_kinks and name in _fastest(reached)
            cells.append(f"[bold green]{cell}*[/]" if is_fastest else f"{cell} ")
        step = steps.get(name, np.nan) if bool(runs["takes_steps"]) else np.nan
        coarse = float(runs["attitude_error_max"][0]) <= min(targets)
        cells.append(NONE if np.isnan(step) else (">" if coarse else "") + f"{step:.2g}")
        table.add_row(str(name), *cells, *(drift_cell(largest(drifts)) for drifts in invariant_drifts(runs)))
    if (comparison["status"] != 0).all():
        table.caption = "\n".join(["", *explained(notes)])
        return table
    legend = (
        "Orders of attitude Λ and material momentum Π as measured. ms: milliseconds to reach an attitude error (rad), "
        f"* within 25 % of the fastest, < at the coarsest step; steps in s. {invariant_legend(comparison)}"
    )
    table.caption = "\n".join(["", *explained(notes), *_verdicts(comparison, times), legend])
    return table


def times_to(comparison: xarray.Dataset, target: float, of: str = "run_time") -> dict[str, float]:
    """Return the time to an attitude error of `target` rad, s, or the step, of each integrator that reaches it."""
    found = {}
    for name in comparison["integrator"].values:
        runs = comparison.sel(integrator=name)
        e, t = runs["attitude_error_max"].values, runs[of].values
        if not (e <= target).any():
            continue
        k, better = int(np.argmax(e <= target)), max if of == "step" else min
        best = float(better(t[e <= target]))
        if k > 0 and e[k - 1] > target and e[k] > 0:
            fraction = np.log(e[k - 1] / target) / np.log(e[k - 1] / e[k])
            best = better(best, float(t[k - 1] * (t[k] / t[k - 1]) ** fraction))
        found[str(name)] = best
    return found


def _fastest(times: dict[str, float]) -> list[str]:
    """Return the integrators within 25 % of the fastest, fastest first: timings vary by as much."""
    return sorted((name for name in times if times[name] <= CLOSE * min(times.values())), key=times.__getitem__)


def _verdicts(comparison: xarray.Dataset, times: dict[float, dict[str, float]]) -> list[str]:
    """Return which integrators are fastest to each error, and which conserve all invariants."""
    lines = []
    if not comparison.attrs.get("meets_kinks", 1):
        times = {}
        lines.append(SPOILT)
    for target, reached in times.items():
        first = f" ({milliseconds(min(reached.values()))} ms)" if reached else ""
        lines.append(f"Fastest to {short(target)} rad: {_listed(comparison, _fastest(reached))}{first}.")
    names = [str(name) for name in comparison["integrator"].values]
    conserving = [
        name for name in names if max(map(largest, invariant_drifts(comparison.sel(integrator=name)))) <= CONSERVED
    ]
    return [*lines, f"Every drift within {short(CONSERVED)}: {_listed(comparison, conserving)}."]


def _listed(comparison: xarray.Dataset, names: list[str]) -> str:
    """Return labels as a list, each family named once: gauss 4, 8; exact."""
    families: dict[str, list[str]] = {}
    for name in names:
        family = str(comparison["family"].sel(integrator=name).values)
        families.setdefault(family, []).append(name.removeprefix(family).strip())
    return "; ".join(f"{family} {', '.join(rest)}".strip() for family, rest in families.items()) or "none"


def _last(orders: Array) -> str:
    measured = orders[~np.isnan(orders)]
    return f"{measured[-1]:.1f}" if measured.size else NONE
