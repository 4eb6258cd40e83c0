"""A step of collocation, linearised: `gauss` of every order, and `lie_midpoint`, but for dead forces its member s = 1.

All is written in body components. The stages of a step are W_i and C_i = (c_k), the axes of its beginning as seen from
the body; K_i = W_i', a_ij = h b_j μ_ij, and S is the inverse of J under the constraint: S n = 0, S J x = x for x ⊥ n.

    W_i = W_n + Σ a_ij K_j,     c_k,i = e_k + Σ a_ij c_k,j × W_j,     J K_i = τ(W_i, C_i) - μ_i n,     n·K_i = c'.

Changes q_i of the torque and ε_i of n·K_i change K_i by ``S (dτ_i - J n ε_i) + n ε_i``, with dτ_i = q_i + B_i dW_i + Σ
H_k,i dc_k,i. Let α be the inverse of the coefficients, a⁻¹ = α/h, and κ_i the sums of its rows. Then

    Σ (α_ij + δ_ij h Ŵ_j) c_k,j = κ_i e_k,     dc_k,i = Σ U_ij (c_k,j × dW_j),     U = h (α + h Ŵ)⁻¹,
    Σ (α_ij - h S (δ_ij B_j + H_i U_ij ĉ_j)) dW_j = h S q_i + Σ α_ij e_j,

with e_i what changes W_i and no K does; of the start it is the same at all stages, and ``Σ α_ij e = κ_i e``. The end of
the step is linear in the stages, dW_{n+1} = dW_n + Σ Z_i dW_i + ..., and so is the turn, θ = Σ Θ_i dW_i + .... Of the
six rows (Θ; Z) a linear system with the transposed matrix makes the response of the state at the end to what stands on
the right at each stage. What an input does is then one product a stage, however many inputs there are.

U is needed only where the torque depends on the rows. The change of the rows at the end needs none: the scheme is
symplectic, so it is its own adjoint, and so is c' = -Ŵ c. With columns c_k in C_i and C_{n+1}, orthogonal,

    dc_k,n+1 = Σ h b_i C_{n+1} C_iᵀ (c_k,i × dW_i),     dc_k = c_k × θ,     θ = ½ Σ dc_k × c_k,
    Θ_i = h b_i C_{n+1} (c_2,i × c_3,i, c_3,i × c_1,i, c_1,i × c_2,i)ᵀ.

Attitudes change by rotation vectors in the body: ``δ_{n+1} = Cᵀδ_n + θ``, and what stands still in space is seen
changed, v × δ. Inertia changes by a whole symmetric matrix: no eigenvector is differentiated.

Turns of `gauss` that are not those of the rows. With one direction γ in space known at both ends, C = D(γ_0)ᵀ exp(ψ r̂)
D(γ_1) (`gauss`); with u = γ × r, a = 1 + γ·r the smallest rotation D(γ) changes in the body by

    ω(γ) = du - (da/a) u - (u × du)/a,     θ = ω(γ_1) + D(γ_1)ᵀ (dψ r + sin ψ dr - (1 - cos ψ) r × dr) - Cᵀ ω(γ_0).

Of a body whose velocity stands still, C = exp(hŴ) and ``θ = ∫ exp((t - h) Ŵ) dW dt``: exact for a change of W that
stands still as well. Inertia or forces under which the body would turn otherwise have no derivative of that run, since
the turn of the step would be another formula: theirs is that of the stages, and has the order of the scheme.

Steps are independent of each other once the states are known, so an element holds eight of them. Their stages are
solved again from the states that were stored: by fixed points and, where those do not contract, by Newton's iteration
with the matrices above.
"""

from ..engine.lane import matrix, put_vector, vector
from ..engine.linear import CALLED, FIXED, LINEAR, applied, emit, fixed_matrix, fixed_vector, inertia_times, tall
from ..geometry.compiled import inlined, kernel, shared
from ..geometry.elements import (
    any_of,
    doubles,
    eight,
    integers,
    lanes,
    load,
    root,
    select,
    splat,
)
from ..geometry.tuples import (
    add,
    axpy,
    cross,
    dot,
    minus,
    scaled,
    times,
    unit,
)
from .gauss_coefficients import TABLE, WIDTH
from .gauss_linear_stages import set_slopes, show_stages, solved
from .gauss_linear_torques import (
    AT,
    FAINT,
    MOMENTUM,
    ROWS,
    STEADY,
    TINY,
    VERTICAL,
    are_coupled,
    columns_at,
    drawn,
    gather,
    of_dead,
    pulled,
    put_columns,
    rows_changed,
)
from .gauss_linear_turns import (
    displaced,
    gaining,
    lifted,
    responded,
    set_ends,
    set_gains,
    set_steady_turn,
    set_turn_of_direction,
    set_turn_of_rows,
    turn_of_momenta,
    turning,
)


@shared
def torque_by_step(b, x, s, i, over, one):
    """Return what a longer step does to the torque at the stage i by the rows, at the same velocities."""
    nothing = tall((0.0, 0.0, 0.0), one)
    v0, v1, v2 = nothing, nothing, nothing
    for l in range(s):
        U, C = columns_at(x, AT.U + 9 * (i * WIDTH + l), one), columns_at(x, AT.C + 9 * l, one)
        W = scaled(over, vector(x, AT.W + 3 * l, one))
        if b[LINEAR.turn] == VERTICAL:
            v0 = add(v0, applied(U, cross(vector(x, AT.g + 3 * l, one), W)))
        else:
            v0, v1 = add(v0, applied(U, cross(C[0], W))), add(v1, applied(U, cross(C[1], W)))
            v2 = add(v2, applied(U, cross(C[2], W)))
    if b[LINEAR.turn] == VERTICAL:
        pull, _ = pulled(b, x, one)
        return cross(pull, v0)
    return rows_changed(b, x, i, matrix(x, AT.dead, one), one, v0, v1, v2)


@shared
def emitted(b, x, table, s, J, out, first, one, loaded, turn):
    """Write the matrices M and N of some steps, but for the columns of dead forces."""
    n, h, zero = lanes(one), load(x, AT.h * lanes(one), one), splat(0.0, one)
    W0, W1, _R, T = vector(x, AT.W0, one), vector(x, AT.W1, one), matrix(x, AT.R, one), matrix(x, AT.turned, one)
    F, none, has_space = matrix(x, AT.dead, one), (zero, zero, zero, zero, zero, zero), b[LINEAR.has_space]
    for c in range(3):
        e = tall(unit(c), one)
        o = turning(none, T[c])
        if loaded is not None:
            o = turning(o, vector(x, AT.of_attitude + 3 * c, one))
            if are_coupled(b) != 0:
                for j in range(s):
                    C, q = columns_at(x, AT.C + 9 * j, one), (zero, zero, zero)
                    if b[LINEAR.has_dead] != 0:  # F holds the components of all forces along each axis
                        f0 = cross((F[0][0], F[1][0], F[2][0]), e)
                        f1 = cross((F[0][1], F[1][1], F[2][1]), e)
                        f2 = cross((F[0][2], F[1][2], F[2][2]), e)
                        seen = ((f0[0], f1[0], f2[0]), (f0[1], f1[1], f2[1]), (f0[2], f1[2], f2[2]))
                        q = of_dead(seen, C, b[LINEAR.has_dead])
                    if has_space != 0:
                        q = add(q, drawn(C, cross(vector(x, AT.space + 3 * j, one), e)))
                    if b[LINEAR.called] != 0:
                        q = add(q, vector(x, AT.called + CALLED.size * j + CALLED.attitude + 3 * c, one))
                    o = responded(x, j, q, o, one)
        emit(b, out, first, c, o)
        o = gaining(turning(none, vector(x, AT.of_start + 3 * c, one)), e)
        for i in range(s):
            o = displaced(x, s, i, scaled(table[TABLE.sums + i], e), o, one)
        emit(b, out, first, 3 + c, o)
    if b[LINEAR.inertia] >= 0:
        for c in range(6):
            o = none
            for j in range(s):
                W, K = vector(x, AT.W + 3 * j, one), vector(x, AT.K + 3 * j, one)
                o = responded(x, j, minus(cross(inertia_times(c, W), W), inertia_times(c, K)), o, one)
            if turn == MOMENTUM:
                P = times(J, W0)
                f = select(dot(P, P) > FAINT, 1.0 / (root(dot(P, P)) + TINY), zero)
                g0, g1 = scaled(f, P), scaled(f, times(J, W1))
                dP0, dP1 = inertia_times(c, W0), inertia_times(c, W1)
                o = turning(o, turn_of_momenta(x, s, f, g0, g1, dP0, dP1, 1.0, J, c, one))
            emit(b, out, first, b[LINEAR.inertia] + c, o)
    if b[LINEAR.step] >= 0:
        o, change = turning(none, vector(x, AT.of_step, one)), (zero, zero, zero)
        for i in range(s):
            K = vector(x, AT.K + 3 * i, one)
            o = lifted(x, i, -load(x, AT.lift * n, one) / (h * h), displaced(x, s, i, K, o, one), one)
            change = axpy(table[TABLE.weights + i], K, change)
            if turn == ROWS:
                W = scaled(1.0 / h, vector(x, AT.W + 3 * i, one))
                o = turning(o, applied(columns_at(x, AT.Theta + 9 * i, one), W))
            if loaded is not None and are_coupled(b) != 0:
                o = responded(x, i, torque_by_step(b, x, s, i, 1.0 / h, one), o, one)
        emit(b, out, first, b[LINEAR.step], gaining(o, change))
    for c in range(3 if b[LINEAR.axis] >= 0 else 0):
        e, o = tall(unit(c), one), none
        for j in range(s):
            o = responded(x, j, scaled(-load(x, (AT.mu + j) * n, one), e), o, one)
            o = lifted(x, j, -load(x, (AT.K + 3 * j + c) * n, one), o, one)
        emit(b, out, first, b[LINEAR.axis] + c, o)
    if b[LINEAR.spin] >= 0:
        o = none
        for j in range(s):
            o = lifted(x, j, 1.0 / h, o, one)
        emit(b, out, first, b[LINEAR.spin], o)
    for k in range(9 if b[LINEAR.damping] >= 0 else 0):
        o, e = none, tall(unit(k // 3), one)
        for j in range(s):
            o = responded(x, j, scaled(-load(x, (AT.W + 3 * j + k % 3) * n, one), e), o, one)
        emit(b, out, first, b[LINEAR.damping] + k, o)
    for c in range(3 if b[LINEAR.rate] >= 0 else 0):
        o, e = none, tall(unit(c), one)
        for j in range(s):
            o = responded(x, j, scaled(-1.0, e), o, one)
        emit(b, out, first, b[LINEAR.rate] + c, o)
    for j in range(s):
        for c in range(3):
            e = tall(unit(c), one)
            if b[LINEAR.moving] >= 0:
                emit(b, out, first, b[LINEAR.moving] + 3 * j + c, responded(x, j, e, none, one))
            if b[LINEAR.rotor] >= 0:
                o = responded(x, j, cross(e, vector(x, AT.W + 3 * j, one)), none, one)
                emit(b, out, first, b[LINEAR.rotor] + 3 * j + c, o)
            if b[LINEAR.space] >= 0 and loaded is not None:
                q = drawn(columns_at(x, AT.C + 9 * j, one), vector(x, AT.R + 3 * c, one))
                emit(b, out, first, b[LINEAR.space] + 3 * j + c, responded(x, j, q, none, one))


@shared
def emitted_dead(b, x, s, out, first, one):
    """Write the columns of dead forces."""
    zero = splat(0.0, one)
    for k in range(9):
        o, e = (zero, zero, zero, zero, zero, zero), tall(unit(k // 3), one)
        f = vector(x, AT.R + 3 * (k % 3), one)
        seen = (scaled(f[0], e), scaled(f[1], e), scaled(f[2], e))
        for j in range(s):
            o = responded(x, j, of_dead(seen, columns_at(x, AT.C + 9 * j, one), b[LINEAR.has_dead]), o, one)
        emit(b, out, first, b[LINEAR.dead] + k, o)


@inlined
def linearised(address, one, loaded):
    """Linearise the steps of a block; without `loaded` those of a free body, which turns by its momentum."""
    b, n = integers(address), lanes(one)
    x, out, table, s = doubles(b[LINEAR.workspace]), doubles(b[LINEAR.out]), doubles(b[LINEAR.table]), b[LINEAR.stages]
    fixed, turn = doubles(b[LINEAR.body]), b[LINEAR.turn]
    J, S, D = fixed_matrix(fixed, FIXED.J), fixed_matrix(fixed, FIXED.S), fixed_matrix(fixed, FIXED.D)
    n0, e, zero = (
        tall(fixed_vector(fixed, FIXED.n), one),
        tall(fixed_vector(fixed, FIXED.vertical), one),
        splat(0.0, one),
    )
    nothing, crosses = (zero, zero, zero), are_coupled(b)
    for first in range(0, b[LINEAR.steps], n):
        gather(b, x, n, s, first, min(first + n, b[LINEAR.steps]))
        bad = solved(b, x, table, s, J, S, D, n0, one, loaded)
        if any_of(bad):
            b[LINEAR.failed] += 1
        if b[LINEAR.shown] != 0:
            show_stages(b, x, s, first, min(first + n, b[LINEAR.steps]), one)
            continue
        put_columns(x, AT.direct, nothing, nothing, nothing)
        put_columns(x, AT.of_start, nothing, nothing, nothing)
        put_columns(x, AT.of_attitude, nothing, nothing, nothing)
        put_vector(x, AT.of_step, nothing)
        set_slopes(b, x, s, J, S, D, one, loaded)
        set_ends(x, table, s, crosses, one, loaded)
        if loaded is None or turn in (MOMENTUM, VERTICAL):
            set_turn_of_direction(x, table, s, J, e, turn == MOMENTUM, one, loaded)
        elif turn == STEADY:
            set_steady_turn(x, table, s, one)
        else:
            set_turn_of_rows(x, table, s, one)
        set_gains(x, table, s, crosses, J, S, n0, one)
        emitted(b, x, table, s, J, out, first, one, loaded, turn)
        if loaded is not None and b[LINEAR.dead] >= 0:
            if turn == MOMENTUM:  # its direction is not kept under forces
                put_columns(x, AT.direct, nothing, nothing, nothing)
                set_turn_of_rows(x, table, s, one)
                set_gains(x, table, s, crosses, J, S, n0, one)
            emitted_dead(b, x, s, out, first, one)


@kernel(unroll=False)
def free_steps(address):
    linearised(address, eight(), None)


@kernel(unroll=False)
def loaded_steps(address):
    linearised(address, eight(), 1)
