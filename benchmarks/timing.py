"""Times of calls that take turns in one process in shuffled order: what else the machine does then hits all alike."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from statistics import median
from typing import Any

import numpy as np

from nontwist.driver import single_run
from nontwist.integrators.stack_march import Listed, StackMarch
from nontwist.kernels.kernel import Kernel

SHORTEST, SLOW, VERY_SLOW = 5e-4, 0.02, 0.2


def shuffled(
    calls: Mapping[Hashable, Callable[[], Any]], passes: int = 7, known: Mapping[Hashable, float] | None = None
) -> dict[Hashable, float]:
    """Return the median seconds of each call; short ones are repeated within a pass, slow ones get fewer passes.

    `known` gives the seconds of calls that have run before.
    """
    order, draw = list(calls), random.Random(1)
    known = known if known is not None else {key: (calls[key](), _timed(calls[key], 1))[1] for key in order}
    counts = {key: int(np.clip(SHORTEST / known[key], 1, 1000)) for key in order}
    turns = {key: passes if known[key] < SLOW else 3 if known[key] < VERY_SLOW else 1 for key in order}
    times: dict[Hashable, list[float]] = {key: [] for key in order}
    for k in range(passes):
        draw.shuffle(order)
        for key in order:
            if k < turns[key]:
                times[key].append(_timed(calls[key], counts[key]))
    return {key: median(found) for key, found in times.items()}


def fastest(calls: Mapping[Hashable, Callable[[], Any]], passes: int = 5) -> dict[Hashable, float]:
    """Return the least seconds of each call, which take turns after one that is not counted; for long calls."""
    times = {key: float("inf") for key in calls}
    for k in range(passes + 1):
        for key, call in calls.items():
            seconds = _timed(call, 1)
            times[key] = min(times[key], seconds) if k else times[key]
    return times


def _timed(call: Callable[[], Any], count: int) -> float:
    start = time.perf_counter()
    for _ in range(count):
        call()
    return (time.perf_counter() - start) / count


@contextmanager
def _recording_marches(found: list[Callable[[], None]]) -> Iterator[None]:
    """Record marches of the engine, which take addresses: their memory is kept, their states are put back each time."""
    sound = StackMarch._run

    def record(self: StackMarch, todo: Listed, width: int, first: int, last: int) -> None:
        names = "states", "failures", "sums", "totals", "observed"
        changing = [(self.arrays[name], self.arrays[name].copy()) for name in names]
        block, *alive = self.laid(todo, width, first, last)
        run, kept = self.driver(todo, width), (self, self.loads, alive)

        def march() -> None:
            for array, start in changing:
                array[...] = start
            run(block.ctypes.data)
            assert kept

        found.append(march)
        sound(self, todo, width, first, last)

    StackMarch._run = record  # type: ignore[method-assign]
    try:
        yield
    finally:
        StackMarch._run = sound  # type: ignore[method-assign]


@contextmanager
def _recording(found: list[tuple[Any, tuple[Any, ...]]]) -> Iterator[None]:
    """Record the calls of kernels with what they were given; those of the engine are parts of marches."""
    sound = Kernel.__call__

    def record(self: Kernel, *args: Any) -> Any:
        if not self.__module__.startswith("nontwist.engine."):
            found.append((self, copies(args)))
        return sound(self, *args)

    Kernel.__call__ = record  # type: ignore[method-assign]
    try:
        yield
    finally:
        Kernel.__call__ = sound  # type: ignore[method-assign]


def copies(args: Any) -> Any:
    """Return `args` with all arrays in them copied."""
    if isinstance(args, np.ndarray):
        return args.copy()
    if isinstance(args, tuple):
        parts = [copies(a) for a in args]
        return type(args)(*parts) if hasattr(args, "_fields") else tuple(parts)
    return args


def kernel_calls(call: Callable[[], Any]) -> Callable[[], None] | None:
    """Return what repeats only the compiled functions that `call` calls, on what it gave them; None: there are none."""
    call()
    found: list[tuple[Any, tuple[Any, ...]]] = []
    marches: list[Callable[[], None]] = []
    single_run._cached.cache_clear()  # else a run that is repeated is a call that was laid out before
    with _recording(found), _recording_marches(marches):
        call()
    if not found and not marches:
        return None
    small = [[(a, a.copy()) for a in args if isinstance(a, np.ndarray) and a.size <= 64] for _, args in found]

    def repeat() -> None:
        for march in marches:
            march()
        for (function, args), state in zip(found, small, strict=True):
            for array, start in state:
                array[...] = start
            function(*args)

    return repeat
