"""The tables ``[start]``, ``[time]``, ``[integrator]``, ``[[event]]`` and ``[output]``."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import MISSING, fields
from functools import cache
from typing import Annotated, Any, ClassVar, Literal, get_type_hints

import numpy as np
from pydantic import Field, create_model

from ..driver.named_events import NamedEvent, axis_crosses, spin_below
from ..geometry.arrays import AXES, Rotation
from ..integrators import DEFAULT, INTEGRATORS
from ..integrators import Integrator as Scheme
from ..integrators.ivp import FIT
from ..recordings.motions import rotation
from ..units import RATE
from .files import Folder, Table
from .section import AN_AXIS, BY_FORM, Axis, Matrix, OneOf, Positive, Section, Vector, entry

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

    matrix: Matrix = entry("Λ as 3 rows of 3 numbers, orthonormal to 1e-9, with the determinant 1")

    def rotation(self) -> Rotation:
        """Return Λ."""
        return rotation(np.array(self.matrix))


class QuaternionRotation(Section):
    """A unit quaternion."""

    quaternion: list[float] = entry("4 numbers of length 1, in the stated order", min_length=4, max_length=4)
    order: Literal["wxyz", "xyzw"] = entry('"wxyz" (scalar first) or "xyzw" (scalar last)')

    def rotation(self) -> Rotation:
        """Return Λ."""
        return rotation(self.quaternion, scalar_first=self.order == "wxyz")


class VectorRotation(Section):
    """A rotation vector: axis times angle."""

    vector: Vector = entry("3 numbers: the axis of the rotation times its angle")
    unit: Unit = entry(UNIT)

    def rotation(self) -> Rotation:
        """Return Λ."""
        from scipy.spatial.transform import Rotation

        return rotation(Rotation.from_rotvec(self.vector, degrees=self.unit.startswith("deg")).as_matrix())


ORDERS = (axes[i:] + axes[:i] for axes in ("xyz", "XYZ") for i in range(3))
SEQUENCES = "|".join("{0}({1}[{0}{2}]?|{2}[{0}{1}]?)?".format(*order) for order in ORDERS)


class EulerRotation(Section):
    """Euler angles as SciPy has them."""

    euler: list[float] = entry("1 to 3 angles, one for each letter of the sequence", min_length=1, max_length=3)
    sequence: str = entry(
        '1 to 3 axes, neighbours different: capitals for turning axes ("ZYX"), small letters for fixed ones ("xyz"), '
        "as in scipy",
        pattern=f"^({SEQUENCES})$",
    )
    unit: Unit = entry(UNIT)

    def rotation(self) -> Rotation:
        """Return Λ."""
        from scipy.spatial.transform import Rotation

        if len(self.euler) != len(self.sequence):
            raise ValueError(f"{len(self.euler)} angles for the {len(self.sequence)} axes of {self.sequence!r}")
        return Rotation.from_euler(self.sequence, self.euler, degrees=self.unit.startswith("deg"))


class BodyVelocity(Section):
    """Angular velocity in body components."""

    body: Vector = entry(f"{IN_UNIT}: components along the directors")
    unit: RateUnit = "rad/s"


class SpaceVelocity(Section):
    """Angular velocity in space components."""

    space: Vector = entry(f"{IN_UNIT}: components along the fixed axes")
    unit: RateUnit = "rad/s"


Attitude = Annotated[MatrixRotation | QuaternionRotation | VectorRotation | EulerRotation, BY_FORM]
Velocity = Annotated[BodyVelocity | SpaceVelocity, BY_FORM]
IDENTITY = MatrixRotation(matrix=np.eye(3).tolist())


class Start(Section):
    """Attitude and angular velocity at t_start; the identity, at rest, where they are left out. Or a run to resume."""

    run: str | None = entry(
        "a result file (NetCDF), relative to the run file, in quotes: its last state, in place of rotation and "
        "angular_velocity; t_start of [time] is its last time",
        None,
        min_length=1,
    )
    sha256: str | None = entry("the hash of the result file, in quotes: another content is refused", None)
    rotation: Attitude = entry(
        "one of { matrix = [...] }, { quaternion = [...], order = ... }, { vector = [...], unit = ... }, "
        "{ euler = [...], sequence = ..., unit = ... }",
        IDENTITY,
    )
    angular_velocity: Velocity = entry(
        "{ body = [...] } or { space = [...] }: 3 numbers, {unit}, or { body = [...], unit = ... }",
        BodyVelocity(body=[0.0, 0.0, 0.0]),
        unit="rad/s",
    )
    project: bool = entry("true to remove a spin about the constrained axis, false to refuse it", False)

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


class TimesFile(Section):
    """Output times in a column of a CSV file with a line of headers."""

    file: str = entry("a CSV file in quotes, relative to the run file: headers, then rows of numbers, s", min_length=1)
    column: str | None = entry("the header of the times (s), in quotes; not needed where there is one column", None)
    sha256: str | None = entry("the hash of the CSV file, in quotes: another content is refused", None)

    def times(self, time: Time, folder: Folder) -> list[float]:
        """Return the times; a ValueError where the file cannot be read."""
        return [*self._table(folder).columns[0].tolist()]

    def recorded(self, folder: Folder) -> dict[str, Any]:
        """Return what is recorded of it: the hash of the file as it was read."""
        return self.model_dump(exclude_none=True) | {"sha256": self._table(folder).sha256}

    def _table(self, folder: Folder) -> Table:
        return folder.table(self.file, None if self.column is None else [self.column], self.sha256, 1)


class TimesEvery(Section):
    """Output times at equal distances, from the start, and the end."""

    every: Positive = entry(
        "a positive number, {unit}: output at t_start, so much later, and so on, and at t_end", unit="s"
    )

    def times(self, time: Time, folder: Folder) -> list[float]:
        """Return the times; a ValueError where they are too many."""
        ratio = (time.t_end - time.t_start) / self.every
        if not ratio < MOST_TIMES:
            raise ValueError(f"it makes {ratio:.3g} times, at most {MOST_TIMES:.0e} are possible")
        return [*(time.t_start + self.every * k for k in range(math.ceil(ratio * (1 - FIT)))), time.t_end]


class Time(Section):
    """From when to when, in which steps."""

    t_end: float = entry("a number after t_start, {unit}", unit="s")
    t_start: float = entry("a number, {unit}", 0.0, unit="s")
    step: Positive | None = entry(
        "a positive number that divides the span, {unit}; left out: at most 0.05 rad a step, or with gauss an error of "
        "1e-8 at most",
        None,
        unit="s",
    )
    tolerance: Annotated[float, Field(gt=0, le=0.1)] | None = entry(
        "a positive number up to 0.1, {unit}, in place of step: a bound of the error of the attitude, and of that of "
        "the angular velocity relative to its largest size",
        None,
        unit="rad",
    )
    store: Annotated[int, Field(ge=1)] | Literal["end"] = entry(
        'a whole number of steps >= 1, or "end" for the first and the last state only', 1
    )
    times: Annotated[TimesFile | TimesEvery | Annotated[list[float], Field(min_length=1)], BY_FORM] | None = entry(
        "increasing numbers from t_start to t_end, {unit}: output at these times, without store; or a table with the "
        "key every (s), or with the keys file and column",
        None,
        unit="s",
    )

    def output_times(self, folder: Folder) -> list[float] | None:
        """Return the output times, None where there are none; a ValueError where the file cannot be read."""
        return self.times.times(self, folder) if isinstance(self.times, (TimesFile, TimesEvery)) else self.times

    def recorded(self, folder: Folder) -> dict[str, Any]:
        """Return what is recorded in the place of `times`: the hash of the file as it was read."""
        return {"times": self.times.recorded(folder)} if isinstance(self.times, TimesFile) else {}


class Integrator(Section):
    """The integrator, its order and its own options."""

    name: Annotated[str, OneOf(INTEGRATORS, open=True)] = DEFAULT
    order: int | None = entry("a whole number: an order that the integrator has", None)
    options: dict[str, Any] = entry("a table of the integrator's own options", {})

    @classmethod
    def known(cls) -> list[str]:
        """Return the keys, and those of `options` of all integrators."""
        kinds: list[Any] = [*INTEGRATORS.values()]
        options = dict.fromkeys(key for kind in kinds for key in options_of(kind).model_fields)
        return [*super().known(), *(f"options.{key}" for key in options)]


class Output(Section):
    """Where the result goes."""

    path: str | None = entry(
        'a file name with the ending ".nc", like result.nc, relative to the run file', None, pattern=r"^[^\x00]+\.nc$"
    )
    figures: list[Literal["momenta", "energy", "path"]] = entry(
        'a list of "momenta", "energy", "path": figures drawn next to the result', []
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
    """An event, with what all kinds have in common: but for `kind`, the keys are those of the function `makes`."""

    makes: ClassVar[Callable[..., NamedEvent]]
    terminal: bool | Annotated[int, Field(ge=0)] = entry(
        "true where the run ends there, or a whole number: after how many of them", False
    )
    name: Annotated[str, Field(pattern=NAME, max_length=60)] | None = entry(
        "a text of up to 60 characters; by default axis_crosses or spin_below", None
    )

    def event(self) -> NamedEvent:
        """Return the event; a ValueError where its numbers make none."""
        return type(self).makes(**self.model_dump(exclude={"kind"}, exclude_none=True))


class AxisCrosses(EventSection):
    """An axis of the body crosses a plane, or a cone about its normal."""

    makes = axis_crosses
    kind: Literal["axis-crosses"]
    axis: Axis = entry(AN_AXIS + "components along the directors", AXES["z"])
    normal: Axis = entry(AN_AXIS + "of the plane, in space", AXES["z"])
    cosine: float = entry(
        "a number between -1 and 1: of the angle between axis and normal, 0 for the plane", 0.0, gt=-1, lt=1
    )
    direction: Literal[-1, 0, 1] = entry(DIRECTION, 0)


class SpinBelow(EventSection):
    """The angular velocity, or its part along an axis of the body, falls below a value."""

    makes = spin_below
    kind: Literal["spin-below"]
    value: Positive = entry("a positive number, {unit}", unit="rad/s")
    axis: Axis | None = entry(AN_AXIS + "components along the directors", None)
    direction: Literal[-1, 0, 1] = entry(DIRECTION, -1)


EVENTS: dict[str, type[EventSection]] = {"axis-crosses": AxisCrosses, "spin-below": SpinBelow}
AnyEvent = Annotated[EventSection, OneOf(EVENTS)]
