"""The cost of a sweep, measured on a few of its members: time, bytes, and its blocks.

A block takes at most 10 s and 64 MiB. There are a few blocks for every worker, but none so small that its overhead
exceeds its work.
"""

from __future__ import annotations

from time import perf_counter
from typing import NamedTuple

import numpy as np

from ..geometry.values import as_whole
from .draws import spread
from .members import REFUSED, Members

LONGEST, LARGEST, MOST = 10.0, 2**26, 2**18  # s, bytes, members of a block
SHORTEST, SHARE = 0.25, 4  # s of a block; blocks for each worker
SHORTEST_MEASUREMENT, FIRST = 0.05, 16  # s; members of the first measurement


class Plan(NamedTuple):
    """The estimated cost of a sweep."""

    members: int
    block: int  #: members of a block
    blocks: int
    bytes_each: int  #: of a member on disk
    bytes: int
    files: int
    seconds_each: float  #: of a member on one core, as measured here
    seconds: float  #: of all on the workers
    workers: int
    refused: float  #: fraction of the tried members whose numbers define no run
    reason: str  #: of the first of these


def plan(members: Members, workers: int, block: int | None = None) -> Plan:
    """Return the estimated cost of a sweep on `workers` cores like this one; a few of its members are run.

    Raises
    ------
    ValueError
        All members that were tried are refused; a `block` that is no whole number >= 1.
    """
    block = None if block is None else as_whole(block, "block", 1)
    each, refused, reason = _measured(members)
    m, size = len(members), members.bytes_each
    fits = _block(m, each, size, workers) if block is None else min(int(block), m)
    blocks = -(-m // fits)
    files = (len(members.kept) + 2) * blocks
    seconds = m * each / min(workers, blocks)
    return Plan(m, fits, blocks, size, m * size, files, each, seconds, workers, refused, reason)


def _block(members: int, each: float, size: int, workers: int) -> int:
    """Return the members of a block, such that all blocks but the last are equal and the last is not much smaller."""
    target = min(max(members * each / (SHARE * workers), SHORTEST), LONGEST / 2)
    most = max(1, int(min(target / each, LARGEST / size, MOST)))
    return -(-members // -(-members // most))


def _measured(members: Members) -> tuple[float, float, str]:
    """Return seconds for each member, the refused fraction, and why the first one is."""
    count = FIRST
    while True:
        numbers = spread(members.sweep, count)
        m = len(next(iter(numbers.values())))
        members.run(numbers)  # compiles the kernels of these members
        begin = perf_counter()
        results = members.run(numbers)
        seconds = perf_counter() - begin
        if seconds >= SHORTEST_MEASUREMENT or m >= min(len(members), MOST) // 2:
            break
        count = min(16 * count, len(members), MOST)
    bad = np.flatnonzero(results.status == REFUSED)
    reason = results.reasons[int(bad[0])] if bad.size else ""
    if bad.size == m:
        raise ValueError(f"all {m} members tried are refused, the first because: {reason}")
    return seconds / m, bad.size / m, reason
