"""What acts at the nodes of a march, as a step sees it: from arrays sampled beforehand, and from the body itself.

Moments of the state are those of C functions, of director forces and of potentials (`generalised`). A C function is
``void (t, directors, angular_velocity, moment)``. It sees directors and angular velocity in space and in the units of
the caller, one body after the other. The derivatives of its moment are differences.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import Any, NamedTuple

from ..kernels.control import Variables, loop, when
from ..kernels.dual import Dual, plain, tangents_of
from ..kernels.elements import any_of, select
from ..kernels.kernel import part
from ..kernels.memory import View, call, doubles, fields, vector_at
from ..kernels.vectors import Matrix, Quaternion, Symmetric, Vector, attitude, cross, first_moment, sum_of, taxicab
from .generalised import without_turn
from .internal import call_all, respond
from .records import FORCES, Body, Found, Parts, StateCall, Work
from .workspace import turned_into

EPS = 2.0**-52
DIFFERENCE, LEAST_TURN = sqrt(EPS), 1e-13  # of the velocity; rad, of a difference
TINY = 1e-280  # of velocities, rad/s: less is rest, and the inverse of a difference is a number
FOUND = fields(Work)["found"].offset
W, C_MOMENT = (fields(StateCall)[name].offset for name in ("w", "c_moment"))


def mean(s: Any, a: Vector, x: Vector) -> Vector:
    """Return M x, M = (I - â)⁻¹ = s (I + â + a aᵀ)."""
    return s * ((a @ x) * a + (x + cross(a, x)))


class Functions(NamedTuple):
    """What is called at a node, in a step that begins with the attitude R."""

    parts: Parts
    block: View
    x: View
    scratch: Any  # for `StateCall` of one body after the other
    t: Any
    forces: Any  # address of the director forces of the node
    R: Matrix

    @part
    def evaluate(self, rows: Matrix, w: Vector, half: Vector) -> None:
        """Evaluate all at the attitude R Λ⁻¹, given the rows of Λ, w in b, and the half turn of the step in b."""
        parts, b, x, state, basis = self.parts, self.block, self.x, View(StateCall, self.scratch), self.x.body.basis
        d = Matrix(*(basis @ row for row in rows)).T
        for k, y in enumerate((*d[0], *d[1], *d[2], *(b.step[1] * (self.R @ w)), *(basis @ half))):
            x.set_number(FOUND + k, y)
        for l in loop(parts.lanes):
            lane = x.lane(l)
            for k in range(C_MOMENT):
                state.set_number(k, lane.number(FOUND + k))
            state.c_moment, state.t = (0.0, 0.0, 0.0), self.t
            if parts.function:
                at = self.scratch
                call_all(b.functions, 3, 0, self.t, at, at.shifted(W), at.shifted(C_MOMENT))
            if parts.generalised:
                state.half = tuple(lane.number(FOUND + 12 + k) for k in range(3))
                state.action, state.terms, state.node = b.action, b.terms, self.forces
                call(b.generalised, self.scratch.address)
                of_potentials, load = state.of_potentials, state.c_moment + state.load
                lane.found.write(Found(load + of_potentials, load, of_potentials, state.rest))
            else:
                lane.found.total = state.c_moment

    def found(self, name: str) -> Any:
        """Return what was found, in units of the body: numbers in space or, of `rest`, along the body."""
        return self.x.scale * getattr(self.x.found, name)

    def moment(self, a: Vector, w: Vector) -> Vector:
        """Return the moment in b for the averaged directors of a step and the velocity w."""
        s = 1.0 / (1.0 + a @ a)
        self.evaluate(Matrix(*(mean(s, -a, row) for row in self.R)), w, a)  # the rows of Λ_m = R M are Mᵀ R_i
        if not self.parts.memory:
            return self.found("total") @ self.R
        zero = self.remember((1.0 + a @ a) * w if self.parts.is_director_scheme else w)
        return Vector(*(x + zero for x in self.found("total") @ self.R))

    def remember(self, W: Vector) -> Any:
        """Add what loads with memory give at Ω to what was found; return NaN where it cannot be found, else 0."""
        parts, b, state = self.parts, self.block, View(StateCall, self.scratch)
        moment, along, zero = respond(parts, b, state, b.step[1] * (self.x.body.basis @ W))
        along = along @ state.directors
        if parts.is_director_scheme and not parts.is_exact:
            along = 2.0 * without_turn(state.directors, along)
        for name in ("total", "load"):
            setattr(self.x.found, name, getattr(self.x.found, name) + (moment + along))
        return zero

    def load(self, total: Vector) -> Vector:
        """Return the part of the moment `total`, found last, that is of the load and not of potentials."""
        return self.found("load") @ self.R if self.parts.generalised else total

    @property
    def rest(self) -> Symmetric:
        """σ, found last, in b."""
        return turned_into(self.x.body.basis.T, self.found("rest"))

    def derivatives(self, f: Any, is_shrinking: bool, Om: Vector, total: Vector) -> tuple[Vector, ...]:
        """Return the derivatives of the moment by the components of Ω, as differences.

        The functions get a = f Ω and ``w = Ω``, or ``w = s Ω`` where that is shrinking. Where the body is so slow that
        the difference of a is lost in the round-off of the attitude, a and w have differences of their own, a that of
        `LEAST_TURN`.
        """
        e, here = DIFFERENCE * taxicab(Om), f * Om
        e = select(e > TINY, e, e + DIFFERENCE)
        is_slow, speed = abs(f) * e < LEAST_TURN, _shrunk(here, Om) if is_shrinking else Om
        v = Variables(S=(total, total, total))
        for j in loop(3):  # so that the call stands once
            w = Vector(*(x + select(j == k, e, 0.0) for k, x in enumerate(Om)))
            a = select(is_slow, here, f * w)
            changed = self.moment(a, _shrunk(a, w) if is_shrinking else w)
            column = (1.0 / e) * (changed - total)
            v.S = v.S[1], v.S[2], column
            for _ in when(any_of(is_slow)):
                a = Vector(*(x + select(j == k, LEAST_TURN, 0.0) for k, x in enumerate(here)))
                column_of_turn = (f / LEAST_TURN) * (self.moment(a, speed) - total) + column
                v.S = v.S[0], v.S[1], select(is_slow, column_of_turn, column)
        return v.S


class MomentOfStep:
    """The moment that functions of the state have in a step, as a function of its velocity Ω; None without functions.

    Near an Ω it is linear, with differences as derivatives. The functions get a = f Ω, and s Ω where w is shrinking.
    """

    def __init__(self, functions: Functions | None, f: Any, W: Vector, is_shrinking: bool) -> None:
        self.functions, self.f, self.is_shrinking = functions, f, is_shrinking
        self._slopes = Variables(columns=None if functions is None else (0.0 * plain(W),) * 3)

    @property
    def size(self) -> Any:
        """The size of the terms that cancel in the moment, None without functions."""
        return None if self.functions is None else sum_of(*map(taxicab, self._slopes.columns))

    def at(self, Om: Vector) -> Any:
        """Return the moment."""
        a = self.f * Om
        return None if self.functions is None else self.functions.moment(a, _shrunk(a, Om) if self.is_shrinking else Om)

    def near(self, Om: Vector, is_new: Any) -> Callable[[Vector], Any]:
        """Return the moment near Ω, on duals as well where `is_new`, which takes derivatives there."""
        total, functions, slopes = self.at(Om), self.functions, self._slopes
        if functions is not None:
            for _ in when(is_new):
                slopes.columns = functions.derivatives(self.f, self.is_shrinking, Om, total)

        def moment(Om: Vector) -> Any:
            if functions is None or isinstance(total[0], Dual) or not isinstance(Om[0], Dual):
                return total
            rows = Matrix(*slopes.columns).T
            return Vector(*(Dual(x, [row @ w for w in tangents_of(Om)]) for x, row in zip(total, rows, strict=True)))

        return moment


def _shrunk(a: Vector, w: Vector) -> Vector:
    return (1.0 / (1.0 + a @ a)) * w


def mean_moment_of_dead(F: Matrix, s: Any, a: Vector) -> Vector:
    """Return the moment of dead forces at the mean directors, as seen at the beginning of the step."""
    return first_moment(Matrix(*(mean(s, a, column) for column in F.T)).T)


ARRAYS = {"times": "is_timed", "moving": "moving", "space": "space", "rotor": "rotor", "spin": "spin"}  # for which part
STATE_CALL = fields(Work)["state_call"].offset


class Loads(NamedTuple):
    """What acts at a node, in b at the beginning of the step; None where there is none."""

    moving: Any = None  # moment along the frame
    space: Any = None  # moment in space
    damping: Any = None
    dead: Any = None  # dead forces, rows
    rotor: Any = None  # momentum of the rotors
    rotor_rate: Any = None
    functions: Any = None


class Nodes:
    """What acts in the steps of the bodies in the workspace.

    Attributes
    ----------
    parts : Parts
    body : Body
    h : the step, in units of the body
    rate : 1 over the unit of time
    R : Matrix, the attitude at the beginning of the step
    node : number of the first node of the step
    memory : scratch of the scheme itself, behind the workspace
    block, x : views of the block and of the workspace
    buffer : memory for what functions of the state are called with, by default in the workspace
    """

    node: Any
    R: Matrix
    solved: Any = None  # what `newton.solve` notes and knows of a step that is linearised

    def __init__(self, parts: Parts, b: View, x: View, memory: Any, buffer: Any = None) -> None:
        self.parts, self.memory, self.block, self.x = parts, memory, b, x
        self.body, self.h, self.rate, self._scale = Body(*x.body.read()), b.step[0], b.step[1], x.scale
        self._arrays = {name: getattr(b, name) for name, part in ARRAYS.items() if getattr(parts, part)}
        self.buffer = doubles(b.workspace).shifted(STATE_CALL * parts.lanes) if buffer is None else buffer

    @property
    def table(self) -> Any:
        """The coefficients of the scheme."""
        return self.block.table

    @property
    def orbit(self) -> tuple[Any, Vector]:
        """The rate of an orbit, in units of the body, and its axis in space."""
        about = self.block.orbit
        return about[0], vector_at(about, 1)

    def begin(self, node: Any, p: Quaternion) -> None:
        """Begin a step at its first node, with the attitude p."""
        self.node, self.R = node, attitude(p)

    def to_material(self, x: Vector) -> Vector:
        """Return the components in b, at the beginning of the step, of a vector in space."""
        return x @ self.R

    def moving(self, j: Any = 0) -> Vector:
        """Return the moment along the frame at a node of the step, in b."""
        return self._along("moving", 3 * (self.node + j))

    def space(self, j: Any = 0) -> Vector:
        """Return the moment in space at a node of the step, as seen at its beginning."""
        return self.to_material(self._scale * vector_at(self._arrays["space"], 3 * (self.node + j)))

    def rotor(self, j: Any = 0) -> tuple[Vector, Vector]:
        """Return the momentum of the rotors at a node of the step and its rate, in b."""
        place = 6 * (self.node + j)
        return self._along("rotor", place), self._along("rotor", place + 3)

    def time(self, j: Any = 0) -> Any:
        """Return the time of a node of the step, that of the caller."""
        return self._arrays["times"][self.node + j]

    def spin(self, j: Any = 0) -> Any:
        """Return the change of the prescribed spin in the step."""
        return self._arrays["spin"][self.node + j]

    def functions(self, j: Any = 0) -> Functions:
        """Return the functions of the state at a node of the step."""
        parts, b, node = self.parts, self.block, self.node + j
        forces = b.forces + 8 * FORCES * node if parts.forces else 0
        return Functions(parts, b, self.x, self.buffer, self._arrays["times"][node], forces, self.R)

    def dead(self) -> Matrix:
        """Return the dead forces as seen at the beginning of the step, rows."""
        return Matrix(*map(self.to_material, self.body.dead))

    def loads(self, j: Any = 0) -> Loads:
        """Return all that acts at a node of the step."""
        parts = self.parts
        moments = (getattr(self, name)(j) if getattr(parts, name) else None for name in ("moving", "space"))
        forces = self.body.damping if parts.damping else None, self.dead() if parts.dead else None
        rotor = self.rotor(j) if parts.rotor else (None, None)
        return Loads._make([*moments, *forces, *rotor, self.functions(j) if parts.calls else None])

    def _along(self, name: str, place: Any) -> Vector:
        return (self._scale * vector_at(self._arrays[name], place)) @ self.body.basis
