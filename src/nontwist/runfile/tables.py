"""The tables ``[time]``, ``[integrator]`` and ``[output]``."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import MISSING, fields
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

import numpy as np
from pydantic import Discriminator, Field, Tag, create_model

from ..driver.events import NamedEvent, axis_crosses, spin_below
from ..integrators import DEFAULT, INTEGRATORS
from ..integrators import Integrator as Scheme
from ..integrators.time_grid import FIT
from ..recordings.motions import rotation
from ..units import RATE
from .folder import Folder
from .section import AN_AXIS, Axis, Matrix, OneOf, Positive, Section, Vector, by_key

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

# The table `[start]`: attitude and angular velocity at t_start.
#
# Every attitude is the rotation Λ from body to space, whose columns are the directors. Angles state their unit,
# quaternions their order, Euler angles their sequence: nothing is guessed.

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


MOST_TIMES = 10_000_000  # output times


def _times_form(value: Any) -> str | None:
    return by_key("file", "every")(value) if isinstance(value, (dict, Section)) else "<values>"


class TimesFile(Section):
    """Output times in a column of a CSV file with a line of headers."""

    file: str = Field(
        min_length=1, description="a CSV file in quotes, relative to the run file: headers, then rows of numbers, s"
    )
    column: str | None = Field(
        default=None, description="the header of the times (s), in quotes; not needed where there is one column"
    )
    sha256: str | None = Field(
        default=None, description="the hash of the CSV file, in quotes: another content is refused"
    )


class TimesEvery(Section):
    """Output times at equal distances, from the start, and the end."""

    every: Positive = Field(
        description="a positive number, s: output at t_start, so much later, and so on, and at t_end"
    )


class Time(Section):
    """From when to when, in which steps."""

    t_end: float = Field(description="a number after t_start, s")
    t_start: float = Field(default=0.0, description="a number, s")
    step: Positive | None = Field(
        default=None,
        description="a positive number that divides the span, s; left out: at most 0.05 rad a step, or with gauss an "
        "error of 1e-8 at most",
    )
    tolerance: Annotated[float, Field(gt=0, le=0.1)] | None = Field(
        default=None,
        description="a positive number up to 0.1, rad, in place of step: a bound of the error of the attitude, and of "
        "that of the angular velocity relative to its largest size",
    )
    store: Annotated[int, Field(ge=1)] | Literal["end"] = Field(
        default=1, description='a whole number of steps >= 1, or "end" for the first and the last state only'
    )
    times: (
        Annotated[
            Annotated[TimesFile, Tag("<file>")]
            | Annotated[TimesEvery, Tag("<every>")]
            | Annotated[list[float], Field(min_length=1), Tag("<values>")],
            Discriminator(_times_form),
        ]
        | None
    ) = Field(
        default=None,
        description="increasing numbers from t_start to t_end, s: output at these times, without store; or a table "
        "with the key every (s), or with the keys file and column",
    )

    def output_times(self, folder: Folder) -> list[float] | None:
        """Return the output times, None where there are none; a ValueError where the file cannot be read."""
        if isinstance(self.times, TimesEvery):
            return self._equidistant(self.times.every)
        if not isinstance(self.times, TimesFile):
            return self.times
        chosen = None if self.times.column is None else [self.times.column]
        found: list[float] = folder.table(self.times.file, chosen, self.times.sha256, 1).columns[0].tolist()
        return found

    def _equidistant(self, every: float) -> list[float]:
        span = self.t_end - self.t_start
        if not span / every < MOST_TIMES:
            raise ValueError(f"it makes {span / every:.3g} times, at most {MOST_TIMES:.0e} are possible")
        count = math.ceil(span / every * (1 - FIT))
        return [*(self.t_start + every * k for k in range(count)), self.t_end]

    def recorded(self, folder: Folder) -> dict[str, Any]:
        """Return what is recorded in the place of `times`: the hash of the file as it was read."""
        if not isinstance(self.times, TimesFile):
            return {}
        one = self.times
        chosen = None if one.column is None else [one.column]
        hashed = {"sha256": folder.table(one.file, chosen, one.sha256, 1).sha256}
        return {"times": one.model_dump(exclude_none=True) | hashed}


class Integrator(Section):
    """The integrator, its order and its own options."""

    name: Annotated[str, OneOf(INTEGRATORS, open=True)] = DEFAULT
    order: int | None = Field(default=None, description="a whole number: an order that the integrator has")
    options: dict[str, Any] = Field(default={}, description="a table of the integrator's own options")

    @classmethod
    def keys(cls) -> list[str]:
        """Return the keys, and those of `options` of all integrators."""
        kinds: list[Any] = [*INTEGRATORS.values()]
        options = dict.fromkeys(key for kind in kinds for key in options_of(kind).model_fields)
        return [*super().keys(), *(f"options.{key}" for key in options)]

    def scheme(self) -> Scheme:
        """Return the integrator; a ValueError where it has no such order or option."""
        order = {} if self.order is None else {"order": self.order}
        return INTEGRATORS[self.name](**order, **self.options)


class Output(Section):
    """Where the result goes."""

    path: Annotated[str, Field(pattern=r"^[^\x00]+\.nc$")] | None = Field(
        default=None, description='a file name with the ending ".nc", like result.nc, relative to the run file'
    )
    figures: list[Literal["momenta", "energy", "path"]] = Field(
        default=[], description='a list of "momenta", "energy", "path": figures drawn next to the result'
    )


@cache
def options_of(scheme: type[Scheme]) -> type[Section]:
    """Return the table of the options of an integrator, without `order`."""
    hints = get_type_hints(scheme)
    own: dict[str, Any] = {
        f.name: (hints[f.name], ... if f.default is MISSING else f.default) for f in fields(scheme) if f.name != "order"
    }
    return create_model("Options", __base__=Section, **own)


# The tables `[[event]]`: where something happens on the way of a run, which may end it.
#
# `EVENTS` is the visible list: a new kind is one class and one line.


NAME = r"^[^\x00-\x20\x7f]([^\x00-\x1f\x7f]*[^\x00-\x20\x7f])?$"  # a line without blanks at its ends
DIRECTION = "-1 (only where its value falls), 1 (only where it rises) or 0 (both)"


class EventSection(Section):
    """An event, with what all kinds have in common."""

    terminal: bool | Annotated[int, Field(ge=0)] = Field(
        default=False, description="true where the run ends there, or a whole number: after how many of them"
    )
    name: Annotated[str, Field(pattern=NAME, max_length=60)] | None = Field(
        default=None, description="a text of up to 60 characters; by default axis_crosses or spin_below"
    )
    if TYPE_CHECKING:
        kind: str
        direction: int

    @abstractmethod
    def event(self) -> NamedEvent:
        """Return the event; a ValueError where its numbers make none."""

    @property
    def named(self) -> str:
        """The name of the event."""
        return self.name or self.kind.replace("-", "_")


class AxisCrosses(EventSection):
    """An axis of the body crosses a plane, or a cone about its normal."""

    kind: Literal["axis-crosses"]
    axis: Axis = Field(default=[0.0, 0.0, 1.0], description=AN_AXIS + "components along the directors")
    normal: Axis = Field(default=[0.0, 0.0, 1.0], description=AN_AXIS + "of the plane, in space")
    cosine: Annotated[float, Field(gt=-1, lt=1)] = Field(
        default=0.0, description="a number between -1 and 1: of the angle between axis and normal, 0 for the plane"
    )
    direction: Literal[-1, 0, 1] = Field(default=0, description=DIRECTION)

    def event(self) -> NamedEvent:
        """Return the event."""
        how = {"direction": self.direction, "terminal": self.terminal, "name": self.named}
        return axis_crosses(self.axis, self.normal, cosine=self.cosine, **how)  # type: ignore[arg-type]


class SpinBelow(EventSection):
    """The angular velocity, or its part along an axis of the body, falls below a value."""

    kind: Literal["spin-below"]
    value: Positive = Field(description="a positive number, rad/s")
    axis: Axis | None = Field(default=None, description=AN_AXIS + "components along the directors")
    direction: Literal[-1, 0, 1] = Field(default=-1, description=DIRECTION)

    def event(self) -> NamedEvent:
        """Return the event."""
        how = {"direction": self.direction, "terminal": self.terminal, "name": self.named}
        return spin_below(self.value, self.axis, **how)  # type: ignore[arg-type]


EVENTS: dict[str, type[EventSection]] = {"axis-crosses": AxisCrosses, "spin-below": SpinBelow}
AnyEvent = Annotated[EventSection, OneOf(EVENTS)]
