"""The step of `energy_momentum`, in a frame in which its equations are short.

The frame b is that of `lie_step`, so E has the entries E13 and E23 beside its diagonal, under the constraint alone.
With Ω = W + y and the notation of `energy_momentum` the unknown y solves

    r(y) = J y - z + h/2 [τ Ω - W × EΩ - N E Ω] - h/2 G = 0,        under the constraint y_3 = -W_3 for the third line,
    G = ½ [(1 + s)(B + f - a × f) + s (a·(B + f)) a] + Σ e_i × (F_i - a × F_i),        B = M - s C Ω,

linear in y but for B and f. The rows L_i give the multipliers: λ their symmetric part, μ of the skew part -μ n̂/2.
"""

from ..engine.called import derivatives, mean, moment_of_state
from ..engine.march import march
from ..engine.solving import CHORDS, ITERATIONS, advance
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
    first_moment,
    inverse_of,
    minus,
    scaled,
    size,
    times,
    unit,
    unit_cross,
)
from .lie_step import dead_turning


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
def tested(a, s, own, m):
    """Return the moments in G of a load ``Λ_m own + Λ_n m``."""
    if m is None:
        return scaled(0.5, axpy(1.0 + s, own, scaled(s * dot(a, own), a)))
    total = add(own, m)
    return scaled(0.5, axpy(1.0 + s, minus(total, cross(a, m)), scaled(s * dot(a, total), a)))


@inlined
def residual(f, W, y, N, EN, body, held, M, m, D, F):
    """Return r(y), f = h/2."""
    Om, (e0, e1, e2) = add(W, y), body[3]
    EO = euler_times(body, Om)
    turning = minus(axpy(EN[0][0] + EN[1][1] + EN[2][2], Om, scaled(-1.0, cross(W, EO))), times(N, EO))
    if M is not None:
        a = scaled(f, Om)
        s = 1.0 / (1.0 + dot(a, a))
        turning = minus(turning, tested(a, s, M if D is None else axpy(-s, times(D, Om), M), m))
        if F is not None:
            turning = minus(turning, minus(first_moment(F), dead_turning(F, a)))
    J_y = minus(scaled(e0 + e1 + e2, y), euler_times(body, y))
    r = add(axpy(f, turning, scaled(-1.0, first_moment(EN))), J_y)
    return (r[0], r[1], select(held, W[2] + y[2], r[2]))


@inlined
def residual_column(k, f, W, Om, EN, body, held, M, m, D, F, S):
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
        c = axpy(-0.5 * f, dG, c)
        if F is not None:
            c = axpy(-f * f, F[k], add_unit(k, f * f * (F[0][0] + F[1][1] + F[2][2]), c))
    return (c[0], c[1], select(held, splat(1.0 if k == 2 else 0.0, f), c[2]))


@inlined
def step(h, W, extra, body, M, m, D, F, call, is_open):
    """Take the step of any body."""
    return step_of(None, h, W, extra, body, M, m, D, F, call, is_open)


@inlined
def held_step(h, W, extra, body, M, m, D, F, call, is_open):
    """Take the step of a body with a constrained axis."""
    return step_of(1, h, W, extra, body, M, m, D, F, call, is_open)


@inlined
def step_of(is_held, h, W, extra, body, M, m, D, F, call, is_open):
    """Return the masks of open and lost bodies, iterations, residual, change of W, N, a, moment in b, μ, λ."""
    zero, f, N = splat(0.0, h), 0.5 * h, normal_part(extra)
    EN, held, (e0, e1, e2) = euler_times_rows(body, N), body[2] == 0.0, body[3]
    y = (zero, zero, select(held, -W[2], zero))
    lost, count, used, before = zero > 1.0, 0, zero, zero
    zeros, left_over, given = (zero, zero, zero), zero, m
    A = S = (zeros, zeros, zeros)
    across = size(N[0]) + size(N[1]) + size(N[2])
    while any_of(is_open) and count < ITERATIONS:
        if call is not None and call[0] != 0:
            m, S = with_state(call, f, add(W, y), given, S, count == 0 or count >= CHORDS)
        if count == 0 or count >= CHORDS:
            Om = add(W, y)
            c0 = residual_column(0, f, W, Om, EN, body, held, M, m, D, F, S)
            c1 = residual_column(1, f, W, Om, EN, body, held, M, m, D, F, S)
            if is_held is None:
                c2 = residual_column(2, f, W, Om, EN, body, held, M, m, D, F, S)
                A = inverse_of(c0, c1, c2)
            else:
                det = 1.0 / (c0[0] * c1[1] - c0[1] * c1[0])
                A = ((det * c1[1], -det * c1[0], zero), (-det * c0[1], det * c0[0], zero), zeros)
        r = residual(f, W, y, N, EN, body, held, M, m, D, F)
        d = scaled(-1.0, times(A, r))
        now, speed = size(d), size(W) + size(y)
        left_over = abs(r[0]) + abs(r[1]) + select(held, zero, abs(r[2]))
        terms = (e0 + e1 + e2) * (2.0 * size(y) + across + abs(f) * (size(W) + across) * speed)
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
    L0, L1, L2 = rows_of(f, a, y, W, N, body)
    Mt = twice_mean_transposed(s, a)
    if M is not None:
        if call is not None and call[0] != 0 and call[4]:
            m = add(given, moment_of_state(call, a, scaled(s, Om)))
        total = mean(s, a, M if D is None else axpy(-s, times(D, Om), M))
        if m is not None:
            total = add(m, total)
        L0 = add(L0, loaded_row(a, total, Mt[0]))
        L1 = add(L1, loaded_row(a, total, Mt[1]))
        L2 = add(L2, loaded_row(a, total, Mt[2]))
        if F is not None:
            L0 = add(L0, minus(F[0], cross(a, F[0])))
            L1 = add(L1, minus(F[1], cross(a, F[1])))
            L2 = add(L2, minus(F[2], cross(a, F[2])))
        moment = scaled(0.5, axpy(1.0 + s, total, scaled(-s * dot(a, total), a)))  # Σ d_{i,m} × f_i
    lam = (L0[0], L1[1], L2[2], 0.5 * (L1[2] + L2[1]), 0.5 * (L0[2] + L2[0]), 0.5 * (L0[1] + L1[0]))
    dW, extra = flipped(Mt, y, N, extra)
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
def rows_of(f, a, y, W, N, body):
    """Return the rows ``-(2/h) Σ_j E_ij (y × e_j - N_j + a × (W × e_j + N_j))``."""
    X0 = minus(add((0.0 * y[0], y[2], -y[1]), cross(a, add((0.0 * y[0], W[2], -W[1]), N[0]))), N[0])
    X1 = minus(add((-y[2], 0.0 * y[0], y[0]), cross(a, add((-W[2], 0.0 * y[0], W[0]), N[1]))), N[1])
    X2 = minus(add((y[1], -y[0], 0.0 * y[0]), cross(a, add((W[1], -W[0], 0.0 * y[0]), N[2]))), N[2])
    L0, L1, L2 = euler_times_rows(body, (X0, X1, X2))
    g = -1.0 / f
    return scaled(g, L0), scaled(g, L1), scaled(g, L2)


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
def flipped(Mt, y, N, extra):
    """Return the changes of W and the next N: ``V_i`` changes by ``2 Mᵀ (y × e_i - N_i)``."""
    zero = splat(0.0, y[0])
    x0 = times(Mt, minus((zero, y[2], -y[1]), N[0]))
    x1 = times(Mt, minus((-y[2], zero, y[0]), N[1]))
    x2 = times(Mt, minus((y[1], -y[0], zero), N[2]))
    dW = (0.5 * (x1[2] - x2[1]), 0.5 * (x2[0] - x0[2]), 0.5 * (x0[1] - x1[0]))
    n00, n11, n22, n12, n02, n01 = extra[:6]
    yz, xz, xy = 0.5 * (x1[2] + x2[1]), 0.5 * (x0[2] + x2[0]), 0.5 * (x0[1] + x1[0])
    return dW, (n00 + x0[0], n11 + x1[1], n22 + x2[2], n12 + yz, n02 + xz, n01 + xy, zero, zero, zero)


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


ONE = (held_one, moved_one, free_one, moved_one, heavy_one, pushed_one, any_one)
EIGHT = (held_eight, moved_eight, free_eight, moved_eight, heavy_eight, pushed_eight, any_eight)
