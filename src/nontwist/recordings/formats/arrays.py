"""Arrays by name: attitudes, or columns; the files of NumPy and MATLAB that hold them, and runs of this package.

Taken are quaternions (n, 4), matrices (n, 3, 3), homogeneous transforms (n, 4, 4), those of several bodies (n, k, 4)
and (n, k, 3, 3), rotation vectors of joints (n, 3 k) named as those of SMPL, columns (n,), and (n, 3), as ``gyr``,
whose columns are ``gyr_x``, ``gyr_y``, ``gyr_z``. What is not taken is named in the notes.

Of MATLAB, arrays are read, and fields of structures as ``structure.field``; version 7.3 is read by h5py.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...io.results import open_run
from ..options import ReadOptions
from ..table import Content, Table
from ..times import clock, not_used
from .apart import read_apart, readable

JOINTS = ("poses", "pose", "body_pose", "pose_body", "root_orient", "global_orient")  # SMPL, AMASS
RATES = ("mocap_framerate", "mocap_frame_rate", "framerate", "frame_rate", "fps", "rate", "frequency")
LARGEST = 4_000_000_000  # bytes of an array of MATLAB
HELP = "save numeric arrays with save('name.mat', ..., '-v7'), or a table with writetable"


def read_numpy(path: Path, how: ReadOptions) -> Content:
    """Read one array, or an archive of arrays."""
    kind = path.suffix[1:].upper()
    with open(path, "rb") as stream:
        try:
            if kind == "NPZ":
                zipfile.ZipFile(stream).close()
                stream.seek(0)
            found = np.load(stream, allow_pickle=False)
            named = {"array": found} if isinstance(found, np.ndarray) else {name: found[name] for name in found.files}
            arrays = {name: np.asarray(one) for name, one in named.items()}  # what is no array are bytes
        except Exception as error:  # zipfile, zlib and NumPy raise what they like
            is_pickled = "pickle" in str(error)
            why = "it holds objects of Python; save arrays of numbers" if is_pickled else "damaged or cut short"
            raise InputError("unreadable", what=f"{kind} file", why=why) from error
    return of_arrays(arrays, how)


def of_arrays(arrays: Mapping[str, Any], how: ReadOptions) -> Content:
    """Return the content of named arrays; an array `directors` holds directors in rows, any other (n, 3, 3) Λ.

    A rate among them gives times where no column does.
    """
    columns, bodies, loose = dict[str, Any](), dict[str, Any](), dict[str, Any]()
    notes, headless = list[str](), False
    for name, array in arrays.items():
        shape, end, is_numeric = array.shape, array.shape[1:], array.dtype.kind in "fiu"
        numbers = np.asarray(array, dtype=float) if is_numeric else np.empty(0)
        if array.dtype.names is not None:
            columns |= {field: np.ravel(array[field]) for field in array.dtype.names}
        elif is_numeric and end == (3, 3):
            bodies[name] = np.swapaxes(numbers, 1, 2) if name == "directors" else numbers
        elif is_numeric and end == (4, 4) and (array[:, 3] == [0, 0, 0, 1]).all():
            bodies[name] = numbers[:, :3, :3]
        elif is_numeric and end == (4,):
            loose[name] = numbers
        elif is_numeric and end[1:] in ((4,), (3, 3)):
            (loose if end[1:] == (4,) else bodies).update({f"{name} {k}": numbers[:, k] for k in range(end[0])})
        elif is_numeric and name in JOINTS and len(end) == 1 and end[0] and end[0] % 3 == 0:
            from scipy.spatial.transform import Rotation

            turned = Rotation.from_rotvec(numbers.reshape(-1, 3)).as_quat().reshape(len(array), -1, 4)
            bodies |= {name if end == (3,) else f"{name} {k}": turned[:, k] for k in range(end[0] // 3)}
        elif len(shape) == 1 or (len(shape) == 2 and 1 in shape):
            columns[name] = np.ravel(array)
        elif is_numeric and end == (3,) and len(arrays) > 1:
            columns |= {f"{name}_{x}": array[:, k] for k, x in enumerate("xyz")}
        elif len(shape) == 2 and len(arrays) == 1:
            columns, headless = {str(k + 1): array[:, k] for k in range(shape[1])}, True
        elif name.lower() not in RATES:
            notes.append(f"not read: the array {name!r} of the shape {shape}")
    if notes and not (columns or bodies or loose):
        raise InputError("no-attitudes", help="; ".join(notes))
    known = next((float(arrays[name]) for name in arrays if name.lower() in RATES and arrays[name].size == 1), 0.0)
    count = max(map(len, [*bodies.values(), *loose.values()] or columns.values()), default=0)
    time = np.arange(count) / known if known > 0 and count else None
    table = Table(columns, headless=headless)
    if time is not None and how.rate is None:
        own = replace(table, columns={name: values for name, values in columns.items() if len(values) == count})
        try:
            told = clock(own, how).time
        except InputError as error:
            if how.time_column or how.time_unit:
                raise
            told = None
            notes.append(not_used(error))
        if told is not None:
            if not abs(told - told[0] - time).max() < 0.5 / known:
                notes.append(f"time: not used: {known:g} samples a second, from which the times differ")
            table, time = own, None
        elif not (bodies or loose):
            table, time = replace(own, columns={"time (s)": time} | dict(own.columns)), None
    return Content(table, bodies, loose, time=time, notes=tuple(notes), directed=False)


def read_matlab(path: Path, how: ReadOptions) -> Content:
    """Read the arrays of a file."""
    found: dict[str, Any] = {}
    with readable("MAT file", f"; {HELP}"):
        with open(path, "rb") as stream:
            modern = b"MATLAB 7.3" in stream.read(128)
        if modern:
            import h5py

            with h5py.File(path, "r") as file:
                file.visititems(lambda name, item: _keep(found, name.replace("/", "."), item))
        else:
            found = read_apart(loaded, path)
    content = of_arrays(found, how)
    if not (content.table.columns or content.bodies or content.loose):
        raise InputError("no-attitudes", help=HELP)
    return content


def loaded(path: str) -> dict[str, Any]:
    """Return the numeric arrays of a file up to version 7; run in a process of its own."""
    from scipy.io import loadmat

    found: dict[str, Any] = {}
    for name, value in loadmat(path, squeeze_me=False, struct_as_record=True).items():
        if not name.startswith("__"):
            _flatten(found, name, value)
    return found


def _keep(found: dict[str, Any], name: str, item: Any) -> None:
    """Take a numeric array of a 7.3 file, whose axes are in reverse; none whose numbers are kept in other files."""
    if hasattr(item, "shape") and item.dtype.kind in "fiu" and not name.startswith("#"):
        if item.is_virtual or item.external or item.nbytes > LARGEST:
            raise ValueError
        _flatten(found, name, np.asarray(item).T)


def _flatten(found: dict[str, Any], name: str, value: Any) -> None:
    if not isinstance(value, np.ndarray):
        return
    if value.dtype.names is not None:
        for field in value.dtype.names if value.size == 1 else ():
            _flatten(found, f"{name}.{field}", value.ravel()[0][field])
    elif value.dtype.kind in "fiu":
        found[name] = np.moveaxis(value, 2, 0) if value.ndim == 3 and value.shape[:2] in ((3, 3), (4, 4)) else value


def read_run(path: Path, how: ReadOptions) -> Content:
    """Read the attitudes of a run."""
    from ..motions import raw_motion

    run = open_run(path)
    found = raw_motion(run, how.scalar_first)
    return Content(bodies={path.stem: found.values}, time=found.time, notes=("orientation: a run of this package",))
