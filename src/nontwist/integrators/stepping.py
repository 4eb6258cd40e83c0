"""A march of one body from its single step, for integrators written in Python."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..geometry.arrays import Array
from .problem import Failure, March, Problem, Status

ORTHONORMAL = 1e-9


class Step(NamedTuple):
    """One step of a scheme."""

    directors: Array
    velocities: Array
    multipliers: Array
    moment: Array
    load_work: float
    newton_iterations: int
    failure: Failure | None


def march(problem: Problem, constraints: int, step: Callable[[int, Array, Array], Step], precision: Any) -> March:
    """Repeat ``step(k, directors, velocities)`` over the grid, with states in `precision`; return the stored ones."""
    q, v, stored = problem.directors.astype(precision), problem.velocities.astype(precision), problem.stored
    directors, velocities = np.empty((len(stored), 3, 3)), np.empty((len(stored), 3, 3))
    directors[0], velocities[0] = q, v
    n = len(stored) - 1
    multipliers, moment = np.zeros((n, constraints)), np.zeros((n, 3))
    work, iterations, lengths = np.zeros(n), np.zeros(n, dtype=np.int64), np.diff(problem.output)
    done, failure = 0, None
    try:
        for k in range(problem.steps):
            one = step(k, q, v)
            failure = one.failure or _broken(k, one.directors)
            if failure:
                break
            q, v = one.directors, one.velocities
            part = problem.step_at(k) / lengths[done]
            multipliers[done] += part * one.multipliers
            moment[done] += part * one.moment
            work[done] += one.load_work
            iterations[done] = max(iterations[done], one.newton_iterations)
            if k + 1 == stored[done + 1]:
                directors[done + 1], velocities[done + 1] = q, v
                done += 1
            if problem.progress:
                problem.progress((k + 1) / problem.steps)
    except KeyboardInterrupt as stop:
        failure = Failure(Status.INTERRUPTED, int(stored[done]), np.nan, np.nan, str(stop))
    return March(
        directors[: done + 1],
        velocities[: done + 1],
        multipliers[:done],
        moment[:done],
        work[:done],
        iterations[:done],
        failure,
    )


def _broken(k: int, q: Array) -> Failure | None:
    defect = float(abs(q @ q.T - np.eye(3)).max())
    if defect <= ORTHONORMAL and np.linalg.det(q.astype(float)) > 0:
        return None
    return Failure(Status.BROKEN, k, defect, np.nan)
