"""Newton's iteration for the stages of one body, where fixed points do not contract: large turns, drag, stiffness.

The unknowns are the increments ``L_i = h b_i f(P_i, g_i)`` of the momentum. The vectors g of the stages, which stand
still in space, follow from the velocities by one linear system of 3s equations,

    g_i - Σ a_ij g_j × W_j = g_0,        a_ij = μ_ij h b_j,

and so do, with the same matrix, the turns θ_i of the body that changes of the velocities make, g_0 = Σ a_ij δW_j. With
B = ∂f/∂P and H = ∂f/∂θ, where a vector of space v changes by v × θ, an increment solves

    δP_i - Σ a_ij (B_j δP_j + H_j θ_j) = Σ μ_ij ρ_j,        δL_i = ρ_i + h b_i (B_i δP_i + H_i θ_i),

ρ the residuals of L. L and not P is the unknown since P = P_n + Σ μ L then has L to its last digits, however large h B
is. Vectors of the stages change by v × θ only to the order of the collocation. So without them the iteration converges
quadratically, with them linearly, by some percent a step at low orders and by next to nothing at high ones. All is done
for the body in one lane, by the same code whether it has neighbours or not.

The iteration ends where changes of the velocities are round-off, or what is left of the equations is. Moments that
cancel, of springs at an equilibrium, have the round-off ε |H| of a turn by ε: a residual of ``ε h b_i |H|`` cannot be
made smaller, however slow the body is.
"""

from ..engine.called import DIFFERENCE
from ..engine.lane import at, frame_at
from ..engine.layout import BLOCK, BODY, STATE, WORK
from ..engine.march import gyrating
from ..engine.solving import ROUND_OFF
from ..geometry.compiled import inlined, shared
from ..geometry.elements import doubles, shifted
from ..geometry.tuples import (
    EPS,
    NAN,
    add,
    add_unit,
    attitude,
    axpy,
    column,
    cross,
    each,
    minus,
    scaled,
    size,
    times,
    transposed,
    transposed_times,
    unit,
)
from .gauss_layout import ROOM, STAGES, TABLE, WIDTH
from .gauss_stages import INFINITE, LOST, TINY, drawn, moments_at, node_of, turning

FREE, HEAVY, ANY = range(3)  # bodies without a vector g, with the vertical, with all three
ITERATIONS, SMALL, NEAR = 50, 1e5, 4.0


@inlined
def stage_at(y, c, i, n, l):
    """Return the vector of components c, c + 1, c + 2 of one body at stage i."""
    return (y[(c * WIDTH + i) * n + l], y[((c + 1) * WIDTH + i) * n + l], y[((c + 2) * WIDTH + i) * n + l])


@inlined
def put_stage(y, c, i, n, l, v):
    """Set the components c, c + 1, c + 2 of one body at stage i."""
    y[(c * WIDTH + i) * n + l], y[((c + 1) * WIDTH + i) * n + l], y[((c + 2) * WIDTH + i) * n + l] = v


@inlined
def put_columns(a, width, row, col, f, c0, c1, c2):
    """Add f times the matrix with these columns to the entries of `a` from a row and a column on."""
    for j, c in enumerate((c0, c1, c2)):
        a[row * width + col + j] += f * c[0]
        a[(row + 1) * width + col + j] += f * c[1]
        a[(row + 2) * width + col + j] += f * c[2]


@shared
def eliminated(a, m, width):
    """Replace the columns after the m-th of m rows by the solutions, for each as right-hand side; partial pivots."""
    for k in range(m):
        pivot = k
        for i in range(k + 1, m):
            if abs(a[i * width + k]) > abs(a[pivot * width + k]):
                pivot = i
        if pivot != k:
            for j in range(k, width):
                a[k * width + j], a[pivot * width + j] = a[pivot * width + j], a[k * width + j]
        f = 1.0 / a[k * width + k]
        for i in range(k + 1, m):
            g = f * a[i * width + k]
            if g != 0.0:
                for j in range(k + 1, width):
                    a[i * width + j] -= g * a[k * width + j]
    for k in range(m - 1, -1, -1):
        f = 1.0 / a[k * width + k]
        for j in range(m, width):
            a[k * width + j] *= f
        for i in range(k):
            g = a[i * width + k]
            if g != 0.0:
                for j in range(m, width):
                    a[i * width + j] -= g * a[k * width + j]


@shared
def set_turns(a, y, at_velocity, table, s, h, n, l, width):
    """Set the matrix of the system for vectors that turn with the velocities there, its right-hand sides to zero."""
    for i in range(3 * s * width):
        a[i] = 0.0
    for i in range(s):
        for c in range(3):
            a[(3 * i + c) * width + 3 * i + c] = 1.0
        for j in range(s):
            f = -h * table[TABLE.weights + j] * table[TABLE.mu + WIDTH * j + i]
            (u, v, w), o = stage_at(y, at_velocity, j, n, l), 0.0
            put_columns(a, width, 3 * i, 3 * j, f, (o, -w, v), (w, o, -u), (-v, u, o))


@shared
def rows_by_elimination(b, y, n, l):
    """Set the increments of the rows of a turn by the velocities of the stages."""
    table, s, h = doubles(b[BLOCK.table]), b[BLOCK.gauss], doubles(b[BLOCK.step])[0]
    a, m = shifted(y, STAGES.size * WIDTH * n), 3 * s
    set_turns(a, y, STAGES.W, table, s, h, n, l, m + 3)
    for i in range(m):
        a[i * (m + 3) + m + i % 3] = 1.0
    eliminated(a, m, m + 3)
    for i in range(s):
        for r in range(3):
            g, at_row = m + r, 3 * i * (m + 3)
            row = (a[at_row + g], a[at_row + m + 3 + g], a[at_row + 2 * (m + 3) + g])
            b_i = h * table[TABLE.weights + i]
            put_stage(y, STAGES.turning + 3 * r, i, n, l, scaled(b_i, cross(row, stage_at(y, STAGES.W, i, n, l))))


@inlined
def rows_of(y, i, n, l):
    """Return the rows of one body at stage i."""
    c = STAGES.rows
    return (stage_at(y, c, i, n, l), stage_at(y, c + 3, i, n, l), stage_at(y, c + 6, i, n, l))


@inlined
def changed(C, j, e):
    """Return the rows C after a turn of the body by e about its axis j."""
    axis = unit(j)
    return (
        axpy(e, cross(C[0], axis), C[0]),
        axpy(e, cross(C[1], axis), C[1]),
        axpy(e, cross(C[2], axis), C[2]),
    )


@inlined
def derivatives_of(call, R, C, k, W, f, held):
    """Return the derivatives by P and by turns, as columns, of the moments f and `held` as they act on the body."""
    e = DIFFERENCE * size(W)
    e = e if e > 0.0 else DIFFERENCE
    S, T = (f, f, f), (f, f, f)
    for j in range(3):
        df = scaled(k[j] / e, minus(moments_at(call, R, C, add_unit(j, e, W))[0], f))
        g, there = moments_at(call, R, changed(C, j, DIFFERENCE), W)
        dg, dh = scaled(1.0 / DIFFERENCE, minus(g, f)), scaled(1.0 / DIFFERENCE, minus(there, held))
        S, T = (S[1], S[2], drawn(C, df)), (T[1], T[2], add(drawn(C, dg), dh))
    return S, T


@inlined
def slope(j, k, off, Q, W, D):
    """Return the derivative by P_j of the torque of gyration and drag."""
    e = unit(j)
    g = axpy(k[j], cross((Q[0], Q[1], Q[2] + off[0] * W[0] + off[1] * W[1]), e), cross(e, W))
    if j < 2:
        g = axpy(k[j] * off[j], cross((0.0, 0.0, 1.0), W), g)
    return axpy(-k[j], column(D, j), g)


@inlined
def product_at(a, v):
    """Return the product of the matrix of 9 entries at a pointer and a vector."""
    return (
        a[0] * v[0] + a[1] * v[1] + a[2] * v[2],
        a[3] * v[0] + a[4] * v[1] + a[5] * v[2],
        a[6] * v[0] + a[7] * v[1] + a[8] * v[2],
    )


@inlined
def set_velocities(y, table, s, P, k, n, l):
    """Set momenta and velocities of the stages from their increments."""
    for i in range(s):
        Q = P
        for j in range(s):
            Q = axpy(table[TABLE.mu + WIDTH * j + i], stage_at(y, 0, j, n, l), Q)
        put_stage(y, STAGES.P, i, n, l, Q)
        put_stage(y, STAGES.W, i, n, l, each(k, Q))


@inlined
def set_sides(a, table, s, h, k, kind, g0, width):
    """Set the right-hand sides of the system for vectors of space: changes of each momentum, and g_0."""
    m = 3 * s
    for i in range(s):
        for j in range(s):
            f = h * table[TABLE.weights + j] * table[TABLE.mu + WIDTH * j + i]
            for c in range(3):
                a[(3 * i + c) * width + m + 3 * j + c] = f * k[c]
        for c in range(3):
            if kind == HEAVY:
                a[(3 * i + c) * width + 2 * m] = g0[0] if c == 0 else g0[1] if c == 1 else g0[2]
            else:
                a[(3 * i + c) * width + 2 * m + c] = 1.0


@shared
def place_vectors(y, a, table, s, h, P, k, kind, g0, call, n, l):
    """Set the velocities of the stages from L, the vectors of space with them, and the turns by changes of momenta."""
    set_velocities(y, table, s, P, k, n, l)
    m, vectors = 3 * s, kind if kind < ANY else 3
    if vectors > 0:
        width, at_velocity = 2 * m + vectors, STAGES.V if kind == ANY else STAGES.W
        if kind == ANY:
            for i in range(s):
                put_stage(y, STAGES.V, i, n, l, turning(rows_of(y, i, n, l), stage_at(y, STAGES.W, i, n, l), call))
        set_turns(a, y, at_velocity, table, s, h, n, l, width)
        set_sides(a, table, s, h, k, kind, g0, width)
        eliminated(a, m, width)
        for i in range(s):
            for r in range(vectors):
                g = 3 * i * width + 2 * m + r
                C = (a[g], a[g + width], a[g + 2 * width])
                put_stage(y, STAGES.rows + 3 * r, i, n, l, C)
                b_i = h * table[TABLE.weights + i]
                put_stage(y, 3 + 3 * r, i, n, l, scaled(b_i, cross(C, stage_at(y, at_velocity, i, n, l))))


@inlined
def set_momenta(momenta, a, Bs, Hs, rest, table, s, h, vectors, width):
    """Set the equations for the changes of P at the stages."""
    m = 3 * s
    for i in range(m * (m + 1)):
        momenta[i] = 0.0
    for i in range(s):
        for c in range(3):
            momenta[(3 * i + c) * (m + 1) + 3 * i + c] = 1.0
        for j in range(s):
            mu = table[TABLE.mu + WIDTH * j + i]
            f = -h * table[TABLE.weights + j] * mu
            for c in range(3):
                row = (3 * i + c) * (m + 1)
                momenta[row + m] += mu * rest[3 * j + c]
                for d in range(3):
                    momenta[row + 3 * j + d] += f * Bs[9 * j + 3 * c + d]
                if vectors > 0:
                    for d in range(3):
                        g = f * Hs[9 * j + 3 * c + d]
                        for col in range(m):
                            momenta[row + col] += g * a[(3 * j + d) * width + m + col]


@inlined
def corrected(y, momenta, a, Bs, Hs, rest, table, s, h, k, P, n, l, vectors, width):
    """Add to L what the changes of P make; return the largest change of a velocity or turn, infinite if one is lost.

    And the largest residual, relative to the velocity and what a turn by one radian would add to it.
    """
    m, worst, residual = 3 * s, 0.0, 0.0
    for i in range(s):
        b_i, turn, row = h * table[TABLE.weights + i], (0.0, 0.0, 0.0), 3 * i * (m + 1) + m
        dP = (momenta[row], momenta[row + m + 1], momenta[row + 2 * (m + 1)])
        if vectors > 0:
            for j in range(m):
                d = momenta[j * (m + 1) + m]
                turn = (
                    turn[0] + a[3 * i * width + m + j] * d,
                    turn[1] + a[(3 * i + 1) * width + m + j] * d,
                    turn[2] + a[(3 * i + 2) * width + m + j] * d,
                )
        B, H = shifted(Bs, 9 * i), shifted(Hs, 9 * i)
        dL = add(
            (rest[3 * i], rest[3 * i + 1], rest[3 * i + 2]),
            scaled(b_i, add(product_at(B, dP), product_at(H, turn))),
        )
        put_stage(y, 0, i, n, l, add(stage_at(y, 0, i, n, l), dL))
        change = size(each(k, dP))
        speed = size(each(k, P)) + size(stage_at(y, STAGES.W, i, n, l)) + change + TINY  # the last one from rest
        worst = max(worst, change / speed, size(turn))
        stiff = b_i * (size((H[0], H[1], H[2])) + size((H[3], H[4], H[5])) + size((H[6], H[7], H[8])))
        left = size(each(k, (rest[3 * i], rest[3 * i + 1], rest[3 * i + 2])))
        residual = max(residual, left / (speed + stiff * max(k[0], k[1], k[2])))
        if not size(dL) <= LOST:
            return INFINITE, INFINITE
    return worst, residual


@inlined
def failed(y, s, n, l, count, residual):
    """Clear the increments of a body that is given up; return what `newton` does."""
    for c in range(12):
        for i in range(s):
            y[(c * WIDTH + i) * n + l] = 0.0
    return False, count, residual


@shared
def newton(b, x, y, n, l, node, kind):
    """Solve the stages of the body in the lane l, from the state in the workspace x and the increments of P there are.

    Return success, iterations, residual.
    """
    table, s, h, rate = doubles(b[BLOCK.table]), b[BLOCK.gauss], doubles(b[BLOCK.step])[0], doubles(b[BLOCK.step])[1]
    a = shifted(y, STAGES.size * WIDTH * n)
    momenta, rest = shifted(a, ROOM.momenta), shifted(a, ROOM.rest)
    Bs, Hs, m = shifted(a, ROOM.B), shifted(a, ROOM.H), 3 * s
    place = WORK.body + BODY.damping
    D = (at(x, place, n, l), at(x, place + 3, n, l), at(x, place + 6, n, l))
    k, off = at(x, WORK.body + BODY.k, n, l), at(x, WORK.body + BODY.off, n, l)
    free, P, q = x[(WORK.body + BODY.free) * n + l], at(x, WORK.state + STATE.s, n, l), at(x, WORK.state + 1, n, l)
    R = attitude((x[WORK.state * n + l], q[0], q[1], q[2]))
    place = WORK.body + BODY.dead
    dead = (at(x, place, n, l), at(x, place + 3, n, l), at(x, place + 6, n, l))
    e, vectors = at(x, WORK.body + BODY.vertical, n, l), kind if kind < ANY else 3
    weight, g0 = times(dead, e), transposed_times(R, e)
    K = transposed((transposed_times(R, dead[0]), transposed_times(R, dead[1]), transposed_times(R, dead[2])))
    basis, function, times_ = frame_at(x, n, l), b[BLOCK.function], doubles(b[BLOCK.times])
    acting = (function, b[BLOCK.generalised], b[BLOCK.terms], b[BLOCK.action], b[BLOCK.workspace] + 8 * WORK.buffer * n)
    room = (shifted(a, ROOM.call), shifted(x, WORK.buffer * n), basis, rate, x[WORK.scale * n + l], acting)
    calls, orbit, o = function + b[BLOCK.generalised], 0.0, (0.0, 0.0, 0.0)
    if b[BLOCK.orbit] != 0:
        about = doubles(b[BLOCK.orbit])
        orbit, o = about[0], transposed_times(R, (about[1], about[2], about[3]))
    call = (calls, node, times_, room, b[BLOCK.forces], (orbit, o, table, h / rate), b[BLOCK.rotor] != 0)
    width = 2 * m + vectors
    if kind == ANY:
        for i in range(s):
            put_stage(y, STAGES.rows, i, n, l, (1.0, 0.0, 0.0))
            put_stage(y, STAGES.rows + 3, i, n, l, (0.0, 1.0, 0.0))
            put_stage(y, STAGES.rows + 6, i, n, l, (0.0, 0.0, 1.0))
    if calls != 0:
        for i in range(s):
            if not size(stage_at(y, STAGES.called, i, n, l)) <= LOST:
                x[WORK.call * n + l] = NAN
                return failed(y, s, n, l, 0, NAN)
    before, worst, rough = LOST, NAN, SMALL + h * size(P) * max(k[0], k[1], k[2])
    for count in range(1, ITERATIONS + 1):
        place_vectors(y, a, table, s, h, P, k, kind, g0, call, n, l)
        for i in range(s):
            b_i = h * table[TABLE.weights + i]
            Q, W = stage_at(y, STAGES.P, i, n, l), stage_at(y, STAGES.W, i, n, l)
            torque = cross((Q[0], Q[1], Q[2] + off[0] * W[0] + off[1] * W[1]), W)
            C_d = gyrating(D, stage_at(y, STAGES.rotor, i, n, l)) if b[BLOCK.rotor] != 0 else D
            torque = add(torque, axpy(-1.0, times(C_d, W), stage_at(y, STAGES.moving, i, n, l)))
            B0, B1, B2 = slope(0, k, off, Q, W, C_d), slope(1, k, off, Q, W, C_d), slope(2, k, off, Q, W, C_d)
            H0 = H1 = H2 = (0.0, 0.0, 0.0)
            for r in range(vectors):
                C, force = stage_at(y, STAGES.rows + 3 * r, i, n, l), weight
                if kind == ANY:
                    force = K[0] if r == 0 else K[1] if r == 1 else K[2]
                torque = add(torque, cross(force, C))
                H0 = add(H0, cross(force, cross(C, (1.0, 0.0, 0.0))))
                H1 = add(H1, cross(force, cross(C, (0.0, 1.0, 0.0))))
                H2 = add(H2, cross(force, cross(C, (0.0, 0.0, 1.0))))
            if kind == ANY:
                C = rows_of(y, i, n, l)
                push = stage_at(y, STAGES.space, i, n, l)
                if calls != 0:
                    if not size(W) + size(C[0]) + size(C[1]) + size(C[2]) <= LOST:
                        return failed(y, s, n, l, count, worst)
                    here = node_of(call, i)
                    f, held = moments_at(here, R, C, W)
                    if not size(f) + size(held) <= LOST:
                        x[WORK.call * n + l] = NAN
                        return failed(y, s, n, l, count, worst)
                    put_stage(y, STAGES.called, i, n, l, f)
                    put_stage(y, STAGES.held, i, n, l, held)
                    torque, push = add(torque, held), add(push, f)
                    S, T = derivatives_of(here, R, C, k, W, f, held)
                    B0, B1, B2 = add(B0, S[0]), add(B1, S[1]), add(B2, S[2])
                    H0, H1, H2 = add(H0, T[0]), add(H1, T[1]), add(H2, T[2])
                push = drawn(C, push)
                torque = add(torque, push)
                H0 = add(H0, cross(push, (1.0, 0.0, 0.0)))
                H1 = add(H1, cross(push, (0.0, 1.0, 0.0)))
                H2 = add(H2, cross(push, (0.0, 0.0, 1.0)))
            for j in range(9):
                Bs[9 * i + j] = Hs[9 * i + j] = 0.0
            moving = (1.0, 1.0, free)
            put_columns(Bs, 3, 3 * i, 0, 1.0, each(moving, B0), each(moving, B1), each(moving, B2))
            put_columns(Hs, 3, 3 * i, 0, 1.0, each(moving, H0), each(moving, H1), each(moving, H2))
            L = stage_at(y, 0, i, n, l)
            rest[3 * i], rest[3 * i + 1] = b_i * torque[0] - L[0], b_i * torque[1] - L[1]
            lift = y[(STAGES.lift * WIDTH + i) * n + l] if kind == ANY else -0.0
            rest[3 * i + 2] = (free * (b_i * torque[2]) + lift) - L[2]
        set_momenta(momenta, a, Bs, Hs, rest, table, s, h, vectors, width)
        eliminated(momenta, m, m + 1)
        worst, left = corrected(y, momenta, a, Bs, Hs, rest, table, s, h, k, P, n, l, vectors, width)
        now = worst / EPS
        if not now <= LOST:
            return failed(y, s, n, l, count, worst)
        if now <= NEAR or left <= ROUND_OFF or (now <= rough and now >= before):
            if now > NEAR:  # the last change is round-off of velocities, but more than the rows may be off
                place_vectors(y, a, table, s, h, P, k, kind, g0, call, n, l)
            return True, count, worst
        before = now
    return failed(y, s, n, l, ITERATIONS, worst)
