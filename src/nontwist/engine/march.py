"""The march over the time grid: one text for one body and for bodies in lanes, whatever the scheme.

All that it takes is the address of a block (`layout`). Members are marched a few at a time, as many as an element
holds: their numbers are copied into the workspace, one element after the other, go through all steps, and are copied
back. W or P is a sum of small increments, compensated (Kahan); the attitude is a quaternion p, turned by each step into
``p (1, a)/|(1, a)|``, compensated as well and kept at unit length. A member that fails is noted and its numbers are NaN
from there on; its neighbours go on. What a step gives to the mean multipliers and moments, to the work and to what is
observed is summed in the workspace.
"""

from ..geometry.compiled import inlined, shared
from ..geometry.elements import (
    any_of,
    both,
    doubles,
    either,
    fused,
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
    column,
    compensated,
    cross,
    dot,
    first_moment,
    larger,
    minus,
    scaled,
    size,
    summed,
    times,
    transposed_times,
)
from .called import mean
from .lane import add_to, gather, keep, matrix, quaternion_at, scatter, show, vector, write
from .layout import BLOCK, BODY, NODAL, OBSERVATION, STATE, SUMS, WORK
from .observing import begin_observing, extend, integrate, observe

PI = 3.141592653589793
FARTHEST = 1e15  # rad a step, of which round-off leaves nothing
UNIT = 1e-9  # how far a quaternion may be from unit length
OK, TURN, STALLED, BROKEN, LOAD = 0, 1, 2, 3, 4


@inlined
def advanced(p, c, a, s):
    """Return the quaternion of ``Λ (2M - I)``, its compensation, and how far p was from unit length.

    It is ``p (1, a)/|(1, a)|``, s = 1/|(1, a)|².
    """
    v = (p[1], p[2], p[3])
    gap = 1.0 - fused(p[0], p[0], dot(v, v))
    f = root(s)
    less = (f - 1.0) + 0.5 * gap
    w, d = -f * dot(v, a), scaled(f, axpy(p[0], a, cross(v, a)))
    x0, c0 = compensated(p[0], fused(less, p[0], w + c[0]))
    x1, c1 = compensated(p[1], fused(less, p[1], d[0] + c[1]))
    x2, c2 = compensated(p[2], fused(less, p[2], d[1] + c[2]))
    x3, c3 = compensated(p[3], fused(less, p[3], d[2] + c[3]))
    return (x0, x1, x2, x3), (c0, c1, c2, c3), abs(gap)


@inlined
def dead_mean(s, a, F):
    """Return ``Σ M e_i × F_i = Σ e_i × (M F)_i``, M as of `mean`: the moment of dead forces at the mean directors."""
    c0, c1, c2 = mean(s, a, column(F, 0)), mean(s, a, column(F, 1)), mean(s, a, column(F, 2))
    return first_moment(((c0[0], c1[0], c2[0]), (c0[1], c1[1], c2[1]), (c0[2], c1[2], c2[2])))


@inlined
def gyrating(D, h):
    """Return D - ĥ: the moment ``h × W`` of rotors with the momentum h is drag with a skew matrix."""
    return (
        (D[0][0], D[0][1] + h[2], D[0][2] - h[1]),
        (D[1][0] - h[2], D[1][1], D[1][2] + h[0]),
        (D[2][0] + h[1], D[2][1] - h[0], D[2][2]),
    )


@inlined
def march(address, one, step, velocity, normal, moved, heavy, pushed, general):
    """March the members `begin` to `end` of the block's order over the nodes of its grid.

    `one` is an element, which says how many bodies are marched at a time; `step` and `velocity` are the scheme's.
    What is None is left out of the compiled code: the normal part of the director velocities, moments along the moving
    frame, dead forces, moments in space, and all else: damping, moments of the state, axes that are not principal.
    """
    b = integers(address)
    x, n = doubles(b[BLOCK.workspace]), lanes(one)
    for first in range(b[BLOCK.begin], b[BLOCK.end], n):
        last = min(first + n, b[BLOCK.end])
        gather(b, x, n, first, last)
        march_lanes(b, x, one, step, velocity, normal, moved, heavy, pushed, general, first, last)
        scatter(b, x, n, first, last)


@inlined
def march_lanes(b, x, one, step, velocity, normal, moved, heavy, pushed, general, first, last):
    """March the bodies in the workspace over the nodes; arguments as of `march`."""
    n, reals, stored = lanes(one), doubles(b[BLOCK.step]), integers(b[BLOCK.stored])
    h, rate, zero, hs = reals[0], reals[1], splat(0.0, one), splat(reals[0], one)
    observed, reports = b[BLOCK.observed] != 0, b[BLOCK.intervals] != 0
    function, done, lengths = b[BLOCK.function], b[BLOCK.done], doubles(b[BLOCK.lengths])
    calls = function
    # The bodies and their states, which stay in registers from here on.
    k, free = vector(x, WORK.body + BODY.k, one), load(x, (WORK.body + BODY.free) * n, one)
    off = (load(x, (WORK.body + BODY.off) * n, one), load(x, (WORK.body + BODY.off + 1) * n, one))
    place = (WORK.body + BODY.dissipation) * n
    body = (k, off, free, vector(x, WORK.body + BODY.E, one), (load(x, place, one), load(x, place + n, one)))
    basis = matrix(x, WORK.body + BODY.basis, one)
    p, c = quaternion_at(x, WORK.state, one), quaternion_at(x, WORK.state + STATE.c, one)
    s, carry = vector(x, WORK.state + STATE.s, one), vector(x, WORK.state + STATE.carry, one)
    place = WORK.state + STATE.extra
    extra = vector(x, place, one) + vector(x, place + 3, one) + vector(x, place + 6, one)
    scale, alive = load(x, WORK.scale * n, one), load(x, WORK.failure * n, one) == 0.0
    far = both(alive, abs(h) * size(velocity(k, s)) > FARTHEST)
    if any_of(far):
        turn = abs(h) * size(velocity(k, s))
        note(x, far, zero > 1.0, far, 0, b[BLOCK.first], NAN + zero, turn, turn)
        alive = without(alive, far)
    # M, m, D, F: moments along the frame and in space, damping, dead forces, all in b; None where the form has none.
    if moved is None:
        M, m, D, F, call = None, None, None, None, None
    else:
        M = (zero, zero, zero)
        moving = doubles(b[BLOCK.moving])
        F = None if heavy is None else (M, M, M)
        m = None if pushed is None else M
        space = doubles(b[BLOCK.space])
        if general is None:
            D, call = None, None
        else:
            D, times_, exact = matrix(x, WORK.body + BODY.damping, one), doubles(b[BLOCK.times]), b[BLOCK.exact] != 0
            at = b[BLOCK.workspace] + 8 * WORK.buffer * n
            acting = (function, b[BLOCK.generalised], b[BLOCK.terms], b[BLOCK.action], at)
            room = (shifted(x, WORK.call * n), shifted(x, WORK.buffer * n), basis, rate, scale, acting)
            rotor, spin_changes, drag, zeros = doubles(b[BLOCK.rotor]), doubles(b[BLOCK.spin]), D, (zero, zero, zero)
            J3, lift = load(x, (WORK.body + BODY.spin) * n, one) * (body[3][0] + body[3][1]), splat(-0.0, one)
            calls = function + b[BLOCK.generalised]
            call = (0, (0.0, 0), room, attitude(p), reports or observed, False, zeros, zeros, lift, exact)
    if observed:
        show(x, p, velocity(k, s), None if normal is None else extra)
        observe(x, one, normal)
        if b[BLOCK.first] == 0:
            begin_observing(x, n)
    for number in range(b[BLOCK.first], b[BLOCK.first] + b[BLOCK.steps]):
        if not any_of(alive):
            break
        weight, node = h / lengths[done], number - b[BLOCK.first]
        # The loads at the middle of the step.
        R = attitude(p)
        if moved is not None and b[BLOCK.moving] != 0:
            mx, my, mz = moving[3 * node], moving[3 * node + 1], moving[3 * node + 2]
            M = transposed_times(basis, (scale * mx, scale * my, scale * mz))
        if heavy is not None:
            dead = matrix(x, WORK.body + BODY.dead, one)
            F = (transposed_times(R, dead[0]), transposed_times(R, dead[1]), transposed_times(R, dead[2]))
        if pushed is not None and b[BLOCK.space] != 0:
            mx, my, mz = space[3 * node], space[3 * node + 1], space[3 * node + 2]
            m = transposed_times(R, (scale * mx, scale * my, scale * mz))
        own = M
        if general is not None:
            spin, rates, turns = zeros, zeros, b[BLOCK.rotor] != 0
            if turns:
                i = 6 * node
                spin = transposed_times(basis, (scale * rotor[i], scale * rotor[i + 1], scale * rotor[i + 2]))
                rates = transposed_times(basis, (scale * rotor[i + 3], scale * rotor[i + 4], scale * rotor[i + 5]))
                if normal is None:
                    D, own = gyrating(drag, spin), minus(M, rates)
            t = times_[node] if calls != 0 else 0.0
            forces = b[BLOCK.forces] + 144 * node if b[BLOCK.forces] != 0 else 0
            if b[BLOCK.spin] != 0:
                lift = (0.5 * spin_changes[node]) * J3
            call = (calls, (t, forces), room, R, reports or observed, turns, spin, rates, lift, exact)
        stalled, lost, used, residual, ds, after, a, moment, mu, lam = step(
            hs, s, extra, body, own, m, D, F, call, alive
        )
        # Bodies that cannot go on are noted before the step counts.
        a2 = dot(a, a)
        ahead, compensation, gap = advanced(p, c, a, 1.0 / (1.0 + a2))
        stalled = either(stalled, lost)
        fine = both(both(gap <= UNIT, 4.0 * a2 <= PI * PI), without(alive, stalled))
        bad = without(alive, fine)
        if any_of(bad):
            W = velocity(k, s)
            speed = h * root(dot(W, W))
            note(x, bad, stalled, 4.0 * a2 > PI * PI, calls, number, residual, speed, 2.0 * root(a2))
            alive = without(alive, bad)
            if not any_of(alive):
                break
        # What the step gives to the means and sums over the interval, and to what is observed.
        if reports or observed:
            add_to(x, WORK.sums + SUMS.mu, weight * mu)
            add_to(x, WORK.sums + SUMS.twist, 2.0 * dot(vector(x, WORK.body + BODY.axis, one), a))
            if heavy is not None and b[BLOCK.held] != 0:
                gravity = times(R, dead_mean(1.0 / (1.0 + a2), a, F))
                for i in range(3):
                    add_to(x, WORK.sums + SUMS.dead + i, weight * gravity[i])
            if observed:
                add_to(x, WORK.now + NODAL, -mu)
                integrate(x, one, 0.5 * h)
        if moved is not None and (reports or observed):
            work = 2.0 * dot(a, moment)
            add_to(x, WORK.sums + SUMS.work, work)
            add_to(x, WORK.observed + OBSERVATION.work, work)
            moment = times(R, moment)
            for i in range(3):
                add_to(x, WORK.sums + SUMS.moment + i, weight * moment[i])
        if reports:
            used = larger(used, load(x, (WORK.sums + SUMS.iterations) * n, one))
            store(x, (WORK.sums + SUMS.iterations) * n, used)
            if normal is not None:
                for i in range(6):
                    add_to(x, WORK.sums + SUMS.lam + i, weight * lam[i])
        # The next state.
        s, carry = summed(s, carry, ds)
        p, c, extra = ahead, compensation, after
        if observed:
            show(x, p, velocity(k, s), None if normal is None else extra)
            observe(x, one, normal)
            integrate(x, one, 0.5 * h)
        if observed and any_of(alive):
            extend(x, one, h)
        if number + 1 == stored[done + 1] and any_of(alive):
            done += 1
            show(x, p, velocity(k, s), None if normal is None else extra)
            write(b, x, n, done, first, last)
    keep(x, p, c, s, carry, extra, velocity(k, s))
    if b[BLOCK.leaves] != 0:
        write(b, x, n, done + 1, first, last)


@shared
def note(x, bad, stalled, turned, calls, number, residual, speed, turn):
    """Note why bodies cannot go on."""
    n, zero = lanes(residual), splat(0.0, residual)
    status = select(turned, zero + TURN, zero + BROKEN)
    status, turn = select(stalled, zero + STALLED, status), select(stalled, speed, turn)
    numbers = (status, zero + number, residual, turn)
    for i in range(4):
        before = load(x, (WORK.failure + i) * n, residual)
        store(x, (WORK.failure + i) * n, select(bad, numbers[i], before))
    if calls != 0:
        for l in range(n):
            called = abs(x[WORK.call * n + l]) + abs(x[(WORK.call + 1) * n + l]) + abs(x[(WORK.call + 2) * n + l])
            if x[WORK.failure * n + l] == STALLED and not called < 1e300:
                x[WORK.failure * n + l] = LOAD
