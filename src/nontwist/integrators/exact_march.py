"""The march of `exact_solution`: from a `Problem` through the closed solutions to a `March`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..exact.free_bodies import TOO_FAR
from ..exact.free_constants import BAD_TIME, NOT_PRINCIPAL, OK
from ..exact.free_kernels import director_states, free_members, free_run, turns
from ..exact.loaded_body import Pieces, Turning, gauss, pieces_of, turning
from ..geometry.arrays import Array
from ..loads import Load
from ..models.catalogue import D3
from .base import March, Problem
from .ensemble import Ensemble, Outcome, in_threads, nothing, progress

BLOCK = 4096  # members


def march(problem: Problem) -> March:
    """Evaluate the solution of `problem` at its output times."""
    system, times, t_start = problem.system, problem.output, problem.t_start
    if system.dead_force.any():
        raise _refusal("gravity and other dead forces")
    start = np.zeros((10, 3))
    start[:3], start[3:6], start[6:9] = system.euler_inertia, problem.directors, problem.velocities
    if system.axis is not None:
        start[9] = system.axis
    if problem.load.terms and _acts(problem.load, t_start, float(times[-1])):
        return _loaded(problem, start)
    status, q, v, mu = free_run(start, system.axis is not None, t_start, times)
    _require_solution(status)
    n = len(times) - 1
    multipliers = np.zeros((n, 0)) if system.axis is None else np.full((n, 1), mu)
    return March(q, v, multipliers, np.zeros((n, 3)), np.zeros(n), None)


def march_many(ensemble: Ensemble, threads: int) -> Outcome | None:
    """Evaluate the solutions of free bodies at the output times; None where there is a load."""
    systems, times, load = ensemble.systems, ensemble.output, ensemble.load
    if load.terms and _acts(load, ensemble.t_start, float(times[-1])):
        return None
    if systems.dead_force is not None and systems.dead_force.any():
        raise _refusal("gravity and other dead forces")
    out = nothing(ensemble)
    axes, since = np.zeros((0, 3)) if systems.axis is None else systems.axis, times - ensemble.t_start
    place = int(since[0] == 0.0)  # the start is there already
    J, since = systems.convected_inertia, since[place:].copy()

    def block(first: int, last: int) -> None:
        where = (place, first, last, out.quaternion, out.velocity)
        status, member = free_members(J, axes, since, *where)
        try:
            _require_solution(status)
        except ValueError as error:
            raise ValueError(f"member {member}: {error}") from error

    in_threads(block, (0, len(ensemble)), BLOCK, threads, progress(ensemble))
    return out


def _require_solution(status: int) -> None:
    if status == NOT_PRINCIPAL:
        raise _refusal("a Suslov body (for its velocity there is nontwist.exact.suslov_velocity)")
    if status == BAD_TIME:
        raise ValueError(TOO_FAR)
    if status != OK:
        raise ValueError("exact cannot take this body: its inertia is at the limit of what a body can have")


def _refusal(what: str) -> ValueError:
    return ValueError(f"exact has no closed solution for {what}; take integrator='lie-midpoint'")


def _acts(load: Load, t_start: float, t_end: float) -> bool:
    """Whether a term of `load` is not zero somewhere between the times, seen at 16 points between its breakpoints."""
    if load.depends_on_state:
        raise _refusal("a load that depends on the state")
    inner = [t for t in load.breakpoints if t_start < t < t_end]
    edges = np.unique([t_start, *inner, t_end])
    at = ((edges[1:] + edges[:-1])[:, None] / 2 + np.diff(edges)[:, None] / 2 * gauss()[0]).ravel()
    return bool(load.sample(at, "body").any() or load.sample(at, "space").any())


def _loaded(problem: Problem, start: Array) -> March:
    system, times = problem.system, problem.output
    if system.axis is None:
        raise _refusal("a standard body under load")
    if any(term.kind != "body" for term in problem.load.terms):
        raise _refusal("a moment along fixed directions")
    at_start = np.array([problem.t_start])
    status, q, v, _ = free_run(start, True, problem.t_start, at_start)
    _require_solution(status)
    R, W = np.ascontiguousarray(q[0].T), q[0] @ np.cross(q[0], v[0]).sum(0) / 2
    # Turn the body so that its axis is the third.
    V = _frame(system.axis)
    J = V @ system.convected_inertia @ V.T
    pieces = pieces_of(problem.load, np.unique(np.append(times, problem.t_start)))
    pieces = pieces._replace(moment=pieces.moment @ V.T)
    motion = turning(J, J @ (V @ W), pieces)
    if motion is None:
        raise _refusal("a load that moves the axis of rotation in the body")
    at = np.searchsorted(np.append(pieces.a, pieces.b[-1]), times)
    attitude = turns(R, motion.axis @ V, motion.angle[at])
    states = director_states(attitude, np.outer(motion.rate[at], motion.axis @ V))
    return March(*states, *_means(J, R @ V.T, pieces, motion, at, times), None)


def _frame(axis: Array) -> Array:
    """Return a rotation with the third row `axis`; the identity for D3."""
    if np.array_equal(axis, D3):
        return np.eye(3)
    V: Array = np.roll(np.linalg.svd(axis[None])[2], -1, axis=0)
    V[2] = axis
    V[0] *= np.sign(np.linalg.det(V))
    return V


def _means(
    J: Array, R: Array, pieces: Pieces, motion: Turning, at: NDArray[np.intp], times: Array
) -> tuple[Array, Array, Array]:
    """Return the means of μ and of the spatial moment and the work, between the output times."""
    half, weights = (pieces.b - pieces.a) / 2, gauss()[1]
    shape = motion.angle_inside.shape
    inside = turns(R, motion.axis, motion.angle_inside.ravel()).reshape(*shape, 3, 3)
    m = np.einsum("pnab,pnb->pna", inside, pieces.moment)
    mu = motion.rate_inside**2 * np.cross(J @ motion.axis, motion.axis)[2] + pieces.moment[..., 2]
    power = motion.rate_inside * (pieces.moment @ motion.axis)
    values = np.concatenate([mu[..., None], m, power[..., None]], axis=2)
    sums = half[:, None] * np.einsum("n,pnc->pc", weights, values)
    total = np.concatenate([np.zeros((1, 5)), np.cumsum(sums, axis=0)])
    between = np.diff(total[at], axis=0)
    length = np.diff(times)[:, None]
    return between[:, :1] / length, between[:, 1:4] / length, between[:, 4]
