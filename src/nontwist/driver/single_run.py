"""One run: from a plan and a start to a trajectory, with a step that is given or chosen."""

from __future__ import annotations

import warnings
from contextlib import nullcontext
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from ..analysis.trajectory import Trajectory
from ..geometry.compiled import interruptible
from ..integrators import Problem, SimulationError, SimulationInterrupt, Status, stack_march
from ..integrators.base import Outcome
from ..integrators.time_grid import Stretches
from . import completion, costs, event_runs
from .coarseness import coarseness, fastest_of, is_fine
from .event_runs import Ended
from .events import Event
from .grid import TURN, automatic_grid, require_resolution, rest_of, stored_count, stretches_of
from .notices import announce, callers_level, failure_message, progress_bar, warn_of_cost, warn_of_grid, warn_of_step
from .planning import Plan
from .starts import Starts
from .tolerance import controlled, first_grid

CACHED_NODES = 2**12  # at most, of a plan whose preparation is cached
AT_REST = Starts(np.array([[0.0, 0.0, 0.0, 1.0]]), np.zeros((1, 3)))


class PreparedPlan:
    """A plan with its grid laid out and its load sampled, ready for starts."""

    def __init__(self, plan: Plan, grid: Stretches) -> None:
        problem = replace(plan.problem(AT_REST, grid), intervals=True)
        self._march, self._terms, body = plan.scheme.prepared(problem), plan.load.description, plan.systems[0]
        self._damped = bool(plan.load.damping.any())  # which is scaled when it is laid out
        self._safe = completion.SAFE / max(1.0, float(abs(body.euler_inertia).max()))
        self._known = {
            "system": body,
            "integrator": plan.scheme,
            "stretches": None if problem.off_grid else problem.grid,
            "load": self._terms,
            "time": problem.output,
        }

    @staticmethod
    def accepts(plan: Plan, grid: Stretches, most: int | None = None) -> bool:
        """Whether a plan can be prepared, and has nodes and outputs of one part, or at most `most`."""
        nodes = max(grid.steps * getattr(plan.scheme, "nodes", 1), 0 if plan.asked is None else len(plan.asked))
        return plan.scheme.can_prepare(plan.load) and nodes <= min(stack_march.NODES, most or stack_march.NODES)

    def run(self, p: Any, W: Any, scale: float) -> Trajectory | None:
        """Return the run from the quaternion `p`, scalar last, and W; None where it fails or is not prepared."""
        if scale != 1 and self._damped:
            return None
        found, squares = self._march(p, W, scale)
        if not squares < self._safe:
            return None
        known = self._known
        if scale != 1:
            known = known | {"load": [term | {"scale": scale * term["scale"]} for term in self._terms]}
        return Trajectory._later(known, partial(self._march.read, found))


@lru_cache(maxsize=16)
def preparations(plan: Plan, grid: Stretches) -> list[PreparedPlan | None]:
    """Return the cached preparation of a plan: empty for a new plan, as preparing pays off from the second run on."""
    return []


def run_of(
    plan: Plan,
    begin: Starts,
    progress: bool = False,
    estimate: Stretches | None = None,
    events: tuple[Event, ...] = (),
) -> Trajectory:
    """Return the run of a plan from a start, with the step of the plan or one that is chosen for the start.

    The steps are those of the run without output times and events. `estimate` is the grid to try first where the plan
    has none, if it is known already.

    Raises
    ------
    ValueError, SimulationError, SimulationInterrupt
        As `nontwist.simulate`.
    """
    if plan.grid is None and (events or plan.asked is not None):
        steps = _chosen(plan, begin, estimate)
        assert steps.stretches is not None
        own = plan._replace(scheme=steps.integrator)
        run = integrated(own, begin, steps.stretches, progress, events)
        return replace(run, tolerance=steps.tolerance, error_estimate=steps.error_estimate, warning=steps.warning)
    if plan.grid is not None:
        check_cost(plan, begin, plan.grid)
        return with_warning(plan, begin, integrated(plan, begin, plan.grid, progress, events))
    if plan.is_controlled:
        return controlled_run(plan, begin, progress)
    load, t0, t1 = plan.load, plan.t_start, plan.t_end
    grid = rest_of(begin.grid, load, t0, t1) or estimate
    grid = grid or automatic_grid(plan.systems, begin.velocity, load, t0, t1, begin.load_scale)
    check_cost(plan, begin, grid)
    while True:
        try:
            run = integrated(plan, begin, grid, progress)
        except SimulationError as error:
            if error.status not in (Status.TURN, Status.STALLED):
                raise
            grid = stretches_of(load, t0, t1, grid.longest / 4)
            continue
        fastest = float(np.sqrt(np.square(run.material_angular_velocity).sum(axis=1)).max())
        turn = fastest * grid.longest
        if turn <= TURN * (1 + 1e-9):
            warn_of_grid(load, t0, t1, grid)
            return with_warning(plan, begin, run)
        grid = stretches_of(load, t0, t1, grid.longest * TURN / (1.02 * turn))


def with_warning(plan: Plan, begin: Starts, run: Trajectory) -> Trajectory:
    """Return a run, with a warning where its step is too coarse."""
    fastest, grid = fastest_of(run.material_angular_velocity), run.stretches
    if grid is None or is_fine(plan.scheme, grid.longest, plan.t_end - plan.t_start, fastest):
        return run
    whole = plan.problem(begin, grid, np.array([0, grid.steps]))
    text = coarseness(plan.scheme, whole, fastest)
    if text is None:
        return run
    warnings.warn(text, UserWarning, stacklevel=callers_level())
    return replace(run, warning=text)


def controlled_run(plan: Plan, begin: Starts, progress: bool = False) -> Trajectory:
    """Return the run of a plan with a tolerance."""
    scheme, grid = first_grid(plan, begin)
    check_cost(plan._replace(scheme=scheme), begin, grid)
    with progress_bar(1, "runs") if progress else nullcontext() as report, interruptible():
        found = controlled(plan, begin, intervals=True, progress=report)
    warn_of_grid(plan.load, plan.t_start, plan.t_end, found.problem.grid)
    run = trajectory(plan._replace(scheme=found.scheme), found.problem, found.outcome)
    return replace(run, tolerance=found.tolerance, error_estimate=found.estimate)


def _chosen(plan: Plan, begin: Starts, estimate: Stretches | None) -> Trajectory:
    """Return the run whose steps are those of a plan with output times or events, as far as it comes."""
    try:
        return run_of(plan._replace(asked=None), begin, estimate=estimate)
    except SimulationError as error:
        if error.partial is None:
            raise
        run: Trajectory = error.partial
        return run


def check_cost(plan: Plan, begin: Starts, grid: Stretches) -> None:
    """Refuse runs that exceed the memory; warn of long runs, of slow loads, and of a given step off the breakpoints."""
    scheme, load = plan.scheme, plan.load
    if load.terms and scheme.is_compiled:
        warn_of_cost(load)
    states = len(plan.asked) if plan.asked is not None else stored_count(grid.steps, plan.store)
    whole = plan.problem(begin, grid, np.array([0, grid.steps]))
    announce(costs.run_cost(scheme, whole, states), scheme, whole)
    if not plan.off_grid and plan.grid is not None:
        warn_of_grid(load, plan.t_start, plan.t_end, grid)
    warn_of_step(scheme, whole)


def integrated(
    plan: Plan, begin: Starts, grid: Stretches, progress: bool = False, events: tuple[Event, ...] = ()
) -> Trajectory:
    """Return the run on a grid."""
    if events:
        problem = replace(plan.problem(begin, grid), intervals=True)
        with interruptible():
            found = event_runs.march(plan.scheme, problem, events)
        return trajectory(plan, replace(problem, asked=found.times), found.outcome, found)
    is_new = begin.memory is None and begin.normal is None and begin.grid is None
    is_new = is_new and not progress and plan.asked is None and PreparedPlan.accepts(plan, grid, CACHED_NODES)
    if is_new and not (cached := preparations(plan, grid)):
        cached.append(None)
    elif is_new:
        require_resolution(plan.t_start, plan.t_end, grid)
        prepared = cached[0] = cached[0] or PreparedPlan(plan, grid)
        run = prepared.run(begin.quaternion[0], begin.velocity[0].tolist(), float(begin.load_scale[0]))
        if run is not None:
            return run
    problem = replace(plan.problem(begin, grid), intervals=True)
    if not progress:
        with interruptible():
            return trajectory(plan, problem, completion.march(plan.scheme, problem))
    with progress_bar(grid.steps) as report, interruptible():
        problem = replace(problem, progress=report)
        return trajectory(plan, problem, completion.march(plan.scheme, problem))


def trajectory(plan: Plan, problem: Problem, outcome: Outcome, ended: Ended | None = None) -> Trajectory:
    """Return the run of an outcome; raise an error that holds the partial run where it has failed."""
    failure, good = outcome.failure(), int(outcome.good[0])
    time = problem.output[:good]
    if outcome.end is not None:
        time = np.append(time[:-1], problem.times(outcome.end))
    message = failure_message(problem, failure) if failure is not None else (ended and ended.message) or "done"
    assert outcome.intervals is not None
    multipliers, moment, work, iterations = outcome.intervals
    means = slice(max(good - 1, 0))
    run = Trajectory(
        problem.system,
        plan.scheme,
        None if problem.off_grid else problem.grid,
        problem.member(0).load.description,
        time,
        outcome.states.part(0, slice(good)),
        multipliers[0, means],
        moment[0, means],
        work[0, means],
        None if iterations is None else iterations[0, means],
        int(failure.status) if failure else 0,
        message,
        None if outcome.memory is None else outcome.memory[0],
        events=ended and ended.events,
    )
    if failure is None:
        return run
    if failure.status is Status.INTERRUPTED:
        raise SimulationInterrupt(message, run)
    h = problem.step_at(failure.step)
    raise SimulationError(message, int(failure.status), problem.began(failure.step), h, failure.residual, run)
