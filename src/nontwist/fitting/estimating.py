r"""The best of several starts: a recording in short lanes first, then as a whole, with the noise that it has.

`estimate` goes in two stages: short lanes first, whose gaps may be as large as the noise (multiple shooting: it
converges from afar; several inertias are tried until one explains the recording), then one lane for each recording,
without gaps: the model. Where that fails, lanes are joined two by two, until one is left. Where something acts, the
first inertias are moved off the wall of flat bodies: there the derivative of the cost across the wall vanishes in the
chart, so that a fit that begins on it creeps along. σ follows from the residuals, and where it changes, the second
stage is repeated, since the priors weigh more or less then.

Starting values without an iteration: two methods that are linear in the inertia.

**Weak form.** A free body has ``J W' = J W × W``. Times a smooth function φ that vanishes at the ends of a window and
integrated by parts, this needs no derivative of the recording,

    J ∫φ' W dt + ∫φ (J W × W) dt = 0 ,

and it is linear in the six entries of J. Many windows make a least-squares problem on tr J = 1. With
``φ = (1 - s²)⁴`` the trapezoidal rule is exact to high order. White noise does not bias the second term, since
``I × I`` vanishes; it biases the first a little towards a sphere.

**Energy and momentum.** ``W·J W`` and ``W·J² W`` are constant. A quadratic form that is constant along the recording is
found without any time: the two smallest singular vectors of the centred products W_i W_j span J and J². J is the
member of this pencil whose square lies in it too, and of the few that do, the one that the weak form likes best. Noise
harms it more, coarse sampling does not harm it at all.

**Other moments.** What acts beside enters the weak form as columns of its own. Damping is ``-∫φ W dt`` times C. A rotor
of momentum h is ``∫φ h × W dt + ∫φ' h dt`` over the unit of J, which follows; where its axis is fitted there is one for
each axis of the body, and the length of the three is 1 over the unit. The
direction of gravity in the body is ``γ = Rᵀ γ_0``, where R is the turn since the start by the recorded angular
velocity, so with ``a = m g c`` the moment ``a × Rᵀ γ_0`` is linear in the nine products ``a γ_0ᵀ``. For all recordings
side by side these make a matrix of rank one, whose singular vectors are a and the γ_0; as |γ_0| = 1, its size is |a|.
Where the direction n of c is known the three numbers |a| γ_0 are found instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise, repeat

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..geometry.attitudes import BASIS, ENTRIES, LEVI
from ..geometry.rotations import exp
from ..recordings.conventions import finite_rows
from .predictions import RunawayError
from .shooting import WHITE, Lane, Shooting, Stretch, Unknowns, correlation, haste_of
from .solving import CALLS, PATIENT, Solution, solve
from .unknowns import TRACELESS, Model, entries, symmetric, unit_vector

WIDTHS = (1.0, 2.0, 4.0)  # of a window, rad
ROUND = ((1.0, 0.0), (2.0, 0.03), (4.0, 0.03), (2.0, 0.3), (2.0, 0.0), (4.0, 0.0))  # widths; weights of a sphere
FEWEST = 8  # samples in a window
ANGLES = 360  # of a pencil
SPHERE = entries(np.eye(3) / 3)
CROSS = np.einsum("abc,kbd->kadc", LEVI, BASIS).reshape(6, 3, 9)


def windowed(
    time: Array, rates: Array, centres: Array, halves: Array, moments: Array, momenta: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the equations of the weak form in windows of time, (m, 3, 6 + q), and which windows have no gap.

    Their centres move to the closest sample, so that the sum of φ' over even samples vanishes as its integral does.
    `moments`, (n, 3, q), are those that act per unit of q more unknowns, and `momenta`, (n, 3, q), are those of rotors.
    """
    from scipy.sparse import csr_array

    centres = time[np.searchsorted((time[1:] + time[:-1]) / 2, centres)]
    steps = np.concatenate([[0.0], np.diff(time), [0.0]])
    interval = np.quantile(steps[1:-1], 0.8)
    first, last = np.searchsorted(time, centres - halves), np.searchsorted(time, centres + halves, "right")
    count = np.where(last - first >= FEWEST, last - first, 0)
    ends = np.concatenate([[0], np.cumsum(count)])
    window = np.repeat(np.arange(len(centres)), count)
    inside = np.arange(ends[-1]) + (first - ends[:-1])[window]
    sides = np.stack([steps[inside], steps[inside + 1]])
    gaps = sides.max(axis=0) > np.maximum(3 * interval, halves / FEWEST)[window]
    lost, weight = np.bincount(window, gaps, len(centres)), sides.mean(axis=0)
    s, half = (time[inside] - centres[window]) / halves[window], halves[window]
    bump, slope = (
        csr_array((values * weight, inside, ends), shape=(len(centres), len(time)))
        for values in ((1 - s**2) ** 4, -8 * s * (1 - s**2) ** 3 / half)
    )
    products = np.einsum("ni,nj->nij", rates, rates).reshape(-1, 9)
    turning = np.einsum("kij,mj->mik", BASIS, slope @ rates) + np.einsum("kij,mj->mik", CROSS, bump @ products)
    more = (bump @ moments.reshape(len(time), -1) + slope @ momenta.reshape(len(time), -1)).reshape(len(centres), 3, -1)
    return np.concatenate([turning, more], axis=2), (count > 0) & (lost == 0)


def weak_rows(model: Model, time: Array, rates: Array, speed: Array | None, width: float) -> Array:
    """Return the equations of the weak form over windows of so many radians, (m, 3, 6 + q)."""
    size, duration = np.sqrt((rates**2).sum(axis=1).mean()), np.ptp(time)
    haste, interval = haste_of(model, time, rates), np.quantile(np.diff(time), 0.8)
    known = acting(model, time, rates, speed)
    longest = 4 * duration / (6 + known[0].shape[2] / 3)  # with which there are as many equations as unknowns
    half = min(max(min(width / max(size * haste, 1e-300), longest), FEWEST * interval), duration) / 2
    centres = np.arange(time[0] + half, time[-1] - half * (1 - 1e-9), half / 2)
    centres = centres if len(centres) else np.array([(time[0] + time[-1]) / 2])
    rows, whole = windowed(time, rates, centres, np.full(len(centres), half), *known)
    return allowed(model, rows[whole]) / (half * size**2 * haste + 1e-300)


def allowed(model: Model, rows: Array) -> Array:
    """Return equations without the part along n of a constraint, whose moment is along it."""
    n = model.constraint
    return rows if n is None else rows - np.einsum("i,j,mjq->miq", n, n, rows)


def turns(time: Array, rates: Array) -> Array:
    """Return the rotations since the first sample by angular velocities that are linear between samples, (n, 3, 3)."""
    steps = exp((rates[1:] + rates[:-1]) / 2 * np.diff(time)[:, None])
    return np.array([*accumulate(steps, np.matmul, initial=np.eye(3))])


@dataclass(frozen=True)
class Guess:
    """Values to start from: the model with its unit, J, what is fitted beside it, and γ at the first samples."""

    model: Model
    inertia: Array
    more: Array
    downs: Sequence[Array] = ()
    misfit: float = 0.0  # of the weak form, r.m.s., of the moments that turning by a radian takes

    @property
    def numbers(self) -> Array:
        """All of them."""
        return np.concatenate([self.inertia.ravel(), self.more, [self.model.unit], *self.downs])


def acting(model: Model, time: Array, rates: Array, speed: Array | None) -> tuple[Array, Array]:
    """Return the moments per unit of what is fitted beside J, and the momenta of a rotor, (n, 3, q).

    The unknowns are those of gravity, of damping, and of the axis of a rotor, in this order.
    """
    pivot, wheel = model.pivot, model.wheel
    moments, momenta = [np.zeros((len(time), 3, 0))], np.zeros((len(time), 3, 0))
    if pivot is not None:
        by = np.einsum("ijk,nlk->nijl", LEVI, turns(time, rates))
        if pivot.direction is not None:
            by = np.einsum("nijl,j->nil", by, pivot.direction)
        moments.append(by.reshape(len(time), 3, -1))
    if model.damping:
        moments.append(-rates[:, :, None] * (np.ones((1, 1)) if model.damping == 1 else np.eye(3)))
    if wheel is not None:
        speed = np.zeros(len(time)) if speed is None else speed
        momenta = wheel.inertia * np.multiply.outer(speed, np.eye(3) if wheel.axis is None else wheel.axis[:, None])
        moments.append(np.cross(momenta, rates[:, :, None], axis=1))
    every = np.concatenate(moments, axis=2)
    return every, np.concatenate([np.zeros((*every.shape[:2], every.shape[2] - momenta.shape[2])), momenta], axis=2)


def balanced(every: Array, model: Model, round_by: float) -> tuple[Array, Array]:
    """Return w and what is left of equations of the weak form, (..., n, 6 + q).

    w are the directions of J of trace 1, (..., 5), and q moments. `round_by` is how much J costs that is not a sphere,
    over what it does to the equations. Without that, noise makes the moments large that a swing in a plane does not
    tell, and so all else small beside the trace.
    """
    A = np.concatenate([every[..., :6] @ TRACELESS, every[..., 6:]], axis=-1)
    size = np.maximum(np.linalg.norm(A, axis=-2, keepdims=True), 1e-300)
    size[..., :5] = size[..., :5].max(axis=-1, keepdims=True)
    aims = -every[..., :6] @ SPHERE
    rounder = np.broadcast_to(round_by * np.eye(5, A.shape[-1]), (*A.shape[:-2], 5, A.shape[-1]))
    solving = np.linalg.pinv(np.concatenate([A / size, rounder], axis=-2), rcond=1e-6 if model.is_free else 1e-4)
    w = (solving[..., : A.shape[-2]] @ aims[..., None])[..., 0] / size[..., 0, :]
    return w, (A @ w[..., None])[..., 0] - aims


def pencil(stretches: Sequence[tuple[Array, Array]]) -> Array | None:
    """Return J of trace 1 by energy and momentum, or None where they do not tell."""
    centred = []
    for _, W in stretches:
        products = np.stack([W[:, i] * W[:, j] * (1 if i == j else 2) for i, j in ENTRIES], axis=1)
        centred.append(products - products.mean(axis=0))
    rows = np.concatenate(centred)
    if len(rows) < 6:
        return None
    found = np.linalg.svd(rows, full_matrices=False)[2]
    first, second = symmetric(found[-1]), symmetric(found[-2])
    angle = np.linspace(0, np.pi, ANGLES, endpoint=False)
    J = np.cos(angle)[:, None, None] * first + np.sin(angle)[:, None, None] * second
    trace = np.trace(J, axis1=1, axis2=2)
    J = J[abs(trace) > 0.1] / trace[abs(trace) > 0.1, None, None]
    J = J[np.linalg.eigvalsh(np.eye(3) / 2 - J)[:, 0] > -0.05]
    if not len(J):
        return None
    plane, squares = np.stack([entries(first), entries(second)]), entries(J @ J)
    squares = squares / np.linalg.norm(squares, axis=1, keepdims=True)
    outside = np.linalg.norm(squares - squares @ np.linalg.pinv(plane) @ plane, axis=1)
    best, weak = J[np.argsort(outside)[:20]], list[Array]()
    for time, W in stretches:
        weak.extend(weak_rows(Model(), time, W, None, WIDTHS[1]).reshape(-1, 6))
    return best[np.argmin(np.linalg.norm(entries(best) @ np.reshape(weak, (-1, 6)).T, axis=1))]


def with_moments(
    stretches: Sequence[tuple[Array, Array]],
    model: Model,
    width: float,
    round_by: float,
    speeds: Sequence[Array | None] = (),
) -> Guess | None:
    """Return what the weak form gives with all that acts on the body, J of trace 1; None where it does not tell."""
    pivot, wheel, count = model.pivot, model.wheel, len(stretches)
    own = 0 if pivot is None else 3 if pivot.direction is not None else 9
    rows = []
    for k, ((time, rates), speed) in enumerate(zip(stretches, speeds or repeat(None), strict=False)):
        turning, arms, others = np.split(weak_rows(model, time, rates, speed, width), [6, 6 + own], axis=2)
        every = [arms if j == k else np.zeros_like(arms) for j in range(count)]
        rows.append(np.concatenate([turning, *every, others], axis=2))
    equations = np.concatenate(rows)
    equations = equations.reshape(-1, equations.shape[2])
    if len(equations) < equations.shape[1]:
        return None
    w, left = balanced(equations, model, round_by)
    misfit = float(np.sqrt(np.mean(left**2)))
    J = symmetric(SPHERE + TRACELESS @ w[:5])
    arms, damping, momentum = np.split(w[5:], [own * count, own * count + model.damping])  # the latter over the unit
    axis = unit_vector(momentum) if "axis" in model.places else np.zeros(0)
    centre, downs, unit = np.zeros(0), np.zeros((0, 3)), 1.0
    if pivot is None and wheel is not None:
        per_unit = float(np.linalg.norm(momentum)) if len(axis) else float(momentum[0])
        unit = 1 / per_unit if per_unit > 0 else np.nan
    elif pivot is not None:
        if pivot.direction is not None:
            downs = arms.reshape(count, 3)
            arm = float(np.sqrt((downs**2).sum(axis=1).mean()))
        else:
            U, sizes, V = np.linalg.svd(np.concatenate(arms.reshape(count, 3, 3), axis=1))
            sign = np.sign(U[np.argmax(abs(U[:, 0])), 0])  # a choice: both have the same motion
            arm, centre, downs = float(sizes[0] / np.sqrt(count)), sign * U[:, 0], sign * V[0].reshape(count, 3)
        unit = pivot.moment / arm if arm > 0 else np.nan
    if np.isnan(unit):
        return None
    more = np.concatenate([centre, axis, np.ones(int("factor" in model.places)), damping])
    return Guess(replace(model, unit=unit), J, more, [unit_vector(one) for one in downs], misfit)


LANE = 1.5  # rad, of the first stage
MOST_LANES = 40
LESS = 0.5  # of the cost, half a sum of squares over the noise
ROUGH = 1e-4  # of cost and unknowns in the first stage, relative
ROUNDS, SETTLED = 4, 0.02
HOPELESS = 0.05  # of the speed, and rad: residuals that no motion of the model leaves
MOST_ENDS = 4  # starts from which the whole is fitted, where something acts
UNLIKELY = 5.0  # standard deviations, of errors of the gyroscope before anything is known
UNTRUSTED = 20.0  # times the noise of samples: residuals that no more trials mend
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
    found = list[Guess]()
    for how in ways:
        made = with_moments(pairs, model, *how, speeds)
        if made is not None and not any(np.array_equal(made.numbers, one.numbers) for one in found):
            found.append(made)  # in short windows wide parts are the same
    if model.is_free:
        energetic = pencil(pairs)
        others = [np.diag([0.25, 0.33, 0.42])] * (not found) if energetic is None else [energetic]
        found += [Guess(model, J, np.zeros(0)) for J in others]
    return found


def estimate(problem: Shooting, known_noise: bool = False, calls: int = PATIENT) -> Solution:
    """Return the best solution of a problem from several starts, with the noise that its residuals have.

    Raises
    ------
    RunawayError
        No start leads to a motion.
    """
    return whole_of(in_lanes(problem), known_noise, calls)


def in_lanes(problem: Shooting, starts: Sequence[Guess] | None = None) -> list[Solution]:
    """Return rough solutions in short lanes from several starts, up to one that explains the recordings.

    Raises
    ------
    RunawayError
        No start leads to a motion.
    """
    gyroscope, model, stretches = problem.gyroscope, problem.model, problem.stretches
    lanes, begin = short(model, stretches), gyroscope.mean[gyroscope.free]
    seen = [replace(one, rates=gyroscope.undone(one.rates)) for one in stretches]
    speeds = np.concatenate([np.zeros(0), *(one.speed.values for one in stretches if one.speed is not None)])
    tried = list[Solution]()
    for one in guesses(seen, model) if starts is None else starts:
        J = one.model.nearest(one.inertia, one.more, INSIDE)
        at = Unknowns(J, one.more, begin, begun(seen, lanes, one), speeds)
        with suppress(RunawayError):
            tried.append(solve(replace(problem, lanes=lanes, model=one.model), at, accuracy=ROUGH, calls=20))
            if explains(tried[-1]):
                break
    if not tried:
        raise RunawayError("no start leads to a motion")
    return tried


def whole_of(tried: Sequence[Solution], known_noise: bool, calls: int) -> Solution:
    """Return the best solution without lanes that rough ones in lanes lead to."""
    model, lanes, stage = tried[0].problem.model, len(tried[0].problem.lanes), min(calls, CALLS)
    ends: list[Solution] = []
    for first in sorted(tried, key=lambda one: one.cost)[: 1 if model.is_free else MOST_ENDS]:
        ends.append(_joined(first, lanes, stage))
        if explains(first) and not explains(ends[-1]):
            ends.append(_joined(first, 2, stage))
        if explains(ends[-1]):
            break
    found = min(ends, key=lambda one: one.cost)
    hopeless = is_hopeless(found)
    while not hopeless and (finer := _with_more_knots(found)) is not None:
        found = solve(*finer, accuracy=ROUGH, calls=stage)
    for _ in range(ROUNDS * (known_noise and not hopeless and model.wheel is None)):
        found = found if found.is_settled else solve(found.problem, found.unknowns, calls=stage)
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
    """Return whether a solution leaves about the noise, with errors of the gyroscope that are likely."""
    return solution.unlike < UNLIKELY and 2 * solution.cost < GOOD * len(solution.problem)


def _joined(found: Solution, many: int, calls: int) -> Solution:
    """Return the solution for whole recordings by lanes of which so many are joined, each time from the one before."""
    lanes: list[Lane] = []
    while not lanes or any(one.joined for one in lanes):
        kept, lanes = list[int](), []
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
    sampled = found.problem.noise
    for _ in range(ROUNDS):
        spread, tilt = max(found.spread, 1e-12), max(found.tilt, 1e-12)
        change = max(abs(spread / found.problem.noise - 1), abs(tilt / max(found.problem.tilt, 1e-12) - 1))
        problem = replace(found.problem, noise=spread, tilt=tilt)
        found = solve(problem, found.unknowns, calls=min(calls, CALLS))
        if change < SETTLED or is_hopeless(found):
            break
    is_lost = is_hopeless(found) or found.spread > UNTRUSTED * sampled
    return found if is_lost else _settled(found, calls)


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
