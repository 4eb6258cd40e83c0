"""The steps of `lie_midpoint` and `energy_momentum` for 16 bodies in lanes.

What is solved. Each body is written in a frame b of its own, in which its inertia is as short as it can be: the
principal axes of a body without constraint; else a frame whose third direction is the constrained axis and with
J12 = 0. With Ω = W + y the velocity of the step, a = h Ω/2, q = J31 Ω1 + J32 Ω2 (0 in principal axes) and
c_i = (J_j - J_k)/J_i, k_i = 1/J_i, the step of `lie_midpoint` reads

    y = (h/2) [(c1 Ω2 Ω3 - k1 q Ω2,  c2 Ω3 Ω1 + k2 q Ω1,  c3 Ω1 Ω2) + k ∘ G(Ω)],
    G = M - D Ω + (I - â) f + (I - s a aᵀ) Σ e_i × (I - â) F_i,         s = 1/(1 + |a|²),

M the moment given in the moving frame, D damping, f = Λ_nᵀ m the moment given in space, F_i = Λ_nᵀ f^i the dead
forces. c3 = k3 = 0 under the constraint: then y3 = 0, and one text serves all bodies. The director scheme has the
equations r(y) = 0 of `energy_momentum`, with y3 = -W3 under the constraint, in the same frame. Either is solved three
times with the Jacobian at the first guess; a lane that is not done to round-off goes on with Newton's iteration, while
its neighbours keep what they have. These are the equations of the two modules, in another frame and solved in another
way, so the balances that the modules derive hold here as they do there. As there, W and the quaternion are sums of
small increments, W compensated, and the quaternion is kept at unit length.
"""

from ..geometry.compiled import inlined, kernel
from .lane_arrays import (
    BAD,
    CARRY,
    FORCES,
    INCREMENT,
    LANES,
    MOVING,
    NORMAL,
    OFF,
    OPEN,
    PULL,
    RATE,
    WORK,
    J,
    K,
    P,
    W,
    Y,
    body_at,
    euler_at,
    get,
    lanes,
    matrix_at,
    more_at,
    normal_at,
    product_of,
    put,
    put_vector,
    quaternion_at,
    vector,
)
from .midpoint_kernel import (
    EPS,
    PI,
    ROUND_OFF,
    add,
    advanced,
    axpy,
    cross,
    dead_moment,
    dead_rate,
    dead_turning,
    director_row,
    director_terms,
    dot,
    first_moment,
    flipped,
    loaded_row,
    mean,
    scaled,
    size,
    summed,
    times,
    unit,
    unit_cross,
)


@inlined
def right(f, body, Om, M, more, F):
    """Return the right-hand side of ``y = ...``, f = h/2.

    Without `more` J31 = J32 = 0 and there is no load but M; without `F` there are no dead forces.
    """
    c, b, k = body
    if more is None:
        return (
            f * (c[0] * Om[1] * Om[2] + k[0] * M[0]),
            f * (c[1] * Om[2] * Om[0] + k[1] * M[1]),
            f * (c[2] * Om[0] * Om[1] + k[2] * M[2]),
        )
    D, push = more
    a, q = scaled(f, Om), b[0] * Om[0] + b[1] * Om[1]
    G = add(axpy(-1.0, times(D, Om), M), axpy(-1.0, cross(a, push), push))
    if F is not None:
        G = add(G, dead_moment(F, a))
    return (
        f * (Om[1] * (c[0] * Om[2] - k[0] * q) + k[0] * G[0]),
        f * (Om[0] * (c[1] * Om[2] + k[1] * q) + k[1] * G[1]),
        f * (c[2] * Om[0] * Om[1] + k[2] * G[2]),
    )


@inlined
def right_column(f, k, j, Om, more, F, gyro):
    """Return the column j of the Jacobian of ``y - right``."""
    D, push = more
    dG = axpy(-f, unit_cross(j, push), (-D[0][j], -D[1][j], -D[2][j]))
    if F is not None:
        dG = add(dG, dead_rate(F, scaled(f, Om), scaled(f, unit(j))))
    return axpy(-f, (gyro[0] + k[0] * dG[0], gyro[1] + k[1] * dG[1], gyro[2] + k[2] * dG[2]), unit(j))


@inlined
def inverse(f, body, Om, more, F):
    """Return the inverse of the Jacobian of ``y - right``, rows."""
    c, b, k = body
    x, y, z = scaled(f, Om)
    if more is None:
        a01, a02, a10, a12, a20, a21 = c[0] * z, c[0] * y, c[1] * z, c[1] * x, c[2] * y, c[2] * x
        n = (1.0 - a12 * a21, a01 + a02 * a21, a02 + a01 * a12)
        d = 1.0 / (n[0] - a10 * n[1] - a20 * n[2])
        return (
            scaled(d, n),
            scaled(d, (a10 + a12 * a20, 1.0 - a02 * a20, a12 + a02 * a10)),
            scaled(d, (a20 + a10 * a21, a21 + a01 * a20, 1.0 - a01 * a10)),
        )
    q, one, two = b[0] * Om[0] + b[1] * Om[1], k[0] * Om[1], k[1] * Om[0]
    c0 = right_column(f, k, 0, Om, more, F, (-one * b[0], c[1] * Om[2] + k[1] * q + two * b[0], c[2] * Om[1]))
    c1 = right_column(f, k, 1, Om, more, F, (c[0] * Om[2] - k[0] * q - one * b[1], two * b[1], c[2] * Om[0]))
    c2 = right_column(f, k, 2, Om, more, F, (c[0] * Om[1], c[1] * Om[0], 0.0))
    n = cross(c1, c2)
    d = 1.0 / dot(c0, n)
    return (scaled(d, n), scaled(d, cross(c2, c0)), scaled(d, cross(c0, c1)))


@inlined
def chord(f, body, w, y, M, more, F, A):
    """Return the increment of y."""
    return times(A, axpy(-1.0, y, right(f, body, add(w, y), M, more, F)))


@inlined
def chords(x, l, h, more, F):
    """Set y by three chord steps, and whether it is still open."""
    f, w, y, M, body = 0.5 * h, vector(x, W, l), scaled(h, vector(x, RATE, l)), vector(x, MOVING, l), body_at(x, l)
    A = inverse(f, body, add(w, y), more, F)
    y = add(y, chord(f, body, w, y, M, more, F, A))
    d = chord(f, body, w, y, M, more, F, A)
    y, before = add(y, d), size(d)
    d = chord(f, body, w, y, M, more, F, A)
    y, now = add(y, d), size(d)
    level = EPS * (size(w) + size(y))
    put_vector(x, Y, l, y)
    put(x, INCREMENT, l, now)
    put(x, OPEN, l, 0.0 if now <= level or now * now <= 0.1 * level * before else 1.0)


@kernel
def solve(x, h):
    """Set y of all lanes where J31 = J32 = 0 and M is the only load."""
    for l in range(lanes(x)):
        chords(x, l, h, None, None)


@kernel
def solve_pushed(x, h):
    """Set y of all lanes where there are no dead forces."""
    for l in range(lanes(x)):
        chords(x, l, h, more_at(x, l), None)


@kernel
def solve_heavy(x, h):
    """Set y of all lanes."""
    for l in range(lanes(x)):
        chords(x, l, h, more_at(x, l), matrix_at(x, FORCES, l))


@inlined
def close(x, l, w, y, d, is_round_off):
    """Add the increment of Newton's iteration to y in an open lane, and close it if it is done.

    Where what is left of the equations is round-off and increments stay large, y is left as it is.
    """
    now, before, is_open = size(d), get(x, INCREMENT, l), get(x, OPEN, l) != 0.0
    level = EPS * (size(w) + size(y))
    done = now <= level or (now > 0.5 * before and EPS * now <= 1e-9 * level)
    done = done or now * now * now <= 0.1 * level * before * before
    rests = not is_open or (not done and is_round_off and now > 0.5 * before)
    done = done or rests
    put_vector(x, Y, l, add(y, (0.0 if rests else d[0], 0.0 if rests else d[1], 0.0 if rests else d[2])))
    put(x, INCREMENT, l, now)
    put(x, OPEN, l, 1.0 if is_open and not done else 0.0)


@kernel
def newton(x, h):
    """Improve y of the open lanes once; close those that are done."""
    f = 0.5 * h
    for l in range(lanes(x)):
        w, y, M, body = vector(x, W, l), vector(x, Y, l), vector(x, MOVING, l), body_at(x, l)
        more, F, j = more_at(x, l), matrix_at(x, FORCES, l), vector(x, J, l)
        Om = add(w, y)
        r = axpy(-1.0, y, right(f, body, Om, M, more, F))
        left_over = j[0] * abs(r[0]) + j[1] * abs(r[1]) + j[2] * abs(r[2])
        terms = j[0] * abs(y[0]) + j[1] * abs(y[1]) + j[2] * abs(y[2]) + abs(f) * size(j) * size(Om) * size(Om)
        close(x, l, w, y, times(inverse(f, body, Om, more, F), r), left_over <= ROUND_OFF * terms)


@kernel
def advance(x, h):
    """Go on by y; mark lanes that turn by more than π or whose quaternion is no longer of unit length; keep |a|²."""
    for l in range(lanes(x)):
        w, y = vector(x, W, l), vector(x, Y, l)
        a = scaled(0.5 * h, add(w, y))
        a2 = dot(a, a)
        w, carry = summed(w, vector(x, CARRY, l), scaled(2.0, y))
        p, gap = advanced(quaternion_at(x, P, l), a, 1.0 / (1.0 + a2))
        put_vector(x, W, l, w)
        put_vector(x, CARRY, l, carry)
        put_vector(x, RATE, l, scaled(1.0 / h, y))
        put_vector(x, P, l, (p[0], p[1], p[2]))
        put(x, P + 3 * LANES, l, p[3])
        put(x, INCREMENT, l, a2)
        put(x, BAD, l, 0.0 if gap <= 1e-9 and 4.0 * a2 <= PI * PI else 1.0)


# The director scheme: r(y) = J y - z + h/2 [τ Ω - W × EΩ - N E Ω] - h/2 G with Ω = W + y, as `energy_momentum` has it.


@inlined
def left(f, w, y, N, E, trace, M, more, F, held):
    """Return r(y), f = h/2, in its third place ``y + W`` under a constraint; without `more` there is no load."""
    Om, EN = add(w, y), product_of(E, N)
    EO = times(E, Om)
    turning = axpy(EN[0][0] + EN[1][1] + EN[2][2], Om, axpy(-1.0, cross(w, EO), scaled(-1.0, times(N, EO))))
    if more is not None:
        (D, push), a = more, scaled(f, Om)
        s = 1.0 / (1.0 + dot(a, a))
        both = add(axpy(-s, times(D, Om), M), push)
        G = scaled(0.5, axpy(1.0 + s, axpy(-1.0, cross(a, push), both), scaled(s * dot(a, both), a)))
        turning = axpy(-1.0, add(G, axpy(-1.0, dead_turning(F, a), first_moment(F))), turning)
    r = axpy(f, turning, axpy(-1.0, first_moment(EN), axpy(trace, y, scaled(-1.0, times(E, y)))))
    return (r[0], r[1], w[2] + y[2] if held else r[2])


@inlined
def left_column(f, k, w, Om, N, E, trace, M, more, F, held):
    """Return the column dr/dy_k."""
    e, EN = unit(k), product_of(E, N)
    turning = axpy(EN[0][0] + EN[1][1] + EN[2][2], e, axpy(-1.0, cross(w, E[k]), scaled(-1.0, times(N, E[k]))))
    if more is not None:
        (D, push), a = more, scaled(f, Om)
        s = 1.0 / (1.0 + dot(a, a))
        CO, ds = times(D, Om), -2.0 * s * s * f * a[k]
        moving = axpy(-s, CO, M)
        p = add(moving, axpy(-1.0, cross(a, push), push))
        dm = axpy(-ds, CO, (-s * D[0][k], -s * D[1][k], -s * D[2][k]))
        q, dq = dot(a, add(moving, push)), f * (moving[k] + push[k]) + dot(a, dm)
        dp = axpy(1.0 + s, axpy(-f, unit_cross(k, push), dm), axpy(ds * q + s * dq, a, scaled(f * s * q, e)))
        turning = axpy(-0.5, axpy(ds, p, dp), axpy(f, dead_turning(F, e), turning))
    c = axpy(f, turning, axpy(trace, e, scaled(-1.0, E[k])))
    return (c[0], c[1], e[2] if held else c[2])


@inlined
def left_inverse(f, w, y, N, E, trace, M, more, F, held):
    """Return the inverse of the Jacobian of r, rows."""
    Om = add(w, y)
    c0 = left_column(f, 0, w, Om, N, E, trace, M, more, F, held)
    c1 = left_column(f, 1, w, Om, N, E, trace, M, more, F, held)
    c2 = left_column(f, 2, w, Om, N, E, trace, M, more, F, held)
    n = cross(c1, c2)
    d = 1.0 / dot(c0, n)
    return (scaled(d, n), scaled(d, cross(c2, c0)), scaled(d, cross(c0, c1)))


@inlined
def director_chords(x, l, h, M, more, F):
    """Set y by three chord steps, and whether it is still open."""
    f, w, N, (E, trace) = 0.5 * h, vector(x, W, l), normal_at(x, l), euler_at(x, l)
    held = get(x, K + 2 * LANES, l) == 0.0
    y = (0.0, 0.0, -w[2] if held else 0.0)
    A = left_inverse(f, w, y, N, E, trace, M, more, F, held)
    y = axpy(-1.0, times(A, left(f, w, y, N, E, trace, M, more, F, held)), y)
    d = times(A, left(f, w, y, N, E, trace, M, more, F, held))
    y, before = axpy(-1.0, d, y), size(d)
    d = times(A, left(f, w, y, N, E, trace, M, more, F, held))
    y, now = axpy(-1.0, d, y), size(d)
    level = EPS * (size(w) + size(y))
    put_vector(x, Y, l, y)
    put(x, INCREMENT, l, now)
    put(x, OPEN, l, 0.0 if now <= level or now * now <= 0.1 * level * before else 1.0)


@kernel
def solve_directors(x, h):
    """Set y of all lanes where there is no load; the equations are linear."""
    for l in range(lanes(x)):
        director_chords(x, l, h, None, None, None)


@kernel
def solve_loaded_directors(x, h):
    """Set y of all lanes."""
    for l in range(lanes(x)):
        director_chords(x, l, h, vector(x, MOVING, l), more_at(x, l), matrix_at(x, FORCES, l))


@kernel
def newton_directors(x, h):
    """Improve y of the open lanes once; close those that are done."""
    f = 0.5 * h
    for l in range(lanes(x)):
        w, y, N, (E, trace), M = vector(x, W, l), vector(x, Y, l), normal_at(x, l), euler_at(x, l), vector(x, MOVING, l)
        more, F, held = more_at(x, l), matrix_at(x, FORCES, l), get(x, K + 2 * LANES, l) == 0.0
        r = left(f, w, y, N, E, trace, M, more, F, held)
        d = scaled(-1.0, times(left_inverse(f, w, y, N, E, trace, M, more, F, held), r))
        close(x, l, w, y, d, size(r) <= ROUND_OFF * director_terms(h, trace, w, y, N))


@kernel
def advance_directors(x, h):
    """Go on by y; mark lanes that turn by more than π or whose quaternion is no longer of unit length; keep |a|²."""
    for l in range(lanes(x)):
        w, y, N = vector(x, W, l), vector(x, Y, l), normal_at(x, l)
        a = scaled(0.5 * h, add(w, y))
        a2 = dot(a, a)
        s = 1.0 / (1.0 + a2)
        dW, N = flipped(a, s, y, N)
        w, carry = summed(w, vector(x, CARRY, l), dW)
        p, gap = advanced(quaternion_at(x, P, l), a, s)
        put_vector(x, W, l, w)
        put_vector(x, CARRY, l, carry)
        put_vector(x, NORMAL, l, (N[0][0], N[1][1], N[2][2]))
        put_vector(x, NORMAL + 3 * LANES, l, (N[1][2], N[0][2], N[0][1]))
        put_vector(x, P, l, (p[0], p[1], p[2]))
        put(x, P + 3 * LANES, l, p[3])
        put(x, INCREMENT, l, a2)
        put(x, BAD, l, 0.0 if gap <= 1e-9 and 4.0 * a2 <= PI * PI else 1.0)


# What the work of the load and the reaction gain by a step.


@kernel
def pull(x, h, part):
    """Add what a substep gives to the work and to the mean reaction moment; `part` of the step is the substep."""
    f = 0.5 * h
    for l in range(lanes(x)):
        y, (b0, b1), M = vector(x, Y, l), (get(x, OFF, l), get(x, OFF + LANES, l)), vector(x, MOVING, l)
        Om = add(vector(x, W, l), y)
        (D, push), F = more_at(x, l), matrix_at(x, FORCES, l)
        a = scaled(f, Om)
        force = axpy(-1.0, times(D, Om), add(M, push))
        G2 = force[2] - (a[0] * push[1] - a[1] * push[0]) + dead_moment(F, a)[2]
        gyro = (get(x, J, l) - get(x, J + LANES, l)) * Om[0] * Om[1]
        put(x, PULL, l, get(x, PULL, l) - part * (gyro + G2 - (b0 * y[0] + b1 * y[1]) / f))
        put(x, WORK, l, get(x, WORK, l) + h * dot(Om, force))


@kernel
def pull_directors(x, h, part):
    """Add what a substep gives to the work and to the mean reaction moment; `part` of the step is the substep."""
    f = 0.5 * h
    for l in range(lanes(x)):
        w, y, N, (E, _), M = vector(x, W, l), vector(x, Y, l), normal_at(x, l), euler_at(x, l), vector(x, MOVING, l)
        (D, push), F, Om = more_at(x, l), matrix_at(x, FORCES, l), add(w, y)
        a = scaled(f, Om)
        s = 1.0 / (1.0 + dot(a, a))
        force = add(push, mean(s, a, axpy(-s, times(D, Om), M)))
        X0 = director_row((0.0, y[2], -y[1]), a, (0.0, w[2], -w[1]), N[0])
        X1 = director_row((-y[2], 0.0, y[0]), a, (-w[2], 0.0, w[0]), N[1])
        X2 = director_row((y[1], -y[0], 0.0), a, (w[1], -w[0], 0.0), N[2])
        L01 = E[0][0] * X0[1] + E[0][1] * X1[1] + E[0][2] * X2[1]
        L10 = E[1][0] * X0[0] + E[1][1] * X1[0] + E[1][2] * X2[0]
        rest0 = add(axpy(-1.0, cross(a, F[0]), F[0]), loaded_row(s, a, force, (1.0, 0.0, 0.0)))
        rest1 = add(axpy(-1.0, cross(a, F[1]), F[1]), loaded_row(s, a, force, (0.0, 1.0, 0.0)))
        put(x, PULL, l, get(x, PULL, l) - part * ((L10 - L01) / f + rest0[1] - rest1[0]))
        put(x, WORK, l, get(x, WORK, l) + h * s * dot(Om, force))
