"""From a stack of problems through its march (`stack_march`) to what comes out of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..engine.records import BODY, QUANTITIES, SUMS
from ..exact.free_bodies import TOO_FAR
from ..geometry.arrays import Array
from .carried import SAME
from .problem import Intervals, Outcome, Problem, Status
from .scheme import Scheme
from .stack_march import StackMarch


def march(problem: Problem, order: int, threads: int, scheme: Scheme) -> Outcome:
    """March a stack; a member that fails keeps its good states."""
    if not scheme.is_director_scheme:
        problem = tangent(problem)
    todo = StackMarch(problem, order, scheme)
    if problem.memory is not None:
        todo.remember(problem.memory)
    common, end = todo.run(threads)
    arrays, reasons, k = todo.arrays, dict[int, str](), len(problem.output)
    failures = arrays["failures"]
    good = np.full(len(problem), k)
    if common is not None:
        running = failures[:, 0] == Status.OK
        failures[running] = common[:4]
        reasons = dict.fromkeys(np.flatnonzero(running).tolist(), common.reason)
    for i in np.flatnonzero(failures[:, 0]).tolist():
        good[i] = todo.good(int(failures[i, 1])) + (end is not None)
        if failures[i, 0] == Status.STALLED and isinstance(todo.called.error, Exception):  # nearby the load has a value
            failures[i, 0] = Status.LOAD if len(problem) == 1 else _status(problem, i, order, scheme)
        if todo.goes_too_far(i):
            reasons[i] = TOO_FAR
        elif failures[i, 0] == Status.LOAD and i not in reasons:
            reasons[i] = _reason(problem, i, order, scheme, todo)
    return Outcome(
        todo.states,
        good,
        failures,
        reasons,
        _intervals(todo) if problem.intervals else None,
        _observed(todo) if problem.observed else None,
        arrays["states"] * todo.factors,
        end,
    )


def tangent(problem: Problem) -> Problem:
    """Return the problem with tangent velocities and the spin that the constraint prescribes, round-off of it apart."""
    W, axis, systems = problem.velocity, problem.systems.axis, problem.systems
    if axis is not None and systems.spin is not None:
        rate = systems.spin_at(problem.t_start)[:, None] - (W * axis).sum(axis=1, keepdims=True)
        W = W + rate * axis
    elif axis is not None:
        spin = (W * axis).sum(axis=1, keepdims=True)
        W = np.where(abs(spin) > SAME * abs(W).max(axis=1, keepdims=True), W - spin * axis, W)
    return replace(problem, velocity=W, normal=None)


def _reason(problem: Problem, i: int, order: int, scheme: Scheme, todo: StackMarch) -> str:
    """Return why a load of the state has failed; of a member of many by marching it once more, alone."""
    if len(problem) > 1:
        return march(problem.member(i), order, 1, scheme).reasons.get(0, "")
    return todo.called.reason(todo.called_last)


def _status(problem: Problem, i: int, order: int, scheme: Scheme) -> float:
    """Return how a member ends that is marched alone."""
    return float(march(problem.member(i), order, 1, scheme).failures[0, 0])


def _intervals(todo: StackMarch) -> Intervals:
    sums = todo.arrays["intervals"][:, todo.skipped :]
    first = SUMS.lam if todo.scheme.is_director_scheme else SUMS.mu
    last = SUMS.mu if todo.stack.systems.axis is None else SUMS.moment
    return Intervals(
        sums[:, :, first:last],
        sums[:, :, SUMS.moment : SUMS.dead],
        sums[:, :, SUMS.work],
        sums[:, :, SUMS.iterations].astype(np.int64),
        sums[:, :, SUMS.dead : SUMS.work] if todo.gives_dead_moment else None,
        sums[:, :, SUMS.twist] if todo.gives_twist else None,
    )


def _observed(todo: StackMarch) -> Array:
    """Return what was observed in the units of the caller, (m, 4, QUANTITIES); NaN for members that have failed."""
    moment, T = todo.bodies[:, BODY.unit, None], todo.unit
    units = np.repeat(moment, QUANTITIES, axis=1)
    units[:, 3:9] *= T
    units[:, 9], units[:, 10] = 1 / T, units[:, 10] * T
    factors = np.stack([units, units, units, units * T], axis=1)
    found: Array = todo.arrays["observed"][:, :-1].reshape(-1, 4, QUANTITIES) * factors
    found[todo.arrays["failures"][:, 0] != Status.OK] = np.nan
    return found
