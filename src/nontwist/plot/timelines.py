"""Curves over time, of one run or of several: the base of all histories."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..analysis.datasets import body_of
from ..errors import warn
from ..geometry.arrays import Array, Axes
from ..geometry.attitudes import turns
from ..recordings.twisting import twist
from ..viewer.content import FAR, extremes
from .journals import axes_for, style
from .looks import Look, Runs, axis_label, explain, given_look, labelled, looks, pale, symbol, unit, variable

Curves = Callable[[Any, str], dict[str, Any]]
MOST = 4000  # points of a curve; more cannot be seen
_FEW = 100  # points of a curve whose corners can be seen
_SPAN = 0.02
_OFTEN = 20  # swings from which on dashes of a curve are too short to be seen
_THIN, _WIDER, _THINNEST = 0.6, 1.3, 0.4  # widths of curves that lie on each other, points


def over_time(
    runs: Any,
    ax: Axes | None,
    curves: Curves,
    function: str,
    properties: Look,
    first: tuple[str, ...] = (),
    *,
    logarithmic: bool = False,
    alike: bool = False,
) -> tuple[Axes, list[Any]]:
    """Draw ``curves(run, label)``, DataArrays over time by their names in the legend, for every run.

    `first` are the first colours; a single curve without is neutral, as on the page of the viewer. Curves that are
    `alike` and swing often are laid on each other. A warning names the run whose states are so far apart that its
    curves are polygons; those of errors, which are logarithmic, have no other shape.
    """
    runs = labelled(runs)
    table = {label: curves(run, label) for label, run in runs.items()}
    components = list(dict.fromkeys(name for own in table.values() for name in own))
    given = given_look(properties, function)
    lines: list[Any] = []
    first = first or (("frame",) if len(components) == len(table) == 1 else ())
    with style():
        look = looks(components, list(table), given, first)
        if alike and 1 in (len(components), len(table)):
            look = {key: one | given for key, one in _layered(table, look).items()}
        ax = axes_for(ax)
        if logarithmic:
            ax.set_yscale("log")
        for label, own in table.items():
            for name, curve in own.items():
                t, y = curve[curve.dims[0]].values, curve.values
                kept = extremes(y, MOST)  # of a long curve, which looks the same
                line: Look = {"label": ", ".join(filter(None, (name, label)))} | look[name, label]
                lines += ax.plot(t[kept], y[kept], **line)
        _time_axis(ax, [run["time"] for run in runs.values()])
        _at_least(ax, _SPAN)
        ax.set_ylabel(axis_label(next(iter(table.values()))[components[0]]))
        explain(ax, look, given)
    if not logarithmic:
        _warn_of_polygons(runs)
    return ax, lines


def _warn_of_polygons(runs: dict[str, Any]) -> None:
    """Warn of runs of few states that are far apart, as those of a run to a tolerance."""
    for label, run in runs.items():
        if "system" not in run.attrs or "quaternion" not in run or not 1 < run.sizes["time"] < _FEW:
            continue
        p = variable(run, label, "quaternion").values
        turn = float(turns(p[:-1], p[1:]).max())
        if turn > FAR:
            warn(
                f"the run {label + ' ' if label else ''}has {len(p)} states, between which the body turns by up to "
                f"{turn:.2g} rad: its curves are drawn as polygons; draw resample(run, times), or run it with times="
            )


def _time_axis(ax: Axes, times: list[Any]) -> None:
    first, last = (float(pick(t.values[k] for t in times)) for pick, k in ((min, 0), (max, -1)))
    if first < last:
        ax.set_xlim(0 if 0 <= first < 0.05 * last else first, last)
    ax.set_xlabel(f"time $t${unit(times[0])}" if unit(times[0]) else "sample")


def _layered(table: dict[str, dict[str, Any]], look: dict[tuple[str, str], Look]) -> dict[tuple[str, str], Look]:
    """Return looks in which the curves that swing often are solid: the first is thin and on top, the next wider.

    Dashes of curves that nearly coincide would run together to a hatch. Components are paler below; runs keep colours.
    """
    swings = {key: _swings(table[key[1]][key[0]].values) for key in look}
    often = [key for key in look if swings[key] > _OFTEN]
    layers: dict[tuple[str, str], Look] = {}
    for k, key in enumerate(often):
        width = max(_THINNEST, (_THIN + k * _WIDER) * min(1.0, 4 * _OFTEN / swings[key]))
        layers[key] = {"linestyle": "-", "linewidth": width, "zorder": 2 - 0.1 * k}
        if k > 0 and len(table) == 1:
            layers[key]["color"] = pale(look[key]["color"])
    return {key: one | layers.get(key, {}) for key, one in look.items()}


def _swings(y: Array) -> int:
    """Return how often a curve turns back by more than a quarter of its range."""
    y = y[np.isfinite(y)]
    if y.size == 0:
        return 0
    gap, count, sign, furthest = 0.25 * float(np.ptp(y)), 0, 1.0, float(y[0])
    for value in map(float, y[extremes(y, MOST)]):
        if sign * (value - furthest) >= 0:
            furthest = value
        elif sign * (furthest - value) > gap:
            count, sign, furthest = count + 1, -sign, value
    return count


def _at_least(ax: Axes, span: float) -> None:
    """Widen the vertical axis to `span` times its largest value, so that a constant does not show its round-off."""
    low, high = ax.get_ylim()
    short = span * max(abs(low), abs(high)) - (high - low)
    if short > 0:
        ax.set_ylim(low - short / 2, high + short / 2)


# The twist of a motion: how much the body turned about its own axis.


_LEAST = 0.01  # rad, smallest range of the axis up and down, so that round-off does not fill it


def twist_angle(
    runs: Runs, ax: Axes | None = None, *, swing: bool = False, degrees: bool = False, **properties: Any
) -> Axes:
    """Draw the twist angle ψ over time: the rotation of the body about its axis relative to a non-twisting frame.

    Curves that swing more than ten times to and fro are solid: the first one thin, the next ones wider, below it.

    Parameters
    ----------
    runs : Dataset, or dict of str to Dataset
        A run or a result of `nontwist.twist`, or several to compare with their labels. The twist of a run is about its
        constrained axis, or else about its third director.
    ax : Axes, optional
        Axes to draw on; by default those of a new figure, one column wide, available as ``ax.figure``.
    swing : bool
        Also draw the swing-twist angle τ and the difference τ - ψ modulo one turn.
    degrees : bool
    **properties
        Properties of the curves, as for `matplotlib.lines.Line2D`: linewidth, color, alpha.

    Returns
    -------
    Axes
        The lines are in the order of the runs: ψ, and with `swing` τ and τ - ψ.

    Raises
    ------
    ValueError
        An argument is not a run, `ax` is not a Matplotlib Axes, or lines do not have one of the properties; or as
        `nontwist.twist`.

    Warns
    -----
    UserWarning
        A run has so few states, and so far apart, that its curves are polygons; `resample` gives more.

    Examples
    --------
    >>> from nontwist import plot, simulate, standard
    >>> run = simulate(standard([3, 4, 5]), t_end=5, material_angular_velocity=(0, 0, 1))
    >>> ax = plot.twist_angle(run)
    >>> round(float(ax.lines[0].get_ydata()[-1]), 6)  # rad
    5.0
    """
    scale, unit = (180 / np.pi, "°") if degrees else (1.0, "rad")

    def curves(run: Any, label: str) -> dict[str, Any]:
        result = run if "twist_angle" in run else _twist(run, label)
        of_psi, of_tau = result["twist_angle"], result["swing_twist_angle"]
        psi, tau = scale * of_psi.values, scale * of_tau.values
        if not swing:
            return {symbol(of_psi): _like(of_psi, psi, unit)}
        turn = 2 * np.pi * scale
        gap = (tau - psi + turn / 2) % turn - turn / 2
        return {
            f"twist {symbol(of_psi)}": _like(of_psi, psi, unit),
            f"swing–twist {symbol(of_tau)}": _like(of_tau, _broken(tau, turn), unit),
            r"$τ-ψ$": _like(of_tau, _broken(gap, turn), unit),
        }

    ax, _ = over_time(runs, ax, curves, "twist_angle", properties, ("twist", "d1", "d3"), alike=True)
    low, high = ax.get_ylim()
    ax.set_ylim(min(low, -_LEAST * scale), max(high, _LEAST * scale))
    ax.axhline(0, color="0.8", linewidth=0.5, zorder=0)
    if swing:
        ax.set_ylabel(f"angle ({unit})")
    return ax


def _twist(run: Any, label: str) -> Any:
    """Return the twist of a run about the axis of its constraint, or about its third director."""
    variable(run, label, "directors")
    axis = body_of(run).axis
    return twist(run, axis=(0, 0, 1) if axis is None else axis)


def _like(angle: Any, values: Array, unit: str) -> Any:
    """Return `angle` with other values; xarray's own arithmetic would import Dask, in a third of a second."""
    import xarray

    variable = xarray.Variable(angle.dims, values, angle.attrs | {"units": unit}, fastpath=True)
    return xarray.DataArray(variable, angle.coords, name=angle.name)


def _broken(angle: Array, turn: float) -> Array:
    """Leave a gap in the curve where a wrapped angle jumps by a turn."""
    jump = np.append(False, abs(np.diff(angle)) > turn / 2)
    return np.where(jump, np.nan, angle)
