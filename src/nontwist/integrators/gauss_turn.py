"""The turn of a step of `gauss`: the rows of the axes at its stages, and the quaternion from its start to its end.

Where the momentum is known at all stages, alone or with one direction in space, the rows follow from linear equations,
``c_k' = c_k × W``; their iteration is that of `gauss_stages`. Where one direction is known at both ends, two angles are
as well, and the third is a sum over the stages (`gauss`).
"""

from math import sin

from ..geometry.compiled import inlined, shared
from ..geometry.elements import (
    any_of,
    either,
    lanes,
    load,
    root,
    select,
    shifted,
    splat,
    store,
)
from ..geometry.tuples import (
    EPS,
    add,
    attitude,
    cross,
    dot,
    larger,
    product,
    scaled,
    size,
)
from .gauss_layout import STAGES, TABLE, WIDTH
from .gauss_newton_step import rows_by_elimination
from .gauss_stages import (
    FAINT,
    INFINITE,
    ITERATIONS,
    ROUGH,
    TINY,
    apart,
    axes,
    collocated,
    parts,
    peak,
    progress,
    put_at,
    put_rows,
    stages_at,
    taken,
    total,
)


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
        takes, is_open, _, worse = progress(count, zero + count, s, is_open, now, before, earlier, rough)
        hard = either(hard, worse)
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
    stages, at the components from c on. A turn so faint that its square is lost is none.
    """
    for i in range(parts(s, one, wide)):
        b, W = h * load(table, TABLE.weights + i, part), stages_at(y, STAGES.W, i, one, wide)
        put_at(y, STAGES.sums, i, one, scaled(b, W))
    w = total(y, STAGES.sums, s, one)
    g0, g1 = scaled(f, g0), scaled(f, g1)
    d = select(dot(w, w) > FAINT, 1.0 / (root(dot(w, w)) + TINY), splat(0.0, one))
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
