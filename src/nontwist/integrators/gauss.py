"""Gauss collocation in the momentum and in the space axes seen from the body: orders 2, 4, 6, 8, 12, 16.

Unknowns. P = J W, and the rows of C = Λ_nᵀ Λ: the axes of the frame of the beginning of the step, seen from the body.
With the moment M along the moving frame, m in space, drag C_d, dead forces f^j, and μ for a constrained axis n,

    P' = P × W + M - C_d W + Λ⁻¹ m + Σ e_j × Λᵀ f^j - μ n,        c_k' = c_k × W,        n·W = 0.

s stages at Gauss nodes c_i: ``Y_i = y_n + h Σ a_ij F(Y_j)``, ``y_{n+1} = y_n + h Σ b_j F(Y_j)``, symmetric, of order
2s; the one-stage member is `lie_midpoint`, but for dead forces, whose moment there is ``C⁻¹ Σ C e_j × Λ_nᵀ f^j``. Since
``b_i a_ij + b_j a_ji = b_i b_j``, a bilinear function Q(y, z) changes by

    Q(y_{n+1}, z_{n+1}) - Q(y_n, z_n) = h Σ b_i [Q(F_i, Z_i) + Q(Y_i, G_i)],

F, G the derivatives at the stages, at any step and for any sequence of steps (Cooper 1987; Hairer, Lubich & Wanner,
IV.2.1): what a bilinear function does along a motion it does stage by stage, and exactly. Orthonormality is one:
``(c_k·c_l)' = 0``. W is linear in P, so these are, up to the round-off of the solution, with Λ_i = Λ_n C_i:

- impulse: π = Λ P, whose rows are c_k·P, and ``(c_k × W)·P + c_k·(P × W) = 0``, so Δπ = h Σ b_i (Λ_i (M_i - C_d W_i) +
  m_i + Σ d_{j,i} × f^j - μ_i Λ_i n): free motion keeps π. For this a moment in space enters as Λ_i⁻¹ m_i, not as
  Λ_iᵀ m_i: the stages are not orthonormal;
- work: K = ½ P·W, so ΔK = h Σ b_i W_i·(M_i - C_d W_i + Λ_i⁻¹ m_i + Σ e_j × Λ_iᵀ f^j); gyration and the constraint do no
  work, also that of a Suslov body; drag alone never lets K rise, ``ΔK = -h Σ b_i W_i·C_d W_i``, whatever the step is;
- K + V: V = -Σ f^j·d_j is linear in the rows, and -ΔV = h Σ b_i Σ_j f^j·Λ_i (W_i × e_j) = h Σ b_i W_i·Σ e_j × Λ_iᵀ f^j;
- the vertical momentum γ·P of a body under gravity, γ = Λᵀ e: the moment of weight is a product with γ;
- Π_⊥ of the non-twisting body: P × W is parallel to n, so it changes by h Σ b_i M_⊥,i; free motion keeps W;
- tangent velocities, n·W = 0 at stages and nodes, no twist: the state is (Λ, P), n·W = 0 is linear.

Potentials V of γ = Λᵀa act by the torque γ_i × ∂V/∂γ at the stages, and ``γ' = γ × W``. As γ is linear in the rows,
``½ γ·Qγ`` is a quadratic function of the unknowns and changes stage by stage by ``-W_i·(γ_i × Qγ_i)``: K + V and γ·P
stay. Other V are no such functions, and kept to the order 2s.

The gravity gradient, V = (3/2) n² c·Jc: the radius turns about o at the rate n, and H = K + V - n o·P is constant. It
is quadratic in (P, c, o), and with ``c' = c × (W - n o)``, ``o' = o × W`` constant along all solutions of these
equations, orthonormal or not:

    (W - n o)·(P × W + 3n² c × Jc) - n (o × W)·P + 3n² (c × (W - n o))·Jc = 0.

So the rows turn with W - n o, o from the rows themselves: they are those of R_oᵀΛ, R_o the turn of the orbit since the
beginning of the step, and the quaternion follows by p ← q(o, nh) ⊗ p ⊗ q(C). In rows that stand still, H is kept to the
order.

What is reported of a step has its order as well: the mean moment is Σ b_i (m_i + Λ_i (M_i - C_d W_i)), the work
h Σ b_i W_i·(...), the multiplier Σ b_i μ_i, the twist h Σ b_i n·W_i, and averages are sums over the stages. The mean
moment of the constraint, -Σ b_i μ_i Λ_i n, is what the impulse leaves: Δπ/h less the moments of loads and dead forces.

Rows where they are needed. A moment in space, or of the state, drag, a slanted axis, forces of several directions: all
three rows are unknowns. A moment along the frame alone: P by itself, then the rows. A heavy body: P and γ; a free one:
P by itself. For these two the direction γ (that of P for a free body) is known at both ends. Let D(γ) be the smallest
rotation of γ to a unit vector r, that along Σ b_i W_i or its opposite. Λ D(γ)ᵀ turns about one line in space, by

    ψ = h Σ b_i W_i·(γ_i + r) / (1 + γ_i·r),        C = D(γ_n)ᵀ exp(ψ r̂) D(γ_{n+1}),

so C maps γ_{n+1} to γ_n, K + V and the vertical momentum (π and K) stay, and ψ has the order 2s, though C is not that
of the collocation in the rows. Where W stands still C = exp(h Ŵ).

The quaternion is only the store, p ← p ⊗ q(C), compensated and normalised: collocation in quaternions is another
discrete solution, which loses the vertical momentum and the impulse.

Gauss collocation is not L-stable: |R(-1000)| = 0.80 ... 0.996. Drag with h λ > 2s, λ the largest eigenvalue of
J⁻¹ C_d, is solved, and K never rises, but such modes are not resolved: a run says so (`unresolved`).

Nothing drifts linearly with time: the coefficients are exactly symplectic in floating point (`gauss_coefficients`), an
iteration that stops leaves no bias (`gauss_stages`), and what the quaternion is rounded by turns with it
(`turning.turned_on`). Energy and momentum change like the root of the number of steps.
The first guess extrapolates the last step; its increments belong to the state that a run leaves, so that a run that
resumes has the same bits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import comb, perm
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..engine.bodies import ANY, FREE, HEAVY
from ..engine.bodies import STEADY as STEADY_FORM
from ..engine.generalised import STAGE
from ..engine.layout import BODY
from ..geometry.arrays import Array
from ..loads import Load
from .base import Problem
from .compiled import Compiled
from .costs import damping_rate
from .gauss_coefficients import nodes, table, within
from .gauss_layout import CARRIED, room
from .scheme import ONCE, Linear, Scheme

LARGEST_TURN = {2: 1.0, 4: 1.73, 6: 2.32, 8: 3.02, 12: 4.33, 16: 5.65}


@dataclass(frozen=True)
class Gauss(Compiled):
    """Gauss collocation, orders 2, 4, 6, 8, 12, 16, for every body and load.

    Parameters
    ----------
    order : {8, 2, 4, 6, 12, 16}

    Raises
    ------
    ValueError
        The scheme does not have this order.

    Warns
    -----
    UserWarning
        Issued by a run whose damping is too strong for its step.

    Examples
    --------
    >>> from nontwist import Gauss, simulate, standard
    >>> scheme = Gauss(order=12)
    >>> run = simulate(standard([3, 4, 5]), t_end=10, step=0.5, angular_velocity=(0.1, 2, 0.1), integrator=scheme)
    >>> run.kinetic_energy.values[[0, -1]].round(9)
    array([8.04, 8.04])
    """

    name: ClassVar[str] = "gauss"
    has_derivatives: ClassVar[bool] = True
    orders: ClassVar[tuple[int, ...]] = (2, 4, 6, 8, 12, 16)
    substep_ns: ClassVar[float] = 500.0
    sources: ClassVar[Mapping[str, str]] = {
        "order": "Hairer, Lubich & Wanner, II.1.3",
        "invariant": "Hairer, Lubich & Wanner, IV.2.1; nontwist.integrators.gauss",
    }
    counts: ClassVar[dict[int, tuple[int, ...]]] = {
        **Compiled.counts,
        8: (12, 16, 20),
        12: (14, 16, 20),
        16: (10, 12, 16),
    }
    controlled_orders: ClassVar[tuple[int, ...]] = (4, 8, 12, 16)
    order: int = 8

    @property
    def automatic(self) -> float | None:
        """The tolerance of a run for which neither step nor tolerance is given; None: at most 0.05 rad per step."""
        return 1e-8 if self.order > 2 else None

    @property
    def effort(self) -> float:
        """The cost of a step relative to order 2; as measured, it is proportional to the number of stages."""
        return float(self.nodes)

    @property
    def largest_turn(self) -> float:
        """The turn per step up to which fixed-point iterations contract and stages are nearly orthonormal, rad.

        For a steady rotation by θ per step, the iteration of the rows contracts by θ ρ(A), where A is the matrix of the
        method, and the stages (1 - iθA)⁻¹ 1 leave the unit circle. Up to this turn the first is at most 0.5, the second
        at most 0.1 (0.2 for order 2). Measurements on tumbling bodies whose fastest stage turns by θ agree with both
        bounds.
        """
        return LARGEST_TURN[self.order]

    def remark(self, problem: Problem) -> str | None:
        """Return the warning about damped modes that the step does not resolve."""
        return unresolved(problem, self.order // 2)

    def lag(self, theta: float) -> float:
        """Return the error of a step for the turn `theta` of a steady rotation, rad, where it integrates rows.

        For rows a step is N(iθ)/N(-iθ), the diagonal Padé approximation of the exponential.
        """
        s = self.order // 2
        numerator = [comb(s, j) * perm(2 * s - j, s - j) / perm(2 * s, s) for j in range(s, -1, -1)]
        off = 2 * np.angle(np.polyval(numerator, 1j * theta)) - theta
        return float(abs((off + np.pi) % (2 * np.pi) - np.pi))

    @property
    def nodes(self) -> int:
        """Nodes of the load in a step."""
        return self.order // 2

    def _scheme(self, constrained: bool) -> Scheme:
        """Return the compiled marches of the step."""
        from .gauss_step import EIGHT, FEW, ONE

        return Scheme(
            FEW if self.order <= 8 else ONE,
            EIGHT,
            stages=stages,
            forms=forms,
            table=table,
            carried=carried,
            action=STAGE,
            room=room,
            within=within,
            linear=linear,
        )


def stages(order: int, form: int) -> tuple[Array, Array]:
    """Return the one fraction of a step that is taken at once, and the nodes of the load."""
    return ONCE, nodes(order)


def forms(found: NDArray[np.int64], bodies: Array, load: Load) -> NDArray[np.int64]:
    """Return the forms of the steps: a heavy body under load, or under forces of several directions, takes any."""
    several = ~bodies[:, BODY.vertical : BODY.dissipation].any(axis=1)
    return np.where((found == HEAVY) & (several | bool(load.terms)), ANY, found)


def linear(form: int, wanted: set[str]) -> Linear:
    """Return what linearises the steps of a form."""
    from .gauss_linear import free_steps, loaded_steps
    from .gauss_linear_torques import AT, MOMENTUM, ROWS, STEADY, VERTICAL

    turn = {FREE: MOMENTUM, HEAVY: VERTICAL, STEADY_FORM: STEADY}.get(form, ROWS)
    return Linear(free_steps if form == FREE and "dead" not in wanted else loaded_steps, AT.size, turn)


def carried(order: int) -> int:
    """Return how many numbers a body carries beside its state: the increments of its last step."""
    return CARRIED * (order // 2)


def unresolved(problem: Problem, s: int) -> str | None:
    """Return what to say where a damped mode decays at a rate λ with h λ > 2s: it is solved, and not resolved."""
    rate, h = damping_rate(problem.systems, problem.load, problem.load_scale), problem.grid.longest
    if not h * rate > 2 * s:
        return None
    return (
        f"damping slows the body down at a rate of up to {rate:.3g} 1/s, which step = {h:.6g} s does not resolve: "
        f"energy does not rise, but those modes are wrong; try step <= {2 * s / rate:.1g}"
    )
