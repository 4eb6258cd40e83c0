"""Curves: frames along them that do not twist, their holonomy, and the link, twist and writhe of ribbons."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .geometry.arrays import Dataset, arcs, norm
from .geometry.curve_frames import frame_along, frame_of_curve
from .geometry.frames import closed_frame, frame_error_estimate, holonomy, nontwisting_frame, solid_angle
from .geometry.linking import directions, link, normalised, polygon, ribbon_twist, writhe, writhe_and_crossings
from .geometry.values import public

__all__ = [
    "closed_frame",
    "curve_report",
    "frame_along",
    "frame_error_estimate",
    "frame_of_curve",
    "holonomy",
    "link",
    "nontwisting_frame",
    "ribbon_twist",
    "solid_angle",
    "writhe",
]
public(__name__)


def curve_report(points: ArrayLike, *, turns: int = 0) -> Dataset:
    """Return the geometry of a closed polygon: writhe, twist, linking number, and frames that close.

    Parameters
    ----------
    points : (n, 3) array
        Vertices; the last one is joined to the first, and may repeat it.
    turns : int
        Additional whole turns of the frames, as in `closed_frame`; each adds 1 to the linking number.

    Returns
    -------
    Dataset on `point`
        position
            The points, the first not repeated.
        frame
            Frames that close, rows d1, d2, d3, with d3 the tangent. They twist uniformly along the curve and sweep a
            tube without a seam.
        arc_length
            Arc length from the first point.
        turning_angle
            Angle between the edges that meet at a point, rad.
        length
            Length of the curve.
        total_curvature
            Sum of the turning angles, rad; 2π for a convex plane curve, more than 4π for a knot.
        writhe, twist, linking_number
            Wr, Tw of `frame` in turns, and Lk = Tw + Wr of the ribbon along d1.
        mean_crossings
            Mean number of crossings over all viewing directions.
        holonomy
            Angle by which a non-twisting frame returns turned, rad, in (-π, π].

    Raises
    ------
    ValueError
        As `writhe`; or `turns` is not a whole number.

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist.curves import curve_report
    >>> t = 2 * np.pi * np.arange(300) / 300
    >>> r = 2 + np.cos(3 * t)
    >>> report = curve_report(np.stack([r * np.cos(2 * t), r * np.sin(2 * t), -np.sin(3 * t)], axis=1))
    >>> int(report.linking_number), round(float(report.twist + report.writhe), 9)
    (4, 4.0)
    >>> report.frame.shape
    (300, 3, 3)
    """
    import xarray

    x = polygon(points, "points", True)
    (unit,) = normalised(x)
    edges, tangents = directions(unit, True)
    # Along vertices and edges in turn, as the twist of a polygon is defined.
    way = np.stack([tangents, edges], axis=1).reshape(-1, 3)
    places = np.stack([unit, (unit + np.roll(unit, -1, axis=0)) / 2], axis=1).reshape(-1, 3)
    frames, turn = closed_frame(way, order=2, turns=turns, points=places)
    frame = frames[::2]
    total, crossings = writhe_and_crossings(unit, True)
    twist = ribbon_twist(unit, frame[:, 0])
    sides = norm(np.roll(x, -1, axis=0) - x)
    described = {
        "position": (("point", "axis"), x, "position"),
        "frame": (("point", "director", "axis"), frame, "frames that close, rows d1, d2, d3"),
        "arc_length": (("point",), np.append(0.0, np.cumsum(sides[:-1])), "length from the first point"),
        "turning_angle": (("point",), arcs(np.concatenate([edges[-1:], edges])), "angle between edges"),
        "length": ((), sides.sum(), "length"),
        "total_curvature": ((), arcs(np.concatenate([edges, edges[:1]])).sum(), "total curvature"),
        "writhe": ((), total, "writhe"),
        "twist": ((), twist, "twist of the frames, turns"),
        "linking_number": ((), round(twist + total), "linking number of the ribbon along d1"),
        "mean_crossings": ((), crossings, "mean number of crossings"),
        "holonomy": ((), turn, "holonomy of the tangents"),
    }
    angles = ("turning_angle", "total_curvature", "holonomy")
    variables = {
        name: xarray.Variable(dims, values, {"long_name": text, "units": "rad" if name in angles else "1"})
        for name, (dims, values, text) in described.items()
    }
    for name in ("position", "arc_length", "length"):
        del variables[name].attrs["units"]  # that of the points
    axes = {"director": ["d1", "d2", "d3"], "axis": list("xyz")}
    return xarray.Dataset(variables, axes, {"title": "closed curve", "turns": turns})
