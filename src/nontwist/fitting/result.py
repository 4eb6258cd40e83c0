"""What a fit returns: `Fit`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.arrays import Array, Axes
from ..geometry.attitudes import ENTRIES
from ..geometry.values import as_whole
from ..machine import cached_property
from . import reports
from .estimating import whole
from .measuring import BIAS, PLACES, SCALE
from .shooting import EXACT, MISFIT, correlation, new_of, scatter_of, scatter_of_attitudes
from .solving import Solution, solve
from .telling import UNTOLD, Direction, Principal, Told, covariance, directions, principal, quantile, told

TOLD = 0.5  # of what was known of an error of the gyroscope: a fit that leaves more does not tell it


if TYPE_CHECKING:
    from ..driver.problem import Problem


@dataclass(frozen=True)
class Part:
    """The interval of one recording that was fitted.

    Attributes
    ----------
    name : str
    time : (n,) array, s
    measured, model : (n, 3) array, rad/s
        What the gyroscope read, and what it would have read without noise.
    start : (3,) array, rad/s
        Angular velocity at the first time.
    down : (3,) array
        Direction of gravity in body components at the first time; empty without a pivot.
    interval : str
        How the interval was found.
    left_out : int
        Rows of the recording that could not be used.
    notes : tuple of str
        What was taken for what.
    speed : pair of (k,) arrays, s and rad/s
        Speed of the rotor, linear between these times; None without a rotor.
    quaternions : (n, 4) array
        Recorded attitudes, nan where there is none; None where no orientation is fitted. Without a gyroscope
        `measured` follows from them.
    attitude : (4,) array
        That at the first time, as fitted; empty without.
    """

    name: str
    time: Array
    measured: Array
    model: Array
    start: Array
    down: Array
    interval: str
    left_out: int
    notes: tuple[str, ...]
    speed: tuple[Array, Array] | None = None
    quaternions: Array | None = None
    attitude: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, repr=False)
class Fit:
    """The inertia of a body as fitted to recordings of its motion, returned by `fit_inertia`.

    Free motion determines only ratios; the moments are then relative to their sum. About a pivot they are absolute, or
    lengths J/(m|c|); with a rotor they are absolute: see `unit`. A fit prints as a table.

    Attributes
    ----------
    parts : tuple of Part
        The intervals that were fitted.
    solution : Solution
        Details of the solution of the least-squares problem.
    read : tuple of str
        Problems found while reading the recordings.
    stated_noise : float, rad/s
        Noise of a sample as given by the caller; 0 if it is estimated from the residuals.

    Examples
    --------
    >>> from nontwist import fit_inertia, sensors, simulate, standard
    >>> run = simulate(standard([1, 2, 2.5]), t_end=1, material_angular_velocity=(3, 8, 1))
    >>> fit = fit_inertia(sensors.gyroscope(run, noise=1e-4, rate=200))
    >>> low, high = fit.principal.intervals[2]
    >>> bool(low < 2.5 / 5.5 < high)
    True
    >>> fit.identifiable[0].name
    'the directions of the principal axes 2 and 3 in their plane'
    """

    parts: tuple[Part, ...]
    solution: Solution
    read: tuple[str, ...] = ()
    stated_noise: float = 0.0

    @cached_property
    def told(self) -> Told:
        """The information about the inertia and its directions."""
        return told(self.solution)

    @property
    def unit(self) -> str:
        """Unit of the inertia: "kg m²"; "m" for J/(m|c|); "" for parts of the sum of the moments."""
        model = self.solution.problem.model
        return "kg m²" if model.has_scale else "m" if model.is_absolute else ""

    @property
    def size(self) -> float:
        """Sum of the principal moments in their unit; 1 where nothing gives a scale."""
        return self.solution.problem.model.unit

    @cached_property
    def identifiable(self) -> tuple[Direction, ...]:
        """Directions in which the inertia can change, the best determined first: five with trace 1, six with a scale.

        Each has a `name` in words, its `matrix`, its `standard_error` relative to the trace, and `is_told`: whether
        this error is below 0.05, so that the direction counts as determined.
        """
        return tuple(directions(self.solution, self.told))

    @property
    def untold(self) -> tuple[Direction, ...]:
        """The directions that the data do not determine."""
        return tuple(one for one in self.identifiable if not one.is_told)

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Problems of the recordings, and of what they determine."""
        return (*self.read, *map(str, reports.worth(self)))

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the entries of the inertia, in the order xx, yy, zz, yz, xz, xy, (6, 6).

        Singular if the trace is 1, and large along directions that the data do not determine.
        """
        return covariance(self.told) * self.size**2

    @cached_property
    def inertia(self) -> Array:
        """Convected inertia, (3, 3), in the axes of the gyroscope, in `unit`; nan where undetermined."""
        J = self.solution.unknowns.inertia * self.size
        errors = np.sqrt(self.covariance.diagonal()) / self.size
        for (i, j), error in zip(ENTRIES, errors, strict=True):
            if not error < UNTOLD:
                J[i, j] = J[j, i] = np.nan
        return J

    @cached_property
    def principal(self) -> Principal:
        """Principal moments in `unit`, ascending, axes and ratios, with 95 % intervals; nan where undetermined."""
        return principal(self.solution, covariance(self.told), self.size)

    @cached_property
    def centre(self) -> tuple[Array, float]:
        """Direction of the centre of mass from the pivot, (3,), and the half-width of its 95 % interval, rad.

        The half-width is 0 if the direction is given; both are nan without a pivot. A gyroscope does not determine the
        sign of a fitted direction: its largest component is taken as positive, but the opposite direction fits equally
        well.
        """
        model, more = self.solution.problem.model, self.solution.unknowns.more
        return self._direction("centre", model.pivot, model.direction(more))

    @cached_property
    def rotor_axis(self) -> tuple[Array, float]:
        """Axis of the rotor, (3,), and the half-width of its 95 % interval, rad.

        The half-width is 0 if the axis is given; both are nan without a rotor. The rotor turns about it by the right
        hand where its speed is positive.
        """
        model, more = self.solution.problem.model, self.solution.unknowns.more
        return self._direction("axis", model.wheel, model.axis(more))

    def _direction(self, name: str, of: Any, n: Array) -> tuple[Array, float]:
        """Return a direction beside J and the half-width of its interval; 0 where it is not fitted."""
        if of is None:
            return np.full(3, np.nan), np.nan
        if (place := self.solution.problem.model.places.get(name)) is None:
            return n, 0.0
        n = n / np.linalg.norm(n)
        across = np.eye(3) - np.outer(n, n)
        widest = float(np.linalg.eigvalsh(across @ self.solution.beside[place, place] @ across)[-1])
        return n, quantile(self.solution) * float(np.sqrt(widest))

    @cached_property
    def damping(self) -> tuple[Array, Array]:
        """Coefficients of the damping along the axes, (3,), and their 95 % intervals, (3, 2), in N m s.

        If nothing gives the scale, relative to the sum of the moments, s⁻¹, or to m|c|, m/s; 0 if no damping is fitted.
        """
        model = self.solution.problem.model
        C = model.damping_of(self.solution.unknowns.more) * self.size
        width = np.zeros(3)
        if model.damping:
            width[:] = quantile(self.solution) * np.sqrt(self.solution.beside.diagonal()[-model.damping :]) * self.size
        return C, np.stack([C - width, C + width], axis=1)

    @property
    def residual(self) -> Array:
        """Residuals of all recordings, one after the other, (n, 3): rad/s, or rad if only attitudes are fitted."""
        return self.solution.misses

    @property
    def has_gyroscope(self) -> bool:
        """Whether angular velocities are fitted, not attitudes alone."""
        return self.solution.problem.has_gyroscope

    @property
    def noise(self) -> float:
        """Standard deviation of the residuals: the noise of a sample, rad/s, or rad if only attitudes are fitted."""
        return self.solution.spread if self.has_gyroscope else self.solution.tilt

    @property
    def attitude_noise(self) -> float:
        """Standard deviation of the residuals of the attitudes about each axis, rad; nan if none are fitted."""
        return self.solution.tilt or np.nan

    @property
    def bias(self) -> Array:
        """Bias of the gyroscope, (3,), rad/s."""
        return self.solution.unknowns.gyroscope[BIAS]

    @property
    def scale(self) -> float:
        """Ratio of reading to angular velocity."""
        return float(self.solution.unknowns.gyroscope[SCALE])

    def _error(self, name: str) -> tuple[Array, Array]:
        """Return an error of the gyroscope and its 95 % intervals; nan where it is not told beyond what was known."""
        gyroscope = self.solution.problem.gyroscope
        width = np.zeros(len(gyroscope.mean))
        width[gyroscope.errors] = np.sqrt(self.solution.of_errors.diagonal())
        width[width > TOLD * gyroscope.deviation] = np.nan
        width *= quantile(self.solution)
        values, place = gyroscope.whole(self.solution.unknowns.gyroscope), PLACES[name]
        return values[place], np.stack([values - width, values + width], axis=1)[place]

    @property
    def delay(self) -> tuple[float, Array]:
        """Delay of the gyroscope, s, and its 95 % interval, (2,); the value itself where it is given.

        As for `misalignment` and `axis_scales`, the interval is nan if the recording adds nothing to the prior.
        """
        values, intervals = self._error("delay")
        return float(values[0]), intervals[0]

    @property
    def misalignment(self) -> tuple[Array, Array]:
        """Rotation vector from the axes of the body to those of the gyroscope, (3,), rad, and its 95 % intervals."""
        return self._error("misalignment")

    @property
    def axis_scales(self) -> tuple[Array, Array]:
        """Scales of the single axes, (3,), in addition to the common scale, and their 95 % intervals, (3, 2)."""
        return self._error("axis_scales")

    @property
    def effective_samples(self) -> float:
        """As how many residuals of white noise tell how large the noise is: fewer where it is slow.

        Intervals are nan below ten for each number of the inertia, where every other number that is fitted takes up
        one.
        """
        return self.solution.effective_samples

    @cached_property
    def correlation(self) -> float:
        """Correlation of neighbouring residuals; about 0 ± 1/√(3n) for white residuals.

        That of angular velocities or of attitudes, whichever is further from 0.
        """
        found = [(correlation(one), one.size) for one in (self.solution.left_over, self.solution.turned_by) if one.size]
        return max(found, key=lambda one: abs(one[0]) * np.sqrt(one[1]))[0]

    @property
    def is_white(self) -> bool:
        """Whether residuals are as likely under white noise as where a part of it is slow, or negligibly small."""
        return self.solution.slow_noise is None

    @cached_property
    def misfit(self) -> float:
        """Ratio of the residuals to the noise, r.m.s.: as given, or the scatter of samples about a smooth motion.

        About 1 where the model is right. Slow noise, of which a smooth motion takes up all but what is new at each
        sample, counts by that. Residuals below 0.01 % of the speed count as explained.
        """
        found = list[float]()
        if self.solution.problem.model.oriented:
            scatter = self._scatter(lambda part: scatter_of_attitudes(part.time, part.quaternions, part.measured))
            found.append(self.solution.tilt / max(scatter / new_of(self.solution.turned_by), EXACT))
        if self.has_gyroscope:
            scatter = self._scatter(lambda part: scatter_of(part.time, part.measured))
            least = max(scatter / new_of(self.solution.left_over), self.stated_noise)
            speed = np.sqrt(np.mean([(part.measured**2).sum(axis=1).mean() for part in self.parts]))
            found.append(self.noise / max(least, EXACT * float(speed)))
        return max(found)

    def _scatter(self, of: Callable[[Part], float]) -> float:
        """Return the scatter of samples about smooth motions, r.m.s. over the recordings."""
        squares = [of(part) ** 2 for part in self.parts]
        return float(np.sqrt(np.average(squares, weights=[len(part.time) for part in self.parts])))

    @property
    def is_explained(self) -> bool:
        """Whether noise and model explain the recordings; if not, neither values nor intervals can be trusted."""
        return self.misfit < MISFIT

    @cached_property
    def cross_validation(self) -> Array:
        """Residual of each recording with the inertia of the others, over the expected residual, r.m.s.

        Start, bias and scale are fitted to each recording itself. The expected residual contains the noise of the
        others and the effect of the error of their inertia on the prediction. About 1 if one body explains all
        recordings; empty for a single recording.
        """
        problem, at = self.solution.problem, self.solution.unknowns
        found = []
        for k in range(len(problem.stretches) if len(problem.stretches) > 1 else 0):
            own, speeds = problem.speeds_of(k), at.flat
            rest = [one for n, one in enumerate(problem.stretches) if n != k]
            others = replace(problem, stretches=rest, lanes=whole(rest))
            begin = replace(
                at, starts=np.delete(at.starts, k, axis=0), speeds=np.delete(speeds, own)[problem.ends[3] :]
            )
            of_rest = solve(others, begin)
            alone = replace(problem, stretches=problem.stretches[k : k + 1], lanes=whole(problem.stretches[k : k + 1]))
            begin = replace(at, starts=at.starts[k : k + 1], speeds=speeds[own], inertia=of_rest.unknowns.inertia)
            predicted = solve(alone, begin, fixed_inertia=True)
            found.append(predicted.surprise(of_rest.information) * problem.noise / of_rest.spread)
        return np.array(found)

    def table(self) -> dict[str, str]:
        """Return the results in words, as rows of a table."""
        return reports.rows(self)

    def numbers(self) -> dict[str, Any]:
        """Return the results as plain data, in rad, s, and the unit of the inertia."""
        return reports.numbers(self)

    def __repr__(self) -> str:
        rows = self.table()
        width = max(map(len, rows))
        return "\n".join(f"{name:{width}}  {text}" for name, text in rows.items())

    def plot(self, recording: int = 0) -> Axes:
        """Draw a recording with the model, the residuals, and the principal moments with their intervals.

        Parameters
        ----------
        recording : int
            Which of the recordings, from 0.

        Returns
        -------
        Axes
            The first of three. A notebook shows the figure, and `nontwist.plot.save` writes it.

        Raises
        ------
        ValueError
            There is no such recording.

        Examples
        --------
        >>> from nontwist import fit_inertia, sensors, simulate, standard
        >>> run = simulate(standard([1, 2, 2.5]), t_end=1, material_angular_velocity=(3, 8, 1))
        >>> fit = fit_inertia(sensors.gyroscope(run, noise=1e-4, rate=200))
        >>> len(fit.plot().figure.axes)
        3
        """
        return reports.drawn(self, as_whole(recording, "recording", 0, len(self.parts) - 1))

    def problem(self, recording: int = 0) -> Problem:
        """Return the motion that was fitted as a problem: the body, its start and its times.

        If nothing gives the scale, the trace is 1 kg m², or m|c| is 1 kg m. About a pivot the heading at the start is
        arbitrary.

        Parameters
        ----------
        recording : int
            Which of the recordings, from 0.

        Returns
        -------
        Problem
            `simulate` runs it; ``problem.write(path)`` writes it as a run file.

        Raises
        ------
        ValueError
            The data do not determine the whole inertia, or there is no such recording.

        Examples
        --------
        >>> from nontwist import fit_inertia, sensors, simulate, standard
        >>> run = simulate(standard([1, 2, 2.5]), t_end=1, material_angular_velocity=(3, 8, 1))
        >>> fit = fit_inertia(sensors.gyroscope(run, noise=1e-4, rate=200))
        >>> simulate(fit.problem()).material_angular_velocity.values[0].round(1)
        array([3., 8., 1.])
        """
        from ..runfile import RunFile

        part = self.parts[as_whole(recording, "recording", 0, len(self.parts) - 1)]
        if self.untold:
            told = f"it leaves open {self.untold[-1].name}"
            raise ValueError(f"the recording does not determine the whole inertia, which a problem needs: {told}")
        return RunFile.model_validate(reports.as_run(self, part)).problem
