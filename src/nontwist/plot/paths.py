"""The path of a director on the unit sphere, in orthographic projection: the far side is dimmed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..geometry.arrays import Array
from .style import COLOURS, ONE_COLUMN, new_axes, style

if TYPE_CHECKING:
    import xarray
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes


def path(
    run: xarray.Dataset,
    ax: Axes | None = None,
    *,
    director: int = 3,
    elevation: float = 25.0,
    azimuth: float = 35.0,
) -> list[Artist]:
    """Draw the path of a director on the sphere, its start and its end, with meridians and parallels.

    Parameters
    ----------
    run : Dataset
    ax : Axes, optional
        Where to draw; a new figure by default, reached as ``artists[0].figure``.
    director : 1, 2 or 3
    elevation, azimuth : float, degrees
        Of the viewer, above the xy plane and from the x axis.

    Returns
    -------
    list of Artist: the path (near side, far side), start, end.
    """
    d = run["directors"].sel(director=director).transpose("time", "axis").values
    return draw_path(ax or new_axes(height=ONE_COLUMN)[0], d, elevation, azimuth)


def draw_path(ax: Axes, d: Array, elevation: float, azimuth: float) -> list[Artist]:
    """Draw the unit vectors `d` (n, 3) as a path on the globe; the artists of `path`."""
    view = _view(elevation, azimuth)
    with style():
        _globe(ax, view)
        lines = [*_curve(ax, _refined(d) @ view.T, COLOURS[0], 1.3, 4)]
        x0, x1 = d[0] @ view.T, d[-1] @ view.T
        start = ax.plot(*x0[:2], "o", ms=5, mfc="white", mec=COLOURS[2], zorder=6, label="start")
        end = ax.plot(*x1[:2], "s", ms=4.5, color=COLOURS[1], zorder=6, label="end")
        ax.legend(loc="lower right", handlelength=1.0, borderaxespad=0.0)
        ax.set_aspect("equal")
        ax.set_xlim(-1.3, 1.3)
        ax.set_ylim(-1.3, 1.3)
        ax.set_axis_off()
    return [*lines, *start, *end]


def _view(elevation: float, azimuth: float) -> Array:
    """Rows: screen right, screen up, towards the viewer."""
    e, a = np.radians([elevation, azimuth])
    right = np.array([-np.sin(a), np.cos(a), 0])
    towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    return np.stack([right, np.cross(towards, right), towards])


def _refined(d: Array) -> Array:
    """Fill segments longer than 2° so that they bend with the sphere."""
    angle = np.arccos(np.clip(np.sum(d[1:] * d[:-1], axis=1), -1, 1))
    pieces = np.maximum(1, np.ceil(angle / np.radians(2)).astype(int))
    k = np.repeat(np.arange(len(pieces)), pieces)
    s = (np.arange(len(k)) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / pieces[k]
    x = np.append((1 - s)[:, None] * d[k] + s[:, None] * d[k + 1], d[-1:], axis=0)
    unit: Array = x / np.linalg.norm(x, axis=1, keepdims=True)
    return unit


def _curve(ax: Axes, x: Array, colour: str, width: float, zorder: float) -> list[Artist]:
    """Draw a curve in screen coordinates; the part behind the sphere is dimmed."""
    near = (x[1:, 2] + x[:-1, 2]) >= 0
    artists: list[Artist] = []
    for side, alpha, order in ((near, 1.0, zorder), (~near, 0.3, zorder - 2)):
        xy = np.where((np.append(side, False) | np.append(False, side))[:, None], x[:, :2], np.nan)
        artists += ax.plot(xy[:, 0], xy[:, 1], "-", color=colour, linewidth=width, alpha=alpha, zorder=order)
    return artists


def _globe(ax: Axes, view: Array) -> None:
    from matplotlib.patches import Circle

    ax.add_patch(Circle((0, 0), 1, facecolor="#f4f6f8", edgecolor="0.45", linewidth=0.6, zorder=0))
    t = np.linspace(0, 2 * np.pi, 181)
    for longitude in np.radians(np.arange(0, 180, 30)):
        m = np.stack([np.cos(t) * np.cos(longitude), np.cos(t) * np.sin(longitude), np.sin(t)], axis=1)
        _curve(ax, m @ view.T, "0.75", 0.4, 2.5)
    for latitude in np.radians([-60, -30, 0, 30, 60]):
        c = np.cos(latitude)
        p = np.stack([c * np.cos(t), c * np.sin(t), np.full_like(t, np.sin(latitude))], axis=1)
        _curve(ax, p @ view.T, "0.55" if latitude == 0 else "0.75", 0.4, 2.5)
    for label, e in zip("xyz", np.eye(3), strict=True):
        x = view @ e
        tip, foot, name = ((s * x[0], s * x[1]) for s in (1.22, 1.0, 1.28))
        ax.annotate("", tip, foot, arrowprops={"arrowstyle": "-|>", "lw": 0.7, "color": "0.3", "shrinkA": 0})
        ax.text(*name, f"${label}$", ha="center", va="center", color="0.3")
