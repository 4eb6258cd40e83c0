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
from ..kernels.elements import cos, larger, logical_not, select, sin, sqrt
from ..kernels.kernel import kernel
from ..kernels.memory import View, call, doubles, fields, put, size_of, vector_at
from ..kernels.vectors import Matrix, Vector, cross, inverse_of
from .records import Acting, places

MOMENT, PAPER, EXACT, STAGE = range(4)  # actions: m; y; m, with σ; the torque of potentials in the body
QUADRATIC, SPRING, FUNCTION, ORBITING = range(4)
NAN, LOST, SHORT = float("nan"), 1e300, 1e-11  # of V; of |Δγ|² over |γ|²


class Terms(NamedTuple):
    """What stands before the potentials."""

    function: int  # address of one of director forces, 0: none
    potentials: int  # how many there are


class Term(NamedTuple):
    """A potential."""

    kind: int
    scale: float
    dimension: int  # how many vectors in space it has
    vectors: Annotated[tuple[Any, ...], 12]
    linear: Vector  # l or ρ
    quadratic: Matrix  # Q
    square: float  # |ρ|² + |a|²
    stiffness: float  # or the rate of an orbit
    rest: float  # length
    function: int  # address of V and its gradient


TERM, TERMS = places(Term), size_of(Terms)
ROOM = fields(Acting)["room"].place
W = fields(Acting)["w"].place
AT, ENDS = 16, 32  # within the room: what V is called with, and what it gives at both ends


class Potential(NamedTuple):
    """A potential at a state: directors as rows in space, half turn, time."""

    term: View
    row: Any  # its numbers
    room: Any
    d: Matrix
    half: Vector
    t: Any

    def space_vector(self, n: Any) -> Vector:
        """Return the vector number n; one on an orbit turns at its rate."""
        v = Variables(a=vector_at(self.row, TERM.vectors + 3 * n))
        for _ in when(self.term.kind == ORBITING):
            angle = self.term.stiffness * self.t
            v.a = cos(angle) * v.a + sin(angle) * vector_at(self.row, TERM.vectors + 3)
        found: Vector = v.a
        return found

    def gradient(self, n: Any, g: Vector) -> Vector:
        """Return the discrete gradient by the vector number n, seen as g; the first one calls the function."""
        term, delta, kind = self.term, -cross(self.half, g), self.term.kind
        v = Variables(gradient=term.linear + term.quadratic @ g)
        for _ in when(kind == SPRING):
            rho, square = term.linear, term.square
            u, du = rho @ g, rho @ delta
            lengths = sqrt(larger(square - 2.0 * (u - du), 0.0)) + sqrt(larger(square - 2.0 * (u + du), 0.0))
            v.gradient = (-term.stiffness * (1.0 - 2.0 * term.rest / lengths)) * rho
        for _ in when(kind == FUNCTION):
            for _ in when(n == 0):
                self.evaluate()
            v.gradient = (2.0 * self.room[1 + 3 * term.dimension]) * delta + vector_at(self.room, 1 + 3 * n)
        found: Vector = v.gradient
        return found

    def put_seen(self, sign: float) -> None:
        """Set what V is called with: the vectors as seen in the middle of the step, or at one of its ends."""
        for n in loop(self.term.dimension):
            g = self.d @ vector_at(self.row, TERM.vectors + 3 * n)
            put(self.room.shifted(AT), g + sign * cross(self.half, g), 3 * n)

    def evaluate(self) -> None:
        """Set the room to V, its gradient at the mean, and what Δγ is multiplied by."""
        room, at, ends, term = self.room, self.room.shifted(AT), self.room.shifted(ENDS), self.term
        factor, v = 1 + 3 * term.dimension, Variables(length=0.0, across=0.0, first=0.0, along=0.0)
        self.put_seen(0.0)
        for n in loop(term.dimension):
            g = vector_at(at, 3 * n)
            delta = cross(self.half, g)
            v.length, v.across = v.length + g @ g, v.across + 4.0 * (delta @ delta)
        call(term.function, self.t, at, at, room)
        for _ in when(logical_not(abs(room[0]) <= LOST)):  # of a state V itself is not used, but it must be there
            room[1] = NAN
        room[factor] = 0.0
        for _ in when(v.across > SHORT * v.length):
            for n in loop(term.dimension):
                v.along = v.along - 2.0 * (vector_at(room, 1 + 3 * n) @ cross(self.half, vector_at(at, 3 * n)))
            self.put_seen(1.0)
            call(term.function, self.t, at, at, ends)
            v.first = ends[0]
            self.put_seen(-1.0)
            call(term.function, self.t, at, at, ends)
            room[factor] = (ends[0] - v.first - v.along) / v.across


def moment_of(d: Matrix, F: Matrix) -> Vector:
    """Return ``Σ d_i × F_i``."""
    return cross(d[0], F[0]) + (cross(d[1], F[1]) + cross(d[2], F[2]))


def without_turn(d: Matrix, m: Vector) -> Vector:
    """Return x with ``(tr D I - D) x = m``, D = Σ d_i ⊗ d_i."""
    D = d.T @ d
    trace, rows = D.trace, (-D).T
    columns = (Vector(*(trace + x if i == j else x for j, x in enumerate(row))) for i, row in enumerate(rows))
    x: Vector = inverse_of(*columns) @ m
    return x


def forces_of(x: View, memory: Any, function: Any, d: Matrix) -> Matrix:
    """Return the forces on the directors d, rows in space."""
    v = Variables(F=0.0 * d)
    for _ in when(x.node != 0):
        f = doubles(x.node)
        along = Matrix(*(vector_at(f, 9 + 3 * i) for i in range(3)))
        v.F = Matrix(*(vector_at(f, 3 * i) for i in range(3))) + along @ d
    for _ in when(function != 0):
        room = memory.shifted(ROOM)
        call(function, x.t, memory, memory.shifted(W), room)
        v.F = v.F + Matrix(*(vector_at(room, 3 * i) for i in range(3)))
    found: Matrix = v.F
    return found


@kernel("i8")
def generalised(address: Any) -> None:
    """Set moments of the load and of potentials, and σ, from the directors, time, and half turn in the block."""
    memory = doubles(address)
    x = View(Acting, memory)
    terms, d, half, t, action = View(Terms, doubles(x.terms)), x.directors, x.half, x.t, x.action
    F, room = forces_of(x, memory, terms.function, d), memory.shifted(ROOM)
    v = Variables(H=0.0 * d, torque=0.0 * half)
    for k in loop(terms.potentials):
        row = doubles(x.terms + 8 * (TERMS + TERM.size * k))
        term = View(Term, row)
        potential = Potential(term, row, room, d, half, t)
        for n in loop(term.dimension):
            a = potential.space_vector(n)
            g = term.scale * potential.gradient(n, d @ a)
            v.H = Matrix(*(h - y * a for h, y in zip(v.H, g, strict=True)))
            v.torque = v.torque + cross(d @ a, g)
    load, held = moment_of(d, F), moment_of(d, v.H)
    v.load, v.held = load, select(action == STAGE, v.torque, held)
    for _ in when((action == PAPER) | (action == EXACT)):
        y, z = without_turn(d, load), without_turn(d, held)
        rest = F + v.H - Matrix(*(cross(y + z, one) for one in d))
        across = Matrix(cross(d[1], d[2]), cross(d[2], d[0]), cross(d[0], d[1]))
        x.rest = (rest @ ((1.0 / (d[0] @ across[0])) * across).T).symmetric
        is_paper = action == PAPER
        v.load, v.held = select(is_paper, 2.0 * y, load), select(is_paper, 2.0 * z, held)
    x.load, x.held = v.load, v.held
