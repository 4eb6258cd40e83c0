"""How a recording is read: what its user knows of it and the file does not say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from ..errors import InputError, Option
from ..spec import Spec, require_types

COLUMNS = Spec(
    "Headers of the columns to use: 4 of a quaternion or 9 of a matrix, row by row, or 3 with {option[euler]} or "
    "{option[rotation_vector=True]}; before them that of the time if there is one. Without headers, column numbers.",
    "A,B,...",
)
BODY = Spec(
    "Which of several to use: a segment, sensor, joint, topic, frame or array, a value of the column that names the "
    "sensor of each row, or the common beginning of the headers of a sensor.",
    "NAME",
)
SCALAR = Spec("Order of quaternions, w x y z or x y z w, as they are stored.", "", "--scalar-first/--scalar-last")
EULER = Spec("Axes of three angles, in the order of the columns: ZYX about moving axes, zyx about fixed axes.", "AXES")
ANGLE_UNIT = Spec("Unit of angles, if the file does not name it.", "deg|rad")
TIME_UNIT = Spec("Unit of the time column: s, ms, us, ns, min, h, day, or the seconds of one count.", "UNIT")
RATE = Spec(
    "Samples per second. Times are then computed from a column of sample or packet numbers, or else by counting rows; "
    "times in the file are ignored.",
    "HZ",
    unit="Hz",
)
NORMALIZE = Spec("Scale rounded or commonly scaled quaternions to length 1, and matrices to the nearest rotations.")
INVERSE = Spec(
    "Invert every attitude, for sensors that report the earth relative to the sensor. By default what a gyroscope or "
    "an accelerometer in the file decides, or else not.",
    option="--inverse/--no-inverse",
)


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """The options of `nontwist.read_motion`; None: what the recording states itself."""

    columns: Annotated[Sequence[str] | None, COLUMNS] = None
    time_column: Annotated[str | None, Spec("Header of the time column.", "NAME")] = None
    body: Annotated[str | None, BODY] = None
    scalar_first: Annotated[bool | None, SCALAR] = None
    euler: Annotated[str | None, EULER] = None
    rotation_vector: Annotated[bool, Spec("The columns are a rotation vector, axis times angle.")] = False
    angle_unit: Annotated[Literal["deg", "rad"] | None, ANGLE_UNIT] = None
    time_unit: Annotated[str | None, TIME_UNIT] = None
    rate: Annotated[float | None, RATE] = None
    normalize: Annotated[bool, NORMALIZE] = False
    inverse: Annotated[bool | None, INVERSE] = None

    def __post_init__(self) -> None:
        """Check the values."""
        require_types(self)
        if self.rate is not None and not 1e-9 <= self.rate <= 1e12:
            raise InputError("rate", rate=self.rate)
        if self.euler is not None and self.rotation_vector:
            raise InputError("option-without-effect", name=Option("rotation_vector"), why="three angles are read")
        if self.euler is not None:
            from ..geometry.attitudes import require_sequence

            require_sequence(self.euler)

    def require_without(self, name: str, why: str) -> None:
        """Refuse an option that has no effect."""
        if getattr(self, name) is not None:
            raise InputError("option-without-effect", name=Option(name), why=why)
