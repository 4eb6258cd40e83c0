"""The orientation that a table, or the bodies of a format, hold: which columns, how they can be read, what is missing.

Recorded numbers are rounded, scaled, missing in some rows, or no rotations at all. Rows that are no rotations where
others are, sentinels, zeros and identities in place of lost rows are missing: NaN, counted in a note. One common scale
and rounding are mended where the caller asks. All else is refused.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, InputWarning, Option
from ..geometry.arrays import Array
from ..geometry.values import counted
from . import headers
from .conventions import GYROSCOPE, OTHER, Evidence, Reading, evidence_of, settled, time_unit
from .headers import Found, plain
from .options import ReadOptions
from .table import Content, Lines, Table, listed, named_columns, of_one_sensor, own_rows, place
from .times import Clock, clock, ignored

SAME = 1e-2  # rad by which a matrix may differ from a quaternion beside it
MARKERS = 3  # that determine an attitude
IDENTITY = 1e-6  # a first row closer to no rotation than this says where the scalar is

MEASURED = 1e-2  # by which recorded rotations, which are rounded, may be off
LEAP = 0.2  # by which a leap at half a turn may be off, which a body that turns makes less
RARE = 0.1  # of all rows: so few that are no rotations are missing
JUMP = 3.0  # times the largest steps: beyond it an exact identity is none
STEADY = 0.75  # of the speed around: what a body that has not stopped for a row keeps, and one that has does not
COARSE = 5.0  # times the last place of what is recorded: so far rounding repeats no row
MOVING = 1.8  # times the smallest step, which is that of numbers that were rounded before they became attitudes
SENTINELS = 3  # values of a row that stand for missing, at most


@dataclass(frozen=True)
class Motion:
    """A motion: (..., 3, 3) matrices Λ or (..., 4) quaternions, scalar last.

    With its times, as given, what these count from, s, the lines of its rows in a file, where there are any, and how
    it was read.
    """

    values: Array
    time: Any = None
    start: float | None = None
    lines: Lines | None = None
    notes: tuple[str, ...] = ()


def of_table(content: Content, how: ReadOptions) -> Motion:
    """Return the motion that the columns of a file hold."""
    table, how, of_sensor = of_one_sensor(content.table, how)
    is_form = bool(how.euler or how.rotation_vector)
    sizes = (3,) if is_form else (4, 9)
    taken, how = named_columns(table, how, sizes, "3 columns of angles, 4 of a quaternion or 9 of a matrix")
    found = None if is_form else _one(table, taken, how, content.notes)
    names = found.headers if found is not None else taken or _three(table, how)
    table, of_rows = own_rows(table, names)
    beside = _beside(table, found, how)
    time = clock(table, how)
    forms = [_attitudes(beside, one) for one in headers.orientations(beside.headers) if found is None and one.ordered]
    form = next((one for one in forms if one is not None), None)
    given = evidence_of(beside, len(table), time.time, form)
    if found is not None:
        how.require_without("angle_unit", "no angles are read")
        readings = _components(table, found, how)
    else:
        how.require_without("scalar_first", "three angles are read")
        readings = _angles(table, names, how, content.angle_unit, taken is not None, given)
    return _recorded(readings, given, how, time, (*content.notes, *of_sensor, *of_rows), table.lines)


def of_bodies(content: Content, how: ReadOptions) -> Motion:
    """Return the attitudes of one body, by its name in any case where there are several."""
    arrays, notes = {**content.bodies, **content.loose}, content.notes
    for option in ("euler", "rotation_vector", "angle_unit"):
        if getattr(how, option):
            raise InputError("attitudes", name=Option(option), names=listed(arrays))
    wanted = [one for one in arrays if how.body in (None, one)]
    wanted = wanted or [one for one in arrays if plain(one) == plain(str(how.body))]
    if len(wanted) != 1:
        raise InputError("several-bodies" if wanted else "no-body", body=how.body, names=listed(wanted or arrays))
    name, values = wanted[0], arrays[wanted[0]]
    if name not in content.bodies:
        readings = _quaternions(values, how, f"of the array {name!r}")
    else:
        how.require_without("scalar_first", "the format states where the scalar is")
        own = f"orientation: {'quaternion' if values.shape[-1] == 4 else 'matrix'} of {name!r}"
        told = next((note for note in notes if note.startswith("orientation: ")), own)
        notes = tuple(note for note in notes if note != told)
        readings = [Reading(told, values.__getitem__, True)]
    notes += (f"body: {name}",) if len(arrays) > 1 else ()
    if content.time is None or (how.rate is not None and not content.sampled):
        notes += () if content.time is None else (ignored("that of the format", content.time),)
        time = clock(content.table if len(content.table) else Table({"": np.zeros(len(values))}), how)
    else:
        how.require_without("time_unit", "the format defines its times")
        unit = "s" if content.start is None else "s since 1970"
        time = Clock(content.time, content.start, (f"time: as the format defines, {unit}",))
    if time.time is not None and len(time.time) != len(values):
        raise InputError("time-length", times=len(time.time), count=len(values))
    given = evidence_of(content.table, len(values), time.time, None, content.spins.get(name))
    lines = content.table.lines if content.lines is None else content.lines
    return _recorded(readings, given, how, time, notes, lines, content.directed and name in content.bodies)


def _recorded(
    readings: list[Reading],
    given: Evidence,
    how: ReadOptions,
    time: Clock,
    notes: tuple[str, ...],
    lines: Lines | None,
    directed: bool = False,
) -> Motion:
    """Return the attitudes by the reading that is meant, without rows that are none."""
    readings = [one.turned(inverse, how.inverse) for inverse in (False, True) for one in readings]
    chosen, checked = settled(readings, given)
    if chosen is None and (what := readings[0].words.partition("scalar first, ")[2]):
        who = f"the {what} do" if what.startswith("columns") else f"{what.removeprefix('of ')} does"
        raise InputError("scalar-unknown", who=who)
    if chosen is None:
        raise InputError("several-readings", readings="; ".join([str(one) for one in readings if one.allowed][:4]))
    if chosen.unlike and not checked:
        warnings.warn(InputWarning("unlike-headers", words=chosen.words), stacklevel=2)
    again = False if time.time is None else np.append(False, np.diff(time.time) == 0)
    values, told = rotations(chosen.values(), lines, how.normalize, chosen.grid, again)
    factor, by_gyroscope = time_unit(chosen, given, time.has_unit)
    times = time.time if time.time is None or factor == 1.0 else time.time * factor
    if chosen.inverse:
        told += ("inverted: earth relative to sensor was made sensor relative to earth",)
    elif not checked:
        which = "body to space, as the format defines" if directed else "taken as sensor to earth"
        told += (f"direction: {which}, which nothing in the file confirms",)
    notes = (chosen.words, *notes, *time.notes, *by_gyroscope, *told, *checked)
    return Motion(values, times, time.start, lines, notes)


def _one(table: Table, taken: tuple[str, ...] | None, how: ReadOptions, notes: tuple[str, ...]) -> Found | None:
    """Return the columns of the orientation; None where there are angles instead."""
    found = headers.orientations(taken or table.headers)
    if taken is not None:
        told = [one for one in found if one.ordered and set(one.headers) == set(taken)]
        if len(taken) == 4 and len(told) == 1 and how.scalar_first is None:
            return told[0]
        return Found(taken, len(taken) == 9, "")
    if how.body is not None:
        there = [one.body for one in found if one.body]
        found = [one for one in found if plain(one.body) == plain(how.body)]
        if not found:
            raise InputError("no-body" if there else "no-bodies", body=how.body, names=listed(there))
    if len(found) > 1:
        attitudes = [(one, _attitudes(table, one)) for one in found]
        good = [(one, quat) for one, quat in attitudes if quat is not None]
        is_marked = not good and len(headers.markers(table.headers)) >= MARKERS
        found = [one for one, _ in good] or ([] if is_marked else found)
        sizes = {len(one.headers): one for one in found}
        if len(good) == len(sizes) == 2 and sizes[4].ordered:
            alike = abs((good[0][1] * good[1][1]).sum(axis=1))
            found = [sizes[4]] if np.fmin.reduce(alike, initial=np.nan) > np.cos(SAME / 2) else found
    if len(found) > 1:
        bodies = [one.body for one in found]
        code = "bodies-in-columns" if all(bodies) and len(set(bodies)) > 1 else "several-orientations"
        raise InputError(code, sets="; ".join(", ".join(one.headers) for one in found), bodies=listed(bodies))
    if found:
        return found[0]
    if headers.angles(table.headers, "xyz") is not None:
        return None
    rates = [", ".join(three) for _, three in headers.sensors(table.headers, headers.GYROSCOPE)]
    if (lacking := headers.lacks(table.headers)) is not None:
        raise InputError("three-of-four", three=", ".join(lacking[0]), fourth=lacking[1])
    if len(marked := headers.markers(table.headers)) >= MARKERS and not rates:
        raise InputError("markers", markers=listed(marked))
    names = "; ".join([listed(table.headers), *(note for note in notes if note.startswith("not read"))])
    raise InputError("gyroscope-alone" if rates else "no-orientation", names=names, gyroscope="".join(rates[:1]))


def _attitudes(table: Table, found: Found) -> Array | None:
    """Return what columns hold as quaternions, nan in rows that are missing; None where they are no rotations."""
    try:
        values = table.vectors(found.headers)
        values, _ = rotations(values.reshape(-1, 3, 3) if len(found.headers) == 9 else values, None, True)
    except ValueError:
        return None
    return Reading("", values.__getitem__).quaternions(slice(None))


def _beside(table: Table, found: Found | None, how: ReadOptions) -> Table:
    """Return the columns that belong to the same sensor, where the file has more than one."""
    bodies = {plain(one.body) for one in headers.orientations(table.headers)}
    if len(bodies) < 2:
        return table
    name = plain(how.body or (found.body if found is not None else ""))
    longer = tuple(one for one in bodies if one != name and one.startswith(name))  # hand10 beside hand1
    own = [h for h in table.headers if name and plain(h).startswith(name) and not plain(h).startswith(longer)]
    return replace(table, columns={h: table.columns[h] for h in own})


def _components(table: Table, found: Found, how: ReadOptions) -> list[Reading]:
    """Return the ways in which columns can be read as quaternions or matrices."""
    values = table.vectors(found.headers)
    if len(found.headers) == 9:
        how.require_without("scalar_first", "a matrix is read")
        words = f"orientation: matrix {found.headers[0]} ... {found.headers[-1]}"
        return [Reading(words, values.reshape(-1, 3, 3).__getitem__, True)]
    in_file = tuple(h for h in table.headers if h in found.headers)
    order = found.headers if how.columns or not found.ordered else in_file
    stated = table.scalar_first if order == in_file else None
    readings = _quaternions(table.vectors(order), how, f"columns {', '.join(order)}", stated)
    by_order = dict(zip(((*order[1:], order[0]), order), readings, strict=True))
    if how.scalar_first is not None:
        labels = next((one.headers for one in headers.orientations(order) if one.ordered), None)
        return [replace(one, unlike=one.unlike or labels not in (None, own)) for own, one in by_order.items()]
    if not found.ordered:
        return readings
    by_order.pop(found.headers, None)
    words = f"orientation: quaternion {', '.join((found.headers[3], *found.headers[:3]))}"
    return [Reading(words, values.__getitem__, True), *(replace(one, stated=False) for one in by_order.values())]


def _quaternions(values: Array, how: ReadOptions, what: str, stated: bool | None = None) -> list[Reading]:
    """Return quaternions with the scalar first and last, one of which the caller, the file or the first row states."""
    first, why = (how.scalar_first, "as given") if how.scalar_first is not None else (stated, "as the file states")
    for row in values[:1] if first is None else ():
        k = int(np.argmax(abs(row)))
        if k in (0, 3) and abs(row[k]) > 0.99 and np.delete(abs(row), k).max() < IDENTITY:
            first, why = k == 0, f"the first row is ({', '.join(f'{x:g}' for x in row)})"
    readings = []
    for is_first, told, ordered in ((True, "first", np.roll(values, -1, axis=1)), (False, "last", values)):
        words = f"orientation: quaternion, scalar {told}{f' ({why})' if first == is_first else ''}, {what}"
        is_allowed, unlike = how.scalar_first in (None, is_first), stated not in (None, is_first)
        readings.append(Reading(words, ordered.__getitem__, first == is_first, is_allowed, unlike=unlike))
    return readings


def _three(table: Table, how: ReadOptions) -> tuple[str, ...]:
    """Return the columns of angles or a rotation vector by their headers."""
    own = [h for h in table.headers if how.body is None or plain(h).startswith(plain(how.body))]
    letters = how.euler or "xyz"
    what, three = f"the angles {letters}", headers.angles(own, letters)
    if how.rotation_vector:
        what, three = "the rotation vector", headers.rotation_vector(own)
    if three is None:
        raise InputError("which-angles", what=what, names=listed(table.headers))
    return three


def _angles(
    table: Table, three: tuple[str, ...], how: ReadOptions, of_file: str | None, is_named: bool, given: Evidence
) -> list[Reading]:
    """Return the ways in which three columns can be read: as stated, and in orders that something beside them tells."""
    stated, names = of_file or headers.angle_unit(three), ", ".join(three)
    units = {of_file or headers.angle_unit([one]) for one in three} - {None}
    if len(units) > 1:
        raise InputError("angle-units", three=names)
    if how.angle_unit is not None and units - {how.angle_unit}:
        raise InputError("angle-unit-stated", three=names, stated=units.pop(), unit=how.angle_unit)
    is_decided, is_form = GYROSCOPE in given.beside or OTHER in given.beside, bool(how.euler or how.rotation_vector)
    if not (is_form or is_decided):
        raise InputError("angles", three=names)
    unit = how.angle_unit or stated or ("rad" if how.rotation_vector else None)
    if unit is not None and not is_decided:
        _warn_of_unit(table.vectors(three), names, unit, how.rotation_vector)
    if unit is None and not is_decided:
        raise InputError("no-angle-unit", three=names)
    told = how.angle_unit or of_file or (None if is_form else stated)
    forms = [(how.euler, three)] if is_form else []
    if is_decided and not how.rotation_vector:
        axes = dict(zip("XYZ", headers.angles(three, "xyz") or three, strict=True))
        for letters in dict.fromkeys([how.euler or "XYZ", *map("".join, permutations("XYZ"))]):
            by_name = tuple(axes[letter] for letter in letters.upper())
            orders = permutations(three) if how.euler in (None, letters) else ()
            forms += [(letters, order) for order in (by_name, *orders)]
    readings, grid = [], _grid(table.vectors(three)) / 2  # in quaternions
    for (letters, order), one in product(dict.fromkeys(forms), ("rad", "deg") if is_decided else (unit,)):
        is_stated = is_form and (letters, order) == (how.euler, three)
        is_free = is_stated or (how.euler in (None, letters) and not (is_named and how.euler))
        about = "moving axes (intrinsic)" if (letters or "").isupper() else "fixed axes (extrinsic)"
        words = f"Euler angles {letters} about {about}" if letters else "rotation vector"
        words = f"orientation: {words}, {one}: {', '.join(order)}"
        unlike = is_named and headers.angles(three, letters or "") not in (None, order)
        make = partial(_of_angles, table.vectors(order), letters, one == "deg")
        is_allowed, own = is_free and told in (None, one), np.radians(grid) if one == "deg" else grid
        readings.append(Reading(words, make, is_stated and one == unit, is_allowed, unlike=unlike, grid=own))
    return readings


def _warn_of_unit(values: Array, names: str, unit: str, is_vector: bool) -> None:
    """Warn of angles that have another unit than is stated, and of three of a quaternion in place of a vector.

    Where an angle goes on from half a turn to minus half a turn, it leaps by 2π in rad. A quaternion whose scalar is
    not negative leaps there from a vector of length 1 to the opposite one, a rotation vector from one of length π.
    """
    values = values[np.isfinite(values).all(axis=1) & (values != values[:, :1]).any(axis=1)]  # no sentinels
    lengths = np.linalg.norm(values, axis=1, ord=2 if is_vector else np.inf)
    longest, code = float(lengths.max(initial=0)), None
    if unit == "rad" and longest > 2 * np.pi:
        code = "long-angles"
    elif is_vector and unit == "rad" and longest < 1 + MEASURED:
        is_opposite = np.linalg.norm(values[1:] + values[:-1], axis=1) < LEAP
        code = "vector-of-quaternion" if (is_opposite & (lengths[1:] > 1 - LEAP)).any() else None
    elif not is_vector and unit == "deg" and longest < 2 * np.pi + MEASURED:
        leaps = abs(abs(np.diff(values, axis=0)) - 2 * np.pi) < LEAP
        code = "short-angles" if leaps.any() else None
    if code is not None:
        warnings.warn(InputWarning(code, three=names, longest=longest), stacklevel=3)


def _of_angles(columns: Array, letters: str | None, in_degrees: bool, rows: Any) -> Array:
    """Return quaternions of Euler angles, or of rotation vectors where there are no letters of axes."""
    from scipy.spatial.transform import Rotation

    part = columns[rows]
    is_sentinel = (part == part[:, :1]).all(axis=1) & (abs(part[:, 0]) > (360 if in_degrees else 2 * np.pi))
    finite, values = np.isfinite(part).all(axis=1) & ~is_sentinel, np.full((len(part), 4), np.nan)
    rotation = partial(Rotation.from_euler, letters) if letters else Rotation.from_rotvec
    values[finite] = rotation(part[finite], degrees=in_degrees).as_quat()
    return values


@np.errstate(over="ignore", invalid="ignore")
def rotations(
    values: Array, lines: Lines | None, normalize: bool, grid: float | None = None, again: Any = False
) -> tuple[Array, tuple[str, ...]]:
    """Return rotations to 1 %, to round-off where `normalize` is set, NaN in rows that are missing, and notes.

    `grid` is by how much they differ at least, where these are not the numbers that were recorded; `again` is where a
    time repeats the one before.

    An InputError where most rows are no rotations, or are so by a common scale or rounding and `normalize` is not set.
    """
    flat, is_quaternion = values.reshape(len(values), math.prod(values.shape[1:])), values.shape[-1] == 4
    good = np.isfinite(flat).all(axis=1) & flat.any(axis=1) & (abs(flat).max(axis=1, initial=0) < 1e100)
    size, off = np.linalg.norm(flat, axis=1) / math.sqrt(1 if is_quaternion else 3), _defect(values)
    if not good.any():
        return values, ()
    bad, (lost, held) = good & ~(off <= MEASURED), _lost(flat, good, grid or _grid(flat[good]), again)
    what, plural = ("quaternion", "quaternions") if is_quaternion else ("matrix", "matrices")
    told = list[str]()
    is_few = (bad != good).any() and len(np.unique(flat[bad], axis=0)) <= SENTINELS
    if bad.sum() > RARE * good.sum() and not is_few:
        scale = float(np.median(size[good]))
        quantum = _grid(flat[good]) / scale
        room = max(MEASURED, 2 * quantum if quantum < 0.5 else 0.0) * (1 if is_quaternion else 3)
        rare = good & (_defect(values / scale) > room)
        if rare.sum() > RARE * good.sum():
            raise InputError("not-rotations", what=plural, low=size[good].min(), high=size[good].max())
        if not normalize:
            looks, k = "rounded" if abs(scale - 1) < MEASURED else f"scaled by {scale:.6g}", int(bad.argmax())
            rows = counted(int(bad.sum()), "row")
            raise InputError("scaled", rows=rows, place=place(k, lines), what=what, size=size[k], looks=looks)
        bad = rare
    kinds = {f"which are not valid {plural}": bad, "whose identities stand for lost ones": lost}
    for why, which in (kinds | {"which repeat the one before, until a jump": held & ~bad}).items():
        if which.any():
            first = place(int(which.argmax()), lines)
            told.append(f"missing: {counted(int(which.sum()), 'row')}, {why}, the first is {first}")
    gone = bad | lost | held | ~flat.any(axis=1)
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


def _grid(numbers: Array) -> float:
    """Return the smallest difference of recorded numbers, one digit of their last place where they are rounded."""
    return float(np.diff(np.unique(numbers[np.isfinite(numbers)])).min(initial=np.inf))


def _lost(flat: Array, good: NDArray[np.bool_], grid: float, again: Any) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return exact identities where attitudes jump far more than elsewhere, and repeated rows before a jump.

    That is one such step; or one that makes up for them: as long, in the time since the last new row, as the steps
    between the new rows before and after are in theirs, of which repeated rows at rest or by rounding have none.
    """
    units, signs = (np.eye(4)[[0, 3]], (1, -1)) if flat.shape[1] == 4 else (np.eye(3).reshape(1, 9), (1,))
    same, (lost, held) = (flat[:, None] == units).all(axis=2).any(axis=1), np.zeros((2, len(flat)), dtype=np.bool_)
    steps = np.min([np.linalg.norm(flat[1:] - sign * flat[:-1], axis=1) for sign in signs], axis=0)
    repeated = np.append(False, steps == 0) & ~np.asarray(again)
    for found, which, apart in ((lost, same, same), (held, repeated, same | repeated)):
        others = steps[np.isfinite(steps) & ~apart[1:] & ~apart[:-1]]
        most = JUMP * float(np.quantile(others, 0.99)) if others.size else 0.0
        far = np.concatenate([[True], steps > (most or np.inf), [True]])
        for first, last in np.flatnonzero(np.diff(np.concatenate([[False], which, [False]]))).reshape(-1, 2):
            found[first:last] = far[last] and (far[first] if which is same else not far[min(last + 1, len(flat))])
    fresh = np.flatnonzero(~repeated)
    ahead, count = steps[fresh[1:] - 1], np.diff(fresh)
    rates, is_long = ahead / count, ahead > COARSE * grid
    before, after = (np.pad(rates, 1)[k : k + len(rates)] for k in (0, 2))
    near = np.pad(is_long, 1, constant_values=True)
    late = (count > 1) & (rates > STEADY * np.maximum(before, after)) & near[:-2] & is_long & near[2:]
    late &= ahead > MOVING * ahead[ahead > 0].min(initial=np.inf)
    for first, last in zip(fresh[:-1][late], fresh[1:][late], strict=True):
        held[first + 1 : last] = True
    return lost & good & ~same.all(), held & good & ~lost
