"""Recorded angular velocities: the columns of a gyroscope, their unit, their time, and the speed of a rotor."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from ..errors import InputError, InputWarning
from ..geometry.arrays import Array, as_floats
from ..geometry.values import shown
from ..io.results import open_run
from ..units import RATE, known
from . import spellings
from .checks import sensor, stated_rate
from .headers import plain, rate_unit, sensors
from .motions import kept_rows
from .options import ReadOptions
from .reading import read_content
from .table import Lines, Table, listed, named_columns, of_one_sensor, own_rows
from .times import clock

FASTEST = 80.0  # rad/s, 4600 °/s: more than common gyroscopes measure
FEWEST = 12  # samples
COLUMNS = ("time", "rates", "acceleration", "speed", "quaternions")


@dataclass(frozen=True)
class Rates:
    """Angular velocities as recorded: times, s, rates, (n, 3), rad/s, acceleration as in the file.

    `speed` is that of a rotor, (n,), rad/s, where a column of it is named; `quaternions`, (n, 4), are attitudes
    recorded beside, nan where there is none, or alone, and then `has_gyroscope` is False and rates follow from them.
    `notes` tell what was taken for what, `warnings` what is wrong with it, `left_out` counts rows.
    """

    time: Array
    rates: Array
    name: str
    notes: tuple[str, ...]
    acceleration: Array | None = None
    speed: Array | None = None
    quaternions: Array | None = None
    left_out: int = 0
    warnings: tuple[InputWarning, ...] = ()
    has_gyroscope: bool = True

    def cleaned(self, lines: Lines | None = None) -> Rates:
        """Return rates in the order of time without rows that are no numbers; an InputError where too few are left.

        `lines` are those of the rows in their file, by which messages name them.
        """
        if self.quaternions is not None and len(self.quaternions) != len(self.time):
            raise InputError("lengths", attitudes=len(self.quaternions), rates=len(self.time))
        good = np.asarray(np.isfinite(self.rates).all(axis=1))
        rows, said = kept_rows(self.time, good, lines, "missing-rates", "a fit", FEWEST)
        if (fastest := float(abs(self.rates[rows]).max())) > FASTEST:
            said.append(InputWarning("fast", fastest=fastest))
        columns = {name: getattr(self, name) for name in COLUMNS}
        kept: dict[str, Any] = {name: one[rows] for name, one in columns.items() if one is not None}
        return replace(self, **kept, left_out=len(good) - len(rows), warnings=tuple(said))


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
        return of_run(open_run(source), name, quaternions)
    content = read_content(source, how)
    table, how, told = (content.table, how, ()) if quaternions is not None else of_one_sensor(content.table, how)
    three, how = named_columns(table, how, (3,), "3 columns of the angular velocity")
    three = three or _one(table, how.body)
    if quaternions is None:
        table, more = own_rows(table, three)
        told += more
    values = table.vectors(three)
    above = "".join(f"; {note}" for note in content.notes if note.startswith("stated above"))
    symbol = _unit(three, unit, values, above)
    time = clock(table, how)
    if time.time is None and content.time is not None and len(content.time) == len(values):
        time = replace(time, time=content.time, notes=("time: as the format defines, s",))
    if time.time is None:
        raise InputError("no-time")
    notes = (f"angular velocity: {', '.join(three)}, {symbol}", *time.notes, *content.notes, *told)
    spun = None
    if speed is not None:
        table.require(speed)
        turning = _agreed(speed_unit, rate_unit(speed), "speed-unit", speed)
        if turning is None:
            raise InputError("no-speed-unit", column=speed, units="|".join(RATE))
        spun = table.numbers(speed) * RATE[turning]
        notes += (f"speed of the rotor: {speed}, {turning}",)
    acceleration, _ = sensor(table, spellings.ACCELEROMETER)
    return Rates(time.time, values * RATE[symbol], name, notes, acceleration, spun, quaternions).cleaned(table.lines)


def of_run(run: Any, name: str, quaternions: Array | None) -> Rates:
    """Return the angular velocity in a run of one body, or in what `sensors.gyroscope` returns."""
    known = next((key for key in ("gyroscope", "material_angular_velocity") if key in run.variables), "")
    if not known or "time" not in run.variables or set(run[known].dims) != {"time", "director"}:
        words = "must be what sensors.gyroscope returns, or a run of one body; this Dataset has"
        raise ValueError(f"{name} {words} {', '.join(map(str, run))}")
    time, W = as_floats(run["time"].values, "time"), as_floats(run[known].transpose("time", "director").values, known)
    return Rates(time, W, name, (f"rates: {known}",), quaternions=quaternions).cleaned()


def _one(table: Table, body: str | None) -> tuple[str, ...]:
    there = sensors(table.headers, spellings.GYROSCOPE)
    found = [three for before, three in there if body is None or before == plain(body)]
    if len(found) != 1:
        sets = "; ".join(map(", ".join, found))
        raise InputError("several-gyroscopes" if found else "no-gyroscope", names=listed(table.headers), sets=sets)
    return found[0]


def _agreed(unit: str | None, stated: str | None, code: str, names: str) -> str | None:
    """Return the unit of rates, as told or as headers state it; an InputError where it is unknown, or these differ."""
    found = stated if unit is None else known(unit, RATE)
    if unit is not None and found is None:
        raise InputError(code, unit=unit, units=", ".join(RATE))
    if stated not in (None, found):
        raise InputError(f"{code}-stated", names=names, stated=stated, unit=unit)
    return found


def _unit(three: Sequence[str], unit: str | None, values: Array, above: str) -> str:
    """Return the unit, as told or as all headers state it."""
    names = ", ".join(three)
    if (found := _agreed(unit, stated_rate(three), "unit", names)) is None:
        largest = abs(values).max(where=np.isfinite(values), initial=0.0)
        hint = f"; up to {largest:.4g}, it looks like deg/s" if largest > FASTEST else ""
        raise InputError("no-unit", names=names, hint=hint + above)
    return found
