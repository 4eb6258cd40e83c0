"""Compiled free motions: of a rigid body in theta functions, and about a fixed axis; `free_bodies` derives them.

Everything is plain scalars. `free_top` puts together what `free_constants` evaluates, `free_members` is what the
integrator calls. Chained calls must not drift: each starts from an orthonormal attitude, and adds to W what the motion
changes it by, ``W + Bᵀ |M| (e(t) - e(0))/I`` with e the unit momentum along the axes B, so that neither the round-off
of B, which would multiply W by Bᵀ B at every call, nor a normalisation of the momentum adds up. Short motions are
increments as a whole (`free_step`).
"""

from __future__ import annotations

import math

import numpy as np

from ..geometry.arrays import Array
from ..geometry.compiled import kernel, shared
from ..geometry.elements import matrix, sixteen
from .free_constants import (
    AX,
    AZ,
    BAD_TIME,
    FARTHEST,
    IX,
    IY,
    IZ,
    LAMBDA,
    MOMENTUM,
    NO_ROTATION,
    NOT_PRINCIPAL,
    OK,
    POLE_X,
    RATE,
    RX,
    SPIN,
    body_status,
    phase,
    prepare,
    to_orthonormal,
)
from .free_step import Increments, increments

_ROTATION, PRINCIPAL, _SPIN = 1e-9, 1e-9, 1e-9
SHORT = 1 / 16  # of the elliptic argument; for longer calls the closed form is as accurate as increments


@shared
def aligned(c: Array, cn: float, sn: float, dn: float) -> tuple[float, float, float, float]:
    """Return the unit vector (e, f) of the momentum around the pole, and its parts along and across the pole."""
    if c[POLE_X] != 0.0:
        e, f, along = c[AX] / c[RX] * sn, c[AZ] * dn, c[AX] * cn
        across = math.sqrt(e * e + f * f)
        e, f = e / across, f / across
    else:
        e, f, along = cn, sn / c[RX], c[AZ] * dn
        across = math.sqrt(e * e + f * f)
        e, f = e / across, f / across
        across *= c[AX]
    length = math.sqrt(along * along + across * across)
    return e, f, along / length, across / length


@kernel("f8[:, :], f8[:], f8[:, :], f8[:], f8[:, :, :], f8[:, :], f8[:] -> i8")
def free_top(J: Array, W: Array, R: Array, times: Array, attitude: Array, velocity: Array, c: Array) -> int:
    """Set the attitudes (k, 3, 3) and the material angular velocities (k, 3) of a free body; return a status.

    `c` (CONSTANTS,) is working space.
    """
    n = times.shape[0]
    B, D = matrix(), matrix()
    status = prepare(J, W, c, B)
    if status == OK:
        status = _rotation_status(R)
    if status != OK:
        return status
    to_orthonormal(R, D)
    m = c[MOMENTUM]
    cn, sn, dn, X0, Y0, extra0 = phase(c, 0.0)
    e, f, along, across = aligned(c, cn, sn, dn)
    # The body basis in the order (pole, next, next but one), and R in it.
    i = 0 if c[POLE_X] != 0.0 else 2
    j, l = (i + 1) % 3, (i + 2) % 3
    p0, p1, p2, q0, q1, q2 = B[i, 0], B[i, 1], B[i, 2], B[j, 0], B[j, 1], B[j, 2]
    r0, r1, r2 = B[l, 0], B[l, 1], B[l, 2]
    L = matrix()  # columns: the axes about which ψ counts, in space
    for a in range(3):
        s0, s1, s2 = R[a, 0] + D[a, 0], R[a, 1] + D[a, 1], R[a, 2] + D[a, 2]
        pole, one, two = s0 * p0 + s1 * p1 + s2 * p2, s0 * q0 + s1 * q1 + s2 * q2, s0 * r0 + s1 * r1 + s2 * r2
        L[a, 0] = along * (e * one + f * two) - across * pole
        L[a, 1] = e * two - f * one
        L[a, 2] = across * (e * one + f * two) + along * pole
    I = (c[IX], c[IY], c[IZ])
    wp, wq, wr = m / I[i], m / I[j], m / I[l]
    fastest = max(wp, wq, wr)
    # The difference of W from the velocity evaluated at t = 0, added at every time.
    g0, g1, g2 = along * wp, across * e * wq, across * f * wr
    o0 = W[0] - (g0 * p0 + g1 * q0 + g2 * r0)
    o1 = W[1] - (g0 * p1 + g1 * q1 + g2 * r1)
    o2 = W[2] - (g0 * p2 + g1 * q2 + g2 * r2)
    rate, pace, short = c[RATE], c[LAMBDA], 0
    for k in range(n):
        t = times[k]
        if not abs(t) * fastest <= FARTHEST:
            return BAD_TIME
        short += abs(pace * t) <= SHORT
        cn, sn, dn, X, Y, extra = phase(c, t)
        e, f, along, across = aligned(c, cn, sn, dn)
        psi = rate * t + (extra - extra0)
        X, Y = X * X0 + Y * Y0, Y * X0 - X * Y0
        over = 1.0 / math.sqrt(X * X + Y * Y)
        X, Y = X * over, Y * over
        C, S = math.cos(psi), math.sin(psi)
        C, S = C * X - S * Y, S * X + C * Y
        u, v = across * e, across * f
        ae, af, g0, g1, g2 = along * e, along * f, along * wp, u * wq, v * wr
        for a in range(3):
            l0, l1 = C * L[a, 0] + S * L[a, 1], C * L[a, 1] - S * L[a, 0]
            l2 = L[a, 2]
            pole = along * l2 - across * l0
            one = ae * l0 - f * l1 + u * l2
            two = af * l0 + e * l1 + v * l2
            attitude[k, a, 0] = pole * p0 + one * q0 + two * r0
            attitude[k, a, 1] = pole * p1 + one * q1 + two * r1
            attitude[k, a, 2] = pole * p2 + one * q2 + two * r2
        velocity[k, 0] = o0 + (g0 * p0 + g1 * q0 + g2 * r0)
        velocity[k, 1] = o1 + (g0 * p1 + g1 * q1 + g2 * r1)
        velocity[k, 2] = o2 + (g0 * p2 + g1 * q2 + g2 * r2)
    if short > 0:
        x, y, z = unit_momentum(c, B, W)
        for k in range(n):
            if abs(pace * times[k]) <= SHORT:
                add_increments(R, D, W, B, c, increments(x, y, z, times[k], c), attitude[k], velocity[k])
    return OK


@shared
def unit_momentum(c: Array, B: Array, W: Array) -> tuple[float, float, float]:
    """Return the momentum along the axes x, y, z, rows of `B`, of unit length but at rest."""
    x = c[IX] * (B[0, 0] * W[0] + B[0, 1] * W[1] + B[0, 2] * W[2])
    y = c[IY] * (B[1, 0] * W[0] + B[1, 1] * W[1] + B[1, 2] * W[2])
    z = c[IZ] * (B[2, 0] * W[0] + B[2, 1] * W[1] + B[2, 2] * W[2])
    if c[MOMENTUM] == 0.0:
        return 0.0, 0.0, 1.0
    return x / c[MOMENTUM], y / c[MOMENTUM], z / c[MOMENTUM]


@shared
def add_increments(
    R: Array, D: Array, W: Array, B: Array, c: Array, step: Increments, attitude: Array, velocity: Array
) -> None:
    """Set the attitude and the velocity that `step` leads to from `R` + `D` and `W`."""
    dx, dy, dz, less, x, y, z = step
    m = c[MOMENTUM]
    dx, dy, dz = m * dx / c[IX], m * dy / c[IY], m * dz / c[IZ]
    vx = B[0, 0] * x + B[1, 0] * y + B[2, 0] * z
    vy = B[0, 1] * x + B[1, 1] * y + B[2, 1] * z
    vz = B[0, 2] * x + B[1, 2] * y + B[2, 2] * z
    w = 2.0 * (1.0 + less)
    for i in range(3):
        velocity[i] = W[i] + (B[0, i] * dx + B[1, i] * dy + B[2, i] * dz)
        # R (I + w v̂ + 2 v̂²), row by row: r + w r × v + 2 (r × v) × v
        a, b, d = R[i, 1] * vz - R[i, 2] * vy, R[i, 2] * vx - R[i, 0] * vz, R[i, 0] * vy - R[i, 1] * vx
        attitude[i, 0] = R[i, 0] + (D[i, 0] + w * a + 2.0 * (b * vz - d * vy))
        attitude[i, 1] = R[i, 1] + (D[i, 1] + w * b + 2.0 * (d * vx - a * vz))
        attitude[i, 2] = R[i, 2] + (D[i, 2] + w * d + 2.0 * (a * vy - b * vx))


@shared
def _rotation_status(R: Array) -> int:
    """Whether `R` is orthonormal to 1e-9 and right-handed."""
    worst = 0.0
    for i in range(3):
        for j in range(i + 1):
            product = R[i, 0] * R[j, 0] + R[i, 1] * R[j, 1] + R[i, 2] * R[j, 2]
            worst = max(worst, abs(product - (1.0 if i == j else 0.0)))
    if not math.isfinite(R[0, 0] + R[1, 1] + R[2, 2] + R[0, 1] + R[0, 2] + R[1, 2] + R[1, 0] + R[2, 0] + R[2, 1]):
        return NO_ROTATION
    det = R[0, 0] * (R[1, 1] * R[2, 2] - R[1, 2] * R[2, 1]) - R[0, 1] * (R[1, 0] * R[2, 2] - R[1, 2] * R[2, 0])
    det += R[0, 2] * (R[1, 0] * R[2, 1] - R[1, 1] * R[2, 0])
    return OK if worst <= _ROTATION and det > 0.0 else NO_ROTATION


@shared
def _turn(R: Array, x: float, y: float, z: float, angle: float, attitude: Array) -> None:
    s, c = math.sin(0.5 * angle), math.cos(0.5 * angle)
    s, c = 2.0 * s * s, 2.0 * s * c
    for a in range(3):
        r0, r1, r2 = R[a, 0], R[a, 1], R[a, 2]
        along = s * (r0 * x + r1 * y + r2 * z)
        attitude[a, 0] = r0 + c * (r1 * z - r2 * y) + along * x - s * r0
        attitude[a, 1] = r1 + c * (r2 * x - r0 * z) + along * y - s * r1
        attitude[a, 2] = r2 + c * (r0 * y - r1 * x) + along * z - s * r2


@kernel("f8[:, :], f8[:], f8[:], f8[:, :, :]")
def set_turns(R: Array, axis: Array, angles: Array, attitude: Array) -> None:
    """Set the attitudes ``R exp(angle hat(axis))``, (k, 3, 3), for a unit `axis` in the body (eq-rodrigues)."""
    for k in range(angles.shape[0]):
        _turn(R, axis[0], axis[1], axis[2], angles[k], attitude[k])


def turns(R: Array, axis: Array, angles: Array) -> Array:
    """Return what `set_turns` sets."""
    attitude = np.empty((len(angles), 3, 3))
    set_turns(R, axis, angles, attitude)
    return attitude


@kernel("f8[:, :], f8[:], f8[:, :], f8[:], f8[:, :, :], f8[:, :], f8[:] -> i8")
def free_turn(J: Array, W: Array, R: Array, times: Array, attitude: Array, velocity: Array, c: Array) -> int:
    """Do what `free_top` does, for the body that may not turn about its third axis."""
    status = body_status(J, W, matrix(), sixteen())
    if status == OK:
        status = _rotation_status(R)
    if status == OK and max(abs(J[0, 2]), abs(J[1, 2])) > PRINCIPAL * max(J[0, 0], J[1, 1], J[2, 2]):
        status = NOT_PRINCIPAL
    if status == OK and abs(W[2]) > _SPIN * math.sqrt(W[0] * W[0] + W[1] * W[1] + W[2] * W[2]):
        status = SPIN
    if status != OK:
        return status
    x, y = W[0], W[1]
    rate = math.sqrt(x * x + y * y)
    e, f, g = (x / rate, y / rate, 0.0) if rate > 0.0 else (0.0, 0.0, 1.0)
    for k in range(times.shape[0]):
        angle = rate * times[k]
        velocity[k, 0], velocity[k, 1], velocity[k, 2] = x, y, 0.0
        _turn(R, e, f, g, angle, attitude[k])
        if not abs(angle) <= FARTHEST:
            status = BAD_TIME
    return status


@shared
def _nearer(R: Array, before: Array, p: Array) -> None:
    """Set the unit quaternion, scalar last, of a rotation (Shepperd); of the two the one nearer to `before`."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    a, b, c, d = 1.0 + trace, 1.0 + 2.0 * R[0, 0] - trace, 1.0 + 2.0 * R[1, 1] - trace, 1.0 + 2.0 * R[2, 2] - trace
    yz, zx, xy = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    YZ, ZX, XY = R[2, 1] + R[1, 2], R[0, 2] + R[2, 0], R[1, 0] + R[0, 1]
    if a >= b and a >= c and a >= d:
        p[0], p[1], p[2], p[3] = yz, zx, xy, a
    elif b >= c and b >= d:
        p[0], p[1], p[2], p[3] = b, XY, ZX, yz
    elif c >= d:
        p[0], p[1], p[2], p[3] = XY, c, YZ, zx
    else:
        p[0], p[1], p[2], p[3] = ZX, YZ, d, xy
    f = 1.0 / math.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2] + p[3] * p[3])
    if p[0] * before[0] + p[1] * before[1] + p[2] * before[2] + p[3] * before[3] < 0.0:
        f = -f
    for j in range(4):
        p[j] *= f


@shared
def _turned(before: Array, W: Array, t: float, p: Array) -> None:
    """Set the quaternion `before` times that of the rotation by W t, all scalar last."""
    rate = math.sqrt(W[0] * W[0] + W[1] * W[1] + W[2] * W[2])
    c, s = math.cos(0.5 * rate * t), math.sin(0.5 * rate * t) / rate if rate > 0.0 else 0.5 * t
    x, y, z = s * W[0], s * W[1], s * W[2]
    a, b, d, w = before[0], before[1], before[2], before[3]
    p[0], p[1] = w * x + c * a + b * z - d * y, w * y + c * b + d * x - a * z
    p[2], p[3] = w * z + c * d + a * y - b * x, w * c - (a * x + b * y + d * z)


@kernel("f8[:, :, :], f8[:, :], f8[:], i8, i8, i8, f8[:, :, :], f8[:, :, :], f8[:, :, :], f8[:, :], f8[:] -> i8, i8")
def free_members(
    bodies: Array,
    axes: Array,
    times: Array,
    place: int,
    first: int,
    last: int,
    attitudes: Array,
    velocities: Array,
    attitude: Array,
    velocity: Array,
    c: Array,
) -> tuple[int, int]:
    """Set the quaternions (m, k, 4), scalar last, and W (m, k, 3) of free bodies at `times` since the start.

    The starts are at index 0; the states at `times` begin at index `place`. `bodies` (m or 1, 3, 3): convected inertia;
    `axes` (m or 1, 3) or (0, 3): constrained axis. Returns a status and the member that it is about. Working
    space: `attitude` (k, 3, 3), `velocity` (k, 3), `c` (CONSTANTS,).
    """
    J, R, W, p, before, now = matrix(), matrix(), sixteen(), sixteen(), sixteen(), sixteen()
    for i in range(first, last):
        b = i if bodies.shape[0] > 1 else 0
        largest = 0.0
        for j in range(3):
            W[j] = velocities[i, 0, j]
            for l in range(3):
                J[j, l] = bodies[b, j, l]
                largest = max(largest, abs(J[j, l]))
        for j in range(4):
            p[j] = before[j] = attitudes[i, 0, j]
        if axes.shape[0] > 0:
            n0, n1, n2 = axes[b, 0], axes[b, 1], axes[b, 2]
            m0 = J[0, 0] * n0 + J[0, 1] * n1 + J[0, 2] * n2
            m1 = J[1, 0] * n0 + J[1, 1] * n1 + J[1, 2] * n2
            m2 = J[2, 0] * n0 + J[2, 1] * n1 + J[2, 2] * n2
            across = max(abs(n1 * m2 - n2 * m1), abs(n2 * m0 - n0 * m2), abs(n0 * m1 - n1 * m0))
            if across > PRINCIPAL * largest:
                return NOT_PRINCIPAL, i
            rate = math.sqrt(W[0] * W[0] + W[1] * W[1] + W[2] * W[2])
            for k in range(times.shape[0]):
                if not abs(times[k]) * rate <= FARTHEST:
                    return BAD_TIME, i
                _turned(p, W, times[k], now)
                sign = 1.0
                if now[0] * before[0] + now[1] * before[1] + now[2] * before[2] + now[3] * before[3] < 0.0:
                    sign = -1.0
                for j in range(4):
                    before[j] = attitudes[i, place + k, j] = sign * now[j]
                for j in range(3):
                    velocities[i, place + k, j] = W[j]
            continue
        x, y, z, w = p[0], p[1], p[2], p[3]
        R[0, 0], R[0, 1], R[0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
        R[1, 0], R[1, 1], R[1, 2] = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
        R[2, 0], R[2, 1], R[2, 2] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
        status = free_top(J, W, R, times, attitude, velocity, c)
        if status != OK:
            return status, i
        for k in range(times.shape[0]):
            _nearer(attitude[k], before, now)
            for j in range(4):
                before[j] = attitudes[i, place + k, j] = now[j]
            for j in range(3):
                velocities[i, place + k, j] = velocity[k, j]
    return OK, 0
