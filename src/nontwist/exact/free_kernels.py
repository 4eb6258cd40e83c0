"""Compiled free motions: of a rigid body in theta functions, and about a fixed axis; `free_bodies` derives them.

Everything is plain scalars. `prepare` turns a body and its start into the constants below, `phase` evaluates the
elliptic functions and the angle about the momentum at one time, `free_top` puts the attitude together, and `free_run`
is what the integrator calls.

The body axes x, y, z are principal, y the middle one, and Mx >= 0, Mz >= 0 (unit momentum); the momentum circles z.
With

    ax² = Mx² + rx² My²,   az² = Mz² + rz² My²,   k = ax rz / (az rx),   k'² = (Mz² rx² - Mx² rz²)/(az rx)²,

it is (ax cn u, (ax/rx) sn u, az dn u), u = u0 + λ t. For k² <= 1/2 the theta functions have the nome q(k) and the
argument π u/(2K); for k² > 1/2 they have the complementary nome p = q(k') and the imaginary argument i v, v = π
u/(2K'), u reduced to |u| <= K. Neither nome exceeds e^(-π) = 0.0432, so that q^13 is below round-off.
"""

from __future__ import annotations

import math

import numpy as np

from ..geometry.arrays import Array
from ..geometry.compiled import kernel

OK, NOT_FINITE, NOT_SYMMETRIC, NO_BODY, NO_ROTATION, BAD_TIME, NOT_PRINCIPAL, SPIN = range(8)
FARTHEST = 1e15  # rad: round-off of a larger turn is no small angle
_SYMMETRY, _TRIANGLE, _ROTATION, _PRINCIPAL, _SPIN = 1e-12, 2e-9, 1e-9, 1e-9, 1e-9

# Places in the array of constants.
HYPERBOLIC, POLE_X, RATE, U0, LAMBDA, TWO_K, FACTOR, NOME, SN, CN, DN = range(11)
AX, AZ, RX, PER_TURN = range(11, 15)
W1, W2, W3, W4, W5, W6, W7, W8 = range(15, 23)  # weights of the harmonics of the angle
MOMENTUM, IX, IY, IZ, K2 = range(23, 28)
CONSTANTS = 28


@kernel
def carlson_rf(x: float, y: float, z: float) -> float:
    """Carlson's symmetric integral R_F(x, y, z) by duplication (DLMF 19.36); at most one argument 0."""
    mean = (x + y + z) / 3.0
    for _ in range(64):
        mean = (x + y + z) / 3.0
        if max(abs(mean - x), abs(mean - y), abs(mean - z)) < 0.008 * mean:
            break
        sx, sy, sz = math.sqrt(x), math.sqrt(y), math.sqrt(z)
        shift = sx * (sy + sz) + sy * sz
        x, y, z = 0.25 * (x + shift), 0.25 * (y + shift), 0.25 * (z + shift)
    a, b = 1.0 - x / mean, 1.0 - y / mean
    c = -a - b
    e2, e3 = a * b - c * c, a * b * c
    series = 1.0 - e2 / 10.0 + e3 / 14.0 + e2 * e2 / 24.0 - 3.0 * e2 * e3 / 44.0
    series += -5.0 * e2 * e2 * e2 / 208.0 + 3.0 * e3 * e3 / 104.0 + e2 * e2 * e3 / 16.0
    return series / math.sqrt(mean)


@kernel
def nome(k2: float, k1: float) -> float:
    """Nome of the modulus k from k² <= 1/2 and k' (DLMF 19.5.5)."""
    root = math.sqrt(k1)
    l = 0.5 * k2 / ((1.0 + k1) * (1.0 + root) * (1.0 + root))
    l4 = l * l * l * l
    return l * (1.0 + l4 * (2.0 + l4 * (15.0 + l4 * 150.0)))


@kernel
def principal_axes(J: Array, V: Array, moments: Array) -> None:
    """Principal moments in ascending order and axes, rows of `V`, of a symmetric `J` by Jacobi rotations."""
    A = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            A[i, j] = 0.5 * (J[i, j] + J[j, i])
            V[i, j] = 1.0 if i == j else 0.0
    for _ in range(16):
        done = True
        for pair in range(3):
            i, j, l = (0, 1, 2) if pair == 0 else ((0, 2, 1) if pair == 1 else (1, 2, 0))
            off = A[i, j]
            if not off * off > 1e-36 * abs(A[i, i] * A[j, j]):
                continue
            done = False
            half = 0.5 * (A[j, j] - A[i, i]) / off
            t = math.copysign(1.0, half) / (abs(half) + math.sqrt(1.0 + half * half))
            c = 1.0 / math.sqrt(1.0 + t * t)
            s = t * c
            A[i, i] -= t * off
            A[j, j] += t * off
            A[i, j] = A[j, i] = 0.0
            a, b = A[i, l], A[j, l]
            A[i, l] = A[l, i] = c * a - s * b
            A[j, l] = A[l, j] = s * a + c * b
            for m in range(3):
                a, b = V[i, m], V[j, m]
                V[i, m], V[j, m] = c * a - s * b, s * a + c * b
        if done:
            break
    for i in range(3):
        moments[i] = A[i, i]
    for i, j in ((0, 1), (1, 2), (0, 1)):
        if moments[i] > moments[j]:
            moments[i], moments[j] = moments[j], moments[i]
            for m in range(3):
                V[i, m], V[j, m] = V[j, m], V[i, m]


@kernel
def _moduli(Mx: float, My: float, Mz: float, rx: float, rz: float) -> tuple[float, float, float, float]:
    """Return ax, az, k², k'²; each a sum of squares but k'², whose difference is that of the problem."""
    ax, az = math.sqrt(Mx * Mx + rx * rx * My * My), math.sqrt(Mz * Mz + rz * rz * My * My)
    if rz == 0.0 or ax == 0.0:
        return ax, az, 0.0, 1.0
    k, b = ax * rz / (rx * az), (Mz * rx - Mx * rz) * (Mz * rx + Mx * rz) / (rx * az * rx * az)
    return ax, az, k * k, max(b, 0.0)


@kernel
def _body_status(J: Array, W: Array, V: Array, moments: Array) -> int:
    """Set the principal axes and moments; whether `J` is the inertia of a body, and `W` finite."""
    total, largest, skew = 0.0, 0.0, 0.0
    for i in range(3):
        total += W[i]
        for j in range(3):
            total += J[i, j]
            largest = max(largest, abs(J[i, j]))
            skew = max(skew, abs(J[i, j] - J[j, i]))
    if not math.isfinite(total):
        return NOT_FINITE
    if skew > _SYMMETRY * largest:
        return NOT_SYMMETRIC
    principal_axes(J, V, moments)
    I1, I2, I3 = moments[0], moments[1], moments[2]
    if not I1 > 9e-16 * I3 or I1 + I2 < I3 - _TRIANGLE * (I1 + I2 + I3):
        return NO_BODY
    return OK


@kernel
def prepare(J: Array, W: Array, c: Array, B: Array) -> int:
    """Set the constants `c` and the axes x, y, z, rows of `B`; `c[MOMENTUM]` is 0 at rest. Returns a status."""
    moments, V = np.empty(3), np.empty((3, 3))
    status = _body_status(J, W, V, moments)
    if status != OK:
        return status
    I1, I2, I3 = moments[0], moments[1], moments[2]
    M1 = I1 * (V[0, 0] * W[0] + V[0, 1] * W[1] + V[0, 2] * W[2])
    M2 = I2 * (V[1, 0] * W[0] + V[1, 1] * W[1] + V[1, 2] * W[2])
    M3 = I3 * (V[2, 0] * W[0] + V[2, 1] * W[1] + V[2, 2] * W[2])
    size = max(abs(M1), abs(M2), abs(M3))
    if size > 0.0:
        M1, M2, M3 = M1 / size, M2 / size, M3 / size
        length = math.sqrt(M1 * M1 + M2 * M2 + M3 * M3)
        M1, M2, M3 = M1 / length, M2 / length, M3 / length
        size *= length
    else:
        M3 = 1.0  # at rest: any direction, all rates are 0
    swapped, rx, rz = circled(I1, I2, I3, M1, M3)
    x, z, Ix, Iz, Mx, Mz = (2, 0, I3, I1, M3, M1) if swapped else (0, 2, I1, I3, M1, M3)
    sx, sz = math.copysign(1.0, Mx), math.copysign(1.0, Mz)
    Mx, Mz = sx * Mx, sz * Mz
    for i in range(3):
        B[0, i], B[2, i] = sx * V[x, i], sz * V[z, i]
    B[1, 0] = B[2, 1] * B[0, 2] - B[2, 2] * B[0, 1]
    B[1, 1] = B[2, 2] * B[0, 0] - B[2, 0] * B[0, 2]
    B[1, 2] = B[2, 0] * B[0, 1] - B[2, 1] * B[0, 0]
    My = M2 if B[1, 0] * V[1, 0] + B[1, 1] * V[1, 1] + B[1, 2] * V[1, 2] > 0.0 else -M2
    c[MOMENTUM], c[IX], c[IY], c[IZ] = size, Ix, I2, Iz
    constants(Mx, My, Mz, rx, rz, c)
    c[U0] = beginning(Mx, My, Mz, rz, c)
    return OK


@kernel
def circled(I1: float, I2: float, I3: float, M1: float, M3: float) -> tuple[bool, float, float]:
    """Whether the axis z that the unit momentum circles is the one of the smallest moment I1; rx and rz."""
    r1, r3 = 1.0, 0.0  # a spherical body
    if I3 > I1:
        r1 = math.sqrt((I1 / I2) * ((I3 - I2) / (I3 - I1)))
        r3 = math.sqrt((I3 / I2) * ((I2 - I1) / (I3 - I1)))
    side = abs(M3) * r1 - abs(M1) * r3
    if side > 0.0 or (side == 0.0 and r1 >= r3):
        return False, r1, r3
    return True, r3, r1


@kernel
def beginning(Mx: float, My: float, Mz: float, rz: float, c: Array) -> float:
    """Return u0, the elliptic argument at t = 0."""
    ax, az, rx = c[AX], c[AZ], c[RX]
    cn, sn, dn = (Mx / ax, rx * My / ax, Mz / az if az > 0.0 else 1.0) if ax > 0.0 else (1.0, 0.0, 1.0)
    if rz == 0.0:
        dn = 1.0
    return sn * carlson_rf(cn * cn, dn * dn, 1.0) if cn != 0.0 or dn != 0.0 else math.copysign(math.inf, sn)


@kernel
def constants(Mx: float, My: float, Mz: float, rx: float, rz: float, c: Array) -> None:
    """Set the constants of the motion of the unit momentum; those of the body are there already, u0 is left out."""
    m, Ix, Iy, Iz = c[MOMENTUM], c[IX], c[IY], c[IZ]
    ax, az, k2, b2 = _moduli(Mx, My, Mz, rx, rz)
    lam = m * ((Iz - Ix) / Ix / Iz) * az * rx
    c[LAMBDA], c[AX], c[AZ], c[RX], c[K2] = lam, ax, az, rx, k2
    pole_x = rx < rz
    c[POLE_X] = 1.0 if pole_x else 0.0
    sign = -1.0 if pole_x else 1.0
    if k2 <= 0.5:
        q = nome(k2, math.sqrt(b2))
        q4, q9 = q**4, q**9
        theta3, theta4 = 1.0 + 2.0 * (q + q4 + q9), 1.0 - 2.0 * (q - q4 + q9)
        two_k = math.pi * theta3 * theta3
        q2, q6 = q * q, q4 * q * q
        g = 0.0  # e^(-π a/K), sn(a, k') = rx: the weight of the first harmonic for the pole z, q/g that for x
        if rz > 0.0:
            g = math.exp(-2.0 * math.pi / two_k * rx * carlson_rf(rz * rz, (rz / az) * (rz / az), 1.0))
        f = q * q / g if g > 0.0 else 0.0
        if pole_x:
            g, f = q / g, q * g
        g2, f2 = g * g, f * f
        c[W1], c[W2], c[W3] = sign * (g - f), -sign * q2 * (g2 - f2), sign * q6 * (g2 * g - f2 * f)
        c[W4], c[W5], c[W6] = -(g + f), q2 * (g2 + f2), -q6 * (g2 * g + f2 * f)
        zeta = 2.0 * ((g - f) - 2.0 * q2 * (g2 - f2) + 3.0 * q6 * (g2 * g - f2 * f))
        zeta *= math.pi / two_k / (1.0 + c[W4] + c[W5] + c[W6])
        c[RATE] = m / (Iz if pole_x else Ix) - sign * lam * zeta
        c[HYPERBOLIC], c[TWO_K], c[FACTOR], c[NOME], c[PER_TURN] = 0.0, two_k, math.pi / two_k, q, 0.0
        c[SN], c[CN], c[DN] = theta3 / (1.0 + q2 + q6), theta4 / (1.0 + q2 + q6), theta4 / theta3
        return
    p = nome(b2, math.sqrt(k2))
    p2, p4, p6, p9 = p * p, p**4, p**6, p**9
    theta3, theta4, theta2 = 1.0 + 2.0 * (p + p4 + p9), 1.0 - 2.0 * (p - p4 + p9), 1.0 + p2 + p6
    two_k1 = math.pi * theta3 * theta3
    a = rx * carlson_rf(rz * rz, (rz / az) * (rz / az), 1.0)
    if not pole_x:
        a = az * carlson_rf(ax * ax, (ax / rx) * (ax / rx), 1.0)
    zeta = math.pi * a / two_k1
    for n in range(4):
        c[W1 + 2 * n], c[W2 + 2 * n] = sign * math.sin((2 * n + 1) * zeta), math.cos((2 * n + 1) * zeta)
    s2, s4, s6 = math.sin(2.0 * zeta), math.sin(4.0 * zeta), math.sin(6.0 * zeta)
    c2, c4, c6 = math.cos(2.0 * zeta), math.cos(4.0 * zeta), math.cos(6.0 * zeta)
    z = 4.0 * math.pi / two_k1 * (p * s2 - 2.0 * p4 * s4 + 3.0 * p9 * s6)
    z /= 1.0 - 2.0 * (p * c2 - p4 * c4 + p9 * c6)
    c[RATE] = m / Iy - lam * z if pole_x else m * (ax * ax / Ix + az * az / Iz) + lam * z
    c[HYPERBOLIC], c[FACTOR], c[NOME], c[PER_TURN] = 1.0, math.pi / two_k1, p, sign * 2.0 * zeta
    c[TWO_K] = -two_k1 * math.log(p) / math.pi if p > 0.0 else math.inf
    c[SN], c[CN], c[DN] = theta3 / theta4, 2.0 * theta2 / theta4, 2.0 * theta2 / theta3


@kernel
def phase(c: Array, t: float) -> tuple[float, float, float, float, float, float]:
    """Return cn, sn, dn at the time t, a complex number whose argument, and an angle which, add to ψ."""
    u, q = c[U0] + c[LAMBDA] * t, c[NOME]
    if c[HYPERBOLIC] == 0.0:
        s, x = math.sin(c[FACTOR] * u), math.cos(c[FACTOR] * u)
        c2, s2 = 1.0 - 2.0 * s * s, 2.0 * s * x
        c4, s4 = 2.0 * c2 * c2 - 1.0, 2.0 * s2 * c2
        c6, s6 = c2 * (2.0 * c4 - 1.0), s2 * (2.0 * c4 + 1.0)
        q2 = q * q
        q4, q6, q9 = q2 * q2, q2 * q2 * q2, q2 * q2 * q2 * q2 * q
        even, odd = 1.0 + 2.0 * q4 * c4, 2.0 * (q * c2 + q9 * c6)
        over = 1.0 / (even - odd)
        sn = c[SN] * s * (1.0 - q2 * (1.0 + 2.0 * c2) + q6 * (1.0 + 2.0 * (c2 + c4))) * over
        cn = c[CN] * x * (1.0 + q2 * (2.0 * c2 - 1.0) + q6 * (1.0 + 2.0 * (c4 - c2))) * over
        dn = c[DN] * (even + odd) * over
        X = 1.0 + c[W4] * c2 + c[W5] * c4 + c[W6] * c6
        return cn, sn, dn, X, c[W1] * s2 + c[W2] * s4 + c[W3] * s6, 0.0
    turns = 0.0
    if math.isfinite(c[TWO_K]):
        turns = math.floor(u / c[TWO_K] + 0.5)
        u -= turns * c[TWO_K]
    E = math.exp(-c[FACTOR] * abs(u))
    e = E * E
    g = q / e if q > 0.0 else 0.0
    q2, e2, g2 = q * q, e * e, g * g
    q4, q6 = q2 * q2, q2 * q2 * q2
    a, b = q * g, q2 * e2
    a2, b2, a3 = q4 * g2, q6 * e2 * e, q6 * q2 * q * g2 * g
    over = 1.0 / (1.0 + e + a + b + a2 + b2 + a3)
    even, odd = 1.0 + q2 * g2 + q4 * e2, g + q * e + q6 * (g2 * g + q2 * q * e2 * e)
    sign = 1.0 if u >= 0.0 else -1.0
    half = 1.0 if turns % 2.0 == 0.0 else -1.0
    sn = half * sign * c[SN] * (1.0 - e - a + b + a2 - b2 - a3) * over
    cn, dn = half * c[CN] * E * (even - odd) * over, c[DN] * E * (even + odd) * over
    X = c[W2] * (1.0 + e) + c[W4] * (a + b) + c[W6] * (a2 + b2) + c[W8] * a3
    Y = sign * (c[W1] * (1.0 - e) + c[W3] * (a - b) + c[W5] * (a2 - b2) + c[W7] * a3)
    return cn, sn, dn, X, Y, turns * c[PER_TURN]


@kernel
def period(c: Array) -> tuple[float, float]:
    """Time in which the momentum returns in the body (infinite where it does not), and what ψ gains in it."""
    if c[LAMBDA] == 0.0 or not math.isfinite(c[TWO_K]) or not math.isfinite(c[U0]):
        return math.inf, 0.0
    T = 2.0 * c[TWO_K] / abs(c[LAMBDA])
    return T, c[RATE] * T + math.copysign(2.0, c[LAMBDA]) * c[PER_TURN]


@kernel
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


@kernel
def free_top(J: Array, W: Array, R: Array, times: Array) -> tuple[int, Array, Array]:
    """Return a status, the attitudes (k, 3, 3) and the material angular velocities (k, 3) of a free body."""
    n = times.shape[0]
    attitude, velocity = np.empty((n, 3, 3)), np.empty((n, 3))
    c, B = np.empty(CONSTANTS), np.empty((3, 3))
    status = prepare(J, W, c, B)
    if status == OK:
        status = _rotation_status(R)
    if status != OK:
        return status, attitude, velocity
    m = c[MOMENTUM]
    cn, sn, dn, X0, Y0, extra0 = phase(c, 0.0)
    e, f, along, across = aligned(c, cn, sn, dn)
    # The body basis in the order (pole, next, next but one), and R in it.
    i = 0 if c[POLE_X] != 0.0 else 2
    j, l = (i + 1) % 3, (i + 2) % 3
    p0, p1, p2, q0, q1, q2 = B[i, 0], B[i, 1], B[i, 2], B[j, 0], B[j, 1], B[j, 2]
    r0, r1, r2 = B[l, 0], B[l, 1], B[l, 2]
    L = np.empty((3, 3))  # columns: the axes about which ψ counts, in space
    for a in range(3):
        pole = R[a, 0] * p0 + R[a, 1] * p1 + R[a, 2] * p2
        one = R[a, 0] * q0 + R[a, 1] * q1 + R[a, 2] * q2
        two = R[a, 0] * r0 + R[a, 1] * r1 + R[a, 2] * r2
        L[a, 0] = along * (e * one + f * two) - across * pole
        L[a, 1] = e * two - f * one
        L[a, 2] = across * (e * one + f * two) + along * pole
    I = (c[IX], c[IY], c[IZ])
    wp, wq, wr = m / I[i], m / I[j], m / I[l]
    fastest = max(wp, wq, wr)
    for k in range(n):
        t = times[k]
        if not abs(t) * fastest <= FARTHEST:
            return BAD_TIME, attitude, velocity
        cn, sn, dn, X, Y, extra = phase(c, t)
        e, f, along, across = aligned(c, cn, sn, dn)
        psi = c[RATE] * t + (extra - extra0)
        X, Y = X * X0 + Y * Y0, Y * X0 - X * Y0
        over = 1.0 / math.sqrt(X * X + Y * Y)
        X, Y = X * over, Y * over
        C, S = math.cos(psi), math.sin(psi)
        C, S = C * X - S * Y, S * X + C * Y
        u, v = across * e, across * f
        o1, o2, g1, g2 = along * e, along * f, u * wq, v * wr
        for a in range(3):
            l0, l1 = C * L[a, 0] + S * L[a, 1], C * L[a, 1] - S * L[a, 0]
            l2 = L[a, 2]
            pole = along * l2 - across * l0
            one = o1 * l0 - f * l1 + u * l2
            two = o2 * l0 + e * l1 + v * l2
            attitude[k, a, 0] = pole * p0 + one * q0 + two * r0
            attitude[k, a, 1] = pole * p1 + one * q1 + two * r1
            attitude[k, a, 2] = pole * p2 + one * q2 + two * r2
        along *= wp
        velocity[k, 0] = along * p0 + g1 * q0 + g2 * r0
        velocity[k, 1] = along * p1 + g1 * q1 + g2 * r1
        velocity[k, 2] = along * p2 + g1 * q2 + g2 * r2
    return OK, attitude, velocity


@kernel
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


@kernel
def turns(R: Array, axis: Array, angles: Array) -> Array:
    """Attitudes ``R exp(angle hat(axis))``, (k, 3, 3), for a unit `axis` in the body (eq-rodrigues)."""
    attitude = np.empty((angles.shape[0], 3, 3))
    x, y, z = axis[0], axis[1], axis[2]
    for k in range(angles.shape[0]):
        s, c = math.sin(0.5 * angles[k]), math.cos(0.5 * angles[k])
        s, c = 2.0 * s * s, 2.0 * s * c
        for a in range(3):
            r0, r1, r2 = R[a, 0], R[a, 1], R[a, 2]
            along = s * (r0 * x + r1 * y + r2 * z)
            attitude[k, a, 0] = r0 + c * (r1 * z - r2 * y) + along * x - s * r0
            attitude[k, a, 1] = r1 + c * (r2 * x - r0 * z) + along * y - s * r1
            attitude[k, a, 2] = r2 + c * (r0 * y - r1 * x) + along * z - s * r2
    return attitude


@kernel
def director_states(attitude: Array, velocity: Array) -> tuple[Array, Array]:
    """Directors, rows of Λᵀ, and their velocities w × d_i (eq-omegas), from Λ (k, 3, 3) and W (k, 3)."""
    n = attitude.shape[0]
    q, v = np.empty((n, 3, 3)), np.empty((n, 3, 3))
    for k in range(n):
        W1, W2, W3 = velocity[k, 0], velocity[k, 1], velocity[k, 2]
        for a in range(3):
            d1, d2, d3 = attitude[k, a, 0], attitude[k, a, 1], attitude[k, a, 2]
            q[k, 0, a], q[k, 1, a], q[k, 2, a] = d1, d2, d3
            v[k, 0, a], v[k, 1, a], v[k, 2, a] = W3 * d2 - W2 * d3, W1 * d3 - W3 * d1, W2 * d1 - W1 * d2
    return q, v


@kernel
def _steady(W: Array, R: Array, times: Array, t_start: float) -> tuple[int, Array, Array]:
    rate = math.sqrt(W[0] * W[0] + W[1] * W[1] + W[2] * W[2])
    axis, angles, velocity = np.zeros(3), np.empty(times.shape[0]), np.empty((times.shape[0], 3))
    axis[2] = 1.0
    status = OK
    for i in range(3):
        if rate > 0.0:
            axis[i] = W[i] / rate
    for k in range(times.shape[0]):
        angles[k] = rate * (times[k] - t_start)
        velocity[k, 0], velocity[k, 1], velocity[k, 2] = W[0], W[1], W[2]
        if not abs(angles[k]) <= FARTHEST:
            status = BAD_TIME
    return status, turns(R, axis, angles), velocity


@kernel
def free_turn(J: Array, W: Array, R: Array, times: Array) -> tuple[int, Array, Array]:
    """Return what `free_top` does, for the body that may not turn about its third axis."""
    nothing = np.empty((0, 3, 3)), np.empty((0, 3))
    status = _body_status(J, W, np.empty((3, 3)), np.empty(3))
    if status == OK:
        status = _rotation_status(R)
    if status == OK and max(abs(J[0, 2]), abs(J[1, 2])) > _PRINCIPAL * max(J[0, 0], J[1, 1], J[2, 2]):
        status = NOT_PRINCIPAL
    if status == OK and abs(W[2]) > _SPIN * math.sqrt(W[0] * W[0] + W[1] * W[1] + W[2] * W[2]):
        status = SPIN
    if status != OK:
        return status, nothing[0], nothing[1]
    planar = np.zeros(3)
    planar[0], planar[1] = W[0], W[1]
    return _steady(planar, R, times, 0.0)


@kernel
def free_run(problem: Array, constrained: bool, t_start: float, times: Array) -> tuple[int, Array, Array, float]:
    """Return a status, directors, their velocities and μ of a free body from its start.

    `problem` is (10, 3): Euler inertia, directors and their velocities at `t_start`, constrained axis.
    """
    J, R, W, n = np.empty((3, 3)), np.empty((3, 3)), np.zeros(3), problem[9]
    trace = problem[0, 0] + problem[1, 1] + problem[2, 2]
    for i in range(3):
        for j in range(3):
            J[i, j] = (trace if i == j else 0.0) - problem[i, j]
            R[i, j] = problem[3 + j, i]
    for i in range(3):  # W1 = (d2'·d3 - d3'·d2)/2
        j, l = (i + 1) % 3, (i + 2) % 3
        for a in range(3):
            W[i] += 0.5 * (problem[6 + j, a] * problem[3 + l, a] - problem[6 + l, a] * problem[3 + j, a])
    if not constrained:
        shifted = times - t_start
        status, attitude, velocity = free_top(J, W, R, shifted)
        q, v = director_states(attitude, velocity)
        return status, q, v, 0.0
    spin = W[0] * n[0] + W[1] * n[1] + W[2] * n[2]
    Jn, M = np.zeros(3), np.zeros(3)
    for i in range(3):
        W[i] -= spin * n[i]
    for i in range(3):
        for j in range(3):
            Jn[i] += J[i, j] * n[j]
            M[i] += J[i, j] * W[j]
    mu, worst = 0.0, 0.0
    for i in range(3):
        j, l = (i + 1) % 3, (i + 2) % 3
        mu += n[i] * (M[j] * W[l] - M[l] * W[j])
        worst = max(worst, abs(n[j] * Jn[l] - n[l] * Jn[j]))
    status, attitude, velocity = _steady(W, R, times, t_start)
    q, v = director_states(attitude, velocity)
    return NOT_PRINCIPAL if worst > _PRINCIPAL * trace else status, q, v, mu


@kernel
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


@kernel
def _turned(before: Array, W: Array, t: float, p: Array) -> None:
    """Set the quaternion `before` times that of the rotation by W t, all scalar last."""
    rate = math.sqrt(W[0] * W[0] + W[1] * W[1] + W[2] * W[2])
    c, s = math.cos(0.5 * rate * t), math.sin(0.5 * rate * t) / rate if rate > 0.0 else 0.5 * t
    x, y, z = s * W[0], s * W[1], s * W[2]
    a, b, d, w = before[0], before[1], before[2], before[3]
    p[0], p[1] = w * x + c * a + b * z - d * y, w * y + c * b + d * x - a * z
    p[2], p[3] = w * z + c * d + a * y - b * x, w * c - (a * x + b * y + d * z)


@kernel
def free_members(
    bodies: Array, axes: Array, times: Array, place: int, first: int, last: int, attitudes: Array, velocities: Array
) -> tuple[int, int]:
    """Set the quaternions (m, k, 4), scalar last, and W (m, k, 3) of free bodies at `times` since the start.

    The starts stand at the places 0; those of the times begin at `place`. `bodies` (m or 1, 3, 3): convected inertia;
    `axes` (m or 1, 3) or (0, 3): constrained axis. Returns a status and the member that it is about.
    """
    J, R, W, p = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(4)
    before, now = np.empty(4), np.empty(4)
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
            if across > _PRINCIPAL * largest:
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
        status, attitude, velocity = free_top(J, W, R, times)
        if status != OK:
            return status, i
        for k in range(times.shape[0]):
            _nearer(attitude[k], before, now)
            for j in range(4):
                before[j] = attitudes[i, place + k, j] = now[j]
            for j in range(3):
                velocities[i, place + k, j] = velocity[k, j]
    return OK, 0
