"""From a plan and a start to a run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..analysis.trajectory import Trajectory
from ..geometry.compiled import interruptible
from ..integrators import Problem, SimulationError, SimulationInterrupt, Status
from ..integrators.base import Outcome
from . import completion, costs
from .grid import TURN, automatic_count, refined_count, stored_count
from .notices import announce, failure_message, progress_bar, warn_of_cost, warn_of_grid
from .planning import Plan
from .starts import Starts


def run_of(plan: Plan, begin: Starts, progress: bool = False) -> Trajectory:
    """Return the run that a start makes of a plan, with the step of the plan or one that is chosen for the start.

    Raises
    ------
    ValueError, SimulationError, SimulationInterrupt
        As `nontwist.simulate`.
    """
    load, t0, t1 = plan.load, plan.t_start, plan.t_end
    if load.terms and plan.scheme.is_compiled:
        warn_of_cost(load)

    def announced(N: int, states: int) -> None:
        whole = plan.problem(begin, N, np.array([0, N]))
        announce(costs.run_cost(plan.scheme, whole, states), plan.scheme, whole)

    if plan.asked is not None:
        announced(1, len(plan.asked))
        return marched(plan, begin, 1)
    if plan.steps is not None:
        announced(plan.steps, stored_count(plan.steps, plan.store))
        warn_of_grid(load, t0, t1, plan.steps)
        return marched(plan, begin, plan.steps, progress)
    N = automatic_count(plan.systems, begin.velocity, load, t0, t1)
    announced(N, stored_count(N, plan.store))
    while True:
        try:
            run = marched(plan, begin, N, progress)
        except SimulationError as error:
            if error.status not in (Status.TURN, Status.STALLED):
                raise
            N = refined_count(4 * N, load, t0, t1)
            continue
        fastest = float(np.sqrt(np.square(run.material_angular_velocity).sum(axis=1)).max())
        turn = fastest * (t1 - t0) / N
        if turn <= TURN * (1 + 1e-9):
            warn_of_grid(load, t0, t1, N)
            return run
        N = refined_count(1.02 * N * turn / TURN, load, t0, t1)


def marched(plan: Plan, begin: Starts, steps: int, progress: bool = False) -> Trajectory:
    """Return the run of so many steps."""
    problem = replace(plan.problem(begin, steps), intervals=True)
    if not progress:
        with interruptible():
            return trajectory(plan, problem, completion.march(plan.scheme, problem))
    with progress_bar(steps) as report, interruptible():
        problem = replace(problem, progress=report)
        return trajectory(plan, problem, completion.march(plan.scheme, problem))


def trajectory(plan: Plan, problem: Problem, outcome: Outcome) -> Trajectory:
    """Return the run that has come out; an error that holds it where it has failed."""
    failure, good, h = outcome.failure(), int(outcome.good[0]), problem.step
    time = problem.output[:good]
    if outcome.end is not None:
        time = np.append(time[:-1], problem.times(outcome.end))
    message = "done" if failure is None else failure_message(problem, failure)
    assert outcome.intervals is not None
    multipliers, moment, work, iterations = outcome.intervals
    means = slice(max(good - 1, 0))
    run = Trajectory(
        problem.system,
        plan.scheme,
        h if problem.asked is None else None,
        problem.load.description,
        time,
        outcome.states.part(0, slice(good)),
        multipliers[0, means],
        moment[0, means],
        work[0, means],
        None if iterations is None else iterations[0, means],
        int(failure.status) if failure else 0,
        message,
        None if outcome.memory is None else outcome.memory[0],
        None if problem.before is None else problem.before.origin,
    )
    if failure is None:
        return run
    if failure.status is Status.INTERRUPTED:
        raise SimulationInterrupt(message, run)
    raise SimulationError(message, int(failure.status), problem.began(failure.step), h, failure.residual, run)
