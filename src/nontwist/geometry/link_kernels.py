"""Gauss integrals of pairs of segments; `linking` derives them. Closed polygons (n, 3): the last point meets the first.

A quotient that is small has its arc tangent by a series, which takes less than half the time of `atan2`.
"""

from __future__ import annotations

import math

from .arrays import Array
from .compiled import kernel, shared

_SMALL = 0.1  # tangent up to which the series is right to 1e-17


@shared
def _difference(a: Array, i: int, b: Array, j: int) -> tuple[float, float, float, float]:
    x, y, z = b[j, 0] - a[i, 0], b[j, 1] - a[i, 1], b[j, 2] - a[i, 2]
    return x, y, z, math.sqrt(x * x + y * y + z * z)


@shared
def _angle(y: float, x: float) -> float:
    """Angle of the point (x, y)."""
    if x > 0.0 and abs(y) < _SMALL * x:
        t = y / x
        s = t * t
        rest = 1 / 13 - s * (1 / 15 - s / 17)
        rest = 1 / 9 - s * (1 / 11 - s * rest)
        rest = 1 / 5 - s * (1 / 7 - s * rest)
        return t * (1.0 - s * (1 / 3 - s * rest))
    return math.atan2(y, x)


@kernel("f8[:, :], f8[:, :], i8, i8, i8, i8, f8[:], f8[:]")
def row_integrals(
    a: Array, b: Array, same: int, closed: int, first: int, stride: int, total: Array, sizes: Array
) -> None:
    """Set the Gauss integral, over 2π, of every `stride`-th segment of `a` with all of `b`; and of its magnitude.

    With `same` the polygons are one, each pair counts once, and neighbours, which lie in a plane, do not.
    """
    n, m = a.shape[0], b.shape[0]
    rows, columns = (n, m) if closed != 0 else (n - 1, m - 1)
    for i in range(first, rows, stride):
        after = i + 1 if i + 1 < n else 0
        begin, end = 0, columns
        if same != 0:
            begin = i + 2
            if i == 0 and closed != 0:
                end = columns - 1
        whole, size = 0.0, 0.0
        if begin < end:
            ax, ay, az, al = _difference(a, i, b, begin)
            dx, dy, dz, dl = _difference(a, after, b, begin)
            for j in range(begin, end):
                k = j + 1 if j + 1 < m else 0
                bx, by, bz, bl = _difference(a, i, b, k)
                cx, cy, cz, cl = _difference(a, after, b, k)
                # edge of `a` = ax - dx, of `b` = bx - ax
                ux, uy, uz, vx, vy, vz = ax - dx, ay - dy, az - dz, bx - ax, by - ay, bz - az
                volume = ax * (uy * vz - uz * vy) + ay * (uz * vx - ux * vz) + az * (ux * vy - uy * vx)
                ac, lengths = ax * cx + ay * cy + az * cz, al * cl
                one = bl * (lengths + ac) + (ax * bx + ay * by + az * bz) * cl + (bx * cx + by * cy + bz * cz) * al
                other = dl * (lengths + ac) + (ax * dx + ay * dy + az * dz) * cl + (dx * cx + dy * cy + dz * cz) * al
                angle = _angle(-volume * (one + other), one * other - volume * volume) if volume != 0.0 else 0.0
                whole += angle
                size += abs(angle)
                ax, ay, az, al, dx, dy, dz, dl = bx, by, bz, bl, cx, cy, cz, cl
        total[i], sizes[i] = whole / (2.0 * math.pi), size / (2.0 * math.pi)
