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

from collections.abc import Callable
from functools import lru_cache
from math import inf, log
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
from . import completion
from .first_steps import (
    MANY,
    STEADY,
    TENTH,
    First,
    coarse_grid,
    finer,
    first_run,
    first_step,
    order_of,
    steps_of_gyration,
)
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

    return Refinement(plan, begin, first or first_run(plan, begin), run).found()


class Refinement:
    """Runs of a plan on one grid after the other, until two of them agree.

    Attributes
    ----------
    goal, floor, slowest : float
        What d has to be below; the floor; the least |W| that errors of W are relative to.
    scheme, grid, coarse : Integrator, Segments, Trial
        Of the next coarse run; the run itself where there is one already.
    before, d, slope, level : tuple, float, float, int
        Steps and distance of the pair before; the distance of the last pair, as which order it falls, and how often it
        did not fall.
    is_rough : bool
        Whether functions of the state have kinks that no node meets.
    """

    def __init__(self, plan: Plan, begin: Starts, first: First, run: Callable[..., Trial]) -> None:
        self.plan, self.begin, self.run, self.linear = plan, begin, run, plan.linearised(begin)
        self.scheme, self.pace, self.h, self.grid, self.swing = first
        self.goal, self.slowest = plan.goal, 0.0
        self.floor: float | None = None
        self.coarse: Trial | None = None
        self.before: tuple[int, float] | None = None
        self.d, self.slope, self.level, self.rounds, self.is_rough = inf, 0.0, 0, 0, False
        self.has_laws = bool(plan.load.called.terms or plan.load.functions or plan.load.memories)
        self.gyration = gyration_rate(plan.systems, plan.load, plan.t_start, plan.t_end)
        self.amplified = ""

    def found(self) -> tuple[Trial, float, float]:
        """Return the run, the tolerance, and the estimate."""
        while self.rounds < ROUNDS:
            self.rounds += 1
            if self.coarse is None:
                self.coarse = self.run(self.scheme, self.grid, _samples(self.grid, self.plan.store))
            coarse = self.coarse
            is_done = coarse.is_coarse or coarse.is_over
            if self.floor is None and not is_done and self.has_better_steps(coarse):
                continue
            fine = coarse if is_done else self.run(self.scheme, finer(coarse.grid), None)
            if fine.is_over:
                return fine, self.goal, inf
            if fine.is_coarse:
                if 2 * coarse.grid.steps > ENOUGH:  # at any step: the run says how it fails
                    return self.run(self.scheme, fine.grid, None), self.goal, inf
                self.begin_with(_scaled(coarse.grid, 2.0))
                self.rounds -= 1  # these end at `ENOUGH`
            elif self.is_accepted(coarse, fine):
                if not completion.misses_jump(self.scheme, fine.problem, fine.outcome, self.goal):
                    if self.amplified and self.plan.tolerance is None:
                        warn(self.amplified)
                    return fine, self.goal, self.d
                self.begin_with(_scaled(coarse.grid, BESIDE))
            elif not self.refines(coarse, fine):
                break
        return self.unreached(fine)

    def begin_with(self, grid: Segments) -> None:
        """Take a grid for the next coarse run, which is compared with none before."""
        self.grid, self.coarse, self.before = grid, None, None

    def has_better_steps(self, coarse: Trial) -> bool:
        """Find the floor and the size of W; return whether the first steps that follow from it are others."""
        plan = self.plan
        other = self.run(self.scheme, coarse.grid, np.array([0, coarse.grid.steps]), moved(self.begin))
        floor = _distance(coarse, other, ends=True) / LARGER
        if FLOORS * floor > plan.goal:
            self.slowest = 1.0 / (plan.t_end - plan.t_start)
            floor = _distance(coarse, other, self.slowest, ends=True) / LARGER
        self.floor, self.pace = floor, coarse.measured(self.pace)
        self.goal = _within_reach(plan, floor, self.pace.largest)
        self.amplified = _amplified(floor) if FLOORS * floor > VAGUE else ""
        before, h = self.scheme, self.h
        self.choose_steps()
        if self.scheme == before and (abs(np.log(self.h.values / h.values)) < log(OVERRATED)).all():
            self.h = h
            return False
        self.begin_with(coarse_grid(self.linear, self.begin, self.scheme, self.h))
        return True

    def choose_steps(self) -> None:
        """Choose the order and the first steps."""
        self.scheme, self.h = first_step(self.linear, self.begin, self.pace, self.swing)

    def is_accepted(self, coarse: Trial, fine: Trial) -> bool:
        """Measure d and how it falls; return whether it is small enough."""
        p, N = order_of(self.scheme), coarse.grid.steps
        self.gap = self.d = _distance(coarse, fine)
        if self.slowest:
            self.d = _distance(coarse, fine, self.slowest)
        self.slope, is_surer = p, False
        if self.before is not None:
            self.slope = log(max(self.before[1], EPS**2) / max(self.d, EPS**2)) / log(N / self.before[0])
            is_surer = self.slope >= p / 2 and not self.has_laws
        return self.d <= TENTH * self.goal or (self.d <= self.goal and is_surer)

    def refines(self, coarse: Trial, fine: Trial) -> bool:
        """Refine the steps, or begin anew with the lowest order; return whether that is of use."""
        is_seen = self.gap < UNSEEN and fine.grid.longest * self.gyration <= STEADY
        needed = steps_of_gyration(self.plan, self.scheme)
        is_missed = coarse.grid.steps < needed < ENOUGH / 2
        is_seen = (is_seen or fine.grid.steps > MANY) and not is_missed
        self.before, self.level = (coarse.grid.steps, self.d), self.level + (is_seen and self.slope < LEVEL)
        if self.is_at_round_off:
            return False
        slope, most = max(self.slope, 1.0), ROUGH if self.is_rough else order_of(self.scheme)
        above = self.d / (TENTH * self.goal)
        factor = min(1.1 * above ** (1 / min(slope, most)), WIDEST)
        if is_missed:
            factor = min(factor, 1.1 * needed / coarse.grid.steps)
        steps_needed = coarse.grid.steps * above ** (1 / max(self.slope, 0.5))
        is_hopeless = (self.level > 1 or steps_needed > ENOUGH) and not (self.is_rough and self.plan.load.is_compiled)
        if not (is_seen and (is_hopeless or fine.grid.steps * factor > ENOUGH)):
            self.grid, self.coarse = _scaled(coarse.grid, factor), fine if factor <= NEARLY else None
            return True
        if self.is_rough or not self.has_kinks:
            return False
        self.is_rough, self.level, self.rounds = True, 0, 0
        self.linear = self.linear._replace(schemes=(min(self.linear.schemes, key=order_of),))
        self.choose_steps()
        self.begin_with(coarse_grid(self.linear, self.begin, self.scheme, self.h))
        return True

    @property
    def has_kinks(self) -> bool:
        """Whether what is left of d may come from kinks of functions: it is not round-off."""
        return self.has_laws and self.d > FLOORS * (self.floor or 0.0)

    @property
    def is_at_round_off(self) -> bool:
        """Whether d no longer falls, and is small enough."""
        return self.level > 1 and self.d <= self.goal and not self.has_kinks

    def unreached(self, fine: Trial) -> tuple[Trial, float, float]:
        """Return the last run with a warning, or raise a ValueError where a tolerance that is asked for is missed."""
        if not self.is_at_round_off:
            text = self.amplified or _unreached(self.scheme, self.plan, fine, self.goal, self.d, self.slope)
            if self.plan.tolerance is not None and self.d > self.goal:
                raise ValueError(text)
            warn(text)
        return fine, self.goal, self.d


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


def _unreached(scheme: Integrator, plan: Plan, fine: Trial, goal: float, d: float, slope: float) -> str:
    load = plan.load
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
    if fine.grid.steps < (needed := steps_of_gyration(plan, scheme)):
        ways = (
            f"rotors and wheels make the body gyrate, which {needed:.2g} steps resolve: shorten the run, or give step="
        )
    return (
        f"tolerance = {goal:.3g} is not reached: with {fine.grid.steps} steps of order {order_of(scheme):g} the error "
        f"is estimated as {d:.1e} and falls as if of order {max(slope, 0.0):.1f}; {ways}"
    )
