"""A step of collocation, linearised: `gauss` of every order, and `lie_midpoint`, but for dead forces its member s = 1.

All is written in body components. The stages of a step are W_i and C_i = (c_k), the axes of its beginning as seen from
the body; K_i = W_i', a_ij = h b_j μ_ij, and S is the inverse of J under the constraint: S n = 0, S J x = x for x ⊥ n.

    W_i = W_n + Σ a_ij K_j,     c_k,i = e_k + Σ a_ij c_k,j × W_j,     J K_i = τ(W_i, C_i) - μ_i n,     n·K_i = c'.

Changes q_i of the torque and ε_i of n·K_i change K_i by ``S (dτ_i - J n ε_i) + n ε_i``, with dτ_i = q_i + B_i dW_i + Σ
H_k,i dc_k,i. The rows of the stages follow from the velocities by one linear system, the same for all of them,

    Σ T_ij dc_k,j = Σ a_ij c_k,j × dW_j,     T_ij = δ_ij + a_ij Ŵ_j,     dc_k,i = Σ U_ij (c_k,j × dW_j),   U = T⁻¹ a,

and ``(I - a S (B + H U ĉ)) dW = e``, e what no change of the velocities has made. So much for the stages. The end of
the step is linear in them, dW_{n+1} = dW_n + Σ Z_i dW_i + ..., and so is the turn: dc_k = c_k × θ gives θ = ½ Σ dc_k ×
c_k. Of the six rows (Θ; Z) a linear system with the transposed matrix makes the response of the state at the end to
changes at each stage. What an input does is then one product a stage, however many inputs there are.

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
from ..engine.layout import layout
from ..engine.linear import FIXED, LINEAR, emit, fixed_matrix, fixed_vector, inertia_times
from ..geometry.compiled import inlined, kernel, shared
from ..geometry.elements import (
    any_of,
    both,
    doubles,
    eight,
    either,
    integers,
    lanes,
    load,
    root,
    select,
    shifted,
    splat,
    store,
)
from ..geometry.tuples import (
    EPS,
    add,
    attitude,
    axpy,
    column,
    cross,
    dot,
    larger,
    minus,
    scaled,
    size,
    times,
    transposed_times,
    unit,
)
from .gauss_layout import TABLE, WIDTH
from .gauss_stages import FAINT, TINY, drawn
from .gauss_turn import half_angle

ROWS, MOMENTUM, VERTICAL, STEADY = range(4)  # what a body turns by
NONE, AS_TORQUE, AS_MOMENT = range(3)  # how dead forces act, ``Σ e_i × Cᵀ f_i`` or ``C⁻¹ Σ C e_i × f_i``
MOST = 3 * WIDTH
ENOUGH, STALLED, ITERATIONS, CORRECTIONS = 8.0 * EPS, 1e-10, 60, 20
# What is known of eight steps: states, loads seen at the beginning, those of the stages, and what the docstring names.
AT = layout(
    "At",
    h=1,
    lift=1,
    W0=3,
    W1=3,
    R=9,
    turned=9,
    dead=9,
    moving=3 * WIDTH,
    space=3 * WIDTH,
    rotor=3 * WIDTH,
    W=3 * WIDTH,
    K=3 * WIDTH,
    K_next=3 * WIDTH,
    C=9 * WIDTH,
    D=9 * WIDTH,
    D_next=9 * WIDTH,
    mu=WIDTH,
    p=3 * WIDTH,
    U=9 * WIDTH * WIDTH,
    slope=9 * WIDTH * WIDTH,
    Z=9 * WIDTH,
    Theta=9 * WIDTH,
    ends=9 * WIDTH,
    g=3 * WIDTH,
    gain=18 * WIDTH,
    lifted=6 * WIDTH,
    rest=MOST,
    E0=9,
    E1=9,
    Gamma=9 * WIDTH,
    direct=9,
    of_start=9,
    of_attitude=9,
    of_step=3,
    room=2,
    a=MOST * (2 * MOST + 6),
)


@inlined
def columns_at(x, place, one):
    """Return the three columns of a matrix that lies there by columns."""
    return (vector(x, place, one), vector(x, place + 3, one), vector(x, place + 6, one))


@inlined
def put_columns(x, place, c0, c1, c2):
    put_vector(x, place, c0)
    put_vector(x, place + 3, c1)
    put_vector(x, place + 6, c2)


@inlined
def applied(A, v):
    """Return the matrix of the columns A times v."""
    return axpy(v[0], A[0], axpy(v[1], A[1], scaled(v[2], A[2])))


@inlined
def tall(v, one):
    """Return a vector of elements."""
    zero = splat(0.0, one)
    return (zero + v[0], zero + v[1], zero + v[2])


@shared
def eliminated(x, place, m, width, one):
    """Replace the columns after the m-th of m rows by the solutions, for each as right-hand side; pivots by lane."""
    n = lanes(one)
    for k in range(m):
        for i in range(k + 1, m):
            swaps = abs(load(x, (place + i * width + k) * n, one)) > abs(load(x, (place + k * width + k) * n, one))
            if any_of(swaps):
                for j in range(k, width):
                    u, v = load(x, (place + k * width + j) * n, one), load(x, (place + i * width + j) * n, one)
                    store(x, (place + k * width + j) * n, select(swaps, v, u))
                    store(x, (place + i * width + j) * n, select(swaps, u, v))
        f = 1.0 / load(x, (place + k * width + k) * n, one)
        for i in range(k + 1, m):
            g = f * load(x, (place + i * width + k) * n, one)
            for j in range(k + 1, width):
                v = load(x, (place + i * width + j) * n, one) - g * load(x, (place + k * width + j) * n, one)
                store(x, (place + i * width + j) * n, v)
    for k in range(m - 1, -1, -1):
        f = 1.0 / load(x, (place + k * width + k) * n, one)
        for j in range(m, width):
            v = f * load(x, (place + k * width + j) * n, one)
            store(x, (place + k * width + j) * n, v)
            for i in range(k):
                u = load(x, (place + i * width + j) * n, one) - load(x, (place + i * width + k) * n, one) * v
                store(x, (place + i * width + j) * n, u)


@shared
def gather(b, x, n, s, first, last):
    """Fill the workspace with steps; lanes beyond `last` repeat the one before it."""
    p, W, sizes, spins = (
        doubles(b[LINEAR.quaternions]),
        doubles(b[LINEAR.velocities]),
        doubles(b[LINEAR.sizes]),
        doubles(b[LINEAR.spins]),
    )
    moved, pushed, wheels = doubles(b[LINEAR.moved]), doubles(b[LINEAR.pushed]), doubles(b[LINEAR.wheels])
    factor = doubles(b[LINEAR.factor])[0]
    F = fixed_matrix(doubles(b[LINEAR.body]), FIXED.dead)
    for l in range(n):
        i = min(first + l, last - 1)
        x[AT.h * n + l] = sizes[i]
        x[AT.lift * n + l] = spins[i] if b[LINEAR.spins] != 0 else 0.0
        R = attitude((p[4 * i + 3], p[4 * i], p[4 * i + 1], p[4 * i + 2]))
        T = attitude((p[4 * i + 7], p[4 * i + 4], p[4 * i + 5], p[4 * i + 6]))
        f0, f1, f2 = transposed_times(R, F[0]), transposed_times(R, F[1]), transposed_times(R, F[2])
        for r in range(3):
            x[(AT.W0 + r) * n + l], x[(AT.W1 + r) * n + l] = W[3 * i + r], W[3 * i + 3 + r]
            c = transposed_times(T, column(R, r))
            for k in range(3):
                x[(AT.R + 3 * r + k) * n + l] = R[r][k]
                x[(AT.turned + 3 * r + k) * n + l] = c[k]
            x[(AT.dead + 3 * r) * n + l], x[(AT.dead + 3 * r + 1) * n + l] = f0[r], f1[r]
            x[(AT.dead + 3 * r + 2) * n + l] = f2[r]
        for j in range(s):
            k, at = 3 * (s * i + j), 3 * j
            m = transposed_times(R, fixed_vector(pushed, k)) if b[LINEAR.has_space] != 0 else (0.0, 0.0, 0.0)
            for r in range(3):
                own = factor * moved[k + r] if b[LINEAR.moved] != 0 else 0.0
                spun = factor * wheels[2 * k + r] if b[LINEAR.wheels] != 0 else 0.0
                x[(AT.moving + at + r) * n + l] = own - factor * wheels[2 * k + 3 + r] if b[LINEAR.wheels] != 0 else own
                x[(AT.rotor + at + r) * n + l] = spun
                x[(AT.space + at + r) * n + l] = factor * m[r]


@inlined
def torque_at(x, j, W, C, J, D, has_dead, has_space, one, loaded):
    """Return the torque at the stage j."""
    g = cross(times(J, W), W)
    if loaded is not None:
        g = add(axpy(-1.0, times(D, W), g), vector(x, AT.moving + 3 * j, one))
        g = add(g, cross(vector(x, AT.rotor + 3 * j, one), W))
        F, push = matrix(x, AT.dead, one), vector(x, AT.space + 3 * j, one)
        if has_dead == AS_TORQUE:
            g = add(g, dead_torque(F, C))
        if has_dead == AS_MOMENT:
            push = add(push, dead_moment(F, C))
        if has_dead == AS_MOMENT or has_space != 0:
            p = drawn(C, push)
            put_vector(x, AT.p + 3 * j, p)
            g = add(g, p)
    return g


@inlined
def dead_torque(F, C):
    """Return ``Σ e_i × Cᵀ f_i``; F holds, for each axis of space, the components of the three forces along it."""
    return add(cross(F[0], C[0]), add(cross(F[1], C[1]), cross(F[2], C[2])))


@inlined
def dead_moment(F, C):
    """Return ``Σ C e_i × f_i``."""
    return (
        dot(C[1], F[2]) - dot(C[2], F[1]),
        dot(C[2], F[0]) - dot(C[0], F[2]),
        dot(C[0], F[1]) - dot(C[1], F[0]),
    )


@inlined
def of_dead(F, C, has_dead):
    """Return the torque of dead forces."""
    return drawn(C, dead_moment(F, C)) if has_dead == AS_MOMENT else dead_torque(F, C)


@shared
def iterated(b, x, table, s, J, S, D, n0, one, loaded):
    """Iterate the stages by fixed points from a guess, as far as they contract."""
    n, h, W0, zero = lanes(one), load(x, AT.h * lanes(one), one), vector(x, AT.W0, one), splat(0.0, one)
    lift, e = load(x, AT.lift * n, one) / h, (tall(unit(0), one), tall(unit(1), one), tall(unit(2), one))
    K = scaled(1.0 / h, minus(vector(x, AT.W1, one), W0))
    mean = scaled(0.5, add(W0, vector(x, AT.W1, one)))
    has_dead, has_space = b[LINEAR.has_dead], b[LINEAR.has_space]
    for j in range(s):
        put_vector(x, AT.K + 3 * j, K)
        put_columns(x, AT.D + 9 * j, cross(e[0], mean), cross(e[1], mean), cross(e[2], mean))
    before = zero + 1e300
    for _ in range(ITERATIONS if s > 1 else 1):  # of one stage the states at both ends tell the velocity
        now = zero
        for i in range(s):
            W, C = W0, e
            for j in range(s):
                a = h * (table[TABLE.weights + j] * table[TABLE.mu + WIDTH * j + i])
                W = axpy(a, vector(x, AT.K + 3 * j, one), W)
                if loaded is not None:
                    D0, D1, D2 = columns_at(x, AT.D + 9 * j, one)
                    C = (axpy(a, D0, C[0]), axpy(a, D1, C[1]), axpy(a, D2, C[2]))
            put_vector(x, AT.W + 3 * i, W)
            g = torque_at(x, i, W, C, J, D, has_dead, has_space, one, loaded)
            K = axpy(lift, n0, times(S, g))
            change = size(minus(K, vector(x, AT.K + 3 * i, one))) / (size(W) + abs(h) * size(K) + TINY)
            put_vector(x, AT.K_next + 3 * i, K)
            if loaded is not None:
                D0, D1, D2 = columns_at(x, AT.D + 9 * i, one)
                V0, V1, V2 = cross(C[0], W), cross(C[1], W), cross(C[2], W)
                change = larger(change, size(minus(V0, D0)) + size(minus(V1, D1)) + size(minus(V2, D2)))
                put_columns(x, AT.D_next + 9 * i, V0, V1, V2)
            now = larger(now, abs(h) * change)
        for k in range(3 * s):
            store(x, (AT.K + k) * n, load(x, (AT.K_next + k) * n, one))
        if loaded is not None:
            for k in range(9 * s):
                store(x, (AT.D + k) * n, load(x, (AT.D_next + k) * n, one))
        done = either(now <= EPS, both(now <= 1e-12, now >= before))
        if not any_of(1.0 - select(done, zero + 1.0, zero) > 0.5) or any_of(now > 1e6):
            break
        before = now


@shared
def set_rows(x, table, s, one):
    """Find the rows of the stages by their velocities, and U."""
    n, h, m, zero = lanes(one), load(x, AT.h * lanes(one), one), 3 * s, splat(0.0, one)
    width = 2 * m + 3
    for i in range(s):
        for j in range(s):
            a = h * (table[TABLE.weights + j] * table[TABLE.mu + WIDTH * j + i])
            W = vector(x, AT.W + 3 * j, one)
            for c in range(3):
                v = cross(W, unit(c))
                for r in range(3):
                    diagonal = 1.0 if i == j and r == c else 0.0
                    store(x, (AT.a + (3 * i + r) * width + 3 * j + c) * n, diagonal + a * v[r])
                    store(x, (AT.a + (3 * i + r) * width + m + 3 + 3 * j + c) * n, a if r == c else zero)
        for c in range(3):
            for r in range(3):
                store(x, (AT.a + (3 * i + r) * width + m + c) * n, zero + (1.0 if r == c else 0.0))
    eliminated(x, AT.a, m, width, one)
    for i in range(s):
        for r in range(3):
            for c in range(3):
                store(x, (AT.C + 9 * i + 3 * c + r) * n, load(x, (AT.a + (3 * i + r) * width + m + c) * n, one))
                for j in range(s):
                    u = load(x, (AT.a + (3 * i + r) * width + m + 3 + 3 * j + c) * n, one)
                    store(x, (AT.U + 9 * (i * WIDTH + j) + 3 * c + r) * n, u)


@inlined
def rows_changed(x, j, F, has_dead, has_space, one, t0, t1, t2):
    """Return what changes t_k of the rows at the stage j do to the torque."""
    q = tall((0.0, 0.0, 0.0), one)
    if has_dead == AS_TORQUE:
        q = dead_torque(F, (t0, t1, t2))
    if has_dead == AS_MOMENT or has_space != 0:
        C, p, push = columns_at(x, AT.C + 9 * j, one), vector(x, AT.p + 3 * j, one), tall((0.0, 0.0, 0.0), one)
        if has_dead == AS_MOMENT:
            push = dead_moment(F, (t0, t1, t2))
        q = add(q, drawn(C, minus(push, (dot(t0, p), dot(t1, p), dot(t2, p)))))
    return q


@shared
def set_slopes(b, x, s, J, S, D, one, loaded):
    """Set S times the derivatives of the torques by the velocities of the stages, by columns."""
    has_dead, has_space = b[LINEAR.has_dead], b[LINEAR.has_space]
    F = matrix(x, AT.dead, one)
    for j in range(s):
        W = vector(x, AT.W + 3 * j, one)
        Q = times(J, W)
        for l in range(0 if has_dead + has_space != 0 else j, s if has_dead + has_space != 0 else j + 1):
            place, crosses = AT.slope + 9 * (j * WIDTH + l), has_dead + has_space
            for c in range(3):
                e = tall(unit(c), one)
                q = tall((0.0, 0.0, 0.0), one)
                if l == j:
                    q = add(cross(times(J, e), W), cross(Q, e))
                    if loaded is not None:
                        q = add(minus(q, times(D, e)), cross(vector(x, AT.rotor + 3 * j, one), e))
                if loaded is not None and crosses != 0:
                    U, C = columns_at(x, AT.U + 9 * (j * WIDTH + l), one), columns_at(x, AT.C + 9 * l, one)
                    t0, t1, t2 = applied(U, cross(C[0], e)), applied(U, cross(C[1], e)), applied(U, cross(C[2], e))
                    q = add(q, rows_changed(x, j, F, has_dead, has_space, one, t0, t1, t2))
                put_vector(x, place + 3 * c, times(S, q))


@shared
def set_system(x, table, s, crosses, extra, flips, one):
    """Set the matrix of the changes of the velocities, with room for right-hand sides.

    `crosses`: 0 where the torque at a stage depends on its own velocity alone; `flips`: the transposed matrix.
    """
    n, h, m = lanes(one), load(x, AT.h * lanes(one), one), 3 * s
    width = m + extra
    for i in range(s):
        for l in range(s):
            for c in range(3):
                v = tall((0.0, 0.0, 0.0), one)
                for j in range(0 if crosses != 0 else l, s if crosses != 0 else l + 1):
                    a = h * (table[TABLE.weights + j] * table[TABLE.mu + WIDTH * j + i])
                    v = axpy(-a, vector(x, AT.slope + 9 * (j * WIDTH + l) + 3 * c, one), v)
                for r in range(3):
                    row, col = 3 * i + r, 3 * l + c
                    if flips:
                        row, col = col, row
                    store(x, (AT.a + row * width + col) * n, v[r] + (1.0 if row == col else 0.0))


@shared
def solved(b, x, table, s, J, S, D, n0, one, loaded):
    """Find the stages; return the mask of the steps that are not solved."""
    n, h, W0, zero = lanes(one), load(x, AT.h * lanes(one), one), vector(x, AT.W0, one), splat(0.0, one)
    lift, m, before = load(x, AT.lift * n, one) / h, 3 * s, zero + 1e300
    has_dead, has_space = b[LINEAR.has_dead], b[LINEAR.has_space]
    iterated(b, x, table, s, J, S, D, n0, one, loaded)
    bad = zero > 1.0
    for _ in range(CORRECTIONS):
        if loaded is not None:
            set_rows(x, table, s, one)
        for i in range(s):
            W, C = vector(x, AT.W + 3 * i, one), columns_at(x, AT.C + 9 * i, one)
            g = torque_at(x, i, W, C, J, D, has_dead, has_space, one, loaded)
            K = axpy(lift, n0, times(S, g))
            put_vector(x, AT.K + 3 * i, K)
            store(x, (AT.mu + i) * n, dot(n0, minus(g, times(J, K))))
        now = zero
        for i in range(s):
            r = minus(W0, vector(x, AT.W + 3 * i, one))
            reach = size(W0) + TINY
            for j in range(s):
                a = h * (table[TABLE.weights + j] * table[TABLE.mu + WIDTH * j + i])
                r, reach = axpy(a, vector(x, AT.K + 3 * j, one), r), reach + abs(a) * size(vector(x, AT.K + 3 * j, one))
            put_vector(x, AT.rest + 3 * i, r)
            now = larger(now, size(r) / reach)
        bad = select(now <= STALLED, zero, zero + 1.0) > 0.5
        ends = either(now <= ENOUGH, both(now <= STALLED, now >= before))
        if not any_of(select(ends, zero, zero + 1.0) > 0.5):
            break
        before = now
        set_slopes(b, x, s, J, S, D, one, loaded)
        set_system(x, table, s, has_dead + has_space, 1, False, one)
        for i in range(m):
            store(x, (AT.a + i * (m + 1) + m) * n, load(x, (AT.rest + i) * n, one))
        eliminated(x, AT.a, m, m + 1, one)
        for i in range(m):
            w = load(x, (AT.W + i) * n, one) + load(x, (AT.a + i * (m + 1) + m) * n, one)
            store(x, (AT.W + i) * n, w)
    return bad


@shared
def set_ends(x, table, s, crosses, one, loaded):
    """Set Z, the change of W at the end by those of the stages, and V: rows at the end change by V_l (c_k,l × dW_l)."""
    _n, h = lanes(one), load(x, AT.h * lanes(one), one)
    for l in range(s):
        for c in range(3):
            z = tall((0.0, 0.0, 0.0), one)
            v = scaled(h * table[TABLE.weights + l], tall(unit(c), one))
            for j in range(s):
                f = h * table[TABLE.weights + j]
                if crosses != 0 or j == l:
                    z = axpy(f, vector(x, AT.slope + 9 * (j * WIDTH + l) + 3 * c, one), z)
                if loaded is not None:
                    u = vector(x, AT.U + 9 * (j * WIDTH + l) + 3 * c, one)
                    v = axpy(-f, cross(vector(x, AT.W + 3 * j, one), u), v)
            put_vector(x, AT.Z + 9 * l + 3 * c, z)
            put_vector(x, AT.ends + 9 * l + 3 * c, v)


@shared
def set_turn_of_rows(x, s, one):
    """Set Θ, the turn by the changes of the velocities of the stages, where it is that of the rows."""
    T = matrix(x, AT.turned, one)
    for l in range(s):
        V, C = columns_at(x, AT.ends + 9 * l, one), columns_at(x, AT.C + 9 * l, one)
        for c in range(3):
            e = tall(unit(c), one)
            t = cross(applied(V, cross(C[0], e)), T[0])
            t = add(t, cross(applied(V, cross(C[1], e)), T[1]))
            t = add(t, cross(applied(V, cross(C[2], e)), T[2]))
            put_vector(x, AT.Theta + 9 * l + 3 * c, scaled(0.5, t))


@shared
def set_gains(x, table, s, crosses, J, S, n0, one):
    """Set the response of the end of the step to changes of the torque, and of n·K, at each stage."""
    n, h, m, zero = lanes(one), load(x, AT.h * lanes(one), one), 3 * s, splat(0.0, one)
    width = m + 6
    set_system(x, table, s, crosses, 6, True, one)
    for k in range(m):
        for r in range(3):
            l, c = k // 3, k % 3
            store(x, (AT.a + k * width + m + r) * n, load(x, (AT.Theta + 9 * l + 3 * c + r) * n, one))
            store(x, (AT.a + k * width + m + 3 + r) * n, load(x, (AT.Z + 9 * l + 3 * c + r) * n, one))
    eliminated(x, AT.a, m, width, one)
    off = minus(n0, times(S, times(J, n0)))
    for j in range(s):
        for o in range(6):
            d0, d1, d2 = columns_at(x, AT.direct, one)
            g = tall(unit(o - 3), one) if o > 2 else (d0[o], d1[o], d2[o])
            g = scaled(h * table[TABLE.weights + j], g)
            for i in range(s):
                a, at = (
                    h * (table[TABLE.weights + j] * table[TABLE.mu + WIDTH * j + i]),
                    (AT.a + 3 * i * width + m + o) * n,
                )
                y = (load(x, at, one), load(x, at + width * n, one), load(x, at + 2 * width * n, one))
                g = axpy(a, y, g)
            put_vector(x, AT.gain + 18 * j + 3 * o, times(S, g))
            store(x, (AT.lifted + 6 * j + o) * n, zero + dot(off, g))


@inlined
def responded(x, j, q, out, one):
    """Add the response to the change q of the torque at the stage j."""
    place = AT.gain + 18 * j
    return (
        out[0] + dot(vector(x, place, one), q),
        out[1] + dot(vector(x, place + 3, one), q),
        out[2] + dot(vector(x, place + 6, one), q),
        out[3] + dot(vector(x, place + 9, one), q),
        out[4] + dot(vector(x, place + 12, one), q),
        out[5] + dot(vector(x, place + 15, one), q),
    )


@inlined
def lifted(x, j, f, out, one):
    """Add the response to the change f of n·K at the stage j."""
    n, place = lanes(one), AT.lifted + 6 * j
    return (
        out[0] + f * load(x, place * n, one),
        out[1] + f * load(x, (place + 1) * n, one),
        out[2] + f * load(x, (place + 2) * n, one),
        out[3] + f * load(x, (place + 3) * n, one),
        out[4] + f * load(x, (place + 4) * n, one),
        out[5] + f * load(x, (place + 5) * n, one),
    )


@inlined
def displaced(x, s, i, e, out, one):
    """Add the response to the change e of W_i that no K has made."""
    n, width = lanes(one), 3 * s + 6
    for c in range(3):
        place = (AT.a + (3 * i + c) * width + 3 * s) * n
        out = (
            out[0] + e[c] * load(x, place, one),
            out[1] + e[c] * load(x, place + n, one),
            out[2] + e[c] * load(x, place + 2 * n, one),
            out[3] + e[c] * load(x, place + 3 * n, one),
            out[4] + e[c] * load(x, place + 4 * n, one),
            out[5] + e[c] * load(x, place + 5 * n, one),
        )
    return out


@inlined
def turning(out, t):
    """Add a turn."""
    return (out[0] + t[0], out[1] + t[1], out[2] + t[2], out[3], out[4], out[5])


@inlined
def gaining(out, w):
    """Add a change of W."""
    return (out[0], out[1], out[2], out[3] + w[0], out[4] + w[1], out[5] + w[2])


@inlined
def swept(g, r, a, u, dg, dr):
    """Return by how much the smallest rotation of g to r turns in the body."""
    du = add(cross(dg, r), cross(g, dr))
    da = dot(dg, r) + dot(g, dr)
    return axpy(-1.0 / a, axpy(da, u, cross(u, du)), du)


@inlined
def half_sines(x, angle, one):
    """Return (1 - cos, sin) of an angle."""
    less, sine = half_angle(shifted(x, AT.room * lanes(one)), angle)
    return 2.0 * sine * sine, 2.0 * sine * (1.0 + less)


@shared
def set_turn_of_direction(x, table, s, J, e, is_momentum, one):
    """Set Θ where one direction in space is known at both ends, and what else changes the turn."""
    _n, h, zero = lanes(one), load(x, AT.h * lanes(one), one), splat(0.0, one)
    W0, W1, T = vector(x, AT.W0, one), vector(x, AT.W1, one), matrix(x, AT.turned, one)
    nothing = (zero, zero, zero)
    if is_momentum:
        P = times(J, W0)
        f = select(dot(P, P) > FAINT, 1.0 / (root(dot(P, P)) + TINY), zero)
        g0, g1 = scaled(f, P), scaled(f, times(J, W1))
    else:
        f, g0 = zero, transposed_times(matrix(x, AT.R, one), e)
        g1 = transposed_times(T, g0)
    w = nothing
    for l in range(s):
        W = vector(x, AT.W + 3 * l, one)
        w = axpy(h * table[TABLE.weights + l], W, w)
        g = scaled(f, times(J, W)) if is_momentum else applied(columns_at(x, AT.C + 9 * l, one), g0)
        put_vector(x, AT.g + 3 * l, g)
    moves = dot(w, w) > FAINT
    d = select(moves, 1.0 / (root(dot(w, w)) + TINY), zero)
    d = select(dot(g0, w) + dot(g1, w) >= 0.0, d, -d)
    r = scaled(d, w)
    (a0, u0), (a1, u1) = (1.0 + dot(g0, r), cross(g0, r)), (1.0 + dot(g1, r), cross(g1, r))
    psi, bar = zero, nothing
    for l in range(s):
        W, g, b = vector(x, AT.W + 3 * l, one), vector(x, AT.g + 3 * l, one), h * table[TABLE.weights + l]
        over = 1.0 / (1.0 + dot(g, r))
        rate = over * dot(W, add(g, r))
        psi, bar = psi + b * rate, axpy(b * over, axpy(-rate, g, W), bar)
    versed, sine = half_sines(x, psi, one)
    along = add(minus(r, cross(u1, r)), scaled(1.0 / a1, cross(u1, cross(u1, r))))
    for c in range(3):
        unit_c = tall(unit(c), one)
        put_vector(x, AT.E1 + 3 * c, swept(g1, r, a1, u1, unit_c, nothing))
        put_vector(x, AT.E0 + 3 * c, scaled(-1.0, transposed_times(T, swept(g0, r, a0, u0, unit_c, nothing))))
    E0, E1 = columns_at(x, AT.E0, one), columns_at(x, AT.E1, one)
    for l in range(s):
        W, g, b = vector(x, AT.W + 3 * l, one), vector(x, AT.g + 3 * l, one), h * table[TABLE.weights + l]
        over = 1.0 / (1.0 + dot(g, r))
        z = scaled(b * over, axpy(-over * dot(W, add(g, r)), r, W))
        for c in range(3):
            put_vector(x, AT.Gamma + 9 * l + 3 * c, scaled(z[c], along))
    for c in range(3):
        unit_c = tall(unit(c), one)
        t = axpy(-r[c], r, unit_c)
        v = minus(scaled(sine, t), scaled(versed, cross(r, t)))
        v = add(minus(v, cross(u1, v)), scaled(1.0 / a1, cross(u1, cross(u1, v))))
        v = add(v, swept(g1, r, a1, u1, nothing, t))
        v = minus(v, transposed_times(T, swept(g0, r, a0, u0, nothing, t)))
        v = scaled(d, axpy(dot(bar, t), along, v))
        for l in range(s):
            W, g, b = vector(x, AT.W + 3 * l, one), vector(x, AT.g + 3 * l, one), h * table[TABLE.weights + l]
            x_c = (g[c] + r[c]) / (1.0 + dot(g, r))
            o = scaled(b, axpy(x_c, along, v))
            if is_momentum:
                o = add(o, applied(columns_at(x, AT.Gamma + 9 * l, one), scaled(f, times(J, unit_c))))
                o = add(o, applied(E1, scaled(f, times(J, vector(x, AT.Z + 9 * l + 3 * c, one)))))
            else:
                turn = cross(g, unit_c)
                for m in range(s):
                    t_m = applied(columns_at(x, AT.U + 9 * (m * WIDTH + l), one), turn)
                    o = add(o, applied(columns_at(x, AT.Gamma + 9 * m, one), t_m))
                o = add(o, applied(E1, applied(columns_at(x, AT.ends + 9 * l, one), turn)))
            o = (
                select(moves, o[0], b * unit_c[0]),
                select(moves, o[1], b * unit_c[1]),
                select(moves, o[2], b * unit_c[2]),
            )
            put_vector(x, AT.Theta + 9 * l + 3 * c, o)
        if is_momentum:
            J_e = times(J, unit_c)
            put_vector(x, AT.direct + 3 * c, applied(E1, scaled(f, J_e)))
            put_vector(x, AT.of_start + 3 * c, turn_of_momenta(x, s, f, g0, g1, J_e, J_e, 0.0, J, -1, one))
        else:
            change = cross(g0, unit_c)
            o, end = applied(E0, change), change  # the rows of the stages, not the turn, take it to the end
            for m in range(s):
                at_stage = applied(columns_at(x, AT.C + 9 * m, one), change)
                o = add(o, applied(columns_at(x, AT.Gamma + 9 * m, one), at_stage))
                end = axpy(h * table[TABLE.weights + m], cross(at_stage, vector(x, AT.W + 3 * m, one)), end)
            o = add(o, applied(E1, end))
            put_vector(x, AT.of_attitude + 3 * c, o)
    o = scaled(psi / h, along)
    if is_momentum:
        o = add(o, applied(E1, scaled(f / h, times(J, minus(W1, W0)))))
    else:
        end = scaled(1.0 / h, minus(g1, g0))
        for m in range(s):
            change = nothing
            for l in range(s):
                rate = cross(vector(x, AT.g + 3 * l, one), vector(x, AT.W + 3 * l, one))
                change = add(change, applied(columns_at(x, AT.U + 9 * (m * WIDTH + l), one), rate))
            change = scaled(1.0 / h, change)
            o = add(o, applied(columns_at(x, AT.Gamma + 9 * m, one), change))
            end = axpy(h * table[TABLE.weights + m], cross(change, vector(x, AT.W + 3 * m, one)), end)
        o = add(o, applied(E1, end))
    put_vector(x, AT.of_step, o)


@inlined
def turn_of_momenta(x, s, f, g0, g1, dP0, dP1, all_stages, J, entry, one):
    """Return the turn by changes of the momenta at both ends and, of an entry of the inertia, at the stages."""
    k = dot(g0, dP0)
    o = applied(columns_at(x, AT.E0, one), scaled(f, axpy(-k, g0, dP0)))
    o = add(o, applied(columns_at(x, AT.E1, one), scaled(f, axpy(-k, g1, dP1))))
    for l in range(s):
        dP = scaled(all_stages, inertia_times(entry, vector(x, AT.W + 3 * l, one)))
        dP = scaled(f, axpy(-k, vector(x, AT.g + 3 * l, one), dP))
        o = add(o, applied(columns_at(x, AT.Gamma + 9 * l, one), dP))
    return o


@shared
def set_steady_turn(x, table, s, one):
    """Set Θ of a body whose velocity stands still, and what else changes its turn."""
    _n, h, W = lanes(one), load(x, AT.h * lanes(one), one), vector(x, AT.W0, one)
    speed = root(dot(W, W))
    axis, angle = scaled(1.0 / (speed + TINY), W), abs(h) * speed
    versed, sine = half_sines(x, angle, one)
    some = angle > 1e-150
    p = select(some, sine / (angle + TINY), 1.0 + 0.0 * h)
    q = select(some, versed / (angle + TINY), 0.0 * h)
    for c in range(3):
        e = tall(unit(c), one)
        o = axpy(p, e, axpy((1.0 - p) * axis[c], axis, scaled(-q, cross(axis, e))))
        put_vector(x, AT.of_start + 3 * c, scaled(h, o))
    for l in range(s):
        f = 1.0 - table[TABLE.nodes + l]
        versed, sine = half_sines(x, f * angle, one)
        for c in range(3):
            e = tall(unit(c), one)
            o = axpy(1.0 - versed, e, axpy(versed * axis[c], axis, scaled(-sine, cross(axis, e))))
            o = scaled(h * table[TABLE.weights + l], o)
            put_vector(x, AT.Theta + 9 * l + 3 * c, o)
            put_vector(x, AT.of_start + 3 * c, minus(vector(x, AT.of_start + 3 * c, one), o))
    put_vector(x, AT.of_step, W)


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
            if b[LINEAR.has_dead] + has_space != 0:
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
                    o = responded(x, j, q, o, one)
        emit(b, out, first, c, o)
        o = gaining(turning(none, vector(x, AT.of_start + 3 * c, one)), e)
        for i in range(s):
            o = displaced(x, s, i, e, o, one)
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
        o = turning(none, vector(x, AT.of_step, one))
        change = (zero, zero, zero)
        r0, r1, r2 = change, change, change
        for i in range(s):
            o = displaced(x, s, i, scaled(1.0 / h, minus(vector(x, AT.W + 3 * i, one), W0)), o, one)
            o = lifted(x, i, -load(x, AT.lift * n, one) / (h * h), o, one)
            change = axpy(zero + table[TABLE.weights + i], vector(x, AT.K + 3 * i, one), change)
            if loaded is not None:
                v0, v1, v2 = (zero, zero, zero), (zero, zero, zero), (zero, zero, zero)
                for l in range(s):
                    U, C = columns_at(x, AT.U + 9 * (i * WIDTH + l), one), columns_at(x, AT.C + 9 * l, one)
                    W = scaled(1.0 / h, vector(x, AT.W + 3 * l, one))
                    v0, v1 = add(v0, applied(U, cross(C[0], W))), add(v1, applied(U, cross(C[1], W)))
                    v2 = add(v2, applied(U, cross(C[2], W)))
                if b[LINEAR.has_dead] + has_space != 0:
                    q = rows_changed(x, i, F, b[LINEAR.has_dead], has_space, one, v0, v1, v2)
                    o = responded(x, i, q, o, one)
                W, f = vector(x, AT.W + 3 * i, one), h * table[TABLE.weights + i]
                r0, r1, r2 = axpy(f, cross(v0, W), r0), axpy(f, cross(v1, W), r1), axpy(f, cross(v2, W), r2)
        o = gaining(o, change)
        if turn == ROWS:
            d = 1.0 / h
            r0 = add(r0, scaled(d, (T[0][0] - 1.0, T[0][1], T[0][2])))
            r1 = add(r1, scaled(d, (T[1][0], T[1][1] - 1.0, T[1][2])))
            r2 = add(r2, scaled(d, (T[2][0], T[2][1], T[2][2] - 1.0)))
            o = turning(o, scaled(0.5, add(cross(r0, T[0]), add(cross(r1, T[1]), cross(r2, T[2])))))
        emit(b, out, first, b[LINEAR.step], o)
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
    nothing, crosses = (zero, zero, zero), b[LINEAR.has_dead] + b[LINEAR.has_space]
    for first in range(0, b[LINEAR.steps], n):
        gather(b, x, n, s, first, min(first + n, b[LINEAR.steps]))
        bad = solved(b, x, table, s, J, S, D, n0, one, loaded)
        if any_of(bad):
            b[LINEAR.failed] += 1
        put_columns(x, AT.direct, nothing, nothing, nothing)
        put_columns(x, AT.of_start, nothing, nothing, nothing)
        put_columns(x, AT.of_attitude, nothing, nothing, nothing)
        put_vector(x, AT.of_step, nothing)
        set_slopes(b, x, s, J, S, D, one, loaded)
        set_ends(x, table, s, crosses, one, loaded)
        if loaded is None or turn in (MOMENTUM, VERTICAL):
            set_turn_of_direction(x, table, s, J, e, turn == MOMENTUM, one)
        elif turn == STEADY:
            set_steady_turn(x, table, s, one)
        else:
            set_turn_of_rows(x, s, one)
        set_gains(x, table, s, crosses, J, S, n0, one)
        emitted(b, x, table, s, J, out, first, one, loaded, turn)
        if loaded is not None and b[LINEAR.dead] >= 0:
            if turn == MOMENTUM:  # its direction is not kept under forces
                put_columns(x, AT.direct, nothing, nothing, nothing)
                set_turn_of_rows(x, s, one)
                set_gains(x, table, s, crosses, J, S, n0, one)
            emitted_dead(b, x, s, out, first, one)


@kernel(unroll=False)
def free_steps(address):
    linearised(address, eight(), None)


@kernel(unroll=False)
def loaded_steps(address):
    linearised(address, eight(), 1)
