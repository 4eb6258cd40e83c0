"""The step of `gauss` and its compiled march, for one body and for bodies in lanes.

The frame b is that of the engine: principal axes, or the constrained axis third and J12 = 0. A step finds its stages
(`gauss_stages`; `gauss_newton_step` for bodies whose increments fall by less than one half each, or are not finite),
then the turn (`gauss_turn`), and then what the interval gets of it.
"""

from math import cos, sin

from ..engine.lane import add_to, gather, keep, matrix, quaternion_at, scatter, show, vector, write
from ..engine.layout import BLOCK, BODY, NODAL, OBSERVATION, STATE, SUMS, WORK
from ..engine.march import FARTHEST, PI, UNIT, note
from ..engine.observing import begin_observing, extend, observe
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
from .gauss_newton_step import newton
from .gauss_stages import (
    FAINT,
    LOST,
    SEEN,
    SHY,
    TINY,
    iterated,
    put_at,
    stages_at,
    total,
)
from .gauss_sums import dead_impulse, ended, impulse, seen
from .gauss_turn import quaternion_of_turn, rows_of_turn, spun, steady_stages, turned_about
from .turning import turned_on

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
    acting = (function, b[BLOCK.generalised], b[BLOCK.terms], b[BLOCK.action], b[BLOCK.workspace] + 8 * WORK.buffer * n)
    calls, orbit, o = function + b[BLOCK.generalised], 0.0, zeros
    if b[BLOCK.orbit] != 0:
        about = doubles(b[BLOCK.orbit])
        orbit, o = about[0], (zero + about[1], zero + about[2], zero + about[3])
    D, K, g0, call, R, unseen = None, None, None, None, attitude(p), load(x, (WORK.state + STATE.extra) * n, one)
    moving, space, times_ = doubles(b[BLOCK.moving]), doubles(b[BLOCK.space]), doubles(b[BLOCK.times])
    rotor, spin_changes = doubles(b[BLOCK.rotor]), doubles(b[BLOCK.spin])
    if pushed is not None:
        D, K = matrix(x, WORK.body + BODY.damping, one), dead
        J3 = load(x, (WORK.body + BODY.spin) * n, one) * (1.0 / k[2])  # J3 times the factor of a prescribed spin
        for j in range(WIDTH):
            store(y, (STAGES.lift * WIDTH + j) * n, splat(-0.0, one))
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
            if b[BLOCK.rotor] != 0:
                for j in range(s):
                    i = 6 * (node + j)
                    m = (scale * rotor[i], scale * rotor[i + 1], scale * rotor[i + 2])
                    put_at(y, STAGES.rotor, j, one, transposed_times(basis, m))
                    m = (scale * rotor[i + 3], scale * rotor[i + 4], scale * rotor[i + 5])
                    before = stages_at(y, STAGES.moving, j, one, one) if b[BLOCK.moving] != 0 else zeros
                    put_at(y, STAGES.moving, j, one, minus(before, transposed_times(basis, m)))
            if b[BLOCK.spin] != 0:
                for j in range(s):
                    lift = (spin_changes[node + j] * table[TABLE.weights + j]) * J3
                    store(y, (STAGES.lift * WIDTH + j) * n, lift)
            room = (shifted(x, WORK.call * n), shifted(x, WORK.buffer * n), basis, rate, scale, acting)
            seen_from = (orbit, transposed_times(R, o), table, h / rate)
            call = (calls, node, times_, room, b[BLOCK.forces], seen_from, b[BLOCK.rotor] != 0)
            for i in range(3 * WIDTH, 12 * WIDTH):
                for l in range(n):
                    y[i * n + l] = 0.0
        elif heavy is not None:
            g0 = transposed_times(R, e)
        # The stages.
        if steady is None:
            hard, used = iterated(
                y, h, table, s, body, P, carry, D, K, g0, R, call, alive, unseen, one, wide, part, moved, heavy, pushed
            )
            if s > SHY and pushed is None:
                unseen = larger(select(hard, zero, used - SEEN), zero)
            takes = without(alive, hard)
            if any_of(hard):
                keep(x, p, c, P, carry, (unseen, zero, zero, zero, zero, zero, zero, zero, zero), each(k, P))
                kind = 2 if pushed is not None else 1 if heavy is not None else 0
                hard, more, residual = solved(b, x, y, node, kind, hard, last - first, one)
                used = used + more
            least = ended(y, h, table, s, body, P, D, K, g0, R, call, takes, one, wide, part, moved, heavy, pushed)
            dP = total(y, 0, s, one)
            mu, work, arc = total(y, STAGES.sums, s, one)
            turn = total(y, STAGES.sums + 3, s, one)
            if pushed is not None:
                mu = mu - (off[0] * k[0] * dP[0] + off[1] * k[1] * dP[1])
                if b[BLOCK.spin] != 0:
                    mu = mu - dP[2]
        else:
            W = each(k, P)
            turn = scaled(h, W)
            dP, mu, work, arc, least = zeros, h * cross(P, W)[2], zero, abs(h) * root(dot(W, W)), zero - 1.0
        next_P, next_carry = summed(P, carry, dP)
        # The turn.
        if steady is not None:
            less, v = turned_about(scratch, turn)
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
        if pushed is not None and orbit != 0.0:
            angle = 0.5 * orbit * h
            q = (zero + cos(angle), sin(angle) * o[0], sin(angle) * o[1], sin(angle) * o[2])
            ahead, compensation = product(q, ahead), product(q, compensation)
        far = either(arc > 0.5 * PI * (s + 1.0), least > -SMALLEST)
        bad = without(alive, without(both(gap <= UNIT, arc <= LOST), either(hard, far)))
        if any_of(bad):
            speed = h * root(dot(each(k, P), each(k, P)))
            note(x, bad, hard, far, calls, number, residual, speed, select(arc <= LOST, arc, speed))
            alive = without(alive, bad)
            if not any_of(alive):
                break
        if reports or observed:
            if moved is not None:
                m = times(R, impulse(y, h, table, s, one, wide, part, pushed))
                for i in range(3):
                    add_to(x, WORK.sums + SUMS.moment + i, per_time * m[i])
            if heavy is not None and b[BLOCK.held] != 0:
                if moved is None:
                    rows_of_turn(b, y, h, table, s, alive, last - first, one, wide, part)
                F = (transposed_times(R, dead[0]), transposed_times(R, dead[1]), transposed_times(R, dead[2]))
                m = times(R, dead_impulse(y, h, table, s, one, wide, part, F))
                for i in range(3):
                    add_to(x, WORK.sums + SUMS.dead + i, per_time * m[i])
            if observed:
                if steady is not None:
                    steady_stages(y, scratch, h, table, s, W, one)
                elif moved is None and (heavy is None or b[BLOCK.held] == 0):
                    rows_of_turn(b, y, h, table, s, alive, last - first, one, wide, part)
                seen(x, y, h, table, s, R, one)
                add_to(x, WORK.now + NODAL, -mu / h)
                add_to(x, WORK.observed + OBSERVATION.work, work)
            add_to(x, WORK.sums + SUMS.mu, per_time * mu)
            add_to(x, WORK.sums + SUMS.work, work)
            add_to(x, WORK.sums + SUMS.twist, dot(vector(x, WORK.body + BODY.axis, one), turn))
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
    keep(x, p, c, P, carry, (unseen, zero, zero, zero, zero, zero, zero, zero, zero), each(k, P))
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
