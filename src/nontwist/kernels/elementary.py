"""Sine, cosine and exponential as texts: for GPUs, and for lanes, in which the functions of C run one after the other.

With n the whole number next to x/(π/2), x - n π/2 is found with π/2 as the sum of three doubles P_1 + P_2 + P_3.
``x - n P_1`` is exact: a multiple of the last place of P_1 or of x that is below 1. What n P_2 and n P_3 take off is
carried along as a second number e. Up to |x| = 2^50, r + e has an error of 2^-109, and no x is so near to a multiple of
π/2 that this is felt; beyond it the functions are NaN. On |r| <= π/4 Taylor's polynomials up to r^17 and r^18 leave
1e-19. The exponential is 2^n exp(r + e), r + e = x - n ln 2, found in the same way; on |r| <= ln 2/2 the polynomial up
to r^14 leaves 1e-19, and 2^n is taken in two halves, so that what is too large is ∞ and what is small loses digits, as
it must. Each function is within one unit in the last place, where the processor has a fused multiply-add.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import factorial, ldexp
from typing import Any

from . import elements, machine_code
from .elements import FUNCTIONS, Element, Whole, floor, fma, select
from .kernel import part
from .machine_code import tracer, writer


def as_three_doubles(digits: str) -> list[float]:
    """Return three doubles whose sum is a number."""
    rest, found = Fraction(digits), list[float]()
    for _ in range(3):
        found.append(float(rest))
        rest -= Fraction(found[-1])
    return found


HALF_PI = as_three_doubles(
    "1.57079632679489661923132169163975144209858469968755291048747229615390820314310449931401741"
)
LN_2 = as_three_doubles("0.69314718055994530941723212145817656807550013436025525412068000949339362196969471560586332")
FARTHEST, LARGEST = 2.0**50, 750.0  # of sine and cosine; of the exponential, beyond which it is ∞ or 0
SINE = [(-1) ** k / factorial(2 * k + 1) for k in range(1, 9)]  # of (sin r - r)/r³, by the powers of r²
COSINE = [(-1) ** k / factorial(2 * k) for k in range(2, 10)]  # of (cos r - 1 + r²/2)/r⁴
EXPONENTIAL = [1 / factorial(k) for k in range(2, 15)]  # of (exp r - 1 - r)/r², by the powers of r
rint = FUNCTIONS["rint"]


def polynomial(x: Any, coefficients: list[float]) -> Any:
    """Return a polynomial, given its coefficients, lowest first."""
    found = 0.0 * x + coefficients[-1]
    for c in coefficients[-2::-1]:
        found = fma(x, found, c)
    return found


def reduced_argument(x: Any, n: Any, parts: list[float]) -> tuple[Any, Any]:
    """Return r and e, with r + e = x - n Σ parts."""
    first, product = fma(-n, parts[0], x), n * parts[1]
    r = first - product
    back = r - first
    low = (first - (r - back)) - (product + back)
    return r, fma(-n, parts[2], low - fma(n, parts[1], -product))


def sine_and_cosine(x: Any) -> tuple[Any, Any]:
    """Return sine and cosine: by the text where the processor has a fused multiply-add, else by the C library."""
    return sincos(x) if machine_code.is_fused() else (elements.sin(x), elements.cos(x))


def sincos(x: Any) -> tuple[Any, Any]:
    """Return sine and cosine of a number, or of numbers side by side."""
    n = rint(x * (1.0 / HALF_PI[0]))
    r, e = reduced_argument(x, n, HALF_PI)
    z = r * r
    sine = r + fma(r * z, polynomial(z, SINE), e * fma(-0.5, z, 1.0))
    half = 0.5 * z
    most = 1.0 - half
    cosine = most + (((1.0 - most) - half) + fma(z * z, polynomial(z, COSINE), -(r * e)))
    quarter = n - 4.0 * floor(0.25 * n)
    sine, cosine = select((quarter == 1.0) | (quarter == 3.0), (cosine, -sine), (sine, cosine))
    sine, cosine = select(quarter >= 2.0, (-sine, -cosine), (sine, cosine))
    is_known = abs(x) <= FARTHEST
    return select(is_known, sine, float("nan")), select(is_known, cosine, float("nan"))


@part
def sin(x: Any) -> Any:
    """Return the sine."""
    return sincos(x)[0]


@part
def cos(x: Any) -> Any:
    """Return the cosine."""
    return sincos(x)[1]


@part
def exp(x: Any) -> Any:
    """Return the exponential."""
    within = select(x > LARGEST, LARGEST, select(x < -LARGEST, -LARGEST, x))
    n = rint(within * (1.0 / LN_2[0]))
    r, e = reduced_argument(within, n, LN_2)
    y = 1.0 + (r + fma(r * r, polynomial(r, EXPONENTIAL), fma(r, e, e)))
    n = select(x == x, n, 0.0)
    half = floor(0.5 * n)
    return (y * two_to_the(half)) * two_to_the(n - half)


def two_to_the(n: Any) -> Any:
    """Return 2^n, n a whole number from -1022 to 1023 as a double."""
    if tracer() is None:
        return ldexp(1.0, int(n))
    t = writer()
    whole: Any = Whole(t.value(f"fptosi double {n.used()} to i64"))
    return Element(t.value(f"bitcast i64 {((whole + 1023) * 2**52).used()} to double"))


OWN: dict[str, Callable[..., Any]] = {"sin": sin, "cos": cos, "exp": exp}
