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

With the momenta h and the speeds Ω of wheels about axes n_a (`loads.memory_terms`), r_a what acts on each beside dry
friction, J_c the inertia of what carries them, Q = J_c⁻¹, across a constrained axis n ``B (BᵀJ_c B)⁻¹ Bᵀ`` of a basis
B, and M the moments of all else,

    J_c W' = K - Gᵀλ - μ n,        K = M + (J_c W + Σ h n) × W - Σ r n,        h_a' = r_a - λ_a,

the rows of G being the axes a of friction of the body, and -n of that in bearings. Hence ``W' = Q (K - Gᵀλ)``, ``μ = (n
- Q J_c n)·(K - Gᵀλ)`` and, with D that of bearings alone, 1/I,

    rates    G W + D h,        b = G Q K + D r,        S = G Q Gᵀ + D.

A wheel that stands is a part of the body, ``h = I n·W``; one that slips has the constant torque -λ, which takes c |Ω|.
An impulse p changes W by -Q Gᵀ p, and h of bearings by -p: the total momentum does not feel those in bearings.

`rubbing` marches: a body slides, sticks and rests. `completion` names other loads that jump with the state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from itertools import product
from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from ..geometry.arrays import Array, cross
from ..geometry.attitudes import States, directors
from ..integrators.integrator import IVP, Integrator
from ..integrators.load_samples import carrier, wheel_columns
from ..loads import Load
from ..loads.friction import ROUND_OFF
from ..loads.functions import checked
from ..loads.load import moment_at
from ..loads.memory_terms import Wheel
from ..models.system import DirectorSystem
from .starts import BodyState

TINY = float(np.finfo(np.float64).tiny)
STILL = 1e-12  # of what moments accelerate a body by: nothing
SCHEMES = "{} needs an integrator that splits its steps, gauss or lie-midpoint; {} does not"
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


class Contacts:
    """The contacts of a body under dry friction, its state, and the modes of these.

    Attributes
    ----------
    load : Load
        What acts in all modes.
    frictions : those of the body, whose contacts come first
    wheels, places : of each wheel a, and the place of h among the internal states
    dry : numbers of the wheels of the other contacts
    limits, G, D, S : of the contacts
    modes : dict
    """

    def __init__(self, scheme: Integrator, problem: IVP) -> None:
        self.scheme, self.problem, self.body = scheme, problem, problem.system
        self.load, self.frictions = problem.load.without_frictions, problem.load.frictions
        self.t, self.modes = problem.t_start, Modes()
        z = None if problem.internal is None else problem.internal[0].copy()
        self.state = States(problem.quaternion[0].copy(), problem.velocity[0].copy(), internal=z)
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
        self._inverse = cache(lambda *contacts: np.linalg.pinv(self.S[np.ix_(contacts, contacts)], hermitian=True))

    # ---- rates and forces

    def rate(self, k: int, W: Sequence[float], z: Any) -> tuple[float, float]:
        """Return the rate of a contact, and the size of the numbers that it is the sum of."""
        (a, b, c), (x, y, s) = self.G[k].tolist(), W
        own = self.D[k] * z[self.places[self.dry[k - self.bearings]]] if k >= self.bearings else 0.0
        return own + a * x + b * y + c * s, abs(own) + sqrt(x * x + y * y + s * s)

    def rates(self) -> tuple[Array, Array]:
        """Return the rates of all contacts, and their signs: 0 of one that is round-off."""
        _, W, *_, z = self.state
        found, sizes = np.array([self.rate(k, W.tolist(), z) for k in range(len(self.limits))]).T
        return found, np.sign(found) * (abs(found) > ROUND_OFF * sizes)

    def forces(self, t: float, q: Array, W: Array, z: Any) -> tuple[Array, Array]:
        """Return K, and z', of wheels without dry friction; q: directors as rows, z: of standing wheels from W."""
        K = inertial_torque(self.body, self.plain, t, q, W)
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

    # ---- modes

    def begin(self) -> None:
        """Choose the first modes."""
        signs = self.rates()[1].tolist()
        self.modes = {k: int(sign) for k, sign in enumerate(signs) if sign}
        if zero := [k for k, sign in enumerate(signs) if not sign]:
            self.settle(zero, {})

    def holding(self, b: Array, modes: Modes) -> tuple[Array, Array]:
        """Return λ and r' of all contacts."""
        lam = np.array([modes.get(k, 0) * c for k, c in enumerate(self.limits.tolist())])
        if held := [k for k, sign in modes.items() if not sign]:
            lam[held] = self._inverse(*held) @ (b - self.S @ lam)[held]
        return lam, b - self.S @ lam

    def settle(self, zero: Sequence[int], forced: Modes) -> None:
        """Choose the modes of contacts whose rates are zero, but for those that are `forced`."""
        own, (_, W, *_, z) = list(zero), self.state
        self.kick(own, self._inverse(*own) @ self.rates()[0][own])
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


def refusal(scheme: Integrator, problem: IVP) -> str | None:
    """Return why a problem is not accepted, for its dry friction or for the integrator's reasons; None if it is."""
    own = problem.load.frictions
    if problem.load.is_dry and not scheme.splits_steps:
        return SCHEMES.format("dry_friction" if own else "coulomb= of a wheel", scheme.name)
    if not own:
        is_free = problem.systems.spin is None or not problem.load.is_dry
        return scheme.refusal(problem) if is_free else WHEELS_SPIN
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


def inertial_torque(body: DirectorSystem, load: Load, t: float, q: Array, W: Array) -> Array:
    """Return J W' of a body without constraint under a load: M + J W × W; q: directors as rows."""
    m = moment_at(load, t, q, W @ q) + cross(q, body.dead_force).sum(axis=0)
    return q @ m + cross(body.convected_inertia @ W, W)
