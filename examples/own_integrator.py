"""An integrator of your own, added to those of the package: the explicit Munthe-Kaas schemes of orders 1 and 4.

In the step from t_n the attitude is Λ_n exp(û), with u = 0 at t_n, and (u, W) lies in a vector space:

    u' = dexp⁻¹(-u) W,        J W' = J W × W + Λᵀ m - μ n,        n·W' = 0,

with the spatial moment m of load and dead forces, and n the constrained axis, if any. Euler's scheme takes
it, and Runge and Kutta's classical one (H. Munthe-Kaas, Appl. Numer. Math. 29 (1999) 115). Λ is a product of
rotations and every stage has n·W' = 0, so directors stay orthonormal and the body does not turn about n,
whatever the step. The errors of energy and momenta are of the order of the scheme.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from nontwist import Load, body_moment, heavy_top, integrate, nontwisting, rotations, space_moment, suslov
from nontwist.geometry.arrays import Array
from nontwist.integrators import INTEGRATORS, Continuous
from nontwist.integrators.integrator import IVP, SPIN, Failure, Integrator, March, Status
from nontwist.integrators.stepping import StepResult, march_by_steps

TABLEAUX = {1: ((0,), (1,)), 4: ((0, 1 / 2, 1 / 2, 1), (1 / 6, 1 / 3, 1 / 3, 1 / 6))}  # nodes and weights


@dataclass(frozen=True)
class MuntheKaas(Integrator):
    """Euler or Runge-Kutta on rotation vector and angular velocity: explicit; all loads, no prescribed spin.

    Parameters
    ----------
    order : {4, 1}

    Raises
    ------
    ValueError
        The scheme does not have this order; or, raised by a run, the spin of the body is prescribed.

    Examples
    --------
    The energy is not conserved exactly; its error falls with the order:

    >>> from nontwist import simulate, standard
    >>> start = {"t_end": 2, "step": 0.01, "material_angular_velocity": (1, -2, 3), "integrator": "munthe-kaas"}
    >>> for order in (1, 4):
    ...     K = simulate(standard([3, 4, 5]), order=order, **start).kinetic_energy
    ...     print(f"order {order}: energy off by {abs(K / K[0] - 1).max().item():.0e}")
    order 1: energy off by 9e-03
    order 4: energy off by 7e-11
    """

    name: ClassVar[str] = "munthe-kaas"
    orders: ClassVar[tuple[int, ...]] = tuple(TABLEAUX)
    order: int = 4

    def refusal(self, problem: IVP) -> str | None:
        """Return why the body is not accepted, or None if it is."""
        return None if problem.systems.spin is None else SPIN.format(self.name)

    def march_one(self, problem: IVP) -> March:
        """Integrate `problem` step by step."""
        if reason := self.refusal(problem):
            raise ValueError(reason)
        constraints = 0 if problem.system.axis is None else 1
        return march_by_steps(
            problem, constraints, lambda k, q, v: step(problem, *TABLEAUX[self.order], k, q, v), float
        )


def step(problem: IVP, nodes: Sequence[float], weights: Sequence[float], k: int, q: Array, v: Array) -> StepResult:
    """Take the step `k` from directors `q` and their velocities `v`, both by rows."""
    n, h = problem.system.axis, problem.step_at(k)
    constraints = 0 if n is None else 1
    start, end = problem.times(np.array([k, k + 1]))
    last = np.nextafter(end, start)  # what jumps at the end of the step belongs to the next one
    W0 = q @ np.cross(q, v).sum(0) / 2
    if n is not None:
        W0 = W0 - (n @ W0) * n
    stages, du, dW = [], np.zeros(3), np.zeros(3)
    try:
        for c in nodes:
            u, W = c * h * du, W0 + c * h * dW
            d = rotations.exp(-u) @ q  # rows: the transpose of Λ_n exp(û)
            du = rotations.dexp_inverse(-u) @ W
            dW, mu, m = rates(problem, min(start + c * h, last), d, W)
            stages.append((du, dW, mu, m, m @ (W @ d)))
    except ValueError as error:  # of a load
        failure = Failure(Status.LOAD, k, np.nan, np.nan, str(error))
        return StepResult(q, v, np.zeros(constraints), np.zeros(3), 0.0, 0, failure)
    du, dW, mu, m, power = (
        sum(b * x for b, x in zip(weights, column, strict=True)) for column in zip(*stages, strict=True)
    )
    q1 = rotations.exp(-h * du) @ q
    q1 = 1.5 * q1 - 0.5 * q1 @ q1.T @ q1  # takes round-off out, which W, recovered from v and q, would add up
    v1 = np.cross((W0 + h * dW) @ q1, q1)
    return StepResult(q1, v1, np.full(constraints, mu), m, h * power, 0, None)


def rates(problem: IVP, t: float, q: Array, W: Array) -> tuple[Array, float, Array]:
    """Return W', the multiplier μ and the spatial moment of the load."""
    body = problem.system
    m = problem.load.moment(t, q, W @ q)
    dead = np.cross(q, body.dead_force).sum(0)
    J, n = body.convected_inertia, body.axis
    free = np.linalg.solve(J, np.cross(J @ W, W) + q @ (m + dead))
    if n is None:
        return free, 0.0, m
    held = np.linalg.solve(J, n)
    mu = float((n @ free) / (n @ held))
    return free - mu * held, mu, m


INTEGRATORS[MuntheKaas.name] = MuntheKaas


def push(t: float) -> tuple[Any, float, float]:
    """Return a smooth moment, N m."""
    return 3 * np.sin(3 * t), 1.0, 0.3


TILTED = [[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]]
PROBLEMS = {
    "non-twisting body, load along the directors": (nontwisting([3, 4, 5]), (1, -2, 0), body_moment(push)),
    "Suslov body, load along fixed axes": (suslov(TILTED, [0.3, 0.2, 1]), (1, -2, 0), space_moment(push)),
    "heavy top": (heavy_top([2.0, 2.2, 1.0], 1.5, [0.1, 0, 0.6]), (1, 0.5, 4), Load()),
}


def main() -> None:
    """Measure errors against SciPy's DOP853 at three steps, and the order from the finer two."""
    for name, (body, w, load) in PROBLEMS.items():
        how: dict[str, Any] = {"t_end": 2, "angular_velocity": w, "project": True, "load": load}
        truth = integrate(body, step=2, integrator=Continuous(rtol=3e-14, atol=1e-15), **how).directors[-1]
        runs = [integrate(body, step=2 / N, integrator="munthe-kaas", **how) for N in (40, 80, 160)]
        errors = [np.linalg.norm(run.directors[-1] - truth) for run in runs]
        q = runs[0].directors
        defect = abs(q @ q.mT - np.eye(3)).max()
        print(f"{name}: order {np.log2(errors[1] / errors[2]):.2f}")
        print(f"  errors {', '.join(f'{error:.1e}' for error in errors)}; orthonormal to {defect:.0e}")


if __name__ == "__main__":
    main()
