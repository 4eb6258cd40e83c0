"""Result files compared with bare h5py: a run of 10^6 stored steps, written, and read with its checksum verified.

"bare" is `h5py.File` and one `create_dataset` for each array, flushed to the disk as a result is; "summed" is the same
with HDF5's checksum Fletcher-32.
"""

from __future__ import annotations

import os
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from nontwist import nontwisting, open_run, pulse, save_run, simulate

from .rows import Row
from .timing import fastest

STEPS = 10**6


def rows() -> list[Row]:
    """Measure all."""
    start = {"material_angular_velocity": (0.6, -0.8, 0)}
    run = simulate(nontwisting([3, 4, 5]), t_end=1000, step=1000 / STEPS, load=pulse((1, 2, 0)), **start)
    arrays = {str(name): variable.values for name, variable in run.variables.items() if variable.dtype.kind in "fi"}
    with tempfile.TemporaryDirectory() as folder:
        ours, bare, summed = (Path(folder) / name for name in ("ours.nc", "bare.h5", "summed.h5"))
        calls = {
            "bare write": partial(write_bare, bare, arrays),
            "summed write": partial(write_bare, summed, arrays, fletcher32=True),
            "save_run": partial(save_run, run, ours, force=True),
            "bare read": partial(read, bare),
            "summed read": partial(read, summed),
            "open_run": partial(open_run, ours),
        }
        found = fastest(calls)
    ratios = (("save_run", "bare write"), ("save_run", "summed write"), ("open_run", "bare read"))
    return [
        Row("10^6 stored steps", sum(array.nbytes for array in arrays.values()) / 1e6, "MB"),
        *(Row(str(name), seconds, "s") for name, seconds in found.items()),
        *(Row(f"{name} over {other}", found[name] / found[other], "×") for name, other in ratios),
        Row("open_run over summed read", found["open_run"] / found["summed read"], "×"),
    ]


def write_bare(path: Path, arrays: dict[str, np.ndarray], **options: Any) -> None:
    """Write arrays with h5py, to the disk."""
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file.create_dataset(name, data=array, **options)
    with open(path, "rb") as file:
        os.fsync(file.fileno())


def read(path: Path) -> list[np.ndarray]:
    """Read all arrays with h5py."""
    with h5py.File(path) as file:
        return [file[name][...] for name in file]
