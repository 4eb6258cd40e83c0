"""The step of `lie_midpoint` for the momentum, in a frame in which its equations are short.

The body is written in a frame b of its own: the principal axes where it has no constraint, else a frame whose third
direction is the constrained axis and with J12 = 0. The unknown is half the change of the momentum, ``P_{n+1} = P_n +
2 z``; with Q = P_n + z the momentum of the step, Ω its velocity (Ω_i = Q_i/J_i, Ω_3 = 0 under the constraint), Q̃ = JΩ
(Q itself but for Q̃_3 = J31 Ω1 + J32 Ω2 under the constraint) and a = h Ω/2 the equations of `lie_midpoint` read

    z = (h/2) [Q̃ × Ω + G(Ω)],        G = M - C Ω + (I - â) f + (I - s a aᵀ) Σ e_i × (I - â) F_i,  s = 1/(1 + |a|²),

M the moment given in the moving frame, C damping, f = Λ_nᵀ m what is given in space or by a function of the state, F_i
= Λ_nᵀ f^i the dead forces. Under the constraint z_3 = 0, and the third line gives μ. With a prescribed spin c, of an
axis that is principal, P_3 = J3 c and Ω_3 = Q_3/J3 as of a free body, ``z_3 = J3 (c_{n+1} - c_n)/2`` is known, and
``μ`` is less by J3 Δc/h. The momentum and not W is the
unknown since the rounded (J2 - J3)/J1 of the equations for W would be felt as a moment: Q × Ω has no component along
Q, whatever 1/J_i has been rounded to, so |π| does not drift, and π = ΛP does not turn.

The first guess of z/h is the value at this step of the parabola through the last three, which leaves two iterations as
a rule. Of a body whose constrained axis is principal, Q̃ × Ω is along the axis; under moments M alone z is explicit, the
first two components of (h/2) M (`explicit_step`).
"""

from ..engine.called import derivatives, load_of_state, mean, moment_of_state
from ..engine.march import march
from ..engine.solving import CHORDS, ITERATIONS, advance, cancelling
from ..geometry.compiled import inlined, kernel
from ..geometry.elements import any_of, eight, fused, select, splat
from ..geometry.tuples import (
    EPS,
    add,
    add_unit,
    axpy,
    chosen,
    column,
    cross,
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
    unit_cross,
)

FORESEEN = 0.5  # rad in half a step


@inlined
def torque(f, body, Q, M, m, D, F):
    """Return G(Ω) + Q̃ × Ω; what is None is left out."""
    k, off = body[0], body[1]
    Om = each(k, Q)
    if D is not None:
        Q = (Q[0], Q[1], Q[2] + off[0] * Om[0] + off[1] * Om[1])
    g, a = cross(Q, Om), scaled(f, Om)
    if M is not None:
        g = add(g, M if D is None else axpy(-1.0, times(D, Om), M))
    if F is not None:
        g = add(g, dead_moment(F, a))
    if m is not None:
        g = add(g, minus(m, cross(a, m)))
    return g


@inlined
def right(f, body, Q, M, m, D, F):
    """Return the right-hand side of ``z = ...``."""
    g = torque(f, body, Q, M, m, D, F)
    return (f * g[0], f * g[1], f * body[2] * g[2])


@inlined
def right_column(j, f, body, Q, Om, m, D, F, S):
    """Return the column j of the Jacobian of ``z - right``; S holds the columns of dm/dΩ."""
    k, off, free = body[0], body[1], body[2]
    a, zero = scaled(f, Om), splat(-0.0, f)  # -0 + x is x, and costs nothing
    dG = (zero, zero, zero)
    if F is not None:
        dG = scaled(f, dead_rate(j, F, a))
    if m is not None:
        dG = axpy(-f, unit_cross(j, m), dG)
    if D is not None:
        dG = add(minus(dG, column(D, j)), minus(S[j], cross(a, S[j])))
        slant = (off[0] if j == 0 else off[1]) if j < 2 else splat(0.0, f)
        dG = axpy(slant, unit_cross(2, Om), dG)
        Q = (Q[0], Q[1], Q[2] + off[0] * Om[0] + off[1] * Om[1])
    g = axpy(k[j], minus(dG, unit_cross(j, Q)), unit_cross(j, Om))
    e = unit(j)
    return (e[0] - f * g[0], e[1] - f * g[1], e[2] - f * free * g[2])


@inlined
def inverse(f, body, Q, m, D, F, S):
    """Return the inverse of the Jacobian of ``z - right``, rows."""
    k, free = body[0], body[2]
    Om = each(k, Q)
    if m is None and F is None:
        u, v, w = f * (k[2] - k[1]), f * (k[0] - k[2]), f * free * (k[1] - k[0])
        a01, a02, a10 = u * Q[2], u * Q[1], v * Q[2]
        a12, a20, a21 = v * Q[0], w * Q[1], w * Q[0]
        n = (fused(-a12, a21, 1.0), fused(a02, a21, a01), fused(a01, a12, a02))
        d = 1.0 / fused(-a20, n[2], fused(-a10, n[1], n[0]))
        return (
            scaled(d, n),
            scaled(d, (fused(a12, a20, a10), fused(-a02, a20, 1.0), fused(a02, a10, a12))),
            scaled(d, (fused(a10, a21, a20), fused(a01, a20, a21), fused(-a01, a10, 1.0))),
        )
    c0 = right_column(0, f, body, Q, Om, m, D, F, S)
    c1 = right_column(1, f, body, Q, Om, m, D, F, S)
    c2 = right_column(2, f, body, Q, Om, m, D, F, S)
    return inverse_of(c0, c1, c2)


@inlined
def dead_moment(F, a):
    """Return ``(I - â) Σ M e_i × F_i = (I - s a aᵀ) k`` with ``k = Σ e_i × (F_i - a × F_i)``."""
    k = minus(first_moment(F), dead_turning(F, a))
    return axpy(-dot(a, k) / (1.0 + dot(a, a)), a, k)


@inlined
def dead_rate(j, F, a):
    """Return the derivative of `dead_moment` by a_j."""
    s, trace = 1.0 / (1.0 + dot(a, a)), F[0][0] + F[1][1] + F[2][2]
    k, dk = minus(first_moment(F), dead_turning(F, a)), add_unit(j, -trace, F[j])
    c, dc = s * dot(a, k), s * (k[j] + dot(a, dk))
    return add_unit(j, -c, axpy(2.0 * s * c * a[j] - dc, a, dk))


@inlined
def dead_turning(F, a):
    """Return ``Σ e_i × (a × F_i) = tr(F) a - Fᵀ a``."""
    return axpy(F[0][0] + F[1][1] + F[2][2], a, scaled(-1.0, transposed_times(F, a)))


@inlined
def explicit_step(h, P, extra, body, M, m, D, F, call, is_open):
    """Take the step of a body whose constrained axis is principal, under moments along its frame: z = h M/2."""
    zero, f = splat(0.0, h), 0.5 * h
    never, zeros = zero > 1.0, (zero, zero, zero)
    z = zeros if M is None else (f * M[0], f * M[1], zero)
    Q = add(P, z)
    Om = each(body[0], Q)
    a, mu, moment = scaled(f, Om), cross(Q, Om)[2], zeros
    if M is not None:
        moment, mu = mean(1.0 / (1.0 + dot(a, a)), a, M), mu + M[2]
    return never, never, zero, zero, scaled(2.0, z), extra, a, moment, mu, None


@inlined
def step(h, P, extra, body, M, m, D, F, call, is_open):
    """Return the masks of open and lost bodies, iterations, residual, change of P, rates, a, moment in b, μ, no λ.

    `extra` holds the first guess of the rate z/h, and the rates of the last two steps. The guess is the last rate where
    the body turns by more than `FORESEEN` in half a step.
    """
    zero, f, k = splat(0.0, h), 0.5 * h, body[0]
    z = (h * extra[0], h * extra[1], h * extra[2])
    lost, count, used, before, speed = zero > 1.0, 0, zero, zero, size(each(k, P))
    zeros, left_over, given = (zero, zero, zero), zero, m
    A = S = (zeros, zeros, zeros)
    while any_of(is_open) and count < ITERATIONS:
        Q = add(P, z)
        if call is not None and call[0] != 0:
            Om = each(k, Q)
            state = moment_of_state(call, scaled(f, Om), Om)
            m = add(given, state)
            if count == 0 or count >= CHORDS:
                S = derivatives(call, f, False, Om, state)
        if count == 0 or count >= CHORDS:
            A = inverse(f, body, Q, m, D, F, S)
        r = minus(right(f, body, Q, M, m, D, F), z)
        if call is not None:
            r = (r[0], r[1], r[2] + call[8])
        d = times(A, r)
        now, level = size(each(k, d)), EPS * (speed + size(each(k, z)))
        left_over, terms = size(r), size(z) + abs(f) * size(Q) * size(each(k, Q))
        if D is not None:
            terms = terms + cancelling(f, each(k, Q), D, S)
        used = select(is_open, zero + (count + 1.0), used)
        here = z
        z, is_open, lost = advance(count, is_open, lost, z, d, now, before, level, left_over, terms)
        if call is not None and call[0] != 0:  # the function is not called with what is no number
            z = chosen(lost, here, z)
        before = now
        count += 1
    Q = add(P, z)
    Om = each(k, Q)
    a = scaled(f, Om)
    moment = zeros
    if M is not None:
        s, own, pushed = 1.0 / (1.0 + dot(a, a)), M, m
        if D is not None:
            if call is not None and call[0] != 0 and call[4]:
                total = moment_of_state(call, a, Om)
                m = add(given, total)
                pushed = add(given, load_of_state(call, total))
            own = axpy(-1.0, times(D, Om), M)
        moment = mean(s, a, own)
        if m is not None:
            moment = add(moment, pushed)
    mu = torque(f, body, Q, M, m, D, F)[2]
    if D is not None:
        mu = mu - (body[1][0] * k[0] * z[0] + body[1][1] * k[1] * z[1]) / f - call[8] / f
    rate, last = scaled(1.0 / h, z), (extra[3], extra[4], extra[5])
    next_rate = add(scaled(3.0, minus(rate, last)), (extra[6], extra[7], extra[8]))
    next_rate = chosen(abs(f) * speed <= FORESEEN, next_rate, rate)
    return is_open, lost, used, 2.0 * left_over, scaled(2.0, z), next_rate + rate + last, a, moment, mu, None


@inlined
def velocity(k, P):
    """Return W of the momentum."""
    return each(k, P)


@kernel
def steady_one(address):
    march(address, 0.0, explicit_step, velocity, None, None, None, None, None)


@kernel
def driven_one(address):
    march(address, 0.0, explicit_step, velocity, None, 1, None, None, None)


@kernel
def free_one(address):
    march(address, 0.0, step, velocity, None, None, None, None, None)


@kernel
def moved_one(address):
    march(address, 0.0, step, velocity, None, 1, None, None, None)


@kernel
def heavy_one(address):
    march(address, 0.0, step, velocity, None, 1, 1, None, None)


@kernel
def pushed_one(address):
    march(address, 0.0, step, velocity, None, 1, None, 1, None)


@kernel
def any_one(address):
    march(address, 0.0, step, velocity, None, 1, 1, 1, 1)


@kernel
def steady_eight(address):
    march(address, eight(), explicit_step, velocity, None, None, None, None, None)


@kernel
def driven_eight(address):
    march(address, eight(), explicit_step, velocity, None, 1, None, None, None)


@kernel
def free_eight(address):
    march(address, eight(), step, velocity, None, None, None, None, None)


@kernel
def moved_eight(address):
    march(address, eight(), step, velocity, None, 1, None, None, None)


@kernel
def heavy_eight(address):
    march(address, eight(), step, velocity, None, 1, 1, None, None)


@kernel
def pushed_eight(address):
    march(address, eight(), step, velocity, None, 1, None, 1, None)


@kernel
def any_eight(address):
    march(address, eight(), step, velocity, None, 1, 1, 1, 1)


ONE = (steady_one, driven_one, free_one, moved_one, heavy_one, pushed_one, any_one)
EIGHT = (steady_eight, driven_eight, free_eight, moved_eight, heavy_eight, pushed_eight, any_eight)
