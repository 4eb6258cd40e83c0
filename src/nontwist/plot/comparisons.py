"""Work and precision of the integrators that a comparison holds."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from ..analysis.datasets import as_comparison
from ..geometry.arrays import Axes, Dataset
from ..geometry.values import require_among
from ..integrators import INTEGRATORS
from .journals import axes_for, style
from .looks import COLOURS, Look, cycle, given_look, shade

NUMBERS = ("attitude_error_max", "attitude_reference_error", "run_time", "takes_steps", "order", "step")
SIZE = 3.5
MARKERS = {0: "D", 2: "o", 4: "s", 6: "^", 8: "*"}


def work_precision(
    comparison: Dataset,
    ax: Axes | None = None,
    *,
    against: Literal["seconds", "steps"] = "seconds",
    **properties: Any,
) -> Axes:
    """Draw the largest attitude error over the run time, with one line for each integrator; lower left is better.

    Colours and line styles distinguish the kinds of integrators, markers the orders; a diamond is an integrator without
    steps. Errors in the shaded area at the bottom are within the error bar of the reference. Times of short runs, below
    some milliseconds, are mostly overhead: `against` shows the errors over the steps instead, where the slope of a line
    is the order. An integrator without steps has the same error there whatever the step: it is a horizontal line
    without markers, labelled with its name and tolerance.

    Parameters
    ----------
    comparison : Dataset
        A result of `nontwist.compare`.
    ax : Axes, optional
        Axes to draw on; by default those of a new figure, available as ``ax.figure``.
    against : "seconds" or "steps"
        The run time, the shortest of the repeats; or the step.
    **properties
        Properties of the lines, as for `matplotlib.lines.Line2D`: linewidth, markersize, alpha.

    Returns
    -------
    Axes
        One line for each integrator that has a run, with all tolerances of one integrator on the same line. The shaded
        area is a patch.

    Raises
    ------
    ValueError
        `comparison` is not a comparison, `ax` is not a Matplotlib Axes, `against` is unknown, or lines do not have one
        of the properties.

    Examples
    --------
    >>> from nontwist import compare, plot, standard
    >>> how = {"material_angular_velocity": (0.5, 2, 0.1), "steps": [0.1, 0.05], "repeats": 1}
    >>> data = compare(standard([3, 4, 5]), t_end=2, integrators=["gauss", "exact"], **how)
    >>> ax = plot.work_precision(data)
    >>> [line.get_label() for line in ax.lines]
    ['gauss 8', 'exact']
    >>> plot.save(ax, "work.pdf")
    """
    from matplotlib.lines import Line2D
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    require_among(against, "against", ("seconds", "steps"))
    comparison = as_comparison(comparison, NUMBERS, (), ("method", "family", "integrator"))
    if not np.isfinite(comparison["run_time"]).any():
        raise ValueError("no run of the comparison is complete: nothing can be drawn; its message gives the reasons")
    given, bar = given_look(properties, "work_precision"), float(comparison["attitude_reference_error"])
    with style():
        ax = axes_for(ax, 3.2)
        families = dict.fromkeys([*INTEGRATORS, *comparison["family"].values.tolist()])
        looks = {family: _look(k) for k, family in enumerate(families)}
        drawn: dict[tuple[str, int], None] = {}
        for method in dict.fromkeys(comparison["method"].values.tolist()):
            runs = comparison.sel(integrator=comparison["method"].values == method)
            family, order = str(runs["family"].values[0]), int(runs["order"].values[0])
            x, error = _curve(runs, against)
            is_level = against == "steps" and not runs["takes_steps"].all()
            marker = "" if is_level else _marker(order)
            look: Look = {**looks[family], "marker": marker, "markersize": SIZE, "label": method}
            if x.size:
                drawn[family, order] = None
                ax.loglog(x, np.maximum(error, bar / 3), **look | given)
            if is_level:
                _name_levels(ax, runs, bar / 3)
        ax.axhspan(bar / 20, bar, color=shade("0.88"), linewidth=0, zorder=0)
        corner: dict[str, Any] = {"ha": "right", "va": "center", "transform": ax.get_yaxis_transform()}
        ax.text(0.99, bar / 4.5, "error bar of the reference", color=shade("0.3"), **corner)
        ax.set_ylim(bottom=bar / 20)
        shortest, longest = ax.get_xlim()
        ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if longest < 300 * shortest else (1,)))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.set_xlabel("time of a run (ms)" if against == "seconds" else "step (s)")
        ax.set_ylabel("largest attitude error (rad)")
        handles = [Line2D([], [], label=name, **looks[name]) for name in dict.fromkeys(name for name, _ in drawn)]
        grey: dict[str, Any] = {"color": shade("0.3"), "linestyle": "", "markersize": SIZE}
        orders = sorted({order for _, order in drawn} - ({0} if against == "steps" else set()))
        handles += [Line2D([], [], label=f"order {n}" if n else "no steps", marker=_marker(n), **grey) for n in orders]
        ax.legend(
            handles=handles, ncols=3, columnspacing=1, handlelength=2, loc="lower center", bbox_to_anchor=(0.42, 1)
        )
    return ax


def _name_levels(ax: Axes, runs: Dataset, least: float) -> None:
    """Put their names on the horizontal lines of integrators without steps, at the smallest step."""
    look: dict[str, Any] = {"fontsize": "x-small", "color": shade("0.3"), "textcoords": "offset points", "zorder": 1}
    step = float(runs["step"].min())
    for name, error in zip(runs["integrator"].values, runs["attitude_error_max"].max("step").values, strict=True):
        if np.isfinite(error):
            ax.annotate(str(name), (step, max(error, least)), (0, 2), **look)


def _look(k: int) -> Look:
    """Return the look of the integrator number k: grey where the colours repeat."""
    look = cycle()[k % len(cycle())]
    return look if k < COLOURS else {**look, "color": shade("0.5")}


def _marker(order: int) -> str:
    return MARKERS.get(order, f"${order}$")


def _curve(runs: Dataset, against: str) -> tuple[Any, Any]:
    """Return milliseconds or steps, and errors, of the completed runs, by steps or by tolerances.

    Over the steps each tolerance is a horizontal line, which ends in a gap.
    """
    steps = runs["step"].values
    if not runs["takes_steps"].all():
        runs = runs.isel(step=0)
    ms, error = 1e3 * runs["run_time"].values, runs["attitude_error_max"].values
    done = np.isfinite(ms)
    if against == "seconds":
        return ms[done], error[done]
    if ms.ndim == 1:
        return np.tile([steps[0], steps[-1], np.nan], done.sum()), np.repeat(error[done], 3)
    return np.broadcast_to(steps, ms.shape)[done], error[done]
