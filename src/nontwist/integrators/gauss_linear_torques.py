"""What is known of eight linearised steps of collocation, and the torques at their stages (`gauss_linear`)."""

from ..engine.lane import matrix, put_vector, vector
from ..engine.layout import layout
from ..engine.linear import CALLED, FIXED, LINEAR, applied, fixed_matrix, fixed_vector, tall
from ..geometry.compiled import inlined, shared
from ..geometry.elements import doubles
from ..geometry.tuples import (
    add,
    attitude,
    axpy,
    column,
    cross,
    dot,
    minus,
    scaled,
    times,
    transposed_times,
)
from .gauss_coefficients import WIDTH

ROWS, MOMENTUM, VERTICAL, STEADY = range(4)  # what a body turns by
NONE, AS_TORQUE, AS_MOMENT = range(3)  # how dead forces act, ``Σ e_i × Cᵀ f_i`` or ``C⁻¹ Σ C e_i × f_i``
MOST = 3 * WIDTH
TINY, FAINT = 1e-300, 1e-280  # FAINT: the square of a vector that has no direction any more
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
    called=CALLED.size * WIDTH,
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
    ends=9,
    g=3 * WIDTH,
    gain=18 * WIDTH,
    lifted=6 * WIDTH,
    rest=MOST,
    E0=9,
    E1=9,
    along=3,
    bent=3 * WIDTH,
    swung=9,
    direct=9,
    of_start=9,
    of_attitude=9,
    of_step=3,
    room=2,
    a=MOST * (2 * MOST + 6),
)


@inlined
def drawn(C, f):
    """Return ``C⁻¹ f``."""
    n = cross(C[1], C[2])
    inner = axpy(f[1], cross(C[2], C[0]), scaled(f[2], cross(C[0], C[1])))
    return scaled(1.0 / dot(C[0], n), axpy(f[0], n, inner))


@inlined
def columns_at(x, place, one):
    """Return the three columns of a matrix that lies there by columns."""
    return (vector(x, place, one), vector(x, place + 3, one), vector(x, place + 6, one))


@inlined
def put_columns(x, place, c0, c1, c2):
    """Write the three columns of a matrix there."""
    put_vector(x, place, c0)
    put_vector(x, place + 3, c1)
    put_vector(x, place + 6, c2)


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
        if b[LINEAR.called] != 0:
            called = doubles(b[LINEAR.called])
            for k in range(CALLED.size * s):
                x[(AT.called + k) * n + l] = called[CALLED.size * s * i + k]


@inlined
def torque_at(b, x, j, W, C, J, D, one, loaded):
    """Return the torque at the stage j."""
    g = cross(times(J, W), W)
    if loaded is not None:
        g = add(axpy(-1.0, times(D, W), g), vector(x, AT.moving + 3 * j, one))
        g = add(g, cross(vector(x, AT.rotor + 3 * j, one), W))
        F, push = matrix(x, AT.dead, one), vector(x, AT.space + 3 * j, one)
        has_dead, has_space = b[LINEAR.has_dead], b[LINEAR.has_space]
        if b[LINEAR.called] != 0:
            at = AT.called + CALLED.size * j
            g = add(g, add(vector(x, at + CALLED.moment, one), called_rows(x, j, C[0], C[1], C[2], one)))
            g = add(g, applied(columns_at(x, at + CALLED.velocity, one), W))
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
def called_rows(x, j, t0, t1, t2, one):
    """Return what changes t_k of the rows at the stage j do to the torque of what depends on the state."""
    at = AT.called + CALLED.size * j + CALLED.rows
    g = add(applied(columns_at(x, at, one), t0), applied(columns_at(x, at + 9, one), t1))
    return add(g, applied(columns_at(x, at + 18, one), t2))


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
def pulled(b, x, one):
    """Return p and γ of dead forces along one direction: their torque is p × γ, and γ the one row that they need."""
    F, v = matrix(x, AT.dead, one), tall(fixed_vector(doubles(b[LINEAR.body]), FIXED.vertical), one)
    g = transposed_times(matrix(x, AT.R, one), v)
    return axpy(g[0], F[0], axpy(g[1], F[1], scaled(g[2], F[2]))), g


@inlined
def of_dead(F, C, has_dead):
    """Return the torque of dead forces."""
    return drawn(C, dead_moment(F, C)) if has_dead == AS_MOMENT else dead_torque(F, C)


@inlined
def are_coupled(b):
    """Return 0 where the torque at a stage depends on its own velocity alone, and not on its rows."""
    return b[LINEAR.has_dead] + b[LINEAR.has_space] + (1 if b[LINEAR.called] != 0 else 0)


@inlined
def rows_changed(b, x, j, F, one, t0, t1, t2):
    """Return what changes t_k of the rows at the stage j do to the torque."""
    q, has_dead, has_space = tall((0.0, 0.0, 0.0), one), b[LINEAR.has_dead], b[LINEAR.has_space]
    if b[LINEAR.called] != 0:
        q = called_rows(x, j, t0, t1, t2, one)
    if has_dead == AS_TORQUE:
        q = add(q, dead_torque(F, (t0, t1, t2)))
    if has_dead == AS_MOMENT or has_space != 0:
        C, p, push = columns_at(x, AT.C + 9 * j, one), vector(x, AT.p + 3 * j, one), tall((0.0, 0.0, 0.0), one)
        if has_dead == AS_MOMENT:
            push = dead_moment(F, (t0, t1, t2))
        q = add(q, drawn(C, minus(push, (dot(t0, p), dot(t1, p), dot(t2, p)))))
    return q
