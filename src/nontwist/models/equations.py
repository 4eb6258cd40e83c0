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

On what a caller gives, the split form (sec-standard-formualtion, sec-nonholonomic-formulation) is `momentum`,
`velocity`, `energy` and `rates`. Vectors split along the director d = Λn of the constrained axis, d3 where the body has
none (eq-r3-isomorphism):

    w = w_⊥ + w_∥ d,        π = π_⊥ + π_∥ d,        K = ½ w_⊥·π_⊥ + ½ w_∥ π_∥,

with w_⊥ = d × d' (eq-omegas-split, eq-omegas-perp, eq-pi-split). Where n is a principal axis, the
spatial inertia j = Λ J Λᵀ (eq-inertia-inertia) splits as well, ``j = j_⊥ + j_∥ d ⊗ d`` (eq-irho-decomp-spatial). Then
π_⊥ = j_⊥ w_⊥ and π_∥ = j_∥ w_∥ (eq-pi-split-components), and the two parts of K are those of
eq-kinetic-density-convected. The rates are those of eq-standard and eq-nonholonomic, the sign corrected
(docs/errata.md, 3).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import TINY, TOLERANCE, Array, as_array, dot, norm, refuse
from ..geometry.attitudes import BASIS, hats
from ..geometry.rotations import is_rotation
from .system import DirectorSystem, as_system

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
    m = moment + products(q, system.dead_force)
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
def _axial_response(system: DirectorSystem) -> Array:
    """Return what gives ``π_∥ = n·J W`` of Π, of a body with an axis n."""
    return _axis_or_d3(system) @ system.convected_inertia @ _response(system)


@lru_cache(maxsize=64)
def _response(system: DirectorSystem) -> Array:
    """Return what gives W of Π: J⁻¹, or the inverse of ``P J P`` on the plane orthogonal to n, 0 along n."""
    J = system.convected_inertia
    plane = I3 if system.axis is None else np.linalg.svd(system.axis[None])[2][1:]
    return plane.T @ np.linalg.solve(plane @ J @ plane.T, plane)


def momentum(system: DirectorSystem, directors: ArrayLike, spatial_momentum: ArrayLike) -> tuple[Array, Array]:
    """Split a momentum along the constrained director: ``π = π_⊥ + π_∥ d`` (eq-pi-split).

    If n is E3, ``π_⊥ = Π1 d1 + Π2 d2`` (eq-pi-perp). Any spatial vector can be split in this way; the parts of an
    angular velocity are w_⊥ and the spin w_∥ (eq-omegas-split).

    Parameters
    ----------
    system : DirectorSystem
        Its axis n, or E3 if it has none, determines ``d = Λn``.
    directors : (..., 3, 3) array
        Rows d_i.
    spatial_momentum : (..., 3) array, kg m² s⁻¹

    Returns
    -------
    momentum_perp : (..., 3) array, kg m² s⁻¹
        π_⊥, tangent to the sphere at d.
    momentum_par : (...) array, kg m² s⁻¹
        π_∥ = π·d.

    Raises
    ------
    ValueError
        `system` is not a body, directors are not orthonormal and right-handed (the message names the index), leading
        axes do not broadcast, or a number is above 1e100.

    Examples
    --------
    The momentum of a free non-twisting body remains in the tangent plane:

    >>> from nontwist import nontwisting, simulate, split_form
    >>> body = nontwisting([3, 4, 5])
    >>> run = simulate(body, t_end=1, step=0.1, material_angular_velocity=(1, 2, 0), integrator="split")
    >>> perp, par = split_form.momentum(body, run.directors, run.spatial_momentum)
    >>> bool(abs(par).max() < 1e-13)
    True
    """
    body = as_system(system)
    lead, (q, pi) = _states(directors, spatial_momentum=(spatial_momentum, (3,)))
    perp, par = _each(split_momentum, body, q, pi)
    return perp.reshape(*lead, 3), par.reshape(lead)


def velocity(system: DirectorSystem, directors: ArrayLike, momentum_perp: ArrayLike, momentum_par: ArrayLike) -> Array:
    """Return the spatial angular velocity of a split momentum (eq-pi-split-components).

    Parameters
    ----------
    system : DirectorSystem
    directors : (..., 3, 3) array
        Rows d_i.
    momentum_perp : (..., 3) array, kg m² s⁻¹
        π_⊥, tangent to the sphere at d.
    momentum_par : (...) array, kg m² s⁻¹
        π_∥. Not used for a body with a constrained axis: w·d = 0, so π_⊥ alone determines w.

    Returns
    -------
    (..., 3) array, rad/s

    Raises
    ------
    ValueError
        As `momentum`; or π_⊥ is not tangent at d (the message names the index).

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist import nontwisting, split_form, standard
    >>> split_form.velocity(standard([3, 4, 5]), np.eye(3), (3, 8, 0), 15)
    array([1., 2., 3.])
    >>> split_form.velocity(nontwisting([3, 4, 5]), np.eye(3), (3, 8, 0), 0)
    array([1., 2., 0.])
    """
    body = as_system(system)
    lead, states = _split_states(body, directors, momentum_perp, momentum_par)
    (w,) = _each(lambda *state: (split_velocity(*state),), body, *states)
    return w.reshape(*lead, 3)


def energy(system: DirectorSystem, directors: ArrayLike, angular_velocity: ArrayLike) -> tuple[Array, Array]:
    """Split the kinetic energy: ``K_⊥ = ½ w_⊥·π_⊥`` and ``K_∥ = ½ w_∥ π_∥`` (eq-kinetic-density-convected).

    Their sum is K for every body. If the axis is principal, they are the paper's ``½ w_⊥·j_⊥ w_⊥`` and ``½ j_∥ w_∥²``;
    otherwise K_∥ of a body that may spin can be negative.

    Parameters
    ----------
    system : DirectorSystem
    directors : (..., 3, 3) array
        Rows d_i.
    angular_velocity : (..., 3) array, rad/s
        Spatial components.

    Returns
    -------
    energy_perp, energy_par : (...) arrays, J

    Raises
    ------
    ValueError
        As `momentum`.

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist import split_form, standard
    >>> perp, par = split_form.energy(standard([3, 4, 5]), np.eye(3), (1, 2, 3))
    >>> float(perp), float(par)  # (3 + 16)/2, 45/2
    (9.5, 22.5)
    """
    body = as_system(system)
    lead, (q, w) = _states(directors, angular_velocity=(angular_velocity, (3,)))
    pi = np.einsum("nix,ij,njy,ny->nx", q, body.convected_inertia, q, w, optimize=True)
    w_perp, w_par = _each(split_momentum, body, q, w)
    pi_perp, pi_par = _each(split_momentum, body, q, pi)
    return dot(w_perp, pi_perp).reshape(lead) / 2, (w_par * pi_par).reshape(lead) / 2


def rates(
    system: DirectorSystem,
    directors: ArrayLike,
    momentum_perp: ArrayLike,
    momentum_par: ArrayLike,
    moment: ArrayLike = (0.0, 0.0, 0.0),
) -> tuple[Array, Array, Array, Array]:
    """Return the rates of the split form and the multiplier (eq-standard, eq-nonholonomic, with the sign corrected).

    ``∇π_⊥ + π_∥ d' = m_⊥`` along d', and ``π_∥' - π_⊥·d' + μ = m_∥``. The rate of π_⊥ is that in space: its part along
    d is -π_⊥·d', the rest is the covariant derivative. For a body with a constrained axis the rates are those of
    eq-nonholonomic-red.

    Parameters
    ----------
    system : DirectorSystem
    directors : (..., 3, 3) array
        Rows d_i.
    momentum_perp : (..., 3) array, kg m² s⁻¹
        π_⊥, tangent to the sphere at d.
    momentum_par : (...) array, kg m² s⁻¹
        π_∥. Not used for a body with a constrained axis.
    moment : (..., 3) array, N m
        Spatial moment of the load; that of the dead forces of the body is added.

    Returns
    -------
    directors_rate : (..., 3, 3) array, 1/s
        Rows d_i' = w × d_i.
    momentum_perp_rate : (..., 3) array, N m
    momentum_par_rate : (...) array, N m
    mu : (...) array, N m
        Multiplier μ; the constraint exerts the moment -μ d on the body. 0 for a body without a constrained axis.

    Raises
    ------
    ValueError
        As `velocity`.

    Examples
    --------
    The multiplier of case 1 of the paper, π_⊥·d3' = 468/7 N m:

    >>> import numpy as np
    >>> from nontwist import nontwisting, split_form
    >>> body = nontwisting([[3, -1 / 7, 0], [-1 / 7, 4, 0], [0, 0, 5]])
    >>> *rates, mu = split_form.rates(body, np.eye(3), body.inertia @ (6, -18, 0), 0)
    >>> round(float(mu), 9)
    66.857142857
    """
    body = as_system(system)
    lead, states = _split_states(body, directors, momentum_perp, momentum_par, moment=(moment, (3,)))
    q_dot, perp_dot, par_dot, mu = _each(split_rates, body, *states)
    return q_dot.reshape(*lead, 3, 3), perp_dot.reshape(*lead, 3), par_dot.reshape(lead), mu.reshape(lead)


def _states(directors: ArrayLike, **given: tuple[ArrayLike, tuple[int, ...]]) -> tuple[tuple[int, ...], list[Array]]:
    """Return the common leading axes, and directors and other arrays with these axes made one."""
    found = {"directors": as_array(directors, "directors", (..., 3, 3))}
    refuse(~is_rotation(found["directors"]), "directors", "is not an orthonormal, right-handed triad of rows")
    found |= {name: as_array(value, name, (..., *tail)) for name, (value, tail) in given.items()}
    tails = {"directors": (3, 3), **{name: tail for name, (_, tail) in given.items()}}
    leads = {name: array.shape[: array.ndim - len(tails[name])] for name, array in found.items()}
    try:
        lead = np.broadcast_shapes(*leads.values())
    except ValueError as error:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in found.items())
        raise ValueError(f"the leading axes must be the same, or 1, in all arguments; got {shapes}") from error
    full = ((np.broadcast_to(array, lead + tails[name]), tails[name]) for name, array in found.items())
    return lead, [array.reshape(prod(lead), *tail) for array, tail in full]


def _split_states(
    body: DirectorSystem, directors: ArrayLike, perp: ArrayLike, par: ArrayLike, **given: Any
) -> tuple[tuple[int, ...], list[Array]]:
    """Return states as `_states` does; ValueError where π_⊥ is not tangent."""
    lead, states = _states(directors, momentum_perp=(perp, (3,)), momentum_par=(par, ()), **given)
    d = _axis_or_d3(body) @ states[0]
    bad = np.abs(dot(d, states[1])) > TOLERANCE * norm(states[1]) + TINY
    reason = "is not tangent at the director of the axis; split_form.momentum returns the tangent part"
    refuse(bad.reshape(lead), "momentum_perp", reason)
    return lead, states


def _each(function: Callable[..., Any], body: DirectorSystem, *states: Array) -> list[Array]:
    """Return what a function of one state gives for each, as arrays."""
    pairs = zip(*states, strict=True)
    found = [function(body, *(float(x) if x.ndim == 0 else x for x in state)) for state in pairs]
    if not found:  # shapes without entries: those of one state at rest
        found = [function(body, np.eye(3), *(np.zeros(x.shape[1:]) for x in states[1:]))]
        return [np.asarray(one)[None][:0] for one in found[0]]
    return [np.array(column, dtype=np.float64) for column in zip(*found, strict=True)]
