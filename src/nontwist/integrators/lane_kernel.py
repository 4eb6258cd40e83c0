"""The steps of `lie_midpoint` and `energy_momentum` for 16 bodies in lanes, and their march over the grid.

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

Why it is quick. All numbers of 16 bodies lie in one flat array `x`, each in a row of 16, at places that are constants
of the compiler, and loops over the lanes have no branch but selections. So LLVM sees that no two rows overlap and works
on 4 (AVX2) or 8 (AVX-512) lanes with one instruction. Three things had to be avoided: indices with a sign (`get`), a
number of turns that the compiler knows (`lanes`), and storing a number where it has just been read (`widen`). Without
`fastmath` nothing is reordered or fused: a lane holds the same bits, whatever its neighbours and its number, and so
does a member for any number of threads and any size of a block. What remains of the last 16 repeats the last member.

What is watched on the way, at whole steps: least and greatest value of the quantities K, V, K + V - A (A: work of the
load), π, Π, ψ', e·π (e vertical) and, as means over a step, of the reaction moment -μ; their integrals over time are
sums over the substeps, by the trapezoidal rule, and so have the order of the composition.
"""

from math import sqrt

import numpy as np

from ..geometry.compiled import inlined, kernel
from .midpoint_kernel import (
    EPS,
    ITERATIONS,
    NAN,
    PI,
    add,
    advanced,
    attitude,
    axpy,
    column,
    cross,
    dead_moment,
    dead_rate,
    dead_turning,
    director_row,
    dot,
    first_moment,
    flipped,
    loaded_row,
    mean,
    of_body,
    scaled,
    size,
    summed,
    times,
    transposed_times,
    unit,
    unit_cross,
)

LANES = 16
OK, TURN, STALLED, BROKEN = 0, 1, 2, 3
STEADY, MOVED, PUSHED, HEAVY = 0, 1, 2, 3  # y = 0; J31 = J32 = 0 and no load but M; no dead forces; anything
INFINITE = float("inf")
QUANTITIES = 12  # K, V, K + V - A, π (3), Π (3), ψ', e·π at nodes; -μ over steps
NODAL = QUANTITIES - 1


def places(*sizes: int) -> list[np.int64]:
    """Return where rows of 16 begin when so many follow one another, and where they end.

    As NumPy integers: of Python's, Numba would compile every function once for each value.
    """
    return [np.int64(LANES * sum(sizes[:k])) for k in range(len(sizes) + 1)]


# A member's state, in b: quaternion (scalar first), W, its compensation, and for lie-midpoint the rate y/h of the last
# step, for the director scheme N (11, 22, 33, 23, 13, 12). Its body: c, (J31, J32), k, (J1, J2, J3), b as columns in
# body components and as a quaternion, dead forces, damping, n and e.
STATE, DIRECTOR_STATE, BODY = 13, 16, 48
P, W, CARRY, RATE, C, OFF, K, J, BASIS, FRAME, DEAD, DAMPING, AXIS, VERTICAL, SCALE, GONE, *_REST = places(
    4, 3, 3, 6, 3, 2, 3, 3, 9, 4, 9, 9, 3, 3, 1, 1, 3, 3, 9, 3, 1, 1, 1, *(6 * (QUANTITIES,)), 1, 1
)
MOVING, SPACE, FORCES, Y, INCREMENT, OPEN, BAD, NOW, FIRST, LEAST, MOST, INTEGRAL, SPARE, PULL, WORK, ROWS = _REST
NORMAL = RATE
# What is written down of the quantities: at first, least, greatest, integral; the work.
SUMS = 4 * QUANTITIES + 1


@inlined
def lanes(x):
    """Return 16, as what the compiler cannot know: else it unrolls a loop over the lanes instead of vectorising it."""
    return LANES * (x.shape[0] // ROWS)


@inlined
def get(x, place, l):
    """Return a number; its index is unsigned, or Numba would look for negative ones, and no loop become vectors."""
    return x[np.uintp(place + l)]


@inlined
def put(x, place, l, a):
    x[np.uintp(place + l)] = a


@inlined
def vector(x, place, l):
    return (get(x, place, l), get(x, place + LANES, l), get(x, place + 2 * LANES, l))


@inlined
def put_vector(x, place, l, a):
    put(x, place, l, a[0])
    put(x, place + LANES, l, a[1])
    put(x, place + 2 * LANES, l, a[2])


@inlined
def quaternion_at(x, place, l):
    return (get(x, place, l), get(x, place + LANES, l), get(x, place + 2 * LANES, l), get(x, place + 3 * LANES, l))


@inlined
def matrix_at(x, place, l):
    return (vector(x, place, l), vector(x, place + 3 * LANES, l), vector(x, place + 6 * LANES, l))


@inlined
def body_at(x, l):
    return vector(x, C, l), (get(x, OFF, l), get(x, OFF + LANES, l)), vector(x, K, l)


@inlined
def more_at(x, l):
    """Return damping and moment in space."""
    return matrix_at(x, DAMPING, l), vector(x, SPACE, l)


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
def close(x, l, w, y, d):
    """Add the increment of Newton's iteration to y in an open lane, and close it if it is done."""
    now, before, is_open = size(d), get(x, INCREMENT, l), get(x, OPEN, l) != 0.0
    level = EPS * (size(w) + size(y))
    done = now <= level or (now > 0.5 * before and EPS * now <= 1e-9 * level)
    done = done or now * now * now <= 0.1 * level * before * before
    put_vector(x, Y, l, add(y, (d[0] if is_open else 0.0, d[1] if is_open else 0.0, d[2] if is_open else 0.0)))
    put(x, INCREMENT, l, now)
    put(x, OPEN, l, 1.0 if is_open and not done else 0.0)


@kernel
def newton(x, h):
    """Improve y of the open lanes once; close those that are done."""
    f = 0.5 * h
    for l in range(lanes(x)):
        w, y, M, body = vector(x, W, l), vector(x, Y, l), vector(x, MOVING, l), body_at(x, l)
        more, F = more_at(x, l), matrix_at(x, FORCES, l)
        close(x, l, w, y, chord(f, body, w, y, M, more, F, inverse(f, body, add(w, y), more, F)))


@kernel
def any_of(x, place):
    """Whether a lane that still runs has a mark there."""
    found = False
    for l in range(lanes(x)):
        found = found or (get(x, place, l) != 0.0 and get(x, GONE, l) == 0.0)
    return found


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
def normal_at(x, l):
    """Return N as rows."""
    n00, n11, n22 = vector(x, NORMAL, l)
    n12, n02, n01 = vector(x, NORMAL + 3 * LANES, l)
    return ((n00, n01, n02), (n01, n11, n12), (n02, n12, n22))


@inlined
def euler_at(x, l):
    """Return E as rows, and its trace."""
    (j0, j1, j2), e02, e12 = vector(x, J, l), -get(x, OFF, l), -get(x, OFF + LANES, l)
    t = 0.5 * (j0 + j1 + j2)
    return ((t - j0, 0.0, e02), (0.0, t - j1, e12), (e02, e12, t - j2)), t


@inlined
def product_of(E, N):
    """Return the rows of E N for a symmetric N."""
    return (times(N, E[0]), times(N, E[1]), times(N, E[2]))


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
        A = left_inverse(f, w, y, N, E, trace, M, more, F, held)
        close(x, l, w, y, scaled(-1.0, times(A, left(f, w, y, N, E, trace, M, more, F, held))))


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


@kernel
def turn_moment(x, m0, m1, m2):
    """Set M of a moment along the moving directors, in body components."""
    for l in range(lanes(x)):
        m = scaled(get(x, SCALE, l), (m0, m1, m2))
        put_vector(x, MOVING, l, transposed_times(matrix_at(x, BASIS, l), m))


@kernel
def turn_space(x, m0, m1, m2):
    """Set f of a moment in space."""
    for l in range(lanes(x)):
        m = scaled(get(x, SCALE, l), (m0, m1, m2))
        put_vector(x, SPACE, l, transposed_times(attitude(quaternion_at(x, P, l)), m))


@kernel
def turn_dead(x):
    """Set the dead forces F_i in b."""
    for l in range(lanes(x)):
        R, dead = attitude(quaternion_at(x, P, l)), matrix_at(x, DEAD, l)
        put_vector(x, FORCES, l, transposed_times(R, dead[0]))
        put_vector(x, FORCES + 3 * LANES, l, transposed_times(R, dead[1]))
        put_vector(x, FORCES + 6 * LANES, l, transposed_times(R, dead[2]))


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


@inlined
def with_normal(x, l, w, Pi):
    """Return K = ½ Σ E_ij V_i·V_j and Π = Σ e_i × Σ_j E_ij V_j of V_i = W × e_i + N_i, from Π = J W."""
    N, E = normal_at(x, l), euler_at(x, l)[0]
    EN = product_of(E, N)
    z = first_moment(EN)
    own = dot(EN[0], N[0]) + dot(EN[1], N[1]) + dot(EN[2], N[2])
    return 0.5 * (dot(w, Pi) + own) + dot(w, z), add(Pi, z)


@kernel
def observe(x, normals):
    """Set the quantities at the node; N counts where there are `normals`."""
    for l in range(lanes(x)):
        w, (b0, b1), n = vector(x, W, l), (get(x, OFF, l), get(x, OFF + LANES, l)), vector(x, AXIS, l)
        j0, j1, j2 = vector(x, J, l)
        Pi = (j0 * w[0] + b0 * w[2], j1 * w[1] + b1 * w[2], b0 * w[0] + b1 * w[1] + j2 * w[2])
        R, f = attitude(quaternion_at(x, P, l)), matrix_at(x, DEAD, l)
        V = -(dot(f[0], (R[0][0], R[1][0], R[2][0])) + dot(f[1], (R[0][1], R[1][1], R[2][1])))
        V -= dot(f[2], (R[0][2], R[1][2], R[2][2]))
        kinetic = 0.5 * dot(w, Pi)
        if normals is not None:
            kinetic, Pi = with_normal(x, l, w, Pi)
        pi = times(R, Pi)
        put(x, NOW, l, kinetic)
        put(x, NOW + LANES, l, V)
        put(x, NOW + 2 * LANES, l, kinetic + V - get(x, WORK, l))
        put_vector(x, NOW + 3 * LANES, l, pi)
        put_vector(x, NOW + 6 * LANES, l, times(matrix_at(x, BASIS, l), Pi))
        put(x, NOW + 9 * LANES, l, dot(n, w))
        put(x, NOW + 10 * LANES, l, dot(vector(x, VERTICAL, l), pi))


@kernel
def integrate(x, h):
    """Add h times the quantities at the node to their integrals."""
    for i in range(NODAL * lanes(x)):
        put(x, INTEGRAL, i, get(x, INTEGRAL, i) + h * get(x, NOW, i))


@kernel
def widen(x, h):
    """Take the quantities of a whole step into the least and the greatest, and the reaction into its integral."""
    for l in range(lanes(x)):
        put(x, NOW + NODAL * LANES, l, get(x, PULL, l))
        put(x, INTEGRAL + NODAL * LANES, l, get(x, INTEGRAL + NODAL * LANES, l) + h * get(x, PULL, l))
        put(x, PULL, l, 0.0)
    # Over a spare place: a number that is stored where it has been read makes a masked store, slow on some processors.
    for i in range(QUANTITIES * lanes(x)):
        now, least = get(x, NOW, i), get(x, LEAST, i)
        put(x, SPARE, i, now if now < least else least)
    for i in range(QUANTITIES * lanes(x)):
        now, most = get(x, NOW, i), get(x, MOST, i)
        put(x, LEAST, i, get(x, SPARE, i))
        put(x, SPARE, i, now if now > most else most)
    for i in range(QUANTITIES * lanes(x)):
        put(x, MOST, i, get(x, SPARE, i))


@inlined
def product(p, q):
    """Return the product of two quaternions, scalar first."""
    u, v = (p[1], p[2], p[3]), (q[1], q[2], q[3])
    w = add(axpy(p[0], v, scaled(q[0], u)), cross(u, v))
    return (p[0] * q[0] - dot(u, v), w[0], w[1], w[2])


@kernel
def gather(x, order, state, bodies, scales, sums, failures, first, last):
    """Fill the lanes with members; lanes beyond `last` repeat the one before it."""
    for l in range(lanes(x)):
        i = order[min(first + l, last - 1)]
        body, scale = (i if bodies.shape[0] > 1 else 0), scales[i if scales.shape[0] > 1 else 0]
        for k in range(state.shape[1]):
            put(x, P + LANES * k, l, state[i, k])
        for k in range(BODY):
            put(x, C + LANES * k, l, bodies[body, k])
        for k in range(9):
            x[DAMPING + LANES * k + l] *= scale
            put(x, FORCES + LANES * k, l, 0.0)
        x[SCALE + l], x[GONE + l], x[PULL + l], x[WORK + l] = scale, failures[i, 0], 0.0, 0.0
        put_vector(x, MOVING, l, (0.0, 0.0, 0.0))
        put_vector(x, SPACE, l, (0.0, 0.0, 0.0))
        put_vector(x, Y, l, (0.0, 0.0, 0.0))
        x[OPEN + l] = x[INCREMENT + l] = x[BAD + l] = 0.0
        if sums.shape[0] > 0:
            for k in range(4 * QUANTITIES):
                put(x, FIRST + LANES * k, l, sums[i, k])
            put(x, WORK, l, sums[i, 4 * QUANTITIES])


@kernel
def scatter(x, order, state, sums, first, last):
    """Put back what the members carry on."""
    for number in range(first, last):
        l, i = number - first, order[number]
        for k in range(state.shape[1]):
            state[i, k] = get(x, P + LANES * k, l)
        if sums.shape[0] > 0:
            for k in range(4 * QUANTITIES):
                sums[i, k] = NAN if get(x, GONE, l) != 0.0 else get(x, FIRST + LANES * k, l)
            sums[i, 4 * QUANTITIES] = get(x, WORK, l)


@kernel
def start_watching(x, normals):
    """Begin all least, greatest and integrals at the first node."""
    observe(x, normals)
    for i in range(NODAL * LANES):
        x[FIRST + i] = x[LEAST + i] = x[MOST + i] = x[NOW + i]
    for i in range(NODAL * LANES, QUANTITIES * LANES):
        x[FIRST + i], x[LEAST + i], x[MOST + i] = NAN, INFINITE, -INFINITE
    for i in range(QUANTITIES * LANES):
        put(x, INTEGRAL, i, 0.0)


@kernel
def write(x, order, attitudes, velocities, k, first, last):
    """Write the states: quaternions of the body, scalar last, and W in body components; NaN where a run has failed.

    Of the two quaternions of an attitude the one that is nearer to the state stored before.
    """
    for number in range(first, last):
        l, i = number - first, order[number]
        if get(x, GONE, l) != 0.0:
            for j in range(4):
                attitudes[i, k, j] = NAN
            for j in range(3):
                velocities[i, k, j] = NAN
            continue
        b = quaternion_at(x, FRAME, l)
        p = product(quaternion_at(x, P, l), (b[0], -b[1], -b[2], -b[3]))
        before = attitudes[i, k - 1, 0] * p[1] + attitudes[i, k - 1, 1] * p[2] + attitudes[i, k - 1, 2] * p[3]
        sign = 1.0 if before + attitudes[i, k - 1, 3] * p[0] >= 0.0 else -1.0
        attitudes[i, k, 0], attitudes[i, k, 1], attitudes[i, k, 2] = sign * p[1], sign * p[2], sign * p[3]
        attitudes[i, k, 3] = sign * p[0]
        velocities[i, k, 0], velocities[i, k, 1], velocities[i, k, 2] = times(matrix_at(x, BASIS, l), vector(x, W, l))


@kernel
def write_normals(x, order, normals, k, first, last):
    """Write N of the body; NaN where a run has failed."""
    for number in range(first, last):
        l, i = number - first, order[number]
        B, N, gone = matrix_at(x, BASIS, l), normal_at(x, l), get(x, GONE, l) != 0.0
        M = of_body(B, N)
        M = of_body(B, (column(M, 0), column(M, 1), column(M, 2)))
        for j in range(3):
            for c in range(3):
                normals[i, k, j, c] = NAN if gone else M[j][c]


@kernel
def give_up(x, normals, order, failures, step, h, hs, first, last):
    """Note why lanes cannot go on, and let them rest: the open ones before they advance, the bad ones after it."""
    for l in range(LANES):
        stalled = get(x, OPEN, l) != 0.0
        if get(x, GONE, l) != 0.0 or not (stalled or get(x, BAD, l) != 0.0):
            continue
        status, residual, turn = BROKEN, NAN, NAN
        if stalled:
            w = vector(x, W, l)
            status, residual, turn = STALLED, left_over(x, l, normals, 0.5 * hs), h * sqrt(dot(w, w))
        elif 4.0 * get(x, INCREMENT, l) > PI * PI:
            status, residual, turn = TURN, 0.0, abs(h / hs) * 2.0 * sqrt(get(x, INCREMENT, l))
        if first + l < last:
            i = order[first + l]
            failures[i, 0], failures[i, 1], failures[i, 2], failures[i, 3] = status, step, residual, turn
        put(x, GONE, l, status)
        for k in range(DIRECTOR_STATE):
            x[P + LANES * k + l] = 1.0 if k == 0 else 0.0
        put_vector(x, Y, l, (0.0, 0.0, 0.0))
        x[OPEN + l] = x[BAD + l] = 0.0


@inlined
def left_over(x, l, normals, f):
    """Return the size of what is left of the equations in a lane, N m s."""
    w, y, M, more, F = vector(x, W, l), vector(x, Y, l), vector(x, MOVING, l), more_at(x, l), matrix_at(x, FORCES, l)
    k = vector(x, K, l)
    held = k[2] == 0.0
    if normals is not None:
        E, trace = euler_at(x, l)
        r = left(f, w, y, normal_at(x, l), E, trace, M, more, F, held)
    else:
        r = axpy(-1.0, y, right(f, body_at(x, l), add(w, y), M, more, F))
        r = (2.0 * r[0] / k[0], 2.0 * r[1] / k[1], 0.0 if held else 2.0 * r[2] / k[2])
    return abs(r[0]) + abs(r[1]) + (0.0 if held else abs(r[2]))


@kernel
def enter(quaternions, velocities, normals, bodies, fixed, state):
    """Set the states, in b, from the first of those stored: quaternions scalar last, W and N in body components.

    Round-off of N, and of W along a constrained axis, is taken away; for lie-midpoint all of the latter.
    """
    for i in range(state.shape[0]):
        b = i if bodies.shape[0] > 1 else 0
        q = (float(bodies[b, 20]), float(bodies[b, 21]), float(bodies[b, 22]), float(bodies[b, 23]))
        p = (quaternions[i, 0, 3], quaternions[i, 0, 0], quaternions[i, 0, 1], quaternions[i, 0, 2])
        state[i, 0], state[i, 1], state[i, 2], state[i, 3] = product(p, q)
        largest = 0.0
        for k in range(3):
            state[i, 4 + k] = 0.0
            for j in range(3):
                state[i, 4 + k] += bodies[b, 11 + 3 * j + k] * velocities[i, 0, j]
            largest = max(largest, abs(state[i, 4 + k]))
        if fixed and (normals is None or abs(state[i, 6]) <= 16.0 * EPS * largest):
            state[i, 6] = 0.0
        for k in range(7, state.shape[1]):
            state[i, k] = 0.0
        if normals is not None:
            for place in range(6):
                k, m = (place, place) if place < 3 else ((1, 2) if place == 3 else (0, 2) if place == 4 else (0, 1))
                total = 0.0
                for j in range(3):
                    for c in range(3):
                        total += bodies[b, 11 + 3 * j + k] * normals[i, 0, j, c] * bodies[b, 11 + 3 * c + m]
                state[i, 10 + place] = total if abs(total) > 16.0 * EPS * largest else 0.0


@kernel
def march(members, bodies, carried, out, normals, grid, loads, kind, begin, end):
    """March the members from number `begin` to `end` of an order over the nodes of `grid`, 16 at a time.

    ``members = (order, scales)``, scales (m or 1,); bodies (m or 1, BODY); ``carried = (state, sums, failures)``, state
    (m, STATE), sums (m, SUMS) where quantities are watched, else (0, SUMS), failures (m, 4): status, step, residual,
    turn; ``out = (attitudes, velocities)``, (m, k, 4) and (m, k, 3) at the steps `stored`; `normals` (m, k, 3, 3) for
    the director scheme, None for lie-midpoint; ``grid = (step, fractions, stored, first step, steps, stored so far)``;
    ``loads = (moving, space)``, (nodes, 3) each or (0, 3); `kind`: STEADY,
    MOVED, PUSHED or HEAVY, of the director scheme STEADY (no load), PUSHED or HEAVY.
    """
    (order, scales), (state, sums, failures), (moving, space) = members, carried, loads
    h, fractions, stored, first_step, steps, done = grid
    attitudes, velocities = out
    stages, watched = fractions.shape[0], sums.shape[0] > 0
    x = np.zeros(ROWS)
    for first in range(begin, end, LANES):
        last, node, k = min(first + LANES, end), 0, done
        gather(x, order, state, bodies, scales, sums, failures, first, last)
        if watched:
            if first_step == 0:
                start_watching(x, normals)
            else:
                observe(x, normals)
        for step in range(first_step, first_step + steps):
            for stage in range(stages):
                part = fractions[stage]
                hs = h * part
                if moving.shape[0] > 0:
                    turn_moment(x, moving[node, 0], moving[node, 1], moving[node, 2])
                if space.shape[0] > 0:
                    turn_space(x, space[node, 0], space[node, 1], space[node, 2])
                if kind == HEAVY:
                    turn_dead(x)
                if normals is not None:
                    if kind == STEADY:
                        solve_directors(x, hs)
                    else:
                        solve_loaded_directors(x, hs)
                elif kind == HEAVY:
                    solve_heavy(x, hs)
                elif kind == PUSHED:
                    solve_pushed(x, hs)
                elif kind == MOVED:
                    solve(x, hs)
                if (normals is not None or kind != STEADY) and any_of(x, OPEN):
                    for _ in range(ITERATIONS):
                        if normals is not None:
                            newton_directors(x, hs)
                        else:
                            newton(x, hs)
                        if not any_of(x, OPEN):
                            break
                    if any_of(x, OPEN):
                        give_up(x, normals, order, failures, step, h, hs, first, last)
                if watched:
                    integrate(x, 0.5 * hs)
                if normals is not None:
                    if watched:
                        pull_directors(x, hs, part)
                    advance_directors(x, hs)
                else:
                    if watched:
                        pull(x, hs, part)
                    advance(x, hs)
                if any_of(x, BAD):
                    give_up(x, normals, order, failures, step, h, hs, first, last)
                if watched:
                    observe(x, normals)
                    integrate(x, 0.5 * hs)
                node += 1
            if watched:
                widen(x, h)
            if step + 1 == stored[k + 1]:
                k += 1
                write(x, order, attitudes, velocities, k, first, last)
                if normals is not None:
                    write_normals(x, order, normals, k, first, last)
        scatter(x, order, state, sums, first, last)
