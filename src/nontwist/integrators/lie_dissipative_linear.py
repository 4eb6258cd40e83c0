"""A step of `lie_midpoint` with dissipation, linearised.

In body components, with U = (W_n + W_{n+1})/2, T = J U + c and g of `lie_midpoint`,

    Ω = U + g T × U,     r = J (U - W_n) - (h/2) [T × Ω + M - c' - C Ω + (I - â) f + ...] = 0,     a = hΩ/2,

f what acts in space. A change of the state or of an input alone changes r by r' and Ω by Ω'; with A = ∂r/∂U

    dU = -A⁻¹ r',    dΩ = Ω' + (∂Ω/∂U) dU,    dW⁺ = 2 dU - dW,    δ⁺ = Cᵀδ + 2s (da - a × da).

U is known from the states at both ends.
"""

from ..engine.lane import put_vector, vector
from ..engine.linear import CALLED, FIXED, LINEAR, applied, emit, inertia_times, tall
from ..geometry.compiled import kernel, shared
from ..geometry.elements import doubles, eight, lanes, load, root, splat, store
from ..geometry.tuples import (
    EPS,
    add,
    axpy,
    cross,
    dot,
    first_moment,
    inverse_of,
    minus,
    scaled,
    size,
    times,
    unit,
)
from .midpoint_linear import AT, columns, dead_moment, dead_turning, put_rows, rows_at, seen, turned_back

ROWS, TINY = 6, 1e-300


@shared
def turning_change(b, x, J, one, dU, dh, entry, dc):
    """Return the changes of T and of Ω."""
    n, fixed = lanes(one), doubles(b[LINEAR.body])
    h, U, T, g = load(x, AT.h * n, one), vector(x, AT.U, one), vector(x, AT.T, one), load(x, AT.g * n, one)
    trace = 2.0 * (fixed[FIXED.principal] + fixed[FIXED.principal + 1] + fixed[FIXED.principal + 2])
    first, second = fixed[FIXED.dissipation] / trace, fixed[FIXED.dissipation + 1] / trace
    speed = root(dot(U, U))
    dT = add(add(times(J, dU), inertia_times(entry, U)), dc)
    dg = dh * (first + 2.0 * second * h * speed) + second * h * h * (dot(U, dU) / (speed + TINY))
    dg = dg - g * ((1.0 if 0 <= entry < 3 else 0.0) / trace)
    dOm = axpy(dg, cross(T, U), axpy(g, add(cross(dT, U), cross(T, dU)), dU))
    return dT, dOm


@shared
def residual_change(b, x, body, one, dU, dW, dh, entry, dM, df, dF, dDOm, dc, rate):
    """Return the change of r; arguments as of `midpoint_linear`, and dU."""
    (J, _, D), h = body, load(x, AT.h * lanes(one), one)
    U, T, Om, a = vector(x, AT.U, one), vector(x, AT.T, one), vector(x, AT.Om, one), vector(x, AT.a, one)
    f, F, W = vector(x, AT.space, one), rows_at(x, AT.dead, one), vector(x, AT.W, one)
    dT, dOm = turning_change(b, x, J, one, dU, dh, entry, dc)
    if b[LINEAR.called] != 0:
        df = add(df, applied(rows_at(x, AT.called + CALLED.velocity, one), dOm))
    s, da = 1.0 / (1.0 + dot(a, a)), scaled(0.5, axpy(dh, Om, scaled(h, dOm)))
    dG = add(add(cross(dT, Om), cross(T, dOm)), minus(minus(dM, rate), add(dDOm, times(D, dOm))))
    dG = add(dG, minus(df, add(cross(da, f), cross(a, df))))
    k = minus(first_moment(F), dead_turning(F, a))
    dk = minus(first_moment(dF), add(dead_turning(dF, a), dead_turning(F, da)))
    q, dq = s * dot(a, k), s * (dot(da, k) + dot(a, dk) - 2.0 * s * dot(a, da) * dot(a, k))
    dG = add(dG, minus(dk, axpy(dq, a, scaled(q, da))))
    dr = add(times(J, minus(dU, dW)), inertia_times(entry, minus(U, W)))
    return axpy(-0.5 * h, dG, axpy(-0.5 * dh, vector(x, AT.G, one), dr))


@shared
def solved(b, x, body, n0, one):
    """Find Ω and what is made of it; return by how much the equations are missed, relative to W."""
    (J, _, D), n, fixed = body, lanes(one), doubles(b[LINEAR.body])
    h, W, zero = load(x, AT.h * n, one), vector(x, AT.W, one), splat(0.0, one)
    o = (zero, zero, zero)
    none = (o, o, o)
    U = scaled(0.5, add(W, vector(x, AT.W1, one)))
    T = add(times(J, U), vector(x, AT.rotor, one))
    trace = 2.0 * (fixed[FIXED.principal] + fixed[FIXED.principal + 1] + fixed[FIXED.principal + 2])
    g = h * (fixed[FIXED.dissipation] + fixed[FIXED.dissipation + 1] * h * root(dot(U, U))) / trace
    Om = axpy(g, cross(T, U), U)
    a = scaled(0.5 * h, Om)
    put_vector(x, AT.U, U)
    put_vector(x, AT.T, T)
    put_vector(x, AT.Om, Om)
    put_vector(x, AT.a, a)
    store(x, AT.g * n, g)
    seen(b, x, Om, one)
    f = vector(x, AT.space, one)
    G = add(cross(T, Om), axpy(-1.0, times(D, Om), vector(x, AT.moving, one)))
    G = add(minus(G, vector(x, AT.rate, one)), minus(f, cross(a, f)))
    G = add(G, dead_moment(rows_at(x, AT.dead, one), a))
    put_vector(x, AT.G, G)
    for k in range(3):
        e = tall(unit(k), one)
        put_vector(x, AT.S + 3 * k, residual_change(b, x, body, one, e, o, 0.0, -1, o, o, none, o, o, o))
    c0, c1, c2 = rows_at(x, AT.S, one)
    S = inverse_of(c0, c1, c2)
    put_rows(x, AT.S, S)
    r = axpy(-0.5 * h, G, times(J, minus(U, W)))
    return size(times(S, r)) / (size(U) + size(W) + EPS / abs(h))


@shared
def emitted(b, x, body, n0, out, first, column, one, delta, dh, dW, dN, entry, dn, dM, df, dF, dDOm, dc, rate):
    """Write the column of one change of the state, or of an input."""
    h, a, Om, zero = load(x, AT.h * lanes(one), one), vector(x, AT.a, one), vector(x, AT.Om, one), splat(0.0, one)
    o, s = (zero, zero, zero), 1.0 / (1.0 + dot(a, a))
    r = residual_change(b, x, body, one, o, dW, dh, entry, dM, df, dF, dDOm, dc, rate)
    dU = scaled(-1.0, times(rows_at(x, AT.S, one), r))
    _, dOm = turning_change(b, x, body[0], one, dU, dh, entry, dc)
    da = scaled(0.5, axpy(dh, Om, scaled(h, dOm)))
    turn = scaled(2.0 * s, minus(da, cross(a, da)))
    emit(b, out, first, column, add(turned_back(s, a, delta), turn) + axpy(2.0, dU, scaled(-1.0, dW)))


@kernel(unroll=False)
def dissipative_steps(address):
    columns(address, eight(), solved, emitted, ROWS)
