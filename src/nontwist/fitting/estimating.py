r"""Weighted least squares by shooting: the inertia, the bias and scale of the gyroscope, and the starts.

A gyroscope reads ``y_k = s W(t_k) + b + noise``. Unknown are J (five numbers, `chart`), b, s and the start of every
lane, a part of a recording that is integrated by itself. Residuals are divided by the standard deviation σ of the
noise; b and s have priors of mean 0 and 1. Where a lane ends and the next one of the same recording begins, the gap
between the two states is a residual as well.

`estimate` goes in two stages: short lanes first, whose gaps may be as large as the noise (multiple shooting: it
converges from afar; several inertias are tried until one explains the recording), then one lane for each recording,
without gaps: the model. σ follows from the residuals, and where it changes, the second stage is repeated, since the
priors weigh more or less then.

The information about J is that of the linear least-squares problem at the solution, in J itself along `TRACELESS`, all
else eliminated: ``I = F_JJ - F_Jn F_nn⁻¹ F_nJ``. Its inverse is the covariance where every direction is told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from ..geometry.arrays import Array
from .bodies import free_body
from .chart import TRACELESS, Chart
from .linear import WIDTHS, pencil, weak_form
from .series import RunawayError, responses

LANE = 1.5  # rad, of the first stage
MOST_LANES = 40
COMMON = 4  # bias and scale
ROUNDS, SETTLED, CALLS = 4, 0.02, 40
HOPELESS = 0.05  # of the speed: residuals that no free motion leaves
HELD = 1e6  # weight of what is held
FAR = 1e6  # residual of a motion that is none
FINE, ROUGH = 1e-8, 1e-4  # relative, of cost and unknowns: second and first stage
GOOD = 2.0  # mean square of the residuals over the noise: no other start is tried then
Loss = Literal["linear", "soft_l1"]


@dataclass(frozen=True)
class Stretch:
    """Free motion as it was recorded: times, s, and angular velocities, rad/s, (n, 3)."""

    time: Array
    rates: Array


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
    """What is fitted: stretches, priors, the noise, rad/s, the loss, and lanes."""

    stretches: Sequence[Stretch]
    priors: Priors
    noise: float
    loss: Loss
    lanes: Sequence[Lane]

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

    def __len__(self) -> int:
        return self.data.size


@dataclass(frozen=True)
class Unknowns:
    """Values of all that is fitted."""

    inertia: Array
    bias: Array
    scale: float
    starts: Array  # (lanes, 3)


def residuals(problem: Problem, at: Unknowns) -> tuple[Array, Array]:
    """Return the residuals over the noise, and their derivatives by the entries of J, bias, scale and starts."""
    values, derivatives = responses(free_body(at.inertia), at.starts, problem.times)
    columns = 6 + COMMON + at.starts.size
    W = np.concatenate([v[: len(v) - one.joined] for v, one in zip(values, problem.lanes, strict=True)])
    r = [((problem.data - at.scale * W - at.bias) / problem.noise).ravel()]
    A = np.zeros((len(W), 3, columns))
    A[:, :, 6:9], A[:, :, 9] = -np.eye(3), -W
    row, gaps = 0, []
    for k, (v, D, lane) in enumerate(zip(values, derivatives, problem.lanes, strict=True)):
        n, own = len(v) - lane.joined, slice(6 + COMMON + 3 * k, 9 + COMMON + 3 * k)
        A[row : row + n, :, :6] = -at.scale * D[:n, :, 3:]
        A[row : row + n, :, own] = -at.scale * D[:n, :, :3]
        row += n
        if lane.joined:
            gap = np.zeros((3, columns))
            gap[:, :6], gap[:, own] = D[n, :, 3:], D[n, :, :3]
            gap[:, own.stop : own.stop + 3] = -np.eye(3)
            r.append((v[n] - at.starts[k + 1]) / problem.noise)
            gaps.append(gap / problem.noise)
    prior = np.zeros((COMMON, columns))
    prior[:, 6 : 6 + COMMON] = np.diag([1 / problem.priors.bias] * 3 + [1 / problem.priors.scale])
    r.append(np.append(at.bias / problem.priors.bias, (at.scale - 1) / problem.priors.scale))
    return np.concatenate(r), np.concatenate([A.reshape(-1, columns) / problem.noise, *gaps, prior])


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
        """What the model leaves of the data, rad/s, (n, 3)."""
        return self.residual[: len(self.problem)].reshape(-1, 3) * self.problem.noise

    @cached_property
    def weighted(self) -> tuple[Array, Array]:
        """Residuals and derivatives, by J along `TRACELESS` first, weighted as the loss does."""
        A = np.concatenate([self.slope[:, :6] @ TRACELESS, self.slope[:, 6:]], axis=1)
        r, factor = as_counted(self.problem, self.residual)
        return r, factor[:, None] * A

    @cached_property
    def apart(self) -> tuple[Array, Array]:
        """Residuals and derivatives by J along `TRACELESS`, weighted, without what all else could take up."""
        r, A = self.weighted
        scale = np.maximum(np.linalg.norm(A[:, 5:], axis=0), 1e-300)
        rest = np.linalg.qr(A[:, 5:] / scale)[0]
        return r - rest @ (rest.T @ r), A[:, :5] - rest @ (rest.T @ A[:, :5])

    @cached_property
    def information(self) -> Array:
        """The information about J along `TRACELESS`, (5, 5)."""
        own = self.apart[1]
        return np.asarray(own.T @ own)

    def surprise(self, information: Array) -> float:
        """Return the residuals over what is expected r.m.s., where J came from elsewhere with this information.

        With C its inverse, r has the covariance ``1 + A C Aᵀ``, and Woodbury's formula needs no C.
        """
        r, own = self.apart
        by = own.T @ r
        taken_up = float(by @ np.linalg.pinv(information + self.information, rcond=1e-12, hermitian=True) @ by)
        return float(np.sqrt(max(float(r @ r) - taken_up, 0.0) / (len(self.problem) - self.unknowns.starts.size)))

    @cached_property
    def newton(self) -> Array:
        """The step along `TRACELESS` that Gauss and Newton would take from here if there were no wall, (5,)."""
        r, A = self.weighted
        return np.asarray(-np.linalg.lstsq(A, r, rcond=1e-10)[0][:5])

    @property
    def spread(self) -> float:
        """The standard deviation of the noise by the residuals, rad/s."""
        if self.problem.loss != "linear":
            return float(np.median(abs(self.left_over)) / 0.6745)
        free = self.left_over.size - 5 - self.unknowns.starts.size
        return float(np.sqrt((self.left_over**2).sum() / max(free, 1)))


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

    chart, own = Chart.about(start.inertia), 0 if fixed_inertia else 5
    last: dict[str, Any] = {}

    def unpacked(x: Array) -> tuple[Unknowns, Array]:
        J, slope = (start.inertia, np.zeros((6, 0))) if fixed_inertia else chart.inertia(x[:5])
        return Unknowns(J, x[own : own + 3], float(x[own + 3]), x[own + 4 :].reshape(-1, 3)), slope

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
            B = factor[:, None] * np.concatenate([A[:, :6] @ slope, A[:, 6:]], axis=1)
            if held is not None:
                value, by_entries = held[0](unknowns.inertia)
                r = np.append(r, (value - held[1]) * HELD)
                B = np.concatenate([B, np.append(HELD * by_entries @ slope, np.zeros(A.shape[1] - 6))[None]])
            last.update(x=x.copy(), r=r, B=B)
        return last

    x = np.concatenate([np.zeros(own), start.bias, [start.scale], start.starts.ravel()])
    # MINPACK's method needs no BLAS, whose threads take ten times as long on a busy machine.
    how = {"method": "lm", "x_scale": "jac", "max_nfev": calls, "ftol": accuracy, "xtol": accuracy}
    found = least_squares(lambda x: at(x)["r"], x, jac=lambda x: at(x)["B"], **how)
    unknowns, _ = unpacked(found.x)
    r, A = residuals(problem, unknowns)
    return Solution(problem, unknowns, float(found.cost), r, A)


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


def begun(stretches: Sequence[Stretch], lanes: Sequence[Lane]) -> Array:
    """Return the angular velocities at the starts of lanes: of a parabola through the first samples."""
    found = []
    for lane in lanes:
        t, W = (a[lane.first : lane.last] for a in (stretches[lane.stretch].time, stretches[lane.stretch].rates))
        speed = max(float(np.linalg.norm(W, axis=1).mean()), 1e-300)
        count = int(np.clip((t - t[0] <= 0.5 / speed).sum(), min(6, len(t)), 30))
        degree = min(2, count - 1)
        found.append(np.polynomial.polynomial.polyfit(t[:count] - t[0], W[:count], degree)[0])
    return np.array(found)


def guesses(stretches: Sequence[Stretch]) -> list[Array]:
    """Return inertias to start from, by all linear methods."""
    pairs = [(one.time, one.rates) for one in stretches]
    found = [made[0] for width in WIDTHS if (made := weak_form(pairs, width)) is not None]
    energetic = pencil(pairs)
    found += [] if energetic is None else [energetic]
    return found or [np.diag([0.25, 0.33, 0.42])]


def estimate(
    stretches: Sequence[Stretch],
    priors: Priors,
    noise: float,
    loss: Loss = "linear",
    known_noise: bool = False,
    starts: Sequence[Array] | None = None,
    calls: int = CALLS,
) -> Solution:
    """Return the best solution from several starts, with the noise that its residuals have.

    Raises
    ------
    RunawayError
        No start leads to a motion.
    """
    lanes = short(stretches)
    first = Problem(stretches, priors, noise, loss, lanes)
    begin = begun(stretches, lanes)
    tried: list[Solution] = []
    for J in guesses(stretches) if starts is None else starts:
        try:
            tried.append(solve(first, Unknowns(J, np.zeros(3), 1.0, begin), accuracy=ROUGH, calls=20))
        except RunawayError:
            continue
        if 2 * tried[-1].cost < GOOD * len(first):
            break
    if not tried:
        raise RunawayError("no start leads to a motion")
    tried.sort(key=lambda one: one.cost)
    firsts = np.flatnonzero([lane.first == 0 for lane in lanes])
    second = replace(first, lanes=whole(stretches))
    best = tried[0].unknowns
    found = solve(second, replace(best, starts=best.starts[firsts]), calls=calls)
    speed = np.sqrt(np.mean([(one.rates**2).sum(axis=1).mean() for one in stretches]))
    for _ in range(0 if known_noise or found.spread > HOPELESS * speed else ROUNDS):
        spread = max(found.spread, 1e-12)
        change = abs(spread / found.problem.noise - 1)
        found = solve(replace(found.problem, noise=spread), found.unknowns, calls=calls)
        if change < SETTLED:
            break
    return found
