"""A step linearised, by the text that takes it: how its end changes with its beginning, and with what acts on it.

The text is traced twice. On plain numbers it takes the step again, eight steps of a run side by side: from the states
at the nodes, which are known. Then on dual numbers: attitude, velocity, and the inputs that are asked for, have a
direction each. Nothing is iterated a second time (`newton.solve`): at the solution y of r(y, u) = 0, and with A =
∂r/∂y,

    dy = -A⁻¹ (∂r/∂u) du,

so one evaluation of r on duals, and a product, gives the derivatives of y, and the rest of the text those of the end.

All is in the frame b of the body, in its units, and relative to the attitude Λ at the beginning: the quaternion that
the text turns is 1 there, and what is given in space is seen from there, f = Λᵀ m, which a turn δ of the body changes
by f × δ. The inertia is diagonal in b but for what the constraint couples, its derivatives are not (`Varied`). With the
constrained axis the frame turns, by ε = n × dn: a vector x along the body is then x + x × ε, a matrix A is A + A ε̂ -
ε̂ A.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

from ..kernels import machine_code
from ..kernels.control import Variables, loop, when
from ..kernels.dual import Dual, jacobian, plain, tangent
from ..kernels.elements import any_of, logical_not, remade, select, smaller
from ..kernels.kernel import Kernel
from ..kernels.memory import Doubles, View, Wholes, call, doubles, put, scratch, size_of, vector_at
from ..kernels.vectors import AXES, Matrix, Quaternion, Symmetric, Vector, attitude, cross
from .generalised import STATE, Sloped
from .marching import UNIT, Text
from .newton import Solved, solving
from .records import FORCES, Body, Parts, State, places
from .sampling import Nodes
from .state_moments import mean
from .workspace import turned_into

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


class Steps(NamedTuple):
    """Some steps, and where their matrices go: entry (i, j) of that of the step k at ``(i width + j) stride + k``."""

    stages: int
    steps: int
    stride: int
    width: int  # columns: of the state, and of the inputs
    sizes: Doubles  # (steps,) of the steps
    quaternions: Doubles  # (steps + 1, 4) scalar last
    velocities: Doubles  # (steps + 1, 3)
    normals: Doubles  # (steps + 1, 6)
    body: Doubles  # `Body`
    factor: Doubles  # of what follows
    moved: Doubles  # (nodes, 3) moments along the frame
    pushed: Doubles  # (nodes, 3) in space
    wheels: Doubles  # (nodes, 6) momentum of rotors and its rate
    spins: Doubles  # (steps,) changes of a spin
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


STEPS = places(Steps)


class Step(NamedTuple):
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


class Varied(Body):
    """A body whose numbers are duals, and its products of inertia, of value 0."""

    products: Any  # J23, J13, J12
    is_free: bool

    @property
    def coupling(self) -> Any:
        """J12."""
        return self.products[2]

    def momentum_of(self, W: Vector) -> Vector:
        """Return the momentum of a velocity."""
        found: Vector = varied(super().momentum_of(W), self._crossed(W))
        return found

    def velocity_of(self, P: Vector) -> Vector:
        """Return the velocity of a momentum."""
        W = super().velocity_of(P)
        found: Vector = varied(W, -plain(self.k) * self._crossed(W))
        return found

    def _crossed(self, W: Vector) -> Vector:
        (J23, J13, J12), third = self.products, self.is_free
        return Vector(J12 * W[1] + J13 * W[2], J12 * W[0] + J23 * W[2], J13 * W[0] + J23 * W[1] if third else 0.0 * J12)


class Directions:
    """The directions of derivatives, one after the other: of the attitude, of W, of N, and of inputs."""

    def __init__(self, places: dict[str, int], count: int) -> None:
        self.places, self.count = places, count

    def along(self, name: str, x: Any) -> Any:
        """Return numbers as duals, in the directions of this name; as they are where it has none."""
        if name not in self.places:
            return x
        return self._seeded(x, self.places[name])[0]

    def tangents(self, place: int) -> list[Any]:
        """Return the derivatives of the number at a place."""
        return [1.0 if j == place else 0.0 for j in range(self.count)]

    def of(self, name: str, kind: Any) -> Any:
        """Return a vector of value 0 with the directions of this name, None where it has none."""
        return self.along(name, kind(*(0.0,) * kind.size)) if name in self.places else None

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
    turn : Vector, how the body is turned at the beginning; None without derivatives
    tilt : Vector, how the frame is turned in the body; None where it is not
    now : State, that a march carries at the beginning; None: made from what is known
    """

    def __init__(
        self,
        parts: Parts,
        body: Body,
        at: Any,
        scale: Any,
        directions: Directions,
        R: Matrix | None = None,
        calls: Calls | None = None,
        now: State | None = None,
    ) -> None:
        self.parts, self.memory, self.node, self._at, self._scale = parts, None, 0, at, scale
        self.calls, self.factor, self.vary, self.now = calls, directions.along("factor", scale), directions, now
        self.basis, d = body.basis, directions.of("axis", Vector)
        self.tilt = None if d is None else Vector(-d[1], d[0], 0.0)
        self.turn, self.R = directions.of("turn", Vector), attitude(at.p) @ self.basis if R is None else R
        self.delta = self.turn
        if self.tilt is not None:
            self.turn = self.turn + self.tilt
        self.h = directions.along("step", at.h)
        self.body = self._varied(body._replace(spin=1.0))

    def _varied(self, body: Body) -> Body:
        """Return the body with what of it has derivatives."""
        dJ, tilt = self.vary.of("inertia", Symmetric), self.tilt
        dead, damping = self.vary.along("dead", body.dead), self.vary.along("damping", body.damping)
        if tilt is not None:
            dead = varied(dead, Matrix(*(cross(column, tilt) for column in dead.T)).T)
            damping = varied(damping, tilted(damping, tilt))
            dJ = symmetric(tilted(body.inertia, tilt)) if dJ is None else dJ + symmetric(tilted(body.inertia, tilt))
        body = body._replace(dead=dead, damping=damping)
        if dJ is None:
            return body
        a, b, c, *products = dJ
        k, off = body.k, body.off
        E = varied(body.E, 0.5 * Vector(b + c - a, c + a - b, a + b - c))
        off = varied(off, (products[1], products[0]))
        found = Varied(*body._replace(E=E, off=off, k=varied(k, -k * k * Vector(a, b, c))))
        found.products, found.is_free = products, not self.parts.is_constrained
        return found

    def start(self, text: Text, W: Vector, N: Any) -> State:
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
                N = varied(N, symmetric(tilted(N.matrix, self.tilt)))
            auxiliary = (*N, *auxiliary[6:])
        elif text.remembered is not None and self.delta is None:
            ends = (self.body.momentum_of(self.along(x)) for x in (at.W, at.ahead))
            auxiliary = text.remembered(at.h, *ends)
        return now._replace(s=s if self.now is None else varied(now.s, s), auxiliary=auxiliary)

    def velocity(self, W: Vector) -> Vector:
        """Return the velocity at the beginning."""
        return self.tilted(self.vary.along("velocity", W))

    def known(self, j: Any) -> Any:
        """Return what is known of a node."""
        return self._at

    def along(self, x: Vector) -> Vector:
        """Return a vector of the body in b."""
        found: Vector = x @ self.basis
        return found

    def tilted(self, x: Vector) -> Vector:
        """Return a vector of the body as the frame has it that is turned."""
        return x if self.tilt is None else varied(x, cross(x, self.tilt))

    def moving(self, j: Any = 0) -> Vector:
        """Return the moment along the frame."""
        return self.tilted(self.vary.along("moving", self._scale * self.along(self.known(j).moving)))

    def space(self, j: Any = 0) -> Vector:
        """Return the moment in space as seen at the beginning."""
        return self.seen(self.vary.along("space", self._scale * self.known(j).space))

    def rotor(self, j: Any = 0) -> tuple[Vector, Vector]:
        """Return the momentum of the rotors and its rate."""
        c, rate = (self._scale * self.along(x) for x in (self.known(j).rotor, self.known(j).rate))
        return self.tilted(self.vary.along("rotor", c)), self.tilted(self.vary.along("rate", rate))

    def spin(self, j: Any = 0) -> Any:
        """Return the change of the prescribed spin."""
        return self.vary.along("spin", self._at.spin)

    def dead(self) -> Matrix:
        """Return the dead forces as seen at the beginning, rows."""
        return Matrix(*map(self.seen, self.body.dead))

    def functions(self, j: Any = 0) -> Any:
        """Return the functions of the state."""
        return LinearFunctions(self, j)

    def later(self, j: Any = 0) -> Any:
        """Return the changes of the time of a node, a number of value 0."""
        later = self.vary.along("time", 0.0)
        return later + self.fraction(j) * (self.h - plain(self.h)) if isinstance(self.h, Dual) else later

    def fraction(self, j: Any) -> Any:
        """Return how far into the step a node is."""
        return 0.5

    def seen(self, x: Vector) -> Vector:
        """Return a vector in space as seen at the beginning."""
        f: Vector = x @ self.R
        return f if self.turn is None else varied(f, cross(f, self.turn))


class Calls(NamedTuple):
    """How functions of the state are called, in one step after the other, and in which directions.

    Where potentials have a torque of their own they are `generalised`, all else is of a `function`. Directions are the
    state, the forces of a table where they are asked for, and changes of the numbers of terms.
    """

    parts: Parts
    block: View  # of `Steps`
    wanted: dict[str, int]  # inputs

    @property
    def places(self) -> dict[str, int]:
        """Where the directions of inputs begin, and, as "", how many there are."""
        return places_of_directions(self.wanted)

    @property
    def size(self) -> int:
        """How many numbers of a step the derivatives take."""
        return 3 * (self.parts.function + self.parts.generalised) * self.places[""]

    def slopes(self, at: View) -> Any:
        """Return the memory of the derivatives, which lies behind what else is known."""
        return at._memory.shifted(size_of(Step) * self.parts.lanes)

    def evaluate(self, at: View, directors: Matrix, w: Vector, half: Vector, is_sloped: bool = True) -> None:
        """Evaluate them, with their derivatives: directors and w are given in space, the half turn in the body."""
        parts, b, n, count = self.parts, self.block, self.parts.lanes, self.places[""]
        at.directors, at.w, at.half = directors, w, half
        own, found, slopes = View(Sloped, scratch(size_of(Sloped))), scratch(6 * count), self.slopes(at)
        acting = own.state_call
        acting.action, acting.terms, acting.called = b.action, b.terms, (b.speed, 0.0, 0.0)
        own.directions, own.seeds, own.slopes = count, b.seeds, found
        for l in loop(n):
            lane = at.lane(l)
            acting.directors, acting.w, acting.half = lane.directors, lane.w, lane.half
            acting.t, acting.node = lane.t, lane.forces
            call(b.sloped if is_sloped else b.generalised, own.address)
            lane.load, lane.of_potentials = acting.load, acting.of_potentials
            if not parts.generalised:
                lane.load = acting.load + acting.of_potentials
            first, rest = 0 if parts.function else 3 * count, 3 * count
            for k in loop(self.size if is_sloped else 0):
                slopes[k * n + l] = found[first + k] if parts.generalised else found[k] + found[rest + k]


def places_of_directions(wanted: dict[str, int]) -> dict[str, int]:
    """Return where directions of functions of the state begin, for inputs, and, as "", how many there are."""
    n, side = len(STATE), machine_code.lanes()
    terms = n + wanted.get("forces", 0)
    return {"forces": n, "terms": terms, "": -(-(terms + wanted.get("terms", 0)) // side) * side}


class LinearFunctions:
    """Functions of the state at a node, linear about the state at which they were evaluated."""

    def __init__(self, known: Known, j: Any) -> None:
        assert known.calls is not None
        self._known, self._at, self._calls, self._j = known, known.known(j), known.calls, j
        self.R, self.B = Matrix(*map(known.seen, AXES)), Matrix(*map(known.tilted, known.basis))

    def moment(self, a: Vector, w: Vector) -> Vector:
        """Return the moment in b for the averaged directors of a step and the velocity w."""
        s = 1.0 / (1.0 + a @ a)
        rows = Matrix(*(mean(s, -a, row) for row in self.R))
        found: Vector = self.changed(self.B @ rows.T, self.R @ w, self.B @ a)[0]
        return found

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
        known, at, calls, own = self._known, self._at, self._calls, self._at.directors
        places, memory, n = calls.places, calls.slopes(at), calls.parts.lanes
        changes = [x - y for row, other in zip(directors, own, strict=True) for x, y in zip(row, other, strict=True)]
        changes += [*(w - at.w), known.later(self._j), *(() if half is None else half - at.half)]
        width = max(len(getattr(x, "tangents", ())) for x in changes)

        def with_slopes(k: Any, x: Any) -> tuple[Any, ...]:
            return tuple(y + memory.load((c * places[""] + k) * n, n) * x for c, y in enumerate(v.found))

        there = scratch(len(changes) * (1 + width) * n)  # so that products with them stand once
        for k, x in enumerate(changes):
            for j, y in enumerate((plain(x), *(tangent(x, j) for j in range(width)))):
                there.store((k * (1 + width) + j) * n, y, n)
        given = (*(at.load if calls.parts.function else ()), *(at.of_potentials if calls.parts.generalised else ()))
        v = Variables(found=tuple(Dual(y, [0.0] * width) for y in given))
        for k in loop(len(changes)):
            y, *tangents = (there.load((k * (1 + width) + j) * n, n) for j in range(1 + width))
            v.found = with_slopes(k, Dual(y, tangents))
        for name in ("forces", "terms"):
            if name in known.vary.places:
                for k, x in enumerate(known.vary.along(name, (0.0,) * calls.wanted[name]), places[name]):
                    v.found = with_slopes(k, x)
        found = v.found if width else plain(v.found)
        moment, torque = Vector(*found[:3]), Vector(*found[-3:])
        return (
            known.factor * known.seen(moment) if calls.parts.function else None,
            known.factor * known.tilted(known.along(torque)) if calls.parts.generalised else None,
        )


def varied(x: Any, change: Any) -> Any:
    """Return numbers to which a change of value 0 is added: their values stay the same to the last bit."""
    if isinstance(x, tuple):
        return remade(x, [varied(*each) for each in zip(x, change, strict=True)])
    return change.chain(plain(x), (1.0, 1.0), (x, change)) if isinstance(change, Dual) else x


def tilted(A: Matrix, tilt: Vector) -> Matrix:
    """Return A ε̂ - ε̂ A."""
    return Matrix(*(cross(row, tilt) for row in A)) + Matrix(*(cross(column, tilt) for column in A.T)).T


def symmetric(A: Matrix) -> Symmetric:
    """Return the entries of a symmetric matrix."""
    return Symmetric(A[0][0], A[1][1], A[2][2], A[1][2], A[0][2], A[0][1])


def rows_of(parts: Parts) -> int:
    """Return how many numbers a state has: attitude, W and, of a director scheme, N."""
    return 12 if parts.is_director_scheme else 6


def places_of(parts: Parts, wanted: Wanted) -> dict[str, int]:
    """Return where the numbers of the state and of inputs begin among all directions."""
    places, width = {"turn": 0, "velocity": 3, "normal": 6}, rows_of(parts)
    for name, size in wanted:
        places[name], width = width, width + size
    return places


@lru_cache
def linearised(text: Text, parts: Parts, wanted: Wanted) -> Kernel:
    """Return the kernel that makes the matrices of `Steps`, with the columns of the inputs that are wanted."""
    width, n = rows_of(parts) + sum(size for _, size in wanted), parts.lanes
    directions = Directions(places_of(parts, wanted), width)

    def kernel(address: Any) -> None:
        b = View(Steps, doubles(address))
        body, x = View(Body, b.body).read(), View(Step, doubles(b.workspace), n)
        scale, out, calls = b.factor[0] / body.unit, b.out, Calls(parts, b, dict(wanted))
        x.moving, x.space, x.spin = (0.0,) * 3, (0.0,) * 3, 0.0  # where only their derivatives are asked for
        for first in loop(0, b.steps, n):
            gather(parts, b, x, first)
            found, is_stalled = derivatives(text, body, x, scale, directions, calls)
            for _ in when(any_of(is_stalled)):
                b.failed = b.failed + 1
            for i, y in enumerate(found):
                for j in range(width):
                    out.store((i * b.width + j) * b.stride + first, tangent(y, j), n)

    return Kernel(kernel, "i8", n)


def gather(parts: Parts, b: View, x: View, first: Any) -> None:
    """Fill the workspace with steps; lanes beyond the last repeat it."""
    for l in loop(parts.lanes):
        i, lane = smaller(first + l, b.steps - 1), x.lane(l)
        p, W = b.quaternions.shifted(4 * i), b.velocities.shifted(3 * i)
        lane.h, lane.p = b.sizes[i], Quaternion(p[3], p[0], p[1], p[2])
        lane.q = Quaternion(p[7], p[4], p[5], p[6])
        lane.W, lane.ahead = vector_at(W), vector_at(W, 3)
        if parts.is_director_scheme:
            lane.N = tuple(b.normals[6 * i + k] for k in range(6))
        sampled(parts, b, lane, i)


def sampled(parts: Parts, b: View, lane: View, i: Any) -> None:
    """Take over what acts on the step i."""
    for name, array in (("moving", b.moved), ("space", b.pushed), ("spin", b.spins)):
        if getattr(parts, name):
            for _ in when(array.address != 0):
                setattr(lane, name, array[i] if name == "spin" else vector_at(array, 3 * i))
    if parts.rotor:
        lane.rotor, lane.rate = vector_at(b.wheels, 6 * i), vector_at(b.wheels, 6 * i + 3)
    if parts.calls:
        called_at(b, lane, i)


def called_at(b: View, lane: View, i: Any) -> None:
    """Take over the time of a node, and where the forces of a table lie."""
    lane.t, lane.forces = b.times[i], select(b.forces == 0, 0, b.forces + 8 * FORCES * i)


def derivatives(
    text: Text, body: Body, at: View, scale: Any, directions: Directions, calls: Calls
) -> tuple[list[Any], Any]:
    """Take the step, and return the changes at its end as duals, and the mask of steps that are not solved."""
    solved, parts = Solved(), calls.parts
    W, N = at.W @ body.basis, turned_into(body.basis.T, at.N) if parts.is_director_scheme else ()
    if parts.calls:
        call_at_middle(calls, at)
    with solving(solved):
        here = Known(parts, body, at, scale, Directions({}, 0), calls=calls)
        is_stalled = text.step(here, here.start(text, W, N), at.h == at.h).stalled
        solved.begin()
        return changes_of(text, Known(parts, body, at, scale, directions, calls=calls), W, N), is_stalled


def call_at_middle(calls: Calls, at: View) -> None:
    """Evaluate functions of the state in the middle of a midpoint step, which turns by ``cay(hΩ)``, from its ends."""
    p, q = at.p, at.q
    turn, R = p.inverse @ q, attitude(p)
    a = (1.0 / turn[0]) * turn.vector
    s = 1.0 / (1.0 + a @ a)
    rows = Matrix(*(mean(s, -a, row) for row in R))
    w = R @ ((2.0 / at.h) * a)
    calls.evaluate(at, rows.T, s * w if calls.parts.is_director_scheme else w, a)


def changes_of(text: Text, known: Known, W: Vector, N: Any) -> list[Any]:
    """Return the changes of attitude, W and N at the end of a step, as duals."""
    h = plain(known.h)
    state = text.step(known, known.start(text, W, N), h == h).state
    q, N = plain(state.p), state.auxiliary[:6] if known.parts.is_director_scheme else ()
    assert known.turn is not None
    turned = q if known.now is None else known.now.p.inverse @ q
    turn = known.turn @ attitude(turned) + 2.0 * (q.inverse @ state.p).vector
    W = text.velocity(known.body, state.s)
    if known.tilt is not None:
        turn, W = turn - known.tilt, W - cross(W, known.tilt)
        N = Symmetric(*N) - symmetric(tilted(Symmetric(*N).matrix, known.tilt)) if N else N
    return [*turn, *W, *N]


# Steps taken and linearised at once, of a run whose directions are known: they lie side by side, in lanes.


class Carried(NamedTuple):
    """A run of one body with the changes of its state: rows of `Directions`, `padded` to whole lanes."""

    steps: Doubles  # `Steps`
    state: Doubles  # `State`
    padded: int
    changes: Doubles  # of the state and of the inputs, (width, padded)
    given: Doubles  # the same, where those of inputs are what all steps have
    begins: Wholes  # (steps + 1,) where the changes begin that each step has beside; 0: there are none
    columns: Wholes
    parameters: Wholes
    values: Doubles
    kept: Wholes  # (steps,) 1: the changes of the state at the end of the step are kept
    found: Doubles  # (kept, 6, padded)
    first: Doubles  # quaternion at the start of the run
    turns: Doubles  # (kept, 3, 3) the attitudes there, as seen from the kept ones


class Loaded(Directions):
    """Directions whose derivatives lie in memory, some lanes at a time; at places that are not used they are 0."""

    def __init__(self, places: dict[str, int], memory: Any, stride: Any, used: frozenset[int]) -> None:
        super().__init__(places, 1)
        self._memory, self._stride, self._used = memory, stride, used

    def tangents(self, place: int) -> list[Any]:
        """Return the derivatives of the number at a place."""
        return [self._memory.load(place * self._stride, machine_code.lanes()) if place in self._used else 0.0]


@lru_cache
def carried(text: Text, parts: Parts, wanted: Wanted, inputs: tuple[int, ...]) -> Kernel:
    """Return the kernel that takes the steps of a run and carries changes along; `inputs` are the places of those."""
    places, used = places_of(parts, wanted), frozenset((*range(rows_of(parts)), *inputs))
    none, side = Directions({}, 0), machine_code.lanes()

    def kernel(address: Any) -> None:
        own = View(Carried, doubles(address))
        b, changes, count = View(Steps, own.steps), own.changes, own.padded
        body, x = View(Body, b.body).read(), View(Step, doubles(b.workspace))
        scale, memory = b.factor[0] / body.unit, View(State, own.state)
        x.moving, x.space, x.spin = (0.0,) * 3, (0.0,) * 3, 0.0
        state = memory.read()
        v = Variables(state=state._replace(auxiliary=state.auxiliary[: text.auxiliary]), done=0)
        for i in loop(b.steps, whilst=lambda: b.failed == 0):
            x.h = b.sizes[i]
            sampled(parts, b, x, i)
            add_own(own, i, 1.0)
            now, solved, at = v.state, Solved(), x.read()
            R, W = attitude(now.p), text.velocity(body, now.s)
            N = Symmetric(*now.auxiliary[:6]) if parts.is_director_scheme else ()
            with solving(solved):
                found = text.step(Known(parts, body, at, scale, none, R), now, at.h == at.h)
                solved.begin()
                values = Loaded(places, changes, count, frozenset())  # which stand outside of the loop
                changes_of(text, Known(parts, body, at, scale, values, R, now=now), W, N)
                for first in loop(0, count, side):
                    own_changes = changes.shifted(first)
                    directions = Loaded(places, own_changes, count, used)
                    known = Known(parts, body, at, scale, directions, R, now=now)
                    for r, y in enumerate(changes_of(text, known, W, N)):
                        own_changes.store(r * count, tangent(y, 0), side)
            for _ in when(found.stalled | found.far | logical_not(found.gap <= UNIT)):
                b.failed = b.failed + 1
            v.state = found.state
            add_own(own, i, 0.0)
            for _ in when(own.kept[i] != 0):
                for k in loop(0, 6 * count, side):
                    own.found.store(v.done * 6 * count + k, changes.load(k, side), side)
                begin = Quaternion(*(own.first[k] for k in range(4)))
                put(own.turns.shifted(9 * v.done), attitude(v.state.p.inverse @ begin))
                v.done = v.done + 1
        now = v.state
        memory.write(now._replace(auxiliary=(*now.auxiliary, *state.auxiliary[text.auxiliary :])))

    return Kernel(kernel, "i8")


def add_own(own: View, i: Any, factor: float) -> None:
    """Add the changes that the step i has beside those of all steps, times a factor, to the given ones."""
    for _ in when(own.begins.address != 0):
        for e in loop(own.begins[i], own.begins[i + 1]):
            place = own.columns[e] * own.padded + own.parameters[e]
            own.changes[place] = own.given[place]
        if factor:
            for e in loop(own.begins[i], own.begins[i + 1]):
                place = own.columns[e] * own.padded + own.parameters[e]
                own.changes[place] = own.changes[place] + own.values[e]
