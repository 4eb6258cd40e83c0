"""The march over the time grid: one text for one body and for bodies in lanes, whatever the scheme.

All that it takes is the address of a block (`layout`). Members are marched a few at a time, as many as an element
holds: their numbers are copied into the workspace, one element after the other, go through all steps, and are copied
back. W or P is a sum of small increments, compensated (Kahan); the attitude is a quaternion p, turned by each step into
``p (1, a)/|(1, a)|`` and kept at unit length. A member that fails is noted and its numbers are NaN from there on; its
neighbours go on. What a step gives to the mean multipliers and moments, to the work and to what is watched is
summed in the workspace.
"""

from ..geometry.compiled import inlined, kernel, shared
from ..geometry.elements import (
    any_of,
    both,
    doubles,
    either,
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
    attitude,
    axpy,
    cross,
    dot,
    each,
    larger,
    product,
    scaled,
    size,
    summed,
    times,
    transposed,
    transposed_times,
    turned_into,
)
from .lane import add_to, matrix, put_vector, quaternion_at, vector
from .layout import BLOCK, BODY, FAILURE, NODAL, STATE, SUMS, WATCH, WORK
from .watch import begin_watching, integrate, observe, widen

PI = 3.141592653589793
FARTHEST = 1e15  # rad a step, of which round-off leaves nothing
UNIT = 1e-9  # how far a quaternion may be from unit length
OK, TURN, STALLED, BROKEN, LOAD = 0, 1, 2, 3, 4


@inlined
def advanced(p, a, s):
    """Return the quaternion of ``Λ (2M - I)``, that is ``p (1, a)/|(1, a)|``, and how far p was from unit length."""
    v = (p[1], p[2], p[3])
    gap = 1.0 - (p[0] * p[0] + dot(v, v))
    f = root(s)
    less = (f - 1.0) + 0.5 * gap
    d = axpy(less, v, scaled(f, axpy(p[0], a, cross(v, a))))
    return (p[0] + (less * p[0] - f * dot(v, a)), v[0] + d[0], v[1] + d[1], v[2] + d[2]), abs(gap)


@inlined
def march(address, one, step, velocity, normal, moved, heavy, pushed):
    """March the members `begin` to `end` of the block's order over the nodes of its grid.

    `one` is an element, which tells how many bodies are marched at a time; `step` and `velocity` are the scheme's.
    What is None is left out of the compiled code: the normal part of the director velocities, moments along the moving
    frame, dead forces, all other loads.
    """
    b = integers(address)
    x, n = doubles(b[BLOCK.workspace]), lanes(one)
    for first in range(b[BLOCK.begin], b[BLOCK.end], n):
        last = min(first + n, b[BLOCK.end])
        gather(b, x, n, first, last)
        march_lanes(b, x, one, step, velocity, normal, moved, heavy, pushed, first, last)
        scatter(b, x, n, first, last)


@inlined
def march_lanes(b, x, one, step, velocity, normal, moved, heavy, pushed, first, last):
    """March the bodies in the workspace over the nodes; arguments as of `march`."""
    n, stages, reals = lanes(one), b[BLOCK.stages], doubles(b[BLOCK.step])
    h, rate, zero = reals[0], reals[1], splat(0.0, one)
    fractions, stored = doubles(b[BLOCK.fractions]), integers(b[BLOCK.stored])
    watched, tells, function, done = b[BLOCK.watch] != 0, b[BLOCK.intervals] != 0, b[BLOCK.function], b[BLOCK.done]
    # The bodies and their states, which stay in registers from here on.
    k, free = vector(x, WORK.body + BODY.k, one), load(x, (WORK.body + BODY.free) * n, one)
    off = (load(x, (WORK.body + BODY.off) * n, one), load(x, (WORK.body + BODY.off + 1) * n, one))
    body, basis = (k, off, free, vector(x, WORK.body + BODY.E, one)), matrix(x, WORK.body + BODY.basis, one)
    p, s, carry = quaternion_at(x, WORK.state, one), vector(x, WORK.state + 4, one), vector(x, WORK.state + 7, one)
    (e0, e1, e2), (e3, e4, e5) = vector(x, WORK.state + STATE.extra, one), vector(x, WORK.state + STATE.extra + 3, one)
    extra = (e0, e1, e2, e3, e4, e5)
    scale, alive = load(x, WORK.scale * n, one), load(x, WORK.failure * n, one) == 0.0
    far = both(alive, abs(h) * size(velocity(k, s)) > FARTHEST)
    if any_of(far):
        turn = abs(h) * size(velocity(k, s))
        note(x, far, zero > 1.0, far, 0, b[BLOCK.first], NAN + zero, turn, turn)
        alive = without(alive, far)
    # M, m, D, F: moments along the frame and in space, damping, dead forces, all in b; None where the form has none.
    R, node = attitude(p), 0
    if moved is None:
        M, m, D, F, call = None, None, None, None, None
    else:
        M, R = (zero, zero, zero), attitude(p)
        moving = doubles(b[BLOCK.moving])
        F = None if heavy is None else (M, M, M)
        if pushed is None:
            m, D, call = None, None, None
        else:
            m, D = M, matrix(x, WORK.body + BODY.damping, one)
            D = (scaled(scale, D[0]), scaled(scale, D[1]), scaled(scale, D[2]))
            space, times_ = doubles(b[BLOCK.space]), doubles(b[BLOCK.times])
            buffer = shifted(x, WORK.buffer * n)
            call = (0, 0.0, shifted(x, WORK.call * n), buffer, R, basis, rate, scale)
    if watched:
        keep(x, p, s, carry, extra, velocity(k, s))
        observe(x, one, normal)
        if b[BLOCK.first] == 0:
            begin_watching(x, n)
    for number in range(b[BLOCK.first], b[BLOCK.first] + b[BLOCK.steps]):
        if not any_of(alive):
            break
        weight = 1.0 / float(stored[done + 1] - stored[done])
        for stage in range(stages):
            part = fractions[stage]
            hs = splat(h * part, one)
            # The loads at the middle of the substep.
            if moved is not None and b[BLOCK.moving] != 0:
                mx, my, mz = moving[3 * node], moving[3 * node + 1], moving[3 * node + 2]
                M = transposed_times(basis, (scale * mx, scale * my, scale * mz))
            if heavy is not None:
                dead = matrix(x, WORK.body + BODY.dead, one)
                F = (transposed_times(R, dead[0]), transposed_times(R, dead[1]), transposed_times(R, dead[2]))
            if pushed is not None:
                if b[BLOCK.space] != 0:
                    mx, my, mz = space[3 * node], space[3 * node + 1], space[3 * node + 2]
                    m = transposed_times(R, (scale * mx, scale * my, scale * mz))
                if function != 0:
                    call = (function, times_[node], shifted(x, WORK.call * n), buffer, R, basis, rate, scale)
            stalled, lost, used, residual, ds, after, a, moment, mu, lam = step(
                hs, s, extra, body, M, m, D, F, call, alive
            )
            # Bodies that cannot go on are noted before the step counts.
            a2 = dot(a, a)
            ahead, gap = advanced(p, a, 1.0 / (1.0 + a2))
            stalled = either(stalled, lost)
            fine = both(both(gap <= UNIT, 4.0 * a2 <= PI * PI), without(alive, stalled))
            bad = without(alive, fine)
            if any_of(bad):
                W = velocity(k, s)
                speed = h * root(dot(W, W))
                note(x, bad, stalled, 4.0 * a2 > PI * PI, function, number, residual, speed, 2.0 / abs(part) * root(a2))
                alive = without(alive, bad)
                if not any_of(alive):
                    break
            # What the step gives to the means and sums over the interval, and to what is watched.
            if tells or watched:
                add_to(x, WORK.sums + SUMS.mu, part * weight * mu)
                if watched:
                    add_to(x, WORK.now + NODAL, -part * mu)
                    integrate(x, one, 0.5 * h * part)
            if moved is not None and (tells or watched):
                work = 2.0 * dot(a, moment)
                add_to(x, WORK.sums + SUMS.work, work)
                add_to(x, WORK.watch + WATCH.work, work)
                moment = times(R, moment)
                for i in range(3):
                    add_to(x, WORK.sums + SUMS.moment + i, part * weight * moment[i])
            if tells:
                used = larger(used, load(x, (WORK.sums + SUMS.iterations) * n, one))
                store(x, (WORK.sums + SUMS.iterations) * n, used)
                if normal is not None:
                    for i in range(6):
                        add_to(x, WORK.sums + SUMS.lam + i, part * weight * lam[i])
            # The next state.
            s, carry = summed(s, carry, ds)
            p, extra = ahead, after
            if moved is not None:
                R = attitude(p)
            if watched:
                keep(x, p, s, carry, extra, velocity(k, s))
                observe(x, one, normal)
                integrate(x, one, 0.5 * h * part)
            node += 1
        if watched and any_of(alive):
            widen(x, one, h)
        if number + 1 == stored[done + 1] and any_of(alive):
            done += 1
            keep(x, p, s, carry, extra, velocity(k, s))
            write(b, x, n, done, first, last)
    keep(x, p, s, carry, extra, velocity(k, s))


@inlined
def keep(x, p, s, carry, extra, W):
    """Write the states to the workspace."""
    n = lanes(p[0])
    store(x, WORK.state * n, p[0])
    put_vector(x, WORK.state + 1, (p[1], p[2], p[3]))
    put_vector(x, WORK.state + STATE.s, s)
    put_vector(x, WORK.state + STATE.carry, carry)
    put_vector(x, WORK.state + STATE.extra, (extra[0], extra[1], extra[2]))
    put_vector(x, WORK.state + STATE.extra + 3, (extra[3], extra[4], extra[5]))
    put_vector(x, WORK.velocity, W)


@shared
def note(x, bad, stalled, turned, function, number, residual, speed, turn):
    """Note why bodies cannot go on."""
    n, zero = lanes(residual), splat(0.0, residual)
    status = select(turned, zero + TURN, zero + BROKEN)
    status, turn = select(stalled, zero + STALLED, status), select(stalled, speed, turn)
    numbers = (status, zero + number, residual, turn)
    for i in range(4):
        before = load(x, (WORK.failure + i) * n, residual)
        store(x, (WORK.failure + i) * n, select(bad, numbers[i], before))
    if function != 0:
        for l in range(n):
            called = abs(x[WORK.call * n + l]) + abs(x[(WORK.call + 1) * n + l]) + abs(x[(WORK.call + 2) * n + l])
            if x[WORK.failure * n + l] == STALLED and not called < 1e300:
                x[WORK.failure * n + l] = LOAD


@shared
def gather(b, x, n, first, last):
    """Fill the workspace with members; lanes beyond `last` repeat the one before it."""
    order, bodies, states = integers(b[BLOCK.order]), doubles(b[BLOCK.bodies]), doubles(b[BLOCK.states])
    scales, failures = doubles(b[BLOCK.scales]), doubles(b[BLOCK.failures])
    for l in range(n):
        i = order[min(first + l, last - 1)]
        for k in range(BODY.size):
            x[(WORK.body + k) * n + l] = bodies[i * b[BLOCK.body_stride] + k]
        for k in range(STATE.size):
            x[(WORK.state + k) * n + l] = states[i * STATE.size + k]
        for k in range(FAILURE.size):
            x[(WORK.failure + k) * n + l] = failures[i * FAILURE.size + k]
        x[WORK.scale * n + l] = scales[i * b[BLOCK.scale_stride]]
        if b[BLOCK.intervals] != 0:
            sums = doubles(b[BLOCK.sums])
            for k in range(SUMS.size):
                x[(WORK.sums + k) * n + l] = sums[i * SUMS.size + k]
        if b[BLOCK.watch] != 0:
            watch = doubles(b[BLOCK.watch])
            for k in range(WATCH.size):
                x[(WORK.watch + k) * n + l] = watch[i * WATCH.size + k]
            x[(WORK.now + NODAL) * n + l] = 0.0


@shared
def scatter(b, x, n, first, last):
    """Put back what the members carry on."""
    order, states, failures = integers(b[BLOCK.order]), doubles(b[BLOCK.states]), doubles(b[BLOCK.failures])
    for l in range(last - first):
        i = order[first + l]
        for k in range(STATE.size):
            states[i * STATE.size + k] = x[(WORK.state + k) * n + l]
        for k in range(FAILURE.size):
            failures[i * FAILURE.size + k] = x[(WORK.failure + k) * n + l]
        if b[BLOCK.intervals] != 0:
            sums = doubles(b[BLOCK.sums])
            for k in range(SUMS.size):
                sums[i * SUMS.size + k] = x[(WORK.sums + k) * n + l]
        if b[BLOCK.watch] != 0:
            watch = doubles(b[BLOCK.watch])
            for k in range(WATCH.size):
                watch[i * WATCH.size + k] = x[(WORK.watch + k) * n + l]


@inlined
def at(x, place, n, l):
    """Return the vector of one body."""
    return (x[place * n + l], x[(place + 1) * n + l], x[(place + 2) * n + l])


@shared
def write(b, x, n, k, first, last):
    """Write the states of the node k, and the means over the interval before it, in body components.

    Of the two quaternions of an attitude it is the one nearer to the state stored before. NaN where a run has failed.
    """
    order, count, rate = integers(b[BLOCK.order]), b[BLOCK.count], doubles(b[BLOCK.step])[1]
    quaternions, velocities, normals = doubles(b[BLOCK.quaternions]), doubles(b[BLOCK.velocities]), b[BLOCK.normals]
    for l in range(last - first):
        row, unit = order[first + l] * count + k, x[(WORK.body + BODY.unit) * n + l]
        q, gone = shifted(quaternions, 4 * row), x[WORK.failure * n + l] != 0.0
        f = NAN if gone else 1.0
        B = transposed(frame_at(x, n, l))
        s, v = x[WORK.state * n + l], at(x, WORK.state + 1, n, l)
        c, u = x[(WORK.body + BODY.frame) * n + l], at(x, WORK.body + BODY.frame + 1, n, l)
        p = product((s, v[0], v[1], v[2]), (c, -u[0], -u[1], -u[2]))
        before = shifted(quaternions, 4 * row - 4)
        nearer = before[0] * p[1] + before[1] * p[2] + before[2] * p[3] + before[3] * p[0]
        sign = f if nearer >= 0.0 else -f
        q[0], q[1], q[2], q[3] = sign * p[1], sign * p[2], sign * p[3], sign * p[0]
        W = times(transposed(B), at(x, WORK.velocity, n, l))
        put(shifted(velocities, 3 * row), scaled(f * rate, W))
        if normals != 0:
            N = symmetric(x, WORK.state + STATE.extra, n, l)
            put_symmetric(shifted(doubles(normals), 6 * row), B, N, f * rate)
        if b[BLOCK.intervals] != 0:
            interval = shifted(doubles(b[BLOCK.intervals]), (row - order[first + l] - 1) * SUMS.size)
            lam = symmetric(x, WORK.sums + SUMS.lam, n, l)
            interval[SUMS.mu] = unit * x[(WORK.sums + SUMS.mu) * n + l]
            put_symmetric(shifted(interval, SUMS.lam), B, lam, unit)
            put(shifted(interval, SUMS.moment), scaled(unit, at(x, WORK.sums + SUMS.moment, n, l)))
            interval[SUMS.work] = unit * x[(WORK.sums + SUMS.work) * n + l]
            interval[SUMS.iterations] = x[(WORK.sums + SUMS.iterations) * n + l]
            for j in range(SUMS.size):
                x[(WORK.sums + j) * n + l] = 0.0


@kernel
def leave(address):
    """Write the state of the member `begin` as if it were that of the node after the last."""
    b = integers(address)
    x, first = doubles(b[BLOCK.workspace]), b[BLOCK.begin]
    gather(b, x, 1, first, first + 1)
    s, k = at(x, WORK.state + STATE.s, 1, 0), at(x, WORK.body + BODY.k, 1, 0)
    put(shifted(x, WORK.velocity), each(k, s) if b[BLOCK.normals] == 0 else s)
    write(b, x, 1, b[BLOCK.done] + 1, first, first + 1)
    scatter(b, x, 1, first, first + 1)


@inlined
def put(pointer, v):
    pointer[0], pointer[1], pointer[2] = v


@inlined
def frame_at(x, n, l):
    """Return the frame of one body, as columns in body components."""
    place = WORK.body + BODY.basis
    return (at(x, place, n, l), at(x, place + 3, n, l), at(x, place + 6, n, l))


@inlined
def symmetric(x, place, n, l):
    """Return the symmetric matrix of the entries 11, 22, 33, 23, 13, 12 of one body."""
    (a, b, c), (d, e, f) = at(x, place, n, l), at(x, place + 3, n, l)
    return ((a, f, e), (f, b, d), (e, d, c))


@inlined
def put_symmetric(pointer, B, A, f):
    """Write the entries of f times a symmetric matrix in body components, B the frame as rows."""
    A = turned_into(transposed(B), A)
    A = turned_into(transposed(B), transposed(A))
    put(pointer, (f * A[0][0], f * A[1][1], f * A[2][2]))
    put(shifted(pointer, 3), (f * A[1][2], f * A[0][2], f * A[0][1]))
