"""Arrays by name: attitudes, or columns; the files of NumPy (.npy, .npz) that hold them, and runs of this package.

Taken are quaternions (n, 4), matrices (n, 3, 3), homogeneous transforms (n, 4, 4), those of several bodies (n, k, 4)
and (n, k, 3, 3), rotation vectors of joints (n, 3 k) named as those of SMPL, columns (n,), and (n, 3), as ``gyr``,
whose columns are ``gyr_x``, ``gyr_y``, ``gyr_z``. What is not taken is named in the notes.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...io.results import open_run
from ..options import ReadOptions
from ..table import Table
from .content import Content

JOINTS = ("poses", "pose", "body_pose", "pose_body", "root_orient", "global_orient")  # SMPL, AMASS
RATES = ("mocap_framerate", "mocap_frame_rate", "framerate", "frame_rate", "fps", "rate", "frequency")


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
    return of_arrays(arrays)


def of_arrays(arrays: Mapping[str, Any]) -> Content:
    """Return the content of named arrays; an array `directors` holds directors in rows, any other (n, 3, 3) Λ."""
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
    count = max(map(len, (*bodies.values(), *loose.values())), default=0)
    time = np.arange(count) / known if known > 0 and count else None
    table = Table(columns, headless=headless)
    return Content(table, bodies, loose, time=time, notes=tuple(notes), directed=False)


def read_run(path: Path, how: ReadOptions) -> Content:
    """Read the attitudes of a run."""
    from ..motions import raw_motion

    run = open_run(path)
    found = raw_motion(run, how.scalar_first)
    return Content(bodies={path.stem: found.values}, time=found.time, notes=("orientation: a run of this package",))
