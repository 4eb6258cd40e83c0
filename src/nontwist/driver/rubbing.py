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
- resting, W = 0 exactly and Λ constant, if nothing accelerates the body.

Modes. Where rates are zero, W' decides: it minimises ½ W'·J W' - M·W' + Σ c_k |a_k·W'| over those contacts, which is
strictly convex. Its conditions, |λ_k| <= c_k where a_k·W' = 0 and λ_k = c_k sign(a_k·W') elsewhere, are tried for each
combination.

The modes of a contact change at the root of a function of the state, found as events are (`pieces`): of σ a·W while it
slides, of c ± λ while it sticks. The step ends there, a·W is set to 0 by an impulse along a, which takes energy, of the
size of round-off, and the rest of the step follows in the new modes. As of events, two changes of sign between two of
the times at which functions are evaluated are missed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from ..geometry.arrays import Array, cross
from ..geometry.attitudes import States, attitudes, directors
from ..integrators.base import IVP, Integrator
from ..integrators.problem import Intervals, onward
from ..loads import Load
from ..loads.base import moment_at
from ..loads.friction import ROUND_OFF
from ..loads.potentials import GravityGradient
from ..loads.terms import Damping, Table
from ..models.stack import stacked
from ..models.system import DirectorSystem
from .events import RTOL, XTOL
from .pieces import TINY, Change, InPieces, Modes, Piece

STILL = 1e-12  # of what moments accelerate a body by: nothing
HELD = (
    "dry friction sticks and leaves the body one axis to turn about, which is not supported; "
    "choose a body without a constrained axis and one dry_friction, or dry_friction without an axis"
)


class Hold(NamedTuple):
    """What holds a body at rest: what is left to the limit of the contact that is nearest to it, and how it slides."""

    left: float
    contact: int
    sign: int
    is_still: bool  # whether nothing accelerates the body
    mu: float


class Rubbed(InPieces):
    """A body under dry friction about axes.

    Attributes
    ----------
    limits, axes : of each contact c, N m, and a
    """

    def __init__(self, scheme: Integrator, problem: IVP) -> None:
        super().__init__(scheme, problem, problem.load.without_frictions)
        self.limits = [term.limit for term in problem.load.frictions]
        self.axes: list[Array] = [np.zeros(3) if term.axis is None else term.axis for term in problem.load.frictions]
        self.J, n = self.body.convected_inertia, self.body.axis
        self.inverse, self.axis = np.linalg.inv(self.J), np.empty((0, 3)) if n is None else n[None]
        self._gains = dict[tuple[int, ...], tuple[Array, Array]]()
        self.is_alone = all(term in self.load.potentials for term in self.load.terms)
        self.at_nodes = not self.is_alone

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
        return sum((-self.limits[k] * sign * self.axes[k] for k, sign in modes.items() if sign), np.zeros(3))

    def sliding_at(self, W: Array) -> Array:
        """Return it in the modes of the march, where W is."""
        return self.sliding(self.modes)

    def under(self, moment: Array) -> Load:
        """Return the load beside a moment along the frame that stays."""
        t = self.problem.t_start, self.problem.t_end
        apart = 1.0 + t[1] - t[0]
        return self.load + Table("body", np.array([t[0] - apart, t[1] + apart]), np.array([moment, moment])).load

    # ---- modes

    def begin(self) -> None:
        """Choose the first modes."""
        W = self.state.velocity
        rates, size = [float(a @ W) for a in self.axes], float(np.linalg.norm(W))
        self.modes = {k: 1 if rate > 0 else -1 for k, rate in enumerate(rates) if abs(rate) > ROUND_OFF * size}
        if zero := [k for k in range(len(rates)) if k not in self.modes]:
            self.settle(zero, {})

    def settle(self, zero: Sequence[int], forced: Modes) -> None:
        """Choose the modes of contacts whose rates are zero; those that are `forced` slide."""
        q, W = directors(self.state.quaternion), self.state.velocity
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

    def phase(self) -> None:
        """March while modes stay, to a node at most."""
        stuck = [k for k, sign in self.modes.items() if not sign]
        if stuck and not self.state.velocity.any() and self.rest(stuck):
            return
        system = self.body
        if stuck:
            if np.linalg.matrix_rank(self._held(tuple(stuck))[0]) > 1:
                self.fail(HELD)
                return
            system = DirectorSystem(self.body.euler_inertia, self.axes[stuck[0]], self.body.dead_force)
        changes = [change for k in self.modes for change in self._changes(k, stuck)]
        load = self.under(self.sliding(self.modes))
        piece, root = self.marched(replace(self.until(), systems=stacked(system), load=load), changes)
        self.keep(piece if system is self.body else self._as_held(piece))
        if root is not None:
            zero = [*stuck] if root.sign else [*stuck, root.contact]
            self.modes = {k: sign for k, sign in self.modes.items() if k not in (*zero, root.contact)}
            self.settle(zero, {root.contact: root.sign} if root.sign else {})

    def _changes(self, k: int, stuck: list[int]) -> list[Change]:
        """Return what can end the mode of a contact: a rate that vanishes, or what holds it reaching its limit."""
        sign, a, c = self.modes[k], self.axes[k], self.limits[k]
        if sign:
            x, y, z = (sign * a).tolist()
            return [Change(k, 0, lambda t, s: along(x, y, z, s.material_angular_velocity))]
        place, sliding, known = stuck.index(k), self.sliding(self.modes), dict[Any, float]()

        def held(t: float, s: Any) -> float:
            if (key := (t, s._numbers)) not in known:  # both functions ask for it
                M = self.torque(t, s.directors, np.array(s.material_angular_velocity)) + sliding
                known[key] = float(self.acceleration(M, stuck)[1][place])
            return known[key]

        return [Change(k, 1, lambda t, s: c - held(t, s)), Change(k, -1, lambda t, s: c + held(t, s))]

    # ---- at rest

    def hold(self, t: float, q: Array, stuck: list[int]) -> Hold:
        """Return what holds the body at rest."""
        M = self.torque(t, q, np.zeros(3))
        rate, lam = self.acceleration(M, stuck)
        left = [self.limits[k] - abs(x) for k, x in zip(stuck, lam, strict=False)]
        is_still = bool(abs(rate).max() <= STILL * abs(self.inverse @ M).max())
        worst = int(np.argmin(left))
        sign = -1 if lam[worst] < 0 else 1
        return Hold(float(left[worst]), stuck[worst], sign, is_still, float(lam[len(stuck) :].sum()))

    def rest(self, stuck: list[int]) -> bool:
        """Let the body rest, up to the node after which it does not, or to where it starts; return whether it rests."""
        one, q = self.until(), directors(self.state.quaternion)

        def held(t: float) -> Hold:
            return self.hold(t, q, stuck)

        nodes, fails = one.times(np.arange(one.steps + 1)), None
        for k, t in enumerate(nodes.tolist() if self._varies() else nodes[:1].tolist()):
            now = held(t)
            if not now.is_still or (k and now.left < 0):
                fails = k, now.is_still
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
            if held(begin).left > 0:
                to = float(brentq(lambda t: held(t).left, begin, end, xtol=XTOL * (end - begin), rtol=RTOL))
            to = self.at_node(to)
        if to > self.t:
            body = DirectorSystem(self.body.euler_inertia, self.body.axis)
            span = self.to(to) if is_root else onward(self.problem, self.number(), self.number(to), self.state)
            piece, _ = self.marched(replace(span, systems=stacked(body), load=Load()), [], at_nodes=True)
            self.keep(self._at_rest(piece, q, lambda t: held(t).mu))
        if is_root:
            worst = held(self.t)
            self.modes = {k: sign for k, sign in self.modes.items() if sign}
            self.settle([k for k in stuck if k != worst.contact], {worst.contact: worst.sign})
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

    def told(self, piece: Piece, means: Intervals) -> Intervals:
        """Return the means of a part, with what friction takes in it."""
        means = means._replace(dissipated_energy=self._dissipated(piece))
        return means if len(self.axis) else means._replace(twist=None)

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
            along = self.sliding_at(W)
            power[i] = -along @ W
            rate[i] = -along @ self.acceleration(self.torque(t, directors(p), W) + along, held)[0]
        h = np.diff(times)
        found: Array = (h / 2 * (power[1:] + power[:-1]) + h**2 / 12 * (rate[:-1] - rate[1:]))[None]
        return found


def torque(body: DirectorSystem, load: Load, t: float, q: Array, W: Array) -> Array:
    """Return J W' of a body without constraint under a load: M + J W × W; q: directors as rows."""
    m = moment_at(load, t, q, W @ q) + cross(q, body.dead_force).sum(axis=0)
    found: Array = q @ m + cross(body.convected_inertia @ W, W)
    return found


def along(x: float, y: float, z: float, W: tuple[float, float, float]) -> float:
    """Return the component of W along an axis."""
    return x * W[0] + y * W[1] + z * W[2]
