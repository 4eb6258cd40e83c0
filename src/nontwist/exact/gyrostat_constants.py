"""The constants of a free gyrostat: axes, quartic, roots, periods and poles; `gyrostats` derives them.

What may cancel is computed with 120 decimal digits, from J, c and W as they are in double precision: axes and rates,
the invariants of the quartic, their roots and the differences of these. All else is positive sums and products, where
double precision loses nothing.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable
from decimal import Decimal, localcontext
from typing import Any, NamedTuple

import numpy as np

from ..geometry.arrays import Array

DIGITS = 120
ZERO, TWO, FOUR = Decimal(0), Decimal(2), Decimal(4)
_STOP, _NONE, _STEADY, _LEAST = Decimal(10) ** (6 - DIGITS), Decimal(10) ** -DIGITS, Decimal(10) ** -45, 1e-100
Vector = list[Decimal]


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

    def __mul__(self, other: Number | Decimal) -> Number:
        if isinstance(other, Decimal):
            return Number(self.x * other, self.y * other)
        return Number(self.x * other.x - self.y * other.y, self.x * other.y + self.y * other.x)

    def conjugate(self) -> Number:
        """Return x - iy."""
        return Number(self.x, -self.y)

    def root(self) -> Number:
        """Return the square root, of real part >= 0."""
        size = (self.x * self.x + self.y * self.y).sqrt()
        if not size:
            return Number(ZERO)
        a = ((size + abs(self.x)) / TWO).sqrt()
        b = self.y / (TWO * a)
        return Number(a, b) if self.x >= 0 else Number(abs(b), a.copy_sign(self.y))

    def rounded(self) -> complex:
        """Return it in double precision; its zeros are positive, on the upper side of cuts."""
        return complex(float(self.x) + 0.0, float(self.y) + 0.0)


def gyrostat(J: Array, c: Array, W: Array) -> Gyrostat:
    """Return the constants of the motion from W on."""
    with localcontext() as context:
        context.prec = DIGITS
        inertia, rotor, velocity = [_many(row) for row in J], _many(c), _many(W)
        D = _inverse(inertia)
        P = [_dot(row, velocity) + x for row, x in zip(inertia, rotor, strict=True)]
        L = _dot(P, P).sqrt()
        frame = _frame([x / L for x in P]) if L else [[Decimal(i == j) for j in range(3)] for i in range(3)]
        mean = (D[0][0] + D[1][1] + D[2][2]) / 3
        apart = [[x - mean * (i == j) for j, x in enumerate(row)] for i, row in enumerate(D)]  # a sphere turns nothing
        A = [[L * _dot(a, [_dot(row, b) for row in apart]) for b in frame] for a in frame]
        b = [_dot(a, [_dot(row, rotor) for row in D]) for a in frame]
        local = [_dot(a, velocity) for a in frame]
        pace = (sum((_dot(row, row) for row in A), ZERO) + _dot(b, b) + _dot(local, local)).sqrt()
        found, unit = None, 1.0
        if L and local[0] ** 2 + local[1] ** 2 > (_STEADY * pace) ** 2:
            unit = math.ldexp(1.0, math.frexp(float(pace))[1])
            over = 1 / Decimal(unit)
            rates = [(A[0][0] - A[1][1]) / TWO, A[0][1], A[0][0] + A[1][1] - TWO * A[2][2]]
            found = _lattice(*([over * x for x in part] for part in (rates, b, local)))
        floats = (np.array(part, dtype=np.float64) for part in (D, frame, local))
        inverse, axes, along = floats
    return Gyrostat(inverse, float(L), axes, float(pace), unit, along / unit, found)


def _many(values: Iterable[Any]) -> Vector:
    return [Decimal(float(x)) for x in values]


def _dot(a: Vector, b: Vector) -> Decimal:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]


def _inverse(J: list[Vector]) -> list[Vector]:
    """Return the inverse of a symmetric matrix."""
    found = [_cross(J[i - 2], J[i - 1]) for i in range(3)]
    determinant = _dot(J[0], found[0])
    return [[x / determinant for x in row] for row in found]


def _frame(n: Vector) -> list[Vector]:
    """Return a rotation whose third row is `n`, with zeros where `n` is an axis."""
    least = min(range(3), key=lambda i: abs(n[i]))
    first = _cross(n, [Decimal(i == least) for i in range(3)])
    size = _dot(first, first).sqrt()
    first = [x / size for x in first]
    return [first, _cross(n, first), n]


def _lattice(rates: Vector, b: Vector, W: Vector) -> Lattice:
    """Return the periods and poles from the `rates` Re m, -Im m and f - 2 b3, and from b and W."""
    m, beta = Number(rates[0], -rates[1]), Number(W[0], -W[1])
    gamma = (beta + Number(b[0], -b[1]) * TWO) * Decimal(-1)
    quartic = _quartic(m, beta, gamma, rates[2] + TWO * b[2], b[2])
    first, second, third = _roots(*_invariants(quartic))
    is_real = not second.y
    slope, y, a2 = Number(beta.y, beta.x) * (1 / TWO), quartic[4].root(), quartic[2] * (1 / Decimal(12))
    poles = []
    for sign in (Decimal(1), Decimal(-1)):
        p = a2 + slope * y * (sign / TWO)
        change = (quartic[1] * y * sign + slope * quartic[3]) * (-1 / FOUR)
        poles.append(_pole([(p - e).rounded() for e in (first, second, third)], change.rounded()))
    if is_real:
        e1, e2, e3 = sorted((first.x, second.x, third.x), reverse=True)
        span, upper, lower = e1 - e3, e1 - e2, e2 - e3
    else:
        span = ((3 * first.x / TWO) ** 2 + second.y**2).sqrt()
        share = 3 * first.x / FOUR
        upper, lower = span / TWO + share, span / TWO - share
    real, imaginary = _half_period(float(span), float(upper)), _half_period(float(span), float(lower))
    ratio = max(real, imaginary) / min(real, imaginary)
    base = complex(real) if real <= imaginary else complex(0, imaginary)
    return Lattice(real, base, complex(0, ratio) if is_real else complex(0.5, ratio / 2), (poles[0], poles[1]))


def _quartic(m: Number, beta: Number, gamma: Number, f: Decimal, b3: Decimal) -> list[Number]:
    """Return the coefficients of -(B² - 4AC)/4, B = β* + f z + γ z², A = m* + γ* z + 2 b3 z², C = β z + m z²."""
    B = beta.conjugate(), Number(f), gamma
    A = m.conjugate(), gamma.conjugate(), Number(TWO * b3)
    C = Number(ZERO), beta, m
    found = [Number(ZERO)] * 5
    for i in range(3):
        for j in range(3):
            found[i + j] = found[i + j] + A[i] * C[j] - B[i] * B[j] * (Decimal(1) / FOUR)
    return found


def _invariants(a: list[Number]) -> tuple[Decimal, Decimal]:
    """Return g2 and g3, which are real."""
    g2 = a[0] * a[4] - a[1] * a[3] * (Decimal(1) / 4) + a[2] * a[2] * (Decimal(1) / 12)
    g3 = a[0] * a[2] * a[4] * (Decimal(1) / 6) + a[1] * a[2] * a[3] * (Decimal(1) / 48)
    g3 = g3 - a[2] * a[2] * a[2] * (Decimal(1) / 216) - (a[0] * a[3] * a[3] + a[1] * a[1] * a[4]) * (Decimal(1) / 16)
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
        step = (FOUR * x * x * x - g2 * x - size) / (12 * x * x - g2)
        x -= step
        if abs(step) <= abs(x) * _STOP:
            break
    x = x.copy_sign(g3)
    rest = g2 - 3 * x * x
    half = abs(rest).sqrt() / TWO
    apart = Number(half) if rest >= 0 else Number(ZERO, half)
    middle = Number(-x / TWO)
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
    """Return a with ℘(a) - e_i = `apart` and ℘'(a) = `slope`: Carlson's R_F of complex arguments (DLMF 19.36)."""
    most = max(abs(x) for x in apart)
    x, y, z = (e if abs(e) > _LEAST * most else complex(_LEAST * most) for e in apart)
    known = -2 * cmath.sqrt(x) * cmath.sqrt(y) * cmath.sqrt(z)
    sign = -1.0 if abs(known + slope) < abs(known - slope) else 1.0
    mean = (x + y + z) / 3
    while max(abs(mean - x), abs(mean - y), abs(mean - z)) > 0.003 * abs(mean):
        s, t, u = cmath.sqrt(x), cmath.sqrt(y), cmath.sqrt(z)
        shift = s * t + t * u + u * s
        x, y, z = (x + shift) / 4, (y + shift) / 4, (z + shift) / 4
        mean = (x + y + z) / 3
    a, b = 1 - x / mean, 1 - y / mean
    c = -a - b
    e2, e3 = a * b - c * c, a * b * c
    series = 1 - e2 / 10 + e3 / 14 + e2 * e2 / 24 - 3 * e2 * e3 / 44
    series += -5 * e2 * e2 * e2 / 208 + 3 * e3 * e3 / 104 + e2 * e2 * e3 / 16
    return sign * series / cmath.sqrt(mean)
