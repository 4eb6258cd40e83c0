"""What is known of steps that are taken again, and what of it has derivatives (`linearised`).

All is in the frame b of the body, in its units, and relative to the attitude Λ at the beginning: the quaternion that
the text turns is 1 there, and what is given in space is seen from there, f = Λᵀ m, which a turn δ of the body changes
by f × δ. The inertia is diagonal in b but for what the constraint couples, its derivatives are not (`DualBody`). With
the constrained axis the frame turns, by ε = n × dn: a vector x along the body is then x + x × ε, a matrix A is A + A ε̂
- ε̂ A.

Functions of the state are evaluated once, with their derivatives, and linear from there on (`LinearFunctions`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from ..kernels import machine_code
from ..kernels.control import Variables, loop
from ..kernels.dual import Dual, jacobian, plain, tangent
from ..kernels.elements import remade
from ..kernels.memory import Doubles, View, Wholes, call, doubles, scratch, size_of
from ..kernels.vectors import AXES, Matrix, Quaternion, Symmetric, Vector, attitude, cross, sum_of
from .generalised import STATE, Sloped
from .marching import Text
from .records import FORCES, Body, Parts, State, offsets_of
from .sampling import Nodes, mean

INPUTS = {
    "inertia": 6,  # 11, 22, 33, 23, 13, 12
    "axis": 3,
    "dead": 9,  # rows of f^i
    "damping": 9,  # rows
    "step": 1,
    "spin": 1,  # its change in the step
    "rate": 3,  # of the momentum of rotors
    "orbit": 1,  # its rate, of one that steps are seen from
    "moving": 3,  # moment along the frame
    "space": 3,
    "rotor": 3,
    "forces": FORCES,
    "time": 1,  # at the beginning
    "factor": 1,  # of functions of the state
    "terms": 0,  # changes of the numbers of these, as many as are asked for
}
NODAL = ("moving", "space", "rotor", "forces")  # at every node of the load
Wanted = tuple[tuple[str, int], ...]  # inputs, and of how many numbers each
LANES = 8  # steps whose matrices are made at a time


def column_offsets(rows: int, wanted: Wanted, stages: int = 1) -> dict[str, int]:
    """Return where the columns of the state, of so many rows, and of inputs begin, and, as "", how many there are."""
    found, place = {"turn": 0, "velocity": 3, "normal": 6}, rows
    for name, size in wanted:
        found[name] = place
        place += size * (stages if name in NODAL else 1)
    return found | {"": place}


class Steps(NamedTuple):
    """Some steps, what makes their matrices, and what goes through these (`linearised`).

    Entry (i, j) of the matrices of the step first + k lies at ``(i width + j) LANES + k`` of `out`.
    """

    steps: int
    batches: int  # of `LANES` steps
    make: int  # address of what makes the matrices of a batch
    first: int  # of the steps whose matrices are made
    rows: int  # of the state
    width: int  # columns: of the state, and of the inputs
    sizes: Doubles  # (steps,) of the steps
    quaternions: Doubles  # (steps + 1, 4) scalar last
    velocities: Doubles  # (steps + 1, 3)
    normals: Doubles  # (steps + 1, 6)
    body: Doubles  # `Body`
    factor: Doubles  # of what follows
    moving: Doubles  # (nodes, 3) moments along the frame
    space: Doubles  # (nodes, 3) in space
    rotor: Doubles  # (nodes, 6) momentum of rotors and its rate
    spin: Doubles  # (nodes,) changes of a spin in the step
    times: Doubles  # of the nodes
    forces: int  # address of (nodes, 18) on the directors; 0: none
    generalised: int  # addresses of what makes moments of functions of the state, and their derivatives as well
    sloped: int
    action: int  # what they make
    terms: int  # address of the terms
    seeds: Doubles  # (numbers, directions) of `generalised.Sloped`
    speed: float  # the scale of velocities
    table: Doubles  # coefficients of a scheme
    orbit: Doubles  # rate and axis of one that steps are seen from
    out: Doubles
    workspace: int
    failed: int  # how many steps could not be solved again
    # What parameters do to the inputs: entries of all steps, then those of each step.
    begins: Wholes  # (steps + 1,) where those of each step begin
    columns: Wholes  # of the entries, and their parameters, values
    parameters: Wholes
    values: Doubles
    padded: int  # parameters, rounded up to a multiple of `LANES`
    inputs: int  # forward: how many columns have entries of all steps, which, and these as rows (inputs, padded)
    used: Wholes
    changes: Doubles  # taken at once (width, padded)
    # What goes through the steps.
    state: Doubles  # X (rows, padded), taken at once with the inputs (width, padded); or λ (rows,)
    is_stored: Wholes  # (steps,) 1: the state at the end of the step is stored
    states: Doubles  # forward (stored, 6, padded); back (stored, 6), derivatives of f by attitude and velocity
    found: Doubles  # back: (padded,) df/dp
    scratch: Doubles  # back: (width,)
    grown: int  # growth: how many changes, at most `LANES`
    together: int  # steps between two times at which they are made orthonormal
    weights: Doubles  # (6,) 1 over the squares of the units
    metric: Doubles  # (6, 6) the same of the entries of N, which count as those in the body
    normal: Doubles  # (rows,) a change that the body may not have, of length 1; 0 if there is none
    lengths: Doubles  # (times, grown) R_kk
    carried: Doubles  # taken at once: `State`
    start: Doubles  # quaternion, scalar last, and W
    is_first: int  # 1: they are those at the beginning of these steps
    turns: Doubles  # (stored, 3, 3) the attitudes there, relative to the stored ones


STEPS = offsets_of(Steps)


class KnownStep(NamedTuple):
    """What is known of a step, in body components and the units of the caller; functions of the state in b."""

    h: float
    p: Quaternion
    q: Quaternion  # at the end
    W: Vector
    ahead: Vector  # W at the end
    N: Symmetric
    moving: Vector
    space: Vector
    rotor: Vector
    rate: Vector
    spin: float
    t: float  # of the node
    forces: int  # address of those of a table there
    directors: Matrix  # where functions of the state are linear
    w: Vector
    half: Vector
    load: Vector  # what they give there
    of_potentials: Vector


class DualBody(Body):
    """A body whose numbers are duals, and its products of inertia, of value 0."""

    products: Any  # J23, J13, J12
    is_free: bool

    @property
    def coupling(self) -> Any:
        """J12."""
        return self.products[2]

    def momentum_of(self, W: Vector) -> Vector:
        """Return the momentum of a velocity."""
        return varied(super().momentum_of(W), self._crossed(W))

    def velocity_of(self, P: Vector) -> Vector:
        """Return the velocity of a momentum."""
        W = super().velocity_of(P)
        return varied(W, -plain(self.k) * self._crossed(W))

    def _crossed(self, W: Vector) -> Vector:
        (J23, J13, J12), third = self.products, self.is_free
        return Vector(J12 * W[1] + J13 * W[2], J12 * W[0] + J23 * W[2], J13 * W[0] + J23 * W[1] if third else 0.0 * J12)


class Directions:
    """The directions of derivatives, one after the other: of the attitude, of W, of N, and of inputs.

    Those of inputs at nodes are of all nodes, one after the other, or of the one that is looked at.
    """

    def __init__(self, offsets: dict[str, int], count: int, has_all_nodes: bool = False) -> None:
        self.offsets, self.count, self.has_all_nodes = offsets, count, has_all_nodes

    def along(self, name: str, x: Any, j: Any = 0) -> Any:
        """Return numbers, of a node, as duals, in the directions of this name; as they are where it has none."""
        if name not in self.offsets:
            return x
        own = j * INPUTS[name] if self.has_all_nodes and name in NODAL else 0
        return self._seeded(x, self.offsets[name] + own)[0]

    def tangents(self, place: int) -> list[Any]:
        """Return the derivatives of the number at a place."""
        return [1.0 if j == place else 0.0 for j in range(self.count)]

    def of(self, name: str, kind: Any) -> Any:
        """Return a vector of value 0 with the directions of this name, None where it has none."""
        return self.along(name, kind(*(0.0,) * kind.size)) if name in self.offsets else None

    def _seeded(self, x: Any, place: int) -> tuple[Any, int]:
        if not isinstance(x, tuple):
            return Dual(x, self.tangents(place)), place + 1
        found = []
        for y in x:
            y, place = self._seeded(y, place)
            found.append(y)
        return remade(x, found), place


class Known(Nodes):
    """What acts in steps of which all is known, and what of it has derivatives.

    Attributes
    ----------
    known : what is known of a node, of its number
    turn : Vector, how the body is turned at the beginning; None without derivatives
    tilt : Vector, how the frame is turned in the body; None where it is not
    now : State, that a march carries at the beginning; None: made from what is known
    part : Matrix, how the body has turned since then where a part of the step begins; None in the first
    """

    part: Matrix | None = None

    def __init__(
        self,
        calls: FunctionCalls,
        body: Body,
        known: Callable[[Any], Any],
        scale: Any,
        directions: Directions,
        R: Any = None,
        now: Any = None,
    ) -> None:
        self.parts, self.solved, self.memory, self.node = calls.parts, calls.solved, None, 0
        self.known, self._at, self._scale = known, known(0), scale
        self.calls, self.factor, self.vary, self.now = calls, directions.along("factor", scale), directions, now
        self.basis, d = body.basis, directions.of("axis", Vector)
        self.tilt = None if d is None else Vector(-d[1], d[0], 0.0)
        self.turn, self.R = directions.of("turn", Vector), attitude(self._at.p) @ self.basis if R is None else R
        self.delta = self.turn
        if self.tilt is not None:
            self.turn = self.turn + self.tilt
        self.h = directions.along("step", self._at.h)
        self.body = self._varied(body._replace(spin=1.0))

    def begin(self, node: Any, p: Quaternion) -> None:
        """Begin a part of the step at its first node, with the attitude p."""
        self.node, self.part = node, attitude(p if self.now is None else self.now.p.inverse @ p)

    def _varied(self, body: Body) -> Body:
        """Return the body with what of it has derivatives."""
        dJ, tilt = self.vary.of("inertia", Symmetric), self.tilt
        dead, damping = self.vary.along("dead", body.dead), self.vary.along("damping", body.damping)
        if tilt is not None:
            dead = varied(dead, Matrix(*(cross(column, tilt) for column in dead.T)).T)
            damping = varied(damping, tilted(damping, tilt))
            dJ = sum_of(dJ, tilted(body.inertia, tilt).symmetric)
        body = body._replace(dead=dead, damping=damping)
        if dJ is None:
            return body
        a, b, c, *products = dJ
        k, off = body.k, body.off
        E = varied(body.E, 0.5 * Vector(b + c - a, c + a - b, a + b - c))
        off = varied(off, (products[1], products[0]))
        found = DualBody(*body._replace(E=E, off=off, k=varied(k, -k * k * Vector(a, b, c))))
        found.products, found.is_free = products, not self.parts.is_constrained
        return found

    def start(self, text: Text, W: Vector, N: Any) -> Any:
        """Return the state at the beginning, of the velocity W and N."""
        at, now = self._at, self.now
        if now is None:
            zeros = Vector(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 0.0), (0.0,) * text.auxiliary
            now = State(Quaternion(1.0, 0.0, 0.0, 0.0), W, *zeros)
        s = W = self.velocity(W)
        if not self.parts.is_director_scheme:
            s = self.body.momentum_of(W)
        auxiliary = now.auxiliary
        if self.parts.is_director_scheme:
            N = self.vary.along("normal", N)
            if self.tilt is not None:
                N = varied(N, tilted(N.matrix, self.tilt).symmetric)
            auxiliary = (*N, *auxiliary[6:])
        elif text.first_guess is not None and self.delta is None:
            ends = (self.body.momentum_of(self.along(x)) for x in (at.W, at.ahead))
            auxiliary = text.first_guess(at.h, *ends)
        return now._replace(s=s if self.now is None else varied(now.s, s), auxiliary=auxiliary)

    def velocity(self, W: Vector) -> Vector:
        """Return the velocity at the beginning."""
        return self.tilted(self.vary.along("velocity", W))

    def along(self, x: Vector) -> Vector:
        """Return a vector of the body in b."""
        return x @ self.basis

    def tilted(self, x: Vector) -> Vector:
        """Return a vector of the body as the frame has it that is turned."""
        return x if self.tilt is None else varied(x, cross(x, self.tilt))

    def moving(self, j: Any = 0) -> Vector:
        """Return the moment along the frame."""
        j = self.node + j
        return self.tilted(self.vary.along("moving", self._scale * self.along(self.known(j).moving), j))

    def space(self, j: Any = 0) -> Vector:
        """Return the moment in space as seen at the beginning."""
        j = self.node + j
        return self.to_material(self.vary.along("space", self._scale * self.known(j).space, j))

    def rotor(self, j: Any = 0) -> tuple[Vector, Vector]:
        """Return the momentum of the rotors and its rate."""
        j = self.node + j
        c, rate = (self._scale * self.along(x) for x in (self.known(j).rotor, self.known(j).rate))
        return self.tilted(self.vary.along("rotor", c, j)), self.tilted(self.vary.along("rate", rate))

    def spin(self, j: Any = 0) -> Any:
        """Return the change of the prescribed spin."""
        return self.vary.along("spin", self.known(self.node + j).spin)

    def functions(self, j: Any = 0) -> Any:
        """Return the functions of the state."""
        return LinearFunctions(self, self.calls, self.node + j)

    def later(self, j: Any = 0) -> Any:
        """Return the changes of the time of a node, a number of value 0."""
        later = self.vary.along("time", 0.0)
        return later + self.fraction(j) * (self.h - plain(self.h)) if isinstance(self.h, Dual) else later

    def fraction(self, j: Any) -> Any:
        """Return how far into the step a node is."""
        return self.calls.fractions[j]

    def to_material(self, x: Vector) -> Vector:
        """Return the components in b, at the beginning of the step, of a vector in space."""
        f = x @ self.R
        f = f if self.turn is None else varied(f, cross(f, self.turn))
        return f if self.part is None else f @ self.part


def varied(x: Any, change: Any) -> Any:
    """Return numbers to which a change of value 0 is added: their values stay the same to the last bit."""
    if isinstance(x, tuple):
        return remade(x, [varied(*each) for each in zip(x, change, strict=True)])
    return change.chain(plain(x), (1.0, 1.0), (x, change)) if isinstance(change, Dual) else x


def tilted(A: Matrix, tilt: Vector) -> Matrix:
    """Return A ε̂ - ε̂ A."""
    return Matrix(*(cross(row, tilt) for row in A)) + Matrix(*(cross(column, tilt) for column in A.T)).T


class FunctionCalls(NamedTuple):
    """How functions of the state are called, in one step after the other, and in which directions.

    Where potentials have a torque of their own they are `generalised`, all else is of a `function`. Directions are the
    state, the forces of a table where they are asked for, and changes of the numbers of terms.
    """

    parts: Parts
    block: View  # of `Steps`
    wanted: dict[str, int]  # inputs
    solved: Any = None  # `newton.Solved`, of the step
    fractions: tuple[float, ...] = ()  # of the step, at its nodes
    is_done: bool = True  # whether they have been evaluated, about where the step calls them; else as it does

    @property
    def offsets(self) -> dict[str, int]:
        """Where the directions of inputs begin, and, as "", how many there are."""
        return offsets_of_directions(self.wanted)

    @property
    def size(self) -> int:
        """How many numbers of a step the derivatives take."""
        return 3 * (self.parts.function + self.parts.generalised) * self.offsets[""]

    @property
    def node_size(self) -> int:
        """How many numbers what is known of a node takes, in all lanes."""
        return (size_of(KnownStep) + self.size) * self.parts.lanes

    def node(self, j: Any) -> View:
        """Return what is known of a node; all but what acts there is in the first one."""
        return View(KnownStep, doubles(self.block.workspace).shifted(j * self.node_size), self.parts.lanes)

    def slopes(self, at: View) -> Any:
        """Return the memory of the derivatives, which lies behind what else is known."""
        return at._memory.shifted(size_of(KnownStep) * self.parts.lanes)

    def evaluate(self, at: View, directors: Matrix, w: Vector, half: Vector, is_sloped: bool = True) -> None:
        """Evaluate them, with their derivatives: directors and w are given in space, the half turn in the body."""
        parts, b, n, count = self.parts, self.block, self.parts.lanes, self.offsets[""]
        at.directors, at.w, at.half = directors, w, half
        own, found, slopes = View(Sloped, scratch(size_of(Sloped))), scratch(6 * count), self.slopes(at)
        state = own.state_call
        state.action, state.terms, state.c_moment = b.action, b.terms, (b.speed, 0.0, 0.0)
        own.directions, own.seeds, own.slopes = count, b.seeds, found
        for l in loop(n):
            lane = at.lane(l)
            state.directors, state.w, state.half = lane.directors, lane.w, lane.half
            state.t, state.node = lane.t, lane.forces
            call(b.sloped if is_sloped else b.generalised, own.address)
            lane.load, lane.of_potentials = state.load, state.of_potentials
            if not parts.generalised:
                lane.load = state.load + state.of_potentials
            first, rest = 0 if parts.function else 3 * count, 3 * count
            for k in loop(self.size if is_sloped else 0):
                slopes[k * n + l] = found[first + k] if parts.generalised else found[k] + found[rest + k]


def offsets_of_directions(wanted: dict[str, int]) -> dict[str, int]:
    """Return where directions of functions of the state begin, for inputs, and, as "", how many there are."""
    n, side = len(STATE), machine_code.lanes()
    terms = n + wanted.get("forces", 0)
    return {"forces": n, "terms": terms, "": -(-(terms + wanted.get("terms", 0)) // side) * side}


class LinearFunctions:
    """Functions of the state at a node, linear about the state at which they were evaluated."""

    def __init__(self, known: Known, calls: FunctionCalls, j: Any) -> None:
        self._known, self._at, self._calls, self._j = known, known.known(j), calls, j
        self.R, self.B = Matrix(*map(known.to_material, AXES)), Matrix(*map(known.tilted, known.basis))

    def moment(self, a: Vector, w: Vector) -> Vector:
        """Return the moment in b for the averaged directors of a step and the velocity w."""
        s = 1.0 / (1.0 + a @ a)
        rows = Matrix(*(mean(s, -a, row) for row in self.R))
        return self.changed(self.B @ rows.T, self.R @ w, self.B @ a)[0]

    def derivatives(self, f: Any, is_shrinking: bool, Om: Vector, total: Vector) -> Any:
        """Return the derivatives of the moment by the components of Ω."""

        def moment(Om: Vector) -> Vector:
            a = f * Om
            return self.moment(a, (1.0 / (1.0 + a @ a)) * Om if is_shrinking else Om)

        return tuple(jacobian(moment, Om))

    def torque(self, g: Matrix, W: Vector) -> tuple[Any, Any]:
        """Return at a stage the moment, as seen at the beginning of the step, and the torque of potentials, in b."""
        return self.changed(self.B @ (self.R @ g).T, self.R @ (g @ W))

    def changed(self, directors: Matrix, w: Vector, half: Any = None) -> tuple[Any, Any]:
        """Return the moment, as seen at the beginning of the step, and the torque of potentials in b."""
        known, at, calls = self._known, self._at, self._calls
        if not calls.is_done:
            calls.evaluate(at, *plain((directors, w, at.half if half is None else half)))
        own = at.directors
        offsets, memory, n = calls.offsets, calls.slopes(at), calls.parts.lanes
        changes = [x - y for row, other in zip(directors, own, strict=True) for x, y in zip(row, other, strict=True)]
        changes += [*(w - at.w), known.later(self._j), *(() if half is None else half - at.half)]
        width = max(len(getattr(x, "tangents", ())) for x in changes)

        def with_slopes(k: Any, x: Any) -> tuple[Any, ...]:
            return tuple(y + memory.load((c * offsets[""] + k) * n, n) * x for c, y in enumerate(v.found))

        there = scratch(len(changes) * (1 + width) * n)  # so that products with them stand once
        for k, x in enumerate(changes):
            for j, y in enumerate((plain(x), *(tangent(x, j) for j in range(width)))):
                there.store((k * (1 + width) + j) * n, y, n)
        values = (*(at.load if calls.parts.function else ()), *(at.of_potentials if calls.parts.generalised else ()))
        v = Variables(found=tuple(Dual(y, [0.0] * width) for y in values))
        for k in loop(len(changes)):
            y, *tangents = (there.load((k * (1 + width) + j) * n, n) for j in range(1 + width))
            v.found = with_slopes(k, Dual(y, tangents))
        for name in ("forces", "terms"):
            if name in known.vary.offsets:
                for k, x in enumerate(known.vary.along(name, (0.0,) * calls.wanted[name], self._j), offsets[name]):
                    v.found = with_slopes(k, x)
        found = v.found if width else plain(v.found)
        moment, torque = Vector(*found[:3]), Vector(*found[-3:])
        load = known.factor * known.to_material(moment) if calls.parts.function else None
        return load, known.factor * known.tilted(known.along(torque)) if calls.parts.generalised else None
