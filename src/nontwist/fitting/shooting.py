r"""A motion as it was recorded beside that of a model: unknowns, residuals and their derivatives, by shooting.

Unknown are J (five numbers, or six), what the model has beside it (`bodies`), the errors of the gyroscope that are
fitted (`measuring`), the start of every lane, a part of a recording that is integrated by itself, and the speeds of a
rotor at its knots. A start is W, about a pivot the direction γ of gravity, and the attitude where that is recorded.
Residuals are divided by the standard deviation σ of the noise; errors of the gyroscope have priors. Where a lane ends
and the next one of the same recording begins, the gap between the two states is a residual as well. The lengths of γ,
of the quaternion, of the direction of the centre and of the axis of a rotor are held at 1 by a residual of large
weight.

**Noise** is told from a motion, which is smooth, by differences and polynomials; what a model leaves shows whether it
is white.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..machine import cached_property
from ..recordings.conventions import finite_rows
from .measuring import Gyroscope, Speed, gaps, triangle
from .predictions import Line, Motion, Track, responses
from .unknowns import Model, entries, symmetric

UNIT = 1e-6  # how closely directions have the length 1
CONSTRAINED = 1e4  # weight of a constraint on W, over that of a sample
FEWEST, LEAST_TURN, MOST_TURN = 12, 1.0, 1.5  # samples; rad over all; rad from sample to sample
TOP = 9  # steps by which readings fall, as far beyond equal ones at the top of a smooth rate as these extend
PLATEAU, EQUAL = 4, 0.1  # equal largest values in a row that are no chance; share of other equal ones in coarse data
WHITE = 5.0  # standard errors of a correlation that is none
STRAY = 8.0  # times the noise: no noise
WINDOW, TURN, DEGREE = 14, 1.5, 8  # samples and rad, at least, of a window; of the polynomial in it
MISFIT = 2.0  # residuals over the scatter of the samples: no noise leaves these
EXACT = 1e-4  # of the speed: residuals that need no noise
FINE = 1e-9  # rad: noise of attitudes at least
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


class Lane(NamedTuple):
    """Samples `first` to `last` of a stretch; `joined` to the next lane, which is of the same stretch."""

    stretch: int
    first: int
    last: int
    joined: bool = False


@dataclass(frozen=True)
class Unknowns:
    """Values of all that is fitted: J, what is beside it, the gyroscope's errors, starts, (lanes, d), and speeds."""

    inertia: Array
    more: Array
    gyroscope: Array
    starts: Array
    speeds: Array

    @cached_property
    def flat(self) -> Array:
        """All numbers, one after the other, as they are differentiated by."""
        return np.concatenate([entries(self.inertia), self.more, self.gyroscope, self.starts.ravel(), self.speeds])


@dataclass(frozen=True)
class Shooting:
    """What is fitted: stretches, the gyroscope, the noise, rad/s, the model, the loss, and lanes."""

    stretches: Sequence[Stretch]
    gyroscope: Gyroscope
    noise: float
    model: Model
    loss: Loss = "linear"
    lanes: Sequence[Lane] = ()
    tilt: float = 0.0  # noise of attitudes, rad

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
        sizes = [self.noise] * 3 + [self.noise / speed] * 3 * (self.model.pivot is not None) + [self.tilt / 2] * 4
        return np.array(sizes)[: self.model.size]

    @property
    def common(self) -> int:
        """How many numbers of the gyroscope are fitted."""
        return len(self.gyroscope.free)

    @cached_property
    def unknown(self) -> int:
        """How many numbers the data determine, but for those of the gyroscope, which have priors."""
        free = self.model.size - len(self.model.directions)  # of a start: γ has two, an attitude three
        free -= self.model.constraint is not None
        beside = self.model.more - len(self.model.directions_beside)
        return int(self.model.basis.shape[1]) + beside + free * len(self.lanes)

    @cached_property
    def ends(self) -> list[int]:
        """Where J, `more`, the gyroscope and the starts end among all unknowns, and the speeds of each stretch."""
        knots = [0 if one.speed is None else len(one.speed.knots) for one in self.stretches]
        counts = [6, self.model.more, self.common, self.model.size * len(self.lanes), *knots]
        return [int(end) for end in np.cumsum(counts)]

    @property
    def columns(self) -> int:
        """How many unknowns there are."""
        return self.ends[-1]

    def unknowns(self, x: Array) -> Unknowns:
        """Return the unknowns by all numbers, one after the other."""
        J, more, gyroscope, starts, speeds = np.split(x, self.ends[:4])
        return Unknowns(symmetric(J), more, gyroscope, starts.reshape(-1, self.model.size), speeds)

    def start_of(self, lane: int) -> slice:
        """Return which of the unknowns are the start of a lane."""
        first = self.ends[2] + self.model.size * lane
        return slice(first, first + self.model.size)

    def speeds_of(self, stretch: int) -> slice:
        """Return which of the unknowns are the speeds of a stretch."""
        return slice(*self.ends[3 + stretch : 5 + stretch])

    def line(self, x: Array, lane: Lane) -> Line | None:
        """Return the speed of a rotor in a lane."""
        one = self.stretches[lane.stretch]
        if one.speed is None:
            return None
        last = one.time[min(lane.last, len(one.time) - 1)]
        return one.speed.line(one.time[lane.first], last, x[self.speeds_of(lane.stretch)])

    def motions(self, at: Unknowns) -> list[tuple[Array, Array]]:
        """Return states and derivatives of each lane at its samples, and at the start of the next one if it is joined.

        Those at the samples less a delay follow, where there may be one.
        """
        tracks, delay = [], self.gyroscope.whole(at.gyroscope)[-1]
        for lane, start in zip(self.lanes, at.starts, strict=True):
            t = self.stretches[lane.stretch].time[lane.first : lane.last + lane.joined]
            t = t - t[0]
            if self.gyroscope.is_late:
                t = np.concatenate([t, t[: lane.last - lane.first] - delay])
            tracks.append(Track(start, t, self.line(at.flat, lane)))
        return responses(Motion(self.model, at.inertia, at.more), tracks)

    def __len__(self) -> int:
        attitudes = [one.quaternions for one in self.stretches if one.quaternions is not None]
        return 3 * (len(self.data) * self.has_gyroscope + sum(len(finite_rows(one)) for one in attitudes))


class Rows(NamedTuple):
    """Residuals over the noise, their derivatives by some of the unknowns, and which these are."""

    r: Array  # (n,)
    A: Array  # (n, k)
    columns: NDArray[np.intp]  # (k,)

    @property
    def reduced(self) -> Rows:
        """As few rows as there are columns, with the same products of columns and residuals: R of a QR product."""
        both = triangle(np.column_stack([self.A, self.r]))
        return Rows(both[:, -1], both[:, :-1], self.columns)


class Residuals(NamedTuple):
    """All residuals: of the gyroscope and of attitudes, lane after lane, and of what is known beside them."""

    rates: list[Rows]
    attitudes: list[Rows]
    beside: list[Rows]


def stacked(rows: Sequence[Rows], columns: int) -> tuple[Array, Array]:
    """Return the residuals of all rows, and their derivatives by all unknowns."""
    A, first = np.zeros((sum(len(row.r) for row in rows), columns)), 0
    for row in rows:
        A[first : first + len(row.r), row.columns] = row.A
        first += len(row.r)
    return np.concatenate([row.r for row in rows]), A


def residuals(problem: Shooting, at: Unknowns) -> Residuals:
    """Return the residuals, and their derivatives by the unknowns."""
    model, d, gyroscope, x = problem.model, problem.model.size, problem.gyroscope, at.flat
    every, (body, common), found = np.arange(problem.columns), problem.ends[1:3], Residuals([], [], [])
    motions, row = problem.motions(at), 0
    if problem.has_gyroscope:
        late, counts = gyroscope.is_late, [lane.last - lane.first for lane in problem.lanes]
        seen = [slice(-n, None) if late else slice(n) for n in counts]
        x_seen = np.concatenate([v[own] for (v, _), own in zip(motions, seen, strict=True)])
        rates = Motion(model, at.inertia, at.more).rate(x_seen) if late else None
        y, by_W, by_errors = gyroscope.reads(x_seen[:, :3], rates, at.gyroscope)
    for k, (lane, (v, D)) in enumerate(zip(problem.lanes, motions, strict=True)):
        stretch, n, start = problem.stretches[lane.stretch], lane.last - lane.first, problem.start_of(k)
        columns = np.concatenate([every[start], every[:body], every[problem.speeds_of(lane.stretch)]])
        if problem.has_gyroscope:
            own, row = slice(row, row + n), row + n
            A = np.empty((n, 3, len(columns) + problem.common))  # the largest of all: no copies
            np.matmul(by_W / -problem.noise, D[seen[k], :3], out=A[:, :, : len(columns)])
            A[:, :, len(columns) :] = by_errors[own] / -problem.noise
            r = (problem.data[own] - y[own]).ravel() / problem.noise
            found.rates.append(Rows(r, A.reshape(3 * n, -1), np.concatenate([columns, every[body:common]])))
        if stretch.quaternions is not None:
            recorded = stretch.quaternions[lane.first : lane.last]
            there = finite_rows(recorded)
            gap, A = gaps(recorded[there], v[there, d - 4 : d], D[there, d - 4 : d])
            found.attitudes.append(Rows(gap.ravel() / problem.tilt, A.reshape(gap.size, -1) / problem.tilt, columns))
        if lane.joined:
            A = np.concatenate([D[n, :d], -np.eye(d)], axis=1) / problem.gap[:, None]
            gap = (v[n, :d] - at.starts[k + 1]) / problem.gap
            found.beside.append(Rows(gap, A, np.concatenate([columns, every[problem.start_of(k + 1)]])))
        if model.constraint is not None:
            A = model.constraint[None] / problem.noise * CONSTRAINED
            found.beside.append(Rows(A @ at.starts[k, :3], A, every[start][:3]))
    for one in lengths(problem):
        length = (x[one] @ x[one] - 1) / 2
        found.beside.append(Rows(np.array([length]) / UNIT, x[None, one] / UNIT, every[one]))
    for k, stretch in enumerate(problem.stretches):
        if stretch.speed is not None:
            (hats, readings), own = stretch.speed.rows, problem.speeds_of(k)
            found.beside.append(Rows(readings - hats @ x[own], -hats, every[own]))
    if model.wheel is not None and "factor" in model.places:
        place = every[6 : problem.ends[1]][model.places["factor"]]
        found.beside.append(Rows((x[place] - 1) / model.wheel.error, np.eye(1) / model.wheel.error, place))
    mean, deviation = gyroscope.mean[gyroscope.free], gyroscope.deviation[gyroscope.free]
    found.beside.append(Rows((at.gyroscope - mean) / deviation, np.diag(1 / deviation), every[body:common]))
    return found


def lengths(problem: Shooting) -> list[slice]:
    """Return which of the unknowns have the length 1 together."""
    found = [slice(6 + one.start, 6 + one.stop) for one in problem.model.directions_beside]
    for k in range(len(problem.lanes)):
        first = problem.start_of(k).start
        found += [slice(first + one.start, first + one.stop) for one in problem.model.directions]
    return found


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
            f"{where}: the body turns by only {turned:.2g} rad in {np.ptp(time):.3g} s, too little to determine "
            "an inertia: turn it faster, throw it higher; or are rates in rad/s, or times in s?"
        )
    between = float(np.median(np.diff(time)) * speed.max())
    if between > MOST_TURN:
        raise ValueError(
            f"{where}: the body turns by up to {between:.3g} rad from one sample to the next, too coarse: record at "
            f"{speed.max() / 0.5:.3g} Hz or more, or turn it more slowly; or are rates in deg/s, or times in ms?"
        )


def require_unsaturated(time: Array, rates: Array, where: str) -> None:
    """Raise a ValueError where an axis has reached its largest reading.

    Readings in steps of g repeat at the top of a smooth rate as well, where this is within h ≤ g of its level. It is a
    parabola there: as far beyond the readings that repeat as these extend, it has fallen by 8 h at most, and what is
    read by another g of rounding. A rate that is cut off falls from there as steeply as it rose.
    """
    speed = np.linalg.norm(rates, axis=1)
    for axis, column in zip("xyz", rates.T, strict=True):
        apart = np.diff(np.unique(column))
        step = apart[apart > 1e-9 * speed.max()].min(initial=np.inf)
        for level in (column.max(), column.min()):
            at = np.flatnonzero(column == level)
            others = (np.diff(column) == 0) & (column[1:] != level)
            borders = np.flatnonzero(np.concatenate([[True], np.diff(at) != 1, [True]]))
            longest = int(np.argmax(np.diff(borders)))
            first, last = int(at[borders[longest]]), int(at[borders[longest + 1] - 1])
            beyond = np.clip([2 * first - last, 2 * last - first], 0, len(column) - 1)
            is_cut = abs(column[beyond] - level).max() > TOP * step
            is_long = last - first + 1 >= PLATEAU and others.mean() < EQUAL
            if is_cut and is_long and abs(level) > 0.5 * speed.max():
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
