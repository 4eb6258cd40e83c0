"""All runs of a comparison, grouped by integrator: `table`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..analysis.datasets import as_comparison
from ..analysis.invariants import in_words
from ..geometry.arrays import Array, Dataset, as_positive
from .comparing import MEASURES, short

if TYPE_CHECKING:
    from rich.table import Table

# Cells, headings, legends and notes of the tables of a comparison.

CONSERVED, NONE = 1e-13, "–"


TEXTS = ("integrator", "message", "invariant", "invariant_symbol", "family")
NUMBERS = ("step", "takes_steps", *(name for name in MEASURES if name not in ("message", "twist_defect")))


def checked(data: Any) -> Any:
    """Return a comparison with all that tables show."""
    return as_comparison(data, NUMBERS, ("title", "shared_times", "reference"), TEXTS)


def empty_table(title: str, first: str, headings: Sequence[str], comparison: Dataset) -> Table:
    """Return a table without rows, its last columns those of invariants; many have no padding between them."""
    from rich import box
    from rich.table import Table

    kept = invariant_headings(comparison)
    left: Any = {"title_justify": "left", "caption_justify": "left", "caption_style": ""}
    table = Table(title=title, **left, box=box.SIMPLE_HEAD, show_edge=False, padding=(0, int(len(kept) < 4), 0, 0))
    table.add_column(first, no_wrap=True)
    for heading in (*headings, *kept):
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def invariant_headings(comparison: Dataset) -> list[str]:
    """Return the headings of the columns of `invariant_drifts`."""
    headings = [f"drift\n{symbol}" for symbol in comparison["invariant_symbol"].values]
    return [*headings, "twist\nrad/s"] if "twist_defect" in comparison else headings


def invariant_legend(comparison: Dataset) -> str:
    """Return the legend of `invariant_headings`."""
    symbols, names = comparison["invariant_symbol"].values, comparison["invariant"].values
    drifts = ", ".join(f"{symbol} {in_words(name)}" for symbol, name in zip(symbols, names, strict=True))
    twist = "; twist: largest error of the rate about the constrained axis" if "twist_defect" in comparison else ""
    return f"Largest relative drifts: {drifts}{twist}."


def invariant_drifts(runs: Dataset) -> list[Array]:
    """Return the drift of each invariant, and the twist defect where there is one, over the steps of `runs`."""
    drifts = list(runs["drift"].transpose("invariant", ...).values)
    return [*drifts, runs["twist_defect"].values] if "twist_defect" in runs else drifts


def largest(drifts: Array) -> float:
    """Return the largest drift of the completed runs; inf where there is none."""
    done = drifts[~np.isnan(drifts)]
    return float(done.max()) if done.size else np.inf


def numbered(notes: list[str], message: object) -> str:
    """Return the number of a message, added to `notes` if it is new; "" for "done"."""
    text = str(message).removeprefix("done").removeprefix("; ")
    if not text:
        return ""
    if text not in notes:
        notes.append(text)
    return f" \\[{notes.index(text) + 1}]"


def explained(notes: list[str]) -> list[str]:
    """Return the notes with their numbers, as rich markup."""
    from rich.markup import escape

    return [f"\\[{k + 1}] {escape(note)}" for k, note in enumerate(notes)]


def failed(status: ArrayLike) -> str:
    """Return the cell of a run without numbers."""
    return "[red]refused[/]" if np.asarray(status) < 0 else "[red]failed[/]"


def drift_cell(drift: float) -> str:
    """Return a drift, green where it is round-off."""
    text = short(drift, 0) if drift else "0"
    return f"[green]{text}[/]" if drift <= CONSERVED else text


def milliseconds(seconds: float) -> str:
    """Return seconds as milliseconds in three digits."""
    ms = 1e3 * seconds
    return NONE if np.isnan(ms) else f"{ms:.2f}" if ms < 10 else f"{ms:.1f}" if ms < 100 else f"{ms:.0f}"


# The choice of integrator, a line for each: `summary`.


CLOSE = 1.25
SPOILT = (
    "The steps miss breakpoints of the load, so orders are spoilt and none is the fastest: leave the steps out, and "
    "breakpoints are nodes."
)


def summary(comparison: Dataset, targets: Sequence[float] = (1e-3, 1e-6, 1e-9)) -> Table:
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
    comparison = checked(comparison)
    targets = as_positive(targets, "targets", (None,), "rad").tolist()
    if not targets:
        raise ValueError("targets is empty; leave it out for 1e-3, 1e-6 and 1e-9")
    to = [*(f"ms to\n{short(target)}" for target in targets), f"step\nfor\n{short(min(targets))}"]
    title = f"{comparison.attrs['title']}: integrators compared"
    table = empty_table(title, "integrator", ["order\nΛ", "order\nΠ", *to], comparison)
    times = {target: times_to(comparison, target) for target in targets}
    steps = times_to(comparison, min(targets), "step")
    notes: list[str] = []
    meets_kinks = bool(comparison.attrs.get("meets_kinks", True))
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
    table.caption = "\n".join(["", *explained(notes), *_verdicts(comparison, times if meets_kinks else {}), legend])
    return table


def times_to(comparison: Dataset, target: float, of: str = "run_time") -> dict[str, float]:
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


def _verdicts(comparison: Dataset, times: dict[float, dict[str, float]]) -> list[str]:
    """Return which integrators are fastest to each error, if times are given, and which conserve all invariants."""
    lines = [] if times else [SPOILT]
    for target, reached in times.items():
        first = f" ({milliseconds(min(reached.values()))} ms)" if reached else ""
        lines.append(f"Fastest to {short(target)} rad: {_listed(comparison, _fastest(reached))}{first}.")
    names = [str(name) for name in comparison["integrator"].values]
    conserving = [
        name for name in names if max(map(largest, invariant_drifts(comparison.sel(integrator=name)))) <= CONSERVED
    ]
    return [*lines, f"Every drift within {short(CONSERVED)}: {_listed(comparison, conserving)}."]


def _listed(comparison: Dataset, names: list[str]) -> str:
    """Return labels as a list, each family named once: gauss 4, 8; exact."""
    families: dict[str, list[str]] = {}
    for name in names:
        family = str(comparison["family"].sel(integrator=name).values)
        families.setdefault(family, []).append(name.removeprefix(family).strip())
    return "; ".join(f"{family} {', '.join(rest)}".strip() for family, rest in families.items()) or "none"


def _last(orders: Array, none: str = NONE) -> str:
    measured = orders[~np.isnan(orders)]
    return f"{measured[-1]:.1f}" if measured.size else none


def table(comparison: Dataset) -> Table:
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
    comparison = checked(comparison)
    headings = ["error Λ\nrad", "n", "error Π\nkg m² s⁻¹", "n"]
    table = empty_table(comparison.attrs["title"], "integrator,\nstep (s)", headings, comparison)
    table.add_column("ms", justify="right", no_wrap=True)
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
            cells = list[str]()
            for of in ("attitude", "momentum"):
                below = "<" * bool(run[f"{of}_below_bar"])
                error = short(float(run[f"{of}_{'reference_error' if below else 'error_max'}"]))
                cells += f"{below}{error}", _last(run[f"{of}_order"].values[None], "")
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
