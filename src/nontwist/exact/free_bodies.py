"""Free motion: no moment about the fixed point, attitude included, at any times.

**Non-twisting body** (eq-nonholonomic). Π_⊥' = 0, so W = J_⊥⁻¹ Π_⊥ is constant and Λ = Λ0 exp(t Ŵ).

**Standard body** (eq-standard). The momentum is fixed in space, and in the body M' = M × W (Landau & Lifshitz,
Mechanics, §37; Whittaker, Analytical Dynamics, §69; Celledoni, Fassò, Säfström & Zanna 2008). With the principal
moments I1 <= I2 <= I3

    r1² = I1 (I3 - I2) / (I2 (I3 - I1)),       r3² = I3 (I2 - I1) / (I2 (I3 - I1)),       r1² + r3² = 1.

The planes |M3| r1 = |M1| r3 are the separatrix, 2K I2 = |M|². Beside it M circles the axis 3 where |M3| r1 is the
greater, else the axis 1. Call that axis z, the other x, the middle one y, right-handed and with Mx, Mz >= 0, and let
|M| = 1 for the lengths below. Then M = (ax cn u, (ax/rx) sn u, az dn u), u = u0 + λ t, where

    ax² = Mx² + rx² My²,     az² = Mz² + rz² My²,     λ = |M| δ az rx,     δ = 1/Ix - 1/Iz,
    k = ax rz/(az rx),       k'² = (Mz² rx² - Mx² rz²)/(az rx)².

All but k'² are sums of squares: the only cancellation is that of the problem itself. M/|M| and a
pole, a principal axis, make a frame that turns about the momentum: for the pole z and x

    ψ_z' = |M| (1/Iz + δ/(1 + N sn² u)),  N = (rz/rx)²,       ψ_x' = |M| (1/Ix - δ/(1 + N sn² u)),  N = (ax/az)².

Write N = k² sc²(a, k'): then sn(a_x, k') = rx, sn(a_z, k') = az, a_x + a_z = K', and Jacobi's form of the third
integral is free of every factor, since |M| δ sn cn/dn(a, k') = λ: with Jacobi's zeta function Z(i a, k) = i ζ(a)

    ψ_z = t (|M|/Ix - λ ζ(a_z)) + arg θ4(π (u + i a_z)/2K),      ψ_x = t (|M|/Iz + λ ζ(a_x)) - arg θ4(π (u + i a_x)/2K),

each from its value at t = 0. The pole is z where rx >= rz, else x: then N and the poles stay harmless at every M, also
where M meets the axis z. For k² > 1/2 Jacobi's imaginary transformation turns θ4 into θ2 of nome q(k') and ζ(a) into dn
sc - Z(a, k'):

    ψ_z = t (|M| (ax²/Ix + az²/Iz) + λ Z(a_z, k')) + n π a_z/K' + arg θ2(π (a_z - i u)/2K'),      u reduced by 2 n K,

and with 1/Iy and the other signs for x. At k' = 0 (the separatrix) K is infinite and the formulas are hyperbolic; at rz
= 0 (two equal moments) k = 0; at the middle axis u0 is infinite; equal moments and rest make λ = 0. No branch needs a
series of its own. Work: one evaluation of each theta function, three harmonics and one exponential or one sine and
cosine.

Accuracy: on every branch a few times the effect of one ulp of the input, and not below 1e-15 per radian turned. All
states are the start and an increment (`free_step`). Chained calls with |λ t| <= 1/2, each from the state that the last
one returned, do not drift: the rounding of that state to double precision remains, which grows like the square root of
their number. Each longer call may change K and |π| by a relative 3e-17 in one direction: 3e-11 in 10⁶ calls.

**Kernels.** `free_top` gives rotations, `free_members`, which the integrator calls, quaternions, at several times side
by side. All states are the start and increments (`free_step`). Chained calls must not drift: each starts from an
orthonormal attitude, and adds to W what the motion changes it by, ``W + Vᵀ ΔP/I`` along the principal axes V, so that
neither the round-off of V, which would multiply W by Vᵀ V at every call, nor a normalisation of the momentum adds up.

All closed-form solutions check their arguments by the functions at the beginning.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..geometry import rotations
from ..geometry.arrays import Array, as_array, as_floats
from ..kernels.control import Variables, loop, when
from ..kernels.elementary import sine_and_cosine
from ..kernels.elements import any_of, copysign, logical_not, select, smaller, sqrt
from ..kernels.kernel import kernel
from ..kernels.machine_code import lanes_of_text
from ..kernels.memory import View, matrix_at, put, scratch, vector_at
from ..kernels.vectors import Matrix, Quaternion, Vector, cross, sum_of
from ..models.bodies import D3
from ..models.system import SYMMETRY, checked_inertia, require_principal
from .free_constants import BAD_TIME, CONSTANTS, FARTHEST, OK, Constants, jacobi_axes, to_orthonormal
from .free_step import FreeMotion, free_motion, free_until, set_origin

SPIN = 1e-9
Motion = tuple[Array, Array]


def checked_attitude(rotation: Any) -> Array:
    """Return the initial attitude Λ (3, 3), of a matrix or an object with `as_matrix`; ValueError for no rotation."""
    if rotation is None:
        return np.eye(3)
    R = as_array(rotation.as_matrix() if hasattr(rotation, "as_matrix") else rotation, "rotation", (3, 3))
    if not rotations.is_rotation(R):
        raise ValueError("rotation is not a rotation (orthonormal, right-handed)")
    return R


def checked_velocity(value: ArrayLike) -> Array:
    """Return the material angular velocity W (3,), rad/s."""
    return as_array(value, "material_angular_velocity", (3,))


def as_times(times: ArrayLike) -> Array:
    """Return the times (k,), s; a single one as (1,)."""
    return as_array(as_floats(times, "times", 1), "times", (None,))


def without_spin(W: Array, axis: Array) -> Array:
    """Return `W` without its round-off along the constrained `axis`; ValueError where it is more than that."""
    spin = float(W @ axis)
    if abs(spin) > SPIN * float(np.linalg.norm(W)):
        raise ValueError(
            f"material_angular_velocity has the component {spin:.6g} rad/s along the constrained body axis "
            f"{np.round(axis, 12).tolist()}"
        )
    return W - spin * axis


def planar(inertia: ArrayLike, velocity: ArrayLike, physical: bool) -> tuple[Array, Array]:
    """Return J (3, 3) and W of a non-twisting body, D3 principal to the last bit (eq-irho-decomp)."""
    J = checked_inertia(inertia, physical, D3)
    require_principal(J, D3)
    J[:2, 2] = J[2, :2] = 0.0
    return J, without_spin(checked_velocity(velocity), D3)


Displacement = Callable[
    [Any], tuple[Any, Any, Any, Vector]
]  # from the time to a status, W, and cosm1 and v of the turn


def _prepared(J: Matrix, W: Vector, c: View) -> tuple[Matrix, Vector, FreeMotion]:
    """Set the constants; return the principal axes and moments, and the motion."""
    V, I = jacobi_axes(J)
    motion = free_motion(I, I * (V @ W), c)
    set_origin(motion, c)
    return V, I, motion


@kernel("f8[:, :], f8[:] -> f8, f8")
def momentum_cycle(J: Any, W: Any) -> tuple[Any, Any]:
    """Return the time in which the momentum returns in the body, infinite where it does not, and what ψ gains in it."""
    c = View(Constants, scratch(CONSTANTS))
    _prepared(matrix_at(J), vector_at(W), c)
    returns = (c.pace != 0.0) & (c.two_k < math.inf) & (abs(c.u0) < math.inf)
    T = select(returns, 2.0 * c.two_k / abs(c.pace), math.inf)
    return T, select(returns, c.rate * T + copysign(2.0, c.pace) * c.per_turn, 0.0)


def _free(J: Matrix, W: Vector) -> Displacement:
    """Return what moves a free body."""
    c = View(Constants, scratch(CONSTANTS))
    V, I, motion = _prepared(J, W, c)
    D = Matrix(*(row / moment for row, moment in zip(V, I, strict=True)))  # ΔW = ΔP D

    def displacement(t: Any) -> tuple[Any, Any, Any, Vector]:
        status, dP, cosm1, v = free_until(motion, t, c)
        return status, W + dP @ D, cosm1, v @ V

    return displacement


def _steady_rotation(W: Vector) -> Displacement:
    """Return what turns a body about the constant W."""
    rate = sqrt(W @ W)

    def displacement(t: Any) -> tuple[Any, Any, Any, Vector]:
        half = 0.5 * rate * t
        quarter, is_far = sine_and_cosine(0.5 * half)[0], logical_not(abs(t) * rate <= FARTHEST)
        turn = select(rate > 0.0, sine_and_cosine(half)[0] / rate, 0.5 * t) * W
        return select(any_of(is_far), BAD_TIME, OK), W, -2.0 * quarter * quarter, turn

    return displacement


def follow(times: Any, move: Callable[[Any], tuple[Any, Any]], write: Callable[[Any, tuple[Any, ...]], None]) -> Any:
    """Write what `move` gives for times side by side, in their order; return its status, and the sum of the squares."""
    v, n, lanes, t = Variables(status=OK, squares=0.0), times.shape[0], lanes_of_text(), scratch(lanes_of_text())
    for first in loop(0, n, lanes, whilst=lambda: v.status == OK):
        for l in loop(lanes):
            t[l] = times[smaller(first + l, n - 1)]
        v.status, found = move(t.load(0, lanes))
        rows = [scratch(lanes) for _ in found]
        for row, x in zip(rows, found, strict=True):
            row.store(0, x, lanes)
        for l in loop(smaller(n - first, lanes)):
            numbers = tuple(row[l] for row in rows)
            write(first + l, numbers)
            v.squares = v.squares + sum_of(*(x * x for x in numbers))
    return v.status, select(v.status == OK, v.squares, math.inf)


@kernel("f8[:, :], f8[:], f8[:, :], f8[:], i8, f8[:, :, :], f8[:, :] -> i8")
def free_top(J: Any, W: Any, R: Any, times: Any, is_constrained: Any, attitudes: Any, velocities: Any) -> Any:
    """Set the attitudes (k, 3, 3) and the material angular velocities (k, 3) of a free body; return a status."""
    W, R = vector_at(W), matrix_at(R)
    v, D = Variables(status=OK), to_orthonormal(R)

    def moved(displacement: Displacement) -> Any:
        def move(t: Any) -> tuple[Any, Any]:
            status, velocity, cosm1, turn = displacement(t)
            found = list(velocity)
            for row, rest in zip(R, D, strict=True):  # R (I + 2 (1 + cosm1) v̂ + 2 v̂²), row by row
                a = cross(row, turn)
                found += row + (rest + 2.0 * (1.0 + cosm1) * a + 2.0 * cross(a, turn))
            return status, found

        def write(k: Any, found: tuple[Any, ...]) -> None:
            put(velocities[k], found[:3])
            for i in range(3):
                put(attitudes[k, i], found[3 + 3 * i : 6 + 3 * i])

        return follow(times, move, write)

    for _ in when(is_constrained == 0):
        v.status, _ = moved(_free(matrix_at(J), W))
    for _ in when(is_constrained != 0):
        v.status, _ = moved(_steady_rotation(W))
    return v.status


def rotations_about(R: Array, axis: Array, angles: Array) -> Array:
    """Return the attitudes ``R exp(angle hat(axis))``, (k, 3, 3), for a unit `axis` in the body (eq-rodrigues)."""
    once, twice = np.cross(R, axis), np.outer(R @ axis, axis) - R
    half = np.sin(0.5 * angles)
    s, c = 2.0 * half * half, 2.0 * half * np.cos(0.5 * angles)
    found: Array = R.ravel() + c[:, None] * once.ravel() + s[:, None] * twice.ravel()
    return found.reshape(len(angles), 3, 3)


@kernel("f8[:, :, :], i8, f8[:], i8, i8, i8, f8[:, :, :], f8[:, :, :] -> i8, i8, f8")
def free_members(
    bodies: Any, is_constrained: Any, times: Any, place: Any, first: Any, last: Any, attitudes: Any, velocities: Any
) -> tuple[Any, Any, Any]:
    """Set the quaternions (m, k, 4), scalar last, and W (m, k, 3) of free bodies at `times` since the start.

    The starts are at index 0; the states at `times` begin at index `place`. `bodies` (m or 1, 3, 3): convected inertia.
    Returns a status, the member that it is about, and the sum of the squares of the states of the last one.
    """
    v = Variables(status=OK, member=0, squares=0.0)
    for i in loop(first, last, whilst=lambda: v.status == OK):
        J, W, row = bodies[select(bodies.shape[0] > 1, i, 0)], vector_at(velocities[i, 0]), attitudes[i, 0]
        p = Quaternion(row[3], row[0], row[1], row[2])
        p = p / sqrt(p[0] * p[0] + p.vector @ p.vector)

        def moved(displacement: Displacement, i: Any = i, p: Quaternion = p) -> Any:
            s, u = Variables(last=p, sign=1.0), p.vector

            def move(t: Any) -> tuple[Any, Any]:
                status, velocity, cosm1, turn = displacement(t)
                q = p + Quaternion(cosm1 * p[0] - u @ turn, *(cosm1 * u + p[0] * turn + cross(u, turn)))
                return status, [*q, *velocity]

            def write(k: Any, found: tuple[Any, ...]) -> None:
                q, last = Quaternion(*found[:4]), s.last
                s.sign = select(q[0] * last[0] + q.vector @ last.vector < 0.0, -s.sign, s.sign)  # no jump of sign
                put(attitudes[i, place + k], s.sign * Vector(*q[1:]))
                attitudes[i, place + k, 3] = s.sign * q[0]
                put(velocities[i, place + k], found[4:])
                s.last = q

            return follow(times, move, write)

        for _ in when(is_constrained != 0):
            v.status, v.squares = moved(_steady_rotation(W))
        for _ in when(is_constrained == 0):
            v.status, v.squares = moved(_free(matrix_at(J), W))
        for _ in when(v.status != OK):
            v.member = i
    return v.status, v.member, v.squares


def free_standard(
    inertia: ArrayLike,
    material_angular_velocity: ArrayLike,
    times: ArrayLike,
    rotation: Any = None,
    *,
    physical: bool = True,
) -> Motion:
    """Return the free motion of a standard body as arrays, without the overhead of a run (eq-standard).

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Convected inertia J about the fixed point.
    material_angular_velocity : (3,) array, rad/s
        W at t = 0, in the body; may be zero.
    times : (k,) array, s
        In any order, negative ones included.
    rotation : (3, 3) array or scipy Rotation, optional
        Λ at t = 0, body to space; the identity by default.
    physical : bool
        As in `nontwist.standard`.

    Returns
    -------
    attitude : (k, 3, 3) array
        Λ, columns are the directors.
    material_angular_velocity : (k, 3) array, rad/s

    Raises
    ------
    ValueError
        As `nontwist.standard`; or an argument has the wrong shape or is not finite, or `rotation` is not a rotation.

    Notes
    -----
    Elliptic and theta functions, exact on every branch. The docstring of the module has sources, derivation and
    accuracy.

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist import exact
    >>> J = [3, 4, 5]
    >>> attitude, W = exact.free_standard(J, (0.1, 2, 0.1), [0, 1, 1000])
    >>> np.einsum("kij,kj->ki", attitude, J * W).round(9)  # the momentum, fixed in space
    array([[0.3, 8. , 0.5],
           [0.3, 8. , 0.5],
           [0.3, 8. , 0.5]])
    """
    return _solved(False, inertia, material_angular_velocity, times, rotation, physical)


def free_nontwisting(
    inertia: ArrayLike,
    material_angular_velocity: ArrayLike,
    times: ArrayLike,
    rotation: Any = None,
    *,
    physical: bool = True,
) -> Motion:
    """Return the free motion of the non-twisting body (eq-nonholonomic): Λ0 exp(t Ŵ) with constant W.

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Convected inertia; the third axis is principal.
    material_angular_velocity : (3,) array, rad/s
        W at t = 0, without a component along the third axis (beyond 1e-9).
    times, rotation, physical
        As in `free_standard`.

    Returns
    -------
    attitude, material_angular_velocity
        As in `free_standard`. Accuracy: round-off, and the ulp of |W| t in the angle.

    Raises
    ------
    ValueError
        As `free_standard`; or the third axis is not principal, or W has a component along it.

    Examples
    --------
    >>> from nontwist import exact, rotation
    >>> attitude, W = exact.free_nontwisting([3, 4, 5], (0, 2, 0), [0, 0.5, 1])
    >>> rotation(attitude).magnitude().round(9)
    array([0., 1., 2.])
    """
    return _solved(True, inertia, material_angular_velocity, times, rotation, physical)


def symmetric_top(
    inertia: ArrayLike,
    material_angular_velocity: ArrayLike,
    times: ArrayLike,
    rotation: Any = None,
    *,
    physical: bool = True,
) -> Motion:
    """Return the free motion of a body with the moments (A, A, C) as two rotations, without elliptic functions.

    ``Λ = Λ0 exp(t M̂/A) exp(t s ê3)`` with ``M = J W`` at the start and ``s = (A - C)/A W_3`` (Landau & Lifshitz, §35):
    the precession about the momentum, and the spin. Accuracy: round-off.

    Parameters
    ----------
    inertia, material_angular_velocity, times, rotation, physical
        As in `free_standard`.

    Returns
    -------
    attitude, material_angular_velocity
        As in `free_standard`.

    Raises
    ------
    ValueError
        As `free_standard`; or the inertia is not diag(A, A, C), to 1e-12 of its largest entry.

    Examples
    --------
    The angle between axis and momentum is constant:

    >>> from nontwist import exact
    >>> attitude, W = exact.symmetric_top([2, 2, 1], (1, 0, 2), [0, 1, 10])
    >>> (attitude[:, :, 2] @ (2, 0, 2)).round(9)
    array([2., 2., 2.])
    """
    J = checked_inertia(inertia, physical)
    A, C = float(J[0, 0] + J[1, 1]) / 2, float(J[2, 2])
    if abs(J - np.diag([A, A, C])).max() > SYMMETRY * abs(J).max():
        raise ValueError(f"inertia must be diag(A, A, C), symmetric about the third axis, got {J.tolist()}")
    W, t, R = checked_velocity(material_angular_velocity), as_times(times), checked_attitude(rotation)
    s = (A - C) / A * W[2]
    precession, spin = rotations.exp(np.outer(t, J @ W / A)), rotations.exp(np.outer(t * s, D3))
    Lam: Array = R @ precession @ spin
    velocity: Array = np.swapaxes(spin, 1, 2) @ W
    return Lam, velocity


TOO_FAR = f"the body turns by more than {FARTHEST:.0e} rad: round-off leaves no digit of its attitude"


def _solved(
    is_constrained: bool, inertia: ArrayLike, velocity: ArrayLike, times: ArrayLike, rotation: Any, physical: bool
) -> Motion:
    """Return the motion, of the inertia to the last bit as it was given."""
    if is_constrained:
        J, W = planar(inertia, velocity, physical)
    else:
        J, W = checked_inertia(inertia, physical), checked_velocity(velocity)
    t, R = as_times(times), checked_attitude(rotation)
    Lam, velocities = np.empty((len(t), 3, 3)), np.empty((len(t), 3))
    if free_top(J, W, R, t, int(is_constrained), Lam, velocities) != OK:
        raise ValueError(TOO_FAR)
    return Lam, velocities
