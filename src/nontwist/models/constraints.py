"""The constraints of the director description as constant 3×3 matrices.

Each constraint reads ``<A_k q, v> = Σ_ij (A_k)_ij d_j·v_i = 0``. Orthonormality (eq_internal_constraint, with the
three rows of unit length that the paper leaves out) gives symmetric matrices: ``A_ii = e_i e_iᵀ`` for
``h_ii = 1/2 (d_i·d_i - 1)`` and ``A_ij = e_i e_jᵀ + e_j e_iᵀ`` for ``h_ij = d_i·d_j``. The nonholonomic constraint
about the body axis n is skew, ``A = -n̂/2``, since ``<-n̂ q, v>/2 = w·Λn`` for ``v_i = w × d_i``. The paper's
``g = (1-a) d1'·d2 - a d2'·d1`` differs from it by a multiple of A_12.
"""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array
from ..geometry.tensors import BASIS, hats

LABELS = ("11", "22", "33", "23", "13", "12", "nh")


def constraint_matrices(axis: Array | None, a: float = 0.5) -> Array:
    """Return the matrices A_k in the order of `LABELS`.

    Parameters
    ----------
    axis : (3,) unit array or None
        Constrained body axis; None leaves the last matrix out.
    a : float
        The paper's parameter (eq_weak_form_rigid_body_alternative): adds ``(1/2 - a) A_12`` to the last matrix. It
        changes the multiplier of d1·d2 and nothing else.

    Returns
    -------
    (6, 3, 3) or (7, 3, 3) array
    """
    if axis is None:
        return BASIS
    return np.concatenate([BASIS, -0.5 * hats(axis[None]) + (0.5 - a) * BASIS[5]])
