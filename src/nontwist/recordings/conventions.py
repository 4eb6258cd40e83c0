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
that fit are a question, none a warning. What the caller states always acts, with a warning where a reading that it
excludes fits best.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, InputWarning, warn
from ..geometry.arrays import Array, Rotation
from ..geometry.attitudes import quaternion_product
from ..geometry.values import counted
from ..units import RATE, TIME
from .headers import ACCELEROMETER, rate_unit, sensors
from .headers import GYROSCOPE as GYROSCOPES
from .table import Table

FEWEST, MOST, BLOCKS = 10, 20_000, 20  # rows that tell anything, and that are compared, in blocks
TURNS = 0.3  # rad by which a body must turn in all for a contradiction
SAME = 2.0  # of the shortfall from 1 of the best reading: those within fit as well
BESIDE = 0.01  # by which a reading that fits may fall short of that, without a warning
FAR, LITTLE = 5.0, 1e-3  # nor by less than that, or than so many times the best; noise is in both
SAME_ATTITUDE = 1e-9  # by which the product of quaternions of readings that give the same may differ from 1
SURE = 0.9  # the agreement that takes a reading in place of the stated one
FITS, MOUNTED = 0.7, 0.95  # least agreement with a gyroscope, and with one whose axes are turned
CLOSE = 0.5  # rad by which steps may differ from a gyroscope that tells how many turns they have lost
FACTOR = 0.1  # by which times may disagree with a gyroscope
GYROSCOPE, SPIN, OTHER, GRAVITY = "gyroscope", "angular velocity", "other form of the orientation", "gravity"
CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])
LEVELS = {GYROSCOPE: FITS, SPIN: FITS, OTHER: 0.9, GRAVITY: 0.97}  # least agreement of a reading that fits


@dataclass(frozen=True)
class Reading:
    """One way to read an orientation.

    `make` returns (k, 4) quaternions or (k, 3, 3) matrices of some rows, of which an `inverse` reading is the inverse.
    It is `stated` by the file, its format or the caller, or no more than possible; it is `allowed` unless the caller
    states another, and `unlike` its headers. `grid` is by how much quaternions that are not recorded differ at least.
    """

    words: str
    make: Callable[[Any], Array]
    stated: bool = False
    allowed: bool = True
    inverse: bool = False
    unlike: bool = False
    grid: float | None = None

    def __str__(self) -> str:
        return self.words.removeprefix("orientation: ") + (", inverted" if self.inverse else "")

    def turned(self, inverse: bool, told: bool | None) -> Reading:
        """Return the reading as it is or inverted, where the caller may have told which is meant."""
        allowed, stated = self.allowed and told in (None, inverse), self.stated and inverse == bool(told)
        return replace(self, inverse=inverse, allowed=allowed, stated=stated)

    def values(self, rows: Any = slice(None)) -> Array:
        """Return attitudes as they are read."""
        values = self.make(rows)
        if not self.inverse:
            return values
        return values * CONJUGATE if values.shape[-1] == 4 else np.swapaxes(values, -1, -2)

    def quaternions(self, rows: Any) -> Array:
        """Return attitudes as quaternions, nan where they are no rotations."""
        values = self.values(rows)
        if values.shape[-1] == 4:
            good = (abs(values) < 1e6).all(axis=1) & values.any(axis=1)
            return np.where(np.asarray(good)[:, None], values, np.nan)
        good = np.isfinite(values).all(axis=(1, 2)) & (np.linalg.det(np.nan_to_num(values)) > 0.5)
        found = np.full((len(values), 4), np.nan)
        found[good] = as_turns(values[good]).as_quat()
        return found


@dataclass(frozen=True)
class Evidence:
    """What is recorded `beside` an orientation, in the `rows` that are compared: vectors, or quaternions.

    `time` makes turns of what a gyroscope measures; it is 0 where its unit or the times are unknown. `places` are those
    of the rows in the order of time.
    """

    beside: Mapping[str, Array]
    rows: NDArray[np.int64]
    places: NDArray[np.int64]
    time: Array

    def steps(self, what: str, quat: Array) -> tuple[Array, Array, Array]:
        """Return turns between neighbouring rows, the rates that were measured there, and what turns these make.

        The turns are at most half a turn, or more by the whole turns that are lost between attitudes by the gyroscope,
        where these bring most of them close to what it measured; by a wrong unit they would not.
        """
        good = finite_rows(quat, self.beside[what], self.time[:, None])
        q, rates, near = quat[good], self.beside[what][good], np.diff(self.places[good]) == 1
        q = q * CONJUGATE if what == SPIN else q
        q = quaternion_product(q[:-1] * CONJUGATE, q[1:])[near]
        size = np.linalg.norm(q[:, :3], axis=1, keepdims=True)
        turned = q[:, :3] * (2 * np.arctan2(size, abs(q[:, 3:])) / np.maximum(size, 1e-300)) * np.copysign(1, q[:, 3:])
        measured = (rates[1:] + rates[:-1])[near] / 2
        ahead = measured * np.diff(self.time[good])[near, None]
        angle, far = np.linalg.norm(turned, axis=1, keepdims=True), np.linalg.norm(ahead, axis=1) > np.pi
        if far.sum() >= FEWEST:
            axis = turned / np.maximum(angle, 1e-300)
            whole = turned + axis * 2 * np.pi * np.rint(((ahead * axis).sum(axis=1, keepdims=True) - angle) / 2 / np.pi)
            is_lost = np.median(np.linalg.norm(whole - ahead, axis=1)[far]) < CLOSE
            turned = np.where(far[:, None] & is_lost, whole, turned)
        return turned, measured, ahead

    def agreement(self, what: str, quat: Array) -> tuple[float, float]:
        """Return how well attitudes agree with what is beside them, 1 at best; with rates, also in direction alone."""
        good = finite_rows(quat, self.beside[what])
        if good.size < FEWEST:
            return np.nan, np.nan
        if what in (GYROSCOPE, SPIN):
            turned, measured, ahead = self.steps(what, quat)
            size = (turned * turned).sum() + (ahead * ahead).sum()
            return float(2 * (turned * ahead).sum() / max(size, 1e-300)), cosine(turned, measured)
        R, b = as_turns(quat[good]), self.beside[what][good]
        if what == OTHER:
            score = 1 - float((as_turns(b).inv() * R).magnitude().mean())
        else:
            up = b / np.maximum(np.linalg.norm(b, axis=1, keepdims=True), 1e-300)
            score = float(np.linalg.norm(R.apply(up).mean(axis=0)))
        return score, score


def as_turns(values: Array) -> Rotation:
    """Return quaternions, scalar last, or matrices as a Rotation of SciPy, whose import takes a third of a second."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(values) if values.shape[-1] == 4 else Rotation.from_matrix(values)


def finite_rows(*arrays: Array) -> NDArray[np.int64]:
    """Return the rows in which all numbers are finite."""
    return np.flatnonzero(np.isfinite(np.hstack(arrays)).all(axis=1))


def cosine(a: Array, b: Array) -> float:
    """Return the cosine between two arrays, 0 where one of them is."""
    return float((a * b).sum() / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-300))


def sensor(table: Table, names: Sequence[str]) -> tuple[Array | None, str | None]:
    """Return the vectors of the first sensor that has one of these names, and the unit of rates that it states."""
    if found := sensors(table.headers, names):
        with suppress(ValueError):
            return table.vectors(found[0][1]), rate_unit(*found[0][1])
    return None, None


def evidence_of(
    table: Table, count: int, time: Array | None, other: Array | None = None, spin: Array | None = None
) -> Evidence:
    """Return what the columns of one sensor tell of its orientation in `count` rows."""
    gyroscope, unit = sensor(table, GYROSCOPES)
    accelerometer, _ = sensor(table, ACCELEROMETER)
    found = {GYROSCOPE: gyroscope, SPIN: None if spin is None else -spin, OTHER: other, GRAVITY: accelerometer}
    places = np.arange(count)
    if count > MOST:
        starts = np.linspace(0, count - MOST // BLOCKS, BLOCKS).astype(int)
        places = np.unique((starts[:, None] + np.arange(MOST // BLOCKS)).ravel())
    rows = places if time is None or len(time) != count else np.argsort(time, kind="stable")[places]
    there = {what: one[rows] for what, one in found.items() if one is not None and len(one) == count >= FEWEST}
    at = np.zeros(len(rows)) if unit is None or time is None else RATE[unit] * time[rows]
    return Evidence(there, rows, places, at)


def settled(readings: Sequence[Reading], given: Evidence) -> tuple[Reading | None, tuple[str, ...]]:
    """Return the reading that is meant, None where nothing tells, and what tells it; warn where that contradicts.

    Raises
    ------
    InputError
        Several readings fit, and none of them is stated; or none that is allowed fits best.
    """
    made = {one.make: one.quaternions(given.rows) for one in readings if given.beside and not one.inverse}
    quats = [made[one.make] * (CONJUGATE if one.inverse else 1.0) for one in readings if given.beside]
    k = next((k for k, one in enumerate(readings) if one.allowed and one.stated), -1)
    stated = readings[k] if k >= 0 else None
    for what in given.beside:
        scores, directions = np.transpose([given.agreement(what, quat) for quat in quats])
        if np.isnan(scores).all():
            continue
        scores = scores if np.nanmax(scores) >= LEVELS[what] else directions  # a unit is unknown, or wrong
        best, mine, is_gravity = float(np.nanmax(scores)), scores[k] if stated else np.nan, what == GRAVITY
        another, room = str(readings[int(np.nanargmax(scores))]), max(SAME * (1 - best), 0.05 if is_gravity else 0.1)
        fits = np.flatnonzero((1 - scores < room) | (scores == best)).tolist()
        own = [j for j in fits if readings[j].allowed]
        told = "steadiness of gravity" if is_gravity else f"agreement with the {what}"
        if what == GYROSCOPE and mine < FITS and best < MOUNTED < _mounted(*given.steps(what, quats[k])[:2]):
            continue
        if best < LEVELS[what] or (stated and best < SURE and k not in fits):
            if stated and not is_gravity and any(map(_turns, quats)):
                _warn("no-reading-fits", what=what, best=best)
        elif stated and (k in own or len(fits) == len(readings)):
            far = min(SAME * (1 - best) + BESIDE, max(FAR * (1 - best), LITTLE))
            if k in own and not is_gravity and 1 - mine > far:
                _warn("options-contradicted", told=told, mine=mine, best=best, another=another)
            others = [j for j, one in enumerate(readings) if one.inverse != stated.inverse]
            if not set(others) & set(fits):  # which tells the direction
                inverted = np.nanmax(scores[others])
                return stated, (f"checked: {told} {mine:.2f} as it is read, {inverted:.2f} inverted",)
        elif not own or scores[own].max() < best - SAME_ATTITUDE:
            if stated is None:
                mine = np.nanmax(scores[[one.allowed for one in readings]])
                raise InputError("options-contradicted", told=told, mine=mine, best=best, another=another)
            _warn("options-contradicted", told=told, mine=mine, best=best, another=another)
            return stated, ()
        elif all(np.nanmin(abs((quats[own[0]] * quats[j]).sum(axis=1))) > 1 - SAME_ATTITUDE for j in own[1:]):
            chosen = readings[own[int(np.argmax(scores[own]))]]
            if stated:
                _warn("reading-by-evidence", told=told, best=best, mine=mine, chosen=str(chosen), stated=str(stated))
            return chosen, (f"checked: {told} {best:.2f} as it is read",)
        elif not is_gravity:
            own.sort(key=lambda j: -scores[j])
            raise InputError("several-readings", readings="; ".join(str(readings[j]) for j in own))
    return stated, ()


def _turns(quat: Array) -> bool:
    """Whether the body turns by more than noise would."""
    quat = quat[finite_rows(quat)]
    dots = abs((quat[1:] * quat[:1]).sum(axis=1)) / np.maximum(np.linalg.norm(quat[1:], axis=1), 1e-300)
    return bool(dots.min(initial=1.0) < np.cos(TURNS / 2))


def _mounted(turned: Array, measured: Array) -> float:
    """Return the agreement with a gyroscope whose axes are those of the sensor, turned as fits best."""
    left, sizes, right = np.linalg.svd(turned.T @ measured)
    sizes[2] *= np.sign(np.linalg.det(left @ right))
    return float(sizes.sum() / max(np.linalg.norm(turned) * np.linalg.norm(measured), 1e-300))


def time_unit(reading: Reading, given: Evidence, has_unit: bool) -> tuple[float, tuple[str, ...]]:
    """Return the factor by which a gyroscope says that times are to be multiplied, and in words why; or warn of it."""
    if GYROSCOPE not in given.beside:
        return 1.0, ()
    turned, _, ahead = given.steps(GYROSCOPE, reading.quaternions(given.rows))
    whole = np.linalg.norm(turned, axis=1) / (2 * np.pi)
    if whole.max(initial=0.0) > 0.501:
        _warn("turns-lost", steps=counted(int((whole > 0.501).sum()), "step"), most=float(whole.max()))
        return 1.0, ()
    if len(turned) < FEWEST - 1 or cosine(turned, ahead) < SURE or np.linalg.norm(turned, axis=1).sum() < TURNS:
        return 1.0, ()
    factor = float((turned * ahead).sum() / (ahead * ahead).sum())
    for unit in () if has_unit else ("ms", "us", "ns"):
        if abs(factor / TIME[unit] - 1) < FACTOR:
            return TIME[unit], (f"time: in {unit}, by the gyroscope",)
    if abs(factor - 1) >= FACTOR:
        _warn("time-contradicted", factor=factor)
    return 1.0, ()


def _warn(code: str, **fields: Any) -> None:
    warn(InputWarning(code, **fields))
