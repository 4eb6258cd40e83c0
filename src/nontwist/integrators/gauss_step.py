"""The step of `gauss` and its compiled march, for one body and for bodies in lanes.

The frame b is that of the engine: principal axes, or the constrained axis third and J12 = 0. A step finds its stages
(`gauss_stages`; `gauss_newton_step` for bodies whose increments fall by less than one half each, or are not finite),
then the turn (`gauss_turn`), and then what the interval gets of it.
"""

from ..engine.lane import add_to, gather, keep, matrix, put_vector, quaternion_at, scatter, show, vector, write
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
    four,
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
    NAN,
    add,
    attitude,
    chosen,
    cross,
    dot,
    each,
    larger,
    scaled,
    size,
    summed,
    times,
    transposed,
    transposed_times,
)
from .gauss_layout import CARRIED, STAGES, TABLE, WIDTH
from .gauss_newton_step import newton
from .gauss_stages import (
    FAINT,
    LOST,
    SEEN,
    SHY,
    TINY,
    iterated,
    parts,
    put_at,
    put_rows,
    rows_at,
    stage,
    stages_at,
    taken,
    total,
)
from .gauss_turn import quaternion_of_turn, rows_of_turn, spun, steady_stages, turned_about
from .split_step import turned_on

SMALLEST = 0.1  # determinant of the rows of a stage


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
        C = rows_at(y, STAGES.rows, i, one, wide)
        m = times(C, own)
        if pushed is not None:
            m = add(m, add(stages_at(y, STAGES.space, i, one, wide), stages_at(y, STAGES.called, i, one, wide)))
        put_at(y, STAGES.sums + 3, i, one, scaled(b, m))
    return total(y, STAGES.sums + 3, s, one)


@shared
def seen(x, y, h, table, s, R, one):
    """Take the stages into the integrals over time of what is observed."""
    n, before = lanes(one), load(x, (WORK.observed + OBSERVATION.work) * lanes(one), one)
    for i in range(s):
        work = before
        for j in range(s):
            work = work + table[TABLE.mu + WIDTH * j + i] * load(y, ((STAGES.sums + 1) * WIDTH + j) * n, one)
        store(x, (WORK.observed + OBSERVATION.work) * n, work)
        C = rows_at(y, STAGES.rows, i, one, one)
        put_vector(x, WORK.velocity, stages_at(y, STAGES.W, i, one, one))
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

    `one` is an element, which says how many bodies are marched at a time, `wide` the element in which stages are
    evaluated, of four up to order 8 and of eight above, `part` that of the coefficients. What is None is left out of
    the compiled code: motion, moments along the moving frame, dead forces, all other loads.
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
    observed, reports = b[BLOCK.observed] != 0, b[BLOCK.intervals] != 0
    function, done, lengths = b[BLOCK.function], b[BLOCK.done], doubles(b[BLOCK.lengths])
    scratch, never, zeros = shifted(x, WORK.constants * n), zero > 1.0, (zero, zero, zero)
    k, free = vector(x, WORK.body + BODY.k, one), load(x, (WORK.body + BODY.free) * n, one)
    off = (load(x, (WORK.body + BODY.off) * n, one), load(x, (WORK.body + BODY.off + 1) * n, one))
    body, basis = (k, off, free, None), matrix(x, WORK.body + BODY.basis, one)
    p, c = quaternion_at(x, WORK.state, one), quaternion_at(x, WORK.state + STATE.c, one)
    P, carry = vector(x, WORK.state + STATE.s, one), vector(x, WORK.state + STATE.carry, one)
    scale, alive = load(x, WORK.scale * n, one), load(x, WORK.failure * n, one) == 0.0
    e, dead = vector(x, WORK.body + BODY.vertical, one), matrix(x, WORK.body + BODY.dead, one)
    D, K, g0, call, R, told = None, None, None, None, attitude(p), load(x, (WORK.state + STATE.extra) * n, one)
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
        show(x, p, each(k, P), None)
        observe(x, one, None)
        if b[BLOCK.first] == 0:
            begin_observing(x, n)
    node = 0 * s
    for number in range(b[BLOCK.first], b[BLOCK.first] + b[BLOCK.steps]):
        if not any_of(alive):
            break
        per_time, used, residual, hard = 1.0 / lengths[done], zero, zero, never
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
                y, h, table, s, body, P, carry, D, K, g0, R, call, alive, told, one, wide, part, moved, heavy, pushed
            )
            if s > SHY and pushed is None:
                told = larger(select(hard, zero, used - SEEN), zero)
            takes = without(alive, hard)
            if any_of(hard):
                keep(x, p, c, P, carry, (told, zero, zero, zero, zero, zero, zero, zero, zero), each(k, P))
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
            dP, mu, work, arc, least = zeros, h * cross(P, W)[2], zero, abs(h) * root(dot(W, W)), zero - 1.0
        next_P, next_carry = summed(P, carry, dP)
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
            f = select(dot(P, P) > FAINT, 1.0 / (root(dot(P, P)) + TINY), zero)
            less, v = spun(y, scratch, h, table, s, STAGES.P, P, next_P, f, one, wide, part)
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
                    add_to(x, WORK.sums + SUMS.moment + i, per_time * m[i])
            if observed:
                if steady is not None:
                    steady_stages(y, scratch, h, table, s, W, one)
                elif moved is None:
                    rows_of_turn(b, y, h, table, s, alive, last - first, one, wide, part)
                seen(x, y, h, table, s, R, one)
                add_to(x, WORK.now + NODAL, -mu / h)
                add_to(x, WORK.observed + OBSERVATION.work, work)
            add_to(x, WORK.sums + SUMS.mu, per_time * mu)
            add_to(x, WORK.sums + SUMS.work, work)
            store(x, (WORK.sums + SUMS.iterations) * n, larger(used, load(x, (WORK.sums + SUMS.iterations) * n, one)))
        # The next state.
        p, c = select_all(alive, ahead, p), select_all(alive, compensation, c)
        P, carry = chosen(alive, next_P, P), chosen(alive, next_carry, carry)
        if steady is None or observed:
            R = attitude(p)
        if observed:
            show(x, p, each(k, P), None)
            observe(x, one, None)
            if any_of(alive):
                extend(x, one, h)
        if number + 1 == stored[done + 1] and any_of(alive):
            done += 1
            show(x, p, each(k, P), None)
            write(b, x, n, done, first, last)
        node += s
    keep(x, p, c, P, carry, (told, zero, zero, zero, zero, zero, zero, zero, zero), each(k, P))
    if b[BLOCK.leaves] != 0:
        write(b, x, n, done + 1, first, last)


@kernel(unroll=False)
def steady_few(address):
    march(address, 0.0, four(), four(), 1, None, None, None)


@kernel(unroll=False)
def free_few(address):
    march(address, 0.0, four(), four(), None, None, None, None)


@kernel(unroll=False)
def moved_few(address):
    march(address, 0.0, four(), four(), None, 1, None, None)


@kernel(unroll=False)
def heavy_few(address):
    march(address, 0.0, four(), four(), None, None, 1, None)


@kernel(unroll=False)
def any_few(address):
    march(address, 0.0, four(), four(), None, 1, 1, 1)


@kernel(unroll=False)
def steady_one(address):
    march(address, 0.0, eight(), eight(), 1, None, None, None)


@kernel(unroll=False)
def free_one(address):
    march(address, 0.0, eight(), eight(), None, None, None, None)


@kernel(unroll=False)
def moved_one(address):
    march(address, 0.0, eight(), eight(), None, 1, None, None)


@kernel(unroll=False)
def heavy_one(address):
    march(address, 0.0, eight(), eight(), None, None, 1, None)


@kernel(unroll=False)
def any_one(address):
    march(address, 0.0, eight(), eight(), None, 1, 1, 1)


@kernel(unroll=False)
def steady_eight(address):
    march(address, eight(), eight(), 0.0, 1, None, None, None)


@kernel(unroll=False)
def free_eight(address):
    march(address, eight(), eight(), 0.0, None, None, None, None)


@kernel(unroll=False)
def moved_eight(address):
    march(address, eight(), eight(), 0.0, None, 1, None, None)


@kernel(unroll=False)
def heavy_eight(address):
    march(address, eight(), eight(), 0.0, None, None, 1, None)


@kernel(unroll=False)
def any_eight(address):
    march(address, eight(), eight(), 0.0, None, 1, 1, 1)


FEW = (steady_few, moved_few, free_few, moved_few, heavy_few, any_few, any_few)
ONE = (steady_one, moved_one, free_one, moved_one, heavy_one, any_one, any_one)
EIGHT = (steady_eight, moved_eight, free_eight, moved_eight, heavy_eight, any_eight, any_eight)
