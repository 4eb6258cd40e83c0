"""The rows of one sensor, in a table that several share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from . import headers, spellings
from .headers import plain
from .options import ReadOptions
from .table import Table, listed

SPARSE = 0.25  # of all rows, empty in the columns of a sensor: those of others, merged on their times
MOST_SENSORS = 64


def of_one_sensor(table: Table, how: ReadOptions) -> tuple[Table, ReadOptions, tuple[str, ...]]:
    """Return the rows of one sensor, where a column names that of each row; an InputError asks for it."""
    for header, values in table.columns.items():
        is_named = plain(header) in spellings.SENSOR
        if values.dtype.kind == "f" or not len(values) > 1 or header == how.time_column:
            continue
        texts = np.array([str(one).strip() for one in values.tolist()], dtype=object)
        if len(set(texts[:1000])) > MOST_SENSORS:
            continue
        names = list(dict.fromkeys(texts))
        codes = np.vectorize({name: k for k, name in enumerate(names)}.get)(texts)
        changes = np.count_nonzero(np.diff(codes))
        if not 1 < len(names) <= MOST_SENSORS or changes < len(names) or np.bincount(codes).min() < 2:
            continue
        if not is_named and not (changes > len(codes) / 2 and _jumps(table, codes)):
            continue
        wanted = [
            k
            for k, name in enumerate(names)
            if how.body is not None and plain(how.body) in (plain(name), plain(f"{header} {name}"))
        ]
        if len(wanted) == 1:
            table = table.at(np.flatnonzero(codes == wanted[0]))
            return table, replace(how, body=None), (f"rows: of {names[wanted[0]]!r} in the column {header!r}",)
        raise InputError("several-sensors", header=header, names=listed(names))
    return table, how, ()


def _jumps(table: Table, codes: NDArray[np.int64]) -> bool:
    """Whether the numbers of neighbouring rows differ far more than those of the rows of one sensor."""
    found = headers.orientations(table.headers)
    three = headers.sensors(table.headers, spellings.GYROSCOPE)
    columns = found[0].headers if found else three[0][1] if three else ()
    try:
        values = table.vectors(columns) if columns else np.zeros((len(codes), 1))
    except ValueError:
        return False
    own = np.concatenate([np.diff(values[codes == k], axis=0) for k in range(codes.max() + 1)])
    across, within = (np.nanmedian(np.linalg.norm(one, axis=1)) for one in (np.diff(values, axis=0), own))
    return bool(across > 5 * within)


def own_rows(table: Table, names: Sequence[str]) -> tuple[Table, tuple[str, ...]]:
    """Return the rows in which these columns are not empty, where many rows belong to other sensors."""
    columns = [table.columns[name] for name in names]
    if not all(one.dtype.kind == "f" for one in columns) or len(table) == 0:
        return table, ()
    empty = np.isnan(np.stack(columns)).all(axis=0)
    others = [one for name, one in table.columns.items() if name not in names and one.dtype.kind == "f"]
    if not SPARSE <= empty.mean() < 1 or not any(
        np.isfinite(one[empty]).mean() > 0.5 and np.isnan(one).any() for one in others
    ):
        return table, ()
    note = f"rows: {len(empty) - empty.sum()} of {len(empty)}, the others are of other sensors"
    return table.at(np.flatnonzero(~empty)), (note,)
