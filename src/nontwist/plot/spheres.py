"""Curves on a sphere or an ellipsoid in orthographic projection: what lies on the far side is dimmed.

The path of a director on the unit sphere.

A free non-twisting body keeps Π1 and Π2 (eq-material_perpendicular_momenta_preservation), so its angular velocity is
constant in the body and d3 runs along a great circle. Under a load that ends it does so from its end on: the great
circle is drawn through the path there.

Poinsot's picture: the inertia ellipsoid and the polhode.

With x = W/√(2K) the kinetic energy 2K = W·JW reads x·Jx = 1: the inertia ellipsoid, with half-axes 1/√J_i. Its points
are directions of the angular velocity, and every motion, free or not, draws a curve on it, the polhode. In free motion
the standard body keeps |Π|² and K as well, so that x·J²x = |Π|²/2K is constant: these level curves are drawn thin, with
the separatrix through the middle axis dashed. The free non-twisting body stays at a point (eq-nonholonomic).

In the principal axes y_i = √J_i x_i lie on the unit sphere, and Σ J_i y_i² = c. For c above J_2 this reads
y1² (J_3 - J_1) + y2² (J_3 - J_2) = J_3 - c: an ellipse seen along axis 3; for c below, one along axis 1.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from ..analysis.datasets import body_of
from ..geometry.arrays import Array, Axes, arcs, as_number
from ..geometry.values import as_whole, require_among
from ..loads.kinds import load_of
from ..models.system import DirectorSystem
from ..viewer.drawing import Camera, circle_about, graticule
from .journals import axes_for, column_width, style
from .looks import COLOURS, Look, cycle, given_look, handle, labelled, legend, looks, pale, shade, shaded, variable

if TYPE_CHECKING:
    from .looks import Runs

ELEVATION, AZIMUTH = 25.0, 35.0  # degrees
DIM, THIN = 0.3, 0.6  # what is on the far side: lines that only guide, the others
_CONCENTRATED, _WELL_SEEN, _ENOUGH = 0.8, 0.7, 2000
_AZIMUTH_CHANGES = (0, 15, -15, 30, -30, 45, -45, 60, -60, 75, -75, 90)  # degrees
_PIXELS = 20000
ARROW = 0.22  # of the coordinate axes
_LABEL, _CLEAR, _TURNS = 0.08, 0.12, (0, 40, -40, 80, -80, 120, -120)  # of their names: from the tip, from paths; °
GUIDE: Look = {"color": "0.35", "linewidth": 0.7, "linestyle": (0, (4, 2))}
_START: Look = {"marker": "o", "markersize": 6, "markerfacecolor": "white", "linestyle": ""}
_BALL: Look = {"facecolor": "#f6f7f8", "edgecolor": "0.45", "linewidth": 0.6, "zorder": 0}
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
    weights = np.maximum(x[:, 2], 0)
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
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def curve(ax: Axes, x: Array, depth: Array, zorder: float, name: str, **look: Any) -> None:
    """Draw a curve in screen coordinates (n, 2 or 3), far where `depth` is negative; `name` is of its near side."""
    near = (depth[1:] + depth[:-1]) >= 0
    for side, label, order in ((near, name, zorder), (~near, f"_{name.removeprefix('_')}, far side", zorder - 2)):
        xy = np.where((np.append(side, False) | np.append(False, side))[:, None], x[:, :2], np.nan)
        whole: Look = {"label": label, "zorder": order, "linestyle": "-", "rasterized": len(x) > _PIXELS} | look
        ax.plot(xy[:, 0], xy[:, 1], **whole if side is near else far(whole))


def far(look: Look) -> Look:
    """Return the look of a line on the far side: thinner, and as pale as it may be."""
    if (faint := pale(look["color"])) is look["color"]:
        return {"alpha": DIM} | look
    return look | {"color": faint, "linewidth": THIN * look["linewidth"]}


def ends(ax: Axes, x: Array, depth: Array, colour: str, name: str) -> None:
    """Mark start and end of a path, x (2, 2 or 3) on the screen, paler where `depth` is negative."""
    for k, (end, look) in enumerate((("start", _START), ("end", _END))):
        own, order = (colour, 6.0) if depth[k] >= 0 else (pale(colour), 2.4)
        marked: Look = {"color": own, "markeredgecolor": own, "zorder": order, "label": f"_{end} of {name}"}
        ax.plot(x[k, 0], x[k, 1], **marked | shaded(look))


def legend_of_ends(ax: Axes, runs: list[str], others: dict[str, Look], look: dict[tuple[str, str], Look]) -> None:
    """Put a legend below the globe: runs where there are several, start and end, and `others`."""
    own = [handle(run, one) for run, one in zip(runs, look.values(), strict=True)]
    marks = [handle("start", shaded(_START | {"color": "0.2"})), handle("end", shaded(_END | {"color": "0.2"}))]
    marks += [handle(label, look) for label, look in others.items()]
    legend(ax, [own, marks] if len(own) > 1 else [marks], below=True)


def arrows(ax: Axes, V: Array, feet: Array, names: str, paths: Array) -> None:
    """Draw arrows outwards along the coordinate axes from `feet` (3,), with `names` beside `paths` (n, 3 on screen)."""
    from matplotlib.patheffects import withStroke

    for k, name in enumerate(names):
        x = V[:, k]
        near = x[2] >= -1e-9
        tip, foot = ((s * x[0], s * x[1]) for s in (feet[k] + ARROW, feet[k]))
        colour = shade("0.3" if near else "0.42")
        head = "-|>,head_width=0.13,head_length=0.3"
        style: Look = {"arrowstyle": head, "lw": 0.7, "color": colour, "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", tip, foot, arrowprops=style, zorder=5 if near else 1)
        place: Look = {"textcoords": "offset points", "ha": "center", "va": "center", "zorder": 7 if near else 1}
        text = ax.annotate(f"${name}$", tip, _beside(np.array(tip), x[:2], paths[:, :2]), color=colour, **place)
        text.set_path_effects([withStroke(linewidth=1.5, foreground=shade("white"))])


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
    return np.stack([points.min(axis=1), points.max(axis=1)], axis=1).ravel()


def bare(ax: Axes, edges: Array) -> None:
    """Remove the frame of the axes and set equal scales, with these edges."""
    ax.set_aspect("equal", anchor="S")  # keeps the legend below in its place
    ax.set_xlim(*edges[:2])
    ax.set_ylim(*edges[2:])
    ax.set_axis_off()


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
    require_among(director, "director", (1, 2, 3))
    triads = as_whole(triads, "triads", 0, MOST_TRIADS)
    given, runs = given_look(properties, "path"), labelled(runs)
    table = {label: _directors(run, label) for label, run in runs.items()}
    with style():
        ax = axes_for(ax, None)
        points = np.concatenate([spaced(q[:, director - 1]) for q in table.values()])
        V = view(elevation, azimuth, points)
        _globe(ax, V, points @ V.T)
        own = looks(["path"], list(table), given, (f"d{director}",))
        pair = [*enumerate(_others(director - 1), len(own))] if triads else []  # behind the colours of several runs
        sticks = {f"$d_{j + 1}$": {"color": cycle()[k % COLOURS if len(own) > 1 else j]["color"]} for k, j in pair}
        for (_, label), look in own.items():
            q = table[label]
            d = q[:, director - 1]
            x = spaced(d) @ V.T
            curve(ax, x, x[:, 2], 4, label or "path", **{"linewidth": _width(d)} | look)
            ends(ax, x[[0, -1]], x[[0, -1], 2], look["color"], label or "path")
            if great_circle:
                _great_circle(ax, d[_free_from(runs[label]) :], V)
            if triads:
                _triads(ax, q, sticks, director - 1, triads, V)
        legend_of_ends(ax, list(table), ({"great circle": shaded(_CIRCLE)} if great_circle else {}) | sticks, own)
    return ax


def _directors(run: Any, label: str) -> Array:
    frame = (run["frame"] if "frame" in run else variable(run, label, "directors")).values
    known: Array = frame[np.isfinite(frame).all(axis=(1, 2))]  # what a failed member has not reached is NaN
    if not len(known):
        raise ValueError("no attitude of the run is finite")
    return known


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
    curve(ax, x, x[:, 2], 3.5, "great circle", **shaded(_CIRCLE))


def _triads(ax: Axes, q: Array, own: dict[str, Look], k: int, count: int, V: Array) -> None:
    """Draw the other two directors at `count` tips along the path: near and far, first one, then the other."""
    length = np.append(0.0, np.cumsum(arcs(q[:, k])))
    chosen = np.searchsorted(length, np.linspace(0, length[-1], count) * (1 - 1e-12))
    tips = q[chosen, k] @ V.T
    for j, (name, look) in zip(_others(k), own.items(), strict=True):
        sticks = np.stack([tips, tips + 0.2 * q[chosen, j] @ V.T, np.full_like(tips, np.nan)], axis=1)
        stick: Look = look | {"linestyle": "-", "linewidth": 1.0}
        for near in (True, False):
            x = sticks[(tips[:, 2] >= 0) == near].reshape(-1, 3)
            label = name if near else f"_{name}, far side"
            ax.plot(x[:, 0], x[:, 1], zorder=5 if near else 2, label=label, **stick if near else far(stick))


def _others(k: int) -> tuple[int, int]:
    return (k + 1) % 3, (k + 2) % 3


def _globe(ax: Axes, V: Array, paths: Array) -> None:
    from matplotlib.patches import Circle

    below = extent(V, np.ones(3), np.zeros((1, 2)))[2]
    bare(ax, np.array([-_MARGIN, _MARGIN, min(below, -_BELOW), _MARGIN]))
    ax.add_patch(Circle((0, 0), 1, **shaded(_BALL)))
    latitudes = (-60, -30, 0, 30, 60)
    meridians, parallels = graticule(latitudes, 181)
    grid: Look = {"linewidth": 0.4, "color": shade("0.75")}
    for m in meridians:
        curve(ax, m @ V.T, m @ V[2], 2.5, "_meridian", **grid)
    for latitude, p in zip(latitudes, parallels, strict=True):
        curve(ax, p @ V.T, p @ V[2], 2.5, "_parallel", **grid | ({"color": shade("0.55")} if latitude == 0 else {}))
    arrows(ax, V, np.ones(3), "xyz", paths)


_SAME, _EQUAL = 1e-9, 1e-6
_LEGEND = 0.25  # in
_CONSTRAINED: Look = {"color": "0.35", "linewidth": 0.7}


def polhode(
    runs: Runs,
    ax: Axes | None = None,
    *,
    elevation: float | None = None,
    azimuth: float | None = None,
    **properties: Any,
) -> Axes:
    """Draw the inertia ellipsoid x·Jx = 1 of the body with the polhode of the run, x = W/√(2K), in body components.

    Parameters
    ----------
    runs : Dataset, or dict of str to Dataset
        A run, or several runs of bodies with the same inertia, with their labels.
    ax : Axes, optional
        Axes to draw on; by default those of a new figure, available as ``ax.figure``.
    elevation, azimuth : float, degrees, optional
        View direction: angles above the plane of D1 and D2 and from D1; by default chosen to show the polhode.
    **properties
        Properties of the polhodes, as for `matplotlib.lines.Line2D`: linewidth, color, alpha.

    Returns
    -------
    Axes
        Lines on the near side, labelled "polhode" or with the label of the run, and on the far side.

    Raises
    ------
    ValueError
        Bodies have different inertia, a run is at rest, or lines do not have one of the properties.

    Examples
    --------
    >>> from nontwist import plot, simulate, standard
    >>> run = simulate(standard([3, 4, 5]), t_end=20, material_angular_velocity=(0.1, 2, 0.1))
    >>> ax = plot.polhode(run)
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['start', 'end', 'separatrix']
    """
    given, table = given_look(properties, "polhode"), labelled(runs)
    velocities = {label: variable(run, label, "material_angular_velocity") for label, run in table.items()}
    systems = {label: body_of(run) for label, run in table.items()}
    J, P = np.linalg.eigh(_common_inertia(systems))
    half_axes: Array = np.sqrt(J[0] / J) * P  # from the unit sphere to the ellipsoid, its longest half-axis 1
    polhodes = {label: _polhode(W, label, np.sqrt(J) * P) for label, W in velocities.items()}
    with style():
        points = np.concatenate([spaced(y) for y in polhodes.values()]) @ half_axes.T
        V = view(elevation, azimuth, points)
        screen, towards = V @ half_axes, V[2] @ (P * np.sqrt(J))  # y lies on the near side where y·towards >= 0
        feet, outline = np.sqrt(J[0] / np.einsum("ki,i,ki->k", P, J, P)), circle_about(towards) @ screen.T
        edges = extent(V, feet, outline[:, :2])
        left, right, below, above = edges
        ax = axes_for(ax, float(column_width() * (above - below) / (right - left)) + _LEGEND)
        bare(ax, edges)
        _surface(ax, J, screen, towards)
        constrained = [system.axis for system in systems.values() if system.axis is not None]
        for n in constrained:
            y = circle_about((n @ P) / np.sqrt(J))
            curve(ax, y @ screen.T, y @ towards, 3.5, r"$W\cdot n=0$", **shaded(_CONSTRAINED))
        arrows(ax, V, feet, "123", points @ V.T)
        own = looks(["polhode"], list(table), given)
        for (_, label), look in own.items():
            y = spaced(polhodes[label])
            curve(ax, y @ screen.T, y @ towards, 4, label or "polhode", **{"linewidth": 1.3} | look)
            ends(ax, y[[0, -1]] @ screen.T, y[[0, -1]] @ towards, look["color"], label or "polhode")
        guides = {"separatrix": shaded(GUIDE)} if _separatrix(J) else {}
        guides |= {r"$W\cdot n=0$": shaded(_CONSTRAINED)} if constrained else {}
        legend_of_ends(ax, list(table), guides, own)
    return ax


def _common_inertia(systems: dict[str, DirectorSystem]) -> Array:
    first, *others = systems
    J = systems[first].convected_inertia
    for label in others:
        if abs(systems[label].convected_inertia - J).max() > _SAME * abs(J).max():
            raise ValueError(f"one ellipsoid needs one inertia, but {first!r} and {label!r} have different ones")
    return J


def _polhode(W: Any, label: str, root: Array) -> Array:
    """Return the angular velocity on the unit sphere, (n, 3), without the times of rest."""
    y = W.values @ root
    length = np.linalg.norm(y, axis=1)
    moving = length > _SAME * np.fmax.reduce(length)  # and not NaN
    if not moving.any():
        raise ValueError(f"the run{label and f' {label!r}'} is at rest: its angular velocity has no direction")
    return y[moving] / length[moving, None]


def _surface(ax: Axes, J: Array, screen: Array, towards: Array) -> None:
    """Draw the ellipsoid: its outline, the polhodes of the free standard body, the separatrix."""
    outline = circle_about(towards) @ screen.T
    ax.fill(outline[:, 0], outline[:, 1], **shaded(_BALL))
    for y in _levels(J):
        curve(ax, y @ screen.T, y @ towards, 2.5, "_level", color=shade("0.7"), linewidth=0.4)
    for y in _separatrix(J):
        curve(ax, y @ screen.T, y @ towards, 3.5, "separatrix", **shaded(GUIDE))


def _separatrix_angle(J: Array) -> float:
    """Return the angle from axis 1 to the separatrix, in the plane of the axes 1 and 3."""
    return float(np.arctan2(np.sqrt(J[1] - J[0]), np.sqrt(J[2] - J[1])))


def _levels(J: Array) -> list[Array]:
    """Return polhodes of the free standard body on the unit sphere, two between the separatrix and each stable axis."""
    t = np.linspace(0, 2 * np.pi, 241)
    curves = []
    for near, far, reach in ((0, 2, _separatrix_angle(J)), (2, 0, np.pi / 2 - _separatrix_angle(J))):
        for angle in (reach / 3, 2 * reach / 3):
            c = J[near] * np.cos(angle) ** 2 + J[far] * np.sin(angle) ** 2
            if reach > _EQUAL:
                y = np.empty((t.size, 3))
                y[:, far] = np.sqrt((c - J[near]) / (J[far] - J[near])) * np.cos(t)
                y[:, 1] = np.sqrt((c - J[near]) / (J[1] - J[near])) * np.sin(t)
                y[:, near] = np.sqrt(1 - y[:, far] ** 2 - y[:, 1] ** 2)
                curves += [y, y * np.where(np.arange(3) == near, -1, 1)]
    return curves


def _separatrix(J: Array) -> list[Array]:
    """Return two great circles through axis 2 on the unit sphere; none where two moments are equal."""
    s, c = np.sin(_separatrix_angle(J)), np.cos(_separatrix_angle(J))
    return [circle_about(np.array([s, 0, sign * c])) for sign in (1, -1)] if min(s, c) > _EQUAL else []
