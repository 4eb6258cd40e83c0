"""The members of a stack in threads; one after the other for integrators of a single body."""

from __future__ import annotations

from collections.abc import Callable
from threading import local
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.attitudes import States, states_of, without_jumps
from .problem import IVP, Intervals, March, Outcome, Status

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
    multipliers, moment, work = (_padded(array, k - 1, 0) for array in march[2:5])
    velocity_integrals = None if march.velocity_integrals is None else _padded(march.velocity_integrals, k - 1, 0)
    iterations = None if march.newton_iterations is None else _padded(march.newton_iterations, k - 1, 0)
    is_known = problem.systems.axis is None or not (problem.load.potentials or problem.systems.has_dead_force)
    dead = np.zeros(moment.shape) if is_known else None
    intervals = Intervals(multipliers, moment, work, iterations, dead, velocity_integrals=velocity_integrals)
    failures = np.zeros((1, 4)) if failure is None else np.array([failure[:4]], dtype=np.float64)
    reasons = {} if failure is None else {0: failure.reason}
    return Outcome(states, np.array([n]), failures, reasons, intervals)


def _padded(array: Any, length: int, value: float) -> NDArray[Any]:
    """Return an array with a member axis, brought to a length."""
    missing = np.full((length - len(array), *array.shape[1:]), value, array.dtype)
    return np.concatenate([array, missing])[None]


def _concatenated(arrays: tuple[NDArray[Any] | None, ...]) -> Any:
    return None if any(array is None for array in arrays) else np.concatenate(arrays)  # type: ignore[arg-type]
