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

from typing import Any, NamedTuple

from ..kernels.control import Variables, when
from ..kernels.elementary import sine_and_cosine
from ..kernels.elements import any_of, copysign, cosh, logical_not, select, sinh, smaller, sqrt
from ..kernels.kernel import part
from ..kernels.memory import View
from ..kernels.vectors import Vector
from .free_constants import (
    BAD_TIME,
    FARTHEST,
    OK,
    beginning,
    circled,
    direction_and_norm,
    harmonics,
    phase,
    set_constants,
    thetas,
)

SMALL, STEADY = 0.5, 1e-150


class FreeMotion(NamedTuple):
    """A free motion: the unit momentum along x, y, z, the signs of these axes, whether they are in descending order."""

    M: Vector
    signs: Vector
    is_swapped: Any


def free_step(moments: Vector, P: Vector, h: Any, c: View) -> tuple[Any, Vector, Any, Vector]:
    """Return a status, the change of the momentum P in the time `h`, and the quaternion of Λ⁻¹Λ' as (cosm1, v).

    It is (1 + cosm1, v). Components along the principal axes, right-handed, of the ascending `moments`; `c` (Constants)
    is working space.
    """
    motion = free_motion(moments, P, c)
    for _ in when(abs(c.pace * h) > SMALL):
        set_origin(motion, c)
    return free_until(motion, h, c)


def free_motion(moments: Vector, P: Vector, c: View) -> FreeMotion:
    """Set the constants of a free motion from the momentum P on, those of `set_origin` left out."""
    (I1, I2, I3), (M, m) = moments, direction_and_norm(P)
    is_swapped, rx, rz = circled(I1, I2, I3, M[0], M[2])
    x, z = select(is_swapped, M[2], M[0]), select(is_swapped, M[0], M[2])
    sx, sz = copysign(1.0, x), copysign(1.0, z)
    signs = Vector(sx, select(is_swapped, -1.0, 1.0) * sx * sz, sz)
    M = signs * Vector(x, M[1], z)
    c.momentum, c.ix, c.iy, c.iz = m, select(is_swapped, I3, I1), I2, select(is_swapped, I1, I3)
    set_constants(M, rx, rz, c)
    return FreeMotion(M, signs, is_swapped)


def set_origin(motion: FreeMotion, c: View) -> None:
    """Set the constants that long increments of a motion need beside the others."""
    c.u0 = beginning(motion.M, c)
    c.start, c.x0, c.y0, c.angle0 = _state_at(0.0 * c.pace, c)


def free_until(motion: FreeMotion, h: Any, c: View) -> tuple[Any, Vector, Any, Vector]:
    """Return what `free_step` does."""
    m, zero = c.momentum, 0.0 * h
    v = Variables(status=BAD_TIME, d=Vector(zero, zero, zero), cosm1=zero, v=Vector(zero, zero, zero))
    is_far = logical_not(abs(h) * m / smaller(c.ix, c.iz) <= FARTHEST)
    for _ in when(logical_not(any_of(is_far))):
        d, cosm1, turn = increments(motion.M, h, c)
        d, turn = motion.signs * (m * d), motion.signs * turn
        v.d, v.v = (select(motion.is_swapped, Vector(x[2], x[1], x[0]), x) for x in (d, turn))
        v.status, v.cosm1 = OK, cosm1
    return v.status, v.d, v.cosm1, v.v


@part
def increments(M: Vector, h: Any, c: View) -> tuple[Vector, Any, Vector]:
    """Return the change of the unit momentum M in the time `h`; cosm1 and v as `free_step`, along x, y, z."""
    zero = 0.0 * h
    v = Variables(d=Vector(zero, zero, zero), cosm1=zero, v=Vector(zero, zero, zero))
    is_steady = abs(M[0]) + abs(M[1]) < STEADY
    for _ in when(is_steady):
        half = 0.5 * c.momentum * h / c.iz
        quarter = sine_and_cosine(0.5 * half)[0]
        v.cosm1, v.v = -2.0 * quarter * quarter, Vector(zero, zero, sine_and_cosine(half)[0])
    for _ in when(logical_not(is_steady)):
        v.d, v.cosm1, v.v = _increments(M, h, c)
    return v.d, v.cosm1, v.v


def _increments(M: Vector, h: Any, c: View) -> tuple[Vector, Any, Vector]:
    """Return what `increments` does, for a momentum that is not steady."""
    near, is_x = abs(c.pace * h) <= SMALL, c.pole_x != 0.0
    v = Variables(found=(0.0 * h,) * 7)
    for _ in when(any_of(near)):
        v.found = _near(M, h, c)
    for _ in when(any_of(logical_not(near))):
        v.found = select(near, v.found, _far(h, c))
    dx, dy, dz, g, X, Y, angle = v.found
    d = Vector(dx, dy, dz)
    # The pole and the two axes across it.
    pole, e, f = select(is_x, (M[0], M[1], M[2]), (M[2], M[0], M[1]))
    dpole, de, df = select(is_x, (dx, dy, dz), (dz, dx, dy))
    r = select(is_x, c.rx, c.rz)
    over = 1.0 / (abs(e) + abs(f))  # of the parts across the pole the directions alone count: no square vanishes
    a, b, da, db = over * e, over * f, over * de, over * df
    a1, b1 = a + da, b + db
    A = a1 * a1 + b1 * b1 - r * r * g * select(is_x, a * (pole + dpole) * b1, b * (pole + dpole) * a1)
    B = r * r * g * select(is_x, a * a1, -(b * b1))
    X, Y = select(near, A * X - B * Y, X), select(near, A * Y + B * X, Y)
    A, B = a * a1 + b * b1, a * db - b * da  # the change of the azimuth
    X, Y = A * X + B * Y, A * Y - B * X
    e1, f1 = e + de, f + df
    B, A = sine_and_cosine(c.rate * h + angle)
    X, Y = A * X - B * Y, A * Y + B * X
    r = sqrt(X * X + Y * Y)
    C, S = select(X >= 0.0, (r + X, Y), (Y, r - X))  # of half the angle, times 2 r (r + |X|) under a root
    w, w1 = 1.0 + pole, 1.0 + pole + dpole
    over = 0.5 / sqrt(w * w1 * (2.0 * r * (r + abs(X))))
    q = over * (C * (w * w1 + e * e1 + f * f1) + S * (f * de - e * df))
    one = over * (C * (w * df - dpole * f) + S * (w1 * e + w * e1))
    two = over * (C * (dpole * e - w * de) + S * (w1 * f + w * f1))
    along = over * (C * (f * de - e * df) + S * (w * w1 - e * e1 - f * f1))
    cosm1 = select(q >= 0.0, -(one * one + two * two + along * along) / (1.0 + q), q - 1.0)
    return d, cosm1, Vector(*select(is_x, (along, one, two), (one, two, along)))


def _near(M: Vector, h: Any, c: View) -> tuple[Any, ...]:
    """Return the change of the unit momentum, g, the complex number with the argument of θ(v), and 0; |v| <= SMALL."""
    (x, y, z), v, k2, rx, rz, w = M, c.pace * h, c.k2, c.rx, c.rz, c.w
    q2 = c.nome * c.nome
    q6 = q2 * q2 * q2
    is_hyperbolic, half = c.hyperbolic != 0.0, 0.5 * c.factor * v
    s = Variables(S=half, C=half)
    for _ in when(is_hyperbolic):
        s.S, s.C = sinh(half), cosh(half)
    for _ in when(logical_not(is_hyperbolic)):
        s.S, s.C = sine_and_cosine(half)
    S, C, t = s.S, s.C, select(is_hyperbolic, s.S * s.S, -(s.S * s.S))
    theta1, theta2, theta3, theta4 = thetas(c.nome, S, C, t)
    over = 1.0 / select(is_hyperbolic, theta2, theta4)
    sn = c.sn * theta1 * over
    cn = c.cn * select(is_hyperbolic, 0.5 * theta4, theta2) * over
    dn = c.dn * select(is_hyperbolic, 0.5, 1.0) * theta3 * over
    s2 = sn * sn
    over = 2.0 * s2 / (1.0 - k2 * s2 * s2)
    one_minus_c, one_minus_d = over * dn * dn, over * k2 * cn * cn
    ratio = select(v != 0.0, 2.0 * sn * cn * dn / (1.0 - k2 * s2 * s2) / v, 1.0)
    g = c.momentum * ((c.iz - c.ix) / c.ix / c.iz) * h * ratio
    part_of_square = rx * rz * y * g
    square = part_of_square * part_of_square
    over = 1.0 / (1.0 - square)
    dx = over * (x * (square - one_minus_c) - rx * rx * y * z * g * (1.0 - one_minus_d))
    dy = over * (y * (square - one_minus_c - one_minus_d + one_minus_c * one_minus_d) + x * z * g)
    dz = over * (z * (square - one_minus_d) - rz * rz * x * y * g * (1.0 - one_minus_c))
    S, C, t = 2.0 * S * C, 1.0 + 2.0 * t, 4.0 * t * (1.0 + t)  # at v
    X = C * (w[1] + w[3] * q2 * (1.0 + 4.0 * t) + w[5] * q6 * (1.0 + t * (12.0 + 16.0 * t)))
    Y = S * (w[0] + w[2] * q2 * (3.0 + 4.0 * t) + w[4] * q6 * (5.0 + t * (20.0 + 16.0 * t)))
    return dx, dy, dz, g, *select(is_hyperbolic, (X, Y), harmonics(w, S, C, t)), 0.0 * h


def _state_at(h: Any, c: View) -> tuple[Vector, Any, Any, Any]:
    """Return the unit momentum at the time `h` and the angle about it, less RATE h, as `phase` does."""
    cn, sn, dn, X, Y, angle = phase(c, h)
    M = Vector(c.ax * cn, c.ax / c.rx * sn, c.az * dn)
    return M / sqrt(M[0] * M[0] + M[1] * M[1] + M[2] * M[2]), X, Y, angle


def _far(h: Any, c: View) -> tuple[Any, ...]:
    """Return the change of the unit momentum, 0, and the turning about it, less RATE h: a complex number, an angle."""
    M, X, Y, angle = _state_at(h, c)
    X, Y = X * c.x0 + Y * c.y0, Y * c.x0 - X * c.y0
    return (*(M - c.start), 0.0 * h, X, Y, angle - c.angle0)
