"""Recorded motions from files: what a reader found, made into attitudes with their time."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TextIO

import numpy as np
from numpy.typing import NDArray

from ..analysis.conventions import verdict
from ..analysis.headers import listed, orientations, plain
from ..analysis.motions import MEASURED
from ..analysis.places import Lines, naming, place
from ..analysis.tables import Reading, Recorded, scalar_place, table_motion
from ..analysis.time_columns import clock, ignored
from ..analysis.variables import assembled, coordinates
from ..geometry.arrays import Array, as_positive
from ..geometry.values import counted, shown
from .readers import READERS, Content
from .readers.text import read_text
from .regular import require_regular

if TYPE_CHECKING:
    import xarray

UNCHECKED = (
    "direction: taken as sensor to earth, which nothing in the file confirms; --inverse (inverse=True) reads earth to "
    "sensor"
)
DEFINED = (
    "direction: body to space, as the format defines, which nothing in the file confirms; --inverse (inverse=True) "
    "reads space to body"
)
RARE = 0.1  # of all rows: so few that are no rotations are damaged, not rounded
BINARY = {".npy", ".npz", ".mat", ".c3d", ".bag", ".mcap", ".db3", ".nc", ".nc4", ".h5"}


def read_motion(
    source: str | os.PathLike[str] | TextIO,
    columns: Sequence[str] | None = None,
    *,
    time_column: str | None = None,
    body: str | None = None,
    scalar_first: bool | None = None,
    euler: str | None = None,
    rotation_vector: bool = False,
    angle_unit: Literal["deg", "rad"] | None = None,
    time_unit: str | None = None,
    rate: float | None = None,
    normalize: bool = False,
    inverse: bool = False,
) -> xarray.DataArray:
    r"""Read a recorded motion from a file, as input of `twist` and `rotation`.

    Parameters
    ----------
    source : path or text stream
        CSV in its dialects, OpenSim (.sto, .mot), Xsens MVNX, BVH, NumPy (.npy, .npz), MATLAB (.mat), C3D, ROS bags,
        SPICE kernels (.tm), or runs of this package (.nc); a stream is CSV.
    columns : sequence of str, optional
        Headers of the columns to use: 4 of a quaternion or 9 of a matrix, row by row, or 3 with `euler` or
        `rotation_vector`; preceded by that of the time if there is one. Without headers, column numbers from 1.
    time_column : str, optional
        Header of the time.
    body : str, optional
        Which of several to use: a segment, sensor, joint, topic, array, or the common beginning of the headers of a
        sensor.
    scalar_first : bool, optional
        Order of quaternions, if the file does not show it.
    euler : str, optional
        Axes of the three angles in the order of the columns: "ZYX" about moving axes, "zyx" about fixed axes.
    rotation_vector : bool
        The columns are a rotation vector, axis times angle.
    angle_unit : "deg" or "rad", optional
        Unit of angles, if the file does not name it; rad for rotation vectors.
    time_unit : str, optional
        Unit of the time column: s, ms, us, ns, min, h, or the number of seconds per count.
    rate : float, optional
        Samples per second. Times are then computed from a column of sample or packet numbers, if any, or else by
        counting rows. The file's own times are ignored; use it where they are rounded too coarsely.
    normalize : bool
        Scale quaternions to length 1, and replace matrices by the nearest rotations.
    inverse : bool
        Invert every attitude: for sensors that report the earth relative to the sensor.

    Returns
    -------
    DataArray
        `quaternion` (time, quat), scalar last, or `directors` (time, director, axis), with the time, s, where there is
        one. Rows that are not finite are kept. The attribute `notes` states how each column was read and whether the
        direction, sensor to earth, could be checked; `start` is what the time counts from, s since 1970, where dates
        are known. Of text files, the coordinate `line` is the line of each sample, by which messages name it.

    Raises
    ------
    ValueError
        No orientation is found, or more than one, or the content is invalid; the message states the place and the
        option that would help.
    ImportError
        The library that reads the format is not installed; the message names the extra that installs it.
    OSError
        The file cannot be read; it is a FIFO or a device.

    Warns
    -----
    UserWarning
        A gyroscope, an accelerometer or angular velocities in the file indicate that the attitudes are inverted.

    Examples
    --------
    >>> import io
    >>> from nontwist import read_motion, twist
    >>> recording = io.StringIO("roll (deg),pitch (deg),yaw (deg)\n0,0,0\n0,0,40\n0,0,80")
    >>> motion = read_motion(recording, euler="ZYX", rate=10)
    >>> twist(motion).twist_angle.values.round(6)
    array([0.        , 0.698132, 1.396263])
    """
    words = {"time_column": time_column, "body": body, "euler": euler, "angle_unit": angle_unit, "time_unit": time_unit}
    flags = {"scalar_first": scalar_first, "rotation_vector": rotation_vector}
    how = reading_of(columns, rate, words, flags)
    content = content_of(source, how)
    how = replace(how, columns=columns or content.chosen, angle_unit=angle_unit or content.angle_unit)
    with naming(content.lines):
        found = (
            _of_bodies(content, how) if (content.bodies or content.loose) and not columns else _of_table(content, how)
        )
    values, notes = _unit(found.values, content.lines, normalize)
    if inverse:
        values = values * [-1, -1, -1, 1] if values.shape[-1] == 4 else np.swapaxes(values, -1, -2)
        notes = (*notes, "inverted: earth relative to sensor was made sensor relative to earth")
    checked = _checked(values, content, how, inverse, found.spin)
    if not checked and not inverse:
        checked = (DEFINED if content.bodies and content.directed and not columns else UNCHECKED,)
    return _array(values, found, content.lines, (*found.notes, *notes, *checked))


def reading_of(columns: Any, rate: Any, words: dict[str, Any], flags: dict[str, Any]) -> Reading:
    """Return what the caller said, checked for its kind."""
    for name, value in words.items():
        if value is not None and not isinstance(value, str):
            raise ValueError(f"{name} must be a text, got {shown(value)}")
    for name, value in flags.items():
        if not (value is None or isinstance(value, (bool, np.bool_))):
            raise ValueError(f"{name} must be True or False, got {shown(value)}")
    if isinstance(columns, str) or not (
        columns is None or (isinstance(columns, Sequence) and all(isinstance(one, str) for one in columns))
    ):
        raise ValueError(f"columns must be a list of headers, got {shown(columns)}")
    hertz = None if rate is None else float(as_positive(rate, "rate", (), "Hz"))
    if hertz is not None and not 1e-9 <= hertz <= 1e12:
        raise ValueError(f"rate must be samples a second, 1e-9 to 1e12, got {hertz:g}")
    return Reading(columns=columns, rate=hertz, **words, **flags)


def content_of(source: str | os.PathLike[str] | TextIO, how: Reading) -> Content:
    """Return what the reader of a file, or of a stream of text, finds in it."""
    if not (isinstance(source, (str, os.PathLike)) or callable(getattr(source, "read", None))):
        raise ValueError(f"source must be a path or a text stream, got {shown(source)}")
    if not isinstance(source, (str, os.PathLike)):
        return read_text(source, how)
    path = Path(source)
    if path.is_dir() and (path / "metadata.yaml").exists():
        return READERS[".db3"](path, how)
    require_regular(path)
    if path.stat().st_size == 0:
        raise ValueError("the file has no content (0 bytes); export the recording again")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        with open(path, "rb") as file:
            if b"\x00" in file.read(4096):
                raise ValueError(
                    f"files with the suffix {path.suffix!r} are not known, and it is not a text file; "
                    f"export it as CSV, or as one of {', '.join(READERS)}"
                )
        reader = read_text
    try:
        return reader(path, how)
    except ValueError as error:
        if path.suffix.lower() in BINARY and _is_text(path):
            raise ValueError(f"{error}; it is text: if it holds columns, give it a name that ends in .csv") from error
        raise


def _is_text(path: Path) -> bool:
    with open(path, "rb") as file:
        start = file.read(4096)
    return bool(start) and all(32 <= byte < 127 or byte in b"\t\r\n" for byte in start)


def _of_table(content: Content, how: Reading) -> Recorded:
    if not content.columns:
        raise ValueError("it has no columns; --body (body=) names what to take")
    found = table_motion(content.columns, how)
    return replace(found, notes=(*content.notes, *found.notes))


def _of_bodies(content: Content, how: Reading) -> Recorded:
    """Return the attitudes of one body, by its name in any case where there are several."""
    names = [*content.bodies, *content.loose]
    option = "euler" if how.euler is not None else "rotation_vector" if how.rotation_vector else None
    if option is not None:
        raise ValueError(
            f"--{option.replace('_', '-')} ({option}=) applies to columns, but the file contains attitudes "
            f"({listed(names)}): omit the option, or name three columns with --columns (columns=)"
        )
    if how.body is not None:
        wanted = [one for one in names if one == how.body] or [one for one in names if plain(one) == plain(how.body)]
    else:
        wanted = names
    if not wanted:
        raise ValueError(f"there is no body {how.body!r}; there is {listed(names)}: --body (body=)")
    if len(wanted) > 1:
        raise ValueError(f"more than one array or body contains an orientation; --body (body=) takes {listed(wanted)}")
    (name,) = wanted
    values = content.bodies.get(name)
    notes = [*content.notes, f"body: {name}"] if len(names) > 1 else [*content.notes]
    if values is None:
        values, note = scalar_place(content.loose[name], how, {}, f"the array {name!r} does")
        notes.append(note)
    elif not any(note.startswith("orientation: ") for note in notes):
        notes.insert(0, f"orientation: {'quaternion' if values.shape[-1] == 4 else 'matrix'} of {name!r}")
    time, start = content.time, content.start
    if time is not None and how.rate is not None and not content.sampled:
        notes.append(ignored("that of the format", time))
        time = None
    if time is None:
        found = clock(content.columns, how.time_column, how.time_unit, how.rate, len(values))
        time, start = found.time, found.start
        notes += found.notes
    else:
        notes.append(f"time: as the format defines, {'s' if start is None else 's since 1970'}")
    if time is not None and len(time) != len(values):
        raise ValueError(f"the time has {len(time)} values, the orientation {len(values)}")
    return Recorded(values, time, start, tuple(notes), content.spins.get(name))


def _unit(values: Array, lines: Lines | None, normalize: bool) -> tuple[Array, tuple[str, ...]]:
    """Return rotations to round-off where `normalize` is set; a ValueError names a row that is none to 1 %."""
    flat = values.reshape(len(values), math.prod(values.shape[1:]))
    good = np.isfinite(flat).all(axis=1) & flat.any(axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        if values.shape[-1] == 4:
            off = np.linalg.norm(values, axis=1)
        else:
            off = 1 + abs(np.swapaxes(values, 1, 2) @ values - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero(good & ~(abs(off - 1) <= MEASURED))
    if bad.size:
        k, is_rare = int(bad[0]), bad.size <= RARE * good.sum()  # else they are rounded, or scaled
        what = f"length {off[k]:.6g}" if values.shape[-1] == 4 else f"largest entry of |ΛᵀΛ - I| {off[k] - 1:.3g}"
        kind = "quaternion" if values.shape[-1] == 4 else "matrix"
        first = f"the first is {place(k, lines)}: its {kind} has the {what}"
        told = f"no valid rotation in {counted(bad.size, 'row')}, {first}"
        if not normalize:
            scaled = "--normalize (normalize=True) converts them to rotations"
            advice = (
                f"all others are rotations, so correct or delete it; {scaled}, right or wrong" if is_rare else scaled
            )
            raise ValueError(f"{told}; {advice}")
        if is_rare:
            warnings.warn(f"{told}; all others are rotations, so what it was converted to is a guess", stacklevel=3)
    if not normalize:
        return values, ()
    if not good.any():
        return values, ()
    values = values.copy()
    if values.shape[-1] == 4:
        values[good] /= off[good, None]
        return values, (f"normalized: quaternions had lengths from {off[good].min():.6g} to {off[good].max():.6g}",)
    left, _, right = np.linalg.svd(values[good])
    values[good] = left @ right
    return values, (f"normalized: |ΛᵀΛ - I| was up to {off[good].max() - 1:.3g}",)


def _checked(values: Array, content: Content, how: Reading, inverse: bool, spin: Array | None) -> tuple[str, ...]:
    """Warn where a gyroscope, an accelerometer or angular velocities beside them say that they are inverted."""
    columns = _beside(content.columns, how)
    if any(len(column) != len(values) for column in columns.values()):
        columns = {}
    if not columns and spin is None:
        return ()
    quat = values
    if values.shape[-1] != 4:
        from scipy.spatial.transform import Rotation

        good = np.isfinite(values).all(axis=(1, 2)) & (np.linalg.det(np.nan_to_num(values)) > 0.5)
        quat = np.full((len(values), 4), np.nan)
        if good.any():
            quat[good] = Rotation.from_matrix(values[good]).as_quat()
    inverted, why = verdict(quat, columns, spin)
    if inverted is None:
        return ()
    if inverted:
        advice = "leave --inverse (inverse=True) out" if inverse else "try --inverse (inverse=True)"
        warnings.warn(f"the attitudes look inverted: {why}; {advice}", stacklevel=3)
    return (f"checked: {why}",)


def _beside(columns: Any, how: Reading) -> dict[str, NDArray[Any]]:
    """Return the columns that belong to the same sensor, where the file has more than one."""
    found = orientations(list(columns))
    if len(found) < 2:
        return dict(columns)
    bodies = {one.body for one in found if how.columns is None or set(one.headers) <= set(how.columns)}
    name = plain(how.body) if how.body is not None else plain(bodies.pop()) if len(bodies) == 1 else ""
    return {header: column for header, column in columns.items() if name and plain(header).startswith(name)}


def _array(values: Array, found: Recorded, lines: Lines | None, notes: Sequence[str]) -> xarray.DataArray:
    name, along = "quaternion" if values.shape[-1] == 4 else "directors", "sample"
    across = ("quat",) if name == "quaternion" else ("director", "axis")
    times: dict[str, Any] = {}
    if found.time is not None:
        along, times = "time", {"time": found.time}
    array = values if name == "quaternion" else np.swapaxes(values, 1, 2)
    attrs = {"units": "1", "notes": "; ".join(notes)} | ({} if found.start is None else {"start": found.start})
    dims = (along, *across)
    beside = {} if lines is None else {"line": (along, lines, {"units": "1", "long_name": "line of the file, from 1"})}
    return assembled({name: (dims, array, attrs)}, coordinates(dims, beside, **times), {})[name]
