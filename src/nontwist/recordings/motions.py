"""Every form of a motion: as a SciPy Rotation, or as quaternions with their times, cleaned.

Of motions with times, rows that are missing and duplicates are dropped and rows are sorted, each with a warning.
SciPy's rotations take a third of a second to import: quaternions that are given pass without them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, InputWarning, Option
from ..geometry.arrays import Array, Rotation, as_floats, in_order
from ..geometry.values import counted
from .conventions import as_turns
from .options import ReadOptions
from .orientations import MEASURED, Motion, of_table
from .table import Lines, of_frame, place
from .times import seconds

EXACT = 1e-9  # accepted departure from orthonormality
GAP = 5.0  # times the median interval
DUPLICATE, SHORTEST = 1e-12, 1e-306  # of the span, and s: closer times are duplicates; rates would overflow
MOST_STARTS, LATE = 10, 0.02  # times that a clock may start again; of all rows, those that are then behind
PARTS, MANY, FEWEST = 4, 1 / 3, 4  # times look rounded where more rows of each part are duplicates; of different times


def rotation(motion: Any, *, scalar_first: bool | None = None) -> Rotation:
    """Return a motion as a SciPy Rotation that maps body to space.

    Parameters
    ----------
    motion : Rotation, (..., 3, 3) or (..., 4) array, Dataset, DataArray, Trajectory or DataFrame
        Arrays of shape (..., 3, 3) are Λ, with the directors as columns; of shape (..., 4) quaternions. Runs,
        trajectories and DataArrays named or laid out as `directors` or `quaternion` are recognised by their names, and
        so are the columns of a DataFrame (``qw qx qy qz``, ``W X Y Z``, ``r11 ... r33`` and the like).
    scalar_first : bool, optional
        Order of quaternions given as a plain array; needed there, since the two orders cannot be distinguished. Of a
        DataArray without a coordinate `quat`, the scalar is last unless this is True.

    Returns
    -------
    scipy.spatial.transform.Rotation

    Raises
    ------
    ValueError
        A matrix is not orthonormal to 1e-9 or is left-handed, a number is not finite, quaternions have no stated order,
        or the form is unknown. Only `twist` drops rows that are not finite, since it has the times of the others.

    Examples
    --------
    >>> from nontwist import rotation
    >>> rotation([[0.8, 0, 0, 0.6]], scalar_first=True).as_rotvec().round(6)  # 2 acos 0.8 about z
    array([[0.      , 0.      , 1.287002]])

    The last attitude of a run:

    >>> from nontwist import nontwisting, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, angular_velocity=(0, 2, 0), integrator="split")
    >>> rotation(run)[-1].as_rotvec().round(6)
    array([0., 2., 0.])
    """
    return motion if hasattr(motion, "as_quat") else as_rotation(raw_motion(motion, scalar_first).values, EXACT)


def raw_motion(motion: Any, scalar_first: bool | None) -> Motion:
    """Return a motion of any form; only that is checked, so that the caller can treat rows that are not finite."""
    if hasattr(motion, "as_quat"):
        return Motion(np.asarray(motion.as_quat()))
    if hasattr(motion, "columns") and hasattr(motion, "iloc"):
        content = of_frame(motion)
        try:
            found = of_table(content, ReadOptions())
        except InputError as error:
            if error.code != "scalar-unknown":
                raise error.about("the table (read_motion takes it with options)") from error
            if scalar_first is None:
                raise
            found = of_table(content, ReadOptions(scalar_first=scalar_first))
        return Motion(found.values, found.time, found.start)
    if hasattr(motion, "data_vars"):
        known = [name for name in ("directors", "quaternion") if name in motion.data_vars]
        if not known and "twist_angle" in motion.data_vars:
            raise ValueError("it is already the result of a twist; nontwist view and nontwist info show it")
        if not known:
            raise ValueError(f"the dataset has neither directors nor quaternion; it has {', '.join(motion.data_vars)}")
        motion = motion[known[0]]
    if hasattr(motion, "dims"):
        line = motion["line"].values if "line" in motion.coords else None
        lines = line if line is not None and line.ndim == 1 else None
        time, start = seconds(motion["time"]) if "time" in motion.coords else (None, None)
        return Motion(_of_dataarray(motion, scalar_first), time, motion.attrs.get("start", start), lines)
    if hasattr(motion, "directors"):
        return Motion(np.swapaxes(motion.directors, -1, -2), motion.time)
    if isinstance(motion, (str, PathLike)):
        readers = "open_run reads a run, read_motion a recording"
        raise ValueError(f"the motion must consist of numbers, got {str(motion)!r}; {readers}")
    array = as_floats(motion, "the motion")
    if hasattr(motion, "iloc") and sorted(map(str, motion.index)) == ["w", "x", "y", "z"]:
        scalar_first = False  # a labelled row of a table, now in the order of its labels
    if array.shape[-2:] == (3, 3):
        return Motion(array)
    if array.shape[-1:] == (4,):
        if scalar_first is None:
            raise ValueError("quaternions need scalar_first=True (w, x, y, z) or scalar_first=False (x, y, z, w)")
        return Motion(np.roll(array, -1, axis=-1) if scalar_first else array)
    angles = "; scipy.spatial.transform.Rotation makes them of angles" * (array.shape[-1:] == (3,))
    raise ValueError(f"rotations must be (..., 3, 3) matrices or (..., 4) quaternions, got {array.shape}{angles}")


def as_rotation(values: Array, tolerance: float, *names: Any) -> Rotation:
    """Return the values of `raw_motion` as a Rotation; a ValueError names what is no rotation within `tolerance`."""
    _require_rotations(values, tolerance, *names)
    return as_turns(values)


def measured_quaternions(motion: Motion, rows: NDArray[np.int64]) -> Array:
    """Return `rows` of a motion as quaternions, (k, 4), scalar last; errors as `as_rotation`, with the row or line.

    Quaternions that are given are left as they are.
    """
    values = motion.values[rows]
    if values.shape[-1] != 4:
        return np.asarray(as_rotation(values, MEASURED, rows, motion.lines).as_quat())
    _require_rotations(values, MEASURED, rows, motion.lines)
    return np.ascontiguousarray(values)


@np.errstate(over="ignore", invalid="ignore")
def _require_rotations(
    values: Array, tolerance: float, rows: NDArray[np.int64] | None = None, lines: Lines | None = None
) -> None:
    """Raise a ValueError where matrices or quaternions are no rotations; `rows` are their numbers in a motion."""
    if values.shape[-1] == 4:
        length = np.linalg.norm(values, axis=-1)
        refused = [
            (~np.isfinite(values).all(axis=-1), "quaternion{} is not finite: {}", values),
            (abs(length - 1) > MEASURED, "quaternion{} must have the length 1, it has {:.6g}", length),
        ]
    else:
        defect, det = abs(np.swapaxes(values, -1, -2) @ values - np.eye(3)).max(axis=(-2, -1)), np.linalg.det(values)
        off = "rotation{} is not orthonormal: the largest entry of |ΛᵀΛ - I| is {:.3g}"
        lacking = "; if digits are missing, SciPy's Rotation.from_matrix has the nearest one"
        refused = [
            (~np.isfinite(values).all(axis=(-2, -1)), "rotation{} is not finite: {}", values),
            (~(defect <= MEASURED), off, defect),
            (defect > tolerance, off + lacking, defect),
            (det < 0, "rotation{} is left-handed: its determinant is {:.6g}", det),
        ]
    for bad, message, shown in refused:
        if np.any(bad):
            index = tuple(int(i) for i in np.argwhere(bad)[0])
            named = index if rows is None else (int(rows[index[0]]), *index[1:])
            where = f"[{', '.join(map(str, named))}]" if named else ""
            where = where if lines is None else f" in {place(named[0], lines)}"
            raise ValueError(message.format(where, np.asarray(shown)[index].tolist()))


def _of_dataarray(motion: Any, scalar_first: bool | None) -> Array:
    if "quat" in motion.dims:
        order = list("wxyz" if scalar_first else "xyzw")
        if "quat" in motion.coords:
            order = [str(x) for x in motion["quat"].values]
        if sorted(order) != sorted("xyzw"):
            raise ValueError(f"the coordinate quat must be x, y, z and w, got {', '.join(order)}")
        values = motion.transpose(..., "quat").values
        return np.asarray(values if order == list("xyzw") else values[..., [order.index(x) for x in "xyzw"]])
    if {"director", "axis"} <= set(motion.dims):
        return np.asarray(in_order(motion).transpose(..., "axis", "director").values)
    raise ValueError(f"a DataArray needs the dims director and axis, or quat; got {', '.join(map(str, motion.dims))}")


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
        return as_turns(self.quaternion)


def one_motion(motion: Any, scalar_first: bool | None) -> Motion:
    """Return the motion of one body; a ValueError where it is of several."""
    found, is_many = raw_motion(motion, scalar_first), "member" in getattr(motion, "dims", ())
    shape = found.values.shape
    if is_many or len(shape) != (2 if shape[-1] == 4 else 3):
        hint = ", of several members; run.isel(member=0) is one of an ensemble, sweep_member of a sweep" * is_many
        raise ValueError(f"a motion has one attitude for each time, (n, 4) or (n, 3, 3), got {shape}{hint}")
    return found


def given_motion(motion: Any, time: Any, scalar_first: bool | None, name: str) -> Motion:
    """Return a motion with its times; a ValueError names what does not fit."""
    found = one_motion(motion, scalar_first)
    t, start = (found.time, found.start) if time is None else seconds(time)
    if t is not None and t.shape != (len(found.values),):
        raise InputError("time-shape", name=name, count=len(found.values), shape=t.shape)
    return replace(found, time=t, start=None if start is None else float(start))


def samples(*motions: Motion) -> list[Samples]:
    """Return the attitudes of motions at the rows that all have, by the times of the first; errors as in `twist`."""
    t, lines = motions[0].time, motions[0].lines
    if any(lines is not None and one.lines is not None and not np.array_equal(one.lines, lines) for one in motions):
        lines = None
    flats = [one.values.reshape(len(one.values), math.prod(one.values.shape[1:])) for one in motions]
    good = np.all([np.isfinite(flat).all(axis=1) & flat.any(axis=1) for flat in flats], axis=0)
    rows, notes = kept_rows(t, good, lines, "missing-rows", "a twist", 2)
    kept, left_out = None if t is None else t[rows], len(good) - rows.size
    return [Samples(measured_quaternions(one, rows), kept, rows, left_out, notes, lines=lines) for one in motions]


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
    duplicate = np.append(False, np.diff(t[rows]) <= max(DUPLICATE * span, SHORTEST))[: rows.size]
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
