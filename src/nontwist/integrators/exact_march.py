"""The march of `exact_solution`: from a `Problem` through the closed-form solutions to an `Outcome`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..exact.free_bodies import TOO_FAR
from ..exact.free_constants import BAD_TIME, NOT_PRINCIPAL, OK
from ..exact.free_kernels import PRINCIPAL, free_members, turns
from ..exact.gyrostats import gyrostat_motion
from ..exact.loaded_body import (
    MOST,
    Pieces,
    Turning,
    edges_of,
    gauss,
    halved_pieces,
    pieces_of,
    too_many,
    turning,
    unrefined,
)
from ..geometry.arrays import Array
from ..geometry.attitudes import attitudes, director_velocities, product, without_jumps
from ..loads import Load
from ..models.catalogue import D3
from ..models.stack import SystemStack
from ..models.system import DirectorSystem
from .costs import Cost
from .members import in_threads, one_by_one, outcome_of, progress
from .problem import Intervals, March, Outcome, Problem, room

BLOCK = 4096  # members, or pieces of a load
GLANCE = 128  # pieces of a load that are enough for a refusal
STATE_NS, PIECE_NS, PIECE = 1_500, 50_000, 4_200  # of an output; of a piece, and its bytes: measured
GYROSTAT_NS = 1_500_000  # of the constants of a gyrostat
FORCES, DEPENDENT = "gravity and other dead forces", "a load that depends on the state"
SUSLOV = "a Suslov body (for its velocity there is nontwist.exact.suslov_velocity)"
ROTORS = "a body with rotors, unless it is a standard one, their momentum is constant, and nothing else acts"
SPIN = "a prescribed spin"
MOVING = "a load that moves the axis of rotation in the body"


def march(problem: Problem, threads: int) -> Outcome:
    """Evaluate the solutions of all members at the output times."""
    m = len(problem)
    if m == 1:
        problem = problem.member(0)
    systems, load, times = problem.systems, problem.load, problem.output
    if reason := refusal(problem) if m == 1 else _refusal_of_all(problem):
        raise ValueError(reason)
    is_gyrostat = bool(load.rotor_momentum(times[:1]).any())
    if is_gyrostat or _acts(load, _edges(load, problem.t_start, float(times[-1]))):
        if m > 1:
            return one_by_one(lambda one: march(one, 1), problem, threads)
        return _gyrostat(problem) if is_gyrostat else outcome_of(problem, _loaded(problem))
    out, J = room(problem), systems.convected_inertia
    axes, since = np.zeros((0, 3)) if systems.axis is None else systems.axis, times - problem.t_start
    place = int(since[0] == 0.0)  # the start is there already
    since = since[place:].copy()

    def block(first: int, last: int) -> None:
        status, member = free_members(J, axes, since, place, first, last, *out.states[:2])
        try:
            _require_solution(status)
        except ValueError as error:
            raise ValueError(f"member {member}: {error}" if m > 1 else str(error)) from error

    in_threads(block, (0, m), BLOCK, threads, progress(problem))
    if not problem.intervals:
        return out
    return out._replace(intervals=free_intervals(systems, problem.velocity, len(times) - 1))


def free_intervals(systems: SystemStack, W: Array, n: int) -> Intervals:
    """Return the means over n intervals of free bodies: μ = n·(J W × W), and no moment."""
    m, mu = len(W), np.zeros((len(W), 0))
    if systems.axis is not None:
        JW = (systems.convected_inertia @ W[:, :, None])[:, :, 0]
        mu = np.sum(systems.axis * np.cross(JW, W), axis=1, keepdims=True)
    none = np.zeros((m, n, 3))
    return Intervals(np.repeat(mu[:, None], n, axis=1), none, np.zeros((m, n)), None, none)


def _refusal_of_all(problem: Problem) -> str | None:
    """Return why there is no closed-form solution for a stack, as far as what its members share shows it."""
    if reason := _unknown(problem):
        return reason
    if problem.load.depends_on_state and not problem.load.rotors:
        return _no_solution(DEPENDENT)
    return _no_solution(FORCES) if problem.systems.has_dead_force else None


def _unknown(problem: Problem) -> str | None:
    """Return why motions with rotors or a prescribed spin are not known."""
    if problem.load.rotors and not _is_gyrostat(problem):
        return _no_solution(ROTORS)
    return _no_solution(SPIN) if problem.systems.spin is not None else None


def _is_gyrostat(problem: Problem) -> bool:
    """Whether standard bodies carry rotors of constant momentum, and nothing else acts."""
    load, t0, t1 = problem.load, problem.t_start, problem.t_end
    if problem.systems.axis is not None or problem.systems.has_dead_force or len(load.rotors) < len(load.terms):
        return False
    c = load.rotor_momentum([t0, t1, *(t for t in load.breakpoints if t0 < t < t1)])
    return bool((c == c[0]).all())


def refusal(problem: Problem) -> str | None:
    """Return why there is no closed-form solution, None where there is one, as far as the load alone shows it."""
    system, load, n = problem.system, problem.load, problem.system.axis
    if reason := _unknown(problem):
        return reason
    if system.dead_force.any():
        return _no_solution(FORCES)
    if n is not None:
        across = np.cross(n, system.convected_inertia @ n)
        if abs(across).max() > PRINCIPAL * np.trace(system.euler_inertia):
            return _no_solution(SUSLOV)
    if load.rotors:
        return None
    if load.depends_on_state:
        return _no_solution(DEPENDENT)
    if not load.terms:
        return None
    edges = _edges(load, problem.t_start, problem.t_end)
    edges = edges[np.unique(np.linspace(0, len(edges) - 1, GLANCE + 1).astype(np.int64))]
    if not _acts(load, edges):
        return None
    if reason := _unsolved(system, load):
        return reason
    motion = _turning(system, problem.velocity[0], unrefined(load, edges[:-1], edges[1:]))[-1]
    return _no_solution(MOVING) if motion is None else too_many(load, problem.output)


def cost(problem: Problem, states: int) -> Cost:
    """Return what `march` will take."""
    load, pieces = problem.load, 0
    if problem.system.axis is not None and load.terms and all(term.kind == "body" for term in load.terms):
        waves = halved_pieces(load, problem.t_start, problem.t_end)
        pieces = states + len(load.breakpoints) + int(min(waves, MOST))
    own = GYROSTAT_NS if load.rotors else 0
    return Cost(pieces, "pieces", (states * STATE_NS + pieces * PIECE_NS + own) * 1e-9, pieces * PIECE)


def _require_solution(status: int) -> None:
    if status == NOT_PRINCIPAL:
        raise ValueError(_no_solution(SUSLOV))
    if status == BAD_TIME:
        raise ValueError(TOO_FAR)
    if status != OK:
        raise ValueError(
            "exact does not support this body: its inertia is too close to the limit of the triangle inequality"
        )


def _no_solution(what: str) -> str:
    return f"exact has no closed-form solution for {what}; use the integrator gauss"


def _unsolved(system: DirectorSystem, load: Load) -> str | None:
    """Return why there is no closed-form solution for this body under this load, which acts."""
    if system.axis is None:
        return _no_solution("a standard body under load")
    if any(term.kind != "body" for term in load.terms):
        return _no_solution("a moment along fixed directions")
    return None


def _edges(load: Load, t_start: float, t_end: float) -> Array:
    return edges_of(load, np.array([t_start, t_end]))


def _acts(load: Load, edges: Array) -> bool:
    """Whether a term of `load` is not zero somewhere, seen at 16 points between any two `edges`."""
    if not load.terms:
        return False
    for first in range(0, len(edges) - 1, BLOCK):
        a, b = edges[first : first + BLOCK + 1][:-1, None], edges[first : first + BLOCK + 1][1:, None]
        at = ((b + a) / 2 + (b - a) / 2 * gauss()[0]).ravel()
        if load.sample(at, "body").any() or load.sample(at, "space").any():
            return True
    return False


def _turning(system: DirectorSystem, W: Array, pieces: Pieces) -> tuple[Array, Array, Pieces, Turning | None]:
    """Return a frame whose third row is the axis; in it the inertia, the pieces, and the rotation from W on."""
    assert system.axis is not None
    V = _frame(system.axis)
    J = V @ system.convected_inertia @ V.T
    pieces = pieces._replace(moment=pieces.moment @ V.T)
    return V, J, pieces, turning(J, J @ (V @ W), pieces)


def _loaded(problem: Problem) -> March:
    system, times = problem.system, problem.output
    if reason := _unsolved(system, problem.load):
        raise ValueError(reason)
    assert system.axis is not None
    R, W = attitudes(problem.quaternion[0]), problem.velocity[0]
    W = W - (system.axis @ W) * system.axis
    pieces = pieces_of(problem.load, np.unique(np.append(times, problem.t_start)))
    V, J, pieces, motion = _turning(system, W, pieces)
    if motion is None:
        raise ValueError(_no_solution(MOVING))
    at = np.searchsorted(np.append(pieces.a, pieces.b[-1]), times)
    q = turns(R, motion.axis @ V, motion.angle[at]).swapaxes(1, 2)
    v = director_velocities(q, np.outer(motion.rate[at], motion.axis @ V), None)
    return March(q, v, *_means(J, R @ V.T, pieces, motion, at, times), None)


def _gyrostat(problem: Problem) -> Outcome:
    """Return the motion of a standard body with rotors of constant momentum; they act with -(Λ c)'."""
    out, times = room(problem), problem.output
    place = int(times[0] == problem.t_start)
    c = problem.load.rotor_momentum(times[:1])[0]
    turn, W = gyrostat_motion(problem.system.convected_inertia, c, problem.velocity[0], times[place:] - problem.t_start)
    start = problem.quaternion
    p, velocity, _, _ = out.states
    p[0, place:], velocity[0, place:] = product(start, turn), W
    p[0] = without_jumps(np.concatenate([start, p[0]]))[1:]
    if not problem.intervals:
        return out
    n = len(times) - 1
    moment = -np.diff(attitudes(p[0]) @ c, axis=0) / np.diff(times)[:, None]
    none = np.zeros((1, n, 3))
    return out._replace(intervals=Intervals(np.zeros((1, n, 0)), moment[None], np.zeros((1, n)), None, none))


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
