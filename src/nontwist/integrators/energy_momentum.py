"""The paper's energy-momentum step in two unknowns, three where the body may twist (eq-discrete-nonholonomic).

`nontwist.validation.compiled_steps` holds the same step in 16 unknowns, with the reason why it keeps energy,
momenta and orthonormality. Here it is solved for the increment y of one angular velocity; no constraint is left among
the equations.

Frame. Everything is written in the frame b of the engine at the beginning of the step: ``d_{i,n} = e_i``, director
velocities V_i, ``P_i = Σ_j E_ij V_j``. Under the constraint n is its third direction, and E has the entries E13 and E23
beside its diagonal. Every V_i splits into ``W × e_i + N_i`` with W = ½ Σ e_i × V_i and N symmetric; N is the
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
``G = ½ [(1 + s)(B + f - a × f) + s (a·(B + f)) a]``; damping C is B = -s C Ω. On the constrained body y·n = -W·n is
known.

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

Rotors of momentum c, in b, act with the moment ``-(Λ c)'``. With the mean c_m and the rate c' of a step

    Λ_{n+1} c_{n+1} - Λ_n c_n = h Λ_n M (Ω × c_m + c'),        as (2M - 2I) c = h Ω × M c = h M (Ω × c).

Of a moment M B the work of the virtual rotations asks for ``(1/s) Mᵀ M B = B + a (a·B)`` in G: here, ``c_m × Ω - c' -
a (a·c')``, with which the total momentum is exact. In the rows it stands as ``f_i = x × d_{i,m}``, whose moment is
``M B`` for ``2x = (2 + a aᵀ) M B/(1 + s)``.

Update. ``V_i`` in the new frame is V_i + 2 Mᵀ (y × e_i - N_i): a small change of W, kept with its rounding error, and
N turns its sign at every step. Multipliers come from the rows, ``L_i = -(2/h) Σ_j E_ij (y × e_j - N_j + a × V_j)
+ (I - â) f_i``; the symmetric part of L is λ, its skew part -μ n̂/2.

Order 2. The normal part N of the director velocities at the nodes alternates. λ and μ see N times 2/h: from a tangent
start N goes to and fro between 0 and -h²/2 times the symmetric part of Ŵ Ŵ' at the start, so they alternate by O(h)
about a course of order 2, the mean of two steps, unless W or W' is 0 at the start, as in the paper's cases. Because N
turns its sign the step is no near-identity map of (q, q̇), and compositions do not raise the order of all variables.
`lie_midpoint` and `gauss` have no such part.

Indefinite E. ``E (V⁺ - V)`` is normal to the rigid velocities, so with V = u + E⁻¹ S, u rigid and S symmetric, a step
without load turns E⁻¹ S into its negative at the mean directors. ``<E⁻¹ S, S>`` is constant to the lowest order in h,
which bounds S if E is definite. In the frame of a body that turns with Ω, with -X the rigid part of Ω × E⁻¹ S, (-1)ⁿ S
follows

    S' = ½ [S, Ω̂] + ½ [E, X̂],        J X = -(tr S I - S) Ω.

About a principal axis k, ``S_ik'' = -Ω² E_i E_j/(J_i J_j) S_ik``: where one of the two is negative, S grows at the rate
``Ω √(-E_i E_j/(J_i J_j))`` from what round-off or the start give it, and ½ W·JW with it, though K is constant. At most
one E is negative, that of the largest J; only about its axis is the rotation stable.

Dissipation χ (`compiled`), for bodies without a constraint: in the principal axes, where E is diagonal, the mean
velocities u_i = ½ (V_i + V_i⁺) move the directors by

    Δd_i = h (1 + κ_i) u_i,        κ_i = χ (|V_i⁺| - |V_i|)/(|V_i⁺| + |V_i|),

the rows of momentum being what they are. Momentum: ``Σ (d_{i,m} × E_i ΔV_i + Δd_i × E_i u_i)``, the second term still
zero, so π changes by the impulse. Energy: Σ L_ij d_{j,m}·Δd_i = 0, so ``Σ (1 + κ_i) E_i u_i·ΔV_i = Σ f_i·Δd_i``, the
work, and with ``u_i·ΔV_i = ½ Δ|V_i|²``

    ΔK = work - ½ Σ κ_i E_i Δ|V_i|² = work - ½ χ Σ E_i (Δ|V_i|)²,

under any load: K + V less the work never rises. 0 where the lengths of all V_i stay, as in a permanent rotation. Of
order 1, or 2 with χ h|W| in place of χ, h|W| of the beginning of the step and at most 1.

With ``κ_i = χ (p_i - v_i)/(p_i + v_i)``, v_i and p_i the lengths of V_i and of the next one, 2u_i - V_i, it is
``(I - â) u_i = (1 + γ_i) Ω × e_i`` with ``1 + γ_i = 1/(1 + κ_i) = (p + v)/((1 + χ) p + (1 - χ) v)``: r(y) gains
``Σ E_i γ_i e_i × (Ω × e_i)``, and where y × e_i stands in rows and changes there is ``y × e_i + γ_i Ω × e_i``. p is the
solution of ``p = |2 (1 + γ) M (Ω × e_i) - V_i|``, found for each Ω.

The Jacobian of r is made by dual numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from ..engine.generalised import EXACT, PAPER
from ..engine.marching import Step, Text, midpoint_means, midpoint_step
from ..engine.newton import EPS, newton_solve
from ..engine.records import Body, State
from ..engine.sampling import Loads, MomentOfStep, Nodes, mean
from ..geometry.values import require_among
from ..kernels.control import Variables, loop
from ..kernels.dual import Dual, plain
from ..kernels.elements import fma, larger, select, sqrt
from ..kernels.kernel import part
from ..kernels.vectors import Matrix, Symmetric, Vector, cross, first_moment, sum_of, taxicab
from ..models.system import TRIANGLE
from .compiled import Dissipative, Needs
from .integrator import IVP, SPIN

MOMENTS = ("paper", "exact")
INDEFINITE = (
    "energy-momentum is unstable where Euler's inertia is indefinite (physical=False): energy and momentum stay, but "
    "director velocities that are not rigid grow, and the motion is wrong in the end; use gauss, lie-midpoint or split"
)


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

    >>> from nontwist import nontwisting, simulate
    >>> from nontwist.integrators import EnergyMomentum
    >>> body, scheme = nontwisting([3, 4, 5]), EnergyMomentum()
    >>> run = simulate(body, t_end=1, step=0.005, material_angular_velocity=(6, -18, 0), integrator=scheme)
    >>> run.constraint.values.tolist()
    ['11', '22', '33', '23', '13', '12', 'nh']
    >>> run.multipliers.sel(constraint="nh").values[[0, -1]].round(6)
    array([108., 108.])
    """

    name: ClassVar[str] = "energy-momentum"
    is_director_scheme: ClassVar[bool] = True
    remembers: ClassVar[bool] = True
    orders: ClassVar[tuple[int, ...]] = (2,)
    substep_ns: ClassVar[float] = 300.0
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
        require_among(self.moments, "moments", MOMENTS)

    def refusal(self, problem: IVP) -> str | None:
        """Return why a prescribed spin, or dissipation with a constrained axis, is not accepted."""
        return SPIN.format(self.name) if problem.systems.spin is not None else super().refusal(problem)

    def remark(self, problem: IVP) -> str | None:
        """Return a warning that Euler's inertia is indefinite, or about the step, or None."""
        E = np.linalg.eigvalsh(problem.systems.euler_inertia)
        return INDEFINITE if (E[:, 0] < -TRIANGLE * E.sum(axis=1)).any() else super().remark(problem)

    def text(self, motion: str) -> Text:
        """Return the text of the step."""
        return TEXT

    @property
    def needs(self) -> Needs:
        """What a march has to have: director forces and potentials in the form that `moments` names."""
        return Needs(PAPER if self.moments == "paper" else EXACT)


LENGTHS, TINY = 6, 1e-140  # iterations for the length of a velocity; what keeps quotients of zeros at 1


class Start(NamedTuple):
    """The beginning of a step: f = h/2, the body, W and N, and of dissipation χ."""

    f: Any
    body: Body
    W: Vector
    N: Matrix
    chi: Any


def step(nodes: Nodes, state: State, is_active: Any) -> Step:
    """Take the step: Newton's iteration for y, then the changes of W and N, and the multipliers."""
    parts, body, h, W, N = nodes.parts, nodes.body, nodes.h, state.s, Symmetric(*state.auxiliary).matrix
    loads, f, chi = nodes.loads(), 0.5 * h, None
    if parts.dissipates:
        turn = h * sqrt(W @ W)
        chi = fma(body.dissipation[1], select(turn < 1.0, turn, 1.0), body.dissipation[0])
    start = Start(f, body, W, N, chi)
    of_state = MomentOfStep(loads.functions, f, W, True)
    linear_part, across, sum_of_E = without_loads(start), sum_of(*map(taxicab, N)), sum_of(*body.E)

    def equations_at(y: Vector, is_new: Any) -> Any:
        moment = of_state.near(W + y, is_new)
        lengths = next_lengths(*plain((f, chi, W, N, W + y))) if parts.dissipates else None

        def r(y: Vector) -> Vector:
            m = sum_of(loads.space, moment(W + y))
            return residual(start, y, linear_part, loads, m, lengths, parts.is_exact)

        return r

    def sizes(y: Vector, d: Vector) -> Any:
        speed, size = taxicab(W) + taxicab(y), taxicab(d)
        terms = sum_of_E * (2.0 * taxicab(y) + across + abs(f) * (taxicab(W) + across) * speed)
        drag = abs(f) * taxicab(body.damping @ (W + y)) if parts.damping else None
        return size, EPS * speed, sum_of(terms, drag, of_state.size)

    guess = Vector(-0.0, -0.0, -W[2] if parts.is_constrained else -0.0)
    solution = newton_solve(nodes, equations_at, sizes, guess, is_active)
    y = solution.y
    Om = W + y
    a = f * Om
    s = shrinking(a)
    Y = velocity_rows(y) - N  # y × e_i - N_i, with γ_i Ω × e_i
    if parts.dissipates:
        gammas = gammas_at(start, Om, next_lengths(*plain((f, chi, W, N, Om))))
        Y = Y + Matrix(*(g * row for g, row in zip(gammas, velocity_rows(Om), strict=True)))
    Mt = twice_mean_transposed(s, a)
    X = Matrix(*(Mt @ row for row in Y))
    N_next = tuple(n + x for n, x in zip(state.auxiliary, symmetric_part(X), strict=True))
    found = midpoint_step(state, a, 0.5 * first_moment(X), N_next, solution)
    return multipliers(nodes, start, found, a, s, Y, Mt, loads) if parts.needs_means or parts.memory else found


TEXT = Text(step, auxiliary=6, is_midpoint=True)


def shrinking(a: Vector) -> Any:
    """Return s."""
    return 1.0 / (1.0 + a @ a)


def velocity_rows(W: Vector) -> Matrix:
    """Return the rows W × e_i."""
    return Matrix((0.0, W[2], -W[1]), (-W[2], 0.0, W[0]), (W[1], -W[0], 0.0))


def symmetric_part(X: Matrix) -> Symmetric:
    """Return the symmetric part of a matrix."""
    yz, xz, xy = 0.5 * (X[1][2] + X[2][1]), 0.5 * (X[0][2] + X[2][0]), 0.5 * (X[0][1] + X[1][0])
    return Symmetric(X[0][0], X[1][1], X[2][2], yz, xz, xy)


def apply_euler_inertia(body: Body, X: Matrix) -> Matrix:
    """Return the rows Σ E_ij X_j."""
    (b0, b1), (e0, e1, e2), c = body.off, body.E, body.coupling
    rows = Matrix(fma(e0, X[0], -b0 * X[2]), fma(e1, X[1], -b1 * X[2]), fma(e2, X[2], -fma(b0, X[0], b1 * X[1])))
    return rows if c is None else rows - Matrix(c * X[1], c * X[0], (0.0, 0.0, 0.0))


# The equations.


def without_loads(start: Start) -> tuple[Matrix, Vector]:
    """Return K and k of ``r(y) = K y + k`` without loads and dissipation."""
    f, body, W, N, _ = start
    EN, J = apply_euler_inertia(body, N), body.inertia
    turned = Matrix(*(cross(W, column) for column in body.euler_inertia)).T  # Ŵ E, E symmetric
    rate, tau = -(turned + EN.T), EN.trace
    rate = Matrix(*(Vector(*(x + tau if i == j else x for j, x in enumerate(row))) for i, row in enumerate(rate)))
    return fma(f, rate, J), fma(f, rate @ W, -first_moment(EN))


def residual(
    start: Start, y: Vector, linear_part: tuple[Matrix, Vector], loads: Loads, m: Any, lengths: Any, is_exact: bool
) -> Vector:
    """Return r(y); m is all that is given in space, `lengths` those of the next velocities under dissipation."""
    (K, k), f, Om = linear_part, start.f, start.W + y
    r, a, own = affine(K, y, k), f * Om, loads.moving
    if loads.damping is not None:
        own = sum_of(own, -(shrinking(a) * (loads.damping @ Om)))
    if own is not None or m is not None:
        r = r - f * moment_terms(a, own, m, is_exact)
    if loads.dead is not None:
        F = loads.dead
        r = r - f * (first_moment(F) - (F.trace * a - a @ F))
    if loads.rotor is not None:
        c, rate = loads.rotor, loads.rotor_rate
        r = r - f * (cross(c, Om) - rate - (a @ rate) * a)
    if lengths is not None:
        x, y, z = start.body.E * gammas_at(start, Om, lengths)
        r = r + Vector(Om[0] * (y + z), Om[1] * (z + x), Om[2] * (x + y))
    return r


def affine(K: Matrix, y: Vector, k: Vector) -> Vector:
    """Return K y + k, without what is known to be zero when the text is traced."""
    for column, x in reversed([*zip(K.T, y, strict=True)]):
        if not (type(x) is float and x == 0.0):
            k = fma(x, column, k)
    return k


def moment_terms(a: Vector, own: Any, m: Any, is_exact: bool) -> Vector:
    """Return what moments give to G: `own` along the mean directors, m at the beginning of the step."""
    total, acts = sum_of(own, m), sum_of(own, None if m is None else m - cross(a, m))
    if is_exact:
        return fma(a @ total, a, acts)
    s = shrinking(a)
    return 0.5 * fma(1.0 + s, acts, (s * (a @ total)) * a)


def twice_mean_transposed(s: Any, a: Vector) -> Matrix:
    """Return 2 Mᵀ."""
    g = 2.0 * s
    b, c = g * a, g * Vector(a[1] * a[2], a[2] * a[0], a[0] * a[1])
    return Matrix(
        (fma(b[0], a[0], g), c[2] + b[2], c[1] - b[1]),
        (c[2] - b[2], fma(b[1], a[1], g), c[0] + b[0]),
        (c[1] + b[1], c[0] - b[0], fma(b[2], a[2], g)),
    )


# What a step gives.


def multipliers(
    nodes: Nodes, start: Start, found: Step, a: Vector, s: Any, Y: Matrix, Mt: Matrix, loads: Loads
) -> Step:
    """Return the step with multipliers, moments and work: λ and μ of the rows L_i."""
    parts, body, f, Om, moment = nodes.parts, start.body, start.f, (1.0 / start.f) * a, None
    V = velocity_rows(start.W) + start.N
    L = (-1.0 / f) * apply_euler_inertia(body, Y + Matrix(*(cross(a, v) for v in V)))
    m = of_load = loads.space
    if parts.calls:
        state_moment = loads.functions.moment(a, s * Om)
        m, of_load = sum_of(m, state_moment), sum_of(of_load, loads.functions.load(state_moment))
    own = sum_of(loads.moving, None if loads.damping is None else -(s * (loads.damping @ Om)))
    own = None if own is None else mean(s, a, own)
    total, of_load = sum_of(own, m), sum_of(own, of_load)
    if parts.is_exact and total is not None:
        total, of_load = pair(s, a, total), pair(s, a, of_load)
    if parts.rotor:
        wheel = pair(s, a, mean(s, a, cross(loads.rotor, Om) - loads.rotor_rate))
        total, of_load = sum_of(total, wheel), sum_of(of_load, wheel)
    if total is not None:
        G = Matrix(*(0.25 * cross(total, row) for row in Mt))
        L = L + G - Matrix(*(cross(a, g) for g in G))
        moment = 0.5 * ((1.0 + s) * of_load - (s * (a @ of_load)) * a)
    if parts.dead:
        F = loads.dead
        L = L + F - Matrix(*(cross(a, row) for row in F))
    lam = symmetric_part(L)
    if parts.generalised:
        lam = lam + loads.functions.rest
    return midpoint_means(nodes, loads.dead, found, a, moment, mu=L[0][1] - L[1][0], lam=lam)


def pair(s: Any, a: Vector, m: Vector) -> Vector:
    """Return the y of forces ``½ y × d_{i,m}`` whose moment is m: ``(1 + s) y - s a (a·y) = 2m``."""
    return (2.0 / (1.0 + s)) * fma(0.5 * (a @ m), a, m)


# Dissipation.


def directors_of(f: Any, W: Vector, N: Matrix, Om: Vector) -> list[tuple[Vector, Any, Vector]]:
    """Return for each director V, |V| and M (Ω × e_i)."""
    a = f * Om
    V, s = velocity_rows(W) + N, shrinking(a)
    return [(v, sqrt(v @ v), s * (u + cross(a, u))) for u, v in zip(velocity_rows(Om), V, strict=True)]


def gain(chi: Any, v: Any, p: Any) -> tuple[Any, Any]:
    """Return 1 + γ of a director whose velocity has the lengths v, then p; and its derivative by p."""
    below = fma(chi, p - v, p + v) + TINY
    return (p + v + TINY) / below, -2.0 * chi * v / (below * below)


def approached(chi: Any, v: Any, p: Any, A: Vector, V: Vector) -> Any:
    """Return the next iterate of Newton's iteration for ``p = |2 (1 + γ) A - V|``."""
    g, dg = gain(chi, v, p)
    U, at, Vs = (2.0 * g) * A - V, plain(A), plain(V)
    length = sqrt(U @ U)
    slope = 1.0 - (4.0 * plain(g) * (at @ at) - 2.0 * (at @ Vs)) * plain(dg) / (plain(length) + TINY)
    return p - (p - length) * (1.0 / slope)


@part
def next_lengths(f: Any, chi: Any, W: Vector, N: Matrix, Om: Vector) -> Vector:
    """Return the lengths of the next velocities of the directors."""
    directors = directors_of(f, W, N, Om)
    ends = [2.0 * A - V for V, _, A in directors]
    x = Variables(p=Vector(*(sqrt(U @ U) for U in ends)))
    for _ in loop(LENGTHS):
        nearer = [approached(chi, v, p, A, V) for (V, v, A), p in zip(directors, x.p, strict=True)]
        x.p = Vector(*(larger(p, 0.0 * p) for p in nearer))
    return x.p


def gammas_at(start: Start, Om: Vector, lengths: Vector) -> Vector:
    """Return the three γ_i at the lengths that belong to Ω; of dual Ω one more iteration gives their derivatives."""
    found = []
    for (V, v, A), p in zip(directors_of(start.f, start.W, start.N, Om), lengths, strict=True):
        now = approached(start.chi, v, p, A, V) if isinstance(Om[0], Dual) else p
        found.append(gain(start.chi, v, now)[0] - 1.0)
    return Vector(*found)
