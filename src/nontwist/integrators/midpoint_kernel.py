"""The compiled steps of `energy_momentum` and `lie_midpoint`, and the march over the grid that they share.

Vectors are tuples in the body frame b of the step's beginning, matrices are tuples of rows. The frame is turned so that
a constrained axis is its third direction (`basis`; the identity for an axis E3 or none). With Ω the angular velocity
of the step and ``a = h Ω/2`` the averaged attitude is ``Λ_m = Λ_n M``, ``M = (I - â)⁻¹ = s (I + â + a aᵀ)``,
``s = 1/(1 + |a|²)``, and ``Λ_{n+1} = Λ_n (2M - I)``, kept as a quaternion p.

What makes long runs exact to round-off: W and p are sums of small increments, compensated (Kahan), and p is normalised;
the unknown is the increment ``y = Ω - W``, so residuals are rounded relative to it.

`state` holds p (4), its compensation (4), W (3), its compensation (3) and the rate y/h of the last step, the first
guess of the next; `normal` the symmetric part N of the velocities of the director scheme, or None for lie-midpoint.
"""

from math import sqrt
from typing import Any, NamedTuple

from ..geometry.compiled import inlined, kernel

EPS = 2.220446049250313e-16
ROUND_OFF = 16.0 * EPS
NAN = float("nan")
PI = 3.141592653589793
FARTHEST = 1e15  # rad a step: of Ω = W + y round-off leaves nothing
ITERATIONS = 40
SMALLEST = 1e-290  # change of Ω for a difference quotient, whose inverse is finite
OK, TURN, STALLED, BROKEN, LOAD = 0, 1, 2, 3, 4


class Body(NamedTuple):
    """A body and its load along the moving frame."""

    E: Any  # (3, 3) Euler inertia
    fixed: bool  # whether the third direction is a constrained axis
    loaded: bool  # whether there is any load, of any kind
    moving: Any  # (nodes, 3); one row stands for all nodes


class More(NamedTuple):
    """What many runs do not have; None leaves it out of the compiled code."""

    heavy: bool
    dead: Any  # (3, 3) dead forces, rows
    damped: bool
    damping: Any  # (3, 3) C
    pushed: bool  # whether there is a moment in space or of the state
    space: Any  # (nodes, 3); one row stands for all nodes
    tilted: bool
    basis: Any  # (3, 3) columns: the frame in body components


class Grid(NamedTuple):
    """Whole steps, each of as many nodes as there are fractions."""

    step: float
    fractions: Any
    times: Any  # (nodes,)
    stored: Any  # numbers of the steps that are kept


class Output(NamedTuple):
    """What is kept; all but the first two are sums over intervals, zero at first."""

    directors: Any
    velocities: Any
    multipliers: Any
    moment: Any
    work: Any
    iterations: Any


@inlined
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@inlined
def add(a, b):
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@inlined
def axpy(c, a, b):
    """Return c a + b."""
    return (c * a[0] + b[0], c * a[1] + b[1], c * a[2] + b[2])


@inlined
def scaled(c, a):
    return (c * a[0], c * a[1], c * a[2])


@inlined
def times(A, x):
    return (dot(A[0], x), dot(A[1], x), dot(A[2], x))


@inlined
def transposed_times(A, x):
    return axpy(x[0], A[0], axpy(x[1], A[1], scaled(x[2], A[2])))


@inlined
def unit(k):
    return (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)


@inlined
def unit_cross(k, x):
    """Return e_k × x."""
    if k == 0:
        return (0.0, -x[2], x[1])
    if k == 1:
        return (x[2], 0.0, -x[0])
    return (-x[1], x[0], 0.0)


@inlined
def add_unit(k, c, x):
    """Return x + c e_k."""
    if k == 0:
        return (x[0] + c, x[1], x[2])
    if k == 1:
        return (x[0], x[1] + c, x[2])
    return (x[0], x[1], x[2] + c)


@inlined
def rows(A):
    return (
        (float(A[0, 0]), float(A[0, 1]), float(A[0, 2])),
        (float(A[1, 0]), float(A[1, 1]), float(A[1, 2])),
        (float(A[2, 0]), float(A[2, 1]), float(A[2, 2])),
    )


@inlined
def size(a):
    """Return Σ |a_i|, which is NaN where an entry is."""
    return abs(a[0]) + abs(a[1]) + abs(a[2])


@inlined
def column(A, k):
    return (A[0][k], A[1][k], A[2][k])


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
def attitude(p):
    """Return Λ of a unit quaternion (scalar first), as rows."""
    w, x, y, z = p
    x2, y2, z2 = x + x, y + y, z + z
    wx, wy, wz = w * x2, w * y2, w * z2
    xx, xy, xz, yy, yz, zz = x * x2, x * y2, x * z2, y * y2, y * z2, z * z2
    return (
        (1.0 - (yy + zz), xy - wz, xz + wy),
        (xy + wz, 1.0 - (xx + zz), yz - wx),
        (xz - wy, yz + wx, 1.0 - (xx + yy)),
    )


@inlined
def mean(s, a, x):
    """Return M x."""
    return scaled(s, axpy(dot(a, x), a, add(x, cross(a, x))))


@inlined
def mean_transposed(s, a, x):
    """Return Mᵀ x."""
    return scaled(s, axpy(dot(a, x), a, axpy(-1.0, cross(a, x), x)))


@inlined
def moment_of_state(function, t, R, basis, a, w):
    """Return the moment of the state in b: `function` gets the averaged directors as rows and w, both in space."""
    s = 1.0 / (1.0 + dot(a, a))
    d0 = times(basis, mean_transposed(s, a, R[0]))  # the rows of Λ_m = R M are Mᵀ R_i
    d1 = times(basis, mean_transposed(s, a, R[1]))
    d2 = times(basis, mean_transposed(s, a, R[2]))
    q = (d0[0], d1[0], d2[0], d0[1], d1[1], d2[1], d0[2], d1[2], d2[2])
    return transposed_times(R, function(t, q, times(R, w)))


@inlined
def first_moment(F):
    """Return Σ e_i × F_i."""
    return (F[1][2] - F[2][1], F[2][0] - F[0][2], F[0][1] - F[1][0])


# lie-midpoint: r(y) = 2 J y - h (Ω × E Ω + g) with Ω = W + y and g = Λ_m⁻¹ m in the frame b.


@inlined
def lie_step(function, more, h, W, y, E, fixed, loaded, B, m, F, R, t):
    """Return status, iterations, residual, y, a, s, μ, m in b, work; y is the first guess."""
    zero = (0.0, 0.0, 0.0)
    trace = E[0][0] + E[1][1] + E[2][2]
    state, force, G, c0, c1, dy = zero, zero, (zero, zero, zero), zero, zero, zero
    status, r, iteration, residual, previous, rate = STALLED, zero, 0, NAN, 1.0, 1.0
    while iteration < ITERATIONS:
        iteration += 1
        Om = add(W, y)
        a = scaled(0.5 * h, Om)
        EO = times(E, Om)
        g = cross(Om, EO)
        if loaded:
            g = add(g, B)
        if more is not None:
            if more.damped:
                g = axpy(-1.0, times(more.damping, Om), g)
            if more.pushed:
                if function is not None:
                    state = moment_of_state(function, t, R, more.basis, a, Om)
                force = add(m, state)
                g = add(g, axpy(-1.0, cross(a, force), force))
            if more.heavy:
                g = add(g, dead_moment(F, a))
        r = axpy(-h, g, axpy(2.0 * trace, y, scaled(-2.0, times(E, y))))
        residual = abs(r[0]) + abs(r[1]) if fixed else size(r)
        stagnant = iteration > 2 and rate > 0.5
        if residual == 0.0 or (stagnant and residual <= ROUND_OFF * lie_terms(h, trace, Om, y)):
            status, dy = OK, zero
            break
        if function is not None:
            if rate > 0.1:
                for k in range(3):
                    e = scaled(sqrt(EPS) * max(size(Om), residual / trace, SMALLEST), unit(k))
                    ahead = moment_of_state(function, t, R, more.basis, axpy(0.5 * h, e, a), add(Om, e))
                    G = (G[1], G[2], scaled(1.0 / e[k], axpy(-1.0, state, ahead)))
            if not size(state) + size(G[0]) + size(G[1]) + size(G[2]) < 1e300:
                status = LOAD
                break
        c0 = lie_column(function, more, 0, h, trace, E, Om, EO, a, force, G, F)
        c1 = lie_column(function, more, 1, h, trace, E, Om, EO, a, force, G, F)
        c2 = lie_column(function, more, 2, h, trace, E, Om, EO, a, force, G, F)
        dy = solve(c0, c1, c2, scaled(-1.0, r), fixed)
        y = add(y, dy)
        increment, level = size(dy), size(W) + size(y)
        if not increment < 1e300:
            break
        rate = increment / previous if iteration > 1 else 0.0
        if (
            increment <= EPS * level
            or (rate > 0.5 and increment <= 1e-9 * level)
            or (function is None and iteration > 1 and increment * rate * rate <= 0.1 * EPS * level)
        ):
            status = OK
            break
        previous = increment
    Om = add(W, y)
    a = scaled(0.5 * h, Om)
    a2 = dot(a, a)
    s = 1.0 / (1.0 + a2)
    if status == OK and 4.0 * a2 > PI * PI:
        status = TURN
    mu = -(1.0 / h) * (r[2] + c0[2] * dy[0] + c1[2] * dy[1])
    work = 0.0
    if loaded:
        if more is not None and more.damped:
            B = axpy(-1.0, times(more.damping, Om), B)
        force = add(force, mean(s, a, B))
        work = h * dot(Om, force)
    return status, iteration, residual, y, a, s, mu, force, work


@inlined
def lie_terms(h, trace, Om, y):
    """Return the size of the terms of r without load: times round-off, what is left of r where J is near singular."""
    return trace * (4.0 * size(y) + abs(h) * size(Om) * size(Om))


@inlined
def lie_column(function, more, k, h, trace, E, Om, EO, a, force, G, F):
    """Return dr/dy_k; G holds the columns of d(force)/dy."""
    g = add(cross(Om, E[k]), unit_cross(k, EO))
    if more is not None:
        if more.damped:
            g = axpy(-1.0, column(more.damping, k), g)
        if more.pushed:
            g = axpy(-0.5 * h, unit_cross(k, force), g)
            if function is not None:
                g = add(g, axpy(-1.0, cross(a, G[k]), G[k]))
        if more.heavy:
            g = axpy(0.5 * h, dead_rate(F, a, unit(k)), g)
    return add_unit(k, 2.0 * trace, axpy(-h, g, scaled(-2.0, E[k])))


@inlined
def dead_moment(F, a):
    """Return ``(I - â) Σ M e_i × F_i = (I - s a aᵀ) k`` with ``k = Σ e_i × (F_i - a × F_i)``."""
    k = axpy(-1.0, dead_turning(F, a), first_moment(F))
    return axpy(-dot(a, k) / (1.0 + dot(a, a)), a, k)


@inlined
def dead_rate(F, a, e):
    """Return the derivative of `dead_moment` in a along e."""
    s = 1.0 / (1.0 + dot(a, a))
    k, dk = axpy(-1.0, dead_turning(F, a), first_moment(F)), scaled(-1.0, dead_turning(F, e))
    c, dc = s * dot(a, k), s * (dot(e, k) + dot(a, dk))
    return axpy(-c, e, axpy(2.0 * s * c * dot(a, e) - dc, a, dk))


@inlined
def dead_turning(F, a):
    """Return ``Σ e_i × (a × F_i) = tr(F) a - Fᵀ a``."""
    return axpy(F[0][0] + F[1][1] + F[2][2], a, scaled(-1.0, transposed_times(F, a)))


# energy-momentum: r(y) = J y - z + h/2 [τ Ω - W × EΩ - N E Ω] - h/2 G with Ω = W + y.


@inlined
def director_step(function, more, h, W, N, E, fixed, loaded, B, m, F, R, t):
    """Return status, iterations, residual, y, a, s, m in b, work, L = Σ λ_i A_i."""
    zero = (0.0, 0.0, 0.0)
    trace, EN = E[0][0] + E[1][1] + E[2][2], (times(N, E[0]), times(N, E[1]), times(N, E[2]))
    tau, z = EN[0][0] + EN[1][1] + EN[2][2], first_moment(EN)
    y = (0.0, 0.0, -W[2]) if fixed else zero
    state, force, moving, G = zero, zero, zero, (zero, zero, zero)
    status, iteration, residual, previous, rate = STALLED, 0, NAN, 1.0, 1.0
    b0 = director_column(more, 0, h, trace, tau, E, W, N, F)
    b1 = director_column(more, 1, h, trace, tau, E, W, N, F)
    b2 = director_column(more, 2, h, trace, tau, E, W, N, F)
    while iteration < ITERATIONS:
        iteration += 1
        Om = add(W, y)
        a = scaled(0.5 * h, Om)
        EO = times(E, Om)
        turning = axpy(tau, Om, axpy(-1.0, cross(W, EO), scaled(-1.0, times(N, EO))))
        r = axpy(0.5 * h, turning, axpy(-1.0, z, axpy(trace, y, scaled(-1.0, times(E, y)))))
        c0, c1, c2 = b0, b1, b2
        if more is not None and more.heavy:
            r = axpy(-0.5 * h, axpy(-1.0, dead_turning(F, a), first_moment(F)), r)
        if loaded:
            s = 1.0 / (1.0 + dot(a, a))
            moving = B
            if more is not None:
                if more.damped:
                    moving = axpy(-s, times(more.damping, Om), B)
                if more.pushed:
                    if function is not None:
                        state = moment_of_state(function, t, R, more.basis, a, scaled(s, Om))
                    force = add(m, state)
            r = axpy(-0.5 * h, tested(a, s, moving, force), r)
        residual = abs(r[0]) + abs(r[1]) if fixed else size(r)
        stagnant = iteration > 2 and rate > 0.5
        if residual == 0.0 or (stagnant and residual <= ROUND_OFF * director_terms(h, trace, W, y, N)):
            status = OK
            break
        if loaded:
            if function is not None:
                if rate > 0.1:
                    for k in range(3):
                        e = scaled(sqrt(EPS) * max(size(Om), residual / trace, SMALLEST), unit(k))
                        ak = axpy(0.5 * h, e, a)
                        wk = scaled(1.0 / (1.0 + dot(ak, ak)), add(Om, e))
                        ahead = moment_of_state(function, t, R, more.basis, ak, wk)
                        G = (G[1], G[2], scaled(1.0 / e[k], axpy(-1.0, state, ahead)))
                if not size(state) + size(G[0]) + size(G[1]) + size(G[2]) < 1e300:
                    status = LOAD
                    break
            c0 = axpy(-0.5 * h, tested_rate(function, more, 0, h, a, s, moving, force, Om, G), c0)
            c1 = axpy(-0.5 * h, tested_rate(function, more, 1, h, a, s, moving, force, Om, G), c1)
            c2 = axpy(-0.5 * h, tested_rate(function, more, 2, h, a, s, moving, force, Om, G), c2)
        dy = solve(c0, c1, c2, scaled(-1.0, r), fixed)
        y = add(y, dy)
        increment, level = size(dy), size(W) + size(y)
        if not increment < 1e300:
            break
        rate = increment / previous if iteration > 1 else 0.0
        if (
            increment <= EPS * level
            or (rate > 0.5 and increment <= 1e-9 * level)
            or (function is None and iteration > 1 and increment * rate * rate <= 0.1 * EPS * level)
        ):
            status = OK
            break
        previous = increment
    Om = add(W, y)
    a = scaled(0.5 * h, Om)
    a2 = dot(a, a)
    s = 1.0 / (1.0 + a2)
    if status == OK and 4.0 * a2 > PI * PI:
        status = TURN
    X0 = director_row((0.0, y[2], -y[1]), a, (0.0, W[2], -W[1]), N[0])
    X1 = director_row((-y[2], 0.0, y[0]), a, (-W[2], 0.0, W[0]), N[1])
    X2 = director_row((y[1], -y[0], 0.0), a, (W[1], -W[0], 0.0), N[2])
    f = -2.0 * (1.0 / h)
    L0 = scaled(f, axpy(E[0][0], X0, axpy(E[0][1], X1, scaled(E[0][2], X2))))
    L1 = scaled(f, axpy(E[1][0], X0, axpy(E[1][1], X1, scaled(E[1][2], X2))))
    L2 = scaled(f, axpy(E[2][0], X0, axpy(E[2][1], X1, scaled(E[2][2], X2))))
    if more is not None and more.heavy:
        L0 = add(L0, axpy(-1.0, cross(a, F[0]), F[0]))
        L1 = add(L1, axpy(-1.0, cross(a, F[1]), F[1]))
        L2 = add(L2, axpy(-1.0, cross(a, F[2]), F[2]))
    work = 0.0
    if loaded:
        if more is not None and more.damped:
            B = axpy(-s, times(more.damping, Om), B)
        force = add(force, mean(s, a, B))
        work = h * s * dot(Om, force)
        L0 = add(L0, loaded_row(s, a, force, (1.0, 0.0, 0.0)))
        L1 = add(L1, loaded_row(s, a, force, (0.0, 1.0, 0.0)))
        L2 = add(L2, loaded_row(s, a, force, (0.0, 0.0, 1.0)))
        force = scaled(0.5, axpy(1.0 + s, force, scaled(-s * dot(a, force), a)))  # Σ d_{i,m} × f_i
    return status, iteration, residual, y, a, s, force, work, (L0, L1, L2)


@inlined
def director_terms(h, trace, W, y, N):
    """Return the size of the terms of r without load, as `lie_terms`."""
    across = size(N[0]) + size(N[1]) + size(N[2])
    return trace * (2.0 * size(y) + across + 0.5 * abs(h) * (size(W) + across) * (size(W) + size(y)))


@inlined
def director_column(more, k, h, trace, tau, E, W, N, F):
    """Return dr/dy_k without the moments of the load: r is linear in y but for them."""
    turning = add_unit(k, tau, axpy(-1.0, cross(W, E[k]), scaled(-1.0, times(N, E[k]))))
    if more is not None and more.heavy:
        turning = axpy(0.5 * h, dead_turning(F, unit(k)), turning)
    return add_unit(k, trace, axpy(0.5 * h, turning, scaled(-1.0, E[k])))


@inlined
def tested(a, s, moving, force):
    """Return G of a moment ``Λ_m moving + Λ_n force``."""
    both = add(moving, force)
    return scaled(0.5, axpy(1.0 + s, axpy(-1.0, cross(a, force), both), scaled(s * dot(a, both), a)))


@inlined
def tested_rate(function, more, k, h, a, s, moving, force, Om, G):
    """Return dG/dy_k; `moving` holds the damping ``-s C Ω``, and ``G[k]`` is d(force)/dy_k."""
    p, dp = moving, (0.0, 0.0, 0.0)
    q, dq, ds = dot(a, moving), 0.5 * h * moving[k], -s * s * h * a[k]
    if more is not None:
        if more.damped:
            dp = axpy(-ds, times(more.damping, Om), scaled(-s, column(more.damping, k)))
            dq += dot(a, dp)
        if more.pushed:
            p = add(p, axpy(-1.0, cross(a, force), force))
            q += dot(a, force)
            dq += 0.5 * h * force[k]
            dp = axpy(-0.5 * h, unit_cross(k, force), dp)
            if function is not None:
                dp = add(dp, axpy(-1.0, cross(a, G[k]), G[k]))
                dq += dot(a, G[k])
    rate = axpy(ds, p, axpy(1.0 + s, dp, scaled(ds * q + s * dq, a)))
    return scaled(0.5, add_unit(k, 0.5 * h * s * q, rate))


@inlined
def director_row(ye, a, We, N):
    """Return ``(I - â)(u_i - v_i)`` in b: ``y × e_i - N_i + a × (W × e_i + N_i)``."""
    return axpy(-1.0, N, add(ye, cross(a, add(We, N))))


@inlined
def loaded_row(s, a, m, e):
    """Return ``(I - â) (m × M e_i)/2``."""
    f = scaled(0.5, cross(m, mean(s, a, e)))
    return axpy(-1.0, cross(a, f), f)


@inlined
def flipped(a, s, y, N):
    """Return the changes of W and N: ``V_i`` changes by ``2 Mᵀ (y × e_i - N_i)``."""
    x0 = mean_transposed(2.0 * s, a, axpy(-1.0, N[0], (0.0, y[2], -y[1])))
    x1 = mean_transposed(2.0 * s, a, axpy(-1.0, N[1], (-y[2], 0.0, y[0])))
    x2 = mean_transposed(2.0 * s, a, axpy(-1.0, N[2], (y[1], -y[0], 0.0)))
    dW = (0.5 * (x1[2] - x2[1]), 0.5 * (x2[0] - x0[2]), 0.5 * (x0[1] - x1[0]))
    xy, xz, yz = 0.5 * (x0[1] + x1[0]), 0.5 * (x0[2] + x2[0]), 0.5 * (x1[2] + x2[1])
    dN = ((x0[0], xy, xz), (xy, x1[1], yz), (xz, yz, x2[2]))
    return dW, (add(N[0], dN[0]), add(N[1], dN[1]), add(N[2], dN[2]))


@kernel
def begin(q, v, basis, state, normal):
    """Write p, W and N of the directors and velocities given as rows; return the largest entry of N over that of V.

    Entries of N that are round-off of V become 0. The quaternion is Shepperd's.
    """
    B = rows(basis)
    C = (column(B, 0), column(B, 1), column(B, 2))
    D, V = of_body(C, rows(q)), of_body(C, rows(v))
    (a, d, g), (b, e, h), (c, f, i) = D  # Λ, column by column
    trace = a + e + i
    if trace >= max(a, e, i):
        p = (1.0 + trace, h - f, c - g, d - b)
    elif a >= max(e, i):
        p = (h - f, 1.0 - trace + 2.0 * a, b + d, c + g)
    elif e >= i:
        p = (c - g, b + d, 1.0 - trace + 2.0 * e, f + h)
    else:
        p = (d - b, c + g, f + h, 1.0 - trace + 2.0 * i)
    length = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2] + p[3] * p[3])
    for k in range(4):
        state[k] = p[k] / length
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
    q = of_body(B, (column(R, 0), column(R, 1), column(R, 2)))
    v = of_body(B, (times(R, V[0]), times(R, V[1]), times(R, V[2])))
    for i in range(3):
        for j in range(3):
            directors[i, j], velocities[i, j] = q[i][j], v[i][j]


@kernel
def march(state, normal, function, more, body, grid, out, first, done):
    """March from the step number `first` over the nodes of `grid`; `function` (t, directors, w) -> m, or None.

    `more`, `body`, `grid` and `out` come as plain tuples: a class of this package in a signature would be part of the
    cache, where a later version could not read it.

    Returns the status, the number of the next step or of the one that failed, the stored intervals, the residual, the
    turn, the node.
    """
    E, fixed, loaded, moving = body
    h, fractions, times_, stored = grid
    directors, velocities, multipliers, moments, works, iterations = out
    E, extra = rows(E), with_rows(more)
    p, W, Wc, rate = loaded_state(state)
    zero = (0.0, 0.0, 0.0)
    N = (zero, zero, zero)
    if normal is not None:
        N = rows(normal)
    B, m, F, R = zero, zero, N, attitude(p)
    stages, nodes = fractions.shape[0], times_.shape[0]
    weight = 1.0 / float(stored[done + 1] - stored[done])
    status, node, k, residual, turn, acts = OK, 0, first, 0.0, 0.0, False
    if abs(h) * size(W) > FARTHEST:
        return TURN, k, done, NAN, abs(h) * size(W), node
    while node < nodes:
        for stage in range(stages):
            part, t = float(fractions[stage]), float(times_[node])
            hs, part = h * part, part * weight
            if loaded:
                B = row(moving, node)
                acts = B[0] != 0.0 or B[1] != 0.0 or B[2] != 0.0
            if more is not None:
                acts = acts or extra.pushed or extra.damped
                if extra.pushed:
                    m = transposed_times(R, row(extra.space, node))
                if extra.heavy:
                    f0, f1, f2 = extra.dead
                    F = (transposed_times(R, f0), transposed_times(R, f1), transposed_times(R, f2))
            if normal is None:
                status, count, residual, y, a, s, mu, moment, work = lie_step(
                    function, extra, hs, W, scaled(hs, rate), E, fixed, acts, B, m, F, R, t
                )
            else:
                status, count, residual, y, a, s, moment, work, L = director_step(
                    function, extra, hs, W, N, E, fixed, acts, B, m, F, R, t
                )
            if status != OK:
                turn = abs(h / hs) * 2.0 * sqrt(dot(a, a)) if status == TURN else h * sqrt(dot(W, W))
                break
            if normal is None:
                dW = scaled(2.0, y)
                if fixed:
                    multipliers[done, 0] += part * mu
            else:
                dW, N = flipped(a, s, y, N)
                add_multipliers(extra, multipliers, done, part, L, fixed)
            if acts:
                moment = times(R, moment)
                moments[done, 0] += part * moment[0]
                moments[done, 1] += part * moment[1]
                moments[done, 2] += part * moment[2]
                works[done] += work
            iterations[done] = max(iterations[done], count)
            W, Wc = summed(W, Wc, dW)
            rate = scaled(1.0 / hs, y)
            p, gap = advanced(p, a, s)
            if loaded or more is not None or stage == stages - 1:
                R = attitude(p)
            if not gap <= 1e-9:
                status, residual, turn = BROKEN, gap, NAN
                break
            node += 1
        if status != OK:
            break
        k += 1
        if k == stored[done + 1]:
            done += 1
            write(normal, extra, directors, velocities, done, R, W, N)
            if done + 1 < stored.shape[0]:
                weight = 1.0 / float(stored[done + 1] - stored[done])
    store_state(state, p, W, Wc, rate)
    if normal is not None:
        for i in range(3):
            normal[i, 0], normal[i, 1], normal[i, 2] = N[i]
    return status, k, done, residual, turn, node


@inlined
def with_rows(more):
    """Return `more` with names, and with tuples for its constant matrices."""
    if more is None:
        return None
    heavy, dead, damped, damping, pushed, space, tilted, basis = more
    return More(heavy, rows(dead), damped, rows(damping), pushed, space, tilted, rows(basis))


@inlined
def row(values, node):
    k = node if values.shape[0] > 1 else 0
    return (float(values[k, 0]), float(values[k, 1]), float(values[k, 2]))


@inlined
def loaded_state(s):
    p = (float(s[0]), float(s[1]), float(s[2]), float(s[3]))
    W, Wc = (float(s[4]), float(s[5]), float(s[6])), (float(s[7]), float(s[8]), float(s[9]))
    return p, W, Wc, (float(s[10]), float(s[11]), float(s[12]))


@inlined
def store_state(s, p, W, Wc, rate):
    s[0], s[1], s[2], s[3] = p
    s[4], s[5], s[6] = W
    s[7], s[8], s[9] = Wc
    s[10], s[11], s[12] = rate


@inlined
def compensated(x, c, d):
    """Return x + d, and the rounding error that the next sum takes up (Kahan)."""
    d = d + c
    total = x + d
    return total, d - (total - x)


@inlined
def summed(x, c, d):
    x0, c0 = compensated(x[0], c[0], d[0])
    x1, c1 = compensated(x[1], c[1], d[1])
    x2, c2 = compensated(x[2], c[2], d[2])
    return (x0, x1, x2), (c0, c1, c2)


@inlined
def advanced(p, a, s):
    """Return the quaternion of ``Λ (2M - I)``, that is ``p (1, a)/|(1, a)|``, and how far p was from unit length."""
    v = (p[1], p[2], p[3])
    gap = 1.0 - (p[0] * p[0] + dot(v, v))
    f = sqrt(s)
    less = (f - 1.0) + 0.5 * gap
    d = axpy(less, v, scaled(f, axpy(p[0], a, cross(v, a))))
    return (p[0] + (less * p[0] - f * dot(v, a)), v[0] + d[0], v[1] + d[1], v[2] + d[2]), abs(gap)


@inlined
def add_multipliers(more, out, k, part, L, fixed):
    """Add the multipliers of L = Σ λ_i A_i: its symmetric part, and μ of its skew part -μ n̂/2."""
    if fixed:
        out[k, 6] += part * (L[0][1] - L[1][0])
    if more is not None and more.tilted:
        L = of_body(more.basis, L)  # columns
        L = of_body(more.basis, (column(L, 0), column(L, 1), column(L, 2)))
    out[k, 0] += part * L[0][0]
    out[k, 1] += part * L[1][1]
    out[k, 2] += part * L[2][2]
    out[k, 3] += part * 0.5 * (L[1][2] + L[2][1])
    out[k, 4] += part * 0.5 * (L[0][2] + L[2][0])
    out[k, 5] += part * 0.5 * (L[0][1] + L[1][0])


@inlined
def of_body(basis, A):
    """Return ``basis A``: the rows for the body's own directions."""
    return (transposed_times(A, basis[0]), transposed_times(A, basis[1]), transposed_times(A, basis[2]))


@inlined
def write(normal, more, directors, velocities, k, R, W, N):
    """Write the directors as rows and their velocities ``Λ V_i``, ``V_i = W × e_i + N_i``."""
    q0, q1, q2 = column(R, 0), column(R, 1), column(R, 2)
    v0 = axpy(W[2], q1, scaled(-W[1], q2))
    v1 = axpy(W[0], q2, scaled(-W[2], q0))
    v2 = axpy(W[1], q0, scaled(-W[0], q1))
    if normal is not None:
        v0, v1, v2 = add(v0, times(R, N[0])), add(v1, times(R, N[1])), add(v2, times(R, N[2]))
    q, v = (q0, q1, q2), (v0, v1, v2)
    if more is not None and more.tilted:
        q, v = of_body(more.basis, q), of_body(more.basis, v)
    for j in range(3):
        directors[k, 0, j], directors[k, 1, j], directors[k, 2, j] = q[0][j], q[1][j], q[2][j]
        velocities[k, 0, j], velocities[k, 1, j], velocities[k, 2, j] = v[0][j], v[1][j], v[2][j]
