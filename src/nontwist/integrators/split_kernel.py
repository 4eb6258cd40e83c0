"""The compiled steps of `split` and their marches over the grid.

Body held about a principal axis (`march`). Vectors are tuples in the body frame, turned so that the constrained axis is
its third direction (`basis`). The state is the attitude as a quaternion p and the two momenta Π_⊥, a sum of increments
that is compensated (Kahan); the angular velocity W solves J_⊥ W = Π_⊥, by the factors G of ``J_⊥ = L D Lᵀ`` and not by
an inverse, which would cost a needle's energy as many digits as J_⊥ has condition. A free step turns by the exact
exponential, so its length does not matter. `state` holds p (4), Π_⊥ (2), its compensation (2), the change of W in the
last implicit step, per time (2), and the compensation of p (4).

Body without an axis (`march_free`). A step is half an exact free motion, a kick of the angular velocity at a fixed
attitude, half an exact free motion; a kick that depends on the velocity is the implicit midpoint rule for it. The frame
is that of the principal axes. `state` holds p (4), W (3), its compensation (3) and that of p (4): sums of increments,
each with the relative accuracy of round-off (`nontwist.exact.free_step`). So nothing that the exact
flow keeps drifts while a free motion is short, |λ h| <= 1/2; longer ones round like values of order 1.
"""

from math import sin, sqrt
from typing import Any, NamedTuple

import numpy as np

from ..engine.called import moment_at as called_at
from ..exact.free_constants import BAD_TIME, CONSTANTS
from ..exact.free_step import free_step
from ..geometry.compiled import inlined, kernel
from ..geometry.tuples import (
    EPS,
    NAN,
    add,
    add_unit,
    attitude,
    axpy,
    column,
    compensated,
    cross,
    dot,
    quaternion,
    rows,
    scaled,
    size,
    summed,
    times,
    transposed_times,
    turned_into,
    unit,
)

FARTHEST = 1e15  # rad a step, of which round-off leaves nothing
SMALLEST = 1e-290  # change of a velocity for a difference quotient, whose inverse is finite
ROUND_OFF = 16.0 * EPS
ITERATIONS = 50
OK, TURN, STALLED, BROKEN, LOAD = 0, 1, 2, 3, 4
R3, R15 = sqrt(3.0), sqrt(15.0)


class More(NamedTuple):
    """What makes a step implicit; None leaves it out of the compiled code."""

    dead: Any  # (3, 3) dead forces, rows
    damping: Any  # (3, 3) C
    space: Any  # (nodes, 3) moments in space
    basis: Any  # (3, 3) columns: the frame in body components


@inlined
def velocity(G, x, y):
    """Return W of Π_⊥ = (x, y); G holds 1/D1, L21, 1/D2."""
    w1 = G[2] * (y - G[1] * x)
    return (G[0] * x - G[1] * w1, w1, 0.0)


@inlined
def magnus(gauss, h, G, x, y, b1, b2, b3):
    """Return the rotation vector of a step, the change of Π_⊥ and the mean of Π·(W × n).

    Magnus expansion on Gauss nodes for Λ' = Λ Ŵ: the bracket of the expansion for Y' = A Y is the negative cross
    product here.
    """
    if gauss == 1:
        dx, dy = h * b1[0], h * b1[1]
        w1, mu = at_node(G, x + 0.5 * dx, y + 0.5 * dy)
        return scaled(h, w1), dx, dy, mu
    if gauss == 2:
        p, m = h * (0.25 + R3 / 6.0), h * (0.25 - R3 / 6.0)
        q = 0.25 * h
        w1, mu1 = at_node(G, x + q * b1[0] + m * b2[0], y + q * b1[1] + m * b2[1])
        w2, mu2 = at_node(G, x + p * b1[0] + q * b2[0], y + p * b1[1] + q * b2[1])
        return magnus_4(h, w1, w2), 0.5 * h * (b1[0] + b2[0]), 0.5 * h * (b1[1] + b2[1]), 0.5 * (mu1 + mu2)
    w1, mu1 = collocated(G, x, y, h, 5 / 36, 2 / 9 - R15 / 15, 5 / 36 - R15 / 30, b1, b2, b3)
    w2, mu2 = collocated(G, x, y, h, 5 / 36 + R15 / 24, 2 / 9, 5 / 36 - R15 / 24, b1, b2, b3)
    w3, mu3 = collocated(G, x, y, h, 5 / 36 + R15 / 30, 2 / 9 + R15 / 15, 5 / 36, b1, b2, b3)
    dx = h * (5 / 18 * (b1[0] + b3[0]) + 4 / 9 * b2[0])
    dy = h * (5 / 18 * (b1[1] + b3[1]) + 4 / 9 * b2[1])
    return magnus_6(h, w1, w2, w3), dx, dy, 5 / 18 * (mu1 + mu3) + 4 / 9 * mu2


@inlined
def magnus_4(h, w1, w2):
    return axpy(R3 / 12.0 * h * h, cross(w1, w2), scaled(0.5 * h, add(w1, w2)))


@inlined
def magnus_6(h, w1, w2, w3):
    a1 = scaled(h, w2)
    a2 = scaled(R15 / 3.0 * h, axpy(-1.0, w1, w3))
    a3 = scaled(10.0 / 3.0 * h, add(axpy(-2.0, w2, w3), w1))
    c1 = scaled(-1.0, cross(a1, a2))
    c2 = scaled(1.0 / 60.0, cross(a1, axpy(2.0, a3, c1)))
    left = axpy(-20.0, a1, axpy(-1.0, a3, c1))
    return axpy(-1.0 / 240.0, cross(left, add(a2, c2)), axpy(1.0 / 12.0, a3, a1))


@inlined
def collocated(G, x, y, h, a1, a2, a3, b1, b2, b3):
    """Return W and Π·(W × n) at a node of the Gauss method with three of them."""
    return at_node(G, x + h * (a1 * b1[0] + a2 * b2[0] + a3 * b3[0]), y + h * (a1 * b1[1] + a2 * b2[1] + a3 * b3[1]))


@inlined
def at_node(G, x, y):
    W = velocity(G, x, y)
    return W, x * W[1] - y * W[0]


@inlined
def exponential(turn):
    """Return (c - 1, v) of the quaternion (c, v) that turns by the rotation vector."""
    half = 0.5 * sqrt(dot(turn, turn))
    if half < 1e-2:
        h2 = half * half
        f = 0.5 * (1.0 - h2 / 6.0 * (1.0 - h2 / 20.0 * (1.0 - h2 / 42.0)))
    else:
        f = 0.5 * sin(half) / half
    quarter = sin(0.5 * half)
    return -2.0 * quarter * quarter, scaled(f, turn)


@inlined
def turned_on(p, c, less, v):
    """Return p (1 + less, v), of unit length to first order in its deviation, its compensation, and that deviation."""
    q = (p[1], p[2], p[3])
    gap = 1.0 - (p[0] * p[0] + dot(q, q))
    f, v = less + 0.5 * gap * (1.0 + less), scaled(1.0 + 0.5 * gap, v)
    d = add(axpy(f, q, scaled(p[0], v)), cross(q, v))
    p0, c0 = compensated(p[0], c[0], f * p[0] - dot(q, v))
    q, c = summed(q, (c[1], c[2], c[3]), d)
    return (p0, q[0], q[1], q[2]), (c0, c[0], c[1], c[2]), abs(gap)


@inlined
def turned(p, less, v):
    return turned_on(p, (0.0, 0.0, 0.0, 0.0), less, v)[0]


@inlined
def own_directors(basis, R):
    """Return the directors, one after the other, of the body whose turned frame has the attitude R."""
    d0, d1, d2 = times(basis, R[0]), times(basis, R[1]), times(basis, R[2])
    return (d0[0], d1[0], d2[0], d0[1], d1[1], d2[1], d0[2], d1[2], d2[2])


@inlined
def moment_at(function, more, t, p, turn, W, b, m):
    """Return the moments of dead forces and of the load in the frame at the middle of the step, turned by `turn`."""
    less, v = exponential(turn)
    R = attitude(turned(p, less, v))
    force = m
    if function is not None:
        force = add(force, called_at(function, t, own_directors(more.basis, R), times(R, W)))
    load = add(axpy(-1.0, times(more.damping, W), b), transposed_times(R, force))
    f0, f1, f2 = transposed_times(R, more.dead[0]), transposed_times(R, more.dead[1]), transposed_times(R, more.dead[2])
    dead = (f1[2] - f2[1], f2[0] - f0[2], f0[1] - f1[0])
    return dead, load, R


@inlined
def implicit(function, more, h, t, p, G, x, y, b, m, w0, w1):
    """Solve J_⊥ W = Π + h/2 M(Λ exp(h Ŵ/2), W) for the velocity at the middle; (w0, w1) is the first guess."""
    status, iteration, residual, previous, rate = STALLED, 0, 0.0, 1.0, 1.0
    j00, j01, j10, j11 = 1.0, 0.0, 0.0, 1.0
    while iteration < ITERATIONS:
        iteration += 1
        if not abs(h) * (abs(w0) + abs(w1)) <= FARTHEST:
            break
        r0, r1 = defect(function, more, h, t, p, G, x, y, b, m, w0, w1)
        residual = abs(r0) + abs(r1)
        if residual == 0.0:
            status = OK
            break
        if rate > 0.1:
            e = sqrt(EPS) * max(abs(w0) + abs(w1), residual, SMALLEST)
            a0, a1 = defect(function, more, h, t, p, G, x, y, b, m, w0 + e, w1)
            c0, c1 = defect(function, more, h, t, p, G, x, y, b, m, w0, w1 + e)
            j00, j10, j01, j11 = (a0 - r0) / e, (a1 - r1) / e, (c0 - r0) / e, (c1 - r1) / e
        if not residual < 1e300:
            status = LOAD
            break
        det = j00 * j11 - j01 * j10
        d0, d1 = -(j11 * r0 - j01 * r1) / det, -(j00 * r1 - j10 * r0) / det
        w0, w1 = w0 + d0, w1 + d1
        increment, level = abs(d0) + abs(d1), abs(w0) + abs(w1)
        if not increment < 1e300:
            break
        rate = increment / previous if iteration > 1 else 0.0
        if increment <= EPS * level or (rate > 0.5 and increment <= 1e-9 * level):
            status = OK
            break
        previous = increment
    return status, iteration, residual, w0, w1


@inlined
def defect(function, more, h, t, p, G, x, y, b, m, w0, w1):
    W = (w0, w1, 0.0)
    dead, load, _ = moment_at(function, more, t, p, scaled(0.5 * h, W), W, b, m)
    M = add(dead, load)
    V = velocity(G, x + 0.5 * h * M[0], y + 0.5 * h * M[1])
    return w0 - V[0], w1 - V[1]


@kernel
def march(state, function, more, body, grid, out, first, done, gauss):
    """March from the step number `first`; each of its parts has `gauss` nodes, one where the step is implicit.

    Returns the status, the number of the next step or of the one that failed, the stored intervals, the residual, the
    turn.
    """
    plane, loaded, moving, tilted, basis = body
    h, fractions, times_, stored = grid
    directors, velocities, multipliers, moments, works, iterations = out
    L = plane[0, 1] / plane[0, 0]
    G = (1.0 / plane[0, 0], L, 1.0 / (plane[1, 1] - L * plane[0, 1]))
    p = (float(state[0]), float(state[1]), float(state[2]), float(state[3]))
    x, y, cx, cy = float(state[4]), float(state[5]), float(state[6]), float(state[7])
    rate0, rate1 = float(state[8]), float(state[9])
    pc = (float(state[10]), float(state[11]), float(state[12]), float(state[13]))
    zero = (0.0, 0.0, 0.0)
    b1, b2, b3, m, dx, dy, turn, R = zero, zero, zero, zero, 0.0, 0.0, zero, attitude(p)
    stages, nodes = fractions.shape[0], times_.shape[0]
    weight = 1.0 / float(stored[done + 1] - stored[done])
    status, node, k, residual, count = OK, 0, first, 0.0, 0
    extra, space = None, moving
    if more is not None:
        extra, space = More(rows(more[0]), rows(more[1]), 0.0, rows(more[3])), more[2]
    while node < nodes:
        for stage in range(stages):
            part = float(fractions[stage])
            hs, part = h * part, part * weight
            if loaded:
                b1 = row(moving, node)
                if gauss > 1:
                    b2 = row(moving, node + 1)
                if gauss > 2:
                    b3 = row(moving, node + 2)
            W0, moment = velocity(G, x, y), zero
            if not abs(hs) * size(W0) <= FARTHEST:
                status = TURN
                break
            if more is None:
                turn, dx, dy, mu = magnus(gauss, hs, G, x, y, b1, b2, b3)
                mu += mean_third(gauss, b1, b2, b3)
                W = velocity(G, x + 0.5 * dx, y + 0.5 * dy)
                if loaded and (size(b1) + size(b2) + size(b3) > 0.0):
                    moment = moment_mean(gauss, hs, p, turn, G, x, y, b1, b2, b3)
                work = dx * W[0] + dy * W[1]
            else:
                m, t = row(space, node), float(times_[node])
                status, count, residual, w0, w1 = implicit(
                    function, extra, hs, t, p, G, x, y, b1, m, W0[0] + hs * rate0, W0[1] + hs * rate1
                )
                if status != OK:
                    break
                W = (w0, w1, 0.0)
                turn = scaled(hs, W)
                dead, load, R2 = moment_at(function, extra, t, p, scaled(0.5, turn), W, b1, m)
                moment = times(R2, load)
                dx, dy = hs * (dead[0] + load[0]), hs * (dead[1] + load[1])
                mu = (x + 0.5 * dx) * W[1] - (y + 0.5 * dy) * W[0] + dead[2] + load[2]
                rate0, rate1 = (w0 - W0[0]) / hs, (w1 - W0[1]) / hs
                work = hs * dot(W, load)
            less, v = exponential(turn)
            p, pc, gap = turned_on(p, pc, less, v)
            if not gap <= 1e-9:
                status, residual = BROKEN, gap
                break
            x, cx = compensated(x, cx, dx)
            y, cy = compensated(y, cy, dy)
            if more is not None or loaded or stage == stages - 1:
                R = attitude(p)
            multipliers[done, 0] += part * mu
            if more is not None or loaded:
                for i in range(3):
                    moments[done, i] += part * moment[i]
                works[done] += work
            iterations[done] = max(iterations[done], count)
            node += gauss
        if status != OK:
            break
        k += 1
        if k == stored[done + 1]:
            done += 1
            write(tilted, basis, directors, velocities, done, R, velocity(G, x, y))
            if done + 1 < stored.shape[0]:
                weight = 1.0 / float(stored[done + 1] - stored[done])
    state[0], state[1], state[2], state[3] = p
    state[4], state[5], state[6], state[7], state[8], state[9] = x, y, cx, cy, rate0, rate1
    state[10], state[11], state[12], state[13] = pc
    return status, k, done, residual, abs(h) * sqrt(dot(velocity(G, x, y), velocity(G, x, y)))


@inlined
def mean_third(gauss, b1, b2, b3):
    """Return the mean of the third components over the step, from its Gauss nodes."""
    if gauss == 1:
        return b1[2]
    if gauss == 2:
        return 0.5 * (b1[2] + b2[2])
    return 5 / 18 * (b1[2] + b3[2]) + 4 / 9 * b2[2]


@inlined
def moment_mean(gauss, h, p, turn, G, x, y, b1, b2, b3):
    """Return the mean of the moment in space, from the Gauss nodes of a step of the rotation vector `turn`."""
    if gauss == 1:
        return in_space(p, scaled(0.5, turn), b1)
    if gauss == 2:
        mean, slope, bend = scaled(0.5, add(b1, b2)), scaled(R3, axpy(-1.0, b1, b2)), scaled(0.0, b1)
        first = in_space(p, turn_to(2, 0.5 - R3 / 6, h, G, x, y, mean, slope, bend), b1)
        last = in_space(p, turn_to(2, 0.5 + R3 / 6, h, G, x, y, mean, slope, bend), b2)
        return scaled(0.5, add(first, last))
    slope, bend = scaled(R15 / 3, axpy(-1.0, b1, b3)), scaled(10 / 3, add(axpy(-2.0, b2, b1), b3))
    first = in_space(p, turn_to(3, 0.5 - R15 / 10, h, G, x, y, b2, slope, bend), b1)
    middle = in_space(p, turn_to(3, 0.5, h, G, x, y, b2, slope, bend), b2)
    last = in_space(p, turn_to(3, 0.5 + R15 / 10, h, G, x, y, b2, slope, bend), b3)
    return axpy(4 / 9, middle, scaled(5 / 18, add(first, last)))


@inlined
def turn_to(gauss, c, h, G, x, y, mean, slope, bend):
    """Return the rotation vector of the part [0, c h] of a step under the moment `mean` + `slope` s + `bend` s².

    s is the time from the middle of the step, as a fraction of it.
    """
    if gauss == 2:
        w1 = velocity_under(G, c * (0.5 - R3 / 6) - 0.5, h, x, y, mean, slope, bend)
        w2 = velocity_under(G, c * (0.5 + R3 / 6) - 0.5, h, x, y, mean, slope, bend)
        return magnus_4(c * h, w1, w2)
    w1 = velocity_under(G, c * (0.5 - R15 / 10) - 0.5, h, x, y, mean, slope, bend)
    w2 = velocity_under(G, c * 0.5 - 0.5, h, x, y, mean, slope, bend)
    w3 = velocity_under(G, c * (0.5 + R15 / 10) - 0.5, h, x, y, mean, slope, bend)
    return magnus_6(c * h, w1, w2, w3)


@inlined
def velocity_under(G, s, h, x, y, mean, slope, bend):
    a, b, d = h * (s + 0.5), 0.5 * h * (s * s - 0.25), h / 3.0 * (s * s * s + 0.125)
    dx, dy = a * mean[0] + b * slope[0] + d * bend[0], a * mean[1] + b * slope[1] + d * bend[1]
    return velocity(G, x + dx, y + dy)


@inlined
def in_space(p, turn, b):
    less, v = exponential(turn)
    return times(attitude(turned(p, less, v)), b)


@inlined
def write(tilted, basis, directors, velocities, k, R, W):
    """Write the directors as rows and their velocities ``Λ (W × e_i)``."""
    q0, q1, q2 = column(R, 0), column(R, 1), column(R, 2)
    v0, v1 = axpy(W[2], q1, scaled(-W[1], q2)), axpy(-W[2], q0, scaled(W[0], q2))
    v2 = axpy(W[1], q0, scaled(-W[0], q1))
    q, v = (q0, q1, q2), (v0, v1, v2)
    if tilted:
        turned_back = rows(basis)
        q, v = turned_into(turned_back, q), turned_into(turned_back, v)
    for j in range(3):
        directors[k, 0, j], directors[k, 1, j], directors[k, 2, j] = q[0][j], q[1][j], q[2][j]
        velocities[k, 0, j], velocities[k, 1, j], velocities[k, 2, j] = v[0][j], v[1][j], v[2][j]


@kernel
def march_free(state, function, body, grid, out, first, done):
    """March a body without an axis; `body` holds its principal moments, ascending, and the load.

    Returns what `march` does: numbers only. While Numba hands arrays back, Ctrl-C would become a SystemError.
    """
    principal, dead, damping, moving, space, basis = body
    h, fractions, times_, stored = grid
    directors, velocities, _, moments, works, iterations = out
    p, W, Wc, pc = free_state(state)
    inertia = (float(principal[0]), float(principal[1]), float(principal[2]))
    stages, nodes = fractions.shape[0], times_.shape[0]
    more = More(rows(dead), rows(damping), 0.0, rows(basis))
    weight = 1.0 / float(stored[done + 1] - stored[done])
    status, node, k, residual, working = OK, 0, first, 0.0, np.empty(CONSTANTS)
    while node < nodes:
        before = 0.0
        for stage in range(stages + 1):
            part = float(fractions[stage]) if stage < stages else 0.0
            bad, dW, less, v = free_step(inertia, W, 0.5 * h * (before + part), working)
            if bad != 0:
                status = TURN if bad == BAD_TIME else BROKEN
                break
            W, Wc = summed(W, Wc, dW)
            p, pc, gap = turned_on(p, pc, less, v)
            if not gap <= 1e-9:
                status, residual = BROKEN, gap
                break
            if stage == stages:
                break
            before, Q = part, attitude(p)
            hs, part = h * part, part * weight
            b, m, t = row(moving, node), row(space, node), float(times_[node])
            f0, f1, f2 = more.dead
            f0, f1, f2 = transposed_times(Q, f0), transposed_times(Q, f1), transposed_times(Q, f2)
            gravity = (f1[2] - f2[1], f2[0] - f0[2], f0[1] - f1[0])
            status, count, residual, load, dW = kick(function, more, hs, t, Q, inertia, W, gravity, b, m)
            if status != OK:
                break
            moment = times(Q, load)
            for i in range(3):
                moments[done, i] += part * moment[i]
            works[done] += hs * dot(axpy(0.5, dW, W), load)
            iterations[done] = max(iterations[done], count)
            W, Wc = summed(W, Wc, dW)
            node += 1
        if status != OK:
            break
        k += 1
        if k == stored[done + 1]:
            done += 1
            write(True, basis, directors, velocities, done, attitude(p), W)
            if done + 1 < stored.shape[0]:
                weight = 1.0 / float(stored[done + 1] - stored[done])
    state[0], state[1], state[2], state[3] = p
    state[4], state[5], state[6] = W
    state[7], state[8], state[9] = Wc
    state[10], state[11], state[12], state[13] = pc
    return status, k, done, residual, abs(h) * size(W)


@inlined
def free_state(s):
    p, W, Wc, _ = loaded_state(s)
    return p, W, Wc, (float(s[10]), float(s[11]), float(s[12]), float(s[13]))


@inlined
def kick(function, more, h, t, Q, inertia, W, gravity, b, m):
    """Return status, iterations, residual, the moment of the load in the body and the change y of W, ``J y = h M``.

    Newton's iteration; where W changes little or M hardly depends on it the matrix is taken as the identity. A change
    of y for a difference quotient is small beside W, and round-off of the residual small beside the change.
    """
    fixed = add(b, transposed_times(Q, m))
    c0, c1, c2 = unit(0), unit(1), unit(2)
    y, load, previous, residual, iteration = scaled(0.0, W), fixed, 1e300, size(W), 0
    while iteration < ITERATIONS and abs(h) * size(add(W, y)) <= FARTHEST:
        iteration += 1
        load, kicked = after_kick(function, more, h, t, Q, inertia, W, y, gravity, fixed)
        r = axpy(-1.0, kicked, y)
        before, residual = residual, size(r)
        if not residual < 1e300:
            return LOAD, iteration, residual, load, y
        if residual > 0.1 * before:
            e = sqrt(EPS) * max(size(add(W, y)), 1e-4 * residual, SMALLEST)
            for k in range(3):
                ahead = add_unit(k, e, y)
                _, there = after_kick(function, more, h, t, Q, inertia, W, ahead, gravity, fixed)
                c0, c1, c2 = c1, c2, scaled(1.0 / e, axpy(-1.0, r, axpy(-1.0, there, ahead)))
        d = solve(c0, c1, c2, r, False)
        y, increment = axpy(-1.0, d, y), size(d)
        level = size(add(W, y))
        if not increment < 1e300:
            break
        if increment <= EPS * level or (increment > 0.5 * previous and increment <= 1e-9 * level):
            return OK, iteration, residual, load, kicked
        previous = increment
    return STALLED, iteration, residual, load, y


@inlined
def after_kick(function, more, h, t, Q, inertia, W, y, gravity, fixed):
    """Return the moment of the load in the body at W + y/2, and the change of W that its kick makes."""
    Wm = axpy(0.5, y, W)
    load = axpy(-1.0, times(more.damping, Wm), fixed)
    if function is not None:
        load = add(load, transposed_times(Q, called_at(function, t, own_directors(more.basis, Q), times(Q, Wm))))
    M = add(load, gravity)
    return load, (h * M[0] / inertia[0], h * M[1] / inertia[1], h * M[2] / inertia[2])


@inlined
def solve(c0, c1, c2, b, fixed):
    """Solve ``c0 x0 + c1 x1 + c2 x2 = b``; with `fixed` the first two rows of it for x2 = 0."""
    if fixed:
        det = c0[0] * c1[1] - c0[1] * c1[0]
        f = 1.0 / det if det != 0.0 else NAN
        return (f * (c1[1] * b[0] - c1[0] * b[1]), f * (c0[0] * b[1] - c0[1] * b[0]), 0.0)
    n = cross(c1, c2)
    det = dot(c0, n)
    f = 1.0 / det if det != 0.0 else NAN
    return (f * dot(b, n), f * dot(b, cross(c2, c0)), f * dot(b, cross(c0, c1)))


@inlined
def row(values, node):
    k = node if values.shape[0] > 1 else 0
    return (float(values[k, 0]), float(values[k, 1]), float(values[k, 2]))


@kernel
def begin(q, v, basis, state, normal):
    """Write p, W and N of the directors and velocities given as rows; return the largest entry of N over that of V.

    Entries of N that are round-off of V become 0. The quaternion is Shepperd's.
    """
    B = rows(basis)
    C = (column(B, 0), column(B, 1), column(B, 2))
    D, V = turned_into(C, rows(q)), turned_into(C, rows(v))
    p = quaternion((column(D, 0), column(D, 1), column(D, 2)))
    state[0], state[1], state[2], state[3] = p
    V = (times(D, V[0]), times(D, V[1]), times(D, V[2]))
    state[4], state[5], state[6] = 0.5 * (V[1][2] - V[2][1]), 0.5 * (V[2][0] - V[0][2]), 0.5 * (V[0][1] - V[1][0])
    most, across = 0.0, 0.0
    for j in range(3):
        for k in range(3):
            normal[j, k] = 0.5 * (V[j][k] + V[k][j])
            most, across = max(most, abs(V[j][k])), max(across, abs(normal[j, k]))
    for j in range(3):
        for k in range(3):
            if abs(normal[j, k]) <= ROUND_OFF * most:
                normal[j, k] = 0.0
    return across / most if most > 0.0 else 0.0


@kernel
def states(state, normal, basis, directors, velocities):
    """Write the directors and velocities, one of each as rows, that `state` and `normal` hold."""
    p, W, _, _ = loaded_state(state)
    B, R, N = rows(basis), attitude(p), rows(normal)
    V = (
        (N[0][0], N[0][1] + W[2], N[0][2] - W[1]),
        (N[1][0] - W[2], N[1][1], N[1][2] + W[0]),
        (N[2][0] + W[1], N[2][1] - W[0], N[2][2]),
    )
    q = turned_into(B, (column(R, 0), column(R, 1), column(R, 2)))
    v = turned_into(B, (times(R, V[0]), times(R, V[1]), times(R, V[2])))
    for i in range(3):
        for j in range(3):
            directors[i, j], velocities[i, j] = q[i][j], v[i][j]


@inlined
def loaded_state(s):
    p = (float(s[0]), float(s[1]), float(s[2]), float(s[3]))
    W, Wc = (float(s[4]), float(s[5]), float(s[6])), (float(s[7]), float(s[8]), float(s[9]))
    return p, W, Wc, (float(s[10]), float(s[11]), float(s[12]))
