"""Recordings as a caller gives them: angular velocities, attitudes, and the speed of a rotor, checked and cleaned."""

from __future__ import annotations

import io
import os
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Array, as_floats, as_number
from ..geometry.values import shown
from ..recordings.attitudes import Motion
from ..recordings.motions import measured_quaternions, raw_motion
from ..recordings.reading import Rates, of_run, read_motion, read_rates
from .measuring import Speed, as_speed, constant, continuous, derived_rates, finite_rows

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
    raise ValueError(f"{name} must be a path, a Dataset, or (times, rates); got {shown(one)}")


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
