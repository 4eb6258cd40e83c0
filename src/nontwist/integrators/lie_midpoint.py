"""The rotation-based energy-momentum step, for every body and every load: tangent velocities, order 2.

With W_m = ½ (W_n + W_{n+1}), a = h W_m/2, Λ_m = Λ_n M and M = (I - â)⁻¹, the mean of Λ_n and Λ_{n+1}, not renormalised,

    Λ_{n+1} = Λ_n cay(h W_m) = Λ_n (2M - I),
    Λ_{n+1} J W_{n+1} - Λ_n J W_n = h m(t_m, Λ_m, w_m) - h μ Λ_m n,        n·W_{n+1} = 0,

the second line for a constrained axis n; w_m = Λ_m W_m = Λ_n W_m, since M a = a. Multiplied by Λ_m⁻¹, and since
``M⁻¹ (2M - I) = I + â``, it reads in the body

    J (W_{n+1} - W_n) = h (J W_m × W_m + Λ_m⁻¹ m - μ n):

three unknowns, two under the constraint. A moment given in the moving frame is m = Λ_m B, so Λ_m⁻¹ m = B; one in space
f = Λ_nᵀ m gives (I - â) f; dead forces F_i = Λ_nᵀ f^i, of moment Σ d_{i,m} × f^i, give (I - s a aᵀ) Σ e_i × (I - â) F_i
with s = 1/(1 + |a|²), because M x × M y = s (I + â)(x × y).

Exact balances, up to the round-off of the solution:

- impulse: π_{n+1} - π_n = h m without a constraint (the second line itself), so free motion keeps π;
- work: K_{n+1} - K_n = W_m·J (W_{n+1} - W_n) = h W_m·Λ_m⁻¹ m = h w_m·m, since W_mᵀ M⁻¹ = W_mᵀ; the gyroscopic term
  and, with n·W_m = 0, the constraint do no work;
- K + V, when V = -Σ f^i·d_i: Δd_i = Λ_n (2M - 2I) e_i = h w_m × d_{i,m}, so -ΔV = Σ f^i·Δd_i = h w_m·Σ d_{i,m} × f^i;
- the vertical momentum of a body under gravity g and no constraint: Σ d_{i,m} × f^i is a product with g, so g·m = 0;
- Π_⊥ of the non-twisting body: W_m has no component along D3, which is principal, so J W_m × W_m is parallel to D3 and
  Π_⊥ changes by exactly h B_⊥ under a moment of the moving frame: free motion keeps W;
- tangent velocities: the state is (Λ, W), and ḋ_i = w × d_i at every node.

The step is symmetric. `gauss` has these balances at the orders 4 to 16.

Unknowns. The step is solved in the frame b of the engine: the principal axes where the body has no constraint, else a
frame whose third direction is the constrained axis and with J12 = 0. The unknown is half the change of the momentum,
``P_{n+1} = P_n + 2 z``; with Q = P_n + z the momentum of the step, Ω its velocity (Ω_i = Q_i/J_i, Ω_3 = 0 under the
constraint) and Q̃ = JΩ (Q itself but for Q̃_3 = J31 Ω1 + J32 Ω2 under the constraint) the equations read

    z = (h/2) [Q̃ × Ω + G(Ω)],        G = M - C Ω + c × Ω - c' + (I - â) f + (I - s a aᵀ) Σ e_i × (I - â) F_i,

M the moment along the frame, C damping, c the momentum of rotors, f what is given in space or by a function of the
state, F_i the dead forces. Under the constraint z_3 = 0, and the third line gives μ. With a prescribed spin c, of an
axis that is principal, P_3 = J3 c and Ω_3 = Q_3/J3 as of a free body, ``z_3 = J3 (c_{n+1} - c_n)/2`` is known, and μ is
less by J3 Δc/h. The momentum and not W is the unknown since the rounded (J2 - J3)/J1 of the equations for W would be
felt as a moment: Q × Ω has no component along Q, whatever 1/J_i has been rounded to, so |π| does not drift, and π = ΛP
does not turn.

The first guess of z/h is the value at this step of the parabola through the last three, which leaves two iterations as
a rule. Of a body whose constrained axis is principal, Q̃ × Ω is along the axis; under moments M alone z is explicit,
the first two components of (h/2) M.

Dissipation χ (`compiled`), for bodies without a constraint. The body turns, and its momentum with it, by

    Ω = W_m + g T × W_m,        W_m = J⁻¹ Q,        T = Q + c,

    Λ_{n+1} = Λ_n cay(hΩ),        J (W_{n+1} - W_n) = h (T × Ω + Λ_m⁻¹ m - c').

The total momentum is kept for any Ω that is in both. Where rotors are constant ``ΔK = W_m·J ΔW = h W_m·(T × Ω) = -h g
|T × W_m|² ≤ 0`` at any step, 0 in a permanent rotation alone. g = χh/tr J of order 1, χh² |W_m|/tr J of order 2. Under
a load the impulse is exact as before, and with A the work of the load on Ω

    Δ(K + V) - A = -g (Q × W_m)·J ΔW,

which has no sign.

The Jacobian of the equations is made by dual numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from ..engine.marching import Step, Text, midpoint_means, midpoint_step
from ..engine.newton import EPS, newton_solve
from ..engine.records import Parts, State
from ..engine.sampling import Loads, MomentOfStep, Nodes, mean
from ..kernels.elements import fma, select, sqrt
from ..kernels.vectors import Matrix, Vector, cross, first_moment, sum_of, taxicab
from .compiled import Dissipative


@dataclass(frozen=True)
class LieMidpoint(Dissipative):
    """The rotation-based energy-momentum step of order 2, for every body and load.

    Parameters
    ----------
    order : {2}
        With dissipation, 1 or 2.
    dissipation : float, 0 to 1
        χ: the degree to which each step dissipates the energy of nutation, with the momentum conserved; only for bodies
        without a constrained axis.

    Raises
    ------
    ValueError
        The scheme does not have this order; `dissipation` is outside its bounds, or the body of the run has a
        constrained axis.

    Examples
    --------
    >>> from nontwist import simulate, standard
    >>> from nontwist.integrators import LieMidpoint
    >>> start = {"material_angular_velocity": (0.1, 2, 0.1), "integrator": LieMidpoint()}
    >>> run = simulate(standard([3, 4, 5]), t_end=10, step=0.1, **start)
    >>> run.kinetic_energy.values[[0, -1]].round(9)
    array([8.04, 8.04])

    With dissipation, a rotation about the middle axis loses energy but no momentum:

    >>> start["integrator"] = LieMidpoint(order=1, dissipation=1)
    >>> run = simulate(standard([3, 4, 5]), t_end=80, step=0.025, **start)
    >>> run.kinetic_energy.values[[0, -1]].round(3)
    array([8.04 , 6.978])
    >>> run.spatial_momentum.values[[0, -1]].round(9)
    array([[0.3, 8. , 0.5],
           [0.3, 8. , 0.5]])
    """

    name: ClassVar[str] = "lie-midpoint"
    splits_steps: ClassVar[bool] = True
    orders: ClassVar[tuple[int, ...]] = (2,)
    removed: ClassVar[Mapping[int, str]] = {
        order: f"its higher orders are gone, gauss keeps the same invariants: integrator='gauss', order={order}"
        for order in (4, 6, 8)
    }
    is_a_stable: ClassVar[bool] = True
    substep_ns: ClassVar[float] = 200.0
    sources: ClassVar[Mapping[str, str]] = {
        "order": "Hairer, Lubich & Wanner, II.3",
        "invariant": "Simo & Wong 1991; nontwist.integrators.lie_midpoint",
    }

    @property
    def remembers(self) -> bool:  # type: ignore[override]
        """Whether it takes loads with memory: not with dissipation, which needs the momentum of wheels as T does."""
        return not self.dissipation

    def text(self, motion: str) -> Text:
        """Return the text of the step."""
        return TEXT

    def motion(self, parts: Parts, is_nonprincipal: bool, has_vertical: bool) -> str:
        """Return whether the step is explicit, as Q̃ × Ω is along the axis."""
        is_quadrature = parts.is_constrained and parts.is_along_frame and not (is_nonprincipal or parts.dead)
        return "explicit" if is_quadrature else ""


FORESEEN = 0.5  # rad in half a step: beyond it the parabola through the last rates is no guess


def step(nodes: Nodes, state: State, is_active: Any) -> Step:
    """Take the step: Newton's iteration for z, then the changes of P and of the rates, and the multiplier."""
    parts, body, h, P = nodes.parts, nodes.body, nodes.h, state.s
    f, k, loads = 0.5 * h, body.k, nodes.loads()
    # First guess, and those of the last two steps.
    rates = [Vector(*state.auxiliary[3 * i : 3 * i + 3]) for i in range(3)]
    zero, speed, of_state = 0.0 * P[0], taxicab(k * P), MomentOfStep(loads.functions, f, P, False)
    axial = 0.5 * nodes.spin() * (body.spin * (body.E[0] + body.E[1])) if parts.spin else zero

    def equations_at(z: Vector, is_new: Any) -> Any:
        moment = of_state.near(velocity_in_step(nodes, loads, P + z), is_new)

        def r(z: Vector) -> Vector:
            Q = P + z
            Om = velocity_in_step(nodes, loads, Q)
            return z - f * torque(nodes, loads, Q, Om, sum_of(loads.space, moment(Om)))

        return r

    def sizes(z: Vector, d: Vector) -> Any:
        Q = P + z
        Om = velocity_in_step(nodes, loads, Q)
        drag = abs(f) * taxicab(body.damping @ Om) if parts.damping else None
        terms = sum_of(taxicab(z) + abs(f) * taxicab(Q) * taxicab(Om), drag, of_state.size)
        return taxicab(k * d), EPS * (speed + taxicab(k * z)), terms

    guess, M, auxiliary = h * rates[0], loads.moving, state.auxiliary
    guess = Vector(guess[0], guess[1], axial) if parts.is_constrained else guess
    known = Vector(zero, zero, zero) if M is None else Vector(f * M[0], f * M[1], zero)
    solution = newton_solve(nodes, equations_at, sizes, guess, is_active, known if parts.is_explicit else None)
    z = solution.y
    if not parts.is_explicit:
        rate = (1.0 / h) * z
        parabola = select(abs(f) * speed <= FORESEEN, 3.0 * (rate - rates[1]) + rates[2], rate)
        auxiliary = (*parabola, *rate, *rates[1])
    Om = velocity_in_step(nodes, loads, P + z)
    solution = solution._replace(residual=2.0 * solution.residual)  # as of P, which changes by 2z
    found = midpoint_step(state, f * Om, 2.0 * z, auxiliary, solution)
    return with_means(nodes, loads, found, P, z, Om, axial) if parts.needs_means or parts.memory else found


def velocity_in_step(nodes: Nodes, loads: Loads, Q: Vector) -> Vector:
    """Return Ω: the velocity of the momentum Q, and what it turns by beside that under dissipation."""
    body, W = nodes.body, nodes.body.velocity_of(Q)
    if not nodes.parts.dissipates:
        return W
    (first, second), half = body.dissipation, 0.5 * nodes.h / (body.E[0] + body.E[1] + body.E[2])  # h/tr J
    g = half * (first + nodes.h * (second * sqrt(W @ W)))
    return fma(g, cross(sum_of(Q, loads.rotor), W), W)


def torque(nodes: Nodes, loads: Loads, Q: Vector, Om: Vector, m: Any) -> Vector:
    """Return Q̃ × Ω + G(Ω); m is all that is given in space."""
    a, off = 0.5 * nodes.h * Om, nodes.body.off
    if nodes.parts.is_constrained:
        Q = Vector(Q[0], Q[1], Q[2] + (off[0] * Om[0] + off[1] * Om[1]))
    g = cross(Q, Om)
    if (own := along_the_frame(loads, Om)) is not None:
        g = g + own
    if loads.dead is not None:
        g = g + dead_moment(loads.dead, a)
    return g if m is None else g + (m - cross(a, m))


def along_the_frame(loads: Loads, Om: Vector) -> Any:
    """Return M - C Ω + c × Ω - c', None where there is nothing of it."""
    drag = None if loads.damping is None else -(loads.damping @ Om)
    wheel = None if loads.rotor is None else cross(loads.rotor, Om) - loads.rotor_rate
    return sum_of(loads.moving, drag, wheel)


def dead_moment(F: Matrix, a: Vector) -> Vector:
    """Return ``(I - â) Σ M e_i × F_i = (I - s a aᵀ) k`` with ``k = Σ e_i × (F_i - a × F_i)``."""
    k = first_moment(F) - (F.trace * a - a @ F)
    return k - ((a @ k) / (1.0 + a @ a)) * a


def with_means(nodes: Nodes, loads: Loads, found: Step, P: Vector, z: Vector, Om: Vector, axial: Any) -> Step:
    """Return the step with the multiplier, moments and work."""
    parts, body, f = nodes.parts, nodes.body, 0.5 * nodes.h
    a, m, of_load = f * Om, loads.space, loads.space
    s, mu = 1.0 / (1.0 + a @ a), 0.0 * f
    if parts.calls:
        total = loads.functions.moment(a, Om)
        m, of_load = sum_of(m, total), sum_of(of_load, loads.functions.load(total))
    if parts.is_constrained:
        off, k = body.off, body.k
        mu = torque(nodes, loads, P + z, Om, m)[2] - (off[0] * k[0] * z[0] + off[1] * k[1] * z[1] + axial) / f
    own = along_the_frame(loads, Om)
    moment = sum_of(None if own is None else mean(s, a, own), of_load)
    return midpoint_means(nodes, loads.dead, found, a, moment, mu=mu)


def first_guess(h: Any, P: Vector, ahead: Vector) -> Any:
    """Return the rates of a step whose end is known, for the first guess."""
    return (*((0.5 / h) * (ahead - P)), *(0.0,) * 6)


TEXT = Text(step, auxiliary=9, first_guess=first_guess, is_midpoint=True)
