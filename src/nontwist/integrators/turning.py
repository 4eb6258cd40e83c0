"""How a quaternion is turned by finite turns, for as long as one likes, without a drift of its length or direction.

A quaternion p is a sum of increments that is compensated (Knuth's sum of two). What it was rounded by is turned too:
else the rounding errors of motions that nearly repeat add up.
"""

from math import sin, sqrt

from ..geometry.compiled import inlined
from ..geometry.tuples import add, axpy, cross, dot, product, scaled

C2, C4, C6, C8, C10 = -1 / 2, 1 / 24, -1 / 720, 1 / 40320, -1 / 3628800  # of the cosine
S3, S5, S7, S9 = -1 / 12, 1 / 240, -1 / 10080, 1 / 725760  # of half the sine


@inlined
def exponential(turn):
    """Return (c - 1, v) of the quaternion (c, v) that turns by the rotation vector."""
    h2 = 0.25 * dot(turn, turn)
    if h2 < 0.01:
        less = C2 + h2 * (C4 + h2 * (C6 + h2 * (C8 + h2 * C10)))
        return h2 * less, scaled(0.5 + h2 * (S3 + h2 * (S5 + h2 * (S7 + h2 * S9))), turn)
    half = sqrt(h2)
    quarter = sin(0.5 * half)
    return -2.0 * quarter * quarter, scaled(0.5 * sin(half) / half, turn)


@inlined
def turned_on(p, c, less, v):
    """Return p (1 + less, v), of unit length to first order in its deviation, its compensation, and that deviation.

    What p was rounded by is turned as well. Else the rounding errors of motions that nearly repeat add up.
    """
    gap = 1.0 - (p[0] * p[0] + dot((p[1], p[2], p[3]), (p[1], p[2], p[3])))
    d, e, f = grown(p, less, v), grown(c, less, v), 0.5 * gap
    x0, c0 = taken_up(p[0], c[0], d[0], e[0], f)
    x1, c1 = taken_up(p[1], c[1], d[1], e[1], f)
    x2, c2 = taken_up(p[2], c[2], d[2], e[2], f)
    x3, c3 = taken_up(p[3], c[3], d[3], e[3], f)
    return (x0, x1, x2, x3), (c0, c1, c2, c3), abs(gap)


@inlined
def grown(p, less, v):
    """Return p (1 + less, v) - p."""
    q = (p[1], p[2], p[3])
    d = add(axpy(less, q, scaled(p[0], v)), cross(q, v))
    return (less * p[0] - dot(q, v), d[0], d[1], d[2])


@inlined
def taken_up(x, c, d, e, f):
    """Return (1 + f) (x + d) + c + e, c, e and f round-off, and what it is rounded by (Knuth's sum of two)."""
    t = x + d
    b = t - x
    small = ((x - (t - b)) + (d - b)) + (c + (e + f * t))
    total = t + small
    return total, small - (total - t)


@inlined
def turned(p, turn):
    """Return the quaternion p turned by a rotation vector."""
    less, v = exponential(turn)
    return product(p, (1.0 + less, v[0], v[1], v[2]))
