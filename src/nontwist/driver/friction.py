"""Dry friction: a run is taken apart where a rate vanishes, or where what holds it at zero exceeds its limit.

With M the moments of all else and C the moments ``λ_k a_k`` of friction, limits c_k, and a constrained axis n,

    J W' + W × J W = M - Σ λ_k a_k - μ n,        λ_k in c_k Sgn(a_k·W),        n·W = 0,

Sgn(r) = {sign r}, and [-1, 1] at r = 0; without an axis λ a is in c Sgn(W), the unit ball at W = 0. The law is the
subdifferential of Σ c_k |a_k·W|, or c |W|, a convex function: it is maximal monotone, and J is positive, so from each
state there is one motion (Brezis 1973; there is no paradox of Painlevé, whose normal force depends on W'). While modes
stay it is smooth:

- sliding, a·W of one sign σ: the constant moment -σ c a along the frame. Steps keep their balance of work, so friction
  takes c |a·W| as long as a·W has the sign at the stages;
- sticking, a·W = 0: a constraint, and the body that has it is the Suslov body of axis a, whose μ is λ. It slides on as
  soon as |λ| exceeds c;
- resting, W = 0 exactly and Λ constant, if nothing accelerates the body. Without an axis sticking is always rest; rest
  ends where the moment that is needed, M across n, exceeds c.

Modes. Where rates are zero, W' decides: it minimises ½ W'·J W' - M·W' + Σ c_k |a_k·W'| over those contacts, which is
strictly convex. Its conditions, |λ_k| <= c_k where a_k·W' = 0 and λ_k = c_k sign(a_k·W') elsewhere, are tried for each
combination. Without an axis, W' = α u with |u| = 1 and α > 0 has ``(α J + c) u = M`` across n, whose |u| falls with α.

The modes of a contact change at the root of a function of the state, found as events are (`events`): of σ a·W while it
slides, of c ± λ while it sticks. The step ends there, a·W is set to 0 by an impulse along a, which takes energy, of the
size of round-off, and the rest of the step follows in the new modes. As of events, two changes of sign between two of
the times at which functions are evaluated are missed.

Without an axis the moment has no limit as W → 0 but along a line, which is so in plane motion: there the direction u of
W is that of an axis. Otherwise W turns faster and faster as it vanishes, in the time s/|W'| or so, s = |W|, along a
principal direction in the end. Then steps are at most a quarter of this time, W falls by a part in each, and vanishes
where that time is 1e-12 of a step. Where a body starts, friction pulls W at the rate c/(J s) to the direction of the W'
above: for 1e-5 h, or 1e-3 h where W' is 0 at first, it is taken to be there, W the integral of this W'. (In a shorter
time the latter would be lost in round-off.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array, cross
from ..geometry.attitudes import States, attitudes, directors
from ..integrators.base import Failure, Integrator, Outcome, Problem, Status
from ..integrators.members import one_by_one
from ..integrators.problem import Intervals, onward, scratch, started
from ..loads import Load, moment
from ..loads.base import moment_at
from ..loads.friction import ROUND_OFF
from ..loads.potentials import GravityGradient
from ..loads.terms import Damping, Table
from ..models.stack import stacked
from ..models.system import DirectorSystem
from . import completion, event_runs
from .events import RTOL, XTOL, Event
from .starts import body_state

EPS = float(np.finfo(np.float64).eps)
TINY = float(np.finfo(np.float64).tiny)
STILL = 1e-12  # of what moments accelerate a body by: nothing
CLOSE, ULPS = 1e-11, 64  # of a step, and units in the last place of a time: what lies nearer to a node is at it
STEPS, PLANE = 4096, 256  # that are marched before modes are looked at again, in all and in plane motion
QUARTER = 0.5  # of the time in which W may vanish
BEGIN, SLOWLY, TICKS = 1e-5, 1e-3, 4096  # of a step, or units in the last place of a time: a start, a slow one
SLOW = 1e-6  # of what moments accelerate a body by: a start where the moment just exceeds the limit
IN_PLANE = 1e-11  # of the largest |W|: velocities along a line
MOST = 50  # changes of modes at one time
SCHEMES = "dry_friction needs an integrator that splits its steps, gauss or lie-midpoint; {} does not"
SPIN = "dry_friction does not act on a body whose spin is prescribed; leave spin= out"
ALONG = "dry_friction about the constrained axis does nothing, as the body does not turn about it; leave it out"
HELD = (
    "dry friction sticks and leaves the body one axis to turn about, which is not supported; "
    "choose a body without a constrained axis and one dry_friction, or dry_friction without an axis"
)
DISSIPATION = "dry_friction sticks by a constraint, under which dissipation= is not possible; leave it out"
RESTLESS = "dry friction changes between sticking and sliding without end"
Modes = dict[int, int]  # of each contact: the sign of its rate while it slides, 0 while it sticks


class Change(NamedTuple):
    """What ends a mode: a function that falls to zero; how its contact slides then, 0: its rate is zero."""

    contact: int
    sign: int
    value: Callable[[float, Any], float]


class Piece(NamedTuple):
    """A part of a run in which modes stay: times with its start and end, states there, means in between."""

    times: Array
    states: States
    means: Intervals | None


def refusal(scheme: Integrator, problem: Problem) -> str | None:
    """Return why a problem is not accepted, for its dry friction or for the integrator's reasons; None if it is."""
    if not (own := problem.load.frictions):
        return scheme.refusal(problem)
    if not scheme.splits_steps:
        return SCHEMES.format(scheme.name)
    systems = problem.systems
    if systems.spin is not None:
        return SPIN
    if getattr(scheme, "dissipation", 0.0):
        return DISSIPATION
    if systems.axis is not None:
        across = [abs(np.cross(term.axis, systems.axis)).max(axis=1).min() for term in own if term.axis is not None]
        if min(across, default=1.0) <= STILL:
            return ALONG
    return scheme.refusal(problem)


def march(scheme: Integrator, problem: Problem, threads: int = 1) -> Outcome:
    """Integrate a stack of bodies under dry friction, one after the other.

    Raises
    ------
    ValueError
        What `refusal` returns; statistics over steps are asked for; as the integrator.
    """
    if (reason := refusal(scheme, problem)) is not None:
        raise ValueError(reason)
    if problem.observed:
        raise ValueError("reduce= does not support dry_friction; leave it out, and store states")
    return one_by_one(lambda one: Rubbed(scheme, one).march(), problem, threads)


class Rubbed:
    """A body under dry friction, from the start of a problem of one to its end.

    Attributes
    ----------
    limits, axes : of each contact c, N m, and a; without an axis there is one, and a is 0
    modes : dict
    direction : (3,) array
        Without an axis, that of W in plane motion.
    """

    def __init__(self, scheme: Integrator, problem: Problem) -> None:
        self.scheme, self.problem, self.body = scheme, problem, problem.system
        own, self.load = problem.load.frictions, problem.load.without_frictions
        self.limits = [term.limit for term in own]
        self.axes: list[Array] = [np.zeros(3) if term.axis is None else term.axis for term in own]
        self.is_central = own[0].axis is None  # then there is one
        self.J, n = self.body.convected_inertia, self.body.axis
        self.inverse, self.axis = np.linalg.inv(self.J), np.empty((0, 3)) if n is None else n[None]
        self.t, self.state = problem.t_start, States(problem.quaternion[0].copy(), problem.velocity[0].copy())
        self.modes, self.pieces = Modes(), list[Piece]()
        self.direction: Array = np.zeros(3)  # of W in plane motion, without an axis
        self.is_plane = True
        self.failure: Failure | None = None
        self._gains = dict[tuple[int, ...], tuple[Array, Array]]()
        self.nodes = problem.times(np.arange(problem.steps + 1))
        self.is_alone = all(term in self.load.potentials for term in self.load.terms)

    # ---- what accelerates the body

    def torque(self, t: float, q: Array, W: Array) -> Array:
        """Return M + J W × W without friction."""
        return torque(self.body, self.load, t, q, W)

    def acceleration(self, M: Array, held: Sequence[int] = ()) -> tuple[Array, Array]:
        """Return W' under M, and the moments λ and μ that hold contacts and the constrained axis."""
        B, gain = self._held(tuple(held))
        lam = gain @ (self.inverse @ M)
        return self.inverse @ (M - lam @ B), lam

    def _held(self, contacts: tuple[int, ...]) -> tuple[Array, Array]:
        """Return the axes that are held, rows of B, and the least solution ``(B J⁻¹ Bᵀ)⁺ B``."""
        if contacts not in self._gains:
            B = np.concatenate([np.reshape([self.axes[k] for k in contacts], (-1, 3)), self.axis])
            self._gains[contacts] = B, np.linalg.pinv(B @ self.inverse @ B.T) @ B
        return self._gains[contacts]

    def sliding(self, modes: Modes) -> Array:
        """Return the moment of the contacts that slide, along the frame."""
        if self.is_central:
            return -self.limits[0] * modes[0] * self.direction
        return sum((-self.limits[k] * sign * self.axes[k] for k, sign in modes.items() if sign), np.zeros(3))

    def _constant(self, M: Array) -> Load:
        """Return a moment along the frame that stays."""
        t = self.problem.t_start, self.problem.t_end
        apart = 1.0 + t[1] - t[0]
        return Table("body", np.array([t[0] - apart, t[1] + apart]), np.array([M, M])).load

    # ---- modes

    def settle(self, zero: Sequence[int], forced: Modes) -> None:
        """Choose the modes of contacts whose rates are zero; those that are `forced` slide."""
        q, W = directors(self.state.quaternion), self.state.velocity
        if self.is_central:
            W[:] = 0.0
            self.modes, self.is_plane = {0: 0}, True
            M = self._across(self.torque(self.t, q, W))
            if np.linalg.norm(M) > self.limits[0] or forced:
                start = self._rate_at_rest()
                u = start if start.any() else M
                self.modes, self.direction = {0: 1}, u / np.linalg.norm(u)
            return
        B, gain = self._held(tuple(zero))
        W -= self.inverse @ (B.T @ (gain @ W))
        if abs(W).max() <= TINY:
            W[:] = 0.0
        M, free = self.torque(self.t, q, W), [k for k in zero if k not in forced]
        for signs in product((0, 1, -1), repeat=len(free)):
            modes = self.modes | forced | dict(zip(free, signs, strict=True))
            held = [k for k in free if not modes[k]]
            rate, lam = self.acceleration(M + self.sliding(modes), held)
            holds = all(abs(x) <= self.limits[k] for k, x in zip(held, lam, strict=False))
            if holds and all(modes[k] * (self.axes[k] @ rate) > 0 for k in free if modes[k]):
                self.modes = modes
                return
        self.modes |= forced | dict.fromkeys(free, 0)  # at a limit, to round-off

    def _across(self, M: Array) -> Array:
        return M - (self.axis @ M) @ self.axis

    def _rate_at_rest(self) -> Array:
        """Return W' at W = 0, against friction without an axis: 0 up to its limit."""
        from scipy.optimize import brentq

        M = self._across(self.torque(self.t, directors(self.state.quaternion), np.zeros(3)))
        basis = np.linalg.svd(np.concatenate([self.axis, np.zeros((1, 3))]))[2][len(self.axis) :]
        J, m, c = basis @ self.J @ basis.T, basis @ M, self.limits[0]
        if not c:
            rate: Array = np.linalg.solve(J, m) @ basis
            return rate
        if np.linalg.norm(m) <= c:
            return np.zeros(3)

        def along(alpha: float) -> Array:
            u: Array = np.linalg.solve(alpha * J + c * np.eye(len(J)), m)
            return u

        most = float(np.linalg.norm(m) / np.linalg.eigvalsh(J)[0])
        alpha = float(brentq(lambda x: float(np.linalg.norm(along(x))) - 1.0, 0.0, most, xtol=EPS * most))
        found: Array = alpha * along(alpha) @ basis
        return found

    # ---- from mode to mode

    def march(self) -> Outcome:
        """March to the end, or to a failure."""
        W, end, last, count = self.state.velocity, self.problem.t_end, self.t, 0
        size = float(np.linalg.norm(W))
        rates = [size] if self.is_central else [float(a @ W) for a in self.axes]
        self.modes = {k: 1 if rate > 0 else -1 for k, rate in enumerate(rates) if abs(rate) > ROUND_OFF * size}
        if self.is_central and size:
            self.direction = W / size
        zero = [k for k in range(len(rates)) if k not in self.modes]
        if zero:
            self.settle(zero, {})
        while self.t < end and self.failure is None:
            self._phase()
            count, last = (0, self.t) if self.t > last else (count + 1, last)
            if count > MOST:
                self.failure = Failure(Status.LOAD, self._number(), np.nan, np.nan, RESTLESS)
            if self.problem.progress:
                self.problem.progress((self.t - self.problem.t_start) / (end - self.problem.t_start))
        return self._outcome()

    def _phase(self) -> None:
        """March while modes stay, to a node at most."""
        stuck = [k for k, sign in self.modes.items() if not sign]
        if stuck and not self.state.velocity.any() and self._rest(stuck):
            return
        if self.is_central:
            self.is_plane = self.is_plane and self._slide_in_plane()
            if not self.is_plane:
                self._slide_around()
            return
        system = self.body
        if stuck:
            if np.linalg.matrix_rank(self._held(tuple(stuck))[0]) > 1:
                self.failure = Failure(Status.LOAD, self._number(), np.nan, np.nan, HELD)
                return
            system = DirectorSystem(self.body.euler_inertia, self.axes[stuck[0]], self.body.dead_force)
        changes = [change for k in self.modes for change in self._changes(k, stuck)]
        load = self.load + self._constant(self.sliding(self.modes))
        piece, root = self._marched(replace(self._until(STEPS), systems=stacked(system), load=load), changes)
        self._keep(piece if system is self.body else self._as_held(piece))
        if root is not None:
            zero = [*stuck] if root.sign else [*stuck, root.contact]
            self.modes = {k: sign for k, sign in self.modes.items() if k not in (*zero, root.contact)}
            self.settle(zero, {root.contact: root.sign} if root.sign else {})

    def _changes(self, k: int, stuck: list[int]) -> list[Change]:
        """Return what can end the mode of a contact: a rate that vanishes, or what holds it reaching its limit."""
        sign, a, c = self.modes[k], self.axes[k], self.limits[k]
        if sign:
            x, y, z = (sign * a).tolist()
            return [Change(k, 0, lambda t, s: _along(x, y, z, s.material_angular_velocity))]
        place, sliding, known = stuck.index(k), self.sliding(self.modes), dict[Any, float]()

        def held(t: float, s: Any) -> float:
            if s._numbers not in known:  # both functions ask for it
                M = self.torque(t, s.directors, np.array(s.material_angular_velocity)) + sliding
                known[s._numbers] = float(self.acceleration(M, stuck)[1][place])
            return known[s._numbers]

        return [Change(k, 1, lambda t, s: c - held(t, s)), Change(k, -1, lambda t, s: c + held(t, s))]

    # ---- without an axis

    def _slide_in_plane(self) -> bool:
        """March under a moment of constant direction in the body; return whether W kept to it: else nothing is kept."""
        x, y, z = self.direction.tolist()
        change = Change(0, 0, lambda t, s: _along(x, y, z, s.material_angular_velocity))
        one = self._until(PLANE)
        load = self.load + self._constant(self.sliding(self.modes))
        piece, root = self._marched(replace(one, load=load), [change], at_nodes=True)
        W = piece.states.velocity
        if self.failure is not None or abs(np.cross(W, self.direction)).max() > IN_PLANE * abs(W).max():
            self.failure = None
            return False
        self._keep(piece)
        if root is not None:
            self.settle([0], {})
        return True

    def _slide_around(self) -> None:
        """March while W may turn, or, where it may vanish within four steps, a part of that time."""
        one, c, W = self._until(STEPS), self.limits[0], self.state.velocity
        h, load = one.grid.longest, self.load + against(c)
        if not W.any():
            self._start(h)
            return

        def time_left(t: float, s: Any) -> float:
            w = np.array(s.material_angular_velocity)
            size = np.linalg.norm(w)
            rate = self.acceleration(self.torque(t, s.directors, w) - c * w / size)[0]
            return float(QUARTER * size / np.linalg.norm(rate)) if rate.any() else np.inf

        left = time_left(self.t, body_state(self.t, *(x.tolist() for x in self.state[:2])))
        if left > h:
            change = Change(0, 0, lambda t, s: min(time_left(t, s), 2 * h) - h)
            self._keep(self._marched(replace(one, load=load), [change])[0])
            return
        if left > QUARTER * max(XTOL * h, ULPS * np.spacing(abs(self.t))):
            node = float(self.nodes[self._number() + 1])
            to = node if node - self.t <= left else self.t + left
            self._keep(self._marched(replace(self._to(to), load=load), [])[0])
            return
        self.direction = W / np.linalg.norm(W)
        self.settle([0], {})

    def _start(self, h: float) -> None:
        """Let the body start to turn, for a short time, to the velocity that it has under the friction along it."""
        begin, node = self.t, float(self.nodes[self._number() + 1])
        a = self._rate_at_rest()
        M = self.torque(begin, directors(self.state.quaternion), np.zeros(3))
        is_slow = np.linalg.norm(a) <= SLOW * np.linalg.norm(self.inverse @ M)
        to = min(begin + max((SLOWLY if is_slow else BEGIN) * h, TICKS * float(np.spacing(abs(begin)))), node)
        self._keep(
            self._marched(replace(self._to(to), load=self.load + self._constant(self.sliding(self.modes))), [])[0]
        )
        b = self._rate_at_rest()
        self.state.velocity[:] = (to - begin) / 2 * (a + b)
        if not self.state.velocity.any():
            self.settle([0], {})

    # ---- at rest

    def _rest(self, stuck: list[int]) -> bool:
        """Let the body rest, up to the node after which it does not, or to where it starts; return whether it rests."""
        one, q, still = self._until(STEPS), directors(self.state.quaternion), np.zeros(3)

        def needed(t: float) -> tuple[float, bool, float]:
            """Return what is left to the limits, whether nothing accelerates the body, and μ."""
            M = self.torque(t, q, still)
            if self.is_central:
                return self.limits[0] - float(np.linalg.norm(self._across(M))), True, float((self.axis @ M).sum())
            rate, lam = self.acceleration(M, stuck)
            left = min(self.limits[k] - abs(x) for k, x in zip(stuck, lam, strict=False))
            is_still = bool(abs(rate).max() <= STILL * abs(self.inverse @ M).max())
            return float(left), is_still, float(lam[len(stuck) :].sum())

        nodes, fails = one.times(np.arange(one.steps + 1)), None
        for k, t in enumerate(nodes.tolist() if self._varies() else nodes[:1].tolist()):
            left, is_still, _ = needed(t)
            if not is_still or (k and left < 0):
                fails = k, is_still
                break
        if fails is not None and (fails[0] == 0 or fails == (1, False)):
            return False
        to, is_root = float(nodes[-1]), False
        if fails is not None:
            to, is_root = float(nodes[fails[0] - 1]), fails[0] == 1
        if is_root:
            from scipy.optimize import brentq

            begin, end = float(nodes[0]), float(nodes[1])
            to = begin
            if needed(begin)[0] > 0:
                to = float(brentq(lambda t: needed(t)[0], begin, end, xtol=XTOL * (end - begin), rtol=RTOL))
            to = self._at_node(to)
        if to > self.t:
            body = DirectorSystem(self.body.euler_inertia, self.body.axis)
            span = self._to(to) if is_root else onward(self.problem, self._number(), self._number(to), self.state)
            piece, _ = self._marched(replace(span, systems=stacked(body), load=Load()), [], at_nodes=True)
            self._keep(self._at_rest(piece, q, lambda t: needed(t)[2]))
        if is_root:
            M = self.torque(self.t, q, still)
            lam = np.zeros(1) if self.is_central else self.acceleration(M, stuck)[1]
            worst = int(np.argmin([self.limits[k] - abs(x) for k, x in zip(stuck, lam, strict=False)]))
            first, self.modes = stuck[worst], {k: sign for k, sign in self.modes.items() if sign}
            self.settle([k for k in stuck if k != first], {first: -1 if lam[worst] < 0 else 1})
        return True

    def _varies(self) -> bool:
        """Whether the moments on a body at rest may change with time."""
        kept = [term for term in self.load.potentials if not isinstance(term, GravityGradient)]
        return any(not isinstance(term, Damping) and term not in kept for term in self.load.terms)

    def _at_rest(self, piece: Piece, q: Array, mu: Callable[[float], float]) -> Piece:
        """Return a part of a run in which a body without load rests as that of this one: friction carries all but μ."""
        times, none = piece.times, piece.means
        assert none is not None
        p, count = self.state.quaternion, len(times)
        middles, dead = (times[1:] + times[:-1]) / 2, cross(q, self.body.dead_force).sum(axis=0)
        held, is_linear = [], True
        for t in middles.tolist():
            held.append(sum((term.scale * term.moment_at(t, q, np.zeros(3)) for term in self.load.potentials), dead))
        is_linear = all(term.dead_force is not None for term in self.load.potentials)
        given, multipliers = np.array(held).reshape(1, -1, 3), none.multipliers
        moment_of, dead_moment = -given, None if len(self.axis) and not is_linear else np.zeros(given.shape)
        if len(self.axis):
            rates = np.array([mu(t) for t in middles.tolist()])
            multipliers = rates[None, :, None] * np.ones_like(multipliers)
            moment_of = moment_of + rates[None, :, None] * (self.axis[0] @ q)
            dead_moment = given if is_linear else None
        means = none._replace(multipliers=multipliers, moment=moment_of, dead_moment=dead_moment)
        return Piece(times, States(np.tile(p, (count, 1)), np.zeros((count, 3))), means)

    # ---- pieces

    def _number(self, t: float | None = None) -> int:
        """Return the number of the step at whose beginning, or in which, a time is, by default that of the march."""
        return int(np.searchsorted(self.nodes, self.t if t is None else t, side="right")) - 1

    def _until(self, most: int) -> Problem:
        """Return the problem from here to the next node, from a node over `most` steps; friction is left out."""
        k = self._number()
        if self.t > self.nodes[k]:
            return self._to(float(self.nodes[k + 1]))
        one = onward(self.problem, k, min(k + most, self.problem.steps), self.state)
        return replace(one, load=self.load)

    def _to(self, t: float) -> Problem:
        """Return the problem of one step from here to a time."""
        grid: dict[str, Any] = {"steps": 1, "stored": np.array([0, 1]), "stretches": None, "progress": None}
        return replace(self.problem, t_start=self.t, t_end=t, asked=None, load=self.load, **grid, **started(self.state))

    def _at_node(self, t: float) -> float:
        """Return a time, or that of the node that it nearly is."""
        k = min(self._number(t) + 1, self.problem.steps)
        node = float(self.nodes[k])
        return node if node - t <= max(CLOSE * (node - self.nodes[k - 1]), ULPS * np.spacing(abs(node))) else t

    def _marched(self, one: Problem, changes: Sequence[Change], at_nodes: bool = False) -> tuple[Piece, Change | None]:
        """March a problem without friction to its end or to the first change, and move there."""
        known = self.problem.output
        inner = known[(known > one.t_start) & (known < one.t_end)]
        ends = one.times(np.arange(one.steps + 1) if at_nodes or not self.is_alone else np.array([0, one.steps]))
        asked = np.union1d(inner, ends) if changes or inner.size or one.steps > 1 else None
        one = replace(one, asked=asked, intervals=True)
        numbers = list[int]()
        if changes:
            begin = one.t_start
            events = tuple(Event(_positive(each.value, begin), "friction", 1, -1.0) for each in changes)
            times, outcome, found, message = event_runs.march(self.scheme, one, events)
            numbers = found.number[-1:].tolist() if message else []
        else:
            times, outcome = one.output, completion.march(self.scheme, one)
        n, failure = int(outcome.good[0]), outcome.failure()
        if failure is not None:
            self.failure = failure._replace(step=failure.step + self._number())
        states = States(outcome.states.quaternion[0, :n].copy(), outcome.states.velocity[0, :n].copy())
        means = outcome.intervals
        if means is not None:
            cut: Any = (None if x is None else x[:, : max(n - 1, 0)] for x in means)
            means = Intervals(*cut)
        times = times[:n].copy()
        if numbers and n:
            times[-1] = self._at_node(float(times[-1]))
        return Piece(times, states, means), changes[numbers[0]] if numbers else None

    def _keep(self, piece: Piece) -> None:
        """Add a part to the run, and what friction takes in it; move to its end."""
        if len(piece.times) > 1:
            assert piece.means is not None
            means = piece.means._replace(dissipated_energy=self._dissipated(piece))
            if not (self.is_central or len(self.axis)):
                means = means._replace(twist=None)
            self.pieces.append(piece._replace(means=means))
        if len(piece.times):
            self.t = float(piece.times[-1])
            self.state = States(piece.states.quaternion[-1].copy(), piece.states.velocity[-1].copy())

    def _as_held(self, piece: Piece) -> Piece:
        """Return a part in which a body without constraint sticks as the one that it then is as its own.

        The mean moment of the constraint is that of friction: what the impulse leaves, or, where potentials act whose
        moment is not summed, -μ along the axis in the middle of the interval.
        """
        if piece.means is None or len(piece.times) < 2:
            return piece
        times, (p, W, *_), own = piece.times, piece.states, piece.means
        length = np.diff(times)[:, None]
        if own.dead_moment is not None:
            momentum = np.einsum("nij,nj->ni", attitudes(p), W @ self.J)
            friction = np.diff(momentum, axis=0) / length - own.moment[0] - own.dead_moment[0]
        else:
            a = next(self.axes[k] for k, sign in self.modes.items() if not sign)
            friction = -own.multipliers[0] * (attitudes(p[1:] + p[:-1]) @ a)
        none = np.zeros((1, len(length), 3))
        return piece._replace(
            means=own._replace(multipliers=none[:, :, :0], moment=own.moment + friction, dead_moment=none)
        )

    def _dissipated(self, piece: Piece) -> Array:
        """Return the energy that friction takes in each interval of a part: its work where no other load has any.

        Otherwise the power is integrated, by a cubic polynomial through its values and derivatives.
        """
        times, states, means = piece
        assert means is not None
        if self.is_alone:
            return -means.load_work
        if not any(self.modes.values()):
            return np.zeros(means.load_work.shape)
        power, rate = np.zeros((2, len(times)))
        held = [k for k, sign in self.modes.items() if not sign]
        for i, (t, p, W) in enumerate(zip(times.tolist(), *states[:2], strict=True)):
            if self.is_central and not self.is_plane and W.any():
                self.direction = W / np.linalg.norm(W)
            along = self.sliding(self.modes)
            power[i] = -along @ W
            rate[i] = -along @ self.acceleration(self.torque(t, directors(p), W) + along, held)[0]
        h = np.diff(times)
        found: Array = (h / 2 * (power[1:] + power[:-1]) + h**2 / 12 * (rate[:-1] - rate[1:]))[None]
        return found

    def _outcome(self) -> Outcome:
        """Return the outcome at the times that are asked for: intervals are sums of parts."""
        known, output, failure = self.pieces, self.problem.output, self.failure
        begin = States(self.problem.quaternion, self.problem.velocity)
        times = np.concatenate([[self.problem.t_start], *(piece.times[1:] for piece in known)])
        p, W = (
            np.concatenate([first, *(piece.states[i][1:] for piece in known)])  # type: ignore[index]
            for i, first in enumerate(begin[:2])
        )
        count = int(np.searchsorted(output, times[-1], side="right"))
        places = np.searchsorted(times, output[:count], side="right") - 1
        failures = np.zeros((1, 4)) if failure is None else np.array([failure[:4]], dtype=np.float64)
        reasons: dict[int, str] = {} if failure is None else {0: failure.reason}
        states = scratch(self.problem).states
        states.quaternion[0, :count], states.velocity[0, :count] = p[places], W[places]
        found = Outcome(states, np.array([count]), failures, reasons)
        return found._replace(intervals=self._means(places)) if self.problem.intervals and known else found

    def _means(self, places: NDArray[np.int64]) -> Intervals:
        """Return the means over the intervals between the times of these numbers, of all; NaN beyond the last."""
        parts = [piece.means for piece in self.pieces if piece.means is not None]
        integrals = np.concatenate(
            [part.integrals(np.diff(piece.times))[0] for part, piece in zip(parts, self.pieces, strict=True)]
        )
        n, missing = max(len(places) - 1, 0), len(self.problem.output) - 1
        sums = np.zeros((missing, integrals.shape[1]))
        lengths = np.ones(missing)
        lengths[:n] = np.diff(self.problem.output[: len(places)])
        most = np.zeros((1, missing), dtype=np.int64)
        used = [part.newton_iterations for part in parts]
        for k, (a, b) in enumerate(pairwise(places.tolist())):
            sums[k] = integrals[a:b].sum(axis=0)
        counts = None if any(x is None for x in used) else np.concatenate([x[0] for x in used if x is not None])
        if counts is not None:
            most[0, :n] = [counts[a:b].max() for a, b in pairwise(places.tolist())]
        return parts[0].of_integrals(sums[None], lengths, None if counts is None else most)


def torque(body: DirectorSystem, load: Load, t: float, q: Array, W: Array) -> Array:
    """Return J W' of a body without constraint under a load: M + J W × W; q: directors as rows."""
    m = moment_at(load, t, q, W @ q) + cross(q, body.dead_force).sum(axis=0)
    found: Array = q @ m + cross(body.convected_inertia @ W, W)
    return found


def _along(x: float, y: float, z: float, W: tuple[float, float, float]) -> float:
    return x * W[0] + y * W[1] + z * W[2]


def _positive(value: Callable[[float, Any], float], start: float) -> Callable[[float, Any], float]:
    """Return a function that is positive where a mode begins: it may vanish there."""
    return lambda t, state: value(t, state) if t > start else max(value(t, state), TINY)


@lru_cache(maxsize=64)
def against(limit: float) -> Load:
    """Return the moment -limit w/|w|, of which nobody asks at w = 0."""

    def friction(t: float, directors: Array, w: Array) -> Any:
        return -limit * w / np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])

    return moment(friction, compiled=True)
