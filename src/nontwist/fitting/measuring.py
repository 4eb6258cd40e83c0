r"""Recordings as a caller gives them, and what instruments read of a motion: gyroscopes, attitudes, speeds of rotors.

**A gyroscope** reads ``y(t) = s E Q W(t - τ) + b + noise`` with the bias b and the common scale s. ``Q = exp(-θ̂)``
takes components along the axes of the body to those of the gyroscope, which are turned by the rotation vector θ against
them; ``E = diag(e₁, e₂, e₃)`` are the scales of its axes, about 1; τ is the delay behind the clock of the recording.
The axes of the body are those in which attitudes, the centre of mass and the axis of a rotor are given. Derivatives,
with ``δ exp(θ̂) = (T δθ)^ exp(θ̂)``:

    ∂y/∂W = s E Q ,     ∂y/∂θ = s E Q Ŵ T ,     ∂y/∂e_i = s (Q W)_i ,     ∂y/∂τ = -s E Q W' .

Readings of free motion alone tell none of θ, e and τ. θ is another choice of axes: V = Q W is a free motion of the
inertia Q J Qᵀ. τ is another start. And along principal axes V = E W obeys

    V₁' = k₁ e₁/(e₂ e₃) V₂ V₃ ,     k₁ = (J₂ - J₃)/J₁ ,     and so on cyclically,

which is a free motion of another body wherever the three new rates obey ``k₁ + k₂ + k₃ + k₁ k₂ k₃ = 0``, as those of
all bodies do: one condition on three scales, so that a family of two is open. What gives axes or a clock besides,
attitudes, a centre of mass, the axis and the speed of a rotor, tells them, or some of them; where not, they are given
or have priors.

**An attitude** Λ, body to space, is a unit quaternion q = (v, w) of the state. The inertia is in recorded attitudes by
W alone. The frame of the recording is arbitrary, as the first attitude of each is fitted. A recorded attitude is
``Λ exp(φ̂)``, and φ, a rotation vector in body components, is its residual. Where the model turns by δ, to
``Λ exp(δ̂)``, this becomes φ - T δ with

    T = 1 - ½ φ̂ + φ̂²/12 + O(|φ|⁴) ,     δ = 2 vec(q̄ ∂q) .

q and -q are one attitude. Those of a recording are chosen so that neighbours are close, as those of a motion are.

**The speed of a rotor** is linear between knots. A tachometer reads ``Ω(t_k) + noise``. Its values at the knots are
unknowns of the fit, and its readings are residuals beside those of the gyroscope, over the noise that they have about
the best such line; so the error of the speed is part of every interval. How many knots: 1, 2, 4, ... equal intervals
are tried, and the number with the least ``n log(rss/n) + k log n`` is found (Schwarz, Annals of Statistics 6, 1978,
461-464). The gyroscope may feel a change of speed that the tachometer hides in its noise: where the speed is not one
line, intervals are a quarter as long, and as long as the residuals of the gyroscope are not white they are halved. A
speed of constant error, or a rotor whose inertia has one, is a factor with a prior (`bodies`).
"""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SENTENCES, InputError
from ..geometry.arrays import Array, as_array, as_floats, as_number, as_positive
from ..geometry.attitudes import hats, without_jumps
from ..geometry.rotations import dexp, exp
from ..geometry.values import short_repr
from ..machine import cached_property
from ..recordings.conventions import finite_rows
from ..recordings.motions import measured_quaternions, raw_motion
from ..recordings.options import require_plain
from ..recordings.orientations import Motion
from ..recordings.reading import Rates, of_run, read_motion, read_rates, speed_factor
from ..recordings.table import is_file
from .predictions import Line
from .unknowns import Model, of_keys

BIAS, SCALE = slice(0, 3), 3
PLACES = {"misalignment": slice(4, 7), "axis_scales": slice(7, 10), "delay": slice(10, 11)}
UNITS = {"misalignment": "rad", "axis_scales": "", "delay": "s"}
IDEAL = np.array([0.0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 0])
WIDE = {"misalignment": 0.2, "axis_scales": 0.05, "delay": 0.05}  # standard deviations before anything is known
TURN = 0.5  # rad: a delay that turns the body by more is none of a sensor
ARC, ATTITUDES = 0.4, 4  # rad to each side of a sample, and samples, whose attitudes give its angular velocity
HELD, COARSE = 0.5, 4.0  # of all readings, at most, that differ from the one before, by how many steps of rounding
MOST, EXACT = 64, 1e-6  # intervals of a speed; of the largest: noise at least
READINGS, AHEAD = 4, 2  # readings at least; halvings of the intervals that the tachometer asks for
SHARED = ("time_column", "body", "time_unit", "rate")  # settings of columns that attitudes have as well
BLOCK, PANEL = 6000, 8  # numbers, and columns, that BLAS leaves to one thread


@dataclass(frozen=True)
class Gyroscope:
    """b, rad/s, s, θ, rad, e and τ, s, and their standard deviations before a recording; 0: given."""

    mean: Array
    deviation: Array

    @cached_property
    def free(self) -> NDArray[np.intp]:
        """The places of what is fitted."""
        return np.flatnonzero(self.deviation)

    @cached_property
    def errors(self) -> NDArray[np.intp]:
        """The places of what is fitted of θ, e and τ."""
        return self.free[self.free > SCALE]

    @property
    def is_late(self) -> bool:
        """Whether there is a delay, or may be one."""
        return bool(self.mean[-1] != 0 or self.deviation[-1] > 0)

    def whole(self, fitted: Array) -> Array:
        """Return all numbers where those that are fitted have these values."""
        found = self.mean.copy()
        found[self.free] = fitted
        return found

    def reads(self, W: Array, rates: Array | None, fitted: Array) -> tuple[Array, Array, Array]:
        """Return readings, (n, 3), and their derivatives by W, (3, 3), and by what is fitted, (n, 3, k)."""
        whole, by = self.whole(fitted), np.zeros((len(W), 3, len(IDEAL)))
        scale, theta, e = whole[SCALE], whole[PLACES["misalignment"]], whole[PLACES["axis_scales"]]
        Q = exp(theta).T if theta.any() else np.eye(3)
        along, by_W = W @ Q.T, scale * e[:, None] * Q
        by[:, :, BIAS], by[:, :, SCALE] = np.eye(3), e * along
        if self.deviation[PLACES["misalignment"]].any():
            by[:, :, PLACES["misalignment"]] = by_W @ hats(W) @ dexp(theta)
        by[:, range(3), range(7, 10)] = scale * along
        if rates is not None:
            by[:, :, -1] = -rates @ by_W.T
        return scale * e * along + whole[BIAS], by_W, by[:, :, self.free]

    def undone(self, rates: Array) -> Array:
        """Return readings as those of an ideal gyroscope, but for the delay."""
        return (rates / self.mean[PLACES["axis_scales"]]) @ exp(self.mean[PLACES["misalignment"]]).T

    def require_short(self, rates: Array) -> None:
        """Raise a ValueError where a given delay turns the body too far."""
        turn = abs(float(self.mean[-1])) * float(np.linalg.norm(rates, axis=1).max())
        if turn > TURN:
            raise ValueError(
                f"delay = {self.mean[-1]:g} s is a turn of {turn:.2g} rad, more than the {TURN} rad that are taken: "
                "shift the times of the recording"
            )


def plain_gyroscope(bias: float, scale: float) -> Gyroscope:
    """Return a gyroscope of which bias and scale are fitted, with these standard deviations."""
    return Gyroscope(IDEAL.copy(), np.array([bias] * 3 + [scale] + [0.0] * 7))


def as_gyroscope(
    plain: Gyroscope, given: Mapping[str, Any], model: Model, has_gyroscope: bool, has_speeds: bool
) -> Gyroscope:
    """Return a gyroscope with further errors: each is None, given, "fit", or a mapping with `value` and `error`.

    Raises
    ------
    ValueError
        Something else; there is no gyroscope; the recording cannot tell what is to be fitted.
    """
    mean, deviation = plain.mean.copy(), plain.deviation.copy()
    for name, place in PLACES.items():
        value = given[name]
        if value is None:
            continue
        if not has_gyroscope:
            raise ValueError(f"{name} is that of a gyroscope, and attitudes alone are fitted: leave it out")
        if isinstance(value, str):
            if value != "fit":
                raise ValueError(
                    f"{name} must be numbers, 'fit', or a mapping with value and error; got {short_repr(value)}"
                )
            _require_told(name, model, has_speeds)
            deviation[place] = WIDE[name]
            continue
        shape = (3,) if place.stop - place.start == 3 else ()
        error: Any = 0.0
        if isinstance(value, Mapping):
            value = of_keys(value, ("value", "error"), name)
            if "error" not in value:
                raise ValueError(f"{name} lacks error, its standard deviation; a value without one is given as numbers")
            error = float(as_positive(value["error"], f"{name}: error", (), UNITS[name]))
            value = value.get("value", IDEAL[place] if shape else 0.0)
        mean[place], deviation[place] = as_array(value, name, shape), error
    if not (mean[PLACES["axis_scales"]] > 0).all():
        raise ValueError(f"axis_scales must be positive, got {short_repr(mean[PLACES['axis_scales']].tolist())}")
    return Gyroscope(mean, deviation)


AS_NUMBERS = "; otherwise give {option[%s]} as numbers, or with its standard deviation: value and error"
SENTENCES["delay-untold"] = (
    "angular velocities alone do not determine their delay; use recorded attitudes on the same clock "
    "({option[orientation='both']}) or the recorded speed of a rotor" + AS_NUMBERS % "delay"
)
for _name, _what in (("misalignment", "its misalignment"), ("axis_scales", "the scales of its single axes")):
    SENTENCES[f"{_name}-untold"] = (
        f"a gyroscope in free motion does not determine {_what}: another body would give the same readings; use "
        "recorded attitudes ({option[orientation='both']}), gravity about a pivot or a rotor" + AS_NUMBERS % _name
    )


def _require_told(name: str, model: Model, has_speeds: bool) -> None:
    """Raise an InputError where nothing in a recording tells this error of a gyroscope."""
    any_axis = name == "misalignment" and "axis" in model.places and model.pivot is None
    needed = not has_speeds if name == "delay" else model.is_free or any_axis
    if not model.oriented and needed:
        raise InputError(f"{name}-untold")


def continuous(quaternions: Array) -> Array:
    """Return quaternions of either sign so that each is close to the one before."""
    found = np.array(quaternions)
    good = finite_rows(found)
    found[good] = without_jumps(found[good])
    return found


def derived_rates(time: Array, quaternions: Array) -> Array:
    """Return angular velocities by parabolas through the rotation vectors to neighbouring attitudes, (n, 3)."""
    from scipy.spatial.transform import Rotation

    R = Rotation.from_quat(quaternions)
    steps = (R[:-1].inv() * R[1:]).magnitude()
    half = ARC / max(float(np.sqrt(np.mean((steps / np.diff(time)) ** 2))), 1e-300)
    first, last = np.searchsorted(time, time - half), np.searchsorted(time, time + half, "right")
    rates = np.empty((len(time), 3))
    for k, t in enumerate(time):
        near = slice(min(int(first[k]), max(k - ATTITUDES, 0)), max(int(last[k]), k + ATTITUDES + 1))
        turned = (R[k].inv() * R[near]).as_rotvec()
        rates[k] = np.polynomial.polynomial.polyfit(time[near] - t, turned, 2)[1]
    return rates


def gaps(recorded: Array, model: Array, slope: Array) -> tuple[Array, Array]:
    """Return the rotation vectors from attitudes of a model to recorded ones, in body components, and derivatives.

    These are by numbers on which the quaternions of the model depend with this `slope`, (n, 4, k).
    """
    from scipy.spatial.transform import Rotation

    gap = np.asarray((Rotation.from_quat(model).inv() * Rotation.from_quat(recorded)).as_rotvec())
    v, w = model[:, :3], model[:, 3, None, None]
    turned = w * slope[:, :3] - v[:, :, None] * slope[:, 3:] - hats(v) @ slope[:, :3]
    across = hats(gap)
    T = np.eye(3) - across / 2 + across @ across / 12
    return gap, -2 * T @ turned / (model**2).sum(axis=1)[:, None, None]


@dataclass(frozen=True)
class Speed:
    """Readings of a speed, rad/s, at their times, the knots, first values there, and the noise of a reading."""

    time: Array
    readings: Array
    knots: Array
    values: Array
    noise: float

    def at(self, time: Array) -> Array:
        """Return the speed at times by the values at the knots, (n, k)."""
        return linear_between(self.knots, time)

    @cached_property
    def rows(self) -> tuple[Array, Array]:
        """H and y, as few rows as there are knots: ``y - H values`` is as long as the residuals of all readings."""
        reduced = triangle(np.column_stack([self.at(self.time), self.readings]) / self.noise)
        return reduced[:, :-1], reduced[:, -1]

    @cached_property
    def slopes(self) -> Array:
        """The rates of the pieces by the values at the knots."""
        return np.diff(np.eye(len(self.knots)), axis=0) / np.diff(self.knots)[:, None]

    def line(self, first: float, last: float, values: Array) -> Line:
        """Return the speed from one time to another by the values at the knots."""
        knots = self.knots
        piece = min(max(int(knots.searchsorted(first, "right")) - 1, 0), len(knots) - 2)
        end = max(int(knots[:-1].searchsorted(last)), piece + 1)
        by, start = self.slopes[piece:end], np.zeros(len(knots))
        along = min(max((first - knots[piece]) / (knots[piece + 1] - knots[piece]), 0.0), 1.0)
        start[piece : piece + 2] = 1 - along, along
        return Line(knots[piece + 1 : end] - first, by @ values, by, float(start @ values), start)

    def refined(self) -> Speed | None:
        """Return the same readings with twice as many intervals; None where there are enough."""
        count = 2 * (len(self.knots) - 1)
        if count > min(MOST, len(self.time) // 3):
            return None
        return of_knots(self.time, self.readings, np.linspace(self.knots[0], self.knots[-1], count + 1))


def linear_between(knots: Array, time: Array) -> Array:
    """Return the functions that are linear between knots, 1 at one and 0 at all others, at times, (n, k)."""
    return np.stack([np.interp(time, knots, unit) for unit in np.eye(len(knots))], axis=1)


def triangle(A: Array) -> Array:
    """Return R of a product QR of a matrix; a matrix of few rows as it is.

    R takes up one block of rows after the other: BLAS would share a larger one among threads, which on a busy machine
    wait for each other a hundred times as long as they work.
    """
    from scipy.linalg.lapack import dtpqrt

    columns = A.shape[1]
    if len(A) <= columns:
        return A
    R = np.zeros((columns, columns), order="F")
    for rows in np.array_split(A, -(-A.size // BLOCK)):
        R = dtpqrt(0, min(PANEL, columns), R, rows)[0]
    return np.asarray(np.triu(R))


def as_speed(time: Array, readings: Array) -> Speed:
    """Return readings with knots that are enough for them; those that are held or not finite do not count.

    A tachometer that is read less often than the gyroscope holds its last reading, which is late then. Where readings
    repeat because they are rounded, they differ by a step or two.
    """
    leaps = abs(np.diff(readings))
    moved = leaps[leaps > 0]
    is_held = 0 < moved.size < HELD * readings.size and np.median(moved) > COARSE * moved.min()
    good = np.isfinite(readings) & ~(is_held & np.append(False, leaps == 0))
    if good.sum() < READINGS:
        raise ValueError(f"{good.sum()} readings of the speed are too few; a fit needs {READINGS}")
    trials: list[Speed] = [of_knots(time[good], readings[good], time[[0, -1]])]
    while (finer := trials[-1].refined()) is not None:
        trials.append(finer)
    scores = [len(one.time) * 2 * np.log(one.noise) + len(one.knots) * np.log(len(one.time)) for one in trials]
    best = int(np.argmin(scores))
    return trials[min(best + AHEAD, len(trials) - 1) if best else 0]


def of_knots(time: Array, readings: Array, knots: Array) -> Speed:
    """Return readings with their best values at some knots."""
    R = triangle(np.column_stack([linear_between(knots, time), readings]))
    values = np.asarray(np.linalg.lstsq(R[:, :-1], R[:, -1], rcond=1e-8)[0], dtype=float)
    rss = float(((R[:, -1] - R[:, :-1] @ values) ** 2).sum())
    least = EXACT * max(float(abs(readings).max()), 1e-300)
    return Speed(time, readings, knots, values, max(float(np.sqrt(rss / max(len(time) - len(knots), 1))), least))


def as_readings(recording: Any, reading: dict[str, Any], use: str, attitudes: dict[str, Any]) -> list[Rates]:
    """Return recordings; `use` is "only" or "both" where attitudes of files and runs are fitted, read as told."""
    many = recording if isinstance(recording, list) else [recording]
    if not many:
        raise ValueError("recording is an empty list: name at least one file")
    if not any(map(is_file, many)):
        own = {key: value for key, value in reading.items() if key not in ("speed", "speed_unit")}
        require_plain(own | attitudes)
    names = [f"recording {k + 1}" for k in range(len(many))] if len(many) > 1 else ["the recording"]
    found = [_reading(one, name, reading, use, attitudes) for one, name in zip(many, names, strict=True)]
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
        motion = Motion(turned[0].as_quat(), as_floats(rest[0], "times")) if turned and rest else None
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
        elif isinstance(one, (str, os.PathLike)):
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


def _rates(one: Any, name: str, reading: dict[str, Any], quaternions: Array | None) -> Rates:
    """Return one recording, checked and cleaned."""
    if is_file(one):
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
        speed = arrays[2] * speed_factor(reading.get("speed_unit")) if len(arrays) == 3 else None
        return Rates(time, arrays[1], name, ("rates: as given",), None, speed, quaternions).cleaned()
    raise ValueError(f"{name} must be a path, a DataFrame, a Dataset, or (times, rates); got {short_repr(one)}")


def spun(one: Rates, spin: Any, speed_unit: str | None = None) -> Rates:
    """Return a recording with the speed of a rotor, a number where it is constant; without one where `spin` is None."""
    if spin is None:
        return replace(one, speed=None)
    if one.speed is None:
        if isinstance(spin, str):
            raise ValueError(f"{one.name} has no columns; give the speed of the rotor as a number, rad/s")
        return replace(one, speed=np.full(len(one.time), as_number(spin, "rotor: speed") * speed_factor(speed_unit)))
    if not np.isfinite(one.speed).any():
        raise ValueError(f"{one.name}: no reading of the speed of the rotor is a number")
    return one


def speed_of(one: Rates, rows: slice | NDArray[np.intp], sense: float = 1.0) -> Speed | None:
    """Return the speed of the rotor in some rows; with the sense -1, backwards in time, these descend."""
    if one.speed is None:
        return None
    try:
        return as_speed(sense * one.time[rows], one.speed[rows])
    except ValueError as error:
        raise ValueError(f"{one.name}: {error}") from error
