"""A step of `energy_momentum`, linearised.

In body components, with ``V_i = W × e_i + N_i`` and P_i = Σ E_ij V_j, the step of `energy_momentum` is, orthogonal to the
constrained axis n,

    r(Ω) = J Ω - Σ e_i × (P_i - a × P_i) - (h/2) G = ρ n,     n·Ω = 0,      a = hΩ/2,

G the moments in their form for the virtual rotations, and ``V_i⁺ = Cᵀ (2Ω × M e_i - V_i)`` with C = 2M - I. A change of
the inputs alone makes a change r' of r, and then with A = ∂r/∂Ω and S the inverse of A orthogonal to n

    dΩ = S (-r' + ρ dn - A n ε) + n ε,    ε = -Ω·dn,     θ = 2s (da - a × da),     d(M x) = M (da × M x) + M dx,

so ``δ⁺ = Cᵀδ + θ`` and ``dV_i⁺ = Cᵀ d(2Ω × M e_i - V_i) - θ × V_i⁺``. The state has 12 numbers: the attitude, W, and N,
whose part in the velocities alternates. Ω is not stored. The quotient of the attitudes gives it to round-off of these,
and a correction by A to that of the equations.

Dissipation (`energy_momentum`) adds ``Σ E_i γ_i q_i × (Ω × q_i)`` to r, over the principal axes q_i, and makes ``V_i⁺ =
Cᵀ (2 (1 + γ_i) A_i - V_i)`` along these, A_i = Ω × M q_i. With v = |V_i|, p = |V_i⁺|, U = 2 (1 + γ) A - V

    1 + γ = (p + v)/((1 + χ) p + (1 - χ) v),     dγ = γ_p dp + γ_v dv + γ_χ dχ,
    p dp = U·(2 dγ A + 2 (1 + γ) dA - dV),

one equation for dp. The axes are those of the body as it is: by entries of the inertia that turn them there is nothing.
"""

from ..engine.called import mean
from ..engine.lane import put_vector, vector
from ..engine.linear import CALLED, FIXED, LINEAR, applied, emit, inertia_times, tall
from ..geometry.compiled import inlined, kernel, shared
from ..geometry.elements import doubles, eight, fused, lanes, load, root, select, splat, store
from ..geometry.tuples import (
    EPS,
    add,
    axpy,
    cross,
    dot,
    first_moment,
    inverse_of,
    larger,
    minus,
    scaled,
    size,
    times,
    transposed_times,
    unit,
)
from .midpoint_linear import AT, columns, dead_turning, put_rows, rows_at, seen, turned_back

ROWS, CORRECTIONS = 12, 2
SLIPS, TINY = 6, 1e-140  # iterations for the length of a velocity; what keeps quotients of zeros at 1


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


@inlined
def slipping(b, x, i, one):
    """Return a principal axis, its γ, and the Euler inertia there."""
    fixed = doubles(b[LINEAR.body])
    q = (fixed[FIXED.basis + i], fixed[FIXED.basis + 3 + i], fixed[FIXED.basis + 6 + i])
    return tall(q, one), load(x, (AT.slips + 15 * i) * lanes(one), one), fixed[FIXED.principal + i]


@shared
def set_slips(b, x, W, V, s, a, Om, one):
    """Set γ of the three directors; its derivatives by p, v, χ; p, v; the vectors 2 (1 + γ) A - V, A, V."""
    n, fixed = lanes(one), doubles(b[LINEAR.body])
    h, zero = load(x, AT.h * n, one), splat(0.0, one)
    turn = h * root(dot(W, W))
    chi = fused(fixed[FIXED.dissipation + 1], select(turn < 1.0, turn, zero + 1.0), zero + fixed[FIXED.dissipation])
    store(x, AT.chi * n, chi)
    for i in range(3):
        q, _, _ = slipping(b, x, i, one)
        own = axpy(q[0], V[0], axpy(q[1], V[1], scaled(q[2], V[2])))
        A = cross(Om, mean(s, a, q))
        v, AA, AV = root(dot(own, own)), dot(A, A), dot(A, own)
        U = minus(scaled(2.0, A), own)
        p = root(dot(U, U))
        for _ in range(SLIPS):
            below = fused(chi, p - v, p + v) + TINY
            g, dg = (p + v + TINY) / below, -2.0 * chi * v / (below * below)
            U = minus(scaled(2.0 * g, A), own)
            length = root(dot(U, U))
            p = larger(p - (p - length) / (1.0 - (4.0 * g * AA - 2.0 * AV) * dg / (length + TINY)), zero)
        below = fused(chi, p - v, p + v) + TINY
        g = (p + v + TINY) / below
        place = AT.slips + 15 * i
        store(x, place * n, g - 1.0)
        store(x, (place + 1) * n, -2.0 * chi * v / (below * below))
        store(x, (place + 2) * n, 2.0 * chi * p / (below * below))
        store(x, (place + 3) * n, -(p + v) * (p - v) / (below * below))
        store(x, (place + 4) * n, p)
        store(x, (place + 5) * n, v)
        put_vector(x, place + 6, minus(scaled(2.0 * g, A), own))
        put_vector(x, place + 9, A)
        put_vector(x, place + 12, own)


@shared
def slip_change(b, x, i, dh, da, dOm, dW, dV, one):
    """Return the changes of γ of a director, and of A = Ω × M q."""
    n, fixed, place = lanes(one), doubles(b[LINEAR.body]), AT.slips + 15 * i
    q, slip, _ = slipping(b, x, i, one)
    h, a, Om, W = load(x, AT.h * n, one), vector(x, AT.a, one), vector(x, AT.Om, one), vector(x, AT.W, one)
    s, zero = 1.0 / (1.0 + dot(a, a)), splat(0.0, one)
    m = mean(s, a, q)
    dA = add(cross(dOm, m), cross(Om, mean(s, a, cross(da, m))))
    own = axpy(q[0], dV[0], axpy(q[1], dV[1], scaled(q[2], dV[2])))
    by_p, by_v = load(x, (place + 1) * n, one), load(x, (place + 2) * n, one)
    by_chi, p, v = load(x, (place + 3) * n, one), load(x, (place + 4) * n, one), load(x, (place + 5) * n, one)
    U, A, V = vector(x, place + 6, one), vector(x, place + 9, one), vector(x, place + 12, one)
    speed = root(dot(W, W))
    d_chi = fixed[FIXED.dissipation + 1] * fused(dh, speed, h * (dot(W, dW) / (speed + TINY)))
    direct = fused(by_chi, select(h * speed < 1.0, d_chi, zero), by_v * (dot(V, own) / (v + TINY)))
    dp = dot(U, axpy(2.0 * (1.0 + slip), dA, scaled(-1.0, own))) + 2.0 * dot(U, A) * direct
    dp = dp / (p - 2.0 * by_p * dot(U, A) + TINY)
    return fused(by_p, dp, direct), dA


@shared
def residual_change(slips, b, x, body, one, dh, dOm, dW, dV, entry, dM, df, dF, dDOm, dc, rate):
    """Return the change of r by those of the step, of Ω, of V, of an entry of the inertia, and of the loads.

    `dDOm` is the change of damping times Ω, `rate` that of the rate of the rotors, dc of their momentum.
    """
    (J, E, D), h = body, load(x, AT.h * lanes(one), one)
    a, Om = vector(x, AT.a, one), vector(x, AT.Om, one)
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
    if slips is not None:
        for i in range(3):
            q, slip, e = slipping(b, x, i, one)
            dg, _ = slip_change(b, x, i, dh, da, dOm, dW, dV, one)
            de = half - dot(q, inertia_times(entry, q))
            dr = axpy(fused(e, dg, de * slip), axpy(-dot(q, Om), q, Om), dr)
            dr = axpy(e * slip, axpy(-dot(q, dOm), q, dOm), dr)
    return axpy(-0.5 * h, dG, axpy(-0.5 * dh, vector(x, AT.G, one), dr))


@inlined
def solved_of(slips, b, x, body, n0, one):
    """Find Ω and what is made of it; return the size of the last correction, relative to W."""
    (J, E, D), n, h, zero = body, lanes(one), load(x, AT.h * lanes(one), one), splat(0.0, one)
    W, N, o = vector(x, AT.W, one), rows_at(x, AT.N, one), (zero, zero, zero)
    none = (o, o, o)
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
        seen(b, x, Om, one)
        G = loads(x, a, s, Om, D, b[LINEAR.exact], one)
        put_vector(x, AT.G, G)
        r = axpy(-0.5 * h, G, minus(add(times(J, Om), dead_turning(P, a)), first_moment(P)))
        if slips is not None:
            set_slips(b, x, W, V, s, a, Om, one)
            for i in range(3):
                q, slip, e = slipping(b, x, i, one)
                r = axpy(e * slip, axpy(-dot(q, Om), q, Om), r)
        for k in range(3):
            e = tall(unit(k), one)
            c = residual_change(slips, b, x, body, one, 0.0, e, o, none, -1, o, o, none, o, o, o)
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
        if slips is not None:
            for i in range(3):
                q, slip, _ = slipping(b, x, i, one)
                v = axpy(2.0 * q[k] * slip, vector(x, AT.slips + 15 * i + 9, one), v)
        put_vector(x, AT.ahead + 3 * k, turned_back(s, a, v))
    if slips is None:
        for k in range(3):
            found = ended(slips, b, x, one, o, 0.0, tall(unit(k), one), o, none)
            for i in range(12):
                store(x, (AT.response + 12 * k + i) * n, found[i])
    return left


@inlined
def emitted_of(
    slips, b, x, body, n0, out, first, column, one, delta, dh, dW, dN, entry, dn, dM, df, dF, dDOm, dc, rate
):
    """Write the column of one change of the state, or of an input."""
    a, Om, zero = vector(x, AT.a, one), vector(x, AT.Om, one), splat(0.0, one)
    nothing, dV = (zero, zero, zero), velocities(dW, dN)
    r = residual_change(slips, b, x, body, one, dh, nothing, dW, dV, entry, dM, df, dF, dDOm, dc, rate)
    e = -dot(Om, dn)
    r = minus(axpy(load(x, AT.rho * lanes(one), one), dn, scaled(-1.0, r)), scaled(e, vector(x, AT.An, one)))
    r = axpy(-dot(n0, r), n0, r)
    dOm = axpy(e, n0, times(rows_at(x, AT.S, one), r))
    if slips is not None or dh != 0.0:
        emit(b, out, first, column, ended(slips, b, x, one, delta, dh, dOm, dW, dV))
    else:  # what is linear in dΩ is known
        s = 1.0 / (1.0 + dot(a, a))
        v0, v1, v2 = turned_back(s, a, dV[0]), turned_back(s, a, dV[1]), turned_back(s, a, dV[2])
        o = turned_back(s, a, delta) + of_velocities(-0.5, v0, v1, v2)
        for k in range(3):
            o = responded(x, 12 * k, dOm[k], o, one)
        emit(b, out, first, column, o)


@inlined
def responded(x, place, f, o, one):
    """Add f times the response of the end that lies there."""
    n, at = lanes(one), AT.response + place
    return (
        fused(f, load(x, at * n, one), o[0]),
        fused(f, load(x, (at + 1) * n, one), o[1]),
        fused(f, load(x, (at + 2) * n, one), o[2]),
        fused(f, load(x, (at + 3) * n, one), o[3]),
        fused(f, load(x, (at + 4) * n, one), o[4]),
        fused(f, load(x, (at + 5) * n, one), o[5]),
        fused(f, load(x, (at + 6) * n, one), o[6]),
        fused(f, load(x, (at + 7) * n, one), o[7]),
        fused(f, load(x, (at + 8) * n, one), o[8]),
        fused(f, load(x, (at + 9) * n, one), o[9]),
        fused(f, load(x, (at + 10) * n, one), o[10]),
        fused(f, load(x, (at + 11) * n, one), o[11]),
    )


@inlined
def of_velocities(f, v0, v1, v2):
    """Return the changes of W and of N by those of 2f times the rows V_i."""
    w = first_moment((v0, v1, v2))
    return (
        f * w[0],
        f * w[1],
        f * w[2],
        2.0 * f * v0[0],
        2.0 * f * v1[1],
        2.0 * f * v2[2],
        f * (v1[2] + v2[1]),
        f * (v0[2] + v2[0]),
        f * (v0[1] + v1[0]),
    )


@inlined
def ended(slips, b, x, one, delta, dh, dOm, dW, dV):
    """Return the change of the state at the end by those of the attitude, of the step, of Ω, and of the velocities."""
    h, a, Om = load(x, AT.h * lanes(one), one), vector(x, AT.a, one), vector(x, AT.Om, one)
    s = 1.0 / (1.0 + dot(a, a))
    da = scaled(0.5, axpy(dh, Om, scaled(h, dOm)))
    turn = scaled(2.0 * s, minus(da, cross(a, da)))
    M, ahead = rows_at(x, AT.mean, one), rows_at(x, AT.ahead, one)
    if slips is not None:  # 2 u_i changes by these, and V_i enters by -V_i
        V0, V1, V2 = dV
        for i in range(3):
            q, slip, _ = slipping(b, x, i, one)
            dg, dA = slip_change(b, x, i, dh, da, dOm, dW, dV, one)
            change = axpy(dg, vector(x, AT.slips + 15 * i + 9, one), scaled(slip, dA))
            V0, V1, V2 = axpy(-2.0 * q[0], change, V0), axpy(-2.0 * q[1], change, V1), axpy(-2.0 * q[2], change, V2)
        dV = (V0, V1, V2)
    v0 = velocity_change(s, a, Om, da, dOm, turn, M[0], ahead[0], dV[0])
    v1 = velocity_change(s, a, Om, da, dOm, turn, M[1], ahead[1], dV[1])
    v2 = velocity_change(s, a, Om, da, dOm, turn, M[2], ahead[2], dV[2])
    return add(turned_back(s, a, delta), turn) + of_velocities(0.5, v0, v1, v2)


@inlined
def velocity_change(s, a, Om, da, dOm, turn, m, ahead, dV):
    """Return the change of ``V_i⁺``."""
    v = axpy(2.0, add(cross(dOm, m), cross(Om, mean(s, a, cross(da, m)))), scaled(-1.0, dV))
    return minus(turned_back(s, a, v), cross(turn, ahead))


@shared
def solved(b, x, body, n0, one):
    return solved_of(None, b, x, body, n0, one)


@shared
def solved_slipping(b, x, body, n0, one):
    return solved_of(1, b, x, body, n0, one)


@shared
def emitted(b, x, body, n0, out, first, column, one, delta, dh, dW, dN, entry, dn, dM, df, dF, dDOm, dc, rate):
    emitted_of(None, b, x, body, n0, out, first, column, one, delta, dh, dW, dN, entry, dn, dM, df, dF, dDOm, dc, rate)


@shared
def emitted_slipping(b, x, body, n0, out, first, column, one, delta, dh, dW, dN, entry, dn, dM, df, dF, dDOm, dc, rate):
    emitted_of(1, b, x, body, n0, out, first, column, one, delta, dh, dW, dN, entry, dn, dM, df, dF, dDOm, dc, rate)


@kernel(unroll=False)
def director_steps(address):
    columns(address, eight(), solved, emitted, ROWS)


@kernel(unroll=False)
def slipping_steps(address):
    columns(address, eight(), solved_slipping, emitted_slipping, ROWS)
