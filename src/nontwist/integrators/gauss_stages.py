"""The stages of a step of `gauss`, for one body and for bodies in lanes: their values, and the iteration for them.

The unknowns of a step are the increments ``L_j = h b_j F_j`` of the momentum P at its s stages, and those of vectors g
that stand still in space, ``g' = g × W``, seen from the body: none, the vertical, or all three axes of b at the
beginning of the step. They lie in memory, ``y[(component * WIDTH + stage) * lanes + lane]``. So one text serves both
kinds of element: for one body an element of stages, read at once; for bodies in lanes an element of bodies, stage by
stage. Each number of a body is made by the same operations in the same order in both.

An iteration evaluates all stages, Y_i = y_n + Σ μ_ij L_j, and takes L = h b F(Y) for the next L. A body is done where
the increments of L are round-off, or have stopped falling and are small; it then keeps its L, whatever its neighbours
do. To look at the increments takes as long as to make them. So with many stages a step first takes as many iterations
unseen as the step before took, less `SEEN`: one too many does no harm.

The velocity of a needle about its length is P/J with J small, and has the round-off of all P. Where that is more than
`NEEDLE`, L comes as near to ``h b F(Y)`` as that and no nearer, and K would change by as much. Newton's iteration
leaves a fraction of the last change of P, so such a body is given to it, with this L, unless L stands still exactly.

With few stages at large steps L comes to a standstill, or alternates between two values, within the round-off of the
equations. Of the values within that reach it is those with some rounding errors that stop an iteration, so their mean
is not zero: with one stage at a radian a step K grows by 1e-19 of itself a step, with three by 2e-20, always the same
way. What is one iteration away from an L that did not come about so has no such preference. So up to `SHY` stages the L
of a body that was not done quickly is changed by some round-off, and iterated once or twice more. What is added is
without a preference itself, and known to a run that resumes: what the compensated sums of the other components of P
have left over. Needles are left alone, as what is added would be their spin.
"""

from ..engine.called import found, state_called
from ..geometry.compiled import inlined, shared
from ..geometry.elements import (
    any_of,
    both,
    either,
    fused,
    lanes,
    largest,
    load,
    select,
    splat,
    store,
    without,
)
from ..geometry.tuples import (
    EPS,
    add,
    axpy,
    cross,
    dot,
    each,
    larger,
    minus,
    scaled,
    size,
    times,
    transposed_times,
)
from .gauss_layout import STAGES, TABLE, WIDTH

FALLING, GROWING, PATIENCE = 0.5, 8.0, 12  # how increments must fall in two iterations, may grow in one at first
EARLY = 3  # iterations; from rest, a moment acts on P, then on g, then on P again: increments grow as they like
FEW, MANY = (0.02, 0.002), (0.1, 0.01)  # increments that are small enough, now and next; up to 4 stages, above
SEEN = 4.0  # last iterations that are looked at
SHY, QUICK, SHAKEN = 3, 8.0, 8.0  # stages; iterations; what the sums have left is multiplied by
ITERATIONS, SMALL, ROUGH, NEEDLE, LOST, TINY = 100, 1e4, 16.0, 3e4, 1e300, 1e-300
INFINITE = float("inf")
FAINT = 1e-280  # square of a vector that has no direction any more


@inlined
def parts(s, one, wide):
    """Return in how many parts the stages of a step are evaluated."""
    return s if lanes(wide) == lanes(one) else 1


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
    """Set the components c, c + 1, c + 2 at stage i."""
    n = lanes(one)
    store(y, (c * WIDTH + i) * n, v[0])
    store(y, ((c + 1) * WIDTH + i) * n, v[1])
    store(y, ((c + 2) * WIDTH + i) * n, v[2])


@inlined
def rows_at(y, c, i, one, wide):
    """Return three vectors from component c on at the stages of part i."""
    return (
        stages_at(y, c, i, one, wide),
        stages_at(y, c + 3, i, one, wide),
        stages_at(y, c + 6, i, one, wide),
    )


@inlined
def put_rows(y, c, i, one, C):
    """Set three vectors from component c on at stage i."""
    put_at(y, c, i, one, C[0])
    put_at(y, c + 3, i, one, C[1])
    put_at(y, c + 6, i, one, C[2])


@inlined
def collocated(y, c, base, i, coefficients, table, s, one, wide, part):
    """Return ``base + Σ μ_ij L_j`` of part i, for the components c, c + 1, c + 2; even and odd j are summed apart."""
    n, even = lanes(one), splat(0.0, wide)
    x0, x1, x2, z0, z1, z2 = even, even, even, even, even, even
    for j in range(0, s - 1, 2):
        m = load(table, coefficients + WIDTH * j + i, part)
        x0 = fused(m, load(y, (c * WIDTH + j) * n, one), x0)
        x1 = fused(m, load(y, ((c + 1) * WIDTH + j) * n, one), x1)
        x2 = fused(m, load(y, ((c + 2) * WIDTH + j) * n, one), x2)
        m = load(table, coefficients + WIDTH * (j + 1) + i, part)
        z0 = fused(m, load(y, (c * WIDTH + j + 1) * n, one), z0)
        z1 = fused(m, load(y, ((c + 1) * WIDTH + j + 1) * n, one), z1)
        z2 = fused(m, load(y, ((c + 2) * WIDTH + j + 1) * n, one), z2)
    if s % 2 == 1:
        m = load(table, coefficients + WIDTH * (s - 1) + i, part)
        x0 = fused(m, load(y, (c * WIDTH + s - 1) * n, one), x0)
        x1 = fused(m, load(y, ((c + 1) * WIDTH + s - 1) * n, one), x1)
        x2 = fused(m, load(y, ((c + 2) * WIDTH + s - 1) * n, one), x2)
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


@inlined
def moments_at(call, R, C, W):
    """Return what is called at the rows C and the velocity W.

    These are the moment of the load, as seen at the beginning of the step, and the torque of potentials.
    """
    q = (transposed_times(C, R[0]), transposed_times(C, R[1]), transposed_times(C, R[2]))
    zero, room = 0.0 * W[0], call[2]
    state_called(call, R, q, times(C, W), (zero, zero, zero))
    if room[5][1] != 0:
        return transposed_times(R, found(call, 3, W[0])), transposed_times(room[2], found(call, 6, W[0]))
    return transposed_times(R, found(call, 0, W[0])), (zero, zero, zero)


@inlined
def node_of(call, j):
    """Return the call at the node of stage j."""
    calls, node, times_, room, forces, (orbit, _, table, length), _ = call
    t = times_[node + j]
    if orbit != 0.0:  # the frame of the rows is that of the beginning of the step
        t = t - table[TABLE.nodes + j] * length
    return (calls, (t, forces + 144 * (node + j) if forces != 0 else 0), room)


@inlined
def turning(C, W, call):
    """Return the velocity that the rows C turn with: W, less that of an orbit ``n o`` that they are seen from."""
    orbit, o = call[5][0], call[5][1]
    if orbit != 0.0:
        return axpy(-orbit * o[0], C[0], axpy(-orbit * o[1], C[1], axpy(-orbit * o[2], C[2], W)))
    return W


@inlined
def drawn(C, f):
    """Return ``C⁻¹ f``."""
    n = cross(C[1], C[2])
    inner = axpy(f[1], cross(C[2], C[0]), scaled(f[2], cross(C[0], C[1])))
    return scaled(1.0 / dot(C[0], n), axpy(f[0], n, inner))


@shared
def call_at(y, i, count, k, R, call, one):
    """Call what depends on the state at the stages i, ..., i + count - 1; the load is kept as seen at the beginning."""
    for j in range(i, i + count):
        C, W = rows_at(y, STAGES.rows, j, one, one), each(k, stages_at(y, STAGES.P, j, one, one))
        f, held = moments_at(node_of(call, j), R, C, W)
        put_at(y, STAGES.called, j, one, f)
        if call[3][5][1] != 0:
            put_at(y, STAGES.held, j, one, held)
            f = add(f, held)
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
    if call[6]:
        own = add(own, cross(stages_at(y, STAGES.rotor, i, one, wide), W))
    e = axes(one)
    c0 = collocated(y, 3, e[0], i, coefficients, table, s, one, wide, part)
    c1 = collocated(y, 6, e[1], i, coefficients, table, s, one, wide, part)
    c2 = collocated(y, 9, e[2], i, coefficients, table, s, one, wide, part)
    if call[0] != 0:
        put_at(y, STAGES.P, i, one, Q)
        put_rows(y, STAGES.rows, i, one, (c0, c1, c2))
        call_at(y, i, s if lanes(wide) > lanes(one) else 1, k, R, call, one)
    f = add(stages_at(y, STAGES.space, i, one, wide), stages_at(y, STAGES.called, i, one, wide))
    push = drawn((c0, c1, c2), f)
    dead = add(cross(K[0], c0), add(cross(K[1], c1), cross(K[2], c2)))
    if call[3][5][1] != 0:
        dead = add(dead, stages_at(y, STAGES.held, i, one, wide))
    return Q, W, (c0, c1, c2), add(add(add(torque, own), dead), push), own, push


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
def progress(count, seen, s, is_open, now, before, earlier, rough):
    """Return the masks of bodies that take this iterate, remain open, are near, and are not for fixed points.

    `seen` is how many iterations before this one were looked at, less than 0 where this one is not either. `now` is the
    size of the increments in round-off of the velocity, `before` and `earlier` those of the last two iterations:
    increments may turn as they shrink. What is left after a body is done would add up to a drift, so it is to be small
    beside round-off; `rough` is the round-off of the equations. Near are needles within it.
    """
    takes = both(is_open, either(now <= LOST, seen < 0.0))
    worse, near = without(is_open, takes), now < 0.0
    is_open = takes
    if count > 0:
        done = both(now <= (FEW[0] if s <= 4 else MANY[0]), seen > 0.0)
        done = either(done, both(now * now <= (FEW[1] if s <= 4 else MANY[1]) * before, seen > 1.0))
        done = either(done, both(both(now <= rough, now >= earlier), seen > 2.0))
        near = both(both(is_open, done), both(rough > NEEDLE, now > 0.0))
        is_open = without(is_open, done)
        if count > EARLY:
            grown = now > GROWING * before
            if count > PATIENCE:
                grown = either(grown, now > FALLING * earlier)
            grown = without(both(is_open, both(grown, seen > 0.0)), now <= SMALL + rough)
            worse = either(worse, grown)
            is_open = without(is_open, grown)
    return takes, is_open, near, worse


@inlined
def cleared(y, bodies, s, one, wide):
    """Set the increments of P to zero, for bodies whose mask is set."""
    if any_of(bodies):
        for k in range(3):
            for i in range(parts(s, one, wide)):
                at = (k * WIDTH + i) * lanes(one)
                old = load(y, at, wide)
                store(y, at, select(bodies, splat(0.0, wide), old))


@inlined
def shaken(y, carry, takes, s, one, wide):
    """Add some round-off to the increments of P, for bodies whose mask is set: what the last sum of P has left."""
    n = lanes(one)
    for c in range(3):
        d = select(takes, SHAKEN * carry[(c + 1) % 3], splat(0.0, one))
        for i in range(parts(s, one, wide)):
            store(y, (c * WIDTH + i) * n, load(y, (c * WIDTH + i) * n, wide) + d)


@shared
def iterated(y, h, table, s, body, P, carry, D, K, g0, R, call, is_open, unseen, one, wide, part, moved, heavy, pushed):
    """Iterate L; return the mask of bodies that are for Newton's iteration, and the iterations of each.

    Of these needles and bodies that took too many iterations keep their L, and L is zero where it does not contract.
    The first iterations, as many as `unseen`, are not looked at.
    """
    zero, (k, _, free, _) = splat(0.0, one), body
    hard, before, used, count, speed = zero > 1.0, splat(INFINITE, one), zero, 0, size(each(k, P))
    earlier, rough = before, ROUGH * (1.0 + h * size(P) * larger(larger(k[0], k[1]), k[2]))
    never, last = hard, 0
    slow = without(is_open, rough > NEEDLE) if s <= SHY else never
    soonest = -largest(-unseen, 0.0)  # the least of all lanes
    while True:
        if last == 0 and count >= ITERATIONS:
            hard, is_open = either(hard, is_open), never
        if not any_of(is_open):
            is_open = without(both(slow, used > QUICK), hard)
            if last > 0 or not any_of(is_open):
                break
            shaken(y, carry, is_open, s, one, wide)
            last = count + (2 if s == 1 else 1)
        coefficients = TABLE.guess if count == 0 else TABLE.mu
        change, reach, turn = zero, zero, zero
        for i in range(parts(s, one, wide)):
            b = h * load(table, TABLE.weights + i, part)
            _, W, C, torque, _, _ = stage(
                y, i, coefficients, table, s, body, P, D, K, g0, R, call, one, wide, part, moved, heavy, pushed
            )
            new = (b * torque[0], b * torque[1], free * (b * torque[2]))
            if pushed is not None:
                new = (new[0], new[1], new[2] + load(y, (STAGES.lift * WIDTH + i) * lanes(one), wide))
            d = apart(y, 0, STAGES.ahead, i, one, wide, new)
            if count >= soonest:
                change = larger(change, peak(size(each(k, d)), one))
                reach = larger(reach, largest(size(each(k, new)), one))
            if pushed is not None:
                V = turning(C, W, call)
                d0 = apart(y, 3, STAGES.ahead + 3, i, one, wide, scaled(b, cross(C[0], V)))
                d1 = apart(y, 6, STAGES.ahead + 6, i, one, wide, scaled(b, cross(C[1], V)))
                d2 = apart(y, 9, STAGES.ahead + 9, i, one, wide, scaled(b, cross(C[2], V)))
                if count >= soonest:
                    turn = larger(turn, peak(size(d0) + size(d1) + size(d2), one))
            elif heavy is not None:
                d0 = apart(y, 3, STAGES.ahead + 3, i, one, wide, scaled(b, cross(C, W)))
                if count >= soonest:
                    turn = larger(turn, peak(size(d0), one))
        used, takes, seen = select(is_open, used + 1.0, used), is_open, zero + count - unseen
        if count >= soonest:
            now = larger(change / (EPS * (speed + reach) + TINY), turn * (1.0 / EPS))
            takes, is_open, near, worse = progress(count, seen, s, is_open, now, before, earlier, rough)
            hard = either(hard, either(near, worse))
            if last > 0:
                is_open = takes if count + 1 < last else never
            earlier = select(seen > 0.0, before, earlier)
            before = select(seen > 0.0, now, before)
        if lanes(wide) == lanes(one):
            taken(y, 0, STAGES.ahead, 12 if pushed is not None else 6 if heavy is not None else 3, takes, s, one, wide)
        if count >= soonest:
            cleared(y, worse, s, one, wide)
        count += 1
    return hard, used
