r"""Intervals of principal moments where they meet the wall: the profile likelihood of the linear problem among bodies.

At a solution the cost is ``c = ½ (w - ŵ)ᵀ I (w - ŵ)`` of the inertia ``J = J_0 + Σ w_n B_n`` to second order, with
the information I and the step ŵ that data without a wall ask for. A body has ``E - m c cᵀ = L Lᵀ`` (`chart`), so w is
quadratic in the six entries of L. A moment is ``λ + b·w``; the least cost at each of its values follows from the
least of ``c + μ b·w`` for each multiplier μ, and the interval ends where the root of twice the rise of c equals the
quantile. As L is square, a local minimum is a global one, though the problem in L is not convex (Burer and Monteiro,
Mathematical Programming 103, 2005, 427-444); the trust region leaves saddles, which L has on the wall.

At the solution the slope of c is not negative towards any body, so the rise is at least that without a wall: these
intervals are within those of the linear problem.
"""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array
from .bodies import entries
from .chart import LOWER
from .estimating import INSIDE
from .solving import Solution, nearest_body

SIZE = np.array([1, 1, 1, 2, 2, 2])  # of entries in the product of two symmetric matrices
DOUBLINGS, ACCURACY = 30, 1e-3


def _squares() -> Array:
    """Return K, (6, 6, 6), with the six entries of J = K(ℓ, ℓ), of the second moments L Lᵀ and the entries ℓ of L."""
    units = np.zeros((6, 3, 3))
    for n, (i, j) in enumerate(LOWER):
        units[n, i, j] = 1.0
    E = np.einsum("pia,qja->pqij", units, units)
    E = (E + np.swapaxes(E, 2, 3)) / 2
    J = np.trace(E, axis1=2, axis2=3)[:, :, None, None] * np.eye(3) - E
    return np.asarray(np.moveaxis(np.array([[entries(one) for one in row] for row in J]), 2, 0))


def walled(solution: Solution, by: Array, sign: float, wide: float) -> float:
    """Return how far below or above its value a moment of derivative `by`, (6,), may be; see the module."""
    from scipy.optimize import brentq, minimize

    model, J = solution.problem.model, solution.unknowns.inertia
    centred, information, asked = model.centred(solution.unknowns.more), solution.information, solution.newton
    onto = model.basis.T * SIZE
    K = np.einsum("ij,jpq->ipq", onto, _squares())
    still = onto @ (entries(np.trace(centred) * np.eye(3) - centred) - entries(J))
    b = model.basis.T @ by
    inside = nearest_body(model, J, solution.unknowns.more, INSIDE)
    L = np.linalg.cholesky(np.trace(inside) / 2 * np.eye(3) - inside - centred)
    begin = np.array([L[i, j] for i, j in LOWER])

    def least(multiplier: float) -> tuple[float, float]:
        """Return the cost and the change of the moment where the cost and a part of that change are least."""

        def at(x: Array) -> tuple[Array, Array]:
            w = K @ x @ x + still
            return w, information @ (w - asked) + multiplier * b

        def value(x: Array) -> float:
            w, _ = at(x)
            return float((w - asked) @ information @ (w - asked) / 2 + multiplier * (b @ w))

        def slope(x: Array) -> Array:
            return np.asarray(2 * (K @ x).T @ at(x)[1])

        def bend(x: Array) -> Array:
            return np.asarray(2 * np.einsum("i,ipq->pq", at(x)[1], K) + 4 * (K @ x).T @ information @ (K @ x))

        x = minimize(value, begin, jac=slope, hess=bend, method="trust-exact", options={"gtol": 1e-7}).x
        w = at(x)[0]
        return float((w - asked) @ information @ (w - asked) / 2), float(b @ w)

    lowest, _ = least(0.0)

    def beyond(multiplier: float) -> float:
        return float(np.sqrt(max(2 * (least(-sign * multiplier)[0] - lowest), 0.0))) - wide

    high = wide / float(np.sqrt(b @ np.linalg.solve(information, b)))
    for _ in range(DOUBLINGS):
        if beyond(high) > 0:
            high = brentq(beyond, 0.0, high, xtol=ACCURACY * high, rtol=ACCURACY)
            break
        high *= 2
    return least(-sign * high)[1]
