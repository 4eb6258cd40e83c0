"""Gauss integrals of pairs of segments; `linking` derives them.

Polygons are (3, n), coordinate by coordinate; those that are closed end with their first point. A row of pairs is done
in loops from 0 without branches, which compilers turn into vector instructions: lengths, then the solid angle of each
as a point (x, y), then its arc tangent by a series where the quotient is small, which it is for most. What is left is
given to `atan2`.
"""

from __future__ import annotations

import math

from .arrays import Array
from .compiled import kernel, shared

_SMALL = 0.1  # tangent up to which the series is right to 1e-17
_LEFT = 9.0  # no angle: what the series is not for
WORK = 5  # rows of numbers that a row of pairs needs


@shared
def _series(t: float) -> float:
    """Arc tangent of a small number."""
    s = t * t
    rest = 1 / 13 - s * (1 / 15 - s / 17)
    rest = 1 / 9 - s * (1 / 11 - s * rest)
    rest = 1 / 5 - s * (1 / 7 - s * rest)
    return t * (1.0 - s * (1 / 3 - s * rest))


@kernel("f8[:, :], f8[:, :], i8, i8, i8, i8, f8[:, :], f8[:], f8[:]", vectorize=True)
def row_integrals(
    a: Array, b: Array, same: int, closed: int, first: int, stride: int, work: Array, total: Array, sizes: Array
) -> None:
    """Set the Gauss integral, over 2π, of every `stride`-th segment of `a` with all of `b`; and of its magnitude.

    With `same` the polygons are one, each pair counts once, and neighbours, which lie in a plane, do not. `work` is
    (WORK, points of b).
    """
    for i in range(first, a.shape[1] - 1, stride):
        begin, end = 0, b.shape[1] - 1
        if same != 0:
            end = max(i - 1, 0)
            if closed != 0 and i == a.shape[1] - 2:
                begin = 1
        p, q, r = a[0, i], a[1, i], a[2, i]
        u, v, w = a[0, i + 1], a[1, i + 1], a[2, i + 1]
        ux, uy, uz = u - p, v - q, w - r
        for j in range(end + 1):
            ax, ay, az, dx, dy, dz = b[0, j] - p, b[1, j] - q, b[2, j] - r, b[0, j] - u, b[1, j] - v, b[2, j] - w
            work[0, j] = math.sqrt(ax * ax + ay * ay + az * az)
            work[1, j] = math.sqrt(dx * dx + dy * dy + dz * dz)
        for j in range(end):
            ax, ay, az, dx, dy, dz = b[0, j] - p, b[1, j] - q, b[2, j] - r, b[0, j] - u, b[1, j] - v, b[2, j] - w
            k = j + 1
            bx, by, bz, cx, cy, cz = b[0, k] - p, b[1, k] - q, b[2, k] - r, b[0, k] - u, b[1, k] - v, b[2, k] - w
            al, dl, bl, cl = work[0, j], work[1, j], work[0, k], work[1, k]
            vx, vy, vz = b[0, k] - b[0, j], b[1, k] - b[1, j], b[2, k] - b[2, j]
            volume = ax * (uy * vz - uz * vy) + ay * (uz * vx - ux * vz) + az * (ux * vy - uy * vx)
            ac, lengths = ax * cx + ay * cy + az * cz, al * cl
            one = bl * (lengths + ac) + (ax * bx + ay * by + az * bz) * cl + (bx * cx + by * cy + bz * cz) * al
            other = dl * (lengths + ac) + (ax * dx + ay * dy + az * dz) * cl + (dx * cx + dy * cy + dz * cz) * al
            work[2, j] = -volume * (one + other)
            work[3, j] = one * other - volume * volume if volume != 0.0 else 1.0
        for j in range(end):
            y, x = work[2, j], work[3, j]
            small = (x > 0.0) & (abs(y) < _SMALL * x)
            work[4, j] = _series(y / x if small else 0.0) if small else _LEFT
        whole, size = 0.0, 0.0
        for j in range(begin, end):
            angle = work[4, j]
            if angle == _LEFT:
                angle = math.atan2(work[2, j], work[3, j])
            whole += angle
            size += abs(angle)
        total[i], sizes[i] = whole / (2.0 * math.pi), size / (2.0 * math.pi)
