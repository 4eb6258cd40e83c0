"""Recorded motions from files: CSV, NPZ, or runs of this package."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from ..analysis.motions import raw_motion
from ..analysis.tables import number, table_motion, table_time
from ..geometry.arrays import Array
from .regular import require_regular
from .results import open_run

LONGEST = 200_000_000  # letters of a stream


def read_motion(
    source: str | os.PathLike[str] | TextIO,
    columns: Sequence[str] | None = None,
    *,
    scalar_first: bool | None = None,
    time_unit: str | None = None,
    inverse: bool = False,
) -> tuple[Array, Array | None]:
    """Read a recorded motion.

    Parameters
    ----------
    source : path or text stream
        CSV (comma, semicolon or tab; columns found by their headers, see `analysis.tables`; without headers 4, 5, 9 or
        10 columns, as `columns` would name them), NPZ (arrays of shape (n, 4) or (n, 3, 3) and the time, or columns)
        or NetCDF (runs of this package).
    columns : sequence of str, optional
        Headers to take: 4 or 9, the time before them where there is one; numbers from 1 where there are no headers.
    scalar_first : bool, optional
        Order of quaternions whose names do not tell.
    time_unit : str, optional
        Of the time column: s, ms, us, ns, min, h.
    inverse : bool
        Invert every attitude: for sensors that report earth relative to sensor.

    Returns
    -------
    values : (n, 4) quaternions, scalar last, or (n, 3, 3) matrices Λ; rows that are not finite are kept
    time : (n,) array, s, or None

    Raises
    ------
    ValueError
        No orientation is found, a column holds something that is not a number (with its row), an NPZ file is damaged,
        or a stream is longer than 200 MB.
    OSError
        The file cannot be read; it is a FIFO or a device.
    """
    suffix = ""
    if isinstance(source, (str, os.PathLike)):
        require_regular(source)
        suffix = Path(source).suffix.lower()
    if suffix in (".nc", ".nc4", ".h5") and isinstance(source, (str, os.PathLike)):
        values, time = raw_motion(open_run(source), scalar_first)
    elif suffix == ".npz" and isinstance(source, (str, os.PathLike)):
        values, time = _of_arrays(source, columns, scalar_first, time_unit)
    else:
        values, time = _of_text(source, columns, scalar_first, time_unit)
    if inverse:
        values = values * [-1, -1, -1, 1] if values.shape[-1] == 4 else np.swapaxes(values, -1, -2)
    return values, time


def _of_text(source: Any, columns: Sequence[str] | None, scalar_first: bool | None, time_unit: str | None) -> Any:
    import pandas

    if isinstance(source, (str, os.PathLike)):
        with open(source, encoding="utf-8-sig") as file:
            header = file.readline()
    else:
        content = source.read(LONGEST + 1)
        if len(content) > LONGEST:
            raise ValueError(f"the stream is longer than {LONGEST / 1e6:g} MB; save it in a file")
        source = io.StringIO(content)
        header = source.readline()
        source.seek(0)
    if not header.strip():
        raise ValueError("the first line is empty; it must hold the headers of the columns")
    separator = max(",;\t", key=header.count)
    names = [name.strip().strip('"') for name in header.split(separator)]
    how: dict[str, Any] = {"sep": separator, "skipinitialspace": True, "encoding": "utf-8-sig", "low_memory": False}
    if None not in map(number, names):
        how |= {"header": None, "names": [str(k + 1) for k in range(len(names))]}
        columns = columns or _numbered(len(names), header)
    table = pandas.read_csv(source, **how)
    found = {str(name).strip(): table[name].to_numpy() for name in table.columns}
    return table_motion(found, scalar_first, columns, time_unit)


def _numbered(count: int, header: str) -> list[str]:
    """Return the names of columns without headers where their number says what they are."""
    if count not in (4, 5, 9, 10):
        raise ValueError(
            f"the first line holds numbers, not the headers of the columns: {header.strip()[:60]}; of {count} columns "
            "name [TIME,] 4 of a quaternion or 9 of a matrix by their numbers from 1"
        )
    return [str(k + 1) for k in range(count)]


def _of_arrays(path: Any, columns: Sequence[str] | None, scalar_first: bool | None, time_unit: str | None) -> Any:
    with open(path, "rb") as stream:
        try:
            with zipfile.ZipFile(stream):
                stream.seek(0)
            with np.load(stream, allow_pickle=False) as file:
                found = {name: file[name] for name in file.files}
        except Exception as error:  # zipfile, zlib and NumPy raise what they like
            raise ValueError(f"it is no NPZ file that can be read ({type(error).__name__}: {error})") from error
    arrays = {name: array for name, array in found.items() if isinstance(array, np.ndarray)}
    flat = {name: array for name, array in arrays.items() if array.ndim == 1}
    shaped = {name: array for name, array in arrays.items() if array.shape[1:] in ((4,), (3, 3))}
    if columns is not None or not shaped:
        return table_motion(flat, scalar_first, columns, time_unit)
    if len(shaped) > 1:
        raise ValueError(f"more than one array holds an orientation: {', '.join(shaped)}")
    (name,) = shaped
    values, _ = raw_motion(np.swapaxes(shaped[name], 1, 2) if name == "directors" else shaped[name], scalar_first)
    return values, table_time(flat, time_unit)
