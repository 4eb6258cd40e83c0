"""Recordings as a caller gives them: angular velocities, attitudes, and the speed of a rotor, checked and cleaned.

What is wrong with a recording, in a sentence, before and after a fit.
"""

from __future__ import annotations

import io
import os
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Array, as_floats, as_number
from ..geometry.values import short_repr
from ..recordings.attitudes import Motion
from ..recordings.motions import measured_quaternions, raw_motion
from ..recordings.reading import Rates, of_run, read_motion, read_rates
from .bodies import Model
from .measuring import Speed, as_speed, constant, continuous, derived_rates, finite_rows

FEWEST, LEAST_TURN, MOST_TURN = 12, 1.0, 1.5  # samples; rad over all; rad from sample to sample
PLATEAU, EQUAL = 4, 0.1  # equal largest values in a row that are no chance; share of other equal ones in coarse data
WHITE = 5.0  # standard errors of a correlation that is none
STRAY = 8.0  # times the noise: no noise
WINDOW, TURN, DEGREE = 14, 1.5, 8  # samples and rad, at least, of a window; of the polynomial in it
MISFIT = 2.0  # residuals over the scatter of the samples: no noise leaves these
EXACT = 1e-4  # of the speed: residuals that need no noise
FINE = 1e-9  # rad: noise of attitudes at least


def noise_of(rates: Array) -> float:
    """Return the standard deviation of the noise of samples of a smooth motion, by their sixth differences."""
    if len(rates) < 14:
        return 0.0
    return float(np.median(abs(np.diff(rates, 6, axis=0))) / 0.6745 / np.sqrt(924))  # 924 = Σ binomials²


def scatter_of(time: Array, samples: Array, rates: Array | None = None) -> float:
    """Return the standard deviation of samples about polynomials, each over a window of `TURN` rad at least.

    A motion is as smooth as that and noise is not, also where a sensor filters its highest frequencies. So no model
    leaves much less, and the right one does not leave much more. Three numbers of each sample are free; `rates` are the
    angular velocities where the samples are not.
    """
    turned = float(np.trapezoid(np.linalg.norm(samples if rates is None else rates, axis=1), time))
    count = max(1, min(len(time) // WINDOW, int(turned / TURN)))
    squares = free = 0.0
    for rows in np.array_split(np.arange(len(time)), count):
        degree = min(DEGREE, len(rows) // 2)
        t = (time[rows] - time[rows].mean()) / np.ptp(time[rows])
        A = np.polynomial.legendre.legvander(2 * t, degree)
        squares += float(((samples[rows] - A @ np.linalg.lstsq(A, samples[rows], rcond=None)[0]) ** 2).sum())
        free += 3 * (len(rows) - degree - 1)
    return float(np.sqrt(squares / free))


def haste_of(model: Model, time: Array, rates: Array) -> float:
    """Return how many times as fast as the body turns W changes, 1 at least: a rotor turns W at about |h|/J.

    The change is ``√(mean |W(t + d) - W(t)|² - 6 σ²)/d`` with the shortest delay d at which noise is the smaller part.
    """
    if model.wheel is None:
        return 1.0
    square, noise = float((rates**2).sum(axis=1).mean()), 6 * noise_of(rates) ** 2
    for lag in (1, 2, 4, 8, 16):
        change = float(((rates[lag:] - rates[:-lag]) ** 2).sum(axis=1).mean()) if lag < len(rates) else 0.0
        if change > 2 * noise:
            delay = lag * float(np.median(np.diff(time)))
            return max(1.0, float(np.sqrt(change - noise)) / max(delay * square, 1e-300))
    return 1.0


def noise_of_attitudes(quaternions: Array) -> float:
    """Return the standard deviation of the noise of attitudes, rad: of a quaternion it is half as large."""
    return max(2 * noise_of(quaternions[finite_rows(quaternions)]), FINE)


def scatter_of_attitudes(time: Array, quaternions: Array | None, rates: Array) -> float:
    """Return the standard deviation of attitudes about a smooth motion of these angular velocities, rad; 0 without."""
    if quaternions is None:
        return 0.0
    good = finite_rows(quaternions)
    return 2 * scatter_of(time[good], quaternions[good], rates[good])


def require_turning(model: Model, time: Array, rates: Array, where: str) -> None:
    """Raise a ValueError where a body turns too little, or too much from sample to sample."""
    if len(time) < FEWEST:
        raise ValueError(f"{where}: {len(time)} samples are too few, a fit needs {FEWEST}; use a longer interval")
    speed = haste_of(model, time, rates) * np.linalg.norm(rates, axis=1)
    turned = float(np.trapezoid(speed, time))
    if turned < LEAST_TURN:
        raise ValueError(
            f"{where}: the body turns by only {turned:.2g} rad in {time[-1] - time[0]:.3g} s, too little to determine "
            "an inertia: turn it faster, throw it higher; or is the unit rad/s?"
        )
    between = float(np.median(np.diff(time)) * speed.max())
    if between > MOST_TURN:
        raise ValueError(
            f"{where}: the body turns by up to {between:.3g} rad from one sample to the next, too coarse: record at "
            f"{speed.max() / 0.5:.3g} Hz or more, or turn it more slowly; or is the unit deg/s?"
        )


def require_unsaturated(time: Array, rates: Array, where: str) -> None:
    """Raise a ValueError where an axis has reached its largest reading."""
    speed = np.linalg.norm(rates, axis=1)
    for axis, column in zip("xyz", rates.T, strict=True):
        for level in (column.max(), column.min()):
            at = np.flatnonzero(column == level)
            others = (np.diff(column) == 0) & (column[1:] != level)
            borders = np.flatnonzero(np.concatenate([[True], np.diff(at) != 1, [True]]))
            if np.diff(borders).max() >= PLATEAU and others.mean() < EQUAL and abs(level) > 0.5 * speed.max():
                raise ValueError(
                    f"{where}: the gyroscope is saturated: {len(at)} samples of axis {axis} read {level:.6g} rad/s, "
                    f"the first at t = {time[at[0]]:.6g} s; turn the body more slowly, or give the sensor a larger "
                    "range"
                )


def correlation(residual: Array, lag: int = 1) -> float:
    """Return the correlation of residuals with their neighbours, or with those `lag` samples before, over all axes."""
    r = residual - residual.mean(axis=0)
    return float((r[lag:] * r[:-lag]).sum() / max((r * r).sum(), 1e-300))


def new_of(residual: Array) -> float:
    """Return which part of residuals is new at each sample where they are noise that goes on as φᵏ, else 1.

    That is ``√(1 - φ²)``, and ``r_k - φ r_k-1`` are then white. What a wrong model leaves is smooth: beside white noise
    it makes these correlated.
    """
    phi, chance = correlation(residual), WHITE / np.sqrt(residual.size)
    new = residual[1:] - phi * residual[:-1]
    if phi < chance or max(abs(correlation(new, lag)) for lag in (1, 2)) > chance:
        return 1.0
    return float(np.sqrt(1 - phi**2))


SHARED = ("time_column", "body", "time_unit", "rate")  # settings of columns that attitudes have as well


def as_readings(recording: Any, reading: dict[str, Any], use: str, attitudes: dict[str, Any]) -> list[Rates]:
    """Return recordings; `use` is "only" or "both" where attitudes of files and runs are fitted, read as told."""
    found = [_reading(one, name, reading, use, attitudes) for one, name in _listed(recording)]
    kinds = {(one.has_gyroscope, one.quaternions is not None) for one in found}
    if len(kinds) > 1:
        raise ValueError("some of the recordings have attitudes or angular velocities that others lack: fit them apart")
    return found


def _reading(one: Any, name: str, reading: dict[str, Any], use: str, attitudes: dict[str, Any]) -> Rates:
    """Return one recording."""
    motion, notes, rest = None, tuple[str, ...](), one
    if isinstance(one, tuple):
        turned = [part for part in one if hasattr(part, "as_quat")]
        rest = tuple(part for part in one if not hasattr(part, "as_quat"))
        motion = Motion(turned[0], as_floats(rest[0], "times")) if turned and rest else None
        if len(rest) == 1 or use == "only":
            use, notes = "only", ("attitudes: as given",)
    elif hasattr(one, "dims") and not hasattr(one, "data_vars"):
        motion, notes, use = raw_motion(one, None), (one.attrs.get("notes", "attitudes: as given"),), "only"
    elif use and hasattr(one, "data_vars"):
        try:
            motion, notes = raw_motion(one, None), ("attitudes: directors",)
        except ValueError as error:
            raise ValueError(f"{name} has no attitudes: {error}") from error
    elif use:
        again = one
        if callable(getattr(one, "read", None)):
            text = one.read()
            rest, again = io.StringIO(text), io.StringIO(text)
        else:
            name = str(one)
        how = {key: value for key, value in reading.items() if key in (*SHARED, "columns") and value is not None}
        if use == "both":
            how.pop("columns", None)
        try:
            recording = read_motion(again, **how, **attitudes)
        except InputError as error:
            raise error.about(name) from error
        motion, notes = raw_motion(recording, None), (recording.attrs["notes"],)
    if motion is None:
        return _rates(rest, name, reading, None)
    quaternions = _quaternions(motion)
    if use == "only":
        return _attitudes(motion, quaternions, name, notes)
    found = _rates(rest, name, reading, continuous(quaternions))
    return replace(found, notes=(*found.notes, *notes))


def _quaternions(motion: Motion) -> Array:
    """Return attitudes as quaternions, (n, 4), nan where there is none; a ValueError where a row is no rotation."""
    values = motion.values
    if hasattr(values, "as_quat"):
        return np.asarray(values.as_quat())
    found, rows = np.full((len(values), 4), np.nan), finite_rows(values.reshape(len(values), -1))
    found[rows] = measured_quaternions(motion, rows)
    return found


def _attitudes(motion: Motion, quaternions: Array, name: str, notes: tuple[str, ...]) -> Rates:
    """Return attitudes alone, with the angular velocities that follow from them."""
    if motion.time is None:
        raise InputError("no-time", name)
    found = Rates(motion.time, quaternions, name, notes).cleaned(motion.lines)
    turned = continuous(found.rates / np.linalg.norm(found.rates, axis=1, keepdims=True))
    rates = derived_rates(found.time, turned)
    return replace(found, rates=rates, quaternions=turned, has_gyroscope=False)


def _listed(recording: Any) -> list[tuple[Any, str]]:
    """Return recordings with names."""
    many = recording if isinstance(recording, list) else [recording]
    if not many:
        raise ValueError("recording is an empty list: name at least one file")
    return [(one, f"recording {k + 1}" if len(many) > 1 else "the recording") for k, one in enumerate(many)]


def _rates(one: Any, name: str, reading: dict[str, Any], quaternions: Array | None) -> Rates:
    """Return one recording, checked and cleaned."""
    if isinstance(one, (str, os.PathLike)) or callable(getattr(one, "read", None)):
        try:
            return read_rates(one, **reading, quaternions=quaternions)
        except InputError as error:
            raise error.about(str(one) if isinstance(one, (str, os.PathLike)) else "") from error
    if hasattr(one, "data_vars"):
        return of_run(one, name, quaternions)
    if isinstance(one, tuple) and len(one) in (2, 3):
        arrays = [as_floats(part, what) for part, what in zip(one, ("times", "rates", "speeds"), strict=False)]
        time, n = arrays[0], arrays[0].size
        if time.ndim != 1:
            raise ValueError(f"times must have the shape (n,), got {time.shape}")
        for what, array, shape in zip(("rates", "speeds"), arrays[1:], ((n, 3), (n,)), strict=False):
            if array.shape != shape:
                raise ValueError(f"{what} must have the shape {shape} as there are {n} times, got {array.shape}")
        speed = arrays[2] if len(arrays) == 3 else None
        return Rates(time, arrays[1], name, ("rates: as given",), None, speed, quaternions).cleaned()
    raise ValueError(f"{name} must be a path, a Dataset, or (times, rates); got {short_repr(one)}")


def speed_of(one: Rates, spin: Any, rows: slice | NDArray[np.intp], sense: float = 1.0) -> Speed:
    """Return the speed of the rotor in some rows; with the sense -1, backwards in time, these descend."""
    time = sense * one.time[rows]
    if one.speed is None:
        if isinstance(spin, str):
            raise ValueError(f"{one.name} has no columns; give the speed of the rotor as a number, rad/s")
        return constant(time, as_number(spin, "rotor: speed"))
    if not np.isfinite(one.speed[rows]).any():
        raise ValueError(f"{one.name}: no reading of the speed of the rotor is a number")
    try:
        return as_speed(time, one.speed[rows])
    except ValueError as error:
        raise ValueError(f"{one.name}: {error}") from error
