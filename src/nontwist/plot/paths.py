"""The path of a director on the unit sphere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.arrays import Array
from ..geometry.stacks import arcs
from ..geometry.values import among, as_whole, shown
from .globe import DIM, GUIDE, arrows, bare, curve, ends, legend_of_ends, spaced, view
from .labels import labelled, variable
from .looks import Look, cycle, looks
from .style import ONE_COLUMN, axes_for, style

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from .labels import Runs

MOST_TRIADS = 1000
_DEPARTED = 1e-3  # rad from the start, where the direction is defined


def path(
    runs: Runs,
    ax: Axes | None = None,
    *,
    director: int = 3,
    great_circle: bool = False,
    triads: int = 0,
    elevation: float | None = None,
    azimuth: float | None = None,
) -> list[Artist]:
    """Draw the path of a director on the sphere, its start and its end, with meridians and parallels.

    Parameters
    ----------
    runs : Dataset, or dict of str to Dataset
        A run or a result of `nontwist.twist`, or several to compare with their labels.
    ax : Axes, optional
        Where to draw; a new figure by default, reached as ``artists[0].figure``.
    director : 1, 2 or 3
    great_circle : bool
        Draw the great circle tangent to the path at its start as well: a free non-twisting body stays on it.
    triads : int
        Number of triads to draw along the path, at equal distances: the two other directors, from its tip.
    elevation, azimuth : float, degrees, optional
        Of the viewer, above the xy plane and from the x axis; by default chosen to show the path.

    Returns
    -------
    list of Artist: for each run the path (near side, far side), start, end; then great circles and triads.

    Raises
    ------
    ValueError
        Not a run, axes that are none, a director, triads or angles that are none.

    Examples
    --------
    >>> from nontwist import nontwisting, plot, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=3, material_angular_velocity=(1, 2, 0))
    >>> near_side, far_side, start, end, *circle = plot.path(run, great_circle=True)
    >>> near_side.figure.get_size_inches()  # one column wide
    array([3.5, 3.5])
    >>> plot.save([near_side], "path.pdf")
    """
    if not among(director, (1, 2, 3)):
        raise ValueError(f"director must be 1, 2 or 3, got {shown(director)}")
    triads = as_whole(triads, "triads", 0, MOST_TRIADS)
    table = {label: _directors(run, label) for label, run in labelled(runs).items()}
    main: list[Artist] = []
    guides: list[Artist] = []
    with style():
        ax = axes_for(ax, ONE_COLUMN)
        V = view(elevation, azimuth, np.concatenate([spaced(q[:, director - 1]) for q in table.values()]))
        bare(ax, V)
        _globe(ax, V)
        for (_, label), look in looks(["path"], list(table)).items():
            q = table[label]
            d = q[:, director - 1]
            x = spaced(d) @ V.T
            main += curve(ax, x, x[:, 2], 4, label=label, linewidth=_width(d), **look)
            main += ends(ax, x[[0, -1]], x[[0, -1], 2], look["color"])
            if great_circle:
                guides += _great_circle(ax, d, V)
            if triads:
                guides += _triads(ax, q, director - 1, triads, V)
        others = zip(_others(director - 1), cycle()[1:], strict=False)
        sticks = {f"$d_{j + 1}$": {"color": look["color"]} for j, look in others if triads}
        legend_of_ends(ax, list(table), ({"great circle": GUIDE} if great_circle else {}) | sticks)
    return main + guides


def _directors(run: Any, label: str) -> Array:
    frame = run["frame"] if "frame" in run else variable(run, label, "directors")
    q: Array = frame.transpose("time", "director", "axis").values
    return q


def _width(d: Array) -> float:
    """Return the width of a path: thinner for many turns."""
    turns = float(arcs(d).sum()) / (2 * np.pi)
    return float(np.clip(1.3 * np.sqrt(6 / max(turns, 6)), 0.4, 1.3))


def _great_circle(ax: Axes, d: Array, V: Array) -> list[Artist]:
    away = np.linalg.norm(d - d[0], axis=1) > _DEPARTED
    if not away.any():
        return []
    ahead = d[np.argmax(away)]
    ahead = ahead - d[0] * (ahead @ d[0])
    t = np.linspace(0, 2 * np.pi, 361)[:, None]
    x = (np.cos(t) * d[0] + np.sin(t) * ahead / np.linalg.norm(ahead)) @ V.T
    return curve(ax, x, x[:, 2], 3.5, **GUIDE)


def _triads(ax: Axes, q: Array, k: int, count: int, V: Array) -> list[Artist]:
    """Draw the other two directors at `count` tips along the path: near and far, first one, then the other."""
    length = np.append(0.0, np.cumsum(arcs(q[:, k])))
    chosen = np.searchsorted(length, np.linspace(0, length[-1], count) * (1 - 1e-12))
    tips = q[chosen, k] @ V.T
    artists: list[Artist] = []
    for j, look in zip(_others(k), cycle()[1:], strict=False):
        sticks = np.stack([tips, tips + 0.2 * q[chosen, j] @ V.T, np.full_like(tips, np.nan)], axis=1)
        for side, alpha, zorder in ((tips[:, 2] >= 0, 1.0, 5), (tips[:, 2] < 0, DIM, 2)):
            x = sticks[side].reshape(-1, 3)
            stick: Look = {"color": look["color"], "linestyle": "-", "linewidth": 1.0}
            artists += ax.plot(x[:, 0], x[:, 1], alpha=alpha, zorder=zorder, **stick)
    return artists


def _others(k: int) -> tuple[int, int]:
    return (k + 1) % 3, (k + 2) % 3


def _globe(ax: Axes, V: Array) -> None:
    from matplotlib.patches import Circle

    ax.add_patch(Circle((0, 0), 1, facecolor="#f6f7f8", edgecolor="0.45", linewidth=0.6, zorder=0))
    t = np.linspace(0, 2 * np.pi, 181)
    grid: Look = {"linewidth": 0.4, "color": "0.75"}
    for longitude in np.radians(np.arange(0, 180, 30)):
        m = np.stack([np.cos(t) * np.cos(longitude), np.cos(t) * np.sin(longitude), np.sin(t)], axis=1) @ V.T
        curve(ax, m, m[:, 2], 2.5, **grid)
    for latitude in np.radians([-60, -30, 0, 30, 60]):
        c = np.cos(latitude)
        p = np.stack([c * np.cos(t), c * np.sin(t), np.full_like(t, np.sin(latitude))], axis=1) @ V.T
        curve(ax, p, p[:, 2], 2.5, **grid | ({"color": "0.55"} if latitude == 0 else {}))
    arrows(ax, V, np.ones(3), "xyz")
