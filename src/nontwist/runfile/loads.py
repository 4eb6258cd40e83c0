"""The tables ``[[load]]``: external moments, forces on directors and potentials as data; they add up.

`LOADS` is the visible list: a new kind is one class and one line. The schema, the messages, `nontwist check` and sweeps
read it at each use.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple, get_args

import numpy as np
from pydantic import Discriminator, Field, Tag

from ..geometry.values import Registry, shown
from ..loads import (
    Load,
    body_moment,
    damping,
    dipole,
    director_forces,
    gravity_gradient,
    potential,
    pulse,
    rotor,
    sine,
    space_moment,
    spring,
)
from .csv_table import Table as CsvTable
from .folder import Folder
from .section import AN_AXIS, Axis, Matrix, OneOf, Positive, Section, Vector, by_shape

FACTOR = "a number that the moment is multiplied by"
HASH = "the hash of the CSV file, in quotes: another content is refused"
FRAME = '"body" (components along the moving directors) or "space" (along fixed axes)'


class Place(NamedTuple):
    """The folder and the time span of a run file, for loads that depend on them."""

    folder: Folder
    t_start: float
    t_end: float


class LoadSection(Section):
    """A load; `error_key` is the key that a message names if the load cannot be made, unless `wrong_key` differs."""

    error_key: ClassVar[str]
    needs_times: ClassVar[bool] = False  # whether it depends on t_start and t_end
    if TYPE_CHECKING:
        kind: str

    @abstractmethod
    def load(self, place: Place) -> Load:
        """Return the load; a ValueError if it cannot be made."""

    @property
    def wrong_key(self) -> str:
        """The key that a message names."""
        return self.error_key

    def in_words(self, folder: Folder) -> str:
        """Describe the load in a preview, by its kind."""
        return self.kind

    def recorded(self, folder: Folder) -> dict[str, Any]:
        """Return what is recorded in addition to the keys that were given."""
        return {}


class Scaled(LoadSection):
    """A load with a factor `scale`, in which the members of a sweep that are computed together may differ."""

    if TYPE_CHECKING:
        scale: float

    def load(self, place: Place) -> Load:
        """Return the load."""
        return self.scale * self.unscaled(place)

    @abstractmethod
    def unscaled(self, place: Place) -> Load:
        """Return the load for the scale 1."""


class Moment(Scaled):
    """A load that is a function of time, along moving or fixed directions."""

    frame: Literal["body", "space"] = Field(description=FRAME)
    scale: float = Field(default=1.0, description=FACTOR)

    def table(self, times: Any, values: Any) -> Load:
        """Return the load that is linear between `times`."""
        return (body_moment if self.frame == "body" else space_moment)(times, values)


class Constant(Moment):
    """A constant moment, from start to end, or during the whole run."""

    error_key = "end"
    needs_times = True
    kind: Literal["constant"]
    moment: Vector = Field(description="3 numbers, N m")
    start: float | None = Field(default=None, description="a number, s; the start of the run by default")
    end: float | None = Field(default=None, description="a number after start, s; the end of the run by default")

    def unscaled(self, place: Place) -> Load:
        """Return the load."""
        start = place.t_start if self.start is None else self.start
        end = place.t_end if self.end is None else self.end
        return pulse(self.moment, start, end, shape="rectangle", frame=self.frame)


class Table(Moment):
    """A table, linear between its times and zero outside."""

    error_key = "times"
    kind: Literal["table"]
    times: Annotated[list[float], Field(min_length=2)] = Field(description="2 or more increasing numbers, s")
    values: list[Vector] = Field(description="rows of 3 numbers, N m, one for each time")

    def unscaled(self, place: Place) -> Load:
        """Return the load."""
        if len(self.times) != len(self.values):
            raise ValueError(f"{len(self.times)} times, but {len(self.values)} rows of values")
        return self.table(self.times, self.values)


class Pulse(Moment):
    """A moment of fixed direction that lasts from start to end."""

    error_key = "end"
    kind: Literal["pulse"]
    amplitude: Vector = Field(description="3 numbers, N m: the peak")
    start: float = Field(default=0.0, description="a number, s")
    end: float = Field(description="a number after start, s")
    shape: Literal["triangle", "rectangle", "half-sine"] = Field(
        default="triangle", description='"triangle", "rectangle" or "half-sine"'
    )

    def unscaled(self, place: Place) -> Load:
        """Return the load."""
        return pulse(self.amplitude, self.start, self.end, shape=self.shape, frame=self.frame)


class Sine(Moment):
    """The moment amplitude sin(2π frequency t + phase)."""

    error_key = "frequency"
    kind: Literal["sine"]
    amplitude: Vector = Field(description="3 numbers, N m: the peak")
    frequency: Positive = Field(description="a positive number, Hz")
    phase: float = Field(default=0.0, description="a number, rad")

    def unscaled(self, place: Place) -> Load:
        """Return the load."""
        return sine(self.amplitude, self.frequency, phase=self.phase, frame=self.frame)


class Csv(Moment):
    """A table in a CSV file with a line of headers: time and three components."""

    error_key = "file"
    kind: Literal["csv"]
    file: str = Field(
        min_length=1,
        description="a CSV file in quotes, relative to the run file: headers, then rows of numbers, s and N m",
    )
    columns: Annotated[list[str], Field(min_length=4, max_length=4)] | None = Field(
        default=None,
        description="4 headers: the time (s), then the components (N m); not needed where there are 4 columns",
    )
    sha256: str | None = Field(default=None, description=HASH)

    def unscaled(self, place: Place) -> Load:
        """Return the load."""
        t, *m = place.folder.table(self.file, self.columns, self.sha256).columns
        return self.table(t, np.stack(m, axis=1))

    def in_words(self, folder: Folder) -> str:
        """Return the kind of load, and the extent of its table."""
        t, *m = folder.table(self.file, self.columns, self.sha256).columns
        peak = abs(self.scale) * max(float(abs(one).max()) for one in m)
        return f"csv ({self.file}: {len(t)} rows, {t[0]:g} s to {t[-1]:g} s, up to {peak:.3g} N m along an axis)"

    def recorded(self, folder: Folder) -> dict[str, Any]:
        """Return the hash of the file as it was read."""
        return {"sha256": folder.table(self.file, self.columns, self.sha256).sha256}


class Damping(LoadSection):
    """Viscous damping, -Λ C Λᵀ w."""

    error_key = "coefficient"
    kind: Literal["damping"]
    coefficient: Annotated[
        Annotated[float, Tag("<number>")] | Annotated[Vector, Tag("<values>")] | Annotated[Matrix, Tag("<rows>")],
        Discriminator(by_shape),
    ] = Field(description="N m s, not negative: a number, 3 numbers along the directors, or 3 rows of 3 numbers")
    scale: float = Field(default=1.0, description=FACTOR)

    def load(self, place: Place) -> Load:
        """Return the load."""
        return self.scale * damping(self.coefficient)


class Rotor(Scaled):
    """A rotor that turns about an axis of the body, of constant momentum or of a table: a gyrostat."""

    error_key = "momentum"
    kind: Literal["rotor"]
    axis: Axis = Field(description=AN_AXIS + "a direction in the body")
    momentum: float | None = Field(default=None, description="a number, kg m² s⁻¹, in place of times and values")
    file: str | None = Field(
        default=None,
        min_length=1,
        description="a CSV file in quotes, relative to the run file, in place of times and values: headers, then rows "
        "of numbers, s and kg m² s⁻¹",
    )
    columns: Annotated[list[str], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="2 headers: the time (s) and the momentum (kg m² s⁻¹); not needed where there are 2"
    )
    sha256: str | None = Field(default=None, description=HASH)
    times: Annotated[list[float], Field(min_length=2)] | None = Field(
        default=None, description="2 or more increasing numbers, s"
    )
    values: list[float] | None = Field(
        default=None, description="a momentum for each time, kg m² s⁻¹; constant before the first and after the last"
    )
    scale: float = Field(default=1.0, description="a number that the momentum is multiplied by")

    def unscaled(self, place: Place) -> Load:
        """Return the load for the scale 1."""
        given = {name for name in ("momentum", "file", "times", "values") if getattr(self, name) is not None}
        if self.file is None and (self.columns is not None or self.sha256 is not None):
            raise ValueError("columns and sha256 are of a file")
        if self.momentum is not None and given == {"momentum"}:
            return rotor(self.axis, self.momentum)
        if given == {"file"}:
            return rotor(self.axis, *self._table(place.folder).columns)
        if given != {"times", "values"}:
            raise ValueError("a rotor has a momentum, or times and values, or a file")
        assert self.times is not None
        assert self.values is not None
        if len(self.times) != len(self.values):
            raise ValueError(f"{len(self.times)} times, but {len(self.values)} values")
        return rotor(self.axis, self.times, self.values)

    @property
    def wrong_key(self) -> str:
        """The key that a message names."""
        return "momentum" if self.file is None else "file"

    def _table(self, folder: Folder) -> CsvTable:
        assert self.file is not None
        return folder.table(self.file, self.columns, self.sha256, 2)

    def in_words(self, folder: Folder) -> str:
        """Return the kind of load, and the extent of its table."""
        if self.file is None:
            return self.kind
        t, h = self._table(folder).columns
        peak = abs(self.scale) * float(abs(h).max())
        return f"rotor ({self.file}: {len(t)} rows, {t[0]:g} s to {t[-1]:g} s, up to {peak:.3g} kg m² s⁻¹)"

    def recorded(self, folder: Folder) -> dict[str, Any]:
        """Return the hash of the file as it was read."""
        return {} if self.file is None else {"sha256": self._table(folder).sha256}


class DirectorForces(LoadSection):
    """Forces on the three directors, linear between its times and zero outside."""

    error_key = "times"
    kind: Literal["director_forces"]
    frame: Literal["body", "space"] = Field(description=FRAME)
    scale: float = Field(default=1.0, description="a number that the forces are multiplied by")
    times: Annotated[list[float], Field(min_length=2)] = Field(description="2 or more increasing numbers, s")
    values: list[Matrix] = Field(description="3 rows of 3 numbers for each time, N m: the forces on d1, d2, d3")

    def load(self, place: Place) -> Load:
        """Return the load."""
        if len(self.times) != len(self.values):
            raise ValueError(f"{len(self.times)} times, but {len(self.values)} sets of values")
        return self.scale * director_forces(self.times, self.values, frame=self.frame)


class Potential(LoadSection):
    """The potential linear·γ + γ·quadratic γ / 2 of a space vector seen from the body, γ = Λᵀ vector."""

    error_key = "quadratic"
    kind: Literal["potential"]
    vector: Vector = Field(description="3 numbers: a vector in space")
    linear: Vector = Field(
        default=[0.0, 0.0, 0.0], description="3 numbers along the directors, J per unit of the vector"
    )
    quadratic: Matrix = Field(
        default=[[0.0] * 3] * 3, description="3 rows of 3 numbers, symmetric, J per unit of the vector squared"
    )
    scale: float = Field(default=1.0, description="a number that the potential is multiplied by")

    def load(self, place: Place) -> Load:
        """Return the load."""
        return self.scale * potential(self.vector, linear=self.linear, quadratic=self.quadratic)


class Spring(LoadSection):
    """A spring between a point of the body and one of space."""

    error_key = "rest_length"
    kind: Literal["spring"]
    stiffness: Positive = Field(description="a positive number, N/m")
    point: Vector = Field(description="3 numbers, m: from the fixed point, along the directors")
    anchor: Vector = Field(description="3 numbers, m: from the fixed point, in space")
    rest_length: float = Field(default=0.0, description="a number, not negative, m")
    scale: float = Field(default=1.0, description=FACTOR)

    def load(self, place: Place) -> Load:
        """Return the load."""
        return self.scale * spring(self.stiffness, self.point, self.anchor, self.rest_length)


class Dipole(LoadSection):
    """A dipole of the body in a uniform field."""

    error_key = "moment"
    kind: Literal["dipole"]
    moment: Vector = Field(description="3 numbers along the directors, A m² or C m")
    field: Vector = Field(description="3 numbers in space, T or V/m")
    scale: float = Field(default=1.0, description=FACTOR)

    def load(self, place: Place) -> Load:
        """Return the load."""
        return self.scale * dipole(self.moment, self.field)


class GravityGradient(LoadSection):
    """The gravity gradient on a circular orbit."""

    error_key = "normal"
    kind: Literal["gravity_gradient"]
    mean_motion: Positive = Field(description="a positive number, rad/s")
    radial: Axis = Field(default=[1.0, 0.0, 0.0], description=AN_AXIS + "the radius at start, in space")
    normal: Axis = Field(default=[0.0, 0.0, 1.0], description=AN_AXIS + "the normal of the orbit, in space")
    start: float = Field(default=0.0, description="a number, s")
    scale: float = Field(default=1.0, description=FACTOR)

    def load(self, place: Place) -> Load:
        """Return the load."""
        return self.scale * gravity_gradient(self.mean_motion, self.radial, self.normal, self.start)


def unregistrable(kind: str, table: type[LoadSection]) -> str | None:
    """Return why a class cannot be the table of this kind, and what to do; None if it can."""
    if not (isinstance(table, type) and issubclass(table, LoadSection)):
        return f"LOADS[{kind!r}] must be a subclass of LoadSection, as Scaled is; got {shown(table)}"
    if get_args(table.model_fields["kind"].annotation if "kind" in table.model_fields else None) != (kind,):
        return f'LOADS[{kind!r}] is the class {table.__name__}, which lacks the line kind: Literal["{kind}"]: add it'
    return None


LOADS: Registry[type[LoadSection]] = Registry(
    {
        "constant": Constant,
        "table": Table,
        "pulse": Pulse,
        "sine": Sine,
        "csv": Csv,
        "damping": Damping,
        "rotor": Rotor,
        "director_forces": DirectorForces,
        "potential": Potential,
        "spring": Spring,
        "dipole": Dipole,
        "gravity_gradient": GravityGradient,
    },
    unregistrable,
    "give the load another kind",
)
AnyLoad = Annotated[LoadSection, OneOf(LOADS, open=True)]
