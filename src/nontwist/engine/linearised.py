"""Steps linearised, by the text that takes them, and how changes go on through them, and back.

The text is traced twice. On plain numbers it takes the step again, eight steps of a run side by side: from the states
at the nodes, which are known. Then on dual numbers: attitude, velocity, and the inputs that are asked for, have a
direction each. Nothing is iterated a second time (`newton.solve`): at the solution y of r(y, u) = 0, and with A =
∂r/∂y,

    dy = -A⁻¹ (∂r/∂u) du,

so one evaluation of r on duals, and a product, gives the derivatives of y, and the rest of the text those of the end.

Of each step this gives two matrices: M of the change of the state at its end by that at its beginning, N by the inputs
of the step. What a parameter p does to the inputs u of a step is a list of entries, ``du_c = v dp``: those that are the
same in all steps, and those of each step by itself. From there on all schemes are alike,

    forward:  X_{n+1} = M_n X_n + N_n V_n,        X = dx/dp,  V_n = du_n/dp,
    back:     λ_n = M_nᵀ λ_{n+1} + (∂f/∂x_n)ᵀ,    df/dp += V_nᵀ N_nᵀ λ_{n+1},

two sums of the same products, so ``λ·X`` at the end is ``df/dp`` to the round-off of the sums. Nothing is approximated:
these are the derivatives of the discrete run. Forward the entries that are the same in all steps are laid out as the
matrix V, so that a step is one product ``(M N)(X; V)`` in vectors of parameters; those of each step by itself are added
one by one.

Growth. How much changes of a state grow along a run: its linearised steps, with orthonormal changes in between. X, the
changes, goes through the matrices of the steps, and every so many steps is replaced by the Q of X = QR, by Gram and
Schmidt (modified): ``Σ log R_kk`` is the logarithm of how much the k-th of them has grown, and the
first k together of the volume that they span. A change of W counts in units of a velocity; what is orthonormal is the
change over these units.

Of a body that may not turn about an axis n, changes of W are across n. Their round-off is not, and where it is not
removed each time, it grows over changes that shrink, until the last ones are nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import product as iterate
from typing import Any

from ..kernels import machine_code
from ..kernels.control import Variables, loop, when
from ..kernels.dual import plain, tangent
from ..kernels.elements import any_of, fma, logical_not, select, smaller, sqrt
from ..kernels.kernel import Kernel, kernel
from ..kernels.machine_code import width
from ..kernels.memory import View, call, doubles, load_lanes, put, store_lanes, vector_at
from ..kernels.vectors import Matrix, Quaternion, Symmetric, Vector, attitude, cross
from .known_steps import LANES, Directions, FunctionCalls, Known, Steps, Wanted, column_offsets, tilted
from .marching import UNIT, Text
from .newton import SolvedEquations
from .records import FORCES, Body, Parts, State
from .sampling import mean
from .workspace import entered, turned_into


def each_step(b: View, back: bool = False) -> Iterator[tuple[Any, Any]]:
    """Yield the number of each step and its matrices, from the last one on `back`."""
    for batch in loop(b.batches, whilst=lambda: b.failed == 0):
        b.first = first = LANES * (b.batches - 1 - batch if back else batch)
        call(b.make, b.address)
        count = smaller(LANES, b.steps - first)
        for k in loop(count):
            n = count - 1 - k if back else k
            yield first + n, b.out.shifted(n)


def multiply(
    c: Any, M: Any, rows: int, count: Any, add: Callable[[Any, Any, Variables], None] = lambda row, k, y: None
) -> None:
    """Replace X, so many rows of `count` numbers, by M X; `add` adds to `y.y`, the numbers k of a row."""
    for k in loop(0, count, width()):
        x = [load_lanes(c.state, j * count + k) for j in range(rows)]
        for i in loop(rows):
            row = M.shifted(i * c.width * LANES)
            y = Variables(y=row[0] * x[0])
            for j in range(1, rows):
                y.y = fma(row[j * LANES], x[j], y.y)
            add(row, k, y)
            store_lanes(c.state, i * count + k, y.y)


@lru_cache
def chain_forward(rows: int) -> Kernel:
    """Return what carries X, of so many rows, through the steps, and writes six rows of it where states are stored."""

    def text(address: Any) -> None:
        b, lanes = View(Steps, doubles(address)), width()
        c, v = b.read(), Variables(done=0)
        x = c.state

        def add(row: Any, k: Any, y: Variables) -> None:
            """Add what the fixed entries do."""
            for j in loop(c.inputs):
                y.y = fma(row[c.used[j] * LANES], load_lanes(c.changes, j * c.padded + k), y.y)

        for n, M in each_step(b):
            multiply(c, M, rows, c.padded, add)
            for e in loop(c.begins[n], c.begins[n + 1]):
                column, to, value = M.shifted(c.columns[e] * LANES), x.shifted(c.parameters[e]), c.values[e]
                for i in range(rows):
                    to[i * c.padded] = fma(value, column[i * c.width * LANES], to[i * c.padded])
            for _ in when(c.is_stored[n] != 0):
                for k in loop(0, 6 * c.padded, lanes):
                    store_lanes(c.states, v.done * 6 * c.padded + k, load_lanes(x, k))
                v.done = v.done + 1

    return Kernel(text, "i8", 0)


@kernel("i8")
def chain_back(address: Any) -> None:
    """Carry λ back through the steps, and add what the parameters do to f."""
    b = View(Steps, doubles(address))
    c = b.read()
    x, y, found, v = c.state, c.scratch, c.found, Variables(left=0)
    for n in loop(c.steps):
        v.left = v.left + c.is_stored[n]
    for n, M in each_step(b, back=True):
        for _ in when(c.is_stored[n] != 0):
            v.left = v.left - 1
            for i in range(6):
                x[i] = x[i] + c.states[6 * v.left + i]
        for j in loop(c.width):
            entries, s = M.shifted(j * LANES), Variables(s=0.0 * x[0])
            for i in loop(c.rows):
                s.s = fma(entries[i * c.width * LANES], x[i], s.s)
            y[j] = s.s
        for first, last in ((0, c.begins[0]), (c.begins[n], c.begins[n + 1])):
            for e in loop(first, last):
                p = c.parameters[e]
                found[p] = fma(c.values[e], y[c.columns[e]], found[p])
        for i in loop(c.rows):
            x[i] = y[i]


@lru_cache
def grow(rows: int) -> Kernel:
    """Return what carries X, of so many rows, through the steps, and writes its growth."""

    def orthonormalise(c: Any, lengths: Any) -> None:
        """Replace the changes by orthonormal ones that span the same, across `normal`, and write how long they were."""
        x, normal = c.state, [c.normal[i] for i in range(rows)]
        for k in loop(c.grown):
            y = [x[i * LANES + k] for i in range(rows)]
            away = inner_product(c, normal, y)
            v = Variables(y=tuple(y[i] - away * normal[i] for i in range(rows)))
            for j in loop(k):
                before = [x[i * LANES + j] for i in range(rows)]
                along = inner_product(c, before, v.y)
                v.y = tuple(v.y[i] - along * before[i] for i in range(rows))
            length = sqrt(inner_product(c, v.y, v.y))
            lengths[k] = length
            for i in range(rows):
                x[i * LANES + k] = v.y[i] / length

    def text(address: Any) -> None:
        b = View(Steps, doubles(address))
        c, v = b.read(), Variables(since=0, done=0)
        for n, M in each_step(b):
            multiply(c, M, rows, LANES)
            v.since = v.since + 1
            for _ in when((v.since == c.together) | (n + 1 == c.steps)):
                orthonormalise(c, c.lengths.shifted(v.done * c.grown))
                v.since, v.done = 0, v.done + 1

    return Kernel(text, "i8", 0)


def inner_product(c: Any, a: Any, b: Any) -> Any:
    """Return the scalar product of two changes."""
    total = c.weights[0] * a[0] * b[0]
    for i in range(1, 6):
        total = total + c.weights[i] * a[i] * b[i]
    for i, j in iterate(range(6, len(a)), repeat=2):
        total = total + c.metric[6 * (i - 6) + j - 6] * a[i] * b[j]
    return total


def tangent_size(parts: Parts) -> int:
    """Return how many numbers a state has: attitude, W and, of a director scheme, N."""
    return 12 if parts.is_director_scheme else 6


@lru_cache
def linearised(text: Text, parts: Parts, wanted: Wanted, fractions: tuple[float, ...]) -> Kernel:
    """Return the kernel that makes matrices of `Steps`, with the columns of the inputs that are wanted."""
    offsets, n = column_offsets(tangent_size(parts), wanted, parts.nodes), parts.lanes
    directions = Directions(offsets, width := offsets[""], True)

    def kernel(address: Any) -> None:
        b = View(Steps, doubles(address))
        body, out = View(Body, b.body).read(), b.out
        scale = b.factor[0] / body.unit
        calls = FunctionCalls(parts, b, dict(wanted), fractions=fractions, is_done=text.is_midpoint)
        for k in loop(0, smaller(LANES, b.steps - b.first), n):
            read_steps(parts, b, calls.node, parts.nodes, b.first + k)
            found, is_stalled = step_derivatives(text, body, scale, directions, calls)
            for _ in when(any_of(is_stalled)):
                b.failed = b.failed + 1
            for i, y in enumerate(found):
                for j in range(width):
                    out.store((i * b.width + j) * LANES + k, tangent(y, j), n)

    return Kernel(kernel, "i8", n)


def read_steps(parts: Parts, b: View, node: Callable[[Any], View], nodes: int, first: Any) -> None:
    """Fill what is known of the nodes of steps; lanes beyond the last repeat it.

    All but what acts at a node stands in the first one.
    """
    for l in loop(parts.lanes):
        i, lane = smaller(first + l, b.steps - 1), node(0).lane(l)
        p, W = b.quaternions.shifted(4 * i), b.velocities.shifted(3 * i)
        lane.h, lane.p = b.sizes[i], Quaternion(p[3], p[0], p[1], p[2])
        lane.q = Quaternion(p[7], p[4], p[5], p[6])
        lane.W, lane.ahead = vector_at(W), vector_at(W, 3)
        if parts.is_director_scheme:
            lane.N = tuple(b.normals[6 * i + k] for k in range(6))
        for j in loop(nodes):
            read_loads(parts, b, node(j).lane(l), nodes * i + j)


def read_loads(parts: Parts, b: View, lane: View, k: Any) -> None:
    """Take over what acts at the node k of the load; 0 where only its derivatives are asked for."""
    for name, size in (("moving", 3), ("space", 3), ("spin", 1)):
        if getattr(parts, name):
            array = getattr(b, name)
            setattr(lane, name, (0.0,) * size)
            for _ in when(array.address != 0):
                setattr(lane, name, tuple(array[size * k + c] for c in range(size)))
    if parts.rotor:
        lane.rotor, lane.rate = vector_at(b.rotor, 6 * k), vector_at(b.rotor, 6 * k + 3)
    if parts.calls:  # the time, and where the forces of a table lie
        lane.t, lane.forces = b.times[k], select(b.forces == 0, 0, b.forces + 8 * FORCES * k)


def step_derivatives(
    text: Text, body: Body, scale: Any, directions: Directions, calls: FunctionCalls
) -> tuple[list[Any], Any]:
    """Take the step, and return the changes at its end as duals, and the mask of steps that are not solved."""
    calls, parts, at = calls._replace(solved=SolvedEquations()), calls.parts, calls.node(0)
    W, N = at.W @ body.basis, turned_into(body.basis.T, at.N) if parts.is_director_scheme else ()
    if parts.calls and text.is_midpoint:
        call_at_middle(calls, at)
    here = Known(calls, body, calls.node, scale, Directions({}, 0))
    is_stalled = text.step(here, here.start(text, W, N), at.h == at.h).stalled
    calls.solved.begin()
    return changes_of(text, Known(calls, body, calls.node, scale, directions), W, N), is_stalled


def call_at_middle(calls: FunctionCalls, at: View) -> None:
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
    rotation = q if known.now is None else known.now.p.inverse @ q
    turn = known.turn @ attitude(rotation) + 2.0 * (q.inverse @ state.p).vector
    W = known.parts.velocity(known.body, state.s)
    if known.tilt is not None:
        turn, W = turn - known.tilt, W - cross(W, known.tilt)
        N = Symmetric(*N) - tilted(Symmetric(*N).matrix, known.tilt).symmetric if N else N
    return [*turn, *W, *N]


# Steps taken and linearised at once, of a run whose directions are known: they lie side by side, in lanes.


class Loaded(Directions):
    """Directions whose derivatives lie in memory, some lanes at a time; at places that are not used they are 0."""

    def __init__(self, offsets: dict[str, int], memory: Any, stride: Any, used: frozenset[int]) -> None:
        super().__init__(offsets, 1, True)
        self._memory, self._stride, self._used = memory, stride, used

    def tangents(self, place: int) -> list[Any]:
        """Return the derivatives of the number at a place."""
        return [self._memory.load(place * self._stride, machine_code.lanes()) if place in self._used else 0.0]


@lru_cache
def forward_run(text: Text, parts: Parts, wanted: Wanted, inputs: tuple[int, ...]) -> Kernel:
    """Return the kernel that takes the steps of a run and carries changes along; `inputs` are the places of those."""
    rows = tangent_size(parts)
    offsets, used = column_offsets(rows, wanted, parts.nodes), frozenset((*range(rows), *inputs))
    none, side = Directions({}, 0), machine_code.lanes()

    def kernel(address: Any) -> None:
        b = View(Steps, doubles(address))
        changes, count = b.state, b.padded
        body, calls = View(Body, b.body).read(), FunctionCalls(parts, b, dict(wanted), SolvedEquations())
        nodes = [calls.node(j) for j in range(parts.nodes)]
        scale, memory = b.factor[0] / body.unit, View(State, b.carried)
        begin, W = entered(body, b.start, b.start.shifted(4))
        for _ in when(b.is_first != 0):
            constrained_W = Vector(W[0], W[1], select(body.k[2] == 0.0, 0.0, W[2]))
            memory.p, memory.s = begin, constrained_W if parts.is_director_scheme else body.momentum_of(constrained_W)
        state = memory.read()
        v = Variables(state=state._replace(auxiliary=state.auxiliary[: text.auxiliary]), done=0)
        for i in loop(b.steps, whilst=lambda: b.failed == 0):
            nodes[0].h = b.sizes[i]
            for j, node in enumerate(nodes):
                read_loads(parts, b, node, parts.nodes * i + j)
            add_own(b, i, True)
            now, known = v.state, [node.read() for node in nodes].__getitem__
            R, W = attitude(now.p), parts.velocity(body, now.s)
            N = Symmetric(*now.auxiliary[:6]) if parts.is_director_scheme else ()
            found = text.step(Known(calls, body, known, scale, none, R, now), now, known(0).h == known(0).h)
            calls.solved.begin()
            values = Loaded(offsets, changes, count, frozenset())  # which stand outside of the loop
            changes_of(text, Known(calls, body, known, scale, values, R, now), W, N)
            for first in loop(0, count, side):
                own_changes = changes.shifted(first)
                directions = Loaded(offsets, own_changes, count, used)
                varied = Known(calls, body, known, scale, directions, R, now)
                for r, y in enumerate(changes_of(text, varied, W, N)):
                    own_changes.store(r * count, tangent(y, 0), side)
            for _ in when(found.stalled | found.far | logical_not(found.gap <= UNIT)):
                b.failed = b.failed + 1
            v.state = found.state
            add_own(b, i, False)
            for _ in when(b.is_stored[i] != 0):
                for k in loop(0, 6 * count, side):
                    b.states.store(v.done * 6 * count + k, changes.load(k, side), side)
                put(b.turns.shifted(9 * v.done), attitude(v.state.p.inverse @ begin))
                v.done = v.done + 1
        now = v.state
        memory.write(now._replace(auxiliary=(*now.auxiliary, *state.auxiliary[text.auxiliary :])))

    return Kernel(kernel, "i8")


def add_own(b: View, i: Any, adds: bool) -> None:
    """Set the changes that the step i has beside those of all steps to the given ones, and add its own, or not."""
    for is_added in (False, True)[: 1 + adds]:
        for e in loop(b.begins[i], b.begins[i + 1]):
            place = b.columns[e] * b.padded + b.parameters[e]
            b.state[place] = b.state[place] + b.values[e] if is_added else b.changes[place]
