"""The steps of `split` and their compiled marches, one body at a time.

The frame b is that of the engine with the principal axes in ascending order, or with the constrained axis as its third
direction and J12 = 0. What is carried is the attitude as a quaternion p and the momentum P, W_i = P_i/J_i, both as sums
of increments that are compensated (Kahan): `extra` holds the compensation of p (4) and the change of P_⊥ in the last
implicit step, per time (2). A free motion turns by its exact quaternion, so its length does not matter.

Body held about a principal axis. A moment of the moving frame alone is taken on Gauss nodes, and nothing is solved; all
others at the middle Λ exp(h Ŵ/2) of the turn.

Body without an axis. A step is half an exact free motion, a kick of the momentum at a fixed attitude, half an exact
free motion. Each is an increment with the relative accuracy of round-off (`nontwist.exact.free_step`), so nothing that
the exact flow keeps drifts while a free motion is short, |λ h| <= 1/2; longer ones round like values of order 1.

The moments are those of `split_moments`.

From the step `ceased` to the step `resumed` a body moves freely. It then carries the state in which that motion began;
each state that is stored is evaluated from there, and that in which it ends.

What is observed is integrated over time by the values at the nodes of the load: Gauss nodes, or the middles of
substeps, which are symmetric in time and so have the order of the composition; in a free motion by four Gauss
nodes a step.
"""

from math import sqrt

import numpy as np

from ..engine.bodies import DRIVEN
from ..engine.lane import add_to, gather, keep, matrix, quaternion_at, scatter, show, vector, write
from ..engine.layout import BLOCK, BODY, NODAL, OBSERVATION, STATE, SUMS, WORK
from ..engine.march import FARTHEST, UNIT, note
from ..engine.observing import begin_observing, extend, observe
from ..geometry.compiled import inlined, kernel
from ..geometry.elements import doubles, integers, shifted
from ..geometry.tuples import (
    NAN,
    add,
    attitude,
    axpy,
    dot,
    each,
    scaled,
    size,
    summed,
    times,
)
from .composition import substeps
from .magnus import NODES
from .split_free import BAD_TIME, free_motion, free_step, free_until, set_origin
from .split_moments import along, held_step, moments_at, seen, solved
from .turning import exponential, turned, turned_on

INNER, OUTER = sqrt(3 / 7 - 2 / 7 * sqrt(6 / 5)), sqrt(3 / 7 + 2 / 7 * sqrt(6 / 5))
NODES_4 = (0.5 - 0.5 * OUTER, 0.5 - 0.5 * INNER, 0.5 + 0.5 * INNER, 0.5 + 0.5 * OUTER)
WEIGHTS_4 = ((18 - sqrt(30.0)) / 72, (18 + sqrt(30.0)) / 72, (18 + sqrt(30.0)) / 72, (18 - sqrt(30.0)) / 72)


@inlined
def freely(held, t, k, J, p, c, P, carry, working):
    """Return whether a free motion turns too far, the state after it, and how far p was from unit length."""
    if held is None:
        return gone(free_step(J, P, t, working), p, c, P, carry)
    W = each(k, P)
    p, c, gap = turned_on(p, c, *exponential(scaled(t, W)))
    return not abs(t) * size(W) <= FARTHEST, p, c, P, carry, gap


@inlined
def gone(step, p, c, P, carry):
    """Return what `freely` does, for a step of the free motion of a body without an axis."""
    status, dP, less, v = step
    p, c, gap = turned_on(p, c, less, v)
    P, carry = summed(P, carry, dP)
    return status == BAD_TIME, p, c, P, carry, gap


@inlined
def reached(held, motion, t, k, p, c, P, carry, working):
    """Return what `freely` does, for any time of the same motion; where there is no axis `free_motion` has begun it."""
    if held is None:
        return gone(free_until(motion, t, working), p, c, P, carry)
    return freely(held, t, k, P, p, c, P, carry, working)


@inlined
def tell(x, part, weight, mu, moment, work, used):
    """Add what a substep gives to the means and sums over the interval, and to what is observed."""
    add_to(x, WORK.sums + SUMS.mu, part * weight * mu)
    add_to(x, WORK.now + NODAL, -part * mu)
    for j in range(3):
        add_to(x, WORK.sums + SUMS.moment + j, part * weight * moment[j])
    add_to(x, WORK.sums + SUMS.work, work)
    add_to(x, WORK.observed + OBSERVATION.work, work)
    x[WORK.sums + SUMS.iterations] = max(x[WORK.sums + SUMS.iterations], float(used))


@inlined
def march(address, held, heavy, pushed):
    """March the members `begin` to `end` of the block's order over the nodes of its grid.

    What is None is left out of the compiled code: the constrained axis, dead forces, all loads but moments along the
    moving frame.
    """
    b = integers(address)
    x = doubles(b[BLOCK.workspace])
    for i in range(b[BLOCK.begin], b[BLOCK.end]):
        gather(b, x, 1, i, i + 1)
        if x[WORK.failure] == 0.0:
            march_body(b, x, i, held, heavy, pushed)
        scatter(b, x, 1, i, i + 1)


@inlined
def march_body(b, x, i, held, heavy, pushed):
    """March the body in the workspace, at the place i of the order; other arguments as of `march`."""
    reals, fractions, stored = doubles(b[BLOCK.step]), doubles(b[BLOCK.fractions]), integers(b[BLOCK.stored])
    h, gauss, observed, zero = reals[0], b[BLOCK.gauss], b[BLOCK.observed] != 0, (0.0, 0.0, 0.0)
    first, last, done, ceased = b[BLOCK.first], b[BLOCK.first] + b[BLOCK.steps], b[BLOCK.done], b[BLOCK.ceased]
    lengths = doubles(b[BLOCK.lengths])
    k, basis, scale = vector(x, WORK.body + BODY.k, 0.0), matrix(x, WORK.body + BODY.basis, 0.0), x[WORK.scale]
    e0, e1, e2 = vector(x, WORK.body + BODY.E, 0.0)
    J, working = (e1 + e2, e2 + e0, e0 + e1), shifted(x, WORK.constants)
    p, c = quaternion_at(x, WORK.state, 0.0), quaternion_at(x, WORK.state + STATE.c, 0.0)
    P, carry = vector(x, WORK.state + STATE.s, 0.0), vector(x, WORK.state + STATE.carry, 0.0)
    rate = (x[WORK.state + STATE.extra], x[WORK.state + STATE.extra + 1], 0.0)
    # M, m, D, dead: moments along the frame and in space, damping, dead forces; None where the form has none.
    M, m, D, dead, node = zero, None, None, None, 0
    calls, at = b[BLOCK.function] + b[BLOCK.generalised], b[BLOCK.workspace] + 8 * WORK.buffer
    acting = (b[BLOCK.function], b[BLOCK.generalised], b[BLOCK.terms], b[BLOCK.action], at)
    room, call = (shifted(x, WORK.call), shifted(x, WORK.buffer), basis, reals[1], scale, acting), None
    moving, space, times_ = doubles(b[BLOCK.moving]), doubles(b[BLOCK.space]), doubles(b[BLOCK.times])
    if heavy is not None:
        dead = matrix(x, WORK.body + BODY.dead, 0.0)
        if size(dead[0]) + size(dead[1]) + size(dead[2]) > 0.0:
            ceased = b[BLOCK.resumed]
    if pushed is not None:
        m, D = zero, matrix(x, WORK.body + BODY.damping, 0.0)
        call = (0, (0.0, 0), room)
    if observed and first == 0:
        show(x, p, each(k, P), None)
        observe(x, 0.0, None)
        begin_observing(x, 1)
    far, stalled, gap, residual, used, R = False, False, 0.0, NAN, 0, attitude(p)
    for number in range(first, min(last, ceased)):
        weight, before, stage = h / lengths[done], 0.0, 0
        while stage < b[BLOCK.stages]:
            part = fractions[stage]
            hs, mu = h * part, 0.0
            if b[BLOCK.moving] != 0:
                M = along(moving, node, scale, basis)
            if pushed is not None:
                if b[BLOCK.space] != 0:
                    m = (scale * space[3 * node], scale * space[3 * node + 1], scale * space[3 * node + 2])
                if calls != 0:
                    forces = b[BLOCK.forces] + 144 * node if b[BLOCK.forces] != 0 else 0
                    call = (calls, (times_[node], forces), room)
            if held is None:  # half a free motion, and with it the half that is left of the substep before
                far, p, c, P, carry, gap = freely(held, 0.5 * h * (before + part), k, J, p, c, P, carry, working)
                before, R = part, attitude(p)
            W = each(k, P)
            if held is not None:
                far = not abs(hs) * size(W) <= FARTHEST
            if far or not gap <= UNIT:
                break
            if held is not None and heavy is None and pushed is None:
                M2 = along(moving, node + 1, scale, basis) if gauss > 1 else M
                M3 = along(moving, node + 2, scale, basis) if gauss > 2 else M
                turn, dP, moment, work, mu = held_step(hs, gauss, k, p, P, M, M2, M3, x, observed)
            else:
                if held is None and pushed is None:
                    load, gravity = moments_at(R, W, M, m, D, dead, call)
                else:
                    y = zero if held is None else scaled(hs, each(k, rate))
                    found, used, residual, (_, load, gravity, R) = solved(held, hs, k, p, R, W, y, M, m, D, dead, call)
                    stalled = not found
                    if stalled:
                        break
                torque = add(load, gravity)
                dP = scaled(hs, torque)
                V = each(k, axpy(0.5, dP, P))
                turn, moment, work = scaled(hs, V), times(R, load), hs * dot(V, load)
                if held is not None:
                    mu = (P[0] + 0.5 * dP[0]) * V[1] - (P[1] + 0.5 * dP[1]) * V[0] + torque[2]
                    dP, rate = (dP[0], dP[1], 0.0), (0.5 * torque[0], 0.5 * torque[1], 0.0)
                if observed:
                    seen(x, p if held is None else turned(p, scaled(0.5, turn)), V, hs)
            if held is not None:
                less, v = exponential(turn)
                p, c, gap = turned_on(p, c, less, v)
                if not gap <= UNIT:
                    break
            P, carry = summed(P, carry, dP)
            tell(x, part, weight, mu, moment, work, used)
            if held is not None and heavy is not None:
                for j in range(3):
                    add_to(x, WORK.sums + SUMS.dead + j, part * weight * times(R, gravity)[j])
            node += gauss
            stage += 1
        if held is None and stage == b[BLOCK.stages]:
            far, p, c, P, carry, gap = freely(held, 0.5 * h * before, k, J, p, c, P, carry, working)
        if stalled or far or not gap <= UNIT:
            speed, left_over = abs(h) * size(each(k, P)), residual if stalled else gap
            note(x, True, stalled, far, calls, number, left_over, speed, speed)
            break
        if observed:
            show(x, p, each(k, P), None)
            observe(x, 0.0, None)
            extend(x, 0.0, h)
        if number + 1 == stored[done + 1]:
            done += 1
            show(x, p, each(k, P), None)
            write(b, x, 1, done, i, i + 1)
    if x[WORK.failure] == 0.0 and last > ceased:
        p, c, P, carry = coast(b, x, i, held, k, J, p, c, P, carry, done, ceased, working)
    keep(x, p, c, P, carry, (rate[0], rate[1], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), each(k, P))
    if b[BLOCK.leaves] != 0:
        write(b, x, 1, done + 1, i, i + 1)


@inlined
def coast(b, x, i, held, k, J, p, c, P, carry, done, ceased, working):
    """Evaluate the free motion that begins with the step `ceased`; return the state at the end of the march."""
    h, stored, observed = doubles(b[BLOCK.step])[0], integers(b[BLOCK.stored]), b[BLOCK.observed] != 0
    lengths = doubles(b[BLOCK.lengths])
    at, last, W = max(b[BLOCK.first], ceased), b[BLOCK.first] + b[BLOCK.steps], each(k, P)
    mu = 0.0 if held is None else P[0] * W[1] - P[1] * W[0]
    motion = None
    if held is None:
        motion = free_motion(J, P, working)
        set_origin(motion, working)
    if reached(held, motion, h * float(b[BLOCK.resumed] - ceased), k, p, c, P, carry, working)[0]:
        note(x, True, False, True, 0, at, NAN, NAN, NAN)
        return p, c, P, carry
    while at < last:
        until = min(stored[done + 1], last)
        add_to(x, WORK.sums + SUMS.mu, h * float(until - at) / lengths[done] * mu)
        if observed:
            for number in range(at - ceased, until - ceased):
                for j in range(4):
                    t = h * (float(number) + NODES_4[j])
                    _, q, _, Q, _, _ = reached(held, motion, t, k, p, c, P, carry, working)
                    seen(x, q, each(k, Q), h * WEIGHTS_4[j])
                _, q, _, Q, _, _ = reached(held, motion, h * float(number + 1), k, p, c, P, carry, working)
                show(x, q, each(k, Q), None)
                observe(x, 0.0, None)
                add_to(x, WORK.now + NODAL, -mu)
                extend(x, 0.0, h)
        if until == stored[done + 1]:
            done += 1
            _, q, _, Q, _, _ = reached(held, motion, h * float(until - ceased), k, p, c, P, carry, working)
            show(x, q, each(k, Q), None)
            write(b, x, 1, done, i, i + 1)
        at = until
    if last == b[BLOCK.resumed] or b[BLOCK.leaves] != 0:
        _, p, c, P, carry, _ = reached(held, motion, h * float(last - ceased), k, p, c, P, carry, working)
    return p, c, P, carry


@kernel
def free(address):
    march(address, None, None, None)


@kernel
def free_heavy(address):
    march(address, None, 1, None)


@kernel
def free_any(address):
    march(address, None, 1, 1)


@kernel
def held(address):
    march(address, 1, None, None)


@kernel
def held_heavy(address):
    march(address, 1, 1, None)


@kernel
def held_any(address):
    march(address, 1, 1, 1)


def stages(order, form):
    """Return the fractions of substeps and the nodes of the load; Gauss nodes for moments along the moving frame."""
    return GAUSS[order] if form == DRIVEN else substeps(order, form)


GAUSS = {order: (np.ones(1), np.array(NODES[order // 2 - 1][: order // 2])) for order in (2, 4, 6)}
FREE = (free, free, free, free, free_heavy, free_any, free_any)
HELD = (held, held, held, held, held_heavy, held_any, held_any)
