"""An integrator whose steps are compiled, and which has derivatives and ensembles without a line of its own.

The step is Euler's explicit one for the momentum, and a rotation by h W: with P = J W and the damping matrix C,

    Λ_{n+1} = Λ_n cay(h W_n),        P_{n+1} = P_n + h (P_n × W_n - C W_n),

for bodies without a constrained axis. It has the order 1 and keeps no invariant. It is a text in the language of
kernels: the package traces it, compiles it for one body and for several side by side, and runs it on dual numbers.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from nontwist import damping, integrate, sensitivities, simulate_ensemble, standard
from nontwist.engine.marching import Step, Text, turned_by_half
from nontwist.engine.records import State
from nontwist.engine.sampling import Nodes
from nontwist.integrators import INTEGRATORS
from nontwist.integrators.compiled import Compiled
from nontwist.integrators.integrator import IVP
from nontwist.kernels.elements import sqrt
from nontwist.kernels.vectors import compensated, cross
from nontwist.loads.terms import Damping


def step(nodes: Nodes, state: State, is_active: Any) -> Step:
    """Take the step."""
    body, h, zero = nodes.body, nodes.h, 0.0 * nodes.h
    W = body.velocity_of(state.s)
    C, torque = nodes.loads().damping, cross(state.s, W)
    drag = None if C is None else -(C @ W)
    if drag is not None:
        torque = torque + drag
    half = 0.5 * h * W
    p, c, gap = turned_by_half(state.p, state.c, half)
    P, compensation = compensated(state.s, state.compensation, h * torque)
    never, turn = zero > 1.0, 2.0 * sqrt(half @ half)
    found = Step(State(p, P, compensation, c, state.auxiliary), never, never, gap, zero, zero, turn)
    if nodes.parts.needs_means:
        found = found._replace(mu=zero, twist=2.0 * (body.axis @ half))
        if drag is not None:
            found = found._replace(moment=nodes.R @ drag, work=h * (W @ drag))
    return found


@dataclass(frozen=True)
class LieEuler(Compiled):
    """Euler's explicit step; for free bodies, with damping or without.

    Parameters
    ----------
    order : {1}
    """

    name: ClassVar[str] = "lie-euler"
    orders: ClassVar[tuple[int, ...]] = (1,)
    order: int = 1

    def refusal(self, problem: IVP) -> str | None:
        """Return why a problem is not accepted that the step has no term for, None if it is."""
        is_free = problem.systems.axis is None and not problem.systems.has_dead_force
        if is_free and all(isinstance(term, Damping) for term in problem.load.terms):
            return None
        return "lie-euler takes free bodies, with damping or without; use lie-midpoint"

    def text(self, motion: str) -> Text:
        """Return the text of the step."""
        return Text(step)


INTEGRATORS["lie-euler"] = LieEuler

if __name__ == "__main__":
    body, load, W = standard([3, 4, 5]), damping(0.1), np.array([1.0, -2.0, 3.0])
    how: dict[str, Any] = {"t_end": 1, "load": load}
    exact = integrate(body, integrator="gauss", step=0.01, material_angular_velocity=W, **how)
    for step_size in (2e-3, 1e-3):
        run = integrate(body, integrator="lie-euler", step=step_size, material_angular_velocity=W, **how)
        error = abs(run.material_angular_velocity[-1] - exact.material_angular_velocity[-1]).max()
        print(f"steps of {step_size} s: W is off by {error:.5f} rad/s")
    how |= {"integrator": "lie-euler", "step": 1e-3}
    found = sensitivities(body, material_angular_velocity=W, wrt=["material_angular_velocity"], **how)
    column = found.d_material_angular_velocity[-1].values[:, 0]
    ends = simulate_ensemble(body, material_angular_velocity=W + np.outer([1e-5, -1e-5], [1, 0, 0]), **how)
    difference = np.subtract(*ends.material_angular_velocity.values[:, -1]) / 2e-5
    print(f"dW/dW1: {column.round(6)}, apart from differences of an ensemble by {abs(column - difference).max():.0e}")
