"""Observables of directors and their velocities, as the paper defines them: what validation and tests compare with.

Those of runs follow from Λ, W and N in `variables`. Arrays may have leading axes. Definitions (eq-dir-momenta,
eq-director-K): ``π^i = Σ_j E_ij d_j'``, ``π = Σ d_i × π^i``, ``Π_i = d_i·π`` (eq-pi-convected),
``K = 1/2 Σ d_i'·π^i``, and ``w = 1/2 Σ d_i × d_i'``. They hold for every velocity; on tangent ones (eq-tq),
``d_i' = w × d_i`` (eq-omegas), they are Λ J W (eq-momenta), J W and W·JW/2 (eq-kinetic-density). The energy-momentum
scheme leaves the tangent space under load.
"""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array
from ..models.system import DirectorSystem

PAIRS = [(i, j) for i in range(3) for j in range(i + 1)]


def angular_velocity(q: Array, v: Array) -> Array:
    """Return the spatial angular velocity w, (..., 3), rad/s."""
    return _moment(q, v) / 2


def spatial_momentum(q: Array, v: Array, E: Array) -> Array:
    """Return the spatial angular momentum π, (..., 3), kg m² s⁻¹."""
    return _moment(q, E @ v)


def material(q: Array, a: Array) -> Array:
    """Return the components ``d_i·a`` of a spatial vector in the body, (..., 3)."""
    A: Array = (q @ a[..., None])[..., 0]
    return A


def kinetic_energy(v: Array, E: Array) -> Array:
    """Return the kinetic energy K = 1/2 <v, E v> (eq-director-K), (...), J."""
    K: Array = np.sum(v * (E @ v), axis=(-2, -1)) / 2
    return K


def potential_energy(q: Array, system: DirectorSystem) -> Array:
    """Return the potential V = -Σ f^i·d_i of the dead forces, (...), J."""
    V: Array = -np.sum(q * system.dead_force, axis=(-2, -1))
    return V


def orthonormality_defect(q: Array) -> Array:
    """Return the largest entry of ``|q qᵀ - I|``, (...)."""
    x, y, z = q[..., 0], q[..., 1], q[..., 2]
    products = ((i, j, x[..., i] * x[..., j] + y[..., i] * y[..., j] + z[..., i] * z[..., j]) for i, j in PAIRS)
    defect: Array = np.maximum.reduce([abs(product - (i == j)) for i, j, product in products])
    return defect


def _moment(q: Array, p: Array) -> Array:
    """Return Σ d_i × p_i, (..., 3), from the skew part of qᵀ p: much faster than cross products."""
    S = np.swapaxes(q, -1, -2) @ p
    return np.stack([S[..., 1, 2] - S[..., 2, 1], S[..., 2, 0] - S[..., 0, 2], S[..., 0, 1] - S[..., 1, 0]], axis=-1)
