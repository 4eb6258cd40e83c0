"""Director forces and potentials: what they are at a state, for every compiled scheme.

A generalised load is three forces f^i on the directors, ``δW = Σ f^i·δd_i``. Its moment is m = Σ d_i × f^i. Forces come
from tables in space, from tables along the directors, f^i = Σ_j φ_ij d_j, and from a function. A potential V of
γ = Λᵀa, a space vector seen from the body, γ_j = a·d_j, has the forces

    f^j = -a ∂̄V/∂γ_j,

with a discrete gradient in the three numbers γ. In a midpoint step ``Δd_j = h Ω × d_{j,m}``, so the forces at the mean
directors do the work ``Σ f^j·Δd_j = -∂̄V·Δγ = -ΔV`` and have no moment about a: K + V and the vertical momentum stay.
With b the half turn of the step, γ_n and γ_{n+1} are γ_m ∓ δ, δ = -b × γ_m. The discrete gradients, each of order 2:

- quadratic V = l·γ + ½ γ·Qγ: the average vector field (AVF) l + Qγ_m, exact;
- the same with a vector a that turns on a circular orbit, taken at the time of the evaluation;
- a spring of stiffness k and rest length L between the point ρ of the body and a, ``V = ½ k (ℓ - L)²`` with
  ℓ² = |ρ|² + |a|² - 2 ρ·γ: V depends on one number ρ·γ, so the quotient of the differences is the AVF. By
  Δℓ (ℓ_0 + ℓ_1) = -2 ρ·Δγ it is ``-k (1 - 2 L/(ℓ_0 + ℓ_1)) ρ``, without a difference;
- a function V with its gradient: Gonzalez's ∇V(γ_m) + (ΔV - ∇V(γ_m)·Δγ) Δγ/|Δγ|². Below |Δγ| = `SHORT` |γ| the second
  part is left out: it changes the energy by less than round-off of V.

Where a scheme evaluates a state and not a step, b = 0, and these are the gradients at γ.

Actions. What a scheme wants of the moment m differs: m itself; of a scheme that turns a moment y into the forces
``½ y × d_{i,m}``, the y = 2x for which they have the moment m, (tr D I - D) x = m, D = Σ d_i ⊗ d_i; or, of stages that
are not orthonormal, the torque γ × ∂V/∂γ in the body, for which Gauss collocation keeps K + V with quadratic V. Forces
are x × d_i and a symmetric rest Σ_j σ_ij d_j, which does no work on rotations: it is carried by the multipliers λ.
"""

from math import cos, sin

from ..geometry.compiled import inlined, kernel, shared
from ..geometry.elements import call_moment, doubles, integers, root, shifted
from ..geometry.tuples import NAN, add, axpy, cross, dot, inverse_of, minus, scaled, times
from .layout import ACTING, TERM

MOMENT, PAPER, EXACT, STAGE = range(4)  # actions: m; y; m, with σ; the torque of potentials in the body
QUADRATIC, SPRING, FUNCTION, ORBITING = range(4)
LOST, SHORT = 1e300, 1e-11  # of V; of |Δγ|² over |γ|²


@inlined
def vector_at(x, place):
    return (x[place], x[place + 1], x[place + 2])


@inlined
def put_at(x, place, v):
    x[place], x[place + 1], x[place + 2] = v


@inlined
def rows_at(x, place):
    return (vector_at(x, place), vector_at(x, place + 3), vector_at(x, place + 6))


@inlined
def moment_of_rows(d, F):
    """Return ``Σ d_i × F_i``."""
    return add(cross(d[0], F[0]), add(cross(d[1], F[1]), cross(d[2], F[2])))


@inlined
def seen(d, a):
    """Return ``γ_j = a·d_j``."""
    return (dot(d[0], a), dot(d[1], a), dot(d[2], a))


@inlined
def turn_of(d, m):
    """Return x with ``(tr D I - D) x = m``."""
    c0 = axpy(-d[0][0], d[0], axpy(-d[1][0], d[1], scaled(-d[2][0], d[2])))
    c1 = axpy(-d[0][1], d[0], axpy(-d[1][1], d[1], scaled(-d[2][1], d[2])))
    c2 = axpy(-d[0][2], d[0], axpy(-d[1][2], d[1], scaled(-d[2][2], d[2])))
    tr = -(c0[0] + c1[1] + c2[2])
    A = inverse_of((tr + c0[0], c0[1], c0[2]), (c1[0], tr + c1[1], c1[2]), (c2[0], c2[1], tr + c2[2]))
    return times(A, m)


@shared
def forces_of(x, b, terms, d):
    """Return the forces on the directors d, rows in space."""
    zero = (0.0, 0.0, 0.0)
    F = (zero, zero, zero)
    if b[ACTING.node] != 0:
        f = doubles(b[ACTING.node])
        F, phi = rows_at(f, 0), rows_at(f, 9)
        F = (
            axpy(phi[0][0], d[0], axpy(phi[0][1], d[1], axpy(phi[0][2], d[2], F[0]))),
            axpy(phi[1][0], d[0], axpy(phi[1][1], d[1], axpy(phi[1][2], d[2], F[1]))),
            axpy(phi[2][0], d[0], axpy(phi[2][1], d[1], axpy(phi[2][2], d[2], F[2]))),
        )
    if terms[0] != 0:
        call_moment(terms[0], x[ACTING.t], x, shifted(x, ACTING.w), shifted(x, ACTING.room))
        f = rows_at(x, ACTING.room)
        F = (add(F[0], f[0]), add(F[1], f[1]), add(F[2], f[2]))
    return F


@inlined
def space_vector(term, whole, v, t):
    """Return the vector number v of a potential at the time t; one on an orbit turns at the rate in `stiffness`."""
    a = vector_at(term, TERM.vectors + 3 * v)
    if whole[TERM.kind] == ORBITING:
        angle = term[TERM.stiffness] * t
        return axpy(cos(angle), a, scaled(sin(angle), vector_at(term, TERM.vectors + 3)))
    return a


@shared
def gradient_of(x, term, whole, d, half, v):
    """Return the discrete gradient by the vector number v of a potential; the first one calls the function."""
    g = seen(d, space_vector(term, whole, v, x[ACTING.t]))
    delta = scaled(-1.0, cross(half, g))
    if whole[TERM.kind] == QUADRATIC or whole[TERM.kind] == ORBITING:
        return add(vector_at(term, TERM.linear), times(rows_at(term, TERM.quadratic), g))
    if whole[TERM.kind] == SPRING:
        rho = vector_at(term, TERM.linear)
        u, du = dot(rho, g), dot(rho, delta)
        square = term[TERM.square]
        lengths = root(max(square - 2.0 * (u - du), 0.0)) + root(max(square - 2.0 * (u + du), 0.0))
        return scaled(-term[TERM.stiffness] * (1.0 - 2.0 * term[TERM.rest] / lengths), rho)
    count, room = whole[TERM.count], shifted(x, ACTING.room)
    if v == 0:
        called(room, term, whole, d, half, x[ACTING.t])
    grad = vector_at(room, 1 + 3 * v)
    return axpy(2.0 * room[1 + 3 * count], delta, grad)


@shared
def called(room, term, whole, d, half, t):
    """Set room to V, its gradient at the mean, and what Δγ is multiplied by."""
    count = whole[TERM.count]
    at, found = shifted(room, 16), shifted(room, 32)
    length, across = 0.0, 0.0
    for v in range(count):
        g = seen(d, vector_at(term, TERM.vectors + 3 * v))
        delta = cross(half, g)
        length, across = length + dot(g, g), across + 4.0 * dot(delta, delta)
        put_at(at, 3 * v, g)
    call_moment(whole[TERM.function], t, at, at, room)
    if not abs(room[0]) <= LOST:  # of a state V itself is not used, but it must be there
        room[1] = NAN
    room[1 + 3 * count] = 0.0
    if across > SHORT * length:
        first = last = 0.0
        for end in range(2):
            for v in range(count):
                g = seen(d, vector_at(term, TERM.vectors + 3 * v))
                put_at(at, 3 * v, axpy(1.0 if end == 0 else -1.0, cross(half, g), g))
            call_moment(whole[TERM.function], t, at, at, found)
            first, last = last, found[0]
        along = 0.0
        for v in range(count):
            g = seen(d, vector_at(term, TERM.vectors + 3 * v))
            along += dot(vector_at(room, 1 + 3 * v), scaled(-2.0, cross(half, g)))
        room[1 + 3 * count] = (last - first - along) / across


@kernel
def generalised(address):
    """Set moments of the load and of potentials, and σ, from the directors, time, and half turn in the block."""
    x, b = doubles(address), integers(address)
    terms, action, zero = integers(b[ACTING.terms]), b[ACTING.action], (0.0, 0.0, 0.0)
    reals, d, half = doubles(b[ACTING.terms]), rows_at(x, 0), vector_at(x, ACTING.half)
    F = forces_of(x, b, terms, d)
    H0, H1, H2, torque = zero, zero, zero, zero
    for k in range(terms[1]):
        place = 2 + TERM.size * k
        term, whole = shifted(reals, place), integers(b[ACTING.terms] + 8 * place)
        for v in range(whole[TERM.count]):
            a = space_vector(term, whole, v, x[ACTING.t])
            g = scaled(term[TERM.scale], gradient_of(x, term, whole, d, half, v))
            H0, H1, H2 = axpy(-g[0], a, H0), axpy(-g[1], a, H1), axpy(-g[2], a, H2)
            torque = add(torque, cross(seen(d, a), g))
    load, held = moment_of_rows(d, F), moment_of_rows(d, (H0, H1, H2))
    if action == STAGE:
        held = torque
    elif action != MOMENT:
        y, z = turn_of(d, load), turn_of(d, held)
        n = add(y, z)
        g0 = minus(add(F[0], H0), cross(n, d[0]))
        g1 = minus(add(F[1], H1), cross(n, d[1]))
        g2 = minus(add(F[2], H2), cross(n, d[2]))
        f = 1.0 / dot(d[0], cross(d[1], d[2]))
        r0, r1, r2 = scaled(f, cross(d[1], d[2])), scaled(f, cross(d[2], d[0])), scaled(f, cross(d[0], d[1]))
        put_at(x, ACTING.rest, (dot(g0, r0), dot(g1, r1), dot(g2, r2)))
        put_at(x, ACTING.rest + 3, (dot(g1, r2), dot(g0, r2), dot(g0, r1)))
        if action == PAPER:
            load, held = scaled(2.0, y), scaled(2.0, z)
    put_at(x, ACTING.load, load)
    put_at(x, ACTING.held, held)
