"""A step of `energy_momentum`, linearised.

In body components, with ``V_i = W × e_i + N_i`` and P_i = Σ E_ij V_j, the step of `director_step` is, orthogonal to the
constrained axis n,

    r(Ω) = J Ω - Σ e_i × (P_i - a × P_i) - (h/2) G = ρ n,     n·Ω = 0,      a = hΩ/2,

G the moments in their form for the virtual rotations, and ``V_i⁺ = Cᵀ (2Ω × M e_i - V_i)`` with C = 2M - I. A change of
the inputs alone makes a change r' of r, and then with A = ∂r/∂Ω and S the inverse of A orthogonal to n

    dΩ = S (-r' + ρ dn - A n ε) + n ε,    ε = -Ω·dn,     θ = 2s (da - a × da),     d(M x) = M (da × M x) + M dx,

so ``δ⁺ = Cᵀδ + θ`` and ``dV_i⁺ = Cᵀ d(2Ω × M e_i - V_i) - θ × V_i⁺``. The state has 12 numbers: the attitude, W, and N,
whose part in the velocities alternates. Ω is not stored. The quotient of the attitudes gives it to round-off of these,
and a correction by A to that of the equations.
"""

from ..engine.called import mean, mean_transposed
from ..engine.lane import put_vector, vector
from ..engine.layout import layout
from ..engine.linear import CALLED, FIXED, LINEAR, applied, emit, fixed_matrix, fixed_vector, inertia_times, tall
from ..geometry.compiled import inlined, kernel, shared
from ..geometry.elements import any_of, doubles, eight, integers, lanes, load, select, splat, store
from ..geometry.tuples import (
    EPS,
    add,
    attitude,
    axpy,
    cross,
    dot,
    first_moment,
    inverse_of,
    minus,
    product,
    scaled,
    size,
    times,
    transposed_times,
    unit,
)
from .lie_step import dead_turning

ROWS, CORRECTIONS, STALLED = 12, 2, 1e-9
AT = layout(
    "At",
    h=1,
    a=3,
    W=3,
    N=9,
    R=9,
    dead=9,
    moving=3,
    given=3,
    space=3,
    called=CALLED.rows,
    rotor=3,
    rate=3,
    Om=3,
    V=9,
    P=9,
    G=3,
    mean=9,
    ahead=9,
    rho=1,
    S=9,
    An=3,
)


@inlined
def rows_at(x, place, one):
    return (vector(x, place, one), vector(x, place + 3, one), vector(x, place + 6, one))


@inlined
def put_rows(x, place, A):
    put_vector(x, place, A[0])
    put_vector(x, place + 3, A[1])
    put_vector(x, place + 6, A[2])


@shared
def gather(b, x, n, first, last):
    """Fill the workspace with steps; lanes beyond `last` repeat the one before it."""
    p, W, N, sizes = (
        doubles(b[LINEAR.quaternions]),
        doubles(b[LINEAR.velocities]),
        doubles(b[LINEAR.normals]),
        doubles(b[LINEAR.sizes]),
    )
    moved, pushed, wheels = doubles(b[LINEAR.moved]), doubles(b[LINEAR.pushed]), doubles(b[LINEAR.wheels])
    factor = doubles(b[LINEAR.factor])[0]
    F = fixed_matrix(doubles(b[LINEAR.body]), FIXED.dead)
    for l in range(n):
        i = min(first + l, last - 1)
        x[AT.h * n + l] = sizes[i]
        q = (p[4 * i + 3], p[4 * i], p[4 * i + 1], p[4 * i + 2])
        R = attitude(q)
        turn = product((q[0], -q[1], -q[2], -q[3]), (p[4 * i + 7], p[4 * i + 4], p[4 * i + 5], p[4 * i + 6]))
        f = (transposed_times(R, F[0]), transposed_times(R, F[1]), transposed_times(R, F[2]))
        m = transposed_times(R, fixed_vector(pushed, 3 * i)) if b[LINEAR.has_space] != 0 else (0.0, 0.0, 0.0)
        for r in range(3):
            x[(AT.W + r) * n + l] = W[3 * i + r]
            x[(AT.a + r) * n + l] = turn[1 + r] / turn[0]
            x[(AT.given + r) * n + l] = x[(AT.space + r) * n + l] = factor * m[r]
            x[(AT.moving + r) * n + l] = factor * moved[3 * i + r] if b[LINEAR.moved] != 0 else 0.0
            x[(AT.rotor + r) * n + l] = factor * wheels[6 * i + r] if b[LINEAR.wheels] != 0 else 0.0
            x[(AT.rate + r) * n + l] = factor * wheels[6 * i + 3 + r] if b[LINEAR.wheels] != 0 else 0.0
            for k in range(3):
                x[(AT.R + 3 * r + k) * n + l] = R[r][k]
                x[(AT.dead + 3 * r + k) * n + l] = f[r][k]
                e = r if r == k else 6 - r - k
                x[(AT.N + 3 * r + k) * n + l] = N[6 * i + e]
        if b[LINEAR.called] != 0:
            called = doubles(b[LINEAR.called])
            for k in range(CALLED.rows):
                x[(AT.called + k) * n + l] = called[CALLED.size * i + k]


@inlined
def velocities(W, N):
    """Return the rows ``W × e_i + N_i``."""
    return (
        (N[0][0], N[0][1] + W[2], N[0][2] - W[1]),
        (N[1][0] - W[2], N[1][1], N[1][2] + W[0]),
        (N[2][0] + W[1], N[2][1] - W[0], N[2][2]),
    )


@inlined
def combined(E, V):
    """Return the rows Σ E_ij V_j."""
    return (transposed_times(V, E[0]), transposed_times(V, E[1]), transposed_times(V, E[2]))


@inlined
def loads(x, a, s, Om, D, exact, one):
    """Return G."""
    f, F, c = vector(x, AT.space, one), rows_at(x, AT.dead, one), vector(x, AT.rate, one)
    total = add(axpy(-s, times(D, Om), vector(x, AT.moving, one)), f)
    if exact != 0:
        g = axpy(dot(a, total), a, minus(total, cross(a, f)))
    else:
        g = scaled(0.5, axpy(1.0 + s, minus(total, cross(a, f)), scaled(s * dot(a, total), a)))
    g = add(g, minus(first_moment(F), dead_turning(F, a)))
    return add(g, minus(minus(cross(vector(x, AT.rotor, one), Om), c), scaled(dot(a, c), a)))


@shared
def residual_change(b, x, J, E, D, one, dh, dOm, dV, entry, dM, df, dF, dDOm, dc, rate):
    """Return the change of r by those of the step, of Ω, of V, of an entry of the inertia, and of the loads.

    `dDOm` is the change of damping times Ω, `rate` that of the rate of the rotors, dc of their momentum.
    """
    h, a, Om = load(x, AT.h * lanes(one), one), vector(x, AT.a, one), vector(x, AT.Om, one)
    s, exact = 1.0 / (1.0 + dot(a, a)), b[LINEAR.exact]
    if b[LINEAR.called] != 0:
        df = add(df, applied(rows_at(x, AT.called + CALLED.velocity, one), dOm))
    da = scaled(0.5, axpy(dh, Om, scaled(h, dOm)))
    ds = -2.0 * s * s * dot(a, da)
    f, F, c = vector(x, AT.space, one), rows_at(x, AT.dead, one), vector(x, AT.rate, one)
    V, P = rows_at(x, AT.V, one), rows_at(x, AT.P, one)
    dP = combined(E, dV)
    half = 0.5 if 0 <= entry < 3 else 0.0  # dE = tr(dJ) I/2 - dJ
    c0, c1 = inertia_times(entry, (V[0][0], V[1][0], V[2][0])), inertia_times(entry, (V[0][1], V[1][1], V[2][1]))
    c2 = inertia_times(entry, (V[0][2], V[1][2], V[2][2]))
    dP = (
        add(dP[0], axpy(half, V[0], scaled(-1.0, (c0[0], c1[0], c2[0])))),
        add(dP[1], axpy(half, V[1], scaled(-1.0, (c0[1], c1[1], c2[1])))),
        add(dP[2], axpy(half, V[2], scaled(-1.0, (c0[2], c1[2], c2[2])))),
    )
    total = add(axpy(-s, times(D, Om), vector(x, AT.moving, one)), f)
    d_total = add(add(dM, df), axpy(-s, add(dDOm, times(D, dOm)), scaled(-ds, times(D, Om))))
    straight, q = minus(total, cross(a, f)), dot(a, total)
    d_straight = minus(d_total, add(cross(da, f), cross(a, df)))
    dq = dot(da, total) + dot(a, d_total)
    if exact != 0:
        dG = add(d_straight, axpy(dq, a, scaled(q, da)))
    else:
        dG = axpy(ds, straight, axpy(1.0 + s, d_straight, axpy(ds * q + s * dq, a, scaled(s * q, da))))
        dG = scaled(0.5, dG)
    dG = add(dG, minus(first_moment(dF), add(dead_turning(dF, a), dead_turning(F, da))))
    dG = add(dG, minus(add(cross(dc, Om), cross(vector(x, AT.rotor, one), dOm)), rate))
    dG = minus(dG, axpy(dot(a, c), da, scaled(dot(da, c) + dot(a, rate), a)))
    dr = add(add(times(J, dOm), inertia_times(entry, Om)), add(dead_turning(dP, a), dead_turning(P, da)))
    dr = minus(dr, first_moment(dP))
    return axpy(-0.5 * h, dG, axpy(-0.5 * dh, vector(x, AT.G, one), dr))


@shared
def solved(b, x, J, E, D, n0, one):
    """Find Ω and what is made of it; return the size of the last correction, relative to W."""
    n, h, zero = lanes(one), load(x, AT.h * lanes(one), one), splat(0.0, one)
    W, N, nothing = vector(x, AT.W, one), rows_at(x, AT.N, one), (zero, zero, zero)
    none = (nothing, nothing, nothing)
    V = velocities(W, N)
    P = combined(E, V)
    put_rows(x, AT.V, V)
    put_rows(x, AT.P, P)
    Om = scaled(2.0 / h, vector(x, AT.a, one))
    Om = axpy(-dot(n0, Om), n0, Om)
    left = zero
    for count in range(CORRECTIONS):
        a = scaled(0.5 * h, Om)
        s = 1.0 / (1.0 + dot(a, a))
        put_vector(x, AT.Om, Om)
        put_vector(x, AT.a, a)
        if b[LINEAR.called] != 0:
            f = add(vector(x, AT.given, one), vector(x, AT.called + CALLED.moment, one))
            put_vector(x, AT.space, add(f, applied(rows_at(x, AT.called + CALLED.velocity, one), Om)))
        G = loads(x, a, s, Om, D, b[LINEAR.exact], one)
        put_vector(x, AT.G, G)
        r = axpy(-0.5 * h, G, minus(add(times(J, Om), dead_turning(P, a)), first_moment(P)))
        for k in range(3):
            e = tall(unit(k), one)
            c = residual_change(
                b, x, J, E, D, one, zero, e, none, -1, nothing, nothing, none, nothing, nothing, nothing
            )
            put_vector(x, AT.S + 3 * k, c)
        c0, c1, c2 = rows_at(x, AT.S, one)
        An = axpy(n0[0], c0, axpy(n0[1], c1, scaled(n0[2], c2)))
        c0, c1, c2 = axpy(-n0[0], An, c0), axpy(-n0[1], An, c1), axpy(-n0[2], An, c2)  # A P
        c0, c1, c2 = axpy(-dot(n0, c0), n0, c0), axpy(-dot(n0, c1), n0, c1), axpy(-dot(n0, c2), n0, c2)
        S = inverse_of(axpy(n0[0], n0, c0), axpy(n0[1], n0, c1), axpy(n0[2], n0, c2))
        put_rows(x, AT.S, S)
        put_vector(x, AT.An, An)
        store(x, AT.rho * n, dot(n0, r))
        d = times(S, axpy(-dot(n0, r), n0, r))
        left = size(d) / (size(W) + size(Om) + EPS / abs(h))
        if count + 1 < CORRECTIONS:
            Om = minus(Om, d)
    for k in range(3):
        m = mean(s, a, tall(unit(k), one))
        put_vector(x, AT.mean + 3 * k, m)
        v = axpy(2.0, cross(Om, m), scaled(-1.0, V[k]))
        put_vector(x, AT.ahead + 3 * k, turned_back(s, a, v))
    return left


@inlined
def turned_back(s, a, v):
    """Return Cᵀ v."""
    return minus(scaled(2.0, mean_transposed(s, a, v)), v)


@shared
def emitted(b, x, J, E, D, n0, out, first, column, one, delta, dh, dV, entry, dn, dM, df, dF, dDOm, dc, rate):
    """Write the column of one change of the state, or of an input."""
    h, a, Om, zero = load(x, AT.h * lanes(one), one), vector(x, AT.a, one), vector(x, AT.Om, one), splat(0.0, one)
    s, nothing = 1.0 / (1.0 + dot(a, a)), (zero, zero, zero)
    r = residual_change(b, x, J, E, D, one, dh, nothing, dV, entry, dM, df, dF, dDOm, dc, rate)
    e = -dot(Om, dn)
    r = minus(axpy(load(x, AT.rho * lanes(one), one), dn, scaled(-1.0, r)), scaled(e, vector(x, AT.An, one)))
    r = axpy(-dot(n0, r), n0, r)
    dOm = axpy(e, n0, times(rows_at(x, AT.S, one), r))
    da = scaled(0.5, axpy(dh, Om, scaled(h, dOm)))
    turn = scaled(2.0 * s, minus(da, cross(a, da)))
    M, ahead = rows_at(x, AT.mean, one), rows_at(x, AT.ahead, one)
    v0 = velocity_change(s, a, Om, da, dOm, turn, M[0], ahead[0], dV[0])
    v1 = velocity_change(s, a, Om, da, dOm, turn, M[1], ahead[1], dV[1])
    v2 = velocity_change(s, a, Om, da, dOm, turn, M[2], ahead[2], dV[2])
    t, w = add(turned_back(s, a, delta), turn), scaled(0.5, first_moment((v0, v1, v2)))
    N = (v0[0], v1[1], v2[2], 0.5 * (v1[2] + v2[1]), 0.5 * (v0[2] + v2[0]), 0.5 * (v0[1] + v1[0]))
    emit(b, out, first, column, t + w + N)


@inlined
def velocity_change(s, a, Om, da, dOm, turn, m, ahead, dV):
    """Return the change of ``V_i⁺``."""
    v = axpy(2.0, add(cross(dOm, m), cross(Om, mean(s, a, cross(da, m)))), scaled(-1.0, dV))
    return minus(turned_back(s, a, v), cross(turn, ahead))


@inlined
def all_of(mask, zero):
    """Whether the mask is set for all."""
    return not any_of(select(mask, zero, zero + 1.0) > 0.5)


@kernel(unroll=False)
def director_steps(address):
    b, one = integers(address), eight()
    n, x, out, fixed = lanes(one), doubles(b[LINEAR.workspace]), doubles(b[LINEAR.out]), doubles(b[LINEAR.body])
    J, E, D = fixed_matrix(fixed, FIXED.J), fixed_matrix(fixed, FIXED.E), fixed_matrix(fixed, FIXED.D)
    n0, zero = tall(fixed_vector(fixed, FIXED.n), one), splat(0.0, one)
    o = (zero, zero, zero)
    none = (o, o, o)
    for first in range(0, b[LINEAR.steps], n):
        gather(b, x, n, first, min(first + n, b[LINEAR.steps]))
        left = solved(b, x, J, E, D, n0, one)
        if not all_of(left <= STALLED, zero):
            b[LINEAR.failed] += 1
        F, f = rows_at(x, AT.dead, one), vector(x, AT.given, one)
        for c in range(3):
            e = tall(unit(c), one)
            dF = (cross(F[0], e), cross(F[1], e), cross(F[2], e))
            df = cross(f, e)
            if b[LINEAR.called] != 0:
                df = add(df, vector(x, AT.called + CALLED.attitude + 3 * c, one))
            emitted(b, x, J, E, D, n0, out, first, c, one, e, zero, none, -1, o, o, df, dF, o, o, o)
            emitted(b, x, J, E, D, n0, out, first, 3 + c, one, o, zero, velocities(e, none), -1, o, o, o, none, o, o, o)
        for c in range(6):
            u = inertia_times(c, tall((1.0, 0.0, 0.0), one))
            dN = (u, inertia_times(c, tall((0.0, 1.0, 0.0), one)), inertia_times(c, tall((0.0, 0.0, 1.0), one)))
            emitted(b, x, J, E, D, n0, out, first, 6 + c, one, o, zero, dN, -1, o, o, o, none, o, o, o)
        for c in range(6 if b[LINEAR.inertia] >= 0 else 0):
            at = b[LINEAR.inertia] + c
            emitted(b, x, J, E, D, n0, out, first, at, one, o, zero, none, c, o, o, o, none, o, o, o)
        if b[LINEAR.step] >= 0:
            at = b[LINEAR.step]
            emitted(b, x, J, E, D, n0, out, first, at, one, o, zero + 1.0, none, -1, o, o, o, none, o, o, o)
        for k in range(9 if b[LINEAR.dead] >= 0 else 0):
            i, g, at = k // 3, vector(x, AT.R + 3 * (k % 3), one), b[LINEAR.dead] + k
            dF = (
                scaled(1.0 if i == 0 else 0.0, g),
                scaled(1.0 if i == 1 else 0.0, g),
                scaled(1.0 if i == 2 else 0.0, g),
            )
            emitted(b, x, J, E, D, n0, out, first, at, one, o, zero, none, -1, o, o, o, dF, o, o, o)
        for k in range(9 if b[LINEAR.damping] >= 0 else 0):
            v, at = scaled(load(x, (AT.Om + k % 3) * n, one), tall(unit(k // 3), one)), b[LINEAR.damping] + k
            emitted(b, x, J, E, D, n0, out, first, at, one, o, zero, none, -1, o, o, o, none, v, o, o)
        for c in range(3):
            e = tall(unit(c), one)
            if b[LINEAR.axis] >= 0:
                at = b[LINEAR.axis] + c
                emitted(b, x, J, E, D, n0, out, first, at, one, o, zero, none, -1, e, o, o, none, o, o, o)
            if b[LINEAR.moving] >= 0:
                at = b[LINEAR.moving] + c
                emitted(b, x, J, E, D, n0, out, first, at, one, o, zero, none, -1, o, e, o, none, o, o, o)
            if b[LINEAR.space] >= 0:
                at, g = b[LINEAR.space] + c, vector(x, AT.R + 3 * c, one)
                emitted(b, x, J, E, D, n0, out, first, at, one, o, zero, none, -1, o, o, g, none, o, o, o)
            if b[LINEAR.rotor] >= 0:
                at = b[LINEAR.rotor] + c
                emitted(b, x, J, E, D, n0, out, first, at, one, o, zero, none, -1, o, o, o, none, o, e, o)
            if b[LINEAR.rate] >= 0:
                at = b[LINEAR.rate] + c
                emitted(b, x, J, E, D, n0, out, first, at, one, o, zero, none, -1, o, o, o, none, o, o, e)
