"""The stages of a step of `gauss`: their equations, solved by fixed points or, where these do not contract, by Newton.

The unknowns of a step are the increments ``L_j = h b_j F_j`` of the momentum P at its s stages, and those of vectors g
that stand still in space, ``g' = g × W``, seen from the body: none, the vertical, or all three axes of b at the
beginning of the step. They lie in memory, stages of a component side by side. For one body a view of a `Stage` holds
all stages at once; for bodies in lanes one stage of all bodies. Each number of a body is made by the same operations in
the same order in both.

Fixed points. An iteration evaluates all stages, Y_i = y_n + Σ μ_ij L_j, and takes L = h b F(Y) for the next L. A body
is done where the increments of L are round-off, or have stopped falling and are small; it then keeps its L, whatever
its neighbours do. To look at the increments takes as long as to make them. So with many stages a step first takes as
many iterations unseen as the step before took, less `SEEN`: one too many does no harm.

The velocity of a needle about its length is P/J with J small, and has the round-off of all P. Where that is more than
`NEEDLE`, L comes as near to ``h b F(Y)`` as that and no nearer, and K would change by as much. Newton's iteration
leaves a fraction of the last change of P, so such a body is given to it, with this L, unless L stands still exactly.

With few stages at large steps L comes to a standstill, or alternates between two values, within the round-off of the
equations. Of the values within that reach it is those with some rounding errors that stop an iteration, so their mean
is not zero: with one stage at a radian a step K grows by 1e-19 of itself a step, with three by 2e-20, always the same
way. What is one iteration away from an L that did not come about so has no such preference. So up to `SHY` stages the L
of a body that was not done quickly is changed by some round-off, and iterated once or twice more. What is added is
without a preference itself, and known to a run that resumes: what the compensated sums of the other components of P
have left over. Needles are left alone, as what is added would be their spin.

Newton. The vectors g of the stages follow from the velocities by one linear system of 3s equations,

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

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from ..engine.records import Parts
from ..engine.sampling import Nodes
from ..engine.state_moments import DIFFERENCE
from ..kernels.control import Variables, loop, when, whilst
from ..kernels.dual import Dual, plain, tangent
from ..kernels.elements import any_of, fma, larger, largest_of, logical_not, select, without
from ..kernels.memory import View, room
from ..kernels.parts import part, rare
from ..kernels.vectors import AXES, Matrix, Vector, cross, sum_of, taxicab
from .gauss_coefficients import TABLE, WIDTH

EPS = 2.0**-52
FALLING, GROWING, PATIENCE = 0.5, 8.0, 12  # how increments must fall in two iterations, may grow in one at first
EARLY = 3  # iterations; from rest, a moment acts on P, then on g, then on P again: increments grow as they like
FEW, MANY = (0.02, 0.002), (0.1, 0.01)  # increments that are small enough, now and next; up to 4 stages, above
SEEN = 4.0  # last iterations that are looked at
SHY, QUICK, SHAKEN = 3, 8.0, 8.0  # stages; iterations; what the sums have left is multiplied by
ITERATIONS, SMALL, ROUGH, NEEDLE, LOST, TINY = 100, 1e4, 16.0, 3e4, 1e300, 1e-300
NEWTON, NEAR, FAR, ROUND_OFF = 50, 4.0, 1e5, 16.0 * EPS
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
    called: Vector
    held: Vector
    rotor: Vector
    lift: float  # increment of a held momentum
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
    def wide(self) -> int:
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
        return View(Stage, self.memory.shifted(i * self.across), self.wide, WIDTH * self.across)

    def each(self) -> Iterator[tuple[Any, View]]:
        """Yield the stages: all at once, or in a loop of the machine."""
        for i in range(1) if self.are_together else loop(self.number):
            yield i, self.at(i)

    def coefficient(self, place: Any, i: Any) -> Any:
        """Return coefficients of the stages that are evaluated at once."""
        return self.table.load(place + i, self.wide if self.are_together else 1)

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
        return largest_of(x) if self.are_together else x

    def put(self, names: Sequence[str], vectors: Sequence[Any], mask: Any = True) -> None:
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


def rows_of(stage: View) -> Matrix:
    """Return the axes of b at the beginning of the step, as seen from the body at stages."""
    return Matrix(stage.g0, stage.g1, stage.g2)


def turned(v: Vector) -> Vector:
    """Return a vector of space as dual numbers: behind three directions that leave it alone the turns of the body."""
    x, y, z = v
    tangents = (0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)
    return Vector(*(Dual(a, [0.0, 0.0, 0.0, *turns]) for a, turns in zip(v, tangents, strict=True)))


def drawn(C: Matrix, f: Vector) -> Vector:
    """Return ``C⁻¹ f``."""
    n = cross(C[1], C[2])
    inner = fma(f[1], cross(C[2], C[0]), f[2] * cross(C[0], C[1]))
    return (1.0 / (C[0] @ n)) * fma(f[0], n, inner)


def drawn_of_duals(C: Any, f: Vector) -> Vector:
    """Return ``C⁻¹ f`` of rows that turn with the body, which therefore turns like a vector of space."""
    C = plain(Matrix(*C))
    v = turned(drawn(C, plain(f)))
    if not isinstance(f[0], Dual):
        return v
    changes = [drawn(C, tangent(f, j)) for j in range(6)]
    return Vector(
        *(Dual(x.value, [t + d[i] for t, d in zip(x.tangents, changes, strict=True)]) for i, x in enumerate(v))
    )


class Now(NamedTuple):
    """What the equations say at a stage."""

    W: Vector
    rate: Vector  # of P
    own: Any  # moments along the frame and in space, torque
    push: Any
    torque: Vector


class Sampled(NamedTuple):
    """Moments along the frame and in space, momentum of the rotors; None where there are none."""

    moving: Any
    space: Any
    rotor: Any


class Equations:
    """The equations of a step: P' and g' at the stages, from P and the vectors g."""

    def __init__(self, motion: str, acting: Nodes, stages: Stages, P: Vector) -> None:
        self.acting, self.stages, self.P, self.k = acting, stages, P, acting.body.k
        self.parts, self.names = acting.parts, UNKNOWNS[: 1 + VECTORS[motion]]
        self.has_rows, body = motion == "rows", acting.body
        self.orbit = None
        if self.parts.orbit and self.has_rows:
            n, o = acting.orbit
            self.orbit = n, acting.seen(o)
        self.start: tuple[Vector, ...] = ()  # vectors of space at the beginning, and what they are acted on by
        self.forces: tuple[Vector, ...] = ()
        if self.has_rows:
            self.start, self.forces = AXES, acting.dead().T if self.parts.dead else ()
        elif motion == "heavy":
            self.start, self.forces = (acting.seen(body.vertical),), (body.dead @ body.vertical,)

    def sample(self) -> None:
        """Take what acts at the nodes of the step to its stages."""
        for j in loop(self.stages.number):
            stage = self.stages.one(j)
            for name, x in self.sampled(j)._asdict().items():
                if x is not None:
                    setattr(stage, name, x)
            if self.parts.spin:
                J3 = self.acting.body.spin * (1.0 / self.k[2])
                stage.lift = (self.acting.spin(j) * self.stages.table[TABLE.weights + j]) * J3

    def sampled(self, j: Any) -> Sampled:
        """Return what acts at a node of the step."""
        acting, parts = self.acting, self.parts
        moving = acting.moving(j) if parts.moving else None
        rotor, rate = acting.rotor(j) if parts.rotor else (None, None)
        if rate is not None:
            moving = -rate if moving is None else moving - rate
        return Sampled(moving, acting.space(j) if parts.space else None, rotor)

    def placed(self, i: Any, matrix: Any = TABLE.mu) -> tuple[Vector, Any]:
        """Return P and the vectors g at stages."""
        P, *g = (
            self.stages.collocated(name, base, i, matrix)
            for name, base in zip(self.names, (self.P, *self.start), strict=True)
        )
        return P, Matrix(*g) if g else ()

    def now(self, stage: Any, P: Vector, g: Any, called: Any = None, held: Any = None, inverse: Any = drawn) -> Now:
        """Return what the equations say at P and g; on dual numbers as well.

        `called` and `held` are what functions say there, `inverse` gives C⁻¹ f.
        """
        body, parts = self.acting.body, self.parts
        W, whole = body.velocity_of(P), P
        if parts.is_held and (self.has_rows or body.coupling is not None):
            whole = Vector(P[0], P[1], P[2] + body.off[0] * W[0] + body.off[1] * W[1])
        own = sum_of(
            stage.moving if parts.moving or parts.rotor else None,
            -(body.damping @ W) if parts.damping else None,
            cross(stage.rotor, W) if parts.rotor else None,
        )
        still = None
        for force, v in reversed(list(zip(self.forces, g, strict=False))):
            still = sum_of(cross(force, v), still)
        push = sum_of(stage.space if parts.space else None, called)
        push = None if push is None else inverse(g, push)
        torque = sum_of(cross(whole, W), own, sum_of(still, held), push)
        third = body.free * torque[2] if parts.is_held else torque[2]
        return Now(W, Vector(torque[0], torque[1], third), own, push, torque)

    def evaluated(self, i: Any, stage: View, matrix: Any = TABLE.mu) -> tuple[Vector, Any, Now]:
        """Return P, the vectors g, and what the equations say at stages."""
        P, g = self.placed(i, matrix)
        if not self.parts.calls:
            return P, g, self.now(stage, P, g)
        stage.P, v = P, Variables(is_fine=True)
        stage.g0, stage.g1, stage.g2 = g
        fine = (lambda: v.is_fine) if self.stages.lanes == 1 else None
        for j in loop(self.stages.number, whilst=fine) if self.stages.are_together else (i,):
            one = self.stages.one(j)
            rows = rows_of(one)
            one.called, held = self.called(j, rows, rows @ (self.k * one.P))
            if held is not None:
                one.held = held
            if fine is not None:
                v.is_fine = taxicab(one.called) <= LOST
        return P, g, self.now(stage, P, g, stage.called, stage.held if self.parts.generalised else None)

    def called(self, j: Any, rows: Matrix, w: Vector) -> tuple[Vector, Any]:
        """Return the moment of functions at a stage, as seen at the beginning, and the torque of potentials."""
        acting, functions = self.acting, self.acting.functions(j)
        if self.orbit is not None:  # the frame of the rows is that of the beginning of the step
            length = acting.h / acting.rate
            functions = functions._replace(t=functions.t - self.stages.table[TABLE.nodes + j] * length)
        functions.evaluate(acting.R @ rows, w, 0.0 * w)
        if not self.parts.generalised:
            return functions.found("total") @ acting.R, None
        return functions.found("load") @ acting.R, functions.found("held") @ acting.body.basis

    def note_call(self, is_sound: Any) -> None:
        """Let it be known that a function has given what is no number."""
        for _ in when(logical_not(is_sound)):
            self.acting.x.found.total = (float("nan"),) * 3

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
        b = self.acting.h * self.stages.coefficient(TABLE.weights, i)
        dP, V = b * now.rate, self.turning(now.W, g)
        if self.parts.spin:
            dP = Vector(dP[0], dP[1], dP[2] + stage.lift)
        return [dP, *(b * cross(v, V) for v in g)]


def iterated(
    stages: Stages,
    names: Sequence[str],
    following: Callable[[Any, View, Any], list[Vector]],
    alive: Any,
    rough: Any,
    matrix: Any = TABLE.mu,
    k: Any = None,
    speed: Any = None,
    unseen: Any = 0.0,
    carry: Any = None,
) -> tuple[Any, Any]:
    """Iterate increments; return the mask of bodies that are for Newton's iteration, and the iterations of each.

    Of these needles and bodies that took too many iterations keep their increments; those of P are zero where they do
    not contract.

    Parameters
    ----------
    names : sequence of str
        The increments.
    following : function
        Of a stage and the coefficients: the increments that follow.
    alive : mask
    rough : number
        Round-off of the equations, in units of that of the velocity.
    matrix : int
        Coefficients of the first iteration.
    k, speed
        1/J_i, the speed: where the first increments are those of P.
    carry : Vector
        What P was rounded by, where increments of few stages are changed by it.
    unseen : number
        How many iterations are not looked at.
    """
    zero, is_shy = 0.0 * rough, carry is not None and stages.number <= SHY
    v = Variables(open=alive, hard=zero > 1.0, used=zero, before=zero + INFINITE, earlier=zero + INFINITE)
    v.count, v.last, v.matrix, v.takes = 0, 0, matrix, alive
    soonest = None if isinstance(unseen, float) else -largest_of(-unseen)
    for _ in whilst(lambda: any_of(v.open)):
        count, v.change, v.reach, v.turn = v.count, zero, zero, zero
        is_seen = True if soonest is None else count >= soonest
        for i, stage in stages.each():
            new = following(i, stage, v.matrix)
            d = [x - getattr(stage, name) for name, x in zip(names, new, strict=True)]
            for name, x in zip(names, new, strict=True):
                setattr(stage, name if stages.are_together else ahead(name), x)
            for _ in when(is_seen):
                turns = d
                if k is not None:
                    v.change = larger(v.change, peak(stages, k * d[0]))
                    v.reach = larger(v.reach, stages.largest(taxicab(k * new[0])))
                    turns = d[1:]
                if turns:
                    v.turn = larger(v.turn, peak(stages, *turns))
        v.used, v.takes = select(v.open, v.used + 1.0, v.used), v.open
        v.worse = v.hard & False
        for _ in when(is_seen):
            now = v.turn * (1.0 / EPS)
            if k is not None:
                now = larger(v.change / (EPS * (speed + v.reach) + TINY), now)
            progress(v, stages.number, zero + count, count - unseen, now, rough)
        if not stages.are_together:
            stages.take(names, v.takes)
        if k is not None:
            for _ in when(any_of(v.worse)):
                stages.put(names[:1], [ZEROS], v.worse)
        v.count, v.matrix = count + 1, TABLE.mu
        if is_shy:
            for _ in when(v.last > 0):
                v.open = v.takes & (count + 1 < v.last)
        for _ in when((v.last == 0) & (count + 1 >= ITERATIONS)):
            v.hard, v.open = v.hard | v.open, v.open & False
        if is_shy:
            for _ in when((v.last == 0) & logical_not(any_of(v.open))):
                v.open = without(alive & (rough <= NEEDLE) & (v.used > QUICK), v.hard)
                v.last = count + (3 if stages.number == 1 else 2)
                shake(stages, carry, v.open)
    return v.hard, v.used


def peak(stages: Stages, *vectors: Vector) -> Any:
    """Return the largest size over the stages, infinity where one is not a number."""
    d = taxicab(vectors[0])
    for v in vectors[1:]:
        d = d + taxicab(v)
    return stages.largest(select(d <= LOST, d, INFINITE))


def progress(v: Variables, s: int, count: Any, seen: Any, now: Any, rough: Any) -> None:
    """Close bodies that are done, and those that do not contract.

    `seen` is how many iterations before this one were looked at, less than 0 where this one is not either. `now` is the
    size of the increments in round-off of the velocity, ``v.before`` and ``v.earlier`` those of the last two
    iterations: increments may turn as they shrink. What is left after a body is done would add up to a drift, so it is
    to be small beside round-off; `rough` is the round-off of the equations. Needles within it are for Newton.
    """
    near, then = FEW if s <= 4 else MANY
    v.takes = v.open & ((now <= LOST) | (seen < 0.0))
    worse = without(v.open, v.takes)
    done = (now <= near) & (seen > 0.0) | (now * now <= then * v.before) & (seen > 1.0)
    done = v.takes & (done | (now <= rough) & (now >= v.earlier) & (seen > 2.0))
    needles = done & (rough > NEEDLE) & (now > 0.0)
    grown = (now > GROWING * v.before) | (now > FALLING * v.earlier) & (count > PATIENCE)
    grown = without(without(v.takes, done) & grown & (seen > 0.0) & (count > EARLY), now <= SMALL + rough)
    v.worse = worse | grown
    v.hard, v.open = v.hard | needles | v.worse, without(without(v.takes, done), grown)
    v.earlier, v.before = select(seen > 0.0, v.before, v.earlier), select(seen > 0.0, now, v.before)


def shake(stages: Stages, carry: Vector, mask: Any) -> None:
    """Add some round-off to the increments of P, for bodies whose mask is set: what the last sum of P has left."""
    d = select(mask, SHAKEN * Vector(carry[1], carry[2], carry[0]), 0.0 * carry)
    for _, stage in stages.each():
        stage.dp = stage.dp + d


def eliminate(a: Any, m: int, width: int) -> None:
    """Let `eliminated` stand once in the code, whatever the sizes."""
    v = Variables(m=m, width=width)
    eliminated(a, v.m, v.width)


@part
def eliminated(a: Any, m: Any, width: Any) -> None:
    """Replace the columns after the m-th of m rows by the solutions, for each as right-hand side; partial pivots."""

    def subtract(i: Any, k: Any, g: Any, first: Any) -> None:
        for _ in when(g != 0.0):
            for j in loop(first, width):
                a[i * width + j] = a[i * width + j] - g * a[k * width + j]

    for k in loop(m):
        v = Variables(pivot=k, largest=abs(a[k * width + k]))
        for i in loop(k + 1, m):
            here = abs(a[i * width + k])
            v.pivot, v.largest = select(here > v.largest, i, v.pivot), larger(here, v.largest)
        pivot = v.pivot
        for _ in when(pivot != k):
            for j in loop(k, width):
                x, y = a[k * width + j], a[pivot * width + j]
                a[k * width + j], a[pivot * width + j] = y, x
        f = 1.0 / a[k * width + k]
        for i in loop(k + 1, m):
            subtract(i, k, f * a[i * width + k], k + 1)
    for back in loop(m):
        k = m - 1 - back
        f = 1.0 / a[k * width + k]
        for j in loop(m, width):
            a[k * width + j] = f * a[k * width + j]
        for i in loop(k):
            subtract(i, k, a[i * width + k], m)


def vectors_of_space(
    stages: Stages, a: Any, h: Any, starts: Sequence[Vector], turning: str, names: Sequence[str], k: Any = None
) -> int:
    """Solve for the vectors of space at the stages, which turn with the velocities there, and set their increments.

    The room `a` then holds behind the 3 s columns of the system: the turns by changes of each momentum, if k = 1/J_i is
    given, and the vectors. Returns the width of its rows.
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
    eliminate(a, m, width)
    for i in loop(s):
        stage, b = stages.one(i), h * stages.table[TABLE.weights + i]
        for c, name in enumerate(names):
            at = 3 * i * width + side + c
            g = Vector(a[at], a[at + width], a[at + 2 * width])
            setattr(stage, name, b * cross(g, getattr(stage, turning)))
            if k is not None:
                setattr(stage, VECTOR[c], g)
    return width


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
            called, held = self.called(v, i, stage, rows_of(stage)) if e.parts.calls else (None, None)
            P = Vector(*(Dual(x, [float(j == c) for c in range(6 if g else 3)]) for j, x in enumerate(stage.P)))
            for _ in when(v.is_fine):
                rate = e.now(stage, P, [turned(c) for c in g], called, held, drawn_of_duals).rate
                dP = b * plain(rate)
                if e.parts.spin:
                    dP = Vector(dP[0], dP[1], dP[2] + stage.lift)
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
        e, W, found = self.equations, stage.W, room(7 * 6)
        v.is_fine = v.is_fine & (taxicab(W) + (taxicab(C[0]) + taxicab(C[1]) + taxicab(C[2])) <= LOST)
        change = DIFFERENCE * taxicab(W)
        change = select(change > 0.0, change, DIFFERENCE)
        for q in loop(7, whilst=lambda: v.is_fine):  # there, at three more velocities, after three turns
            w = Vector(*(x + select(q == j + 1, change, 0.0) for j, x in enumerate(W)))
            a = Vector(*(select(q == j + 4, DIFFERENCE, 0.0) for j in range(3)))
            rows = Matrix(*(c + cross(c, a) for c in C))
            f, held = e.called(i, rows, rows @ w)
            for j, x in enumerate((*f, *(held or ()))):
                found[6 * q + j] = x
            is_sound = (q > 0) | (taxicab(f) + taxicab(held or ZEROS) <= LOST)
            e.note_call(is_sound)
            v.is_fine = v.is_fine & is_sound

        def dual(j: int, by_velocity: bool) -> Dual:
            d = [found[6 * q + j] - found[j] for q in range(1, 7)]
            by_momentum = [(k / change) * x if by_velocity else 0.0 for k, x in zip(e.k, d[:3], strict=True)]
            return Dual(found[j], by_momentum + [x * (1.0 / DIFFERENCE) for x in d[3:]])

        stage.called = Vector(found[0], found[1], found[2])
        called = Vector(*(dual(j, True) for j in range(3)))
        if not e.parts.generalised:
            return called, None
        stage.held = Vector(found[3], found[4], found[5])
        return called, Vector(*(dual(j + 3, False) for j in range(3)))

    def turn(self, i: Any, q: Any) -> Vector:
        """Return the turn at a stage by a momentum."""
        at, width = 3 * i * self.width + self.m + q, self.width
        return Vector(self.turns[at], self.turns[at + width], self.turns[at + 2 * width])

    def solve(self) -> None:
        """Find the changes of P at the stages."""
        combine(self.momenta, self.slopes, self.stages.table.shifted(TABLE.mu), self.stages.number)
        eliminate(self.momenta, self.m, self.m + 1)

    def correct(self, v: Variables) -> None:
        """Add to L what the changes of P make; set the largest change of a velocity or turn, and the largest residual.

        That is relative to the velocity and what a turn by one radian would add to it. Infinite if one is lost.
        """
        e, m, k = self.equations, self.m, self.equations.k
        v.worst, v.left, fastest = 0.0 * self.h, 0.0 * self.h, larger(larger(k[0], k[1]), k[2])
        for i in loop(self.stages.number, whilst=lambda: v.is_fine):
            stage, at, n = self.stages.one(i), 3 * i * (m + 1), m + 1
            x = Variables(change=0.0 * e.P, turn=0.0 * e.P)
            for q in loop(m):
                dP, slope = self.momenta[q * n + m], self.slopes.shifted(at + q)
                x.change = x.change + dP * Vector(slope[0], slope[n], slope[2 * n])
                if e.start:
                    x.turn = x.turn + dP * self.turn(i, q)
            rest, dP = self.column(self.slopes, i), self.column(self.momenta, i)
            dL = rest + x.change
            stage.dp, change = stage.dp + dL, taxicab(k * dP)
            speed = taxicab(k * e.P) + taxicab(stage.W) + change + TINY  # the last one from rest
            v.worst = larger(larger(change / speed, taxicab(x.turn)), v.worst)
            v.left = larger(taxicab(k * rest) / (speed + self.stiffness[i] * fastest), v.left)
            v.is_fine = taxicab(dL) <= LOST
        v.worst = select(v.is_fine, v.worst, INFINITE)

    def column(self, a: Any, i: Any) -> Vector:
        """Return what the last column of a matrix says of a stage."""
        at, n = 3 * i * (self.m + 1) + self.m, self.m + 1
        return Vector(a[at], a[at + n], a[at + 2 * n])


def tangents(x: Dual, first: int) -> Vector:
    """Return three derivatives."""
    found = [*x.tangents[first : first + 3], 0.0, 0.0, 0.0]
    return Vector(*found[:3])


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
    v.before = zero + LOST
    if e.parts.calls:
        for i in loop(stages.number):
            v.is_fine = v.is_fine & (taxicab(stages.one(i).called) <= LOST)
        e.note_call(v.is_fine)
        v.goes = v.is_fine
    if e.has_rows:
        stages.put(VECTOR, AXES)
    rough = FAR + e.acting.h * taxicab(e.P) * larger(larger(e.k[0], e.k[1]), e.k[2])
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
                is_done = (now <= NEAR) | (v.left <= ROUND_OFF) | ((now <= rough) & (now >= v.before))
                v.is_fine, v.before = now <= LOST, now
                v.is_found = v.is_fine & is_done
                # the last change is round-off of velocities, but more than the vectors may be off
                v.goes = v.is_fine & select(v.is_found, now > NEAR, v.count < NEWTON)
    for _ in when(logical_not(v.is_found)):
        stages.put(UNKNOWNS, [ZEROS] * 4)
    return v.is_found, v.count, v.worst


def lanes_where(mask: Any, lanes: int) -> Iterator[Any]:
    """Yield the bodies whose mask is set, in a loop of the machine."""
    flags = room(lanes)
    flags.store(0, select(mask, 1.0, 0.0), lanes)
    for l in loop(lanes):
        for _ in when(flags[l] > 0.0):
            yield l
