"""Dry friction, of a body and in the bearings of its wheels: a run is taken apart where a contact sticks, or slides on.

A contact k has a rate r_k, linear in the velocities, and a limit c_k. Along it acts -λ_k, with λ_k in c_k Sgn(r_k):
Sgn(r) = {sign r}, and [-1, 1] at r = 0. With S the inverse of the mass that the contacts feel, and b what else changes
their rates,

    r' = b(t, state) - S λ,        S symmetric, positive definite or at least not negative.

The law is the subdifferential of Σ c_k |r_k|, a convex function: it is maximal monotone, and the mass is positive, so
from each state there is one motion (Brezis 1973; there is no paradox of Painlevé, whose normal force depends on the
accelerations). While modes stay it is smooth:

- sliding, r of one sign σ: λ = σ c, a constant moment;
- sticking, r = 0: a constraint, and λ is what holds it, ``S λ = b`` over the contacts that stick. It slides on as soon
  as |λ| exceeds c.

Modes. Where rates are zero, r' decides: of each combination of sticking and of sliding in either direction it is tried
whether |λ_k| <= c_k where r_k' = 0, and r_k' has the sign of λ_k elsewhere. One holds: it minimises a strictly convex
function of the accelerations.

A mode ends at the root of a function of the state, found as events are (`events`): of σ r while it slides, of c ± λ
while it sticks. The step ends there, the rate, which is round-off, is set to 0 by an impulse p along the contact, S p =
r, which takes energy, and the rest of the step follows in the new modes. Means over intervals are sums over pieces. So
that a step does not turn a body far behind the root, it is at most as long as two of the times in which a rate would
vanish, where this is much shorter than the step.

With the momenta h and the speeds Ω of wheels about axes n_a (`loads.memory`), r_a what acts on each beside dry
friction, J_c the inertia of what carries them, Q = J_c⁻¹, across a constrained axis n ``B (BᵀJ_c B)⁻¹ Bᵀ`` of a basis
B, and M the moments of all else,

    J_c W' = K - Gᵀλ - μ n,        K = M + (J_c W + Σ h n) × W - Σ r n,        h_a' = r_a - λ_a,

the rows of G being the axes a of friction of the body, and -n of that in bearings. Hence ``W' = Q (K - Gᵀλ)``, ``μ = (n
- Q J_c n)·(K - Gᵀλ)`` and, with D that of bearings alone, 1/I,

    rates    G W + D h,        b = G Q K + D r,        S = G Q Gᵀ + D.

A wheel that stands is a part of the body, ``h = I n·W``; one that slips has the constant torque -λ, which takes c |Ω|.
An impulse p changes W by -Q Gᵀ p, and h of bearings by -p: the total momentum does not feel those in bearings.

`rubbing` has how a body slides, sticks and rests, `completion` how other loads are named that jump with the state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from ..geometry.arrays import Array, cross
from ..geometry.attitudes import States, directors
from ..integrators.base import IVP, Failure, Integrator, Outcome, Status
from ..integrators.load_samples import carrier, wheel_columns
from ..integrators.problem import Intervals, onward, started
from ..integrators.stepping import one_by_one
from ..loads import Load
from ..loads.base import moment_at
from ..loads.friction import ROUND_OFF
from ..loads.functions import checked
from ..loads.memory import Wheel
from ..models.stack import stacked
from ..models.system import DirectorSystem
from . import completion
from .events import Event, Piece, joined, march_to_events
from .starts import BodyState

TINY = float(np.finfo(np.float64).tiny)
CLOSE, ULPS = 1e-11, 64  # of a step, and units in the last place of a time: what lies nearer to a node is at it
STEPS = 4096  # that are marched before modes are looked at again
MOST = 50  # changes of modes at one time
SOON = 1 / 64  # of a step: a rate that would vanish earlier has steps of its own
STILL = 1e-12  # of what moments accelerate a body by: nothing
RESTLESS = "dry friction changes between sticking and sliding without end"
SCHEMES = "dry_friction needs an integrator that splits its steps, gauss or lie-midpoint; {} does not"
SPIN = "dry_friction does not act on a body whose spin is prescribed; leave spin= out"
WHEELS_SPIN = "coulomb= of a wheel does not act on a body whose spin is prescribed; leave spin= out, or use viscous="
BEARINGS = "dry_friction against w does not act beside coulomb= of a wheel; give axis=, or leave one of the two out"
ALONG = "dry_friction about the constrained axis does nothing, as the body does not turn about it; leave it out"
DISSIPATION = "dry_friction sticks by a constraint, under which dissipation= is not possible; leave it out"
Modes = dict[int, int]  # of each contact: the sign of its rate while it slides, 0 while it sticks


class Change(NamedTuple):
    """What ends a mode: a function that falls to zero; how its contact slides then, 0: its rate is zero."""

    contact: int
    sign: int
    value: Callable[[float, Any], float]


class Phase(NamedTuple):
    """A smooth problem while modes stay: body, load, what ends it, and what its pieces are as those of the body."""

    system: DirectorSystem
    load: Load
    changes: Sequence[Change]
    told: Callable[[Piece], Piece]


class Contacts:
    """A march of a problem of one body under dry friction, from its start to its end.

    Attributes
    ----------
    load : Load
        What acts in all modes.
    frictions : those of the body, whose contacts come first
    wheels, places : of each wheel a, and the place of h among the internal states
    dry : numbers of the wheels of the other contacts
    limits, G, D, S : of the contacts
    modes : dict
    at_nodes : bool
        Whether pieces have the states at all nodes.
    """

    def __init__(self, scheme: Integrator, problem: IVP) -> None:
        self.scheme, self.problem, self.body = scheme, problem, problem.system
        self.load, self.frictions = problem.load.without_frictions, problem.load.frictions
        self.t, self.modes, self.at_nodes = problem.t_start, Modes(), False
        z = None if problem.internal is None else problem.internal[0].copy()
        self.state = States(problem.quaternion[0].copy(), problem.velocity[0].copy(), internal=z)
        self.pieces = [Piece(np.array([self.t]), self.state.part(None), None)]
        self.failure: Failure | None = None
        self._inverses = dict[tuple[int, ...], Array]()  # of parts of S
        self.nodes = problem.times(np.arange(problem.steps + 1))
        found = list(wheel_columns(self.load))
        self.wheels, self.places = [one.unscaled for one, _ in found], np.array([place for _, place in found], int)
        self.dry, self.bearings = [a for a, one in enumerate(self.wheels) if one.is_dry], len(self.frictions)
        self.beside = [term for term in self.load.remembering if not isinstance(term, Wheel)]
        self.plain = Load(tuple(term for term in self.load.terms if term not in self.load.remembering))
        self.limits = np.array([one.limit for one in self.frictions] + [self.wheels[a].coulomb for a in self.dry])
        self.inertia = np.array([one.inertia for one in self.wheels])
        self.spins = np.array([one.direction for one in self.wheels]).reshape(-1, 3)
        self.J = (carrier(self.body, self.load) if self.wheels else self.body).convected_inertia
        n = self.body.axis  # about which J may be 0
        across = np.eye(3) if n is None else np.linalg.svd(n[None])[2][1:].T
        self.Q = across @ np.linalg.solve(across.T @ self.J @ across, across.T)
        self.D = np.concatenate([np.zeros(self.bearings), 1 / self.inertia[self.dry]])
        self.turn([np.zeros(3) if one.axis is None else one.axis for one in self.frictions])

    def turn(self, axes: Sequence[Array]) -> None:
        """Set the axes of the friction of the body."""
        self.G = np.concatenate([np.reshape(axes, (-1, 3)), -self.spins[self.dry]])
        self.S = self.G @ self.Q @ self.G.T + np.diag(self.D)
        self._inverses.clear()

    # ---- rates and forces

    def rate(self, k: int, W: Sequence[float], z: Any) -> tuple[float, float]:
        """Return the rate of a contact, and the size of the numbers that it is the sum of."""
        (a, b, c), (x, y, s) = self.G[k].tolist(), W
        own = self.D[k] * z[self.places[self.dry[k - self.bearings]]] if k >= self.bearings else 0.0
        return own + a * x + b * y + c * s, abs(own) + sqrt(x * x + y * y + s * s)

    def rates(self) -> Array:
        """Return the rates of all contacts."""
        _, W, *_, z = self.state
        return np.array([self.rate(k, W.tolist(), z)[0] for k in range(len(self.limits))])

    def forces(self, t: float, q: Array, W: Array, z: Any) -> tuple[Array, Array]:
        """Return K, and z', of wheels without dry friction; q: directors as rows, z: of standing wheels from W."""
        K = torque(self.body, self.plain, t, q, W)
        if z is None:
            return K, np.zeros(0)
        h, turning = np.asarray(z)[self.places], self.inertia * (self.spins @ W)
        standing = self.wheels_of(self.standing)
        h[standing] = turning[standing]
        rate, own = np.zeros(len(z)), iter(h.tolist())
        for term, place in self.load.placed:
            if isinstance(term, Wheel):
                rate[place] = term.responses(checked, t, (next(own), *z[place][1:]), None, W)[1][: term.count]
            else:
                M, rate[place] = term.answers(t, q, W, np.asarray(z)[place])
                K = K + q @ M
        return K + cross((h - turning) @ self.spins, W) - rate[self.places] @ self.spins, rate

    def free(self, t: float, q: Array, W: Array, z: Any) -> Array:
        """Return b, the derivatives of the rates without friction."""
        K, rate = self.forces(t, q, W, z)
        b: Array = self.G @ (self.Q @ K)
        b[self.bearings :] += rate[self.places[self.dry]] / self.inertia[self.dry]
        return b

    def slope(self, t: float, q: Array, W: Array, z: Any) -> Array:
        """Return W' in the modes that there are."""
        K, lam = self.forces(t, q, W, z)[0], self.holding(self.free(t, q, W, z), self.modes)[0]
        return self.Q @ (K - lam @ self.G)

    def kick(self, contacts: Sequence[int], p: Array) -> None:
        """Change the state by impulses along contacts; what is left of W is round-off, or no longer there."""
        _, W, *_, z = self.state
        change = self.Q @ (p @ self.G[list(contacts)])
        W -= change
        if abs(W).max() <= max(ROUND_OFF * abs(change).max(), TINY):
            W[:] = 0.0
        if z is not None:
            own = self.wheels_of(contacts)
            z[self.places[own]] = self.inertia[own] * (self.spins[own] @ W)

    def wheels_of(self, contacts: Sequence[int]) -> list[int]:
        """Return the numbers of the wheels of those contacts that are in bearings."""
        return [self.dry[k - self.bearings] for k in contacts if k >= self.bearings]

    @property
    def standing(self) -> list[int]:
        """The contacts that stick."""
        return [k for k, sign in self.modes.items() if not sign]

    def phase(self, stuck: list[int]) -> Phase | None:
        """Return the smooth problem in which these contacts stick and all others slide; None where it fails."""
        raise NotImplementedError

    # ---- modes

    def begin(self) -> None:
        """Choose the first modes."""
        _, W, *_, z = self.state
        found = [self.rate(k, W.tolist(), z) for k in range(len(self.limits))]
        slides = {k: 1 if x > 0 else -1 for k, (x, size) in enumerate(found) if abs(x) > ROUND_OFF * size}
        self.modes = slides
        if zero := [k for k in range(len(found)) if k not in slides]:
            self.settle(zero, {})

    def holding(self, b: Array, modes: Modes) -> tuple[Array, Array]:
        """Return λ and r' of all contacts."""
        lam = np.array([modes.get(k, 0) * c for k, c in enumerate(self.limits.tolist())])
        if held := [k for k, sign in modes.items() if not sign]:
            lam[held] = self._inverse(held) @ (b - self.S @ lam)[held]
        return lam, b - self.S @ lam

    def _inverse(self, contacts: Sequence[int]) -> Array:
        if (key := tuple(contacts)) not in self._inverses:
            self._inverses[key] = np.asarray(np.linalg.pinv(self.S[np.ix_(key, key)], hermitian=True), np.float64)
        return self._inverses[key]

    def settle(self, zero: Sequence[int], forced: Modes) -> None:
        """Choose the modes of contacts whose rates are zero; those that are `forced` slide."""
        own, (_, W, *_, z) = list(zero), self.state
        self.kick(own, self._inverse(own) @ self.rates()[own])
        b, free = self.free(self.t, directors(self.state.quaternion), W, z), [k for k in zero if k not in forced]
        for signs in product((0, 1, -1), repeat=len(free)):
            modes = self.modes | forced | dict(zip(free, signs, strict=True))
            lam, change = self.holding(b, modes)
            if all(modes[k] * change[k] > 0 if modes[k] else abs(lam[k]) <= self.limits[k] for k in free):
                self.modes = modes
                return
        self.modes |= forced | dict.fromkeys(free, 0)  # at a limit, to round-off

    def changes(self, contacts: Sequence[int]) -> list[Change]:
        """Return what can end the modes of contacts: a rate that vanishes, or what holds it reaching its limit.

        Both by more than round-off, as they may be there where a mode begins.
        """
        modes, known = dict(self.modes), dict[Any, Array]()

        def left(t: float, s: BodyState, k: int, side: int) -> float:
            if not side:
                rate, size = self.rate(k, s.material_angular_velocity, s.internal_state)
                return modes[k] * rate + ROUND_OFF * size
            if (key := (t, s._numbers)) not in known:  # several functions ask for it
                W, z = np.array(s.material_angular_velocity), s.internal_state or None
                known[key] = self.holding(self.free(t, s.directors, W, z), modes)[0]
            return float(self.limits[k] * (1 + ROUND_OFF) - side * known[key][k])

        sides = [(k, side) for k in contacts for side in ((0,) if modes[k] else (1, -1))]
        return [Change(k, side, partial(left, k=k, side=side)) for k, side in sides]

    # ---- the march

    def march(self) -> Outcome:
        """March to the end, or to a failure."""
        self.begin()
        begin, end, last, count = self.problem.t_start, self.problem.t_end, self.t, 0
        while self.t < end and self.failure is None:
            self.advance()
            count, last = (0, self.t) if self.t > last else (count + 1, last)
            if count > MOST:
                self.fail(RESTLESS)
            if self.problem.progress:
                self.problem.progress((self.t - begin) / (end - begin))
        return joined(self.pieces, self.problem, self.failure)

    def advance(self) -> None:
        """March while modes stay, to a node at most."""
        stuck = self.standing
        if (phase := self.phase(stuck)) is None:
            return
        one = replace(self.until(left=self.time_left()), systems=stacked(phase.system), load=phase.load)
        piece, change = self.marched(one, phase.changes)
        self.keep(phase.told(piece))
        if change is not None and change.contact in self.modes:
            zero = stuck if change.sign else [*stuck, change.contact]
            self.modes = {k: sign for k, sign in self.modes.items() if k not in (*zero, change.contact)}
            self.settle(zero, {change.contact: change.sign} if change.sign else {})

    def time_left(self) -> float:
        """Return the time in which the first of the rates would vanish, at its derivative here."""
        _, W, *_, z = self.state
        rates = self.rates()
        slopes = self.holding(self.free(self.t, directors(self.state.quaternion), W, z), self.modes)[1]
        falls = [k for k, sign in self.modes.items() if sign and sign * slopes[k] < 0 < sign * rates[k]]
        return float(min((-rates[falls] / slopes[falls]), default=np.inf))

    def fail(self, reason: str) -> None:
        """End the march here."""
        self.failure = Failure(Status.LOAD, self.number(), np.nan, np.nan, reason)

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
        grid: dict[str, Any] = {"steps": 1, "stored": np.array([0, 1]), "stretches": None, "progress": None}
        return replace(
            self.problem, t_start=self.t, t_end=t, output_times=None, load=self.load, **grid, **started(self.state)
        )

    def at_node(self, t: float) -> float:
        """Return a time, or that of the node that it nearly is."""
        k = min(self.number(t) + 1, self.problem.steps)
        node = float(self.nodes[k])
        return node if node - t <= max(CLOSE * (node - self.nodes[k - 1]), ULPS * np.spacing(abs(node))) else t

    def marched(self, one: IVP, changes: Sequence[Change], at_nodes: bool = False) -> tuple[Piece, Change | None]:
        """March a smooth problem to its end or to the first change."""
        known = self.problem.stored_times
        inner = known[(known > one.t_start) & (known < one.t_end)]
        ends = one.times(np.arange(one.steps + 1) if at_nodes or self.at_nodes else np.array([0, one.steps]))
        output_times = np.union1d(inner, ends) if changes or inner.size or one.steps > 1 else None
        one, ended_by = replace(one, output_times=output_times, intervals=True), None
        if changes:
            events = tuple(Event(_positive(each.value, one.t_start), "friction", 1, -1.0) for each in changes)
            times, outcome, _, ended_by = march_to_events(self.scheme, one, events)
        else:
            times, outcome = one.stored_times, completion.march(self.scheme, one)
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


def _positive(value: Callable[[float, Any], float], start: float) -> Callable[[float, Any], float]:
    """Return a function that is positive where a mode begins: it may vanish there."""
    return lambda t, state: value(t, state) if t > start else max(value(t, state), TINY)


# ---- what is refused, and marches


def refusal(scheme: Integrator, problem: IVP) -> str | None:
    """Return why a problem is not accepted, for its dry friction or for the integrator's reasons; None if it is."""
    own = problem.load.frictions
    if not own:
        is_free = problem.systems.spin is None or not problem.load.is_dry
        return scheme.refusal(problem) if is_free else WHEELS_SPIN
    if not scheme.splits_steps:
        return SCHEMES.format(scheme.name)
    systems = problem.systems
    if systems.spin is not None:
        return SPIN
    if any(one.axis is None for one in own) and any(one.is_dry for one in problem.load.wheels):
        return BEARINGS
    if getattr(scheme, "dissipation", 0.0):
        return DISSIPATION
    if systems.axis is not None:
        across = [abs(np.cross(term.axis, systems.axis)).max(axis=1).min() for term in own if term.axis is not None]
        if min(across, default=1.0) <= STILL:
            return ALONG
    return scheme.refusal(problem)


def march(scheme: Integrator, problem: IVP, threads: int = 1) -> Outcome:
    """Integrate a stack of bodies under dry friction, or with wheels that have it, one after the other.

    Raises
    ------
    ValueError
        What `refusal` returns; as the integrator.
    """
    from .rubbing import Rubbed, Tumbling

    if (reason := refusal(scheme, problem)) is not None:
        raise ValueError(reason)
    kind = Tumbling if any(one.axis is None for one in problem.load.frictions) else Rubbed
    return one_by_one(lambda one: kind(scheme, one).march(), problem, threads)


def torque(body: DirectorSystem, load: Load, t: float, q: Array, W: Array) -> Array:
    """Return J W' of a body without constraint under a load: M + J W × W; q: directors as rows."""
    m = moment_at(load, t, q, W @ q) + cross(q, body.dead_force).sum(axis=0)
    return q @ m + cross(body.convected_inertia @ W, W)
