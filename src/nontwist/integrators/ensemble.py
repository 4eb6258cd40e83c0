"""Many initial value problems on one time grid, what comes out of them, and blocks of them in threads.

An `Ensemble` holds everything that its result depends on, and no member knows of another: it may be cut anywhere, given
to any number of threads, and each member has the same bits.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..loads import Load
from ..models.stack import SystemStack
from .base import Problem
from .time_grid import Before, OnGrid

# What is watched on the way, and how many numbers it has; energy is K + V less the work of the load.
WATCHED = {
    "kinetic_energy": 1,
    "potential_energy": 1,
    "energy": 1,
    "spatial_momentum": 3,
    "material_momentum": 3,
    "twist_rate": 1,
    "vertical_momentum": 1,
    "reaction_moment": 1,
}
COLUMNS = sum(WATCHED.values())
FIRST, LEAST, MOST, INTEGRAL = range(4)


@dataclass(frozen=True, eq=False)
class Ensemble(OnGrid):
    """Initial value problems of m bodies on a uniform time grid."""

    systems: SystemStack  # of one body or of m
    quaternion: Array  # (m, 4) Λ at t_start, scalar last, of unit length
    velocity: Array  # (m, 3) W at t_start
    load: Load
    load_scale: Array  # (1,) or (m,)
    t_start: float
    t_end: float
    steps: int
    stored: NDArray[np.int64]
    asked: Array | None = None
    normal: Array | None = None  # (m, 3, 3) symmetric part of the director velocities in the body at t_start
    watched: bool = False
    progress: Callable[[float], None] | None = None  # gets the part that is done
    before: Before | None = None

    def __len__(self) -> int:
        return len(self.quaternion)

    def member(self, i: int) -> Problem:
        """Return the problem of one member."""
        from scipy.spatial.transform import Rotation

        q = Rotation.from_quat(self.quaternion[i]).as_matrix().T
        x, y, z = self.velocity[i]
        V = np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])  # rows W × e_i
        if self.normal is not None:
            V = V + self.normal[i]
        scale = float(self.load_scale[i if len(self.load_scale) > 1 else 0])
        load = scale * self.load if self.load.terms else self.load
        body = self.systems[i if len(self.systems) > 1 else 0]
        grid = self.t_start, self.t_end, self.steps, self.stored, self.asked
        return Problem(body, q, V @ q, load, *grid, before=self.before)


class Outcome(NamedTuple):
    """The stored states of all members, NaN from where one has failed, and what was watched."""

    quaternion: Array  # (m, k, 4) scalar last
    velocity: Array  # (m, k, 3) W
    normal: Array | None  # (m, k, 3, 3) symmetric part of the director velocities, None where there is none
    watched: Array | None  # (m, 4, COLUMNS): at first, least, greatest, integral over time
    failures: Array  # (m, 4): status, step, residual, turn
    reasons: dict[int, str] = {}  # noqa: RUF012 - of members whose load failed


def in_threads(
    task: Callable[[int, int], None], span: tuple[int, int], size: int, threads: int, report: Callable[[int], None]
) -> None:
    """Call ``task(first, last)`` for blocks of `size` of a span of members; ``report(members)`` after each.

    What it writes must have a place of its own for each member. The first exception stops what has not begun.
    """
    spans = [(k, min(k + size, span[1])) for k in range(*span, size)]
    if threads == 1 or len(spans) == 1:
        for first, last in spans:
            task(first, last)
            report(last - first)
        return
    pool = ThreadPoolExecutor(threads)
    try:
        futures = [pool.submit(task, *span) for span in spans]
        for future, (first, last) in zip(futures, spans, strict=True):
            future.result()
            report(last - first)
    finally:
        pool.shutdown(cancel_futures=True)


def progress(ensemble: Ensemble, rounds: int = 1) -> Callable[[int], None]:
    """Return what adds up members that are done and tells `ensemble` the part, when each is marched in `rounds`."""
    done = 0

    def report(members: int) -> None:
        nonlocal done
        done += members
        if ensemble.progress:
            ensemble.progress(done / (rounds * len(ensemble)))

    return report


def nothing(ensemble: Ensemble) -> Outcome:
    """Return an outcome with room for all states, NaN but for the start."""
    m, k = len(ensemble), len(ensemble.output)
    quaternion, velocity = np.full((m, k, 4), np.nan), np.full((m, k, 3), np.nan)
    quaternion[:, 0], velocity[:, 0] = ensemble.quaternion, ensemble.velocity
    return Outcome(quaternion, velocity, None, None, np.zeros((m, 4)))
