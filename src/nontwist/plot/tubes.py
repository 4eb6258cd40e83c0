"""Tubes and ribbons along closed curves, in orthographic projection: faces from the far ones to the near ones."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..curves import curve_report
from ..geometry.arrays import Array, Axes, as_array, as_positive, norm
from ..geometry.linking import polygon, ribbon_twist
from .journals import axes_for, style
from .looks import Look, cycle, given_look
from .spheres import view

SIDES, STRIPES = 24, 4
_WIDE = 0.06  # of the size of the curve
_LIGHT = np.array([-0.4, 0.5, 0.77])  # right, up, towards the viewer
_FACES = 600  # along a curve, at least
SMALLEST = 1e-75  # size of a curve that is drawn: squares of lengths are computed


def tube(
    points: ArrayLike,
    ax: Axes | None = None,
    *,
    radius: float | None = None,
    turns: int = 0,
    elevation: float | None = None,
    azimuth: float | None = None,
    **properties: Any,
) -> Axes:
    """Draw a tube along a closed curve, swept by frames that close, so that its stripes have no seam.

    Parameters
    ----------
    points : (n, 3) array
        The curve, in any unit of length; the last point is joined to the first, and may repeat it.
    ax : Axes, optional
        Axes to draw on; by default those of a new figure, available as ``ax.figure``.
    radius : float, optional
        Radius of the tube in the unit of the points; by default 6 % of the size of the curve.
    turns : int
        Additional whole turns of the stripes about the curve, as in `nontwist.curves.closed_frame`.
    elevation, azimuth : float, degrees, optional
        View direction: angles above the xy plane and from the x axis.
    **properties
        Properties of the faces, as for `matplotlib.collections.PolyCollection`: alpha, linewidths, edgecolors.

    Returns
    -------
    Axes
        The faces are one collection, ``ax.collections[0]``.

    Raises
    ------
    ValueError
        `points` are not a closed curve, as in `nontwist.curves.writhe`; the radius is not positive; `ax` is not a
        Matplotlib Axes, or an angle is invalid; or faces do not have one of the properties.

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist import plot
    >>> t = 2 * np.pi * np.arange(300) / 300
    >>> r = 2 + np.cos(3 * t)
    >>> ax = plot.tube(np.stack([r * np.cos(2 * t), r * np.sin(2 * t), -np.sin(3 * t)], axis=1))
    >>> plot.save(ax, "trefoil.pdf")
    """
    given = given_look(properties, "tube", "PolyCollection")
    report = curve_report(points, turns=turns)
    x, frame = report.position.values, report.frame.values
    width = _width(radius, "radius", x)
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    around = np.cos(angle)[:, None, None] * frame[:, 0] + np.sin(angle)[:, None, None] * frame[:, 1]
    shell = x + width * around
    corners = [shell, np.roll(shell, -1, axis=1)]
    quads = np.stack([*corners[::-1], *(np.roll(c, -1, axis=0) for c in corners)], axis=2)  # seen from outside
    band = np.broadcast_to((np.arange(SIDES) * STRIPES // SIDES % 2)[:, None], quads.shape[:2])
    return _drawn(quads.reshape(-1, 4, 3), band.ravel(), ax, elevation, azimuth, given, two_sided=False)


def ribbon(
    points: ArrayLike,
    d1: ArrayLike,
    ax: Axes | None = None,
    *,
    width: float | None = None,
    elevation: float | None = None,
    azimuth: float | None = None,
    **properties: Any,
) -> Axes:
    """Draw a ribbon along a closed curve, with its two halves in different colours.

    Parameters
    ----------
    points : (n, 3) array
        Centre line of the ribbon, in any unit of length; the last point is joined to the first, and may repeat it.
    d1 : (n, 3) array
        Vectors across the ribbon at each point, of any length, as in `nontwist.curves.ribbon_twist`.
    ax : Axes, optional
        Axes to draw on; by default those of a new figure, available as ``ax.figure``.
    width : float, optional
        Width of the ribbon in the unit of the points; by default 12 % of the size of the curve.
    elevation, azimuth : float, degrees, optional
        View direction: angles above the xy plane and from the x axis.
    **properties
        Properties of the faces, as for `matplotlib.collections.PolyCollection`: alpha, linewidths, edgecolors.

    Returns
    -------
    Axes
        The faces are one collection, ``ax.collections[0]``.

    Raises
    ------
    ValueError
        `points` are not a closed curve, or `d1` not vectors across it, as in `nontwist.curves.ribbon_twist`; the width
        is not positive; `ax` is not a Matplotlib Axes, or an angle is invalid; or faces do not have one of these
        properties.

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist import plot
    >>> t = 2 * np.pi * np.arange(300)[:, None] / 300
    >>> circle = np.hstack([np.cos(t), np.sin(t), 0 * t])
    >>> ax = plot.ribbon(circle, np.cos(2 * t) * circle + np.sin(2 * t) * [0, 0, 1])
    >>> plot.save(ax, "ribbon.pdf")
    """
    given = given_look(properties, "ribbon", "PolyCollection")
    x, v = polygon(points, "points", True), as_array(d1, "d1", (None, 3), np.inf)
    ribbon_twist(x, v[: len(x)] if len(v) == len(x) + 1 else v)
    v = v[: len(x)]
    half = _width(width, "width", x) / (1 if width is None else 2)
    across = half * v / norm(v)[:, None]
    rails = [x - across, x, x + across]
    quads = [np.stack([a, b, np.roll(b, -1, axis=0), np.roll(a, -1, axis=0)], axis=1) for a, b in pairwise(rails)]
    band = np.repeat([0, 1], len(x))
    return _drawn(np.concatenate(quads), band, ax, elevation, azimuth, given, two_sided=True)


def _width(given: float | None, name: str, x: Array) -> float:
    if given is None:
        return _WIDE * float(norm(np.ptp(x, axis=0)))
    return float(as_positive(given, name, (), "in the unit of the points"))


def _drawn(
    quads: Array,
    band: Any,
    ax: Axes | None,
    elevation: float | None,
    azimuth: float | None,
    given: Look,
    *,
    two_sided: bool,
) -> Axes:
    """Draw faces (k, 4, 3) in the colours of their bands, shaded, the far ones first."""
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgb

    if not SMALLEST <= (size := float(np.ptp(quads, axis=(0, 1)).max())) <= 1 / SMALLEST:
        raise ValueError(f"a curve of size {size:.3g} cannot be drawn; choose another unit of length")
    with style():
        ax = axes_for(ax, None)
        V = view(elevation, azimuth, quads.mean(axis=1) - quads.mean(axis=(0, 1)))
        q = quads @ V.T
        normal = np.cross(q[:, 2] - q[:, 0], q[:, 3] - q[:, 1])
        normal /= np.maximum(norm(normal), np.finfo(float).tiny)[:, None]
        light = normal @ _LIGHT
        light = np.abs(light) if two_sided else np.maximum(light, 0.0)
        colours = np.array([to_rgb(str(look["color"])) for look in cycle()[:2]])
        shade = (0.35 + 0.65 * light)[:, None]
        face = shade * colours[band] + 0.12 * (light**8)[:, None]
        order = np.argsort(q[:, :, 2].mean(axis=1))
        faces = np.clip(face[order], 0, 1)
        look: Look = {"facecolors": faces, "edgecolors": faces, "linewidths": 0.4}
        drawn = PolyCollection(list(q[order, :, :2]), **look | given)
        drawn.set_rasterized(len(q) > _FACES)
        ax.add_collection(drawn)
        ax.set_aspect("equal")
        ax.autoscale_view()
        ax.set_axis_off()
    return ax
