"""The equations of the bodies that are fitted, as data for `series`."""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array
from .series import QuadraticMotion

ENTRIES = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))  # of a symmetric matrix, in this order everywhere
LEVI = np.zeros((3, 3, 3))
for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    LEVI[i, j, k], LEVI[i, k, j] = 1.0, -1.0
BASIS = np.zeros((6, 3, 3))  # ∂J/∂(its entry)
for n, (i, j) in enumerate(ENTRIES):
    BASIS[n, i, j] = BASIS[n, j, i] = 1.0


def entries(J: Array) -> Array:
    """Return the six entries of a symmetric matrix."""
    return np.array([J[..., i, j] for i, j in ENTRIES]).T if J.ndim > 2 else np.array([J[i, j] for i, j in ENTRIES])


def symmetric(v: Array) -> Array:
    """Return the symmetric matrix of six entries."""
    return np.tensordot(v, BASIS, axes=(-1, 0))


def _turning(J: Array) -> Array:
    """Return B with ``B(W, W) = J W × W`` for one matrix or many."""
    T = np.einsum("abc,...bd->...adc", LEVI, J)
    return np.asarray((T + np.swapaxes(T, -1, -2)) / 2)


def free_body(J: Array) -> QuadraticMotion:
    """Return ``J W' = J W × W`` with its derivatives by the six entries of J."""
    return QuadraticMotion(J, np.zeros((3, 3)), _turning(J), BASIS, np.zeros((6, 3, 3)), _turning(BASIS))
