"""Recorded angular velocities from files: the columns of a gyroscope, their unit, and their time."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from ..analysis.conventions import vectors
from ..analysis.headers import ACCELEROMETER, GYROSCOPE, RATES, known_rate, listed, plain, rate_unit, three_axes
from ..analysis.places import Lines, naming, place
from ..analysis.samples import GAP, ordered
from ..analysis.tables import Reading
from ..analysis.time_columns import clock
from ..analysis.time_values import numbers
from ..geometry.arrays import Array
from ..geometry.values import counted
from .readers import Content
from .recordings import content_of, reading_of
from .results import open_run

FASTEST = 80.0  # rad/s, 4600 °/s: more than common gyroscopes measure
FEWEST = 12  # samples


@dataclass(frozen=True)
class Rates:
    """Angular velocities as recorded, bad rows left out: times, s, rates, (n, 3), rad/s, acceleration as in the file.

    `speed` is that of a rotor, (n,), rad/s, where a column of it is named; `quaternions`, (n, 4), are attitudes
    recorded beside, nan where there is none, or alone, and then `has_gyroscope` is False and rates follow from them.
    `notes` tell what was taken for what, `warnings` what is wrong with it, `left_out` counts rows.
    """

    time: Array
    rates: Array
    acceleration: Array | None
    name: str
    left_out: int
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    speed: Array | None = None
    quaternions: Array | None = None
    has_gyroscope: bool = True


def read_rates(
    source: str | os.PathLike[str] | TextIO,
    columns: Sequence[str] | None = None,
    *,
    time_column: str | None = None,
    body: str | None = None,
    unit: str | None = None,
    time_unit: str | None = None,
    rate: float | None = None,
    speed: str | None = None,
    speed_unit: str | None = None,
    quaternions: Array | None = None,
) -> Rates:
    """Return the angular velocity that a file holds, and the column `speed` of a rotor; see `nontwist.fit_inertia`.

    `quaternions` are the attitudes of its rows.

    Raises
    ------
    ValueError
        No column, or more than one set of them, holds an angular velocity; no unit is stated; no time; with what would
        help.
    OSError
        The file cannot be read.
    """
    words = {"time_column": time_column, "body": body, "unit": unit, "time_unit": time_unit}
    how = reading_of(columns, rate, {key: value for key, value in words.items() if key != "unit"}, {})
    if not (unit is None or isinstance(unit, str)):
        raise ValueError(f"unit must be a text, one of {', '.join(RATES)}")
    name = str(source) if isinstance(source, (str, os.PathLike)) else "the stream"
    if isinstance(source, (str, os.PathLike)) and Path(source).suffix.lower() in (".nc", ".nc4", ".h5"):
        if speed is not None:
            raise ValueError(f"a run has no column {speed!r}; give the speed of the rotor as a number, rad/s")
        run = open_run(source)
        W = run["material_angular_velocity"].values
        return cleaned(run["time"].values, W, None, name, ("rates: a run",), None, quaternions)
    content = content_of(source, how)
    with naming(content.lines):
        return _of_table(content, how, columns or content.chosen, unit, name, speed, speed_unit, quaternions)


def _of_table(
    content: Content,
    how: Reading,
    chosen: Sequence[str] | None,
    unit: str | None,
    name: str,
    speed: str | None,
    speed_unit: str | None,
    quaternions: Array | None,
) -> Rates:
    """Return the angular velocity that the columns of a file hold."""
    table, time_column = content.columns, how.time_column
    if not table:
        raise ValueError("it has no columns that could contain an angular velocity")
    if chosen is not None:
        if len(chosen) not in (3, 4):
            raise ValueError(f"name 3 columns of the angular velocity, the time before them; got {len(chosen)}")
        missing = [one for one in chosen if one not in table]
        if missing:
            raise ValueError(f"there is no column {missing[0]!r}; there are {listed(table)}")
        three = tuple(chosen[-3:])
        time_column = chosen[0] if len(chosen) == 4 else time_column
    else:
        three = _one(list(table), how.body)
    values = np.stack([numbers(table, one) for one in three], axis=1)
    symbol = _unit(three, unit, values)
    told = clock(table, time_column, how.time_unit, how.rate, len(values))
    time = told.time
    if time is None and content.time is not None and len(content.time) == len(values):
        time = content.time
    if time is None:
        raise ValueError("it has no time column; --rate HZ (rate=) gives times, --time-column (time_column=) names one")
    notes = (f"angular velocity: {', '.join(three)}, {symbol}", *told.notes, *content.notes)
    spun = None
    if speed is not None:
        spun, stated = _speed(table, speed, speed_unit)
        notes += (f"speed of the rotor: {speed}, {stated}",)
    acceleration = vectors(table, ACCELEROMETER)
    return cleaned(time, values * RATES[symbol], acceleration, name, notes, spun, quaternions, content.lines)


def cleaned(
    time: Array,
    rates: Array,
    acceleration: Array | None,
    name: str,
    notes: tuple[str, ...],
    speed: Array | None = None,
    quaternions: Array | None = None,
    lines: Lines | None = None,
) -> Rates:
    """Return rates in the order of time without rows that are no numbers; a ValueError where too few are left.

    `lines` are those of the rows in their file, by which messages name them.
    """
    if quaternions is not None and len(quaternions) != len(time):
        raise ValueError(
            f"there are {len(quaternions)} attitudes and {len(time)} angular velocities: both need the same times"
        )
    rows, said = np.arange(len(time)), list[str]()
    bad = ~(np.isfinite(time) & np.isfinite(rates).all(axis=1))
    if bad.any():
        first = place(rows[bad][0], lines)
        said.append(f"dropped {counted(bad.sum(), 'row')} without finite numbers, the first is {first}")
    kept = ordered(time, rows[~bad], said, lines)
    if len(kept) < FEWEST:
        raise ValueError(f"{len(kept)} of {len(time)} rows can be used; a fit needs at least {FEWEST}")
    t, W = time[kept], rates[kept]
    step = np.diff(t)
    wide = np.flatnonzero(step > GAP * np.median(step))
    if wide.size:
        k = int(wide[np.argmax(step[wide])])
        said.append(
            f"{counted(wide.size, 'gap')} longer than {GAP:g} sampling intervals, the longest of {step[k]:.4g} s at "
            f"t = {t[k]:.6g} s"
        )
    fastest = float(abs(W).max())
    if fastest > FASTEST:
        said.append(
            f"angular velocities of up to {fastest:.4g} rad/s are more than common gyroscopes measure: is the unit "
            "right?"
        )
    a = None if acceleration is None or len(acceleration) != len(time) else acceleration[kept]
    spun = None if speed is None else speed[kept]
    turned = None if quaternions is None else quaternions[~bad][kept]
    return Rates(t, W, a, name, len(time) - len(kept), notes, tuple(said), spun, turned)


def _speed(table: Mapping[str, Any], column: str, unit: str | None) -> tuple[Array, str]:
    """Return the speed of a rotor, rad/s, and the unit that it was recorded in."""
    if column not in table:
        raise ValueError(f"there is no column {column!r} for the speed of the rotor; there are {listed(table)}")
    symbol = rate_unit(column) if unit is None else known_rate(unit)
    if symbol is None:
        what = f"the column {column!r} does not state its unit" if unit is None else f"unknown unit of speed {unit!r}"
        raise ValueError(f"{what}: give unit={'|'.join(RATES)} among the settings of the rotor")
    return numbers(table, column) * RATES[symbol], symbol


def _one(headers: Sequence[str], body: str | None) -> tuple[str, ...]:
    found = three_axes(headers, GYROSCOPE)
    if body is not None:
        found = [one for one in found if one[0] == plain(body)]
    if len(found) == 1:
        return found[0][1]
    if not found:
        raise ValueError(
            f"no columns contain an angular velocity (gx gy gz, gyr_x gyr_y gyr_z, wx wy wz): {listed(headers)}; name "
            "three with --columns (columns=), or fit attitudes: --orientation only (orientation=)"
        )
    raise ValueError(
        f"more than one set of columns contains an angular velocity ({'; '.join(', '.join(one[1]) for one in found)}); "
        "name three with --columns (columns=)"
    )


def _unit(three: Sequence[str], unit: str | None, values: Any) -> str:
    """Return the unit, as told or as all headers state it."""
    stated = {rate_unit(one) for one in three}
    known = stated.pop() if len(stated) == 1 else None
    if unit is not None:
        given = known_rate(unit)
        if given is None:
            raise ValueError(f"unknown unit of angular velocity {unit!r}; known are {', '.join(RATES)}")
        if known not in (None, given):
            raise ValueError(
                f"the columns {', '.join(three)} state {known}, but --unit (unit=) says {unit}; omit the option, or "
                "rename the columns"
            )
        return given
    if known is None:
        finite = abs(values[np.isfinite(values)])
        largest = float(finite.max()) if finite.size else 0.0
        hint = f"; up to {largest:.4g}, it looks like deg/s" if largest > FASTEST else ""
        raise ValueError(
            f"the columns {', '.join(three)} do not state their unit: use --unit (unit=) rad/s or deg/s{hint}"
        )
    return known
