"""Runs to a tolerance: the order and the step that keep the error of a run below a bound, and how that is known.

The error of a run is that of its attitude, in rad, that of W relative to the largest |W|, or that of the internal
states of loads with memory relative to their scale, or to the largest where that is more: the largest of these, at its
worst over the stored states. A tolerance bounds it.

1. The first steps follow from a local estimate (`first_steps`), on which nothing else relies.
2. N steps are run, and at least 3/2 N: a segment between two kinks has an even number of steps, and then half as many
   more, or one step, and then two. The finer run is returned; its largest distance d from the coarse one, at the stored
   nodes that they share, is the estimate of its error. That is nearly the error of the coarse run; the finer one is
   about 1.5^p times better, which is not relied on.
3. d is accepted where it is below a tenth of the tolerance; or below the tolerance, if it falls from one pair of runs
   to the next at least as an order of p/2 does. Else the steps are refined. Steps that miss an oscillation, under
   a moment whose rate is not known, give distances of the size of the motion, which do not fall: that is no reason to
   stop. Nor is it where steps miss the gyration that rotors and wheels cause, be it ever so small.
   Functions of the state may have kinks that no node meets, as where a motor reaches its limit. The error is of order 2
   then, d falls by fits and starts, and may be small by chance: beside such functions it has to be below a tenth of the
   tolerance. Where a high order does not get there, the lowest one begins anew, whose steps cost least.
4. No run is more accurate than its start. The floor is the motion of the end under a change of the start and of the
   load by two units of round-off, measured with a change 32 times larger. A tolerance below ten floors is refused.
   A body that rests, or swings by less than its attitude resolves, has a W of round-off: then an error of W counts
   relative to one radian in the length of the run, if it is larger than the largest |W|.

All members of an ensemble have one grid; the worst member decides. Where neither step nor tolerance is given, the
tolerance of the integrator is taken (`Integrator.automatic`), or ten floors; a warning tells what is not reached, and
where ten floors are more than 1e-3.
"""

from __future__ import annotations

from functools import lru_cache
from math import log
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import warn
from ..geometry.arrays import EPS, Array, distinct
from ..geometry.values import number_text
from ..integrators import IVP, Integrator, Status
from ..integrators.costs import gyration_rate
from ..integrators.integrator import Outcome
from ..integrators.ivp import Segments, segmented
from ..loads import Load
from . import completion
from .first_steps import MANY, STEADY, TENTH, First, coarse_grid, finer, first_run, first_step, order_of
from .grid import Piecewise, stored_steps
from .notices import SMOOTH
from .planning import Plan
from .starts import Starts

LARGER = 32
CHANGE = 2 * EPS * LARGER
FLOORS = 10.0
VAGUE = 1e-3  # rad, the least error that is possible from which on this is told
# Refinements of runs that reach the end; the largest at a time; up to which the finer run is the next.
ROUNDS, WIDEST, NEARLY = 14, 8.0, 1.6
SAMPLES = 64  # states of a coarse run that show the size of W
OVERRATED = 1.6  # estimates of |w| that are so much too large are corrected
COARSE = (Status.TURN, Status.STALLED, Status.BROKEN)
ENOUGH = 1_000_000  # steps, of a run that is given up where it would need more
BESIDE = 1.25  # refinement where a jump of the load lies at a node
LEVEL, ROUGH = 0.3, 2.0  # slope of what no longer falls; of laws with kinks that no node meets
UNSEEN = 0.01  # distance of runs that miss an oscillation


class Trial(NamedTuple):
    """Runs on one grid."""

    scheme: Integrator
    grid: Segments
    problem: IVP
    outcome: Outcome

    @property
    def is_coarse(self) -> bool:
        """Whether steps are too long for a member."""
        return not self.done.all() and bool(np.isin(self.outcome.failures[:, 0], COARSE).any())

    @property
    def is_over(self) -> bool:
        """Whether shorter steps are of no use: it was interrupted, or the load jumps for every member."""
        if self.done.all():
            return False
        failures = self.outcome.failures[:, 0]
        return bool((failures == Status.INTERRUPTED).any() or (failures == Status.JUMP).all())

    @property
    def done(self) -> NDArray[np.bool_]:
        """Whether members have reached the end, (m,)."""
        return self.outcome.failures[:, 0] == Status.OK

    def measured(self, pace: Piecewise) -> Piecewise:
        """Return the largest |W| at the stored states of members that have reached the end, in pieces of time."""
        speeds = np.sqrt(np.square(self.outcome.states.velocity[self.done]).sum(axis=2))
        return pace.measured(self.problem.stored_times, speeds.max(axis=0, initial=0.0))

    @property
    def speeds(self) -> Array:
        """The largest |W| at the stored states of each member, rad/s, (m,)."""
        return np.sqrt(np.square(self.outcome.states.velocity).sum(axis=2)).max(axis=1)


def controlled(
    plan: Plan, begin: Starts, threads: int = 1, first: First | None = None, on_gpu: bool = False, **options: Any
) -> tuple[Trial, float, float]:
    """Return the run or the ensemble of a plan with a tolerance, the tolerance, and the estimate of its error.

    `options` are those of the problem.

    Raises
    ------
    ValueError
        The tolerance is below what round-off allows, or is not reached; as `nontwist.simulate`.
    """

    def run(scheme: Integrator, grid: Segments, stored: NDArray[np.int64] | None, start: Starts = begin) -> Trial:
        more = options if stored is None else {}
        task = plan._replace(scheme=scheme).problem(start, grid, stored, on_gpu=on_gpu, **more)
        return Trial(scheme, grid, task, completion.checked_march(scheme, task, threads))

    goal, floor, (scheme, pace, h, grid, swing) = plan.goal, None, first or first_run(plan, begin)
    linear = plan.linearised(begin)
    coarse: Trial | None = None
    before: tuple[int, float] | None = None
    level, slowest, amplified, is_rough = 0, 0.0, "", False
    has_laws = bool(plan.load.called.terms or plan.load.functions or plan.load.memories)
    gyration = gyration_rate(plan.systems, plan.load, plan.t_start, plan.t_end)
    rounds = 0
    while rounds < ROUNDS:
        rounds += 1
        if coarse is None:
            coarse = run(scheme, grid, _samples(grid, plan.store))
        if floor is None and not (coarse.is_coarse or coarse.is_over):
            other = run(scheme, coarse.grid, np.array([0, coarse.grid.steps]), moved(begin))
            floor = _distance(coarse, other, ends=True) / LARGER
            if FLOORS * floor > plan.goal:
                slowest = 1.0 / (plan.t_end - plan.t_start)
                floor = _distance(coarse, other, slowest, ends=True) / LARGER
            pace = coarse.measured(pace)
            goal = _within_reach(plan, floor, pace.largest)
            amplified = _amplified(floor) if FLOORS * floor > VAGUE else ""
            scheme, better = first_step(linear, begin, pace, swing)
            if scheme != coarse.scheme or (abs(np.log(better.values / h.values)) >= log(OVERRATED)).any():
                h, coarse = better, None
                grid = coarse_grid(linear, begin, scheme, h)
                continue
        fine = coarse if coarse.is_coarse or coarse.is_over else run(scheme, finer(coarse.grid), None)
        if fine.is_over:
            return fine, goal, np.inf
        if fine.is_coarse:
            if 2 * coarse.grid.steps > ENOUGH:
                break
            grid, coarse, before, rounds = _scaled(coarse.grid, 2.0), None, None, rounds - 1  # these end at `ENOUGH`
            continue
        p, N, gap = order_of(scheme), coarse.grid.steps, _distance(coarse, fine)
        d = gap if slowest == 0.0 else _distance(coarse, fine, slowest)
        slope = p if before is None else log(max(before[1], EPS**2) / max(d, EPS**2)) / log(N / before[0])
        is_surer = before is not None and slope >= p / 2 and not has_laws
        if d <= TENTH * goal or (d <= goal and is_surer):
            if completion.misses_jump(scheme, fine.problem, fine.outcome, goal):
                grid, coarse, before = _scaled(coarse.grid, BESIDE), None, None
                continue
            if amplified and plan.tolerance is None:
                warn(amplified)
            return fine, goal, d
        is_seen = (gap < UNSEEN and fine.grid.longest * gyration <= STEADY) or fine.grid.steps > MANY
        before, level = (N, d), level + (is_seen and slope < LEVEL)
        factor = min(1.1 * (d / (TENTH * goal)) ** (1 / min(max(slope, 1.0), ROUGH if is_rough else p)), WIDEST)
        whole = (d / (TENTH * goal)) ** (1 / max(slope, 0.5))
        has_kinks = has_laws and d > FLOORS * (floor or 0.0)
        if level > 1 and d <= goal and not has_kinks:  # of round-off
            return fine, goal, d
        is_hopeless = (level > 1 or N * whole > ENOUGH) and not (is_rough and plan.load.is_compiled)
        if is_seen and (is_hopeless or fine.grid.steps * factor > ENOUGH):
            if is_rough or not has_kinks:
                break
            is_rough, linear = True, linear._replace(schemes=(min(linear.schemes, key=order_of),))
            (scheme, h), coarse, before, level, rounds = first_step(linear, begin, pace, swing), None, None, 0, 0
            grid = coarse_grid(linear, begin, scheme, h)
            continue
        grid, coarse = _scaled(coarse.grid, factor), fine if factor <= NEARLY else None
    if fine.is_coarse:  # at any step: the run says how it fails
        fine = run(scheme, fine.grid, None)
        return fine, goal, np.inf
    text = amplified or _unreached(scheme, plan.load, fine, goal, d, slope)
    if plan.tolerance is not None and d > goal:
        raise ValueError(text)
    warn(text)
    return fine, goal, d


def _scaled(grid: Segments, factor: float) -> Segments:
    """Return a grid with about so many times as many steps in each segment, an even number."""
    return segmented(grid.borders, 2 * np.ceil(np.diff(grid.numbers) * factor / 2))


def _partners(grid: Segments, fine: Segments, numbers: NDArray[np.int64]) -> tuple[Any, Any]:
    """Return which nodes of `fine`, the finer grid, with these numbers are nodes of `grid`, and their numbers there."""
    first, ends = np.array(grid.numbers), np.array(fine.numbers)
    j = np.searchsorted(ends[1:-1], numbers, side="right")
    local, is_even = numbers - ends[j], (np.diff(first) % 2 == 0)[j]
    size = np.where(is_even, 3, 2)
    shared = np.flatnonzero(local % size == 0)
    found = first[j] + np.where(is_even, local // 3 * 2, local // 2)
    return shared, found[shared]


@lru_cache(maxsize=64)
def _samples(grid: Segments, store: int | Literal["end"]) -> NDArray[np.int64]:
    """Return the nodes of a coarse run that its finer run stores as well, and some for the size of W."""
    fine = finer(grid)
    shared = _partners(grid, fine, stored_steps(fine.steps, store))[1]
    some = np.linspace(0, grid.steps, min(SAMPLES, grid.steps) + 1).astype(np.int64)
    return distinct(np.concatenate([shared, some]))


def _distance(a: Trial, b: Trial, slowest: float = 0.0, ends: bool = False) -> float:
    """Return the largest distance of two trials, of attitudes (rad) and of W relative to its size, over all members.

    It is taken at the stored nodes that `b`, on a finer grid, shares with `a`; with `ends` at the last ones. The size
    of W is at least `slowest`, rad/s.
    """
    i, k = np.array([-1]), np.array([-1])
    if not ends:
        k, numbers = _partners(a.grid, b.grid, b.problem.stored)
        known = a.problem.stored
        i = np.minimum(np.searchsorted(known, numbers), len(known) - 1)
        i, k = i[known[i] == numbers], k[known[i] == numbers]
    good = a.done & b.done
    if not good.any():
        return 0.0
    every = slice(None) if good.all() else good
    (p, W, *_, z), (q, V, *_, y) = a.outcome.states.part(every), b.outcome.states.part(every)
    p, q = p[:, i], q[:, k]
    p = np.where((p * q).sum(axis=2, keepdims=True) < 0, -p, p)
    angle = 4 * np.arcsin(np.minimum(np.sqrt(np.square(p - q).sum(axis=2)) / 2, 1.0))
    size = np.maximum(np.maximum(a.speeds[good], b.speeds[good]), slowest)
    gap = np.sqrt(np.square(W[:, i] - V[:, k]).sum(axis=2)).max(axis=1)
    worst = max(angle.max(), np.divide(gap, size, out=np.zeros_like(gap), where=size > 0).max())
    if z is not None and y is not None:
        sizes = np.maximum(abs(z).max(axis=1, keepdims=True), a.problem.load.internal_scale)
        worst = max(worst, (abs(z[:, i] - y[:, k]) / sizes).max())
    return float(worst)


def moved(begin: Starts) -> Starts:
    """Return the starts with attitudes, velocities and loads changed by `LARGER` times two units of round-off."""
    (x, y, z, w), f = begin.quaternion.T, CHANGE / 2 * np.array([1, -1, 1]) / np.sqrt(3)
    a, b, c = f
    turned = x + w * a + y * c - z * b, y + w * b + z * a - x * c, z + w * c + x * b - y * a, w - x * a - y * b - z * c
    W = begin.velocity * (1 + CHANGE * np.array([1, -1, 1]))
    scale = begin.load_scale * (1 + CHANGE)
    own = {name: getattr(begin, name) for name in ("time", "internal", "wheels", "wheel_torque")}
    return Starts(np.stack(turned, axis=1), W, None, scale, **own)


def _within_reach(plan: Plan, floor: float, fastest: float) -> float:
    """Return the tolerance that is aimed at; a ValueError where one is asked for that floor or times do not permit."""
    resolution = float(np.spacing(max(abs(plan.t_start), abs(plan.t_end))))
    least = max(FLOORS * floor, clock := fastest * resolution / 2)
    if plan.tolerance is not None and plan.tolerance < least:
        reason = _amplified(floor) if least > VAGUE else _moved(floor)
        if clock == least:
            reason = f"times are resolved to {resolution:.2g} s; count them from a start at 0"
        raise ValueError(
            f"tolerance = {plan.tolerance:g} cannot be reached: {reason}; "
            f"{'or ' * (clock == least)}use tolerance >= {float(f'{1.25 * least:.1e}'):g}"
        )
    return max(plan.goal, least)


def _amplified(floor: float) -> str:
    return (
        f"the motion amplifies errors: {_moved(floor)} rad, so it is known to "
        f"{number_text(FLOORS * floor, '.2g')} rad at best; a shorter run is known better"
    )


def _moved(floor: float) -> str:
    return f"a change of the start by two units of round-off moves the end by {number_text(floor, '.1e')}"


def _unreached(scheme: Integrator, load: Load, fine: Trial, goal: float, d: float, slope: float) -> str:
    if d <= goal:
        return (
            f"the error is estimated as {d:.1e} by two runs, the finer of {fine.grid.steps} steps; a third, to "
            f"confirm that it is below {goal:.3g}, would take too many"
        )
    ways = f"{SMOOTH}, " if load.called.terms else ""
    if load.terms:
        ways += "name the times where the load jumps or has kinks with breakpoints=, "
    ways += "ask for less, or give step="
    if not load.terms and slope < order_of(scheme) / 2:
        ways = "the motion amplifies round-off: a shorter run is known better"
    return (
        f"tolerance = {goal:.3g} is not reached: with {fine.grid.steps} steps of order {order_of(scheme):g} the error "
        f"is estimated as {d:.1e} and falls as if of order {max(slope, 0.0):.1f}; {ways}"
    )
