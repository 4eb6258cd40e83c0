"""Runs on disk: NetCDF-4 with checksums, written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray


def save_run(run: xarray.Dataset, path: str | os.PathLike[str]) -> None:
    """Write a dataset as NetCDF-4, every variable compressed and with a Fletcher-32 checksum.

    The file appears under its name only when it is complete.

    Raises
    ------
    OSError
        The folder does not exist or cannot be written.
    """
    path = Path(path)
    encoding = {
        name: {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}
        for name, variable in run.variables.items()
        if variable.dtype.kind in "fi" and variable.ndim
    }
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        run.to_netcdf(temporary, engine="h5netcdf", encoding=encoding)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def open_run(path: str | os.PathLike[str]) -> xarray.Dataset:
    """Read a run that `save_run` wrote, whole, checksums verified.

    Raises
    ------
    FileNotFoundError
        No such file.
    ValueError
        Not a run of this package, or of a newer format.
    OSError
        The file is damaged.
    """
    import xarray

    from .analysis.trajectory import FORMAT_VERSION

    if not Path(path).is_file():
        raise FileNotFoundError(f"no such file: {path}")
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        run = data.load()
    found = run.attrs.get("format_version")
    if found is None:
        raise ValueError(f"{path} is not a run of nontwist: it has no format_version")
    if int(found) > FORMAT_VERSION:
        raise ValueError(f"{path} has format {found}; this version reads up to {FORMAT_VERSION}")
    return run
