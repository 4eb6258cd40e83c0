"""The rows of one sensor, in a table that several share."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, InputWarning
from ..geometry.arrays import Array
from . import headers, spellings
from .headers import plain
from .options import ReadOptions
from .table import Table, listed

SPARSE = 0.25  # of all rows, empty in the columns of a sensor: those of others, merged on their times
MOST_SENSORS = 64
OFTEN = 0.05  # of all rows, after which the next is of another sensor, where blocks may be parts of one motion
FAR = 5.0  # times as far from each other as neighbouring rows of one sensor are those of several


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
