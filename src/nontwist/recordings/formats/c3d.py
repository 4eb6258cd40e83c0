"""C3D: the group ROTATION, 4×4 matrices of segments, read by ezc3d.

Source: C-Motion's description of rotation data in C3D files, as ezc3d reads it: the upper left 3×3 block maps segment
to laboratory, the last column is the origin of the segment.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ..options import ReadOptions
from .apart import library, read_apart, readable
from .content import Content, by_name


def read_c3d(path: Path, how: ReadOptions) -> Content:
    """Read the rotations of a file."""
    library("ezc3d", "c3d")
    with readable("C3D file"):
        found = read_apart(rotations, path)
        matrices = np.asarray(found["matrices"], dtype=float)
        labels, rate = [str(one) for one in found["labels"]], float(np.asarray(found["rate"], dtype=float))
    if matrices.ndim != 4 or matrices.shape[2] == 0 or matrices.shape[3] == 0:
        raise InputError("no-rotations")
    names = [labels[k] if k < len(labels) else f"rotation {k + 1}" for k in range(matrices.shape[2])]
    bodies = by_name("segment", ((name, np.moveaxis(matrices[:3, :3, k, :], 2, 0)) for k, name in enumerate(names)))
    time = np.arange(matrices.shape[3]) / rate if rate > 0 else None
    return Content(bodies=bodies, time=time, notes=("orientation: matrices of the group ROTATION",))


def rotations(path: str) -> dict[str, Any]:
    """Return the matrices of a file, (4, 4, bodies, frames), their labels and rate; run in a process of its own."""
    import ezc3d

    file = ezc3d.c3d(path)
    group = file["parameters"].get("ROTATION", {})
    labels = [str(one) for one in group.get("LABELS", {}).get("value", [])]
    rates = [*np.ravel(group.get("RATE", {}).get("value", [])), file["header"]["points"]["frame_rate"]]
    matrices = np.asarray(file["data"]["rotations"], dtype=float)
    return {"matrices": matrices, "labels": np.array(labels, dtype=str), "rate": np.array(float(rates[0]))}
