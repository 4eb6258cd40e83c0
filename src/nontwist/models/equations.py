"""The continuous equations of motion, in both descriptions of the paper, for every `DirectorSystem`.

Split form. Let d = Λn be the constrained director (n = E3 where the body has no axis), and split the momentum,
``π = π_⊥ + π_∥ d`` with π_⊥·d = 0. The balance ``π' = m - μ d`` reads (eq-standard, eq-nonholonomic)

    ∇_{d'} π_⊥ + π_∥ d' = m_⊥,        π_∥' - π_⊥·d' + μ = m_∥,

where the paper prints ``+ π_⊥·d'``: from π_⊥·d = 0 follows π_⊥'·d = -π_⊥·d'. Standard body: μ = 0 and w = j⁻¹ π. Body
with an axis: w·d = 0, so w is what π_⊥ alone determines, W = (P J P)⁺ Π_⊥ with P the projection along n; then π_∥ =
n·J W is no state of its own (0 where n is principal: eq-nonholonomic-red), and the second equation gives μ.

Director form (eq_weak_form_rigid_body, eq_weak_form_rigid_body_alternative), from the action with constraints
(eq-constrained-L). With the constraint matrices A_k,

    E v' + Σ_k λ_k A_k q = f,        <A_k q, v'> = -<A_k v, v>    for every k,

the second row being the time derivative of ``<A_k q, v> = 0``. Loads act as f^i = m × d_i / 2, dead forces as they are.

Constraints. Each reads ``<A_k q, v> = Σ_ij (A_k)_ij d_j·v_i = 0``. Orthonormality (eq_internal_constraint, with the
three rows of unit length that the paper leaves out) gives symmetric matrices: ``A_ii = e_i e_iᵀ`` for
``h_ii = 1/2 (d_i·d_i - 1)`` and ``A_ij = e_i e_jᵀ + e_j e_iᵀ`` for ``h_ij = d_i·d_j``. The nonholonomic constraint
about the body axis n is skew, ``A = -n̂/2``, since ``<-n̂ q, v>/2 = w·Λn`` for ``v_i = w × d_i``. The paper's
``g = (1-a) d1'·d2 - a d2'·d1`` differs from it by a multiple of A_12.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..geometry.arrays import Array
from ..geometry.attitudes import BASIS, hats
from .system import DirectorSystem

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


I3, NO_FORCES = np.eye(3), np.zeros((3, 3))


def hat(w: Array) -> Array:
    """Return ŵ, ``ŵ x = w × x``."""
    x, y, z = w.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def products(a: Array, b: Array) -> Array:
    """Return ``Σ a_i × b_i`` over the rows of two (3, 3) arrays, (3,)."""
    (_, xy, xz), (yx, _, yz), (zx, zy, _) = (a.T @ b).tolist()
    return np.array([yz - zy, zx - xz, xy - yx])


class SplitRates(NamedTuple):
    """Time derivatives in the split form, and the multiplier μ (N m; 0 without an axis)."""

    directors: Array  # (3, 3)
    momentum_perp: Array  # (3,)
    momentum_par: float
    mu: float


def split_momentum(system: DirectorSystem, q: Array, pi: Array) -> tuple[Array, float]:
    """Split a spatial momentum into ``(π_⊥, π_∥)`` along d = Λn (eq-pi-split)."""
    d = _axis_or_d3(system) @ q
    par = float(pi @ d)
    return pi - par * d, par


def split_velocity(system: DirectorSystem, q: Array, pi_perp: Array, pi_par: float) -> Array:
    """Return the spatial angular velocity w, (3,), rad/s, of a split momentum (eq-pi-split-components)."""
    Pi = q @ pi_perp
    if system.axis is None:
        Pi[2] += pi_par
    return _response(system) @ Pi @ q


def split_rates(
    system: DirectorSystem, q: Array, pi_perp: Array, pi_par: float, moment: Array, w: Array | None = None
) -> SplitRates:
    """Return the rates of the split form (eq-standard, eq-nonholonomic, the sign corrected).

    Parameters
    ----------
    system : DirectorSystem
    q : (3, 3) array, directors as rows
    pi_perp, pi_par : (3,) array and float, kg m² s⁻¹
        The split momentum; for a body with an axis `pi_par` is not used.
    moment : (3,) array, N m
        Spatial moment of the load, dead forces not included.
    w : (3,) array, rad/s, optional
        The velocity, where `split_velocity` has found it.
    """
    turn, d = hat(split_velocity(system, q, pi_perp, pi_par) if w is None else w), _axis_or_d3(system) @ q
    m = moment + products(q, system.dead_force) if _is_heavy(system) else moment
    d_dot = turn @ d
    along, mu = float(pi_perp @ d_dot + m @ d), 0.0  # π_∥' + μ
    if system.axis is None:
        return SplitRates(q @ turn.T, m - along * d - pi_par * d_dot, along, mu)
    axial_response = _axial_response(system)
    perp_dot = m - along * d - float(axial_response @ (q @ pi_perp)) * d_dot
    mu = along - float(axial_response @ (q @ perp_dot))
    return SplitRates(q @ turn.T, perp_dot, along - mu, mu)


def director_rates(
    system: DirectorSystem, q: Array, v: Array, moment: Array, forces: Array = NO_FORCES
) -> tuple[Array, Array]:
    """Return ``(v', multipliers)`` of the director form (eq_weak_form_rigid_body_alternative).

    Parameters
    ----------
    system : DirectorSystem
    q, v : (3, 3) arrays, 1 and 1/s
        Directors and their velocities as rows.
    moment : (3,) array, N m
        Spatial moment of the load, dead forces not included.
    forces : (3, 3) array, N m
        Further forces on the directors, rows.

    Returns
    -------
    v_dot : (3, 3) array, 1/s²
    multipliers : (6,) or (7,) array, N m
        λ in the order 11, 22, 33, 23, 13, 12, then μ.
    """
    A = constraint_matrices(system.axis)
    c = len(A)
    B = (A @ q).reshape(c, 9)
    matrix = np.zeros((9 + c, 9 + c))
    matrix[:9, :9], matrix[:9, 9:], matrix[9:, :9] = np.kron(system.euler_inertia, I3), B.T, B
    force = system.dead_force + forces + np.cross(moment, q) / 2
    right = np.concatenate([force.ravel(), -np.sum((A @ v) * v, axis=(1, 2))])
    x = np.linalg.solve(matrix, right)
    return x[:9].reshape(3, 3), x[9:]


def _axis_or_d3(system: DirectorSystem) -> Array:
    return I3[2] if system.axis is None else system.axis


@lru_cache(maxsize=64)
def _is_heavy(system: DirectorSystem) -> bool:
    return bool(system.dead_force.any())


@lru_cache(maxsize=64)
def _axial_response(system: DirectorSystem) -> Array:
    """Return what gives ``π_∥ = n·J W`` of Π, of a body with an axis n."""
    return _axis_or_d3(system) @ system.convected_inertia @ _response(system)


@lru_cache(maxsize=64)
def _response(system: DirectorSystem) -> Array:
    """Return what gives W of Π: J⁻¹, or the inverse of ``P J P`` on the plane orthogonal to n, 0 along n."""
    J = system.convected_inertia
    plane = I3 if system.axis is None else np.linalg.svd(system.axis[None])[2][1:]
    return plane.T @ np.linalg.solve(plane @ J @ plane.T, plane)
