"""Orientation in the columns of a table: found by header, in any case and order.

Known are a time (``t``, ``time``, ``timestamp``, with a unit in brackets), quaternions (``w x y z`` with any prefix
that the four share: ``qw``, ``quat_w``, ``orientation.w``), nine matrix elements of Λ (``r11 ... r33``,
``m00 ... m22``) and directors (``d1_x ... d3_z``).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry.arrays import Array, as_floats, as_plain

UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
TIMES = ("t", "time", "timestamp", "seconds", "secs", "sec")
_HEADER = re.compile(r"^\s*(?P<name>.*?)\s*(?:[\[(](?P<unit>[^\])]*)[\])])?\s*$")


def table_motion(
    columns: Mapping[str, NDArray[np.generic]],
    scalar_first: bool | None = None,
    chosen: Sequence[str] | None = None,
    time_unit: str | None = None,
) -> tuple[Array, Array | None]:
    """Return ``(values, time)`` of a table.

    Parameters
    ----------
    columns : mapping of header to (n,) array
    scalar_first : bool, optional
        Order of quaternions whose names do not state it (``q0 q1 q2 q3``, or `chosen`).
    chosen : sequence of str, optional
        Headers of the 4 or 9 columns to take, the time before them where there is one (5 or 10).
    time_unit : str, optional
        Of the time column, where its header has none or a wrong one; s by default.

    Returns
    -------
    values : (n, 4) quaternions, scalar last, or (n, 3, 3) matrices Λ
    time : (n,) array, s, or None

    Raises
    ------
    ValueError
        No orientation, more than one candidate, a column that is missing or not numeric, an unknown unit.
    """
    if chosen is not None:
        names, time_name = _chosen(columns, chosen)
        ordered = len(names) == 9
    else:
        time_name = _time_column(columns)
        names, ordered = _orientation_columns([name for name in columns if name != time_name])
    values = np.stack([_numbers(columns, name) for name in names], axis=1)
    time = None if time_name is None else _seconds(columns, time_name, time_unit)
    if len(names) == 9:
        return values.reshape(-1, 3, 3), time
    if not ordered:
        if scalar_first is None:
            raise ValueError(f"the columns {', '.join(names)} do not say where the scalar is: scalar first or last?")
        if scalar_first:
            values = np.roll(values, -1, axis=1)
    return values, time


def _chosen(columns: Mapping[str, object], chosen: Sequence[str]) -> tuple[list[str], str | None]:
    missing = [name for name in chosen if name not in columns]
    if missing:
        raise ValueError(f"there is no column {missing[0]!r}; there are {', '.join(columns)}")
    if len(chosen) not in (4, 5, 9, 10):
        raise ValueError(f"name 4 (quaternion) or 9 (matrix) columns, the time before them; got {len(chosen)}")
    has_time = len(chosen) in (5, 10)
    return list(chosen[has_time:]), chosen[0] if has_time else None


def _parts(header: str) -> tuple[str, str | None]:
    match = _HEADER.match(header)
    assert match is not None
    return match["name"].lower(), match["unit"]


def table_time(columns: Mapping[str, NDArray[np.generic]], time_unit: str | None = None) -> Array | None:
    """Return the time column of a table, s, or None where there is none."""
    name = _time_column(columns)
    return None if name is None else _seconds(columns, name, time_unit)


def _time_column(columns: Mapping[str, object]) -> str | None:
    found = [name for name in columns if _parts(name)[0] in TIMES]
    if len(found) > 1:
        raise ValueError(f"more than one column may be the time: {', '.join(found)}; name the columns to take")
    return found[0] if found else None


def _orientation_columns(headers: Sequence[str]) -> tuple[list[str], bool]:
    """Return four or nine headers, and whether their order is known (x, y, z, w or row by row)."""
    names = {header: re.sub(r"[\s_.\-]", "", _parts(header)[0]) for header in headers}
    found: list[tuple[list[str], bool]] = []
    for letters, ordered in (("xyzw", True), ("0123", False)):
        for prefix in {name[:-1] for name in names.values() if name}:
            group = [[h for h, name in names.items() if name == prefix + letter] for letter in letters]
            if all(len(one) == 1 for one in group) and (ordered or prefix.startswith("q")):
                found.append(([one[0] for one in group], ordered))
    for first, order in ((1, "123"), (0, "012")):
        for prefix in {name[:-2] for name in names.values() if len(name) > 2}:
            cells = [f"{prefix}{i}{j}" for i in order for j in order]
            group = [[h for h, name in names.items() if name == cell] for cell in cells]
            if all(len(one) == 1 for one in group) and not (first == 0 and prefix == "q"):
                found.append(([one[0] for one in group], True))
    directors = [f"d{i}{x}" for x in "xyz" for i in "123"]
    group = [[h for h, name in names.items() if name == cell] for cell in directors]
    if all(len(one) == 1 for one in group):
        found.append(([one[0] for one in group], True))
    if len(found) != 1:
        many = "more than one set of columns holds" if found else "no columns hold"
        raise ValueError(
            f"{many} an orientation (qw qx qy qz, or r11 ... r33): {', '.join(headers)}; name the columns to take"
        )
    return found[0]


def _numbers(columns: Mapping[str, NDArray[np.generic]], name: str) -> Array:
    values = np.asarray(columns[name])
    if values.dtype.kind in "cmM":
        return as_floats(values, f"the column {name!r}")
    try:
        return values.astype(np.float64)
    except (TypeError, ValueError):
        bad = [number(value) is None for value in values.tolist()]
    k = int(np.argmax(bad))
    raise ValueError(f"the column {name!r} holds {values[k]!r} in row {k}, which is not a number")


def number(value: object) -> float | None:
    """Return `value` as a float, None where it is no number."""
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return None


def _seconds(columns: Mapping[str, NDArray[np.generic]], name: str, unit: str | None) -> Array:
    values = np.asarray(columns[name])
    if values.dtype.kind in "mM":
        return seconds(values)
    given = unit if unit is not None else _parts(name)[1]
    if given is not None and given.strip().lower() not in UNITS:
        raise ValueError(f"unknown unit of time {given!r} in the column {name!r}; known are {', '.join(UNITS)}")
    return _numbers(columns, name) * UNITS[(given or "s").strip().lower()]


def seconds(times: ArrayLike) -> Array:
    """Return times as float seconds; dates and durations count from the first."""
    values = as_plain(times, "time")
    if values.dtype.kind in "mM" and values.ndim == 1 and values.size:
        durations = values - values[0]
        return np.where(np.isnat(values), np.nan, durations / np.timedelta64(1, "s"))
    return as_floats(times, "time")
