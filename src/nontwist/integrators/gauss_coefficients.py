"""Coefficients of Gauss collocation with s stages, order 2s, as the kernels take them.

The nodes c_i are the zeros of the shifted Legendre polynomial, b_i the weights, a_ij the integrals of the Lagrange
polynomial l_j from 0 to c_i. What an s-stage step with increments ``L_j = h b_j F_j`` computes is

    Y_i = y_n + Σ μ_ij L_j,        y_{n+1} = y_n + Σ L_j,        μ_ij = a_ij / b_j.

Quadratic invariants are kept where ``μ_ij + μ_ji = 1`` for all i, j. With rounded a_ij and b_j this would hold to
round-off, always with the same sign, and the invariants would drift linearly with time. So the larger of the pair is
rounded, which lies in [1/2, 2], and the other one is 1 less it, which is exact (M. Antoñana, J. Makazaga, A. Murua,
Numer. Algorithms 76 (2017) 861). The scheme is also symmetric to the last bit: ``μ_{s+1-i,s+1-j} = μ_ji`` and
``b_{s+1-i} = b_i``.

The first guess extrapolates the polynomial through the last derivatives by one step, ``Y_i = y_n + Σ γ_ij L_j`` with
``γ_ij = Σ_k a_ik l_j(1 + c_k) / b_j``.

Linearised steps take the inverse of (a_ij) as well, and the sums κ_i of its rows. The stages of an increment that is a
polynomial of degree s, zero at the beginning, have the derivatives a⁻¹ of their values; so the inverse differentiates
the Lagrange polynomials of the nodes and zero, ``(a⁻¹)_ij = (x l_j(x))' / c_j`` at c_i.
"""

from __future__ import annotations

from decimal import Decimal, localcontext
from functools import cache
from typing import Any

import numpy as np

from ..engine.records import layout
from ..geometry.arrays import Array

DIGITS = 60
WIDTH, SQUARE = 8, 64  # stages that there is room for; matrices by columns
TABLE = layout(nodes=WIDTH, weights=WIDTH, mu=SQUARE, guess=SQUARE, a=SQUARE, inverse=SQUARE, sums=WIDTH)

Numbers = list[Decimal]


@cache
def table(order: int) -> Array:
    """Return the coefficients of an order, padded with zeros to `WIDTH` stages, in the places of `TABLE`."""
    s = order // 2
    with localcontext() as context:
        context.prec = DIGITS
        c, b, a, l = _exact(s)
        ahead = [[_value(l[j], 1 + c[k]) for j in range(s)] for k in range(s)]
        guess = [[sum(a[i][k] * ahead[k][j] for k in range(s)) / b[j] for j in range(s)] for i in range(s)]
        mu = [[a[i][j] / b[j] for j in range(s)] for i in range(s)]
        slopes = [[(k + 1) * x for k, x in enumerate(l[j])] for j in range(s)]
        inverse = [[_value(slopes[j], c[i]) / c[j] for j in range(s)] for i in range(s)]
        sums = [sum(row) for row in inverse]
    symplectic, rounded = _symplectic(np.array(mu, dtype=np.float64)), np.array(b, dtype=np.float64)
    columns: Any = (zip(*matrix, strict=True) for matrix in (symplectic, guess, rounded * symplectic, inverse))
    return _packed(_padded([c, b], 2), *(_padded(list(matrix), WIDTH) for matrix in columns), _padded([sums], 1))


def _padded(rows: Any, count: int) -> Array:
    """Return rows of numbers, with zeros so many rows of `WIDTH`."""
    found = np.zeros((count, WIDTH))
    found[: len(rows), : len(rows[0])] = np.array(rows, dtype=np.float64)
    return found


def _packed(*parts: Array) -> Array:
    """Return the numbers of arrays one after the other, which nobody writes to."""
    found: Array = np.concatenate([part.ravel() for part in parts])
    found.flags.writeable = False
    return found


def nodes(order: int) -> Array:
    """Return where the stages lie, as fractions of a step, (s,)."""
    return table(order)[TABLE.nodes : TABLE.nodes + order // 2]


def matrix(order: int) -> Array:
    """Return the numbers μ_ij, (s, s)."""
    s = order // 2
    return table(order)[TABLE.mu : TABLE.guess].reshape(WIDTH, WIDTH)[:s, :s].T


def weights(order: int) -> Array:
    """Return the weights b_i, (s,)."""
    return table(order)[TABLE.weights : TABLE.weights + order // 2]


def _symplectic(mu: Array) -> Array:
    """Return μ with μ_ij + μ_ji = 1 to the last bit, equal for the pairs that symmetry in time makes equal."""
    s = len(mu)
    for i in range(s):
        for j in range(i + 1):
            large = max(mu[i, j], mu[j, i])
            for k, m in ((i, j), (s - 1 - j, s - 1 - i)):
                mu[k, m] = large if mu[i, j] == large else 1 - large
                mu[m, k] = 1 - mu[k, m]
    return mu


def _exact(s: int) -> tuple[Numbers, Numbers, list[Numbers], list[Numbers]]:
    """Return nodes, weights, the integrals a_ij, and the coefficients of the polynomials l_j, lowest first."""
    c = sorted((1 + _zero(s, i)) / 2 for i in range(s))
    l = [_lagrange(c, j) for j in range(s)]
    integrals = [[Decimal(0), *(x / (k + 1) for k, x in enumerate(p))] for p in l]
    return c, [_value(p, Decimal(1)) for p in integrals], [[_value(p, x) for p in integrals] for x in c], l


def _zero(s: int, i: int) -> Decimal:
    """Return a zero of the Legendre polynomial of degree s by Newton's iteration."""
    x = Decimal(float(np.cos(np.pi * (i + 0.75) / (s + 0.5))))
    for _ in range(8):
        before, p = Decimal(1), x
        for k in range(2, s + 1):
            before, p = p, ((2 * k - 1) * x * p - (k - 1) * before) / k
        x -= p * (x * x - 1) / (s * (x * p - before))
    return x


def _lagrange(c: Numbers, j: int) -> Numbers:
    found = [Decimal(1)]
    for k, x in enumerate(c):
        if k != j:
            f = 1 / (c[j] - x)
            found = [f * (high - x * low) for low, high in zip([*found, Decimal(0)], [Decimal(0), *found], strict=True)]
    return found


def _value(p: Numbers, x: Decimal) -> Decimal:
    found = Decimal(0)
    for coefficient in reversed(p):
        found = found * x + coefficient
    return found
