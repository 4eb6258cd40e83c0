"""Non-twisting frames of sampled directors, holonomy, solid angle.

A frame d1, d2, d3 moves without twist when ``d1'.d2 = 0`` (eq-non-twisting). Its angular velocity is ``w = d3 x d3'``,
so ``d1' = -(d1.d3') d3``: d1 is transported along d3 by the parallel transport of the sphere
(eq-parallel-transport-2-sphere). Turned about d3 by an angle it gains that angle's rate as its twist rate (eq-w_twist);
hence two non-twisting frames of one path differ by a constant angle, and the whole error of a computed one is an angle
about d3.

**Order 2.** From sample to sample d1 is turned by the minimal rotation ``d_i -> d_{i+1}``, the transport along the
great circle between them: exact for geodesic polygons. A smooth path differs from its chord circle by a roll about d3,
equal to the area between the two, ``kappa l^3 / 12 + O(l^5)`` with the geodesic curvature kappa at the middle of the
segment of length l. The sum of the rolls is of order 2.

**Order 4.** After each minimal rotation that roll is made. At sample i, between chords l- and l+,

    kappa_i = 2 det(d_{i-1}, d_i, d_{i+1}) / (l- l+ (l- + l+))

is the curvature at the centroid of the three samples up to O(l^2). Linear interpolation between two centroids gives
kappa at the middle of the segment up to O(l^2); so the roll is right up to O(l^5) and the frame up to O(l^4), on any
sampling, without times. The first and the last segment of an open path extrapolate. Samples that repeat the one before,
exactly or nearly so (within 1e-50), take no part; where a chord a thousand times longer or shorter follows, only the
curvature at the other end of the segment is used.

**The error** of order 4, segment by segment. A curve of curvature kappa, kappa', kappa'' at the middle of a segment of
arc h has against its chord the roll and, at a node with the arcs a and b beside it, x from the middle, the curvature

    kappa h^3 / 12 + (kappa'' + 4 kappa - 2 kappa^3) h^5 / 480,
    kappa_i = kappa + c kappa' + (x^2/2 + x (b - a)/3 + (a^2 - a b + b^2)/12) kappa'' - a b/8 (kappa^3 + kappa),

with c = x + (b - a)/3, up to O(h^6) and O(h^3); the chord is h (1 - (1 + kappa^2) h^2/24). Hence with the weights w of
the interpolation, which cancel kappa', and sums over the two nodes

    e = h^3/12 (kappa'' sum w z - (kappa^3 + kappa) sum w a b/8) - h^5/96 (kappa^3 + kappa)
        + h^5/480 (2 kappa^3 - 4 kappa - kappa''),

where z is what stands by kappa''. Three curvatures in turn give kappa'' at their node; of those at both ends of a
segment the smaller one is taken, since where they differ much the samples resolve neither. The estimate is

    2 sqrt(max (sum e)^2 + sum e^2):

the sum is the error itself up to a higher order, with its sign; its largest value so far does not vanish where the
error changes sign, and the second part stands for the errors of the e, taken as independent. The estimate for order 2
adds the largest sum of the rolls, which order 2 leaves out.

The **holonomy** is the angle by which the frame returns turned from a closed path; it equals the enclosed **solid
angle**, counter-clockwise seen from outside counted positive, modulo 2 pi. A smooth path and the geodesic polygon of
its samples enclose different angles (2001 samples of the circle of colatitude 0.3: 4e-7): `holonomy` and `solid_angle`
mean the polygon, `closed_frame` with order 4 the smooth path. R. L. Bishop, Amer. Math. Monthly 82 (1975) 246-251, has
the frame.
"""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..kernels.vectors import Vector, cross
from .arrays import TOLERANCE, Array, as_direction, as_floats, principal_angle, refuse, require_finite
from .frame_kernels import ANTIPODAL
from .values import as_whole, require_among


def vectors(value: ArrayLike, name: str) -> Array:
    """Return `value` as a new array (..., n, 3) with n >= 1; a ValueError for any other shape."""
    array = as_floats(value, name)
    if array.ndim < 2 or array.shape[-1] != 3 or array.shape[-2] == 0:
        raise ValueError(f"{name} must have the shape (..., n, 3) with n >= 1, got {array.shape}")
    return array


def in_range(points: Array) -> Array:
    """Return points (m, n, 3), those of each member over a power of two, so that squares of distances are floats."""
    exponent = np.frexp(np.abs(points).max(axis=(1, 2), keepdims=True))[1]
    return np.ldexp(points, -exponent)


def indices_of(lead: tuple[int, ...], member: int, *samples: int) -> list[str]:
    """Index of `samples` in the argument of the caller, ``[member indices, sample]``."""
    front = [str(int(i)) for i in np.unravel_index(member, lead)] if lead else []
    return ["[" + ", ".join([*front, str(int(i))]) + "]" for i in samples]


def unit_directors(d3: ArrayLike, name: str = "d3", tolerance: float = TOLERANCE) -> tuple[Array, tuple[int, ...]]:
    """Check that `d3` (..., n, 3) are unit vectors and make them so to round-off.

    Returns
    -------
    (m, n, 3) array and the leading axes, whose product is m.

    Raises
    ------
    ValueError
        Another shape; an entry that is not finite or a vector that is not of unit length (the message names its index).
    """
    array = vectors(d3, name)
    lead = array.shape[:-2]
    u = array.reshape(-1, *array.shape[-2:])
    x, y, z = np.moveaxis(u, -1, 0)
    with np.errstate(over="ignore"):  # infinite is wrong, as is what is not a number
        size = np.sqrt(x * x + y * y + z * z)
    is_wrong = ~(np.abs(size - 1.0) <= tolerance)
    if is_wrong.any():
        k, i = np.argwhere(is_wrong)[0].tolist()
        require_finite(array, name)
        (at,) = indices_of(lead, k, i)
        raise ValueError(f"{name}{at} must be a unit vector, its length is {math.hypot(*u[k, i]):.12g}")
    u /= size[..., None]
    return u, lead


def first_d1(d1: ArrayLike | None, first: Array, lead: tuple[int, ...]) -> Array:
    """Return unit vectors (m, 3) orthogonal to `first` (m, 3), from `d1` (..., 3) or the coordinate axes, projected.

    Without `d1`: the coordinate axis least aligned with the first director (the first of equals), projected; so
    d3 = (0, 0, 1) has d1 = (1, 0, 0), d2 = (0, 1, 0).
    """
    if d1 is None:
        preferred = np.eye(3)[np.argmin(np.abs(first), axis=1)]
    else:
        given = as_floats(d1, "d1")
        try:
            preferred = np.broadcast_to(given, (*lead, 3)).reshape(-1, 3)
        except ValueError as error:
            raise ValueError(f"d1 must be one vector, or one for each member: shape {(*lead, 3)}") from error
        require_finite(given, "d1")
        largest = np.abs(preferred).max(axis=1, keepdims=True)
        preferred = preferred / np.where(largest > 0.0, largest, 1.0)
    start: Array = preferred - np.sum(preferred * first, axis=1, keepdims=True) * first
    size = np.linalg.norm(start, axis=1, keepdims=True)
    bad = size[:, 0] <= 1e-8 * np.linalg.norm(preferred, axis=1)
    refuse(bad.reshape(lead), "d1", "must not be zero or parallel to the first director")
    start /= size
    start -= np.sum(start * first, axis=1, keepdims=True) * first  # what round-off left, at most 1e-8
    return start


def triad_about(n: Array) -> Array:
    """Return the triad (3, 3), rows, with the third director n and the first of `first_d1`."""
    e1 = first_d1(None, n[None], ())[0]
    return np.stack([e1, np.cross(n, e1), n])


def frames_along(
    u: Array, lead: tuple[int, ...], d1: ArrayLike | None, rolls: tuple[Array, NDArray[np.int64]], period: int
) -> Array:
    """Frames (m, n, 3, 3) along the unit directors `u` (m, n, 3); warn of wide steps, refuse antipodal ones.

    Messages count samples modulo `period`, so that the closing side of a polygon ends at sample 0.
    """
    from .frame_kernels import transport_samples

    frames = np.empty((*u.shape, 3))
    k, a, b, far_k, far = transport_samples(u, first_d1(d1, u[:, 0], lead), *rolls, frames)
    if k >= 0:
        raise _antipodal(*indices_of(lead, k, a % period, b % period))
    if far >= 0:
        (at,) = indices_of(lead, far_k, far % period)
        message = f"d3{at} is more than a right angle from the sample before it: the path between the two is a guess"
        warnings.warn(message, stacklevel=3)
    return frames


def shaped(values: Array, lead: tuple[int, ...]) -> float | Array:
    """One value for each member: a float where there are no leading axes."""
    return values.reshape(lead) if lead else float(values[0])


MOST_TURNS = 10**9


def nontwisting_frame(d3: ArrayLike, d1: ArrayLike | None = None, *, order: int = 4) -> Array:
    """Return the non-twisting frames of sampled directors (eq-non-twisting).

    Parameters
    ----------
    d3 : (..., n, 3) array
        Unit vectors along the path, in any spacing. No times are needed: the frame depends on the path alone.
    d1 : (3,) or (..., 3) array, optional
        First vector of the first frame; its part orthogonal to ``d3[0]`` is normalised. Default: the coordinate axis
        least aligned with ``d3[0]``, the first of equals, so that the first frame for ``d3[0] = z`` is the identity.
    order : {4, 2}
        4 treats the samples as points of a smooth path; the error is O(spacing^4), at a corner O(spacing^2). 2 joins
        them by great circles: exact for geodesic polygons, and suited to a path with corners at its samples.

    Returns
    -------
    (..., n, 3, 3) array
        Rows d1, d2, d3 of each frame, orthonormal to round-off for paths of any length.

    Raises
    ------
    ValueError
        A director is not finite or not a unit vector within 1e-9 (the message states its index), neighbours are
        antipodal (within 1e-7 rad), d1 is parallel to ``d3[0]``, or `order` is neither 4 nor 2.

    Warns
    -----
    UserWarning
        Neighbours are more than a right angle apart.

    See Also
    --------
    frame_error_estimate : Estimated error angle of the frames.

    Examples
    --------
    Once around the circle of colatitude 60°, the frame returns turned by 2π (1 - cos 60°), half a turn:

    >>> import numpy as np
    >>> from nontwist.curves import nontwisting_frame
    >>> t, a = np.linspace(0, 2 * np.pi, 201), np.radians(60)
    >>> d3 = np.stack([np.sin(a) * np.cos(t), np.sin(a) * np.sin(t), np.full(201, np.cos(a))], axis=1)
    >>> frames = nontwisting_frame(d3)
    >>> round(float(frames[0, 0] @ frames[-1, 0]), 6)
    -1.0
    """
    u, lead = unit_directors(d3)
    frames = frames_along(u, lead, d1, rolls(u, order, closed=False), u.shape[1])
    return frames.reshape(*lead, *frames.shape[1:])


def closed_frame(
    d3: ArrayLike, d1: ArrayLike | None = None, *, order: int = 4, turns: int = 0, points: ArrayLike | None = None
) -> tuple[Array, float | Array]:
    """Return frames of a closed path that close: the holonomy is removed by a uniform twist along the path.

    The path returns from the last sample to the first, which may be repeated at the end. The frames twist uniformly, in
    total by minus the holonomy and by `turns` additional whole turns. Among the frames that close in this way, they
    have the least mean square twist rate per length. If `d3` are the tangents of a closed curve and `points` its
    points, they sweep a tube along the curve without a seam.

    Parameters
    ----------
    d3 : (..., n, 3) array
        Unit vectors along the closed path.
    d1 : (3,) or (..., 3) array, optional
        As in `nontwisting_frame`.
    order : {4, 2}
        4: the smooth closed path through the samples; 2: their geodesic polygon. The holonomies differ by O(spacing^2).
    turns : int
        Additional whole turns of the frames about d3, counter-clockwise positive.
    points : (..., n, 3) array, optional
        Points of a closed curve whose tangents are `d3`. The twist is then uniform along this curve instead of along
        the path of `d3` on the sphere.

    Returns
    -------
    frames : (..., n, 3, 3) array
        Rows d1, d2, d3 of each frame.
    holonomy : float or (...) array, rad, in (-pi, pi]
        Angle about ``d3[0]`` by which the non-twisting frame returns turned.

    Raises
    ------
    ValueError
        As `nontwisting_frame`, for the side from the last sample to the first as well; or `turns` is not a whole
        number, or `points` have another shape or are not finite.

    Warns
    -----
    UserWarning
        Neighbours are more than a right angle apart.

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist.curves import closed_frame
    >>> t, z = np.arange(200) * np.pi / 100, 0.75
    >>> d3 = np.stack([np.sqrt(1 - z**2) * np.cos(t), np.sqrt(1 - z**2) * np.sin(t), np.full(200, z)], axis=1)
    >>> frames, holonomy = closed_frame(d3)
    >>> round(float(np.degrees(holonomy)), 4)  # 360° (1 - 0.75)
    90.0
    """
    u, lead = unit_directors(d3)
    n = u.shape[1]
    turns = as_whole(turns, "turns", -MOST_TURNS, MOST_TURNS)
    along = u
    if points is not None:
        along = vectors(points, "points")
        if along.shape != (*lead, n, 3):
            raise ValueError(f"points must have the shape of d3, {(*lead, n, 3)}, got {along.shape}")
        require_finite(along, "points")
        along = in_range(along.reshape(u.shape))
    u, along = (np.concatenate([x, x[:, :1]], axis=1) for x in (u, along))
    frames = frames_along(u, lead, d1, rolls(u, order, closed=True), n)
    angle = _close(frames, along, 2 * np.pi * turns)
    return frames[:, :n].reshape(*lead, n, 3, 3), shaped(angle, lead)


def frame_error_estimate(d3: ArrayLike, *, order: int = 4) -> Array:
    """Return the estimated error angle of the frames of `nontwisting_frame`, from the samples alone.

    About twice the largest error so far, from the leading term of the error in each segment, plus an estimate of
    round-off. Motion that the samples do not resolve is not included. Two distinct samples are treated as a great
    circle; for up to four nodes the whole correction of order 4 serves as its error. Noise of the samples is included
    as far as noise looks like motion; `twist` estimates the effect of noise.

    It is an estimate, not a bound. For 1000 random smooth paths of each kind it was between 1 and 5 times the largest
    error in 98 % of cases for even steps of 1° to 15°, 98 % for steps that vary up to 1:6, 97 % for random ones, and 96
    % for sparse samples 7° to 20° apart, even or not; at order 4 the median was twice the error. At corners, which
    lower order 4 to order 2, it may be only half the error.

    Parameters
    ----------
    d3 : (..., n, 3) array
        Unit vectors along the path.
    order : {4, 2}

    Returns
    -------
    (..., n) array, rad
        Not decreasing along the path.

    Raises
    ------
    ValueError
        A director is not finite or not a unit vector within 1e-9 (the message states its index), or `order` is neither
        4 nor 2.

    Examples
    --------
    With twice as many samples, a sixteenth of the error:

    >>> import numpy as np
    >>> from nontwist.curves import frame_error_estimate
    >>> def path(n):
    ...     t = np.linspace(0, 2 * np.pi, n)
    ...     return np.stack([0.6 * np.cos(t), 0.6 * np.sin(t), np.full(n, 0.8)], axis=1)
    >>> coarse, fine = (frame_error_estimate(path(n))[-1] for n in (101, 201))
    >>> round(float(coarse / fine))
    16
    """
    u, lead = unit_directors(d3)
    return estimates(u, as_order(order)).reshape(*lead, u.shape[1])


def holonomy(d3: ArrayLike) -> float | Array:
    """Return the angle by which a non-twisting frame returns turned after the closed **geodesic polygon** `d3`.

    Exact for the polygon; for a smooth closed path through the samples use `closed_frame`.

    Parameters
    ----------
    d3 : (..., n, 3) array
        Unit vectors, the vertices. The last one is joined to the first, and may repeat it.

    Returns
    -------
    float or (...) array, rad, in (-pi, pi]
        Angle about ``d3[0]``, positive if counter-clockwise seen from outside: `solid_angle` modulo 2 pi.

    Raises
    ------
    ValueError
        A vertex is not finite or not a unit vector within 1e-9, or neighbours are antipodal (the message states the
        index).

    Examples
    --------
    Around an octant of the sphere the frame turns by a right angle:

    >>> import numpy as np
    >>> from nontwist.curves import holonomy
    >>> round(float(np.degrees(holonomy([[1, 0, 0], [0, 1, 0], [0, 0, 1]]))), 9)
    90.0
    """
    angle = principal_angle(solid_angle(d3))
    return angle if angle.ndim else float(angle)


def solid_angle(d3: ArrayLike, *, pole: ArrayLike | None = None) -> float | Array:
    """Return the solid angle of the closed **geodesic polygon** `d3`, positive if counter-clockwise seen from outside.

    The solid angle of a closed path on the sphere is defined modulo 4 pi: the area to its left is one value, the area
    to its right, counted negative, another. It is computed by multiplying the minimal rotations along the sides as unit
    quaternions: the relative accuracy is that of round-off even for tiny polygons, and no point of the sphere is
    special. With `pole` the total is returned.

    Parameters
    ----------
    d3 : (..., n, 3) array
        Unit vectors, the vertices. The last one is joined to the first, and may repeat it.
    pole : (3,) array, optional
        A direction, of any length. Every area then counts as often as the polygon winds around it, with ``-pole``
        outside: k turns along the circle of colatitude a about the pole give 2 pi k (1 - cos a).

    Returns
    -------
    float or (...) array, sr
        In (-2 pi, 2 pi] without `pole`; the total with it.

    Raises
    ------
    ValueError
        A vertex is not finite or not a unit vector within 1e-9, neighbours are antipodal, a side passes through
        ``-pole`` (the message states the index), or the pole has no direction.

    Notes
    -----
    The sum of the triangles from the pole to the sides (A. Van Oosterom, J. Strackee, IEEE Trans. Biomed. Eng. 30
    (1983) 125-126) is used only to determine the multiple of 4 pi.

    Examples
    --------
    >>> from nontwist.curves import solid_angle
    >>> x, y, z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
    >>> round(solid_angle([x, y, z]), 6)  # an octant, 4π/8
    1.570796
    >>> square = [x, y, (-1, 0, 0), (0, -1, 0)]
    >>> round(solid_angle(2 * square, pole=z), 6)  # twice around a half of the sphere
    12.566371
    """
    from .frame_kernels import solid_angles

    u, lead = unit_directors(d3)
    n = u.shape[1]
    area = np.empty(len(u))
    k, i = solid_angles(u, area)
    if k >= 0:
        raise _antipodal(*indices_of(lead, k, (i - 1) % n, i))
    if pole is not None:
        a, b = Vector(*np.moveaxis(u, -1, 0)), Vector(*np.moveaxis(np.roll(u, -1, axis=1), -1, 0))
        p = Vector(*as_direction(pole, "pole", "space"))
        det, rest = cross(a, b) @ p, 1.0 + (a + b) @ p + a @ b
        is_through = (np.abs(det) <= ANTIPODAL) & (rest <= ANTIPODAL)
        if is_through.any():
            k, i = np.argwhere(is_through)[0].tolist()
            one, other = indices_of(lead, k, i, (i + 1) % n)
            raise ValueError(f"the side from d3{one} to d3{other} runs through -pole: choose another pole")
        total = 2.0 * np.arctan2(det, rest).sum(axis=-1)
        area += 4 * np.pi * np.round((total - area) / (4 * np.pi))
    return shaped(area, lead)


def _antipodal(one: str, other: str) -> ValueError:
    return ValueError(f"d3{one} and d3{other} are antipodal: the shortest path between them is not unique")


def _close(frames: Array, points: Array, angle: float) -> Array:
    """Turn the frames back about d3 by the holonomy, in proportion to the length of `points`: the last meets the first.

    ``frames[:, -1]`` has the same director as ``frames[:, 0]``. The frames turn forward by `angle` besides, a number of
    whole turns. Returns the holonomy (m,).
    """
    (d1, d2), last = frames[:, 0, :2].swapaxes(0, 1), frames[:, -1, 0]
    found: Array = np.arctan2((last * d2).sum(axis=-1), (last * d1).sum(axis=-1))
    found[found <= -np.pi] = np.pi
    path = np.zeros(points.shape[:2])
    path[:, 1:] = np.cumsum(np.linalg.norm(np.diff(points, axis=1), axis=-1), axis=1)
    total = path[:, -1:]
    share = (angle - found)[:, None] * np.divide(path, total, out=np.zeros_like(path), where=total > 0.0)
    c, s = np.cos(share)[..., None], np.sin(share)[..., None]
    d1, d2 = frames[:, :, 0], frames[:, :, 1]
    frames[:, :, 0], frames[:, :, 1] = c * d1 + s * d2, c * d2 - s * d1
    return found


def estimates(u: Array, order: int) -> Array:
    """Estimated largest errors so far (m, n) of the frames along the unit directors `u` (m, n, 3)."""
    from .path_kernels import error_angles

    found = np.empty(u.shape[:2])
    error_angles(u, order, found)
    # What is known of the error up to a later sample holds for those before.
    return np.minimum.accumulate(found[:, ::-1], axis=1)[:, ::-1]


def rolls(u: Array, order: int, *, closed: bool) -> tuple[Array, NDArray[np.int64]]:
    """Roll on arriving at each sample, and which samples are nodes: at order 2 all, without roll."""
    from .frame_kernels import smooth_rolls

    roll, node = np.zeros(u.shape[:2]), np.ones(u.shape[:2], dtype=np.int64)
    if as_order(order) == 4:
        n = u.shape[1]
        smooth_rolls(u, int(closed), roll, node, np.empty(n, dtype=np.int64), np.empty((3, n)))
    return roll, node


def as_order(order: Any) -> int:
    """Return the order of frames; a ValueError where it is neither 2 nor 4."""
    require_among(order, "order", (2, 4))
    return int(order)
