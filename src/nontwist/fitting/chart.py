r"""Inertias as free numbers, so that every inertia that a fit tries is that of a body.

**Of trace 1, five numbers.** A body has the Euler inertia ``E = ∫ρ x xᵀ``, positive semidefinite, and
``J = tr(E) I - E``. Let ``E = L Lᵀ`` with L lower triangular, its six entries a vector ℓ: ``tr E = |ℓ|²``, so tr J = 1
is ``|ℓ|² = 1/2``, a sphere. About ℓ_0 it is reached by ``ℓ = (u_0 + P z) / (√2 |u_0 + P z|)`` with ``u_0 = √2 ℓ_0`` and
P an orthonormal basis of what is orthogonal to u_0. All z are bodies, and all bodies but those across the sphere are
reached; on a flat one the diagonal of L has a zero, and the chart is smooth there. Its derivative is not of full rank
at such a body, so intervals never use z: they use J itself.

**With mass and centre, six numbers.** The second moments about a pivot, the mass and its moment are those of a body
where the pseudo-inertia ``[[E, m c], [m cᵀ, m]]`` is positive semidefinite. Its block Cholesky factor is
``[[L, √m c], [0, √m]]``, so ``E = m c cᵀ + L Lᵀ`` with L free: what `Weighed` does, c given or itself fitted. Without a
known mass the first term is 0, as m may be as small as one likes where m c is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.arrays import Array
from .bodies import entries

LOWER = np.tril_indices(3)
THINNEST = 1e-4  # eigenvalue of E, of tr J, below which a start is not taken: on the wall the chart has no slope


def of_trace_one(J: Array) -> Array:
    """Return the inertia of trace 1 closest to a symmetric matrix that is one of a body, and not a flat one."""
    values, vectors = np.linalg.eigh(np.trace(J) / 2 * np.eye(3) - J)
    values = np.maximum(values / max(np.trace(J) / 2, 1e-300) / 2, THINNEST)
    E = (vectors * (values / values.sum() / 2)) @ vectors.T
    return np.asarray(np.eye(3) / 2 - E)


def of_a_body(J: Array, centred: Array, thinnest: float = THINNEST) -> Array:
    """Return the closest inertia whose second moments exceed m c cᵀ, by a part of tr J at least in any direction."""
    values, vectors = np.linalg.eigh(np.trace(J) / 2 * np.eye(3) - J - centred)
    return inertia_of((vectors * np.maximum(values, thinnest * abs(np.trace(J)))) @ vectors.T + centred)


def inertia_of(E: Array) -> Array:
    """Return the inertia of second moments, or of several, (..., 3, 3)."""
    return np.asarray(np.trace(E, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - E)


def lower(v: Array) -> Array:
    """Return L by its entries, (..., 6)."""
    L = np.zeros((*v.shape[:-1], 3, 3))
    L[..., *LOWER] = v
    return L


def _moments(v: Array, slope: Array) -> tuple[Array, Array]:
    """Return L Lᵀ by the entries of L, and its derivatives, (k, 3, 3), where these have the slope (6, k)."""
    L = lower(v)
    dE = lower(slope.T) @ L.T
    return L @ L.T, dE + np.swapaxes(dE, 1, 2)


@dataclass(frozen=True)
class Chart:
    """Five coordinates about an inertia of trace 1."""

    centre: Array  # (6,), of length 1
    basis: Array  # (6, 5)

    @staticmethod
    def about(J: Array) -> Chart:
        """Return the chart whose origin is J, of trace 1."""
        centre = np.sqrt(2) * np.linalg.cholesky(np.eye(3) / 2 - of_trace_one(J))[LOWER]
        centre /= np.linalg.norm(centre)
        return Chart(centre, np.linalg.svd(centre[None])[2][1:].T)

    def inertia(self, z: Array) -> tuple[Array, Array]:
        """Return J, (3, 3), and the derivatives of its six entries by z, (6, 5)."""
        u = self.centre + self.basis @ z
        size = np.linalg.norm(u)
        slope = (self.basis - np.outer(u, u @ self.basis) / size**2) / size / np.sqrt(2)
        E, dE = _moments(u / size / np.sqrt(2), slope)
        return np.eye(3) / 2 - E, -entries(dE).T


@dataclass(frozen=True)
class Weighed:
    """Six coordinates about an inertia whose second moments exceed ``weight n nᵀ``."""

    centre: Array  # (6,)
    weight: float

    @staticmethod
    def about(J: Array, weight: float, n: Array) -> Weighed:
        """Return the chart whose origin is J."""
        centred = weight * np.outer(n, n)
        J = of_a_body(J, centred)
        return Weighed(np.linalg.cholesky(np.trace(J) / 2 * np.eye(3) - J - centred)[LOWER], weight)

    def inertia(self, z: Array, n: Array) -> tuple[Array, Array]:
        """Return J, (3, 3), and the derivatives of its six entries by z and n, (6, 9)."""
        E, dE = _moments(self.centre + z, np.eye(6))
        by_n = self.weight * np.eye(3)[:, :, None] * n
        dE = np.concatenate([dE, by_n + np.swapaxes(by_n, 1, 2)])
        return inertia_of(self.weight * np.outer(n, n) + E), entries(inertia_of(dE)).T
