"""Recorded motions from files: what a reader found, made into attitudes with their time."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from ..analysis.variables import assembled, coordinates
from ..errors import InputError
from ..geometry.values import shown
from ..io.whole import free_memory, require_regular
from ..spec import takes
from .attitudes import of_bodies, of_table
from .formats import BEGINNINGS, PACKED, READERS, Content
from .formats.text import read_text
from .options import ReadOptions
from .rotations import Motion

if TYPE_CHECKING:
    import xarray

BINARY = {".npy", ".npz", ".mat", ".c3d", ".bag", ".mcap", ".db3", ".nc", ".nc4", ".h5"}
SHARE = 0.5  # of the free memory that a file may have


@takes(ReadOptions)
def read_motion(
    source: str | os.PathLike[str] | TextIO, columns: Sequence[str] | None = None, **options: Any
) -> xarray.DataArray:
    r"""Read a recorded motion from a file, as input of `twist` and `rotation`.

    Parameters
    ----------
    source : path or text stream
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


def read_content(source: str | os.PathLike[str] | TextIO, how: ReadOptions) -> Content:
    """Return what the reader of a file, or of a stream of text, finds in it."""
    if callable(getattr(source, "read", None)):
        return read_text(source, how)
    if not isinstance(source, (str, os.PathLike)):
        raise InputError("source", value=shown(source))
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
        suffix = next((one for magic, one in BEGINNINGS.items() if start.startswith(magic)), suffix)
        packed = next((words for magic, words in PACKED.items() if start.startswith(magic)), None)
        if packed is not None and suffix != ".xlsx":
            raise InputError("packed", packed=packed)
        if start.lstrip()[:1] in (b"{", b"["):
            raise InputError("json")
        if suffix not in READERS and b"\x00" in start and start[:2] not in (b"\xff\xfe", b"\xfe\xff"):
            raise InputError("unknown-format", suffix=path.suffix, known=", ".join(READERS))
    with _unchanged(path):
        try:
            return READERS.get(suffix, read_text)(path, how)
        except InputError:
            if suffix in BINARY and all(32 <= byte < 127 or byte in b"\t\r\n" for byte in start):
                raise InputError("text-inside", suffix=suffix) from None
            raise


@contextmanager
def _unchanged(path: Path) -> Iterator[None]:
    """Refuse a file that does not fit into memory, or that changes while it is read."""
    before = os.stat(path)
    if before.st_size > SHARE * (free := free_memory()):
        raise InputError("too-large", size=before.st_size / 1e9, free=free / 1e9)
    yield
    after = os.stat(path)
    if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
        raise InputError("file-changed")


def _array(motion: Motion) -> xarray.DataArray:
    values, time, lines, start = motion.values, motion.time, motion.lines, motion.start
    is_quaternion, along = values.shape[-1] == 4, "sample" if time is None else "time"
    dims = (along, "quat") if is_quaternion else (along, "director", "axis")
    name, array = ("quaternion", values) if is_quaternion else ("directors", np.swapaxes(values, 1, 2))
    attrs = {"units": "1", "notes": "; ".join(motion.notes)} | ({} if start is None else {"start": start})
    described = {"units": "1", "long_name": "line of the file, from 1"}
    beside = {} if lines is None else {"line": (along, lines, described)}
    times = {} if time is None else {"time": time}
    return assembled({name: (dims, array, attrs)}, coordinates(dims, beside, **times), {})[name]
