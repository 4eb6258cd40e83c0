"""Poinsot's picture: the inertia ellipsoid and the polhode.

With x = W/√(2K) the kinetic energy 2K = W·JW reads x·Jx = 1: the inertia ellipsoid, with half-axes 1/√J_i. Its points
are directions of the angular velocity, and every motion, free or not, draws a curve on it, the polhode. In free motion
the standard body keeps |Π|² and K as well, so that x·J²x = |Π|²/2K is constant: these level curves are drawn thin, with
the separatrix through the middle axis dashed. The free non-twisting body stays at a point (eq-nonholonomic).

In the principal axes y_i = √J_i x_i lie on the unit sphere, and Σ J_i y_i² = c. For c above J_2 this reads
y1² (J_3 - J_1) + y2² (J_3 - J_2) = J_3 - c: an ellipse seen along axis 3; for c below, one along axis 1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.arrays import Array
from ..models.system import DirectorSystem
from .globe import GUIDE, arrows, bare, curve, ends, extent, legend_of_ends, spaced, view
from .journals import axes_for, column_width, style
from .looks import Look, given_look, labelled, looks, variable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .looks import Runs

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
    systems = {label: DirectorSystem.from_json(run.attrs["system"]) for label, run in table.items()}
    J, P = np.linalg.eigh(_common_inertia(systems))
    body: Array = np.sqrt(J[0] / J) * P  # from the unit sphere to the ellipsoid, its longest half-axis 1
    polhodes = {label: _polhode(W, label, np.sqrt(J) * P) for label, W in velocities.items()}
    with style():
        points = np.concatenate([spaced(y) for y in polhodes.values()]) @ body.T
        V = view(elevation, azimuth, points)
        screen, towards = V @ body, V[2] @ (P * np.sqrt(J))  # y lies on the near side where y·towards >= 0
        feet, outline = np.sqrt(J[0] / np.einsum("ki,i,ki->k", P, J, P)), _circle(towards) @ screen.T
        edges = extent(V, feet, outline[:, :2])
        ax = axes_for(ax, _height(edges))
        bare(ax, edges)
        _surface(ax, J, screen, towards)
        constrained = [system.axis for system in systems.values() if system.axis is not None]
        for n in constrained:
            y = _circle((n @ P) / np.sqrt(J))
            curve(ax, y @ screen.T, y @ towards, 3.5, r"$W\cdot n=0$", **_CONSTRAINED)
        arrows(ax, V, feet, "123", points @ V.T)
        own = looks(["polhode"], list(table), given)
        for (_, label), look in own.items():
            y = spaced(polhodes[label])
            curve(ax, y @ screen.T, y @ towards, 4, label or "polhode", **{"linewidth": 1.3} | look)
            ends(ax, y[[0, -1]] @ screen.T, y[[0, -1]] @ towards, look["color"], label or "polhode")
        guides = {"separatrix": GUIDE} if _separatrix(J) else {}
        guides |= {r"$W\cdot n=0$": _CONSTRAINED} if constrained else {}
        legend_of_ends(ax, list(table), guides, own)
    return ax


def _height(edges: Array) -> float:
    """Return the height of a figure one column wide that these edges fill, with its legend, in."""
    left, right, below, above = edges
    return float(column_width() * (above - below) / (right - left)) + _LEGEND


def _common_inertia(systems: dict[str, DirectorSystem]) -> Array:
    first, *others = systems
    J = systems[first].convected_inertia
    for label in others:
        if abs(systems[label].convected_inertia - J).max() > _SAME * abs(J).max():
            raise ValueError(f"one ellipsoid needs one inertia, but {first!r} and {label!r} have different ones")
    return J


def _polhode(W: Any, label: str, root: Array) -> Array:
    """Return the angular velocity on the unit sphere, (n, 3), without the times of rest."""
    y = W.transpose("time", "director").values @ root
    length = np.linalg.norm(y, axis=1)
    moving = length > _SAME * length.max()
    if not moving.any():
        raise ValueError(f"the run{label and f' {label!r}'} is at rest: its angular velocity has no direction")
    unit: Array = y[moving] / length[moving, None]
    return unit


def _circle(n: Array) -> Array:
    """Return the great circle about the vector n, (m, 3)."""
    t = np.linspace(0, 2 * np.pi, 241)[:, None]
    a = np.linalg.svd(n[None])[2][1:]
    points: Array = np.cos(t) * a[0] + np.sin(t) * a[1]
    return points


def _surface(ax: Axes, J: Array, screen: Array, towards: Array) -> None:
    """Draw the ellipsoid: its outline, the polhodes of the free standard body, the separatrix."""
    outline = _circle(towards) @ screen.T
    ax.fill(outline[:, 0], outline[:, 1], facecolor="#f6f7f8", edgecolor="0.45", linewidth=0.6, zorder=0)
    for y in _levels(J):
        curve(ax, y @ screen.T, y @ towards, 2.5, "_level", color="0.7", linewidth=0.4)
    for y in _separatrix(J):
        curve(ax, y @ screen.T, y @ towards, 3.5, "separatrix", **GUIDE)


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
    return [_circle(np.array([s, 0, sign * c])) for sign in (1, -1)] if min(s, c) > _EQUAL else []
