"""The tables ``[[load]]``: external moments, forces on directors and potentials as data; they add up.

The table of an entry of `nontwist.loads.LOADS` follows from its fields. Those below take what is no field: files, the
time span, numbers in several forms. The schema, the messages, `nontwist check` and sweeps read all at each use.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import MISSING
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple, get_args, get_origin

import numpy as np
from pydantic import Discriminator, Field, Tag, create_model

from ..loads import LOADS, Load, Term, body_moment, damping, dipole, pulse, rotor, space_moment
from ..loads.terms import FRAME, ForceTerm, own_fields
from ..spec import Spec, specs
from .folder import Folder
from .folder import Table as CsvTable
from .section import AN_AXIS, Axis, Matrix, OneOf, Positive, Section, Vector, by_shape

HASH = "the hash of the CSV file, in quotes: another content is refused"


class Place(NamedTuple):
    """The folder and the time span of a run file, for loads that depend on them."""

    folder: Folder
    t_start: float
    t_end: float


class LoadSection(Section):
    """A load; `error_key` is the key that a message names if the load cannot be made, unless `wrong_key` differs.

    If it `is_swept`, the members of a sweep that differ in its factor are computed together.
    """

    error_key: ClassVar[str]
    needs_times: ClassVar[bool] = False  # whether it depends on t_start and t_end
    is_swept: ClassVar[bool] = True
    if TYPE_CHECKING:
        kind: str
    scale: float = Field(default=1.0, description="a number that the load is multiplied by")

    def load(self, place: Place) -> Load:
        """Return the load; a ValueError if it cannot be made."""
        return self.scale * self.unscaled(place)

    @abstractmethod
    def unscaled(self, place: Place) -> Load:
        """Return the load for the scale 1."""

    @property
    def wrong_key(self) -> str:
        """The key that a message names."""
        return self.error_key

    @property
    def is_lasting(self) -> bool:
        """Whether it begins or ends with the run."""
        return False

    def in_words(self, folder: Folder) -> str:
        """Describe the load in a preview, by its kind."""
        return self.kind

    def recorded(self, folder: Folder) -> dict[str, Any]:
        """Return what is recorded in addition to the keys that were given."""
        return {}


class Moment(LoadSection):
    """A load that is a function of time, along moving or fixed directions."""

    frame: Literal["body", "space"] = Field(description=FRAME)


class Constant(Moment):
    """A constant moment, from start to end, or during the whole run."""

    error_key = "end"
    needs_times = True
    kind: Literal["constant"]
    moment: Vector = Field(description="3 numbers, N m")
    start: float | None = Field(default=None, description="a number, s; the start of the run by default")
    end: float | None = Field(default=None, description="a number after start, s; the end of the run by default")

    @property
    def is_lasting(self) -> bool:
        """Whether it begins or ends with the run."""
        return None in (self.start, self.end)

    def unscaled(self, place: Place) -> Load:
        """Return the load."""
        start = place.t_start if self.start is None else self.start
        end = place.t_end if self.end is None else self.end
        return pulse(self.moment, start, end, shape="rectangle", frame=self.frame)


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
        return (body_moment if self.frame == "body" else space_moment)(t, np.stack(m, axis=1))

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
    is_swept = False
    kind: Literal["damping"]
    coefficient: Annotated[
        Annotated[float, Tag("<number>")] | Annotated[Vector, Tag("<values>")] | Annotated[Matrix, Tag("<rows>")],
        Discriminator(by_shape),
    ] = Field(description="N m s, not negative: a number, 3 numbers along the directors, or 3 rows of 3 numbers")

    def unscaled(self, place: Place) -> Load:
        """Return the load."""
        return damping(self.coefficient)


class Rotor(LoadSection):
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
        times: Any = self.times
        return rotor(self.axis, times, self.values)

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


class Dipole(LoadSection):
    """A dipole of the body in a uniform field."""

    error_key = "moment"
    is_swept = False
    kind: Literal["dipole"]
    moment: Vector = Field(description="3 numbers along the directors, A m² or C m")
    field: Vector = Field(description="3 numbers in space, T or V/m")

    def unscaled(self, place: Place) -> Load:
        """Return the load."""
        return dipole(self.moment, self.field)


class OfTerm(LoadSection):
    """A load that is one term, whose fields are the keys."""

    makes: ClassVar[type[Term]]

    def unscaled(self, place: Place) -> Load:
        """Return the load."""
        return self.makes(**{name: getattr(self, key) for name, key in keys_of(self.makes).items()}).load


MADE: dict[str, type[LoadSection]] = {
    "constant": Constant,
    "csv": Csv,
    "damping": Damping,
    "rotor": Rotor,
    "dipole": Dipole,
}


def keys_of(cls: type[Term]) -> dict[str, str]:
    """Return the key in run files of each field of a term."""
    return {name: spec.option or name for name, (_, _, spec) in specs(cls).items()}


@cache
def table_of(kind: str, cls: type[Term]) -> type[LoadSection]:
    """Return the table of a term: a key for each field that has a `Spec`."""
    keys: dict[str, Any] = {"kind": (Literal[kind], ...)}
    keys_of_fields, required = keys_of(cls), list[str]()
    for name, (form, default, spec) in specs(cls).items():
        given = {} if default is MISSING else {"default": _plain(default)}
        described = Field(description=accepted(form, spec), **given)
        kind_of_key = type_of(form, spec) if default is not None else type_of(form, spec) | None
        keys[keys_of_fields[name]] = Annotated[kind_of_key, spec], described
        required += [keys_of_fields[name]] * (default is MISSING)
    made = create_model(cls.__name__, __base__=OfTerm, __doc__=cls.__doc__, __module__=cls.__module__, **keys)
    made.makes, made.error_key, made.is_swept = cls, required[-1], not issubclass(cls, ForceTerm)
    return made


def _plain(default: Any) -> Any:
    """Return a default of a field as TOML has it."""
    return [*map(_plain, default)] if isinstance(default, (tuple, list, np.ndarray)) else default


def type_of(form: Any, spec: Spec) -> Any:
    """Return the type of a key from that of a field and its description."""
    if get_origin(form) is Literal:
        return form
    if spec.rule.startswith("direction"):
        return Axis
    found: Any = Positive if spec.rule == "positive" else float
    for n in reversed(spec.shape):
        least, most = (n, n) if isinstance(n, int) else (2 if spec.rule == "increasing" else None, None)
        found = Annotated[list[found], Field(min_length=least, max_length=most)]
    return found


def accepted(form: Any, spec: Spec) -> str:
    """Return what a key accepts, in words."""
    if get_origin(form) is Literal:
        *first, last = map('"{}"'.format, get_args(form))
        return spec.text or f"{', '.join(first)} or {last}"
    if spec.rule.startswith("direction"):
        return AN_AXIS + spec.text
    number = "a positive number" if spec.rule == "positive" else "a number"
    words = "2 or more increasing numbers" if spec.rule == "increasing" else "numbers" if spec.shape else number
    for n in reversed(spec.shape):
        if isinstance(n, int):
            words = f"{n} {words}" if words == "numbers" else f"{n} rows of {words}"
        elif words != "numbers" and spec.rule != "increasing":
            words = f"rows of {words}" if len(spec.shape) == 2 else f"{words} for each"
    words += f", {spec.rule}" * (spec.rule in ("not negative", "from 0 and below 1")) + f", {spec.unit}" * bool(
        spec.unit
    )
    return words + f": {spec.text}" * bool(spec.text)


class Tables(Mapping[str, type[LoadSection]]):
    """The tables by their kinds: those above, and those of the entries of `nontwist.loads.LOADS` that are data."""

    def __iter__(self) -> Iterator[str]:
        data = [kind for kind, cls in LOADS.items() if own_fields(cls)[0] in specs(cls)]
        return iter(dict.fromkeys([*MADE, *data]))

    def __len__(self) -> int:
        return len(list(iter(self)))

    def __getitem__(self, kind: str) -> type[LoadSection]:
        return MADE[kind] if kind in MADE else table_of(kind, LOADS[kind])


AnyLoad = Annotated[LoadSection, OneOf(Tables(), open=True)]
