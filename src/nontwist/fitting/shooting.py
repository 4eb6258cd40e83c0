r"""A motion as it was recorded beside that of a model: unknowns, residuals and their derivatives, by shooting.

A gyroscope reads ``y_k = s W(t_k) + b + noise``, with further errors where they are asked for (`sensing`); attitudes
may be recorded as well, or alone (`orienting`). Unknown are J (five numbers, or six, `chart`), what the model has
beside it (`bodies`), b, s, the errors that are fitted, and the start of every lane, a part of a recording that is
integrated by itself: W, and about a pivot the direction γ of gravity. Residuals are divided by the standard deviation σ
of the noise; b and s have priors of mean 0 and 1, errors their own. Where a lane ends and the next one of the same
recording begins, the gap between the two states is a residual as well. The lengths of γ, of the direction of the
centre and of the axis of a rotor are held at 1 by a residual of large weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from .bodies import FREE_BODY, Model
from .motions import Kicks, Motion, responses
from .orienting import finite_rows, gaps, gaps_by
from .sensing import PLAIN, Sensor
from .speeds import Speed, triangle

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
class Shooting:
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
        """All angular velocities, (n, 3), one recording after the other, as lanes are."""
        return np.concatenate([one.rates for one in self.stretches])

    @property
    def has_gyroscope(self) -> bool:
        """Whether these are readings of a gyroscope, in all recordings or in none."""
        return self.stretches[0].has_gyroscope

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
        beside = self.model.more - len(self.model.directions_beside)
        return int(self.model.basis.shape[1]) + beside + free * len(self.lanes)

    @cached_property
    def speed_columns(self) -> list[slice]:
        """Where the values at the knots of each stretch are among all of them."""
        counts = [0 if one.speed is None else len(one.speed.knots) for one in self.stretches]
        ends = np.cumsum(counts)
        return [slice(int(end - count), int(end)) for end, count in zip(ends, counts, strict=True)]

    def states(self, at: Unknowns) -> tuple[Array, list[Kicks] | None]:
        """Return the states at the starts of lanes, with the speed of a rotor and its kicks where there is one."""
        if self.model.wheel is None:
            return at.starts, None
        kicks, begin = [], []
        for lane in self.lanes:
            one = self.stretches[lane.stretch]
            assert one.speed is not None
            values, last = at.speeds[self.speed_columns[lane.stretch]], one.time[min(lane.last, len(one.time) - 1)]
            kicks.append(one.speed.kicks(one.time[lane.first], last, values))
            begin.append(kicks[-1].start_by @ values)
        return np.concatenate([at.starts, begin], axis=1), kicks

    @property
    def columns(self) -> int:
        """How many derivatives there are: by J, `more`, the gyroscope, starts and speeds."""
        return 6 + self.model.more + self.common + self.model.size * len(self.lanes) + int(self.speed_columns[-1].stop)

    def __len__(self) -> int:
        attitudes = [one.quaternions for one in self.stretches if one.quaternions is not None]
        return 3 * (len(self.data) * self.has_gyroscope + sum(len(finite_rows(one)) for one in attitudes))


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


class Rows(NamedTuple):
    """Residuals over the noise, their derivatives by some of the unknowns, and which these are."""

    r: Array  # (n,)
    A: Array  # (n, k)
    columns: NDArray[np.intp]  # (k,)


class Residuals(NamedTuple):
    """All residuals: of the gyroscope and of attitudes, lane after lane, and of what is known beside them."""

    rates: list[Rows]
    attitudes: list[Rows]
    beside: list[Rows]

    @property
    def rows(self) -> list[Rows]:
        """All of them."""
        return [*self.rates, *self.attitudes, *self.beside]


def stacked(rows: Sequence[Rows], columns: int) -> tuple[Array, Array]:
    """Return the residuals of all rows, and their derivatives by all unknowns."""
    A, first = np.zeros((sum(len(row.r) for row in rows), columns)), 0
    for row in rows:
        A[first : first + len(row.r), row.columns] = row.A
        first += len(row.r)
    return np.concatenate([row.r for row in rows]), A


def reduced(row: Rows) -> Rows:
    """Return as few rows as there are columns, with the same products of columns and residuals: R of a QR product."""
    both = triangle(np.column_stack([row.A, row.r]))
    return Rows(both[:, -1], both[:, :-1], row.columns)


def residuals(problem: Shooting, at: Unknowns) -> Residuals:
    """Return the residuals, and their derivatives: by J, `more`, bias, scale, errors, starts, speeds."""
    model, d, sensor = problem.model, problem.model.size, problem.priors.sensor
    begin, kicks = problem.states(at)
    times = problem.times
    if sensor.is_late:  # what is read has been earlier
        delay = sensor.whole(at.errors)[6]
        times = [
            np.concatenate([t, t[: len(t) - one.joined] - delay]) for t, one in zip(times, problem.lanes, strict=True)
        ]
    motion = Motion(model, at.inertia, at.more)
    values, derivatives = responses(motion, begin, times, kicks)
    body, size, common = 6 + model.more, begin.shape[1], problem.common
    spun = body + common + at.starts.size
    found = Residuals([], [], [])
    for k, (v, D, lane) in enumerate(zip(values, derivatives, problem.lanes, strict=True)):
        stretch, n, start = problem.stretches[lane.stretch], lane.last - lane.first, body + common + d * k
        own, speeds = np.arange(start, start + d), spun + np.arange(at.speeds.size)[problem.speed_columns[lane.stretch]]
        D = np.concatenate([D[:, :d, size : size + body], D[:, :d, :d], D[:, :d, size + body :]], axis=2)
        columns = np.concatenate([np.arange(body), own, speeds])
        if stretch.has_gyroscope:
            seen = slice(-n, None) if sensor.is_late else slice(n)
            W, rates = v[seen, :3], motion.rate(v[seen]) if sensor.is_late else None
            y, by_W, by_errors = sensor.reads(W, rates, at.errors)
            by = [np.broadcast_to(-np.eye(3), (n, 3, 3)), -y[:, :, None], -at.scale * by_errors]
            A = np.concatenate([-at.scale * by_W @ D[seen, :3], *by], axis=2) / problem.noise
            r = (stretch.rates[lane.first : lane.last] - at.scale * y - at.bias) / problem.noise
            all_columns = np.concatenate([columns, np.arange(body, body + common)])
            found.rates.append(Rows(r.ravel(), A.reshape(3 * n, -1), all_columns))
        if model.oriented:
            assert stretch.quaternions is not None
            recorded = stretch.quaternions[lane.first : lane.last]
            there = finite_rows(recorded)
            q, Q = v[there, d - 4 : d], D[there, d - 4 :]
            gap = gaps(recorded[there], q)
            A = gaps_by(gap, q, Q).reshape(-1, len(columns))
            found.attitudes.append(Rows(gap.ravel() / problem.tilt, A / problem.tilt, columns))
        if lane.joined:
            A = np.concatenate([D[n], -np.eye(d)], axis=1) / problem.gap[:, None]
            gap = (v[n, :d] - at.starts[k + 1]) / problem.gap
            found.beside.append(Rows(gap, A, np.concatenate([columns, own + d])))
        found.beside.extend(_of_length_one(at.starts[k, part], own[part]) for part in model.directions)
        if model.constraint is not None:
            A = model.constraint[None] / problem.noise * CONSTRAINED
            found.beside.append(Rows(A @ at.starts[k, :3], A, own[:3]))
    found.beside.extend(_of_length_one(at.more[one], 6 + np.arange(model.more)[one]) for one in model.directions_beside)
    if model.wheel is not None:
        for stretch, part in zip(problem.stretches, problem.speed_columns, strict=True):
            assert stretch.speed is not None
            hats, readings = stretch.speed.rows
            found.beside.append(Rows(readings - hats @ at.speeds[part], -hats, spun + np.arange(at.speeds.size)[part]))
        if model.has_factor:
            r, A = np.array([model.factor(at.more) - 1]), np.ones((1, 1))
            place = np.array([6 + 3 * len(model.directions_beside)])
            found.beside.append(Rows(r / model.wheel.error, A / model.wheel.error, place))
    free = sensor.free
    deviations = np.array([problem.priors.bias] * 3 + [problem.priors.scale, *sensor.deviation[free]])
    r = np.concatenate([at.bias, [at.scale - 1], at.errors - sensor.mean[free]]) / deviations
    found.beside.append(Rows(r, np.diag(1 / deviations), np.arange(body, body + common)))
    return found


def _of_length_one(direction: Array, columns: NDArray[np.intp]) -> Rows:
    """Return a residual that keeps a direction at the length 1."""
    return Rows(np.array([(direction @ direction - 1) / 2 / UNIT]), direction[None] / UNIT, columns)
