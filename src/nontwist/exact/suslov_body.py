"""The free Suslov body: W·n = 0 for a body axis n, principal or not (Suslov 1946; Bloch, Nonholonomic Mechanics, §8).

With n = e3 and the axes e1, e2 chosen so that J12 = 0, the balance ``J W' = J W × W - μ n`` reads in the plane

    J11 W1' = -W2 M3,      J22 W2' = W1 M3,      M3 = J13 W1 + J23 W2:

the energy is kept. Put (√J11 W1, √J22 W2) = √(2K) a with a unit vector a, and (J13/√J11, J23/√J22) = c b with a unit
vector b. The angle θ from b to a obeys θ' = A cos θ, A = c √(2K/(J11 J22)), hence

    sin θ = tanh y,   cos θ = sgn(cos θ0)/cosh y,   y = A t + y0,   y0 = asinh(sin θ0/|cos θ0|):

every motion goes from the permanent rotation a = -b⊥ to a = b⊥, b⊥ = b turned by a right angle; a = ±b⊥ stays, and for
A = 0 (n principal) all stay. The attitude Λ' = Λ Ŵ(t) is a quadrature on SO(3): Magnus steps of order 6 with the
velocity in closed form (Blanes, Casas, Oteo & Ros 2009), in the order of brackets that Λ' = ΛŴ asks for, exact where W
is constant.

**Settled.** W differs from the permanent rotation ±B1, B1 = √(2K) b⊥ in the plane, by at most
w (2 e^-|y| + 2 e^-2|y|), w ≥ |W| the largest rate. What this adds to the turn beyond |y| = Y is below 3 (w/A) e^-Y rad,
and below round-off of the attitude, ε/4, for

    Y = ln(12 w/(A ε)).

Beyond |y| = Y, on either side, one exponential of ±B1 does; its error is the round-off of its angle, ε times the turn.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..engine.marching import magnus, turned_by_vector
from ..geometry.arrays import EPS, Array, as_direction
from ..kernels.control import Variables, loop
from ..kernels.elements import cosh, real, select, sqrt, tanh
from ..kernels.kernel import kernel
from ..kernels.memory import matrix_at, put, vector_at
from ..kernels.vectors import Matrix, Quaternion, attitude
from ..models.system import checked_inertia
from .free_bodies import TOO_FAR, Motion, as_times, checked_attitude, checked_velocity, without_spin
from .free_constants import FARTHEST

# Largest A h and |W| h of a Magnus step: the local error is at most 3e-5 times its seventh power (400 random bodies).
_TURN = 0.02


class _Plane(NamedTuple):
    """W = B[0]/cosh y + B[1] tanh y with y = A t + y0, and the largest rate."""

    B: Array  # (2, 3)
    y0: float
    A: float
    fastest: float


def suslov_velocity(
    inertia: ArrayLike,
    axis: ArrayLike,
    material_angular_velocity: ArrayLike,
    times: ArrayLike,
    *,
    physical: bool = True,
) -> Array:
    """Angular velocity of the free Suslov body, in closed form.

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Convected inertia J about the fixed point.
    axis : (3,) array, or "x", "y", "z", "-x", "-y", "-z"
        n, any length but 0.
    material_angular_velocity : (3,) array, rad/s
        W at t = 0, with W·n = 0 (to 1e-9).
    times : (k,) array, s
        In any order, negative ones included.
    physical : bool
        As in `nontwist.standard`.

    Returns
    -------
    (k, 3) array, rad/s
        W in the body. Accuracy: round-off times 1 + A |t|, and at most the effect of one ulp of W near the rotation
        at the start.

    Raises
    ------
    ValueError
        As `nontwist.suslov`; a velocity along the axis; a wrong shape, not finite.

    Examples
    --------
    >>> from nontwist import exact
    >>> J = [[2, 0, 0.3], [0, 2.5, -0.2], [0.3, -0.2, 3]]
    >>> exact.suslov_velocity(J, (0, 0, 1), (-1, 0.4, 0), [0, 100])[:, :2].round(3)  # to a steady rotation
    array([[-1.   ,  0.4  ],
           [ 0.561,  0.842]])
    """
    motion = _motion(inertia, axis, material_angular_velocity, physical)
    y = motion.A * as_times(times) + motion.y0
    return np.stack([1 / np.cosh(np.clip(y, -700, 700)), np.tanh(y)], axis=1) @ motion.B


def suslov(
    inertia: ArrayLike,
    axis: ArrayLike,
    material_angular_velocity: ArrayLike,
    times: ArrayLike,
    rotation: Any = None,
    *,
    physical: bool = True,
) -> Motion:
    """Motion of the free Suslov body: velocity in closed form, attitude by quadrature.

    Parameters
    ----------
    inertia, axis, material_angular_velocity, times, physical
        As in `suslov_velocity`.
    rotation : (3, 3) array or scipy Rotation, optional
        Λ at t = 0, body to space; the identity by default.

    Returns
    -------
    attitude, material_angular_velocity
        As of `free_standard`. Accuracy of the attitude until W is steady: 1e-12 over a thousand radians, in steps of
        0.02 rad from one of the times to the next; from then on round-off of the turn, 1e-15 times its angle, in one
        step.

    Raises
    ------
    ValueError
        As `suslov_velocity`, for a rotation that is none, and for a time by which the body turns by more than 1e15 rad.

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist import exact
    >>> J = np.array([[2, 0, 0.3], [0, 2.5, -0.2], [0.3, -0.2, 3]])
    >>> attitude, W = exact.suslov(J, (0, 0, 1), (-1, 0.4, 0), [0, 5, 100])
    >>> (np.einsum("ki,ij,kj->k", W, J, W) / 2).round(9)  # the energy
    array([1.2, 1.2, 1.2])
    """
    motion = _motion(inertia, axis, material_angular_velocity, physical)
    t, R = as_times(times), checked_attitude(rotation)
    if motion.fastest * abs(t).max(initial=0.0) > FARTHEST:
        raise ValueError(TOO_FAR)
    attitudes = np.empty((len(t), 3, 3))
    for part in (t >= 0, t < 0):  # forwards and backwards from 0
        ends, steps = _schedule(motion, t[part])
        found = np.empty((len(ends), 3, 3))
        _set_attitudes(R, *motion[:3], ends, steps, found)
        attitudes[part] = found[np.searchsorted(abs(ends), abs(t[part]))]
    return attitudes, suslov_velocity(inertia, axis, material_angular_velocity, times, physical=physical)


def _schedule(motion: _Plane, t: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return the ends of intervals from 0 through `t`, of one sign, and the Magnus steps in each: 0 if W is steady."""
    _, y0, A, fastest = motion
    window = np.full(2, -y0)
    if A > 0 and math.isfinite(y0):
        Y = math.log(12 * fastest / (A * EPS))
        window = np.array([(-Y - y0) / A, (Y - y0) / A])
    sign = -1.0 if t.min(initial=0.0) < 0 else 1.0
    inner = sign * window
    inner = inner[(inner > 0) & (inner < abs(t).max(initial=0.0))]
    ends = sign * np.unique(np.concatenate([[0.0], abs(t), inner]))
    gaps = np.diff(ends, prepend=0.0)
    middle = ends - gaps / 2
    steps = np.ceil(abs(gaps) * max(fastest, A) / _TURN)
    steps[(middle < window[0]) | (middle > window[1])] = 0
    return ends, steps.astype(np.int64)


def _motion(inertia: ArrayLike, axis: ArrayLike, velocity: ArrayLike, physical: bool = True) -> _Plane:
    """Return the motion in the plane; the sign of cos θ is in B[0]. A constant W has A = 0 and y0 = ∞."""
    n = as_direction(axis, "axis")
    J = checked_inertia(inertia, physical, n)
    W = without_spin(checked_velocity(velocity), n)
    plane = np.linalg.svd(n[None])[2][1:]
    moments, vectors = np.linalg.eigh(plane @ J @ plane.T)
    plane = vectors.T @ plane  # rows e1, e2
    if np.cross(plane[0], plane[1]) @ n < 0:
        plane[1] *= -1
    root = np.sqrt(moments)
    a, b = root * (plane @ W), plane @ J @ n / root
    speed, c = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    if speed == 0 or c <= 1e-15 * float(root.max()):
        return _Plane(np.stack([0 * W, W]), math.inf, 0.0, float(np.linalg.norm(W)))
    a, b = a / speed, b / c
    cosine, sine = float(a @ b), float(b[0] * a[1] - b[1] * a[0])
    y0 = math.asinh(sine / abs(cosine)) if cosine else math.copysign(math.inf, sine)
    ends = np.array([math.copysign(1.0, cosine) * b, [-b[1], b[0]]])
    return _Plane(speed * (ends / root) @ plane, y0, c * speed / float(root.prod()), speed / float(root.min()))


def _turn(B: Matrix, y: Any, A: Any, h: Any, is_steady: Any) -> Any:
    """Return the rotation vector of a Magnus step with y in the middle, ``W = B[0]/cosh y + B[1] tanh y``."""
    reach = select(is_steady, 0.0, A * math.sqrt(0.15) * h)
    return magnus(h, [1.0 / cosh(x) * B[0] + tanh(x) * B[1] for x in (y - reach, y, y + reach)])


@kernel("f8[:, :], f8[:, :], f8, f8, f8[:], i8[:], f8[:, :, :]")
def _set_attitudes(R: Any, B: Any, y0: Any, A: Any, times: Any, steps: Any, out: Any) -> None:
    """Set Λ at `times`, of one sign, by ``steps[k]`` Magnus steps from the one before, an exponential where it is 0."""
    start, plane = matrix_at(R), Matrix(vector_at(B[0]), vector_at(B[1]))
    v = Variables(q=Quaternion(1.0, 0.0, 0.0, 0.0), now=0.0)
    for k in loop(times.shape[0]):
        is_steady = steps[k] == 0
        count = select(is_steady, 1, steps[k])
        h = (times[k] - v.now) / real(count)
        for i in loop(count):
            q = turned_by_vector(v.q, _turn(plane, A * (v.now + (real(i) + 0.5) * h) + y0, A, h, is_steady))
            v.q = q / sqrt(q[0] * q[0] + q.vector @ q.vector)
        v.now = times[k]
        for a, row in enumerate(start @ attitude(v.q)):
            put(out[k, a], row)
