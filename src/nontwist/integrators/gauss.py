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

- impulse: π = Λ P, whose rows are c_k·P, and ``(c_k × W)·P + c_k·(P × W) = 0``, so Δπ = h Σ b_i (Λ_i (M_i - C_d W_i +
  Σ e_j × Λ_iᵀ f^j - μ_i n) + m_i): free motion keeps π. For this a moment in space enters as Λ_i⁻¹ m_i, not as
  Λ_iᵀ m_i: the stages are not orthonormal. So Λ_i (e_j × Λ_iᵀ f^j) is not d_{j,i} × f^j either, but to the order;
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
of the collocation in the rows. So of the impulse of a heavy body only the vertical part, 0, is exact: the horizontal
part of Δπ is h Σ b_i Λ_i (Σ e_j × Λ_iᵀ f^j - μ_i n) to the order, with the Λ_i of the stages or any other of that
order. Where W stands still C = exp(h Ŵ).

The quaternion is only the store, p ← p ⊗ q(C), compensated and normalised: collocation in quaternions is another
discrete solution, which loses the vertical momentum and the impulse.

Gauss collocation is not L-stable: |R(-1000)| = 0.80 ... 0.996. Drag with h λ > 2s, λ the largest eigenvalue of
J⁻¹ C_d, is solved, and K never rises, but such modes are not resolved: a run says so (`costs.unresolved`), unless short
steps have let them decay before, as those of a tolerance do.

Nothing drifts linearly with time: the coefficients are exactly symplectic in floating point (`gauss_coefficients`), an
iteration that stops leaves no bias (`gauss_stages`), and what the quaternion is rounded by turns with it
(`turned_and_normalised`). Energy and momentum change like the root of the number of steps.
The first guess extrapolates the last step; its increments belong to the state that a run leaves, so that a run that
resumes has the same bits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from math import comb, perm
from typing import Any, ClassVar

import numpy as np

from ..engine.generalised import STAGE
from ..engine.known_steps import Wanted
from ..engine.marching import PI, Step, Text, turned_and_normalised
from ..engine.records import Parts, State
from ..engine.sampling import TINY, Nodes
from ..engine.workspace import add_to_integrals, observe_at
from ..geometry.arrays import Array
from ..kernels.control import Variables, loop, when
from ..kernels.elements import any_of, cos, larger, select, sin, smaller, sqrt, without
from ..kernels.kernel import Kernel
from ..kernels.machine_code import tracer
from ..kernels.memory import View, size_of
from ..kernels.vectors import Matrix, Quaternion, Vector, attitude, compensated, cross, first_moment, sum_of
from ..loads import Load
from ..models.stack import SystemStack
from .compiled import ONCE, Compiled, Needs
from .gauss_coefficients import TABLE, WIDTH, nodes, table
from .gauss_memory import StageMemory
from .gauss_newton import lanes_where, rows_by_elimination, solve_stages, unknowns
from .gauss_stages import CHECKED, OVERFLOW, Equations, Stage, Stages, TurnEquations, axes_at, iterated

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
    >>> from nontwist import simulate, standard
    >>> from nontwist.integrators import Gauss
    >>> scheme = Gauss(order=12)
    >>> run = simulate(standard([3, 4, 5]), t_end=10, step=0.5, angular_velocity=(0.1, 2, 0.1), integrator=scheme)
    >>> run.kinetic_energy.values[[0, -1]].round(9)
    array([8.04, 8.04])
    """

    name: ClassVar[str] = "gauss"
    remembers: ClassVar[bool] = True
    splits_steps: ClassVar[bool] = True
    orders: ClassVar[tuple[int, ...]] = (2, 4, 6, 8, 12, 16)
    is_a_stable: ClassVar[bool] = True
    substep_ns: ClassVar[float] = 500.0
    sources: ClassVar[Mapping[str, str]] = {
        "order": "Hairer, Lubich & Wanner, II.1.3",
        "invariant": "Hairer, Lubich & Wanner, IV.2.1; nontwist.integrators.gauss",
    }
    counts: ClassVar[dict[int, Any]] = Compiled.counts | {8: (12, 16, 20), 12: (14, 16, 20), 16: (10, 12, 16)}
    controlled_orders: ClassVar[tuple[int, ...]] = (4, 8, 12, 16)
    order: int = 8

    @property
    def automatic(self) -> float | None:
        """The tolerance of a run for which neither step nor tolerance is given; None: at most 0.05 rad per step."""
        return 1e-8 if self.order > 2 else None

    @property
    def largest_turn(self) -> float:
        """The turn per step up to which fixed-point iterations contract and stages are nearly orthonormal, rad.

        For a steady rotation by θ per step, the iteration of the rows contracts by θ ρ(A), where A is the matrix of the
        method, and the stages (1 - iθA)⁻¹ 1 leave the unit circle. Up to this turn the first is at most 0.5, the second
        at most 0.1 (0.2 for order 2). Measurements on tumbling bodies whose fastest stage turns by θ agree with both
        bounds.
        """
        return LARGEST_TURN[self.order]

    def has_series(self, systems: SystemStack, load: Load) -> bool:
        """Whether its nodes lie on one trajectory, nearly, and the equations between them can be run on series."""
        return self.order > 2 and load.is_series and (systems.spin is None or systems.spin.is_constant)

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

    def text(self, motion: str) -> Text:
        """Return the text of the step."""
        return text_of(self.nodes, motion)

    def motion(self, parts: Parts, is_nonprincipal: bool, has_vertical: bool) -> str:
        """Return the kind of motion, by the vectors of space that are unknowns: "rows" where those are all three."""
        if is_nonprincipal or not parts.is_along_frame:
            return "rows"
        if parts.dead:
            return "heavy" if has_vertical and not parts.moving else "rows"
        return "moved" if parts.moving else "steady" if parts.is_constrained else "free"

    def stages(self, parts: Parts) -> tuple[Array, Array]:
        """Return the one fraction of a step that is taken at once, and the nodes of the load."""
        return ONCE, nodes(self.order)

    def linear(self, parts: Parts, wanted: Wanted) -> Kernel:
        """Return what linearises the steps of bodies."""
        from .gauss_derivatives import linearised_stages

        return linearised_stages(self.nodes, parts.motion, parts, wanted)

    @property
    def needs(self) -> Needs:
        """What a march has to have: increments of the last step, memory of stages and of systems of equations."""
        return Needs(STAGE, table(self.order), COMPONENTS * self.nodes, scratch_sizes)


def scratch_sizes(internal: int) -> tuple[int, int]:
    """Return the numbers of stages of a body with so many internal states, and of Newton's iteration."""
    side, m = 3 * WIDTH, unknowns(internal) * WIDTH
    newton = side * (2 * side + 3) + 2 * m * (m + 1) + WIDTH + (7 + internal) * (9 + internal)
    return (size_of(Stage) + 3 * internal) * WIDTH, newton


# The step.

COMPONENTS = 6  # of the increments that a member carries
FAINT = 1e-280  # square of a vector that has no direction any more
SLIGHT = 1e-150  # rad, of which the sine is the angle itself
SMALLEST = 0.1  # determinant of the rows of a stage


@lru_cache
def text_of(s: int, motion: str) -> Text:
    """Return the text of the steps of s stages for a motion."""

    def step(nodes: Nodes, state: State, alive: Any) -> Step:
        n, t = nodes.parts.lanes, tracer()  # of one body all stages are evaluated at once, where there are vectors
        y = Stages(nodes.memory, nodes.table, s, n, n, n == 1 and t is not None and t.has_vectors)
        return steady_step(nodes, state, y) if motion == "steady" else collocated(nodes, state, alive, y, motion)

    return Text(step, auxiliary=1, integrates=True, exchange=exchange)


def exchange(parts: Parts, b: View, memory: Any, first: Any, last: Any, back: bool) -> None:
    """Bring the increments that the members carry into the memory of their stages, or back."""
    s, n = parts.nodes, parts.lanes
    for l in loop(last - first) if back else loop(n):
        own = b.states.shifted(b.order[smaller(first + l, last - 1)] * b.state_size + size_of(State))
        for c in loop(COMPONENTS):
            for j in loop(s):
                if back:
                    own[c * s + j] = memory[(c * WIDTH + j) * n + l]
                else:
                    memory[(c * WIDTH + j) * n + l] = own[c * s + j]


def collocated(nodes: Nodes, state: State, alive: Any, y: Stages, motion: str) -> Step:
    """Take a step: its stages, the turn, and what the interval gets of it."""
    parts, body, h, P, s = nodes.parts, nodes.body, nodes.h, state.s, y.number
    memory = StageMemory(nodes, y) if parts.memory else None
    e, k, zero = Equations(motion, nodes, y, P, memory), body.k, 0.0 * P[0]
    e.sample()
    if memory:
        memory.clear()
    unchecked = state.auxiliary[0] if e.is_eager else 0.0
    for_newton, used = iterated(e, alive, TABLE.guess, unchecked, state.compensation)
    v = Variables(for_newton=for_newton, used=used, residual=zero)
    for _ in when(any_of(for_newton)):
        solve_stages(nodes, y, state, motion, for_newton, v)
    least = e.ended(without(alive, for_newton))
    dP, (torque, work, arc), turn = y.total("dp"), y.total("sum"), y.total("angle")
    next_P, next_compensation = compensated(P, state.compensation, dP)
    if e.has_rows or motion == "moved":
        names = e.names[1:] if e.has_rows else rows_of_turn(y, nodes, alive).names
        cosm1, w = quaternion_of(Matrix(*map(y.total, names)))
    elif motion == "heavy":
        cosm1, w = about_a_line(y, h, "g0", e.start[0], e.start[0] + y.total("dg0"), 1.0)
    else:
        f = select(P @ P > FAINT, 1.0 / (sqrt(P @ P) + TINY), 0.0)
        cosm1, w = about_a_line(y, h, "P", P, next_P, f)
    p, c, gap = turned_and_normalised(state.p, state.c, cosm1, w)
    if e.orbit is not None:
        n, o = nodes.orbit
        half = 0.5 * n * h
        q = Quaternion(cos(half), *(sin(half) * o))
        p, c = q @ p, q @ c
    far = (arc > 0.5 * PI * (s + 1.0)) | (least > -SMALLEST)
    auxiliary = (larger(select(for_newton, 0.0, used - CHECKED), zero) if e.is_eager else zero,)
    gap = select(arc <= OVERFLOW, gap, arc)
    W = k * P
    how_far = select(arc <= OVERFLOW, arc, h * sqrt(W @ W))
    found = Step(State(p, next_P, next_compensation, c, auxiliary), v.for_newton, far, gap, v.used, v.residual, how_far)
    if not parts.needs_means:
        return found
    mu = torque
    if parts.is_constrained:
        mu = mu - (body.off[0] * k[0] * dP[0] + body.off[1] * k[1] * dP[1])
    if parts.spin:
        mu = mu - dP[2]
    found = found._replace(mu=mu / h, twist=body.axis @ turn)
    if parts.integrates_velocity:
        velocity_moment = sum_of(*(nodes.time(j) * y.one(j).angle for j in range(s)))
        found = found._replace(velocity_integral=turn, velocity_moment=velocity_moment)
    return with_means(e, y, alive, motion, found, work)


def with_means(e: Equations, y: Stages, alive: Any, motion: str, found: Step, work: Any) -> Step:
    """Return what a step gives, with the mean moments; take its stages into the integrals of what is observed."""
    nodes, parts, R = e.nodes, e.parts, e.nodes.R
    has_dead = parts.dead and parts.is_constrained and motion in ("heavy", "rows")
    has_own = motion == "moved" or (e.has_rows and (parts.moving or parts.damping or parts.rotor or parts.memory))
    has_push = e.has_rows and (parts.space or parts.calls)
    if motion in ("free", "heavy") and (has_dead or parts.observes):
        rows_of_turn(y, nodes, alive)

    def mean(moment: Any) -> Vector:
        total = Variables(m=0.0 * e.P)
        for j in loop(y.number):
            stage = y.one(j)
            total.m = total.m + y.table[TABLE.weights + j] * moment(stage, axes_at(stage))
        return R @ total.m

    if has_own or has_push:

        def moment(stage: View, C: Matrix) -> Vector:
            own, space = C @ stage.own if has_own else None, stage.space if has_push and parts.space else None
            return sum_of(own, space, stage.of_functions if has_push and parts.calls else None)

        found = found._replace(moment=mean(moment), work=work)
    if has_dead:
        dead = nodes.dead()
        found = found._replace(dead=mean(lambda _, C: C @ first_moment(Matrix(*(row @ C for row in dead)))))
    if parts.observes:
        observe_stages(nodes, y)
    return found


def rows_of_turn(y: Stages, nodes: Nodes, alive: Any) -> TurnEquations:
    """Find the rows of the turn at all stages from the velocities there."""
    e, h = TurnEquations(nodes, y), nodes.h
    for_newton, _ = iterated(e, alive)
    for _ in when(any_of(for_newton)):
        for l in lanes_where(for_newton, y.lanes):
            rows_by_elimination(y.lane(l), nodes.memory.shifted(size_of(Stage) * WIDTH * y.lanes), h)
    e.end()
    return e


def observe_stages(nodes: Nodes, y: Stages) -> None:
    """Take the stages into the integrals over time of what is observed."""
    x, table = nodes.x, y.table
    before = x.observed.work
    for i in loop(y.number):
        work = before
        for j in range(y.number):
            work = work + table[TABLE.mu + WIDTH * j + i] * y.one(j).sum[1]
        x.observed.work, x.velocity = work, y.one(i).W
        observe_at(x, False, nodes.R @ axes_at(y.one(i)))
        add_to_integrals(x, nodes.h * table[TABLE.weights + i])
    x.observed.work = before


# The turn.


def quaternion_of(D: Matrix) -> tuple[Any, Vector]:
    """Return (c - 1, v), c >= 0, of the quaternion (c, v) of a rotation with the rows I + D (Shepperd)."""
    d, trace = [1.0 + D[k][k] for k in range(3)], D.trace
    u = Vector(D[2][1] - D[1][2], D[0][2] - D[2][0], D[1][0] - D[0][1])
    a, b, c = D[0][1] + D[1][0], D[0][2] + D[2][0], D[1][2] + D[2][1]
    q, best = Quaternion(4.0 + trace, *u), 3.0 + trace
    for k in range(3):
        t, wins = 1.0 + 2.0 * d[k] - (d[0] + d[1] + d[2]), d[k] > best
        q = select(wins, Quaternion(*((u[0], t, a, b), (u[1], a, t, c), (u[2], b, c, t))[k]), q)
        best = select(wins, d[k], best)
    f = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    f = select(q[0] >= 0.0, f, -f)
    v = f * q.vector
    return -(v @ v) / (1.0 + f * q[0]), v


def half_angle(angle: Any) -> tuple[Any, Any]:
    """Return (cos - 1, sin) of half an angle."""
    quarter = sin(0.25 * angle)
    return -2.0 * quarter * quarter, sin(0.5 * angle)


def about_a_line(y: Stages, h: Any, name: str, g0: Vector, g1: Vector, f: Any) -> tuple[Any, Vector]:
    """Return (c - 1, v) of the quaternion (c, v) of the turn of a step of which one direction in space is known.

    f g_0 and f g_1 are its unit vectors as seen from the body at both ends, f g that of the stages. A turn so faint
    that its square is lost is none.
    """
    g0, g1 = f * g0, f * g1
    r = line(y.total("angle"), g0, g1)
    for _, stage in y.each():
        stage.axial = arc(stage.angle, f * getattr(stage, name), r)
    q = turned_about(r, y.total("axial"), g0, g1)
    f = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return f * q[0] - 1.0, f * q.vector


def line(w: Vector, g0: Vector, g1: Vector) -> Vector:
    """Return r, along w or its opposite."""
    d = select(w @ w > FAINT, 1.0 / (sqrt(w @ w) + TINY), 0.0)
    return select(g0 @ w + g1 @ w >= 0.0, d, -d) * w


def arc(angle: Vector, g: Vector, r: Vector) -> Any:
    """Return what a stage adds to ψ."""
    return (angle @ (g + r)) / (1.0 + g @ r)


def turned_about(r: Vector, psi: Any, g0: Vector, g1: Vector) -> Quaternion:
    """Return the quaternion of C, of any length."""
    cosm1, sine = half_angle(psi)
    return smallest(g0, r, -1.0) @ Quaternion(1.0 + cosm1, *(sine * r)) @ smallest(g1, r, 1.0)


def smallest(g: Vector, r: Vector, sign: float) -> Quaternion:
    """Return the quaternion of the smallest rotation of g to r, of any length; that back for the sign -1."""
    v = cross(g, r)
    return Quaternion(1.0 + g @ r, *(v if sign > 0.0 else -v))


def about(turn: Vector) -> tuple[Any, Vector]:
    """Return (c - 1, v) of the quaternion (c, v) that turns by a rotation vector."""
    angle = sqrt(turn @ turn)
    cosm1, sine = half_angle(angle)
    return cosm1, select(angle > SLIGHT, sine / (angle + TINY), 0.5) * turn


def steady_step(nodes: Nodes, state: State, y: Stages) -> Step:
    """Take a step of a body whose momentum stands still."""
    h, P, W = nodes.h, state.s, nodes.body.k * state.s
    zero, turn, far_turn = 0.0 * P[0], h * W, abs(h) * sqrt(W @ W)
    p, c, gap = turned_and_normalised(state.p, state.c, *about(turn))
    never, far = zero > 1.0, far_turn > 0.5 * PI * (y.number + 1.0)
    after = state._replace(p=p, c=c, auxiliary=(zero,))
    found = Step(after, never, far, select(far_turn <= OVERFLOW, gap, far_turn), zero, zero, turn=far_turn)
    if not nodes.parts.needs_means:
        return found
    if nodes.parts.observes:
        for j in loop(y.number):
            cosm1, v = about(h * y.table[TABLE.nodes + j] * W)
            stage = y.one(j)
            stage.g0, stage.g1, stage.g2 = attitude(Quaternion(1.0 + cosm1, *v))
            stage.W, stage.sum = W, 0.0 * W
        observe_stages(nodes, y)
    return found._replace(mu=cross(P, W)[2], twist=nodes.body.axis @ turn)
