"""The constants of a free gyrostat: axes, quartic, roots, periods and poles; `gyrostats` derives them.

What may cancel is computed with 120 decimal digits, from J, c and W as they are in double precision: axes and rates,
the invariants of the quartic, their roots and the differences of these. All else is positive sums and products, where
double precision loses nothing.
"""

from __future__ import annotations

import cmath
import math
from decimal import Decimal, localcontext
from typing import Any, NamedTuple

import numpy as np

from ..geometry.arrays import Array, cross
from .free_constants import carlson_rf

DIGITS = 120
ZERO = Decimal(0)
_STOP, _NONE, _STEADY, _LEAST = Decimal(10) ** (6 - DIGITS), Decimal(10) ** -DIGITS, Decimal(10) ** -45, 1e-100
Vector = Any  # array of decimals
_exact: Any = np.frompyfunc(lambda x: Decimal(float(x)), 1, 1)


class Lattice(NamedTuple):
    """The periods of the motion and the poles of z."""

    half: float  # half of the real period; infinite where the momentum does not return
    base: complex  # the half-period that theta functions are taken with, real or imaginary
    tau: complex
    poles: tuple[complex, complex]


class Gyrostat(NamedTuple):
    """A body with its rotors at the start."""

    inverse: Array  # (3, 3) D
    length: float  # L
    frame: Array  # (3, 3) rows e1, e2, e3
    pace: float  # 1/s, no part of W or of the motion of P in the body is faster by far
    unit: float  # of time, for what follows, 1/s: a power of two
    W: Array  # (3,) along e1, e2, e3
    lattice: Lattice | None  # None: W is constant


class Number:
    """A complex number of many digits."""

    __slots__ = ("x", "y")

    def __init__(self, x: Decimal, y: Decimal = ZERO) -> None:
        self.x, self.y = x, y

    def __add__(self, other: Number) -> Number:
        return Number(self.x + other.x, self.y + other.y)

    def __sub__(self, other: Number) -> Number:
        return Number(self.x - other.x, self.y - other.y)

    def __mul__(self, other: Number | Decimal | int) -> Number:
        if not isinstance(other, Number):
            return Number(self.x * other, self.y * other)
        return Number(self.x * other.x - self.y * other.y, self.x * other.y + self.y * other.x)

    def __truediv__(self, other: int) -> Number:
        return Number(self.x / other, self.y / other)

    def conjugate(self) -> Number:
        """Return x - iy."""
        return Number(self.x, -self.y)

    def root(self) -> Number:
        """Return the square root, of real part >= 0."""
        size = (self.x * self.x + self.y * self.y).sqrt()
        if not size:
            return Number(ZERO)
        a = ((size + abs(self.x)) / 2).sqrt()
        b = self.y / (2 * a)
        return Number(a, b) if self.x >= 0 else Number(abs(b), a.copy_sign(self.y))

    def rounded(self) -> complex:
        """Return it in double precision; its zeros are positive, on the upper side of cuts."""
        return complex(float(self.x) + 0.0, float(self.y) + 0.0)


def gyrostat(J: Array, c: Array, W: Array) -> Gyrostat:
    """Return the constants of the motion from W on."""
    with localcontext() as context:
        context.prec = DIGITS
        inertia, rotor, velocity = _exact(J), _exact(c), _exact(W)
        adjugate = cross(inertia[[1, 2, 0]], inertia[[2, 0, 1]])
        D = adjugate / (inertia[0] @ adjugate[0])
        P = inertia @ velocity + rotor
        L = (P @ P).sqrt()
        frame = _frame(P / L) if L else _exact(np.eye(3))
        A = L * frame @ (D - np.trace(D) / 3 * _exact(np.eye(3))) @ frame.T  # a sphere turns nothing
        b, local = frame @ D @ rotor, frame @ velocity
        pace = ((A * A).sum() + b @ b + local @ local).sqrt()
        found, unit = None, 1.0
        if L and local[0] ** 2 + local[1] ** 2 > (_STEADY * pace) ** 2:
            unit = math.ldexp(1.0, math.frexp(float(pace))[1])
            rates = np.array([(A[0, 0] - A[1, 1]) / 2, A[0, 1], A[0, 0] + A[1, 1] - 2 * A[2, 2]])
            found = _lattice(*(part / Decimal(unit) for part in (rates, b, local)))
        inverse, axes, along = (part.astype(np.float64) for part in (D, frame, local))
    return Gyrostat(inverse, float(L), axes, float(pace), unit, along / unit, found)


def _frame(n: Vector) -> Vector:
    """Return a rotation whose third row is `n`, with zeros where `n` is an axis."""
    first: Any = cross(n, _exact(np.eye(3))[abs(n).argmin()])
    first = first / (first @ first).sqrt()
    return np.array([first, cross(n, first), n])


def _lattice(rates: Vector, b: Vector, W: Vector) -> Lattice:
    """Return the periods and poles from the `rates` Re m, -Im m and f - 2 b3, and from b and W."""
    m, beta = Number(rates[0], -rates[1]), Number(W[0], -W[1])
    gamma = (beta + Number(b[0], -b[1]) * 2) * -1
    quartic = _quartic(m, beta, gamma, rates[2] + 2 * b[2], b[2])
    first, second, third = _roots(*_invariants(quartic))
    is_real = not second.y
    slope, y, a2 = Number(beta.y, beta.x) / 2, quartic[4].root(), quartic[2] / 12
    poles = []
    for sign in (1, -1):
        p = a2 + slope * y * sign / 2
        change = (quartic[1] * y * sign + slope * quartic[3]) / -4
        poles.append(_pole([(p - e).rounded() for e in (first, second, third)], change.rounded()))
    if is_real:
        e1, e2, e3 = sorted((first.x, second.x, third.x), reverse=True)
        span, upper, lower = e1 - e3, e1 - e2, e2 - e3
    else:
        span = ((3 * first.x / 2) ** 2 + second.y**2).sqrt()
        upper, lower = (span / 2 + sign * 3 * first.x / 4 for sign in (1, -1))
    real, imaginary = _half_period(float(span), float(upper)), _half_period(float(span), float(lower))
    ratio = max(real, imaginary) / min(real, imaginary)
    base = complex(real) if real <= imaginary else complex(0, imaginary)
    return Lattice(real, base, complex(0, ratio) if is_real else complex(0.5, ratio / 2), (poles[0], poles[1]))


def _quartic(m: Number, beta: Number, gamma: Number, f: Decimal, b3: Decimal) -> Any:
    """Return the coefficients of -(B² - 4AC)/4, B = β* + f z + γ z², A = m* + γ* z + 2 b3 z², C = β z + m z²."""
    B = np.array([beta.conjugate(), Number(f), gamma])
    A = np.array([m.conjugate(), gamma.conjugate(), Number(2 * b3)])
    return np.convolve(A, np.array([Number(ZERO), beta, m])) - np.convolve(B, B) / 4


def _invariants(a: Any) -> tuple[Decimal, Decimal]:
    """Return g2 and g3, which are real."""
    g2 = a[0] * a[4] - a[1] * a[3] / 4 + a[2] * a[2] / 12
    g3 = a[0] * a[2] * a[4] / 6 + a[1] * a[2] * a[3] / 48 - a[2] * a[2] * a[2] / 216
    g3 = g3 - (a[0] * a[3] * a[3] + a[1] * a[1] * a[4]) / 16
    return g2.x, g3.x


def _roots(g2: Decimal, g3: Decimal) -> tuple[Number, Number, Number]:
    """Return the roots of 4 x³ - g2 x - g3; the first is real, the others are real or conjugate.

    The root with the sign of g3 that is farthest from 0 is never double. Newton's iteration falls to it from above.
    """
    if abs(g2) < _NONE and abs(g3) < _NONE:
        g2 = _NONE  # three equal roots: the motion is rational in time, as far as anyone will wait
    size = abs(g3)
    x = Decimal(math.sqrt(max(float(g2), 0.0)) / 2 + math.cbrt(float(size) / 4)) * (1 + Decimal(10) ** -12)
    for _ in range(400):
        step = (4 * x * x * x - g2 * x - size) / (12 * x * x - g2)
        x -= step
        if abs(step) <= abs(x) * _STOP:
            break
    x = x.copy_sign(g3)
    rest = g2 - 3 * x * x
    half = abs(rest).sqrt() / 2
    apart = Number(half) if rest >= 0 else Number(ZERO, half)
    middle = Number(-x / 2)
    return Number(x), middle + apart, middle - apart


def _half_period(span: float, part: float) -> float:
    """Return K(k)/√span, where k'² = part/span."""
    a, b = math.sqrt(span), math.sqrt(max(part, 0.0))
    if b == 0.0:
        return math.inf
    while a - b > 1e-15 * a:
        a, b = 0.5 * (a + b), math.sqrt(a * b)
    return math.pi / (a + b)


def _pole(apart: list[complex], slope: complex) -> complex:
    """Return a with ℘(a) - e_i = `apart` and ℘'(a) = `slope`: Carlson's R_F of complex arguments."""
    most = max(abs(x) for x in apart)
    x, y, z = (e if abs(e) > _LEAST * most else complex(_LEAST * most) for e in apart)
    known = -2 * cmath.sqrt(x) * cmath.sqrt(y) * cmath.sqrt(z)
    sign = -1.0 if abs(known + slope) < abs(known - slope) else 1.0
    return complex(sign * carlson_rf(x, y, z, 0.003))
