"""The turn of a linearised step of collocation, and how the end of the step responds to its stages (`gauss_linear`)."""

from math import sin

from ..engine.elimination import eliminated
from ..engine.lane import matrix, put_vector, vector
from ..engine.linear import applied, inertia_times, tall
from ..geometry.compiled import inlined, shared
from ..geometry.elements import (
    any_of,
    lanes,
    load,
    root,
    select,
    shifted,
    splat,
    store,
)
from ..geometry.tuples import (
    add,
    axpy,
    chosen,
    column,
    cross,
    dot,
    minus,
    scaled,
    times,
    transposed_times,
    unit,
)
from .gauss_coefficients import TABLE, WIDTH
from .gauss_linear_stages import set_rows, set_system
from .gauss_linear_torques import AT, FAINT, TINY, columns_at, put_columns


@inlined
def half_angle(x, angle):
    """Return (cos - 1, sin) of half an angle; x has room for two elements."""
    n = lanes(angle)
    store(x, 0, angle)
    for l in range(n):
        quarter = sin(0.25 * x[l])
        x[n + l], x[l] = -2.0 * quarter * quarter, sin(0.5 * x[l])
    return load(x, n, angle), load(x, 0, angle)


@shared
def set_ends(x, table, s, crosses, one, loaded):
    """Set Z, the change of W at the end by those of the stages, and the rows at the end."""
    h = load(x, AT.h * lanes(one), one)
    for l in range(s):
        for c in range(3):
            z = tall((0.0, 0.0, 0.0), one)
            for j in range(0 if crosses != 0 else l, s if crosses != 0 else l + 1):
                f = h * table[TABLE.weights + j]
                z = axpy(f, vector(x, AT.slope + 9 * (j * WIDTH + l) + 3 * c, one), z)
            put_vector(x, AT.Z + 9 * l + 3 * c, z)
    if loaded is not None:
        set_rows_at_end(x, table, s, one)


@shared
def set_rows_at_end(x, table, s, one):
    """Set the rows at the end from those of the stages."""
    h = load(x, AT.h * lanes(one), one)
    for k in range(3):
        c = tall((0.0, 0.0, 0.0), one)
        for l in range(s):
            rate = cross(vector(x, AT.C + 9 * l + 3 * k, one), vector(x, AT.W + 3 * l, one))
            c = axpy(table[TABLE.weights + l], rate, c)
        put_vector(x, AT.ends + 3 * k, axpy(h, c, tall(unit(k), one)))


@inlined
def turn_of_rows(x, table, l, one):
    """Return Θ of the stage l, the turn by the change of its velocity, where it is that of the rows."""
    C, T = columns_at(x, AT.C + 9 * l, one), columns_at(x, AT.ends, one)
    f = load(x, AT.h * lanes(one), one) * table[TABLE.weights + l]
    c0, c1, c2 = scaled(f, cross(C[1], C[2])), scaled(f, cross(C[2], C[0])), scaled(f, cross(C[0], C[1]))
    return applied(T, column((c0, c1, c2), 0)), applied(T, column((c0, c1, c2), 1)), applied(T, column((c0, c1, c2), 2))


@shared
def set_turn_of_rows(x, table, s, one):
    """Set Θ where the turn is that of the rows."""
    for l in range(s):
        t0, t1, t2 = turn_of_rows(x, table, l, one)
        put_columns(x, AT.Theta + 9 * l, t0, t1, t2)


@shared
def set_small_turns(x, table, s, small, one, loaded):
    """Set Θ, and what else changes the turn, to those of the rows in the steps that turn too little for a direction."""
    zero = splat(0.0, one)
    nothing, o = (zero, zero, zero), (zero, zero, zero)
    if loaded is None:
        set_rows(x, table, s, 0, one)
        set_rows_at_end(x, table, s, one)
    for l in range(s):
        t0, t1, t2 = turn_of_rows(x, table, l, one)
        o = add(o, applied((t0, t1, t2), vector(x, AT.W + 3 * l, one)))
        Q = columns_at(x, AT.Theta + 9 * l, one)
        put_columns(x, AT.Theta + 9 * l, chosen(small, t0, Q[0]), chosen(small, t1, Q[1]), chosen(small, t2, Q[2]))
    for place in (AT.E0, AT.E1, AT.direct, AT.of_start, AT.of_attitude):
        Q = columns_at(x, place, one)
        put_columns(x, place, chosen(small, nothing, Q[0]), chosen(small, nothing, Q[1]), chosen(small, nothing, Q[2]))
    put_vector(x, AT.along, chosen(small, nothing, vector(x, AT.along, one)))
    o = scaled(1.0 / load(x, AT.h * lanes(one), one), o)
    put_vector(x, AT.of_step, chosen(small, o, vector(x, AT.of_step, one)))


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
            g, at = tall(unit(o - 3), one) if o > 2 else (d0[o], d1[o], d2[o]), (AT.a + 3 * j * width + m + o) * n
            y = (load(x, at, one), load(x, at + width * n, one), load(x, at + 2 * width * n, one))
            g = scaled(h, axpy(table[TABLE.weights + j], g, y))
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
    """Add the response to changes of velocities that no K has made, e the one at the stage i of a⁻¹ h times these."""
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
def set_turn_of_direction(x, table, s, J, e, is_momentum, one, loaded):
    """Set Θ where one direction in space is known at both ends, and what else changes the turn.

    It is divided by the turn of the step. Below some turn the round-off is larger than the difference from the turn of
    the rows, which is of the order of the scheme, so these are taken.
    """
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
    least = 2e-5 if s == 1 else 1e-3 if s == 2 else 1e-2 if s == 3 else 5e-2
    small = dot(w, w) < least * least
    d = select(dot(w, w) > FAINT, 1.0 / (root(dot(w, w)) + TINY), zero)
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
    put_vector(x, AT.along, along)
    for l in range(s):
        W, g, b = vector(x, AT.W + 3 * l, one), vector(x, AT.g + 3 * l, one), h * table[TABLE.weights + l]
        over = 1.0 / (1.0 + dot(g, r))
        put_vector(x, AT.bent + 3 * l, scaled(b * over, axpy(-over * dot(W, add(g, r)), r, W)))
    for c in range(3):
        t = axpy(-r[c], r, tall(unit(c), one))
        v = minus(scaled(sine, t), scaled(versed, cross(r, t)))
        v = add(minus(v, cross(u1, v)), scaled(1.0 / a1, cross(u1, cross(u1, v))))
        v = add(v, swept(g1, r, a1, u1, nothing, t))
        v = minus(v, transposed_times(T, swept(g0, r, a0, u0, nothing, t)))
        put_vector(x, AT.swung + 3 * c, scaled(d, axpy(dot(bar, t), along, v)))
    ends, seen, by_step = columns_at(x, AT.ends, one), nothing, nothing
    ends = (applied(E1, ends[0]), applied(E1, ends[1]), applied(E1, ends[2]))
    for l in range(s):
        W, g, b = vector(x, AT.W + 3 * l, one), vector(x, AT.g + 3 * l, one), h * table[TABLE.weights + l]
        C, bent, over = columns_at(x, AT.C + 9 * l, one), vector(x, AT.bent + 3 * l, one), 1.0 / (1.0 + dot(g, r))
        if not is_momentum:
            seen, bent = add(seen, times(C, bent)), nothing
            for m in range(s):  # γ at all stages changes by what changes it at this one
                U = columns_at(x, AT.U + 9 * (m * WIDTH + l), one)
                bent = add(bent, times(U, vector(x, AT.bent + 3 * m, one)))
            by_step = add(by_step, turn_of_vertical(along, bent, ends, C, b, cross(g, W)))
        for c in range(3):
            unit_c = tall(unit(c), one)
            o = scaled(b, axpy(over * (g[c] + r[c]), along, vector(x, AT.swung + 3 * c, one)))
            if is_momentum:
                o = axpy(f * dot(bent, times(J, unit_c)), along, o)
                o = add(o, applied(E1, scaled(f, times(J, vector(x, AT.Z + 9 * l + 3 * c, one)))))
            else:
                o = add(o, turn_of_vertical(along, bent, ends, C, b, cross(g, unit_c)))
            put_vector(x, AT.Theta + 9 * l + 3 * c, o)
    for c in range(3):
        unit_c = tall(unit(c), one)
        if is_momentum:
            J_e = times(J, unit_c)
            put_vector(x, AT.direct + 3 * c, applied(E1, scaled(f, J_e)))
            put_vector(x, AT.of_start + 3 * c, turn_of_momenta(x, s, f, g0, g1, J_e, J_e, 0.0, J, -1, one))
        else:  # the rows of the stages, not the turn, take γ to the end
            change = cross(g0, unit_c)
            o = axpy(dot(seen, change), along, applied(E0, change))
            put_vector(x, AT.of_attitude + 3 * c, add(o, applied(ends, change)))
    o = scaled(psi, along)
    if is_momentum:
        o = add(o, applied(E1, scaled(f, times(J, minus(W1, W0)))))
    put_vector(x, AT.of_step, scaled(1.0 / h, add(o, by_step)))
    if any_of(small):
        set_small_turns(x, table, s, small, one, loaded)


@inlined
def turn_of_vertical(along, bent, ends, C, b, t):
    """Return the turn by a change of the rate of γ at a stage: by γ at the stages, and at the end."""
    return axpy(dot(bent, t), along, scaled(b, applied(ends, times(C, t))))


@inlined
def turn_of_momenta(x, s, f, g0, g1, dP0, dP1, all_stages, J, entry, one):
    """Return the turn by changes of the momenta at both ends and, of an entry of the inertia, at the stages."""
    k = dot(g0, dP0)
    o = applied(columns_at(x, AT.E0, one), scaled(f, axpy(-k, g0, dP0)))
    o = add(o, applied(columns_at(x, AT.E1, one), scaled(f, axpy(-k, g1, dP1))))
    bent = 0.0 * k
    for l in range(s):
        dP = scaled(all_stages, inertia_times(entry, vector(x, AT.W + 3 * l, one)))
        bent = bent + dot(vector(x, AT.bent + 3 * l, one), axpy(-k, vector(x, AT.g + 3 * l, one), dP))
    return axpy(f * bent, vector(x, AT.along, one), o)


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
