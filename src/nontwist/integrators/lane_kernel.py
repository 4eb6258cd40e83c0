"""The march of bodies in lanes over the grid: 16 at a time in, on by the steps of `lane_steps`, and out.

What remains of the last 16 repeats the last member. A lane that cannot go on rests until its neighbours are done, and
its member is NaN from there.
"""

from math import sqrt

import numpy as np

from ..geometry.compiled import inlined, kernel
from .lane_arrays import (
    BAD,
    BASIS,
    BODY,
    DAMPING,
    DEAD,
    DIRECTOR_STATE,
    FIRST,
    FORCES,
    FRAME,
    GONE,
    HEAVY,
    INCREMENT,
    LANES,
    MOVED,
    MOVING,
    OPEN,
    PULL,
    PUSHED,
    QUANTITIES,
    ROWS,
    SCALE,
    SPACE,
    STEADY,
    WORK,
    C,
    K,
    P,
    W,
    Y,
    any_of,
    body_at,
    euler_at,
    get,
    lanes,
    matrix_at,
    more_at,
    normal_at,
    put,
    put_vector,
    quaternion_at,
    vector,
)
from .lane_steps import (
    advance,
    advance_directors,
    left,
    newton,
    newton_directors,
    pull,
    pull_directors,
    right,
    solve,
    solve_directors,
    solve_heavy,
    solve_loaded_directors,
    solve_pushed,
)
from .lane_watch import integrate, observe, start_watching, widen
from .midpoint_kernel import (
    EPS,
    ITERATIONS,
    NAN,
    PI,
    add,
    attitude,
    axpy,
    column,
    cross,
    dot,
    of_body,
    scaled,
    times,
    transposed_times,
)

OK, TURN, STALLED, BROKEN = 0, 1, 2, 3


@kernel
def turn_moment(x, m0, m1, m2):
    """Set M of a moment along the moving directors, in body components."""
    for l in range(lanes(x)):
        m = scaled(get(x, SCALE, l), (m0, m1, m2))
        put_vector(x, MOVING, l, transposed_times(matrix_at(x, BASIS, l), m))


@kernel
def turn_space(x, m0, m1, m2):
    """Set f of a moment in space."""
    for l in range(lanes(x)):
        m = scaled(get(x, SCALE, l), (m0, m1, m2))
        put_vector(x, SPACE, l, transposed_times(attitude(quaternion_at(x, P, l)), m))


@kernel
def turn_dead(x):
    """Set the dead forces F_i in b."""
    for l in range(lanes(x)):
        R, dead = attitude(quaternion_at(x, P, l)), matrix_at(x, DEAD, l)
        put_vector(x, FORCES, l, transposed_times(R, dead[0]))
        put_vector(x, FORCES + 3 * LANES, l, transposed_times(R, dead[1]))
        put_vector(x, FORCES + 6 * LANES, l, transposed_times(R, dead[2]))


@inlined
def product(p, q):
    """Return the product of two quaternions, scalar first."""
    u, v = (p[1], p[2], p[3]), (q[1], q[2], q[3])
    w = add(axpy(p[0], v, scaled(q[0], u)), cross(u, v))
    return (p[0] * q[0] - dot(u, v), w[0], w[1], w[2])


@kernel
def gather(x, order, state, bodies, scales, sums, failures, first, last):
    """Fill the lanes with members; lanes beyond `last` repeat the one before it."""
    for l in range(lanes(x)):
        i = order[min(first + l, last - 1)]
        body, scale = (i if bodies.shape[0] > 1 else 0), scales[i if scales.shape[0] > 1 else 0]
        for k in range(state.shape[1]):
            put(x, P + LANES * k, l, state[i, k])
        for k in range(BODY):
            put(x, C + LANES * k, l, bodies[body, k])
        for k in range(9):
            x[DAMPING + LANES * k + l] *= scale
            put(x, FORCES + LANES * k, l, 0.0)
        x[SCALE + l], x[GONE + l], x[PULL + l], x[WORK + l] = scale, failures[i, 0], 0.0, 0.0
        put_vector(x, MOVING, l, (0.0, 0.0, 0.0))
        put_vector(x, SPACE, l, (0.0, 0.0, 0.0))
        put_vector(x, Y, l, (0.0, 0.0, 0.0))
        x[OPEN + l] = x[INCREMENT + l] = x[BAD + l] = 0.0
        if sums.shape[0] > 0:
            for k in range(4 * QUANTITIES):
                put(x, FIRST + LANES * k, l, sums[i, k])
            put(x, WORK, l, sums[i, 4 * QUANTITIES])


@kernel
def scatter(x, order, state, sums, first, last):
    """Put back what the members carry on."""
    for number in range(first, last):
        l, i = number - first, order[number]
        for k in range(state.shape[1]):
            state[i, k] = get(x, P + LANES * k, l)
        if sums.shape[0] > 0:
            for k in range(4 * QUANTITIES):
                sums[i, k] = NAN if get(x, GONE, l) != 0.0 else get(x, FIRST + LANES * k, l)
            sums[i, 4 * QUANTITIES] = get(x, WORK, l)


@kernel
def write(x, order, attitudes, velocities, k, first, last):
    """Write the states: quaternions of the body, scalar last, and W in body components; NaN where a run has failed.

    Of the two quaternions of an attitude the one that is nearer to the state stored before.
    """
    for number in range(first, last):
        l, i = number - first, order[number]
        if get(x, GONE, l) != 0.0:
            for j in range(4):
                attitudes[i, k, j] = NAN
            for j in range(3):
                velocities[i, k, j] = NAN
            continue
        b = quaternion_at(x, FRAME, l)
        p = product(quaternion_at(x, P, l), (b[0], -b[1], -b[2], -b[3]))
        before = attitudes[i, k - 1, 0] * p[1] + attitudes[i, k - 1, 1] * p[2] + attitudes[i, k - 1, 2] * p[3]
        sign = 1.0 if before + attitudes[i, k - 1, 3] * p[0] >= 0.0 else -1.0
        attitudes[i, k, 0], attitudes[i, k, 1], attitudes[i, k, 2] = sign * p[1], sign * p[2], sign * p[3]
        attitudes[i, k, 3] = sign * p[0]
        velocities[i, k, 0], velocities[i, k, 1], velocities[i, k, 2] = times(matrix_at(x, BASIS, l), vector(x, W, l))


@kernel
def write_normals(x, order, normals, k, first, last):
    """Write N of the body; NaN where a run has failed."""
    for number in range(first, last):
        l, i = number - first, order[number]
        B, N, gone = matrix_at(x, BASIS, l), normal_at(x, l), get(x, GONE, l) != 0.0
        M = of_body(B, N)
        M = of_body(B, (column(M, 0), column(M, 1), column(M, 2)))
        for j in range(3):
            for c in range(3):
                normals[i, k, j, c] = NAN if gone else M[j][c]


@kernel
def give_up(x, normals, order, failures, step, h, hs, first, last):
    """Note why lanes cannot go on, and let them rest: the open ones before they advance, the bad ones after it."""
    for l in range(LANES):
        stalled = get(x, OPEN, l) != 0.0
        if get(x, GONE, l) != 0.0 or not (stalled or get(x, BAD, l) != 0.0):
            continue
        status, residual, turn = BROKEN, NAN, NAN
        if stalled:
            w = vector(x, W, l)
            status, residual, turn = STALLED, left_over(x, l, normals, 0.5 * hs), h * sqrt(dot(w, w))
        elif 4.0 * get(x, INCREMENT, l) > PI * PI:
            status, residual, turn = TURN, 0.0, abs(h / hs) * 2.0 * sqrt(get(x, INCREMENT, l))
        if first + l < last:
            i = order[first + l]
            failures[i, 0], failures[i, 1], failures[i, 2], failures[i, 3] = status, step, residual, turn
        put(x, GONE, l, status)
        for k in range(DIRECTOR_STATE):
            x[P + LANES * k + l] = 1.0 if k == 0 else 0.0
        put_vector(x, Y, l, (0.0, 0.0, 0.0))
        x[OPEN + l] = x[BAD + l] = 0.0


@inlined
def left_over(x, l, normals, f):
    """Return the size of what is left of the equations in a lane, N m s."""
    w, y, M, more, F = vector(x, W, l), vector(x, Y, l), vector(x, MOVING, l), more_at(x, l), matrix_at(x, FORCES, l)
    k = vector(x, K, l)
    held = k[2] == 0.0
    if normals is not None:
        E, trace = euler_at(x, l)
        r = left(f, w, y, normal_at(x, l), E, trace, M, more, F, held)
    else:
        r = axpy(-1.0, y, right(f, body_at(x, l), add(w, y), M, more, F))
        r = (2.0 * r[0] / k[0], 2.0 * r[1] / k[1], 0.0 if held else 2.0 * r[2] / k[2])
    return abs(r[0]) + abs(r[1]) + (0.0 if held else abs(r[2]))


@kernel
def enter(quaternions, velocities, normals, bodies, fixed, state):
    """Set the states, in b, from the first of those stored: quaternions scalar last, W and N in body components.

    Round-off of N, and of W along a constrained axis, is taken away; for lie-midpoint all of the latter.
    """
    for i in range(state.shape[0]):
        b = i if bodies.shape[0] > 1 else 0
        q = (float(bodies[b, 20]), float(bodies[b, 21]), float(bodies[b, 22]), float(bodies[b, 23]))
        p = (quaternions[i, 0, 3], quaternions[i, 0, 0], quaternions[i, 0, 1], quaternions[i, 0, 2])
        state[i, 0], state[i, 1], state[i, 2], state[i, 3] = product(p, q)
        largest = 0.0
        for k in range(3):
            state[i, 4 + k] = 0.0
            for j in range(3):
                state[i, 4 + k] += bodies[b, 11 + 3 * j + k] * velocities[i, 0, j]
            largest = max(largest, abs(state[i, 4 + k]))
        if fixed and (normals is None or abs(state[i, 6]) <= 16.0 * EPS * largest):
            state[i, 6] = 0.0
        for k in range(7, state.shape[1]):
            state[i, k] = 0.0
        if normals is not None:
            for place in range(6):
                k, m = (place, place) if place < 3 else ((1, 2) if place == 3 else (0, 2) if place == 4 else (0, 1))
                total = 0.0
                for j in range(3):
                    for c in range(3):
                        total += bodies[b, 11 + 3 * j + k] * normals[i, 0, j, c] * bodies[b, 11 + 3 * c + m]
                state[i, 10 + place] = total if abs(total) > 16.0 * EPS * largest else 0.0


@kernel
def march(members, bodies, carried, out, normals, grid, loads, kind, begin, end):
    """March the members from number `begin` to `end` of an order over the nodes of `grid`, 16 at a time.

    ``members = (order, scales)``, scales (m or 1,); bodies (m or 1, BODY); ``carried = (state, sums, failures)``, state
    (m, STATE), sums (m, SUMS) where quantities are watched, else (0, SUMS), failures (m, 4): status, step, residual,
    turn; ``out = (attitudes, velocities)``, (m, k, 4) and (m, k, 3) at the steps `stored`; `normals` (m, k, 3, 3) for
    the director scheme, None for lie-midpoint; ``grid = (step, fractions, stored, first step, steps, stored so far)``;
    ``loads = (moving, space)``, (nodes, 3) each or (0, 3); `kind`: STEADY,
    MOVED, PUSHED or HEAVY, of the director scheme STEADY (no load), PUSHED or HEAVY.
    """
    (order, scales), (state, sums, failures), (moving, space) = members, carried, loads
    h, fractions, stored, first_step, steps, done = grid
    attitudes, velocities = out
    stages, watched = fractions.shape[0], sums.shape[0] > 0
    x = np.zeros(ROWS)
    for first in range(begin, end, LANES):
        last, node, k = min(first + LANES, end), 0, done
        gather(x, order, state, bodies, scales, sums, failures, first, last)
        if watched:
            if first_step == 0:
                start_watching(x, normals)
            else:
                observe(x, normals)
        for step in range(first_step, first_step + steps):
            for stage in range(stages):
                part = fractions[stage]
                hs = h * part
                if moving.shape[0] > 0:
                    turn_moment(x, moving[node, 0], moving[node, 1], moving[node, 2])
                if space.shape[0] > 0:
                    turn_space(x, space[node, 0], space[node, 1], space[node, 2])
                if kind == HEAVY:
                    turn_dead(x)
                if normals is not None:
                    if kind == STEADY:
                        solve_directors(x, hs)
                    else:
                        solve_loaded_directors(x, hs)
                elif kind == HEAVY:
                    solve_heavy(x, hs)
                elif kind == PUSHED:
                    solve_pushed(x, hs)
                elif kind == MOVED:
                    solve(x, hs)
                if (normals is not None or kind != STEADY) and any_of(x, OPEN):
                    for _ in range(ITERATIONS):
                        if normals is not None:
                            newton_directors(x, hs)
                        else:
                            newton(x, hs)
                        if not any_of(x, OPEN):
                            break
                    if any_of(x, OPEN):
                        give_up(x, normals, order, failures, step, h, hs, first, last)
                if watched:
                    integrate(x, 0.5 * hs)
                if normals is not None:
                    if watched:
                        pull_directors(x, hs, part)
                    advance_directors(x, hs)
                else:
                    if watched:
                        pull(x, hs, part)
                    advance(x, hs)
                if any_of(x, BAD):
                    give_up(x, normals, order, failures, step, h, hs, first, last)
                if watched:
                    observe(x, normals)
                    integrate(x, 0.5 * hs)
                node += 1
            if watched:
                widen(x, h)
            if step + 1 == stored[k + 1]:
                k += 1
                write(x, order, attitudes, velocities, k, first, last)
                if normals is not None:
                    write_normals(x, order, normals, k, first, last)
        scatter(x, order, state, sums, first, last)
