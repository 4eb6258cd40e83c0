"""The step of `lie_midpoint` for the momentum, in a frame in which its equations are short.

The body is written in a frame b of its own: the principal axes where it has no constraint, else a frame whose third
direction is the constrained axis and with J12 = 0. The unknown is half the change of the momentum, ``P_{n+1} = P_n +
2 z``; with Q = P_n + z the momentum of the step, Ω its velocity (Ω_i = Q_i/J_i, Ω_3 = 0 under the constraint), Q̃ = JΩ
(Q itself but for Q̃_3 = J31 Ω1 + J32 Ω2 under the constraint) and a = h Ω/2 the equations of `lie_midpoint` read

    z = (h/2) [Q̃ × Ω + G(Ω)],        G = M - C Ω + (I - â) f + (I - s a aᵀ) Σ e_i × (I - â) F_i,  s = 1/(1 + |a|²),

M the moment given in the moving frame, C damping, f = Λ_nᵀ m what is given in space or by a function of the state, F_i
= Λ_nᵀ f^i the dead forces. Under the constraint z_3 = 0, and the third line gives μ. The momentum and not W is the
unknown since the rounded (J2 - J3)/J1 of the equations for W would be felt as a moment: Q × Ω has no component along
Q, whatever 1/J_i has been rounded to, so |π| does not drift, and π = ΛP does not turn.
"""

from ..engine.called import derivatives, mean, moment_of_state
from ..engine.march import march
from ..engine.solving import CHORDS, ITERATIONS, progress
from ..geometry.compiled import inlined, kernel
from ..geometry.elements import any_of, eight, select, splat
from ..geometry.tuples import (
    EPS,
    add,
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


@inlined
def torque(f, body, Q, M, m, D, F):
    """Return G(Ω) + Q̃ × Ω; what is None is left out."""
    k, off, _, _ = body
    Om = each(k, Q)
    if m is None and F is None:
        g = cross(Q, Om)
        return g if M is None else add(g, M)
    a = scaled(f, Om)
    if m is None:
        return add(add(cross(Q, Om), M), dead_moment(F, a))
    g = cross((Q[0], Q[1], Q[2] + off[0] * Om[0] + off[1] * Om[1]), Om)
    g = add(g, axpy(-1.0, times(D, Om), M))
    return add(add(g, dead_moment(F, a)), minus(m, cross(a, m)))


@inlined
def right(f, body, Q, M, m, D, F):
    """Return the right-hand side of ``z = ...``."""
    g = torque(f, body, Q, M, m, D, F)
    return (f * g[0], f * g[1], f * body[2] * g[2])


@inlined
def right_column(j, f, body, Q, Om, m, D, F, S):
    """Return the column j of the Jacobian of ``z - right``; S holds the columns of dm/dΩ."""
    k, off, free, _ = body
    e = unit(j)
    if m is None:
        a = scaled(f, Om)
        g = axpy(k[j], add(scaled(-1.0, unit_cross(j, Q)), scaled(f, dead_rate(F, a, e))), unit_cross(j, Om))
    else:
        a, slant = scaled(f, Om), (off[0] if j == 0 else off[1]) if j < 2 else splat(0.0, f)
        q = (Q[0], Q[1], Q[2] + off[0] * Om[0] + off[1] * Om[1])
        g = axpy(k[j] * slant, unit_cross(2, Om), axpy(-k[j], unit_cross(j, q), unit_cross(j, Om)))
        dG = axpy(f, minus(dead_rate(F, a, e), unit_cross(j, m)), scaled(-1.0, column(D, j)))
        g = axpy(k[j], add(dG, minus(S[j], cross(a, S[j]))), g)
    return (e[0] - f * g[0], e[1] - f * g[1], e[2] - f * free * g[2])


@inlined
def inverse(f, body, Q, m, D, F, S):
    """Return the inverse of the Jacobian of ``z - right``, rows."""
    k, _, free, _ = body
    Om = each(k, Q)
    if m is None and F is None:
        g = f * free
        a01, a02 = f * (Om[2] - k[1] * Q[2]), f * (k[2] * Q[1] - Om[1])
        a10, a12 = f * (k[0] * Q[2] - Om[2]), f * (Om[0] - k[2] * Q[0])
        a20, a21 = g * (Om[1] - k[0] * Q[1]), g * (k[1] * Q[0] - Om[0])
        n = (1.0 - a12 * a21, a01 + a02 * a21, a02 + a01 * a12)
        d = 1.0 / (n[0] - a10 * n[1] - a20 * n[2])
        return (
            scaled(d, n),
            scaled(d, (a10 + a12 * a20, 1.0 - a02 * a20, a12 + a02 * a10)),
            scaled(d, (a20 + a10 * a21, a21 + a01 * a20, 1.0 - a01 * a10)),
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
def dead_rate(F, a, e):
    """Return the derivative of `dead_moment` in a along e."""
    s = 1.0 / (1.0 + dot(a, a))
    k, dk = minus(first_moment(F), dead_turning(F, a)), scaled(-1.0, dead_turning(F, e))
    c, dc = s * dot(a, k), s * (dot(e, k) + dot(a, dk))
    return axpy(-c, e, axpy(2.0 * s * c * dot(a, e) - dc, a, dk))


@inlined
def dead_turning(F, a):
    """Return ``Σ e_i × (a × F_i) = tr(F) a - Fᵀ a``."""
    return axpy(F[0][0] + F[1][1] + F[2][2], a, scaled(-1.0, transposed_times(F, a)))


@inlined
def steady_step(h, P, extra, body, M, m, D, F, call, is_open):
    """Take the step of a body whose momentum stands still: no load acts, and its constrained axis is principal."""
    zero = splat(0.0, h)
    nothing = (zero, zero, zero)
    never, Om = zero > 1.0, each(body[0], P)
    return never, never, zero, zero, nothing, extra, scaled(0.5 * h, Om), nothing, cross(P, Om)[2], None


@inlined
def step(h, P, extra, body, M, m, D, F, call, is_open):
    """Return the masks of open and lost bodies, iterations, residual, change of P, rate, a, moment in b, μ, no λ."""
    zero, f, k = splat(0.0, h), 0.5 * h, body[0]
    z = (h * extra[0], h * extra[1], h * extra[2])
    lost, count, used, before = zero > 1.0, 0, zero, zero
    nothing, left_over, given = (zero, zero, zero), zero, m
    A = S = (nothing, nothing, nothing)
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
        d = times(A, r)
        now, level = size(each(k, d)), EPS * size(each(k, P)) + EPS * size(each(k, z))
        left_over, terms = size(r), size(z) + abs(f) * size(Q) * size(each(k, Q))
        used = select(is_open, zero + (count + 1.0), used)
        takes, is_open, lost = progress(count, is_open, lost, now, before, level, left_over, terms)
        z, before = chosen(takes, add(z, d), z), now
        count += 1
    Q = add(P, z)
    Om = each(k, Q)
    a = scaled(f, Om)
    moment = nothing
    if M is not None:
        s, own = 1.0 / (1.0 + dot(a, a)), M
        if m is not None:
            if call is not None and call[0] != 0:
                m = add(given, moment_of_state(call, a, Om))
            own = axpy(-1.0, times(D, Om), M)
        moment = mean(s, a, own)
        if m is not None:
            moment = add(moment, m)
    mu = torque(f, body, Q, M, m, D, F)[2]
    if m is not None:
        mu = mu - (body[1][0] * k[0] * z[0] + body[1][1] * k[1] * z[1]) / f
    rate = (z[0] / h, z[1] / h, z[2] / h, zero, zero, zero)
    return is_open, lost, used, 2.0 * left_over, scaled(2.0, z), rate, a, moment, mu, None


@inlined
def velocity(k, P):
    """Return W of the momentum."""
    return each(k, P)


@kernel
def steady_one(address):
    march(address, 0.0, steady_step, velocity, None, None, None, None)


@kernel
def free_one(address):
    march(address, 0.0, step, velocity, None, None, None, None)


@kernel
def moved_one(address):
    march(address, 0.0, step, velocity, None, 1, None, None)


@kernel
def heavy_one(address):
    march(address, 0.0, step, velocity, None, 1, 1, None)


@kernel
def any_one(address):
    march(address, 0.0, step, velocity, None, 1, 1, 1)


@kernel
def steady_eight(address):
    march(address, eight(), steady_step, velocity, None, None, None, None)


@kernel
def free_eight(address):
    march(address, eight(), step, velocity, None, None, None, None)


@kernel
def moved_eight(address):
    march(address, eight(), step, velocity, None, 1, None, None)


@kernel
def heavy_eight(address):
    march(address, eight(), step, velocity, None, 1, 1, None)


@kernel
def any_eight(address):
    march(address, eight(), step, velocity, None, 1, 1, 1)


ONE = (steady_one, free_one, moved_one, heavy_one, any_one)
EIGHT = (steady_eight, free_eight, moved_eight, heavy_eight, any_eight)
