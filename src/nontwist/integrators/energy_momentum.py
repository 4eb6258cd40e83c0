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

Update. ``V_i`` in the new frame is V_i + 2 Mᵀ (y × e_i - N_i): a small change of W, kept with its rounding error, and
N turns its sign at every step. Multipliers come from the rows, ``L_i = -(2/h) Σ_j E_ij (y × e_j - N_j + a × V_j)
+ (I - â) f_i``; the symmetric part of L is λ, its skew part -μ n̂/2.

Order 2. The normal part N of the director velocities at the nodes alternates. λ and μ see N times 2/h: from a tangent
start N goes to and fro between 0 and -h²/2 times the symmetric part of Ŵ Ŵ' at the start, so they alternate by O(h)
about a course of order 2, the mean of two steps, unless W or W' is 0 at the start, as in the paper's cases. Because N
turns its sign the step is no near-identity map of (q, q̇), and compositions do not raise the order of all variables.
`lie_midpoint` and `gauss` have no such part.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from .compiled import Compiled

if TYPE_CHECKING:
    from .scheme import Scheme


@dataclass(frozen=True)
class EnergyMomentum(Compiled):
    """The energy-momentum scheme of the paper (eq-discrete-nonholonomic), order 2, for every body and load.

    Parameters
    ----------
    order : {2}

    Raises
    ------
    ValueError
        The scheme does not have this order.

    Examples
    --------
    The multipliers of all constraints come with it, of the non-twisting one ``μ = (J1 - J2) W1 W2`` where no load acts:

    >>> from nontwist import EnergyMomentum, nontwisting, simulate
    >>> body, scheme = nontwisting([3, 4, 5]), EnergyMomentum()
    >>> run = simulate(body, t_end=1, step=0.005, material_angular_velocity=(6, -18, 0), integrator=scheme)
    >>> run.constraint.values.tolist()
    ['11', '22', '33', '23', '13', '12', 'nh']
    >>> run.multipliers.sel(constraint="nh").values[[0, -1]].round(6)
    array([108., 108.])
    """

    name: ClassVar[str] = "energy-momentum"
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
    order: int = 2

    def _scheme(self, constrained: bool) -> Scheme:
        """Return the compiled marches of the step."""
        from .director_step import EIGHT, ONE
        from .scheme import Scheme

        return Scheme(ONE, EIGHT, is_director_scheme=True)
