"""The stages of a linearised step of collocation: solved again, and the equations of their changes (`gauss_linear`)."""

from ..engine.elimination import eliminated
from ..engine.lane import matrix, put_vector, vector
from ..engine.linear import CALLED, LINEAR, applied, tall
from ..geometry.compiled import inlined, shared
from ..geometry.elements import (
    any_of,
    both,
    doubles,
    either,
    lanes,
    load,
    select,
    splat,
    store,
)
from ..geometry.tuples import (
    EPS,
    add,
    axpy,
    cross,
    dot,
    larger,
    minus,
    scaled,
    size,
    times,
    unit,
)
from .gauss_coefficients import TABLE, WIDTH
from .gauss_linear_torques import (
    AT,
    TINY,
    VERTICAL,
    are_coupled,
    columns_at,
    pulled,
    put_columns,
    rows_changed,
    torque_at,
)

ENOUGH, STALLED, ITERATIONS, CORRECTIONS = 8.0 * EPS, 1e-10, 60, 20
LEVELLED = 1e-5  # of accelerations that level each other out: their round-off, over `STALLED`


@shared
def iterated(b, x, table, s, J, S, D, n0, one, loaded):
    """Iterate the stages by fixed points from a guess, as far as they contract, with the rows that the torque needs."""
    n, h, W0, zero = lanes(one), load(x, AT.h * lanes(one), one), vector(x, AT.W0, one), splat(0.0, one)
    lift, (e0, e1, e2) = load(x, AT.lift * n, one) / h, (tall(unit(0), one), tall(unit(1), one), tall(unit(2), one))
    K, pull = scaled(1.0 / h, minus(vector(x, AT.W1, one), W0)), e0
    mean, rows, o = scaled(0.5, add(W0, vector(x, AT.W1, one))), 0, (zero, zero, zero)
    if loaded is not None and are_coupled(b) != 0:
        rows = 3
        if b[LINEAR.turn] == VERTICAL:  # the forces are a pull along one direction: it is the row, the pull its factor
            rows, (pull, e0) = 1, pulled(b, x, one)
    for j in range(s):
        put_vector(x, AT.K + 3 * j, K)
        put_columns(x, AT.D + 9 * j, cross(e0, mean), cross(e1, mean), cross(e2, mean))
    before = zero + 1e300
    for _ in range(ITERATIONS if s > 1 else 1):  # of one stage the states at both ends tell the velocity
        now = zero
        for i in range(s):
            W, c0, c1, c2 = o, o, o, o
            for j in range(s):
                a = table[TABLE.a + WIDTH * j + i]
                W = axpy(a, vector(x, AT.K + 3 * j, one), W)
                if rows > 0:
                    c0 = axpy(a, vector(x, AT.D + 9 * j, one), c0)
                if rows > 1:
                    c1 = axpy(a, vector(x, AT.D + 9 * j + 3, one), c1)
                    c2 = axpy(a, vector(x, AT.D + 9 * j + 6, one), c2)
            W, c0, c1, c2 = axpy(h, W, W0), axpy(h, c0, e0), axpy(h, c1, e1), axpy(h, c2, e2)
            put_vector(x, AT.W + 3 * i, W)
            if rows == 1:
                g = add(cross(times(J, W), W), cross(pull, c0))
            else:
                g = torque_at(b, x, i, W, (c0, c1, c2), J, D, one, loaded)
            K = axpy(lift, n0, times(S, g))
            change = size(minus(K, vector(x, AT.K + 3 * i, one))) / (size(W) + abs(h) * size(K) + TINY)
            put_vector(x, AT.K_next + 3 * i, K)
            if rows > 0:
                V0 = cross(c0, W)
                turn = size(minus(V0, vector(x, AT.D + 9 * i, one)))
                put_vector(x, AT.D_next + 9 * i, V0)
                if rows > 1:
                    V1, V2 = cross(c1, W), cross(c2, W)
                    turn = turn + size(minus(V1, vector(x, AT.D + 9 * i + 3, one)))
                    turn = turn + size(minus(V2, vector(x, AT.D + 9 * i + 6, one)))
                    put_vector(x, AT.D_next + 9 * i + 3, V1)
                    put_vector(x, AT.D_next + 9 * i + 6, V2)
                change = larger(change, turn)
            now = larger(now, abs(h) * change)
        for k in range(3 * s):
            store(x, (AT.K + k) * n, load(x, (AT.K_next + k) * n, one))
        for j in range(s if rows > 0 else 0):
            for k in range(3 * rows):
                store(x, (AT.D + 9 * j + k) * n, load(x, (AT.D_next + 9 * j + k) * n, one))
        done = either(now <= EPS, both(now <= 1e-12, now >= before))
        if not any_of(1.0 - select(done, zero + 1.0, zero) > 0.5) or any_of(now > 1e6):
            break
        before = now


@shared
def set_rows(x, table, s, crosses, one):
    """Find the rows of the stages by their velocities, and U where it is asked for (`crosses`)."""
    n, h, m, zero = lanes(one), load(x, AT.h * lanes(one), one), 3 * s, splat(0.0, one)
    width = m + 3 + (m if crosses != 0 else 0)
    for i in range(s):
        W = scaled(h, vector(x, AT.W + 3 * i, one))
        for c in range(3):
            v = cross(W, unit(c))
            for j in range(s):
                a = table[TABLE.inverse + WIDTH * j + i]
                for r in range(3):
                    own = zero + (a if r == c else 0.0)
                    store(x, (AT.a + (3 * i + r) * width + 3 * j + c) * n, own + v[r] if i == j else own)
            for r in range(3):
                row = AT.a + (3 * i + r) * width + m
                store(x, (row + c) * n, zero + (table[TABLE.sums + i] if r == c else 0.0))
                for j in range(s if crosses != 0 else 0):
                    store(x, (row + 3 + 3 * j + c) * n, zero + (1.0 if i == j and r == c else 0.0))
    eliminated(x, AT.a, m, width, one)
    for i in range(s):
        for r in range(3):
            row = AT.a + (3 * i + r) * width + m
            for c in range(3):
                store(x, (AT.C + 9 * i + 3 * c + r) * n, load(x, (row + c) * n, one))
                for j in range(s if crosses != 0 else 0):
                    u = h * load(x, (row + 3 + 3 * j + c) * n, one)
                    store(x, (AT.U + 9 * (i * WIDTH + j) + 3 * c + r) * n, u)


@shared
def set_slopes(b, x, s, J, S, D, one, loaded):
    """Set S times the derivatives of the torques by the velocities of the stages, by columns."""
    crosses, F = are_coupled(b), matrix(x, AT.dead, one)
    for j in range(s):
        W = vector(x, AT.W + 3 * j, one)
        Q = times(J, W)
        for c in range(3):
            e = tall(unit(c), one)
            q = add(cross(times(J, e), W), cross(Q, e))
            if loaded is not None:
                q = add(minus(q, times(D, e)), cross(vector(x, AT.rotor + 3 * j, one), e))
                if b[LINEAR.called] != 0:
                    q = add(q, vector(x, AT.called + CALLED.size * j + CALLED.velocity + 3 * c, one))
            put_vector(x, AT.slope + 9 * (j * WIDTH + j) + 3 * c, times(S, q))
    if loaded is not None and crosses != 0:
        (pull, g), e0, e1, e2 = pulled(b, x, one), tall(unit(0), one), tall(unit(1), one), tall(unit(2), one)
        Q = (times(S, cross(pull, e0)), times(S, cross(pull, e1)), times(S, cross(pull, e2)))
        for l in range(s):
            C = columns_at(x, AT.C + 9 * l, one)
            g_l = applied(C, g)
            for j in range(s):
                U, place = columns_at(x, AT.U + 9 * (j * WIDTH + l), one), AT.slope + 9 * (j * WIDTH + l)
                if b[LINEAR.turn] == VERTICAL:  # of U (γ × e_c)
                    q0 = applied(Q, axpy(g_l[2], U[1], scaled(-g_l[1], U[2])))
                    q1 = applied(Q, axpy(g_l[0], U[2], scaled(-g_l[2], U[0])))
                    q2 = applied(Q, axpy(g_l[1], U[0], scaled(-g_l[0], U[1])))
                else:
                    q0, q1, q2 = (
                        times(S, rows_bent(b, x, j, F, C, U, e0, one)),
                        times(S, rows_bent(b, x, j, F, C, U, e1, one)),
                        times(S, rows_bent(b, x, j, F, C, U, e2, one)),
                    )
                if j == l:
                    own = columns_at(x, place, one)
                    q0, q1, q2 = add(q0, own[0]), add(q1, own[1]), add(q2, own[2])
                put_columns(x, place, q0, q1, q2)


@shared
def rows_bent(b, x, j, F, C, U, e, one):
    """Return what the change e of a velocity does to the torque at the stage j by the rows."""
    return rows_changed(
        b, x, j, F, one, applied(U, cross(C[0], e)), applied(U, cross(C[1], e)), applied(U, cross(C[2], e))
    )


@shared
def set_system(x, table, s, crosses, extra, flips, one):
    """Set the matrix of the changes of the velocities, with room for right-hand sides.

    `crosses`: 0 where the torque at a stage depends on its own velocity alone; `flips`: the transposed matrix.
    """
    n, h, m = lanes(one), load(x, AT.h * lanes(one), one), 3 * s
    width, zero = m + extra, splat(0.0, one)
    for i in range(s):
        for l in range(s):
            a = table[TABLE.inverse + WIDTH * l + i]
            for c in range(3):
                v = (zero, zero, zero)
                if crosses != 0 or i == l:
                    v = scaled(-h, vector(x, AT.slope + 9 * (i * WIDTH + l) + 3 * c, one))
                for r in range(3):
                    row, col = 3 * i + r, 3 * l + c
                    if flips:
                        row, col = col, row
                    store(x, (AT.a + row * width + col) * n, v[r] + (a if r == c else 0.0))


@inlined
def strength(b, x, i, S, one):
    """Return the size of the accelerations that may level each other out at the stage i."""
    F, zero = matrix(x, AT.dead, one), splat(0.0, one)
    torque = size(F[0]) + size(F[1]) + size(F[2]) + size(vector(x, AT.moving + 3 * i, one))
    torque = torque + size(vector(x, AT.space + 3 * i, one))
    if b[LINEAR.called] != 0:
        at = AT.called + CALLED.size * i
        torque = torque + size(vector(x, at + CALLED.moment, one))
        for k in range(9):
            torque = torque + size(vector(x, at + CALLED.rows + 3 * k, one))
    return torque * (zero + size(S[0]) + size(S[1]) + size(S[2]))


@shared
def solved(b, x, table, s, J, S, D, n0, one, loaded):
    """Find the stages; return the mask of the steps that are not solved."""
    n, h, W0, zero = lanes(one), load(x, AT.h * lanes(one), one), vector(x, AT.W0, one), splat(0.0, one)
    lift, m, before = load(x, AT.lift * n, one) / h, 3 * s, zero + 1e300
    iterated(b, x, table, s, J, S, D, n0, one, loaded)
    bad = zero > 1.0
    for _ in range(CORRECTIONS):
        if loaded is not None:
            set_rows(x, table, s, are_coupled(b), one)
        for i in range(s):
            W, C = vector(x, AT.W + 3 * i, one), columns_at(x, AT.C + 9 * i, one)
            g = torque_at(b, x, i, W, C, J, D, one, loaded)
            K = axpy(lift, n0, times(S, g))
            put_vector(x, AT.K + 3 * i, K)
            store(x, (AT.mu + i) * n, dot(n0, minus(g, times(J, K))))
        now = zero
        for i in range(s):
            r = minus(W0, vector(x, AT.W + 3 * i, one))
            reach = size(W0) + TINY
            if loaded is not None:
                reach = reach + LEVELLED * abs(h) * strength(b, x, i, S, one)
            for j in range(s):
                a = h * table[TABLE.a + WIDTH * j + i]
                r, reach = axpy(a, vector(x, AT.K + 3 * j, one), r), reach + abs(a) * size(vector(x, AT.K + 3 * j, one))
            put_vector(x, AT.rest + 3 * i, r)
            now = larger(now, size(r) / reach)
        bad = select(now <= STALLED, zero, zero + 1.0) > 0.5
        ends = either(now <= ENOUGH, both(now <= STALLED, now >= before))
        if not any_of(select(ends, zero, zero + 1.0) > 0.5):
            break
        before = now
        set_slopes(b, x, s, J, S, D, one, loaded)
        set_system(x, table, s, are_coupled(b), 1, False, one)
        for i in range(s):
            r = (zero, zero, zero)
            for j in range(s):
                r = axpy(table[TABLE.inverse + WIDTH * j + i], vector(x, AT.rest + 3 * j, one), r)
            for k in range(3):
                store(x, (AT.a + (3 * i + k) * (m + 1) + m) * n, r[k])
        eliminated(x, AT.a, m, m + 1, one)
        for i in range(m):
            w = load(x, (AT.W + i) * n, one) + load(x, (AT.a + i * (m + 1) + m) * n, one)
            store(x, (AT.W + i) * n, w)
    return bad


@shared
def show_stages(b, x, s, first, last, one):
    """Write velocities and rows of the stages."""
    n, out = lanes(one), doubles(b[LINEAR.shown])
    for l in range(last - first):
        for j in range(s):
            place = 12 * (s * (first + l) + j)
            for k in range(3):
                out[place + k] = x[(AT.W + 3 * j + k) * n + l]
            for k in range(9):
                out[place + 3 + k] = x[(AT.C + 9 * j + k) * n + l]
