"""The constants of a free rigid body and its elliptic functions, compiled; `free_bodies` derives them.

`set_constants` turns a body and its start into the constants below, `phase` evaluates the elliptic functions and the
angle about the momentum at one time.

Axes, ax, az, rx, rz, k, u and λ are those of `free_bodies`; the momentum has unit length. For k² <= 1/2 the theta
functions have the nome q(k) and the argument π u/(2K); for k² > 1/2 they have the complementary nome p = q(k') and the
imaginary argument i v, v = π u/(2K'), u reduced to |u| <= K. Neither nome exceeds e^(-π) = 0.0432, so that q^13 is
below round-off.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

from ..kernels.control import Variables, when, whilst
from ..kernels.elementary import sine_and_cosine
from ..kernels.elements import any_of, copysign, cos, exp, floor, larger, log, logical_not, select, sin, sqrt
from ..kernels.kernel import part
from ..kernels.memory import View, size_of
from ..kernels.vectors import AXES, Matrix, Vector

OK, BAD_TIME = range(2)
FARTHEST = 1e15  # rad: round-off of a larger turn is no small angle
_SWEEPS = 16
NEAR = 0.008  # of arguments of R_F to their mean, from which on its series is right to round-off


class Constants(NamedTuple):
    """Constants of a free motion; those from `momentum` to `iz` are of the body, and set first.

    Attributes
    ----------
    momentum, ix, iy, iz : float
        Size of the momentum; moments about the axes x, y, z.
    hyperbolic, pole_x : float
        1 for k² > 1/2, and where the pole is x; else 0.
    rate, u0, pace, two_k, factor, nome, per_turn : float
        Of the angle about the momentum; u at t = 0, and λ; 2K, the argument of the theta functions over u, the nome;
        what the angle gains for 2K.
    sn, cn, dn : float
        Factors of the elliptic functions.
    ax, az, rx, rz, k2 : float
        As `free_bodies`.
    w : tuple
        Weights of the harmonics of the angle.
    start, x0, y0, angle0 : Vector, float
        The unit momentum and what `phase` gives at t = 0, for long increments.
    """

    momentum: float
    ix: float
    iy: float
    iz: float
    hyperbolic: float
    pole_x: float
    rate: float
    u0: float
    pace: float
    two_k: float
    factor: float
    nome: float
    per_turn: float
    sn: float
    cn: float
    dn: float
    ax: float
    az: float
    rx: float
    rz: float
    k2: float
    w: Annotated[tuple[Any, ...], 8]
    start: Vector
    x0: float
    y0: float
    angle0: float


CONSTANTS = size_of(Constants)


@part
def carlson_rf(x: Any, y: Any, z: Any) -> Any:
    """Return Carlson's symmetric integral R_F(x, y, z) by duplication (DLMF 19.36); at most one argument 0."""
    v = Variables(x=x, y=y, z=z, count=0)

    def is_active() -> Any:
        mean = (v.x + v.y + v.z) / 3.0
        return larger(abs(mean - v.x), larger(abs(mean - v.y), abs(mean - v.z))) >= NEAR * abs(mean)

    v.active = is_active()
    for _ in whilst(lambda: any_of(v.active) & (v.count < 64)):
        sx, sy, sz = sqrt(v.x), sqrt(v.y), sqrt(v.z)
        shift = sx * (sy + sz) + sy * sz
        v.x, v.y, v.z = (select(v.active, 0.25 * (u + shift), u) for u in (v.x, v.y, v.z))
        v.active, v.count = is_active(), v.count + 1
    mean = (v.x + v.y + v.z) / 3.0
    a, b = 1.0 - v.x / mean, 1.0 - v.y / mean
    c = -a - b
    e2, e3 = a * b - c * c, a * b * c
    series = 1.0 - e2 / 10.0 + e3 / 14.0 + e2 * e2 / 24.0 - 3.0 * e2 * e3 / 44.0
    series = series - 5.0 * e2 * e2 * e2 / 208.0 + 3.0 * e3 * e3 / 104.0 + e2 * e2 * e3 / 16.0
    return series / sqrt(mean)


def _nome(k2: Any, k1: Any) -> Any:
    """Return the nome of the modulus k from k² <= 1/2 and k' (DLMF 19.5.5)."""
    root = sqrt(k1)
    l = 0.5 * k2 / ((1.0 + k1) * (1.0 + root) * (1.0 + root))
    l4 = l * l * l * l
    return l * (1.0 + l4 * (2.0 + l4 * (15.0 + l4 * 150.0)))


def jacobi_axes(J: Matrix) -> tuple[Matrix, Vector]:
    """Return the axes of a symmetric J, as rows, and its principal moments, by Jacobi rotations.

    The moments are in ascending order, the axes right-handed.
    """
    v = Variables(rows=Matrix(*AXES), d=Vector(J[0][0], J[1][1], J[2][2]), done=False, count=0)
    v.off = 0.5 * Vector(J[1][2] + J[2][1], J[0][2] + J[2][0], J[0][1] + J[1][0])  # entry l is across from l
    for _ in whilst(lambda: logical_not(v.done) & (v.count < _SWEEPS)):
        v.done, v.count = True, v.count + 1
        for i, j, l in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
            off, square = v.off[l], 1e-36 * abs(v.d[i] * v.d[j])
            for _ in when(off * off > square):
                v.done = False
                half = 0.5 * (v.d[j] - v.d[i]) / off
                t = copysign(1.0, half) / (abs(half) + sqrt(1.0 + half * half))
                c = 1.0 / sqrt(1.0 + t * t)
                s = t * c
                d, o, rows = list(v.d), list(v.off), list(v.rows)
                d[i], d[j] = d[i] - t * off, d[j] + t * off
                o[j], o[i], o[l] = c * o[j] - s * o[i], s * o[j] + c * o[i], 0.0 * off
                rows[i], rows[j] = c * rows[i] - s * rows[j], s * rows[i] + c * rows[j]
                v.d, v.off, v.rows = Vector(*d), Vector(*o), Matrix(*rows)
    moments, rows = list(v.d), list(v.rows)
    for i, j in ((0, 1), (1, 2), (0, 1)):
        is_larger = moments[i] > moments[j]
        moments[i], moments[j] = select(is_larger, (moments[j], moments[i]), (moments[i], moments[j]))
        rows[i], rows[j] = select(is_larger, (rows[j], -rows[i]), (rows[i], rows[j]))
    return Matrix(*rows) + to_orthonormal(Matrix(*rows)), Vector(*moments)


def to_orthonormal(R: Matrix) -> Matrix:
    """Return what to add to the rows of R: half of what is left of ``I - R Rᵀ``, Newton's step to the polar factor."""
    E = Matrix(*(Vector(*(0.5 * ((1.0 if i == j else 0.0) - a @ b) for j, b in enumerate(R))) for i, a in enumerate(R)))
    return Matrix(*(row[0] * R[0] + row[1] * R[1] + row[2] * R[2] for row in E))


def _moduli(M: Vector, rx: Any, rz: Any) -> tuple[Any, Any, Any, Any]:
    """Return ax, az, k², k'²; each a sum of squares but k'², whose difference is that of the problem."""
    ax, az = sqrt(M[0] * M[0] + rx * rx * M[1] * M[1]), sqrt(M[2] * M[2] + rz * rz * M[1] * M[1])
    k, b = ax * rz / (rx * az), (M[2] * rx - M[0] * rz) * (M[2] * rx + M[0] * rz) / (rx * az * rx * az)
    is_round = (rz == 0.0) | (ax == 0.0)
    return ax, az, select(is_round, 0.0, k * k), select(is_round, 1.0, larger(b, 0.0))


def direction_and_norm(M: Vector) -> tuple[Vector, Any]:
    """Return the direction of a momentum, the third axis for none, and its size; no square vanishes or overflows."""
    size = larger(abs(M[0]), larger(abs(M[1]), abs(M[2])))
    is_moving = size > 0.0
    M = M / select(is_moving, size, 1.0)
    length = sqrt(M[0] * M[0] + M[1] * M[1] + M[2] * M[2])
    M = M / select(is_moving, length, 1.0)
    return Vector(M[0], M[1], select(is_moving, M[2], 1.0)), select(is_moving, size * length, 0.0)


def circled(I1: Any, I2: Any, I3: Any, M1: Any, M3: Any) -> tuple[Any, Any, Any]:
    """Return whether the axis z that the unit momentum circles is the one of the smallest moment I1; rx and rz."""
    is_body = I3 > I1  # else spherical
    r1 = select(is_body, sqrt((I1 / I2) * ((I3 - I2) / (I3 - I1))), 1.0)
    r3 = select(is_body, sqrt((I3 / I2) * ((I2 - I1) / (I3 - I1))), 0.0)
    side = abs(M3) * r1 - abs(M1) * r3
    stays = (side > 0.0) | ((side == 0.0) & (r1 >= r3))
    return logical_not(stays), select(stays, r1, r3), select(stays, r3, r1)


def beginning(M: Vector, c: View) -> Any:
    """Return u0, the elliptic argument at t = 0."""
    ax, az, rx = c.ax, c.az, c.rx
    is_moving = ax > 0.0
    cn, sn = select(is_moving, M[0] / ax, 1.0), select(is_moving, rx * M[1] / ax, 0.0)
    dn = select(is_moving & (az > 0.0) & (c.rz != 0.0), M[2] / az, 1.0)
    found = sn * carlson_rf(cn * cn, dn * dn, 0.0 * cn + 1.0)
    return select((cn != 0.0) | (dn != 0.0), found, copysign(math.inf, sn))


@part
def set_constants(M: Vector, rx: Any, rz: Any, c: View) -> None:
    """Set the constants of the motion of the unit momentum; those of the body must be set; u0 is not set."""
    m, Ix, Iy, Iz = c.momentum, c.ix, c.iy, c.iz
    ax, az, k2, b2 = _moduli(M, rx, rz)
    lam, one = m * ((Iz - Ix) / Ix / Iz) * az * rx, 0.0 * rx + 1.0
    c.pace, c.ax, c.az, c.rx, c.rz, c.k2 = lam, ax, az, rx, rz, k2
    is_x = rx < rz
    sign = select(is_x, -1.0, 1.0)
    c.pole_x, c.per_turn = select(is_x, 1.0, 0.0), 0.0
    q = _nome(select(k2 <= 0.5, k2, b2), sqrt(select(k2 <= 0.5, b2, k2)))
    q2 = q * q
    q4, q6, q9 = q2 * q2, q2 * q2 * q2, q2 * q2 * q2 * q2 * q
    theta3, theta4, theta2 = 1.0 + 2.0 * (q + q4 + q9), 1.0 - 2.0 * (q - q4 + q9), 1.0 + q2 + q6
    two_k = math.pi * theta3 * theta3
    c.factor, c.nome = math.pi / two_k, q
    for _ in when(k2 <= 0.5):
        # e^(-π a/K), sn(a, k') = rx: the weight of the first harmonic for the pole z, q/g that for x
        s = Variables(g=0.0 * rx)
        for _ in when(rz > 0.0):
            s.g = exp(-2.0 * math.pi / two_k * rx * carlson_rf(rz * rz, (rz / az) * (rz / az), one))
        g = s.g
        f = select(g > 0.0, q * q / g, 0.0)
        g, f = select(is_x, q / g, g), select(is_x, q * g, f)
        g2, f2, g3, f3 = g * g, f * f, g * g * g, f * f * f
        odd = sign * (g - f), -sign * q2 * (g2 - f2), sign * q6 * (g3 - f3)
        even = -(g + f), q2 * (g2 + f2), -q6 * (g3 + f3)
        c.w = (*odd, *even, 0.0, 0.0)
        zeta = 2.0 * ((g - f) - 2.0 * q2 * (g2 - f2) + 3.0 * q6 * (g3 - f3))
        zeta = zeta * (math.pi / two_k / (1.0 + even[0] + even[1] + even[2]))
        c.rate = m / select(is_x, Iz, Ix) - sign * lam * zeta
        c.hyperbolic, c.two_k = 0.0, two_k
        c.sn, c.cn, c.dn = theta3 / theta2, theta4 / theta2, theta4 / theta3
    for _ in when(logical_not(k2 <= 0.5)):
        a, x, y = select(is_x, (rx, rz, rz / az), (az, ax, ax / rx))
        a = a * carlson_rf(x * x, y * y, one)
        zeta = math.pi * a / two_k
        c.w = tuple(x for n in (1.0, 3.0, 5.0, 7.0) for x in (sign * sin(n * zeta), cos(n * zeta)))
        z = 4.0 * math.pi / two_k * (q * sin(2.0 * zeta) - 2.0 * q4 * sin(4.0 * zeta) + 3.0 * q9 * sin(6.0 * zeta))
        z = z / (1.0 - 2.0 * (q * cos(2.0 * zeta) - q4 * cos(4.0 * zeta) + q9 * cos(6.0 * zeta)))
        c.rate = select(is_x, m / Iy - lam * z, m * (ax * ax / Ix + az * az / Iz) + lam * z)
        c.hyperbolic, c.per_turn = 1.0, sign * 2.0 * zeta
        c.two_k = select(q > 0.0, -two_k * log(q) / math.pi, math.inf)
        c.sn, c.cn, c.dn = theta3 / theta4, 2.0 * theta2 / theta4, 2.0 * theta2 / theta3


@part
def phase(c: View, t: Any) -> tuple[Any, ...]:
    """Return cn, sn, dn at the time t, a complex number and an angle, whose argument and value add to ψ."""
    v, u = Variables(found=(0.0 * t,) * 6), c.u0 + c.pace * t
    for _ in when(c.hyperbolic == 0.0):
        v.found = _circular(c, u)
    for _ in when(c.hyperbolic != 0.0):
        v.found = _hyperbolic(c, u)
    return v.found


def thetas(q: Any, S: Any, C: Any, t: Any) -> tuple[Any, Any, Any, Any]:
    """Return θ1 and θ2 over 2 q^(1/4), θ3, θ4 at z, from sin z, cos z, -sin² z; at i z from sinh z, cosh z, sinh² z."""
    q2 = q * q
    q4, q6, q9 = q2 * q2, q2 * q2 * q2, q2 * q2 * q2 * q2 * q
    c2 = 1.0 + 2.0 * t
    c4 = 2.0 * c2 * c2 - 1.0
    even, odd = 1.0 + 2.0 * q4 * c4, 2.0 * (q * c2 + q9 * c2 * (2.0 * c4 - 1.0))
    theta1 = S * (1.0 - q2 * (3.0 + 4.0 * t) + q6 * (5.0 + t * (20.0 + 16.0 * t)))
    theta2 = C * (1.0 + q2 * (1.0 + 4.0 * t) + q6 * (1.0 + t * (12.0 + 16.0 * t)))
    return theta1, theta2, even + odd, even - odd


def harmonics(w: Any, S: Any, C: Any, t: Any) -> tuple[Any, Any]:
    """Return the complex number of the angle at z from its weights, sin z, cos z and -sin² z."""
    c2, s2 = 1.0 + 2.0 * t, 2.0 * S * C
    c4, s4 = 2.0 * c2 * c2 - 1.0, 2.0 * s2 * c2
    X = 1.0 + w[3] * c2 + w[4] * c4 + w[5] * c2 * (2.0 * c4 - 1.0)
    return X, w[0] * s2 + w[1] * s4 + w[2] * s2 * (2.0 * c4 + 1.0)


def _circular(c: View, u: Any) -> tuple[Any, ...]:
    S, C = sine_and_cosine(c.factor * u)
    theta1, theta2, theta3, theta4 = thetas(c.nome, S, C, -(S * S))
    over = 1.0 / theta4
    return c.cn * theta2 * over, c.sn * theta1 * over, c.dn * theta3 * over, *harmonics(c.w, S, C, -(S * S)), 0.0 * S


def _hyperbolic(c: View, u: Any) -> tuple[Any, ...]:
    q, w, two_k = c.nome, c.w, c.two_k
    turns = select(two_k < math.inf, floor(u / two_k + 0.5), 0.0)
    u = select(two_k < math.inf, u - turns * two_k, u)
    E = exp(-c.factor * abs(u))
    e = E * E
    g = select(q > 0.0, q / e, 0.0)
    q2, e2, g2 = q * q, e * e, g * g
    q4, q6 = q2 * q2, q2 * q2 * q2
    a, b = q * g, q2 * e2
    a2, b2, a3 = q4 * g2, q6 * e2 * e, q6 * q2 * q * g2 * g
    over = 1.0 / (1.0 + e + a + b + a2 + b2 + a3)
    even, odd = 1.0 + q2 * g2 + q4 * e2, g + q * e + q6 * (g2 * g + q2 * q * e2 * e)
    sign, half = select(u >= 0.0, 1.0, -1.0), select(0.5 * turns == floor(0.5 * turns), 1.0, -1.0)
    sn = half * sign * c.sn * (1.0 - e - a + b + a2 - b2 - a3) * over
    cn, dn = half * c.cn * E * (even - odd) * over, c.dn * E * (even + odd) * over
    X = w[1] * (1.0 + e) + w[3] * (a + b) + w[5] * (a2 + b2) + w[7] * a3
    Y = sign * (w[0] * (1.0 - e) + w[2] * (a - b) + w[4] * (a2 - b2) + w[6] * a3)
    return cn, sn, dn, X, Y, turns * c.per_turn
