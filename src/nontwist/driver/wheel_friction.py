"""Dry friction in the bearings of wheels: their contacts (`contacts`), which stand in the body, or slip.

With the momenta h and speeds Ω of wheels about n_a (`loads.wheels`), r_a = τ_a - f_a(Ω_a) what acts on each beside dry
friction, λ_a in c_a Sgn(Ω_a), the carrier's inertia J_c, M the moments of all else and μ that of a constrained axis n,

    h_a' = r_a - λ_a,        J_c W' = (J_c W + Σ h n) × W + M - Σ (r_a - λ_a) n_a - μ n.

The rates of the contacts are the speeds Ω. With Q = J_c⁻¹, across n under a constraint (``Q - Q n nᵀQ/n·Qn``), N the
rows n_a and ``K = (J_c W + Σ h n) × W + M - Σ r n``,

    W' = Q (K + Nᵀλ),        b = I⁻¹ r - N Q K,        S = I⁻¹ + N Q Nᵀ, positive definite.

- Slipping, ``λ = σ c`` is a constant torque, which takes c |Ω|.
- Standing, ``h = I n·W``. The wheel is part of the body, whose J is that with all wheels locked, and does nothing else.

An impulse p between wheel and body, ``W ← W + Q Nᵀ p``, keeps the total momentum, which does not feel λ in any mode.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from ..geometry.arrays import Array, cross
from ..integrators.base import IVP, Integrator
from ..integrators.wheels import carrier, places
from ..loads import Load
from ..loads.calls import checked
from ..loads.memory import MOMENTS
from ..loads.wheels import Slipping, Standing, Wheel
from .contacts import Contacts, Phase, torque
from .events import Piece


class Bearings(Contacts):
    """A body with wheels, in some of whose bearings, the contacts, there is dry friction.

    Attributes
    ----------
    wheels, places : of each wheel a, and the place of h among the internal states
    dry : numbers of the wheels of the contacts
    """

    def __init__(self, scheme: Integrator, problem: IVP) -> None:
        super().__init__(scheme, problem, problem.load)
        found = list(places(self.load))
        self.wheels, self.places = [one.unscaled for one, _ in found], np.array([place for _, place in found])
        self.dry = [a for a, one in enumerate(self.wheels) if one.is_dry]
        self.beside = [term for term in self.load.remembering if not isinstance(term, Wheel)]
        self.plain = Load(tuple(term for term in self.load.terms if term not in self.load.remembering))
        self.limits = np.array([self.wheels[a].coulomb for a in self.dry])
        self.inertia = np.array([one.inertia for one in self.wheels])
        self.axes = np.array([one.direction for one in self.wheels])
        self.Q = np.linalg.inv(carrier(self.body, self.load).convected_inertia)
        if (n := self.body.axis) is not None:
            self.Q -= np.outer(self.Q @ n, self.Q @ n) / (n @ self.Q @ n)
        self.N = self.axes[self.dry]
        self.S = np.diag(1 / self.inertia[self.dry]) + self.N @ self.Q @ self.N.T
        self._slipping = dict[tuple[int, int], Wheel]()

    def rates(self, W: Array, z: Array) -> Array:
        """Return Ω."""
        found: Array = z[self.places[self.dry]] / self.inertia[self.dry] - self.N @ W
        return found

    def noise(self, W: Array, z: Array) -> Array:
        """Return the sizes of what Ω is the difference of."""
        found: Array = abs(z[self.places[self.dry]] / self.inertia[self.dry]) + abs(self.N @ W)
        return found

    def kick(self, contacts: Sequence[int], p: Array) -> None:
        """Change W and h by impulses between wheels and body."""
        own, (_, W, *_, z) = [self.dry[k] for k in contacts], self.state
        assert z is not None
        W += self.Q @ (p @ self.axes[own])
        z[self.places[own]] = self.inertia[own] * (self.axes[own] @ W)

    def free(self, t: float, q: Array, W: Array, z: Array) -> Array:
        """Return I⁻¹ r - N Q K; `z` are all internal states, of which those of standing wheels follow from W."""
        h, n = z[self.places], self.axes
        standing = [self.dry[k] for k, sign in self.modes.items() if not sign]
        h[standing] = self.inertia[standing] * (n[standing] @ W)
        r = np.array(
            [one.responses(checked, t, (x,), None, W)[1][0] for one, x in zip(self.wheels, h.tolist(), strict=True)]
        )
        K = torque(self.body, self.plain, t, q, W) + cross((h - self.inertia * (n @ W)) @ n, W) - r @ n
        place = len(z) - sum(term.state0.size for term in self.beside)
        for term in self.beside:
            own = z[place : place + term.state0.size]
            found = term.text(checked, [*q.ravel().tolist(), *(W @ q).tolist(), *W.tolist(), *own.tolist(), t])
            K = K + term.scale * (q @ np.array(found[:3]) + np.array(found[3:MOMENTS]))
            place += len(own)
        b: Array = r[self.dry] / self.inertia[self.dry] - self.N @ (self.Q @ K)
        return b

    def phase(self, stuck: list[int]) -> Phase:
        """Return the smooth problem in which these wheels stand and all others slip."""
        return Phase(self.body, self._loaded(), self.changes(list(self.modes)), partial(self._stood, stuck))

    def _loaded(self) -> Load:
        """Return the load with wheels that slip or stand as the modes say."""
        modes, wheels = {self.dry[k]: sign for k, sign in self.modes.items()}, iter(enumerate(self.wheels))

        def term_of(wheel: Wheel) -> Wheel:
            number, own = next(wheels)
            if number not in modes:
                return wheel
            key = number, modes[number]
            if key not in self._slipping:
                self._slipping[key] = (Slipping if modes[number] else Standing).of(own, modes[number])
            return self._slipping[key]

        return Load(tuple(term_of(term) if isinstance(term, Wheel) else term for term in self.load.terms))

    def _stood(self, stuck: list[int], piece: Piece) -> Piece:
        """Return a piece with the momenta of standing wheels, which follow from W."""
        own, (_, W, *_, z) = [self.dry[k] for k in stuck], piece.states
        assert z is not None
        z[:, self.places[own]] = self.inertia[own] * (W @ self.axes[own].T)
        return piece
