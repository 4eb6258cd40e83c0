"""exact: the closed-form solutions as an integrator; no stepping, output at any times.

Free standard body, also with rotors of constant momentum: elliptic and theta functions. Free non-twisting body:
rotation about a fixed axis. Non-twisting body under a moment in its moving frame: the same, wherever the axis stays
fixed in the body, that is in particular once the load has ended. `nontwist.exact` derives the formulas. Director
velocities are tangent, ``d_i' = w × d_i``.

The multiplier of the non-twisting body is μ = π_⊥·d3' + m^ext·d3 = Π·(W × E3) + M_3, its mean over an interval the
integral over the length; so are the mean moment Λ M and the work M·W. A standard body has no multiplier here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..engine.body_frames import bases_of
from ..exact import nontwisting_body
from ..exact.free_bodies import TOO_FAR, free_members, rotations_about
from ..exact.free_constants import OK
from ..exact.gyrostats import gyrostat_motion
from ..geometry.arrays import Array, cross
from ..geometry.attitudes import States, attitudes, director_velocities, quaternion_product, without_jumps
from ..loads import Load
from ..loads.load import tables_as_moments
from ..models.stack import SystemStack, is_principal
from ..models.system import DirectorSystem
from .costs import Cost
from .integrator import Integrator
from .ivp import IVP, Intervals, March, Outcome, empty_outcome
from .stepping import PerThread, in_threads, one_by_one, outcome_of, progress

BLOCK = 4096  # members, or subintervals of a load
GLANCE = 128  # subintervals of a load that are enough for a refusal
STATE_NS, SUBINTERVAL_NS, SUBINTERVAL = 1_500, 50_000, 4_200  # of an output; of a subinterval, and its bytes: measured
GYROSTAT_NS = 1_500_000  # of the constants of a gyrostat
SUSLOV = "a Suslov body (for its velocity there is nontwist.exact.suslov_velocity)"
ROTORS = "a body with rotors or wheels, unless it is a standard one, their momentum is constant, and nothing else acts"
MOVING = "a load that moves the axis of rotation in the body"


@dataclass(frozen=True)
class Exact(Integrator):
    """Closed-form solutions: free bodies and gyrostats; the loaded non-twisting body that turns about one body axis.

    Raises
    ------
    ValueError
        Raised by a run without a closed-form solution; the message names a suitable integrator.

    Examples
    --------
    >>> from nontwist import simulate, standard
    >>> from nontwist.integrators import Exact
    >>> W = (0.1, 2, 0.1)
    >>> run = simulate(standard([3, 4, 5]), times=[0, 1, 1000], material_angular_velocity=W, integrator=Exact())
    >>> run.spatial_momentum.values.round(9)
    array([[0.3, 8. , 0.5],
           [0.3, 8. , 0.5],
           [0.3, 8. , 0.5]])
    """

    name: ClassVar[str] = "exact"
    any_times: ClassVar[bool] = True
    together: ClassVar[float] = 1.0

    def march(self, problem: IVP, threads: int = 1) -> Outcome:
        """Evaluate the solutions at the output times; under a load, one body after the other."""
        if (m := len(problem)) == 1:
            problem = problem.member(0)
        problem = with_tables_as_moments(problem)
        self.require(problem)
        systems, load, times = problem.systems, problem.load, problem.stored_times
        is_gyrostat = bool(load.rotor_momentum([problem.t_start]).any())
        if is_gyrostat or _acts(load, nontwisting_body.edges_of(load, np.array([problem.t_start, times[-1]]))):
            if m > 1:
                return one_by_one(self.march, problem, threads)
            return _gyrostat(problem) if is_gyrostat else outcome_of(problem, _loaded(problem))
        out, since = empty_outcome(problem), times - problem.t_start
        place = int(since[0] == 0.0)  # the start is there already
        since = since[place:].copy()

        def block(first: int, last: int) -> None:
            status, member, _ = free_members(*_bodies(systems), since, place, first, last, *out.states[:2])
            if status != OK:
                raise ValueError(f"member {member}: {TOO_FAR}" if m > 1 else TOO_FAR)

        in_threads(block, (0, m), BLOCK, threads, progress(problem))
        if not problem.intervals:
            return out
        return out._replace(intervals=free_intervals(systems, problem.velocity, len(times) - 1))

    def can_prepare(self, load: Load) -> bool:
        """Whether `prepared` supports problems under this load: free motion only."""
        return not load.terms

    def prepared(self, problem: IVP, work: float = inf) -> PreparedSolution:
        """Return the solution of the free motion of one body, prepared once for any start."""
        self.require(problem)
        return PreparedSolution(problem)

    def refusal(self, problem: IVP) -> str | None:
        """Return why there is no closed-form solution, as far as that is quick to decide."""
        systems, load = problem.systems, with_tables_as_moments(problem).load
        if load.rotors and not _is_gyrostat(problem):
            return _no_solution(ROTORS)
        if systems.spin is not None:
            return _no_solution("a prescribed spin")
        if systems.has_dead_force:
            return _no_solution("gravity and other dead forces")
        if systems.axis is not None and not (is_fine := is_principal(systems)).all():
            return f"member {int(is_fine.argmin())}: " * (len(problem) > 1) + _no_solution(SUSLOV)
        if load.rotors:
            return None
        if load.depends_on_state:
            return _no_solution("a load that depends on the state")
        if not load.terms or len(problem) > 1:
            return None
        edges = nontwisting_body.edges_of(load, np.array([problem.t_start, problem.t_end]))
        edges = edges[np.unique(np.linspace(0, len(edges) - 1, GLANCE + 1).astype(np.int64))]
        if not _acts(load, edges):
            return None
        if reason := _unsolved(systems[0], load):
            return reason
        motion = _in_axis_frame(
            systems[0], problem.velocity[0], nontwisting_body.unrefined(load, edges[:-1], edges[1:])
        )[-1]
        return _no_solution(MOVING) if motion is None else nontwisting_body.too_many(load, problem.stored_times)

    def cost(self, problem: IVP, states: int) -> Cost:
        """Return the estimated cost of `march`."""
        load, subintervals = with_tables_as_moments(problem).load, 0
        if problem.system.axis is not None and load.terms and all(term.kind == "body" for term in load.terms):
            waves = nontwisting_body.expected_subintervals(load, problem.t_start, problem.t_end)
            subintervals = states + len(load.breakpoints) + int(min(waves, nontwisting_body.MOST))
        own = GYROSTAT_NS if load.rotors else 0
        return Cost(
            subintervals,
            "subintervals",
            (states * STATE_NS + subintervals * SUBINTERVAL_NS + own) * 1e-9,
            subintervals * SUBINTERVAL,
        )


def with_tables_as_moments(problem: IVP) -> IVP:
    """Return a problem with the moments of tables of forces along the directors in their place."""
    return replace(problem, load=tables_as_moments(problem.load))


def _bodies(systems: SystemStack) -> tuple[Array, int]:
    """Return inertias, and whether there are constrained axes, as `free_members` takes them."""
    return systems.convected_inertia, int(systems.axis is not None)


class PreparedSolution:
    """The solution of a problem of one free body whose start is left open, from many threads."""

    def __init__(self, problem: IVP) -> None:
        self._systems, since = problem.systems, problem.stored_times - problem.t_start
        self._place, self._count = int(since[0] == 0.0), len(since)
        self._since = since[self._place :].copy()
        self._empty = np.full(7 * self._count, np.nan)
        self._threads = PerThread(self._workspace)

    def __call__(self, p: Any, W: Any, scale: float) -> tuple[Array, float, float]:
        """Evaluate the solution from the quaternion `p`, scalar last, and W; as `PreparedMarch`.

        There is no load, so no factor, and no step that a velocity could be too large for.
        """
        memory, start, solve = self._threads.own
        memory[:] = self._empty
        start[0][:], start[1][:] = p, W
        _, _, squares = solve()
        return memory.copy(), squares, 0.0

    def read(self, found: Array) -> dict[str, Any]:
        """Return the states of a run from the numbers found; its `_read` returns the rest."""
        p, W = self._states(found)
        return {"states": States(p, W), "memory": None, "_read": partial(self._means, W[:1])}

    def _means(self, W: Array) -> dict[str, Any]:
        return free_intervals(self._systems, W, self._count - 1).of_one

    def _states(self, found: Array) -> tuple[Array, Array]:
        """Return views of the quaternions and of W."""
        k = self._count
        return found[: 4 * k].reshape(k, 4), found[4 * k :].reshape(k, 3)

    def _workspace(self) -> tuple[Array, tuple[Array, Array], Callable[[], Any]]:
        """Return memory for one thread, where the start lies in it, and the kernel that works on it."""
        memory = self._empty.copy()
        p, W = self._states(memory)
        solve = free_members.bound(*_bodies(self._systems), self._since, self._place, 0, 1, p[None], W[None])
        return memory, (p[0], W[0]), solve


def free_intervals(systems: SystemStack, W: Array, n: int) -> Intervals:
    """Return the means over n intervals of free bodies: μ = n·(J W × W), and no moment."""
    m, mu = len(W), np.zeros((len(W), 0))
    if systems.axis is not None:
        JW = (systems.convected_inertia @ W[:, :, None])[:, :, 0]
        mu = np.sum(systems.axis * cross(JW, W), axis=1, keepdims=True)
    none = np.zeros((m, n, 3))
    return Intervals(np.repeat(mu[:, None], n, axis=1), none, np.zeros((m, n)), None, none)


def _is_gyrostat(problem: IVP) -> bool:
    """Whether standard bodies carry rotors of constant momentum, and nothing else acts."""
    load, t0, t1 = problem.load, problem.t_start, problem.t_end
    if problem.systems.axis is not None or problem.systems.has_dead_force or len(load.rotors) < len(load.terms):
        return False
    c = load.rotor_momentum([t0, t1, *(t for t in load.breakpoints if t0 < t < t1)])
    return bool((c == c[0]).all())


def _no_solution(what: str) -> str:
    return f"exact has no closed-form solution for {what}; use the integrator gauss"


def _unsolved(system: DirectorSystem, load: Load) -> str | None:
    """Return why there is no closed-form solution for this body under this load, which acts."""
    if system.axis is None:
        return _no_solution("a standard body under load")
    if any(term.kind != "body" for term in load.terms):
        return _no_solution("a moment along fixed directions")
    return None


def _acts(load: Load, edges: Array) -> bool:
    """Whether a term of `load` is not zero somewhere, seen at 16 points between any two `edges`."""
    if not load.terms:
        return False
    for first in range(0, len(edges) - 1, BLOCK):
        a, b = edges[first : first + BLOCK + 1][:-1, None], edges[first : first + BLOCK + 1][1:, None]
        at = ((b + a) / 2 + (b - a) / 2 * nontwisting_body.gauss()[0]).ravel()
        if load.sample(at, "body").any() or load.sample(at, "space").any():
            return True
    return False


def _in_axis_frame(
    system: DirectorSystem, W: Array, subintervals: nontwisting_body.Subintervals
) -> tuple[Array, Array, nontwisting_body.Subintervals, nontwisting_body.AxialRotation | None]:
    """Return a frame whose third row is the axis; in it the inertia, the subintervals, and the rotation from W on."""
    assert system.axis is not None
    V = bases_of(system.axis[None])[0].T
    J = V @ system.convected_inertia @ V.T
    subintervals = subintervals._replace(moment=subintervals.moment @ V.T)
    return V, J, subintervals, nontwisting_body.axial_rotation(J, J @ (V @ W), subintervals)


def _loaded(problem: IVP) -> March:
    system, times = problem.system, problem.stored_times
    if reason := _unsolved(system, problem.load):
        raise ValueError(reason)
    assert system.axis is not None
    R, W = attitudes(problem.quaternion[0]), problem.velocity[0]
    W = W - (system.axis @ W) * system.axis
    subintervals = nontwisting_body.subintervals_of(problem.load, np.unique(np.append(times, problem.t_start)))
    V, J, subintervals, motion = _in_axis_frame(system, W, subintervals)
    if motion is None:
        raise ValueError(_no_solution(MOVING))
    at = np.searchsorted(np.append(subintervals.a, subintervals.b[-1]), times)
    q = rotations_about(R, motion.axis @ V, motion.angle[at]).swapaxes(1, 2)
    v = director_velocities(q, np.outer(motion.rate[at], motion.axis @ V), None)
    return March(q, v, *_means(J, R @ V.T, subintervals, motion, at, times), None)


def _gyrostat(problem: IVP) -> Outcome:
    """Return the motion of a standard body with rotors of constant momentum; they act with -(Λ c)'."""
    out, times = empty_outcome(problem), problem.stored_times
    place = int(times[0] == problem.t_start)
    c = problem.load.rotor_momentum(times[:1])[0]
    turn, W = gyrostat_motion(problem.system.convected_inertia, c, problem.velocity[0], times[place:] - problem.t_start)
    start = problem.quaternion
    p, velocity, *_ = out.states
    p[0, place:], velocity[0, place:] = quaternion_product(start, turn), W
    p[0] = without_jumps(np.concatenate([start, p[0]]))[1:]
    if not problem.intervals:
        return out
    n = len(times) - 1
    moment = -np.diff(attitudes(p[0]) @ c, axis=0) / np.diff(times)[:, None]
    none = np.zeros((1, n, 3))
    return out._replace(intervals=Intervals(np.zeros((1, n, 0)), moment[None], np.zeros((1, n)), None, none))


def _means(
    J: Array,
    R: Array,
    subintervals: nontwisting_body.Subintervals,
    motion: nontwisting_body.AxialRotation,
    at: NDArray[np.intp],
    times: Array,
) -> tuple[Array, Array, Array]:
    """Return the means of μ and of the spatial moment and the work, between the output times."""
    half, weights = (subintervals.b - subintervals.a) / 2, nontwisting_body.gauss()[1]
    shape = motion.angle_inside.shape
    inside = rotations_about(R, motion.axis, motion.angle_inside.ravel()).reshape(*shape, 3, 3)
    m = np.einsum("pnab,pnb->pna", inside, subintervals.moment)
    mu = motion.rate_inside**2 * np.cross(J @ motion.axis, motion.axis)[2] + subintervals.moment[..., 2]
    power = motion.rate_inside * (subintervals.moment @ motion.axis)
    values = np.concatenate([mu[..., None], m, power[..., None]], axis=2)
    sums = half[:, None] * np.einsum("n,pnc->pc", weights, values)
    total = np.concatenate([np.zeros((1, 5)), np.cumsum(sums, axis=0)])
    between = np.diff(total[at], axis=0)
    length = np.diff(times)[:, None]
    return between[:, :1] / length, between[:, 1:4] / length, between[:, 4]
