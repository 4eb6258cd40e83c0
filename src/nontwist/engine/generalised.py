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

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from ..kernels.control import Variables, loop, when
from ..kernels.elements import cos, larger, select, sin, sqrt
from ..kernels.kernel import kernel
from ..kernels.memory import View, call, doubles, put, vector_at, wholes
from ..kernels.parts import part
from ..kernels.vectors import Matrix, Symmetric, Vector, cross, inverse_of
from .records import Acting, places

MOMENT, PAPER, EXACT, STAGE = range(4)  # actions: m; y; m, with σ; the torque of potentials in the body
QUADRATIC, SPRING, FUNCTION, ORBITING = range(4)
NAN, LOST, SHORT = float("nan"), 1e300, 1e-11  # of V; of |Δγ|² over |γ|²
ZERO = Vector(0.0, 0.0, 0.0)


class Term(NamedTuple):
    """A potential."""

    kind: int
    scale: float
    number: int  # of vectors
    vectors: Annotated[tuple[Any, ...], 12]  # in space; of an orbit the radius at the time 0 and that a quarter later
    linear: Vector  # l or ρ
    quadratic: Matrix
    square: float  # |ρ|² + |a|²
    stiffness: float  # k, or the rate of an orbit
    rest: float
    function: int  # address of V and its gradient


TERM, W, ROOM = places(Term), places(Acting).w, places(Acting).room


def moment_of_rows(d: Matrix, F: Matrix) -> Vector:
    """Return ``Σ d_i × F_i``."""
    return cross(d[0], F[0]) + (cross(d[1], F[1]) + cross(d[2], F[2]))


def turn_of(d: Matrix, m: Vector) -> Vector:
    """Return x with ``(tr D I - D) x = m``, D = Σ d_i ⊗ d_i."""
    D = d.T @ d
    A = Matrix(*(Vector(*((D.trace if i == j else 0.0) - D[i][j] for j in range(3))) for i in range(3)))
    return inverse_of(*A) @ m


def forces_of(x: Any, a: View, forces: Any, d: Matrix) -> Matrix:
    """Return the forces on the directors d, rows in space."""
    v = Variables(F=Matrix(ZERO, ZERO, ZERO))
    for _ in when(a.node != 0):
        f = doubles(a.node)
        rows, phi = (Matrix(*(vector_at(f, first + 3 * i) for i in range(3))) for first in (0, 9))
        v.F = rows + phi @ d
    for _ in when(forces != 0):
        room = x.shifted(ROOM)
        call(forces, a.t, x, x.shifted(W), room)
        v.F = v.F + Matrix(*(vector_at(room, 3 * i) for i in range(3)))
    found: Matrix = v.F
    return found


def space_vector(term: View, v: Any, t: Any) -> Vector:
    """Return the vector number v of a potential at the time t; one on an orbit turns at its rate."""
    numbers = Variables(a=_vector(term, v))
    for _ in when(term.kind == ORBITING):
        angle = term.stiffness * t
        numbers.a = cos(angle) * numbers.a + sin(angle) * _vector(term, 1)
    found: Vector = numbers.a
    return found


def _vector(term: View, v: Any) -> Vector:
    return vector_at(doubles(term.address), TERM.vectors + 3 * v)


def gradient_of(x: Any, a: View, term: View, v: Any, g: Vector) -> Vector:
    """Return the discrete gradient by the vector number v of a potential, which is g; the first one calls V."""
    found, delta = Variables(grad=ZERO), -cross(a.half, g)
    for _ in when((term.kind == QUADRATIC) | (term.kind == ORBITING)):
        found.grad = term.linear + term.quadratic @ g
    for _ in when(term.kind == SPRING):
        rho = term.linear
        u, du = rho @ g, rho @ delta
        first, last = (sqrt(larger(term.square - 2.0 * y, 0.0)) for y in (u - du, u + du))
        found.grad = (-term.stiffness * (1.0 - 2.0 * term.rest / (first + last))) * rho
    for _ in when(term.kind == FUNCTION):
        room = x.shifted(ROOM)
        for _ in when(v == 0):
            called(x, a, term)
        found.grad = 2.0 * room[1 + 3 * term.number] * delta + vector_at(room, 1 + 3 * v)
    grad: Vector = found.grad
    return grad


@part
def called(x: Any, a: View, term: View) -> None:
    """Set room to V, its gradient at the mean, and what Δγ is multiplied by."""
    d, half, count, t, room = a.directors, a.half, term.number, a.t, x.shifted(ROOM)
    at, ends = room.shifted(16), room.shifted(32)
    v = Variables(length=0.0, across=0.0, first=0.0, last=0.0, along=0.0)
    for k in loop(count):
        g = d @ _vector(term, k)
        delta = cross(half, g)
        v.length, v.across = v.length + g @ g, v.across + 4.0 * (delta @ delta)
        put(at, g, 3 * k)
    call(term.function, t, at, at, room)
    room[1] = select(abs(room[0]) <= LOST, room[1], NAN)  # of a state V itself is not used, but it must be there
    room[1 + 3 * count] = 0.0
    for _ in when(v.across > SHORT * v.length):
        for end in loop(2):
            for k in loop(count):
                g = d @ _vector(term, k)
                put(at, select(end == 0, 1.0, -1.0) * cross(half, g) + g, 3 * k)
            call(term.function, t, at, at, ends)
            v.first, v.last = v.last, ends[0]
        for k in loop(count):
            v.along = v.along + vector_at(room, 1 + 3 * k) @ (-2.0 * cross(half, d @ _vector(term, k)))
        room[1 + 3 * count] = (v.last - v.first - v.along) / v.across


@kernel("i8")
def generalised(address: Any) -> None:
    """Set moments of the load and of potentials, and σ, from the directors, time, and half turn in the block."""
    x = doubles(address)
    a = View(Acting, x)
    d, terms = a.directors, wholes(a.terms)
    F = forces_of(x, a, terms[0], d)
    v = Variables(H=Matrix(ZERO, ZERO, ZERO), torque=ZERO)
    for k in loop(terms[1]):
        term = View(Term, doubles(a.terms).shifted(2 + TERM.size * k))
        for i in loop(term.number):
            space = space_vector(term, i, a.t)
            g = d @ space
            grad = term.scale * gradient_of(x, a, term, i, g)
            v.H = Matrix(*(-y * space + row for y, row in zip(grad, v.H, strict=True)))
            v.torque = v.torque + cross(g, grad)
    load, H = moment_of_rows(d, F), v.H
    found = Variables(load=load, held=moment_of_rows(d, H))
    for _ in when(a.action == STAGE):
        found.held = v.torque
    for _ in when((a.action == PAPER) | (a.action == EXACT)):
        y, z = turn_of(d, load), turn_of(d, found.held)
        n = y + z
        rest = Matrix(*(F[i] + H[i] - cross(n, d[i]) for i in range(3)))
        c = cross(d[1], d[2]), cross(d[2], d[0]), cross(d[0], d[1])
        f = 1.0 / (d[0] @ c[0])
        r = [f * y for y in c]
        pairs = (0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)
        a.rest = Symmetric(*(rest[i] @ r[j] for i, j in pairs))
        for _ in when(a.action == PAPER):
            found.load, found.held = 2.0 * y, 2.0 * z
    a.load, a.held = found.load, found.held
