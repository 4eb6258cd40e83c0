"""The paper's energy-momentum step as the paper writes it: 16 unknowns (eq-discrete-nonholonomic, sec-integration).

Rows of q are the directors, ``<A_k q, v> = 0`` the constraints (`models.constraints`), E the Euler inertia. The step
from (q_n, v_n) has the unknowns u = (q_{n+1} - q_n)/h, λ and, for a body with a constrained axis, μ:

    (2/h) E (u - v_n) + Σ_k λ_k A_k q_m = f(t_m, q_m, u),       q_m = q_n + h u/2,
    <A_k q_m, u> = 0    for every k,

and then q_{n+1} = q_n + h u, v_{n+1} = v_n + 2 (u - v_n). The Jacobians H_d and G_d of the paper, averages over the
segment from q_n to q_{n+1}, are those at the arithmetic mean q_m, because the constraints are quadratic in q.

Round-off. λ and μ see an error of v_n times 2E/h, and v_{n+1} = 2u - v_n passes the part of it that is normal to the
constraints on undamped, with its sign changed: in double precision the multipliers of a run of 1000 steps are off by
tens of ulps of |E||v|/h. Hence u - v_n is the unknown, and state and residuals are carried in `Extended` precision,
where the platform has one; the Newton matrix stays in double precision.

Energy. 2u = v_{n+1} + v_n, so testing the first row with h u gives K_{n+1} - K_n = h <u, E 2(u - v_n)/h>
= Σ_i f^i·Δd_i: the constraints do no work by the second row. With f^i = m × d_{i,m}/2 the work is h m·w_m,
w_m = Σ d_{i,m} × u_i / 2.

Orthonormality. <A_k q_m, q_{n+1} - q_n> is h_k(q_{n+1}) - h_k(q_n) for the six symmetric A_k.

Momentum. Since Σ E_ij u_i × u_j = 0, Δπ = h Σ d_{i,m} × (f^i - Σ_jk λ_k (A_k)_ij d_{j,m}); symmetric A_k drop out, so a
body without axis keeps π when no moment acts. What a run reports as moment is that of the director forces,
Σ d_{i,m} × (m × d_{i,m}/2) = (tr S - S) m/2 with S = Σ d_{i,m} d_{i,m}ᵀ: it differs from m by O(h²), as mean directors
are shorter than 1.

Nonholonomic momenta. Let f = 0, n = e3, E_13 = E_23 = 0 and v_n = w × q_n with w·d_{3,n} = 0. Turning all directors
about the fixed axis w by 2 atan(h|w|/2), that is u = w × q_m and v_{n+1} = w × q_{n+1}, solves the step: the left side
of the moment balance, Σ E_ij d_{i,m} × (v_{n+1} - v_n)_j = -h w × Σ_{i,j<3} E_ij (w·d_{i,m}) d_{j,m}, is a product of
two vectors in the plane of d_{1,m} and d_{2,m}, hence parallel to d_{1,m} × d_{2,m}, the direction of the constraint's
moment. So W, and with it Π1, Π2 and K, are kept exactly, for every value of the paper's parameter a.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..geometry.arrays import Array, cross
from ..integrators.base import IVP, Failure, Integrator, March, Status
from ..integrators.stepping import Step, march
from ..loads.base import Load, forces_at, state_moment_at
from ..loads.forces import DirectorForces
from ..models.constraints import constraint_matrices

Extended = np.longdouble
EPS = float(np.finfo(np.float64).eps)
ITERATIONS = 40
I3 = np.eye(3)
State = Callable[[Array, Array], Array]


@dataclass(frozen=True, eq=False)
class MidpointMoment:
    """The load at the middle of a step: ``m = m_space + Σ M_i d_{i,m} + m_state(q_m, w_m)``."""

    body: Array  # (3,) M
    space: Array  # (3,)
    state: State | None = None  # (q_m, w_m) -> (3,)
    forces: State | None = None  # (q_m, w_m) -> (3, 3), on the directors

    def spatial(self, qm: Array, w: Array) -> Array:
        """Return the terms that are not given along the moving directors."""
        return self.space if self.state is None else self.space + self.state(qm.astype(float), w.astype(float))

    def value(self, q0: Array, u: Array, h: float) -> Array:
        """Return the spatial moment m at the averaged directors and the velocities `u`."""
        qm = q0 + h / 2 * u
        m: Array = self.spatial(qm, cross(qm, u).sum(0) / 2) + self.body @ qm
        return m

    def on_directors(self, q0: Array, u: Array, h: float) -> Array:
        """Return the director forces at the averaged directors and the velocities `u`, (3, 3)."""
        if self.forces is None:
            return np.zeros((3, 3))
        qm = q0 + h / 2 * u
        return self.forces(qm.astype(float), (cross(qm, u).sum(0) / 2).astype(float))

    def derivative(self, q0: Array, u: Array, h: float) -> Array:
        """Return dm/du, (3, 9): exact for the first two terms, by forward differences for the third."""
        G = np.zeros((3, 9))
        G += h / 2 * np.kron(self.body, I3)
        if self.state is None:
            return G
        rest = MidpointMoment(np.zeros(3), np.zeros(3), self.state)
        delta, base = np.sqrt(EPS) * max(1.0, abs(u).max()), rest.value(q0, u, h)
        shifted = [rest.value(q0, u + delta * e.reshape(3, 3), h) for e in np.eye(9)]
        G += (np.array(shifted) - base).T / delta
        return G


def equations(
    x: Array, q0: Array, v0: Array, h: float, E: Array, A: Array, dead: Array, load: MidpointMoment
) -> tuple[Array, Array]:
    """Return the residual of eq-discrete-nonholonomic and its Jacobian at ``x = (u - v_n, λ, μ)``."""
    y, lam, c = x[:9].reshape(3, 3), x[9:], len(A)
    u = v0 + y
    qm, m, F = q0 + h / 2 * u, load.value(q0, u, h), load.on_directors(q0, u, h)
    L, B = np.tensordot(lam, A, 1), (A @ qm).reshape(c, 9)
    force = dead + F + cross(m, qm) / 2
    residual = np.concatenate([(2 / h * E @ y + L @ qm - force).ravel(), B @ u.ravel()])

    G = load.derivative(q0, u, h)
    J = np.zeros((9 + c, 9 + c))
    J[:9, :9] = np.kron(2 / h * E + h / 2 * L, I3) - h / 4 * np.kron(I3, cross(m, I3).T)
    J[:9, :9] -= cross(G.T[:, None], qm).reshape(9, 9).T / 2
    if load.forces is not None:
        delta = np.sqrt(EPS) * max(1.0, abs(u).max())
        moved = [load.on_directors(q0, u + delta * e.reshape(3, 3), h) - F for e in np.eye(9)]
        J[:9, :9] -= np.array(moved).reshape(9, 9).T / delta
    J[:9, 9:] = B.T
    J[9:, :9] = B + h / 2 * (np.swapaxes(A, 1, 2) @ u).reshape(c, 9)
    return residual, J


def newton(
    function: Callable[[Any], tuple[Any, Array]], x: Any, size: Callable[[Any], float], scale: float
) -> tuple[Array, float, int, bool]:
    """Iterate until the increment stops decreasing; return the solution, the residual, the iterations, the success.

    The increment of ``size(dx)`` counts as round-off below 1e-9 of the larger of `scale` and ``size(x)``.
    """
    x = x.copy()
    previous = residual = np.inf
    for iteration in range(1, ITERATIONS + 1):
        r, jacobian = function(x)
        residual = float(abs(r).max())
        try:
            dx = np.linalg.solve(jacobian, -r.astype(float))
        except np.linalg.LinAlgError:
            return x, residual, iteration, False
        x += dx
        increment, level = size(dx), max(scale, size(x))
        if not np.isfinite(increment):
            return x, residual, iteration, False
        if increment <= EPS * level or (increment > previous / 2 and increment <= 1e-9 * level):
            return x, residual, iteration, True
        previous = increment
    return x, residual, ITERATIONS, False


def step(k: int, q0: Array, v0: Array, h: float, E: Array, A: Array, dead: Array, load: MidpointMoment) -> Step:
    """Take one step of eq-discrete-nonholonomic.

    Parameters
    ----------
    k : int
        Number of the step, for the message of a failure.
    q0, v0 : (3, 3) arrays of `Extended`, 1 and 1/s
        Directors and their velocities, as rows.
    h : float, s
    E : (3, 3) array, kg m²
        Euler inertia.
    A : (6, 3, 3) or (7, 3, 3) array
        Constraint matrices.
    dead : (3, 3) array, N m
        Constant director forces.
    load : MidpointMoment
    """
    x0 = np.zeros(9 + len(A), dtype=Extended)
    try:
        x, residual, iterations, converged = newton(
            lambda x: equations(x, q0, v0, h, E, A, dead, load), x0, lambda x: float(abs(x[:9]).max()), abs(v0).max()
        )
        y, lam = x[:9].reshape(3, 3), x[9:]
        u = v0 + y
        m = load.value(q0, u, h)
    except ValueError as error:
        return Step(q0, v0, np.zeros(len(A)), np.zeros(3), 0.0, 0, Failure(Status.LOAD, k, np.nan, np.nan, str(error)))
    qm = q0 + h / 2 * u
    spin = cross(qm, u).sum(0)
    inertia = (np.sum(qm**2) * I3 - qm.T @ qm).astype(float)
    turn = h * float(np.linalg.norm(np.linalg.solve(inertia, spin.astype(float)))) if converged else np.nan
    failure = None
    if not converged:
        failure = Failure(Status.STALLED, k, residual, h * float(np.linalg.norm(cross(q0, v0).sum(0))) / 2)
    elif turn > np.pi:
        failure = Failure(Status.TURN, k, residual, turn)
    F = load.on_directors(q0, u, h)
    work, moment = h / 2 * float(m @ spin) + h * float(np.sum(F * u)), inertia @ m / 2 + cross(qm, F).sum(0)
    return Step(q0 + h * u, v0 + 2 * y, lam, moment, work, iterations, failure)


@dataclass(frozen=True)
class ReferenceEnergyMomentum(Integrator):
    """The scheme step by step in 16 unknowns: what `energy_momentum` is tested against."""

    name: ClassVar[str] = "reference-energy-momentum"
    orders: ClassVar[tuple[int, ...]] = (2,)
    order: int = 2

    def march_one(self, problem: IVP) -> March:
        """Integrate `problem` step by step."""
        system, load = problem.system, problem.load
        A = constraint_matrices(system.axis)
        middle = problem.nodes(np.arange(problem.steps), np.array([0.5]))
        body, space = load.sample(middle, "body"), load.sample(middle, "space")

        forces = Load(tuple(term for term in load.terms if isinstance(term, DirectorForces)))
        moments = Load(tuple(term for term in load.terms if not isinstance(term, DirectorForces)))

        def one(k: int, q: Array, v: Array) -> Step:
            t = middle[k]
            state = (lambda d, w: state_moment_at(moments, t, d, w)) if moments.depends_on_state else None
            on_directors = (lambda d, w: forces_at(forces, t, d, w)) if forces.terms else None
            moment = MidpointMoment(body[k], space[k], state, on_directors)
            return step(k, q, v, problem.step_at(k), system.euler_inertia, A, system.dead_force, moment)

        return march(problem, len(A), one, Extended)
