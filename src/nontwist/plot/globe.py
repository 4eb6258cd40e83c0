"""Curves on a sphere or an ellipsoid in orthographic projection: what lies on the far side is dimmed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.arrays import Array, as_number
from ..geometry.stacks import arcs
from ..viewer.drawing import Camera
from .looks import LEAST, Look, contrast, handle, legend, pale

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ELEVATION, AZIMUTH = 25.0, 35.0  # degrees
DIM, THIN = 0.3, 0.6  # what is on the far side: lines that only guide, the others
_CONCENTRATED, _WELL_SEEN, _ENOUGH = 0.8, 0.7, 2000
_AZIMUTH_CHANGES = (0, 15, -15, 30, -30, 45, -45, 60, -60, 75, -75, 90)  # degrees
_PIXELS = 20000
ARROW = 0.22  # of the coordinate axes
_LABEL, _CLEAR, _TURNS = 0.08, 0.12, (0, 40, -40, 80, -80, 120, -120)  # of their names: from the tip, from paths; °
GUIDE: Look = {"color": "0.35", "linewidth": 0.7, "linestyle": (0, (4, 2))}
_START: Look = {"marker": "o", "markersize": 6, "markerfacecolor": "white", "linestyle": ""}
_END: Look = {"marker": "s", "markersize": 3.5, "linestyle": ""}


def view(elevation: float | None, azimuth: float | None, points: Array) -> Array:
    """Return the rows screen right, screen up, towards the viewer.

    Angles in degrees, above the xy plane and from the x axis. Where they are None, the view is from the side of
    `points` that are close together; else at 25° of elevation and the azimuth nearest to 35° that shows a path well.
    """
    mean = points.mean(axis=0)
    if np.linalg.norm(mean) > _CONCENTRATED * np.linalg.norm(points, axis=1).mean():
        e = float(np.degrees(np.arctan2(mean[2], np.hypot(mean[0], mean[1]))))
        e, a = e + np.clip(ELEVATION - e, -20, 20), float(np.degrees(np.arctan2(mean[1], mean[0]))) + 20
    else:
        few = points[:: 1 + len(points) // _ENOUGH]
        seen = {turn: _width_seen(few @ _axes(ELEVATION, AZIMUTH + turn).T) for turn in _AZIMUTH_CHANGES}
        e, a = ELEVATION, AZIMUTH + next(t for t in _AZIMUTH_CHANGES if seen[t] >= _WELL_SEEN * max(seen.values()))
    if elevation is not None:
        e = as_number(elevation, "elevation")
    return _axes(e, a if azimuth is None else as_number(azimuth, "azimuth"))


def _width_seen(x: Array) -> float:
    """Return how wide points spread on the screen across their longest direction, counting the near ones most."""
    weights = np.maximum(x[:, 2], 0) / len(x)
    away = x[:, :2] - weights @ x[:, :2] / max(weights.sum(), 1e-9)
    return float(np.linalg.eigvalsh((away.T * weights) @ away)[0])


def _axes(elevation: float, azimuth: float) -> Array:
    return Camera(*np.radians([azimuth, elevation])).view()


def spaced(d: Array) -> Array:
    """Return points of a path of unit vectors 0.5° to 2° apart: fewer than dense samples, more than sparse ones."""
    length = np.append(0.0, np.cumsum(arcs(d)))
    kept = np.append(True, np.diff(np.floor(length / np.radians(0.5))) > 0)
    kept[-1] = True
    d = d[kept]
    pieces = np.maximum(1, np.ceil(arcs(d) / np.radians(2)).astype(int))
    k = np.repeat(np.arange(len(pieces)), pieces)
    s = (np.arange(len(k)) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / pieces[k]
    x = np.append((1 - s)[:, None] * d[k] + s[:, None] * d[k + 1], d[-1:], axis=0)
    unit: Array = x / np.linalg.norm(x, axis=1, keepdims=True)
    return unit


def curve(ax: Axes, x: Array, depth: Array, zorder: float, name: str, **look: Any) -> None:
    """Draw a curve in screen coordinates (n, 2 or 3), far where `depth` is negative; `name` is of its near side."""
    near = (depth[1:] + depth[:-1]) >= 0
    for side, label, order in ((near, name, zorder), (~near, f"_{name.removeprefix('_')}, far side", zorder - 2)):
        xy = np.where((np.append(side, False) | np.append(False, side))[:, None], x[:, :2], np.nan)
        whole: Look = {"label": label, "zorder": order, "linestyle": "-", "rasterized": len(x) > _PIXELS} | look
        ax.plot(xy[:, 0], xy[:, 1], **whole if side is near else far(whole))


def far(look: Look) -> Look:
    """Return the look of a line on the far side: thinner, and as pale as it may be."""
    if contrast(look["color"]) < LEAST:
        return {"alpha": DIM} | look
    return look | {"color": pale(look["color"]), "linewidth": THIN * look["linewidth"]}


def ends(ax: Axes, x: Array, depth: Array, colour: str, name: str) -> None:
    """Mark start and end of a path, x (2, 2 or 3) on the screen, paler where `depth` is negative."""
    for k, (end, look) in enumerate((("start", _START), ("end", _END))):
        own, order = (colour, 6.0) if depth[k] >= 0 else (pale(colour), 2.4)
        marked: Look = {"color": own, "markeredgecolor": own, "zorder": order, "label": f"_{end} of {name}"}
        ax.plot(x[k, 0], x[k, 1], **marked | look)


def legend_of_ends(ax: Axes, runs: list[str], others: dict[str, Look], look: dict[tuple[str, str], Look]) -> None:
    """Put a legend below the globe: runs where there are several, start and end, and `others`."""
    own = [handle(run, one) for run, one in zip(runs, look.values(), strict=True)]
    marks = [handle("start", _START | {"color": "0.2"}), handle("end", _END | {"color": "0.2"})]
    marks += [handle(label, look) for label, look in others.items()]
    legend(ax, [own, marks] if len(own) > 1 else [marks], below=True)


def arrows(ax: Axes, V: Array, feet: Array, names: str, paths: Array) -> None:
    """Draw arrows outwards along the coordinate axes from `feet` (3,), with `names` beside `paths` (n, 3 on screen)."""
    from matplotlib.patheffects import withStroke

    for k, name in enumerate(names):
        x = V[:, k]
        near = x[2] >= -1e-9
        tip, foot = ((s * x[0], s * x[1]) for s in (feet[k] + ARROW, feet[k]))
        colour = "0.3" if near else "0.42"
        head = "-|>,head_width=0.13,head_length=0.3"
        style: Look = {"arrowstyle": head, "lw": 0.7, "color": colour, "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", tip, foot, arrowprops=style, zorder=5 if near else 1)
        place: Look = {"textcoords": "offset points", "ha": "center", "va": "center", "zorder": 7 if near else 1}
        text = ax.annotate(f"${name}$", tip, _beside(np.array(tip), x[:2], paths[:, :2]), color=colour, **place)
        text.set_path_effects([withStroke(linewidth=1.5, foreground="white")])


def _beside(tip: Array, direction: Array, paths: Array) -> tuple[float, float]:
    """Return 6 points along the arrow on the screen, or in the first direction about it that is clear of the paths."""
    angles = np.arctan2(direction[1], direction[0]) + np.radians(_TURNS)
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    gaps = np.hypot(*(tip + _LABEL * around[:, None] - paths[:, None].swapaxes(0, 1)).T).min(axis=0)
    x, y = 6 * around[int(np.argmax(np.minimum(gaps, _CLEAR)))]
    return float(x), float(y)


def extent(V: Array, feet: Array, outline: Array) -> Array:
    """Return left, right, below and above of an outline (n, 2) on the screen and of the arrows with their labels."""
    ends = V[:2] * (feet + ARROW)
    points = np.concatenate([ends - 2 * _LABEL, ends + 2 * _LABEL, 1.05 * outline.T], axis=1)
    edges: Array = np.stack([points.min(axis=1), points.max(axis=1)], axis=1).ravel()
    return edges


def bare(ax: Axes, edges: Array) -> None:
    """Remove the frame of the axes and set equal scales, with these edges."""
    ax.set_aspect("equal", anchor="S")  # keeps the legend below in its place
    ax.set_xlim(*edges[:2])
    ax.set_ylim(*edges[2:])
    ax.set_axis_off()
