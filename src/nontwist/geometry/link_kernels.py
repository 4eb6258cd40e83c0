"""Gauss integrals of pairs of segments; `linking` derives them.

Polygons are (3, n), coordinate by coordinate; those that are closed end with their first point. A row of pairs is done
in lanes: lengths, then the solid angle of each pair as a point (x, y), then its arc tangent by a series where the
quotient is small, which it is for most. What is left is given to `arctan2`.
"""

from __future__ import annotations

import math
from typing import Any

from ..kernels.control import Variables, loop, when
from ..kernels.elements import any_of, arctan2, logical_not, select, sum_of_lanes
from ..kernels.kernel import kernel
from ..kernels.memory import load, store
from ..kernels.tracing import width
from ..kernels.vectors import Vector, cross
from .frame_kernels import length

_SMALL = 0.1  # tangent up to which the series is right to 1e-17
WORK = 2  # rows of numbers that a row of pairs needs
SCRATCH = 8  # columns behind the points of `b`, for lanes that have no pair


def _series(t: Any) -> Any:
    """Return the arc tangent of a small number."""
    s = t * t
    rest = 1 / 13 - s * (1 / 15 - s * (1 / 17))
    rest = 1 / 9 - s * (1 / 11 - s * rest)
    rest = 1 / 5 - s * (1 / 7 - s * rest)
    return t * (1.0 - s * (1 / 3 - s * rest))


@kernel("f8[:, :], f8[:, :], f8[:], i8, i8, i8, i8, f8[:, :], f8[:], f8[:]", lanes=0)
def row_integrals(
    a: Any, b: Any, numbers: Any, same: Any, closed: Any, first: Any, stride: Any, work: Any, total: Any, sizes: Any
) -> None:
    """Set the Gauss integral, over 2π, of every `stride`-th segment of `a` with all of `b`; and of its magnitude.

    With `same` the polygons are one, each pair counts once, and neighbours, which lie in a plane, do not. Behind the
    points of `b` lie `SCRATCH` more of any finite numbers; `work` is (WORK, columns of b), `numbers` counts from 0.
    """
    points = a.shape[1]
    for i in loop(first, points - 1, stride):
        end = select(same != 0, select(i > 1, i - 1, 0), b.shape[1] - SCRATCH - 1)
        begin = select((same != 0) & (closed != 0) & (i == points - 2), 1, 0)
        p, q = (Vector(*(a[k, i + l] for k in range(3))) for l in (0, 1))
        for j in loop(0, end + 1, width()):
            x = Vector(*(load(b[k], j) for k in range(3)))
            store(work[0], j, length(x - p))
            store(work[1], j, length(x - q))
        v = Variables(whole=0.0, size=0.0, angle=0.0)
        for j in loop(0, end, width()):
            x, y = (Vector(*(load(b[k], j + l) for k in range(3))) for l in (0, 1))
            (al, bl), (dl, cl) = ([load(work[k], j + l) for l in (0, 1)] for k in (0, 1))
            volume, lengths, ac = _dot(x - p, cross(q - p, y - x)), al * cl, _dot(x - p, y - q)
            one = bl * (lengths + ac) + _dot(x - p, y - p) * cl + _dot(y - p, y - q) * al
            other = dl * (lengths + ac) + _dot(x - p, x - q) * cl + _dot(y - q, x - q) * al
            up, along = -volume * (one + other), select(volume != 0.0, one * other - volume * volume, 1.0)
            number = load(numbers, j)
            is_pair = (number >= 1.0 * begin) & (number < 1.0 * end)
            is_small = (along > 0.0) & (abs(up) < _SMALL * along)
            v.angle = _series(select(is_small, up / along, 0.0))
            for _ in when(any_of(logical_not(is_small) & is_pair)):
                v.angle = select(is_small, v.angle, arctan2(up, along))
            angle = select(is_pair, v.angle, 0.0)
            v.whole, v.size = v.whole + angle, v.size + abs(angle)
        total[i], sizes[i] = sum_of_lanes(v.whole) / (2.0 * math.pi), sum_of_lanes(v.size) / (2.0 * math.pi)


def _dot(a: Vector, b: Vector) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
