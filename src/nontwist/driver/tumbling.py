"""Dry friction against w: as about axes (`rubbing`), but that sticking is always rest.

Rest ends where the moment that is needed, M across the constrained axis n, exceeds c. Where W = 0 the body starts with
W' = α u, |u| = 1 and α > 0, ``(α J + c) u = M`` across n, whose |u| falls with α.

The moment has no limit as W → 0 but along a line, which is so in plane motion: there the direction u of W is that of an
axis. Otherwise W turns faster and faster as it vanishes, in the time s/|W'| or so, s = |W|, along a principal direction
in the end. Then steps are at most a quarter of this time, W falls by a part in each, and vanishes where that time is
1e-12 of a step. Where a body starts, friction pulls W at the rate c/(J s) to the direction of the W' above: for 1e-5 h,
or 1e-3 h where W' is 0 at first, it is taken to be there, W the integral of this W'. (In a shorter time the latter
would be lost in round-off.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from ..geometry.arrays import Array
from ..geometry.attitudes import directors
from ..integrators.base import IVP, Integrator
from ..integrators.problem import Intervals
from ..loads import Load, moment
from .events import XTOL
from .pieces import ULPS, Change, Modes, Piece
from .rubbing import Hold, Rubbed, along
from .starts import body_state

EPS = float(np.finfo(np.float64).eps)
PLANE = 256  # steps that are marched before modes are looked at again, in plane motion
QUARTER = 0.5  # of the time in which W may vanish
BEGIN, SLOWLY, TICKS = 1e-5, 1e-3, 4096  # of a step, or units in the last place of a time: a start, a slow one
SLOW = 1e-6  # of what moments accelerate a body by: a start where the moment just exceeds the limit
IN_PLANE = 1e-11  # of the largest |W|: velocities along a line


class Tumbling(Rubbed):
    """A body under dry friction against w: one contact, of the limit c.

    Attributes
    ----------
    direction : (3,) array
        That of W in plane motion.
    """

    def __init__(self, scheme: Integrator, problem: IVP) -> None:
        super().__init__(scheme, problem)
        self.direction: Array = np.zeros(3)
        self.is_plane = True

    def sliding(self, modes: Modes) -> Array:
        """Return the moment of friction, along the frame."""
        return -self.limits[0] * modes[0] * self.direction

    def sliding_at(self, W: Array) -> Array:
        """Return it where W is."""
        if not self.is_plane and W.any():
            self.direction = W / np.linalg.norm(W)
        return self.sliding(self.modes)

    def begin(self) -> None:
        """Choose the first mode."""
        if size := float(np.linalg.norm(self.state.velocity)):
            self.modes, self.direction = {0: 1}, self.state.velocity / size
        else:
            self.settle([0], {})

    def settle(self, zero: Sequence[int], forced: Modes) -> None:
        """Choose the mode where W is zero; it is to slide if it is `forced`."""
        q, W = directors(self.state.quaternion), self.state.velocity
        W[:] = 0.0
        self.modes, self.is_plane = {0: 0}, True
        M = self._across(self.torque(self.t, q, W))
        if np.linalg.norm(M) > self.limits[0] or forced:
            start = self._rate_at_rest()
            u = start if start.any() else M
            self.modes, self.direction = {0: 1}, u / np.linalg.norm(u)

    def hold(self, t: float, q: Array, stuck: list[int]) -> Hold:
        """Return what holds the body at rest."""
        M = self.torque(t, q, np.zeros(3))
        left = self.limits[0] - float(np.linalg.norm(self._across(M)))
        return Hold(left, 0, 1, True, float((self.axis @ M).sum()))

    def told(self, piece: Piece, means: Intervals) -> Intervals:
        """Return the means of a part, with what friction takes in it."""
        return means._replace(dissipated_energy=self._dissipated(piece))

    def _across(self, M: Array) -> Array:
        """Return a moment across the constrained axis."""
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

        def direction_of(alpha: float) -> Array:
            u: Array = np.linalg.solve(alpha * J + c * np.eye(len(J)), m)
            return u

        most = float(np.linalg.norm(m) / np.linalg.eigvalsh(J)[0])
        alpha = float(brentq(lambda x: float(np.linalg.norm(direction_of(x))) - 1.0, 0.0, most, xtol=EPS * most))
        found: Array = alpha * direction_of(alpha) @ basis
        return found

    def phase(self) -> None:
        """March while modes stay, to a node at most."""
        if not self.modes[0] and not self.state.velocity.any() and self.rest([0]):
            return
        self.is_plane = self.is_plane and self._slide_in_plane()
        if not self.is_plane:
            self._slide_around()

    def _slide_in_plane(self) -> bool:
        """March under a moment of constant direction in the body; return whether W kept to it: else nothing is kept."""
        x, y, z = self.direction.tolist()
        change = Change(0, 0, lambda t, s: along(x, y, z, s.material_angular_velocity))
        one = self.until(PLANE)
        load = self.under(self.sliding(self.modes))
        piece, root = self.marched(replace(one, load=load), [change], at_nodes=True)
        W = piece.states.velocity
        if self.failure is not None or abs(np.cross(W, self.direction)).max() > IN_PLANE * abs(W).max():
            self.failure = None
            return False
        self.keep(piece)
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
            rate = self.acceleration(self.torque(t, s.directors, w) - c * w / size)[0]
            return float(QUARTER * size / np.linalg.norm(rate)) if rate.any() else np.inf

        left = time_left(self.t, body_state(self.t, *(x.tolist() for x in self.state[:2])))
        if left > h:
            change = Change(0, 0, lambda t, s: min(time_left(t, s), 2 * h) - h)
            self.keep(self.marched(replace(one, load=load), [change])[0])
            return
        if left > QUARTER * max(XTOL * h, ULPS * np.spacing(abs(self.t))):
            node = float(self.nodes[self.number() + 1])
            to = node if node - self.t <= left else self.t + left
            self.keep(self.marched(replace(self.to(to), load=load), [])[0])
            return
        self.direction = W / np.linalg.norm(W)
        self.settle([0], {})

    def _start(self, h: float) -> None:
        """Let the body start to turn, for a short time, to the velocity that it has under the friction along it."""
        begin, node = self.t, float(self.nodes[self.number() + 1])
        a = self._rate_at_rest()
        M = self.torque(begin, directors(self.state.quaternion), np.zeros(3))
        is_slow = np.linalg.norm(a) <= SLOW * np.linalg.norm(self.inverse @ M)
        to = min(begin + max((SLOWLY if is_slow else BEGIN) * h, TICKS * float(np.spacing(abs(begin)))), node)
        self.keep(self.marched(replace(self.to(to), load=self.under(self.sliding(self.modes))), [])[0])
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
