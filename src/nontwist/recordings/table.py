"""A table of a recording: columns by header, the rows of one sensor, and where each row is in its file."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, InputWarning
from ..geometry.arrays import Array, as_floats
from . import headers, spellings
from .headers import plain
from .options import ReadOptions

Lines = NDArray[np.int64]
Rows = NDArray[np.int64] | NDArray[np.bool_]
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
    """Return `value` as a float, or None if it is not a number."""
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return None


@dataclass(frozen=True)
class Table:
    """Columns of equal length; `lines`, where known, are those of the rows in a file of text, from 1.

    It is `headless` where the file has no headers; they are numbers then, from 1.
    """

    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    lines: Lines | None = None
    headless: bool = False

    @property
    def headers(self) -> list[str]:
        """The headers, in the order of the file."""
        return list(self.columns)

    def __len__(self) -> int:
        return max((len(values) for values in self.columns.values()), default=0)

    def require(self, *names: str) -> None:
        """Raise an InputError where there is no such column."""
        for name in names:
            if name not in self.columns:
                raise InputError("no-column", name=name, names=listed(self.columns))

    def at(self, rows: Rows) -> Table:
        """Return some of the rows."""
        lines = None if self.lines is None else self.lines[rows]
        return replace(self, columns={name: values[rows] for name, values in self.columns.items()}, lines=lines)

    def numbers(self, name: str) -> Array:
        """Return a column as floats; an InputError names the row that holds something else."""
        self.require(name)
        values = np.asarray(self.columns[name])
        if values.dtype.kind in "cmM":
            return as_floats(values, f"the column {name!r}")
        try:
            return values.astype(np.float64)
        except (TypeError, ValueError):
            bad = np.array([number(one) is None for one in values.tolist()])
        # beside decimal commas, what is not a number with a point either
        worse = bad & [number(str(one).replace(",", ".")) is None for one in values.tolist()]
        k = int(np.argmax(worse if worse.any() else bad))
        raise InputError("not-a-number", what=f"the column {name!r}", value=values[k], place=place(k, self.lines))

    def vectors(self, names: Sequence[str]) -> Array:
        """Return several columns, (n, k)."""
        return np.stack([self.numbers(name) for name in names], axis=1)


def of_one_sensor(table: Table, how: ReadOptions) -> tuple[Table, ReadOptions, tuple[str, ...]]:
    """Return the rows of one sensor, where a column names that of each row; an InputError asks for it."""
    for header, values in table.columns.items():
        if len(values) < 2 or header == how.time_column:
            continue
        start, is_float = values[:1000], values.dtype.kind == "f"
        if is_float and not ((start == np.round(start)).mean() > 0.5 and (start != start[0]).any()):
            continue  # numbers that name sensors are whole, and few are missing
        if len(set(start.tolist())) > MOST_SENSORS:
            continue
        texts = np.array([f"{one:g}" if is_float else str(one).strip() for one in values.tolist()], dtype=object)
        names = list(dict.fromkeys(texts))
        codes = np.vectorize({name: k for k, name in enumerate(names)}.get)(texts)
        if not 1 < len(names) <= MOST_SENSORS or np.median(np.bincount(codes)) < 2:
            continue
        changes, is_named = np.count_nonzero(np.diff(codes)), plain(header) in spellings.SENSOR
        is_sure = is_named and changes > OFTEN * len(codes)
        if not is_sure and not ((is_named or changes > len(codes) / 2) and _jumps(table, codes, how)):
            continue
        told = [(plain(name), plain(f"{header} {name}")) for name in names]
        wanted = [k for k, both in enumerate(told) if how.body is not None and plain(how.body) in both]
        if len(wanted) == 1:
            table = table.at(np.flatnonzero(codes == wanted[0]))
            return table, replace(how, body=None), (f"rows: of {names[wanted[0]]!r} in the column {header!r}",)
        raise InputError("several-sensors", header=header, names=listed(names))
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
    if size is None and how.columns is None:
        raise InputError("no-headers", count=len(names))
    if size is None:
        raise InputError("three-columns" if len(names) == 3 else "columns", sizes=words, count=len(names))
    time = names[0] if len(names) > size else how.time_column
    return names[len(names) - size :], replace(how, columns=names, time_column=time)


@np.errstate(over="ignore", invalid="ignore")
def _jumps(table: Table, codes: NDArray[np.int64], how: ReadOptions) -> bool:
    """Whether rows of different sensors that are neighbours differ far more than those of one sensor."""
    found = headers.orientations(how.columns or table.headers)
    three = headers.sensors(table.headers, spellings.GYROSCOPE)
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
    columns = [table.columns[name] for name in names]
    if not all(one.dtype.kind == "f" for one in columns) or len(table) == 0:
        return table, ()
    empty = np.isnan(np.stack(columns)).all(axis=0)
    others = [one for name, one in table.columns.items() if name not in names and one.dtype.kind == "f"]
    is_sparse = SPARSE <= empty.mean() < 1
    if not is_sparse or not any(np.isfinite(one[empty]).mean() > 0.5 and np.isnan(one).any() for one in others):
        return table, ()
    note = f"rows: {len(empty) - empty.sum()} of {len(empty)}, the others are of other sensors"
    return table.at(np.flatnonzero(~empty)), (note,)
