"""The step of `lie_midpoint`, which derives it and its balances, in the unknowns W_{n+1} - W_n and μ.

Solved as it stands there, ``J (W_{n+1} - W_n) = h (J W_m × W_m + Λ_m⁻¹ m - μ n)`` and ``n·W_{n+1} = 0``, in extended
precision, with a Jacobian by differences: what the compiled step is compared with.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ..geometry.arrays import Array, cross
from ..integrators.base import IVP, Failure, Integrator, March, Status
from ..integrators.stepping import Step, march
from ..loads.base import state_moment_at
from ..models.system import DirectorSystem
from .energy_momentum_reference import EPS, Extended, MidpointMoment, newton

I3 = np.eye(3)


def hat(a: Array) -> Array:
    """Return â, ``â x = a × x``, in the precision of `a`."""
    return cross(a, I3).T


def body_moment(system: DirectorSystem, q0: Array, W: Array, h: float, load: MidpointMoment) -> tuple[Array, Array]:
    """Return ``(Λ_m⁻¹ m, m_load)`` at the averaged directors of the velocity `W`."""
    a = h / 2 * W
    back = I3 - hat(a)
    qm: Array = ((I3 - hat(a) + np.outer(a, a)) / (1 + a @ a)) @ q0
    m = load.spatial(qm, W @ q0)
    dead = cross(qm, system.dead_force).sum(0)
    M: Array = load.body + back @ (q0 @ (m + dead))
    return M, m + load.body @ qm


def step(k: int, system: DirectorSystem, q0: Array, W0: Array, h: float, load: MidpointMoment) -> tuple[Step, Array]:
    """Take one step; the directors and velocities of the result, and W at its end."""
    J, n = system.convected_inertia, system.axis
    c = 0 if n is None else 1
    axis = np.zeros((c, 3)) if n is None else n[None]

    def equations(x: Array) -> tuple[Array, Array]:
        y, mu = x[:3], x[3:]
        W = W0 + y
        M, _ = body_moment(system, q0, W, h, load)
        residual = np.concatenate([2 / h * J @ y - cross(J @ W, W) - M + mu @ axis, axis @ W])
        delta = np.sqrt(EPS) * max(1.0, abs(W).max())
        dM = np.array([body_moment(system, q0, W + delta * e, h, load)[0] - M for e in I3]).T / delta
        jacobian = np.zeros((3 + c, 3 + c))
        jacobian[:3, :3] = 2 / h * J + hat(W) @ J - hat(J @ W) - dM
        jacobian[:3, 3:], jacobian[3:, :3] = axis.T, axis
        return residual, jacobian

    try:
        x0 = np.zeros(3 + c, dtype=Extended)
        x, residual, iterations, converged = newton(equations, x0, lambda x: float(abs(x[:3]).max()), abs(W0).max())
        W = W0 + x[:3]
        m = body_moment(system, q0, W, h, load)[1]
    except ValueError as error:
        failure: Failure | None = Failure(Status.LOAD, k, np.nan, np.nan, str(error))
        return Step(q0, q0, np.zeros(c), np.zeros(3), 0.0, 0, failure), W0
    turn = h * float(np.linalg.norm(W if converged else W0))
    failure = None if converged else Failure(Status.STALLED, k, residual, turn)
    if converged and turn > np.pi:
        failure = Failure(Status.TURN, k, residual, turn)
    a = h / 2 * W
    q1: Array = (2 * (I3 - hat(a) + np.outer(a, a)) / (1 + a @ a) - I3) @ q0
    W1 = W0 + 2 * x[:3]
    return Step(q1, cross(W1 @ q1, q1), x[3:], m, h * float((W @ q0) @ m), iterations, failure), W1


@dataclass(frozen=True)
class ReferenceLieMidpoint(Integrator):
    """The step in plain NumPy: what `lie_midpoint` is tested against."""

    name: ClassVar[str] = "reference-lie-midpoint"
    orders: ClassVar[tuple[int, ...]] = (2,)
    order: int = 2

    def march_one(self, problem: IVP) -> March:
        """Integrate `problem` step by step."""
        system, load = problem.system, problem.load
        middle = problem.nodes(np.arange(problem.steps), np.array([0.5]))
        body, space = load.sample(middle, "body"), load.sample(middle, "space")
        W = problem.velocity[0].astype(Extended)
        if system.axis is not None:
            W -= (system.axis @ W) * system.axis
        problem = replace(problem, velocity=W.astype(float)[None], normal=None)

        def one(k: int, q: Array, v: Array) -> Step:
            nonlocal W
            state = (lambda d, w: state_moment_at(load, middle[k], d, w)) if load.depends_on_state else None
            moment = MidpointMoment(body[k], space[k], state)
            result, W = step(k, system, q, W, problem.step_at(k), moment)
            return result

        return march(problem, 0 if system.axis is None else 1, one, Extended)
