"""A dataset as the bytes of a NetCDF-4 file, in order, without HDF5 near the disk.

HDF5 2.0 ends the process with a segmentation fault when the disk is full while it closes a file. So it writes a file
in memory, without the arrays: attributes, strings and scalars are in it, but for every array of numbers only
the space is set aside (storage allocated at once, never filled). The arrays themselves, which are nearly all of the
file, then come straight from NumPy at the offsets that HDF5 names: no second copy of the run is made, and errors
in writing are raised by Python, as an `OSError`.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray

PAGE = 2**12
Placed = tuple[int, memoryview]


def file_bytes(run: xarray.Dataset) -> Iterator[bytes | memoryview]:
    """Yield the NetCDF-4 file of `run` piece by piece.

    Raises
    ------
    TypeError
        An attribute or a variable that NetCDF cannot hold.
    """
    plan, arrays = _planned(run)
    at = 0
    for offset, values in sorted(arrays, key=lambda placed: placed[0]):
        yield plan.between(at, offset)
        yield values
        at = offset + values.nbytes
    yield plan.between(at, plan.size)


class _Pages(io.RawIOBase):
    """A file in memory of which only the pages that were written exist; the rest reads as zeros."""

    def __init__(self) -> None:
        self.pages: dict[int, bytearray] = {}
        self.at = self.size = 0

    def _parts(self, start: int, stop: int) -> Iterator[tuple[int, slice, slice]]:
        """Cut a range of bytes into the number of a page, the range within it, the range within the whole."""
        at = start
        while at < stop:
            number, inside = divmod(at, PAGE)
            count = min(PAGE - inside, stop - at)
            yield number, slice(inside, inside + count), slice(at - start, at - start + count)
            at += count

    def write(self, data: Any) -> int:
        piece = memoryview(data).cast("B")
        for number, inside, whole in self._parts(self.at, self.at + len(piece)):
            self.pages.setdefault(number, bytearray(PAGE))[inside] = piece[whole]
        self.at += len(piece)
        self.size = max(self.size, self.at)
        return len(piece)

    def between(self, start: int, stop: int) -> bytes:
        """Return the bytes of a range."""
        found = bytearray(stop - start)
        for number, inside, whole in self._parts(start, stop):
            if number in self.pages:
                found[whole] = self.pages[number][inside]
        return bytes(found)

    def readinto(self, buffer: Any) -> int:
        count = max(0, min(len(buffer), self.size - self.at))
        buffer[:count] = self.between(self.at, self.at + count)
        self.at += count
        return count

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self.at = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self.at, io.SEEK_END: self.size}[whence]
        return self.at

    def tell(self) -> int:
        return self.at

    def truncate(self, size: int | None = None) -> int:
        self.size = self.at if size is None else size
        return self.size

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True


def _planned(run: xarray.Dataset) -> tuple[_Pages, list[Placed]]:
    """Return the file without its arrays, and the arrays with their offsets."""
    import h5netcdf
    import h5py
    from h5py import h5d, h5p
    from xarray.conventions import encode_cf_variable, encode_dataset_coordinates

    now = h5p.create(h5p.DATASET_CREATE)
    now.set_alloc_time(h5d.ALLOC_TIME_EARLY)
    now.set_fill_time(h5d.FILL_TIME_NEVER)
    variables, attributes = encode_dataset_coordinates(run)
    plan, planned = _Pages(), []
    with h5netcdf.File(plan, "w") as file:
        file.dimensions = {str(name): size for name, size in run.sizes.items()}
        file.attrs.update(attributes)
        for name, variable in variables.items():
            variable = variable.copy(deep=False)
            variable.encoding = {"_FillValue": None}
            variable = encode_cf_variable(variable, name=name)
            values = np.asarray(variable.values)
            kind = values.dtype if values.dtype.kind in "fiu" else h5py.string_dtype()
            if values.dtype.kind in "fiu" and values.ndim and values.size:
                target = file.create_variable(name, variable.dims, kind, dcpl=now.copy())
                planned.append((file[name]._h5ds.id, values))
            else:
                target = file.create_variable(name, variable.dims, kind)
                try:
                    target[...] = values if values.dtype == kind else values.astype(object)
                except TypeError as error:
                    words = f"{name} holds {values.dtype}: only real numbers and text can be saved"
                    raise ValueError(words) from error
            target.attrs.update(variable.attrs)
        file.flush()
        placed = [(dataset.get_offset(), _raw(values)) for dataset, values in planned]
    return plan, placed


def _raw(values: NDArray[np.generic]) -> memoryview:
    flat: Any = np.ascontiguousarray(values).reshape(-1).view(np.uint8)
    return memoryview(flat)
