"""What a reader finds in a file: a table of columns by header, attitudes of bodies, or both; the rows of one sensor."""

from __future__ import annotations

import os
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, InputWarning
from ..geometry.arrays import Array, as_floats
from . import headers
from .headers import plain
from .options import ReadOptions

Lines = NDArray[np.int64]
SPARSE = 0.25  # of all rows, empty in the columns of a sensor: those of others, merged on their times
MOST_SENSORS = 64
OFTEN = 0.05  # of all rows, after which the next is of another sensor, where blocks may be parts of one motion
FAR = 5.0  # times as far from each other as neighbouring rows of one sensor are those of several


def place(row: int, lines: Lines | None) -> str:
    """Return the name of a row: ``line 19`` of a file of text, as an editor numbers it, else ``row 17``, from 0."""
    return f"row {row}" if lines is None else f"line {lines[row]}"


def listed(names: Iterable[str]) -> str:
    """Return names for a message: as many, and as much of each, as can be read."""
    shown = [name if len(name) <= 80 else f"{name[:80]}..." for name in names]
    return ", ".join(shown[:60]) + (f" and {len(shown) - 60} more" if len(shown) > 60 else "")


def number(value: object) -> float | None:
    """Return `value` as a float, or None if it is not a number; 1_000 is one in Python alone."""
    try:
        return None if isinstance(value, str) and "_" in value else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return None


def numbered(names: Iterable[str]) -> list[str]:
    """Return headers, those that repeat others with a number, as pandas gives them."""
    counts = Counter[str]()
    found = []
    for name in names:
        found.append(f"{name}.{counts[name]}" if counts[name] else name)
        counts[name] += 1
    return found


def by_name(kind: str, streams: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Return streams by their names; an InputError names those that two have."""
    found: dict[str, Any] = {}
    for name, values in streams:
        if name in found:
            raise InputError("same-name", kind=kind, name=name)
        found[name] = values
    return found


def stacked(rows: Sequence[Sequence[Any]], width: int, what: str, lines: Lines | None = None) -> Array:
    """Return rows of numbers as an array; an InputError names the first of another length, or that is no number."""
    for k, row in enumerate(rows):
        if len(row) != width:
            raise InputError("row-length", place=place(k, lines), what=what, count=len(row), width=width)
    found = [number(cell) for row in rows for cell in row]
    if None in found:
        k, column = divmod(found.index(None), width)
        raise InputError("not-a-number", what=f"the {what}", value=rows[k][column], place=place(k, lines))
    return np.array(found, dtype=float).reshape(-1, width)


@dataclass(frozen=True)
class Table:
    """Columns of equal length; `lines`, where known, are those of the rows in a file of text, from 1.

    It is `headless` where the file has no headers; they are numbers then, from 1. Columns of `thousands` have marks
    before three digits alone, as numbers above 1000 may. `scalar_first` is what lines above it state of quaternions.
    """

    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    lines: Lines | None = None
    headless: bool = False
    thousands: Sequence[str] = ()
    scalar_first: bool | None = None

    @property
    def headers(self) -> list[str]:
        """The headers, in the order of the file."""
        return list(self.columns)

    def __len__(self) -> int:
        return max((len(values) for values in self.columns.values()), default=0)

    def require(self, *names: str) -> None:
        """Raise an InputError where there is no such column, or it may hold thousands."""
        for name in names:
            if name not in self.columns:
                raise InputError("no-column", name=name, names=listed(self.columns))
            if name in self.thousands:
                raise InputError("thousands", name=name)

    def at(self, rows: NDArray[np.int64]) -> Table:
        """Return some of the rows."""
        lines = None if self.lines is None else self.lines[rows]
        return replace(self, columns={name: values[rows] for name, values in self.columns.items()}, lines=lines)

    def numbers(self, name: str) -> Array:
        """Return a column as floats; an InputError names the row that holds something else."""
        self.require(name)
        values = np.asarray(self.columns[name])
        if values.dtype.kind in "cmM":
            return as_floats(values, f"the column {name!r}")
        if values.dtype.kind in "biuf":
            return values.astype(np.float64)
        found = [np.nan if one is None else number(one) for one in values.tolist()]
        if None not in found:
            return np.array(found, dtype=float)
        bad = [k for k, one in enumerate(found) if one is None]
        # beside decimal commas, what is not a number with a point either
        k = next((k for k in bad if number(str(values[k]).replace(",", ".")) is None), bad[0])
        raise InputError("not-a-number", what=f"the column {name!r}", value=values[k], place=place(k, self.lines))

    def vectors(self, names: Sequence[str]) -> Array:
        """Return several columns, (n, k)."""
        return np.stack([self.numbers(name) for name in names], axis=1)


@dataclass(frozen=True)
class Content:
    """The content of a file.

    `table` has orientation and time by its headers, as in CSV.
    `bodies` are (n, 4) quaternions, scalar last, or (n, 3, 3) matrices Λ, by name; they map body to space, which the
    format defines where they are `directed`. `loose` are quaternions for which it does not define where the scalar is.
    `spins` are spatial angular velocities, (n, 3), rad/s, if the file states them; `time`, s, that of the samples of
    the bodies, counted from `start`, s since 1970, and `sampled` at the rate that the caller gave. `angle_unit` is
    stated for all columns. `notes` tell the conventions of the file, and what was not read. `lines` are those of the
    rows of the bodies in a file of text, from 1, by which messages name them.
    """

    table: Table = field(default_factory=Table)
    bodies: Mapping[str, Array] = field(default_factory=dict)
    loose: Mapping[str, Array] = field(default_factory=dict)
    spins: Mapping[str, Array] = field(default_factory=dict)
    time: Array | None = None
    start: float | None = None
    angle_unit: Literal["deg", "rad"] | None = None
    sampled: bool = False
    notes: tuple[str, ...] = ()
    lines: Lines | None = None
    directed: bool = True


def is_file(source: Any) -> bool:
    """Return whether a recording is to be read: from a path, a stream, or a DataFrame."""
    return isinstance(source, (str, os.PathLike)) or callable(getattr(source, "read", None)) or hasattr(source, "iloc")


def of_frame(frame: Any) -> Content:
    """Return the columns of a DataFrame."""
    columns = (frame.iloc[:, k].to_numpy() for k in range(frame.shape[1]))
    return Content(Table(dict(zip(numbered(map(str, frame.columns)), columns, strict=True))))


def of_one_sensor(table: Table, how: ReadOptions) -> tuple[Table, ReadOptions, tuple[str, ...]]:
    """Return the rows of one sensor, where a column names that of each row; an InputError asks for it."""
    lengths = [len(values) for values in table.columns.values()]
    if len(set(lengths)) > 1:  # of a workspace, of which those that hold most numbers are meant
        most = max(lengths, key=lambda count: count * lengths.count(count))
        table = replace(table, columns={name: one for name, one in table.columns.items() if len(one) == most})
    for header, values in table.columns.items():
        start, is_float = values[:1000], values.dtype.kind == "f"
        if len(values) < 2 or header == how.time_column or len(set(start.tolist())) > MOST_SENSORS:
            continue
        if is_float and not ((start == np.round(start)).mean() > 0.5 and (start != start[0]).any()):
            continue  # numbers that name sensors are whole, and few are missing
        texts = [f"{one:g}" if is_float else str(one).strip() for one in values.tolist()]
        names = {name: k for k, name in enumerate(dict.fromkeys(texts))}
        codes = np.array([names[one] for one in texts])
        if not 1 < len(names) <= MOST_SENSORS or np.median(np.bincount(codes)) < 2:
            continue
        changes, is_named = np.count_nonzero(np.diff(codes)), plain(header) in headers.SENSOR
        is_sure = is_named and changes > OFTEN * len(codes)
        if not is_sure and not ((is_named or changes > len(codes) / 2) and _jumps(table, codes, how)):
            continue
        wanted = [one for one in names if how.body and plain(how.body) in (plain(one), plain(f"{header} {one}"))]
        if len(wanted) != 1:
            raise InputError("several-sensors", header=header, names=listed(names))
        table = table.at(np.flatnonzero(codes == names[wanted[0]]))
        return table, replace(how, body=None), (f"rows: of {wanted[0]!r} in the column {header!r}",)
    first = np.arange(min(len(table), 1000))
    turns = [count for count in (2, 3, 4) if len(first) > 4 * count and _jumps(table.at(first), first % count, how)]
    if turns:
        warnings.warn(InputWarning("rows-in-turn", count=turns[0]), stacklevel=2)
    return table, how, ()


def named_columns(
    table: Table, how: ReadOptions, sizes: Sequence[int], words: str
) -> tuple[tuple[str, ...] | None, ReadOptions]:
    """Return the columns that the caller names, or of a table without headers all, and the options with their time.

    None where headers tell the columns. The time may be before those that are named.
    """
    if not table.columns:
        raise InputError("no-columns")
    names = tuple(how.columns or (table.headers if table.headless else ()))
    if not names and how.columns is None:
        return None, how
    table.require(*names)
    size = next((n for n in sizes if len(names) in (n, n + 1)), None)
    if size is None:
        code = "no-headers" if how.columns is None else "three-columns" if len(names) == 3 else "columns"
        raise InputError(code, sizes=words, count=len(names))
    is_ignored = how.columns is None and how.rate is not None
    time = names[0] if len(names) > size and not is_ignored else how.time_column
    return names[len(names) - size :], replace(how, columns=names, time_column=time)


@np.errstate(over="ignore", invalid="ignore")
def _jumps(table: Table, codes: NDArray[np.int64], how: ReadOptions) -> bool:
    """Whether rows of different sensors that are neighbours differ far more than those of one sensor."""
    found = headers.orientations(how.columns or table.headers)
    three = headers.sensors(table.headers, headers.GYROSCOPE)
    columns = found[0].headers if found else headers.angles(table.headers, "xyz") or (three[0][1] if three else ())
    try:
        values = table.vectors(columns)
    except ValueError:
        return False

    def steps(a: Array, b: Array) -> float:
        both = np.minimum(*(np.linalg.norm(b - sign * a, axis=1) for sign in (1, -1)))  # quaternions of either sign
        return float(np.nanmedian(both)) if np.isfinite(both).any() else 0.0

    own = [values[codes == k] for k in range(codes.max() + 1)]
    other = np.flatnonzero(np.diff(codes))
    within = steps(np.concatenate([one[:-1] for one in own]), np.concatenate([one[1:] for one in own]))
    return steps(values[other], values[other + 1]) > FAR * within


def own_rows(table: Table, names: Sequence[str]) -> tuple[Table, tuple[str, ...]]:
    """Return the rows in which these columns are not empty, where many rows belong to other sensors."""
    floats = {name: one for name, one in table.columns.items() if one.dtype.kind == "f"}
    if not set(names) <= set(floats) or len(table) == 0:
        return table, ()
    empty = np.isnan(np.stack([floats[name] for name in names])).all(axis=0)
    others = [one for name, one in floats.items() if name not in names and np.isnan(one).any()]
    if not SPARSE <= empty.mean() < 1 or not any(np.isfinite(one[empty]).mean() > 0.5 for one in others):
        return table, ()
    note = f"rows: {len(empty) - empty.sum()} of {len(empty)}, the others are of other sensors"
    return table.at(np.flatnonzero(~empty)), (note,)
