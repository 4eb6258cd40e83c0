"""`fit_inertia`: from recordings to a `Fit`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..errors import SENTENCES, InputError, InputWarning, Option, warn
from ..geometry.arrays import Array, as_array, as_flag, as_positive
from ..geometry.values import require_among, short_repr
from ..recordings.options import ReadOptions
from ..recordings.reading import Rates
from ..spec import takes
from .estimating import estimate, is_hopeless
from .intervals import FITS, NoMotionError, Search
from .measuring import Gyroscope, as_gyroscope, as_readings, plain_gyroscope, speed_of, spun
from .predictions import RunawayError
from .reports import worth
from .result import Fit, Part
from .shooting import Loss, Shooting, Stretch, noise_of, noise_of_attitudes, require_turning, require_unsaturated
from .solving import CALLS, PATIENT
from .telling import beyond_the_wall
from .unknowns import Model, as_model, as_orientation

KNOWN = 1e-12  # a prior that leaves nothing open; squares of the inverse of a smaller one may overflow
OUTSIDE = 4.0  # standard errors beyond the flat bodies


@takes(ReadOptions, "time_column", "body", "time_unit", "rate")
def fit_inertia(
    recording: Any,
    *,
    interval: tuple[float, float] | Literal["free", "all"] | None = None,
    gravity: Mapping[str, Any] | Literal["unknown"] | None = None,
    rotor: Mapping[str, Any] | None = None,
    damping: ArrayLike | Literal["one", "three"] | None = None,
    constraint: ArrayLike | Literal["x", "y", "z", "-x", "-y", "-z"] | None = None,
    orientation: Mapping[str, Any] | Literal["only", "both"] | None = None,
    bias: float = 0.02,
    scale: float = 0.01,
    delay: float | Literal["fit"] | Mapping[str, float] | None = None,
    misalignment: ArrayLike | Literal["fit"] | Mapping[str, Any] | None = None,
    axis_scales: ArrayLike | Literal["fit"] | Mapping[str, Any] | None = None,
    noise: float | None = None,
    loss: Loss = "linear",
    physical: bool = True,
    columns: Sequence[str] | None = None,
    unit: str | None = None,
    **reading: Any,
) -> Fit:
    """Fit the inertia of a rigid body to recordings of its motion: thrown, or swinging on a pivot.

    Free motion determines the inertia up to a factor, so the moments are given relative to their sum. Under gravity
    about a pivot, a known mass and centre of mass give the scale. What a recording leaves undetermined is named, and is
    nan in the result.

    Parameters
    ----------
    recording : path, DataFrame, Dataset, DataArray, (times, rates) or (times, rates, speeds); or a list of them
        Files or tables with the columns of a gyroscope and its time; what `nontwist.sensors.gyroscope` returns; a run
        of `simulate`; or arrays: times, (n,), s, angular velocities in the axes of the sensor, (n, 3), rad/s, and
        speeds of a rotor, (n,), rad/s. Attitudes, body to space, are given as what `read_motion` returns, or as a
        Rotation of length n in place of the angular velocities or after them. Several recordings of one body by one
        sensor are fitted together.
    interval : (float, float), "free" or "all", optional
        Which part of each recording is fitted, s. "free", the default: from release to catch, found from the
        accelerometer if there is one and the body is thrown, otherwise the longest interval in which a body on which
        this acts can move as recorded. "all": every sample; the default for attitudes alone of a body on which
        something acts.
    gravity : mapping or "unknown", optional
        The body turns about a fixed point under gravity. Keys: `mass`, kg; `centre`, the centre of mass from the pivot
        in the axes of the sensor, (3,), m, or only its `distance`, m, so that its direction is fitted; `g`, by default
        9.81 m/s². J is then about the pivot, kg m². "unknown": neither mass nor centre is known, and J/(m|c|), m, is
        fitted.
    rotor : mapping, optional
        A rotor of known momentum turns in the body, which also gives the scale: J is that of the body with the rotor
        locked, kg m². Keys: `axis`, (3,) or "x", "y", "z", "-x", "-y", "-z", or "fit"; `inertia` about it, kg m²;
        `speed` relative to the body, positive by the right hand about the axis, the header of a column, or a number,
        left out where arrays bring it; its `unit`, else that of the column or rad/s; `error`, the relative standard
        deviation of the momentum, by default 0. The noise of a recorded speed is estimated from its readings.
    damping : "one", "three", float or (3,) array, optional
        A moment -C W acts. "one", "three": C is fitted, as one number or as three along the axes of the sensor.
        Numbers: C is known, N m s; this requires a known scale.
    constraint : (3,) array, or "x", "y", "z", "-x", "-y", "-z", optional
        An axis n of the body about which it may not turn, W·n = 0: a non-twisting body or another Suslov body, under
        gravity or with a rotor. The moment of inertia about n does not affect the motion, and is nan.
    orientation : "only", "both" or mapping, optional
        Fit the attitudes of a file or of a run, alone or together with the angular velocity. They must be independent
        of the angular velocity and refer to the same axes. A mapping has the key `use`, "only" or "both", and options
        that define how a file is read: `scalar_first`, `euler`, `rotation_vector`, `angle_unit`, `normalize`,
        `inverse`, as in `read_motion`. By default the angular velocity of a file is fitted; of other inputs, everything
        that is given.
    bias : float, rad/s
        Prior standard deviation of the bias of the gyroscope about 0.
    scale : float
        Prior standard deviation of its scale about 1.
    delay : float, "fit", or mapping, s, optional
        Delay of the readings of the gyroscope relative to their times. A number is assumed exact. Keys of a mapping:
        `value`, by default 0, and `error`, its prior standard deviation. "fit": fit the delay, which attitudes on the
        same clock or the recorded speed of a rotor determine.
    misalignment : (3,) array, "fit", or mapping, rad, optional
        Rotation vector from the axes of the body, in which attitudes, centre of mass and rotor are given, to those of
        the gyroscope. Given or fitted like the delay. Attitudes determine it; a centre of mass or the axis of a rotor
        determines two of its components.
    axis_scales : (3,) array, "fit", or mapping, optional
        Scales of the single axes of the gyroscope, about 1, in addition to the common scale. Given or fitted like the
        misalignment.
    noise : float, rad/s, optional
        Standard deviation of the noise of a sample. By default it is estimated from the residuals.
    loss : "linear" or "soft_l1"
        "soft_l1" is robust: outliers have less weight, and intervals are approximate.
    physical : bool
        False also accepts a J that no distribution of mass has, as one with a moment larger than the sum of the others;
        it is still positive definite.
    columns : sequence of str, optional
        Headers of the three columns of the angular velocity, preceded by that of the time if there is one.
    unit : str, optional
        Unit of the angular velocity in files that do not state it: rad/s, deg/s, mrad/s, mdeg/s or rpm.
    {ReadOptions}

    Returns
    -------
    Fit

    Raises
    ------
    ValueError
        There is no angular velocity, unit, time or free motion; a recording is too short, too coarse or saturated, or
        no rigid body moves like this; `gravity` has an unknown key, no mass or distance, or a centre of length 0;
        `rotor` lacks a key, or has an axis of length 0, an unknown column or unit; there are no attitudes, or attitudes
        alone without an interval; the recording cannot determine an error of the gyroscope, or its value is impossible;
        damping is negative, or known without a scale; a constraint has length 0, or is given in free motion. The
        message states the remedy.
    OSError
        A file cannot be read.

    Warns
    -----
    UserWarning
        Rows are dropped; residuals are larger than noise explains, or not white; there are outliers; or some quantities
        are undetermined.

    Examples
    --------
    >>> from nontwist import fit_inertia, sensors, simulate, standard
    >>> run = simulate(standard([1, 2, 2.5]), t_end=1, material_angular_velocity=(3, 8, 1))
    >>> fit = fit_inertia(sensors.gyroscope(run, noise=1e-4, bias=(0.01, 0, 0), rate=200))
    >>> (5.5 * fit.principal.moments).round(2)
    array([1. , 2. , 2.5])
    >>> fit.untold
    ()

    A pendulum that swings and turns on a string, with known mass and centre of mass:

    >>> from nontwist import heavy_top
    >>> pendulum = heavy_top([0.020, 0.022, 0.004], mass=0.5, centre_of_mass=(0, 0, -0.15))
    >>> swing = simulate(pendulum, t_end=2, rotation=[[1, 0, 0], [0, 0, -1], [0, 1, 0]], angular_velocity=(1, 2, 5))
    >>> recording = sensors.gyroscope(swing, noise=1e-4, rate=100)
    >>> fit = fit_inertia(recording, gravity={"mass": 0.5, "centre": (0, 0, -0.15)})
    >>> (1000 * fit.principal.moments).round(1)
    array([ 4., 20., 22.])
    >>> fit.unit
    'kg m²'
    """
    every = recording if isinstance(recording, list) else [recording]
    if isinstance(rotor, Mapping) and all(isinstance(one, tuple) and len(one) == 3 for one in every):
        rotor = {"speed": "of the arrays", **rotor}
    model = as_model(gravity, damping, rotor, constraint, as_flag(physical, "physical"))
    deviations = as_positive(bias, "bias", (), "rad/s"), as_positive(scale, "scale", (), "")
    plain = plain_gyroscope(*(max(float(one), KNOWN) for one in deviations))
    sigma = 0.0 if noise is None else float(as_positive(noise, "noise", (), "rad/s"))
    require_among(loss, "loss", ("linear", "soft_l1"))
    ReadOptions(columns=columns, **reading)  # refuses what it does not know
    reading |= {"columns": columns, "unit": unit}
    spin = None if rotor is None else rotor["speed"]
    units = {} if rotor is None else {"speed_unit": rotor.get("unit")}
    reading |= units | ({"speed": spin} if isinstance(spin, str) else {})
    given = [spun(one, spin, **units) for one in as_readings(recording, reading, *as_orientation(orientation))]
    model = replace(model, oriented=given[0].quaternions is not None)
    errors = {"delay": delay, "misalignment": misalignment, "axis_scales": axis_scales}
    gyroscope = as_gyroscope(plain, errors, model, given[0].has_gyroscope, isinstance(spin, str))
    task = Task(given, interval, plain, gyroscope, sigma, loss)
    try:
        fit = task.fit(model)
    except NoMotionError as error:
        raise error.with_what_fits(task.what_fits(model)) from error
    if not fit.is_explained and fit.untold and (other := task.what_fits(model)):
        raise task.no_motion(fit.solution.problem.stretches, fit.residual, model).with_what_fits(other)
    for one in (*task.said, *worth(fit)):
        warn(one)
    return fit


@dataclass(frozen=True)
class Task:
    """Recordings that are fitted, whatever the model: the interval and the noise, 0 where it is not known, as given."""

    given: Sequence[Rates]
    interval: Any
    plain: Gyroscope
    gyroscope: Gyroscope
    sigma: float
    loss: Loss
    is_brief: bool = False  # motions are not searched in shorter windows, nor fitted to the end of a long valley

    def fit(self, model: Model) -> Fit:
        """Return the fit of a model.

        Raises
        ------
        NoMotionError
            No body of the model moves as recorded.
        """
        cuts = [self.cut(one, model) for one in self.given]
        stretches = [self.stretch(one, slice(*cut[:2]), model) for one, cut in zip(self.given, cuts, strict=True)]
        attitudes = [one.quaternions for one in stretches if one.quaternions is not None]
        tilt = max(map(noise_of_attitudes, attitudes), default=0.0)
        noise = self.noise(stretches, tilt)
        try:
            problem = Shooting(stretches, self.gyroscope, noise, model, self.loss, (), tilt)
            found = estimate(problem, self.sigma > 0, calls=CALLS if self.is_brief else PATIENT)
        except RunawayError as error:
            raise self.no_motion(stretches, None, model) from error
        if is_hopeless(found):
            raise self.no_motion(stretches, found.misses, model)
        parts, problem, at = [], found.problem, found.unknowns
        if problem.has_gyroscope:
            ends = np.cumsum([len(one.time) for one in stretches])[:-1]
            explained = np.split(problem.data - found.left_over, ends)
        else:
            explained = [values[:, :3] for values, _ in problem.motions(at)]
        for k, (one, stretch, (*_, how)) in enumerate(zip(self.given, problem.stretches, cuts, strict=True)):
            start, down, attitude = np.split(at.starts[k], [3, 3 + 3 * (model.pivot is not None)])
            spun = None if stretch.speed is None else (stretch.speed.knots, at.flat[problem.speeds_of(k)])
            seen = start, down, how, one.left_out, one.notes, spun, stretch.quaternions, attitude
            parts.append(Part(one.name, stretch.time, stretch.rates, explained[k], *seen))
        fit = Fit(tuple(parts), found, tuple(map(str, self.said)), self.sigma)
        if (outside := beyond_the_wall(found)) > OUTSIDE:
            why, given = _beyond(model), "mass and centre, the unit" if model.weight else "the unit"
            raise NoMotionError("no-inertia", names=self.names, why=why, outside=outside, given=given)
        return fit

    def stretch(self, one: Rates, rows: slice, model: Model) -> Stretch:
        """Return some samples of a recording; a ValueError where they cannot be fitted."""
        t, y = one.time[rows], one.rates[rows]
        require_turning(model, t, y, one.name)
        if one.has_gyroscope and one.is_read:
            require_unsaturated(t, y, one.name)
        self.gyroscope.require_short(y)
        quaternions = None if one.quaternions is None else one.quaternions[rows]
        return Stretch(t, y, speed_of(one, rows), quaternions, one.has_gyroscope)

    def noise(self, stretches: Sequence[Stretch], tilt: float) -> float:
        """Return the noise of a sample that a fit begins with."""
        speed = max(float(abs(one.rates).max()) for one in stretches)
        if not stretches[0].has_gyroscope:  # of gaps between short arcs alone
            return tilt * speed
        return self.sigma or max(*(noise_of(one.rates) for one in stretches), 1e-6 * speed)

    def cut(self, one: Rates, model: Model) -> tuple[int, int, str]:
        """Return the samples to fit, from the first to before the last, and how they were found."""
        interval = self.interval
        if interval is None:
            interval = "free" if model.is_free or one.has_gyroscope else "all"
        if isinstance(interval, str):
            if interval == "all":
                return 0, len(one.time), "all"
            if interval == "free":
                return self.searched(one, model)
            raise ValueError(f"interval must be two times, 'free' or 'all'; got {short_repr(interval)}")
        first, last = as_array(interval, "interval", (2,))
        if not first < last:
            raise ValueError(f"interval must be two times, the first before the last; got {first:g} s and {last:g} s")
        a, b = int(np.searchsorted(one.time, first, "left")), int(np.searchsorted(one.time, last, "right"))
        if b <= a:
            raise ValueError(
                f"{one.name} has no sample between {first:g} s and {last:g} s; it lasts from {one.time[0]:.6g} s to "
                f"{one.time[-1]:.6g} s"
            )
        return a, b, "as given"

    def searched(self, one: Rates, model: Model) -> tuple[int, int, str]:
        """Return the samples of the longest motion of the model, and how they were found."""
        if not one.has_gyroscope:
            raise InputError("attitudes-alone", one.name)
        require_turning(model, one.time, one.rates, one.name)
        seen = replace(one, rates=self.gyroscope.undone(one.rates))
        try:
            return Search(seen, replace(model, oriented=False), self.plain, self.is_brief).found()
        except NoMotionError as error:
            if one.is_read:
                require_unsaturated(one.time, one.rates, one.name)
            raise error.about(one.name) from error

    def what_fits(self, model: Model) -> dict[str, str]:
        """Return what a recording fits that does not fit the model, and its option; empty where nothing is found."""
        for other, words, remedy in _others(model):
            try:
                fit = replace(self, is_brief=True).fit(other)
            except ValueError:
                continue
            if fit.is_explained:
                found = np.zeros(0)
                if other.physical:
                    found, _ = fit.rotor_axis if other.pivot is model.pivot else fit.centre
                words = words.format(",".join(f"{x + 0.0:.4g}" for x in found.round(4)))
                return {"fits": f"; it fits with {words}", "remedy": remedy}
        return {}

    @property
    def said(self) -> list[InputWarning]:
        """What is wrong with the recordings."""
        return [warning.about(one.name) for one in self.given for warning in one.warnings]

    @property
    def names(self) -> str:
        """What the recordings are called."""
        return ", ".join(one.name for one in self.given)

    def no_motion(self, stretches: Sequence[Stretch], left_over: Array | None, model: Model) -> NoMotionError:
        """Return the error where no body moves as recorded."""
        where = ""
        if left_over is not None:
            time = np.concatenate([one.time for one in stretches])
            size = np.linalg.norm(left_over, axis=1)
            k = int(np.argmax(size))
            unit = "rad/s" if stretches[0].has_gyroscope else "rad"
            where = f", the largest residual, {size[k]:.3g} {unit}, is at t = {time[k]:.6g} s"
        what, advice = "this", ": a hand, an impact, or a loose part? Name"
        if len(self.given) > 1:
            what, advice = "all of these", "; fit each alone to see which is another body, or name"
        between = "the interval between release and catch" if model.is_free else "an interval without hands and impacts"
        words = {"how": model.words, "what": what, "where": where, "advice": advice, "between": between}
        return NoMotionError("no-rigid-body", self.names, **words)


SENTENCES["no-rigid-body"] = "no rigid body moves {how} like {what}{where}{advice} {between}: {option[interval]}" + FITS
SENTENCES["no-inertia"] = (
    "no body has the inertia implied by {names}: {why} by {outside:.3g} standard errors; check {given}, and that the "
    "interval is free of hands and impacts" + FITS
)
SENTENCES["attitudes-alone"] = (
    "attitudes alone do not show where free motion begins and ends: {option[interval]}, the interval between release "
    "and catch, or {option[interval='all']}, which uses every sample"
)


def _others(model: Model) -> Iterator[tuple[Model, str, str]]:
    """Yield models that are close to one, with words on what they fit, and the option that they need.

    In the words ``{}`` is for the direction that is found.
    """
    wheel, pivot = model.wheel, model.pivot
    if wheel is not None and wheel.axis is not None:
        yield replace(model, wheel=replace(wheel, axis=-wheel.axis)), "the rotor turning the other way: axis={}", ""
        yield replace(model, wheel=replace(wheel, axis=None)), "the axis of the rotor along {}: axis=fit", ""
    if pivot is not None and pivot.direction is not None:
        free = replace(model, pivot=replace(pivot, direction=None))
        yield free, "the centre of mass along {}, or opposite: mass and distance", ""
    if model.physical and not model.is_absolute:
        unphysical = "moments that no distribution of mass has: "
        yield replace(model, physical=False), unphysical, Option("physical=False")


def _beyond(model: Model) -> str:
    if not model.physical:
        return "its smallest moment would be negative"
    if model.weight:
        return "its second moments would fall short of those that mass and centre alone have"
    return "its largest moment would exceed the sum of the others"
