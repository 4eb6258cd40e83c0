"""The stages of a step of `gauss`: their equations, solved by fixed points, or by Newton where these do not contract.

The unknowns of a step are the increments ``L_j = h b_j F_j`` of the momentum P at its s stages, and those of vectors g
that stand still in space, ``g' = g × W``, seen from the body: none, the vertical, or all three axes of b at the
beginning of the step. They lie in memory, stages of a component side by side. For one body a view of a `Stage` holds
all stages at once; for bodies in lanes one stage of all bodies. Each number of a body is made by the same operations in
the same order in both.

Fixed points. An iteration evaluates all stages, Y_i = y_n + Σ μ_ij L_j, and takes L = h b F(Y) for the next L. A body
is done where the increments of L are round-off, or have stopped falling and are small; it then keeps its L, whatever
its neighbours do. To look at the increments takes as long as to make them. So with many stages a step first takes as
many iterations unseen as the step before took, less `CHECKED`: one too many does no harm.

The velocity of a needle about its length is P/J with J small, and has the round-off of all P. Where that is more than
`NEEDLE`, L comes as near to ``h b F(Y)`` as that and no nearer, and K would change by as much. Newton's iteration
leaves a fraction of the last change of P, so such a body is given to it, with this L, unless L stands still exactly.

With few stages at large steps L comes to a standstill, or alternates between two values, within the round-off of the
equations. Of the values within that reach it is those with some rounding errors that stop an iteration, so their mean
is not zero: with one stage at a radian a step K grows by 1e-19 of itself a step, with three by 2e-20, always the same
way. What is one iteration away from an L that did not come about so has no such preference. So up to `DITHERED` stages
L of a body that was not done quickly is changed by some round-off, and iterated once or twice more. What is added is
without a preference itself, and known to a run that resumes: what the compensated sums of the other components of P
have left over. Needles are left alone, as what is added would be their spin.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from ..engine.newton import EPS
from ..engine.sampling import TINY, Nodes
from ..kernels.control import Variables, loop, when, whilst
from ..kernels.elements import all_lanes, any_of, fma, larger, logical_not, select, sqrt, without
from ..kernels.memory import View
from ..kernels.vectors import AXES, Matrix, Vector, cross, sum_of, taxicab
from .gauss_coefficients import TABLE, WIDTH

FALLING, GROWING, PATIENCE = 0.5, 8.0, 12  # how increments must fall in two iterations, may grow in one at first
EARLY = 3  # iterations; from rest, a moment acts on P, then on g, then on P again: increments grow as they like
FEW, MANY = (0.02, 0.002), (0.1, 0.01)  # increments that are small enough, now and next; up to 4 stages, above
CHECKED = 4.0  # last iterations that are looked at
DITHERED, QUICK, DITHER = 3, 8.0, 8.0  # stages; iterations; what the sums have left is multiplied by
ITERATIONS, SMALL, LEVEL, NEEDLE, OVERFLOW = 100, 1e4, 16.0, 3e4, 1e300
INFINITE = float("inf")
ZEROS = Vector(0.0, 0.0, 0.0)

VECTORS = {"free": 0, "moved": 0, "heavy": 1, "rows": 3}  # that stand still in space, among the unknowns of a motion
UNKNOWNS, TURN = ("dp", "dg0", "dg1", "dg2"), ("turn0", "turn1", "turn2")
VECTOR = ("g0", "g1", "g2")


class Stage(NamedTuple):
    """What is known of a stage; what is of space as seen from b at the beginning of the step."""

    dp: Vector  # increments: of P, of vectors that stand still in space
    dg0: Vector
    dg1: Vector
    dg2: Vector
    next_dp: Vector  # those that follow from them
    next_dg0: Vector
    next_dg1: Vector
    next_dg2: Vector
    turn0: Vector  # increments of the axes where they are no unknowns
    turn1: Vector
    turn2: Vector
    moving: Vector  # moments along the frame, in space, of functions of the state; torques of potentials
    space: Vector
    of_functions: Vector
    of_potentials: Vector
    of_memory: Vector  # along the frame, of loads with memory
    rotor: Vector
    axial: float  # increment of a constrained momentum
    P: Vector
    W: Vector
    V: Vector  # what the vectors turn with
    g0: Vector  # the vectors of space
    g1: Vector
    g2: Vector
    own: Vector  # moment along the frame
    sum: Vector  # of the torque along the axis, the work, the arc
    angle: Vector  # of what the body turns by


def ahead(name: str) -> str:
    """Return where the increments are kept that follow from others."""
    return "next_dg" + name[-1] if name in TURN else "next_" + name


class Stages(NamedTuple):
    """The stages of a step of some bodies in memory, and the coefficients."""

    memory: Any
    table: Any
    number: int
    lanes: int  # bodies
    across: int  # numbers from a stage to the next one
    are_together: bool  # whether all stages are evaluated at once

    @property
    def width(self) -> int:
        """How many numbers are evaluated at once."""
        return self.lanes if not self.are_together else 4 if self.number <= 4 else WIDTH

    def lane(self, l: Any) -> Stages:
        """Return those of one of the bodies, stage by stage."""
        return Stages(self.memory.shifted(l), self.table, self.number, 1, self.across, False)

    def one(self, j: Any) -> View:
        """Return a stage."""
        return View(Stage, self.memory.shifted(j * self.across), self.lanes, WIDTH * self.across)

    def at(self, i: Any) -> View:
        """Return the stages that are evaluated at once."""
        return View(Stage, self.memory.shifted(i * self.across), self.width, WIDTH * self.across)

    def each(self) -> Iterator[tuple[Any, View]]:
        """Yield the stages: all at once, or in a loop of the machine."""
        for i in range(1) if self.are_together else loop(self.number):
            yield i, self.at(i)

    def coefficient(self, place: Any, i: Any) -> Any:
        """Return coefficients of the stages that are evaluated at once."""
        return self.table.load(place + i, self.width if self.are_together else 1)

    def collocated(self, name: str, base: Vector, i: Any, matrix: Any = TABLE.mu) -> Vector:
        """Return ``base + Σ μ_ij L_j``; even and odd j are summed apart."""
        sums = [ZEROS, ZEROS]
        for j in range(self.number):
            sums[j % 2] = fma(self.coefficient(matrix + WIDTH * j, i), getattr(self.one(j), name), sums[j % 2])
        return base + (sums[0] + sums[1] if self.number > 1 else sums[0])

    def total(self, name: str) -> Any:
        """Return the sum over the stages."""
        return sum_of(*(getattr(self.one(j), name) for j in range(self.number)))

    def largest(self, x: Any) -> Any:
        """Return the largest number of all stages that are evaluated at once."""
        return all_lanes(larger, x) if self.are_together else x

    def fill(self, names: Sequence[str], vectors: Sequence[Any], mask: Any = True) -> None:
        """Write vectors of zeros, say, to all stages, for bodies whose mask is set."""
        for _, stage in self.each():
            for name, v in zip(names, vectors, strict=True):
                setattr(stage, name, v if mask is True else select(mask, v, getattr(stage, name)))

    def take(self, names: Sequence[str], mask: Any) -> None:
        """Take the increments that follow for the next ones, for bodies whose mask is set."""
        for _ in when(any_of(mask)):
            for _, stage in self.each():
                for name in names:
                    setattr(stage, name, select(mask, getattr(stage, ahead(name)), getattr(stage, name)))


def axes_at(stage: View) -> Matrix:
    """Return the axes of b at the beginning of the step, as seen from the body at stages."""
    return Matrix(stage.g0, stage.g1, stage.g2)


def pulled_back(C: Matrix, f: Vector) -> Vector:
    """Return ``C⁻¹ f``."""
    n = cross(C[1], C[2])
    inner = fma(f[1], cross(C[2], C[0]), f[2] * cross(C[0], C[1]))
    return (1.0 / (C[0] @ n)) * fma(f[0], n, inner)


class Now(NamedTuple):
    """What the equations say at a stage."""

    W: Vector
    rate: Vector  # of P
    own: Any  # moments along the frame and in space, of dead forces, torque
    push: Any
    still: Any
    torque: Vector


class StageLoads(NamedTuple):
    """What acts at a stage, named as in `Stage`; None where there is nothing of it."""

    moving: Any = None  # less the rate of the rotors
    space: Any = None
    rotor: Any = None
    of_functions: Any = None
    of_potentials: Any = None
    of_memory: Any = None

    def store(self, stage: View) -> None:
        """Keep it in memory."""
        for name, x in self._asdict().items():
            if x is not None:
                setattr(stage, name, x)


class Equations:
    """The equations of a step: P' and g' at the stages, from P and the vectors g."""

    def __init__(self, motion: str, nodes: Nodes, stages: Stages, P: Vector, memory: Any = None) -> None:
        self.nodes, self.stages, self.P, self.k = nodes, stages, P, nodes.body.k
        self.parts, self.names = nodes.parts, UNKNOWNS[: 1 + VECTORS[motion]]
        self.has_rows, body = motion == "rows", nodes.body
        self.orbit, self.memory = None, memory
        if self.parts.orbit and self.has_rows:
            n, o = nodes.orbit
            self.orbit = n, nodes.to_material(o)
        self.start: tuple[Vector, ...] = ()  # vectors of space at the beginning, and what they are acted on by
        self.forces: tuple[Vector, ...] = ()
        if self.has_rows:
            self.start, self.forces = AXES, nodes.dead().T if self.parts.dead else ()
        elif motion == "heavy":
            self.start, self.forces = (nodes.to_material(body.vertical),), (body.dead @ body.vertical,)

    def sample(self) -> None:
        """Take what acts at the nodes of the step to its stages; rows begin with increments of zero."""
        if self.has_rows:
            self.stages.fill(self.names[1:], [ZEROS] * 3)
        for j in loop(self.stages.number):
            stage = self.stages.one(j)
            self.sampled_loads(j).store(stage)
            if self.parts.spin:
                J3 = self.nodes.body.spin * (1.0 / self.k[2])
                stage.axial = (self.nodes.spin(j) * self.stages.table[TABLE.weights + j]) * J3

    @property
    def stiffness(self) -> Any:
        """H times the size of P and the largest 1/J_i."""
        return self.nodes.h * taxicab(self.P) * larger(larger(self.k[0], self.k[1]), self.k[2])

    @property
    def level(self) -> Any:
        """The round-off of the equations, in units of that of the velocity."""
        return LEVEL * (1.0 + self.stiffness)

    @property
    def is_eager(self) -> bool:
        """Whether the first iterations of a step are not looked at."""
        return self.stages.number > DITHERED and not self.has_rows

    def sampled_loads(self, j: Any) -> StageLoads:
        """Return what acts at a node of the step."""
        nodes, parts = self.nodes, self.parts
        rotor, rate = nodes.rotor(j) if parts.rotor else (None, None)
        moving = sum_of(nodes.moving(j) if parts.moving else None, None if rate is None else -rate)
        return StageLoads(moving, nodes.space(j) if parts.space else None, rotor)

    def stored_loads(self, stage: View) -> StageLoads:
        """Return what acts at stages as it is kept in memory."""
        parts = self.parts
        is_there = parts.moving or parts.rotor, parts.space, parts.rotor, parts.calls, parts.generalised, parts.memory
        names = zip(StageLoads._fields, is_there, strict=True)
        return StageLoads(*(getattr(stage, name) if is_one else None for name, is_one in names))

    def placed(self, i: Any, matrix: Any = TABLE.mu) -> tuple[Vector, Any]:
        """Return P and the vectors g at stages."""
        bases = zip(self.names, (self.P, *self.start), strict=True)
        P, *g = (self.stages.collocated(name, base, i, matrix) for name, base in bases)
        return P, Matrix(*g)

    def now(self, loads: StageLoads, P: Vector, g: Any, inverse: Any = pulled_back) -> Now:
        """Return what the equations say at P and g; on dual numbers as well. `inverse` gives C⁻¹ f."""
        body, parts = self.nodes.body, self.parts
        W, whole = body.velocity_of(P), P
        if parts.is_constrained:
            whole = Vector(P[0], P[1], P[2] + body.off[0] * W[0] + body.off[1] * W[1])
        drag = -(body.damping @ W) if parts.damping else None
        own = sum_of(loads.moving, drag, cross(loads.rotor, W) if parts.rotor else None, loads.of_memory)
        still = None
        for force, v in reversed(list(zip(self.forces, g, strict=False))):
            still = sum_of(cross(force, v), still)
        push = sum_of(loads.space, loads.of_functions)
        push = None if push is None else inverse(g, push)
        torque = sum_of(cross(whole, W), own, sum_of(still, loads.of_potentials), push)
        third = body.free * torque[2] if parts.is_constrained else torque[2]
        return Now(W, Vector(torque[0], torque[1], third), own, push, still, torque)

    def evaluated(self, i: Any, stage: View, matrix: Any = TABLE.mu) -> tuple[Vector, Any, Now]:
        """Return P, the vectors g, and what the equations say at stages."""
        P, g = self.placed(i, matrix)
        if self.parts.calls:
            stage.P, v = P, Variables(is_fine=True)
            stage.g0, stage.g1, stage.g2 = g
            fine = (lambda: v.is_fine) if self.stages.lanes == 1 else None
            for j in loop(self.stages.number, whilst=fine) if self.stages.are_together else (i,):
                one = self.stages.one(j)
                self.evaluate_functions(j, axes_at(one), self.k * one.P).store(one)
                if fine is not None:
                    v.is_fine = taxicab(one.of_functions) <= OVERFLOW
        return P, g, self.now(self.stored_loads(stage), P, g)

    def evaluate_functions(self, j: Any, rows: Matrix, W: Vector) -> StageLoads:
        """Return what functions of the state give at a stage."""
        nodes, functions, w = self.nodes, self.nodes.functions(j), rows @ W
        if self.orbit is not None:  # the frame of the rows is that of the beginning of the step
            length = nodes.h / nodes.rate
            functions = functions._replace(t=functions.t - self.stages.table[TABLE.nodes + j] * length)
        functions.evaluate(nodes.R @ rows, w, 0.0 * w)
        found = StageLoads(of_memory=self.evaluate_memory(j, functions.t, rows, W) if self.memory else None)
        if not self.parts.generalised:
            return found._replace(of_functions=functions.found("total") @ nodes.R)
        torque = functions.found("of_potentials") @ nodes.body.basis
        return found._replace(of_functions=functions.found("load") @ nodes.R, of_potentials=torque)

    def evaluate_memory(self, j: Any, t: Any, rows: Matrix, W: Vector) -> Vector:
        """Return the moment along the frame of loads with memory; add the one in space to what was found."""
        nodes, basis = self.nodes, self.nodes.body.basis
        d, w = Matrix(*(basis @ row for row in nodes.R @ rows)).T, nodes.R @ (rows @ W)
        space, along, zero = self.memory.evaluate(j, t, d, nodes.rate * w, nodes.rate * (basis @ W))
        for name in ("total", "load"):
            setattr(nodes.x.found, name, getattr(nodes.x.found, name) + Vector(*(x + zero for x in space)))
        return (nodes.x.scale * Vector(*(x + zero for x in along))) @ basis

    def turning(self, W: Vector, g: Any) -> Vector:
        """Return the velocity that vectors g turn with: W, less that of an orbit ``n o`` that they are seen from."""
        if self.orbit is None:
            return W
        n, o = self.orbit
        return fma(-n * o[0], g[0], fma(-n * o[1], g[1], fma(-n * o[2], g[2], W)))

    def follow(self, i: Any, stage: View, matrix: Any) -> list[Vector]:
        """Return the increments that follow from those there are."""
        _, g, now = self.evaluated(i, stage, matrix)
        return self.increments(i, stage, g, now)

    def increments(self, i: Any, stage: View, g: Any, now: Now) -> list[Vector]:
        """Return the increments that follow, of P and the vectors g."""
        b = self.nodes.h * self.stages.coefficient(TABLE.weights, i)
        dP, V = b * now.rate, self.turning(now.W, g)
        if self.parts.spin:
            dP = Vector(dP[0], dP[1], dP[2] + stage.axial)
        return [dP, *(b * cross(v, V) for v in g)]

    def ended(self, takes: Any) -> Any:
        """Evaluate the stages found, store P, W, g and sums; return the smallest determinant of the rows, negative.

        Bodies whose mask is set take the increments that come out, which are nearer to the solution.
        """
        v, stages, memory = Variables(least=0.0 * self.P[0] - 1.0), self.stages, self.memory
        if memory:
            memory.update_states()
        for i, stage in stages.each():
            b = self.nodes.h * stages.coefficient(TABLE.weights, i)
            stage.P, g, now = self.evaluated(i, stage)
            W, power = now.W, 0.0 * now.W[0]
            stage.W = W
            for name, c in zip(VECTOR, g, strict=False):
                setattr(stage, name, c)
            if now.push is not None:
                power = W @ now.push
            if now.own is not None:
                power = power + W @ now.own
                stage.own = now.own
            if self.has_rows:
                v.least = larger(v.least, stages.largest(-(g[0] @ cross(g[1], g[2]))))
            for name, x in zip(self.names, self.increments(i, stage, g, now), strict=True):
                setattr(stage, ahead(name), x)
            stage.sum, stage.angle = Vector(b * now.torque[2], b * power, b * sqrt(W @ W)), b * W
        stages.take(self.names, takes)
        if memory:
            for _ in when(any_of(takes)):
                for i, stage in stages.each():
                    memory.follow(i, stage)
            memory.end()
        return v.least


class TurnEquations:
    """The equations of the axes ``c_k' = c_k × W`` at the stages, whose velocities are known: linear."""

    names, k, memory = TURN, None, None

    def __init__(self, nodes: Nodes, stages: Stages) -> None:
        self.stages, self.h, self.level = stages, nodes.h, LEVEL + 0.0 * nodes.body.free
        stages.fill(TURN, [ZEROS] * 3)

    def follow(self, i: Any, stage: View, matrix: Any) -> list[Vector]:
        """Return the increments that follow from those there are."""
        b, W = self.h * self.stages.coefficient(TABLE.weights, i), stage.W
        return [b * cross(self.stages.collocated(name, axis, i), W) for name, axis in zip(TURN, AXES, strict=True)]

    def end(self) -> None:
        """Keep the axes that belong to the increments."""
        for i, stage in self.stages.each():
            for name, turn, axis in zip(VECTOR, TURN, AXES, strict=True):
                setattr(stage, name, self.stages.collocated(turn, axis, i))


def iterated(
    equations: Any, alive: Any, matrix: Any = TABLE.mu, unchecked: Any = 0.0, compensation: Any = None
) -> tuple[Any, Any]:
    """Iterate increments; return the mask of bodies that are for Newton's iteration, and the iterations of each.

    Of these needles and bodies that took too many iterations keep their increments; those of P are zero where they do
    not contract.

    Parameters
    ----------
    equations : Equations or TurnEquations
        The first increments are those of P where they have k, 1/J_i.
    alive : mask
    matrix : int
        Coefficients of the first iteration.
    unchecked : number
        How many iterations are not looked at.
    compensation : Vector
        What P was rounded by, where increments of few stages are changed by it.
    """
    stages, k, level = equations.stages, equations.k, equations.level
    speed = None if k is None else taxicab(k * equations.P)
    zero, is_dithered = 0.0 * level, compensation is not None and stages.number <= DITHERED
    v = Variables(active=alive, for_newton=zero > 1.0, used=zero, before=zero + INFINITE, earlier=zero + INFINITE)
    v.count, v.last, v.matrix, v.takes = 0, 0, matrix, alive
    soonest = None if isinstance(unchecked, float) else -all_lanes(larger, -unchecked)
    for _ in whilst(lambda: any_of(v.active)):
        count, v.change, v.reach, v.turn = v.count, zero, zero, zero
        is_checked = True if soonest is None else count >= soonest
        update_increments(equations, v, is_checked)
        v.used, v.takes = select(v.active, v.used + 1.0, v.used), v.active
        v.worse = v.for_newton & False
        for _ in when(is_checked):
            now = v.turn * (1.0 / EPS)
            if k is not None:
                now = larger(v.change / (EPS * (speed + v.reach) + TINY), now)
            check_convergence(v, stages.number, zero + count, count - unchecked, now, level)
        if not stages.are_together:
            stages.take(equations.names, v.takes)
        if k is not None:
            for _ in when(any_of(v.worse)):
                stages.fill(equations.names[:1], [ZEROS], v.worse)
        v.count, v.matrix = count + 1, TABLE.mu
        if is_dithered:
            for _ in when(v.last > 0):
                v.active = v.takes & (count + 1 < v.last)
        for _ in when((v.last == 0) & (count + 1 >= ITERATIONS)):
            v.for_newton, v.active = v.for_newton | v.active, v.active & False
        if is_dithered:
            for _ in when((v.last == 0) & logical_not(any_of(v.active))):
                v.active = without(alive & (level <= NEEDLE) & (v.used > QUICK), v.for_newton)
                v.last = count + (3 if stages.number == 1 else 2)
                dither(stages, compensation, v.active)
    return v.for_newton, v.used


def update_increments(equations: Any, v: Variables, is_checked: Any) -> None:
    """Replace the increments by those that follow; look at how far they moved where they are checked.

    ``v.change`` is the largest move of W, ``v.turn`` of the vectors g and of the memory, ``v.reach`` the largest W.
    """
    stages, names, k, memory = equations.stages, equations.names, equations.k, equations.memory
    if memory:
        memory.update_states(v.matrix)
    for i, stage in stages.each():
        new = equations.follow(i, stage, v.matrix)
        d = [x - getattr(stage, name) for name, x in zip(names, new, strict=True)]
        for name, x in zip(names, new, strict=True):
            setattr(stage, name if stages.are_together else ahead(name), x)
        for _ in when(is_checked):
            turns = d
            if k is not None:
                v.change = larger(v.change, largest_change(stages, k * d[0]))
                v.reach = larger(v.reach, stages.largest(taxicab(k * new[0])))
                turns = d[1:]
            if turns:
                v.turn = larger(v.turn, largest_change(stages, *turns))
        if memory:
            v.turn = larger(v.turn, memory.follow(i, stage))


def largest_change(stages: Stages, *vectors: Vector) -> Any:
    """Return the largest size over the stages, infinity where one is not a number."""
    d = taxicab(vectors[0])
    for v in vectors[1:]:
        d = d + taxicab(v)
    return stages.largest(select(d <= OVERFLOW, d, INFINITE))


def check_convergence(v: Variables, s: int, count: Any, checked: Any, now: Any, level: Any) -> None:
    """Deactivate bodies that are done, and those that do not contract.

    `checked` is how many iterations before this one were looked at, less than 0 where this one is not. `now` is the
    size of the increments in round-off of the velocity, ``v.before`` and ``v.earlier`` those of the last two
    iterations: increments may turn as they shrink. What is left after a body is done would add up to a drift, so it is
    to be small beside round-off; `level` is the round-off of the equations. Needles within it are for Newton.
    """
    near, then = FEW if s <= 4 else MANY
    v.takes = v.active & ((now <= OVERFLOW) | (checked < 0.0))
    worse = without(v.active, v.takes)
    done = (now <= near) & (checked > 0.0) | (now * now <= then * v.before) & (checked > 1.0)
    done = v.takes & (done | (now <= level) & (now >= v.earlier) & (checked > 2.0))
    needles = done & (level > NEEDLE) & (now > 0.0)
    grown = (now > GROWING * v.before) | (now > FALLING * v.earlier) & (count > PATIENCE)
    grown = without(without(v.takes, done) & grown & (checked > 0.0) & (count > EARLY), now <= SMALL + level)
    v.worse = worse | grown
    v.for_newton, v.active = v.for_newton | needles | v.worse, without(without(v.takes, done), grown)
    v.earlier, v.before = select(checked > 0.0, v.before, v.earlier), select(checked > 0.0, now, v.before)


def dither(stages: Stages, compensation: Vector, mask: Any) -> None:
    """Add some round-off to the increments of P, for bodies whose mask is set: what the last sum of P has left."""
    d = select(mask, DITHER * Vector(compensation[1], compensation[2], compensation[0]), 0.0 * compensation)
    for _, stage in stages.each():
        stage.dp = stage.dp + d
