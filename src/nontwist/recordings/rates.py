"""Recorded angular velocities: the columns of a gyroscope, their unit, their time, and the speed of a rotor."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from ..errors import InputError, InputWarning
from ..geometry.arrays import Array
from ..geometry.values import counted, shown
from ..io.results import open_run
from ..units import RATE, known
from . import spellings
from .formats import Content
from .headers import plain, rate_unit, sensors
from .options import ReadOptions
from .reading import read_content
from .rows import of_one_sensor, own_rows
from .samples import gaps, ordered
from .table import Lines, Table, listed, place
from .times import clock

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
    warnings: tuple[InputWarning, ...]
    speed: Array | None = None
    quaternions: Array | None = None
    has_gyroscope: bool = True


def read_rates(
    source: str | os.PathLike[str] | TextIO,
    columns: Sequence[str] | None = None,
    *,
    unit: str | None = None,
    speed: str | None = None,
    speed_unit: str | None = None,
    quaternions: Array | None = None,
    **options: Any,
) -> Rates:
    """Return the angular velocity that a file holds, and the column `speed` of a rotor; see `nontwist.fit_inertia`.

    `quaternions` are the attitudes of its rows; `options` are those of `ReadOptions`.

    Raises
    ------
    InputError
        No column, or more than one set of them, holds an angular velocity; no unit is stated; no time; with what would
        help.
    OSError
        The file cannot be read.
    """
    how = ReadOptions(columns=columns, **options)
    if not (unit is None or isinstance(unit, str)):
        raise InputError("type", name="unit", words="a text", value=shown(unit))
    name = str(source) if isinstance(source, (str, os.PathLike)) else "the stream"
    if isinstance(source, (str, os.PathLike)) and Path(source).suffix.lower() in (".nc", ".nc4", ".h5"):
        if speed is not None:
            raise InputError("no-speed", speed=speed)
        run = open_run(source)
        W = run["material_angular_velocity"].values
        return cleaned(run["time"].values, W, None, name, ("rates: a run",), None, quaternions)
    content = read_content(source, how)
    how = replace(how, columns=how.columns or (content.table.headers if content.headless else None))
    return _of_content(content, how, unit, name, speed, speed_unit, quaternions)


def _of_content(
    content: Content,
    how: ReadOptions,
    unit: str | None,
    name: str,
    speed: str | None,
    speed_unit: str | None,
    quaternions: Array | None,
) -> Rates:
    """Return the angular velocity that the columns of a file hold."""
    if not content.table.columns:
        raise InputError("no-columns")
    table, how, told = (content.table, how, ()) if quaternions is not None else of_one_sensor(content.table, how)
    if how.columns is not None:
        if len(how.columns) not in (3, 4):
            raise InputError("columns", sizes="3 columns of the angular velocity", count=len(how.columns))
        table.require(*how.columns)
        three = tuple(how.columns[-3:])
        how = replace(how, time_column=how.columns[0] if len(how.columns) == 4 else how.time_column)
    else:
        three = _one(table, how.body)
    if quaternions is None:
        table, more = own_rows(table, three)
        told += more
    values = table.vectors(three)
    above = "".join(f"; {note}" for note in content.notes if note.startswith("stated above"))
    symbol = _unit(three, unit, values, above)
    time = clock(table, how)
    if time.time is None and content.time is not None and len(content.time) == len(values):
        time = replace(time, time=content.time)
    if time.time is None:
        raise InputError("no-time")
    notes = (f"angular velocity: {', '.join(three)}, {symbol}", *time.notes, *content.notes, *told)
    spun = None
    if speed is not None:
        table.require(speed)
        stated = rate_unit(speed) if speed_unit is None else known(speed_unit, RATE)
        if stated is None:
            code = "no-speed-unit" if speed_unit is None else "speed-unit"
            raise InputError(code, column=speed, unit=speed_unit, units="|".join(RATE))
        spun = table.numbers(speed) * RATE[stated]
        notes += (f"speed of the rotor: {speed}, {stated}",)
    pulls = sensors(table.headers, spellings.ACCELEROMETER)
    acceleration = None
    if pulls:
        try:
            acceleration = table.vectors(pulls[0][1])
        except ValueError:
            acceleration = None
    return cleaned(time.time, values * RATE[symbol], acceleration, name, notes, spun, quaternions, table.lines)


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
    """Return rates in the order of time without rows that are no numbers; an InputError where too few are left.

    `lines` are those of the rows in their file, by which messages name them.
    """
    if quaternions is not None and len(quaternions) != len(time):
        raise InputError("lengths", attitudes=len(quaternions), rates=len(time))
    rows, said = np.arange(len(time)), list[InputWarning]()
    bad = ~(np.isfinite(time) & np.isfinite(rates).all(axis=1))
    if bad.any():
        fields = {"rows": counted(int(bad.sum()), "row"), "place": place(rows[bad][0], lines)}
        said.append(InputWarning("missing-rates", **fields))
    kept = ordered(time, rows[~bad], said, lines)
    if len(kept) < FEWEST:
        raise InputError("too-few-samples", what="a fit", why="", left=len(kept), count=len(time), least=FEWEST)
    t, W = time[kept], rates[kept]
    said += gaps(t, kept, lines)
    fastest = float(abs(W).max())
    if fastest > FASTEST:
        said.append(InputWarning("fast", fastest=fastest))
    a = None if acceleration is None or len(acceleration) != len(time) else acceleration[kept]
    spun = None if speed is None else speed[kept]
    turned = None if quaternions is None else quaternions[kept]
    return Rates(t, W, a, name, len(time) - len(kept), notes, tuple(said), spun, turned)


def _one(table: Table, body: str | None) -> tuple[str, ...]:
    found = sensors(table.headers, spellings.GYROSCOPE)
    if body is not None:
        found = [one for one in found if one[0] == plain(body)]
    if len(found) == 1:
        return found[0][1]
    if not found:
        raise InputError("no-gyroscope", names=listed(table.headers))
    raise InputError("several-gyroscopes", sets="; ".join(", ".join(one[1]) for one in found))


def _unit(three: Sequence[str], unit: str | None, values: Any, above: str) -> str:
    """Return the unit, as told or as all headers state it."""
    units = {rate_unit(one) for one in three}
    stated = units.pop() if len(units) == 1 else None
    names = ", ".join(three)
    if unit is not None:
        given = known(unit, RATE)
        if given is None:
            raise InputError("unit", unit=unit, units=", ".join(RATE))
        if stated not in (None, given):
            raise InputError("unit-stated", names=names, stated=stated, unit=unit)
        return given
    if stated is None:
        finite = abs(values[np.isfinite(values)])
        largest = float(finite.max()) if finite.size else 0.0
        hint = f"; up to {largest:.4g}, it looks like deg/s" if largest > FASTEST else ""
        raise InputError("no-unit", names=names, hint=hint + above)
    return stated
