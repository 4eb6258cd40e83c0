"""The step of `energy_momentum`, in a frame in which its equations are short.

The frame b is that of `lie_midpoint`, so E has the entries E13 and E23 beside its diagonal, under the constraint alone.
With Ω = W + y and the notation of `energy_momentum` the unknown y solves

    r(y) = J y - z + h/2 [τ Ω - W × EΩ - N E Ω] - h/2 G = 0,        under the constraint y_3 = -W_3 for the third line,
    G = ½ [(1 + s)(B + f - a × f) + s (a·(B + f)) a] + Σ e_i × (F_i - a × F_i),        B = M - s C Ω,

linear in y but for B and f. The rows L_i give the multipliers: λ their symmetric part, μ of the skew part -μ n̂/2.

Rotors of momentum c, in b, act with the moment ``-(Λ c)'``. With the mean c_m and the rate c' of a step

    Λ_{n+1} c_{n+1} - Λ_n c_n = h Λ_n M (Ω × c_m + c'),        as (2M - 2I) c = h Ω × M c = h M (Ω × c).

Of a moment M B the work of the virtual rotations asks for ``(1/s) Mᵀ M B = B + a (a·B)`` in G: here, ``c_m × Ω - c' -
a (a·c')``, with which the total momentum is exact. In the rows it stands as ``f_i = x × d_{i,m}``, whose moment is
``M B`` for ``2x = (2 + a aᵀ) M B/(1 + s)``.

Dissipation χ of a body without a constraint (`energy_momentum`): with E diagonal, ``Δd_i = h (1 + κ_i) u_i``, u_i the
mean velocity, ``κ_i = χ (p_i - v_i)/(p_i + v_i)``, v_i and p_i the lengths of V_i and of the next one, 2u_i - V_i. So
``(I - â) u_i = (1 + γ_i) Ω × e_i`` with ``1 + γ_i = 1/(1 + κ_i) = (p + v)/((1 + χ) p + (1 - χ) v)``: r(y) gains
``Σ E_i γ_i e_i × (Ω × e_i)``, and where y × e_i stands in rows and changes there is ``y × e_i + γ_i Ω × e_i``. p is the
solution of ``p = |2 (1 + γ) M (Ω × e_i) - V_i|``, found for each Ω. In order 2 χ is times h|W|, at most 1.
"""

from ..engine.called import derivatives, load_of_state, mean, moment_of_state, rest_of_state
from ..engine.march import march
from ..engine.solving import CHORDS, ITERATIONS, advance, cancelling
from ..geometry.compiled import inlined, kernel
from ..geometry.elements import any_of, eight, fused, root, select, splat
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
    larger,
    minus,
    scaled,
    size,
    times,
    unit,
    unit_cross,
)
from .midpoint_linear import dead_turning

SLIPS, TINY = 6, 1e-140  # iterations for the length of a velocity; what keeps quotients of zeros at 1


@inlined
def normal_part(extra):
    """Return N as rows."""
    n00, n11, n22, n12, n02, n01 = extra[:6]
    return ((n00, n01, n02), (n01, n11, n12), (n02, n12, n22))


@inlined
def euler_times(body, x):
    """Return E x."""
    (b0, b1), (e0, e1, e2) = body[1], body[3]
    return (
        fused(e0, x[0], -b0 * x[2]),
        fused(e1, x[1], -b1 * x[2]),
        fused(e2, x[2], -fused(b0, x[0], b1 * x[1])),
    )


@inlined
def euler_times_rows(body, X):
    """Return E X of a matrix of rows."""
    (b0, b1), (e0, e1, e2) = body[1], body[3]
    return (
        axpy(e0, X[0], scaled(-b0, X[2])),
        axpy(e1, X[1], scaled(-b1, X[2])),
        axpy(e2, X[2], axpy(-b0, X[0], scaled(-b1, X[1]))),
    )


@inlined
def jacobian_at_rest(k, body, f, W):
    """Return the column k of ``J - f Ŵ E``."""
    (b0, b1), (e0, e1, e2) = body[1], body[3]
    if k == 0:
        return (fused(f, b0 * W[1], e1 + e2), -f * fused(e0, W[2], b0 * W[0]), fused(f, e0 * W[1], b0))
    if k == 1:
        return (f * fused(e1, W[2], b1 * W[1]), fused(-f, b1 * W[0], e2 + e0), fused(-f, e1 * W[0], b1))
    return (
        fused(-f, fused(e2, W[1], b1 * W[2]), b0),
        fused(f, fused(e2, W[0], b0 * W[2]), b1),
        fused(f, fused(b1, W[0], -b0 * W[1]), e0 + e1),
    )


@inlined
def tested(a, s, own, m, exact):
    """Return the moments in G of a load ``Λ_m own + Λ_n m``."""
    if m is None:
        return scaled(0.5, axpy(1.0 + s, own, scaled(s * dot(a, own), a)))
    total = add(own, m)
    if exact:
        return axpy(dot(a, total), a, minus(total, cross(a, m)))
    return scaled(0.5, axpy(1.0 + s, minus(total, cross(a, m)), scaled(s * dot(a, total), a)))


@inlined
def residual(f, W, y, N, EN, body, held, M, m, D, F, call, exact):
    """Return r(y), f = h/2."""
    Om, (e0, e1, e2) = add(W, y), body[3]
    EO = euler_times(body, Om)
    turning = minus(axpy(EN[0][0] + EN[1][1] + EN[2][2], Om, scaled(-1.0, cross(W, EO))), times(N, EO))
    if M is not None:
        a = scaled(f, Om)
        s = 1.0 / (1.0 + dot(a, a))
        turning = minus(turning, tested(a, s, M if D is None else axpy(-s, times(D, Om), M), m, exact))
        if F is not None:
            turning = minus(turning, minus(first_moment(F), dead_turning(F, a)))
        if call is not None and call[5]:
            turning = minus(turning, axpy(-dot(a, call[7]), a, minus(cross(call[6], Om), call[7])))
    J_y = minus(scaled(e0 + e1 + e2, y), euler_times(body, y))
    r = add(axpy(f, turning, scaled(-1.0, first_moment(EN))), J_y)
    return (r[0], r[1], select(held, W[2] + y[2], r[2]))


@inlined
def residual_column(k, f, W, Om, EN, body, held, M, m, D, F, S, call, exact):
    """Return the column dr/dy_k; S holds the columns of dm/dΩ."""
    c = axpy(-f, EN[k], add_unit(k, f * (EN[0][0] + EN[1][1] + EN[2][2]), jacobian_at_rest(k, body, f, W)))
    if M is not None:
        a, e = scaled(f, Om), unit(k)
        s = 1.0 / (1.0 + dot(a, a))
        ds = -2.0 * s * s * f * a[k]
        if m is None:
            q, dq, p = dot(a, M), f * M[k], M
            dG = axpy(ds, p, axpy(ds * q + s * dq, a, scaled(f * s * q, e)))
        else:
            zero = splat(-0.0, f)  # -0 + x is x, and costs nothing
            own, dt, dp = M, (zero, zero, zero), scaled(-f, unit_cross(k, m))
            if D is not None:
                CO = times(D, Om)
                own, dt = axpy(-s, CO, M), add(axpy(-ds, CO, scaled(-s, column(D, k))), S[k])
                dp = add(dp, minus(dt, cross(a, S[k])))
            total = add(own, m)
            p, q = minus(total, cross(a, m)), dot(a, total)
            dq = fused(f, total[k], dot(a, dt))
            dG = axpy(ds, p, axpy(1.0 + s, dp, axpy(ds * q + s * dq, a, scaled(f * s * q, e))))
            if exact:
                dG = scaled(2.0, add(dp, axpy(dq, a, scaled(f * q, e))))
        c = axpy(-0.5 * f, dG, c)
        if F is not None:
            c = axpy(-f * f, F[k], add_unit(k, f * f * (F[0][0] + F[1][1] + F[2][2]), c))
        if call is not None and call[5]:
            rates = add_unit(k, f * dot(a, call[7]), scaled(f * call[7][k], a))
            c = axpy(f, add(rates, unit_cross(k, call[6])), c)
    return (c[0], c[1], select(held, splat(1.0 if k == 2 else 0.0, f), c[2]))


@inlined
def step(h, W, extra, body, M, m, D, F, call, is_open):
    """Take the step of any body."""
    return step_of(None, None, h, W, extra, body, M, m, D, F, call, is_open)


@inlined
def held_step(h, W, extra, body, M, m, D, F, call, is_open):
    """Take the step of a body with a constrained axis."""
    return step_of(1, None, h, W, extra, body, M, m, D, F, call, is_open)


@inlined
def dissipative_step(h, W, extra, body, M, m, D, F, call, is_open):
    """Take the step of a body without a constrained axis that dissipates energy."""
    return step_of(None, 1, h, W, extra, body, M, m, D, F, call, is_open)


@inlined
def step_of(is_held, dissipates, h, W, extra, body, M, m, D, F, call, is_open):
    """Return the masks of open and lost bodies, iterations, residual, change of W, N, a, moment in b, μ, λ."""
    zero, f, N = splat(0.0, h), 0.5 * h, normal_part(extra)
    EN, held, (e0, e1, e2) = euler_times_rows(body, N), body[2] == 0.0, body[3]
    y = (zero, zero, select(held, -W[2], zero))
    lost, count, used, before = zero > 1.0, 0, zero, zero
    zeros, left_over, given = (zero, zero, zero), zero, m
    A = S = (zeros, zeros, zeros)
    exact = False if call is None else call[9]
    across = size(N[0]) + size(N[1]) + size(N[2])
    if dissipates is not None:
        turn = h * root(dot(W, W))
        chi, gradients = fused(body[4][1], select(turn < 1.0, turn, splat(1.0, h)), body[4][0]), S
        gammas = zeros
    while any_of(is_open) and count < ITERATIONS:
        if call is not None and call[0] != 0:
            m, S = with_state(call, f, add(W, y), given, S, count == 0 or count >= CHORDS)
        if dissipates is not None:
            gammas, gradients = dissipation(chi, f, add(W, y), W, N)
        if count == 0 or count >= CHORDS:
            Om = add(W, y)
            c0 = residual_column(0, f, W, Om, EN, body, held, M, m, D, F, S, call, exact)
            c1 = residual_column(1, f, W, Om, EN, body, held, M, m, D, F, S, call, exact)
            if dissipates is not None:
                c0 = add(c0, slip_column(0, body, Om, gammas, gradients))
                c1 = add(c1, slip_column(1, body, Om, gammas, gradients))
            if is_held is None:
                c2 = residual_column(2, f, W, Om, EN, body, held, M, m, D, F, S, call, exact)
                if dissipates is not None:
                    c2 = add(c2, slip_column(2, body, Om, gammas, gradients))
                A = inverse_of(c0, c1, c2)
            else:
                det = 1.0 / (c0[0] * c1[1] - c0[1] * c1[0])
                A = ((det * c1[1], -det * c1[0], zero), (-det * c0[1], det * c0[0], zero), zeros)
        r = residual(f, W, y, N, EN, body, held, M, m, D, F, call, exact)
        if dissipates is not None:
            r = add(r, slip_moment(body, add(W, y), gammas))
        d = scaled(-1.0, times(A, r))
        now, speed = size(d), size(W) + size(y)
        left_over = abs(r[0]) + abs(r[1]) + select(held, zero, abs(r[2]))
        terms = (e0 + e1 + e2) * (2.0 * size(y) + across + abs(f) * (size(W) + across) * speed)
        if D is not None:
            terms = terms + cancelling(f, add(W, y), D, S)
        used = select(is_open, zero + (count + 1.0), used)
        here = y
        y, is_open, lost = advance(count, is_open, lost, y, d, now, before, EPS * speed, left_over, terms)
        if call is not None and call[0] != 0:  # the function is not called with what is no number
            y = chosen(lost, here, y)
        before = now
        count += 1
    Om = add(W, y)
    a = scaled(f, Om)
    s, moment = 1.0 / (1.0 + dot(a, a)), zeros
    if dissipates is not None:
        (g0, g1, g2), _ = dissipation(chi, f, Om, W, N)
        slips = (scaled(-g0, unit_cross(0, Om)), scaled(-g1, unit_cross(1, Om)), scaled(-g2, unit_cross(2, Om)))
    else:
        slips = None
    L0, L1, L2 = rows_of(f, a, y, W, N, slips, body)
    Mt = twice_mean_transposed(s, a)
    if M is not None:
        pushed = m
        if call is not None and call[0] != 0 and call[4]:
            state = moment_of_state(call, a, scaled(s, Om))
            m, pushed = add(given, state), add(given, load_of_state(call, state))
        own = mean(s, a, M if D is None else axpy(-s, times(D, Om), M))
        total = own
        if m is not None:
            total, own = add(m, own), add(pushed, own)
            if exact:
                total, own = pair_of(a, s, total), pair_of(a, s, own)
        if call is not None and call[5]:
            wheel = pair_of(a, s, mean(s, a, minus(cross(call[6], Om), call[7])))
            total, own = add(wheel, total), add(wheel, own)
        L0 = add(L0, loaded_row(a, total, Mt[0]))
        L1 = add(L1, loaded_row(a, total, Mt[1]))
        L2 = add(L2, loaded_row(a, total, Mt[2]))
        if F is not None:
            L0 = add(L0, minus(F[0], cross(a, F[0])))
            L1 = add(L1, minus(F[1], cross(a, F[1])))
            L2 = add(L2, minus(F[2], cross(a, F[2])))
        moment = scaled(0.5, axpy(1.0 + s, own, scaled(-s * dot(a, own), a)))  # Σ d_{i,m} × f_i
    lam = (L0[0], L1[1], L2[2], 0.5 * (L1[2] + L2[1]), 0.5 * (L0[2] + L2[0]), 0.5 * (L0[1] + L1[0]))
    if call is not None and call[0] != 0 and call[4]:
        r0, r1, r2, r3, r4, r5 = rest_of_state(call, a[0])
        lam = (lam[0] + r0, lam[1] + r1, lam[2] + r2, lam[3] + r3, lam[4] + r4, lam[5] + r5)
    dW, extra = flipped(Mt, y, N, slips, extra)
    return is_open, lost, used, left_over, dW, extra, a, moment, L0[1] - L1[0], lam


@inlined
def with_state(call, f, Om, given, S, anew):
    """Return `given` with the moment of the state added, and the columns of its derivative, computed `anew` or kept."""
    a = scaled(f, Om)
    state = moment_of_state(call, a, scaled(1.0 / (1.0 + dot(a, a)), Om))
    if anew:
        S = derivatives(call, f, True, Om, state)
    return add(given, state), S


@inlined
def rows_of(f, a, y, W, N, slips, body):
    """Return the rows ``-(2/h) Σ_j E_ij (y × e_j - N_j + γ_j Ω × e_j + a × (W × e_j + N_j))``."""
    X0 = minus(add((0.0 * y[0], y[2], -y[1]), cross(a, add((0.0 * y[0], W[2], -W[1]), N[0]))), N[0])
    X1 = minus(add((-y[2], 0.0 * y[0], y[0]), cross(a, add((-W[2], 0.0 * y[0], W[0]), N[1]))), N[1])
    X2 = minus(add((y[1], -y[0], 0.0 * y[0]), cross(a, add((W[1], -W[0], 0.0 * y[0]), N[2]))), N[2])
    if slips is not None:
        X0, X1, X2 = add(X0, slips[0]), add(X1, slips[1]), add(X2, slips[2])
    L0, L1, L2 = euler_times_rows(body, (X0, X1, X2))
    g = -1.0 / f
    return scaled(g, L0), scaled(g, L1), scaled(g, L2)


@inlined
def pair_of(a, s, m):
    """Return the y of forces ``½ y × d_{i,m}`` whose moment is m: ``(1 + s) y - s a (a·y) = 2m``."""
    return scaled(2.0 / (1.0 + s), axpy(0.5 * dot(a, m), a, m))


@inlined
def loaded_row(a, m, twice):
    """Return ``(I - â) (m × M e_i)/2``; `twice` is 2 M e_i."""
    g = scaled(0.25, cross(m, twice))
    return minus(g, cross(a, g))


@inlined
def twice_mean_transposed(s, a):
    """Return 2 Mᵀ as rows."""
    g = 2.0 * s
    b, c = scaled(g, a), scaled(g, (a[1] * a[2], a[2] * a[0], a[0] * a[1]))
    return (
        (fused(b[0], a[0], g), c[2] + b[2], c[1] - b[1]),
        (c[2] - b[2], fused(b[1], a[1], g), c[0] + b[0]),
        (c[1] + b[1], c[0] - b[0], fused(b[2], a[2], g)),
    )


@inlined
def flipped(Mt, y, N, slips, extra):
    """Return the changes of W and the next N: ``V_i`` changes by ``2 Mᵀ (y × e_i - N_i + γ_i Ω × e_i)``."""
    zero = splat(0.0, y[0])
    if slips is not None:
        N = (minus(N[0], slips[0]), minus(N[1], slips[1]), minus(N[2], slips[2]))
    x0 = times(Mt, minus((zero, y[2], -y[1]), N[0]))
    x1 = times(Mt, minus((-y[2], zero, y[0]), N[1]))
    x2 = times(Mt, minus((y[1], -y[0], zero), N[2]))
    dW = (0.5 * (x1[2] - x2[1]), 0.5 * (x2[0] - x0[2]), 0.5 * (x0[1] - x1[0]))
    n00, n11, n22, n12, n02, n01 = extra[:6]
    yz, xz, xy = 0.5 * (x1[2] + x2[1]), 0.5 * (x0[2] + x2[0]), 0.5 * (x0[1] + x1[0])
    return dW, (n00 + x0[0], n11 + x1[1], n22 + x2[2], n12 + yz, n02 + xz, n01 + xy, zero, zero, zero)


@inlined
def dissipation(chi, f, Om, W, N):
    """Return the three γ_i, and their derivatives by Ω as vectors; χ is `chi`."""
    a = scaled(f, Om)
    s = 1.0 / (1.0 + dot(a, a))
    g0, d0 = slip_of(0, chi, f, s, a, Om, W, N[0])
    g1, d1 = slip_of(1, chi, f, s, a, Om, W, N[1])
    g2, d2 = slip_of(2, chi, f, s, a, Om, W, N[2])
    return (g0, g1, g2), (d0, d1, d2)


@inlined
def slip_of(i, chi, f, s, a, Om, W, normal):
    """Return γ of a director and its derivative: the length p of the next velocity, by Newton's iteration."""
    V, u = minus(normal, unit_cross(i, W)), scaled(-1.0, unit_cross(i, Om))
    A = scaled(s, add(u, cross(a, u)))  # M (Ω × e_i)
    v, AA, AV = root(dot(V, V)), dot(A, A), dot(A, V)
    U = minus(scaled(2.0, A), V)
    p = root(dot(U, U))
    for _ in range(SLIPS):
        below = fused(chi, p - v, p + v) + TINY
        g, dg = (p + v + TINY) / below, -2.0 * chi * v / (below * below)
        U = minus(scaled(2.0 * g, A), V)
        length = root(dot(U, U))
        p = larger(p - (p - length) / (1.0 - (4.0 * g * AA - 2.0 * AV) * dg / (length + TINY)), 0.0 * p)
    below = fused(chi, p - v, p + v) + TINY
    g, dg = (p + v + TINY) / below, -2.0 * chi * v / (below * below)
    U = minus(scaled(2.0 * g, A), V)
    slope = 2.0 * s * g * dg / (p - 2.0 * dg * dot(U, A) + TINY)
    inner = add(unit_cross(i, add(U, cross(U, a))), axpy(f, cross(u, U), scaled(-2.0 * f * dot(U, A), a)))
    return g - 1.0, scaled(slope, inner)


@inlined
def slip_moment(body, Om, slips):
    """Return ``Σ E_i γ_i e_i × (Ω × e_i)``."""
    x, y, z = each(body[3], slips)
    return (Om[0] * (y + z), Om[1] * (z + x), Om[2] * (x + y))


@inlined
def slip_column(k, body, Om, slips, gradients):
    """Return the derivative of `slip_moment` by Ω_k."""
    rates = (gradients[0][k], gradients[1][k], gradients[2][k])
    x, y, z = each(body[3], slips)
    diagonal = (y + z, z + x, x + y)
    return add_unit(k, diagonal[k], slip_moment(body, Om, rates))


@inlined
def velocity(k, W):
    """Return W of the state, which is it."""
    return W


@kernel
def held_one(address):
    march(address, 0.0, held_step, velocity, 1, None, None, None, None)


@kernel
def free_one(address):
    march(address, 0.0, step, velocity, 1, None, None, None, None)


@kernel
def moved_one(address):
    march(address, 0.0, step, velocity, 1, 1, None, None, None)


@kernel
def heavy_one(address):
    march(address, 0.0, step, velocity, 1, 1, 1, None, None)


@kernel
def pushed_one(address):
    march(address, 0.0, step, velocity, 1, 1, None, 1, None)


@kernel
def any_one(address):
    march(address, 0.0, step, velocity, 1, 1, 1, 1, 1)


@kernel
def held_eight(address):
    march(address, eight(), held_step, velocity, 1, None, None, None, None)


@kernel
def free_eight(address):
    march(address, eight(), step, velocity, 1, None, None, None, None)


@kernel
def moved_eight(address):
    march(address, eight(), step, velocity, 1, 1, None, None, None)


@kernel
def heavy_eight(address):
    march(address, eight(), step, velocity, 1, 1, 1, None, None)


@kernel
def pushed_eight(address):
    march(address, eight(), step, velocity, 1, 1, None, 1, None)


@kernel
def any_eight(address):
    march(address, eight(), step, velocity, 1, 1, 1, 1, 1)


@kernel
def dissipative_one(address):
    march(address, 0.0, dissipative_step, velocity, 1, 1, 1, 1, 1)


@kernel
def dissipative_eight(address):
    march(address, eight(), dissipative_step, velocity, 1, 1, 1, 1, 1)


ONE = (held_one, moved_one, free_one, moved_one, heavy_one, pushed_one, any_one)
EIGHT = (held_eight, moved_eight, free_eight, moved_eight, heavy_eight, pushed_eight, any_eight)
