"""Steps of the free motion of a rigid body as increments, for the Numba kernels of `split`; see `exact.free_step`."""

from __future__ import annotations

import math

from ..geometry.arrays import Array
from ..geometry.compiled import shared

OK, NOT_FINITE, NOT_SYMMETRIC, NO_BODY, NO_ROTATION, BAD_TIME, NOT_PRINCIPAL, SPIN = range(8)
FARTHEST = 1e15  # rad: round-off of a larger turn is no small angle

# Places in the array of constants.
HYPERBOLIC, POLE_X, RATE, U0, LAMBDA, TWO_K, FACTOR, NOME, SN, CN, DN = range(11)
AX, AZ, RX, PER_TURN = range(11, 15)
W1, W2, W3, W4, W5, W6, W7, W8 = range(15, 23)  # weights of the harmonics of the angle
MOMENTUM, IX, IY, IZ, K2, RZ = range(23, 29)
MX0, MY0, MZ0, X0, Y0, EXTRA0 = range(29, 35)  # unit momentum and what `phase` gives at t = 0, for long increments
SMALL, STEADY = 0.5, 1e-150
Increments = tuple[float, float, float, float, float, float, float]
Vector = tuple[float, float, float]
Motion = tuple[float, float, float, float, float, float, bool]
Turned = tuple[float, float, float, float, float, float, float]
Step = tuple[int, Vector, float, Vector]


@shared
def free_step(moments: Vector, P: Vector, h: float, c: Array) -> Step:
    """Return a status, the change of the momentum P in the time `h`, and the quaternion of Λ⁻¹Λ' as (less, v).

    It is (1 + less, v). Components along the principal axes, right-handed, of the ascending `moments`; `c`
    (CONSTANTS,) is working space.
    """
    motion = free_motion(moments, P, c)
    if abs(c[LAMBDA] * h) > SMALL:
        set_origin(motion, c)
    return free_until(motion, h, c)


@shared
def free_motion(moments: Vector, P: Vector, c: Array) -> Motion:
    """Set the constants of a free motion from the momentum P on, those of `set_origin` left out.

    Returns the unit momentum along x, y, z, the signs of these axes, whether they are the principal ones in descending
    order.
    """
    I1, I2, I3 = moments
    M1, M2, M3 = P
    m = max(abs(M1), abs(M2), abs(M3))
    if m > 0.0:
        M1, M2, M3 = M1 / m, M2 / m, M3 / m
        length = math.sqrt(M1 * M1 + M2 * M2 + M3 * M3)
        M1, M2, M3, m = M1 / length, M2 / length, M3 / length, m * length
    else:
        M3 = 1.0  # at rest: any direction, all rates are 0
    swapped, rx, rz = circled(I1, I2, I3, M1, M3)
    x, z, Ix, Iz, hand = (M3, M1, I3, I1, -1.0) if swapped else (M1, M3, I1, I3, 1.0)
    sx, sz = math.copysign(1.0, x), math.copysign(1.0, z)
    sy = hand * sx * sz
    x, y, z = sx * x, sy * M2, sz * z
    c[MOMENTUM], c[IX], c[IY], c[IZ] = m, Ix, I2, Iz
    constants(x, y, z, rx, rz, c)
    return x, y, z, sx, sy, sz, swapped


@shared
def set_origin(motion: Motion, c: Array) -> None:
    """Set the constants that long increments of a motion need beside the others."""
    x, y, z, _, _, _, _ = motion
    c[U0] = beginning(x, y, z, c[RZ], c)
    c[MX0], c[MY0], c[MZ0], c[X0], c[Y0], c[EXTRA0] = _at(0.0, c)


@shared
def free_until(motion: Motion, h: float, c: Array) -> Step:
    """Return what `free_step` does."""
    x, y, z, sx, sy, sz, swapped = motion
    m = c[MOMENTUM]
    if not abs(h) * m / min(c[IX], c[IZ]) <= FARTHEST:
        return BAD_TIME, (0.0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0)
    dx, dy, dz, less, vx, vy, vz = increments(x, y, z, h, c)
    dx, dy, dz = sx * m * dx, sy * m * dy, sz * m * dz
    vx, vy, vz = sx * vx, sy * vy, sz * vz
    if swapped:
        return OK, (dz, dy, dx), less, (vz, vy, vx)
    return OK, (dx, dy, dz), less, (vx, vy, vz)


@shared
def increments(x: float, y: float, z: float, h: float, c: Array) -> Increments:
    """Return the change of the unit momentum (x, y, z) in the time `h`; less and v as `free_step`, along x, y, z."""
    if abs(x) + abs(y) < STEADY:
        half = 0.5 * c[MOMENTUM] * h / c[IZ]
        return 0.0, 0.0, 0.0, -2.0 * math.sin(0.5 * half) ** 2, 0.0, 0.0, math.sin(half)
    near = abs(c[LAMBDA] * h) <= SMALL
    dx, dy, dz, g, X, Y, extra = _near(x, y, z, h, c) if near else _far(h, c)
    if c[POLE_X] != 0.0:
        pole, e, f, dpole, de, df, r = x, y, z, dx, dy, dz, c[RX]
    else:
        pole, e, f, dpole, de, df, r = z, x, y, dz, dx, dy, c[RZ]
    over = 1.0 / (abs(e) + abs(f))  # of the parts across the pole the directions alone count: no square vanishes
    a, b, da, db = over * e, over * f, over * de, over * df
    a1, b1 = a + da, b + db
    if near:
        if c[POLE_X] != 0.0:
            A, B = a1 * a1 + b1 * b1 - r * r * g * a * (pole + dpole) * b1, r * r * g * a * a1
        else:
            A, B = a1 * a1 + b1 * b1 - r * r * g * b * (pole + dpole) * a1, -r * r * g * b * b1
        X, Y = A * X - B * Y, A * Y + B * X
    A, B = a * a1 + b * b1, a * db - b * da  # the change of the azimuth
    X, Y = A * X + B * Y, A * Y - B * X
    e1, f1 = e + de, f + df
    A, B = math.cos(c[RATE] * h + extra), math.sin(c[RATE] * h + extra)
    X, Y = A * X - B * Y, A * Y + B * X
    r = math.sqrt(X * X + Y * Y)
    C, S = (r + X, Y) if X >= 0.0 else (Y, r - X)  # of half the angle, times 2 r (r + |X|) under a root
    w, w1 = 1.0 + pole, 1.0 + pole + dpole
    over = 0.5 / math.sqrt(w * w1 * (2.0 * r * (r + abs(X))))
    q = over * (C * (w * w1 + e * e1 + f * f1) + S * (f * de - e * df))
    one = over * (C * (w * df - dpole * f) + S * (w1 * e + w * e1))
    two = over * (C * (dpole * e - w * de) + S * (w1 * f + w * f1))
    along = over * (C * (f * de - e * df) + S * (w * w1 - e * e1 - f * f1))
    less = -(one * one + two * two + along * along) / (1.0 + q) if q >= 0.0 else q - 1.0
    if c[POLE_X] != 0.0:
        return dx, dy, dz, less, along, one, two
    return dx, dy, dz, less, one, two, along


@shared
def _near(x: float, y: float, z: float, h: float, c: Array) -> Turned:
    """Return the change of the unit momentum, g, the complex number with the argument of θ(v), and 0; |v| <= SMALL."""
    v, q, k2, rx, rz = c[LAMBDA] * h, c[NOME], c[K2], c[RX], c[RZ]
    q2 = q * q
    q4, q6, q9 = q2 * q2, q2 * q2 * q2, q2 * q2 * q2 * q2 * q
    hyperbolic = c[HYPERBOLIC] != 0.0
    w = 0.5 * c[FACTOR] * v
    if hyperbolic:
        S, C = math.sinh(w), math.cosh(w)
        t = S * S
    else:
        S, C = math.sin(w), math.cos(w)
        t = -S * S
    c2 = 1.0 + 2.0 * t
    c4 = 2.0 * c2 * c2 - 1.0
    even, odd = 1.0 + 2.0 * q4 * c4, 2.0 * (q * c2 + q9 * c2 * (2.0 * c4 - 1.0))
    theta1 = S * (1.0 - q2 * (3.0 + 4.0 * t) + q6 * (5.0 + t * (20.0 + 16.0 * t)))
    theta2 = C * (1.0 + q2 * (1.0 + 4.0 * t) + q6 * (1.0 + t * (12.0 + 16.0 * t)))
    if hyperbolic:
        sn, cn, dn = c[SN] * theta1 / theta2, 0.5 * c[CN] * (even - odd) / theta2, 0.5 * c[DN] * (even + odd) / theta2
    else:
        over = 1.0 / (even - odd)
        sn, cn, dn = c[SN] * theta1 * over, c[CN] * theta2 * over, c[DN] * (even + odd) * over
    s2 = sn * sn
    over = 2.0 * s2 / (1.0 - k2 * s2 * s2)
    less_c, less_d = over * dn * dn, over * k2 * cn * cn
    ratio = 2.0 * sn * cn * dn / (1.0 - k2 * s2 * s2) / v if v != 0.0 else 1.0
    g = c[MOMENTUM] * ((c[IZ] - c[IX]) / c[IX] / c[IZ]) * h * ratio
    square = (rx * rz * y * g) ** 2
    over = 1.0 / (1.0 - square)
    dx = over * (x * (square - less_c) - rx * rx * y * z * g * (1.0 - less_d))
    dy = over * (y * (square - less_c - less_d + less_c * less_d) + x * z * g)
    dz = over * (z * (square - less_d) - rz * rz * x * y * g * (1.0 - less_c))
    S, C, t = 2.0 * S * C, c2, 4.0 * t * (1.0 + t)  # at v
    if hyperbolic:
        X = C * (c[W2] + c[W4] * q2 * (1.0 + 4.0 * t) + c[W6] * q6 * (1.0 + t * (12.0 + 16.0 * t)))
        Y = S * (c[W1] + c[W3] * q2 * (3.0 + 4.0 * t) + c[W5] * q6 * (5.0 + t * (20.0 + 16.0 * t)))
        return dx, dy, dz, g, X, Y, 0.0
    c2, t2 = 1.0 + 2.0 * t, 2.0 * S * C
    c4, t4 = 2.0 * c2 * c2 - 1.0, 2.0 * t2 * c2
    X = 1.0 + c[W4] * c2 + c[W5] * c4 + c[W6] * c2 * (2.0 * c4 - 1.0)
    return dx, dy, dz, g, X, c[W1] * t2 + c[W2] * t4 + c[W3] * t2 * (2.0 * c4 + 1.0), 0.0


@shared
def _at(h: float, c: Array) -> tuple[float, float, float, float, float, float]:
    """Return the unit momentum at the time `h` and the angle about it, less RATE h, as `phase` does."""
    cn, sn, dn, X, Y, extra = phase(c, h)
    x, y, z = c[AX] * cn, c[AX] / c[RX] * sn, c[AZ] * dn
    over = 1.0 / math.sqrt(x * x + y * y + z * z)
    return over * x, over * y, over * z, X, Y, extra


@shared
def _far(h: float, c: Array) -> Turned:
    """Return the change of the unit momentum, 0, and the turning about it, less RATE h: a complex number, an angle."""
    x, y, z, X, Y, extra = _at(h, c)
    X, Y = X * c[X0] + Y * c[Y0], Y * c[X0] - X * c[Y0]
    return x - c[MX0], y - c[MY0], z - c[MZ0], 0.0, X, Y, extra - c[EXTRA0]


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
def _moduli(Mx: float, My: float, Mz: float, rx: float, rz: float) -> tuple[float, float, float, float]:
    """Return ax, az, k², k'²; each a sum of squares but k'², whose difference is that of the problem."""
    ax, az = math.sqrt(Mx * Mx + rx * rx * My * My), math.sqrt(Mz * Mz + rz * rz * My * My)
    if rz == 0.0 or ax == 0.0:
        return ax, az, 0.0, 1.0
    k, b = ax * rz / (rx * az), (Mz * rx - Mx * rz) * (Mz * rx + Mx * rz) / (rx * az * rx * az)
    return ax, az, k * k, max(b, 0.0)


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
