"""Two constant tensors, of the cross product and of symmetric matrices by their six entries; matrices ``a ×``."""

import numpy as np

from .arrays import Array

LEVI = np.zeros((3, 3, 3))  # (a × b)_c = LEVI[c, i, j] a_i b_j
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    LEVI[_i, _j, _k], LEVI[_i, _k, _j] = 1.0, -1.0
ENTRIES = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))  # of a symmetric matrix, in this order everywhere
BASIS = np.zeros((6, 3, 3))  # the derivatives of a symmetric matrix by these
for _n, (_i, _j) in enumerate(ENTRIES):
    BASIS[_n, _i, _j] = BASIS[_n, _j, _i] = 1.0


def hats(a: Array) -> Array:
    """Return the matrices of ``a ×``, (n, 3, 3), of vectors (n, 3)."""
    found: Array = np.einsum("cij,ni->ncj", LEVI, a)
    return found
