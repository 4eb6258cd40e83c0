"""Times of calls that take turns in one process in shuffled order: what else the machine does then hits all alike."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Hashable, Mapping
from statistics import median
from typing import Any

import numpy as np

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
    times = [{key: _timed(call, 1) for key, call in calls.items()} for _ in range(passes + 1)][1:]
    return {key: min(one[key] for one in times) for key in calls}


def _timed(call: Callable[[], Any], count: int) -> float:
    start = time.perf_counter()
    for _ in range(count):
        call()
    return (time.perf_counter() - start) / count
