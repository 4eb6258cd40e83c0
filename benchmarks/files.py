"""Result files compared with bare h5py: a run of 10^6 stored steps, written, and read with its checksum verified.

"bare" is `h5py.File` and one `create_dataset` for each array: by default, flushed to the disk as a result is, or with
HDF5's checksum Fletcher-32.
"""

from __future__ import annotations

import os
import random
import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import h5py
import numpy as np

from nontwist import nontwisting, open_run, pulse, save_run, simulate

from .rows import Row

STEPS, PASSES = 10**6, 9
BODY, LOAD = nontwisting([3, 4, 5]), pulse((1, 2, 0))


def rows() -> list[Row]:
    """Measure all."""
    run = simulate(BODY, t_end=1000, step=1000 / STEPS, material_angular_velocity=(0.6, -0.8, 0), load=LOAD)
    arrays = {str(name): variable.values for name, variable in run.variables.items() if variable.dtype.kind in "fi"}
    size = sum(array.nbytes for array in arrays.values()) / 1e6
    with tempfile.TemporaryDirectory() as folder:
        ours, bare, summed = (Path(folder) / name for name in ("ours.nc", "bare.h5", "summed.h5"))
        calls: dict[str, Callable[[], Any]] = {
            "bare": lambda: _write(bare, arrays),
            "flushed": lambda: _flushed(bare, arrays),
            "summed": lambda: _flushed(summed, arrays, fletcher32=True),
            "written": lambda: save_run(run, ours, force=True),
            "bare read": lambda: _read(bare),
            "summed read": lambda: _read(summed),
            "read": lambda: open_run(ours),
        }
        found = _medians(calls)
    return [
        Row("10^6 stored steps", size, "MB"),
        Row("bare h5py write", found["bare"], "s"),
        Row("   flushed to the disk", found["flushed"], "s"),
        Row("   flushed to the disk, with Fletcher-32", found["summed"], "s"),
        Row("bare h5py read", found["bare read"], "s"),
        Row("   with Fletcher-32", found["summed read"], "s"),
        Row("save_run", found["written"], "s"),
        Row("open_run", found["read"], "s"),
        Row("save_run over bare write, both flushed to the disk", found["written"] / found["flushed"], "×"),
        Row("open_run over that write", found["read"] / found["flushed"], "×"),
        Row("save_run over bare write with Fletcher-32", found["written"] / found["summed"], "×"),
        Row("open_run over bare read with Fletcher-32", found["read"] / found["summed read"], "×"),
        Row("save_run over bare write left to the system", found["written"] / found["bare"], "×"),
        Row("open_run over that write", found["read"] / found["bare"], "×"),
    ]


def _medians(calls: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Return the median seconds of each call; they take turns in shuffled order."""
    order, draw = list(calls), random.Random(1)
    times: dict[str, list[float]] = {name: [] for name in order}
    for turn in range(PASSES + 1):
        for name in order:
            start = perf_counter()
            calls[name]()
            if turn:
                times[name].append(perf_counter() - start)
        draw.shuffle(order)
    return {name: median(found) for name, found in times.items()}


def _write(path: Path, arrays: dict[str, np.ndarray], **options: Any) -> None:
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file.create_dataset(name, data=array, **options)


def _flushed(path: Path, arrays: dict[str, np.ndarray], **options: Any) -> None:
    _write(path, arrays, **options)
    with open(path, "rb") as file:
        os.fsync(file.fileno())


def _read(path: Path) -> list[np.ndarray]:
    with h5py.File(path) as file:
        return [file[name][...] for name in file]
