"""What the linearised steps of the two midpoint schemes share that take moments by one velocity Ω of the step.

A scheme brings `solved`, which finds Ω and what is made of it and returns by how much the equations are missed, and
`emitted`, which writes the column of one change: of the attitude, the length of the step, W, N, an entry of the
inertia, the axis, moments along the frame and in space, dead forces, damping times Ω, momentum and rate of the rotors.
"""

from ..engine.called import mean_transposed
from ..engine.lane import put_vector, vector
from ..engine.layout import layout
from ..engine.linear import CALLED, FIXED, LINEAR, applied, fixed_matrix, fixed_vector, inertia_times, tall
from ..geometry.compiled import inlined, shared
from ..geometry.elements import any_of, doubles, integers, lanes, load, select, splat
from ..geometry.tuples import (
    add,
    attitude,
    axpy,
    cross,
    dot,
    first_moment,
    minus,
    product,
    scaled,
    transposed_times,
    unit,
)

STALLED = 1e-9
# Of one step: what is known of it; of `energy_momentum` velocities, their combinations, G, means of the axes,
# velocities at the end, the inverse of the derivative of the residual and its product with the axis, what Ω does to the
# end, by columns; of dissipation what γ_i is made of, and of `lie_midpoint` T, the mean velocity, g.
AT = layout(
    "At",
    h=1,
    a=3,
    W=3,
    W1=3,
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
    response=36,
    chi=1,
    slips=3 * 15,
    T=3,
    U=3,
    g=1,
)


@inlined
def dead_moment(F, a):
    """Return ``(I - â) Σ M e_i × F_i = (I - s a aᵀ) k`` with ``k = Σ e_i × (F_i - a × F_i)``."""
    k = minus(first_moment(F), dead_turning(F, a))
    return axpy(-dot(a, k) / (1.0 + dot(a, a)), a, k)


@inlined
def dead_turning(F, a):
    """Return ``Σ e_i × (a × F_i) = tr(F) a - Fᵀ a``."""
    return axpy(F[0][0] + F[1][1] + F[2][2], a, scaled(-1.0, transposed_times(F, a)))


@inlined
def rows_at(x, place, one):
    return (vector(x, place, one), vector(x, place + 3, one), vector(x, place + 6, one))


@inlined
def put_rows(x, place, A):
    put_vector(x, place, A[0])
    put_vector(x, place + 3, A[1])
    put_vector(x, place + 6, A[2])


@inlined
def seen(b, x, Om, one):
    """Set the moment in space as seen at the beginning of the step, with what depends on the state."""
    if b[LINEAR.called] != 0:
        f = add(vector(x, AT.given, one), vector(x, AT.called + CALLED.moment, one))
        put_vector(x, AT.space, add(f, applied(rows_at(x, AT.called + CALLED.velocity, one), Om)))


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
            x[(AT.W + r) * n + l], x[(AT.W1 + r) * n + l] = W[3 * i + r], W[3 * i + 3 + r]
            x[(AT.a + r) * n + l] = turn[1 + r] / turn[0]
            x[(AT.given + r) * n + l] = x[(AT.space + r) * n + l] = factor * m[r]
            x[(AT.moving + r) * n + l] = factor * moved[3 * i + r] if b[LINEAR.moved] != 0 else 0.0
            x[(AT.rotor + r) * n + l] = factor * wheels[6 * i + r] if b[LINEAR.wheels] != 0 else 0.0
            x[(AT.rate + r) * n + l] = factor * wheels[6 * i + 3 + r] if b[LINEAR.wheels] != 0 else 0.0
            for k in range(3):
                x[(AT.R + 3 * r + k) * n + l] = R[r][k]
                x[(AT.dead + 3 * r + k) * n + l] = f[r][k]
                e = r if r == k else 6 - r - k
                x[(AT.N + 3 * r + k) * n + l] = N[6 * i + e] if b[LINEAR.normals] != 0 else 0.0
        if b[LINEAR.called] != 0:
            called = doubles(b[LINEAR.called])
            for k in range(CALLED.rows):
                x[(AT.called + k) * n + l] = called[CALLED.size * i + k]


@inlined
def turned_back(s, a, v):
    """Return Cᵀ v."""
    return minus(scaled(2.0, mean_transposed(s, a, v)), v)


@inlined
def all_of(mask, zero):
    """Whether the mask is set for all."""
    return not any_of(select(mask, zero, zero + 1.0) > 0.5)


@shared
def columns(address, one, solved, emitted, rows):
    """Write the matrices of midpoint steps of a state of so many rows, 6 or 12: each a column of `emitted`."""
    b = integers(address)
    n, x, out, fixed = lanes(one), doubles(b[LINEAR.workspace]), doubles(b[LINEAR.out]), doubles(b[LINEAR.body])
    body = fixed_matrix(fixed, FIXED.J), fixed_matrix(fixed, FIXED.E), fixed_matrix(fixed, FIXED.D)
    n0, zero = tall(fixed_vector(fixed, FIXED.n), one), splat(0.0, one)
    o = (zero, zero, zero)
    none = (o, o, o)
    for first in range(0, b[LINEAR.steps], n):
        gather(b, x, n, first, min(first + n, b[LINEAR.steps]))
        left = solved(b, x, body, n0, one)
        if not all_of(left <= STALLED, zero):
            b[LINEAR.failed] += 1
        F, f = rows_at(x, AT.dead, one), vector(x, AT.given, one)
        for c in range(3):
            e = tall(unit(c), one)
            dF = (cross(F[0], e), cross(F[1], e), cross(F[2], e))
            df = cross(f, e)
            if b[LINEAR.called] != 0:
                df = add(df, vector(x, AT.called + CALLED.attitude + 3 * c, one))
            emitted(b, x, body, n0, out, first, c, one, e, 0.0, o, none, -1, o, o, df, dF, o, o, o)
            emitted(b, x, body, n0, out, first, 3 + c, one, o, 0.0, e, none, -1, o, o, o, none, o, o, o)
        for c in range(6 if rows > 6 else 0):
            u = inertia_times(c, tall((1.0, 0.0, 0.0), one))
            dN = (u, inertia_times(c, tall((0.0, 1.0, 0.0), one)), inertia_times(c, tall((0.0, 0.0, 1.0), one)))
            emitted(b, x, body, n0, out, first, 6 + c, one, o, 0.0, o, dN, -1, o, o, o, none, o, o, o)
        for c in range(6 if b[LINEAR.inertia] >= 0 else 0):
            at = b[LINEAR.inertia] + c
            emitted(b, x, body, n0, out, first, at, one, o, 0.0, o, none, c, o, o, o, none, o, o, o)
        if b[LINEAR.step] >= 0:
            at = b[LINEAR.step]
            emitted(b, x, body, n0, out, first, at, one, o, 1.0, o, none, -1, o, o, o, none, o, o, o)
        for k in range(9 if b[LINEAR.dead] >= 0 else 0):
            i, g, at = k // 3, vector(x, AT.R + 3 * (k % 3), one), b[LINEAR.dead] + k
            dF = (
                scaled(1.0 if i == 0 else 0.0, g),
                scaled(1.0 if i == 1 else 0.0, g),
                scaled(1.0 if i == 2 else 0.0, g),
            )
            emitted(b, x, body, n0, out, first, at, one, o, 0.0, o, none, -1, o, o, o, dF, o, o, o)
        for k in range(9 if b[LINEAR.damping] >= 0 else 0):
            v, at = scaled(load(x, (AT.Om + k % 3) * n, one), tall(unit(k // 3), one)), b[LINEAR.damping] + k
            emitted(b, x, body, n0, out, first, at, one, o, 0.0, o, none, -1, o, o, o, none, v, o, o)
        for c in range(3):
            e = tall(unit(c), one)
            if b[LINEAR.axis] >= 0:
                at = b[LINEAR.axis] + c
                emitted(b, x, body, n0, out, first, at, one, o, 0.0, o, none, -1, e, o, o, none, o, o, o)
            if b[LINEAR.moving] >= 0:
                at = b[LINEAR.moving] + c
                emitted(b, x, body, n0, out, first, at, one, o, 0.0, o, none, -1, o, e, o, none, o, o, o)
            if b[LINEAR.space] >= 0:
                at, g = b[LINEAR.space] + c, vector(x, AT.R + 3 * c, one)
                emitted(b, x, body, n0, out, first, at, one, o, 0.0, o, none, -1, o, o, g, none, o, o, o)
            if b[LINEAR.rotor] >= 0:
                at = b[LINEAR.rotor] + c
                emitted(b, x, body, n0, out, first, at, one, o, 0.0, o, none, -1, o, o, o, none, o, e, o)
            if b[LINEAR.rate] >= 0:
                at = b[LINEAR.rate] + c
                emitted(b, x, body, n0, out, first, at, one, o, 0.0, o, none, -1, o, o, o, none, o, o, e)
