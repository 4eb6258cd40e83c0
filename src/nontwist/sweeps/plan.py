"""What a sweep will take, measured on a few of its members: time, bytes, and the blocks that it is cut into.

A block takes at most 10 s and 64 MiB. Within that it is as large as leaves a few for every worker, and not so small
that handing it out would cost more than making it.
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
LONG_ENOUGH, FIRST = 0.05, 16  # s of a measurement; members of the first


class Plan(NamedTuple):
    """What a sweep will take."""

    members: int
    block: int  #: members of a block
    blocks: int
    bytes_each: int  #: of a member on disk
    bytes: int
    files: int
    seconds_each: float  #: of a member on one core, as measured here
    seconds: float  #: of all on the workers
    workers: int
    refused: float  #: part of the members tried whose numbers make no run
    reason: str  #: of the first of these


def plan(members: Members, workers: int, block: int | None = None) -> Plan:
    """Return what a sweep will take on `workers` cores like this one; a few of its members are run.

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
    """Return how many members a block has, so that all blocks but the last are alike and the last not much smaller."""
    wanted = min(max(members * each / (SHARE * workers), SHORTEST), LONGEST / 2)
    most = max(1, int(min(wanted / each, LARGEST / size, MOST)))
    return -(-members // -(-members // most))


def _measured(members: Members) -> tuple[float, float, str]:
    """Return seconds for each member, the part that is refused, and why the first one is."""
    count = FIRST
    while True:
        numbers = spread(members.sweep, count)
        m = len(next(iter(numbers.values())))
        members.run(numbers)  # compiles all that these members need, of which a refused one needs nothing
        begin = perf_counter()
        results = members.run(numbers)
        seconds = perf_counter() - begin
        if seconds >= LONG_ENOUGH or m >= min(len(members), MOST) // 2:
            break
        count = min(16 * count, len(members), MOST)
    bad = np.flatnonzero(results.status == REFUSED)
    reason = results.reasons[int(bad[0])] if bad.size else ""
    if bad.size == m:
        raise ValueError(f"all {m} members tried are refused, the first because: {reason}")
    return seconds / m, bad.size / m, reason
