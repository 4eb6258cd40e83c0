"""The step of `lie_midpoint` with dissipation, for bodies without a constrained axis, and for every load.

In the notation of `lie_step`: Q = P + z the mean momentum, W_m = J⁻¹ Q, c the momentum of rotors, T = Q + c_m. The body
turns, and its momentum with it, by

    Ω = W_m + g T × W_m,    a = h Ω/2,    z = (h/2) [T × Ω + M - c' - C Ω + (I - â) f + ...]

with the moments of `lie_step` for this Ω: the impulses are what they were, so that π, or the total momentum, changes by
the impulse of the load alone. Without one, ``ΔK = 2 W_m·z = h W_m·(T × Ω) = -h g |T × W_m|²``. g is ``χh/tr J`` of
order 1, ``χh² |W_m|/tr J`` of order 2.
"""

from ..engine.called import derivatives, load_of_state, mean, moment_of_state
from ..engine.march import march
from ..engine.solving import CHORDS, ITERATIONS, advance, cancelling
from ..geometry.compiled import inlined, kernel
from ..geometry.elements import any_of, eight, root, select, splat
from ..geometry.tuples import (
    EPS,
    add,
    add_unit,
    axpy,
    chosen,
    cross,
    dot,
    each,
    inverse_of,
    minus,
    scaled,
    size,
    times,
    unit,
    unit_cross,
)
from .lie_step import FORESEEN, dead_moment, dead_rate, velocity

TINY = 1e-300


@inlined
def turning(h, body, T, W):
    """Return Ω, the factor g, and its derivative by |W|."""
    (e0, e1, e2), (first, second) = body[3], body[4]
    rate = 0.5 * h / (e0 + e1 + e2)  # h/tr J
    slope = rate * h * second
    g = rate * first + slope * root(dot(W, W))
    return axpy(g, cross(T, W), W), g, slope


@inlined
def torque(f, Q, Om, M, m, D, F):
    """Return G(Ω) + Q × Ω; rotors are part of M and D."""
    a = scaled(f, Om)
    g = add(cross(Q, Om), axpy(-1.0, times(D, Om), M))
    return add(add(g, dead_moment(F, a)), minus(m, cross(a, m)))


@inlined
def column_of(j, f, k, Q, T, W, turns, m, D, F, S):
    """Return the column j of the Jacobian of ``z - f torque``."""
    Om, g, slope = turns
    a, u = scaled(f, Om), cross(T, W)
    du = axpy(k[j], minus((0.0 * u[0], 0.0 * u[1], 0.0 * u[2]), unit_cross(j, T)), unit_cross(j, W))
    dg = slope * k[j] * W[j] / (root(dot(W, W)) + TINY)
    dOm = add_unit(j, k[j], axpy(g, du, scaled(dg, u)))
    dm = axpy(dOm[0], S[0], axpy(dOm[1], S[1], scaled(dOm[2], S[2])))
    d = add(unit_cross(j, Om), cross(Q, dOm))
    d = add(minus(d, times(D, dOm)), minus(dm, cross(a, dm)))
    d = axpy(-f, cross(dOm, m), d)
    dead = axpy(dOm[0], dead_rate(0, F, a), axpy(dOm[1], dead_rate(1, F, a), scaled(dOm[2], dead_rate(2, F, a))))
    d, e = axpy(f, dead, d), unit(j)
    return (e[0] - f * d[0], e[1] - f * d[1], e[2] - f * d[2])


@inlined
def step(h, P, extra, body, M, m, D, F, call, is_open):
    """Return what `lie_step.step` does."""
    zero, f, k = splat(0.0, h), 0.5 * h, body[0]
    z = (h * extra[0], h * extra[1], h * extra[2])
    lost, count, used, before, speed = zero > 1.0, 0, zero, zero, size(each(k, P))
    zeros, left_over, given = (zero, zero, zero), zero, m
    A = S = (zeros, zeros, zeros)
    while any_of(is_open) and count < ITERATIONS:
        Q = add(P, z)
        W, T = each(k, Q), add(Q, call[6])
        turns = turning(h, body, T, W)
        Om = turns[0]
        if call[0] != 0:
            state = moment_of_state(call, scaled(f, Om), Om)
            m = add(given, state)
            if count == 0 or count >= CHORDS:
                S = derivatives(call, f, False, Om, state)
        if count == 0 or count >= CHORDS:
            c0 = column_of(0, f, k, Q, T, W, turns, m, D, F, S)
            c1 = column_of(1, f, k, Q, T, W, turns, m, D, F, S)
            c2 = column_of(2, f, k, Q, T, W, turns, m, D, F, S)
            A = inverse_of(c0, c1, c2)
        r = minus(scaled(f, torque(f, Q, Om, M, m, D, F)), z)
        d = times(A, r)
        now, level = size(each(k, d)), EPS * (speed + size(each(k, z)))
        left_over, terms = size(r), size(z) + abs(f) * size(Q) * size(Om) + cancelling(f, Om, D, S)
        used = select(is_open, zero + (count + 1.0), used)
        here = z
        z, is_open, lost = advance(count, is_open, lost, z, d, now, before, level, left_over, terms)
        z = chosen(lost, here, z)  # the function is not called with what is no number
        before = now
        count += 1
    Q = add(P, z)
    Om, _, _ = turning(h, body, add(Q, call[6]), each(k, Q))
    a = scaled(f, Om)
    if call[0] != 0 and call[4]:
        m = add(given, load_of_state(call, moment_of_state(call, a, Om)))
    moment = add(mean(1.0 / (1.0 + dot(a, a)), a, axpy(-1.0, times(D, Om), M)), m)
    rate, last = scaled(1.0 / h, z), (extra[3], extra[4], extra[5])
    next_rate = add(scaled(3.0, minus(rate, last)), (extra[6], extra[7], extra[8]))
    next_rate = chosen(abs(f) * speed <= FORESEEN, next_rate, rate)
    return is_open, lost, used, 2.0 * left_over, scaled(2.0, z), next_rate + rate + last, a, moment, zero, None


@kernel
def dissipative_one(address):
    march(address, 0.0, step, velocity, None, 1, 1, 1, 1)


@kernel
def dissipative_eight(address):
    march(address, eight(), step, velocity, None, 1, 1, 1, 1)
