r"""A motion as it was recorded beside that of a model: unknowns, residuals and their derivatives, by shooting.

A gyroscope reads ``y_k = s W(t_k) + b + noise``, with further errors where they are asked for (`sensing`); attitudes
may be recorded as well, or alone (`orienting`). Unknown are J (five numbers, or six, `chart`), what the model has
beside it (`bodies`), b, s, the errors that are fitted, and the start of every lane, a part of a recording that is
integrated by itself: W, and about a pivot the direction γ of gravity. Residuals are divided by the standard deviation σ
of the noise; b and s have priors of mean 0 and 1, errors their own. Where a lane ends and the next one of the same
recording begins, the gap between the two states is a residual as well. The lengths of γ and of the direction of the
centre are held at 1 by a residual of large weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from .bodies import FREE_BODY, Model
from .orienting import gaps, gaps_by
from .sensing import PLAIN, Sensor
from .series import Kicks, responses
from .speeds import Speed

COMMON = 4  # bias and scale, which the errors of the gyroscope that are fitted follow
UNIT = 1e-6  # how closely directions have the length 1
CONSTRAINED = 1e4  # weight of a constraint on W, over that of a sample
Loss = Literal["linear", "soft_l1"]


@dataclass(frozen=True)
class Stretch:
    """A motion as it was recorded: times, s, angular velocities, rad/s, (n, 3), and the speed of a rotor.

    `quaternions` are its attitudes, (n, 4), nan where there is none. Without a gyroscope the rates follow from them,
    and are what a fit begins with only.
    """

    time: Array
    rates: Array
    speed: Speed | None = None
    quaternions: Array | None = None
    has_gyroscope: bool = True


@dataclass(frozen=True)
class Priors:
    """What is known of a gyroscope: standard deviations of bias, rad/s, and scale, and its other errors."""

    bias: float
    scale: float
    sensor: Sensor = PLAIN


@dataclass(frozen=True)
class Lane:
    """Samples `first` to `last` of a stretch; `joined` to the next lane, which is of the same stretch."""

    stretch: int
    first: int
    last: int
    joined: bool = False


@dataclass(frozen=True)
class Problem:
    """What is fitted: stretches, priors, the noise, rad/s, the loss, lanes, and the model."""

    stretches: Sequence[Stretch]
    priors: Priors
    noise: float
    loss: Loss
    lanes: Sequence[Lane]
    model: Model = FREE_BODY
    tilt: float = 0.0  # noise of attitudes, rad

    @cached_property
    def times(self) -> list[Array]:
        """Times of each lane from its start, with the start of the next one where that is joined."""
        found = []
        for lane in self.lanes:
            t = self.stretches[lane.stretch].time
            found.append(t[lane.first : lane.last + lane.joined] - t[lane.first])
        return found

    @property
    def common(self) -> int:
        """How many numbers of the gyroscope are fitted."""
        return COMMON + len(self.priors.sensor.free)

    @cached_property
    def data(self) -> Array:
        """All angular velocities, (n, 3), lane after lane."""
        return np.concatenate([self.stretches[one.stretch].rates[one.first : one.last] for one in self.lanes])

    @cached_property
    def read(self) -> NDArray[np.bool_]:
        """Which of these are readings of a gyroscope."""
        return np.concatenate(
            [np.full(one.last - one.first, self.stretches[one.stretch].has_gyroscope) for one in self.lanes]
        )

    @cached_property
    def attitudes(self) -> Array:
        """Recorded quaternions beside them, (n, 4), nan where there is none."""
        found = []
        for lane in self.lanes:
            own = self.stretches[lane.stretch].quaternions
            found.append(np.full((lane.last - lane.first, 4), np.nan) if own is None else own[lane.first : lane.last])
        return np.concatenate(found)

    @cached_property
    def turned(self) -> NDArray[np.bool_]:
        """Where there are attitudes."""
        return np.asarray(np.isfinite(self.attitudes).all(axis=1))

    @cached_property
    def gap(self) -> Array:
        """How large the gaps between lanes may be, of W, of γ and of the quaternion."""
        speed = max(float(np.sqrt((self.data**2).sum(axis=1).mean())), 1e-300)
        angle = self.noise / speed
        sizes = [self.noise] * 3 + [angle] * 3 * (self.model.pivot is not None) + [self.tilt / 2] * 4
        return np.array(sizes)[: self.model.size]

    @cached_property
    def unknown(self) -> int:
        """How many numbers the data determine, but for those of the gyroscope, which have priors."""
        free = self.model.size - len(self.model.directions)  # of a start: γ has two, an attitude three
        free -= self.model.constraint is not None
        return int(self.model.basis.shape[1]) + self.model.more - self.model.points + free * len(self.lanes)

    @cached_property
    def speed_columns(self) -> list[slice]:
        """Where the values at the knots of each stretch are among all of them."""
        counts = [0 if one.speed is None else len(one.speed.knots) for one in self.stretches]
        ends = np.cumsum(counts)
        return [slice(int(end - count), int(end)) for end, count in zip(ends, counts, strict=True)]

    def states(self, at: Unknowns) -> tuple[Array, list[Kicks] | None]:
        """Return the states at the starts of lanes, with the speed of a rotor and its kicks where there is one."""
        d, size = self.model.size, self.model.size + self.model.hidden
        if self.model.wheel is None:
            return np.concatenate([at.starts, np.zeros((len(at.starts), size - d))], axis=1), None
        starts, kicks = [], []
        for lane, start in zip(self.lanes, at.starts, strict=True):
            one, columns = self.stretches[lane.stretch], self.speed_columns[lane.stretch]
            last = one.time[min(lane.last, len(one.time) - 1)]
            values = at.speeds[columns]
            found = one.speed.kicks(one.time[lane.first], last, size, d, columns, len(at.speeds), values)  # type: ignore[union-attr]
            kicks.append(found)
            starts.append(np.concatenate([start, (found.start_by @ at.speeds)[d:]]))
        return np.array(starts), kicks

    def __len__(self) -> int:
        return 3 * int(self.read.sum() + self.turned.sum())


@dataclass(frozen=True)
class Unknowns:
    """Values of all that is fitted: J, bias, scale, starts, (lanes, d), what is beside J, speeds, and `sensing`."""

    inertia: Array
    bias: Array
    scale: float
    starts: Array
    more: Array = field(default_factory=lambda: np.zeros(0))
    speeds: Array = field(default_factory=lambda: np.zeros(0))
    errors: Array = field(default_factory=lambda: np.zeros(0))


def residuals(problem: Problem, at: Unknowns) -> tuple[Array, Array]:
    """Return the residuals over the noise, and derivatives: by J, `more`, bias, scale, errors, starts, speeds."""
    model, d, sensor = problem.model, problem.model.size, problem.priors.sensor
    begin, kicks = problem.states(at)
    counts, times = [lane.last - lane.first for lane in problem.lanes], problem.times
    if sensor.is_late:  # what is read has been earlier
        delay = sensor.whole(at.errors)[6]
        times = [np.concatenate([t, t[:n] - delay]) for t, n in zip(times, counts, strict=True)]
    motion = model.motion(at.inertia, at.more)
    values, derivatives = responses(motion, begin, times, kicks)
    body, size, common = 6 + model.more, begin.shape[1], problem.common
    spun = body + common + at.starts.size
    columns = spun + len(at.speeds)
    states = np.concatenate([v[:n, :d] for v, n in zip(values, counts, strict=True)])
    seen = np.concatenate([v[-n:] if sensor.is_late else v[:n] for v, n in zip(values, counts, strict=True)])
    rates = motion.rate(seen)[:, :3] if sensor.is_late else None
    y, by_W, by_errors = sensor.reads(seen[:, :3], rates, at.errors)
    r = [((problem.data - at.scale * y - at.bias) / problem.noise)[problem.read].ravel()]
    A = np.zeros((len(y), 3, columns))
    Q = np.zeros((len(y), 4 * model.oriented, columns))
    A[:, :, body : body + 3], A[:, :, body + 3] = -np.eye(3), -y
    A[:, :, body + COMMON : body + common] = -at.scale * by_errors
    row, more, of_W = 0, [], -at.scale * by_W
    for k, (v, D, lane, n) in enumerate(zip(values, derivatives, problem.lanes, counts, strict=True)):
        first = body + common + d * k
        own, W_by = slice(first, first + d), of_W @ (D[-n:] if sensor.is_late else D[:n])[:, :3]
        A[row : row + n, :, :body] = W_by[:, :, size : size + body]
        A[row : row + n, :, spun:] = W_by[:, :, size + body :]
        A[row : row + n, :, own] = W_by[:, :, :d]
        if model.oriented:
            Q[row : row + n, :, :body] = D[:n, d - 4 : d, size : size + body]
            Q[row : row + n, :, spun:] = D[:n, d - 4 : d, size + body :]
            Q[row : row + n, :, own] = D[:n, d - 4 : d, :d]
        row += n
        if lane.joined:
            gap = np.zeros((d, columns))
            gap[:, :body], gap[:, own] = D[n, :d, size : size + body], D[n, :d, :d]
            gap[:, spun:] = D[n, :d, size + body :]
            gap[:, own.stop : own.stop + d] = -np.eye(d)
            r.append((v[n, :d] - at.starts[k + 1]) / problem.gap)
            more.append(gap / problem.gap[:, None])
        for part in model.directions:
            _hold(r, more, columns, first + part.start, at.starts[k, part])
        if model.constraint is not None:
            r.append(np.array([model.constraint @ at.starts[k, :3]]) / problem.noise * CONSTRAINED)
            held = np.zeros((1, columns))
            held[0, first : first + 3] = model.constraint / problem.noise * CONSTRAINED
            more.append(held)
    if model.points:
        _hold(r, more, columns, 6, at.more[:3])
    if model.wheel is not None:
        for one, own in zip(problem.stretches, problem.speed_columns, strict=True):
            _read(r, more, columns, slice(spun + own.start, spun + own.stop), one.speed, at.speeds[own])  # type: ignore[arg-type]
        if model.has_factor:
            at_factor = 6 + 3 * model.points
            r.append(np.array([(model.factor(at.more) - 1) / model.wheel.error]))
            more.append(np.eye(1, columns, at_factor) / model.wheel.error)
    free = sensor.free
    deviations = np.array([problem.priors.bias] * 3 + [problem.priors.scale, *sensor.deviation[free]])
    prior = np.zeros((common, columns))
    prior[:, body : body + common] = np.diag(1 / deviations)
    r.append(np.concatenate([at.bias, [at.scale - 1], at.errors - sensor.mean[free]]) / deviations)
    data = [A[problem.read].reshape(-1, columns) / problem.noise]
    if model.oriented:
        there = problem.turned
        q = states[there, d - 4 :]
        gap = gaps(problem.attitudes[there], q)
        r.insert(1, gap.ravel() / problem.tilt)
        data.append(gaps_by(gap, q, Q[there]).reshape(-1, columns) / problem.tilt)
    return np.concatenate(r), np.concatenate([*data, *more, prior])


def _hold(r: list[Array], rows: list[Array], columns: int, first: int, direction: Array) -> None:
    """Add a residual that keeps a direction at the length 1."""
    row = np.zeros((1, columns))
    row[0, first : first + len(direction)] = direction / UNIT
    r.append(np.array([(direction @ direction - 1) / 2 / UNIT]))
    rows.append(row)


def _read(r: list[Array], rows: list[Array], columns: int, own: slice, speed: Speed, values: Array) -> None:
    """Add the readings of a speed as residuals over their noise."""
    hats = speed.at(speed.time) / speed.noise
    row = np.zeros((len(hats), columns))
    row[:, own] = -hats
    r.append(speed.readings / speed.noise - hats @ values)
    rows.append(row)
