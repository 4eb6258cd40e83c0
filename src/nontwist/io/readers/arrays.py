"""NumPy files: arrays of attitudes, or columns by name."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...analysis.tables import Reading
from .content import Content


def read_npz(path: Path, how: Reading) -> Content:
    """Read an archive of arrays."""
    with open(path, "rb") as stream:
        try:
            with zipfile.ZipFile(stream):
                stream.seek(0)
            with np.load(stream, allow_pickle=False) as file:
                found = {name: file[name] for name in file.files}
        except Exception as error:  # zipfile, zlib and NumPy raise what they like
            raise ValueError(f"it is not a readable NPZ file: {_why(error)}") from error
    return of_arrays({name: array for name, array in found.items() if isinstance(array, np.ndarray)})


def read_npy(path: Path, how: Reading) -> Content:
    """Read one array: attitudes, a structured array, or columns by number with the time before them."""
    try:
        with open(path, "rb") as stream:
            array = np.load(stream, allow_pickle=False)
    except Exception as error:  # NumPy raises what it likes
        raise ValueError(f"it is not a readable NPY file: {_why(error)}") from error
    return of_arrays({"array": array})


def _why(error: Exception) -> str:
    if isinstance(error, zipfile.BadZipFile):
        return "no archive, or one cut short"
    return "it holds objects of Python; save arrays of numbers" if "pickle" in str(error) else "damaged or cut short"


def of_arrays(arrays: Mapping[str, Any]) -> Content:
    """Return the content of named arrays: series of quaternions or matrices, and columns.

    An array `directors` holds directors in rows, (n, 3, 3); any other of this shape matrices Λ. Of an array (n, 3)
    beside others, as `gyr`, the columns are `gyr_x`, `gyr_y`, `gyr_z`.
    """
    columns: dict[str, Any] = {}
    bodies: dict[str, Any] = {}
    loose: dict[str, Any] = {}
    chosen: tuple[str, ...] | None = None
    for name, array in arrays.items():
        if array.dtype.names is not None:
            columns |= {field: np.ravel(array[field]) for field in array.dtype.names}
        elif array.shape[1:] == (3, 3) and array.dtype.kind in "fiu":
            bodies[name] = np.asarray(np.swapaxes(array, 1, 2) if name == "directors" else array, dtype=float)
        elif array.ndim == 2 and array.shape[1] == 4 and array.dtype.kind in "fiu":
            loose[name] = np.asarray(array, dtype=float)
        elif array.ndim == 1 or (array.ndim == 2 and 1 in array.shape):
            columns[name] = np.ravel(array)
        elif array.ndim == 2 and array.shape[1] == 3 and len(arrays) > 1 and array.dtype.kind in "fiu":
            columns |= {f"{name}_{x}": array[:, k] for k, x in enumerate("xyz")}
        elif array.ndim == 2 and len(arrays) == 1:
            columns = {str(k + 1): array[:, k] for k in range(array.shape[1])}
            chosen = tuple(columns)
    return Content(columns=columns, chosen=chosen, bodies=bodies, loose=loose, directed=False)
