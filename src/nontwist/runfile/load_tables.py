"""The tables ``[[load]]``: external moments, forces on directors and potentials as data; they add up.

The table of an entry of `nontwist.loads.LOADS` follows from its fields. Those below take what is no field: files, the
time span, numbers in several forms. The schema, the messages, `nontwist check` and sweeps read all at each use.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import create_model

from ..geometry.values import MadeByName
from ..loads import LOADS, Load, Term, body_moment, damping, dipole, pulse, rotor, space_moment
from ..loads.terms import EVER, FRAME, ForceTerm, own_fields
from ..spec import specs
from .files import Folder, Table
from .section import AN_AXIS, BY_FORM, Axis, Matrix, OneOf, Section, Vector, entry, key_of

FILE = "a CSV file in quotes, relative to the run file: headers, then rows of numbers"
HASH = "the hash of the CSV file, in quotes: another content is refused"


class LoadSection(Section):
    """A load; a message names `error_key` if the load cannot be made and the reason names no other key.

    If it `is_swept`, the members of a sweep that differ in its factor are computed together.
    """

    makes: ClassVar[Callable[..., Load]]
    error_key: ClassVar[str]
    is_swept: ClassVar[bool] = True
    if TYPE_CHECKING:
        kind: str
    scale: float = entry("a number that the load is multiplied by", 1.0)

    def load(self, folder: Folder) -> Load:
        """Return the load; a ValueError if it cannot be made."""
        return self.scale * self.unscaled(folder)

    def unscaled(self, folder: Folder) -> Load:
        """Return the load for the scale 1: what `makes` makes of the keys."""
        return type(self).makes(**self.model_dump(exclude={"kind", "scale"}, exclude_none=True))

    def in_words(self, folder: Folder) -> str:
        """Describe the load in a preview, by its kind."""
        return self.kind

    def recorded(self, folder: Folder) -> dict[str, Any]:
        """Return what is recorded in addition to the keys that were given."""
        return {}


class Constant(LoadSection):
    """A constant moment, from start to end, or during the whole run."""

    error_key = "end"
    frame: Literal["body", "space"] = entry(FRAME)
    kind: Literal["constant"]
    moment: Vector = entry("3 numbers, {unit}", unit="N m")
    start: float | None = entry("a number, {unit}; the start of the run by default", None, unit="s")
    end: float | None = entry("a number after start, {unit}; the end of the run by default", None, unit="s")

    def unscaled(self, folder: Folder) -> Load:
        """Return the load."""
        start, end = -EVER if self.start is None else self.start, EVER if self.end is None else self.end
        return pulse(self.moment, start, end, shape="rectangle", frame=self.frame)


class Tabled(LoadSection):
    """A load that may be a table in a CSV file with a line of headers."""

    quantity: ClassVar[str]  # of its values, with the unit
    count: ClassVar[int]  # of its columns
    if TYPE_CHECKING:
        file: str | None
        columns: list[str] | None
        sha256: str | None

    def table(self, folder: Folder) -> Table:
        """Return the columns, times and values; a ValueError where the file cannot be read."""
        assert self.file is not None
        return folder.table(self.file, self.columns, self.sha256, self.count)

    def in_words(self, folder: Folder) -> str:
        """Return the kind of load, and the extent of its table."""
        if self.file is None:
            return self.kind
        t, *values = self.table(folder).columns
        peak = abs(self.scale) * max(float(abs(one).max()) for one in values)
        return f"{self.kind} ({self.file}: {len(t)} rows, {t[0]:g} s to {t[-1]:g} s, up to {peak:.3g} {self.quantity})"

    def recorded(self, folder: Folder) -> dict[str, Any]:
        """Return the hash of the file as it was read."""
        return {} if self.file is None else {"sha256": self.table(folder).sha256}


class Csv(Tabled):
    """A table in a CSV file with a line of headers: time and three components."""

    error_key, quantity, count = "file", "N m along an axis", 4
    frame: Literal["body", "space"] = entry(FRAME)
    kind: Literal["csv"]
    file: str = entry(f"{FILE}, s and N m", min_length=1)
    columns: list[str] | None = entry(
        "4 headers: the time (s), then the components (N m); not needed where there are 4 columns",
        None,
        min_length=4,
        max_length=4,
    )
    sha256: str | None = entry(HASH, None)

    def unscaled(self, folder: Folder) -> Load:
        """Return the load."""
        t, *m = self.table(folder).columns
        return (body_moment if self.frame == "body" else space_moment)(t, np.stack(m, axis=1))


class Damping(LoadSection):
    """Viscous damping, -Λ C Λᵀ w."""

    makes, error_key, is_swept = damping, "coefficient", False
    kind: Literal["damping"]
    coefficient: Annotated[float | Vector | Matrix, BY_FORM] = entry(
        "{unit}, not negative: a number, 3 numbers along the directors, or 3 rows of 3 numbers", unit="N m s"
    )


class Rotor(Tabled):
    """A rotor that turns about an axis of the body, of constant momentum or of a table: a gyrostat."""

    quantity, count = "kg m² s⁻¹", 2
    kind: Literal["rotor"]
    axis: Axis = entry(AN_AXIS + "a direction in the body")
    momentum: float | None = entry("a number, {unit}, in place of times and values", None, unit="kg m² s⁻¹")
    file: str | None = entry(
        "a CSV file in quotes, relative to the run file, in place of times and values: headers, then rows of numbers, "
        "s and kg m² s⁻¹",
        None,
        min_length=1,
    )
    columns: list[str] | None = entry(
        "2 headers: the time (s) and the momentum (kg m² s⁻¹); not needed where there are 2",
        None,
        min_length=2,
        max_length=2,
    )
    sha256: str | None = entry(HASH, None)
    times: list[float] | None = entry("2 or more increasing numbers, {unit}", None, min_length=2, unit="s")
    values: list[float] | None = entry(
        "a momentum for each time, {unit}; constant before the first and after the last", None, unit="kg m² s⁻¹"
    )

    @property
    def error_key(self) -> str:  # type: ignore[override]
        """The key that a message names."""
        return "momentum" if self.file is None else "file"

    def unscaled(self, folder: Folder) -> Load:
        """Return the load for the scale 1."""
        given = {name for name in ("momentum", "file", "times", "values") if getattr(self, name) is not None}
        if self.file is None and (self.columns is not None or self.sha256 is not None):
            raise ValueError("columns and sha256 are of a file")
        if given == {"file"}:
            return rotor(self.axis, *self.table(folder).columns)
        if given not in ({"momentum"}, {"times", "values"}):
            raise ValueError("a rotor has a momentum, or times and values, or a file")
        momentum: Any = self.times if self.momentum is None else self.momentum
        return rotor(self.axis, momentum, self.values)


class Dipole(LoadSection):
    """A dipole of the body in a uniform field."""

    makes, error_key, is_swept = dipole, "moment", False
    kind: Literal["dipole"]
    moment: Vector = entry("3 numbers along the directors, A m² or C m")
    field: Vector = entry("3 numbers in space, T or V/m")


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
    names, required = keys_of(cls), list[str]()
    for name, (form, default, spec) in specs(cls).items():
        keys[names[name]] = key_of(form, default, spec)
        required += [names[name]] * (default is MISSING)

    def load_of(**given: Any) -> Load:
        return cls(**{name: given[key] for name, key in names.items() if key in given}).load

    made = create_model(cls.__name__, __base__=LoadSection, __doc__=cls.__doc__, __module__=cls.__module__, **keys)
    made.makes, made.error_key, made.is_swept = load_of, required[-1], not issubclass(cls, ForceTerm)
    return made


def known_kinds() -> dict[str, None]:
    """Return the kinds of loads: those above, and those of the entries of `nontwist.loads.LOADS` that are data."""
    return dict.fromkeys([*MADE, *(kind for kind, cls in LOADS.items() if own_fields(cls)[0] in specs(cls))])


TABLES = MadeByName(known_kinds, lambda kind: MADE.get(kind) or table_of(kind, LOADS[kind]))
AnyLoad = Annotated[LoadSection, OneOf(TABLES, open=True)]
