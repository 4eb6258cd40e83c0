"""The paper's energy-momentum step in two unknowns, three where the body may twist (eq-discrete-nonholonomic).

`reference` holds the same step in 16 unknowns, with the reason why it keeps energy, momenta and orthonormality. Here
it is solved for the increment y of one angular velocity; no constraint is left among the equations.

Frame. Everything is written in the body frame b at the beginning of the step: ``d_{i,n} = e_i``, director velocities
V_i, ``P_i = Σ_j E_ij V_j``. Every V_i splits into ``W × e_i + N_i`` with W = ½ Σ e_i × V_i and N symmetric; N is the
part that leaves the tangent space. Write the step as ``Δd_i = h Ω × d_{i,m}``. With ``a = hΩ/2``

    d_{i,m} = M e_i,    M = (I - â)⁻¹ = s (I + â + a aᵀ),   s = 1/(1 + |a|²),   Λ_{n+1} = Λ_n (2M - I),

a rotation, so the six rows of orthonormality hold, for every Ω. The nonholonomic row ``A = -n̂/2`` becomes
``Ω·n = 0``: by ``M e_i × M e_j = cof(M) (e_i × e_j)`` and ``cof(M) = det(M) (I + â)``

    Σ n̂_ij d_{j,m}·(Ω × d_{i,m}) = -2 Ω·cof(M) n = -2 det(M) Ω·n.

Equations. Rows ``(2/h) Σ_j E_ij (u_j - V_j) + Σ_j L_ij d_{j,m} = f_i`` with L = Σ λ_k A_k. The virtual rotations that
are free of λ and μ are ``δd_i = (M β) × d_{i,m}`` with β ⊥ n: the moment of the constraint is along
cof(M) n ∥ (I + â) n, and (I + â) n · M β = n·β. (With β itself, or β ⊥ Λ_n n, energy is still kept, and the order
falls to 1 for a Suslov body.) Since ``Mᵀ (M e_i × x) = s e_i × (I - â) x`` and (I - â) u_i = Ω × e_i, they are

    r(y) = Σ_i e_i × [Σ_j E_ij (Ω × e_j - (I - â) V_j) - (h/2) (I - â) f_i]
         = J y - z + (h/2) [τ Ω - W × EΩ - N E Ω] - (h/2) G   orthogonal to n,        Ω = W + y,

z = Σ e_i × (EN)_i, τ = tr EN: **linear** in y but for the moments of the load. Dead forces F_i in b give
``G = Σ e_i × (F_i - a × F_i)``, linear as well; a moment ``m = Λ_m B + Λ_n f``, as f_i = m × d_{i,m}/2, gives
``G = ½ [(1 + s)(B + f - a × f) + s (a·(B + f)) a]``. On the constrained body y·n = -W·n is known.

Exact moments. The forces f_i = m × d_{i,m}/2 of the paper have at the mean directors the moment ½ (tr D I - D) m, with
D = Σ d_{i,m} ⊗ d_{i,m} = Λ_n M Mᵀ Λ_nᵀ, and not m: M Mᵀ = s (I + a aᵀ) is I up to |a|². The forces x × d_{i,m} with
(tr D I - D) x = m have the moment m, and since Δd_i = h Ω × d_{i,m} the work h m·Ω. In b ``tr D I - D = (1 + s) I -
s a aᵀ``, so x = (m + ½ (a·m) a)/(1 + s), and by MᵀM = M Mᵀ

    G = Mᵀ m / s = B + f - a × f + (a·(B + f)) a.

`moments="exact"` takes these, so Δπ = h m of a body without constraint. The default stays the form of the paper: what
is compared with it, and was computed with it, keeps its digits, and the motion is of the same order.

Director forces act as the paper writes them, f_i at the mean directors: with m = Σ d_{i,m} × f_i they are x × d_{i,m} +
Σ_j σ_ij d_{j,m}, σ symmetric. The first part is the exact moment, whatever `moments` says; of the second,
(I - â) M = I leaves σ itself in the rows, which is balanced by λ (`engine.generalised`). So are potentials.

Update. ``V_i`` in the new frame is V_i + 2 Mᵀ (y × e_i - N_i): a small change of W, kept with its rounding error, and
N turns its sign at every step. Multipliers come from the rows, ``L_i = -(2/h) Σ_j E_ij (y × e_j - N_j + a × V_j)
+ (I - â) f_i``; the symmetric part of L is λ, its skew part -μ n̂/2.

Order 2. The normal part N of the director velocities at the nodes alternates. λ and μ see N times 2/h: from a tangent
start N goes to and fro between 0 and -h²/2 times the symmetric part of Ŵ Ŵ' at the start, so they alternate by O(h)
about a course of order 2, the mean of two steps, unless W or W' is 0 at the start, as in the paper's cases. Because N
turns its sign the step is no near-identity map of (q, q̇), and compositions do not raise the order of all variables.
`lie_midpoint` and `gauss` have no such part.

Dissipation χ (`dissipative`), for bodies without a constraint: in the principal axes, where E is diagonal, the mean
velocities u_i = ½ (V_i + V_i⁺) move the directors by

    Δd_i = h (1 + κ_i) u_i,        κ_i = χ (|V_i⁺| - |V_i|)/(|V_i⁺| + |V_i|),

the rows of momentum being what they are. Momentum: ``Σ (d_{i,m} × E_i ΔV_i + Δd_i × E_i u_i)``, the second term still
zero, so π changes by the impulse. Energy: Σ L_ij d_{j,m}·Δd_i = 0, so ``Σ (1 + κ_i) E_i u_i·ΔV_i = Σ f_i·Δd_i``, the
work, and with ``u_i·ΔV_i = ½ Δ|V_i|²``

    ΔK = work - ½ Σ κ_i E_i Δ|V_i|² = work - ½ χ Σ E_i (Δ|V_i|)²,

under any load: K + V less the work never rises. 0 where the lengths of all V_i stay, as in a permanent rotation. Of
order 1, or 2 with χ h|W| in place of χ, h|W| of the beginning of the step and at most 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from ..engine.bodies import ANY
from ..geometry.arrays import Array
from ..geometry.values import among, shown
from ..loads import Load
from ..models.stack import SystemStack
from .dissipative import Dissipative
from .spins import REFUSAL as SPIN

if TYPE_CHECKING:
    from .scheme import Linear, Scheme


MOMENTS = ("paper", "exact")


@dataclass(frozen=True)
class EnergyMomentum(Dissipative):
    """The energy-momentum scheme of the paper (eq-discrete-nonholonomic), order 2, for every body and load.

    Parameters
    ----------
    order : {2}
        With dissipation, 1 or 2.
    dissipation : float, 0 to 1
        χ: the degree to which each step dissipates the energy of nutation, with the momentum conserved; only for bodies
        without a constrained axis.
    moments : {"paper", "exact"}
        How a moment m acts on the directors: by the forces ``½ m × d_i`` of the paper, whose moment at the mean
        directors differs from m by O(h²), or by forces that have the moment m.

    Raises
    ------
    ValueError
        The scheme does not have this order; `dissipation` is outside its bounds, or the body of the run has a
        constrained axis; `moments` is unknown.

    Examples
    --------
    The run has the multipliers of all constraints. That of the non-twisting constraint is ``μ = (J1 - J2) W1 W2`` if no
    load acts:

    >>> from nontwist import EnergyMomentum, nontwisting, simulate
    >>> body, scheme = nontwisting([3, 4, 5]), EnergyMomentum()
    >>> run = simulate(body, t_end=1, step=0.005, material_angular_velocity=(6, -18, 0), integrator=scheme)
    >>> run.constraint.values.tolist()
    ['11', '22', '33', '23', '13', '12', 'nh']
    >>> run.multipliers.sel(constraint="nh").values[[0, -1]].round(6)
    array([108., 108.])
    """

    name: ClassVar[str] = "energy-momentum"
    has_derivatives: ClassVar[bool] = True
    orders: ClassVar[tuple[int, ...]] = (2,)
    substep_ns: ClassVar[float] = 400.0
    sources: ClassVar[Mapping[str, str]] = {
        "order": "eq-discrete-nonholonomic",
        "invariant": "eq-energy_preservation; eq-material_perpendicular_momenta_preservation",
    }
    removed: ClassVar[Mapping[int, str]] = {
        4: "its order 4 is gone, gauss has the motion and the reaction moment more accurately: "
        "integrator='gauss', order=4"
    }
    moments: Literal["paper", "exact"] = "paper"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not among(self.moments, MOMENTS):
            raise ValueError(f"moments must be 'paper' or 'exact', got {shown(self.moments)}")

    def _reason(self, systems: SystemStack) -> str | None:
        return SPIN.format(self.name) if systems.spin is not None else super()._reason(systems)

    def _scheme(self, constrained: bool) -> Scheme:
        """Return the compiled marches of the step."""
        from ..engine.generalised import EXACT, PAPER
        from .director_step import EIGHT, ONE, dissipative_eight, dissipative_one
        from .scheme import Scheme

        action = PAPER if self.moments == "paper" else EXACT
        if self.dissipation:
            kernels = (dissipative_one,) * 7, (dissipative_eight,) * 7
            return Scheme(
                *kernels,
                is_director_scheme=True,
                dissipation=self.dissipation,
                action=action,
                linear=linear_of_dissipation,
            )
        if action == PAPER:
            return Scheme(ONE, EIGHT, is_director_scheme=True, action=action, linear=linear)
        return Scheme(ONE, EIGHT, is_director_scheme=True, action=action, forms=loaded_as_any, linear=linear)


def linear(form: int, wanted: set[str]) -> Linear:
    """Return what linearises the step."""
    from .director_linear import ROWS, director_steps
    from .midpoint_linear import AT
    from .scheme import Linear

    return Linear(director_steps, AT.size, rows=ROWS, acts="space")


def linear_of_dissipation(form: int, wanted: set[str]) -> Linear:
    """Return what linearises the step with dissipation."""
    from .director_linear import slipping_steps

    return linear(form, wanted)._replace(kernel=slipping_steps)


def loaded_as_any(forms: NDArray[np.int64], bodies: Array, load: Load) -> NDArray[np.int64]:
    """Return the forms of the steps: that for all loads wherever there is one, in which moments act exactly."""
    return np.full_like(forms, ANY) if load.terms else forms
