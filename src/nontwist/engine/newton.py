"""Newton's iteration for three unknowns, which implicit steps share: when a body is done, and when it is lost.

Increments of a chord iteration (the Jacobian of the first guess is kept) shrink by one factor each, so the one after
d is d²/d_before; with Newton's iteration by the square of the factor, d³/d_before². A body is done once the increment
is round-off of its velocity, or the next one a small part of that (what is left in each step has one direction, and
would add up to a drift). A chord's Jacobian is off by the turn in h/2 that the guess missed: the next increment may be
that times d, though the spin of a needle, which fills d, fell faster. A body is also done when increments have stopped
falling and either are small or what is left of the equations is round-off of their terms, as for needles. Among the
terms are those that cancel within a moment, of springs and drag at an equilibrium: their size is that of the change by
a turn of one radian, however small the moment is. The body then keeps its value, whatever its neighbours do, so the
result depends on that body alone.

`eliminate` solves systems of linear equations, one for each lane, by Gauss's elimination with partial pivots.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from ..kernels.control import Variables, loop, when, whilst
from ..kernels.dual import Dual, jacobian, seeded, tangent
from ..kernels.elements import any_of, fma, logical_not, select, without
from ..kernels.kernel import part
from ..kernels.memory import put, vector_at
from ..kernels.vectors import Matrix, Vector, inverse_of, sum_of

EPS = 2.0**-52
ITERATIONS, CHORDS = 40, 3
ROUND_OFF = 16.0 * EPS
FALLING, SMALL, OVERFLOW, REST = 0.5, 1e-9, 1e300, 1e-4


class Solution(NamedTuple):
    """The unknowns, iterations, what is left of the equations; the mask of bodies without a solution."""

    y: Vector
    used: Any
    residual: Any
    stalled: Any


def newton_solve(
    nodes: Any,
    equations_at: Callable[[Vector, Any], Callable[[Vector], Vector]],
    sizes: Callable[[Vector, Vector], tuple[Any, Any, Any]],
    guess: Vector,
    is_active: Any,
    explicit: Vector | None = None,
) -> Solution:
    """Solve r(y) = 0 for the bodies whose mask is set.

    Parameters
    ----------
    nodes : Nodes
        Of the step; those of a step that is linearised know its solutions (`Solved`). With a constrained axis the third
        unknown is known: two equations. Where r is long, or calls functions of the state, it stands in the code once,
        and gets nothing that is no number.
    equations_at : function
        Of y and of whether a Jacobian will be made there; returns the text of r near y, which is differentiated by
        dual numbers.
    sizes : function
        Of y and an increment: the size of the increment, that of round-off, that of the terms of r.
    guess : Vector
        Where it is -0.0, known when the text is traced, sums with it are left out.
    is_active : mask
    explicit : Vector, optional
        The solution, where it is known.
    """
    known: SolvedEquations | None = nodes.solved
    if known is not None and known.is_complete:
        return known.derivatives(equations_at, guess)
    is_constrained, is_long = nodes.parts.is_constrained, nodes.parts.calls or nodes.parts.dissipates
    if explicit is not None:
        found = Solution(explicit, 0.0 * explicit[0], 0.0 * explicit[0], 0.0 * explicit[0] > 1.0)
        if known is not None:
            known.add(equations_at, found, is_constrained)
        return found
    v = Variables(
        y=guess, active=is_active, diverged=is_active & False, used=0.0, residual=0.0, before=-1.0, turned=0.0, count=0
    )
    v.A = ((0.0, 0.0),) * 2 if is_constrained else Matrix(*((0.0,) * 3,) * 3)

    def iterate(y: Vector, is_new: Any, is_late: Any) -> None:
        r_of = equations_at(y, is_new)
        for _ in when(is_new):
            v.A = inverse_jacobian(r_of, y, is_constrained)
        r, A = r_of(y), v.A
        if is_constrained:
            d = Vector(-(A[0][0] * r[0] + A[0][1] * r[1]), -(A[1][0] * r[0] + A[1][1] * r[1]), 0.0)
            v.residual = abs(r[0]) + abs(r[1])
        else:
            d, v.residual = -(A @ r), abs(r[0]) + abs(r[1]) + abs(r[2])
        v.used = select(v.active, v.used + 1.0, v.used)
        update(v, y, d, 0.5 * nodes.h, *sizes(y, d), is_late)
        if is_long:
            v.y = select(v.diverged, y, v.y)

    if not is_long:  # the first iteration without questions
        iterate(guess, True, False)
    for _ in whilst(lambda: any_of(v.active) & (v.count < ITERATIONS)):
        is_late = v.count >= CHORDS
        iterate(v.y, (v.count == 0) | is_late if is_long else is_late, is_late)
    found = Solution(v.y, v.used, v.residual, v.active | v.diverged)
    if known is not None:
        known.add(equations_at, found, is_constrained)
    return found


class SolvedEquations:
    """The solutions of the equations of a step, which is then repeated on dual numbers: derivatives by theirs."""

    def __init__(self) -> None:
        self._found: list[tuple[Solution, Any]] = []
        self._noted: list[tuple[Any, Solution, bool]] = []
        self.is_complete = False

    def add(self, equations_at: Any, solution: Solution, is_constrained: bool) -> None:
        """Note what was solved, and how."""
        self._noted.append((equations_at, solution, is_constrained))

    def begin(self) -> None:
        """Begin the step on dual numbers, with the inverse of each Jacobian at the solution."""
        for equations_at, solution, is_constrained in self._noted:
            r_of = equations_at(solution.y, True)
            self._found.append((solution, inverse_jacobian(r_of, solution.y, is_constrained)))
        self.is_complete = True

    def derivatives(self, equations_at: Any, guess: Vector) -> Solution:
        """Return the next solution as duals, for equations whose numbers are duals: ``dy = -A⁻¹ dr``."""
        solution, A = known = self._found.pop(0)
        self._found.append(known)  # for the step that is taken once more
        y = Vector(*solution.y[: len(A)], *guess[len(A) :])
        missed = [Dual(0.0, x.tangents) for x in equations_at(y, False)(y)]
        changes = [sum_of(*(a * x for a, x in zip(row, missed, strict=False))) for row in A]
        found = [Dual(x, (-dx).tangents) for x, dx in zip(y, changes, strict=False)]
        return solution._replace(y=Vector(*found, *y[len(A) :]))


def inverse_jacobian(r_of: Callable[[Vector], Vector], y: Vector, is_constrained: bool) -> Any:
    """Return the inverse of the Jacobian, rows: of all equations, or of the first two by the first two unknowns."""
    if not is_constrained:
        return inverse_of(*jacobian(r_of, y))
    found = r_of(seeded(y, (0, 1)))
    (a, b), (c, d) = ([tangent(x, j) for j in range(2)] for x in found[:2])
    f = 1.0 / (a * d - b * c)
    return (f * d, -f * b), (-f * c, f * a)


def update(v: Variables, y: Vector, d: Vector, f: Any, size: Any, level: Any, terms: Any, is_late: Any) -> None:
    """Set ``v.y`` to y and an increment of it, and deactivate bodies that are done."""
    before, is_diverged = v.before, v.active & logical_not(size <= OVERFLOW)
    is_last = (size * size <= REST * level * before) & (size * v.turned <= level)
    v.done = is_diverged | (size <= level) | is_last
    v.moves = v.active
    for _ in when(is_late):
        is_stuck = size > FALLING * before
        done = v.done | (size * size * size <= REST * level * before * before)
        done = done | (is_stuck & (EPS * size <= SMALL * level))
        rests = without(is_stuck & (v.residual <= ROUND_OFF * terms), done)
        v.done, v.moves = done | rests, without(v.active, rests)
    v.y, v.active = select(v.moves, y + d, y), without(v.active, v.done)
    v.diverged, v.before, v.count = v.diverged | is_diverged, size, v.count + 1
    v.turned = v.turned + abs(f) * size


class Scratch(NamedTuple):
    """Numbers in memory, one for each lane."""

    memory: Any
    lanes: int

    def shifted(self, k: Any) -> Scratch:
        """Return the memory that begins k numbers further."""
        return Scratch(self.memory.shifted(self._place(k)), self.lanes)

    def __getitem__(self, k: Any) -> Any:
        return self.memory.load(self._place(k), self.lanes)

    def __setitem__(self, k: Any, x: Any) -> None:
        self.memory.store(self._place(k), x, self.lanes)

    def _place(self, k: Any) -> Any:
        return k if self.lanes == 1 else k * self.lanes


class Blocks:
    """A matrix in memory, by rows, in blocks of 3 × 3."""

    def __init__(self, memory: Scratch, rows: int, columns: int) -> None:
        self.memory, self.rows, self.columns = memory, rows, columns

    def __getitem__(self, place: tuple[Any, Any]) -> Matrix:
        return Matrix(*(vector_at(self.memory, self._at(*place) + r * self.columns) for r in range(3)))

    def __setitem__(self, place: tuple[Any, Any], block: Matrix) -> None:
        for r, row in enumerate(block):
            put(self.memory, row, self._at(*place) + r * self.columns)

    def row(self, k: Any) -> Scratch:
        """Return the row k."""
        return self.memory.shifted(k * self.columns)

    def column(self, i: Any, c: Any) -> Vector:
        """Return what a column has in the blocks of a row."""
        at = self._at(i, 0) + c
        return Vector(*(self.memory[at + r * self.columns] for r in range(3)))

    def set_column(self, i: Any, c: Any, x: Vector) -> None:
        """Set it."""
        for r, y in enumerate(x):
            self.memory[self._at(i, 0) + r * self.columns + c] = y

    def solve(self) -> None:
        """Replace the columns behind the square ones by the solutions, for each as right-hand side."""
        v = Variables(m=self.rows, columns=self.columns)  # so that it stands once in the code, whatever the sizes
        eliminate(self.memory, v.m, v.columns)

    def _at(self, i: Any, j: Any) -> Any:
        return 3 * i * self.columns + 3 * j


@part
def eliminate(a: Scratch, m: Any, columns: Any) -> None:
    """Replace the columns behind the m-th of m rows by the solutions, for each as right-hand side.

    m is a multiple of three: rows go by threes, so that what is loaded serves several products.
    """

    def row(i: Any) -> Scratch:
        return a.shifted(i * columns)

    def lessen(i: Any, p: Any, first: Any) -> None:
        """Take multiples of the rows p, p + 1, p + 2 from three rows i, which hold them from the column p on."""
        pivots, rows = [row(p + k) for k in range(3)], [row(i + k) for k in range(3)]
        f = [[-own[p + k] for k in range(3)] for own in rows]
        for j in loop(first, columns):
            u = [own[j] for own in pivots]
            for own, g in zip(rows, f, strict=True):
                own[j] = fma(g[0], u[0], fma(g[1], u[1], fma(g[2], u[2], own[j])))

    for p in loop(0, m, 3):
        for c in range(3):
            k, pivot = p + c, row(p + c)
            for i in loop(k + 1, m):
                own = row(i)
                swaps = abs(own[k]) > abs(pivot[k])
                for _ in when(any_of(swaps)):
                    for j in loop(p, columns):
                        u, v = pivot[j], own[j]
                        pivot[j], own[j] = select(swaps, v, u), select(swaps, u, v)
            f = 1.0 / pivot[k]
            for i in loop(k + 1, m):
                own = row(i)
                own[k] = f * own[k]
                for j in range(c + 1, 3):
                    own[p + j] = fma(-own[k], pivot[p + j], own[p + j])
        r0, r1, r2 = (row(p + k) for k in range(3))
        f, g, h = r1[p], r2[p], r2[p + 1]
        for j in loop(p + 3, columns):
            u = r0[j]
            v = fma(-f, u, r1[j])
            r1[j], r2[j] = v, fma(-h, v, fma(-g, u, r2[j]))
        for i in loop(p + 3, m, 3):
            lessen(i, p, p + 3)
    for back in loop(0, m, 3):
        p = m - 3 - back
        r0, r1, r2 = (row(p + k) for k in range(3))
        d0, d1, d2 = 1.0 / r0[p], 1.0 / r1[p + 1], 1.0 / r2[p + 2]
        f, g, h = r0[p + 1], r0[p + 2], r1[p + 2]
        for j in loop(m, columns):
            w = d2 * r2[j]
            v = d1 * fma(-h, w, r1[j])
            r0[j], r1[j], r2[j] = d0 * fma(-f, v, fma(-g, w, r0[j])), v, w
        for i in loop(0, p, 3):
            lessen(i, p, m)
