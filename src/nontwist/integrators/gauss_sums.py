"""What a step of `gauss` takes from the stages that have been found: sums over them, impulse, statistics."""

from ..engine.lane import put_vector
from ..engine.layout import OBSERVATION, WORK
from ..engine.observing import integrate, observe_at
from ..geometry.compiled import shared
from ..geometry.elements import lanes, largest, load, root, splat, store
from ..geometry.tuples import add, cross, dot, first_moment, larger, scaled, times, transposed_times
from .gauss_layout import STAGES, TABLE, WIDTH
from .gauss_stages import parts, put_at, put_rows, rows_at, stage, stages_at, taken, total, turning


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
        held = body[2] * (b * torque[2])
        if pushed is not None:
            held = held + load(y, (STAGES.lift * WIDTH + i) * lanes(one), wide)
        put_at(y, STAGES.ahead, i, one, (b * torque[0], b * torque[1], held))
        if pushed is not None:
            V = turning(C, W, call)
            put_at(y, STAGES.ahead + 3, i, one, scaled(b, cross(C[0], V)))
            put_at(y, STAGES.ahead + 6, i, one, scaled(b, cross(C[1], V)))
            put_at(y, STAGES.ahead + 9, i, one, scaled(b, cross(C[2], V)))
        elif heavy is not None:
            put_at(y, STAGES.ahead + 3, i, one, scaled(b, cross(C, W)))
        put_at(y, STAGES.sums, i, one, (b * torque[2], b * power, b * root(dot(W, W))))
        put_at(y, STAGES.sums + 3, i, one, scaled(b, W))
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
def dead_impulse(y, h, table, s, one, wide, part, F):
    """Return the integral over the step of the moment of dead forces F in space, as seen at its beginning."""
    for i in range(parts(s, one, wide)):
        b, C = h * load(table, TABLE.weights + i, part), rows_at(y, STAGES.rows, i, one, wide)
        M = first_moment((transposed_times(C, F[0]), transposed_times(C, F[1]), transposed_times(C, F[2])))
        put_at(y, STAGES.sums + 3, i, one, scaled(b, times(C, M)))
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
