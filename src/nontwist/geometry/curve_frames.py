"""Non-twisting frames of more than samples of d3: a function d3(t), or a curve with its tangents.

**A function.** On a subinterval cut into m equal steps of time, the frame turns relative to the great circle
through the ends by the area between path and great circle. The geodesic polygon through the m + 1 samples has that area
up to a series in even powers of 1/m, for transport along a geodesic and back is the identity. Polygons of 1, 2, 4 and 8
sides extrapolated to none (Richardson, Romberg) give it to order 8, the difference from the order-6 value serves as the
error, and subintervals are halved until the sum of the errors is within the tolerance. Those at a kink are halved until
it fits; at a jump they cannot.

**A curve.** Double reflection (W. Wang, B. Juettler, D. Zheng, Y. Liu, ACM Trans. Graph. 27 (2008) 2): reflect the
frame in the plane that bisects the chord, then in the one that takes the reflected tangent to the next tangent. Order
4, since the positions contain the curvature that `frames` estimates from neighbouring directors (eq-non-twisting
holds in both).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arrays import TOLERANCE, Array, as_array, as_positive, refuse, require_finite
from .frames import first_d1, frames_along, in_range, indices_of, unit_directors, vectors
from .values import as_function

_SUBINTERVALS = 32  # at least, at the start
_EVALUATIONS = 1_000_000  # at most, after the start
_ROUND_OFF = 1e-16  # rad, of a single angle
_JUMP = 1e-6  # rad; a smaller jump turns the frame by 1e-12 at most
_STEP = np.arange(9) / 8


def frame_along(
    function: Callable[[float], ArrayLike], times: ArrayLike, d1: ArrayLike | None = None, rtol: float = 1e-10
) -> Array:
    """Return the non-twisting frames of a function d3(t) at the given times, to a tolerance.

    Parameters
    ----------
    function : callable
        ``function(t)`` returns the unit vector d3, shape (3,), for a float t between the first and the last of `times`.
    times : (n,) array, increasing
    d1 : (3,) array, optional
        First vector of the first frame, as in `nontwisting_frame`.
    rtol : float, rad
        Bound for the estimated error angle about d3 at the last time, and thus at every other.

    Returns
    -------
    (n, 3, 3) array
        Rows d1, d2, d3 of each frame.

    Raises
    ------
    ValueError
        Times do not increase, or a value of `function` is not a unit vector within 1e-9 (the message states its time).
    RuntimeError
        The tolerance cannot be met, as at a jump of d3 or near round-off; the message states the estimated error and
        its place.

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist.curves import frame_along
    >>> first, last = frame_along(lambda t: (0.6 * np.cos(t), 0.6 * np.sin(t), 0.8), [0, 2 * np.pi])
    >>> angle = np.arctan2(last[0] @ first[1], last[0] @ first[0])
    >>> round(float(np.degrees(angle)), 6)  # 360° (1 - 0.8)
    72.0
    """
    function, t = as_function(function, "function"), as_array(times, "times", (None,))
    if t.size == 0 or np.any(np.diff(t) <= 0):
        raise ValueError("times must increase, and there must be at least one")
    tolerance = float(as_positive(rtol, "rtol", (), "rad"))

    # Unequal subintervals: no period of the function fits all of them.
    subintervals = max(2, -(-_SUBINTERVALS // max(1, t.size - 1)))
    cuts = t[:-1, None] + np.diff(t)[:, None] * (np.arange(subintervals) / subintervals) ** 1.2
    knots = np.append(cuts.ravel(), t[-1])
    grid = knots[:-1, None] + np.diff(knots)[:, None] * _STEP
    u = np.empty((*grid.shape, 3))
    u[:, :-1] = _evaluate(function, grid[:, :-1].ravel()).reshape(len(grid), 8, 3)
    last = _evaluate(function, t[-1:])
    u[:, -1] = np.concatenate([u[1:, 0], last])
    evaluations_left = _EVALUATIONS if tolerance >= _ROUND_OFF else 0

    while True:
        angle, error = _subinterval_angles(u)
        if error.sum() <= tolerance:
            break
        coarse = error > 0.5 * tolerance / error.size
        worst = int(np.argmax(error))
        width = grid[worst, -1] - grid[worst, 0]
        evaluations_left -= 8 * int(coarse.sum())
        if evaluations_left < 0 or width < 1e3 * np.spacing(np.abs(grid[worst]).max()):
            raise RuntimeError(
                f"frame_along cannot meet rtol = {tolerance:.1e}: the estimated error is {error.sum():.1e} rad, "
                f"{error[worst]:.1e} of it near t = {float(grid[worst, 0])!r}; is d3 continuous there?"
            )
        grid, u = _halve(function, grid, u, coarse)

    knots = np.append(grid[:, 0], t[-1])
    chain = np.concatenate([u[:, 0], last])[None]
    roll = np.append(0.0, angle)[None]
    frames = frames_along(chain, (), d1, (roll, np.ones(roll.shape, dtype=np.int64)), roll.size)
    return frames[0, np.searchsorted(knots, t)]


def _evaluate(function: Callable[[float], ArrayLike], times: Array) -> Array:
    u = np.empty((times.size, 3))
    for i, t in enumerate(times):
        u[i] = as_array(function(float(t)), f"function({float(t)!r})", (3,), np.inf)
    length = np.sqrt(np.sum(u * u, axis=1))
    bad = np.flatnonzero(~(np.abs(length - 1.0) <= TOLERANCE))
    if bad.size:
        i = int(bad[0])
        raise ValueError(f"function({float(times[i])!r}) must be a unit vector, got {u[i].tolist()}")
    u /= length[:, None]
    return u


def _subinterval_angles(u: Array) -> tuple[Array, Array]:
    """Angle of each subinterval (k, 9, 3) against the great circle through its ends, and the estimated error.

    Infinite where the subinterval is too long, or where one of eight steps covers nearly all of it.
    """
    row = [np.zeros(len(u))]
    best = row
    for stride in (4, 2, 1):
        previous, row = row, [_polygon_areas(u[:, ::stride])]
        for p, value in enumerate(previous, start=1):
            row.append(row[-1] + (row[-1] - value) / (4.0**p - 1.0))
        best = [best[-1], row[-1]]
    reach = np.einsum("kx,kjx->kj", u[:, 0], u).min(axis=1)
    steps = np.sqrt(np.sum(np.diff(u, axis=1) ** 2, axis=2))
    largest = steps.max(axis=1)
    jump = (largest > 0.9 * steps.sum(axis=1)) & (largest > _JUMP)
    angle: Array = row[-1]
    error: Array = np.where((reach > 0.5) & ~jump, np.abs(best[1] - best[0]), np.inf)
    return angle, error


def _polygon_areas(u: Array) -> Array:
    """Signed area of the polygons `u` (k, n, 3), triangles from the first vertex."""
    a, b, c = u[:, :1], u[:, 1:-1], u[:, 2:]
    det = np.sum(b * np.cross(b - a, c - b), axis=2)
    return np.sum(2.0 * np.arctan2(det, 1.0 + np.sum(a * b + b * c + c * a, axis=2)), axis=1)


def _halve(
    function: Callable[[float], ArrayLike], grid: Array, u: Array, coarse: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Cut the subintervals marked `coarse` in two; the nine samples of each are kept."""
    middle = 0.5 * (grid[coarse, :-1] + grid[coarse, 1:])
    middle_u = _evaluate(function, middle.ravel()).reshape(*middle.shape, 3)
    fine, fine_u = np.empty((len(middle), 17)), np.empty((len(middle), 17, 3))
    fine[:, ::2], fine[:, 1::2], fine_u[:, ::2], fine_u[:, 1::2] = grid[coarse], middle, u[coarse], middle_u
    grid = np.concatenate([grid[~coarse], fine[:, :9], fine[:, 8:]])
    order = np.argsort(grid[:, 0])
    return grid[order], np.concatenate([u[~coarse], fine_u[:, :9], fine_u[:, 8:]])[order]


def frame_of_curve(points: ArrayLike, tangents: ArrayLike, d1: ArrayLike | None = None) -> Array:
    """Return the non-twisting (rotation-minimising) frames of a sampled space curve, by double reflection.

    Parameters
    ----------
    points : (..., n, 3) array
        Positions along a smooth curve, in any unit of length.
    tangents : (..., n, 3) array
        Tangents at these points, of any length but zero. They must be exact: finite differences lower the order to 2.
    d1 : (3,) or (..., 3) array, optional
        First vector of the first frame, as in `nontwisting_frame`.

    Returns
    -------
    (..., n, 3, 3) array
        Rows d1, d2, d3 of each frame, d3 the unit tangent. Error O(spacing^4).

    Raises
    ------
    ValueError
        Shapes differ, an entry is not finite, a tangent has length zero, the chord of a step reverses the tangent (the
        message states the index), or d1 is parallel to the first tangent.

    Examples
    --------
    One turn of a helix that rises at 45°: relative to the Frenet frame the frame turns by -∫ τ ds = -√2 π:

    >>> import numpy as np
    >>> from nontwist.curves import frame_of_curve
    >>> t = np.linspace(0, 2 * np.pi, 201)
    >>> points = np.stack([np.cos(t), np.sin(t), t], axis=1)
    >>> tangents = np.stack([-np.sin(t), np.cos(t), np.ones(201)], axis=1)
    >>> first, *_, last = frame_of_curve(points, tangents)
    >>> angle = np.arctan2(last[0] @ first[1], last[0] @ first[0]) - 2 * np.pi
    >>> round(float(angle / np.pi), 4)
    -1.4142
    """
    from .frame_kernels import double_reflection

    x, given = vectors(points, "points"), vectors(tangents, "tangents")
    if x.shape != given.shape:
        raise ValueError(f"points and tangents must have the same shape, got {x.shape} and {given.shape}")
    require_finite(x, "points")
    require_finite(given, "tangents")
    size = np.abs(given).max(axis=-1, keepdims=True)
    refuse(size[..., 0] == 0, "tangents", "must not be zero")
    given /= size
    u, lead = unit_directors(given / np.linalg.norm(given, axis=-1, keepdims=True), "tangents")
    frames = np.empty((*u.shape, 3))
    k, i = double_reflection(in_range(x.reshape(u.shape)), u, first_d1(d1, u[:, 0], lead), frames)
    if k >= 0:
        one, other = indices_of(lead, k, i - 1, i)
        raise ValueError(f"from tangents{one} to tangents{other} the chord of the points reverses the direction")
    return frames.reshape(*x.shape, 3)
