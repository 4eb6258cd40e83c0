"""Which reading of an orientation is meant: each that is possible is compared with what is recorded beside it.

Readings differ in the place of the scalar, the order and unit of angles, and the direction. Let Λ map sensor to earth.

- A gyroscope measures w = vee(Λᵀ Λ') in the sensor; of the inverse Λᵀ the same formula gives vee(Λ Λ'ᵀ) = -Λ w. The
  cosine between what is computed and what was measured, over the whole recording, tells readings apart, whatever the
  unit. Where the unit and the times are known, 2 a·b/(a² + b²) tells the unit of angles as well. A gyroscope knows no
  earth, so nothing is to be assumed of its axes. If the stated reading agrees with one that is mounted with other axes,
  and no reading does without that turn, nothing is decided.
- The angular velocity in space, w_s = vee(Λ' Λᵀ), that motion capture states of its segments is told apart likewise:
  -w_s is what a gyroscope on the inverse Λᵀ would measure.
- Another form of the same attitudes, a matrix or a quaternion, agrees or does not.
- An accelerometer measures the specific force, on average g upwards: Λ a has a constant direction in space, Λᵀ a has
  not if the sensor tilts about more than the vertical. Its test is the length of the mean of the unit vectors.

A reading fits if its number is above a level, and falls short of 1 by no more than twice what the best does, or 0.1.
What the file or the format states is kept if it fits; else the one that fits well is taken, with a warning. Several
that fit are a question, none a warning. What the caller states always acts, with a warning where another reading fits.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, InputWarning
from ..geometry.arrays import Array
from ..units import RATE, TIME
from . import spellings
from .headers import rate_unit, sensors
from .table import Table

FEWEST, MOST = 10, 20_000  # rows that tell anything, and that are compared
TURNS = 0.3  # rad by which a body must turn in all for a contradiction
SAME = 2.0  # of the shortfall from 1 of the best reading: those within fit as well
CLOSE = 0.1
SURE = 0.9  # the agreement that takes a reading in place of the stated one
FITS, MOUNTED = 0.7, 0.95  # least agreement with a gyroscope, and with one whose axes are turned
FACTOR = 0.1  # by which times may disagree with a gyroscope


@dataclass(frozen=True)
class Reading:
    """One way to read an orientation.

    `make` returns its (k, 4) quaternions or (k, 3, 3) matrices of some rows. It is `stated` by the file, its format or
    the caller, or no more than possible; it is `allowed` unless the caller states another, and `unlike` its headers.
    """

    words: str
    make: Callable[[Any], Array]
    stated: bool = False
    allowed: bool = True
    inverse: bool = False
    unlike: bool = False

    def quaternions(self, rows: Any) -> Array:
        """Return some attitudes as quaternions, nan where they are no rotations."""
        from scipy.spatial.transform import Rotation

        values = self.make(rows)
        if values.shape[-1] != 4:
            good = np.isfinite(values).all(axis=(1, 2)) & (np.linalg.det(np.nan_to_num(values)) > 0.5)
            found = np.full((len(values), 4), np.nan)
            if good.any():
                found[good] = Rotation.from_matrix(values[good]).as_quat()
            return found
        good = (abs(values) < 1e6).all(axis=1) & values.any(axis=1)
        return np.where(np.asarray(good)[:, None], values, np.nan)


@dataclass(frozen=True)
class Evidence:
    """What is recorded beside an orientation: (n, 3) vectors, the unit of the gyroscope, another form of it, times."""

    gyroscope: Array | None = None
    unit: str | None = None
    spin: Array | None = None
    accelerometer: Array | None = None
    other: Array | None = None
    time: Array | None = None


def evidence_of(table: Table, time: Array | None, other: Array | None = None, spin: Array | None = None) -> Evidence:
    """Return what the columns of one sensor tell of its orientation."""
    found: dict[str, tuple[Array, tuple[str, ...]]] = {}
    for key, names in (("gyroscope", spellings.GYROSCOPE), ("accelerometer", spellings.ACCELEROMETER)):
        for _, three in sensors(table.headers, names)[:1]:
            try:
                found[key] = table.vectors(three), three
            except ValueError:
                continue
    units = {rate_unit(one) for one in found["gyroscope"][1]} if "gyroscope" in found else set()
    unit = units.pop() if len(units) == 1 else None
    vectors = {key: values for key, (values, _) in found.items()}
    return Evidence(**vectors, unit=unit, spin=spin, other=other, time=time)


def agreements(readings: Sequence[Reading], given: Evidence, count: int) -> Iterator[tuple[str, float, Array]]:
    """Yield what tells the readings apart, the level of one that fits, and how well each agrees, 1 at best."""
    rates = {"gyroscope": given.gyroscope, "angular velocity": None if given.spin is None else -given.spin}
    others = {"other form of the orientation": given.other, "gravity": given.accelerometer}
    there = {what: one for what, one in (rates | others).items() if one is not None and len(one) == count}
    if not there:
        return
    from scipy.spatial.transform import Rotation

    rows = np.unique(np.linspace(0, count - 1, min(count, MOST)).astype(int)) if count <= MOST else _blocks(count)
    all_quats = [one.quaternions(rows) for one in readings]
    for what, measured in there.items():
        beside, (scores, cosines) = measured[rows], np.full((2, len(readings)), np.nan)
        for k, quat in enumerate(all_quats):
            good = np.isfinite(beside).all(axis=1) & np.isfinite(quat).all(axis=1)
            if good.sum() < FEWEST:
                continue
            R, b = Rotation.from_quat(quat[good]), beside[good]
            if what == "gravity":
                up = b / np.maximum(np.linalg.norm(b, axis=1, keepdims=True), 1e-300)
                scores[k] = np.linalg.norm(R.apply(up).mean(axis=0))
            elif what in rates:
                R = R if what == "gyroscope" else R.inv()
                near = np.diff(rows[good]) == 1
                turned, between = (R[:-1].inv() * R[1:]).as_rotvec()[near], ((b[1:] + b[:-1]) / 2)[near]
                scale = _scale(given, rows[good], near) if what == "gyroscope" else None
                scores[k], cosines[k] = agreement(turned, between, scale), agreement(turned, between, None)
            else:
                scores[k] = 1 - float((Rotation.from_quat(b).inv() * R).magnitude().mean())
        if what == "gyroscope" and not np.nanmax(scores, initial=0.0) >= FITS:
            scores = cosines  # a unit, of which `time_unit` speaks, is wrong
        if np.isfinite(scores).any():
            yield what, {"gravity": 0.97, "other form of the orientation": 0.9}.get(what, FITS), scores


def _blocks(count: int) -> NDArray[np.int64]:
    starts = np.linspace(0, count - 1 - MOST // 20, 20).astype(int)
    return np.unique((starts[:, None] + np.arange(MOST // 20)).ravel())


def _scale(given: Evidence, rows: NDArray[np.int64], near: Any) -> Array | None:
    """Return what makes rotation vectors of readings of a gyroscope, where its unit and the times are known."""
    if given.unit is None or given.time is None:
        return None
    return np.asarray((RATE[given.unit] * np.diff(given.time[rows]))[near])


def agreement(turned: Array, measured: Array, scale: Array | None) -> float:
    """Return the cosine between turns and what was measured; with its scale, twice the product over both squares."""
    both = turned if scale is None else measured * np.nan_to_num(scale)[:, None]
    measured = measured if scale is None else both
    a, b = (float((one * one).sum()) for one in (turned, measured))
    size = np.sqrt(a * b) if scale is None else (a + b) / 2
    return float((turned * measured).sum() / size) if size > 0 else 0.0


def settled(readings: Sequence[Reading], given: Evidence, count: int) -> tuple[Reading | None, tuple[str, ...]]:
    """Return the reading that is meant, None where nothing tells, and what tells it; warn where that contradicts.

    Raises
    ------
    InputError
        Several readings fit, and none of them is stated.
    """
    allowed = [one for one in readings if one.allowed]
    stated = next((one for one in allowed if one.stated), None)
    if count < FEWEST or all(one is None for one in (given.gyroscope, given.spin, given.other, given.accelerometer)):
        return stated, ()
    for what, level, scores in agreements(readings, given, count):
        best = float(np.nanmax(scores))
        margin = max(SAME * (1 - best), CLOSE if what != "gravity" else 0.05)
        fits = [k for k, score in enumerate(scores) if 1 - score < margin or score == best]
        is_open = what == "gyroscope" and stated is not None and best < MOUNTED
        if is_open and stated and scores[readings.index(stated)] < level and _mounted(stated, given, count) > MOUNTED:
            continue
        is_weak = best < SURE and stated is not None and readings.index(stated) not in fits
        if best < level or is_weak:
            if stated is not None and what != "gravity" and any(_turns(one, count) for one in readings):
                _warn("no-reading-fits", what=what, best=best)
            continue
        own = [k for k in fits if readings[k].allowed]
        told = f"agreement with the {what}" if what != "gravity" else "steadiness of gravity"
        if stated is not None and (readings.index(stated) in own or len(fits) == len(readings)):
            others = [k for k, one in enumerate(readings) if one.inverse != stated.inverse]
            if not others or set(others) & set(fits):  # which tells no direction
                continue
            mine, other = scores[readings.index(stated)], np.nanmax(scores[others])
            return stated, (f"checked: {told} {mine:.2f} as it is read, {other:.2f} inverted",)
        if not own:
            another = readings[int(np.nanargmax(scores))]
            mine = np.nan if stated is None else scores[readings.index(stated)]
            _warn("options-contradicted", told=told, mine=mine, best=best, another=_named(another))
            return stated, ()
        if len(own) > 1 and not _alike([readings[k] for k in own], count):
            if what == "gravity":
                continue
            names = "; ".join(_named(readings[k]) for k in own)
            raise InputError("several-readings", readings=names)
        chosen = readings[own[int(np.argmax(scores[own]))]]
        if stated is not None:
            mine = scores[readings.index(stated)]
            both = {"chosen": _named(chosen), "stated": _named(stated)}
            _warn("reading-by-evidence", told=told, best=best, mine=mine, **both)
        return chosen, (f"checked: {told} {best:.2f} as it is read",)
    return stated, ()


def _named(reading: Reading) -> str:
    return reading.words.removeprefix("orientation: ") + (", inverted" if reading.inverse else "")


def _turns(reading: Reading, count: int) -> bool:
    """Whether the body turns by more than noise would."""
    quat = reading.quaternions(slice(0, count, max(count // 500, 1)))
    quat = quat[np.isfinite(quat).all(axis=1)]
    dots = abs((quat[1:] * quat[:1]).sum(axis=1)) / np.maximum(np.linalg.norm(quat[1:], axis=1), 1e-300)
    return bool(quat.size and dots.size and dots.min() < np.cos(TURNS / 2))


def _alike(readings: Sequence[Reading], count: int) -> bool:
    """Whether readings give the same attitudes."""
    first, *more = (one.quaternions(slice(0, count, max(count // 500, 1))) for one in readings)
    return all(np.nanmin(abs((first * other).sum(axis=1))) > 1 - 1e-9 for other in more)


def time_unit(reading: Reading, given: Evidence, count: int, has_unit: bool) -> tuple[float, tuple[str, ...]]:
    """Return the factor by which a gyroscope says that times are to be multiplied, and in words why; or warn of it."""
    if given.unit is None or given.time is None:
        return 1.0, ()
    good, turned, measured = _turned(reading, given, count)
    if len(good) < FEWEST:
        return 1.0, ()
    ahead = measured * (RATE[given.unit] * np.diff(given.time[good]))[:, None]
    if agreement(turned, ahead, None) < 0.9 or np.linalg.norm(turned, axis=1).sum() < TURNS:
        return 1.0, ()
    factor = float((turned * ahead).sum() / (ahead * ahead).sum())
    if abs(factor - 1) < FACTOR:
        return 1.0, ()
    for unit in ("ms", "us", "ns"):
        if not has_unit and abs(factor / TIME[unit] - 1) < FACTOR:
            return TIME[unit], (f"time: in {unit}, by the gyroscope",)
    _warn("time-contradicted", factor=factor)
    return 1.0, ()


def _turned(reading: Reading, given: Evidence, count: int) -> tuple[NDArray[np.int64], Array, Array]:
    """Return rows whose numbers are finite, and what is between them: turns, and what a gyroscope measured."""
    from scipy.spatial.transform import Rotation

    if given.gyroscope is None or len(given.gyroscope) != count:
        return np.arange(0), np.empty((0, 3)), np.empty((0, 3))
    rows = np.arange(min(count, MOST))
    quat, rates, time = (
        reading.quaternions(rows),
        given.gyroscope[rows],
        rows if given.time is None else given.time[rows],
    )
    good = np.flatnonzero(np.isfinite(quat).all(axis=1) & np.isfinite(rates).all(axis=1) & np.isfinite(time))
    R = Rotation.from_quat(quat[good])
    return good, (R[:-1].inv() * R[1:]).as_rotvec(), (rates[good][1:] + rates[good][:-1]) / 2


def _mounted(reading: Reading, given: Evidence, count: int) -> float:
    """Return the agreement with a gyroscope whose axes are those of the sensor, turned as fits best."""
    good, turned, measured = _turned(reading, given, count)
    if len(good) < FEWEST:
        return 0.0
    left, sizes, right = np.linalg.svd(turned.T @ measured)
    sizes[2] *= np.sign(np.linalg.det(left @ right))
    return float(sizes.sum() / max(np.linalg.norm(turned) * np.linalg.norm(measured), 1e-300))


def both_directions(readings: Sequence[Reading], inverse: bool | None) -> list[Reading]:
    """Return readings as they are and inverted; those that `inverse` excludes are not allowed."""
    found = []
    for turned in (False, True):
        for one in readings:
            make = one.make if not turned else _inverted(one.make)
            allowed = one.allowed and inverse in (None, turned)
            stated = one.stated and turned == bool(inverse)
            found.append(replace(one, make=make, inverse=turned, allowed=allowed, stated=stated))
    return found


def _inverted(make: Callable[[Any], Array]) -> Callable[[Any], Array]:
    def inverted(rows: Any) -> Array:
        values = make(rows)
        return values * [-1, -1, -1, 1] if values.shape[-1] == 4 else np.swapaxes(values, -1, -2)

    return inverted


def _warn(code: str, **fields: Any) -> None:
    warnings.warn(InputWarning(code, **fields), stacklevel=4)
