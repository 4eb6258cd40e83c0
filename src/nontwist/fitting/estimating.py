"""The best of several starts: a recording in short lanes first, then as a whole, with the noise that it has.

`estimate` goes in two stages: short lanes first, whose gaps may be as large as the noise (multiple shooting: it
converges from afar; several inertias are tried until one explains the recording), then one lane for each recording,
without gaps: the model. Where that fails, lanes are joined two by two, until one is left. Where something acts, the
first inertias are moved off the wall of flat bodies: there the derivative of the cost across the wall vanishes in the
chart, so that a fit that begins on it creeps along. σ follows from the residuals, and where it changes, the second
stage is repeated, since the priors weigh more or less then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ..geometry.arrays import Array
from .bodies import Model
from .linear import ROUND, WIDTHS, Guess, pencil, turns, with_moments
from .measuring import finite_rows
from .motions import RunawayError
from .quality import WHITE, correlation, haste_of
from .shooting import Lane, Shooting, Stretch, Unknowns
from .solving import CALLS, PATIENT, Solution, solve

LANE = 1.5  # rad, of the first stage
MOST_LANES = 40
LESS = 0.5  # of the cost, half a sum of squares over the noise
ROUGH = 1e-4  # of cost and unknowns in the first stage, relative
ROUNDS, SETTLED = 4, 0.02
HOPELESS = 0.05  # of the speed, and rad: residuals that no motion of the model leaves
MOST_ENDS = 4  # starts from which the whole is fitted, where something acts
GOOD = 2.0  # mean square of the residuals over the noise: no other start is tried then
INSIDE = 0.01  # of tr J: second moments of a first inertia beside m c cᵀ at least


def whole(stretches: Sequence[Stretch]) -> list[Lane]:
    """Return one lane for each stretch."""
    return [Lane(k, 0, len(one.time)) for k, one in enumerate(stretches)]


def short(model: Model, stretches: Sequence[Stretch]) -> list[Lane]:
    """Return lanes in which the motion goes on by about `LANE`."""
    lanes = []
    speeds = [np.linalg.norm(one.rates, axis=1).mean() * haste_of(model, one.time, one.rates) for one in stretches]
    turned = [float(speed * np.ptp(one.time)) for speed, one in zip(speeds, stretches, strict=True)]
    size = max(LANE, sum(turned) / MOST_LANES)
    for k, one in enumerate(stretches):
        count = int(np.clip(np.ceil(turned[k] / size), 1, max(1, len(one.time) // 6)))
        borders = np.linspace(0, len(one.time), count + 1).astype(int)
        lanes += [Lane(k, a, b, b < len(one.time)) for a, b in pairwise(borders)]
    return lanes


def begun(stretches: Sequence[Stretch], lanes: Sequence[Lane], guess: Guess) -> Array:
    """Return the states at the starts of lanes: W of a parabola through the first samples, γ by turns, the attitude."""
    found, n = [], guess.model.constraint
    turned = [turns(one.time, one.rates) for one in stretches] if guess.downs else []
    for lane in lanes:
        one = stretches[lane.stretch]
        t, W = (a[lane.first : lane.last] for a in (one.time, one.rates))
        speed = max(float(np.linalg.norm(W, axis=1).mean()), 1e-300) * haste_of(guess.model, t, W)
        count = int(np.clip((t - t[0] <= 0.5 / speed).sum(), min(6, len(t)), 30))
        start = np.polynomial.polynomial.polyfit(t[:count] - t[0], W[:count], min(2, count - 1))[0]
        parts = [start if n is None else start - n * (n @ start)]  # steps keep a constraint, as it is linear
        if turned:
            parts.append(turned[lane.stretch][lane.first].T @ guess.downs[lane.stretch])
        if one.quaternions is not None:  # the closest that there is
            there = finite_rows(one.quaternions)
            parts.append(one.quaternions[there[np.argmin(abs(there - lane.first))]])
        found.append(np.concatenate(parts))
    return np.array(found)


def guesses(stretches: Sequence[Stretch], model: Model) -> list[Guess]:
    """Return values to start from, by all linear methods."""
    pairs = [(one.time, one.rates) for one in stretches]
    speeds = [None if one.speed is None else one.speed.at(one.time) @ one.speed.values for one in stretches]
    ways = [(width, 0.0) for width in WIDTHS] if model.is_free else ROUND
    found = [made for how in ways if (made := with_moments(pairs, model, *how, speeds)) is not None]
    if model.is_free:
        energetic = pencil(pairs)
        others = [np.diag([0.25, 0.33, 0.42])] * (not found) if energetic is None else [energetic]
        found += [Guess(model, J, np.zeros(0)) for J in others]
    return found


def estimate(
    problem: Shooting, known_noise: bool = False, starts: Sequence[Guess] | None = None, calls: int = PATIENT
) -> Solution:
    """Return the best solution of a problem from several starts, with the noise that its residuals have.

    Raises
    ------
    RunawayError
        No start leads to a motion.
    """
    gyroscope, model, stretches = problem.gyroscope, problem.model, problem.stretches
    lanes, begin = short(model, stretches), gyroscope.mean[gyroscope.free]
    seen = [replace(one, rates=gyroscope.undone(one.rates)) for one in stretches]
    speeds = np.concatenate([np.zeros(0), *(one.speed.values for one in stretches if one.speed is not None)])
    tried, stage = list[Solution](), min(calls, CALLS)
    for one in guesses(seen, model) if starts is None else starts:
        J = one.model.nearest(one.inertia, one.more, INSIDE)
        at = Unknowns(J, one.more, begin, begun(seen, lanes, one), speeds)
        try:
            tried.append(solve(replace(problem, lanes=lanes, model=one.model), at, accuracy=ROUGH, calls=20))
        except RunawayError:
            continue
        if explains(tried[-1]):
            break
    if not tried:
        raise RunawayError("no start leads to a motion")
    tried.sort(key=lambda one: one.cost)
    ends: list[Solution] = []
    for first in tried[: 1 if model.is_free else MOST_ENDS]:
        ends.append(_joined(first, len(lanes), stage))
        if explains(first) and not explains(ends[-1]):
            ends.append(_joined(first, 2, stage))
        if explains(ends[-1]):
            break
    found = min(ends, key=lambda one: one.cost)
    hopeless = is_hopeless(found)
    while not hopeless and (finer := _with_more_knots(found)) is not None:
        found = solve(*finer, accuracy=ROUGH, calls=stage)
    if not hopeless:
        found = _settled(found, calls) if known_noise else _with_its_noise(found, calls)
    return found.of_trace_one()


def _settled(found: Solution, calls: int) -> Solution:
    """Return a solution whose trials were used up after more of them, where these lessen the cost by what data tell.

    The valley is long where a rotor turns: its momentum, the scale and the moment about its axis are told apart by
    little. A direction that the data of other bodies do not determine would be followed to its end.
    """
    if found.is_settled or calls <= CALLS or found.problem.model.wheel is None:
        return found
    further = solve(found.problem, found.unknowns, calls=calls)
    return further if further.cost < found.cost - LESS else replace(found, is_settled=True)


def explains(solution: Solution) -> bool:
    """Return whether a solution leaves about the noise."""
    return 2 * solution.cost < GOOD * len(solution.problem)


def _joined(found: Solution, many: int, calls: int) -> Solution:
    """Return the solution for whole recordings by lanes of which so many are joined, each time from the one before."""
    is_first = True
    while is_first or any(one.joined for one in found.problem.lanes):
        kept, lanes, is_first = list[int](), list[Lane](), False
        for k, lane in enumerate(found.problem.lanes):
            if lanes and lanes[-1].joined and k < kept[-1] + many:
                lanes[-1] = lanes[-1]._replace(last=lane.last, joined=lane.joined)
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
        at = solve(replace(found.problem, noise=spread, tilt=tilt), found.unknowns, calls=min(calls, CALLS))
        found = _settled(at, calls)
        if change < SETTLED:
            break
    return found


def _with_more_knots(found: Solution) -> tuple[Shooting, Unknowns] | None:
    """Return a problem with more knots of the speed of a rotor; None where the residuals do not ask for them."""
    problem, x, row, stretches, speeds = found.problem, found.unknowns.flat, 0, [], [np.zeros(0)]
    for k, one in enumerate(problem.stretches):
        left_over = found.misses[row : row + len(one.time)]
        row += len(one.time)
        white = abs(correlation(left_over)) < WHITE / np.sqrt(left_over.size)
        finer = None if white or one.speed is None else one.speed.refined()
        stretches.append(one if finer is None else replace(one, speed=finer))
        values = x[problem.speeds_of(k)]
        speeds.append(values if finer is None or one.speed is None else one.speed.at(finer.knots) @ values)
    if all(new is old for new, old in zip(stretches, problem.stretches, strict=True)):
        return None
    return replace(problem, stretches=stretches), replace(found.unknowns, speeds=np.concatenate(speeds))
