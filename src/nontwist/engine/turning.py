"""How a quaternion is turned by finite turns, for as long as one likes, without a drift of its length or direction."""

from __future__ import annotations

from math import sqrt as root
from typing import Any

from ..kernels.control import Variables, when
from ..kernels.elements import fma, sin, sqrt
from ..kernels.vectors import Quaternion, Vector, cross

COSINE = -1 / 2, 1 / 24, -1 / 720, 1 / 40320, -1 / 3628800  # (cos h - 1)/h² and sin h/2h by the powers of h²
SINE = 1 / 2, -1 / 12, 1 / 240, -1 / 10080, 1 / 725760
SERIES = 0.01  # the largest h² for which they are enough


def exponential(turn: Vector) -> tuple[Any, Vector]:
    """Return (c - 1, v) of the quaternion (c, v) that turns one body by the rotation vector."""
    h2 = 0.25 * (turn @ turn)
    less, sine = 0.0 * h2 + COSINE[-1], 0.0 * h2 + SINE[-1]
    for c, s in zip(COSINE[-2::-1], SINE[-2::-1], strict=True):
        less, sine = fma(h2, less, c), fma(h2, sine, s)
    found = Variables(less=h2 * less, sine=sine)
    for _ in when(h2 >= SERIES):
        half = sqrt(h2)
        quarter = sin(0.5 * half)
        found.less, found.sine = -2.0 * quarter * quarter, 0.5 * sin(half) / half
    return found.less, found.sine * turn


def turned(p: Quaternion, turn: Vector) -> Quaternion:
    """Return the quaternion p turned by a rotation vector."""
    less, v = exponential(turn)
    return p @ Quaternion(1.0 + less, *v)


def turned_on(p: Quaternion, c: Quaternion, less: Any, v: Vector) -> tuple[Quaternion, Quaternion, Any]:
    """Return p (1 + less, v), of unit length to first order in its deviation, its compensation, and that deviation.

    The sum of p and its increment is Knuth's. What p was rounded by is turned as well: else the rounding errors of
    motions that nearly repeat add up.
    """

    def grown(p: Quaternion) -> Quaternion:
        q = p.vector
        return Quaternion(less * p[0] - q @ v, *(fma(less, q, p[0] * v) + cross(q, v)))

    def taken_up(x: Any, c: Any, d: Any, e: Any) -> tuple[Any, Any]:
        t = x + d
        b = t - x
        small = ((x - (t - b)) + (d - b)) + (c + (e + 0.5 * gap * t))
        total = t + small
        return total, small - (total - t)

    gap = 1.0 - (p[0] * p[0] + p.vector @ p.vector)
    pairs = [taken_up(*each) for each in zip(p, c, grown(p), grown(c), strict=True)]
    return Quaternion(*(a for a, _ in pairs)), Quaternion(*(b for _, b in pairs)), abs(gap)


def magnus(h: Any, W: list[Vector]) -> Any:
    """Return the rotation vector Ω of Λ(h) = Λ(0) exp(Ω̂), Λ' = Λ Ŵ, from W at one, two or three Gauss nodes.

    Magnus expansions of order 2, 4, 6 (A. Iserles, S. P. Nørsett, Phil. Trans. R. Soc. A 357 (1999) 983; S. Blanes, F.
    Casas, J. Ros, BIT 40 (2000) 434). They are those of Y' = A Y with the bracket [x, y] = -x × y.
    """
    if len(W) == 1:
        return h * W[0]
    if len(W) == 2:
        return (root(3.0) / 12.0 * h * h) * cross(W[0], W[1]) + (0.5 * h) * (W[0] + W[1])
    a1, a2 = h * W[1], (root(15.0) / 3.0 * h) * (W[2] - W[0])
    a3 = (10.0 / 3.0 * h) * (W[2] - 2.0 * W[1] + W[0])
    c1 = -cross(a1, a2)
    c2 = cross(a1, 2.0 * a3 + c1) / 60.0
    return a1 + a3 / 12.0 - cross(c1 - a3 - 20.0 * a1, a2 + c2) / 240.0
