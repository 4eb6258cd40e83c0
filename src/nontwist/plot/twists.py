"""The twist of a motion: how much the body turned about its own axis."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.arrays import Array
from ..recordings.twisting import twist_of_run
from .labels import symbol, variable
from .timelines import over_time

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .labels import Runs

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
    return twist_of_run(run, json.loads(run.attrs["system"])["axis"] or (0, 0, 1))


def _like(angle: Any, values: Array, unit: str) -> Any:
    """Return `angle` with other values; xarray's own arithmetic would import Dask, in a third of a second."""
    import xarray

    variable = xarray.Variable(angle.dims, values, angle.attrs | {"units": unit}, fastpath=True)
    return xarray.DataArray(variable, angle.coords, name=angle.name)


def _broken(angle: Array, turn: float) -> Array:
    """Leave a gap in the curve where a wrapped angle jumps by a turn."""
    jump = np.append(False, abs(np.diff(angle)) > turn / 2)
    return np.where(jump, np.nan, angle)
