"""One step of the free motion of a rigid body as increments, for marches of many steps.

A march that evaluates the closed solution of `free_bodies` anew at every step adds up rounding errors of values of
order 1. Here each increment is computed to full relative accuracy, so that the errors of a march shrink with its steps.

**Momentum.** In the notation of `free_bodies` (unit momentum M, axes x, y, z), with v = λ h and s, c, d = sn v, cn v,
dn v, the addition theorem of Jacobi's functions (DLMF 22.8) gives

    g = |M| δ h s/v,      D = 1 - (rx rz My g)²,
    Mx' = (Mx c - rx² My Mz g d)/D,    My' = (My c d + Mx Mz g)/D,    Mz' = (Mz d - rz² Mx My g c)/D,

with no singular factor and without u0. Insert c = 1 - (1 - c), d = 1 - (1 - d) to get M' - M without cancellation. The
functions at v follow from σ, γ, ε = sn, cn, dn of v/2 (DLMF 22.6.5 to 22.6.7):

    s = 2 σ γ ε/N,    1 - c = 2 σ² ε²/N,    1 - d = 2 k² σ² γ²/N,    N = 1 - k² σ⁴.

The momentum is not normalised.

**Attitude.** The angle about the momentum gains rate h + arg θ(v) and what the addition theorem of the third elliptic
integral (DLMF 19.11) adds. With sn, cn, dn(a_z, k') = az, ax, ax/rx and sn, cn, dn(a_x, k') = rx, rz, rz/az that is
arg(A - i B) for the pole z, with r = rz, and arg(A + i B) for the pole x, with r = rx:

    A = |M'_⊥|² - r² g My Mx' Mz',      B = r² g My My',      M_⊥ the part of M across the pole.

With S the smallest rotation that takes the pole to M, and α the azimuth of M about the pole, the step turns the body by

    Λ⁻¹ Λ' = S R_pole(Ψ) S'⁻¹,      Ψ = ψ' - ψ - (α' - α),

whose quaternion is a sum of products with one small factor each. S is regular: M·pole > -0.71.

Steps with |v| > 1/2 are evaluated from u0 as in `free_bodies`: the error of their phase, an ulp of the turn, is as
large as that of the differences.
"""

from __future__ import annotations

import math

from ..geometry.arrays import Array
from ..geometry.compiled import shared
from .free_constants import (
    AX,
    AZ,
    BAD_TIME,
    CN,
    DN,
    EXTRA0,
    FACTOR,
    FARTHEST,
    HYPERBOLIC,
    IX,
    IY,
    IZ,
    K2,
    LAMBDA,
    MOMENTUM,
    MX0,
    MY0,
    MZ0,
    NOME,
    OK,
    POLE_X,
    RATE,
    RX,
    RZ,
    SN,
    U0,
    W1,
    W2,
    W3,
    W4,
    W5,
    W6,
    X0,
    Y0,
    beginning,
    circled,
    constants,
    phase,
)

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
