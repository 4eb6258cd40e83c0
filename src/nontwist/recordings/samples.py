"""Recorded attitudes, cleaned: invalid and duplicate rows are dropped and rows sorted, each with a warning."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, InputWarning, Option
from ..geometry.arrays import Array
from ..geometry.values import counted
from .motions import measured_quaternions, raw_motion
from .rotations import Motion
from .table import Lines, place
from .times import seconds

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

GAP = 5.0  # times the median interval
DUPLICATE, TINIEST = 1e-12, 1e-100  # of the span, s: closer times are duplicates
MOST_STARTS, LATE = 10, 0.02  # times that a clock may start again; of all rows, those that are then behind
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
    notes: list[InputWarning]
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


def given_motion(motion: Any, time: Any, scalar_first: bool | None, name: str) -> Motion:
    """Return a motion with its times; a ValueError names what does not fit."""
    found = raw_motion(motion, scalar_first)
    start, given = (found.start, found.time) if time is None else (None, time)
    t = None if given is None else seconds(given)
    if t is not None and t.shape != (len(found.values),):
        raise InputError("time-shape", name=name, count=len(found.values), shape=t.shape)
    return replace(found, time=t, start=None if start is None else float(start))


def samples(motion: Motion, beside: Motion | None = None) -> tuple[Samples, Samples | None]:
    """Return checked attitudes, of `beside` as well at the same rows; warnings and errors as in `nontwist.twist`.

    `beside` has the times of the motion, or none.
    """
    given = [motion] if beside is None else [motion, beside]
    t, lines = motion.time, motion.lines
    if any(lines is not None and one.lines is not None and not np.array_equal(one.lines, lines) for one in given):
        lines = None
    good = np.all([_is_there(one.values) for one in given], axis=0)
    rows, notes = kept_rows(t, good, lines, "missing-rows", "a twist", 2)
    kept, left_out = None if t is None else t[rows], len(good) - rows.size
    found = [Samples(measured_quaternions(one, rows), kept, rows, left_out, notes, lines=lines) for one in given]
    return found[0], found[1] if beside is not None else None


def _is_there(values: Any) -> NDArray[np.bool_]:
    if not isinstance(values, np.ndarray):
        return np.ones(len(values), dtype=np.bool_)
    flat = values.reshape(len(values), math.prod(values.shape[1:]))
    return np.asarray(np.isfinite(flat).all(axis=1) & flat.any(axis=1))


def kept_rows(
    t: Array | None, good: NDArray[np.bool_], lines: Lines | None, code: str, what: str, least: int
) -> tuple[NDArray[np.int64], list[InputWarning]]:
    """Return the good rows in the order of time, and what is wrong; `code` is that of rows that are not good.

    An InputError where fewer are left than the `least` that `what` needs.
    """
    notes = list[InputWarning]()
    bad = ~(good if t is None else good & np.isfinite(t))
    if bad.any():
        notes.append(InputWarning(code, rows=counted(int(bad.sum()), "row"), place=place(int(bad.argmax()), lines)))
    rows = np.flatnonzero(~bad) if t is None else _ordered(t, np.flatnonzero(~bad), notes, lines)
    if rows.size < least:
        why = f": {'; '.join(map(str, notes))}" if notes else ""
        raise InputError("too-few-samples", what=what, least=least, left=rows.size, count=len(good), why=why)
    return rows, notes if t is None else notes + _gaps(t[rows], rows, lines)


def _ordered(t: Array, rows: NDArray[np.int64], notes: list[InputWarning], lines: Lines | None) -> NDArray[np.int64]:
    """Return rows in the order of their times, those that repeat a time left out; `notes` say what was wrong.

    An InputError where the clock starts again: rows of the second part are not of the first.
    """
    late = np.flatnonzero(np.diff(t[rows]) < 0)
    if late.size:
        first = place(rows[late[0] + 1], lines)
        behind = t[rows] < np.maximum.accumulate(t[rows])
        if late.size <= min(MOST_STARTS, 1 + rows.size // 20) and behind.sum() > max(FEWEST, LATE * rows.size):
            raise InputError("clock-goes-back", back=-float(np.diff(t[rows])[late[0]]), place=first)
        notes.append(InputWarning("unsorted-times", place=first))
        rows = rows[np.argsort(t[rows], kind="stable")]
    span = float(t[rows[-1]] - t[rows[0]]) if rows.size else 0.0
    duplicate = np.append(False, np.diff(t[rows]) <= max(DUPLICATE * span, TINIEST))[: rows.size]
    if duplicate.any():
        fields = _rounded(t[rows], duplicate) if not late.size else {}
        first = place(int(rows[duplicate].min()), lines)
        code = "rounded-times" if fields else "duplicate-times"
        notes.append(InputWarning(code, rows=counted(int(duplicate.sum()), "row"), place=first, **fields))
        rows = rows[~duplicate]
    return rows


def _rounded(t: Array, duplicate: NDArray[np.bool_]) -> dict[str, Any]:
    """Return what to do about times that look rounded; "" unless many rows in all parts repeat the time before."""
    first = np.flatnonzero(~duplicate)
    few = min(part.mean() if part.size else 0.0 for part in np.array_split(duplicate, PARTS)) <= MANY
    if few or first.size < FEWEST:
        return {}
    step = float(np.median(np.diff(t[first])))
    inner, groups = first[-1] - first[1], first.size - 2  # rounding cuts the first and the last group
    each = inner / groups
    if abs(inner - round(each) * groups) <= 2:  # halves are rounded either way
        each = round(each)
    hertz = each / step
    return {"step": step, "each": each, "hertz": hertz, "rate": Option(f"rate={hertz:.4g}"), "half": step / 2}


def _gaps(t: Array, rows: NDArray[np.int64], lines: Lines | None) -> list[InputWarning]:
    """Return what is to be said of long gaps between times."""
    step = np.diff(t)
    wide = np.flatnonzero(step > GAP * np.median(step))
    if not wide.size:
        return []
    k = int(wide[np.argmax(step[wide])])
    ends = {"first": place(rows[k], lines), "last": place(rows[k + 1], lines)}
    return [InputWarning("gaps", gaps=counted(wide.size, "gap"), most=GAP, step=step[k], **ends)]
