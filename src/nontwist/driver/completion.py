"""The one check that every run, every member of an ensemble and so every block of a sweep passes.

Status 0 means: t_end reached, times increasing, every number finite, those of the dataset that follow from the states
included. What fails the check is a failed run; what was good before is kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from ..analysis import ensemble_dataset
from ..analysis.trajectory import state_dataset
from ..geometry.arrays import Array
from ..integrators import Integrator, Status
from ..integrators.base import Failure, March, Problem
from ..integrators.ensemble import FIRST, WATCHED, Ensemble, Outcome
from ..integrators.time_grid import OnGrid
from ..models.stack import SystemStack
from .grid import require_resolution

SAFE = 1e300  # sum of squares of all numbers, times the inertia, up to which no observable overflows
OVERFLOW = (
    "the variable {} is not finite at the end of it; choose units of time, length and mass in which the numbers of the "
    "run are nearer to 1"
)
LOST = "the integrator returned {} of {} states, which is a defect of it; take another integrator"
NOT_INCREASING = "the output times do not increase up to t_end"
COLUMN_NAMES = np.repeat(list(WATCHED), list(WATCHED.values()))


def march(scheme: Integrator, problem: Problem) -> March:
    """Integrate `problem` and check what comes out.

    Raises
    ------
    ValueError
        As the integrator; the steps are below the resolution of the times.
    """
    require_resolution(problem.t_start, problem.t_end, problem.steps)
    result = scheme.march(problem)
    bad = _first_bad(problem, result)
    if bad is not None:
        good, name = bad
        return _cut(result, good, result.failure or _failed(problem, good, Status.NOT_FINITE, OVERFLOW.format(name)))
    if result.failure is not None:
        return result
    found, wanted = len(result.directors), len(problem.output)
    if found != wanted:
        return result._replace(failure=_failed(problem, found, Status.INCOMPLETE, LOST.format(found, wanted)))
    if not _increases(problem):
        return _cut(result, 1, _failed(problem, 1, Status.INCOMPLETE, NOT_INCREASING))
    return result


def verified(ensemble: Ensemble, outcome: Outcome) -> Outcome:
    """Return `outcome` with the members that fail the check marked as failed, their numbers NaN from there."""
    reasons = dict(outcome.reasons)
    for i, good, (status, step, residual, turn, reason) in _failed_members(ensemble, outcome):
        outcome.failures[i], reasons[i] = (status, step, residual, turn), reason
        for states in (outcome.quaternion, outcome.velocity, outcome.normal):
            if states is not None:
                states[i, good:] = np.nan
        if outcome.watched is not None:
            outcome.watched[i] = np.nan
    return outcome._replace(reasons=reasons)


def _increases(grid: OnGrid) -> bool:
    times = grid.output
    return bool(times[-1] == grid.t_end and (times[1:] > times[:-1]).all())


def _failed(grid: OnGrid, good: int, status: Status, reason: str) -> Failure:
    """Return the failure of the step, or after the asked time, that follows `good` states."""
    last = good - 1 if grid.asked is not None else int(grid.stored[max(good - 1, 0)])
    return Failure(status, last, np.nan, np.nan, reason)


def _cut(result: March, good: int, failure: Failure) -> March:
    """Return the first `good` states of a march."""
    n = max(good - 1, 0)
    iterations = None if result.newton_iterations is None else result.newton_iterations[:n]
    intervals = result.multipliers[:n], result.moment[:n], result.load_work[:n], iterations
    return March(result.directors[:good], result.velocities[:good], *intervals, failure)


def _first_bad(problem: Problem, result: March) -> tuple[int, str] | None:
    """Return how many states are good and the variable that ends them; None where all numbers are finite."""
    system, (q, v, multipliers, moment, work) = problem.system, result[:5]
    squares = [float(np.vdot(array, array)) for array in (v, q, multipliers, moment, work)]
    if sum(squares) < SAFE and squares[0] * float(abs(system.euler_inertia).max()) < SAFE:
        return None
    states = {"directors": q, "director_velocities": v}
    intervals = {"multipliers": multipliers, "moment": moment, "load_work": work}
    found = [*_ends(states), *((good + 1, name) for good, name in _ends(intervals))]
    n = min(good for good, _ in found) if found else len(q)
    with np.errstate(all="ignore"):
        observables = state_dataset(system, problem.output[:n], q[:n], v[:n])
    found += _ends({str(name): variable.values for name, variable in observables.data_vars.items()})
    return min(found, key=itemgetter(0), default=None)


def _ends(arrays: dict[str, Array]) -> Iterator[tuple[int, str]]:
    """Yield how many rows come before the first that is not finite, and the name, of arrays with such a row."""
    for name, array in arrays.items():
        finite = np.isfinite(array).reshape(len(array), -1).all(axis=1)
        if not finite.all():
            yield int(finite.argmin()), name


def _failed_members(ensemble: Ensemble, outcome: Outcome) -> Iterator[tuple[int, int, Failure]]:
    """Yield members that are said to be done and are not, how many of their states are good, and the failure."""
    done = outcome.failures[:, 0] == Status.OK
    if not _increases(ensemble):
        failure = _failed(ensemble, 1, Status.INCOMPLETE, NOT_INCREASING)
        yield from ((i, 1, failure) for i in np.flatnonzero(done).tolist())
        return
    for i in np.flatnonzero(done & ~_is_safe(ensemble, outcome)).tolist():
        if found := list(_ends_of_member(ensemble, outcome, i)):
            good, name = min(found, key=itemgetter(0))
            yield i, good, _failed(ensemble, good, Status.NOT_FINITE, OVERFLOW.format(name))
        elif outcome.watched is not None and (column := np.flatnonzero(~_finite_columns(ensemble, outcome)[i])).size:
            name = str(COLUMN_NAMES[column[0]])
            yield i, 1, _failed(ensemble, 1, Status.NOT_FINITE, OVERFLOW.format(name))


def _is_safe(ensemble: Ensemble, outcome: Outcome) -> NDArray[np.bool_]:
    """Whether nothing of a member can overflow, (m,), or of all, (1,)."""
    arrays = [array for array in outcome[:3] if array is not None]
    E = np.maximum(abs(ensemble.systems.euler_inertia).max(axis=(1, 2)), 1.0)
    safe: NDArray[np.bool_] = np.ones(1, dtype=bool)
    if not sum(float(np.vdot(array, array)) for array in arrays) * E.max() < SAFE:
        with np.errstate(all="ignore"):
            squares = [np.square(array).reshape(len(ensemble), -1).sum(axis=1) for array in arrays]
            safe = np.array(E * np.sum(squares, axis=0) < SAFE, dtype=bool)
    return safe if outcome.watched is None else np.logical_and(safe, _finite_columns(ensemble, outcome).all(axis=1))


def _finite_columns(ensemble: Ensemble, outcome: Outcome) -> NDArray[np.bool_]:
    """Whether what was watched is finite, (m, COLUMNS); a reaction moment has no first value, a free body none."""
    assert outcome.watched is not None
    finite = np.isfinite(outcome.watched)
    finite[:, FIRST, -1] = True
    if ensemble.systems.axis is None:
        finite[:, :, -1] = True
    return np.asarray(finite.all(axis=1), dtype=np.bool_)


def _ends_of_member(ensemble: Ensemble, outcome: Outcome, i: int) -> Iterator[tuple[int, str]]:
    one = slice(i, i + 1)
    yield from _ends({"quaternion": outcome.quaternion[i], "material_angular_velocity": outcome.velocity[i]})
    normal = None if outcome.normal is None else outcome.normal[one]
    member = outcome._replace(quaternion=outcome.quaternion[one], velocity=outcome.velocity[one], normal=normal)
    body = SystemStack.of([ensemble.systems[i if len(ensemble.systems) > 1 else 0]])
    with np.errstate(all="ignore"):
        states = ensemble_dataset.states(ensemble_dataset.NODES, body, member)
    yield from _ends({name: array[0] for name, array in states.items()})
