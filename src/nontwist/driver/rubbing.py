"""Dry friction of a body, about axes or against w: its contacts (`contacts`), how it sticks, rests and starts.

With M the moments of all else, contacts along axes a_k of the body, and a constrained axis n,

    J W' + W × J W = M - Σ λ_k a_k - μ n,        λ_k in c_k Sgn(a_k·W),        n·W = 0,

so with Q = J⁻¹, across n under a constraint (``Q - Q n nᵀQ/n·Qn``), A the rows a_k and K = M + J W × W

    W' = Q (K - Aᵀλ),        b = A Q K,        S = A Q Aᵀ.

- Sliding, the moment -σ c a along the frame is constant. Steps keep their balance of work, so friction takes c |a·W| as
  long as a·W has the sign at the stages.
- Sticking, the body is the Suslov body of axis a, whose μ is λ.
- Resting, W = 0 exactly and Λ constant, if nothing accelerates the body.

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

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from ..geometry.arrays import Array, cross
from ..geometry.attitudes import States, attitudes, directors
from ..integrators.base import IVP, Integrator
from ..loads import Load, moment
from ..loads.friction import ROUND_OFF
from ..loads.potentials import GravityGradient
from ..loads.terms import Damping, Table
from ..models.system import DirectorSystem
from .contacts import STILL, TINY, ULPS, Change, Contacts, Modes, Phase, torque
from .events import XTOL, Piece
from .starts import body_state

EPS = float(np.finfo(np.float64).eps)
PLANE = 256  # steps that are marched before modes are looked at again, in plane motion
QUARTER = 0.5  # of the time in which W may vanish
BEGIN, SLOWLY, TICKS = 1e-5, 1e-3, 4096  # of a step, or units in the last place of a time: a start, a slow one
SLOW = 1e-6  # of what moments accelerate a body by: a start where the moment just exceeds the limit
IN_PLANE = 1e-11  # of the largest |W|: velocities along a line
HELD = (
    "dry friction sticks and leaves the body one axis to turn about, which is not supported; "
    "choose a body without a constrained axis and one dry_friction, or dry_friction without an axis"
)


class Rubbed(Contacts):
    """A body under dry friction about axes.

    Attributes
    ----------
    axes : (n, 3) array, a of each contact
    axis : (1, 3) or (0, 3) array, the constrained one
    """

    has_twist = False  # of pieces: while a body sticks, it would be that about the axis of a contact

    def __init__(self, scheme: Integrator, problem: IVP) -> None:
        super().__init__(scheme, problem, problem.load.without_frictions)
        own, n = problem.load.frictions, self.body.axis
        self.limits = np.array([term.limit for term in own])
        self.J = self.body.convected_inertia
        self.Q = self.inverse = np.linalg.inv(self.J)
        self.axis = np.empty((0, 3)) if n is None else n[None]
        if n is not None:
            self.Q = self.Q - np.outer(self.Q @ n, self.Q @ n) / (n @ self.Q @ n)
        self.turn([np.zeros(3) if term.axis is None else term.axis for term in own])
        self.is_alone = all(term in self.load.potentials for term in self.load.terms)
        self.at_nodes = not self.is_alone

    def turn(self, axes: Sequence[Array]) -> None:
        """Set the axes of the contacts."""
        self.axes = np.array(axes)
        self.S = self.axes @ self.Q @ self.axes.T
        self._inverses.clear()

    # ---- contacts

    def rates(self, W: Array, z: Any) -> Array:
        """Return a·W."""
        found: Array = self.axes @ W
        return found

    def noise(self, W: Array, z: Any) -> Array:
        """Return |W|, of each."""
        return np.full(len(self.limits), np.sqrt(W @ W))

    def free(self, t: float, q: Array, W: Array, z: Any) -> Array:
        """Return A Q K."""
        b: Array = self.axes @ (self.Q @ self.torque(t, q, W))
        return b

    def kick(self, contacts: Sequence[int], p: Array) -> None:
        """Change W by impulses along axes; what is left of it is round-off, or no longer there."""
        W, change = self.state.velocity, self.Q @ (p @ self.axes[list(contacts)])
        W -= change
        if abs(W).max() <= max(ROUND_OFF * abs(change).max(), TINY):
            W[:] = 0.0

    def torque(self, t: float, q: Array, W: Array) -> Array:
        """Return K without friction."""
        return torque(self.body, self.load, t, q, W)

    def sliding(self, W: Array) -> Array:
        """Return the moment of the contacts that slide, along the frame."""
        signs = np.array([float(self.modes.get(k, 0)) for k in range(len(self.limits))])
        found: Array = -(self.limits * signs) @ self.axes
        return found

    # ---- from mode to mode

    def phase(self, stuck: list[int]) -> Phase | None:
        """Return the smooth problem in which these contacts stick and all others slide; None where it fails."""
        W, body = self.state.velocity, self.body
        if stuck and not W.any() and self.stillness(stuck, self.t, directors(self.state.quaternion)) >= 0:
            changes = self.ends_of_rest(stuck) if self._varies() else []
            return Phase(DirectorSystem(body.euler_inertia, body.axis), Load(), changes, partial(self._rested, stuck))
        held, told = body, self._slid
        if stuck:
            if np.linalg.matrix_rank(np.concatenate([self.axes[stuck], self.axis])) > 1:
                self.fail(HELD)
                return None
            held, told = DirectorSystem(body.euler_inertia, self.axes[stuck[0]], body.dead_force), self._held
        return Phase(held, self.under(self.sliding(W)), self.changes(list(self.modes)), told)

    def under(self, moment: Array) -> Load:
        """Return the load beside a moment along the frame that stays."""
        t = self.problem.t_start, self.problem.t_end
        apart = 1.0 + t[1] - t[0]
        return self.load + Table("body", np.array([t[0] - apart, t[1] + apart]), np.array([moment, moment])).load

    def stillness(self, stuck: list[int], t: float, q: Array) -> float:
        """Return a number that is negative where contacts that hold a body at rest do not hold all of it."""
        K = self.torque(t, q, np.zeros(3))
        lam = self._inverse(stuck) @ (self.axes[stuck] @ (self.Q @ K))
        rate = self.Q @ (K - lam @ self.axes[stuck])
        return float(STILL * abs(self.inverse @ K).max() - abs(rate).max())

    def ends_of_rest(self, stuck: list[int]) -> list[Change]:
        """Return what can end it."""
        return [
            *self.changes(stuck),
            Change(-1, 0, lambda t, s: TINY + self.stillness(stuck, t, s.directors)),
        ]

    def _varies(self) -> bool:
        """Whether the moments on a body at rest may change with time."""
        kept = [term for term in self.load.potentials if not isinstance(term, GravityGradient)]
        return any(not isinstance(term, Damping) and term not in kept for term in self.load.terms)

    # ---- pieces

    def _slid(self, piece: Piece) -> Piece:
        """Return a piece with what friction takes in it."""
        if (means := piece.means) is None:
            return piece
        means = means._replace(dissipated_energy=self._dissipated(piece))
        return piece._replace(means=means if len(self.axis) or self.has_twist else means._replace(twist=None))

    def _held(self, piece: Piece) -> Piece:
        """Return a piece in which a body without constraint sticks as the one that it then is as its own.

        The mean moment of the constraint is that of friction: what the impulse leaves, or, where potentials act whose
        moment is not summed, -μ along the axis in the middle of the interval.
        """
        times, (p, W, *_), own = piece
        if own is None or len(self.axis):
            return self._slid(piece)
        length = np.diff(times)[:, None]
        if own.dead_moment is not None:
            momentum = np.einsum("nij,nj->ni", attitudes(p), W @ self.J)
            friction = np.diff(momentum, axis=0) / length - own.moment[0] - own.dead_moment[0]
        else:
            a = next(self.axes[k] for k, sign in self.modes.items() if not sign)
            friction = -own.multipliers[0] * (attitudes(p[1:] + p[:-1]) @ a)
        none = np.zeros((1, len(length), 3))
        means = own._replace(multipliers=none[:, :, :0], moment=own.moment + friction, dead_moment=none)
        return self._slid(piece._replace(means=means))

    def _rested(self, stuck: list[int], piece: Piece) -> Piece:
        """Return a piece in which a body without load rests as that of this one: friction carries all but μ."""
        times, own, q = piece.times, piece.means, directors(self.state.quaternion)
        assert own is not None
        middles, potentials = ((times[1:] + times[:-1]) / 2).tolist(), self.load.potentials
        dead, n = cross(q, self.body.dead_force).sum(axis=0), self.axis
        given = [sum((term.scale * term.moment_at(t, q, np.zeros(3)) for term in potentials), dead) for t in middles]
        potential = np.array(given).reshape(1, -1, 3)
        means = own._replace(moment=-potential, dead_moment=np.zeros(potential.shape))
        if len(n):
            K = np.array([self.torque(t, q, np.zeros(3)) for t in middles]).reshape(-1, 3)
            lam = K @ self.Q @ self.axes[stuck].T @ self._inverse(stuck)
            mu = (K - lam @ self.axes[stuck]) @ (self.inverse @ n[0]) / (n[0] @ self.inverse @ n[0])
            is_linear = all(term.dead_force is not None for term in potentials)
            means = means._replace(
                multipliers=mu[None, :, None],
                moment=means.moment + mu[:, None] * (n[0] @ q),
                dead_moment=potential if is_linear else None,
            )
        p, count = self.state.quaternion, len(times)
        return self._slid(Piece(times, States(np.tile(p, (count, 1)), np.zeros((count, 3))), means))

    def _dissipated(self, piece: Piece) -> Array:
        """Return the energy that friction takes in each interval of a piece: its work where no other load has any.

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
            along = self.sliding(W)
            K = self.torque(t, directors(p), W) + along
            if held:
                K = K - (self._inverse(held) @ (self.axes[held] @ (self.Q @ K))) @ self.axes[held]
            power[i], rate[i] = -along @ W, -along @ (self.Q @ K)
        h = np.diff(times)
        found: Array = (h / 2 * (power[1:] + power[:-1]) + h**2 / 12 * (rate[:-1] - rate[1:]))[None]
        return found


class Tumbling(Rubbed):
    """A body under dry friction against w: one contact, of the limit c, about the direction of W in plane motion."""

    has_twist = True

    def __init__(self, scheme: Integrator, problem: IVP) -> None:
        super().__init__(scheme, problem)
        self.is_plane = True

    def sliding(self, W: Array) -> Array:
        """Return the moment of friction, along the frame."""
        if self.is_plane or not W.any():
            return super().sliding(W)
        found: Array = -self.limits[0] * W / np.linalg.norm(W)
        return found

    def begin(self) -> None:
        """Choose the first mode."""
        W = self.state.velocity
        if W.any():
            self.modes = {0: 1}
            self.turn([W / np.linalg.norm(W)])
        else:
            self.settle([0], {})

    def settle(self, zero: Sequence[int], forced: Modes) -> None:
        """Choose the mode where W is zero; it is to slide if it is `forced`."""
        q, W = directors(self.state.quaternion), self.state.velocity
        W[:] = 0.0
        self.modes, self.is_plane = {0: 0}, True
        K = self._across(self.torque(self.t, q, W))
        if np.linalg.norm(K) > self.limits[0] or forced:
            start = self._rate_at_rest()
            u = start if start.any() else K
            self.modes = {0: 1}
            self.turn([u / np.linalg.norm(u)])

    def stillness(self, stuck: list[int], t: float, q: Array) -> float:
        """Return that friction holds all of a body at rest."""
        return 0.0

    def ends_of_rest(self, stuck: list[int]) -> list[Change]:
        """Return what can end it: the moment that is needed."""

        def left(t: float, s: Any) -> float:
            return float(self.limits[0] - np.linalg.norm(self._across(self.torque(t, s.directors, np.zeros(3)))))

        return [Change(0, 1, left)]

    def advance(self) -> None:
        """March while modes stay, to a node at most."""
        if not self.modes[0]:
            super().advance()
            return
        self.is_plane = self.is_plane and self._slide_in_plane()
        if not self.is_plane:
            self._slide_around()

    def _across(self, K: Array) -> Array:
        """Return a moment across the constrained axis."""
        return K - (self.axis @ K) @ self.axis

    def _rate_at_rest(self) -> Array:
        """Return W' at W = 0, against friction: 0 up to its limit."""
        from scipy.optimize import brentq

        K = self._across(self.torque(self.t, directors(self.state.quaternion), np.zeros(3)))
        basis = np.linalg.svd(np.concatenate([self.axis, np.zeros((1, 3))]))[2][len(self.axis) :]
        J, m, c = basis @ self.J @ basis.T, basis @ K, self.limits[0]
        if not c:
            rate: Array = np.linalg.solve(J, m) @ basis
            return rate
        if np.linalg.norm(m) <= c:
            return np.zeros(3)

        def direction_of(alpha: float) -> Array:
            u: Array = np.linalg.solve(alpha * J + c * np.eye(len(J)), m)
            return u

        most = float(np.linalg.norm(m) / np.linalg.eigvalsh(J)[0])
        alpha = float(brentq(lambda x: float(np.linalg.norm(direction_of(x))) - 1.0, 0.0, most, xtol=EPS * most))
        found: Array = alpha * direction_of(alpha) @ basis
        return found

    def _slide_in_plane(self) -> bool:
        """March under a moment of constant direction in the body; return whether W kept to it: else nothing is kept."""
        one = replace(self.until(PLANE, self.time_left()), load=self.under(self.sliding(self.state.velocity)))
        piece, root = self.marched(one, self.changes([0]), at_nodes=True)
        W = piece.states.velocity
        if self.failure is not None or abs(np.cross(W, self.axes[0])).max() > IN_PLANE * abs(W).max():
            self.failure = None
            return False
        self.keep(self._slid(piece))
        if root is not None:
            self.settle([0], {})
        return True

    def _slide_around(self) -> None:
        """March while W may turn, or, where it may vanish within four steps, a part of that time."""
        one, c, W = self.until(), self.limits[0], self.state.velocity
        h, load = one.grid.longest, self.load + against(c)
        if not W.any():
            self._start(h)
            return

        def time_left(t: float, s: Any) -> float:
            w = np.array(s.material_angular_velocity)
            size = np.linalg.norm(w)
            rate = self.Q @ (self.torque(t, s.directors, w) - c * w / size)
            return float(QUARTER * size / np.linalg.norm(rate)) if rate.any() else np.inf

        left = time_left(self.t, body_state(self.t, *(x.tolist() for x in self.state[:2])))
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
        K = self.torque(begin, directors(self.state.quaternion), np.zeros(3))
        is_slow = np.linalg.norm(a) <= SLOW * np.linalg.norm(self.inverse @ K)
        to = min(begin + max((SLOWLY if is_slow else BEGIN) * h, TICKS * float(np.spacing(abs(begin)))), node)
        along = self.under(self.sliding(self.state.velocity))
        self.keep(self._slid(self.marched(replace(self.to(to), load=along), [])[0]))
        b = self._rate_at_rest()
        self.state.velocity[:] = (to - begin) / 2 * (a + b)
        if not self.state.velocity.any():
            self.settle([0], {})


@lru_cache(maxsize=64)
def against(limit: float) -> Load:
    """Return the moment -limit w/|w|, of which nobody asks at w = 0."""

    def friction(t: float, directors: Array, w: Array) -> Any:
        return -limit * w / np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])

    return moment(friction, compiled=True)
