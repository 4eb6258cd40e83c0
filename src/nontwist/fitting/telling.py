r"""What a solution tells of the inertia: directions, principal moments and axes, with their intervals.

**At the wall** of flat bodies intervals are those of the profile likelihood of the linear problem among bodies. At a
solution the cost is ``c = ½ (w - ŵ)ᵀ I (w - ŵ)`` of the inertia ``J = J_0 + Σ w_n B_n`` to second order, with the
information I and the step ŵ that data without a wall ask for. A body has ``E - m c cᵀ = L Lᵀ`` (`chart`), so w is
quadratic in the six entries of L. A moment is ``λ + b·w``; the least cost at each of its values follows from the
least of ``c + μ b·w`` for each multiplier μ, and the interval ends where the root of twice the rise of c equals the
quantile. As L is square, a local minimum is a global one, though the problem in L is not convex (Burer and Monteiro,
Mathematical Programming 103, 2005, 427-444); the trust region leaves saddles, which L has on the wall.

At the solution the slope of c is not negative towards any body, so the rise is at least that without a wall: these
intervals are within those of the linear problem.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..geometry.arrays import Array
from ..geometry.attitudes import BASIS, ENTRIES
from .estimating import INSIDE
from .predictions import RunawayError
from .solving import Solution, solve
from .unknowns import TWICE, entries, symmetric

UNTOLD = 0.05  # of the trace: a direction with a larger standard error is not told
SINGULAR = 1e-12  # of the largest information: none
FAR = 1.0  # of the trace: an inertia that has gone so far meets w by its round-off in directions that are not told
LEAST = 1e-4  # information of a direction that is not told, as inertias of trace 1 lie within 1 of each other
THIN = 0.005  # of the trace: a smallest moment that may be the choice of the noise
LINEAR = 0.02  # of the trace: a standard error up to which the problem is linear
LEVEL = 0.95
APART = 3.0  # standard errors of the difference of two moments, below which their axes are not told apart
WALL = 0.5  # of the trace: the largest moment of a flat body
RESOLVED = 1e-6  # of the trace: a smaller change is lost in a solution that holds a moment
FEWEST = 10.0  # effective samples of each number of the inertia, for intervals
SEARCH, ACCURACY, CLOSE = 30, 0.01, 1e-3  # of a profile: trials, and how well it finds its level, and a multiplier


class Direction(NamedTuple):
    """A direction in the space of inertias, and what the data tell of it.

    Attributes
    ----------
    name : str
        In words: which moments or axes change along it.
    matrix : (3, 3) array
        The direction, of Frobenius norm 1, in body components.
    standard_error : float
        Along it, of the trace; infinite where the data tell nothing.
    is_told : bool
        Whether that is less than 0.05.
    """

    name: str
    matrix: Array
    standard_error: float
    is_told: bool


@dataclass(frozen=True)
class Principal:
    """Principal moments of J, ascending, with intervals, and their axes.

    Attributes
    ----------
    moments : (3,) array
    intervals : (3, 2) array
    axes : (3, 3) array
        Columns; right-handed.
    tilts : (3,) array, rad
        Half-widths of the intervals of the directions, nan where two moments are too close to tell.
    ratios : (2,) array
        J1/J3 and J2/J3.
    ratio_intervals : (2, 2) array
    """

    moments: Array
    intervals: Array
    axes: Array
    tilts: Array
    ratios: Array
    ratio_intervals: Array


@dataclass(frozen=True)
class Told:
    """What a solution tells: the information, best first, along directions of six entries each, in columns."""

    information: Array
    vectors: Array
    idle: Array  # directions that the motion does not depend on


def told(solution: Solution, white: bool = False) -> Told:
    """Return what the data tell, direction by direction.

    If noise is taken for white, correlated residuals tell more, and the first direction that is not told ends it.

    Where a direction is not told the linear problem at the solution is not to be trusted: the noise has chosen the
    place, and some other direction may look told there alone. So the inertia is moved along each that looks told, as
    far as what counts as not told, and the rest is fitted again: if the cost does not rise, the direction is not told
    either.
    """
    values, vectors = np.linalg.eigh(solution.information if white else solution.trusted)
    values = np.where(values > SINGULAR * values[-1], values, 0.0)[::-1]
    vectors = solution.problem.model.basis @ vectors[:, ::-1]
    smallest = np.linalg.eigvalsh(solution.unknowns.inertia)[0]
    if not (values[-1] * UNTOLD**2 > 1 and smallest > THIN):
        wide = quantile(solution, always=True)
        for k, w in enumerate(vectors.T):
            if values[k] * UNTOLD**2 > 1 and any(rise < wide for rise in _rises_along(solution, w, wide)):
                values[k] = 0.0
                if white:
                    break
    order = np.argsort(-values, kind="stable")
    return Told(values[order], vectors[:, order], solution.problem.model.idle)


def _rise(solution: Solution, found: Solution) -> float:
    """Return the root of twice the rise of the cost from one solution to another."""
    return float(np.sqrt(max(2 * (found.cost - solution.cost), 0.0) / solution.inflation))


def _rises_along(solution: Solution, w: Array, wide: float) -> Iterator[float]:
    """Yield the rise of the cost where the inertia is moved along w, to each side; if below `wide`, not the least."""
    by, J, at = w * TWICE, solution.unknowns.inertia, solution.unknowns
    enough = solution.cost + wide**2 / 2 * solution.inflation
    for change in (-UNTOLD, UNTOLD):
        start = replace(at, inertia=solution.problem.model.nearest(J + change * symmetric(w), at.more))
        held = (lambda J: (float(by @ entries(J)), by)), float(by @ entries(J)) + change
        try:
            found = solve(solution.problem, start, held=held, calls=30, enough=enough)
        except RunawayError:
            continue
        moved = found.unknowns.inertia - J
        if abs(by @ entries(moved) - change) < UNTOLD / 10 and abs(moved).max() < FAR:
            yield _rise(solution, found)


def directions(solution: Solution, found: Told) -> list[Direction]:
    """Return the directions in which J can change, the best told first."""
    axes = np.linalg.eigh(solution.unknowns.inertia)[1]
    named = []
    for value, w in zip(found.information, found.vectors.T, strict=True):
        error = float(1 / np.sqrt(value)) if value > 0 else np.inf
        N = symmetric(w)
        named.append(Direction(_name(axes.T @ N @ axes), N, error, error < UNTOLD))
    return named


def _name(N: Array) -> str:
    """Return what changes along a direction given in principal axes."""
    changes, diagonal = entries(N), N.diagonal()
    k = 3 + int(np.argmax(abs(changes[3:])))
    if 2 * changes[k] ** 2 > (diagonal**2).sum():
        i, j = sorted(ENTRIES[k])
        return f"the directions of the principal axes {i + 1} and {j + 1} in their plane"
    weakest, middle, most = np.argsort(abs(diagonal), kind="stable")
    is_large = abs(diagonal) >= 0.3 * abs(diagonal[most])
    if not is_large[middle]:
        return f"the principal moment {most + 1}"
    if not is_large[weakest]:
        low, high = sorted((most, middle))
        what = "sum" if diagonal[low] * diagonal[high] > 0 else "difference"
        return f"the {what} of the principal moments {low + 1} and {high + 1}"
    together = abs(np.sign(diagonal).sum()) == 3
    return "all principal moments together" if together else f"the principal moment {most + 1} beside the two others"


def covariance(found: Told) -> Array:
    """Return the covariance of the six entries of J, (6, 6), in the order xx, yy, zz, yz, xz, xy."""
    told = (found.vectors / np.maximum(found.information, LEAST)) @ found.vectors.T
    return np.asarray(told + found.idle @ found.idle.T / LEAST)


def has_intervals(solution: Solution) -> bool:
    """Return whether enough samples count for intervals."""
    return solution.slow_noise is None or solution.samples_each >= FEWEST


def quantile(solution: Solution, always: bool = False) -> float:
    """Return how many standard errors the intervals have to each side; nan where too few samples count."""
    from scipy.special import stdtrit  # as `scipy.stats.t.ppf`, whose import takes a second

    return float(stdtrit(solution.freedom, (1 + LEVEL) / 2)) if always or has_intervals(solution) else np.nan


@np.errstate(invalid="ignore")  # variances that round-off of what is not told makes negative
def principal(solution: Solution, C: Array, size: float) -> Principal:
    """Return principal moments, of this sum, ratios and axes with their intervals; nan where they are not told."""
    J, wide = solution.unknowns.inertia, quantile(solution)
    values, axes = np.linalg.eigh(J)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    # dJ_ij in principal axes as rows of the six entries
    by = np.array([[_product(axes[:, i], axes[:, j]) for j in range(3)] for i in range(3)])
    errors = wide * np.sqrt(np.einsum("iim,mn,iin->i", by, C, by))
    intervals = np.stack([values - errors, values + errors], axis=1)
    has_an_end = solution.problem.model.physical and not solution.problem.model.is_absolute  # where bodies are flat
    if has_an_end and intervals[2, 1] > WALL and errors[2] < wide * UNTOLD:
        intervals[2] = to_the_wall(solution, wide, C)
    for k in range(3):
        if meets_the_wall(solution, by[k, k], errors[k], C):
            intervals[k] = [values[k] + walled(solution, by[k, k], sign, wide) for sign in (-1.0, 1.0)]
    intervals[:2, 0] = np.maximum(intervals[:2, 0], 0.0)
    tilts = np.zeros(3)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        gap, apart = values[j] - values[i], by[j, j] - by[i, i]
        tilt = wide * np.sqrt(by[i, j] @ C @ by[i, j]) / max(gap, 1e-300)
        tilt = tilt if gap > APART * np.sqrt(max(apart @ C @ apart, 0.0)) else np.nan
        tilts[[i, j]] = np.maximum(tilts[[i, j]], tilt)
    ratios = values[:2] / values[2]
    slopes = [by[k, k] / values[2] - values[k] / values[2] ** 2 * by[2, 2] for k in range(2)]
    spread = wide * np.sqrt([slope @ C @ slope for slope in slopes])
    ratio_intervals = np.stack([ratios - spread, ratios + spread], axis=1)
    lost = np.diff(intervals)[:, 0] > 4 * UNTOLD
    values[lost], intervals[lost] = np.nan, np.nan
    ratios[lost[:2] | lost[2]], ratio_intervals[lost[:2] | lost[2]] = np.nan, np.nan
    tilts[~(tilts <= 0.5)] = np.nan
    return Principal(values * size, intervals * size, axes, tilts, ratios, ratio_intervals)


def _product(a: Array, b: Array) -> Array:
    """Return ``∂(a·J b)/∂(entries of J)``."""
    return np.asarray(entries(np.outer(a, b) + np.outer(b, a)) * TWICE / 2)


def beyond_the_wall(solution: Solution) -> float:
    """Return by how many standard errors data without the wall would ask for a body flatter than flat.

    0 within the wall, and where a standard error is so large that the linear problem does not reach that far.
    """
    if not np.linalg.eigvalsh(solution.information)[0] * LINEAR**2 > 1:
        return 0.0
    model, more = solution.problem.model, solution.unknowns.more
    asked = solution.unknowns.inertia + symmetric(model.basis @ solution.newton)
    values, vectors = np.linalg.eigh(model.moments(asked) - model.centred(more))
    if values[0] >= 0 or not (found := told(solution, white=True)).information[-1] * LINEAR**2 > 1:
        return 0.0
    by = np.einsum("i,kij,j->k", vectors[:, 0], model.moments(BASIS), vectors[:, 0])
    return -float(values[0]) / float(np.sqrt(by @ covariance(found) @ by))


def meets_the_wall(solution: Solution, by: Array, error: float, C: Array) -> bool:
    """Return whether the linear problem asks for what is no body, at its best or at the ends of an interval.

    So it can be where the wall of an inertia with a scale has a known place, and data tell the inertia up to there.
    """
    model = solution.problem.model
    is_known = model.is_absolute and model.constraint is None and not ("centre" in model.places and model.weight)
    if not is_known or np.isnan(error) or not np.linalg.eigvalsh(solution.information)[0] * LINEAR**2 > 1:
        return False
    shift = symmetric(C @ by) * error / (by @ C @ by)
    places = solution.unknowns.inertia + np.array([symmetric(model.basis @ solution.newton), -shift, shift])
    return bool((model.thinnest(places, solution.unknowns.more) < 0).any())


def to_the_wall(solution: Solution, wide: float, C: Array) -> Array:
    """Return the interval of the largest moment by its profile likelihood; the wall is its end where it is reached.

    The square root of twice the rise of the cost is nearly linear in the value that is held.
    """
    from scipy.optimize import brentq

    def largest(J: Array) -> tuple[float, Array]:
        values, vectors = np.linalg.eigh(J)
        return float(values[2]), _product(vectors[:, 2], vectors[:, 2])

    at = solution.unknowns
    best, by = largest(at.inertia)
    error, room = wide * float(np.sqrt(by @ C @ by)), WALL - best
    if error < RESOLVED:
        return np.array([best - error, min(best + error, WALL)])

    def beyond(value: float) -> float:
        if value == best:
            return -wide
        return _rise(solution, solve(solution.problem, at, held=(largest, value), calls=30)) - wide

    low, high = best - error, WALL
    while beyond(low) < 0 and low > best - FAR:
        low -= error
    low = brentq(beyond, low, best, xtol=ACCURACY * error)
    if room > 1e-5 and beyond(best + room * (1 - 1e-3)) > 0:
        high = brentq(beyond, best, best + room * (1 - 1e-3), xtol=ACCURACY * min(error, room))
    return np.array([low, high])


def walled(solution: Solution, by: Array, sign: float, wide: float) -> float:
    """Return how far below or above its value a moment of derivative `by`, (6,), may be; see the module."""
    from scipy.optimize import brentq, minimize

    model, J, more = solution.problem.model, solution.unknowns.inertia, solution.unknowns.more
    information, asked = solution.information, solution.newton
    onto, b = model.basis.T * TWICE, model.basis.T @ by
    # J is K(ℓ, ℓ) beside m c cᵀ, and w along the basis, of the numbers ℓ of L
    K = np.stack([onto @ model.inertia(e, more)[1][:, :6] / 2 for e in np.eye(6)], axis=2)
    still = onto @ entries(model.inertia(np.zeros(6), more)[0] - J)
    begin = model.cholesky(J, more, INSIDE)

    def cost(w: Array) -> float:
        return float((w - asked) @ information @ (w - asked) / 2)

    def least(multiplier: float) -> tuple[float, float]:
        """Return the cost and the change of the moment where the cost and a part of that change are least."""

        def value(x: Array) -> tuple[float, Array]:
            w = K @ x @ x + still
            return cost(w) + multiplier * float(b @ w), 2 * (K @ x).T @ (information @ (w - asked) + multiplier * b)

        def bend(x: Array) -> Array:
            by_w = information @ (K @ x @ x + still - asked) + multiplier * b
            return np.asarray(2 * np.einsum("i,ipq->pq", by_w, K) + 4 * (K @ x).T @ information @ (K @ x))

        x = minimize(value, begin, jac=True, hess=bend, method="trust-exact", options={"gtol": 1e-7}).x
        w = K @ x @ x + still
        return cost(w), float(b @ w)

    lowest, _ = least(0.0)

    def beyond(multiplier: float) -> float:
        return float(np.sqrt(max(2 * (least(-sign * multiplier)[0] - lowest), 0.0))) - wide

    high = wide / float(np.sqrt(b @ np.linalg.solve(information, b)))
    for _ in range(SEARCH):
        if beyond(high) > 0:
            high = brentq(beyond, 0.0, high, xtol=CLOSE * high, rtol=CLOSE)
            break
        high *= 2
    return least(-sign * high)[1]
