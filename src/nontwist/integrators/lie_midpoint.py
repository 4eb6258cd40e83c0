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

Dissipation χ (`dissipative`, `lie_dissipative_step`), for bodies without a constraint. The body turns, and its momentum
with it, by Ω = W_m + g Q × W_m, Q = J W_m the mean momentum:

    Λ_{n+1} = Λ_n cay(hΩ),        J (W_{n+1} - W_n) = h (Q × Ω + Λ_m⁻¹ m).

π is kept for any Ω that stands in both. ``ΔK = W_m·J ΔW = h W_m·(Q × Ω) = -h g |Q × W_m|² ≤ 0`` at any step, 0 in a
permanent rotation alone. g = χh/tr J of order 1, χh² |W_m|/tr J of order 2. Under a load the impulse is exact as
before, and with A the work of the load on Ω

    Δ(K + V) - A = -g (Q × W_m)·J ΔW,

which has no sign. With rotors of momentum c, Q + c_m takes the place of Q, and ΔK = -h g |(Q + c_m) × W_m|² where they
are constant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from .dissipative import Dissipative

if TYPE_CHECKING:
    from .scheme import Linear, Scheme


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
    >>> from nontwist import LieMidpoint, simulate, standard
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
    has_derivatives: ClassVar[bool] = True
    orders: ClassVar[tuple[int, ...]] = (2,)
    removed: ClassVar[Mapping[int, str]] = {
        order: f"its higher orders are gone, gauss keeps the same invariants: integrator='gauss', order={order}"
        for order in (4, 6, 8)
    }
    substep_ns: ClassVar[float] = 300.0
    sources: ClassVar[Mapping[str, str]] = {
        "order": "Hairer, Lubich & Wanner, II.3",
        "invariant": "Simo & Wong 1991; nontwist.integrators.lie_midpoint",
    }

    def _scheme(self, constrained: bool) -> Scheme:
        """Return the compiled marches of the step."""
        from .scheme import Scheme

        if self.dissipation:
            from .lie_dissipative_step import dissipative_eight, dissipative_one

            kernels = (dissipative_one,) * 7, (dissipative_eight,) * 7
            return Scheme(*kernels, dissipation=self.dissipation, linear=linear_of_dissipation)
        from .lie_step import EIGHT, ONE

        return Scheme(ONE, EIGHT, linear=linear)


def linear(form: int, wanted: set[str]) -> Linear:
    """Return what linearises the step: that of `gauss` with one stage, but for how dead forces act."""
    from .gauss_linear import loaded_steps
    from .gauss_linear_torques import AS_MOMENT, AT
    from .scheme import Linear

    return Linear(loaded_steps, AT.size, dead=AS_MOMENT)


def linear_of_dissipation(form: int, wanted: set[str]) -> Linear:
    """Return what linearises the step with dissipation."""
    from .lie_dissipative_linear import ROWS, dissipative_steps
    from .midpoint_linear import AT
    from .scheme import Linear

    return Linear(dissipative_steps, AT.size, rows=ROWS, acts="space")
