"""The turn of a body that is held about a principal axis, under moments along the moving frame.

The momentum Π_⊥ = (x, y) is the integral of the moment, and Λ' = Λ Ŵ with W = J_⊥⁻¹ Π_⊥: the Gauss Runge-Kutta matrix
gives Π_⊥ at one, two or three Gauss nodes of a step, Magnus expansions of order 2, 4, 6 the turn. `split` derives what
follows from them.
"""

from math import sqrt

from ..geometry.compiled import inlined
from ..geometry.tuples import add, axpy, cross, minus, scaled

R3, R15 = sqrt(3.0), sqrt(15.0)
NODES = ((0.5, 0.0, 0.0), (0.5 - R3 / 6, 0.5 + R3 / 6, 0.0), (0.5 - R15 / 10, 0.5, 0.5 + R15 / 10))
WEIGHTS = ((1.0, 0.0, 0.0), (0.5, 0.5, 0.0), (5 / 18, 4 / 9, 5 / 18))


@inlined
def velocity(k, x, y):
    """Return W of Π_⊥ = (x, y)."""
    return (k[0] * x, k[1] * y, 0.0)


@inlined
def at_node(k, x, y):
    """Return W of Π_⊥ = (x, y), and the third component of Π × W."""
    W = velocity(k, x, y)
    return W, x * W[1] - y * W[0]


@inlined
def magnus(gauss, h, k, x, y, b1, b2, b3):
    """Return the rotation vector of a step, the change of Π_⊥, the velocities at the nodes, and the mean of μ.

    Magnus expansion on Gauss nodes for Λ' = Λ Ŵ: the bracket of the expansion for Y' = A Y is the negative cross
    product here.
    """
    if gauss == 1:
        dx, dy = h * b1[0], h * b1[1]
        w1, mu = at_node(k, x + 0.5 * dx, y + 0.5 * dy)
        return scaled(h, w1), dx, dy, w1, w1, w1, mu + b1[2]
    if gauss == 2:
        p, m = h * (0.25 + R3 / 6.0), h * (0.25 - R3 / 6.0)
        q = 0.25 * h
        w1, mu1 = at_node(k, x + q * b1[0] + m * b2[0], y + q * b1[1] + m * b2[1])
        w2, mu2 = at_node(k, x + p * b1[0] + q * b2[0], y + p * b1[1] + q * b2[1])
        dx, dy, mu = 0.5 * h * (b1[0] + b2[0]), 0.5 * h * (b1[1] + b2[1]), 0.5 * (mu1 + mu2)
        return magnus_4(h, w1, w2), dx, dy, w1, w2, w2, mu + 0.5 * (b1[2] + b2[2])
    w1, mu1 = collocated(k, x, y, h, 5 / 36, 2 / 9 - R15 / 15, 5 / 36 - R15 / 30, b1, b2, b3)
    w2, mu2 = collocated(k, x, y, h, 5 / 36 + R15 / 24, 2 / 9, 5 / 36 - R15 / 24, b1, b2, b3)
    w3, mu3 = collocated(k, x, y, h, 5 / 36 + R15 / 30, 2 / 9 + R15 / 15, 5 / 36, b1, b2, b3)
    dx = h * (5 / 18 * (b1[0] + b3[0]) + 4 / 9 * b2[0])
    dy = h * (5 / 18 * (b1[1] + b3[1]) + 4 / 9 * b2[1])
    mu = 5 / 18 * (mu1 + mu3 + b1[2] + b3[2]) + 4 / 9 * (mu2 + b2[2])
    return magnus_6(h, w1, w2, w3), dx, dy, w1, w2, w3, mu


@inlined
def magnus_4(h, w1, w2):
    """Return the rotation vector of order 4 from W at two nodes."""
    return axpy(R3 / 12.0 * h * h, cross(w1, w2), scaled(0.5 * h, add(w1, w2)))


@inlined
def magnus_6(h, w1, w2, w3):
    """Return the rotation vector of order 6 from W at three nodes."""
    a1 = scaled(h, w2)
    a2 = scaled(R15 / 3.0 * h, axpy(-1.0, w1, w3))
    a3 = scaled(10.0 / 3.0 * h, add(axpy(-2.0, w2, w3), w1))
    c1 = scaled(-1.0, cross(a1, a2))
    c2 = scaled(1.0 / 60.0, cross(a1, axpy(2.0, a3, c1)))
    left = axpy(-20.0, a1, axpy(-1.0, a3, c1))
    return axpy(-1.0 / 240.0, cross(left, add(a2, c2)), axpy(1.0 / 12.0, a3, a1))


@inlined
def collocated(k, x, y, h, a1, a2, a3, b1, b2, b3):
    """Return W and the third component of Π × W at a node of the Gauss method with three of them."""
    return at_node(k, x + h * (a1 * b1[0] + a2 * b2[0] + a3 * b3[0]), y + h * (a1 * b1[1] + a2 * b2[1] + a3 * b3[1]))


@inlined
def turn_to(gauss, c, turn, h, k, x, y, b1, b2, b3):
    """Return the rotation vector of the part [0, c h] of the step of `magnus`, whose rotation vector is `turn`.

    The moment is that of the polynomial through the nodes, ``mean + slope s + bend s²``, s the time from the middle of
    the step, as a fraction of it.
    """
    if gauss == 1:
        return scaled(0.5, turn)
    if gauss == 2:
        mean, slope, bend = scaled(0.5, add(b1, b2)), scaled(R3, minus(b2, b1)), (0.0, 0.0, 0.0)
        w1 = velocity_under(k, c * NODES[1][0] - 0.5, h, x, y, mean, slope, bend)
        w2 = velocity_under(k, c * NODES[1][1] - 0.5, h, x, y, mean, slope, bend)
        return magnus_4(c * h, w1, w2)
    slope, bend = scaled(R15 / 3, minus(b3, b1)), scaled(10 / 3, add(axpy(-2.0, b2, b1), b3))
    w1 = velocity_under(k, c * NODES[2][0] - 0.5, h, x, y, b2, slope, bend)
    w2 = velocity_under(k, c * NODES[2][1] - 0.5, h, x, y, b2, slope, bend)
    w3 = velocity_under(k, c * NODES[2][2] - 0.5, h, x, y, b2, slope, bend)
    return magnus_6(c * h, w1, w2, w3)


@inlined
def velocity_under(k, s, h, x, y, mean, slope, bend):
    """Return W at the time s of the moment that `turn_to` takes."""
    a, b, d = h * (s + 0.5), 0.5 * h * (s * s - 0.25), h / 3.0 * (s * s * s + 0.125)
    dx, dy = a * mean[0] + b * slope[0] + d * bend[0], a * mean[1] + b * slope[1] + d * bend[1]
    return velocity(k, x + dx, y + dy)
