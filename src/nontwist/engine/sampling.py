"""What acts at the nodes of a march, as a step sees it: from arrays sampled beforehand, and from the body itself."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..kernels.memory import View, doubles, fields, vector_at
from ..kernels.vectors import Matrix, Quaternion, Vector, attitude
from .records import FORCES, Body, Parts, Work
from .state_moments import Functions
from .workspace import internal

ARRAYS = {"times": "is_timed", "moving": "moving", "space": "space", "rotor": "rotor", "spin": "spin"}  # for which part
STATE_CALL = fields(Work)["state_call"].place


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
    memory : room of the scheme itself, behind the workspace
    block, x : views of the block and of the workspace
    buffer : room for what functions of the state are called with, by default in the workspace
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

    @property
    def internal(self) -> Any:
        """The internal states at the beginning of the step."""
        return internal(self.block)

    def fraction(self, i: Any) -> Any:
        """Return the fraction of the step that a substep takes."""
        return self.block.fractions[i]

    def begin(self, node: Any, p: Quaternion) -> None:
        """Begin a step at its first node, with the attitude p."""
        self.node, self.R = node, attitude(p)

    def seen(self, x: Vector) -> Vector:
        """Return a vector in space as seen at the beginning of the step."""
        return x @ self.R

    def moving(self, j: Any = 0) -> Vector:
        """Return the moment along the frame at a node of the step, in b."""
        return self._along("moving", 3 * (self.node + j))

    def space(self, j: Any = 0) -> Vector:
        """Return the moment in space at a node of the step, as seen at its beginning."""
        return self.seen(self._scale * vector_at(self._arrays["space"], 3 * (self.node + j)))

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
        return Matrix(*map(self.seen, self.body.dead))

    def loads(self, j: Any = 0) -> Loads:
        """Return all that acts at a node of the step."""
        parts = self.parts
        moments = (getattr(self, name)(j) if getattr(parts, name) else None for name in ("moving", "space"))
        forces = self.body.damping if parts.damping else None, self.dead() if parts.dead else None
        rotor = self.rotor(j) if parts.rotor else (None, None)
        return Loads._make([*moments, *forces, *rotor, self.functions(j) if parts.calls else None])

    def _along(self, name: str, place: Any) -> Vector:
        return (self._scale * vector_at(self._arrays[name], place)) @ self.body.basis
