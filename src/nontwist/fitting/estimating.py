r"""Weighted least squares by shooting: the inertia, what acts, the bias and scale of the gyroscope, and the starts.

A gyroscope reads ``y_k = s W(t_k) + b + noise``; attitudes may be recorded as well, or alone (`orienting`). Unknown
are J (five numbers, or six, `chart`), what the model has beside it (`bodies`), b, s and the start of every lane, a
part of a recording that is integrated by itself: W, and about a pivot the direction γ of gravity. Residuals are
divided by the standard deviation σ of the noise; b and s have priors of mean 0 and 1. Where a lane ends and the next
one of the same recording begins, the gap between the two states is a residual as well. The lengths of γ and of the
direction of the centre are held at 1 by a residual of large weight.

`estimate` goes in two stages: short lanes first, whose gaps may be as large as the noise (multiple shooting: it
converges from afar; several inertias are tried until one explains the recording), then one lane for each recording,
without gaps: the model. Where that fails, lanes are joined two by two, until one is left. Where something acts, the
first inertias are moved off the wall of flat bodies: there the derivative of the cost across the wall vanishes in the
chart, so that a fit that begins on it creeps along. σ follows from the residuals, and where it changes, the second
stage is repeated, since the priors weigh more or less then.

The information about J is that of the linear least-squares problem at the solution, in J itself along the basis of the
model, all else eliminated: ``I = F_JJ - F_Jn F_nn⁻¹ F_nJ``. Its
inverse is the covariance where every direction is told.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from .bodies import FREE_BODY, Model
from .chart import THINNEST, Chart, Weighed, of_a_body, of_trace_one
from .linear import ROUND, WIDTHS, Guess, pencil, turns, weak_form, with_moments
from .orienting import gaps, gaps_by
from .quality import WHITE, correlation
from .series import Kicks, RunawayError, responses
from .speeds import Speed, refined

LANE = 1.5  # rad, of the first stage
MOST_LANES = 40
COMMON = 4  # bias and scale
ROUNDS, SETTLED, CALLS = 4, 0.02, 40
HOPELESS = 0.05  # of the speed, and rad: residuals that no motion of the model leaves
HELD = 1e6  # weight of what is held
UNIT = 1e-6  # how closely directions have the length 1
CONSTRAINED = 1e4  # weight of a constraint on W, over that of a sample
FAR = 1e6  # residual of a motion that is none
FINE, ROUGH = 1e-8, 1e-4  # relative, of cost and unknowns: second and first stage
MOST_ENDS = 4  # starts from which the whole is fitted, where something acts
GOOD = 2.0  # mean square of the residuals over the noise: no other start is tried then
INSIDE = 0.03  # of tr J: second moments of a first inertia beside m c cᵀ at least
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


def as_counted(problem: Problem, r: Array) -> tuple[Array, Array]:
    """Return residuals whose squares add up to the loss, and their derivatives by the residuals.

    For soft_l1 these are ``sign(r) √(2 √(1 + r²) - 2)`` of the data; gaps and priors stay as they are.
    """
    counted, factor = r.copy(), np.ones_like(r)
    if problem.loss == "soft_l1":
        own = r[: len(problem)]
        root = np.sqrt(1 + own**2)
        counted[: len(problem)] = own * np.sqrt(2 / (1 + root))
        factor[: len(problem)] = np.sqrt((1 + root) / 2) / root
    return counted, factor


def without(A: Array, others: Array) -> Array:
    """Return columns without what others, at any scale, could take up."""
    scale = np.maximum(np.linalg.norm(others, axis=0), 1e-300)
    rest = np.linalg.qr(others / scale)[0]
    return np.asarray(A - rest @ (rest.T @ A))


@dataclass(frozen=True)
class Solution:
    """A least-squares solution: unknowns, cost, residuals over the noise and their derivatives as `residuals`."""

    problem: Problem
    unknowns: Unknowns
    cost: float
    residual: Array
    slope: Array

    @cached_property
    def left_over(self) -> Array:
        """What the model leaves of the angular velocities, rad/s, (n, 3)."""
        return self.residual[: 3 * int(self.problem.read.sum())].reshape(-1, 3) * self.problem.noise

    @cached_property
    def turned_by(self) -> Array:
        """What the model leaves of the attitudes, rad, (n, 3)."""
        return self.residual[3 * int(self.problem.read.sum()) : len(self.problem)].reshape(-1, 3) * self.problem.tilt

    @cached_property
    def states(self) -> list[Array]:
        """The states of each lane at its times."""
        begin, kicks = self.problem.states(self.unknowns)
        motion = self.problem.model.motion(self.unknowns.inertia, self.unknowns.more)
        return responses(motion, begin, self.problem.times, kicks)[0]

    @property
    def misses(self) -> Array:
        """What it leaves of the angular velocities, or of the attitudes where there is no gyroscope, (n, 3)."""
        return self.left_over if self.problem.read.any() else self.turned_by

    @cached_property
    def weighted(self) -> tuple[Array, Array]:
        """Residuals and derivatives, by J along the basis of the model first, weighted as the loss does."""
        A = np.concatenate([self.slope[:, :6] @ self.problem.model.basis, self.slope[:, 6:]], axis=1)
        r, factor = as_counted(self.problem, self.residual)
        return r, factor[:, None] * A

    @cached_property
    def apart(self) -> tuple[Array, Array]:
        """Residuals and derivatives by J, weighted, without what all else could take up."""
        (r, A), k = self.weighted, self.problem.model.basis.shape[1]
        both = without(np.concatenate([r[:, None], A[:, :k]], axis=1), A[:, k:])
        return both[:, 0], both[:, 1:]

    @cached_property
    def information(self) -> Array:
        """The information about J along the basis of the model, (5, 5) or (6, 6)."""
        own = self.apart[1]
        return np.asarray(own.T @ own)

    @cached_property
    def beside(self) -> Array:
        """Covariance of what the model has beside J, all else eliminated."""
        (_, A), k, count = self.weighted, self.problem.model.basis.shape[1], self.problem.model.more
        own = without(A[:, k : k + count], np.delete(A, slice(k, k + count), axis=1))
        size = np.maximum(np.linalg.norm(own, axis=0), 1e-300)
        return np.linalg.pinv((own / size).T @ (own / size), rcond=1e-14, hermitian=True) / np.outer(size, size)

    def surprise(self, information: Array) -> float:
        """Return the residuals over what is expected r.m.s., where J came from elsewhere with this information.

        With C its inverse, r has the covariance ``1 + A C Aᵀ``, and Woodbury's formula needs no C.
        """
        r, own = self.apart
        by = own.T @ r
        taken_up = float(by @ np.linalg.pinv(information + self.information, rcond=1e-12, hermitian=True) @ by)
        own_unknowns = self.problem.unknown - self.problem.model.basis.shape[1]
        return float(np.sqrt(max(float(r @ r) - taken_up, 0.0) / (len(self.problem) - own_unknowns)))

    @cached_property
    def newton(self) -> Array:
        """The step of J along the basis that Gauss and Newton would take from here if there were no wall."""
        r, A = self.weighted
        return np.asarray(-np.linalg.lstsq(A, r, rcond=1e-10)[0][: self.problem.model.basis.shape[1]])

    @property
    def spread(self) -> float:
        """The standard deviation of the noise by the residuals, rad/s; as assumed without a gyroscope."""
        return self._deviation(self.left_over) if self.left_over.size else self.problem.noise

    @property
    def tilt(self) -> float:
        """The same of the attitudes, rad; 0 without."""
        return self._deviation(self.turned_by) if self.turned_by.size else 0.0

    def _deviation(self, left: Array) -> float:
        """Return the standard deviation of what is left of one kind of data, which has its share of the unknowns."""
        if self.problem.loss != "linear":
            return float(np.median(abs(left)) / 0.6745)
        free = left.size * (1 - self.problem.unknown / len(self.problem))
        return float(np.sqrt((left**2).sum() / max(free, 1)))

    def of_trace_one(self) -> Solution:
        """Return the same solution in a unit in which tr J = 1."""
        factor = float(np.trace(self.unknowns.inertia))
        if not self.problem.model.is_absolute:
            return self
        model, more = self.problem.model.in_unit(self.unknowns.more, factor)
        unknowns = replace(self.unknowns, inertia=self.unknowns.inertia / factor, more=more)
        slope = self.slope.copy()
        slope[:, :6] *= factor
        slope[:, 6 + model.more - model.damping : 6 + model.more] *= factor
        return Solution(replace(self.problem, model=model), unknowns, self.cost, self.residual, slope)


def solve(
    problem: Problem,
    start: Unknowns,
    held: tuple[Any, float] | None = None,
    accuracy: float = FINE,
    calls: int = CALLS,
    fixed_inertia: bool = False,
) -> Solution:
    """Return the least-squares solution from a start.

    Parameters
    ----------
    problem : Problem
    start : Unknowns
    held : function and value, optional
        A function of J that returns a number and its derivative by the six entries: it is held at the value.
    accuracy : float
        Relative, of the cost and of the unknowns.
    calls : int
        Trials at most.
    fixed_inertia : bool
        All but the inertia is fitted.

    Raises
    ------
    RunawayError
        The start itself is no motion.
    """
    from scipy.optimize import least_squares

    model, count = problem.model, problem.model.more
    own = 0 if fixed_inertia else model.coordinates
    chart = _chart(model, start)
    # Where directions begin: numbers of any length, which count over their length, as a length that is held by its
    # weight alone makes the valley narrow and the way long.
    lengths = [slice(own, own + 3)] if model.points else []
    for k in range(len(problem.lanes)):
        begin = own + count + COMMON + model.size * k
        lengths += [slice(begin + part.start, begin + part.stop) for part in model.directions]
    last: dict[str, Any] = {}

    def unpacked(x: Array) -> tuple[Unknowns, Array]:
        """Return the unknowns, and the derivatives of J and `more` by the first numbers of x."""
        x = x.copy()
        for part in lengths:
            x[part] /= np.linalg.norm(x[part])
        more, rest = x[own : own + count], x[own + count :]
        J, slope = (start.inertia, np.zeros((6, count))) if fixed_inertia else chart(x[:own], more)
        slope = np.concatenate([slope, np.eye(count, own + count, own)])
        starts = rest[COMMON : COMMON + start.starts.size].reshape(-1, model.size)
        return Unknowns(J, rest[:3], float(rest[3]), starts, more, rest[COMMON + start.starts.size :]), slope

    def at(x: Array) -> dict[str, Any]:
        if not last or not np.array_equal(last["x"], x):
            unknowns, slope = unpacked(x)
            try:
                r, A = residuals(problem, unknowns)
            except RunawayError:
                if not last:
                    raise
                return {"r": np.full_like(last["r"], FAR), "B": last["B"]}
            r, factor = as_counted(problem, r)
            B = factor[:, None] * np.concatenate([A[:, : 6 + count] @ slope, A[:, 6 + count :]], axis=1)
            for part in lengths:
                size = np.linalg.norm(x[part])
                n = x[part] / size
                B[:, part] = (B[:, part] - np.outer(B[:, part] @ n, n)) / size
            if held is not None:
                value, by_entries = held[0](unknowns.inertia)
                r = np.append(r, (value - held[1]) * HELD)
                row = np.zeros((1, B.shape[1]))
                row[0, : own + count] = HELD * by_entries @ slope[:6]
                B = np.concatenate([B, row])
            last.update(x=x.copy(), r=r, B=B)
        return last

    x = np.concatenate([np.zeros(own), start.more, start.bias, [start.scale], start.starts.ravel(), start.speeds])
    # MINPACK's method needs no BLAS, whose threads take ten times as long on a busy machine.
    how = {"method": "lm", "x_scale": "jac", "max_nfev": calls, "ftol": accuracy, "xtol": accuracy}
    found = least_squares(lambda x: at(x)["r"], x, jac=lambda x: at(x)["B"], **how)
    unknowns, _ = unpacked(found.x)
    r, A = residuals(problem, unknowns)
    return Solution(problem, unknowns, float(found.cost), r, A)


def _chart(model: Model, start: Unknowns) -> Callable[[Array, Array], tuple[Array, Array]]:
    """Return J as a function of its own coordinates and of what is fitted beside it, with derivatives by both."""
    if not model.is_absolute:
        of_one = Chart.about(start.inertia)

        def ratios(z: Array, more: Array) -> tuple[Array, Array]:
            J, slope = of_one.inertia(z)
            return J, np.concatenate([slope, np.zeros((6, len(more)))], axis=1)

        return ratios
    weighed = Weighed.about(start.inertia, model.weight, model.direction(start.more))

    def absolute(z: Array, more: Array) -> tuple[Array, Array]:
        J, slope = weighed.inertia(z, model.direction(more))
        full = np.zeros((6, 6 + len(more)))
        full[:, :6] = slope[:, :6]
        if model.points:
            full[:, 6:9] = slope[:, 6:]
        return J, full

    return absolute


def nearest_body(model: Model, J: Array, more: Array, thinnest: float = THINNEST) -> Array:
    """Return the closest inertia that a body can have; where something acts, off the wall by a part of tr J."""
    return of_a_body(J, model.centred(more), thinnest) if model.is_absolute else of_trace_one(J)


def whole(stretches: Sequence[Stretch]) -> list[Lane]:
    """Return one lane for each stretch."""
    return [Lane(k, 0, len(one.time)) for k, one in enumerate(stretches)]


def short(stretches: Sequence[Stretch]) -> list[Lane]:
    """Return lanes in which the body turns by about `LANE`."""
    lanes = []
    turned = [float(np.linalg.norm(one.rates, axis=1).mean() * np.ptp(one.time)) for one in stretches]
    size = max(LANE, sum(turned) / MOST_LANES)
    for k, one in enumerate(stretches):
        count = int(np.clip(np.ceil(turned[k] / size), 1, max(1, len(one.time) // 6)))
        borders = np.linspace(0, len(one.time), count + 1).astype(int)
        lanes += [Lane(k, a, b, b < len(one.time)) for a, b in pairwise(borders)]
    return lanes


def begun(stretches: Sequence[Stretch], lanes: Sequence[Lane], downs: Sequence[Array] = ()) -> Array:
    """Return the states at the starts of lanes: W of a parabola through the first samples, γ by turns, the attitude."""
    found = []
    turned = [turns(one.time, one.rates) for one in stretches] if downs else []
    for lane in lanes:
        t, W = (a[lane.first : lane.last] for a in (stretches[lane.stretch].time, stretches[lane.stretch].rates))
        speed = max(float(np.linalg.norm(W, axis=1).mean()), 1e-300)
        count = int(np.clip((t - t[0] <= 0.5 / speed).sum(), min(6, len(t)), 30))
        degree = min(2, count - 1)
        start = np.polynomial.polynomial.polyfit(t[:count] - t[0], W[:count], degree)[0]
        down = [turned[lane.stretch][lane.first].T @ downs[lane.stretch]] if downs else []
        quaternions = stretches[lane.stretch].quaternions
        if quaternions is not None:  # the closest that there is
            there = np.flatnonzero(np.isfinite(quaternions).all(axis=1))
            down.append(quaternions[there[np.argmin(abs(there - lane.first))]])
        found.append(np.concatenate([start, *down]))
    return np.array(found)


def guesses(stretches: Sequence[Stretch], model: Model) -> list[Guess]:
    """Return values to start from, by all linear methods."""
    pairs = [(one.time, one.rates) for one in stretches]
    if not model.is_free:
        speeds = [None if one.speed is None else one.speed.at(one.time) @ one.speed.values for one in stretches]
        return [made for how in ROUND if (made := with_moments(pairs, model, *how, speeds)) is not None]
    found = [weak[0] for width in WIDTHS if (weak := weak_form(pairs, width)) is not None]
    energetic = pencil(pairs)
    found += [] if energetic is None else [energetic]
    return [Guess(model, J, np.zeros(0), []) for J in found or [np.diag([0.25, 0.33, 0.42])]]


def estimate(
    stretches: Sequence[Stretch],
    priors: Priors,
    noise: float,
    loss: Loss = "linear",
    known_noise: bool = False,
    starts: Sequence[Guess] | None = None,
    calls: int = CALLS,
    model: Model = FREE_BODY,
    tilt: float = 0.0,
) -> Solution:
    """Return the best solution from several starts, with the noise that its residuals have.

    Raises
    ------
    RunawayError
        No start leads to a motion.
    """
    lanes = short(stretches)
    speeds = np.concatenate([np.zeros(0), *(one.speed.values for one in stretches if one.speed is not None)])
    tried: list[Solution] = []
    for one in guesses(stretches, model) if starts is None else starts:
        first = Problem(stretches, priors, noise, loss, lanes, one.model, tilt)
        at = begun(stretches, lanes, one.downs)
        if one.model.constraint is not None:  # which steps keep, as it is linear
            at[:, :3] -= np.outer(at[:, :3] @ one.model.constraint, one.model.constraint)
        inertia = nearest_body(one.model, one.inertia, one.more, INSIDE) if model.is_absolute else one.inertia
        begin = Unknowns(inertia, np.zeros(3), 1.0, at, one.more, speeds)
        try:
            tried.append(solve(first, begin, accuracy=ROUGH, calls=20))
        except RunawayError:
            continue
        if explains(tried[-1]):
            break
    if not tried:
        raise RunawayError("no start leads to a motion")
    tried.sort(key=lambda one: one.cost)
    firsts = np.flatnonzero([lane.first == 0 for lane in lanes])
    ends: list[Solution] = []
    for from_there in tried[: 1 if model.is_free else MOST_ENDS]:
        second, best = replace(from_there.problem, lanes=whole(stretches)), from_there.unknowns
        ends.append(solve(second, replace(best, starts=best.starts[firsts]), calls=calls))
        if explains(from_there) and not explains(ends[-1]):
            ends.append(_merged(from_there, calls))
        if explains(ends[-1]):
            break
    found = min(ends, key=lambda one: one.cost)
    hopeless = is_hopeless(found)
    while not hopeless and (finer := _with_more_knots(found)) is not None:
        found = solve(*finer, accuracy=ROUGH, calls=calls)
    return (found if known_noise or hopeless else _with_its_noise(found, calls)).of_trace_one()


def explains(solution: Solution) -> bool:
    """Return whether a solution leaves about the noise."""
    return 2 * solution.cost < GOOD * len(solution.problem)


def _merged(found: Solution, calls: int) -> Solution:
    """Return the solution for whole recordings by lanes that are joined two by two, each time from the one before."""
    while any(one.joined for one in found.problem.lanes):
        kept, lanes = list[int](), list[Lane]()
        for k, lane in enumerate(found.problem.lanes):
            if lanes and lanes[-1].joined and k == kept[-1] + 1:
                lanes[-1] = replace(lanes[-1], last=lane.last, joined=lane.joined)
            else:
                kept.append(k)
                lanes.append(lane)
        begin = replace(found.unknowns, starts=found.unknowns.starts[kept])
        found = solve(replace(found.problem, lanes=lanes), begin, calls=calls)
    return found


def is_hopeless(found: Solution) -> bool:
    """Return whether the residuals are such as no motion of the model leaves."""
    speed = float(np.sqrt((found.problem.data**2).sum(axis=1).mean()))
    return any(
        len(left) > 0 and float(np.sqrt((left**2).mean())) > HOPELESS * size
        for left, size in ((found.left_over, speed), (found.turned_by, 1.0))
    )


def _with_its_noise(found: Solution, calls: int) -> Solution:
    """Return a solution whose noise is that of its residuals."""
    for _ in range(ROUNDS):
        spread, tilt = max(found.spread, 1e-12), max(found.tilt, 1e-12)
        change = max(abs(spread / found.problem.noise - 1), abs(tilt / max(found.problem.tilt, 1e-12) - 1))
        found = solve(replace(found.problem, noise=spread, tilt=tilt), found.unknowns, calls=calls)
        if change < SETTLED:
            break
    return found


def _with_more_knots(found: Solution) -> tuple[Problem, Unknowns] | None:
    """Return a problem with more knots of the speed of a rotor; None where the residuals do not ask for them."""
    row, stretches, speeds = 0, [], []
    for one, own in zip(found.problem.stretches, found.problem.speed_columns, strict=True):
        left_over = found.misses[row : row + len(one.time)]
        row += len(one.time)
        white = abs(correlation(left_over)) < WHITE / np.sqrt(left_over.size)
        finer = None if white or one.speed is None else refined(one.speed)
        stretches.append(one if finer is None else replace(one, speed=finer))
        values = found.unknowns.speeds[own]
        speeds.append(values if finer is None else one.speed.at(finer.knots) @ values)  # type: ignore[union-attr]
    if all(new is old for new, old in zip(stretches, found.problem.stretches, strict=True)):
        return None
    return replace(found.problem, stretches=stretches), replace(found.unknowns, speeds=np.concatenate(speeds))
