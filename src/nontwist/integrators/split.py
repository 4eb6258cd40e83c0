"""split: exact free motion, with the load as quadrature or kicks.

Non-twisting body (any principal axis n). With body components Π_⊥ the split form (eq-nonholonomic-red, with moments)
is

    Π_⊥' = M_⊥,        Λ' = Λ Ŵ,        W = J_⊥⁻¹ Π_⊥,

so the momentum is a quadrature of the moment in the moving frame, and the attitude a product of exponentials.

- Moments given along the moving frame: M(t) at Gauss nodes, Π_⊥ at the nodes by the Gauss Runge-Kutta matrix, and
  Λ_{n+1} = Λ_n exp(Ω̂) with the Magnus expansion of order 2, 4, 6 (A. Iserles, S. P. Nørsett, Phil. Trans. R. Soc. A
  357 (1999) 983; S. Blanes, F. Casas, J. Ros, BIT 40 (2000) 434), for order 4 Ω = h (W_1 + W_2)/2 + (√3/12) h² W_1 ×
  W_2. The sign of the bracket is that of Λ' = Λ Ŵ.
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

Where no moment acts each stretch is one exact motion, evaluated at each stored time from its start: no steps, no
accumulation of round-off. Pulses and tables act where they are not zero; gravity and functions act always.

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
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..models.stack import SystemStack, is_principal, stacked, transverse_momentum
from ..models.system import DirectorSystem
from .base import Problem
from .coasting import Coasting
from .compiled import Compiled
from .composition import fractions, substeps
from .costs import Cost, steps_cost
from .spins import REFUSAL as SPIN

if TYPE_CHECKING:
    from ..loads import Load
    from .scheme import Scheme

ROTORS = (
    "split does not accept rotors: its free motion between the kicks is that of the body without them; use "
    "the integrator gauss"
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

    >>> from nontwist import Split, nontwisting, rotation, simulate
    >>> body = nontwisting([3, 4, 5])
    >>> run = simulate(body, t_end=1, step=0.5, material_angular_velocity=(0, 3, 0), integrator=Split())
    >>> rotation(run).magnitude().round(9)
    array([0. , 1.5, 3. ])
    """

    name: ClassVar[str] = "split"
    orders: ClassVar[tuple[int, ...]] = (2, 4, 6)
    together: ClassVar[float] = 1.0
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
    def effort(self) -> float:
        """The cost of a step, relative to that of a step of order 2."""
        return float(self.nodes)

    @property
    def largest_turn(self) -> float:
        """The turn per step up to which no substep turns the body by more than 60°, rad."""
        return float(np.pi / 3 / abs(fractions(self.order)).max())

    def turns_exactly(self, problem: Problem) -> bool:
        """Whether a step is an exponential: without load, and with a constrained axis under body-fixed moments."""
        is_held = problem.systems.axis is not None and not problem.systems.has_dead_force
        return super().turns_exactly(problem) or (is_held and all(term.kind == "body" for term in problem.load.terms))

    def lag(self, theta: float) -> float:
        """Return the error of a step for the turn `theta` of a steady rotation, rad."""
        gamma = fractions(self.order)
        return float(abs(np.sum(2 * np.arctan(gamma * theta / 2)) - theta))

    def _scheme(self, constrained: bool) -> Scheme:
        """Return the compiled marches of the step, for bodies with a constrained axis or without."""
        from .scheme import Scheme
        from .split_step import FREE, HELD, stages

        marches, staged = (HELD, stages) if constrained else (FREE, substeps)
        return Scheme(marches, (), is_exact=True, stages=staged)

    def refusal(self, problem: Problem) -> str | None:
        """Return why the constrained axis or the load is not accepted, or None if both are."""
        if problem.load.rotors or problem.systems.spin is not None:
            return ROTORS if problem.load.rotors else SPIN.format(self.name)
        return _refusal(problem.system) if problem.system.axis is not None else None

    def cost(self, problem: Problem, states: int) -> Cost:
        """Return the estimated cost of `march`: that of the steps while moments act."""
        system, ns = problem.system, self.substep_ns if problem.system.axis is None else CONSTRAINED_NS
        coasting = None if system.dead_force.any() else problem.load
        steps = problem.steps - int(Coasting(problem, coasting).before(np.array([problem.steps]))[0])
        return steps_cost(problem, steps, self.nodes, ns)

    def require(self, systems: SystemStack, load: Load) -> None:
        """Raise a ValueError for rotors, a prescribed spin, and a constrained axis that is not principal."""
        if load.rotors or systems.spin is not None:
            raise ValueError(ROTORS if load.rotors else SPIN.format(self.name))
        for i, reason in _not_principal(systems).items():
            raise ValueError(f"member {i}: {reason}" if len(systems) > 1 else reason)


@lru_cache(maxsize=64)
def _refusal(system: DirectorSystem) -> str | None:
    return next(iter(_not_principal(stacked(system)).values()), None)


def _not_principal(systems: SystemStack) -> dict[int, str]:
    """Return why constrained axes of members are not accepted, by member."""
    if systems.axis is None:
        return {}
    across = transverse_momentum(systems)
    return {
        i: f"split needs a constrained axis that is principal, but J n differs from its part along n by "
        f"{np.linalg.norm(across[i]):.3g} kg m²; use the integrator gauss"
        for i in np.flatnonzero(~is_principal(systems)).tolist()
    }
