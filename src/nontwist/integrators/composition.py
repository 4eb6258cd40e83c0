"""Symmetric compositions: a step of order 2 repeated with fractions of h becomes one of order 4 or 6.

If Φ_h is a symmetric method of order 2 and a near-identity map, ``Φ_{γ_s h} ∘ ... ∘ Φ_{γ_1 h}`` with
``γ_i = γ_{s+1-i}`` and the order conditions ``Σ γ_i = 1``, ``Σ γ_i³ = 0``, ... is symmetric and of the higher order,
and it keeps every invariant that Φ keeps at every step size. The middles of all substeps lie inside the step, so a
load with kinks on the ends of steps costs no order.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ..geometry.arrays import Array

_SUZUKI = 1 / (4 - 4 ** (1 / 3))

# The first half of the fractions and the middle one.
HALVES: dict[int, tuple[float, ...]] = {
    2: (1.0,),
    # M. Suzuki, Fractal decomposition of exponential operators, Phys. Lett. A 146 (1990) 319.
    4: (_SUZUKI, _SUZUKI, 1 - 4 * _SUZUKI),
    # W. Kahan, R.-C. Li, Composition constants for raising the orders of unconventional schemes for ordinary
    # differential equations, Math. Comp. 66 (1997) 1089; to more digits in E. Hairer, C. Lubich, G. Wanner, Geometric
    # Numerical Integration, sec. V.3.2.
    6: (
        0.39216144400731413927925056,
        0.33259913678935943859974864,
        -0.70624617255763935980996482,
        0.08221359629355080023149045,
        0.79854399093482996339895035,
    ),
}


@cache
def fractions(order: int) -> Array:
    """Return the fractions γ_i of the step, (s,); one array for all callers."""
    half = HALVES[order]
    return np.array([*half, *half[-2::-1]])


@cache
def nodes(order: int) -> Array:
    """Return where the middles of the substeps lie, as fractions of the step, (s,); one array for all callers."""
    gamma = fractions(order)
    return np.cumsum(gamma) - gamma / 2
