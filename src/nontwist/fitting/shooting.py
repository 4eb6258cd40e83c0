r"""A motion as it was recorded beside that of a model: unknowns, residuals and their derivatives, by shooting.

A gyroscope reads ``y_k = s W(t_k) + b + noise``; attitudes may be recorded as well, or alone (`orienting`). Unknown
are J (five numbers, or six, `chart`), what the model has beside it (`bodies`), b, s and the start of every lane, a
part of a recording that is integrated by itself: W, and about a pivot the direction γ of gravity. Residuals are
divided by the standard deviation σ of the noise; b and s have priors of mean 0 and 1. Where a lane ends and the next
one of the same recording begins, the gap between the two states is a residual as well. The lengths of γ and of the
direction of the centre are held at 1 by a residual of large weight.
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
from .series import Kicks, responses
from .speeds import Speed

COMMON = 4  # bias and scale
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
    """Standard deviations of the bias, rad/s, and of the scale before anything is recorded."""

    bias: float
    scale: float


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
        """How many numbers the data determine, but for bias and scale, which have priors."""
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
    """Values of all that is fitted: J, bias, scale, starts, (lanes, 3 or 6), what is beside J, and speeds at knots."""

    inertia: Array
    bias: Array
    scale: float
    starts: Array
    more: Array = field(default_factory=lambda: np.zeros(0))
    speeds: Array = field(default_factory=lambda: np.zeros(0))


def residuals(problem: Problem, at: Unknowns) -> tuple[Array, Array]:
    """Return the residuals over the noise, and their derivatives: by J, `more`, bias, scale, starts, speeds."""
    model, d = problem.model, problem.model.size
    begin, kicks = problem.states(at)
    values, derivatives = responses(model.motion(at.inertia, at.more), begin, problem.times, kicks)
    body, size = 6 + model.more, begin.shape[1]
    spun = body + COMMON + at.starts.size
    columns = spun + len(at.speeds)
    states = np.concatenate([v[: len(v) - one.joined, :d] for v, one in zip(values, problem.lanes, strict=True)])
    W = states[:, :3]
    r = [((problem.data - at.scale * W - at.bias) / problem.noise)[problem.read].ravel()]
    A = np.zeros((len(W), 3, columns))
    Q = np.zeros((len(W), 4 * model.oriented, columns))
    A[:, :, body : body + 3], A[:, :, body + 3] = -np.eye(3), -W
    row, more = 0, []
    for k, (v, D, lane) in enumerate(zip(values, derivatives, problem.lanes, strict=True)):
        n, first = len(v) - lane.joined, body + COMMON + d * k
        own = slice(first, first + d)
        A[row : row + n, :, :body] = -at.scale * D[:n, :3, size : size + body]
        A[row : row + n, :, spun:] = -at.scale * D[:n, :3, size + body :]
        A[row : row + n, :, own] = -at.scale * D[:n, :3, :d]
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
    prior = np.zeros((COMMON, columns))
    prior[:, body : body + COMMON] = np.diag([1 / problem.priors.bias] * 3 + [1 / problem.priors.scale])
    r.append(np.append(at.bias / problem.priors.bias, (at.scale - 1) / problem.priors.scale))
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
