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
from ..geometry.tensors import ENTRIES

LOWER = ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2))
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
    E = (vectors * np.maximum(values, thinnest * abs(np.trace(J)))) @ vectors.T + centred
    return np.asarray(np.trace(E) * np.eye(3) - E)


@dataclass(frozen=True)
class Chart:
    """Five coordinates about an inertia of trace 1."""

    centre: Array  # (6,), of length 1
    basis: Array  # (6, 5)

    @staticmethod
    def about(J: Array) -> Chart:
        """Return the chart whose origin is J, of trace 1."""
        L = np.linalg.cholesky(np.eye(3) / 2 - of_trace_one(J))
        centre = np.sqrt(2) * np.array([L[i, j] for i, j in LOWER])
        centre /= np.linalg.norm(centre)
        basis = np.linalg.svd(centre[None])[2][1:].T
        return Chart(centre, basis)

    def inertia(self, z: Array) -> tuple[Array, Array]:
        """Return J, (3, 3), and the derivatives of its six entries by z, (6, 5)."""
        u = self.centre + self.basis @ z
        size = np.linalg.norm(u)
        L, slope = (
            _lower(u / size / np.sqrt(2)),
            (self.basis - np.outer(u, u @ self.basis) / size**2) / size / np.sqrt(2),
        )
        dL = np.array([_lower(column) for column in slope.T])
        dE = dL @ L.T + L @ np.swapaxes(dL, 1, 2)
        return np.eye(3) / 2 - L @ L.T, -np.array([[one[i, j] for one in dE] for i, j in ENTRIES])


@dataclass(frozen=True)
class Weighed:
    """Six coordinates about an inertia whose second moments exceed ``weight n nᵀ``."""

    centre: Array  # (6,)
    weight: float

    @staticmethod
    def about(J: Array, weight: float, n: Array) -> Weighed:
        """Return the chart whose origin is J."""
        J = of_a_body(J, weight * np.outer(n, n))
        L = np.linalg.cholesky(np.trace(J) / 2 * np.eye(3) - J - weight * np.outer(n, n))
        return Weighed(np.array([L[i, j] for i, j in LOWER]), weight)

    def inertia(self, z: Array, n: Array) -> tuple[Array, Array]:
        """Return J, (3, 3), and the derivatives of its six entries by z and n, (6, 9)."""
        L = _lower(self.centre + z)
        dL = np.array([_lower(column) for column in np.eye(6)])
        dE = dL @ L.T + L @ np.swapaxes(dL, 1, 2)
        by_n = self.weight * np.eye(3)[:, :, None] * n
        dE = np.concatenate([dE, by_n + np.swapaxes(by_n, 1, 2)])
        E = self.weight * np.outer(n, n) + L @ L.T
        dJ = np.trace(dE, axis1=1, axis2=2)[:, None, None] * np.eye(3) - dE
        return np.trace(E) * np.eye(3) - E, np.array([[one[i, j] for one in dJ] for i, j in ENTRIES])


def _lower(v: Array) -> Array:
    L = np.zeros((3, 3))
    for (i, j), value in zip(LOWER, v, strict=True):
        L[i, j] = value
    return L
