"""MATLAB (.mat): arrays, and fields of structures as ``structure.field``; version 7.3 is read by h5py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ..options import ReadOptions
from .apart import read_apart, readable
from .arrays import of_arrays
from .content import Content

LARGEST = 4_000_000_000  # bytes of an array
HELP = "save numeric arrays with save('name.mat', ..., '-v7'), or a table with writetable"


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
