r"""Inertias of trace 1 as five free numbers, so that every inertia that a fit tries is that of a body.

A body has the Euler inertia ``E = ∫ρ x xᵀ``, positive semidefinite, and ``J = tr(E) I - E``. Let ``E = L Lᵀ`` with L
lower triangular, its six entries a vector ℓ: ``tr E = |ℓ|²``, so tr J = 1 is ``|ℓ|² = 1/2``, a sphere. About ℓ_0 it is
reached by ``ℓ = (u_0 + P z) / (√2 |u_0 + P z|)`` with ``u_0 = √2 ℓ_0`` and P an orthonormal basis of what is orthogonal
to u_0. All z are bodies, and all bodies but those across the sphere are reached; on a flat one the diagonal of L has a
zero, and the chart is smooth there. Its derivative is not of full rank at such a body, so intervals never use z: they
use J itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.arrays import Array
from .bodies import ENTRIES, symmetric

LOWER = ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2))
THINNEST = 1e-4  # eigenvalue of E, of tr J, below which a start is not taken: on the wall the chart has no slope
# Six entries of symmetric matrices without a trace, of Frobenius norm 1, orthogonal to each other: (6, 5).
TRACELESS = np.zeros((6, 5))
TRACELESS[:3, 0], TRACELESS[:3, 1] = np.array([1, -1, 0]) / np.sqrt(2), np.array([1, 1, -2]) / np.sqrt(6)
TRACELESS[3:, 2:] = np.eye(3) / np.sqrt(2)


def of_trace_one(J: Array) -> Array:
    """Return the inertia of trace 1 closest to a symmetric matrix that is one of a body, and not a flat one."""
    values, vectors = np.linalg.eigh(np.trace(J) / 2 * np.eye(3) - J)
    values = np.maximum(values / max(np.trace(J) / 2, 1e-300) / 2, THINNEST)
    E = (vectors * (values / values.sum() / 2)) @ vectors.T
    return np.asarray(np.eye(3) / 2 - E)


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


def _lower(v: Array) -> Array:
    L = np.zeros((3, 3))
    for (i, j), value in zip(LOWER, v, strict=True):
        L[i, j] = value
    return L


def moved(J: Array, w: Array) -> Array:
    """Return J with w, (5,), along `TRACELESS` added."""
    return np.asarray(J + symmetric(TRACELESS @ w))
