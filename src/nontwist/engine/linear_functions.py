"""Functions of the state in a linearised step: evaluated once, with their derivatives, and linear from there on."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..kernels import machine_code
from ..kernels.control import Variables, loop
from ..kernels.dual import Dual, jacobian, plain, tangent
from ..kernels.memory import View, call, scratch, size_of
from ..kernels.vectors import AXES, Matrix, Vector
from .generalised import STATE, Sloped
from .known_steps import Known, Step
from .records import Parts
from .state_moments import mean


class Calls(NamedTuple):
    """How functions of the state are called, in one step after the other, and in which directions.

    Where potentials have a torque of their own they are `generalised`, all else is of a `function`. Directions are the
    state, the forces of a table where they are asked for, and changes of the numbers of terms.
    """

    parts: Parts
    block: View  # of `Steps`
    wanted: dict[str, int]  # inputs
    solved: Any = None  # `newton.Solved`, of the step

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

    def linear(self, known: Known, j: Any) -> LinearFunctions:
        """Return the functions at a node, as they were evaluated there."""
        return LinearFunctions(known, self, j)

    def evaluate(self, at: View, directors: Matrix, w: Vector, half: Vector, is_sloped: bool = True) -> None:
        """Evaluate them, with their derivatives: directors and w are given in space, the half turn in the body."""
        parts, b, n, count = self.parts, self.block, self.parts.lanes, self.places[""]
        at.directors, at.w, at.half = directors, w, half
        own, found, slopes = View(Sloped, scratch(size_of(Sloped))), scratch(6 * count), self.slopes(at)
        state = own.state_call
        state.action, state.terms, state.called = b.action, b.terms, (b.speed, 0.0, 0.0)
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


def places_of_directions(wanted: dict[str, int]) -> dict[str, int]:
    """Return where directions of functions of the state begin, for inputs, and, as "", how many there are."""
    n, side = len(STATE), machine_code.lanes()
    terms = n + wanted.get("forces", 0)
    return {"forces": n, "terms": terms, "": -(-(terms + wanted.get("terms", 0)) // side) * side}


class LinearFunctions:
    """Functions of the state at a node, linear about the state at which they were evaluated."""

    def __init__(self, known: Known, calls: Calls, j: Any) -> None:
        self._known, self._at, self._calls, self._j = known, known.known(j), calls, j
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
        values = (*(at.load if calls.parts.function else ()), *(at.of_potentials if calls.parts.generalised else ()))
        v = Variables(found=tuple(Dual(y, [0.0] * width) for y in values))
        for k in loop(len(changes)):
            y, *tangents = (there.load((k * (1 + width) + j) * n, n) for j in range(1 + width))
            v.found = with_slopes(k, Dual(y, tangents))
        for name in ("forces", "terms"):
            if name in known.vary.places:
                for k, x in enumerate(known.vary.along(name, (0.0,) * calls.wanted[name]), places[name]):
                    v.found = with_slopes(k, x)
        found = v.found if width else plain(v.found)
        moment, torque = Vector(*found[:3]), Vector(*found[-3:])
        load = known.factor * known.seen(moment) if calls.parts.function else None
        return load, known.factor * known.tilted(known.along(torque)) if calls.parts.generalised else None
