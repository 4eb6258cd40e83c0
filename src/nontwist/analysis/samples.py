"""Recorded attitudes, cleaned: invalid and duplicate rows are dropped and rows sorted, each with a warning."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from .motions import MEASURED, as_rotation, raw_motion
from .tables import seconds

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

GAP = 5.0  # times the median interval
DUPLICATE, TINIEST = 1e-12, 1e-100  # of the span, s: closer times are duplicates


@dataclass(frozen=True)
class Samples:
    """Attitudes in the order of time; `rows` are their row numbers in the recording."""

    rotation: Rotation
    time: Array | None
    rows: NDArray[np.int64]
    left_out: int
    notes: list[str]


def samples(motion: Any, time: Any, relative_to: Any, scalar_first: bool | None) -> Samples:
    """Return checked attitudes; parameters, warnings and errors as in `nontwist.twist`."""
    values, own_time = raw_motion(motion, scalar_first)
    t = None if time is None and own_time is None else seconds(own_time if time is None else time)
    count = len(values)
    if t is not None and t.shape != (count,):
        raise ValueError(f"time must have the shape ({count},) as the motion has {count} samples, got {t.shape}")
    bad = _missing(values)
    if relative_to is not None:
        base, base_time = raw_motion(relative_to, scalar_first)
        if len(base) != count:
            raise ValueError(f"relative_to has {len(base)} samples, the motion {count}: they must be taken together")
        if t is not None and base_time is not None and not np.array_equal(seconds(base_time), t, True):
            raise ValueError("relative_to has other times than the motion: resample one of them")
        bad |= _missing(base)
    rows, notes = np.arange(count), []
    if t is not None:
        bad |= ~np.isfinite(t)
    if bad.any():
        notes.append(
            f"{bad.sum()} row(s) without a finite attitude and time are left out, the first is row {rows[bad][0]}"
        )
        rows = rows[~bad]
    if t is not None:
        rows = _ordered(t, rows, notes)
    if rows.size < 2:
        raise ValueError(f"a twist needs at least 2 samples; {rows.size} of {count} are left")
    rotation = as_rotation(values, MEASURED, rows)
    if relative_to is not None:
        rotation = as_rotation(base, MEASURED, rows).inv() * rotation
    kept = None if t is None else t[rows]
    if kept is not None:
        _gaps(kept, rows, notes)
    for note in notes:
        warnings.warn(note, stacklevel=3)
    return Samples(rotation, kept, rows, count - rows.size, notes)


def _missing(values: Any) -> NDArray[np.bool_]:
    if not isinstance(values, np.ndarray):
        return np.zeros(len(values), dtype=np.bool_)
    flat = values.reshape(len(values), -1)
    return np.array(~np.isfinite(flat).all(axis=1) | ~flat.any(axis=1), dtype=np.bool_)


def _ordered(t: Array, rows: NDArray[np.int64], notes: list[str]) -> NDArray[np.int64]:
    late = np.flatnonzero(np.diff(t[rows]) < 0)
    if late.size:
        notes.append(f"times are not in order, the first at row {rows[late[0] + 1]}; rows are sorted by time")
        rows = rows[np.argsort(t[rows], kind="stable")]
    span = float(t[rows[-1]] - t[rows[0]]) if rows.size else 0.0
    duplicate = np.append(False, np.diff(t[rows]) <= max(DUPLICATE * span, TINIEST))[: rows.size]
    if duplicate.any():
        first = int(rows[duplicate].min())
        notes.append(f"{duplicate.sum()} row(s) repeat the time of another and are left out, the first is row {first}")
        rows = rows[~duplicate]
    return rows


def _gaps(t: Array, rows: NDArray[np.int64], notes: list[str]) -> None:
    step = np.diff(t)
    wide = np.flatnonzero(step > GAP * np.median(step))
    if wide.size:
        k = int(wide[np.argmax(step[wide])])
        notes.append(
            f"{wide.size} gap(s) longer than {GAP:g} sampling intervals, the longest of {step[k]:.4g} s from row "
            f"{rows[k]} to row {rows[k + 1]}: the motion in between is a guess"
        )
