"""The path of a director on the unit sphere.

A free non-twisting body keeps Π1 and Π2 (eq-material_perpendicular_momenta_preservation), so its angular velocity is
constant in the body and d3 runs along a great circle. Under a load that ends it does so from its end on: the great
circle is drawn through the path there.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.arrays import Array
from ..geometry.stacks import arcs
from ..geometry.values import among, as_whole, shown
from ..loads.kinds import load_of
from .globe import arrows, bare, curve, ends, extent, far, legend_of_ends, spaced, view
from .journals import axes_for, style
from .looks import Look, cycle, given_look, labelled, looks, variable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .looks import Runs

MOST_TRIADS = 1000
_MARGIN, _BELOW = 1.32, 1.08  # of the axes, in radii of the sphere
_CIRCLE: Look = {"color": "0.56", "linewidth": 2.8}  # wider than the path that lies on it
_DEPARTED = 1e-3  # rad from where the body is free, where the direction is defined


def path(
    runs: Runs,
    ax: Axes | None = None,
    *,
    director: int = 3,
    great_circle: bool = False,
    triads: int = 0,
    elevation: float | None = None,
    azimuth: float | None = None,
    **properties: Any,
) -> Axes:
    """Draw the path of a director on the sphere with its start and end, and meridians and parallels.

    Parameters
    ----------
    runs : Dataset, or dict of str to Dataset
        A run or a result of `nontwist.twist`, or several to compare with their labels.
    ax : Axes, optional
        Axes to draw on; by default those of a new figure, available as ``ax.figure``.
    director : 1, 2 or 3
    great_circle : bool
        Also draw the great circle that is tangent to the path at the end of the load, or at the start if there is no
        load that ends. A free non-twisting body moves along it.
    triads : int
        Number of triads to draw along the path at equal distances: the other two directors, from the tip of the first.
    elevation, azimuth : float, degrees, optional
        View direction: angles above the xy plane and from the x axis; by default chosen to show the path.
    **properties
        Properties of the paths, as for `matplotlib.lines.Line2D`: linewidth, color, alpha.

    Returns
    -------
    Axes
        Lines on the near side and on the far side. ``ax.get_legend_handles_labels()`` returns those on the near side
        with their labels: "path" or the label of the run, "great circle", ``"$d_1$"``.

    Raises
    ------
    ValueError
        An argument is not a run, `ax` is not a Matplotlib Axes, `director`, `triads` or an angle is invalid, or lines
        do not have one of the properties.

    Examples
    --------
    >>> from nontwist import nontwisting, plot, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=3, material_angular_velocity=(1, 2, 0))
    >>> ax = plot.path(run, great_circle=True)
    >>> ax.get_legend_handles_labels()[1]
    ['path', 'great circle']
    >>> ax.figure.get_size_inches()  # one column wide
    array([3.5, 3.5])
    >>> plot.save(ax, "path.pdf")
    """
    if not among(director, (1, 2, 3)):
        raise ValueError(f"director must be 1, 2 or 3, got {shown(director)}")
    triads = as_whole(triads, "triads", 0, MOST_TRIADS)
    given, runs = given_look(properties, "path"), labelled(runs)
    table = {label: _directors(run, label) for label, run in runs.items()}
    with style():
        ax = axes_for(ax, None)
        points = np.concatenate([spaced(q[:, director - 1]) for q in table.values()])
        V = view(elevation, azimuth, points)
        _globe(ax, V, points @ V.T)
        own = looks(["path"], list(table), given, (f"d{director}",))
        for (_, label), look in own.items():
            q = table[label]
            d = q[:, director - 1]
            x = spaced(d) @ V.T
            curve(ax, x, x[:, 2], 4, label or "path", **{"linewidth": _width(d)} | look)
            ends(ax, x[[0, -1]], x[[0, -1], 2], look["color"], label or "path")
            if great_circle:
                _great_circle(ax, d[_free_from(runs[label]) :], V)
            if triads:
                _triads(ax, q, director - 1, triads, V)
        sticks = {f"$d_{j + 1}$": {"color": cycle()[j]["color"]} for j in _others(director - 1) if triads}
        legend_of_ends(ax, list(table), ({"great circle": _CIRCLE} if great_circle else {}) | sticks, own)
    return ax


def _directors(run: Any, label: str) -> Array:
    frame = run["frame"] if "frame" in run else variable(run, label, "directors")
    q: Array = frame.transpose("time", "director", "axis").values
    return q


def _width(d: Array) -> float:
    """Return the width of a path: thinner for many turns."""
    turns = float(arcs(d).sum()) / (2 * np.pi)
    return float(np.clip(1.3 * np.sqrt(6 / max(turns, 6)), 0.4, 1.3))


def _free_from(run: Any) -> int:
    """Return the number of the first state after the load; 0 where there is none, or none that is known to end."""
    try:
        end = load_of(json.loads(run.attrs.get("load", "[]"))).end
    except ValueError:
        return 0
    k = int(np.searchsorted(run["time"].values, end))
    return k if k + 1 < run.sizes["time"] else 0


def _great_circle(ax: Axes, d: Array, V: Array) -> None:
    away = np.linalg.norm(d - d[0], axis=1) > _DEPARTED
    if not away.any():
        return
    ahead = d[np.argmax(away)]
    ahead = ahead - d[0] * (ahead @ d[0])
    t = np.linspace(0, 2 * np.pi, 361)[:, None]
    x = (np.cos(t) * d[0] + np.sin(t) * ahead / np.linalg.norm(ahead)) @ V.T
    curve(ax, x, x[:, 2], 3.5, "great circle", **_CIRCLE)


def _triads(ax: Axes, q: Array, k: int, count: int, V: Array) -> None:
    """Draw the other two directors at `count` tips along the path: near and far, first one, then the other."""
    length = np.append(0.0, np.cumsum(arcs(q[:, k])))
    chosen = np.searchsorted(length, np.linspace(0, length[-1], count) * (1 - 1e-12))
    tips = q[chosen, k] @ V.T
    for j in _others(k):
        sticks = np.stack([tips, tips + 0.2 * q[chosen, j] @ V.T, np.full_like(tips, np.nan)], axis=1)
        stick: Look = {"color": cycle()[j]["color"], "linestyle": "-", "linewidth": 1.0}
        for near in (True, False):
            x = sticks[(tips[:, 2] >= 0) == near].reshape(-1, 3)
            name = f"$d_{j + 1}$" if near else f"_$d_{j + 1}$, far side"
            ax.plot(x[:, 0], x[:, 1], zorder=5 if near else 2, label=name, **stick if near else far(stick))


def _others(k: int) -> tuple[int, int]:
    return (k + 1) % 3, (k + 2) % 3


def _globe(ax: Axes, V: Array, paths: Array) -> None:
    from matplotlib.patches import Circle

    below = extent(V, np.ones(3), np.zeros((1, 2)))[2]
    bare(ax, np.array([-_MARGIN, _MARGIN, min(below, -_BELOW), _MARGIN]))
    ax.add_patch(Circle((0, 0), 1, facecolor="#f6f7f8", edgecolor="0.45", linewidth=0.6, zorder=0))
    t = np.linspace(0, 2 * np.pi, 181)
    grid: Look = {"linewidth": 0.4, "color": "0.75"}
    for longitude in np.radians(np.arange(0, 180, 30)):
        m = np.stack([np.cos(t) * np.cos(longitude), np.cos(t) * np.sin(longitude), np.sin(t)], axis=1) @ V.T
        curve(ax, m, m[:, 2], 2.5, "_meridian", **grid)
    for latitude in np.radians([-60, -30, 0, 30, 60]):
        c = np.cos(latitude)
        p = np.stack([c * np.cos(t), c * np.sin(t), np.full_like(t, np.sin(latitude))], axis=1) @ V.T
        curve(ax, p, p[:, 2], 2.5, "_parallel", **grid | ({"color": "0.55"} if latitude == 0 else {}))
    arrows(ax, V, np.ones(3), "xyz", paths)
