"""Derivatives of terms of a load that depend on the state, at many states: by directors, velocity, time, parameters.

Of each term the moment m in space is differentiated as a function of the nine components of the directors, of the
angular velocity in space and, for potentials, of the half turn b of the step in the body, which discrete gradients
depend on (`engine.generalised`). Directors are taken as they are: averages and stages are not orthonormal.

- Functions: by their own derivative where they have one; compiled ones by dual numbers (`compiled`), others by central
  differences of the function alone. With the step ``eps^(1/3)`` of the scale of an argument, 1 for a director, the
  rounding of the function, eps over the step, and what the difference leaves out, the square of the step times a third
  derivative, are both some 1e-11 of the scale.
- Potentials: with γ_j = a·d_j, δ = -b × γ and a discrete gradient g(γ, δ) the moment is ``a × Σ g_j d_j``. Of quadratic
  potentials and of springs dg is written out. Gonzalez's gradient, ``g = ∇V + 2qδ`` with ``q = (V(γ + δ) - V(γ - δ) -
  2 ∇V·δ)/4|δ|²``, has

      4|δ|² dq = ∇V(γ + δ)·(dγ + dδ) - ∇V(γ - δ)·(dγ - dδ) - 2 δ·Hdγ - 2 ∇V·dδ - 8q δ·dδ,

  H the second derivatives of V, by central differences of its gradient.
- The gravity gradient: its moment m = 3n² c × Jc is linear in J and quadratic in c, c' = n o × c. With c± = c ± o × c
  that is ``∂m/∂t = n (m(c+) - m(c-))/2`` and ``∂m/∂n = 2m/n + (t - t_0) (m(c+) - m(c-))/2``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..geometry.arrays import Array, as_floats
from ..geometry.tensors import BASIS, LEVI
from ..kernels.memory import view_of
from .compiled import States
from .derivatives import STEP, chord
from .forces import DirectorForces, ForceFunction, ForceTable
from .potentials import GravityGradient, Potential, PotentialFunction, Quadratic, Spring
from .terms import Damping, Function, Rotor, Term, name_of

DIFFERENCE = float(2.0 ** np.round(np.log2(np.finfo(np.float64).eps) / 3))  # of a central difference, of the scale
SHORT = 1e-11  # of |Δγ|² over |γ|² below which a discrete gradient is the gradient, as in `engine.generalised`


class At(NamedTuple):
    """States at which terms are evaluated, and the half turns of steps there."""

    times: Array  # (n,)
    directors: Array  # (n, 3, 3) rows
    velocity: Array  # (n, 3) in space
    half: Array  # (n, 3) in the body
    scale: float  # of velocities, rad/s


class Slope(NamedTuple):
    """A moment in space and its derivatives."""

    moment: Array  # (n, 3)
    directors: Array  # (n, 3, 3, 3) of the component c by the component x of the director i: [c, i, x]
    velocity: Array  # (n, 3, 3)
    half: Array  # (n, 3, 3)


def without_derivative(terms: tuple[Term, ...]) -> list[str]:
    """Return the names of functions whose derivatives are differences, and of the classes of other such terms."""
    found = list[str]()
    for term in terms:
        if isinstance(term, PotentialFunction):
            found.append(name_of(term.gradient))
        elif isinstance(term, ForceFunction):
            found.append(name_of(term.director_forces))
        elif isinstance(term, DirectorForces) and not isinstance(term, ForceTable):
            found.append(name_of(type(term)))
        elif (
            term.kind == "state"
            and not isinstance(term, Damping | Rotor)
            and term.derivative is None
            and not term.slopes
        ):
            found.append(name_of(term.function if isinstance(term, Function) else type(term)))
    return found


def moment_slope(term: Term, at: At) -> Slope:
    """Return the moment of a term, without its factor, and the derivatives."""
    if isinstance(term, Potential):
        return _of_gradient(term, at)
    n = len(at.times)
    if term.slopes is not None:
        found = compiled_slopes_at(term, at)
        by_directors = found[:, :, 1:10].reshape(n, 3, 3, 3)
        return Slope(found[:, :, 0], by_directors, found[:, :, 10:13], np.zeros((n, 3, 3)))
    moment = moments(term, at)
    if term.kind == "state" and term.derivative is not None:
        given = [
            own_derivative(term, t, d, w) for t, d, w in zip(at.times.tolist(), at.directors, at.velocity, strict=True)
        ]
        by_directors, by_velocity = (np.array(part) for part in zip(*given, strict=True))
        return Slope(moment, by_directors, by_velocity, np.zeros((n, 3, 3)))
    if isinstance(term, ForceTable):
        return Slope(moment, _of_table(term, at), np.zeros((n, 3, 3)), np.zeros((n, 3, 3)))
    by_directors, by_velocity = np.empty((n, 3, 3, 3)), np.empty((n, 3, 3))
    for i in range(3):
        for x in range(3):
            by_directors[:, :, i, x] = _difference(term, at, "directors", (i, x), DIFFERENCE)
    for x in range(3):
        by_velocity[:, :, x] = _difference(term, at, "velocity", (x,), DIFFERENCE * at.scale)
    return Slope(moment, by_directors, by_velocity, np.zeros((n, 3, 3)))


def compiled_slopes_at(term: Term, at: At) -> Array:
    """Return moments of a compiled function, and their derivatives by directors, velocity, time, (n, 3, 14)."""
    assert term.slopes is not None
    found, block = np.empty((len(at.times), 3, 14)), view_of(States)
    block.states, block.found = len(at.times), found
    for name, array in (("times", at.times), ("directors", at.directors), ("velocities", at.velocity)):
        setattr(block, name, np.ascontiguousarray(array))
    term.slopes(block.address)
    return found


def moments(term: Term, at: At) -> Array:
    """Return the moments of a term in space, (n, 3), without its factor."""
    if isinstance(term, Potential):
        return _of_gradient(term, at).moment
    if term.slopes is not None:
        return compiled_slopes_at(term, at)[:, :, 0]
    states = zip(at.times.tolist(), at.directors, at.velocity, strict=True)
    return np.array([term.moment(t, d, w) for t, d, w in states]).reshape(-1, 3)


def torque_slope(term: Potential, at: At) -> tuple[Array, Array]:
    """Return the torque γ × ∂V/∂γ of a potential in the body, and its derivatives by directors, (n, 3, 3, 3)."""
    a, gamma, delta = _seen(term, at)
    g, by_gamma, _ = _gradient(term, gamma, delta)
    torque: Array = np.cross(gamma, g).sum(axis=1)
    by = np.einsum("cij,nvi,nvjul->ncul", LEVI, gamma, by_gamma) + np.einsum("clj,nvj->ncvl", LEVI, g)
    return torque, np.einsum("ncul,nux->nclx", by, a)  # γ_l = a·d_l


def time_rates(term: Term, at: At) -> Array:
    """Return the derivatives of the moment of forces or a function by the time, (n, 3), without its factor."""
    if isinstance(term, ForceTable):
        rows = [chord(term.times, f, at.times) for f in term.forces_of.reshape(-1, 9).T]
        return _table_moment(term, np.stack(rows, axis=1).reshape(-1, 3, 3), at.directors)
    if term.slopes is not None:
        return compiled_slopes_at(term, at)[:, :, 13]
    e = STEP * max(1.0, float(abs(at.times).max()))
    found: Array = moments(term, at._replace(times=at.times + e)) - moments(term, at._replace(times=at.times - e))
    found /= 2 * e
    return found


def parts_of_time(term: Potential) -> list[tuple[float, Term]]:
    """Return the terms, and their factors, of which the derivative of a potential by the time is the sum."""
    if not isinstance(term, GravityGradient):
        return []
    return [(sign * term.mean_motion / 2, term.led(sign)) for sign in (1.0, -1.0)]


def parts_of(term: Term, name: str, times: Array) -> list[list[tuple[Any, Term]]]:
    """Return for each number of a parameter the terms, and their factors, of which its derivative is the sum.

    Factors are numbers, or (n, 1) at the `times`.
    """
    found: list[list[tuple[Any, Term]]] = []
    if isinstance(term, Quadratic) and name == "linear":
        found = [[(1.0, replace(term, linear=row, quadratic=np.zeros((3, 3))))] for row in np.eye(3)]
    elif isinstance(term, Quadratic):
        found = [[(1.0, replace(term, linear=np.zeros(3), quadratic=Q))] for Q in BASIS]
    elif isinstance(term, Spring):
        if name == "stiffness":
            found = [[(1.0, replace(term, stiffness=1.0))]]
        else:
            L = term.rest_length
            found = [[(1 / L, replace(term, rest_length=2 * L)), (-1 / L, term)]]
    elif isinstance(term, GravityGradient) and name == "mean_motion":
        half = (times - term.start)[:, None] / 2
        found = [[(2 / term.mean_motion, term), (half, term.led(1.0)), (-half, term.led(-1.0))]]
    return found


def forces_slopes(term: ForceTable, directors: Array) -> Array:
    """Return the derivatives of the moment of forces on the directors by these, row by row, (n, 3, 9)."""
    if term.frame == "space":
        found = np.einsum("cyx,niy->ncix", LEVI, directors)
    else:
        found = np.einsum("cyz,niy,njz->ncij", LEVI, directors, directors)
    return np.reshape(found, (len(directors), 3, 9))


def own_derivative(term: Term, t: float, directors: Array, velocity: Array) -> tuple[Array, Array]:
    """Call the derivative that a term of kind "state" has.

    Raises
    ------
    ValueError
        It raised, or returned something else than finite arrays (3, 3, 3) and (3, 3).
    """
    assert term.derivative is not None
    name, shapes = name_of(term.derivative), ((3, 3, 3), (3, 3))
    remedy = (
        "let it return two arrays: by the directors, (3, 3, 3), its entry [c, i, x] the derivative of the component c "
        "by directors[i, x], and by the angular velocity, (3, 3)"
    )
    try:
        by = term.derivative(t, directors.copy(), velocity.copy())
        found = [as_floats(part, f"the derivative {name}") for part in by]
    except Exception as error:
        raise ValueError(
            f"the derivative {name} raised {type(error).__name__} at t = {t:.12g} s: {error}; {remedy}"
        ) from error
    if tuple(part.shape for part in found) != shapes:
        got = ", ".join(str(part.shape) for part in found)
        raise ValueError(f"the derivative {name} returned the shapes {got} at t = {t:.12g} s; {remedy}")
    if not all(np.isfinite(part).all() for part in found):
        raise ValueError(f"the derivative {name} is not finite at t = {t:.12g} s; {remedy}")
    return found[0], found[1]


def _difference(term: Term, at: At, name: str, place: tuple[int, ...], step: float) -> Array:
    """Return the central difference of the moments by one component of an argument."""
    known: Array = getattr(at, name)
    where: Any = (slice(None), *place)
    ahead, behind = known.copy(), known.copy()
    ahead[where] += step
    behind[where] -= step
    apart: Array = (ahead - behind)[where]
    sides: list[At] = [
        at._replace(directors=x) if name == "directors" else at._replace(velocity=x) for x in (ahead, behind)
    ]
    found: Array = (moments(term, sides[0]) - moments(term, sides[1])) / apart[:, None]
    return found


def _table_moment(term: ForceTable, rows: Array, directors: Array) -> Array:
    """Return ``Σ d_i × f^i`` of forces in the frame of a table."""
    forces = rows if term.frame == "space" else rows @ directors
    found: Array = np.cross(directors, forces).sum(axis=1)
    return found


def _of_table(term: ForceTable, at: At) -> Array:
    """Return the derivatives of the moment of a table of forces by the directors."""
    rows = term.rows(at.times)
    forces = rows if term.frame == "space" else rows @ at.directors
    found: Array = np.einsum("cxj,nij->ncix", LEVI, forces)
    if term.frame == "body":  # Σ_i d_i × Σ_j φ_ij dd_j
        found += np.einsum("ckx,njk,nji->ncix", LEVI, at.directors, rows)
    return found


def _seen(term: Potential, at: At) -> tuple[Array, Array, Array]:
    """Return the space vectors (n, k, 3), γ and δ."""
    a = np.broadcast_to(term.vectors_at(at.times), (len(at.times), *term.vectors.shape))
    gamma = np.einsum("njx,nvx->nvj", at.directors, a)
    return a, gamma, -np.cross(at.half[:, None], gamma)


def _of_gradient(term: Potential, at: At) -> Slope:
    """Return the moment ``Σ_v a_v × Σ_j g_vj d_j`` of a discrete gradient, and its derivatives."""
    n, d = len(at.times), at.directors
    a, gamma, delta = _seen(term, at)
    g, by_gamma, by_delta = _gradient(term, gamma, delta)
    drawn = np.einsum("nvj,njx->nvx", g, d)
    # δ = -b × γ: dδ = -db × γ - b × dγ, and dγ_l = a·dd_l
    turned = np.einsum("cil,ni->ncl", LEVI, at.half)
    by_gamma = by_gamma - np.einsum("nvjuc,ncl->nvjul", by_delta, turned)
    change = np.einsum("nvjul,nux,njy->nvylx", by_gamma, a, d)
    change += np.einsum("nvl,xy->nvylx", g, np.eye(3))
    by_half = -np.einsum("nvjuc,cbl,nul,njy->nvyb", by_delta, LEVI, gamma, d)
    return Slope(
        np.cross(a, drawn).sum(axis=1),
        np.einsum("czy,nvz,nvylx->nclx", LEVI, a, change),
        np.zeros((n, 3, 3)),
        np.einsum("czy,nvz,nvyb->ncb", LEVI, a, by_half),
    )


def _gradient(term: Potential, gamma: Array, delta: Array) -> tuple[Array, Array, Array]:
    """Return the discrete gradient (n, k, 3) of a potential, and its derivatives by γ and δ, (n, k, 3, k, 3)."""
    n, k = gamma.shape[:2]
    by_gamma, by_delta = np.zeros((n, k, 3, k, 3)), np.zeros((n, k, 3, k, 3))
    if isinstance(term, Quadratic | GravityGradient):
        by_gamma[:, 0, :, 0] = term.quadratic
        return term.slope(gamma), by_gamma, by_delta
    if isinstance(term, Spring):
        rho, L = term.point, term.rest_length
        u, du = gamma[:, 0] @ rho, delta[:, 0] @ rho
        first, last = (np.sqrt(np.maximum(term.square - 2 * (u + sign * du), 0.0)) for sign in (-1, 1))
        total = first + last
        f = -term.stiffness * (1 - 2 * L / total)
        # df = -k 2L/(ℓ_0 + ℓ_1)² (dℓ_0 + dℓ_1), dℓ = -ρ·(dγ ± dδ)/ℓ
        slope = 2 * term.stiffness * L / total**2
        outer = np.outer(rho, rho)
        by_gamma[:, 0, :, 0] = (slope * (1 / first + 1 / last))[:, None, None] * outer
        by_delta[:, 0, :, 0] = (slope * (1 / last - 1 / first))[:, None, None] * outer
        return f[:, None, None] * rho, by_gamma, by_delta
    assert isinstance(term, PotentialFunction)
    found = np.empty_like(gamma)
    for i in range(n):
        found[i], by_gamma[i], by_delta[i] = _of_function(term, gamma[i], delta[i])
    return found, by_gamma, by_delta


def _of_function(term: PotentialFunction, gamma: Array, delta: Array) -> tuple[Array, Array, Array]:
    """Return Gonzalez's gradient of a potential that is a function, and its derivatives by γ and δ."""
    shape = (*gamma.shape, *gamma.shape)
    slope, H = term.slope(gamma), np.empty(shape)
    e = DIFFERENCE * float(abs(gamma).max() or 1.0)
    for place in np.ndindex(*gamma.shape):
        step = np.zeros_like(gamma)
        step[place] = e
        ahead, behind = gamma + step, gamma - step
        H[..., *place] = (term.slope(ahead) - term.slope(behind)) / (ahead[place] - behind[place])
    square = float((delta * delta).sum())
    if not 4 * square > SHORT * float((gamma * gamma).sum()):
        return slope, H, np.zeros(shape)
    first, last = gamma - delta, gamma + delta
    q = (term.checked_value(last.reshape(term.shape)) - term.checked_value(first.reshape(term.shape))) / (4 * square)
    q -= float((slope * delta).sum()) / (2 * square)
    ahead, behind = term.slope(last), term.slope(first)
    of_gamma = (ahead - behind - 2 * np.einsum("ab,abcd->cd", delta, H)) / (4 * square)
    of_delta = (ahead + behind - 2 * slope) / (4 * square) - 2 * q / square * delta
    by_gamma = H + 2 * np.einsum("ab,cd->abcd", delta, of_gamma)
    by_delta = 2 * np.einsum("ab,cd->abcd", delta, of_delta) + 2 * q * np.eye(gamma.size).reshape(shape)
    return slope + 2 * q * delta, by_gamma, by_delta
