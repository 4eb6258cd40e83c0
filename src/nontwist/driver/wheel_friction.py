"""Dry friction in the bearings of wheels: a run is taken apart where a wheel comes to stand in the body, or slips.

With the momenta h and speeds Ω of wheels about n_a (`loads.wheels`), r_a = τ_a - f_a(Ω_a) what acts on each beside dry
friction, λ_a in c_a Sgn(Ω_a), the carrier's inertia J_c, M the moments of all else and μ that of a constrained axis n,

    h_a' = r_a - λ_a,        J_c W' = (J_c W + Σ h n) × W + M - Σ (r_a - λ_a) n_a - μ n.

The law is the subdifferential of Σ c_a |Ω_a|, convex, and the mass matrix of body and wheels is positive, so from each
state there is one motion, as of a body under dry friction (`rubbing`). Each wheel has a mode of its own:

- slipping, Ω of one sign σ: ``λ = σ c``, a constant torque, which takes c |Ω|;
- standing, Ω = 0: ``h = I n·W``. The wheel is part of the body, whose J is that with all wheels locked: it is left out
  of the load. What holds it is ``λ = r(0) - I n·W'``, and it slips as soon as |λ| exceeds c.

The total momentum does not feel λ, which acts between body and wheel, in any mode.

Modes. With Q = J_c⁻¹, across n under a constraint (``Q - Q n nᵀQ/n·Qn``), N the rows n_a and
``K = (J_c W + Σ h n) × W + M - Σ r n``,

    W' = Q (K + Nᵀλ),        Ω' = I⁻¹ r - N Q K - S λ,        S = I⁻¹ + N Q Nᵀ, positive definite.

Where speeds are zero, Ω' decides: of each combination of standing and of slipping in either direction it is tried
whether |λ_a| <= c_a where Ω_a' = 0 and Ω_a' has the sign of λ_a elsewhere. One holds, since S is positive definite.

A mode ends at the root of σΩ, or of c ± λ (`pieces`). There the speed, which is round-off, is set to zero by an impulse
p between wheel and body, ``S p = Ω``, ``W ← W + Q Nᵀ p``, which keeps the total momentum and takes energy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array, cross
from ..geometry.attitudes import States, directors
from ..integrators.base import IVP, Integrator
from ..integrators.wheels import carrier, places
from ..loads import Load
from ..loads.calls import checked
from ..loads.friction import ROUND_OFF
from ..loads.memory import MOMENTS
from ..loads.terms import Term
from ..loads.wheels import Slipping, Wheel
from .pieces import Change, InPieces, Modes, Piece
from .rubbing import torque

STATES = 3  # of a wheel with friction: h, work, loss


class Bearings(InPieces):
    """A body with wheels, in some of whose bearings there is dry friction.

    Attributes
    ----------
    wheels, places : of each wheel a, and the place of h among the internal states
    dry : numbers of those with dry friction, the contacts
    """

    def __init__(self, scheme: Integrator, problem: IVP) -> None:
        super().__init__(scheme, problem, problem.load)
        found = list(places(self.load))
        self.wheels, self.places = [one.unscaled for one, _ in found], np.array([place for _, place in found])
        self.dry = [a for a, one in enumerate(self.wheels) if one.is_dry]
        self.rest = [term for term in self.load.remembering if not isinstance(term, Wheel)]
        self.plain = Load(tuple(term for term in self.load.terms if term not in self.load.remembering))
        self.inertia = np.array([one.inertia for one in self.wheels])
        self.axes = np.array([one.direction for one in self.wheels])
        self.Q = np.linalg.inv(carrier(self.body, self.load).convected_inertia)
        if (n := self.body.axis) is not None:
            self.Q -= np.outer(self.Q @ n, self.Q @ n) / (n @ self.Q @ n)
        self.S = np.diag(1 / self.inertia) + self.axes @ self.Q @ self.axes.T
        self._slipping = dict[tuple[int, int], Term]()

    # ---- what accelerates the wheels

    def acting(self, t: float, q: Array, W: Array, z: Array) -> tuple[Array, Array]:
        """Return K and r; `z` are all internal states."""
        h, n = z[self.places], self.axes
        r = np.array(
            [one.responses(checked, t, (x,), None, W)[1][0] for one, x in zip(self.wheels, h.tolist(), strict=True)]
        )
        K = torque(self.body, self.plain, t, q, W) + cross((h - self.inertia * (n @ W)) @ n, W) - r @ n
        place = len(z) - sum(term.state0.size for term in self.rest)
        for term in self.rest:
            own = z[place : place + term.state0.size]
            found = term.text(checked, [*q.ravel().tolist(), *(W @ q).tolist(), *W.tolist(), *own.tolist(), t])
            K = K + term.scale * (q @ np.array(found[:3]) + np.array(found[3:MOMENTS]))
            place += len(own)
        return K, r

    def holding(self, K: Array, r: Array, modes: Modes) -> tuple[Array, Array]:
        """Return λ and Ω' of all wheels."""
        lam = np.array([modes.get(a, 0) * one.coulomb for a, one in enumerate(self.wheels)])
        free = r / self.inertia - self.axes @ (self.Q @ K)
        if held := [a for a, sign in modes.items() if not sign]:
            lam[held] = np.linalg.solve(self.S[np.ix_(held, held)], (free - self.S @ lam)[held])
        return lam, free - self.S @ lam

    # ---- modes

    def begin(self) -> None:
        """Choose the first modes."""
        assert self.state.internal is not None
        turning, axial = self.state.internal[self.places] / self.inertia, self.axes @ self.state.velocity
        speeds, noise = turning - axial, ROUND_OFF * (abs(turning) + abs(axial))
        self.modes = {a: 1 if speeds[a] > 0 else -1 for a in self.dry if abs(speeds[a]) > noise[a]}
        if zero := [a for a in self.dry if a not in self.modes]:
            self.settle(zero, {})

    def settle(self, zero: Sequence[int], forced: Modes) -> None:
        """Choose the modes of wheels whose speeds are zero; those that are `forced` slip."""
        W, z, own = self.state.velocity, self.state.internal, list(zero)
        assert z is not None
        speeds = (z[self.places] / self.inertia - self.axes @ W)[own]
        W += self.Q @ (np.linalg.solve(self.S[np.ix_(own, own)], speeds) @ self.axes[own])
        z[self.places[own]] = self.inertia[own] * (self.axes[own] @ W)
        K, r = self.acting(self.t, directors(self.state.quaternion), W, z)
        free = [a for a in zero if a not in forced]
        for signs in product((0, 1, -1), repeat=len(free)):
            modes = self.modes | forced | dict(zip(free, signs, strict=True))
            lam, rates = self.holding(K, r, modes)
            if all(modes[a] * rates[a] > 0 if modes[a] else abs(lam[a]) <= self.wheels[a].coulomb for a in free):
                self.modes = modes
                return
        self.modes |= forced | dict.fromkeys(free, 0)  # at a limit, to round-off

    # ---- from mode to mode

    def phase(self) -> None:
        """March while modes stay, to a node at most."""
        standing = [a for a, sign in self.modes.items() if not sign]
        one, left = self.until(), self._columns(standing)
        assert one.internal is not None
        kept = np.delete(np.arange(one.internal.shape[1]), left)
        changes = [change for a in self.dry for change in self._changes(a, standing, kept)]
        one = replace(one, load=self._loaded(), internal=one.internal[:, kept] if len(kept) else None)
        piece, root = self.marched(one, changes)
        self.keep(piece._replace(states=self._whole(piece, standing, kept)))
        if root is not None:
            zero = standing if root.sign else [*standing, root.contact]
            self.modes = {a: sign for a, sign in self.modes.items() if a not in (*zero, root.contact)}
            self.settle(zero, {root.contact: root.sign} if root.sign else {})

    def _columns(self, standing: list[int]) -> list[int]:
        """Return the internal states of standing wheels."""
        return [int(self.places[a]) + k for a in standing for k in range(STATES)]

    def _loaded(self) -> Load:
        """Return the load with wheels that slip as the modes say, without those that stand."""
        number, terms = 0, list[Term]()
        for term in self.load.terms:
            if not isinstance(term, Wheel):
                terms.append(term)
                continue
            sign = self.modes.get(number, None)
            if sign is None:
                terms.append(term)
            elif sign:
                key = number, sign
                self._slipping[key] = self._slipping.get(key) or Slipping.of(term.unscaled, sign)
                terms.append(self._slipping[key])
            number += 1
        return Load(tuple(terms))

    def _whole(self, piece: Piece, standing: list[int], kept: NDArray[np.int64]) -> States:
        """Return the states of a part with all internal states: those of standing wheels follow from W."""
        own = piece.states
        assert self.state.internal is not None
        z = np.tile(self.state.internal, (len(piece.times), 1))
        if own.internal is not None:
            z[:, kept] = own.internal
        z[:, self.places[standing]] = self.inertia[standing] * (own.velocity @ self.axes[standing].T)
        return own._replace(internal=z)

    def _changes(self, a: int, standing: list[int], kept: NDArray[np.int64]) -> list[Change]:
        """Return what can end the mode of a wheel: its speed vanishes, or what holds it reaches its limit."""
        sign, c, modes = self.modes[a], self.wheels[a].coulomb, dict(self.modes)
        if sign:
            place, inertia = int(np.searchsorted(kept, self.places[a])), self.wheels[a].inertia
            x, y, z = self.axes[a].tolist()

            def speed(t: float, s: Any) -> float:
                W = s.material_angular_velocity
                found: float = sign * (s.internal_state[place] / inertia - (x * W[0] + y * W[1] + z * W[2]))
                return found

            return [Change(a, 0, speed)]
        assert self.state.internal is not None
        known, internal = dict[Any, float](), self.state.internal.copy()

        def held(t: float, s: Any) -> float:
            if (key := (t, s._numbers)) not in known:  # both functions ask for it
                W = np.array(s.material_angular_velocity)
                internal[kept] = s.internal_state
                internal[self.places[standing]] = self.inertia[standing] * (self.axes[standing] @ W)
                known[key] = float(self.holding(*self.acting(t, s.directors, W, internal), modes)[0][a])
            return known[key]

        return [Change(a, 1, lambda t, s: c - held(t, s)), Change(a, -1, lambda t, s: c + held(t, s))]
