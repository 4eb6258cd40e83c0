"""An ensemble one member after the other: what no integrator does faster together. The same results, 0.1 ms a member.

Threads help where a member takes much longer than that; they do not where its load is a Python function.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..analysis.reductions import of_run
from ..analysis.trajectory import Trajectory
from ..integrators import Integrator
from ..integrators.base import March, Problem
from ..integrators.ensemble import COLUMNS, Ensemble, Outcome, in_threads, nothing, progress
from . import completion
from .grid import stored_steps

BLOCK = 16


def march(scheme: Integrator, ensemble: Ensemble, threads: int) -> Outcome:
    """Integrate every member by itself."""
    out, reasons = nothing(ensemble), dict[int, str]()
    if ensemble.watched:
        out = out._replace(watched=np.full((len(ensemble), 4, COLUMNS), np.nan))

    def block(first: int, last: int) -> None:
        for i in range(first, last):
            problem = ensemble.member(i)
            if ensemble.watched:
                problem = replace(problem, stored=stored_steps(problem.steps, 1))
            result = completion.march(scheme, problem)
            _write(out, i, result, ensemble.stored if ensemble.watched else None)
            if result.failure is not None:
                reasons[i] = result.failure.reason
                out.failures[i] = result.failure[:4]
            elif out.watched is not None:
                out.watched[i] = of_run(_trajectory(scheme, problem, result), getattr(scheme, "order", 2))

    in_threads(block, (0, len(ensemble)), BLOCK, threads, progress(ensemble))
    return out._replace(reasons=reasons)


def _write(out: Outcome, i: int, result: March, kept: NDArray[np.int64] | None) -> None:
    """Write the states of a member, those of the steps `kept` where all are there."""
    from scipy.spatial.transform import Rotation

    q, v = result.directors, result.velocities
    if kept is not None:
        there = kept[kept < len(q)]
        q, v = q[there], v[there]
    n = len(q)
    p = Rotation.from_matrix(q.swapaxes(1, 2)).as_quat()
    for k in range(n):
        before = out.quaternion[i, max(k - 1, 0)]
        p[k] *= -1.0 if before @ p[k] < 0 else 1.0
        out.quaternion[i, k] = p[k]
    V = v @ q.swapaxes(1, 2)
    out.velocity[i, :n] = np.stack([V[:, 1, 2] - V[:, 2, 1], V[:, 2, 0] - V[:, 0, 2], V[:, 0, 1] - V[:, 1, 0]], 1) / 2
    out.quaternion[i, n:] = out.velocity[i, n:] = np.nan


def _trajectory(scheme: Integrator, problem: Problem, result: March) -> Trajectory:
    return Trajectory(problem.system, scheme, problem.step, [], problem.output, *result[:6])
