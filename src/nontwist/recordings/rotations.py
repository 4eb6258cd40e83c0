"""What recorded numbers are as rotations: rounded, scaled, missing in some rows, or none at all.

Rows that are no rotations where others are, sentinels, zeros and identities in place of lost rows are missing: NaN,
counted in a note. One common scale and rounding are mended where the caller asks. All else is refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Array
from ..geometry.values import counted
from .table import Lines, place

MEASURED = 1e-2  # by which recorded rotations, which are rounded, may be off
RARE = 0.1  # of all rows: so few that are no rotations are missing
JUMP = 3.0  # times the largest steps: beyond it an exact identity is none
SENTINELS = 3  # values of a row that stand for missing, at most


@dataclass(frozen=True)
class Motion:
    """A motion: a Rotation, (..., 3, 3) matrices Λ or (..., 4) quaternions, scalar last.

    With its times, as given, what these count from, s, the lines of its rows in a file, where there are any, and how
    it was read.
    """

    values: Any
    time: Any = None
    start: float | None = None
    lines: Lines | None = None
    notes: tuple[str, ...] = ()


@np.errstate(over="ignore", invalid="ignore")
def rotations(values: Array, lines: Lines | None, normalize: bool) -> tuple[Array, tuple[str, ...]]:
    """Return rotations to 1 %, to round-off where `normalize` is set, NaN in rows that are missing, and notes.

    An InputError where most rows are no rotations, or are so by a common scale or rounding and `normalize` is not set.
    """
    flat, is_quaternion = values.reshape(len(values), math.prod(values.shape[1:])), values.shape[-1] == 4
    good = np.isfinite(flat).all(axis=1) & flat.any(axis=1) & (abs(flat).max(axis=1, initial=0) < 1e100)
    size, off = np.linalg.norm(flat, axis=1) / math.sqrt(1 if is_quaternion else 3), _defect(values)
    if not good.any():
        return values, ()
    bad, lost = good & ~(off <= MEASURED), good & _lost_identities(flat)
    what, plural = ("quaternion", "quaternions") if is_quaternion else ("matrix", "matrices")
    told = list[str]()
    if bad.any() and bad.sum() > RARE * good.sum() and len(np.unique(flat[bad], axis=0)) > SENTINELS:
        scale = float(np.median(size[good]))
        steps = np.diff(np.unique(flat[good].ravel()))
        quantum = float(steps[steps > 0].min(initial=np.inf)) / scale  # of rounded values
        room = max(MEASURED, 2 * quantum if quantum < 0.5 else 0.0) * (1 if is_quaternion else 3)
        rare = good & (_defect(values / scale) > room)
        if rare.sum() > RARE * good.sum():
            raise InputError("not-rotations", what=plural, low=size[good].min(), high=size[good].max())
        if not normalize:
            looks, k = "rounded" if abs(scale - 1) < MEASURED else f"scaled by {scale:.6g}", int(bad.argmax())
            rows = counted(int(bad.sum()), "row")
            raise InputError("scaled", rows=rows, place=place(k, lines), what=what, size=size[k], looks=looks)
        bad = rare
    for which, why in ((bad, f"which are not valid {plural}"), (lost, "whose identities stand for lost ones")):
        if which.any():
            first = place(int(which.argmax()), lines)
            told.append(f"missing: {counted(int(which.sum()), 'row')}, {why}, the first is {first}")
    gone = bad | lost
    if gone.any() or normalize:
        values = values.copy()
    values[gone] = np.nan
    good &= ~gone
    if normalize and is_quaternion:
        values[good] /= size[good, None]
        told.append(f"normalized: quaternions had lengths from {size[good].min():.6g} to {size[good].max():.6g}")
    elif normalize:
        left, _, right = np.linalg.svd(values[good])
        values[good] = left @ right
        told.append(f"normalized: |ΛᵀΛ - I| was up to {off[good].max():.3g}")
    return values, tuple(told)


def _defect(values: Array) -> Array:
    """Return by how much quaternions differ from the length 1, or products ΛᵀΛ from the identity."""
    if values.shape[-1] == 4:
        return np.asarray(abs(np.linalg.norm(values, axis=1) - 1))
    return np.asarray(abs(np.swapaxes(values, 1, 2) @ values - np.eye(3)).max(axis=(1, 2)))


def _lost_identities(flat: Array) -> NDArray[np.bool_]:
    """Return which rows are exact identities, from and to which the attitudes jump far more than between others."""
    units, signs = (np.eye(4)[[0, 3]], (1, -1)) if flat.shape[1] == 4 else (np.eye(3).reshape(1, 9), (1,))
    same, lost = (flat[:, None] == units).all(axis=2).any(axis=1), np.zeros(len(flat), dtype=np.bool_)
    if not same.any() or same.all():
        return lost
    steps = np.min([np.linalg.norm(flat[1:] - sign * flat[:-1], axis=1) for sign in signs], axis=0)
    others = steps[np.isfinite(steps) & ~same[1:] & ~same[:-1]]
    most = float(np.quantile(others, 0.99)) if others.size else 0.0
    far = np.concatenate([[True], steps > (JUMP * most if most > 0 else np.inf), [True]])
    for first, last in np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]))).reshape(-1, 2):
        lost[first:last] = far[first] and far[last]
    return lost
