"""The table ``[start]``: attitude and angular velocity at t_start.

Every attitude is the rotation Λ from body to space, whose columns are the directors. Angles state their unit,
quaternions their order, Euler angles their sequence: nothing is guessed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag

from ..recordings.motions import rotation
from ..units import RATE
from .folder import Folder
from .section import Matrix, Section, Vector, by_key

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Unit = Literal["radians", "degrees", "rad", "deg"]
UNIT = '"radians", "degrees", "rad" or "deg"'
RateUnit = Annotated[Literal["rad/s", "deg/s", "rpm"], Field(description='"rad/s" (by default), "deg/s" or "rpm"')]
IN_UNIT = "3 numbers, rad/s, or in the stated unit"


class MatrixRotation(Section):
    """Λ itself."""

    matrix: Matrix = Field(description="Λ as 3 rows of 3 numbers, orthonormal to 1e-9, with the determinant 1")

    def rotation(self) -> Rotation:
        """Return Λ."""
        return rotation(np.array(self.matrix))


class QuaternionRotation(Section):
    """A unit quaternion."""

    quaternion: Annotated[list[float], Field(min_length=4, max_length=4)] = Field(
        description="4 numbers of length 1, in the stated order"
    )
    order: Literal["wxyz", "xyzw"] = Field(description='"wxyz" (scalar first) or "xyzw" (scalar last)')

    def rotation(self) -> Rotation:
        """Return Λ."""
        return rotation(self.quaternion, scalar_first=self.order == "wxyz")


class VectorRotation(Section):
    """A rotation vector: axis times angle."""

    vector: Vector = Field(description="3 numbers: the axis of the rotation times its angle")
    unit: Unit = Field(description=UNIT)

    def rotation(self) -> Rotation:
        """Return Λ."""
        from scipy.spatial.transform import Rotation

        return rotation(Rotation.from_rotvec(self.vector, degrees=self.unit.startswith("deg")).as_matrix())


class EulerRotation(Section):
    """Euler angles as SciPy has them."""

    euler: Annotated[list[float], Field(min_length=1, max_length=3)] = Field(
        description="1 to 3 angles, one for each letter of the sequence"
    )
    sequence: str = Field(
        pattern="^([xyz]{1,3}|[XYZ]{1,3})$",
        description='1 to 3 axes, neighbours different: capitals for turning axes ("ZYX"), small letters for fixed '
        'ones ("xyz"), as in scipy',
    )
    unit: Unit = Field(description=UNIT)

    def rotation(self) -> Rotation:
        """Return Λ."""
        from scipy.spatial.transform import Rotation

        if len(self.euler) != len(self.sequence):
            raise ValueError(f"{len(self.euler)} angles for the {len(self.sequence)} axes of {self.sequence!r}")
        return Rotation.from_euler(self.sequence, self.euler, degrees=self.unit.startswith("deg"))


class BodyVelocity(Section):
    """Angular velocity in body components."""

    body: Vector = Field(description=f"{IN_UNIT}: components along the directors")
    unit: RateUnit = "rad/s"


class SpaceVelocity(Section):
    """Angular velocity in space components."""

    space: Vector = Field(description=f"{IN_UNIT}: components along the fixed axes")
    unit: RateUnit = "rad/s"


Attitude = Annotated[
    Annotated[MatrixRotation, Tag("<matrix>")]
    | Annotated[QuaternionRotation, Tag("<quaternion>")]
    | Annotated[VectorRotation, Tag("<vector>")]
    | Annotated[EulerRotation, Tag("<euler>")],
    Discriminator(by_key("matrix", "quaternion", "vector", "euler")),
]
Velocity = Annotated[
    Annotated[BodyVelocity, Tag("<body>")] | Annotated[SpaceVelocity, Tag("<space>")],
    Discriminator(by_key("body", "space")),
]


IDENTITY = MatrixRotation(matrix=np.eye(3).tolist())


class Start(Section):
    """Attitude and angular velocity at t_start; the identity, at rest, where they are left out. Or a run to resume."""

    run: str | None = Field(
        default=None,
        min_length=1,
        description="a result file (NetCDF), relative to the run file, in quotes: its last state, in place of rotation "
        "and angular_velocity; t_start of [time] is its last time",
    )
    sha256: str | None = Field(
        default=None, description="the hash of the result file, in quotes: another content is refused"
    )
    rotation: Attitude = Field(
        default=IDENTITY,
        description="one of { matrix = [...] }, { quaternion = [...], order = ... }, { vector = [...], unit = ... }, "
        "{ euler = [...], sequence = ..., unit = ... }",
    )
    angular_velocity: Velocity = Field(
        default=BodyVelocity(body=[0.0, 0.0, 0.0]),
        description="{ body = [...] } or { space = [...] }: 3 numbers, rad/s, or { body = [...], unit = ... }",
    )
    project: bool = Field(
        default=False, description="true to remove a spin about the constrained axis, false to refuse it"
    )

    def arguments(self, folder: Folder) -> dict[str, Any]:
        """Return what `simulate` takes; a ValueError where a result file cannot be read."""
        if self.run is not None:
            return {"start": folder.result(self.run, self.sha256)[0], "project": self.project}
        velocity, factor = self.angular_velocity, RATE[self.angular_velocity.unit]
        if isinstance(velocity, BodyVelocity):
            given: dict[str, Any] = {"material_angular_velocity": [factor * x for x in velocity.body]}
        else:
            given = {"angular_velocity": [factor * x for x in velocity.space]}
        rotation = None if self.rotation == IDENTITY else self.rotation.rotation()  # which would import SciPy's
        return {"rotation": rotation, **given, "project": self.project}

    def recorded(self, data: dict[str, Any], folder: Folder) -> dict[str, Any]:
        """Return the table as it is recorded: of a run to resume its file, and the hash of that as it was read."""
        if self.run is None:
            return data
        return {"run": self.run, "sha256": folder.result(self.run, self.sha256)[1], "project": self.project}
