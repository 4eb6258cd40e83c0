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
from contextlib import nullcontext
from typing import Any

from ..engine.newton import EPS, ROUND_OFF, Blocks, Scratch
from ..engine.records import Parts, State
from ..engine.sampling import DIFFERENCE, TINY, Nodes
from ..kernels.control import Variables, loop, when, whilst
from ..kernels.dual import Dual, plain, tangent
from ..kernels.elements import fma, larger, logical_not, real, select
from ..kernels.kernel import part, rare
from ..kernels.memory import View, put, scratch, size_of
from ..kernels.vectors import AXES, Matrix, Vector, cross, taxicab
from .gauss_coefficients import TABLE, WIDTH
from .gauss_memory import StageMemory
from .gauss_stages import OVERFLOW, TURN, VECTOR, ZEROS, Equations, Stage, StageLoads, Stages, axes_at, pulled_back

NEWTON, NEAR, FAR = 50, 4.0, 1e5


def spatial_dual(v: Vector) -> Vector:
    """Return a vector of space as dual numbers: behind three directions that leave it alone the turns of the body."""
    x, y, z = v
    tangents = (0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)
    return Vector(*(Dual(a, [0.0, 0.0, 0.0, *turns]) for a, turns in zip(v, tangents, strict=True)))


def pulled_back_duals(C: Any, f: Vector) -> Vector:
    """Return ``C⁻¹ f`` of rows that turn with the body, which therefore turns like a vector of space."""
    C = plain(Matrix(*C))
    v = spatial_dual(pulled_back(C, plain(f)))
    if not isinstance(f[0], Dual):
        return v
    changes = [pulled_back(C, tangent(f, j)) for j in range(6)]
    return Vector(
        *(Dual(x.value, [t + d[i] for t, d in zip(x.tangents, changes, strict=True)]) for i, x in enumerate(v))
    )


def vectors_of_space(
    stages: Stages, a: Scratch, h: Any, starts: Sequence[Vector], turning: str, names: Sequence[str], k: Any = None
) -> Blocks:
    """Solve for the vectors of space at the stages, which turn with the velocities there, and set their increments.

    Returned is the system: behind its 3 s columns are the turns by changes of each momentum, if k = 1/J_i is given (of
    each velocity, if it is 1), and the vectors.
    """
    s, side = stages.number, 3 * stages.number * (1 if k is None else 2)
    system = Blocks(a, 3 * s, side + len(starts))
    for i in loop(s):
        for j in loop(s):
            f = h * stages.table[TABLE.weights + j] * stages.table[TABLE.mu + WIDTH * j + i]
            (x, y, z), one = f * getattr(stages.one(j), turning), select(i == j, 1.0, 0.0)
            system[i, j] = Matrix((one, -z, y), (z, one, -x), (-y, x, one))
            if k is not None:
                system[i, s + j] = Matrix((f * k[0], 0.0, 0.0), (0.0, f * k[1], 0.0), (0.0, 0.0, f * k[2]))
        for c, g in enumerate(starts):
            system.set_column(i, side + c, g)
    system.solve()
    for i in loop(s):
        stage, b = stages.one(i), h * stages.table[TABLE.weights + i]
        for c, name in enumerate(names):
            g = system.column(i, side + c)
            setattr(stage, name, b * cross(g, getattr(stage, turning)))
            if k is not None:
                setattr(stage, VECTOR[c], g)
    return system


@rare
def rows_by_elimination(stages: Stages, a: Any, h: Any) -> None:
    """Set the increments of the axes by the velocities of the stages."""
    vectors_of_space(stages, Scratch(a, 1), h, AXES, "W", TURN)


@part
def combine(momenta: Scratch, slopes: Scratch, mu: Any, s: int, n: int) -> None:
    """Set the equations for the changes of P, and of z, n numbers of a stage."""
    m = n * s
    for i in loop(s):
        for c in loop(n):
            p = n * i + c
            for q in loop(m + 1):
                x = Variables(entry=0.0 * mu[0])
                for j in loop(s):
                    x.entry = fma(mu[WIDTH * j + i], slopes[(n * j + c) * (m + 1) + q], x.entry)
                momenta[p * (m + 1) + q] = select(q == m, x.entry, select(p == q, 1.0, 0.0) - x.entry)


def unknowns(k: int) -> int:
    """Return how many unknowns a stage has with k internal states, a multiple of three as elimination needs it."""
    return 3 - (-k // 3) * 3


class Residuals:
    """The equations of Newton's iteration for the stages of one body, linearised, in memory.

    With k numbers z there are n unknowns of a stage, zeros among them, and m = n s in all.

    Attributes
    ----------
    turns : (3 s, width), behind 3 s columns the turns by changes of the momenta, then the vectors
    slopes : (m, m + 1), h b times the derivatives of the rates by the momenta, by way of turns as well; the residuals
    momenta : (m, m + 1), the equations for the changes of the momenta, and these changes
    stiffness : (s,), h b times the size of the derivatives by turns
    found : (7 + k, 9 + k), what functions give, and give after changes
    """

    def __init__(self, equations: Equations, memory: Any) -> None:
        self.equations, self.stages, self.k = equations, equations.stages, equations.parts.memory
        self.h, self.n, s = equations.nodes.h, unknowns(self.k), equations.stages.number
        self.m, self.side = m, side = self.n * s, 3 * s
        self.turns, square = Blocks(Scratch(memory, 1), side, 2 * side + len(equations.start)), m * (m + 1)
        memory = self.turns.memory.shifted(side * (2 * side + 3))
        self.momenta, self.slopes = (Blocks(memory.shifted(k * square), m, m + 1) for k in range(2))
        self.stiffness = memory.shifted(2 * square)
        self.found = Blocks(self.stiffness.shifted(s), 7 + self.k, 9 + self.k)
        if self.n > 3 + self.k:
            for q in loop(square):
                self.slopes.memory[q] = 0.0

    def update_stages(self) -> None:
        """Set P, W and the vectors of the stages from the increments of P."""
        e, stages = self.equations, self.stages
        for i in loop(stages.number):
            stage = stages.one(i)
            P = stages.collocated("dp", e.P, i)
            stage.P, stage.W = P, e.k * P
            stage.V = e.turning(stage.W, axes_at(stage)) if e.has_rows else stage.W
        if e.memory:
            e.memory.update_states()
        if e.start:
            vectors_of_space(stages, self.turns.memory, self.h, e.start, "V", e.names[1:], e.k)

    def differentiate(self, v: Variables) -> None:
        """Set residuals and slopes at the stages, while all numbers are fine."""
        e, stages, m, h = self.equations, self.stages, self.m, self.h
        for i in loop(stages.number, whilst=lambda: v.is_fine):
            stage, b = stages.one(i), h * stages.table[TABLE.weights + i]
            g = [getattr(stage, name) for name in VECTOR[: len(e.start)]]
            loads = e.stored_loads(stage)._replace(
                **self.differentiate_functions(v, i, stage, axes_at(stage)) if e.parts.calls else {}
            )
            P = Vector(*(Dual(x, [float(j == c) for c in range(6 if g else 3)]) for j, x in enumerate(stage.P)))
            for _ in when(v.is_fine):
                rate = e.now(loads, P, [spatial_dual(c) for c in g], pulled_back_duals).rate
                dP = b * plain(rate)
                if e.parts.spin:
                    dP = Vector(dP[0], dP[1], dP[2] + stage.axial)
                rest, stiff = dP - stage.dp, 0.0 * b
                for c in range(3):
                    H = b * three_tangents(rate[c], 3)
                    row = self.row(i, c, H if g else None, b * three_tangents(rate[c]))
                    row[m], stiff = rest[c], stiff + taxicab(H)
                self.stiffness[i] = stiff
                if e.memory:
                    self.set_memory_slopes(i, stage, b)

    def row(self, i: Any, c: Any, H: Any, B: Vector) -> Any:
        """Set a row of the slopes to derivatives by turns and by the momenta of a stage; return it."""
        n, row = self.n, self.slopes.row(self.n * i + c)
        for j in loop(self.stages.number):
            for d in range(3):
                row[n * j + d] = 0.0 if H is None else H @ self.turn(i, 3 * j + d)
            for d in loop(3, n):
                row[n * j + d] = 0.0
        for d, x in enumerate(B):
            row[n * i + d] = row[n * i + d] + x
        return row

    def set_memory_slopes(self, i: Any, stage: View, b: Any) -> None:
        """Set the slopes by z, and those of z, at a stage."""
        e, n, found, C = self.equations, self.n, self.found.row(0), axes_at(stage)
        memory, h, speed = e.memory, b / e.nodes.rate, self.change(stage.W)
        for c in loop(self.k):
            f = b / memory.change(stage, c)
            space, along = (Vector(*(f * self.difference(7 + c, j + d) for d in range(3))) for j in (0, 6))
            slope = along + pulled_back(C, space)
            third = e.nodes.body.free * slope[2] if e.parts.is_constrained else slope[2]
            for d, x in enumerate((slope[0], slope[1], third)):
                self.slopes.row(n * i + d)[n * i + 3 + c] = x
        for c in loop(self.k):
            more = [self.difference(q, 9 + c) for q in range(1, 7)]
            H = Vector(*((h / DIFFERENCE) * x for x in more[3:]))
            B = Vector(*((h / speed * k) * x for k, x in zip(e.k, more[:3], strict=True)))
            row = self.row(i, 3 + c, H, B)
            for y in loop(self.k):
                row[n * i + 3 + y] = (h / memory.change(stage, y)) * self.difference(7 + y, 9 + c)
            row[self.m] = h * found[9 + c] - memory.increment(stage, c)

    def difference(self, q: Any, j: Any) -> Any:
        """Return what the change number q makes of the number j that functions give."""
        return self.found.row(q)[j] - self.found.row(0)[j]

    def change(self, W: Vector) -> Any:
        """Return the difference of velocities."""
        change = DIFFERENCE * taxicab(W)
        return select(change > TINY, change, DIFFERENCE)

    def differentiate_functions(self, v: Variables, i: Any, stage: View, C: Matrix) -> dict[str, Vector]:
        """Return what functions give, with their derivatives as differences; one call stands in the code."""
        e, W, k = self.equations, stage.W, self.k
        v.is_fine = v.is_fine & (taxicab(W) + (taxicab(C[0]) + taxicab(C[1]) + taxicab(C[2])) <= OVERFLOW)
        change = self.change(W)
        for q in loop(7 + k, whilst=lambda: v.is_fine):  # there, at three more velocities, after three turns, at more z
            w = Vector(*(x + select(q == j + 1, change, 0.0) for j, x in enumerate(W)))
            a = Vector(*(select(q == j + 4, DIFFERENCE, 0.0) for j in range(3)))
            rows = Matrix(*(c + cross(c, a) for c in C))
            with e.memory.changed(stage, q - 7) if e.memory else nullcontext():
                results = [x or ZEROS for x in e.evaluate_functions(i, rows, w)[3:]]
            put(found := self.found.row(q), tuple(results))
            for c in loop(k) if k else ():
                found[9 + c] = e.memory.rate(stage, c)
            v.is_fine = v.is_fine & ((q > 0) | (sum(map(taxicab, results), 0.0) <= OVERFLOW))

        def dual(j: int, by_velocity: bool) -> Dual:
            d = [self.difference(q, j) for q in range(1, 7)]
            by_momentum = [(k / change) * x if by_velocity else 0.0 for k, x in zip(e.k, d[:3], strict=True)]
            return Dual(self.found.row(0)[j], by_momentum + [x * (1.0 / DIFFERENCE) for x in d[3:]])

        loads, are_there = dict[str, Vector](), (True, e.parts.generalised, e.memory)
        for k, (name, is_there) in enumerate(zip(StageLoads._fields[3:], are_there, strict=True)):
            if is_there:
                loads[name] = Vector(*(dual(3 * k + j, name != "of_potentials") for j in range(3)))
                setattr(stage, name, plain(loads[name]))
        return loads

    def turn(self, i: Any, q: Any) -> Vector:
        """Return the turn at a stage by a momentum."""
        return self.turns.column(i, self.side + q)

    def solve(self) -> None:
        """Find the changes of P at the stages."""
        mu = self.stages.table.shifted(TABLE.mu)
        combine(self.momenta.memory, self.slopes.memory, mu, self.stages.number, self.n)
        self.momenta.solve()

    def correct(self, v: Variables) -> None:
        """Add to L what the changes of P make; set the largest change of a velocity or turn, and the largest residual.

        That is relative to the velocity and what a turn by one radian would add to it. Infinite if one is lost.
        """
        e, m, n, k = self.equations, self.m, self.n, self.equations.k
        v.worst, v.left, fastest = 0.0 * self.h, 0.0 * self.h, larger(larger(k[0], k[1]), k[2])
        for i in loop(self.stages.number, whilst=lambda: v.is_fine):
            stage, x = self.stages.one(i), Variables(change=0.0 * e.P, turn=0.0 * e.P)
            for q in loop(m):
                x.change = x.change + self.solved(q) * self.slopes.column(n // 3 * i, q)
            if e.start:
                for j in loop(self.stages.number):
                    for d in range(3):
                        x.turn = x.turn + self.solved(n * j + d) * self.turn(i, 3 * j + d)
            rest, dP = (a.column(n // 3 * i, m) for a in (self.slopes, self.momenta))
            dL = rest + x.change
            stage.dp, change = stage.dp + dL, taxicab(k * dP)
            speed = taxicab(k * e.P) + taxicab(stage.W) + change + TINY  # the last one from rest
            v.worst = larger(larger(change / speed, taxicab(x.turn)), v.worst)
            v.left = larger(taxicab(k * rest) / (speed + self.stiffness[i] * fastest), v.left)
            v.is_fine = taxicab(dL) <= OVERFLOW
            if e.memory:
                self.correct_memory(v, i, stage)
        v.worst = select(v.is_fine, v.worst, float("inf"))

    def correct_memory(self, v: Variables, i: Any, stage: View) -> None:
        """Do so for z at a stage, relative to its size."""
        memory, m = self.equations.memory, self.m
        for c in loop(self.k):
            row, size = self.slopes.row(self.n * i + 3 + c), memory.size(stage, c)
            x = Variables(change=row[m])
            for q in loop(m):
                x.change = x.change + self.solved(q) * row[q]
            memory.set_increment(stage, c, memory.increment(stage, c) + x.change)
            v.worst = larger(abs(self.solved(self.n * i + 3 + c)) / size, v.worst)
            v.left = larger(abs(row[m]) / size, v.left)
            v.is_fine = v.is_fine & (abs(x.change) <= OVERFLOW)

    def solved(self, q: Any) -> Any:
        """Return the change of an unknown that was found."""
        return self.momenta.row(q)[self.m]


def three_tangents(x: Dual, first: int = 0) -> Vector:
    """Return three derivatives."""
    found = [*x.tangents[first : first + 3], 0.0, 0.0, 0.0]
    return Vector(*found[:3])


@rare
def newton(
    motion: str, parts: Parts, b: View, x: View, stages: Stages, memory: Any, buffer: Any, node: Any
) -> tuple[Any, Any, Any]:
    """Solve the stages of one body from the increments of P there are; return success, iterations, residual."""
    nodes = Nodes(parts._replace(lanes=1), b, x, memory, buffer)
    nodes.begin(node, x.state.p)
    memory_of_loads = StageMemory(nodes, stages) if parts.memory else None
    e = Equations(motion, nodes, stages, x.state.s, memory_of_loads)
    r, zero = Residuals(e, memory), 0.0 * e.P[0]
    v = Variables(is_fine=True, is_found=False, goes=True, count=0, worst=zero + float("nan"), left=zero)
    v.before = zero + OVERFLOW
    if e.parts.calls and not e.memory:  # with memory it begins anew
        for i in loop(stages.number):
            v.is_fine = v.is_fine & (taxicab(stages.one(i).of_functions) <= OVERFLOW)
        v.goes = v.is_fine
    if e.has_rows:
        stages.fill(VECTOR, AXES)
    if e.memory:
        e.memory.clear()
    level = FAR + e.stiffness
    for _ in whilst(lambda: v.goes):
        r.update_stages()
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
        stages.fill(e.names, [ZEROS] * len(e.names))
    return v.is_found, v.count, v.worst


def lanes_where(mask: Any, lanes: int) -> Iterator[Any]:
    """Yield the bodies whose mask is set, in a loop of the machine."""
    flags = scratch(lanes)
    flags.store(0, select(mask, 1.0, 0.0), lanes)
    for l in loop(lanes):
        for _ in when(flags[l] > 0.0):
            yield l


def solve_stages(nodes: Nodes, y: Stages, state: State, motion: str, for_newton: Any, v: Variables) -> None:
    """Solve the stages of bodies whose mask is set by Newton's iteration."""
    n = y.lanes
    nodes.x.state.p, nodes.x.state.s, found = state.p, state.s, scratch(3 * n)
    for k in range(3):
        found.store(k * n, 0.0, n)
    for l in lanes_where(for_newton, n):
        x, memory = nodes.x.lane(l), nodes.memory.shifted((size_of(Stage) + 3 * nodes.parts.memory) * WIDTH * n)
        where = nodes.block, x, y.lane(l), memory, nodes.buffer, nodes.node
        is_found, count, residual = newton(motion, nodes.parts, *where)
        found[l], found[n + l], found[2 * n + l] = select(is_found, 0.0, 1.0), real(count), residual
    v.for_newton = found.load(0, n) > 0.0
    v.used, v.residual = v.used + found.load(n, n), found.load(2 * n, n)
