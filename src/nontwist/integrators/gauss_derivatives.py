"""A step of `gauss`, linearised by the equations of its stages on dual numbers (`gauss_stages`).

Unknowns of the stages are the velocities V_i that vectors of space turn with, V = W but in an orbit, and the vectors
g_k,i, as seen from the body. With F = V' as the equations have it, α/h the inverse of the coefficients a, and κ_i the
sums of the rows of α, a step solves

    Σ α_ij V_j - κ_i V_n = h F(V_i, g_i),        Σ α_ij g_k,j - κ_i g_k,n = h g_k,i × V_i.

Known inputs change F by dF, V_n by dV_n. The second equations are linear: ``dg_k,i = Σ U_ij (g_k,j × dV_j) + ...``, U
= h (α + h V̂)⁻¹. So with T_ij = h (δ_ij ∂F_i/∂V + Σ_k ∂F_i/∂g_k U_ij ĝ_k,j)

    Σ (α_ij - T_ij) dV_j = κ_i dV_n + h dF_i,        dV_{n+1} = dV_n + Σ b_i (T_ij dV_j + h dF_i),

and the turn of the step, ``θ = Σ Θ_i dV_i + ...``, is linear as well (`gauss_turns`). Of the six rows (Θ_i; Σ_j b_j
T_ji) a system with the transposed matrix makes the response of the end to what stands on the right at each stage. An
input then costs one product a stage. All derivatives of F are those of its text on dual numbers, in the directions of
V and g for the matrices, in those of the start and of the inputs for dF. Inertia changes by a whole symmetric matrix,
as duals in the frame b (`engine.known_steps`): no eigenvector is differentiated.

Steps are independent of each other once the states are known, so lanes hold several of them. Their stages are solved
again: by fixed points and, where those do not contract, by Newton's iteration with the matrices above.
"""

from __future__ import annotations

from functools import lru_cache
from math import prod
from typing import Any

from ..engine.known_steps import (
    LANES,
    NODAL,
    Directions,
    FunctionCalls,
    Known,
    KnownStep,
    Steps,
    Wanted,
    column_offsets,
)
from ..engine.linearised import read_steps
from ..engine.newton import ROUND_OFF, Blocks, Scratch
from ..engine.records import Body, Parts
from ..kernels.control import Variables, loop, when, whilst
from ..kernels.dual import Dual, plain, seeded, tangent
from ..kernels.elements import any_of, larger, remade, select, smaller, without
from ..kernels.kernel import Kernel
from ..kernels.memory import View, doubles, flat, size_of, vector_at
from ..kernels.vectors import AXES, Matrix, Quaternion, Vector, attitude, cross, taxicab
from .gauss import about
from .gauss_coefficients import TABLE, WIDTH
from .gauss_newton import vectors_of_space
from .gauss_stages import OVERFLOW, VECTOR, VECTORS, ZEROS, Equations, Stage, StageLoads, Stages, iterated
from .gauss_turns import Line, Steady, Turn

CORRECTIONS, CLOSE, SAME, ONES = 20, 1e-9, 1e-6, Vector(1.0, 1.0, 1.0)
REST = 1e-250  # of velocities: less is what a step leaves of a decay
STATE = {"turn": 3, "velocity": 3}


def matrices(s: int, columns: int) -> dict[str, tuple[int, int]]:
    """Return the rows and columns of the matrices that steps of s stages take; blocks belong to stages."""
    return {
        "C": (3 * s, 3),  # rows of the stages
        "U": (3 * s, 3 * s),
        "T": (3 * s, 3 * s),
        "by_rows": (3 * s, 9),  # h ∂F/∂g_k
        "by_end": (3 * s, 3),  # of the turn about a line, by g
        "Z": (3 * s, 3),  # Σ b_i T_ij
        "theta": (3 * s, 3),
        "direct": (3, 3),  # of the turn, by V at the end
        "adjoint": (3 * s, 6),  # the response
        "ends": (6, columns),  # turn and V
        "along": (columns, 4),  # of a turn about a line: changes of ψ, and of the vector at the end
        "a": (3 * s, 6 * s + 6),
    }


def scratch_size(s: int, columns: int, slopes: int) -> int:
    """Return how many numbers of a lane a kernel needs; `slopes`: those of functions of the state at a node."""
    return s * (size_of(KnownStep) + slopes) + WIDTH * size_of(Stage) + sum(map(prod, matrices(s, columns).values()))


@lru_cache
def linearised_stages(s: int, motion: str, parts: Parts, wanted: Wanted) -> Kernel:
    """Return the kernel that makes matrices of `Steps` of s stages, with the columns of the inputs wanted."""

    def kernel(address: Any) -> None:
        b = View(Steps, doubles(address))
        body = View(Body, b.body).read()
        for k in loop(0, smaller(LANES, b.steps - b.first), parts.lanes):
            steps = Collocation(s, motion, parts, wanted, b, body)
            read_steps(parts, b, steps.calls.node, s, b.first + k)
            for _ in when(any_of(steps.solve())):
                b.failed = b.failed + 1
            for _ in when(any_of(steps.have_other_ends())):
                b.failed = b.failed + 1
            steps.differentiate(k)

    return Kernel(kernel, "i8", parts.lanes)


class Collocation:
    """Some steps in lanes, linearised."""

    def __init__(self, s: int, motion: str, parts: Parts, wanted: Wanted, b: View, body: Body) -> None:
        self.s, self.motion, self.parts, self.wanted, self.b, self.body = s, motion, parts, dict(wanted), b, body
        self.columns, n, self.table = column_offsets(6, wanted, s), parts.lanes, b.table
        self.calls = FunctionCalls(parts, b, self.wanted)
        self.names = VECTOR[: VECTORS.get(motion, 0)]  # the vectors g
        stages = doubles(b.workspace).shifted(s * self.calls.node_size)
        self.stages = Stages(stages, self.table, s, n, n, False)
        memory, made = Scratch(stages.shifted(WIDTH * size_of(Stage) * n), n), list[Blocks]()
        for rows, columns in matrices(s, self.columns[""]).values():
            made.append(Blocks(memory, rows, columns))
            memory = memory.shifted(rows * columns)
        self.C, self.U, self.T, self.by_rows, self.by_end, self.Z, self.theta, *made = made
        self.direct, self.adjoint, self.ends, self.along, self.a = made
        self.scale = b.factor[0] / body.unit

    # What is known.

    def equations(self, offsets: dict[str, int], count: int) -> StageEquations:
        """Return the equations, of numbers that have derivatives in the directions at these places."""
        known = KnownStages(self.calls, self.body, self.calls.node, self.scale, Directions(offsets, count))
        motion = "moved" if self.motion == "steady" else self.motion
        return StageEquations(motion, known, self.stages, ZEROS)

    def vectors(self, stage: View) -> Matrix:
        """Return the vectors g of a stage."""
        return Matrix(*(getattr(stage, name) for name in self.names))

    def still_rows(self, i: Any) -> Matrix:
        """Return the axes of b at the beginning as seen at a stage, also where those that turn are in an orbit."""
        if not self.parts.orbit:
            return self.C[i, 0]
        cosm1, v = about((self.h * self.table[TABLE.nodes + i]) * self.orbital[0])
        return attitude(Quaternion(1.0 + cosm1, *v)) @ self.C[i, 0]

    def weight(self, i: Any) -> Any:
        """Return b_i."""
        return self.table[TABLE.weights + i]

    def inverse(self, i: Any, j: Any) -> Any:
        """Return α_ij."""
        return self.table[TABLE.inverse + WIDTH * j + i]

    def sum(self, i: Any) -> Any:
        """Return κ_i."""
        return self.table[TABLE.sums + i]

    # The stages.

    def solve(self) -> Any:
        """Find V and g of the stages, the rows, U and T; return the mask of steps that are not solved."""
        at, body = self.calls.node(0), self.body
        self.h, B = at.h, body.basis
        R, self.W = attitude(at.p) @ B, (at.W @ B, at.ahead @ B)
        e = self.equations({}, 0)
        self.plain, self.orbital = e, (ZEROS, ZEROS)
        p, q = at.p, at.q
        if self.parts.orbit:
            n, o = e.nodes.orbit
            cosm1, v = about((n * self.h) * o)
            p = Quaternion(1.0 + cosm1, *v) @ p
            self.orbital = n * (o @ R), n * (o @ (attitude(q) @ B))
        self.turn = B.T @ attitude(Quaternion(p[0], -p[1], -p[2], -p[3]) @ q) @ B  # C at the end
        self.V = self.W[0] - self.orbital[0], self.W[1] - self.orbital[1]
        P, ahead = (body.momentum_of(W) for W in self.W)
        e.P, mean = P, 0.5 * (self.V[0] + self.V[1])
        e.sample()
        for j, stage in self.stages.each():
            stage.dp = self.weight(j) * (ahead - P)
            for name, g in zip(e.names[1:], e.start, strict=True):
                setattr(stage, name, (self.h * self.weight(j)) * cross(g, mean))
        for_newton, _ = iterated(e, self.h == self.h)
        for i, stage in self.stages.each():
            P, g = e.placed(i)
            stage.V = e.turning(body.velocity_of(P), g)
            for name, x in zip(self.names, g, strict=True):
                setattr(stage, name, x)
        now = Variables(active=for_newton, goes=True, count=0)
        for _ in whilst(lambda: now.goes):
            if self.names:
                self.set_rows(True)
            self.set_slopes()
            now.goes = False
            for _ in when(any_of(now.active) & (now.count < CORRECTIONS)):
                self.correct(now)
                now.goes, now.count = True, now.count + 1
        return now.active

    def have_other_ends(self) -> Any:
        """Return the mask of steps that end elsewhere than is known: large ones have several solutions."""
        v = Variables(end=self.V[0], speed=taxicab(self.V[1]) + REST, stiff=0.0 * self.h)
        for i, stage in self.stages.each():
            v.end = v.end - (self.weight(i) * self.sum(i)) * self.V[0]
            v.speed = larger(v.speed, taxicab(stage.V))
            v.stiff = larger(v.stiff, self.stiffness(i))
            for j in loop(self.s):
                v.end = v.end + (self.weight(i) * self.inverse(i, j)) * self.stages.one(j).V
        return taxicab(v.end - self.V[1]) > SAME * v.speed + 16.0 * ROUND_OFF * v.stiff

    def stiffness(self, i: Any) -> Any:
        """Return how much a turn at a stage changes V, at most."""
        found = 0.0 * self.h
        for k in range(len(self.names)):
            A = self.by_rows[i, k]
            found = larger(found, taxicab(A[0]) + taxicab(A[1]) + taxicab(A[2]))
        return found

    def set_rows(self, has_inverse: bool) -> None:
        """Find the rows of the stages by their velocities, the vectors g, and U where it is asked for."""
        s, k = self.s, ONES if has_inverse else None
        system = vectors_of_space(self.stages, self.a.memory, self.h, AXES, "V", (), k)
        for i, stage in self.stages.each():
            self.C[i, 0] = C = system[i, 2 * s if has_inverse else s].T
            for name, g in zip(self.names, self.plain.start, strict=True):
                setattr(stage, name, g @ C)
            for j in loop(s if has_inverse else 0):
                self.U[i, j] = system[i, s + j]

    def set_slopes(self) -> None:
        """Set T, h ∂F/∂g, and the residuals of the equations for V."""
        s, h, e, count = self.s, self.h, self.plain, len(self.names)
        for i, stage in self.stages.each():
            x = seeded(flat((stage.V, *self.vectors(stage))))
            V, *g = (Vector(*x[k : k + 3]) for k in range(0, len(x), 3))
            if self.parts.calls:
                W = stage.V + e.orbital(self.vectors(stage)) if self.parts.orbit else stage.V
                e.nodes.evaluate(i, W, self.vectors(stage), True)
            F = h * e.rate(i, V, Matrix(*g), self.C[i, 0])
            by = [Matrix(*(Vector(*(tangent(x, 3 * k + c) for c in range(3))) for x in F)) for k in range(1 + count)]
            for k in range(count):
                self.by_rows[i, k] = by[1 + k]
            for j in loop(s):
                T = 0.0 * by[0]
                for A, g in zip(by[1:], self.vectors(self.stages.one(j)), strict=True):
                    T = T + Matrix(*(cross(row, g) for row in A @ self.U[i, j]))
                self.T[i, j] = T
            self.T[i, i] = by[0] + self.T[i, i]
            r = Variables(r=plain(F) + self.sum(i) * self.V[0])
            for j in loop(s):
                r.r = r.r - self.inverse(i, j) * self.stages.one(j).V
            stage.next_dp = r.r

    def system(self, others: int, is_transposed: bool) -> Blocks:
        """Return α - T, or the transposed matrix, with room for so many right-hand sides."""
        system = Blocks(self.a.memory, 3 * self.s, 3 * self.s + others)
        for i in loop(self.s):
            for j in loop(self.s):
                alpha, T = self.inverse(i, j), self.T[i, j]
                A = Matrix(*([(alpha if r == c else 0.0) - T[r][c] for c in range(3)] for r in range(3)))
                system[(j, i) if is_transposed else (i, j)] = A.T if is_transposed else A
        return system

    def correct(self, v: Variables) -> None:
        """Take a step of Newton's iteration for the steps that are active, and deactivate those that are done."""
        system, m = self.system(1, False), 3 * self.s
        for i, stage in self.stages.each():
            system.set_column(i, m, stage.next_dp)
        system.solve()
        most = Variables(change=0.0 * self.h, speed=taxicab(self.V[0]) + REST, stiff=0.0 * self.h)
        for i, stage in self.stages.each():
            d = system.column(i, m)
            stage.V = stage.V + select(v.active, d, 0.0 * d)
            most.change = larger(most.change, select(taxicab(d) <= OVERFLOW, taxicab(d), 2.0 * OVERFLOW))
            most.speed = larger(most.speed, taxicab(stage.V))
            most.stiff = larger(most.stiff, self.stiffness(i))
        v.active = without(v.active, most.change <= CLOSE * most.speed + ROUND_OFF * most.stiff)

    # The end of the step.

    def differentiate(self, place: Any) -> None:
        """Write the columns of the matrices."""
        is_apart = self.motion == "free" and "dead" in self.wanted  # the direction of P is not kept under forces
        if not self.names and ("dead" in self.wanted or self.motion == "moved"):
            self.set_rows(False)
        self.set_ends()
        turn = {"free": Line, "heavy": Line, "steady": Steady}.get(self.motion, Turn)(self)
        self.set_turn(turn)
        self.emit(place, tuple(name for name in self.wanted if not (is_apart and name == "dead")), turn, True)
        if is_apart:
            self.turn = self.turn_of_rows()
            self.set_turn(turn := Turn(self))
            self.emit(place, ("dead",), turn, False)

    def turn_of_rows(self) -> Matrix:
        """Return C at the end as the rows have it, where the body turns about a line."""
        v = Variables(C=0.0 * self.turn + AXES)
        for i, stage in self.stages.each():
            v.C = v.C + (self.h * self.weight(i)) * Matrix(*(cross(c, stage.V) for c in self.C[i, 0]))
        return v.C

    def set_ends(self) -> None:
        """Set Z, the change of V at the end by those of the stages."""
        for j in loop(self.s):
            v = Variables(Z=self.weight(0) * self.T[0, j])
            for i in loop(1, self.s):
                v.Z = v.Z + self.weight(i) * self.T[i, j]
            self.Z[j, 0] = v.Z

    def set_turn(self, turn: Turn) -> None:
        """Set how the turn changes, and the response of the end to right-hand sides at the stages, six rows.

        It solves the transposed system.
        """
        self.direct[0, 0] = 0.0 * self.turn
        turn.set()
        system, s = self.system(6, True), self.s
        for j in loop(s):
            system[j, s], system[j, s + 1] = self.theta[j, 0].T, self.Z[j, 0].T
        system.solve()
        for j in loop(s):
            self.adjoint[j, 0], self.adjoint[j, 1] = system[j, s].T, system[j, s + 1].T

    def emit(self, place: Any, inputs: tuple[str, ...], turn: Turn, has_state: bool) -> None:
        """Write the columns of the state and of inputs."""
        b, ends, direct = self.b, self.ends, self.direct[0, 0]
        offsets, outs = dict[str, int](), list[int]()
        for name in (*STATE, *inputs) if has_state else inputs:
            if name not in NODAL:
                is_force = name == "dead" and (self.motion != "rows" or self.parts.orbit)
                offsets["force" if is_force else name] = len(outs)
                outs += range(self.columns[name], self.columns[name] + (STATE | self.wanted)[name])
        nodal, width = [name for name in inputs if name in NODAL], (count := len(outs))
        for name in nodal:
            offsets[name], width = width, width + self.wanted[name]
        e = self.equations(offsets, width)
        W = e.nodes.velocity(self.W[0])
        V = W - e.orbital(AXES) if self.parts.orbit else W

        def store(column: Any, *found: Vector) -> None:
            for r, x in enumerate(flat(found)):
                b.out.store((r * b.width + column) * LANES + place, x, self.parts.lanes)

        for j in range(count):
            dV = tangent(V, j)
            ends.set_column(0, j, direct @ dV)
            ends.set_column(1, j, dV)
        turn.begin(e, W, count)
        for i, stage in self.stages.each():
            g = self.changed(i, stage, e)
            F = e.nodes.h * e.rate(i, stage.V, g, self.still_rows(i))
            by = self.adjoint[i, 0], self.adjoint[i, 1]
            both = [x + self.weight(i) * y for x, y in zip(by, (direct, Matrix(*AXES)), strict=True)]
            for name in nodal:
                for c in range(self.wanted[name]):
                    dF = tangent(F, offsets[name] + c)
                    store(self.columns[name] + self.wanted[name] * i + c, *(A @ dF for A in both))
            for j in range(count):
                for parts, dx in ((both, tangent(F, j)), (by, self.sum(i) * tangent(V, j))):
                    for k in range(0 if is_nothing(dx) else 2):
                        ends.set_column(k, j, ends.column(k, j) + parts[k] @ dx)
            turn.add_changes(i, stage, g)
        for j, change in enumerate(turn.changes(V)):
            store(outs[j], *self.at_end(e.nodes, ends.column(0, j) + change, ends.column(1, j), j))

    def changed(self, i: Any, stage: View, e: StageEquations) -> Any:
        """Return the vectors g of a stage with the changes that no change of V makes."""
        h, later = e.nodes.h, self.vectors(stage)
        g = Matrix(*(x @ self.C[i, 0] for x in e.start)) if self.motion == "heavy" else later
        if not g or not isinstance(h, Dual):
            return g
        v = Variables(g=0.0 * self.h * later)
        for j, one in self.stages.each():
            v.g = v.g + Matrix(*(self.U[i, j] @ cross(x, one.V) for x in self.vectors(one)))
        longer = (1.0 / self.h) * (h - self.h)  # 0, and what the step changes by
        return Matrix(*(x + longer * y for x, y in zip(g, v.g, strict=True)))

    def at_end(self, known: KnownStages, theta: Vector, dV: Vector, j: int) -> tuple[Vector, Vector]:
        """Return the changes of attitude and W at the end, by those of the turn and of V in a direction."""
        zero = 0.0 * self.h
        turn = Vector(*(Dual(zero, [x]) for x in theta))
        W = Vector(*(Dual(x, [d]) for x, d in zip(self.V[1], dV, strict=True)))
        if known.turn is not None:
            turn = turn + in_direction(known.turn, j) @ self.turn
        if self.parts.orbit:
            (n, o), at = known.orbit, self.calls.node(0)
            n, o = in_direction(n, j), o @ (attitude(at.q) @ self.body.basis)
            angle = tangent(n * in_direction(known.h, j), 0)
            turn = turn + Vector(*(Dual(zero, [angle * x]) for x in o))
            W = W + n * (o + cross(o, turn))
        if known.tilt is not None:
            tilt = in_direction(known.tilt, j)
            turn, W = turn - tilt, W - cross(W, tilt)
        return tangent((turn, W), 0)


def is_nothing(x: Vector) -> bool:
    """Whether derivatives are 0 by their making."""
    return all(type(y) is float and y == 0.0 for y in x)


def in_direction(x: Any, j: int) -> Any:
    """Return numbers as duals of one direction."""
    return remade(x, [in_direction(y, j) for y in x]) if isinstance(x, tuple) else Dual(plain(x), [tangent(x, j)])


class KnownStages(Known):
    """What acts at the stages of steps of which all is known."""

    def __init__(self, calls: FunctionCalls, body: Body, known: Any, scale: Any, directions: Directions) -> None:
        super().__init__(calls, body, known, scale, directions)
        self.force = directions.along("force", Matrix(*(ZEROS,) * 3)) if "force" in directions.offsets else None

    @property
    def orbit(self) -> tuple[Any, Vector]:
        """The rate of the orbit, and its axis in space."""
        return self.vary.along("orbit", self.calls.block.orbit[0]), vector_at(self.calls.block.orbit, 1)

    def fraction(self, j: Any) -> Any:
        """Return how far into the step a node is; seen from an orbit, no time passes in it."""
        return 0.0 if self.parts.orbit else self.calls.block.table[TABLE.nodes + j]

    def evaluate(self, i: Any, W: Vector, g: Any, is_sloped: bool) -> None:
        """Evaluate the functions of the state at a stage."""
        rows = self.R @ g
        self.calls.evaluate(self.known(i), self.basis @ rows.T, rows @ W, ZEROS, is_sloped)


class StageEquations(Equations):
    """The equations of the stages for the velocities V that vectors of space turn with."""

    nodes: KnownStages

    def evaluate_functions(self, j: Any, rows: Matrix, W: Vector) -> StageLoads:
        """Return what functions of the state give at a stage."""
        nodes, parts = self.nodes, self.parts
        nodes.evaluate(j, W, rows, False)
        at = nodes.known(j)
        of_potentials = nodes.factor * (at.of_potentials @ nodes.basis) if parts.generalised else None
        load = nodes.factor * (at.load @ nodes.R) if parts.function else ZEROS
        return StageLoads(of_functions=load, of_potentials=of_potentials)

    def orbital(self, g: Any) -> Vector:
        """Return the velocity of the orbit, n o, as seen from the body; 0 where there is none."""
        return -self.turning(ZEROS, g)

    def rate(self, i: Any, V: Vector, g: Any, C: Any) -> Vector:
        """Return V' at a stage, of numbers of any kind; C: the axes of b at the beginning as seen there."""
        nodes, W = self.nodes, V if self.orbit is None else V + self.orbital(g)
        body = nodes.body
        load, of_potentials = nodes.functions(i).torque(g, W) if self.parts.calls else (None, None)
        loads = self.sampled_loads(i)._replace(of_functions=load, of_potentials=of_potentials)
        x, y, z = self.now(loads, body.momentum_of(W), g).rate
        if nodes.force is not None:
            more = ZEROS
            for f, c in zip(Matrix(*map(nodes.to_material, nodes.force)).T, C, strict=True):
                more = more + cross(f, c)
            x, y, z = x + more[0], y + more[1], z + body.free * more[2]
        if self.parts.spin:
            z = z + (body.E[0] + body.E[1]) * (nodes.spin(i) / nodes.h)
        rate = body.velocity_of(Vector(x, y, z))
        return rate if self.orbit is None else rate - cross(self.orbital(g), V)
