"""MATLAB (.mat) and C3D, by libraries, which raise what they like on damaged files or even end their process.

Of MATLAB, arrays are read, and fields of structures as ``structure.field``; version 7.3 is read by h5py. Of C3D, the
group ROTATION, 4×4 matrices of segments, as C-Motion describes it and ezc3d reads it: the upper left 3×3 block maps
segment to laboratory, the last column is the origin of the segment.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ..options import ReadOptions
from .arrays import of_arrays
from .content import Content, by_name

Arrays = dict[str, NDArray[np.generic]]
LARGEST = 4_000_000_000  # bytes of an array of MATLAB
HELP = "save numeric arrays with save('name.mat', ..., '-v7'), or a table with writetable"
CHILD = (
    "import sys; from importlib import import_module; import numpy; module, function, path = sys.argv[1:]; "
    "found = getattr(import_module(module), function)(path); "
    "numpy.savez(sys.stdout.buffer, **{'_' + name: array for name, array in found.items()})"
)


@contextmanager
def readable(what: str, help_with: str = "") -> Iterator[None]:
    """Turn every exception that a library raises on a damaged file into an InputError, but for those of the system.

    The message names the format, as in "it is not a readable spin log: damaged, cut short or something else".
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # libraries raise what they like
        if isinstance(error, OSError) and error.errno is not None:
            raise
        why = f"damaged, cut short or something else{help_with}"
        raise InputError("unreadable", what=what, why=why) from error


def library(name: str, extra: str) -> Any:
    """Import the library that reads a format; an ImportError names the extra that installs it."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(f"this format is read by {name}: pip install 'nontwist[{extra}]'", name=name) from error


def read_apart(function: Callable[[str], Arrays], path: Path) -> Arrays:
    """Return the arrays that a function of a module finds in a file.

    Raises
    ------
    RuntimeError
        Its process did not end well.
    """
    command = [sys.executable, "-c", CHILD, function.__module__, function.__name__, str(path.resolve())]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(one for one in sys.path if one)}
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, env=env)
    if done.returncode:
        raise RuntimeError(f"the process that reads it ended with {done.returncode}")
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as file:
        return {name.removeprefix("_"): file[name] for name in file.files}


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
    content = of_arrays(found)
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
        found[name] = np.asarray(item).T


def _flatten(found: dict[str, Any], name: str, value: Any) -> None:
    if not isinstance(value, np.ndarray):
        return
    if value.dtype.names is not None:
        for field in value.dtype.names if value.size == 1 else ():
            _flatten(found, f"{name}.{field}", value.ravel()[0][field])
    elif value.dtype.kind in "fiu":
        found[name] = np.moveaxis(value, 2, 0) if value.ndim == 3 and value.shape[:2] in ((3, 3), (4, 4)) else value


def read_c3d(path: Path, how: ReadOptions) -> Content:
    """Read the rotations of a file."""
    library("ezc3d", "c3d")
    with readable("C3D file"):
        found = read_apart(rotations, path)
        matrices = np.asarray(found["matrices"], dtype=float)
        labels, rate = [str(one) for one in found["labels"]], float(np.asarray(found["rate"], dtype=float))
    if matrices.ndim != 4 or matrices.shape[2] == 0 or matrices.shape[3] == 0:
        raise InputError("no-rotations")
    names = [labels[k] if k < len(labels) else f"rotation {k + 1}" for k in range(matrices.shape[2])]
    bodies = by_name("segment", ((name, np.moveaxis(matrices[:3, :3, k, :], 2, 0)) for k, name in enumerate(names)))
    time = np.arange(matrices.shape[3]) / rate if rate > 0 else None
    return Content(bodies=bodies, time=time, notes=("orientation: matrices of the group ROTATION",))


def rotations(path: str) -> dict[str, Any]:
    """Return the matrices of a file, (4, 4, bodies, frames), their labels and rate; run in a process of its own."""
    import ezc3d

    file = ezc3d.c3d(path)
    group = file["parameters"].get("ROTATION", {})
    labels = [str(one) for one in group.get("LABELS", {}).get("value", [])]
    rates = [*np.ravel(group.get("RATE", {}).get("value", [])), file["header"]["points"]["frame_rate"]]
    matrices = np.asarray(file["data"]["rotations"], dtype=float)
    return {"matrices": matrices, "labels": np.array(labels, dtype=str), "rate": np.array(float(rates[0]))}
