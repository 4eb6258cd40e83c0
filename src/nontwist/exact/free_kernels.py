"""Compiled free motions: of a rigid body in theta functions, and about a fixed axis; `free_bodies` derives them.

`free_top` puts together what `free_constants` evaluates, `free_members` is what the
integrator calls. Chained calls must not drift: each starts from an orthonormal attitude, and adds to W what the motion
changes it by, ``W + Bᵀ |M| (e(t) - e(0))/I`` with e the unit momentum along the axes B, so that neither the round-off
of B, which would multiply W by Bᵀ B at every call, nor a normalisation of the momentum adds up. Short motions are
increments as a whole (`free_step`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..geometry.arrays import Array
from ..kernels.control import Variables, loop, when
from ..kernels.elements import cos, larger, logical_not, select, sin, sqrt
from ..kernels.kernel import kernel
from ..kernels.memory import View, matrix_at, put, vector_at, view_in
from ..kernels.parts import part
from ..kernels.vectors import Matrix, Quaternion, Vector, attitude, cross
from .free_constants import (
    BAD_TIME,
    FARTHEST,
    NO_ROTATION,
    NOT_PRINCIPAL,
    OK,
    SPIN,
    Constants,
    phase,
    prepared,
    to_orthonormal,
)
from .free_step import increments

_ROTATION, PRINCIPAL, _SPIN = 1e-9, 1e-9, 1e-9
SHORT = 1 / 16  # of the elliptic argument; for longer calls the closed form is as accurate as increments


def _aligned(c: View, cn: Any, sn: Any, dn: Any) -> tuple[Any, Any, Any, Any]:
    """Return the unit vector (e, f) of the momentum around the pole, and its parts along and across the pole."""
    is_x = c.pole_x != 0.0
    e, f = select(is_x, c.ax / c.rx * sn, cn), select(is_x, c.az * dn, sn / c.rx)
    size = sqrt(e * e + f * f)
    along, across = select(is_x, c.ax * cn, c.az * dn), select(is_x, size, c.ax * size)
    length = sqrt(along * along + across * across)
    return e / size, f / size, along / length, across / length


@kernel("f8[:, :], f8[:], f8[:, :], f8[:], f8[:, :, :], f8[:, :], f8[:] -> i8")
def free_top(J: Any, W: Any, R: Any, times: Any, attitudes: Any, velocities: Any, c: Any) -> Any:
    """Set the attitudes (k, 3, 3) and the material angular velocities (k, 3) of a free body; return a status.

    `c` (CONSTANTS,) is working space.
    """
    given = matrix_at(J), vector_at(W), matrix_at(R)
    return _free_top(*given, times, attitudes, velocities, view_in(Constants, c))


@part
def _free_top(J: Matrix, W: Vector, R: Matrix, times: Any, attitudes: Any, velocities: Any, c: View) -> Any:
    """Do what `free_top` does."""
    status, B = prepared(J, W, c)
    v = Variables(status=select(status == OK, _rotation_status(R), status), short=0)
    D = to_orthonormal(R)
    is_x, is_z = c.pole_x != 0.0, c.pole_x == 0.0
    *found, X0, Y0, extra0 = phase(c, 0.0 * c.pace)
    e, f, along, across = _aligned(c, *found)
    # The body basis in the order (pole, next, next but one), and R in it.
    p, q, r = select(is_x, B[0], B[2]), select(is_z, B[0], B[1]), select(is_z, B[1], B[2])
    rows = []
    for s in R + D:  # of L, whose columns are the axes about which ψ counts, in space
        pole, one, two = s @ p, s @ q, s @ r
        turned = along * (e * one + f * two) - across * pole, e * two - f * one
        rows.append(Vector(*turned, across * (e * one + f * two) + along * pole))
    m, I = c.momentum, (c.ix, c.iy, c.iz)
    rates = select(is_x, (m / I[0], m / I[1], m / I[2]), (m / I[2], m / I[0], m / I[1]))
    fastest = larger(rates[0], larger(rates[1], rates[2]))

    def velocity(along: Any, u: Any, w: Any) -> Any:
        return along * rates[0] * p + u * rates[1] * q + w * rates[2] * r

    off = W - velocity(along, across * e, across * f)  # from the velocity evaluated at t = 0, added at every time
    for k in loop(times.shape[0], whilst=lambda: v.status == OK):
        t = times[k]
        for _ in when(logical_not(abs(t) * fastest <= FARTHEST)):
            v.status = BAD_TIME
        v.short = v.short + select(abs(c.pace * t) <= SHORT, 1, 0)
        *at, X, Y, extra = phase(c, t)
        e_t, f_t, along_t, across_t = _aligned(c, *at)
        psi = c.rate * t + (extra - extra0)
        X, Y = X * X0 + Y * Y0, Y * X0 - X * Y0
        over = 1.0 / sqrt(X * X + Y * Y)
        C, S = cos(psi), sin(psi)
        C, S = over * (C * X - S * Y), over * (S * X + C * Y)
        u, w = across_t * e_t, across_t * f_t
        for a, l in enumerate(rows):
            l0, l1 = C * l[0] + S * l[1], C * l[1] - S * l[0]
            pole = along_t * l[2] - across_t * l0
            one, two = along_t * e_t * l0 - f_t * l1 + u * l[2], along_t * f_t * l0 + e_t * l1 + w * l[2]
            put(attitudes[k, a], pole * p + one * q + two * r)
        put(velocities[k], off + velocity(along_t, u, w))
    for _ in when((v.status == OK) & (v.short > 0)):
        M = _unit_momentum(c, B, W)
        for k in loop(times.shape[0]):
            for _ in when(abs(c.pace * times[k]) <= SHORT):
                _add_increments(R, D, W, B, c, increments(M, times[k], c), attitudes[k], velocities[k])
    return v.status


def _unit_momentum(c: View, B: Matrix, W: Vector) -> Vector:
    """Return the momentum along the axes x, y, z, rows of B, of unit length but at rest."""
    m, is_moving = B @ W, c.momentum != 0.0
    found = Vector(c.ix * m[0], c.iy * m[1], c.iz * m[2]) / select(is_moving, c.momentum, 1.0)
    return select(is_moving, found, Vector(0.0, 0.0, 1.0))  # type: ignore[no-any-return]


def _add_increments(
    R: Matrix, D: Matrix, W: Vector, B: Matrix, c: View, step: Any, attitude_at: Any, velocity_at: Any
) -> None:
    """Set the attitude and the velocity that a step of `increments` leads to from R + D and W."""
    (dx, dy, dz), less, turn = step
    m = c.momentum
    put(velocity_at, W + Vector(m * dx / c.ix, m * dy / c.iy, m * dz / c.iz) @ B)
    v, w = turn @ B, 2.0 * (1.0 + less)
    for i, (row, rest) in enumerate(zip(R, D, strict=True)):  # R (I + w v̂ + 2 v̂²), row by row
        a = cross(row, v)
        put(attitude_at[i], row + (rest + w * a + 2.0 * cross(a, v)))


def _rotation_status(R: Matrix) -> Any:
    """Return whether R is orthonormal to 1e-9 and right-handed."""
    worst = 0.0 * R[0][0]
    for i in range(3):
        for j in range(i + 1):
            worst = larger(abs(R[i] @ R[j] - (1.0 if i == j else 0.0)), worst)
    numbers = [x for row in R for x in row]
    is_finite = abs(sum(numbers[1:], start=numbers[0])) < math.inf
    return select(is_finite & (worst <= _ROTATION) & (R[0] @ cross(R[1], R[2]) > 0.0), OK, NO_ROTATION)


def turns(R: Array, axis: Array, angles: Array) -> Array:
    """Return the attitudes ``R exp(angle hat(axis))``, (k, 3, 3), for a unit `axis` in the body (eq-rodrigues)."""
    once, twice = np.cross(R, axis), np.outer(R @ axis, axis) - R
    half = np.sin(0.5 * angles)
    s, c = 2.0 * half * half, 2.0 * half * np.cos(0.5 * angles)
    found: Array = R.ravel() + c[:, None] * once.ravel() + s[:, None] * twice.ravel()
    return found.reshape(-1, 3, 3)


def free_turn(J: Array, W: Array, R: Array, times: Array, attitudes: Array, velocities: Array, c: Array) -> int:
    """Do what `free_top` does, for the body that may not turn about its third axis."""
    status = free_top(J, W, R, times[:0], attitudes[:0], velocities[:0], c)
    if status == OK and max(abs(J[0, 2]), abs(J[1, 2])) > PRINCIPAL * max(J[0, 0], J[1, 1], J[2, 2]):
        status = NOT_PRINCIPAL
    if status == OK and abs(W[2]) > _SPIN * math.sqrt(W @ W):
        status = SPIN
    if status != OK:
        return int(status)
    rate = math.hypot(W[0], W[1])
    axis = np.array([W[0] / rate, W[1] / rate, 0.0]) if rate > 0.0 else np.array([0.0, 0.0, 1.0])
    if not (np.abs(rate * times) <= FARTHEST).all():
        return BAD_TIME
    velocities[:], attitudes[:] = (W[0], W[1], 0.0), turns(R, axis, rate * times)
    return OK


def _nearer(R: Matrix, before: Quaternion) -> Any:
    """Return the unit quaternion of a rotation (Shepperd); of the two the one nearer to `before`."""
    trace = R.trace
    u = Vector(R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1])
    yz, zx, xy = R[2][1] + R[1][2], R[0][2] + R[2][0], R[1][0] + R[0][1]
    best, q = 1.0 + trace, Quaternion(1.0 + trace, *u)
    for k in range(3):
        t = 1.0 + 2.0 * R[k][k] - trace
        is_larger = t > best
        row = ((t, xy, zx), (xy, t, yz), (zx, yz, t))[k]
        q, best = select(is_larger, Quaternion(u[k], *row), q), select(is_larger, t, best)
    f = 1.0 / sqrt(_dot(q, q))
    return select(_dot(q, before) < 0.0, -f, f) * q


def _dot(p: Quaternion, q: Quaternion) -> Any:
    return p[0] * q[0] + p.vector @ q.vector


def _quaternion_at(row: Any) -> Quaternion:
    return Quaternion(row[3], row[0], row[1], row[2])


def _put_quaternion(row: Any, q: Any) -> None:
    put(row, (*q[1:], q[0]))


@kernel("f8[:, :, :], f8[:, :], f8[:], i8, i8, i8, f8[:, :, :], f8[:, :, :], f8[:, :, :], f8[:, :], f8[:] -> i8, i8")
def free_members(
    bodies: Any,
    axes: Any,
    times: Any,
    place: Any,
    first: Any,
    last: Any,
    attitudes: Any,
    velocities: Any,
    turn: Any,
    velocity: Any,
    c: Any,
) -> tuple[Any, Any]:
    """Set the quaternions (m, k, 4), scalar last, and W (m, k, 3) of free bodies at `times` since the start.

    The starts are at index 0; the states at `times` begin at index `place`. `bodies` (m or 1, 3, 3): convected inertia;
    `axes` (m or 1, 3) or (0, 3): constrained axis. Returns a status and the member that it is about. Working
    space: `turn` (k, 3, 3), `velocity` (k, 3), `c` (CONSTANTS,).
    """
    v = Variables(status=OK, member=0)
    for i in loop(first, last, whilst=lambda: v.status == OK):
        b = select(bodies.shape[0] > 1, i, 0)
        J, W, p = matrix_at(bodies[b]), vector_at(velocities[i, 0]), _quaternion_at(attitudes[i, 0])
        is_held = axes.shape[0] > 0
        for _ in when(is_held):
            v.status = _hold(J, axes[b], W, p, times, place, attitudes[i], velocities[i])
        for _ in when(logical_not(is_held)):
            v.status = _free_top(J, W, attitude(p), times, turn, velocity, view_in(Constants, c))
            before = Variables(p=p)
            for k in loop(select(v.status == OK, times.shape[0], 0)):
                before.p = _nearer(matrix_at(turn[k]), before.p)
                _put_quaternion(attitudes[i, place + k], before.p)
                put(velocities[i, place + k], vector_at(velocity[k]))
        for _ in when(v.status != OK):
            v.member = i
    return v.status, v.member


def _hold(
    J: Matrix, axis: Any, W: Vector, p: Quaternion, times: Any, place: Any, attitudes: Any, velocities: Any
) -> Any:
    """Turn a body about the constant W at the times; return a status."""
    n = vector_at(axis)
    m = J @ n
    largest, across = _largest([x for row in J for x in row]), _largest(list(cross(n, m)))
    rate = sqrt(W @ W)
    v = Variables(p=p, status=select(across > PRINCIPAL * largest, NOT_PRINCIPAL, OK))
    for k in loop(times.shape[0], whilst=lambda: v.status == OK):
        t = times[k]
        for _ in when(logical_not(abs(t) * rate <= FARTHEST)):
            v.status = BAD_TIME
        half = 0.5 * rate * t
        q = p @ Quaternion(cos(half), *(select(rate > 0.0, sin(half) / rate, 0.5 * t) * W))
        v.p = select(_dot(q, v.p) < 0.0, -q, q)
        _put_quaternion(attitudes[place + k], v.p)
        put(velocities[place + k], W)
    return v.status


def _largest(numbers: list[Any]) -> Any:
    found = abs(numbers[0])
    for x in numbers[1:]:
        found = larger(abs(x), found)
    return found
