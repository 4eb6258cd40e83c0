"""The step of `gauss` and its compiled march, for one body and for bodies in lanes.

The frame b is that of the engine: principal axes, or the constrained axis third and J12 = 0. The unknowns of a step
are the increments ``L_j = h b_j F_j`` of the momentum P at its s stages, and those of vectors g that stand still in
space, ``g' = g × W``, seen from the body: none, the vertical, or all three axes of b at the beginning of the step. They
lie in memory, ``y[(component * WIDTH + stage) * lanes + lane]``. So one text serves both kinds of element: for one body
an element of stages, read at once; for bodies in lanes an element of bodies, stage by stage. Each number of a body is
made by the same operations in the same order in both.

An iteration evaluates all stages, Y_i = y_n + Σ μ_ij L_j, and takes L = h b F(Y) for the next L. A body is done where
the increments of L are round-off, or have stopped falling and are small; it then keeps its L, whatever its neighbours
do. Where they fall by less than one half each, or something is not finite, `gauss_newton_step` solves for that body.
"""

from math import sin

from ..engine.called import moment_of
from ..engine.lane import add_to, gather, keep, matrix, put_vector, quaternion_at, scatter, vector, write
from ..engine.layout import BLOCK, BODY, NODAL, OBSERVATION, STATE, SUMS, WORK
from ..engine.march import FARTHEST, PI, UNIT, note
from ..engine.observing import begin_observing, extend, integrate, observe, observe_at
from ..geometry.compiled import inlined, kernel, shared
from ..geometry.elements import (
    any_of,
    both,
    doubles,
    eight,
    either,
    integers,
    lanes,
    largest,
    load,
    root,
    select,
    shifted,
    splat,
    store,
    without,
)
from ..geometry.tuples import (
    EPS,
    NAN,
    add,
    attitude,
    axpy,
    chosen,
    cross,
    dot,
    each,
    larger,
    minus,
    product,
    scaled,
    size,
    summed,
    times,
    transposed,
    transposed_times,
)
from .gauss_layout import CARRIED, STAGES, TABLE, WIDTH
from .gauss_newton_step import newton, rows_by_elimination
from .split_step import turned_on

FALLING, GROWING, PATIENCE = 0.5, 8.0, 12  # how increments must fall in two iterations, may grow in one at first
FEW, MANY = (0.02, 0.002), (0.1, 0.01)  # increments that are small enough, now and next; up to 4 stages, above
ITERATIONS, SMALL, ROUGH, LOST, TINY = 100, 1e4, 16.0, 1e300, 1e-300
SMALLEST = 0.1  # determinant of the rows of a stage
INFINITE = float("inf")


@inlined
def parts(s, one, wide):
    """Return in how many parts the stages of a step are evaluated."""
    return s if lanes(wide) == lanes(one) else 1


@inlined
def at(y, c, i, one):
    """Return the vector of components c, c + 1, c + 2 at stage i."""
    n = lanes(one)
    return (
        load(y, (c * WIDTH + i) * n, one),
        load(y, ((c + 1) * WIDTH + i) * n, one),
        load(y, ((c + 2) * WIDTH + i) * n, one),
    )


@inlined
def stages_at(y, c, i, one, wide):
    """Return the vector of components c, c + 1, c + 2 at the stages of part i."""
    n = lanes(one)
    return (
        load(y, (c * WIDTH + i) * n, wide),
        load(y, ((c + 1) * WIDTH + i) * n, wide),
        load(y, ((c + 2) * WIDTH + i) * n, wide),
    )


@inlined
def put_at(y, c, i, one, v):
    n = lanes(one)
    store(y, (c * WIDTH + i) * n, v[0])
    store(y, ((c + 1) * WIDTH + i) * n, v[1])
    store(y, ((c + 2) * WIDTH + i) * n, v[2])


@inlined
def collocated(y, c, base, i, coefficients, table, s, one, wide, part):
    """Return ``base + Σ μ_ij L_j`` of part i, for the components c, c + 1, c + 2; even and odd j are summed apart."""
    n, even = lanes(one), splat(0.0, wide)
    x0, x1, x2, z0, z1, z2 = even, even, even, even, even, even
    for j in range(0, s - 1, 2):
        m = load(table, coefficients + WIDTH * j + i, part)
        x0 = x0 + m * load(y, (c * WIDTH + j) * n, one)
        x1 = x1 + m * load(y, ((c + 1) * WIDTH + j) * n, one)
        x2 = x2 + m * load(y, ((c + 2) * WIDTH + j) * n, one)
        m = load(table, coefficients + WIDTH * (j + 1) + i, part)
        z0 = z0 + m * load(y, (c * WIDTH + j + 1) * n, one)
        z1 = z1 + m * load(y, ((c + 1) * WIDTH + j + 1) * n, one)
        z2 = z2 + m * load(y, ((c + 2) * WIDTH + j + 1) * n, one)
    if s % 2 == 1:
        m = load(table, coefficients + WIDTH * (s - 1) + i, part)
        x0 = x0 + m * load(y, (c * WIDTH + s - 1) * n, one)
        x1 = x1 + m * load(y, ((c + 1) * WIDTH + s - 1) * n, one)
        x2 = x2 + m * load(y, ((c + 2) * WIDTH + s - 1) * n, one)
    return (base[0] + (x0 + z0), base[1] + (x1 + z1), base[2] + (x2 + z2))


@inlined
def total(y, c, s, one):
    """Return the sum over the stages of the components c, c + 1, c + 2."""
    n, x0 = lanes(one), splat(0.0, one)
    x1, x2 = x0, x0
    for j in range(s):
        x0 = x0 + load(y, (c * WIDTH + j) * n, one)
        x1 = x1 + load(y, ((c + 1) * WIDTH + j) * n, one)
        x2 = x2 + load(y, ((c + 2) * WIDTH + j) * n, one)
    return (x0, x1, x2)


@inlined
def axes(one):
    """Return the rows of the unit matrix."""
    o, e = splat(0.0, one), splat(1.0, one)
    return ((e, o, o), (o, e, o), (o, o, e))


@shared
def call_at(y, i, count, k, R, call, one):
    """Call the moment of the state at the stages i, ..., i + count - 1; it is kept as seen at the beginning."""
    function, node, times_, room = call
    for j in range(i, i + count):
        C = (at(y, STAGES.rows, j, one), at(y, STAGES.rows + 3, j, one), at(y, STAGES.rows + 6, j, one))
        W = each(k, at(y, STAGES.P, j, one))
        q = (transposed_times(C, R[0]), transposed_times(C, R[1]), transposed_times(C, R[2]))
        f = moment_of((function, times_[node + j], room), R, q, times(C, W))
        put_at(y, STAGES.called, j, one, f)
        if lanes(one) == 1 and not any_of(size(f) <= LOST):
            break


@shared
def stage(y, i, coefficients, table, s, body, P, D, K, g0, R, call, one, wide, part, moved, heavy, pushed):
    """Return P, W, the vectors g, the torque, the own moment, and the moment of space at the stages of part i.

    K are the columns of the dead forces, or the centre of mass times the weight where g is the vertical.
    """
    k, off, _, _ = body
    Q = collocated(y, 0, P, i, coefficients, table, s, one, wide, part)
    W, C, own, push = each(k, Q), None, None, None
    if pushed is None:
        torque = cross(Q, W)
        if moved is not None:
            own = stages_at(y, STAGES.moving, i, one, wide)
            torque = add(torque, own)
        if heavy is not None:
            C = collocated(y, 3, g0, i, coefficients, table, s, one, wide, part)
            torque = add(torque, cross(K, C))
        return Q, W, C, torque, own, push
    torque = cross((Q[0], Q[1], Q[2] + off[0] * W[0] + off[1] * W[1]), W)
    own = axpy(-1.0, times(D, W), stages_at(y, STAGES.moving, i, one, wide))
    e = axes(one)
    c0 = collocated(y, 3, e[0], i, coefficients, table, s, one, wide, part)
    c1 = collocated(y, 6, e[1], i, coefficients, table, s, one, wide, part)
    c2 = collocated(y, 9, e[2], i, coefficients, table, s, one, wide, part)
    if call[0] != 0:
        put_at(y, STAGES.P, i, one, Q)
        put_rows(y, STAGES.rows, i, one, (c0, c1, c2))
        call_at(y, i, s if lanes(wide) > lanes(one) else 1, k, R, call, one)
    f = add(stages_at(y, STAGES.space, i, one, wide), stages_at(y, STAGES.called, i, one, wide))
    n = cross(c1, c2)
    push = scaled(1.0 / dot(c0, n), axpy(f[0], n, axpy(f[1], cross(c2, c0), scaled(f[2], cross(c0, c1)))))
    dead = add(cross(K[0], c0), add(cross(K[1], c1), cross(K[2], c2)))
    return Q, W, (c0, c1, c2), add(add(add(torque, own), dead), push), own, push


@inlined
def put_rows(y, c, i, one, C):
    put_at(y, c, i, one, C[0])
    put_at(y, c + 3, i, one, C[1])
    put_at(y, c + 6, i, one, C[2])


@inlined
def apart(y, c, ahead, i, one, wide, new):
    """Return what `new` is away from the increments at the components from c on, and put it at those from `ahead`.

    Where a part holds all stages nobody needs the old ones any more, and `new` takes their place.
    """
    old = stages_at(y, c, i, one, wide)
    put_at(y, ahead if lanes(wide) == lanes(one) else c, i, one, new)
    return minus(new, old)


@inlined
def peak(d, one):
    """Return the largest of d over the stages, infinity where one is not a number."""
    return largest(select(d <= LOST, d, splat(INFINITE, d)), one)


@inlined
def taken(y, c, ahead, count, takes, s, one, wide):
    """Put `count` components from `ahead` on to those from c on, for bodies whose mask is set."""
    n = lanes(one)
    if any_of(takes):
        for k in range(count):
            for i in range(parts(s, one, wide)):
                old, new = ((c + k) * WIDTH + i) * n, ((ahead + k) * WIDTH + i) * n
                store(y, old, select(takes, load(y, new, wide), load(y, old, wide)))


@inlined
def progress(count, s, is_open, hard, now, before, earlier, rough):
    """Return the masks of bodies that take this iterate, remain open, and are not for fixed points.

    `now` is the size of the increments in round-off of the velocity, `before` and `earlier` those of the last two
    iterations: increments may turn as they shrink. What is left after a body is done would add up to a drift, so it is
    to be small beside round-off; `rough` is the round-off of the equations.
    """
    finite = now <= LOST
    takes = both(is_open, finite)
    hard, is_open = either(hard, without(is_open, finite)), takes
    if count > 0:
        done = now <= (FEW[0] if s <= 4 else MANY[0])
        if count > 1:
            done = either(done, now * now <= (FEW[1] if s <= 4 else MANY[1]) * before)
        if count > 2:
            done = either(done, both(now <= rough, now >= earlier))
        is_open = without(is_open, done)
        if count > 1:
            worse = now > GROWING * before
            if count > PATIENCE:
                worse = either(worse, now > FALLING * earlier)
            worse = without(both(is_open, worse), now <= SMALL + rough)
            hard = either(hard, worse)
            is_open = without(is_open, worse)
    return takes, is_open, hard


@shared
def iterated(y, h, table, s, body, P, D, K, g0, R, call, is_open, one, wide, part, moved, heavy, pushed):
    """Iterate L; return the mask of bodies whose iteration does not contract well, and the iterations of each."""
    zero, (k, _, free, _) = splat(0.0, one), body
    hard, before, used, count, speed = zero > 1.0, splat(INFINITE, one), zero, 0, size(each(k, P))
    earlier, rough = before, ROUGH * (1.0 + h * size(P) * larger(larger(k[0], k[1]), k[2]))
    while any_of(is_open) and count < ITERATIONS:
        coefficients = TABLE.guess if count == 0 else TABLE.mu
        change, reach, turn = zero, zero, zero
        for i in range(parts(s, one, wide)):
            b = h * load(table, TABLE.weights + i, part)
            _, W, C, torque, _, _ = stage(
                y, i, coefficients, table, s, body, P, D, K, g0, R, call, one, wide, part, moved, heavy, pushed
            )
            new = (b * torque[0], b * torque[1], free * (b * torque[2]))
            d = apart(y, 0, STAGES.ahead, i, one, wide, new)
            change = larger(change, peak(size(each(k, d)), one))
            reach = larger(reach, largest(size(each(k, new)), one))
            if pushed is not None:
                d0 = apart(y, 3, STAGES.ahead + 3, i, one, wide, scaled(b, cross(C[0], W)))
                d1 = apart(y, 6, STAGES.ahead + 6, i, one, wide, scaled(b, cross(C[1], W)))
                d2 = apart(y, 9, STAGES.ahead + 9, i, one, wide, scaled(b, cross(C[2], W)))
                turn = larger(turn, peak(size(d0) + size(d1) + size(d2), one))
            elif heavy is not None:
                d0 = apart(y, 3, STAGES.ahead + 3, i, one, wide, scaled(b, cross(C, W)))
                turn = larger(turn, peak(size(d0), one))
        now = larger(change / (EPS * (speed + reach) + TINY), turn * (1.0 / EPS))
        used = select(is_open, zero + (count + 1.0), used)
        takes, is_open, hard = progress(count, s, is_open, hard, now, before, earlier, rough)
        if lanes(wide) == lanes(one):
            taken(y, 0, STAGES.ahead, 12 if pushed is not None else 6 if heavy is not None else 3, takes, s, one, wide)
        if count > 0:
            before, earlier = now, before
        count += 1
    return either(hard, is_open), used


@inlined
def turning(y, c, e, i, b, W, table, s, one, wide, part):
    """Make the next increments of one row of the turn at part i; return by how much they change."""
    C = collocated(y, c, e, i, TABLE.mu, table, s, one, wide, part)
    return size(apart(y, c, c + STAGES.turned - STAGES.turning, i, one, wide, scaled(b, cross(C, W))))


@inlined
def turned(y, h, table, s, is_open, one, wide, part):
    """Iterate the rows of the turn with the velocities of the stages; return the mask of those that do not contract."""
    n, zero, c, e = lanes(one), splat(0.0, one), STAGES.turning, axes(one)
    hard, before, count = zero > 1.0, splat(INFINITE, one), 0
    earlier, rough = before, splat(ROUGH, one)
    for k in range(9):
        for i in range(parts(s, one, wide)):
            store(y, ((c + k) * WIDTH + i) * n, splat(0.0, wide))
    while any_of(is_open) and count < ITERATIONS:
        turn = zero
        for i in range(parts(s, one, wide)):
            b, W = h * load(table, TABLE.weights + i, part), stages_at(y, STAGES.W, i, one, wide)
            d = turning(y, c, e[0], i, b, W, table, s, one, wide, part)
            d = d + turning(y, c + 3, e[1], i, b, W, table, s, one, wide, part)
            d = d + turning(y, c + 6, e[2], i, b, W, table, s, one, wide, part)
            turn = larger(turn, peak(d, one))
        now = turn * (1.0 / EPS)
        takes, is_open, hard = progress(count, s, is_open, hard, now, before, earlier, rough)
        if lanes(wide) == lanes(one):
            taken(y, c, STAGES.turned, 9, takes, s, one, wide)
        if count > 0:
            before, earlier = now, before
        count += 1
    return either(hard, is_open)


@shared
def rows_of_turn(b, y, h, table, s, alive, count, one, wide, part):
    """Find the rows of the turn at all stages, and put them where the vectors g of the stages lie."""
    n, e, c = lanes(one), axes(one), STAGES.turning
    hard = turned(y, h, table, s, alive, one, wide, part)
    if any_of(hard):
        flags = shifted(y, STAGES.sums * WIDTH * n)
        store(flags, 0, select(hard, splat(1.0, one), splat(0.0, one)))
        for l in range(count):
            if flags[l] > 0.0:
                rows_by_elimination(b, y, n, l)
    for i in range(parts(s, one, wide)):
        c0 = collocated(y, c, e[0], i, TABLE.mu, table, s, one, wide, part)
        c1 = collocated(y, c + 3, e[1], i, TABLE.mu, table, s, one, wide, part)
        put_rows(y, STAGES.rows, i, one, (c0, c1, collocated(y, c + 6, e[2], i, TABLE.mu, table, s, one, wide, part)))


@inlined
def half_angle(x, angle):
    """Return (cos - 1, sin) of half an angle; x has room for two elements."""
    n = lanes(angle)
    store(x, 0, angle)
    for l in range(n):
        quarter = sin(0.25 * x[l])
        x[n + l], x[l] = -2.0 * quarter * quarter, sin(0.5 * x[l])
    return load(x, n, angle), load(x, 0, angle)


@inlined
def turned_about(x, w):
    """Return (c - 1, v) of the quaternion (c, v) that turns by the rotation vector w."""
    angle = root(dot(w, w))
    less, sine = half_angle(x, angle)
    return less, scaled(sine / (angle + TINY), w)


@shared
def quaternion_of_turn(D):
    """Return (c - 1, v), c >= 0, of the quaternion (c, v) of a rotation with the rows I + D."""
    d0, d1, d2 = 1.0 + D[0][0], 1.0 + D[1][1], 1.0 + D[2][2]
    trace = D[0][0] + D[1][1] + D[2][2]
    u = (D[2][1] - D[1][2], D[0][2] - D[2][0], D[1][0] - D[0][1])
    a, b, c = D[0][1] + D[1][0], D[0][2] + D[2][0], D[1][2] + D[2][1]
    q = (4.0 + trace, u[0], u[1], u[2])
    best = 3.0 + trace
    for k in range(3):
        d = d0 if k == 0 else d1 if k == 1 else d2
        wins = d > best
        t = 1.0 + 2.0 * d - (d0 + d1 + d2)
        r = (u[0], t, a, b) if k == 0 else (u[1], a, t, c) if k == 1 else (u[2], b, c, t)
        q = (select(wins, r[0], q[0]), select(wins, r[1], q[1]), select(wins, r[2], q[2]), select(wins, r[3], q[3]))
        best = select(wins, d, best)
    f = 1.0 / root(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    f = select(q[0] >= 0.0, f, -f)
    v = (f * q[1], f * q[2], f * q[3])
    return -dot(v, v) / (1.0 + f * q[0]), v


@shared
def spun(y, x, h, table, s, c, g0, g1, f, one, wide, part):
    """Return (c - 1, v) of the quaternion (c, v) of the turn of a step, and the length of what it turns through.

    f g_0 and f g_1 are the unit vectors of one direction in space as seen from the body at both ends, f g that of the
    stages, at the components from c on.
    """
    for i in range(parts(s, one, wide)):
        b, W = h * load(table, TABLE.weights + i, part), stages_at(y, STAGES.W, i, one, wide)
        put_at(y, STAGES.sums, i, one, scaled(b, W))
    w = total(y, STAGES.sums, s, one)
    g0, g1 = scaled(f, g0), scaled(f, g1)
    d = 1.0 / (root(dot(w, w)) + TINY)
    d = select(dot(g0, w) + dot(g1, w) >= 0.0, d, -d)
    r = scaled(d, w)
    for i in range(parts(s, one, wide)):
        g, w = scaled(f, stages_at(y, c, i, one, wide)), stages_at(y, STAGES.sums, i, one, wide)
        rate = dot(w, add(g, r)) / (1.0 + dot(g, r))
        put_at(y, STAGES.sums, i, one, (rate, rate, rate))
    less, sine = half_angle(x, total(y, STAGES.sums, s, one)[0])
    (a, u), (c, v) = (1.0 + dot(g0, r), cross(g0, r)), (1.0 + dot(g1, r), cross(g1, r))
    q = product(
        product((a, -u[0], -u[1], -u[2]), (1.0 + less, sine * r[0], sine * r[1], sine * r[2])), (c, v[0], v[1], v[2])
    )
    f = 1.0 / root(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return f * q[0] - 1.0, (f * q[1], f * q[2], f * q[3])


@shared
def steady_stages(y, x, h, table, s, W, one):
    """Set the velocities and rows of the stages of a body whose momentum stands still."""
    for j in range(s):
        less, v = turned_about(x, scaled(h * table[TABLE.nodes + j], W))
        put_rows(y, STAGES.rows, j, one, attitude((1.0 + less, v[0], v[1], v[2])))
        put_at(y, STAGES.W, j, one, W)


@shared
def solved(b, x, y, node, kind, hard, count, one):
    """Solve the stages of bodies whose mask is set by Newton's iteration: mask of failures, iterations, residuals."""
    n, zero = lanes(one), splat(0.0, one)
    flags = shifted(y, STAGES.sums * WIDTH * n)
    store(flags, 0, select(hard, splat(1.0, one), zero))
    store(flags, n, zero)
    store(flags, 2 * n, zero)
    for l in range(count):
        if flags[l] > 0.0:
            found, used, residual = newton(b, x, y, n, l, node, int(kind))
            flags[l], flags[n + l], flags[2 * n + l] = 0.0 if found else 1.0, float(used), residual
    return load(flags, 0, one) > 0.0, load(flags, n, one), load(flags, 2 * n, one)


@inlined
def select_all(mask, p, q):
    """Return the quaternion p where the mask is set, else q."""
    return (select(mask, p[0], q[0]), select(mask, p[1], q[1]), select(mask, p[2], q[2]), select(mask, p[3], q[3]))


@shared
def ended(y, h, table, s, body, P, D, K, g0, R, call, takes, one, wide, part, moved, heavy, pushed):
    """Evaluate the stages that are found, keep P, W, g and sums; return the smallest determinant of the rows.

    Bodies whose mask is set take the increments that come out, which are nearer to the solution.
    """
    least = splat(-1.0, one)
    for i in range(parts(s, one, wide)):
        b = h * load(table, TABLE.weights + i, part)
        Q, W, C, torque, own, push = stage(
            y, i, TABLE.mu, table, s, body, P, D, K, g0, R, call, one, wide, part, moved, heavy, pushed
        )
        put_at(y, STAGES.P, i, one, Q)
        put_at(y, STAGES.W, i, one, W)
        power = splat(0.0, wide)
        if heavy is not None and pushed is None:
            put_at(y, STAGES.rows, i, one, C)
        if pushed is not None:
            put_rows(y, STAGES.rows, i, one, C)
            power = dot(W, push)
            least = larger(least, largest(-dot(C[0], cross(C[1], C[2])), one))
        if moved is not None:
            power = power + dot(W, own)
            put_at(y, STAGES.sums + 6, i, one, own)
        put_at(y, STAGES.ahead, i, one, (b * torque[0], b * torque[1], body[2] * (b * torque[2])))
        if pushed is not None:
            put_at(y, STAGES.ahead + 3, i, one, scaled(b, cross(C[0], W)))
            put_at(y, STAGES.ahead + 6, i, one, scaled(b, cross(C[1], W)))
            put_at(y, STAGES.ahead + 9, i, one, scaled(b, cross(C[2], W)))
        elif heavy is not None:
            put_at(y, STAGES.ahead + 3, i, one, scaled(b, cross(C, W)))
        put_at(y, STAGES.sums, i, one, (b * torque[2], b * power, b * root(dot(W, W))))
    taken(y, 0, STAGES.ahead, 12 if pushed is not None else 6 if heavy is not None else 3, takes, s, one, wide)
    return least


@shared
def impulse(y, h, table, s, one, wide, part, pushed):
    """Return the integral over the step of the moment of the load in space, as seen at its beginning."""
    for i in range(parts(s, one, wide)):
        b, own = h * load(table, TABLE.weights + i, part), stages_at(y, STAGES.sums + 6, i, one, wide)
        C = tuple_of_rows(y, STAGES.rows, i, one, wide)
        m = times(C, own)
        if pushed is not None:
            m = add(m, add(stages_at(y, STAGES.space, i, one, wide), stages_at(y, STAGES.called, i, one, wide)))
        put_at(y, STAGES.sums + 3, i, one, scaled(b, m))
    return total(y, STAGES.sums + 3, s, one)


@inlined
def tuple_of_rows(y, c, i, one, wide):
    return (
        stages_at(y, c, i, one, wide),
        stages_at(y, c + 3, i, one, wide),
        stages_at(y, c + 6, i, one, wide),
    )


@shared
def seen(x, y, h, table, s, R, one):
    """Take the stages into the integrals over time of what is observed."""
    n, before = lanes(one), load(x, (WORK.observed + OBSERVATION.work) * lanes(one), one)
    for i in range(s):
        work = before
        for j in range(s):
            work = work + table[TABLE.mu + WIDTH * j + i] * load(y, ((STAGES.sums + 1) * WIDTH + j) * n, one)
        store(x, (WORK.observed + OBSERVATION.work) * n, work)
        C = (at(y, STAGES.rows, i, one), at(y, STAGES.rows + 3, i, one), at(y, STAGES.rows + 6, i, one))
        put_vector(x, WORK.velocity, at(y, STAGES.W, i, one))
        observe_at(x, one, None, (transposed_times(C, R[0]), transposed_times(C, R[1]), transposed_times(C, R[2])))
        integrate(x, one, h * table[TABLE.weights + i])
    store(x, (WORK.observed + OBSERVATION.work) * n, before)


@inlined
def carried(b, x, y, n, first, last, back):
    """Bring the increments that the members carry into the room of their stages, or back."""
    order, states, s, stride = integers(b[BLOCK.order]), doubles(b[BLOCK.states]), b[BLOCK.gauss], b[BLOCK.state_size]
    for l in range(n if not back else last - first):
        i = order[min(first + l, last - 1)]
        own = shifted(states, i * stride + STATE.size)
        for c in range(CARRIED):
            for j in range(s):
                if back:
                    own[c * s + j] = y[(c * WIDTH + j) * n + l]
                else:
                    y[(c * WIDTH + j) * n + l] = own[c * s + j]


@inlined
def march(address, one, wide, part, steady, moved, heavy, pushed):
    """March the members `begin` to `end` of the block's order over the nodes of its grid.

    `one` is an element, which reports how many bodies are marched at a time, `wide` the element in which stages are
    evaluated, `part` that of the coefficients. What is None is left out of the compiled code: motion, moments along the
    moving frame, dead forces, all other loads.
    """
    b = integers(address)
    x, n = doubles(b[BLOCK.workspace]), lanes(one)
    y = shifted(x, WORK.size * n)
    for first in range(b[BLOCK.begin], b[BLOCK.end], n):
        last = min(first + n, b[BLOCK.end])
        gather(b, x, n, first, last)
        carried(b, x, y, n, first, last, False)
        march_lanes(b, x, y, one, wide, part, steady, moved, heavy, pushed, first, last)
        scatter(b, x, n, first, last)
        carried(b, x, y, n, first, last, True)


@inlined
def march_lanes(b, x, y, one, wide, part, steady, moved, heavy, pushed, first, last):
    """March the bodies in the workspace over the nodes; arguments as of `march`."""
    n, s, reals, table = lanes(one), b[BLOCK.gauss], doubles(b[BLOCK.step]), doubles(b[BLOCK.table])
    h, rate, zero, stored = reals[0], reals[1], splat(0.0, one), integers(b[BLOCK.stored])
    observed, reports, function, done = (
        b[BLOCK.observed] != 0,
        b[BLOCK.intervals] != 0,
        b[BLOCK.function],
        b[BLOCK.done],
    )
    scratch, never, nothing = shifted(x, WORK.constants * n), zero > 1.0, (zero, zero, zero)
    k, free = vector(x, WORK.body + BODY.k, one), load(x, (WORK.body + BODY.free) * n, one)
    off = (load(x, (WORK.body + BODY.off) * n, one), load(x, (WORK.body + BODY.off + 1) * n, one))
    body, basis = (k, off, free, None), matrix(x, WORK.body + BODY.basis, one)
    p, c = quaternion_at(x, WORK.state, one), quaternion_at(x, WORK.state + STATE.extra, one)
    P, carry = vector(x, WORK.state + STATE.s, one), vector(x, WORK.state + STATE.carry, one)
    scale, alive = load(x, WORK.scale * n, one), load(x, WORK.failure * n, one) == 0.0
    e, dead = vector(x, WORK.body + BODY.vertical, one), matrix(x, WORK.body + BODY.dead, one)
    D, K, g0, call, R = None, None, None, None, attitude(p)
    moving, space, times_ = doubles(b[BLOCK.moving]), doubles(b[BLOCK.space]), doubles(b[BLOCK.times])
    if pushed is not None:
        D, K = matrix(x, WORK.body + BODY.damping, one), dead
    elif heavy is not None:
        K, g0 = times(dead, e), P
    far = both(alive, abs(h) * size(each(k, P)) > FARTHEST)
    if any_of(far):
        turn = abs(h) * size(each(k, P))
        note(x, far, never, far, 0, b[BLOCK.first], NAN + zero, turn, turn)
        alive = without(alive, far)
    if observed:
        keep(x, p, P, carry, (c[0], c[1], c[2], c[3], zero, zero, zero, zero, zero), each(k, P))
        observe(x, one, None)
        if b[BLOCK.first] == 0:
            begin_observing(x, n)
    node = 0 * s
    for number in range(b[BLOCK.first], b[BLOCK.first] + b[BLOCK.steps]):
        if not any_of(alive):
            break
        weight, used, residual, hard = 1.0 / float(stored[done + 1] - stored[done]), zero, zero, never
        if moved is not None:
            for j in range(s if b[BLOCK.moving] != 0 else 0):
                i = 3 * (node + j)
                m = transposed_times(basis, (scale * moving[i], scale * moving[i + 1], scale * moving[i + 2]))
                put_at(y, STAGES.moving, j, one, m)
        if pushed is not None:
            for j in range(s if b[BLOCK.space] != 0 else 0):
                i = 3 * (node + j)
                m = transposed_times(R, (scale * space[i], scale * space[i + 1], scale * space[i + 2]))
                put_at(y, STAGES.space, j, one, m)
            K = transposed((transposed_times(R, dead[0]), transposed_times(R, dead[1]), transposed_times(R, dead[2])))
            room = (shifted(x, WORK.call * n), shifted(x, WORK.buffer * n), basis, rate, scale)
            call = (function, node, times_, room)
            for i in range(3 * WIDTH, 12 * WIDTH):
                for l in range(n):
                    y[i * n + l] = 0.0
        elif heavy is not None:
            g0 = transposed_times(R, e)
        # The stages.
        if steady is None:
            hard, used = iterated(
                y, h, table, s, body, P, D, K, g0, R, call, alive, one, wide, part, moved, heavy, pushed
            )
            takes = without(alive, hard)
            if any_of(hard):
                keep(x, p, P, carry, (c[0], c[1], c[2], c[3], zero, zero, zero, zero, zero), each(k, P))
                kind = 2 if pushed is not None else 1 if heavy is not None else 0
                hard, more, residual = solved(b, x, y, node, kind, hard, last - first, one)
                used = used + more
            least = ended(y, h, table, s, body, P, D, K, g0, R, call, takes, one, wide, part, moved, heavy, pushed)
            dP = total(y, 0, s, one)
            mu, work, arc = total(y, STAGES.sums, s, one)
            if pushed is not None:
                mu = mu - (off[0] * k[0] * dP[0] + off[1] * k[1] * dP[1])
        else:
            W = each(k, P)
            dP, mu, work, arc, least = nothing, h * cross(P, W)[2], zero, abs(h) * root(dot(W, W)), zero - 1.0
        # The turn.
        if steady is not None:
            less, v = turned_about(scratch, scaled(h, W))
        elif pushed is not None:
            less, v = quaternion_of_turn((total(y, 3, s, one), total(y, 6, s, one), total(y, 9, s, one)))
        elif moved is not None:
            rows_of_turn(b, y, h, table, s, without(alive, hard), last - first, one, wide, part)
            at_turn = STAGES.turning
            less, v = quaternion_of_turn(
                (total(y, at_turn, s, one), total(y, at_turn + 3, s, one), total(y, at_turn + 6, s, one))
            )
        elif heavy is not None:
            g1 = add(g0, total(y, 3, s, one))
            less, v = spun(y, scratch, h, table, s, STAGES.rows, g0, g1, 1.0, one, wide, part)
        else:
            f = 1.0 / (root(dot(P, P)) + TINY)
            less, v = spun(y, scratch, h, table, s, STAGES.P, P, add(P, dP), f, one, wide, part)
        # Bodies that cannot go on are noted before the step counts.
        ahead, compensation, gap = turned_on(p, c, less, v)
        far = either(arc > 0.5 * PI * (s + 1.0), least > -SMALLEST)
        bad = without(alive, without(both(gap <= UNIT, arc <= LOST), either(hard, far)))
        if any_of(bad):
            speed = h * root(dot(each(k, P), each(k, P)))
            note(x, bad, hard, far, function, number, residual, speed, arc)
            alive = without(alive, bad)
            if not any_of(alive):
                break
        if reports or observed:
            if moved is not None:
                m = times(R, impulse(y, h, table, s, one, wide, part, pushed))
                for i in range(3):
                    add_to(x, WORK.sums + SUMS.moment + i, weight / h * m[i])
            if observed:
                if steady is not None:
                    steady_stages(y, scratch, h, table, s, W, one)
                elif moved is None:
                    rows_of_turn(b, y, h, table, s, alive, last - first, one, wide, part)
                seen(x, y, h, table, s, R, one)
                add_to(x, WORK.now + NODAL, -mu / h)
                add_to(x, WORK.observed + OBSERVATION.work, work)
            add_to(x, WORK.sums + SUMS.mu, weight / h * mu)
            add_to(x, WORK.sums + SUMS.work, work)
            store(x, (WORK.sums + SUMS.iterations) * n, larger(used, load(x, (WORK.sums + SUMS.iterations) * n, one)))
        # The next state.
        p, c = select_all(alive, ahead, p), select_all(alive, compensation, c)
        P, carry = summed(P, carry, chosen(alive, dP, nothing))
        if steady is None or observed:
            R = attitude(p)
        if observed:
            keep(x, p, P, carry, (c[0], c[1], c[2], c[3], zero, zero, zero, zero, zero), each(k, P))
            observe(x, one, None)
            if any_of(alive):
                extend(x, one, h)
        if number + 1 == stored[done + 1] and any_of(alive):
            done += 1
            keep(x, p, P, carry, (c[0], c[1], c[2], c[3], zero, zero, zero, zero, zero), each(k, P))
            write(b, x, n, done, first, last)
        node += s
    keep(x, p, P, carry, (c[0], c[1], c[2], c[3], zero, zero, zero, zero, zero), each(k, P))
    if b[BLOCK.leaves] != 0:
        write(b, x, n, done + 1, first, last)


@kernel
def steady_one(address):
    march(address, 0.0, eight(), eight(), 1, None, None, None)


@kernel
def free_one(address):
    march(address, 0.0, eight(), eight(), None, None, None, None)


@kernel
def moved_one(address):
    march(address, 0.0, eight(), eight(), None, 1, None, None)


@kernel
def heavy_one(address):
    march(address, 0.0, eight(), eight(), None, None, 1, None)


@kernel
def any_one(address):
    march(address, 0.0, eight(), eight(), None, 1, 1, 1)


@kernel
def steady_eight(address):
    march(address, eight(), eight(), 0.0, 1, None, None, None)


@kernel
def free_eight(address):
    march(address, eight(), eight(), 0.0, None, None, None, None)


@kernel
def moved_eight(address):
    march(address, eight(), eight(), 0.0, None, 1, None, None)


@kernel
def heavy_eight(address):
    march(address, eight(), eight(), 0.0, None, None, 1, None)


@kernel
def any_eight(address):
    march(address, eight(), eight(), 0.0, None, 1, 1, 1)


ONE = (steady_one, moved_one, free_one, moved_one, heavy_one, any_one, any_one)
EIGHT = (steady_eight, moved_eight, free_eight, moved_eight, heavy_eight, any_eight, any_eight)
