r"""A motion as it was recorded beside that of a model: unknowns, residuals and their derivatives, by shooting.

Unknown are J (five numbers, or six), what the model has beside it (`bodies`), the errors of the gyroscope that are
fitted (`measuring`), the start of every lane, a part of a recording that is integrated by itself, and the speeds of a
rotor at its knots. A start is W, about a pivot the direction γ of gravity, and the attitude where that is recorded.
Residuals are divided by the standard deviation σ of the noise; errors of the gyroscope have priors. Where a lane ends
and the next one of the same recording begins, the gap between the two states is a residual as well. The lengths of γ,
of the quaternion, of the direction of the centre and of the axis of a rotor are held at 1 by a residual of large
weight.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from .bodies import FREE_BODY, Model, entries, symmetric
from .measuring import Gyroscope, Speed, finite_rows, gaps, triangle
from .motions import Line, Motion, response

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
    """What is fitted: stretches, the gyroscope, the noise, rad/s, the loss, lanes, and the model."""

    stretches: Sequence[Stretch]
    gyroscope: Gyroscope
    noise: float
    loss: Loss = "linear"
    lanes: Sequence[Lane] = ()
    model: Model = FREE_BODY
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

    def motions(self, at: Unknowns) -> Iterator[tuple[Array, Array]]:
        """Yield states and derivatives of each lane at its samples, and at the start of the next one if it is joined.

        Those at the samples less a delay follow, where there may be one.
        """
        motion, delay = Motion(self.model, at.inertia, at.more), self.gyroscope.whole(at.gyroscope)[-1]
        for lane, start in zip(self.lanes, at.starts, strict=True):
            t = self.stretches[lane.stretch].time[lane.first : lane.last + lane.joined]
            t = t - t[0]
            if self.gyroscope.is_late:
                t = np.concatenate([t, t[: lane.last - lane.first] - delay])
            yield response(motion, start, t, self.line(at.flat, lane))

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
    for k, (lane, (v, D)) in enumerate(zip(problem.lanes, problem.motions(at), strict=True)):
        stretch, n, start = problem.stretches[lane.stretch], lane.last - lane.first, problem.start_of(k)
        columns = np.concatenate([every[start], every[:body], every[problem.speeds_of(lane.stretch)]])
        if stretch.has_gyroscope:
            seen = slice(-n, None) if gyroscope.is_late else slice(n)
            late = Motion(model, at.inertia, at.more).rate(v[seen]) if gyroscope.is_late else None
            y, by_W, by_errors = gyroscope.reads(v[seen, :3], late, at.gyroscope)
            A = np.empty((n, 3, len(columns) + problem.common))  # the largest of all: no copies
            np.matmul(by_W / -problem.noise, D[seen, :3], out=A[:, :, : len(columns)])
            A[:, :, len(columns) :] = by_errors / -problem.noise
            r = (stretch.rates[lane.first : lane.last] - y).ravel() / problem.noise
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
    mean, deviation = (one[gyroscope.free] for one in gyroscope)
    found.beside.append(Rows((at.gyroscope - mean) / deviation, np.diag(1 / deviation), every[body:common]))
    return found


def lengths(problem: Shooting) -> list[slice]:
    """Return which of the unknowns have the length 1 together."""
    found = [slice(6 + one.start, 6 + one.stop) for one in problem.model.directions_beside]
    for k in range(len(problem.lanes)):
        first = problem.start_of(k).start
        found += [slice(first + one.start, first + one.stop) for one in problem.model.directions]
    return found
