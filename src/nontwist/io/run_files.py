"""Runs on disk: NetCDF-4, whole or absent (`whole`), and sealed.

A file ends with a line of text, the seal: the number of bytes before it and their CRC-32. It stands behind the end that
HDF5 knows, so every NetCDF-4 reader takes the file as it is; `open_run` checks the seal before HDF5 sees a byte.
Numbers, names, attributes and HDF5's own index are all under it: a flipped bit anywhere is noticed, whereas HDF5's
checksums would cover arrays alone. The file is made in memory: HDF5 2.0 ends the process with a segmentation fault
when a disk is full while it closes a file there.

The numbers of a run or of a sweep for other programs: flat columns with units in their headers, as CSV, NPZ or JSON.

A column is called after its variable and the labels along dimensions other than time, or member of a sweep:
``spatial_momentum_x [kg m2 s-1]``, ``directors_3_z``. Dimensionless ones have no unit.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from io import BytesIO
from math import prod
from pathlib import Path
from typing import Any, BinaryIO, TextIO

import numpy as np
from numpy.typing import NDArray

from ..analysis.datasets import as_dataset
from ..analysis.trajectory import FORMAT_VERSION
from ..analysis.variables import assembled
from ..errors import InputWarning, ResultFileError, callers_level, warn
from ..geometry.arrays import DataArray, Dataset
from ..geometry.attitudes import euler_angles
from ..geometry.values import as_path
from .whole import atomic_file, require_regular, reserved_path

ROWS = 2**13  # formatted at a time
WORDS = {"title", "message", "warning", "run_file"}  # of attributes: they may look like JSON
STATES, INTERVALS, EVENTS, MEMBERS = "time", "midtime", "event", "member"
Columns = dict[str, NDArray[Any]]


def columns(run: Dataset, along: str) -> Columns:
    """Return the columns along the dimension `along`, such as "time", by header; that coordinate, or names, first."""
    names = [name for name in run.data_vars if along in run[name].dims]
    first = {"event_name": run["event_name"].values.astype(np.str_)} if along == EVENTS and EVENTS in run.dims else {}
    return first | {
        header: values
        for name in ([along, *names] if along in run.coords else names)
        for header, values in _of_variable(run[name], along)
    }


def _all_columns(run: Dataset) -> Columns:
    """Return the columns of states, intervals and events, or of members."""
    return {**columns(run, _lines(run)), **columns(run, INTERVALS), **columns(run, EVENTS)}


def _lines(run: Dataset) -> str:
    """Return along what a table has its lines: of a sweep along its members, of events alone along them."""
    return next((along for along in (STATES, MEMBERS) if along in run.dims), EVENTS)


def _of_variable(variable: DataArray, along: str) -> Iterable[tuple[str, NDArray[Any]]]:
    variable = variable.transpose(along, ...)
    labels = [[str(label) for label in variable[dim].values] for dim in variable.dims[1:]]
    unit = variable.attrs.get("units", "1")
    suffix = "" if unit == "1" else f" [{unit}]"
    flat = variable.values.reshape(variable.sizes[along], prod(map(len, labels)))
    for k, label in enumerate(itertools.product(*labels)):
        yield "_".join([str(variable.name), *label]) + suffix, flat[:, k]


def in_degrees(run: Dataset) -> Dataset:
    """Return a run or a sweep with angles, their rates and their units in degrees; the attributes stay as they are.

    Derivatives by parameters stay as well: their units are those of the parameters, too.
    """
    turned = run.copy()
    for name, variable in run.data_vars.items():
        unit, *rest = variable.attrs.get("units", "1").split(" ")
        if unit == "rad" and "parameter" not in variable.dims:
            units = " ".join(["degree", *rest])
            turned[name] = variable.copy(data=np.degrees(variable.values)).assign_attrs(units=units)
    return turned


def with_euler(run: Dataset, letters: str) -> Dataset:
    """Return a run or a sweep with Euler angles and their rates beside its variables; InputWarning in gimbal lock."""
    p, W = run["quaternion"], run["material_angular_velocity"]
    along, shape = p.dims[:-1], p.shape[:-1]
    angles, rates, is_locked = euler_angles(p.values.reshape(-1, 4), W.values.reshape(-1, 3), letters)
    if is_locked.any():
        first = np.broadcast_to(run[along[-1]].values, shape).ravel()[int(is_locked.argmax())]
        facts: dict[str, Any] = {"count": int(is_locked.sum()), "along": along[-1], "first": f"{first:.6g}"}
        warnings.warn(InputWarning("gimbal-lock", letters=letters, **facts), stacklevel=callers_level())
    own = {"long_name": f"Euler angles {letters}, as SciPy has them", "units": "rad"}
    dims = (*along, "angle")
    return run.assign(
        euler_angles=(dims, angles.reshape(*shape, 3), own),
        euler_rates=(dims, rates.reshape(*shape, 3), {"long_name": "their rates", "units": "rad s-1"}),
    ).assign_coords(angle=[1, 2, 3])


def write_csv(run: Dataset, stream: TextIO, *, decimal_comma: bool = False) -> None:
    """Write a line for each stored state, or member of a sweep, or event where the run has columns of events alone.

    Columns of intervals belong to the state that ends them: the first is empty. Numbers have as many digits as
    reading them back exactly requires. Decimal commas come with semicolons between columns.
    """
    import pandas

    marks: dict[str, Any] = {"sep": ";", "decimal": ","} if decimal_comma else {}
    states, intervals = (columns(run, along) for along in (_lines(run), INTERVALS))
    if intervals and STATES in run.dims:
        t, middle = run[STATES].values, run[INTERVALS].values
        if len(middle) != len(t) - 1 or ((middle < t[:-1]) | (t[1:] < middle)).any():
            why = "the intervals of the run are not those between its states"
            raise ValueError(f"{why}: choose variables of states, --columns, or write JSON or NPZ, which have both")
    for first in range(0, max(run.sizes[_lines(run)], 1), ROWS):
        table = pandas.DataFrame({header: values[first : first + ROWS] for header, values in states.items()})
        for header, values in intervals.items():
            ended = pandas.Series(values[max(first - 1, 0) : first + ROWS - 1])
            ended.index += 0 if first else 1
            table[header] = ended.astype("Int64") if ended.dtype.kind == "i" else ended
        table.to_csv(stream, index=False, header=not first, lineterminator="\n", **marks)


def write_npz(run: Dataset, file: Any) -> None:
    """Write an array for each column, and the record of the run as the string `record` (JSON)."""
    arrays: dict[str, Any] = _all_columns(run)
    np.savez(file, record=np.array(json.dumps(record(run), ensure_ascii=False)), **arrays)


def write_json(run: Dataset, stream: TextIO) -> None:
    """Write an object: ``record``, and ``columns`` with a list of numbers each; what is not finite is null."""
    found = _all_columns(run)
    stream.write('{"record": ' + json.dumps(record(run), ensure_ascii=False) + ', "columns": {')
    for k, (header, values) in enumerate(found.items()):
        stream.write((", " if k else "") + json.dumps(header) + ": " + json.dumps(finite(values), allow_nan=False))
    stream.write("}}\n")


def record(run: Dataset) -> dict[str, Any]:
    """Return the attributes of a run as plain data, those in JSON decoded; words of users are none."""
    return {str(name): value if name in WORDS else finite(_of_json(value)) for name, value in run.attrs.items()}


def _of_json(value: Any) -> Any:
    if isinstance(value, str) and value[:1] in ("{", "["):
        with suppress(ValueError):
            return json.loads(value)
    return value


def finite(value: Any) -> Any:
    """Return arrays as lists, and None for numbers that are not finite, which JSON does not have."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: finite(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


# Detection of what `save_run` never writes: links, external arrays, and arrays larger than the file.

NO_VARIABLE = b"This is a netCDF dimension but not a netCDF variable"  # the NAME of a scale, which nobody reads


def suspect(file: BinaryIO) -> str | None:
    """Return what an HDF5 file has that `save_run` does not write, in words, or None; no array is read.

    These are links, arrays that are kept in other files, and more numbers than there are bytes.
    """
    import h5py
    from h5py import h5d, h5g, h5l, h5o

    size, total = os.fstat(file.fileno()).st_size, 0
    with h5py.File(file, "r") as opened:
        groups: list[Any] = [h5o.open(opened.id, b"/")]
        seen = {h5o.get_info(groups[0]).addr}
        while groups:
            group = groups.pop()
            for name in group:
                words = repr(name.decode(errors="replace"))
                if group.links.get_info(name).type != h5l.TYPE_HARD:
                    return f"{words} is a link to another place or file"
                found = h5o.open(group, name)
                if isinstance(found, h5d.DatasetID):
                    array = h5py.Dataset(found)
                    if array.is_virtual or array.external:
                        return f"the numbers of {words} are kept in other files"
                    total += 0 if bytes(array.attrs.get("NAME", b"")).startswith(NO_VARIABLE) else array.nbytes
                    if total > size:
                        return f"up to {words} its arrays take {total} bytes, but it has {size}"
                elif isinstance(found, h5g.GroupID) and (at := h5o.get_info(found).addr) not in seen:
                    seen.add(at)
                    groups.append(found)
    return None


SEAL = "\nnontwist: {:020d} bytes, crc32 {:08x}\n"
PATTERN = re.compile(rb"\nnontwist: (\d{20}) bytes, crc32 ([0-9a-f]{8})\n")
LENGTH, BEGINS = len(SEAL.format(0, 0)), b"\nnontwist: "
HDF5 = b"\x89HDF\r\n\x1a\n"
BLOCK = 2**20
UNSEALED = "has no seal: another program, as Dataset.to_netcdf, wrote or changed it, not nontwist.save_run(run, path)"
EXPORTED = (".csv", ".npz", ".json")  # what `nontwist export` writes


def save_run(run: Dataset, path: str | os.PathLike[str], *, force: bool = False) -> None:
    """Write a run, or a result of `twist`, as a NetCDF-4 file sealed with a checksum.

    The file appears under its name only once it has been written completely to disk.

    Parameters
    ----------
    run : Dataset
    path : path
    force : bool
        Overwrite an existing file.

    Raises
    ------
    ValueError
        `run` is not a run, `path` is not a path, or the name has the suffix of another format, .csv, .npz or .json.
    FileExistsError
        The file exists, and `force` is not set.
    BlockingIOError
        Another process is writing this file, or has reserved it.
    OSError
        The folder does not exist or cannot be written, or the disk is full; no partial file remains.

    Examples
    --------
    >>> from nontwist import nontwisting, open_run, save_run, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, angular_velocity=(0, 2, 0))
    >>> save_run(run, "run.nc")
    >>> open_run("run.nc").identical(run)
    True
    """
    run = as_dataset(run, "a run or a result of twist")
    place = as_path(path, "path")
    if place.suffix.lower() in EXPORTED:
        raise ValueError(f"{place}: save_run writes NetCDF, NAME.nc; nontwist export NAME.nc --out {place} writes that")
    with reserved(place, force=force) as write:
        write(run)


@contextmanager
def reserved(path: str | os.PathLike[str], *, force: bool = False) -> Iterator[Callable[[Dataset], None]]:
    """Reserve an output file before a long run; errors as in `save_run`, but at once.

    Yields
    ------
    write : callable
        Writes a dataset; it may be called again.
    """
    with reserved_path(path, force=force) as place:
        yield lambda run: _write(run, place)


def _write(run: Dataset, place: Path) -> None:
    content = _content(run)
    with atomic_file(place) as file:
        file.write(content)
        file.write(SEAL.format(len(content), zlib.crc32(content)).encode("ascii"))


def _content(run: Dataset) -> memoryview:
    """Return the file that ``run.to_netcdf(engine="h5netcdf")`` writes; that would import Dask, in half a second."""
    import h5netcdf
    import h5py
    from xarray.conventions import encode_cf_variable, encode_dataset_coordinates

    content = BytesIO()
    variables, attributes = encode_dataset_coordinates(run)
    with h5netcdf.File(content, "w") as file:
        file.dimensions = {str(name): size for name, size in run.sizes.items()}
        file.attrs.update({"format_version": FORMAT_VERSION} | attributes)  # not all results state it
        for name, variable in variables.items():
            variable = variable.copy(deep=False)
            variable.encoding = {"_FillValue": None}
            variable = encode_cf_variable(variable, name=name)
            values = np.asarray(variable.values)
            if values.dtype.kind not in "fiuOUS":
                raise ValueError(f"{name} holds {values.dtype}: only real numbers and text can be saved")
            kind = values.dtype if values.dtype.kind in "fiu" else h5py.string_dtype()
            target = file.create_variable(name, variable.dims, kind)
            target[...] = values if values.dtype == kind else values.astype(object)
            target.attrs.update(variable.attrs)
    return content.getbuffer()


def open_run(path: str | os.PathLike[str]) -> Dataset:
    """Read a run completely, and verify the seal that `save_run` gave it.

    A run that ``run.to_netcdf(path)`` wrote has no seal; it is read with a warning. ``xarray.open_dataset(path,
    engine="h5netcdf")`` reads a file lazily, without verification.

    Parameters
    ----------
    path : path

    Returns
    -------
    Dataset
        The run as it was saved.

    Raises
    ------
    ResultFileError
        The file is not a run, is truncated, damaged, changed by another program, or of a newer format; or it has
        links, arrays that are stored in other files, or arrays larger than the file.
    ValueError
        `path` is not a path.
    OSError
        The file does not exist or cannot be read; it is a FIFO or a device.

    Warns
    -----
    UserWarning
        The file has no seal, so that nothing verifies it.

    Examples
    --------
    >>> from nontwist import nontwisting, open_run, save_run, simulate
    >>> body = nontwisting([3, 4, 5])
    >>> save_run(simulate(body, t_end=1, angular_velocity=(0, 2, 0)), "run.nc")
    >>> rest = simulate(body, t_end=3, start=open_run("run.nc"))
    >>> rest.time.values[[0, -1]]
    array([1., 3.])
    """
    path = as_path(path, "path")
    if not os.path.exists(path):
        raise FileNotFoundError(f"no such file: {path}")
    require_regular(path)
    with open(path, "rb") as file:
        if (reason := _broken_seal(file)) == UNSEALED:
            warn(f"{path} {reason}; it is read, unverified")
        elif reason:
            raise ResultFileError(f"{path} {reason}")
        try:
            run = _loaded(file)
        except ResultFileError as error:
            raise ResultFileError(f"{path} {error}") from error
        except MemoryError:
            raise
        except Exception as error:  # HDF5 and its readers raise exceptions of any kind
            raise ResultFileError(f"{path} cannot be read: {type(error).__name__}: {error}") from error
    run.encoding["source"] = os.fspath(path)  # as xarray.open_dataset has it
    return run


def _loaded(file: BinaryIO) -> Dataset:
    """Return what ``xarray.open_dataset`` reads of a file, loaded, in a third of its time.

    To ask of each array whether it is one of Dask's, that would import Dask as well, in half a second.
    """
    import h5netcdf

    if reason := suspect(file):
        raise ResultFileError(f"was not written by save_run: {reason}")
    variables, named = dict[str, Any](), set[str]()
    with h5netcdf.File(file, "r", decode_vlen_strings=True) as opened:
        record = dict(opened.attrs)
        if reason := _foreign(record):
            raise ResultFileError(reason)
        if "stretches" in record:  # of 0.2.0
            record["segments"] = record.pop("stretches")
        for name, stored in opened.variables.items():
            attributes = dict(stored.attrs)
            named.update(attributes.pop("coordinates", "").split())
            attributes.pop("_FillValue", None)  # which xarray adds: NaN
            variables[name] = _decoded(name, stored.dimensions, _values(stored[...]), attributes)
    named.update(record.pop("coordinates", "").split())
    return assembled(variables, record, named)


def _values(stored: Any) -> NDArray[Any]:
    """Return an array that was stored, numbers in the order of bytes of this machine, texts as such."""
    values = np.asarray(stored)
    return values.astype(values.dtype.newbyteorder("=") if values.dtype.kind in "fiu" else str, copy=False)


def _decoded(name: str, dims: tuple[str, ...], values: NDArray[Any], attributes: dict[str, Any]) -> tuple[Any, ...]:
    """Return what the CF conventions make of a variable: dates, durations and truth values were stored as numbers."""
    if "dtype" not in attributes and " since " not in str(attributes.get("units")):
        return dims, values, attributes
    import xarray
    from xarray.conventions import decode_cf_variable

    found = decode_cf_variable(name, xarray.Variable(dims, values, attributes))
    return dims, np.asarray(found.values), found.attrs


def _broken_seal(file: BinaryIO) -> str | None:
    """Return what is wrong with the bytes of a file, or None."""
    length = file.seek(0, os.SEEK_END)
    file.seek(max(0, length - LENGTH))
    seal = file.read()
    match = PATTERN.fullmatch(seal)
    file.seek(0)
    if match is None:
        alike = sum(a == b for a, b in zip(seal, SEAL.format(0, 0).encode("ascii"), strict=False))
        is_cut = BEGINS in seal or any(seal.endswith(BEGINS[:k]) for k in range(3, len(BEGINS)))
        return "is damaged: its seal cannot be read" if is_cut or 2 * alike > LENGTH else _unsealed(file, length)
    checksum = size = 0
    while size < length - LENGTH:
        block = file.read(min(BLOCK, length - LENGTH - size))
        checksum, size = zlib.crc32(block, checksum), size + len(block)
    file.seek(0)
    if size != int(match[1]):
        return f"is damaged: it holds {size} bytes, {int(match[1])} were written"
    if checksum != int(match[2], 16):
        return f"is damaged: the CRC-32 of its bytes is {checksum:08x}, {match[2].decode()} was written"
    return None


def _unsealed(file: BinaryIO, length: int) -> str:
    """Return what a file without a seal is."""
    import h5py

    if not length:
        return "is empty"
    head = file.read(len(HDF5))
    if head != HDF5:
        text = head.decode("ascii", "replace")
        if all(letter.isprintable() or letter.isspace() for letter in text) and "\ufffd" not in text:
            return f"is not a NetCDF-4 file but text, {text.strip().partition(chr(10))[0]!r} ..."
        return f"is not a NetCDF-4 file: its first bytes are {head.hex(' ')}"
    file.seek(0)
    try:
        with h5py.File(file, "r") as data:
            attributes = dict(data.attrs)
    except Exception:  # HDF5 raises exceptions of any kind
        return f"is cut off or damaged: HDF5 cannot open the rest, {length} bytes"
    return _foreign(attributes) or UNSEALED


def _foreign(attributes: Mapping[str, Any]) -> str | None:
    found = np.ravel(attributes.get("format_version", []))
    if found.size != 1 or found.dtype.kind not in "iu":
        return "is not a run of nontwist: it has no format_version"
    if found[0] > FORMAT_VERSION:
        return f"has format {found[0]}; this version of nontwist reads up to {FORMAT_VERSION}, a newer one reads it"
    return None
