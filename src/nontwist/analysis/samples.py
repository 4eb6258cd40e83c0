"""Recorded attitudes, cleaned: invalid and duplicate rows are dropped and rows sorted, each with a warning."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..geometry.values import counted
from .motions import measured_quaternions, raw_motion
from .places import Lines, lines_of, place
from .time_values import seconds

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

GAP = 5.0  # times the median interval
DUPLICATE, TINIEST = 1e-12, 1e-100  # of the span, s: closer times are duplicates
PARTS, MANY, FEWEST = 4, 1 / 3, 4  # times look rounded where more rows of each part are duplicates; of different times


@dataclass(frozen=True)
class Samples:
    """Attitudes in the order of time; `rows` are their row numbers in the recording, from 0.

    The quaternions are those of the recording where it has them, not of length 1 to round-off then. `notes` tell what
    is wrong with it, `facts` what was found to align it with another.
    """

    quaternion: Array  # (k, 4) scalar last
    time: Array | None
    rows: NDArray[np.int64]
    left_out: int
    notes: list[str]
    facts: tuple[str, ...] = ()
    lines: Lines | None = None  # of the rows of the recording, in its file

    def place(self, k: int) -> str:
        """Return where the k-th attitude is in the recording, by its line or row."""
        return place(self.rows[k], self.lines)

    @property
    def rotation(self) -> Rotation:
        """The attitudes."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.quaternion)


@dataclass(frozen=True)
class Motion:
    """What the caller gives of one body: values as `raw_motion` returns them, times, s, and what these count from.

    `lines` are those of its rows in a file, or None.
    """

    values: Any
    time: Array | None
    start: float | None
    lines: Lines | None = None


def given_motion(motion: Any, time: Any, scalar_first: bool | None, name: str) -> Motion:
    """Return a motion with its times; a ValueError names what does not fit."""
    values, own_time = raw_motion(motion, scalar_first)
    t = None if time is None and own_time is None else seconds(own_time if time is None else time)
    if t is not None and t.shape != (len(values),):
        raise ValueError(
            f"{name} must have the shape ({len(values)},) as the motion has {len(values)} samples, got {t.shape}"
        )
    start = getattr(motion, "attrs", {}).get("start") if time is None and hasattr(motion, "dims") else None
    return Motion(values, t, None if start is None else float(start), lines_of(motion))


def samples(motion: Motion, beside: Motion | None = None) -> tuple[Samples, Samples | None]:
    """Return checked attitudes, of `beside` as well at the same rows; warnings and errors as in `nontwist.twist`.

    `beside` has the times of the motion, or none.
    """
    values, t, count = motion.values, motion.time, len(motion.values)
    bad, lines = _missing(values), motion.lines
    if beside is not None:
        bad |= _missing(beside.values)
        if lines is not None and beside.lines is not None and not np.array_equal(beside.lines, lines):
            lines = None
    rows, notes = np.arange(count), []
    if t is not None:
        bad |= ~np.isfinite(t)
    if bad.any():
        notes.append(
            f"dropped {counted(bad.sum(), 'row')} with a zero or missing attitude or a missing time, the first is "
            f"{place(rows[bad][0], lines)}"
        )
        rows = rows[~bad]
    if t is not None:
        rows = ordered(t, rows, notes, lines)
    if rows.size < 2:
        why = f": {'; '.join(notes)}" if notes else ""
        raise ValueError(f"a twist needs at least 2 samples; {rows.size} of {count} are left{why}")
    kept = None if t is None else t[rows]
    if kept is not None:
        _gaps(kept, rows, notes, lines)
    left_out = count - rows.size
    found, other = (
        None
        if one is None
        else Samples(measured_quaternions(one.values, rows, one.lines), kept, rows, left_out, notes, lines=lines)
        for one in (motion, beside)
    )
    assert found is not None
    return found, other


def told(notes: list[str], stacklevel: int) -> None:
    """Warn of everything in `notes`."""
    for note in notes:
        warnings.warn(note, stacklevel=stacklevel + 1)


def _missing(values: Any) -> NDArray[np.bool_]:
    if not isinstance(values, np.ndarray):
        return np.zeros(len(values), dtype=np.bool_)
    flat = values.reshape(len(values), math.prod(values.shape[1:]))
    return np.array(~np.isfinite(flat).all(axis=1) | ~flat.any(axis=1), dtype=np.bool_)


def ordered(t: Array, rows: NDArray[np.int64], notes: list[str], lines: Lines | None) -> NDArray[np.int64]:
    """Return rows in the order of their times, those that repeat a time left out; `notes` say what was wrong."""
    late = np.flatnonzero(np.diff(t[rows]) < 0)
    if late.size:
        notes.append(f"times are not in order, the first at {place(rows[late[0] + 1], lines)}; rows are sorted by time")
        rows = rows[np.argsort(t[rows], kind="stable")]
    span = float(t[rows[-1]] - t[rows[0]]) if rows.size else 0.0
    duplicate = np.append(False, np.diff(t[rows]) <= max(DUPLICATE * span, TINIEST))[: rows.size]
    if duplicate.any():
        first = place(int(rows[duplicate].min()), lines)
        notes.append(
            f"dropped {counted(duplicate.sum(), 'row')} with duplicate timestamps, the first is {first}"
            f"{'' if late.size else _rounded(t[rows], duplicate)}"
        )
        rows = rows[~duplicate]
    return rows


def _rounded(t: Array, duplicate: NDArray[np.bool_]) -> str:
    """Return what to do about times that look rounded; "" unless many rows in all parts repeat the time before."""
    if min(part.mean() if part.size else 0.0 for part in np.array_split(duplicate, PARTS)) <= MANY:
        return ""
    first = np.flatnonzero(~duplicate)
    if first.size < FEWEST:
        return ""
    step = float(np.median(np.diff(t[first])))
    inner, groups = first[-1] - first[1], first.size - 2  # rounding cuts the first and the last group
    each = inner / groups
    if abs(inner - round(each) * groups) <= 2:  # halves are rounded either way
        each = round(each)
    return (
        f": the times look rounded to {step:.3g} s, as about {each:.2g} rows share each; --rate {each / step:.4g} "
        "(rate=), or the sample rate that you know, ignores the times and reads all rows as evenly spaced; the error "
        f"estimates do not include an error of the times of {step / 2:.2g} s"
    )


def _gaps(t: Array, rows: NDArray[np.int64], notes: list[str], lines: Lines | None) -> None:
    step = np.diff(t)
    wide = np.flatnonzero(step > GAP * np.median(step))
    if wide.size:
        k = int(wide[np.argmax(step[wide])])
        notes.append(
            f"{counted(wide.size, 'gap')} longer than {GAP:g} sampling intervals, the longest of {step[k]:.4g} s from "
            f"{place(rows[k], lines)} to {place(rows[k + 1], lines)}: the motion in between is a guess"
        )
