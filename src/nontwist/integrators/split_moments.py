"""The moments of the substeps of `split`, and the changes that they make.

A moment that depends on the velocity, or on the turn that it makes, is found by Newton's iteration for half the change
of W,

    y = (h/2) J⁻¹ M(W + y).
"""

from math import sqrt

from ..engine.called import parts_of
from ..engine.lane import show
from ..engine.march import FARTHEST
from ..engine.observing import integrate, observe
from ..geometry.compiled import inlined
from ..geometry.tuples import (
    EPS,
    add,
    add_unit,
    attitude,
    axpy,
    dot,
    each,
    first_moment,
    inverse_of,
    minus,
    scaled,
    size,
    times,
    transposed_times,
    unit,
)
from .magnus import NODES, WEIGHTS, magnus, turn_to, velocity
from .turning import turned

SMALLEST = 1e-290  # change of a velocity for a difference quotient, whose inverse is finite
ITERATIONS = 50


@inlined
def moments_at(R, W, b, m, D, dead, call):
    """Return the moments at the attitude R of the load, and of dead forces and potentials; what is None is left out."""
    load, held = b, (0.0, 0.0, 0.0)
    if m is not None:
        load = add(load, axpy(-1.0, times(D, W), transposed_times(R, m)))
        if call[0] != 0:
            own, held = parts_of(call, R, R, W, (0.0, 0.0, 0.0))
            load = add(load, own)
    if dead is None:
        return load, held
    F = (transposed_times(R, dead[0]), transposed_times(R, dead[1]), transposed_times(R, dead[2]))
    if m is not None and call[2][5][1] != 0:
        return load, add(first_moment(F), held)
    return load, first_moment(F)


@inlined
def after(held, h, k, p, R, W, y, b, m, D, dead, call):
    """Return what the moments at the velocity W + y make of y, the moments, and the attitude where they act."""
    V = add(W, y)
    if held is not None:
        R = attitude(turned(p, scaled(0.5 * h, V)))
    load, gravity = moments_at(R, V, b, m, D, dead, call)
    return scaled(0.5 * h, each(k, add(load, gravity))), load, gravity, R


@inlined
def solved(held, h, k, p, R, W, y, b, m, D, dead, call):
    """Return whether y is found, the iterations, the residual, and what `after` returns.

    Where W changes little or M hardly depends on it the matrix is taken as the identity. A change of y for a difference
    quotient is small beside W, and round-off of the residual small beside the change.
    """
    e0, e1, e2 = unit(0), unit(1), unit(2)
    inverse, previous, residual, count, found = (e0, e1, e2), 1e300, size(W), 0, False
    there = after(held, h, k, p, R, W, y, b, m, D, dead, call)
    while abs(h) * size(add(W, y)) <= FARTHEST:
        count += 1
        r = minus(y, there[0])
        before, residual = residual, size(r)
        if not residual < 1e300:
            break
        if residual > 0.1 * before:
            e = sqrt(EPS) * max(size(add(W, y)), 1e-4 * residual, SMALLEST)
            c0, c1, c2 = e0, e1, e2
            for j in range(2 if held is not None else 3):
                ahead = add_unit(j, e, y)
                c = minus(ahead, after(held, h, k, p, R, W, ahead, b, m, D, dead, call)[0])
                c0, c1, c2 = c1, c2, scaled(1.0 / e, minus(c, r))
            inverse = inverse_of(c0, c1, c2) if held is None else inverse_of(c1, c2, c0)
        d = times(inverse, r)
        y, now = minus(y, d), size(d)
        level = size(add(W, y))
        found = now <= EPS * level or (now > 0.5 * previous and now <= 1e-9 * level)
        if found or count == ITERATIONS or not now < 1e300:
            break
        previous = now
        there = after(held, h, k, p, R, W, y, b, m, D, dead, call)
    return found, count, residual, there


@inlined
def along(moving, node, scale, basis):
    """Return the moment along the moving frame at a node, in b."""
    mx, my, mz = moving[3 * node], moving[3 * node + 1], moving[3 * node + 2]
    return transposed_times(basis, (scale * mx, scale * my, scale * mz))


@inlined
def held_step(h, gauss, k, p, P, b1, b2, b3, x, observed):
    """Take the step of a held body under moments along the moving frame: turn, ΔP, moment in space, work, μ."""
    turn, dx, dy, w1, w2, w3, mu = magnus(gauss, h, k, P[0], P[1], b1, b2, b3)
    moment = (0.0, 0.0, 0.0)
    for j in range(gauss):
        B, W = (b1, w1) if j == 0 else ((b2, w2) if j == 1 else (b3, w3))
        weight = WEIGHTS[gauss - 1][j]
        if observed or size(B) > 0.0:
            inside = turned(p, turn_to(gauss, NODES[gauss - 1][j], turn, h, k, P[0], P[1], b1, b2, b3))
            moment = axpy(weight, times(attitude(inside), B), moment)
            if observed:
                seen(x, inside, W, h * weight)
    work = dot((dx, dy, 0.0), velocity(k, P[0] + 0.5 * dx, P[1] + 0.5 * dy))
    return turn, (dx, dy, 0.0), moment, work, mu


@inlined
def seen(x, p, W, weight):
    """Take the state (p, W) into the integrals over time of what is observed."""
    show(x, p, W, None)
    observe(x, 0.0, None)
    integrate(x, 0.0, weight)
