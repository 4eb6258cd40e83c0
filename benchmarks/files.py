"""Result files compared with bare h5py: a run of 10^6 stored steps, written, and read with its checksum verified.

"bare" is `h5py.File` and one `create_dataset` for each array, flushed to the disk as a result is.
"""

from __future__ import annotations

import os
import tempfile
from functools import partial
from pathlib import Path

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
        ours, bare = Path(folder) / "ours.nc", Path(folder) / "bare.h5"
        calls = {
            "bare write": partial(write_bare, bare, arrays),
            "save_run": partial(save_run, run, ours, force=True),
            "bare read": partial(read, bare),
            "open_run": partial(open_run, ours),
        }
        found = fastest(calls)
    ratios = (("save_run", "bare write"), ("open_run", "bare read"))
    return [
        Row("10^6 stored steps", sum(array.nbytes for array in arrays.values()) / 1e6, "MB"),
        *(Row(str(name), seconds, "s") for name, seconds in found.items()),
        *(Row(f"{name} over {other}", found[name] / found[other], "×") for name, other in ratios),
    ]


def write_bare(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write arrays with h5py, to the disk."""
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file.create_dataset(name, data=array)
    with open(path, "rb") as file:
        os.fsync(file.fileno())


def read(path: Path) -> list[np.ndarray]:
    """Read all arrays with h5py."""
    with h5py.File(path) as file:
        return [file[name][...] for name in file]
