"""What a reader found in a file, made into attitudes with their time, or into angular velocities."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..analysis.variables import Described, assembled, labelled
from ..errors import InputError, InputWarning
from ..geometry.arrays import Array, DataArray, as_floats, in_order
from ..geometry.values import short_repr
from ..io.run_files import open_run
from ..io.whole import require_regular
from ..machine import free_memory
from ..spec import takes
from ..units import RATE, known
from .conventions import sensor
from .formats import BEGINNINGS, READERS
from .headers import ACCELEROMETER, GYROSCOPE, plain, rate_unit, sensors
from .motions import kept_rows
from .options import ReadOptions, require_plain
from .orientations import Motion, of_bodies, of_table
from .table import Content, Lines, Table, listed, named_columns, of_frame, of_one_sensor, own_rows
from .text import read_text
from .times import clock

BINARY = {".npy", ".npz", ".mat", ".c3d", ".bag", ".mcap", ".db3", ".nc", ".nc4", ".h5"}
SHARE = 0.5  # of the free memory that a file may have
FASTEST = 80.0  # rad/s, 4600 °/s: more than common gyroscopes measure
FEWEST = 12  # samples
JUMP = 3.0  # times the largest steps: beyond it zeros are lost rows
COLUMNS = ("time", "rates", "acceleration", "speed", "quaternions")


@takes(ReadOptions)
def read_motion(source: Any, columns: Sequence[str] | None = None, **options: Any) -> DataArray:
    r"""Read a recorded motion from a file, as input of `twist` and `rotation`.

    Parameters
    ----------
    source : path, text stream or DataFrame
        CSV in its dialects, OpenSim (.sto, .mot), Xsens MVNX, BVH, NumPy (.npy, .npz), MATLAB (.mat), C3D, ROS bags,
        SPICE kernels (.tm), Gyroflow (.gcsv), or runs of this package (.nc); a stream is CSV.
    {ReadOptions}

    Returns
    -------
    DataArray
        `quaternion` (time, quat), scalar last, or `directors` (time, director, axis), with the time, s, where there is
        one. Rows that are missing are NaN. The attribute `notes` states how each column was read, which rows are
        missing, and what confirms the reading; `start` is what the time counts from, s since 1970, where dates are
        known, or of the day. Of text files, the coordinate `line` is that of each sample, by which messages name it.

    Raises
    ------
    InputError
        No orientation is found, or more than one; several readings fit; the content is invalid; an option has no
        effect. The message states the place and the option that would help.
    ImportError
        The library that reads the format is not installed; the message names the extra that installs it.
    OSError
        The file cannot be read; it is a FIFO or a device.

    Warns
    -----
    InputWarning
        A gyroscope, an accelerometer, angular velocities or another form of the orientation in the file contradict
        headers, format or options: which reading is taken, and how well each agrees.

    Examples
    --------
    >>> import io
    >>> from nontwist import read_motion, twist
    >>> recording = io.StringIO("roll (deg),pitch (deg),yaw (deg)\n0,0,0\n0,0,40\n0,0,80")
    >>> motion = read_motion(recording, euler="ZYX", rate=10)
    >>> twist(motion).twist_angle.values.round(6)
    array([0.        , 0.698132, 1.396263])
    """
    how = ReadOptions(columns=columns, **options)
    content = read_content(source, how)
    is_of_format = bool(content.bodies or content.loose) and not columns
    return _array((of_bodies if is_of_format else of_table)(content, how))


def read_content(source: Any, how: ReadOptions) -> Content:
    """Return what the reader of a file, or of a stream of text, finds in it.

    A file that does not fit into memory, or that changes while it is read, is refused.
    """
    if callable(getattr(source, "read", None)):
        return read_text(source, how)
    if hasattr(source, "columns") and hasattr(source, "iloc"):
        return of_frame(source)
    if not isinstance(source, (str, os.PathLike)):
        raise InputError("source", value=short_repr(source))
    path = Path(source)
    if path.is_dir() and (path / "metadata.yaml").exists():
        return READERS[".db3"](path, how)
    require_regular(path)
    with open(path, "rb") as file:
        start = file.read(4096)
    if not start:
        raise InputError("no-content")
    suffix = path.suffix.lower()
    if suffix not in READERS:
        found = next((one for magic, one in BEGINNINGS.items() if start.lstrip().startswith(magic)), suffix)
        if isinstance(found, str):
            suffix = found
        elif suffix != ".xlsx":
            raise InputError(found[0], packed=found[1])
        if suffix not in READERS and b"\x00" in start and start[:2] not in (b"\xff\xfe", b"\xfe\xff"):
            raise InputError("unknown-format", suffix=path.suffix, known=", ".join(READERS))
    before = os.stat(path)
    if before.st_size > SHARE * (free := free_memory()):
        raise InputError("too-large", size=before.st_size / 1e9, free=free / 1e9)
    try:
        content = READERS.get(suffix, read_text)(path, how)
    except InputError:
        if suffix in BINARY and all(32 <= byte < 127 or byte in b"\t\r\n" for byte in start):
            raise InputError("text-inside", suffix=suffix) from None
        raise
    after = os.stat(path)
    if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
        raise InputError("file-changed")
    return content


def _array(motion: Motion) -> DataArray:
    values, time, lines, start = motion.values, motion.time, motion.lines, motion.start
    is_quaternion, along = values.shape[-1] == 4, "sample" if time is None else "time"
    dims = (along, "quat") if is_quaternion else (along, "director", "axis")
    name, array = ("quaternion", values) if is_quaternion else ("directors", np.swapaxes(values, 1, 2))
    attrs = {"units": "1", "notes": "; ".join(motion.notes)} | ({} if start is None else {"start": start})
    found: dict[str, Described] = {name: (dims, array, attrs)}
    if lines is not None:
        found["line"] = ((along,), lines, {"units": "1", "long_name": "line of the file, from 1"})
    return assembled(labelled(found, **({} if time is None else {"time": time})), {})[name]


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
    is_read: bool = True  # by a sensor, which has a range

    def cleaned(self, lines: Lines | None = None) -> Rates:
        """Return rates in the order of time without rows that are no numbers; an InputError where too few are left.

        `lines` are those of the rows in their file, by which messages name them.
        """
        if self.quaternions is not None and len(self.quaternions) != len(self.time):
            raise InputError("lengths", attitudes=len(self.quaternions), rates=len(self.time))
        good = np.asarray(np.isfinite(self.rates).all(axis=1)) & ~_zeros_in_motion(self.rates)
        rows, said = kept_rows(self.time, good, lines, "missing-rates", "a fit", FEWEST)
        if (fastest := float(abs(self.rates[rows]).max())) > FASTEST:
            said.append(InputWarning("fast", fastest=fastest))
        columns = {name: getattr(self, name) for name in COLUMNS}
        kept: dict[str, Any] = {name: one[rows] for name, one in columns.items() if one is not None}
        return replace(self, **kept, left_out=len(good) - len(rows), warnings=tuple(said))


def _zeros_in_motion(rates: Array) -> NDArray[np.bool_]:
    """Whether rows are zeros in place of lost ones: a body neither stops nor goes on within one step."""
    zero = np.asarray(~rates.any(axis=1))
    steps = np.linalg.norm(np.diff(rates, axis=0), axis=1)
    others = steps[np.isfinite(steps) & ~zero[1:] & ~zero[:-1]]
    most = JUMP * float(np.quantile(others, 0.99)) if others.size else np.inf
    far, lost = np.concatenate([[False], steps > most, [False]]), np.zeros(len(rates), dtype=bool)
    runs = np.flatnonzero(np.diff(np.concatenate([[False], zero, [False]]))).reshape(-1, 2)
    for first, last in runs[far[runs].all(axis=1)]:
        lost[first:last] = True
    return lost


def read_rates(
    source: Any,
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
        raise InputError("type", name="unit", words="a text", value=short_repr(unit))
    name = str(source) if isinstance(source, (str, os.PathLike)) else "the table"
    if isinstance(source, (str, os.PathLike)) and Path(source).suffix.lower() in (".nc", ".nc4", ".h5"):
        if speed is not None:
            raise InputError("no-speed", speed=speed)
        require_plain({"columns": columns, "unit": unit, **options})
        return of_run(open_run(source), name, quaternions)
    content = read_content(source, how)
    table, how, told = (content.table, how, ()) if quaternions is not None else of_one_sensor(content.table, how)
    three, how = named_columns(table, how, (3,), "3 columns of the angular velocity")
    three = three or _one(table, None if {how.body} == {*content.bodies} else how.body)
    if quaternions is None:
        table, more = own_rows(table, three)
        told += more
    values = table.vectors(three)
    largest = abs(values).max(where=np.isfinite(values), initial=0.0)
    hint = f"; up to {largest:.4g}, it looks like deg/s" if largest > FASTEST else ""
    hint += "".join(f"; {note}" for note in content.notes if note.startswith("stated above"))
    symbol = _unit(three, unit, "unit", hint)
    time = clock(table, how)
    if time.time is None and content.time is not None and len(content.time) == len(values):
        time = replace(time, time=content.time, notes=("time: as the format defines, s",))
    if time.time is None:
        raise InputError("no-time")
    notes = (f"angular velocity: {', '.join(three)}, {symbol}", *time.notes, *content.notes, *told)
    spun = None
    if speed is not None:
        table.require(speed)
        turning = _unit([speed], speed_unit, "speed-unit")
        spun = table.numbers(speed) * RATE[turning]
        notes += (f"speed of the rotor: {speed}, {turning}",)
    acceleration, _ = sensor(table, ACCELEROMETER)
    return Rates(time.time, values * RATE[symbol], name, notes, acceleration, spun, quaternions).cleaned(table.lines)


def of_run(run: Any, name: str, quaternions: Array | None) -> Rates:
    """Return the angular velocity in a run of one body, or in what `sensors.gyroscope` returns."""
    known = next((key for key in ("gyroscope", "material_angular_velocity") if key in run.variables), "")
    if not known or "time" not in run.variables or set(run[known].dims) != {"time", "director"}:
        words = "must be what sensors.gyroscope returns, or a run of one body; this Dataset has"
        raise ValueError(f"{name} {words} {', '.join(map(str, run))}")
    time, W = (
        as_floats(run["time"].values, "time"),
        as_floats(in_order(run[known]).transpose("time", "director").values, known),
    )
    return Rates(time, W, name, (f"rates: {known}",), quaternions=quaternions, is_read=known == "gyroscope").cleaned()


def _one(table: Table, body: str | None) -> tuple[str, ...]:
    there = sensors(table.headers, GYROSCOPE)
    found = [three for before, three in there if body is None or plain(body) in (before, plain(three[0])[:-1])]
    if there and not found:
        names = list(filter(None, (before for before, _ in there)))
        raise InputError("no-body" if names else "no-bodies", body=body, names=listed(names))
    if len(found) != 1:
        sets = "; ".join(map(", ".join, found))
        raise InputError("several-gyroscopes" if found else "no-gyroscope", names=listed(table.headers), sets=sets)
    return found[0]


def speed_factor(unit: str | None) -> float:
    """Return the factor to rad/s of a speed that is given as numbers, by default rad/s."""
    return RATE[_unit([], "rad/s" if unit is None else unit, "speed-unit")]


def _unit(headers: Sequence[str], unit: str | None, code: str, hint: str = "") -> str:
    """Return the unit of rates, as told or as headers state it; an InputError where none is known, or these differ."""
    stated, names = rate_unit(*headers), ", ".join(headers)
    found = stated if unit is None else known(unit, RATE)
    if unit is not None and found is None:
        raise InputError(code, unit=unit, units=", ".join(RATE))
    if found is None:
        raise InputError(f"no-{code}", names=names, hint=hint, units="|".join(RATE))
    if stated not in (None, found):
        raise InputError(f"{code}-stated", names=names, stated=stated, unit=unit)
    return found
