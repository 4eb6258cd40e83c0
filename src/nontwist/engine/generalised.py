"""Director forces and potentials: what they are at a state, for every compiled scheme.

A generalised load is three forces f^i on the directors, ``δW = Σ f^i·δd_i``. Its moment is m = Σ d_i × f^i. Forces come
from tables in space, from tables along the directors, f^i = Σ_j φ_ij d_j, and from a function. A potential V of
γ = Λᵀa, a space vector seen from the body, γ_j = a·d_j, has the forces

    f^j = -a ∂̄V/∂γ_j,

with a discrete gradient in the three numbers γ. In a midpoint step ``Δd_j = h Ω × d_{j,m}``, so the forces at the mean
directors do the work ``Σ f^j·Δd_j = -∂̄V·Δγ = -ΔV`` and have no moment about a: K + V and the vertical momentum stay.
With b the half turn of the step, γ_n and γ_{n+1} are γ_m ∓ δ, δ = -b × γ_m. The discrete gradients, each of order 2:

- quadratic V = l·γ + ½ γ·Qγ: the average vector field (AVF) l + Qγ_m, exact;
- the same with a vector a on an orbit (`loads.potentials`), taken at the time of the evaluation;
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

Derivatives. `sloped` evaluates the same text on dual numbers, in directions that lie side by side, in lanes: of
directors, velocity, time and half turn, of the forces of a table, and of the numbers of the terms. What a function
adds to them it gives itself, as a second function that returns its derivatives as well (`called_functions`).
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from ..kernels import machine_code
from ..kernels.control import Variables, loop, when
from ..kernels.dual import Dual, plain, tangent
from ..kernels.elements import cos, larger, logical_not, select, sin, sqrt
from ..kernels.kernel import kernel
from ..kernels.memory import Doubles, View, call, doubles, fields, memory_at, put, scratch, vector_at
from ..kernels.vectors import Matrix, Vector, cross, inverse_of
from ..loads.potentials import on_orbit
from ..loads.terms import MOST_NUMBERS
from .records import FORCES, StateCall, offsets_of

MOMENT, PAPER, EXACT, STAGE = range(4)  # actions: m; y; m, with σ; the torque of potentials in the body
QUADRATIC, SPRING, FUNCTION, ORBITING, OF_FORCES, OF_MOMENT = range(6)  # potentials; functions of the state
NAN, OVERFLOW, SHORT = float("nan"), 1e300, 1e-11  # of V; of |Δγ|² over |γ|²


class TracedTerm(NamedTuple):
    """A potential, or a function of the state."""

    kind: int
    scale: float
    dimension: int  # how many vectors in space it has
    vectors: Annotated[tuple[Any, ...], 12]
    linear: Vector  # l or ρ
    quadratic: Matrix  # Q
    square: float  # |ρ|² + |a|², or the eccentricity of an orbit
    stiffness: float  # or the rate of an orbit
    rest: float  # length, or the time at which an orbit begins
    function: int  # address of a function, of V and its gradient, of forces or of a moment
    slopes: int  # address of one that gives their derivatives as well
    numbers: int  # of the term, that a function is differentiated by
    own: Annotated[tuple[Any, ...], MOST_NUMBERS]


class Sloped(NamedTuple):
    """What `sloped` is called with."""

    state_call: StateCall
    directions: int
    seeds: Doubles  # (numbers, directions) of `StateCall`, of the forces of a table, of the terms
    slopes: Doubles  # (6, directions) where the derivatives of the moments of the load and of potentials go


TERM = offsets_of(TracedTerm)
SCRATCH = fields(StateCall)["scratch"].offset
W = fields(StateCall)["w"].offset
OF_TABLE = fields(StateCall)["half"].offset + 3  # places of seeds
OF_TERMS = OF_TABLE + FORCES
STATE = (*range(W + 3), *range(fields(StateCall)["t"].offset, OF_TABLE - 3), *range(OF_TABLE - 3, OF_TABLE))
GIVEN = W + 4  # numbers that a function of the state gets
AT, ENDS = 16, 32  # within the scratch: what V is called with, and what it gives at both ends


class TermState:
    """A state at which terms are evaluated, on plain numbers."""

    def __init__(self, memory: Any) -> None:
        self.memory, self.view = memory, View(StateCall, memory)
        self.scratch, x = memory.shifted(SCRATCH), View(StateCall, self.seeded(memory, 0))
        self.d, self.w, self.half, self.t = x.directors, x.w, x.half, x.t

    def seeded(self, memory: Any, place: Any) -> Any:
        """Return memory whose numbers have the derivatives of the seeds from a place on."""
        return memory

    def of_state(self, term: View, count: int) -> Any:
        """Return what a function of the state gives, in memory."""
        call(term.function, self.t, self.memory, self.memory.shifted(W), self.scratch)
        return self.scratch

    def of_potential(self, term: View, at: Any, found: Any) -> None:
        """Set V and its gradient for what is seen."""
        call(term.function, self.t, at, at, found)


class DualMemory:
    """Dual numbers in memory, with derivatives in as many directions as there are lanes, one stride apart."""

    def __init__(self, values: Any, tangents: Any, stride: Any) -> None:
        self.values, self.tangents, self.stride = values, tangents, stride

    def load(self, k: Any, n: int = 1) -> Dual:
        """Return the number at a place."""
        return Dual(self.values[k], [self.tangents.load(k * self.stride, machine_code.lanes())])

    def __setitem__(self, k: Any, x: Any) -> None:
        self.values[k] = plain(x)
        self.tangents.store(k * self.stride, tangent(x, 0), machine_code.lanes())

    def shifted(self, k: Any, is_whole: bool = False) -> Any:
        """Return the memory of what lies k numbers further; that of whole numbers has no derivatives."""
        values = self.values.shifted(k, is_whole)
        return values if is_whole else DualMemory(values, self.tangents.shifted(k * self.stride), self.stride)

    __getitem__ = load


class DualState(TermState):
    """A state on dual numbers, in some of the directions of the seeds, from `first` on."""

    def __init__(self, own: View, memory: Any, first: Any) -> None:
        self._own, self._first, side = own, first, machine_code.lanes()
        super().__init__(memory)
        self.scratch = DualMemory(self.scratch, scratch(fields(StateCall)["scratch"].size * side), side)
        self._numbers = DualMemory(scratch(GIVEN + MOST_NUMBERS), scratch((GIVEN + MOST_NUMBERS) * side), side)
        self._table = scratch((1 + FORCES // 2 + 3) * (1 + GIVEN + MOST_NUMBERS))

    def seeded(self, memory: Any, place: Any) -> Any:
        """Return memory of duals."""
        own = self._own
        return DualMemory(memory, own.seeds.shifted(place * own.directions + self._first), own.directions)

    def of_state(self, term: View, count: int) -> Any:
        """Return what a function of the state gives, in memory."""
        put(self._numbers, (self.d, self.w, self.t))
        call(term.slopes, plain(self.t), self.memory, self.memory.shifted(W), self._table)
        self._chain(GIVEN, term, count, self.scratch)
        return self.scratch

    def of_potential(self, term: View, at: DualMemory, found: DualMemory) -> None:
        """Set V and its gradient for what is seen."""
        n = 3 * term.dimension
        for k in loop(n):
            self._numbers[k] = at[k]
        call(term.slopes, plain(self.t), at.values, at.values, self._table)
        self._chain(n, term, 1 + n, found)

    def _chain(self, n: Any, term: View, count: Any, found: DualMemory) -> None:
        """Set what is found from the table of values and derivatives by the n numbers given, and those of the term."""
        numbers = self._numbers
        for k in loop(term.numbers):
            numbers[n + k] = term.number(TERM.own + k)
        n = n + term.numbers
        for i in loop(count):
            row = self._table.shifted(i * (1 + n))
            v = Variables(x=row[1] * tangent(numbers[0], 0))
            for j in loop(1, n):
                v.x = v.x + row[1 + j] * tangent(numbers[j], 0)
            found[i] = Dual(row[0], [v.x])


class PotentialAtState(NamedTuple):
    """A potential at a state."""

    term: View
    state: TermState

    def given(self, n: Any) -> Vector:
        """Return the vector number n as it was given."""
        return Vector(*(self.term.number(TERM.vectors + 3 * n + k) for k in range(3)))

    def space_vector(self, n: Any) -> Vector:
        """Return the vector number n; one on an orbit turns with the radius."""
        term, v = self.term, Variables(a=self.given(n))
        for _ in when(term.kind == ORBITING):
            angle = term.stiffness * (self.state.t - term.rest)
            v.x, v.y = cos(angle), sin(angle)
            for _ in when(plain(term.square) > 0.0):
                v.x, v.y = on_orbit(angle, term.square)
            v.a = v.x * v.a + v.y * self.given(1)
        return v.a

    def gradient(self, n: Any, g: Vector) -> Vector:
        """Return the discrete gradient by the vector number n, seen as g; the first one calls the function."""
        term, scratch, delta, kind = self.term, self.state.scratch, -cross(self.state.half, g), self.term.kind
        v = Variables(gradient=term.linear + term.quadratic @ g)
        for _ in when(kind == SPRING):
            rho, square = term.linear, term.square
            u, du = rho @ g, rho @ delta
            lengths = sqrt(larger(square - 2.0 * (u - du), 0.0)) + sqrt(larger(square - 2.0 * (u + du), 0.0))
            v.gradient = (-term.stiffness * (1.0 - 2.0 * term.rest / lengths)) * rho
        for _ in when(kind == FUNCTION):
            for _ in when(n == 0):
                self.evaluate()
            v.gradient = (2.0 * scratch[1 + 3 * term.dimension]) * delta + vector_at(scratch, 1 + 3 * n)
        return v.gradient

    def set_arguments(self, sign: float) -> None:
        """Set what V is called with: the vectors as seen in the middle of the step, or at one of its ends."""
        state = self.state
        for n in loop(self.term.dimension):
            g = state.d @ self.given(n)
            put(state.scratch.shifted(AT), g + sign * cross(state.half, g), 3 * n)

    def evaluate(self) -> None:
        """Set the scratch to V, its gradient at the mean, and what Δγ is multiplied by."""
        state, term, half = self.state, self.term, self.state.half
        scratch, at, ends = state.scratch, state.scratch.shifted(AT), state.scratch.shifted(ENDS)
        factor, zero = 1 + 3 * term.dimension, state.t - state.t
        v = Variables(length=zero, across=zero, first=zero, along=zero)
        self.set_arguments(0.0)
        for n in loop(term.dimension):
            g = vector_at(at, 3 * n)
            delta = cross(half, g)
            v.length, v.across = v.length + g @ g, v.across + 4.0 * (delta @ delta)
        state.of_potential(term, at, scratch)
        # Of a state V itself is not used, but it must be there.
        for _ in when(logical_not(abs(scratch[0]) <= OVERFLOW)):
            scratch[1] = NAN
        scratch[factor] = 0.0
        for _ in when(v.across > SHORT * v.length):
            for n in loop(term.dimension):
                v.along = v.along - 2.0 * (vector_at(scratch, 1 + 3 * n) @ cross(half, vector_at(at, 3 * n)))
            self.set_arguments(1.0)
            state.of_potential(term, at, ends)
            v.first = ends[0]
            self.set_arguments(-1.0)
            state.of_potential(term, at, ends)
            scratch[factor] = (ends[0] - v.first - v.along) / v.across


def moment_of(d: Matrix, F: Matrix) -> Vector:
    """Return ``Σ d_i × F_i``."""
    return cross(d[0], F[0]) + (cross(d[1], F[1]) + cross(d[2], F[2]))


def without_turn(d: Matrix, m: Vector) -> Vector:
    """Return x with ``(tr D I - D) x = m``, D = Σ d_i ⊗ d_i."""
    D = d.T @ d
    trace, rows = D.trace, (-D).T
    columns = (Vector(*(trace + x if i == j else x for j, x in enumerate(row))) for i, row in enumerate(rows))
    return inverse_of(*columns) @ m


def moments_at(state: TermState) -> tuple[Vector, Vector]:
    """Return the moments of the load and of potentials at a state as the action has them; set σ."""
    d, view = state.d, state.view
    zero, action = d - d, view.action
    v = Variables(F=zero, H=zero, torque=zero[0], free=zero[0])
    for _ in when(view.node != 0):
        table = state.seeded(doubles(view.node), OF_TABLE)
        inner, along = (Matrix(*(vector_at(table, k + 3 * i) for i in range(3))) for k in (0, 9))
        v.F = inner + along @ d
    count = memory_at(view.terms, True)[0]
    for k in loop(count):
        row = doubles(view.terms + 8 * (1 + TERM.size * k))
        term = View(TracedTerm, state.seeded(row, OF_TERMS + TERM.size * k))
        for _ in when(term.kind == OF_FORCES):
            found = state.of_state(term, 9)
            v.F = v.F + term.scale * Matrix(*(vector_at(found, 3 * i) for i in range(3)))
        for _ in when(term.kind == OF_MOMENT):
            v.free = v.free + term.scale * vector_at(state.of_state(term, 3))
        potential = PotentialAtState(term, state)
        for n in loop(term.dimension):
            a = potential.space_vector(n)
            g = term.scale * potential.gradient(n, d @ a)
            v.H = Matrix(*(h - y * a for h, y in zip(v.H, g, strict=True)))
            v.torque = v.torque + cross(d @ a, g)
    load, of_potentials = moment_of(d, v.F), moment_of(d, v.H)
    v.load, v.of_potentials = load, select(action == STAGE, v.torque, of_potentials)
    for _ in when((action == PAPER) | (action == EXACT)):
        y, z = without_turn(d, load), without_turn(d, of_potentials)
        if not isinstance(state, DualState):
            rest = v.F + v.H - Matrix(*(cross(y + z, one) for one in d))
            across = Matrix(cross(d[1], d[2]), cross(d[2], d[0]), cross(d[0], d[1]))
            view.rest = (rest @ ((1.0 / (d[0] @ across[0])) * across).T).symmetric
        is_paper = action == PAPER
        v.load, v.of_potentials = select(is_paper, 2.0 * y, load), select(is_paper, 2.0 * z, of_potentials)
    return v.load + v.free, v.of_potentials


@kernel("i8")
def generalised(address: Any) -> None:
    """Set moments of the load and of potentials, and σ, from the directors, time, and half turn in the block."""
    x = View(StateCall, doubles(address))
    x.load, x.of_potentials = moments_at(TermState(doubles(address)))


@kernel("i8")
def sloped(address: Any) -> None:
    """Set moments of the load and of potentials, and their derivatives in the directions of seeds."""
    memory = doubles(address)
    own, x, side = View(Sloped, memory), View(StateCall, memory), machine_code.lanes()
    for first in loop(0, own.directions, side):
        found = moments_at(DualState(own, memory, first))
        x.load, x.of_potentials = plain(found)
        for k, y in enumerate((*found[0], *found[1])):
            own.slopes.store(k * own.directions + first, tangent(y, 0), side)
