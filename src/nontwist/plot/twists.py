"""The twist of a motion: where the axis went, and how much the body turned about it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..geometry.arrays import Array
from .paths import draw_path
from .style import ONE_COLUMN, new_axes, style

if TYPE_CHECKING:
    import xarray
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

MOST = 4000  # points of a curve; more cannot be seen


def twist_path(twist: xarray.Dataset, ax: Axes | None = None) -> list[Artist]:
    """Draw the path of the axis on the sphere, its start and its end.

    Parameters
    ----------
    twist : Dataset
        Of `nontwist.twist`.
    ax : Axes, optional
        Where to draw; a new figure by default, reached as ``artists[0].figure``.

    Returns
    -------
    list of Artist: the path (near side, far side), start, end.
    """
    d3 = twist["frame"].sel(director=3).values
    chosen = np.unique(np.linspace(0, len(d3) - 1, min(len(d3), MOST)).astype(int))
    ax = ax or new_axes(height=ONE_COLUMN)[0]
    towards = np.median(d3[chosen], axis=0)
    if np.linalg.norm(towards) < 0.1:
        towards = np.array([1.0, 0.7, 0.5])
    azimuth = float(np.degrees(np.arctan2(towards[1], towards[0]))) + 20
    elevation = float(np.degrees(np.arctan2(towards[2], np.hypot(towards[0], towards[1])))) - 15
    return draw_path(ax, d3[chosen], max(-75.0, min(75.0, elevation)), azimuth)


def twist_angles(twist: xarray.Dataset, ax: Axes | None = None, *, degrees: bool = False) -> list[Artist]:
    """Draw the twist angle ψ, the swing-twist angle τ and their difference over time.

    Parameters
    ----------
    twist : Dataset
        Of `nontwist.twist`.
    ax : Axes, optional
        Where to draw; a new figure by default, reached as ``artists[0].figure``.
    degrees : bool

    Returns
    -------
    list of Artist: ψ, τ, τ - ψ modulo a turn.
    """
    import matplotlib

    ax = ax or new_axes(columns=2)[0]
    unit, scale = ("°", 180 / np.pi) if degrees else ("rad", 1.0)
    psi, tau = twist["twist_angle"].values, twist["swing_twist_angle"].values
    gap = (tau - psi + np.pi) % (2 * np.pi) - np.pi
    time = twist["time"]
    with style():
        cycle = list(matplotlib.rcParams["axes.prop_cycle"])
        lines: list[Artist] = []
        curves = {r"twist $\psi$": psi, r"swing–twist $\tau$": tau, r"$\tau-\psi$": gap}
        for properties, (label, curve) in zip(cycle, curves.items(), strict=False):
            t, y = _thinned(time.values, _broken(curve) if curve is not psi else psi)
            lines += ax.plot(t, scale * y, label=label, **properties)
        ax.axhline(0, color="0.8", linewidth=0.5, zorder=0)
        ax.set_xlim(time.values[0], time.values[-1])
        ax.set_xlabel("time (s)" if time.attrs.get("units") == "s" else "sample")
        ax.set_ylabel(f"angle ({unit})")
        ax.legend(ncols=3, loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.2)
    return lines


def _broken(angle: Array) -> Array:
    """Leave a gap in the curve where a wrapped angle jumps by a turn."""
    jump = np.append(False, abs(np.diff(angle)) > np.pi)
    return np.where(jump, np.nan, angle)


def _thinned(time: Array, y: Array) -> tuple[Array, Array]:
    """Keep the extremes of each of `MOST` / 2 stretches of a long curve, so that nothing seen is lost."""
    if y.size <= MOST:
        return time, y
    size = y.size // (MOST // 2)
    count = y.size // size
    stretches = y[: count * size].reshape(count, size)
    low = np.where(np.isnan(stretches), np.inf, stretches).argmin(axis=1)
    high = np.where(np.isnan(stretches), -np.inf, stretches).argmax(axis=1)
    first = np.arange(count) * size
    index = np.unique(np.concatenate([first + low, first + high, [y.size - 1]]))
    return time[index], y[index]
