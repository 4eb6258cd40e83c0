"""Newton's iteration for the stages of a step of `gauss`, where fixed points do not contract (`gauss_stages`).

The vectors g of the stages follow from the velocities by one linear system of 3s equations,

    g_i - Σ a_ij g_j × W_j = g_0,        a_ij = μ_ij h b_j,

and so do, with the same matrix, the turns θ_i of the body that changes of the velocities make, g_0 = Σ a_ij δW_j. With
B = ∂f/∂P and H = ∂f/∂θ, where a vector of space v changes by v × θ, an increment solves

    δP_i - Σ a_ij (B_j δP_j + H_j θ_j) = Σ μ_ij ρ_j,        δL_i = ρ_i + h b_i (B_i δP_i + H_i θ_i),

ρ the residuals of L. B and H come from the equations themselves, on dual numbers; those of functions of the state are
differences. L and not P is the unknown since P = P_n + Σ μ L then has L to its last digits, however large h B is.
Vectors of the stages change by v × θ only to the order of the collocation. So without them the iteration converges
quadratically, with them linearly, by some percent a step at low orders and by next to nothing at high ones.

It ends where changes of the velocities are round-off, or what is left of the equations is. Moments that cancel, of
springs at an equilibrium, have the round-off ε |H| of a turn by ε: a residual of ``ε h b_i |H|`` cannot be made
smaller, however slow the body is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from ..engine.elimination import Scratch, eliminate_once
from ..engine.records import Parts, State
from ..engine.sampling import Nodes
from ..engine.state_moments import DIFFERENCE
from ..kernels.control import Variables, loop, when, whilst
from ..kernels.dual import Dual, plain, tangent
from ..kernels.elements import fma, larger, logical_not, real, select
from ..kernels.memory import View, scratch, size_of
from ..kernels.parts import part, rare
from ..kernels.vectors import AXES, Matrix, Vector, cross, taxicab
from .gauss_coefficients import TABLE, WIDTH
from .gauss_stages import (
    EPS,
    OVERFLOW,
    ROUND_OFF,
    TINY,
    TURN,
    VECTOR,
    ZEROS,
    Equations,
    Stage,
    Stages,
    pulled_back,
    rows_of,
)

NEWTON, NEAR, FAR = 50, 4.0, 1e5


def turned(v: Vector) -> Vector:
    """Return a vector of space as dual numbers: behind three directions that leave it alone the turns of the body."""
    x, y, z = v
    tangents = (0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)
    return Vector(*(Dual(a, [0.0, 0.0, 0.0, *turns]) for a, turns in zip(v, tangents, strict=True)))


def pulled_back_duals(C: Any, f: Vector) -> Vector:
    """Return ``C⁻¹ f`` of rows that turn with the body, which therefore turns like a vector of space."""
    C = plain(Matrix(*C))
    v = turned(pulled_back(C, plain(f)))
    if not isinstance(f[0], Dual):
        return v
    changes = [pulled_back(C, tangent(f, j)) for j in range(6)]
    return Vector(
        *(Dual(x.value, [t + d[i] for t, d in zip(x.tangents, changes, strict=True)]) for i, x in enumerate(v))
    )


def column_at(a: Any, i: Any, width: Any, column: Any) -> Vector:
    """Return what a column of a matrix says of a stage."""
    at = 3 * i * width + column
    return Vector(a[at], a[at + width], a[at + 2 * width])


def vectors_of_space(
    stages: Stages, a: Any, h: Any, starts: Sequence[Vector], turning: str, names: Sequence[str], k: Any = None
) -> None:
    """Solve for the vectors of space at the stages, which turn with the velocities there, and set their increments.

    Then `a` holds behind the 3 s columns of the system: the turns by changes of each momentum, if k = 1/J_i is
    given, and the vectors.
    """
    s, m = stages.number, 3 * stages.number
    side = m if k is None else 2 * m
    width = side + len(starts)
    for i in loop(m * width):
        a[i] = 0.0
    for i in loop(s):
        row = 3 * i * width
        for j in loop(s):
            f = h * stages.table[TABLE.weights + j] * stages.table[TABLE.mu + WIDTH * j + i]
            x, y, z = f * getattr(stages.one(j), turning)
            for r, entries in enumerate(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))):
                for c, entry in enumerate(entries):
                    a[row + r * width + 3 * j + c] = 0.0 * f + entry
                if k is not None:
                    a[row + r * width + m + 3 * j + r] = f * k[r]
        for r in range(3):
            at = row + r * width
            a[at + 3 * i + r] = a[at + 3 * i + r] + 1.0
            for c, g in enumerate(starts):
                a[at + side + c] = g[r]
    eliminate_once(Scratch(a, 1), m, width)
    for i in loop(s):
        stage, b = stages.one(i), h * stages.table[TABLE.weights + i]
        for c, name in enumerate(names):
            g = column_at(a, i, width, side + c)
            setattr(stage, name, b * cross(g, getattr(stage, turning)))
            if k is not None:
                setattr(stage, VECTOR[c], g)


@rare
def rows_by_elimination(stages: Stages, a: Any, h: Any) -> None:
    """Set the increments of the axes by the velocities of the stages."""
    vectors_of_space(stages, a, h, AXES, "W", TURN)


@part
def combine(momenta: Any, slopes: Any, mu: Any, s: int) -> None:
    """Set the equations for the changes of P."""
    m = 3 * s
    for i in loop(s):
        for c in loop(3):
            p = 3 * i + c
            for q in loop(m + 1):
                x = Variables(entry=0.0 * mu[0])
                for j in loop(s):
                    x.entry = fma(mu[WIDTH * j + i], slopes[(3 * j + c) * (m + 1) + q], x.entry)
                momenta[p * (m + 1) + q] = select(q == m, x.entry, select(p == q, 1.0, 0.0) - x.entry)


class Residuals:
    """The equations of Newton's iteration for the stages of one body, linearised: matrices of m = 3 s rows in memory.

    Attributes
    ----------
    turns : (m, width), behind m columns the turns by changes of the momenta, then the vectors
    slopes : (m, m + 1), h b times the derivatives of the rates by the momenta, by way of turns as well; the residuals
    momenta : (m, m + 1), the equations for the changes of the momenta, and these changes
    stiffness : (s,), h b times the size of the derivatives by turns
    """

    def __init__(self, equations: Equations, memory: Any) -> None:
        self.equations, self.stages, m = equations, equations.stages, 3 * equations.stages.number
        self.m, self.width, self.h, self.turns = m, 2 * m + len(equations.start), equations.acting.h, memory
        self.momenta = memory.shifted(m * (2 * m + 3))
        self.slopes = self.momenta.shifted(m * (m + 1))
        self.stiffness = self.slopes.shifted(m * (m + 1))

    def place(self) -> None:
        """Set P, W and the vectors of the stages from the increments of P."""
        e, stages = self.equations, self.stages
        for i in loop(stages.number):
            stage = stages.one(i)
            P = stages.collocated("dp", e.P, i)
            stage.P, stage.W = P, e.k * P
            stage.V = e.turning(stage.W, rows_of(stage)) if e.has_rows else stage.W
        if e.start:
            vectors_of_space(stages, self.turns, self.h, e.start, "V", e.names[1:], e.k)

    def differentiate(self, v: Variables) -> None:
        """Set residuals and slopes at the stages, while all numbers are fine."""
        e, stages, m, h = self.equations, self.stages, self.m, self.h
        for i in loop(stages.number, whilst=lambda: v.is_fine):
            stage, b = stages.one(i), h * stages.table[TABLE.weights + i]
            g = [getattr(stage, name) for name in VECTOR[: len(e.start)]]
            called, of_potentials = self.called(v, i, stage, rows_of(stage)) if e.parts.calls else (None, None)
            P = Vector(*(Dual(x, [float(j == c) for c in range(6 if g else 3)]) for j, x in enumerate(stage.P)))
            for _ in when(v.is_fine):
                rate = e.now(stage, P, [turned(c) for c in g], called, of_potentials, pulled_back_duals).rate
                dP = b * plain(rate)
                if e.parts.spin:
                    dP = Vector(dP[0], dP[1], dP[2] + stage.axial)
                rest, stiff = dP - stage.dp, 0.0 * b
                for c in range(3):
                    row, H = self.slopes.shifted((3 * i + c) * (m + 1)), b * tangents(rate[c], 3)
                    for q in loop(m):
                        row[q] = H @ self.turn(i, q) if g else 0.0
                    for d, B in enumerate(tangents(rate[c], 0)):
                        row[3 * i + d] = row[3 * i + d] + b * B
                    row[m], stiff = rest[c], stiff + taxicab(H)
                self.stiffness[i] = stiff

    def called(self, v: Variables, i: Any, stage: View, C: Matrix) -> tuple[Vector, Any]:
        """Return what functions say, with their derivatives as differences; one call stands in the code."""
        e, W, found = self.equations, stage.W, scratch(7 * 6)
        v.is_fine = v.is_fine & (taxicab(W) + (taxicab(C[0]) + taxicab(C[1]) + taxicab(C[2])) <= OVERFLOW)
        change = DIFFERENCE * taxicab(W)
        change = select(change > 0.0, change, DIFFERENCE)
        for q in loop(7, whilst=lambda: v.is_fine):  # there, at three more velocities, after three turns
            w = Vector(*(x + select(q == j + 1, change, 0.0) for j, x in enumerate(W)))
            a = Vector(*(select(q == j + 4, DIFFERENCE, 0.0) for j in range(3)))
            rows = Matrix(*(c + cross(c, a) for c in C))
            f, of_potentials = e.called(i, rows, rows @ w)
            for j, x in enumerate((*f, *(of_potentials or ()))):
                found[6 * q + j] = x
            is_sound = (q > 0) | (taxicab(f) + taxicab(of_potentials or ZEROS) <= OVERFLOW)
            note_call(e, is_sound)
            v.is_fine = v.is_fine & is_sound

        def dual(j: int, by_velocity: bool) -> Dual:
            d = [found[6 * q + j] - found[j] for q in range(1, 7)]
            by_momentum = [(k / change) * x if by_velocity else 0.0 for k, x in zip(e.k, d[:3], strict=True)]
            return Dual(found[j], by_momentum + [x * (1.0 / DIFFERENCE) for x in d[3:]])

        stage.called = Vector(found[0], found[1], found[2])
        called = Vector(*(dual(j, True) for j in range(3)))
        if not e.parts.generalised:
            return called, None
        stage.of_potentials = Vector(found[3], found[4], found[5])
        return called, Vector(*(dual(j + 3, False) for j in range(3)))

    def turn(self, i: Any, q: Any) -> Vector:
        """Return the turn at a stage by a momentum."""
        return column_at(self.turns, i, self.width, self.m + q)

    def solve(self) -> None:
        """Find the changes of P at the stages."""
        combine(self.momenta, self.slopes, self.stages.table.shifted(TABLE.mu), self.stages.number)
        eliminate_once(Scratch(self.momenta, 1), self.m, self.m + 1)

    def correct(self, v: Variables) -> None:
        """Add to L what the changes of P make; set the largest change of a velocity or turn, and the largest residual.

        That is relative to the velocity and what a turn by one radian would add to it. Infinite if one is lost.
        """
        e, m, k = self.equations, self.m, self.equations.k
        v.worst, v.left, fastest = 0.0 * self.h, 0.0 * self.h, larger(larger(k[0], k[1]), k[2])
        for i in loop(self.stages.number, whilst=lambda: v.is_fine):
            stage, n = self.stages.one(i), m + 1
            x = Variables(change=0.0 * e.P, turn=0.0 * e.P)
            for q in loop(m):
                dP = self.momenta[q * n + m]
                x.change = x.change + dP * column_at(self.slopes, i, n, q)
                if e.start:
                    x.turn = x.turn + dP * self.turn(i, q)
            rest, dP = column_at(self.slopes, i, n, m), column_at(self.momenta, i, n, m)
            dL = rest + x.change
            stage.dp, change = stage.dp + dL, taxicab(k * dP)
            speed = taxicab(k * e.P) + taxicab(stage.W) + change + TINY  # the last one from rest
            v.worst = larger(larger(change / speed, taxicab(x.turn)), v.worst)
            v.left = larger(taxicab(k * rest) / (speed + self.stiffness[i] * fastest), v.left)
            v.is_fine = taxicab(dL) <= OVERFLOW
        v.worst = select(v.is_fine, v.worst, float("inf"))


def tangents(x: Dual, first: int) -> Vector:
    """Return three derivatives."""
    found = [*x.tangents[first : first + 3], 0.0, 0.0, 0.0]
    return Vector(*found[:3])


def note_call(e: Equations, is_sound: Any) -> None:
    """Let it be known that a function has given what is no number."""
    for _ in when(logical_not(is_sound)):
        e.acting.x.found.total = (float("nan"),) * 3


@rare
def newton(
    motion: str, parts: Parts, b: View, x: View, stages: Stages, memory: Any, buffer: Any, node: Any
) -> tuple[Any, Any, Any]:
    """Solve the stages of one body from the increments of P there are; return success, iterations, residual."""
    acting = Nodes(parts._replace(lanes=1), b, x, memory, buffer)
    acting.begin(node, x.state.p)
    e = Equations(motion, acting, stages, x.state.s)
    r, zero = Residuals(e, memory), 0.0 * e.P[0]
    v = Variables(is_fine=True, is_found=False, goes=True, count=0, worst=zero + float("nan"), left=zero)
    v.before = zero + OVERFLOW
    if e.parts.calls:
        for i in loop(stages.number):
            v.is_fine = v.is_fine & (taxicab(stages.one(i).called) <= OVERFLOW)
        note_call(e, v.is_fine)
        v.goes = v.is_fine
    if e.has_rows:
        stages.put(VECTOR, AXES)
    level = FAR + e.acting.h * taxicab(e.P) * larger(larger(e.k[0], e.k[1]), e.k[2])
    for _ in whilst(lambda: v.goes):
        r.place()
        v.goes = False
        for _ in when(logical_not(v.is_found)):
            v.count = v.count + 1
            r.differentiate(v)
            for _ in when(v.is_fine):
                r.solve()
                r.correct(v)
                now = v.worst * (1.0 / EPS)
                is_done = (now <= NEAR) | (v.left <= ROUND_OFF) | ((now <= level) & (now >= v.before))
                v.is_fine, v.before = now <= OVERFLOW, now
                v.is_found = v.is_fine & is_done
                # the last change is round-off of velocities, but more than the vectors may be off
                v.goes = v.is_fine & select(v.is_found, now > NEAR, v.count < NEWTON)
    for _ in when(logical_not(v.is_found)):
        stages.put(e.names, [ZEROS] * len(e.names))
    return v.is_found, v.count, v.worst


def lanes_where(mask: Any, lanes: int) -> Iterator[Any]:
    """Yield the bodies whose mask is set, in a loop of the machine."""
    flags = scratch(lanes)
    flags.store(0, select(mask, 1.0, 0.0), lanes)
    for l in loop(lanes):
        for _ in when(flags[l] > 0.0):
            yield l


def solve(acting: Nodes, y: Stages, state: State, motion: str, for_newton: Any, v: Variables) -> None:
    """Solve the stages of bodies whose mask is set by Newton's iteration."""
    n = y.lanes
    acting.x.state.p, acting.x.state.s, found = state.p, state.s, scratch(3 * n)
    for k in range(3):
        found.store(k * n, 0.0, n)
    for l in lanes_where(for_newton, n):
        x, memory = acting.x.lane(l), acting.memory.shifted(size_of(Stage) * WIDTH * n)
        where = acting.block, x, y.lane(l), memory, acting.buffer, acting.node
        is_found, count, residual = newton(motion, acting.parts, *where)
        found[l], found[n + l], found[2 * n + l] = select(is_found, 0.0, 1.0), real(count), residual
    v.for_newton = found.load(0, n) > 0.0
    v.used, v.residual = v.used + found.load(n, n), found.load(2 * n, n)
