"""Writhe, linking number and twist of closed curves, given as polygons: exact for the polygon.

**Gauss integral.** Two curves a, b have the linking number Lk = 1/4π ∮∮ (a - b)·(da × db)/|a - b|³, and a curve with
itself the writhe Wr. **Sign**: a right-handed crossing counts +1/2 in Lk. Seen from anywhere, the direction of the
strand in front goes to that of the one behind by a counter-clockwise turn of less than half a turn. For two segments,
with the vectors r_ij between their ends, the integral is 1/4π times the solid angle of the directions between them (K.
Klenin, J. Langowski, Biopolymers 54 (2000) 307-317), a quadrilateral of the unit vectors along r_13, r_14, r_24, r_23.
Cut in two triangles it is 2 atan2(V, p) + 2 atan2(V, q), where V is six times the volume of the four ends and p, q are
the denominators of A. Van Oosterom and J. Strackee (IEEE Trans. Biomed. Eng. 30 (1983) 125-126); the sum is below half
a turn, so one arc tangent of (p + iV)(q + iV) gives it. Nothing cancels where segments are far from one another.

**Twist.** The tangents of a polygon jump from edge to edge; carried along the great circle between them, from the
bisector u_i at a vertex over the edge t_i to u_i+1, a normal vector d1_i moves without twist (`frames`). Tw is 1/2π
times the sum over the edges of the angle from d1_i so carried to d1_i+1, each between minus half a turn and half a
turn.

**Călugăreanu's theorem** then holds for the polygon itself, not in a limit alone: with the linking number of the curve
and its neighbour x + ε d1,

    Lk = Tw + Wr,

for Wr + 1 is, modulo 2, 1/2π times the area that the tangents enclose on the sphere (F. B. Fuller, Proc. Natl. Acad.
Sci. USA 75 (1978) 3557-3561), and d1 comes back turned by that area where it does not twist. Each call of `writhe`
tests the first: where a curve runs through itself its Gauss integral is the mean of the two sides, 1 off from both. In
the smooth limit Tw and Wr of a polygon with its vertices on a curve are off by O(spacing²).

**Pairs in lanes.** Polygons are (3, n), coordinate by coordinate; those that are closed end with their first point. A
row of pairs is done in lanes: lengths, then the solid angle of each pair as a point (x, y), then its arc tangent by a
series where the quotient is small, which it is for most. What is left is given to `arctan2`.
"""

from __future__ import annotations

import math
import operator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..kernels.control import Variables, loop, when
from ..kernels.elements import all_lanes, any_of, arctan2, logical_not, select
from ..kernels.kernel import kernel
from ..kernels.machine_code import width
from ..kernels.memory import load_lanes, store_lanes
from ..kernels.vectors import Vector, cross
from ..machine import cores
from .arrays import Array, as_array, as_flag, dot, norm, refuse
from .frame_kernels import length, reflected
from .frames import solid_angle

_WHOLE = 1e-6  # departure from a whole number that round-off does not reach
_ROWS = 250  # segments of a thread, at least
_SMALL = 0.1  # tangent up to which the series is right to 1e-17
WORK = 2  # rows of numbers that a row of pairs needs
SCRATCH = 8  # columns behind the points of `b`, for lanes that have no pair


def writhe(points: ArrayLike, *, closed: bool = True) -> float:
    """Return the writhe of a polygon: its mean signed number of crossings over all viewing directions.

    Parameters
    ----------
    points : (n, 3) array
        Vertices, in any unit of length. The last one is joined to the first, and may repeat it.
    closed : bool
        False: the polygon ends at the last point, and its writhe is the Gauss integral over the open polygon.

    Returns
    -------
    float
        Positive for right-handed crossings. Exact for the polygon; for a curve through the points the error is
        O(spacing²).

    Raises
    ------
    ValueError
        `points` have another shape or are not finite, there are fewer than 3, points coincide, an edge reverses the one
        before, or a closed curve passes through itself.

    Examples
    --------
    A trefoil, right-handed:

    >>> import numpy as np
    >>> from nontwist.curves import writhe
    >>> t = 2 * np.pi * np.arange(300) / 300
    >>> r = 2 + np.cos(3 * t)
    >>> round(writhe(np.stack([r * np.cos(2 * t), r * np.sin(2 * t), -np.sin(3 * t)], axis=1)), 2)
    3.52
    """
    (x,) = normalised(polygon(points, "points", closed))
    return writhe_and_crossings(x, closed)[0]


def link(a: ArrayLike, b: ArrayLike) -> int:
    """Return the linking number of two closed polygons: how often one winds around the other, with sign.

    Parameters
    ----------
    a, b : (n, 3) and (m, 3) arrays
        Vertices; the last one is joined to the first, and may repeat it.

    Returns
    -------
    int
        Half the signed number of crossings of one with the other, right-handed ones positive.

    Raises
    ------
    ValueError
        As `writhe`; or the curves meet.

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist.curves import link
    >>> ring = np.array([(1, 1, 0), (-1, 1, 0), (-1, -1, 0), (1, -1, 0)])
    >>> other = ring[:, [1, 2, 0]] + (1, 0, 0)
    >>> link(ring, other), link(ring, other[::-1]), link(ring, other + 10)
    (1, -1, 0)
    """
    given = polygon(a, "a", True), polygon(b, "b", True)
    if met := _coincident(np.concatenate(given)):
        raise ValueError(f"a[{met[0]}] and b[{met[1] - len(given[0])}] coincide: the curves meet")
    x, y = normalised(*given)
    total = gauss_integrals(x, y, closed=True)[0]
    if abs(total - round(total)) > _WHOLE:
        raise ValueError(f"a and b meet: their Gauss integral is {total:.9g}, and no whole number")
    return round(total)


def ribbon_twist(points: ArrayLike, d1: ArrayLike, *, closed: bool = True) -> float:
    """Return the twist of a ribbon along a polygon, in turns: that of the vectors d1 relative to a non-twisting frame.

    Parameters
    ----------
    points : (n, 3) array
        As in `writhe`.
    d1 : (n, 3) array
        Vectors at each point, of any length. Only their part normal to the polygon counts, whose tangent at a point is
        the mean of the two edges. From point to point they must twist by less than half a turn.
    closed : bool
        False: the polygon, and the ribbon, end at the last point.

    Returns
    -------
    float, turns
        Positive if counter-clockwise about the direction of the curve. Together with `writhe` it gives exactly the
        linking number of the curve and its neighbour ``points + ε d1``: Lk = Tw + Wr.

    Raises
    ------
    ValueError
        As `writhe`; or d1 has another shape, is not finite, or is zero or parallel to the tangent (the message states
        the index).

    Examples
    --------
    A ribbon along a circle with three full turns of twist:

    >>> import numpy as np
    >>> from nontwist.curves import link, ribbon_twist, writhe
    >>> t = 2 * np.pi * np.arange(200)[:, None] / 200
    >>> out, up = np.hstack([np.cos(t), np.sin(t), 0 * t]), np.array([0, 0, 1])
    >>> d1 = np.cos(3 * t) * out + np.sin(3 * t) * up
    >>> round(ribbon_twist(out, d1), 9), round(writhe(out), 9), link(out, out + 0.1 * d1)
    (-3.0, 0.0, -3)
    """
    (x,) = normalised(polygon(points, "points", closed))
    edges, tangents = directions(x, closed)
    v = as_array(d1, "d1", (None, 3), np.inf)
    if len(v) == len(x) + 1 and closed:  # the first point was repeated
        v = v[:-1]
    if len(v) != len(x):
        raise ValueError(f"d1 must have one vector for each of the {len(x)} points, got {len(v)}")
    v = v / np.where((size := np.abs(v).max(axis=1)) > 0, size, 1.0)[:, None]
    v -= dot(v, tangents)[:, None] * tangents
    refuse(norm(v) < 1e-8, "d1", "is zero or parallel to the tangent there")
    return float(_twists(v, edges, tangents, closed).sum())


def polygon(points: ArrayLike, name: str, closed: bool) -> Array:
    """Return checked vertices (n, 3), the first not repeated; errors as in `writhe`."""
    x = as_array(points, name, (None, 3), np.inf)
    as_flag(closed, "closed")
    if closed and len(x) > 1 and np.array_equal(x[0], x[-1]):
        x = x[:-1]
    if len(x) < 3:
        raise ValueError(
            f"{name} must contain at least 3 different points of a {'closed ' * bool(closed)}curve, got {len(x)}"
        )
    if met := _coincident(x):
        one, other = met
        raise ValueError(
            f"{name}[{one}] and {name}[{other}] coincide: drop repeated points; a curve must not meet itself"
        )
    return x


def _coincident(x: Array) -> tuple[int, int] | None:
    """Return the numbers of two points that coincide, None where none do."""
    order = np.lexsort(x.T)
    same = np.flatnonzero((np.diff(x[order], axis=0) == 0).all(axis=1))
    return None if not same.size else (int(order[same[0]]), int(order[same[0] + 1]))  # the sort is stable


def normalised(*curves: Array) -> list[Array]:
    """Return curves near the origin and of size 1, all shifted and divided alike."""
    first = curves[0][0]
    size = max(float(np.abs(x - first).max()) for x in curves)
    return [np.ascontiguousarray((x - first) / size) for x in curves]


def directions(x: Array, closed: bool) -> tuple[Array, Array]:
    """Return unit vectors along the edges, and the tangents at the vertices, which bisect them."""
    edges = np.roll(x, -1, axis=0) - x if closed else np.diff(x, axis=0)
    edges = edges / norm(edges)[:, None]
    if closed:
        tangents = edges + np.roll(edges, 1, axis=0)
    else:
        tangents = np.concatenate([edges[:1], edges[:-1] + edges[1:], edges[-1:]])
    size = norm(tangents)
    back = np.flatnonzero(size < 1e-7)
    if back.size:
        raise ValueError(f"the curve turns back on itself at points[{back[0]}]: it has no tangent there")
    return edges, tangents / size[:, None]


def writhe_and_crossings(x: Array, closed: bool) -> tuple[float, float]:
    """Return the writhe of checked vertices, and their mean number of crossings."""
    total, size = (2 * found for found in gauss_integrals(x, x, closed=closed))
    edges, _ = directions(x, closed)
    if closed:
        half = (1 + total - float(solid_angle(edges)) / (2 * np.pi)) / 2
        if abs(half - round(half)) > _WHOLE:
            raise ValueError(
                "the curve runs through itself: its writhe does not fit the area that its tangents enclose, by "
                f"{2 * (half - round(half)):.9g}"
            )
    return total, size


def _twists(v: Array, edges: Array, tangents: Array, closed: bool) -> Array:
    """Twist along each edge, in turns, of normal vectors at the vertices."""
    ends, to = (np.roll(tangents, -1, axis=0), np.roll(v, -1, axis=0)) if closed else (tangents[1:], v[1:])
    begins = tangents if closed else tangents[:-1]
    w = _transported(_transported(v if closed else v[:-1], begins, edges), edges, ends)
    return np.arctan2(dot(to, np.cross(ends, w)), dot(to, w)) / (2 * np.pi)


def _transported(v: Array, a: Array, b: Array) -> Array:
    """Carry vectors normal to a to b by minimal rotations."""
    return np.stack(reflected(Vector(*v.T), Vector(*(a + b).T)), axis=1)


def gauss_integrals(a: Array, b: Array, *, closed: bool) -> tuple[float, float]:
    """Gauss integral of two polygons, or of the pairs of one, and that of its magnitude; the same for any threads."""
    total, sizes = np.zeros((2, len(a)))
    threads = max(1, min(cores(), len(a) // _ROWS))
    x, y = (np.ascontiguousarray((np.concatenate([one, one[:1]]) if closed else one).T) for one in (a, b))
    y = np.pad(y, ((0, 0), (0, SCRATCH)), mode="edge")
    numbers = np.arange(float(y.shape[1]))

    def part(first: int) -> None:
        work = np.empty((WORK, y.shape[1]))
        row_integrals(x, y, numbers, int(a is b), int(closed), first, threads, work, total, sizes)

    if threads == 1:
        part(0)
    else:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(part, range(threads)))
    return float(total.sum()), float(sizes.sum())


def _arctan_series(t: Any) -> Any:
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
            x = Vector(*(load_lanes(b[k], j) for k in range(3)))
            store_lanes(work[0], j, length(x - p))
            store_lanes(work[1], j, length(x - q))
        v = Variables(whole=0.0, size=0.0, angle=0.0)
        for j in loop(0, end, width()):
            x, y = (Vector(*(load_lanes(b[k], j + l) for k in range(3))) for l in (0, 1))
            (al, bl), (dl, cl) = ([load_lanes(work[k], j + l) for l in (0, 1)] for k in (0, 1))
            volume, lengths, ac = _dot(x - p, cross(q - p, y - x)), al * cl, _dot(x - p, y - q)
            one = bl * (lengths + ac) + _dot(x - p, y - p) * cl + _dot(y - p, y - q) * al
            other = dl * (lengths + ac) + _dot(x - p, x - q) * cl + _dot(y - q, x - q) * al
            up, along = -volume * (one + other), select(volume != 0.0, one * other - volume * volume, 1.0)
            number = load_lanes(numbers, j)
            is_pair = (number >= 1.0 * begin) & (number < 1.0 * end)
            is_small = (along > 0.0) & (abs(up) < _SMALL * along)
            v.angle = _arctan_series(select(is_small, up / along, 0.0))
            for _ in when(any_of(logical_not(is_small) & is_pair)):
                v.angle = select(is_small, v.angle, arctan2(up, along))
            angle = select(is_pair, v.angle, 0.0)
            v.whole, v.size = v.whole + angle, v.size + abs(angle)
        total[i], sizes[i] = (all_lanes(operator.add, x) / (2.0 * math.pi) for x in (v.whole, v.size))


def _dot(a: Vector, b: Vector) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
