"""MATLAB files: numeric arrays and structures, up to version 7 by SciPy, of version 7.3 by h5py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...analysis.tables import Reading
from .apart import read_apart
from .arrays import of_arrays
from .content import Content, reading

LARGEST = 4_000_000_000  # bytes of an array
HELP = "; save numeric arrays with save('name.mat', ..., '-v7'), or a table with writetable"


def read_mat(path: Path, how: Reading) -> Content:
    """Read arrays; fields of a structure are ``structure.field``."""
    import h5py

    found: dict[str, Any] = {}
    with reading("MAT file", HELP):
        with open(path, "rb") as stream:
            modern = b"MATLAB 7.3" in stream.read(128)
        if modern:
            with h5py.File(path, "r") as file:
                file.visititems(lambda name, item: _keep(found, name.replace("/", "."), item))
        else:
            found = read_apart(loaded, path)
    content = of_arrays(found)
    if not (content.columns or content.bodies or content.loose):
        raise ValueError(f"it contains no array of attitudes and no columns{HELP}")
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
        found[name] = np.moveaxis(value, 2, 0) if value.shape[:2] == (3, 3) and value.ndim == 3 else value
