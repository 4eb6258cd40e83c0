"""The members of a stack, in threads or one after the other; marches of one body by integrators written in Python.

These march from a single step, with output at any times.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from threading import local
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..geometry.attitudes import States, states_of, without_jumps
from .ivp import IVP, Failure, Intervals, March, Outcome, Outputs, Status, started

BLOCK = 16


class PerThread(local):
    """What each thread makes for itself when it first asks: `own`."""

    def __init__(self, make: Callable[[], Any]) -> None:
        self.own = make()


def in_threads(
    task: Callable[[int, int], None], span: tuple[int, int], size: int, threads: int, report: Callable[[int], None]
) -> None:
    """Call ``task(first, last)`` for blocks of `size` of a span of members; ``report(members)`` after each.

    Each member must write to memory of its own. The first exception cancels the blocks that have not begun.
    """
    spans = [(k, min(k + size, span[1])) for k in range(*span, size)]
    if threads == 1 or len(spans) == 1:
        for first, last in spans:
            task(first, last)
            report(last - first)
        return
    from concurrent.futures import ThreadPoolExecutor

    pool = ThreadPoolExecutor(threads)
    try:
        futures = [pool.submit(task, *span) for span in spans]
        for future, (first, last) in zip(futures, spans, strict=True):
            future.result()
            report(last - first)
    finally:
        pool.shutdown(cancel_futures=True)


def progress(problem: IVP, rounds: int = 1) -> Callable[[int], None]:
    """Return a callback that counts completed members and reports the fraction to `problem`; each takes `rounds`."""
    done = 0

    def report(members: int) -> None:
        nonlocal done
        done += members
        if problem.progress:
            problem.progress(done / (rounds * len(problem)))

    return report


def one_by_one(march: Callable[[IVP], Outcome], problem: IVP, threads: int) -> Outcome:
    """Integrate every member by itself.

    Raises
    ------
    ValueError
        As `march`.
    KeyboardInterrupt
        In a stack of more than one, whose other members would be lost.
    """
    m, found = len(problem), dict[int, Outcome]()
    if m == 1:
        return march(problem.member(0))

    def block(first: int, last: int) -> None:
        for i in range(first, last):
            one = found[i] = march(problem.member(i))
            if one.failures[0, 0] == Status.INTERRUPTED:
                raise KeyboardInterrupt(one.reasons[0])

    in_threads(block, (0, m), BLOCK, threads, progress(problem))
    members = [found[i] for i in range(m)]
    states = States(*map(_concatenated, zip(*(one.states for one in members), strict=True)))
    good, failures = (np.concatenate([getattr(one, name) for one in members]) for name in ("good", "failures"))
    reasons = {i: one.reasons[0] for i, one in enumerate(members) if 0 in one.reasons}
    means = zip(*(one.intervals for one in members if one.intervals), strict=True)
    intervals = Intervals(*map(_concatenated, means)) if problem.intervals else None
    return Outcome(states, good, failures, reasons, intervals)


def outcome_of(problem: IVP, march: March) -> Outcome:
    """Return the outcome of a problem of one body from its march; missing states are NaN, missing intervals 0."""
    k, n, failure = len(problem.stored_times), len(march.directors), march.failure
    p, W, N = states_of(march.directors, march.velocities)
    p = without_jumps(np.concatenate([problem.quaternion, p]))[1:]
    carried = np.stack([march.directors, march.velocities], axis=1)
    states = States(*(_padded(array, k, np.nan) for array in (p, W, N, carried)))
    multipliers, moment, work, iterations = (_padded(array, k - 1, 0) for array in march[2:6])
    velocity_integrals = _padded(march.velocity_integrals, k - 1, 0)
    is_known = problem.systems.axis is None or not (problem.load.potentials or problem.systems.has_dead_force)
    dead = np.zeros(moment.shape) if is_known else None
    intervals = Intervals(multipliers, moment, work, iterations, dead, velocity_integrals=velocity_integrals)
    failures = np.zeros((1, 4)) if failure is None else np.array([failure[:4]], dtype=np.float64)
    reasons = {} if failure is None else {0: failure.reason}
    return Outcome(states, np.array([n]), failures, reasons, intervals)


def _padded(array: Any, length: int, value: float) -> Any:
    """Return an array, if there is one, with a member axis, brought to a length."""
    if array is None:
        return None
    missing = np.full((length - len(array), *array.shape[1:]), value, array.dtype)
    return np.concatenate([array, missing])[None]


def _concatenated(arrays: tuple[NDArray[Any] | None, ...]) -> Any:
    return None if any(array is None for array in arrays) else np.concatenate(arrays)  # type: ignore[arg-type]


ORTHONORMAL = 1e-9
ENDS = np.array([0, 1])


class StepResult(NamedTuple):
    """The result of one step of a scheme."""

    directors: Array  # (3, 3) rows, at the end of the step
    velocities: Array  # (3, 3) rows, at the end of the step
    multipliers: Array  # (constraints,) means over the step
    moment: Array  # (3,) mean moment of the load in space, N m
    load_work: float  # J
    newton_iterations: int
    failure: Failure | None


def march_by_steps(
    problem: IVP, constraints: int, step: Callable[[int, Array, Array], StepResult], precision: Any
) -> March:
    """Call ``step(k, directors, velocities)`` for all steps of the grid, and return the march.

    Parameters
    ----------
    problem : IVP
        Of one body.
    constraints : int
        Number of multipliers.
    step : callable
        Returns the `Step` number k from the directors and their velocities at its beginning.
    precision : dtype
        Of the states.
    """
    q, v, stored = problem.directors.astype(precision), problem.velocities.astype(precision), problem.stored
    states, n, lengths, failure = [(q, v)], len(stored) - 1, np.diff(problem.stored_times), None
    multipliers, moment, work = np.zeros((n, constraints)), np.zeros((n, 3)), np.zeros(n)
    iterations = np.zeros(n, dtype=np.int64)
    try:
        for k in range(problem.steps):
            one, done = step(k, q, v), len(states) - 1
            if failure := one.failure or _broken(k, one.directors):
                break
            q, v, part = one.directors, one.velocities, problem.step_at(k) / lengths[done]
            multipliers[done] += part * one.multipliers
            moment[done] += part * one.moment
            work[done] += one.load_work
            iterations[done] = max(iterations[done], one.newton_iterations)
            if k + 1 == stored[done + 1]:
                states.append((q, v))
            if problem.progress:
                problem.progress((k + 1) / problem.steps)
    except KeyboardInterrupt as stop:
        failure = Failure(Status.INTERRUPTED, int(stored[len(states) - 1]), np.nan, np.nan, str(stop))
    directors, velocities = (np.array(part, dtype=np.float64) for part in zip(*states, strict=True))
    n = len(states) - 1
    return March(directors, velocities, multipliers[:n], moment[:n], work[:n], iterations[:n], failure)


def _broken(k: int, q: Array) -> Failure | None:
    defect = float(abs(q @ q.T - np.eye(3)).max())
    if defect <= ORTHONORMAL and np.linalg.det(q.astype(float)) > 0:
        return None
    return Failure(Status.BROKEN, k, defect, np.nan)


def at_any_times(march_one: Callable[[IVP], March], problem: IVP) -> March:
    """Return the states of one body at the output times: each by a step of its own from the last node.

    Parameters
    ----------
    march_one : callable
        From a problem without output times to its march.
    problem : IVP

    Returns
    -------
    March
        Means over the intervals follow from integrals (`nontwist.engine.workspace`).
    """
    outputs, N = Outputs(problem), problem.steps
    nodes = np.unique(np.concatenate([[0], outputs.node, [N]]))
    whole = march_one(replace(problem, output_times=None, stored=nodes, intervals=True))
    once = replace(problem, output_times=None, steps=1, stored=ENDS, intervals=True, progress=None)
    reached, counts = problem.times(nodes)[: len(whole.directors)], whole.newton_iterations
    passed = whole.means.integrals(np.diff(reached))[0]
    total = np.concatenate([np.zeros((1, passed.shape[1])), np.cumsum(passed, axis=0)])
    states, sums, iterations = [(whole.directors[0], whole.velocities[0])], [total[0]], list[int]()
    last, failure = 0, whole.failure
    for k, since in zip(np.searchsorted(nodes, outputs.node).tolist(), outputs.since.tolist(), strict=True):
        if k >= len(reached):
            break
        q, v, integral, used = whole.directors[k], whole.velocities[k], total[k], 0
        if since > 0:
            span: dict[str, Any] = {"t_start": reached[k], "t_end": reached[k] + since, "segments": None}
            part = march_one(replace(once, **started(States(*states_of(q, v))), **span))
            if part.failure is not None:
                failure = failure or part.failure._replace(step=int(nodes[k]))
                break
            q, v = part.directors[1], part.velocities[1]
            integral = integral + part.means.integrals(np.array([since]))[0, 0]
            used = 0 if part.newton_iterations is None else int(part.newton_iterations[0])
        iterations.append(used if counts is None else max([used, *counts[last:k].tolist()]))
        last = k
        states.append((q, v))
        sums.append(integral)
    n, first = len(states) - 1, 0 if outputs.has_start else 1
    between = np.diff(np.array(sums), axis=0)
    q, v = (np.array(part) for part in zip(*states, strict=True))
    used_most = None if counts is None else np.array([iterations], dtype=np.int64)
    means = whole.means.of_integrals(between[None], outputs.length[:n], used_most).of_one
    parts: Any = (None if array is None else array[first:] for array in (q, v, *list(means.values())[:4]))
    return March(*parts)._replace(failure=failure)
