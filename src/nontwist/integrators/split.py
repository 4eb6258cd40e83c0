"""split: exact free motion, with the load as quadrature or kicks.

Non-twisting body (any principal axis n). With body components Π_⊥ the split form (eq-nonholonomic-red, with moments)
is

    Π_⊥' = M_⊥,        Λ' = Λ Ŵ,        W = J_⊥⁻¹ Π_⊥,

so the momentum is a quadrature of the moment in the moving frame, and the attitude a product of exponentials.

- Moments given along the moving frame: M(t) at Gauss nodes, Π_⊥ at the nodes by the Gauss Runge-Kutta matrix, and
  Λ_{n+1} = Λ_n exp(Ω̂) with the Magnus expansion of order 2, 4, 6 (`engine.marching`), for order 4 Ω = h (W_1 + W_2)/2 +
  (√3/12) h² W_1 × W_2.
- Moments fixed in space, gravity, loads of the state: M at Λ_m = Λ_n exp(h Ŵ_m/2) with W_m = J_⊥⁻¹ (Π_n + Π_{n+1})/2,
  implicit in W_m and iterated to round-off; symmetric, of order 2; composed to orders 4 and 6 (`composition`).

Without load W is constant and the step exact, at any size. W·n = 0 at every node by construction: no twist. Without
moment K and Π_⊥ stand still; with one, ½ (W_n + W_{n+1})·ΔΠ is the change of K, which is the work.

Standard body. Half a step of exact free motion (`nontwist.exact`), the kick ΔΠ = h M(t_m, Λ, W + ½ ΔW) at a fixed
attitude, half a step of exact free motion: symmetric, of order 2, exact without load; composed to 4 and 6, where
the last half of one substep and the first of the next are one free motion. Each is an increment of full relative
accuracy in the principal frame (`nontwist.exact.free_step`), and all sums are compensated: K, π, W and Λ do not drift,
however small the steps and however long the load; steps with |λ h| > 1/2 may lose 2e-18 of K and π each. Load nodes
lie inside the step. There is no limit to the turn of a step but 1e15 rad, of which round-off leaves no digit: an
error.

Where no moment acts each segment is one exact motion, evaluated at each stored time from its start: no steps, no
accumulation of round-off. Pulses and tables act where they are not zero; gravity and functions act always.

The frame b is that of the engine with the principal axes in ascending order, or with the constrained axis as its third
direction; W_i = P_i/J_i. A moment of the velocity, or of the turn that it makes, is found by iteration for half the
change of W,

    y = (h/2) J⁻¹ M(W + y),

with a matrix of difference quotients where M depends on y so much that it does not shrink to a tenth.

What is observed is integrated over time by the values at the nodes of the load: Gauss nodes, or the middles of
substeps, which are symmetric in time and so have the order of the composition; in a free motion by four Gauss nodes a
step.

**Mean moment in space.** It is the impulse of the load over the length of the interval. A kick of the standard body,
and an implicit step, apply the moment at one attitude, so that on the standard body Δπ = h · moment to round-off;
both are symmetric in time, the composed steps have the mean in their order, and so has Λ_n exp(Ω̂/2) M(t_m) of order
8. Orders 4 and 6 of moments along the moving frame take the mean Σ b_i Λ(t_i) M(t_i) over their s Gauss nodes: a
quadrature of order 2s of the integral of Λ M, wherever Λ(t_i) is good enough. M is interpolated through the nodes by
a polynomial of degree s - 1, Π_⊥ by its integral, and Λ(t_i) = Λ_n exp(Ω̂_i) with the Magnus expansion of the part
[0, c_i h] of the step. The interpolation leaves M a multiple of the node polynomial P_s, Π_⊥ of its integral, Λ(t_i)
of its second integral δ(c_i) h^(s+2). For s = 2 that is h⁴. For s = 3 it is h⁵; but P_3 is odd about the middle of
the step, orthogonal to 1 - c, and so is δ odd, and Σ b_i δ(c_i) M(t_i) of h⁶. The impulse of an interval has its
order then, 4 and 6: what π gains is h · moment and what the reaction along the axis adds.

**Compositions** repeat a step of order 2 with fractions of h. If Φ_h is a symmetric method of order 2 and a
near-identity map, ``Φ_{γ_s h} ∘ ... ∘ Φ_{γ_1 h}`` with ``γ_i = γ_{s+1-i}`` and the order conditions ``Σ γ_i = 1``, ``Σ
γ_i³ = 0``, ... is symmetric and of the higher order, and it keeps every invariant that Φ keeps at every step size. The
middles of all substeps lie inside the step, so a load with kinks on the ends of steps costs no order.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from math import sqrt
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..engine.marching import FARTHEST, UNIT, Step, Text, exponential, magnus, turned_and_normalised, turned_by_vector
from ..engine.records import Parts, State
from ..engine.sampling import TINY, Loads, Nodes
from ..engine.workspace import add_to_integrals, observe
from ..exact.free_constants import BAD_TIME, CONSTANTS, Constants
from ..exact.free_step import free_motion, free_step, free_until, set_origin
from ..geometry.arrays import Array
from ..kernels.control import Variables, loop, when, whilst
from ..kernels.elements import larger, logical_not, real, select, smaller, without
from ..kernels.memory import View, scratch
from ..kernels.vectors import Matrix, Vector, attitude, compensated, cross, first_moment, inverse_of, sum_of, taxicab
from ..models.stack import is_principal, transverse_momentum
from .compiled import ONCE, Compiled
from .costs import Cost, steps_cost
from .gauss_coefficients import nodes as gauss_nodes
from .integrator import IVP, SPIN
from .load_samples import Unloaded, coefficients, lagrange_integrals

_SUZUKI = 1 / (4 - 4 ** (1 / 3))

# The first half of the fractions and the middle one.
HALVES: dict[int, tuple[float, ...]] = {
    2: (1.0,),
    # M. Suzuki, Fractal decomposition of exponential operators, Phys. Lett. A 146 (1990) 319.
    4: (_SUZUKI, _SUZUKI, 1 - 4 * _SUZUKI),
    # W. Kahan, R.-C. Li, Composition constants for raising the orders of unconventional schemes for ordinary
    # differential equations, Math. Comp. 66 (1997) 1089; to more digits in E. Hairer, C. Lubich, G. Wanner, Geometric
    # Numerical Integration, sec. V.3.2.
    6: (
        0.39216144400731413927925056,
        0.33259913678935943859974864,
        -0.70624617255763935980996482,
        0.08221359629355080023149045,
        0.79854399093482996339895035,
    ),
}


@cache
def fractions(order: int) -> Array:
    """Return the fractions γ_i of the step, (s,); one array for all callers."""
    half = HALVES[order]
    return np.array([*half, *half[-2::-1]])


@cache
def substep_nodes(order: int) -> Array:
    """Return where the middles of the substeps lie, as fractions of the step, (s,); one array for all callers."""
    gamma = fractions(order)
    return np.cumsum(gamma) - gamma / 2


ROTORS = (
    "split does not accept rotors and wheels: its free motion between the kicks is that of the body without them; use "
    "the integrator gauss"
)
NOT_PRINCIPAL = (
    "split needs a constrained axis that is principal, but J n differs from its part along n by {:.3g} kg m²; use the "
    "integrator gauss"
)
CONSTRAINED_NS = 400.0  # of a substep of a non-twisting body


@dataclass(frozen=True)
class Split(Compiled):
    """Exact free motion with quadrature or kicks of the load, orders 2, 4, 6; for standard and non-twisting bodies.

    Parameters
    ----------
    order : {4, 2, 6}

    Raises
    ------
    ValueError
        The scheme does not have this order; or, raised by a run, the constrained axis is not principal.

    Examples
    --------
    Without a load, steps of any length are exact:

    >>> from nontwist import nontwisting, rotation, simulate
    >>> from nontwist.integrators import Split
    >>> body = nontwisting([3, 4, 5])
    >>> run = simulate(body, t_end=1, step=0.5, material_angular_velocity=(0, 3, 0), integrator=Split())
    >>> rotation(run).magnitude().round(9)
    array([0. , 1.5, 3. ])
    """

    name: ClassVar[str] = "split"
    has_derivatives: ClassVar[bool] = False
    orders: ClassVar[tuple[int, ...]] = (2, 4, 6)
    together: ClassVar[float] = 1.0
    in_lanes: ClassVar[bool] = False
    substep_ns: ClassVar[float] = 550.0
    is_exact_without_load: ClassVar[bool] = True
    removed: ClassVar[Mapping[int, str]] = {
        8: "this order is gone, gauss has it: order=6, or integrator='gauss', order=8"
    }
    sources: ClassVar[Mapping[str, str]] = {
        "order": "eq-nonholonomic-red; Blanes, Casas & Ros 2000; Suzuki 1990; Kahan & Li 1997",
        "invariant": "eq-nonholonomic-red",
    }
    counts: ClassVar[dict[int, tuple[int, ...]]] = {**Compiled.counts, 6: (14, 18, 24)}
    order: int = 4

    @property
    def nodes(self) -> int:
        """Nodes of the load in a step, one in each substep."""
        return len(fractions(self.order))

    @property
    def largest_turn(self) -> float:
        """The turn per step up to which no substep turns the body by more than 60°, rad."""
        return float(np.pi / 3 / abs(fractions(self.order)).max())

    def turns_exactly(self, problem: IVP) -> bool:
        """Whether a step is an exponential: without load, and with a constrained axis under body-fixed moments."""
        is_constrained = problem.systems.axis is not None and not problem.systems.has_dead_force
        is_along_frame = all(term.kind == "body" for term in problem.load.terms)
        return super().turns_exactly(problem) or (is_constrained and is_along_frame)

    def lag(self, theta: float) -> float:
        """Return the error of a step for the turn `theta` of a steady rotation, rad."""
        gamma = fractions(self.order)
        return float(abs(np.sum(2 * np.arctan(gamma * theta / 2)) - theta))

    def text(self, motion: str) -> Text:
        """Return the text of the step."""
        return TEXT

    def motion(self, parts: Parts, is_nonprincipal: bool, has_vertical: bool) -> str:
        """Return whether the step is explicit: kicks of a standard body, quadrature of a non-twisting one."""
        return "explicit" if parts.is_along_frame and not (parts.is_constrained and parts.dead) else ""

    def stages(self, parts: Parts) -> tuple[Array, Array]:
        """Return the fractions of substeps and the nodes of the load; Gauss nodes for moments along the moving frame.

        Nodes of substeps are their middles.
        """
        if parts.is_constrained and parts.is_explicit:
            return ONCE, gauss_nodes(self.order)
        return fractions(self.order), substep_nodes(self.order)

    def refusal(self, problem: IVP) -> str | None:
        """Return why rotors, a prescribed spin, or a constrained axis that is not principal are not accepted."""
        systems, rotors = problem.systems, problem.load.rotors
        if rotors or systems.spin is not None:
            return ROTORS if rotors else SPIN.format(self.name)
        if systems.axis is None or is_principal(systems).all():
            return None
        i = int(np.argmin(is_principal(systems)))
        reason = NOT_PRINCIPAL.format(np.linalg.norm(transverse_momentum(systems)[i]))
        return f"member {i}: {reason}" if len(systems) > 1 else reason

    def cost(self, problem: IVP, states: int) -> Cost:
        """Return the estimated cost of `march`: that of the steps while moments act."""
        system, ns = problem.system, self.substep_ns if problem.system.axis is None else CONSTRAINED_NS
        unloaded = None if system.dead_force.any() else problem.load
        steps = problem.steps - int(Unloaded(problem, unloaded).before(np.array([problem.steps]))[0])
        is_quadrature = unloaded is not None and self.turns_exactly(problem) and problem.system.axis is not None
        return steps_cost(problem, steps, 1 if is_quadrature else self.nodes, ns)


# The step.

EPS, ITERATIONS = 2.0**-52, 50
DIFFERENCE = sqrt(EPS)


class GaussRule(NamedTuple):
    """Gauss nodes, weights, the matrix (a_ij), and the integrals of the Lagrange polynomials from 0 to c_i c_j."""

    substep_nodes: Array
    weights: Array
    matrix: Array
    inner: Array


@cache
def gauss_rule(s: int) -> GaussRule:
    """Return the coefficients of s Gauss nodes; the attitude at a single one is turned by half the step."""
    c = gauss_nodes(2 * s)
    inner = lagrange_integrals(c, np.outer(c, c)) if s > 1 else np.full((1, 1, 1), 0.5)
    matrix, weights = coefficients(tuple(c.tolist()))
    return GaussRule(c, weights, matrix, inner)


def rotated(state: State, cosm1: Any, v: Vector, dP: Vector) -> tuple[State, Any]:
    """Return the state turned by the quaternion (1 + cosm1, v), P changed by dP; how far p was from unit length."""
    p, c, gap = turned_and_normalised(state.p, state.c, cosm1, v)
    P, compensation = compensated(state.s, state.compensation, dP)
    return State(p, P, compensation, c, state.auxiliary), gap


def flow(nodes: Nodes, start: State) -> Any:
    """Return what moves the body freely from a state on: of the time the state, and whether it turns too far."""
    body, W, zero = nodes.body, nodes.body.k * start.s, 0.0 * start.s
    if nodes.parts.is_constrained:
        return lambda t: (rotated(start, *exponential(t * W), zero)[0], is_too_far(t * W))
    constants = View(Constants, scratch(CONSTANTS))
    motion = free_motion(body.moments, start.s, constants)
    set_origin(motion, constants)

    def state_at(t: Any) -> tuple[State, Any]:
        status, dP, cosm1, v = free_until(motion, t, constants)
        return rotated(start, cosm1, v, dP)[0], status == BAD_TIME

    return state_at


def is_too_far(turn: Vector) -> Any:
    """Whether round-off leaves no digit of a turn; one that is no number is too far."""
    size = taxicab(turn)
    return (size > FARTHEST) | (size != size)


class StepSums:
    """What the substeps of a step give to means and sums, and to what is observed."""

    def __init__(self, nodes: Nodes) -> None:
        zero, self.nodes = 0.0 * nodes.body.k[0], nodes
        none = Vector(zero, zero, zero)
        self.sums = Variables(mu=zero, work=zero, moment=none, dead=none)
        self.before = nodes.x.observed.work if nodes.parts.observes else None

    def see(self, p: Any, W: Vector, weight: Any) -> None:
        """Take a state into the integrals over time of what is observed."""
        x = self.nodes.x
        if self.nodes.parts.observes:
            x.state.p, x.velocity, x.observed.work = p, W, self.before + self.sums.work
            observe(x, False)
            add_to_integrals(x, weight)

    def add(self, part: Any, mu: Any, work: Any, moment: Vector, dead: Vector) -> None:
        """Add what a substep gives, the means times its part of the step."""
        s = self.sums
        if self.nodes.parts.needs_means:
            s.mu, s.work = s.mu + part * mu, s.work + work
            s.moment, s.dead = s.moment + part * moment, s.dead + part * dead

    def completed(self, found: Step) -> Step:
        """Return the step with what it gives."""
        parts, s = self.nodes.parts, self.sums
        if parts.observes:
            self.nodes.x.observed.work = self.before
        if not parts.needs_means:
            return found
        dead = s.dead if parts.is_constrained and not parts.is_explicit else None
        return found._replace(twist=0.0 * s.mu, mu=s.mu, moment=s.moment, work=s.work, dead=dead)


def step(nodes: Nodes, state: State, is_active: Any) -> Step:
    """Take the step."""
    parts = nodes.parts
    return quadrature(nodes, state) if parts.is_constrained and parts.is_explicit else composed(nodes, state)


def quadrature(nodes: Nodes, state: State) -> Step:
    """Turn a constrained body, under moments along the moving frame: Π_⊥ by quadrature, Ω by its Magnus expansion."""
    parts, k, h, P, zero, s = nodes.parts, nodes.body.k, nodes.h, state.s, 0.0 * state.s, nodes.parts.nodes
    rule, means = gauss_rule(s), StepSums(nodes)
    M = [nodes.moving(j) if parts.moving else zero for j in range(s)]
    across = [Vector(B[0], B[1], zero[2]) for B in M]

    def momentum(weights: Array) -> Vector:
        return P + change(weights)

    def change(weights: Array) -> Vector:
        return h * sum_of(*(float(w) * B for w, B in zip(weights, across, strict=True)))

    Pi, dP = [momentum(row) for row in rule.matrix], change(rule.weights)
    W = [k * x for x in Pi]
    turn = magnus(h, W)
    after, gap = rotated(state, *exponential(turn), dP)
    if parts.needs_means:
        for c, weight, inner, B, x, w in zip(*map(list, rule[:2]), rule.inner, M, Pi, W, strict=True):
            until = turned_by_vector(state.p, magnus(float(c) * h, [k * momentum(row) for row in inner]))
            means.see(until, w, h * float(weight))
            means.add(float(weight), cross(x, w)[2] + B[2], 0.0 * h, attitude(until) @ B, zero)
        means.sums.work = dP @ (k * (P + 0.5 * dP))
    far, none = is_too_far(h * (k * P)), zero[0]
    return means.completed(Step(after, none > 1.0, far, gap, none, gap, abs(h) * taxicab(k * P)))


def composed(nodes: Nodes, state: State) -> Step:
    """Take the substeps of a composition, each of order 2, up to one that cannot be taken."""
    parts, body, h, zero = nodes.parts, nodes.body, nodes.h, 0.0 * state.s[0]
    never, first, means = zero > 1.0, nodes.node, StepSums(nodes)
    v = Variables(state=state, half=zero, gap=zero, used=zero, residual=zero, far=never, stalled=never)

    def is_fine() -> Any:
        return without(v.gap <= UNIT, v.far | v.stalled)

    def drift(t: Any) -> None:
        status, dP, cosm1, turn = free_step(body.moments, v.state.s, t, View(Constants, scratch(CONSTANTS)))
        v.far = status == BAD_TIME
        v.state, v.gap = rotated(v.state, cosm1, turn, dP)

    count = parts.nodes
    for i in loop(count if parts.is_constrained else count + 1, whilst=is_fine):
        part = select(i < count, nodes.block.fractions[smaller(i, count - 1)], 0.0)
        length = h * part
        if parts.is_constrained:
            v.far = is_too_far(length * (body.k * v.state.s))
        else:  # half a free motion, and with it the half that is left of the substep before
            drift(v.half + 0.5 * length)
            v.half = 0.5 * length
        for _ in when(without(i < count, v.far) & (v.gap <= UNIT)):
            nodes.begin(first + i, v.state.p)
            kick(nodes, length, part, v, means)
    residual, turn = select(v.stalled, v.residual, v.gap), abs(h) * taxicab(body.k * v.state.s)
    return means.completed(Step(v.state, v.stalled, v.far, v.gap, v.used, residual, turn))


def kick(nodes: Nodes, h: Any, part: Any, v: Variables, means: StepSums) -> None:
    """Change the momentum by the moments of a substep; turn a constrained body."""
    parts, k, now, mu = nodes.parts, nodes.body.k, v.state, 0.0 * h
    if parts.is_explicit:
        (torque, load), R = total_moments(nodes.loads(), k * now.s), nodes.R
    else:
        v.stalled, used, v.residual, (torque, load, R) = solve_for_change(nodes, h, now)
        v.used = larger(used, v.used)
    dP = h * Vector(torque[0], torque[1], torque[2] * nodes.body.free)
    middle = now.s + 0.5 * dP
    V = k * middle
    turn = h * V
    means.see(turned_by_vector(now.p, 0.5 * turn) if parts.is_constrained else now.p, V, h)
    if parts.is_constrained:
        mu = cross(middle, V)[2] + torque[2]
        v.state, v.gap = rotated(now._replace(auxiliary=(0.5 * torque[0], 0.5 * torque[1])), *exponential(turn), dP)
    else:
        P, compensation = compensated(now.s, now.compensation, dP)
        v.state = now._replace(s=P, compensation=compensation)
    means.add(part, mu, h * (V @ load), R @ load, R @ (torque - load))


def total_moments(loads: Loads, W: Vector) -> tuple[Vector, Vector]:
    """Return all moments, and those of the load without dead forces and potentials."""
    zero, moment, own = 0.0 * W, None, None
    if loads.functions is not None:
        moment = loads.functions.moment(zero, W)
        own = loads.functions.load(moment)
    drag = None if loads.damping is None else -(loads.damping @ W)
    applied = sum_of(loads.moving, loads.space, drag)
    dead = None if loads.dead is None else first_moment(loads.dead)
    return sum_of(applied, moment, dead) or zero, sum_of(applied, own) or zero


def solve_for_change(nodes: Nodes, h: Any, start: State) -> tuple[Any, Any, Any, tuple[Vector, Vector, Matrix]]:
    """Solve for y; return whether it is not found, iterations, the residual, and the moments and where they act.

    A change of y for a difference quotient is small beside W, and round-off of the residual small beside the change.
    """
    parts, k, node, W = nodes.parts, nodes.body.k, nodes.node, nodes.body.k * start.s
    zero, loads, f = 0.0 * W, nodes.loads(), (0.5 * h) * k

    def at(y: Vector) -> tuple[Vector, tuple[Vector, Vector, Matrix]]:
        there = loads
        if parts.is_constrained:
            nodes.begin(node, turned_by_vector(start.p, (0.5 * h) * (W + y)))
            there = nodes.loads()._replace(moving=loads.moving)
        torque, load = total_moments(there, W + y)
        return f * torque, (torque, load, nodes.R)

    e0, e1, e2 = (Vector(*(float(i == j) for j in range(3))) + zero for i in range(3))
    guess = h * (k * Vector(start.auxiliary[0], start.auxiliary[1], zero[0])) if parts.is_constrained else zero
    v = Variables(y=guess, inverse=Matrix(e0, e1, e2), columns=(e0, e1, e2), residual=taxicab(W), size=1e300 + zero[0])
    v.moments, v.count, v.active, v.found = (zero, zero, Matrix(zero, zero, zero)), 0, True, False
    for _ in whilst(lambda: v.active & (abs(h) * taxicab(W + v.y) <= FARTHEST)):
        value, v.moments = at(v.y)
        r, before = v.y - value, v.residual
        v.residual = taxicab(r)
        for _ in when(v.residual > 0.1 * before):
            e = DIFFERENCE * larger(larger(taxicab(W + v.y), 1e-4 * v.residual), TINY)
            v.columns = e0, e1, e2
            for j in loop(2 if parts.is_constrained else 3):
                shifted = Vector(*(x + select(j == i, e, 0.0) for i, x in enumerate(v.y)))
                v.columns = v.columns[1], v.columns[2], (1.0 / e) * ((shifted - at(shifted)[0]) - r)
            c0, c1, c2 = v.columns
            v.inverse = inverse_of(c1, c2, c0) if parts.is_constrained else inverse_of(c0, c1, c2)
        d = v.inverse @ r
        v.y, size, is_small = v.y - d, taxicab(d), v.residual < 1e300
        level = larger(taxicab(W + v.y), TINY)
        v.found = is_small & ((size <= EPS * level) | ((size > 0.5 * v.size) & (size <= 1e-9 * level)))
        v.size, v.count = size, v.count + 1
        v.active = without(is_small & (size < 1e300) & (v.count < ITERATIONS), v.found)
    return logical_not(v.found), real(v.count), v.residual, v.moments


TEXT = Text(step, auxiliary=2, integrates=True, flow=flow)
