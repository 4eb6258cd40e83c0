"""Validation of compiled steps, and their reference implementations.

**compiled**: The compiled steps compared with reference implementations that share no code.

The director scheme in two or three unknowns is compared with the paper's form in 16, and lie-midpoint with its
equations in NumPy, over 200 steps of 0.005 s. A random body moves under moments along its directors and along fixed
axes, the heavy body also with damping. λ and μ have the round-off of the velocities times |E|/h: their bound is
1e-11 max(1, |λ|), and the number below is the largest fraction of it.

The steps of `energy_momentum` and `lie_midpoint` as equations in all unknowns: what compiled ones are compared with.

**energy-momentum** as the paper writes it, in 16 unknowns (eq-discrete-nonholonomic, sec-integration). Rows of q are
the directors, ``<A_k q, v> = 0`` the constraints (`models.equations`), E the Euler inertia. The step from (q_n, v_n)
has the unknowns u = (q_{n+1} - q_n)/h, λ and, for a body with a constrained axis, μ:

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

**lie-midpoint** as its module derives it, in W_m - W_n and μ:

    (2/h) J (W_m - W_n) = J W_m × W_m + Λ_m⁻¹ m - μ n,          n·W_m = 0.

Both are solved by Newton's iteration with a Jacobian by forward differences.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..driver.runs import integrate
from ..geometry.arrays import Array, cross
from ..integrators.integrator import IVP, Integrator, March
from ..integrators.stepping import StepResult, march_by_steps
from ..loads import body_moment, damping, space_moment
from ..loads.load import Load, forces_at, state_moment_at
from ..loads.potentials import DirectorForces
from ..models.equations import constraint_matrices
from ..models.system import DirectorSystem
from .checks import Check
from .problems import Arguments, error, random_body, random_kinds, random_start

Extended = np.longdouble
EPS = float(np.finfo(np.float64).eps)
ITERATIONS = 40
I3 = np.eye(3)


class MidpointLoad(NamedTuple):
    """The load at the middle of a step: moments along the directors, in space and of the state, director forces.

    Those of the state are functions of the directors and the angular velocity, (3, 3) and (3,).
    """

    body: Array  # (3,)
    space: Array  # (3,)
    moment: Callable[[Array, Array], Array] | None = None  # (3,)
    forces: Callable[[Array, Array], Array] | None = None  # (3, 3)

    def in_space(self, q: Array, w: Array) -> Array:
        """Return the moment that is not given along the moving directors; states may have leading axes."""
        return self.space + _of_states(self.moment, q, w)

    def on_directors(self, q: Array, w: Array) -> Array:
        """Return the director forces."""
        return np.zeros((3, 3)) + _of_states(self.forces, q, w)


def _of_states(function: Callable[[Array, Array], Array] | None, q: Array, w: Array) -> Any:
    if function is None:
        return 0.0
    q, w = q.astype(float), w.astype(float)
    return function(q, w) if w.ndim == 1 else np.array([function(*one) for one in zip(q, w, strict=True)])


def newton(residual: Callable[[Array], Array], unknowns: int, velocities: int, scale: float) -> tuple[Any, int]:
    """Iterate from zero until the increment of the first unknowns, `velocities`, stops decreasing.

    It counts as round-off below 1e-9 of the larger of `scale` and these unknowns. `residual` takes rows. Returned are
    the unknowns, of `Extended`, and the number of iterations.
    """
    x: Any = np.zeros(unknowns, dtype=Extended)
    delta, previous = np.sqrt(EPS) * max(1.0, scale), np.inf
    for iteration in range(1, ITERATIONS + 1):
        r, *moved = residual(x + delta * np.eye(1 + unknowns, unknowns, -1))
        dx = np.linalg.solve(((np.array(moved) - r).T / delta).astype(float), -r.astype(float))
        x = x + dx
        increment, level = float(abs(dx[:velocities]).max()), max(scale, float(abs(x[:velocities]).max()))
        if increment <= EPS * level or (increment > previous / 2 and increment <= 1e-9 * level):
            return x, iteration
        previous = increment
    raise ArithmeticError("Newton's iteration of a reference step does not converge")


def director_step(q0: Array, v0: Array, h: float, E: Array, A: Array, dead: Array, load: MidpointLoad) -> StepResult:
    """Take one step of eq-discrete-nonholonomic.

    Parameters
    ----------
    q0, v0 : (3, 3) arrays of `Extended`, 1 and 1/s
        Directors and their velocities, as rows.
    h : float, s
    E : (3, 3) array, kg m²
        Euler inertia.
    A : (6, 3, 3) or (7, 3, 3) array
        Constraint matrices.
    dead : (3, 3) array, N m
        Constant director forces.
    load : MidpointLoad
    """

    def middle(x: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return u, the directors, their angular velocity, the moment and the director forces at the middle."""
        u = v0 + x[..., :9].reshape(*x.shape[:-1], 3, 3)
        qm = q0 + h / 2 * u
        w = cross(qm, u).sum(-2) / 2
        return u, qm, w, load.in_space(qm, w) + load.body @ qm, load.on_directors(qm, w)

    def residual(x: Array) -> Array:
        u, qm, _, m, F = middle(x)
        reaction = np.tensordot(x[..., 9:], A, 1) @ qm
        balance = 2 / h * E @ (u - v0) + reaction - dead - F - cross(m[..., None, :], qm) / 2
        tangent = (A @ qm[..., None, :, :] * u[..., None, :, :]).sum((-2, -1))
        return np.concatenate([balance.reshape(*x.shape[:-1], 9), tangent], axis=-1)

    x, iterations = newton(residual, 9 + len(A), 9, float(abs(v0).max()))
    u, qm, w, m, F = middle(x)
    inertia = (np.sum(qm**2) * I3 - qm.T @ qm).astype(float)
    work, moment = h * float(m @ w) + h * float(np.sum(F * u)), inertia @ m / 2 + cross(qm, F).sum(0)
    return StepResult(q0 + h * u, 2 * u - v0, x[9:], moment, work, iterations, None)


def body_step(system: DirectorSystem, q0: Array, v0: Array, h: float, load: MidpointLoad) -> StepResult:
    """Take one step of lie-midpoint; parameters as those of `director_step`."""
    J, axis = system.convected_inertia, np.zeros((0, 3)) if system.axis is None else system.axis[None]
    W0: Any = np.zeros(3, dtype=Extended)
    for _ in range(3):  # directors are orthonormal in double precision alone
        W0 = W0 + q0 @ cross(q0, v0 - cross(W0 @ q0, q0)).sum(0) / 2
    W0 = W0 - (axis @ W0) @ axis

    def middle(W: Array) -> tuple[Array, Array]:
        """Return the moment of the load in space, and all moments along the directors."""
        a = h / 2 * W[..., None, :]
        back = I3 + cross(a, I3)
        qm = ((back + a * a.swapaxes(-1, -2)) / (1 + (a * a).sum(-1, keepdims=True))) @ q0
        m = load.in_space(qm, W @ q0)
        M = load.body + (back @ (q0 @ (m + cross(qm, system.dead_force).sum(-2))[..., None]))[..., 0]
        return m + load.body @ qm, M

    def residual(x: Array) -> Array:
        y, mu = x[..., :3], x[..., 3:]
        W = W0 + y
        return np.concatenate([2 / h * y @ J - cross(W @ J, W) - middle(W)[1] + mu @ axis, W @ axis.T], axis=-1)

    x, iterations = newton(residual, 3 + len(axis), 3, float(abs(W0).max()))
    W = W0 + x[:3]
    m, _ = middle(W)
    a = h / 2 * W
    q1: Array = (2 * (I3 + cross(a, I3) + np.outer(a, a)) / (1 + a @ a) - I3) @ q0
    v1 = cross((2 * W - W0) @ q1, q1)
    return StepResult(q1, v1, x[3:], m, h * float((W @ q0) @ m), iterations, None)


def _marched(problem: IVP, count: int, step: Callable[[Array, Array, float, MidpointLoad], StepResult]) -> March:
    """March step by step, with `count` multipliers."""
    middle = problem.nodes(np.arange(problem.steps), np.array([0.5]))
    body, space = problem.load.sample(middle, "body"), problem.load.sample(middle, "space")
    forces = Load(tuple(term for term in problem.load.terms if isinstance(term, DirectorForces)))
    moments = Load(tuple(term for term in problem.load.terms if not isinstance(term, DirectorForces)))

    def one(k: int, q: Array, v: Array) -> StepResult:
        t = middle[k]
        moment = (lambda d, w: state_moment_at(moments, t, d, w)) if moments.depends_on_state else None
        on_directors = (lambda d, w: forces_at(forces, t, d, w)) if forces.terms else None
        return step(q, v, problem.step_at(k), MidpointLoad(body[k], space[k], moment, on_directors))

    return march_by_steps(problem, count, one, Extended)


@dataclass(frozen=True)
class ReferenceEnergyMomentum(Integrator):
    """The director scheme in 16 unknowns."""

    name: ClassVar[str] = "reference-energy-momentum"
    orders: ClassVar[tuple[int, ...]] = (2,)
    order: int = 2

    def march_one(self, problem: IVP) -> March:
        """Integrate `problem` step by step."""
        A, E, dead = constraint_matrices(problem.system.axis), problem.system.euler_inertia, problem.system.dead_force
        return _marched(problem, len(A), lambda q, v, h, load: director_step(q, v, h, E, A, dead, load))


@dataclass(frozen=True)
class ReferenceLieMidpoint(Integrator):
    """The midpoint scheme of the body in W_m and μ."""

    name: ClassVar[str] = "reference-lie-midpoint"
    orders: ClassVar[tuple[int, ...]] = (2,)
    order: int = 2

    def march_one(self, problem: IVP) -> March:
        """Integrate `problem` step by step."""
        system = problem.system
        return _marched(problem, int(system.axis is not None), lambda *step: body_step(system, *step))


STEP, SPAN = 0.005, 1.0
PLAIN: dict[str, tuple[Integrator, str]] = {
    "energy-momentum": (ReferenceEnergyMomentum(), "eq-discrete-nonholonomic"),
    "lie-midpoint": (ReferenceLieMidpoint(), "nontwist.integrators.lie_midpoint"),
}


def parity() -> Iterator[Check]:
    """Compare states and multipliers of a random body of every kind."""
    for seed, (words, (kind, heavy)) in enumerate(random_kinds().items()):
        rng = np.random.default_rng(seed)
        body, start, load = random_body(kind, heavy, rng), random_start(rng), random_load(rng)
        if heavy:
            load = load + damping(rng.uniform(0, 0.3, size=3))
        how: Arguments = {"t_end": SPAN, "step": STEP, "load": load, **start}
        for scheme, (plain, source) in PLAIN.items():
            one, other = integrate(body, integrator=scheme, order=2, **how), integrate(body, integrator=plain, **how)
            speed = float(abs(other.director_velocities).max())
            gaps = [one.directors - other.directors, (one.director_velocities - other.director_velocities) / speed]
            yield error(f"{scheme}, {words}: states", gaps, 1e-11, source, "independent")
            if one.multipliers.size:
                title = f"{scheme}, {words}: λ and μ, fraction of the bound"
                gap = (one.multipliers - other.multipliers) / (1e-11 * np.maximum(1, abs(other.multipliers)))
                yield error(title, gap, 1.0, source, "independent")


def random_load(rng: np.random.Generator) -> Load:
    """Return a moment along the directors and one along fixed axes, both smooth."""
    a, b = rng.normal(size=(2, 3))
    return body_moment(lambda t: a * np.sin(2 * t)) + space_moment(lambda t: b * np.cos(t))


CHECKS = {"compiled": (parity,)}
