"""How a body under dry friction, and wheels in their bearings, slide, stick, rest and start (`contacts`).

- Sliding, the moment -σ c a along the frame is constant. Steps keep their balance of work, so friction takes c |a·W| as
  long as a·W has the sign at the stages.
- Sticking, the body is the Suslov body of axis a, whose μ is λ.
- Sticking so that one axis d is left to turn about, it turns about this one alone, ``d·J d ω' = d·M``, and d stays in
  space (`HingedSystem`). What holds it follows from its momentum.
- Resting, W = 0 exactly and Λ constant, if nothing accelerates the body. Wheels then turn as if nothing carried them.

In thick oil a body slides on to the attitude where M is c, ever more slowly, r' = -κ r, and never stops. Where r' is no
more than the round-off of the moments, and r than what this adds to it in the part `SOON` of a step, it is taken to
stick: the angle that is left, r/κ, is round-off as well. (The times |r/r'| of such r' would be steps without end.)

Against w there is one contact, whose λ a is in c Sgn(W), the unit ball at W = 0; sticking is always rest. It ends where
the moment that is needed, K across n, exceeds c. Where W = 0 the body starts with W' = α u, |u| = 1 and α > 0, ``(α J +
c) u = K`` across n, whose |u| falls with α. The moment has no limit as W → 0 but along a line, which is so in plane
motion: there the direction u of W is that of an axis. Otherwise W turns faster and faster as it vanishes, in the time
s/|W'| or so, s = |W|, along a principal direction in the end. Then steps are at most a quarter of this time, W falls by
a part in each, and vanishes where that time is 1e-12 of a step. Where a body starts, friction pulls W at the rate
c/(J s) to the direction of the W' above: for 1e-5 h, or 1e-3 h where W' is 0 at first, it is taken to be there, W the
integral of this W'. (In a shorter time the latter would be lost in round-off.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from ..geometry.arrays import Array, cross
from ..geometry.attitudes import States, attitudes, directors
from ..integrators.integrator import IVP, Failure, Integrator, Outcome, Status
from ..integrators.ivp import Intervals, onward, started
from ..integrators.stepping import one_by_one
from ..loads import Load, moment
from ..loads.friction import ROUND_OFF, Sliding
from ..loads.memory_terms import OnBodyAtRest, Wheel
from ..loads.potentials import GravityGradient
from ..loads.terms import Damping
from ..models.stack import stacked
from ..models.system import DirectorSystem, HingedSystem
from . import completion
from .completion import WEIGHTS, X
from .contacts import STILL, TINY, Change, Contacts, Modes, refusal
from .events import XTOL, Event, Piece, joined, march_to_events
from .starts import body_state

EPS = float(np.finfo(np.float64).eps)
CLOSE, ULPS = 1e-11, 64  # of a step, and units in the last place of a time: what lies nearer to a node is at it
STEPS, PLANE = 4096, 256  # that are marched before modes are looked at again; in plane motion
MOST = 50  # changes of modes at one time
SOON = 1 / 64  # of a step: a rate that would vanish earlier has steps of its own
RESTLESS = "dry friction changes between sticking and sliding without end"
QUARTER = 0.5  # of the time in which W may vanish
BEGIN, SLOWLY, TICKS = 1e-5, 1e-3, 4096  # of a step, or units in the last place of a time: a start, a slow one
SLOW = 1e-6  # of what moments accelerate a body by: a start where the moment just exceeds the limit
IN_PLANE = 1e-11  # of the largest |W|: velocities along a line
State = tuple[float, Array, Array, Any]  # time, directors as rows, W, internal states


def march_with_friction(scheme: Integrator, problem: IVP, threads: int = 1) -> Outcome:
    """Integrate a stack of bodies under dry friction, or with wheels that have it, one after the other.

    Raises
    ------
    ValueError
        What `refusal` returns; as the integrator.
    """
    if (reason := refusal(scheme, problem)) is not None:
        raise ValueError(reason)
    kind = Tumbling if any(one.axis is None for one in problem.load.frictions) else Rubbed
    return one_by_one(lambda one: kind(scheme, one).march(), problem, threads)


class Rubbed(Contacts):
    """The march of a body under dry friction about axes, and in the bearings of its wheels.

    Attributes
    ----------
    axis : (1, 3) or (0, 3) array, the constrained one
    most : steps that are marched before modes are looked at again
    at_nodes : bool
        Whether pieces have the states at all nodes.
    """

    has_twist = False  # of pieces: while a body sticks, theirs is that about the axis of a contact

    def __init__(self, scheme: Integrator, problem: IVP) -> None:
        super().__init__(scheme, problem)
        self.axis = np.empty((0, 3)) if self.body.axis is None else self.body.axis[None]
        self._in_mode = cache(lambda a, mode: replace(self.wheels[a], mode=mode))
        self.nodes, self.at_nodes, self.most = problem.times(np.arange(problem.steps + 1)), False, STEPS
        self.pieces = [Piece(np.array([self.t]), self.state.part(None), None)]
        self.failure: Failure | None = None

    def march(self) -> Outcome:
        """March to the end, or to a failure."""
        self.begin()
        begin, end, last, count = self.problem.t_start, self.problem.t_end, self.t, 0
        while self.t < end and self.failure is None:
            self.advance()
            count, last = (0, self.t) if self.t > last else (count + 1, last)
            if count > MOST:
                self.failure = Failure(Status.LOAD, self.number(), np.nan, np.nan, RESTLESS)
            if self.problem.progress:
                self.problem.progress((self.t - begin) / (end - begin))
        return joined(self.pieces, self.problem, self.failure)

    def advance(self) -> None:
        """March while modes stay, to a node at most."""
        left, over = self.time_left()
        if over:
            self.settle([*self.standing, *over], dict.fromkeys(over, 0))
        stuck, (system, load, changes, told) = self.standing, self.phase()
        one = replace(self.until(self.most, left), systems=stacked(system), load=load)
        piece, change = self.marched(one, changes)
        if not self.holds(piece):
            return
        self.keep(told(piece))
        if change is not None and change.contact in self.modes:
            zero = stuck if change.sign else [*stuck, change.contact]
            self.modes = {k: sign for k, sign in self.modes.items() if k not in (*zero, change.contact)}
            self.settle(zero, {change.contact: change.sign} if change.sign else {})

    def time_left(self) -> tuple[float, list[int]]:
        """Return the time in which the first of the rates would vanish, at its derivative here, and what stops here."""
        _, W, *_, z = self.state
        (rates, signs), k = self.rates(), self.number()
        b = self.free(self.t, directors(self.state.quaternion), W, z)
        slopes = self.holding(b, self.modes)[1]
        size = abs(b) + abs(b - slopes) + abs(self.Q).max() * abs(self.body.dead_force).sum()
        soon, least = SOON * float(self.nodes[k + 1] - self.nodes[k]), ROUND_OFF * size
        slides = [k for k, sign in self.modes.items() if sign and sign == signs[k]]
        over = [k for k in slides if abs(slopes[k]) <= least[k] and abs(rates[k]) <= soon * least[k]]
        falls = [k for k in slides if self.modes[k] * slopes[k] < 0 and k not in over]
        return float(min((-rates[falls] / slopes[falls]), default=np.inf)), over

    def number(self, t: float | None = None) -> int:
        """Return the number of the step at whose beginning, or in which, a time is, by default that of the march."""
        return int(np.searchsorted(self.nodes, self.t if t is None else t, side="right")) - 1

    def until(self, most: int = STEPS, left: float = np.inf) -> IVP:
        """Return the problem from here to the next node, from a node over `most` steps; `left`: as `time_left`."""
        k = self.number()
        end, length = float(self.nodes[k + 1]), float(self.nodes[k + 1] - self.nodes[k])
        if left < SOON * length:
            end = min(end, self.t + max(2 * left, ULPS * float(np.spacing(abs(self.t)))))
        elif self.t == self.nodes[k]:
            one = onward(self.problem, k, min(k + most, self.problem.steps), self.state)
            return replace(one, load=self.load)
        return self.to(end)

    def to(self, t: float) -> IVP:
        """Return the problem of one step from here to a time."""
        grid: dict[str, Any] = {"steps": 1, "stored": np.array([0, 1]), "segments": None, "progress": None}
        return replace(
            self.problem, t_start=self.t, t_end=t, output_times=None, load=self.load, **grid, **started(self.state)
        )

    def at_node(self, t: float) -> float:
        """Return a time, or that of the node that it nearly is."""
        k = min(self.number(t) + 1, self.problem.steps)
        node = float(self.nodes[k])
        return node if node - t <= max(CLOSE * (node - self.nodes[k - 1]), ULPS * np.spacing(abs(node))) else t

    def marched(self, one: IVP, changes: Sequence[Change]) -> tuple[Piece, Change | None]:
        """March a smooth problem to its end or to the first change."""
        known = self.problem.stored_times
        inner = known[(known > one.t_start) & (known < one.t_end)]
        ends = one.times(np.arange(one.steps + 1) if self.at_nodes else np.array([0, one.steps]))
        output_times = np.union1d(inner, ends) if changes or inner.size or one.steps > 1 else None
        one, ended_by = replace(one, output_times=output_times, intervals=True), None
        if changes:
            events = tuple(Event(_positive(each.value, one.t_start), "friction", 1, -1.0) for each in changes)
            times, outcome, _, ended_by = march_to_events(self.scheme, one, events)
        else:
            times, outcome = one.stored_times, completion.checked_march(self.scheme, one)
        n, failure = int(outcome.good[0]), outcome.failure()
        if failure is not None:
            self.failure = failure._replace(step=failure.step + self.number())
        states, means = outcome.states.part(0, slice(n)), outcome.intervals
        cut: Any = () if means is None else (None if x is None else x[:, : max(n - 1, 0)] for x in means)
        times = times[:n].copy()
        if ended_by is not None and n:
            times[-1] = self.at_node(float(times[-1]))
        piece = Piece(times, states._replace(normal=None, directors=None), Intervals(*cut) if means else None)
        return piece, None if ended_by is None else changes[ended_by]

    def keep(self, piece: Piece) -> None:
        """Add a part to the run; move to its end."""
        if len(piece.times) > 1:
            self.pieces.append(piece)
        if len(piece.times):
            self.t = float(piece.times[-1])
            self.state = States(*(None if x is None else x[-1].copy() for x in piece.states))  # type: ignore[arg-type]

    def holds(self, piece: Piece) -> bool:
        """Whether a piece is what its phase has assumed."""
        return True

    def sliding(self, W: Array) -> Array:
        """Return the moment of the friction of the body that slides, along the frame."""
        signs = np.array([float(self.modes.get(k, 0)) for k in range(self.bearings)])
        return -(self.limits[: self.bearings] * signs) @ self.G[: self.bearings]

    # ---- from mode to mode

    def phase(self) -> tuple[DirectorSystem, Load, list[Change], Callable[[Piece], Piece]]:
        """Return the smooth problem in the modes that there are: body, load, and what ends it; its pieces as ours."""
        (p, W, *_, z), body = self.state, self.body
        own = [k for k in self.standing if k < self.bearings]
        if own and not W.any() and self.stillness(self.t, directors(p), z) >= 0:
            changes = self.ends_of_rest() if self._varies() else []
            still = DirectorSystem(body.euler_inertia, body.axis, physical=False)
            return still, self.resting(), changes, self._rested
        held, told = body, self._slid if self.frictions else self._stood
        if own:
            rows = np.concatenate([self.G[own], self.axis])
            kind: dict[str, Any] = {"dead_force": body.dead_force, "physical": False}
            if np.linalg.matrix_rank(rows) > 1:
                n, _, d = np.linalg.svd(rows)[2]
                held, told = HingedSystem(body.euler_inertia, n, **kind, hinge=d), partial(self._turned, d)
                self.at_nodes = True
            else:
                held, told = DirectorSystem(body.euler_inertia, self.G[own[0]], **kind), self._held
        return held, self.under(self.sliding(W)), self.changes(list(self.modes)), told

    def in_modes(self) -> Load:
        """Return the load with wheels that slip or stand as the modes say."""
        modes = {self.dry[k - self.bearings]: sign for k, sign in self.modes.items() if k >= self.bearings}
        numbers = iter(range(len(self.wheels)))

        def term_of(wheel: Wheel) -> Wheel:
            return self._in_mode(a, modes[a]) if (a := next(numbers)) in modes else wheel

        return Load(tuple(term_of(one) if isinstance(one, Wheel) else one for one in self.load.terms))

    def under(self, moment: Array) -> Load:
        """Return the load in the modes that there are, beside a moment along the frame that stays."""
        if not self.frictions:
            return self.in_modes()
        t = self.problem.t_start, self.problem.t_end
        apart = 1.0 + t[1] - t[0]
        return (
            self.in_modes() + Sliding("body", np.array([t[0] - apart, t[1] + apart]), np.array([moment, moment])).load
        )

    def resting(self) -> Load:
        """Return what has memory, without its moments."""
        wheels = (one.unscaled for one in self.in_modes().wheels)
        return Load((*map(OnBodyAtRest.carried, wheels), *(term.scaled(0.0) for term in self.beside)))

    def stillness(self, t: float, q: Array, z: Any) -> float:
        """Return a number that is negative where contacts that hold a body at rest do not hold all of it."""
        K, W = self.forces(t, q, np.zeros(3), z)[0], np.zeros(3)
        return float(STILL * abs(self.Q).max() * abs(K).max() - abs(self.slope(t, q, W, z)).max())

    def ends_of_rest(self) -> list[Change]:
        """Return what can end it."""
        return [
            *self.changes(list(self.modes)),
            Change(-1, 0, lambda t, s: TINY + self.stillness(t, s.directors, s.internal_state or None)),
        ]

    def _varies(self) -> bool:
        """Whether the moments on a body at rest may change with time."""
        kept = [term for term in self.load.potentials if not isinstance(term, GravityGradient)]
        return any(not isinstance(term, Damping) and term not in kept for term in self.load.terms)

    # ---- pieces

    def _stood(self, piece: Piece) -> Piece:
        """Return a piece with the momenta of standing wheels, which follow from W."""
        own, (_, W, *_, z) = self.wheels_of(self.standing), piece.states
        if own and z is not None:
            z[:, self.places[own]] = self.inertia[own] * (W @ self.spins[own].T)
        return piece

    def _slid(self, piece: Piece) -> Piece:
        """Return a piece with what friction takes in it."""
        piece = self._stood(piece)
        if (means := piece.means) is None:
            return piece
        means = means._replace(dissipated_energy=self._dissipated(piece))
        if not (len(self.axis) or self.has_twist):
            rest, turns = np.zeros(means.load_work.shape), means.velocity_integrals
            means = means._replace(twist=rest if turns is None else turns[..., 2])
        return piece._replace(means=means)

    def _held(self, piece: Piece) -> Piece:
        """Return a piece in which a body without constraint sticks as the one that it then is as its own.

        The mean moment of the constraint is that of friction: what the impulse leaves, or, where potentials act whose
        moment is not summed, -μ along the axis in the middle of the interval.
        """
        times, (p, W, *_), own = piece
        if own is None:
            return self._slid(piece)
        length = np.diff(times)[:, None]
        if own.dead_moment is not None:
            momentum = np.einsum("nij,nj->ni", attitudes(p), W @ self.body.convected_inertia)
            friction = np.diff(momentum, axis=0) / length - own.moment[0] - own.dead_moment[0]
        else:
            friction = -own.multipliers[0] * (attitudes(p[1:] + p[:-1]) @ self.G[min(self.standing)])
        none = np.zeros((1, len(length), 3))
        means = own._replace(multipliers=none[:, :, :0], moment=own.moment + friction, dead_moment=none)
        return self._slid(piece._replace(means=means))

    def _turned(self, d: Array, piece: Piece) -> Piece:
        """Return a piece in which a body turns about one axis alone, as that of this one.

        The mean moment of potentials, and μ, are integrals over angles, and internal states, by cubic polynomials; of
        all moments the mean is what turns the momentum.
        """
        from scipy.interpolate import CubicHermiteSpline
        from scipy.spatial.transform import Rotation

        times, (p, W, *_, z), own = piece = self._stood(piece)
        W[:] = (W @ d)[:, None] * d
        if own is None or len(times) < 2:
            return piece
        R, x = attitudes(p), np.zeros((len(times), 0)) if z is None else z
        turns = (Rotation.from_matrix(R[:-1]).inv() * Rotation.from_matrix(R[1:])).as_rotvec() @ d
        rates = [self._memory_rate(t, R[k].T, W[k], x[k]) for k, t in enumerate(times.tolist())]
        values = np.column_stack([np.append(0.0, np.cumsum(turns)), x])
        between = CubicHermiteSpline(times, values, np.column_stack([W @ d, rates]))
        slope = between.derivative()

        def at(k: int, part: float) -> State:
            t = times[k] + part * (times[k + 1] - times[k])
            angle, *inner = between(t)
            q = (R[k] @ Rotation.from_rotvec((angle - values[k, 0]) * d).as_matrix()).T
            return t, q, slope(t)[0] * d, np.array(inner) if inner else None

        means = self._balanced(piece, at, X, WEIGHTS)
        taken, twist = -(turns * (d @ self.sliding(d)))[None], 0.0 if len(self.axis) else d[2]
        return piece._replace(means=means._replace(dissipated_energy=taken, twist=twist * turns[None]))

    def _rested(self, piece: Piece) -> Piece:
        """Return a piece in which a body without load rests as that of this one: friction carries all but μ."""
        times, z, p, count = piece.times, piece.states.internal, self.state.quaternion, len(piece.times)
        q, middles = directors(p), (times[1:] + times[:-1]) / 2

        def at(k: int, part: float) -> State:
            return float(middles[k]), q, np.zeros(3), None if z is None else (z[k + 1] + z[k]) / 2

        piece = piece._replace(states=States(np.tile(p, (count, 1)), np.zeros((count, 3)), internal=z))
        return self._slid(piece._replace(means=self._balanced(piece, at, [0.5], [1.0])))

    def _balanced(self, piece: Piece, at: Callable[[int, float], State], x: Any, weights: Any) -> Intervals:
        """Return the means of a piece by quadrature: potentials, μ, and the moment, which is what turns the momentum.

        `at` gives the state at a fraction of an interval, `x` and `weights` are those of the quadrature.
        """
        times, (p, W, *_), own = piece
        assert own is not None
        length = np.diff(times)
        (potential, held), mu = np.zeros((2, len(length), 3)), np.zeros(len(length))
        for k in range(len(length)):
            for part, weight in zip(x, weights, strict=True):
                t, q, V, z = at(k, part)
                potential[k] += weight * sum(
                    (term.scale * term.moment_at(t, q, V @ q) for term in self.load.potentials),
                    cross(q, self.body.dead_force).sum(axis=0),
                )
                for n in self.axis:
                    K, lam = self.forces(t, q, V, z)[0], self.holding(self.free(t, q, V, z), self.modes)[0]
                    mu[k] += weight * (f := (K - lam @ self.G) @ (n - self.Q @ self.J @ n))
                    held[k] += weight * f * (n @ q)
        momentum = np.einsum("nij,nj->ni", attitudes(p), W @ self.body.convected_inertia)
        moment, is_known = np.diff(momentum, axis=0) / length[:, None] - potential + held, not len(self.axis)
        is_known |= all(term.dead_force is not None for term in self.load.potentials)
        return own._replace(
            multipliers=mu[None, :, None][..., : len(self.axis)],
            moment=moment[None],
            dead_moment=len(self.axis) * potential[None] if is_known else None,
        )

    def _memory_rate(self, t: float, q: Array, W: Array, z: Array) -> Array:
        """Return z' while modes stay."""
        if not z.size:
            return z
        rate = self.forces(t, q, W, z)[1]
        rate[self.places[self.dry]] -= self.holding(self.free(t, q, W, z), self.modes)[0][self.bearings :]
        return rate

    def _dissipated(self, piece: Piece) -> Array:
        """Return the energy that friction of the body takes in each interval of a piece: its moment is constant."""
        means = piece.means
        assert means is not None
        if means.velocity_integrals is None:
            return np.zeros(means.load_work.shape)
        return -means.velocity_integrals[..., :3] @ self.sliding(np.zeros(3))


class Tumbling(Rubbed):
    """A body under dry friction against w: one contact, of the limit c, about the direction of W in plane motion."""

    has_twist = True

    def __init__(self, scheme: Integrator, problem: IVP) -> None:
        super().__init__(scheme, problem)
        self.is_plane, self.is_alone = True, all(term in self.load.potentials for term in self.load.terms)
        if (W := self.state.velocity).any():
            self.turn([W / np.linalg.norm(W)])

    def slope(self, t: float, q: Array, W: Array, z: Any) -> Array:
        """Return W' while the body slides."""
        return self.Q @ (self.forces(t, q, W, z)[0] + self.sliding(W))

    def sliding(self, W: Array) -> Array:
        """Return the moment of friction, along the frame."""
        if self.is_plane or not W.any():
            return super().sliding(W)
        return -self.limits[0] * W / np.linalg.norm(W)

    def _dissipated(self, piece: Piece) -> Array:
        """Return the energy that friction takes in each interval of a piece, where its moment turns.

        It is its work where no other load has any. Otherwise the power is integrated, by a cubic polynomial through its
        values and derivatives.
        """
        times, (p, velocities, *_, internal), means = piece
        assert means is not None
        if self.is_plane:
            return super()._dissipated(piece)
        if self.is_alone:
            return -means.load_work
        power, rate = np.zeros((2, len(times)))
        for i, (t, W) in enumerate(zip(times.tolist(), velocities, strict=True)):
            along, z = self.sliding(W), None if internal is None else internal[i]
            power[i], rate[i] = -along @ W, -along @ self.slope(t, directors(p[i]), W, z)
        h = np.diff(times)
        return (h / 2 * (power[1:] + power[:-1]) + h**2 / 12 * (rate[:-1] - rate[1:]))[None]

    def settle(self, zero: Sequence[int], forced: Modes) -> None:
        """Choose the mode where W is zero; it is to slide if it is `forced`."""
        self.state.velocity[:] = 0.0
        self.modes, self.is_plane = {0: 0}, True
        K = self._needed()
        if forced.get(0, np.linalg.norm(K) > self.limits[0]):
            start = self._rate_at_rest()
            u = start if start.any() else K
            self.modes = {0: 1}
            self.turn([u / np.linalg.norm(u)])

    def stillness(self, t: float, q: Array, z: Any) -> float:
        """Return that friction holds all of a body at rest."""
        return 0.0

    def ends_of_rest(self) -> list[Change]:
        """Return what can end it: the moment that is needed."""

        def left(t: float, s: Any) -> float:
            K = self.forces(t, s.directors, np.zeros(3), s.internal_state or None)[0]
            return float(self.limits[0] - np.linalg.norm(self._across(K)))

        return [Change(0, 1, left)]

    def advance(self) -> None:
        """March while modes stay, to a node at most."""
        is_in_plane = self.is_plane and bool(self.modes[0])
        self.at_nodes, self.most = is_in_plane or not self.is_alone, PLANE if is_in_plane else STEPS
        if self.modes[0] and not self.is_plane:
            self._slide_around()
        else:
            super().advance()

    def holds(self, piece: Piece) -> bool:
        """Whether W keeps to a line where it slides: friction has a constant direction in the body."""
        W = piece.states.velocity
        if self.modes[0] and (self.failure is not None or abs(np.cross(W, self.G[0])).max() > IN_PLANE * abs(W).max()):
            self.failure, self.is_plane = None, False
        return self.is_plane

    def _across(self, K: Array) -> Array:
        """Return a moment across the constrained axis."""
        return K - (self.axis @ K) @ self.axis

    def _needed(self) -> Array:
        """Return the moment, across the constrained axis, that holds the body at rest here."""
        p, *_, z = self.state
        return self._across(self.forces(self.t, directors(p), np.zeros(3), z)[0])

    def _rate_at_rest(self) -> Array:
        """Return W' at W = 0, against friction: 0 up to its limit."""
        from scipy.optimize import brentq

        K = self._needed()
        basis = np.linalg.svd(np.concatenate([self.axis, np.zeros((1, 3))]))[2][len(self.axis) :]
        J, m, c = basis @ self.J @ basis.T, basis @ K, self.limits[0]
        if not c:
            return np.linalg.solve(J, m) @ basis
        if np.linalg.norm(m) <= c:
            return np.zeros(3)

        def direction_of(alpha: float) -> Array:
            return np.linalg.solve(alpha * J + c * np.eye(len(J)), m)

        most = float(np.linalg.norm(m) / np.linalg.eigvalsh(J)[0])
        alpha = float(brentq(lambda x: float(np.linalg.norm(direction_of(x))) - 1.0, 0.0, most, xtol=EPS * most))
        return alpha * direction_of(alpha) @ basis

    def _slide_around(self) -> None:
        """March while W may turn, or, where it may vanish within four steps, a part of that time."""
        one, W = self.until(), self.state.velocity
        h, load = one.grid.longest, self.load + float(self.limits[0]) * friction_of_one()
        if not W.any():
            self._start(h)
            return

        def time_left(t: float, s: Any) -> float:
            w = np.array(s.material_angular_velocity)
            rate = self.slope(t, s.directors, w, s.internal_state or None)
            return float(QUARTER * np.linalg.norm(w) / np.linalg.norm(rate)) if rate.any() else np.inf

        p, _, *_, z = self.state
        left = time_left(self.t, body_state(self.t, p.tolist(), W.tolist(), () if z is None else z.tolist()))
        if left > h:
            change = Change(0, 0, lambda t, s: min(time_left(t, s), 2 * h) - h)
            self.keep(self._slid(self.marched(replace(one, load=load), [change])[0]))
        elif left > QUARTER * max(XTOL * h, ULPS * np.spacing(abs(self.t))):
            node = float(self.nodes[self.number() + 1])
            to = node if node - self.t <= left else self.t + left
            self.keep(self._slid(self.marched(replace(self.to(to), load=load), [])[0]))
        else:
            self.turn([W / np.linalg.norm(W)])
            self.settle([0], {})

    def _start(self, h: float) -> None:
        """Let the body start to turn, for a short time, to the velocity that it has under the friction along it."""
        begin, node = self.t, float(self.nodes[self.number() + 1])
        a = self._rate_at_rest()
        is_slow = np.linalg.norm(a) <= SLOW * np.linalg.norm(self.Q @ self._needed())
        to = min(begin + max((SLOWLY if is_slow else BEGIN) * h, TICKS * float(np.spacing(abs(begin)))), node)
        along = self.under(self.sliding(self.state.velocity))
        self.keep(self._slid(self.marched(replace(self.to(to), load=along), [])[0]))
        b = self._rate_at_rest()
        self.state.velocity[:] = (to - begin) / 2 * (a + b)
        if not self.state.velocity.any():
            self.settle([0], {})


def _positive(value: Callable[[float, Any], float], start: float) -> Callable[[float, Any], float]:
    """Return a function that is positive where a mode begins: it may vanish there."""
    return lambda t, state: value(t, state) if t > start else max(value(t, state), TINY)


@cache
def friction_of_one() -> Load:
    """Return the moment -w/|w|, of which nobody asks at w = 0."""

    def friction(t: float, directors: Array, w: Array) -> Any:
        return -w / np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])

    return moment(friction, compiled=True)
