"""The step of `energy_momentum`, in a frame in which its equations are short.

The frame b is that of `lie_step`, so E has the entries E13 and E23 beside its diagonal, under the constraint alone.
With Ω = W + y and the notation of `energy_momentum` the unknown y solves

    r(y) = J y - z + h/2 [τ Ω - W × EΩ - N E Ω] - h/2 G = 0,        under the constraint y_3 = -W_3 for the third line,
    G = ½ [(1 + s)(B + f - a × f) + s (a·(B + f)) a] + Σ e_i × (F_i - a × F_i),        B = M - s C Ω,

linear in y but for B and f. The rows L_i give the multipliers: λ their symmetric part, μ of the skew part -μ n̂/2.
"""

from ..engine.called import derivatives, mean, mean_transposed, moment_of_state
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
from .lie_step import dead_turning


@inlined
def normal_part(extra):
    """Return N as rows."""
    n00, n11, n22, n12, n02, n01 = extra
    return ((n00, n01, n02), (n01, n11, n12), (n02, n12, n22))


@inlined
def euler(body):
    """Return E as rows, and its trace."""
    (b0, b1), (e0, e1, e2) = body[1], body[3]
    zero = splat(0.0, e0)
    return ((e0, zero, -b0), (zero, e1, -b1), (-b0, -b1, e2)), e0 + e1 + e2


@inlined
def tested(a, s, own, m):
    """Return the moments in G of a load ``Λ_m own + Λ_n m``."""
    total = add(own, m)
    return scaled(0.5, axpy(1.0 + s, minus(total, cross(a, m)), scaled(s * dot(a, total), a)))


@inlined
def left(f, W, y, N, EN, E, trace, held, M, m, D, F):
    """Return r(y), f = h/2."""
    Om = add(W, y)
    EO = times(E, Om)
    turning = minus(axpy(EN[0][0] + EN[1][1] + EN[2][2], Om, scaled(-1.0, cross(W, EO))), times(N, EO))
    if M is not None:
        a = scaled(f, Om)
        s = 1.0 / (1.0 + dot(a, a))
        G = add(tested(a, s, axpy(-s, times(D, Om), M), m), minus(first_moment(F), dead_turning(F, a)))
        turning = minus(turning, G)
    r = add(axpy(f, turning, scaled(-1.0, first_moment(EN))), minus(scaled(trace, y), times(E, y)))
    return (r[0], r[1], select(held, W[2] + y[2], r[2]))


@inlined
def left_column(k, f, W, Om, N, EN, E, trace, held, M, m, D, F, S):
    """Return the column dr/dy_k; S holds the columns of dm/dΩ."""
    e = unit(k)
    turning = minus(axpy(EN[0][0] + EN[1][1] + EN[2][2], e, scaled(-1.0, cross(W, E[k]))), times(N, E[k]))
    if M is not None:
        a = scaled(f, Om)
        s = 1.0 / (1.0 + dot(a, a))
        CO, ds = times(D, Om), -2.0 * s * s * f * a[k]
        own, do = axpy(-s, CO, M), axpy(-ds, CO, scaled(-s, column(D, k)))
        total, dt = add(own, m), add(do, S[k])
        p, dp = minus(total, cross(a, m)), minus(dt, axpy(f, unit_cross(k, m), cross(a, S[k])))
        q, dq = dot(a, total), f * total[k] + dot(a, dt)
        dG = axpy(ds, p, axpy(1.0 + s, dp, axpy(ds * q + s * dq, a, scaled(f * s * q, e))))
        turning = axpy(-0.5, dG, axpy(f, dead_turning(F, e), turning))
    c = axpy(f, turning, axpy(trace, e, scaled(-1.0, E[k])))
    return (c[0], c[1], select(held, e[2] + 0.0 * c[2], c[2]))


@inlined
def step(h, W, extra, body, M, m, D, F, call, is_open):
    """Return the masks of open and lost bodies, iterations, residual, change of W, N, a, moment in b, μ, λ."""
    zero, f, N, (E, trace) = splat(0.0, h), 0.5 * h, normal_part(extra), euler(body)
    EN, held = (times(N, E[0]), times(N, E[1]), times(N, E[2])), body[2] == 0.0
    y = (zero, zero, select(held, -W[2], zero))
    lost, count, used, before = zero > 1.0, 0, zero, zero
    nothing, left_over, given = (zero, zero, zero), zero, m
    A = S = (nothing, nothing, nothing)
    across = size(N[0]) + size(N[1]) + size(N[2])
    while any_of(is_open) and count < ITERATIONS:
        if call is not None and call[0] != 0:
            m, S = with_state(call, f, add(W, y), given, S, count == 0 or count >= CHORDS)
        if count == 0 or count >= CHORDS:
            Om = add(W, y)
            A = inverse_of(
                left_column(0, f, W, Om, N, EN, E, trace, held, M, m, D, F, S),
                left_column(1, f, W, Om, N, EN, E, trace, held, M, m, D, F, S),
                left_column(2, f, W, Om, N, EN, E, trace, held, M, m, D, F, S),
            )
        r = left(f, W, y, N, EN, E, trace, held, M, m, D, F)
        d = times(A, r)
        now, speed = size(d), size(W) + size(y)
        left_over = abs(r[0]) + abs(r[1]) + select(held, zero, abs(r[2]))
        terms = trace * (2.0 * size(y) + across + abs(f) * (size(W) + across) * speed)
        used = select(is_open, zero + (count + 1.0), used)
        takes, is_open, lost = progress(count, is_open, lost, now, before, EPS * speed, left_over, terms)
        y, before = chosen(takes, minus(y, d), y), now
        count += 1
    Om = add(W, y)
    a = scaled(f, Om)
    s, moment = 1.0 / (1.0 + dot(a, a)), nothing
    L0, L1, L2 = rows_of(f, a, y, W, N, E)
    if M is not None:
        if call is not None and call[0] != 0:
            m = add(given, moment_of_state(call, a, scaled(s, Om)))
        total = add(m, mean(s, a, axpy(-s, times(D, Om), M)))
        L0 = add(L0, add(minus(F[0], cross(a, F[0])), loaded_row(s, a, total, (1.0, 0.0, 0.0))))
        L1 = add(L1, add(minus(F[1], cross(a, F[1])), loaded_row(s, a, total, (0.0, 1.0, 0.0))))
        L2 = add(L2, add(minus(F[2], cross(a, F[2])), loaded_row(s, a, total, (0.0, 0.0, 1.0))))
        moment = scaled(0.5, axpy(1.0 + s, total, scaled(-s * dot(a, total), a)))  # Σ d_{i,m} × f_i
    lam = (L0[0], L1[1], L2[2], 0.5 * (L1[2] + L2[1]), 0.5 * (L0[2] + L2[0]), 0.5 * (L0[1] + L1[0]))
    dW, extra = flipped(a, s, y, N, extra)
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
def rows_of(f, a, y, W, N, E):
    """Return the rows ``-(2/h) Σ_j E_ij (y × e_j - N_j + a × (W × e_j + N_j))``."""
    X0 = minus(add((0.0 * y[0], y[2], -y[1]), cross(a, add((0.0 * y[0], W[2], -W[1]), N[0]))), N[0])
    X1 = minus(add((-y[2], 0.0 * y[0], y[0]), cross(a, add((-W[2], 0.0 * y[0], W[0]), N[1]))), N[1])
    X2 = minus(add((y[1], -y[0], 0.0 * y[0]), cross(a, add((W[1], -W[0], 0.0 * y[0]), N[2]))), N[2])
    X, g = (X0, X1, X2), -1.0 / f
    return (
        scaled(g, transposed_times(X, E[0])),
        scaled(g, transposed_times(X, E[1])),
        scaled(g, transposed_times(X, E[2])),
    )


@inlined
def loaded_row(s, a, m, e):
    """Return ``(I - â) (m × M e_i)/2``."""
    g = scaled(0.5, cross(m, mean(s, a, e)))
    return minus(g, cross(a, g))


@inlined
def flipped(a, s, y, N, extra):
    """Return the changes of W and the next N: ``V_i`` changes by ``2 Mᵀ (y × e_i - N_i)``."""
    zero = splat(0.0, s)
    x0 = mean_transposed(2.0 * s, a, minus((zero, y[2], -y[1]), N[0]))
    x1 = mean_transposed(2.0 * s, a, minus((-y[2], zero, y[0]), N[1]))
    x2 = mean_transposed(2.0 * s, a, minus((y[1], -y[0], zero), N[2]))
    dW = (0.5 * (x1[2] - x2[1]), 0.5 * (x2[0] - x0[2]), 0.5 * (x0[1] - x1[0]))
    n00, n11, n22, n12, n02, n01 = extra
    yz, xz, xy = 0.5 * (x1[2] + x2[1]), 0.5 * (x0[2] + x2[0]), 0.5 * (x0[1] + x1[0])
    return dW, (n00 + x0[0], n11 + x1[1], n22 + x2[2], n12 + yz, n02 + xz, n01 + xy)


@inlined
def velocity(k, W):
    """Return W of the state, which is it."""
    return W


@kernel
def free_one(address):
    march(address, 0.0, step, velocity, 1, None, None, None)


@kernel
def any_one(address):
    march(address, 0.0, step, velocity, 1, 1, 1, 1)


@kernel
def free_eight(address):
    march(address, eight(), step, velocity, 1, None, None, None)


@kernel
def any_eight(address):
    march(address, eight(), step, velocity, 1, 1, 1, 1)


ONE = (free_one, free_one, any_one, any_one, any_one)
EIGHT = (free_eight, free_eight, any_eight, any_eight, any_eight)
