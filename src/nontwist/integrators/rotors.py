"""The momenta of rotors and wheels at the nodes of a march.

Within a step the momentum c of the rotors is taken as the polynomial whose rate has, at the nodes θ_j of the step, the
values of c' there, but for a constant by which it is c at both ends,

    c'_j = c'(t_j) + r,    Σ b_j c'_j = (c_{n+1} - c_n)/h,    c_j = c_n + h Σ a_jk c'_k.

So it is collocated as the unknowns of the step are. In a step of one node, and for rotors, whose c is linear between
the times of a table, c' is the chord. The impulses of the steps add up to c at every node, whatever the grid is, and
with them the schemes keep the total momentum π + Λc exactly: with the mean momentum Q of the step `lie_midpoint` has
``ΔP + Δc = h (Q + c_m) × Ω``, the free step of the total momentum, and `gauss` a bilinear function Λ (P + c). A rotor
of constant momentum is drag with a skew matrix, ``c × W``, and does no work; as it spins up its work is ``-h c'·W``, W
of the step.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial.legendre import legvander

from ..geometry.arrays import Array
from ..loads import Load
from ..loads.wheels import Driven


def at_nodes(load: Load, begin: Array, end: Array, length: Array, middles: Array, unit: float) -> Array:
    """Return the momentum of the rotors over the unit of time, and its rate, at the nodes of some steps, (nodes, 6).

    `begin`, `end` and `length` are those of the steps, `middles` the nodes of one, as fractions.
    """
    first = load.rotor_momentum(begin)
    change = load.rotor_momentum(end) - first
    found, h = np.empty((len(begin), len(middles), 6)), length[:, None, None]
    found[:, :, :3] = first[:, None] + middles[:, None] * change[:, None]
    found[:, :, 3:] = (change / length[:, None])[:, None]
    if len(middles) > 1 and any(isinstance(one, Driven) for one in load.rotors):
        times = begin[:, None] + middles * length[:, None]
        rate = load.rotor_torque(times.ravel()).reshape(found[:, :, 3:].shape)
        A, b = coefficients(tuple(middles.tolist()))
        rate -= np.einsum("j,njc->nc", b, rate)[:, None]  # what is left of it beside the chord
        found[:, :, :3] += h * np.einsum("ij,njc->nic", A, rate)
        found[:, :, 3:] += rate
    found[:, :, :3] /= unit
    return found.reshape(-1, 6)


@lru_cache
def coefficients(middles: tuple[float, ...]) -> tuple[Array, Array]:
    """Return A, b of the collocation at some nodes: integrals of its polynomials up to each node, and to the end."""
    x, s = 2 * np.array([*middles, 1.0]) - 1, len(middles)
    P, k = legvander(x, s), np.arange(1, s)
    integrals = np.column_stack([x + 1, (P[:, 2:] - P[:, :-2]) / (2 * k + 1)]) / 2
    found: Any = np.linalg.solve(P[:-1, :s].T, integrals.T).T
    return found[:-1], found[-1]
