"""Coefficients of Gauss collocation with s stages, order 2s, as the kernels take them.

The nodes c_i are the zeros of the Legendre polynomial P_s on [0, 1], b_i the weights, a_ij the integrals of the
Lagrange polynomial l_j from 0 to c_i. The P_k are orthogonal, so ``l_j = b_j Σ_k (2k + 1) P_k(c_j) P_k``, k < s, and
``1/b_j = Σ_k (2k + 1) P_k(c_j)²``. What an s-stage step with increments ``L_j = h b_j F_j`` computes is

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
Decimals = Any  # array


@cache
def table(order: int) -> Array:
    """Return the coefficients of an order, padded with zeros to `WIDTH` stages, in the places of `TABLE`."""
    s, found = order // 2, np.zeros(TABLE.size)
    with localcontext() as context:
        context.prec = DIGITS
        c = _zeros(s)
        odd = np.array(range(1, 2 * s, 2), dtype=object)[:, None]
        P, slopes = _legendre(c, s)
        at_nodes = odd * P[:s]
        b = 1 / (at_nodes * P[:s]).sum(axis=0)
        mu = np.concatenate([c[None], (P[2:] - P[: s - 1]) / (2 * odd[1:])]).T @ at_nodes
        guess = mu * b @ _legendre(1 + c, s)[0][:s].T @ at_nodes
        inverse = (np.eye(s, dtype=int) + c[:, None] * b * (slopes[:s].T @ at_nodes)) / c
    symplectic = _symplectic(mu.astype(np.float64))
    matrices = {"mu": symplectic, "guess": guess, "a": b.astype(np.float64) * symplectic, "inverse": inverse}
    for name, rows in (matrices | {"nodes": c, "weights": b, "sums": inverse.sum(axis=1)}).items():
        for j, column in enumerate(np.atleast_2d(rows.T)):
            first = getattr(TABLE, name) + WIDTH * j
            found[first : first + s] = column
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


def _zeros(s: int) -> Decimals:
    """Return the zeros of P_s by Newton's iteration."""
    x: Any = np.array([Decimal(float(y)) for y in (1 - np.cos(np.pi * (np.arange(s) + 0.75) / (s + 0.5))) / 2])
    for _ in range(8):
        P, slopes = _legendre(x, s)
        x = x - P[s] / slopes[s]
    return x


def _legendre(x: Decimals, s: int) -> tuple[Decimals, Decimals]:
    """Return P_0 to P_s at some places, (s + 1, n), and their derivatives."""
    P, slopes = [1 + 0 * x, 2 * x - 1], [0 * x, 2 + 0 * x]
    for k in range(1, s):
        P.append(((2 * k + 1) * P[1] * P[k] - k * P[k - 1]) / (k + 1))
        slopes.append(slopes[k - 1] + 2 * (2 * k + 1) * P[k])
    return np.array(P), np.array(slopes)
