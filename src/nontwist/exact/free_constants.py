"""The constants of a free rigid body and its elliptic functions, compiled; `free_bodies` derives them.

Everything is plain scalars. `prepare` turns a body and its start into the constants below, `phase` evaluates the
elliptic functions and the angle about the momentum at one time.

Axes, ax, az, rx, rz, k, u and λ are those of `free_bodies`; the momentum has unit length. For k² <= 1/2 the theta
functions have the nome q(k) and the argument π u/(2K); for k² > 1/2 they have the complementary nome p = q(k') and the
imaginary argument i v, v = π u/(2K'), u reduced to |u| <= K. Neither nome exceeds e^(-π) = 0.0432, so that q^13 is
below round-off.
"""

from __future__ import annotations

import math

from ..geometry.arrays import Array
from ..geometry.compiled import kernel, shared
from ..geometry.elements import matrix, sixteen

OK, NOT_FINITE, NOT_SYMMETRIC, NO_BODY, NO_ROTATION, BAD_TIME, NOT_PRINCIPAL, SPIN = range(8)
FARTHEST = 1e15  # rad: round-off of a larger turn is no small angle
_SYMMETRY, _TRIANGLE = 1e-12, 2e-9

# Places in the array of constants.
HYPERBOLIC, POLE_X, RATE, U0, LAMBDA, TWO_K, FACTOR, NOME, SN, CN, DN = range(11)
AX, AZ, RX, PER_TURN = range(11, 15)
W1, W2, W3, W4, W5, W6, W7, W8 = range(15, 23)  # weights of the harmonics of the angle
MOMENTUM, IX, IY, IZ, K2, RZ = range(23, 29)
MX0, MY0, MZ0, X0, Y0, EXTRA0 = range(29, 35)  # unit momentum and what `phase` gives at t = 0, for long increments
CONSTANTS = 35


@shared
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


@shared
def nome(k2: float, k1: float) -> float:
    """Nome of the modulus k from k² <= 1/2 and k' (DLMF 19.5.5)."""
    root = math.sqrt(k1)
    l = 0.5 * k2 / ((1.0 + k1) * (1.0 + root) * (1.0 + root))
    l4 = l * l * l * l
    return l * (1.0 + l4 * (2.0 + l4 * (15.0 + l4 * 150.0)))


@shared
def principal_axes(J: Array, V: Array, moments: Array) -> None:
    """Principal moments in ascending order and axes, rows of `V`, of a symmetric `J` by Jacobi rotations."""
    A = matrix()
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
    to_orthonormal(V, A)
    for i in range(3):
        for m in range(3):
            V[i, m] += A[i, m]


@shared
def to_orthonormal(R: Array, D: Array) -> None:
    """Set what to add to the rows of `R`: half of what is left of ``I - R Rᵀ``, Newton's step to the polar factor."""
    e00 = 0.5 * (1.0 - (R[0, 0] * R[0, 0] + R[0, 1] * R[0, 1] + R[0, 2] * R[0, 2]))
    e11 = 0.5 * (1.0 - (R[1, 0] * R[1, 0] + R[1, 1] * R[1, 1] + R[1, 2] * R[1, 2]))
    e22 = 0.5 * (1.0 - (R[2, 0] * R[2, 0] + R[2, 1] * R[2, 1] + R[2, 2] * R[2, 2]))
    e01 = -0.5 * (R[0, 0] * R[1, 0] + R[0, 1] * R[1, 1] + R[0, 2] * R[1, 2])
    e02 = -0.5 * (R[0, 0] * R[2, 0] + R[0, 1] * R[2, 1] + R[0, 2] * R[2, 2])
    e12 = -0.5 * (R[1, 0] * R[2, 0] + R[1, 1] * R[2, 1] + R[1, 2] * R[2, 2])
    for i in range(3):
        x, y, z = R[0, i], R[1, i], R[2, i]
        D[0, i] = e00 * x + e01 * y + e02 * z
        D[1, i] = e01 * x + e11 * y + e12 * z
        D[2, i] = e02 * x + e12 * y + e22 * z


@shared
def _moduli(Mx: float, My: float, Mz: float, rx: float, rz: float) -> tuple[float, float, float, float]:
    """Return ax, az, k², k'²; each a sum of squares but k'², whose difference is that of the problem."""
    ax, az = math.sqrt(Mx * Mx + rx * rx * My * My), math.sqrt(Mz * Mz + rz * rz * My * My)
    if rz == 0.0 or ax == 0.0:
        return ax, az, 0.0, 1.0
    k, b = ax * rz / (rx * az), (Mz * rx - Mx * rz) * (Mz * rx + Mx * rz) / (rx * az * rx * az)
    return ax, az, k * k, max(b, 0.0)


@shared
def body_status(J: Array, W: Array, V: Array, moments: Array) -> int:
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


@kernel("f8[:, :], f8[:], f8[:], f8[:, :] -> i8")
def prepare(J: Array, W: Array, c: Array, B: Array) -> int:
    """Set the constants `c` and the axes x, y, z, rows of `B`; `c[MOMENTUM]` is 0 at rest. Returns a status."""
    moments, V = sixteen(), matrix()
    status = body_status(J, W, V, moments)
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


@shared
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


@shared
def beginning(Mx: float, My: float, Mz: float, rz: float, c: Array) -> float:
    """Return u0, the elliptic argument at t = 0."""
    ax, az, rx = c[AX], c[AZ], c[RX]
    cn, sn, dn = (Mx / ax, rx * My / ax, Mz / az if az > 0.0 else 1.0) if ax > 0.0 else (1.0, 0.0, 1.0)
    if rz == 0.0:
        dn = 1.0
    return sn * carlson_rf(cn * cn, dn * dn, 1.0) if cn != 0.0 or dn != 0.0 else math.copysign(math.inf, sn)


@shared
def constants(Mx: float, My: float, Mz: float, rx: float, rz: float, c: Array) -> None:
    """Set the constants of the motion of the unit momentum; those of the body must be set; u0 is not set."""
    m, Ix, Iy, Iz = c[MOMENTUM], c[IX], c[IY], c[IZ]
    ax, az, k2, b2 = _moduli(Mx, My, Mz, rx, rz)
    lam = m * ((Iz - Ix) / Ix / Iz) * az * rx
    c[LAMBDA], c[AX], c[AZ], c[RX], c[RZ], c[K2] = lam, ax, az, rx, rz, k2
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


@shared
def phase(c: Array, t: float) -> tuple[float, float, float, float, float, float]:
    """Return cn, sn, dn at the time t, a complex number and an angle, whose argument and value add to ψ."""
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


@kernel("f8[:] -> f8, f8")
def period(c: Array) -> tuple[float, float]:
    """Time in which the momentum returns in the body (infinite where it does not), and what ψ gains in it."""
    if c[LAMBDA] == 0.0 or not math.isfinite(c[TWO_K]) or not math.isfinite(c[U0]):
        return math.inf, 0.0
    T = 2.0 * c[TWO_K] / abs(c[LAMBDA])
    return T, c[RATE] * T + math.copysign(2.0, c[LAMBDA]) * c[PER_TURN]
