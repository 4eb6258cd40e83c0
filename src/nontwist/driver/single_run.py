"""One run: from a plan and a start to a trajectory, with a step that is given or chosen.

A problem made ready to run, once: check, forecast, run and every block of a sweep use the same `Prepared`.
"""

from __future__ import annotations

import math
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from ..analysis.trajectory import Trajectory
from ..errors import warn
from ..geometry.arrays import Array
from ..geometry.attitudes import States
from ..integrators import DEFAULT, IVP, Integrator, SimulationError, SimulationInterrupt, Status, stack_march
from ..integrators.base import Outcome
from ..integrators.compiled import Compiled
from ..integrators.costs import swing_rate
from ..integrators.problem import Intervals, Stretches, stretched
from ..loads import Load
from . import completion, notices
from .contacts import refusal
from .events import Ended, Event, march_to_events
from .grid import TURN, even_step, load_messages, require_resolution, rest_of, stored_count, stretches_of
from .notices import (
    announce,
    coarseness,
    failure_message,
    phase_error,
    progress_bar,
    say,
    unremarkable,
    warn_of_cost,
    warn_of_grid,
)
from .planning import Plan, resolve_integrator
from .starts import AT_REST, Starts
from .tolerance import First, apart_shown, controlled, finer, first_run

CACHED_NODES = 2**13  # at most, of a plan whose preparation is cached


class PreparedPlan:
    """A plan with its grid laid out and its load sampled, ready for starts."""

    def __init__(self, plan: Plan, grid: Stretches) -> None:
        problem = replace(plan.problem(AT_REST, grid), intervals=True)
        self._march, self._terms, body = plan.scheme.prepared(problem), plan.load.description, plan.systems[0]
        # Damping and linear potentials are scaled when they are laid out: another factor needs another preparation.
        linear = any(term.dead_force is not None for term in plan.load.potentials)
        self.is_damped, self._held = bool(plan.load.damping.any()) or linear, held_by(plan.load)
        self.whole, self.is_quiet = whole_of(plan, grid), False  # whether there is nothing to say of its costs
        self.increases = completion.increases(problem)
        self.unremarkable = unremarkable(plan.scheme, grid.longest, plan.t_end - plan.t_start)
        self._safe = completion.SAFE / max(1.0, float(abs(body.euler_inertia).max()))
        self._known = {
            "system": body,
            "integrator": plan.scheme,
            "stretches": None if problem.off_grid else problem.grid,
            "load": self._terms,
            "time": problem.stored_times,
            "potentials": self._held,
        }

    @staticmethod
    def accepts(plan: Plan, grid: Stretches, most: int | None = None) -> bool:
        """Whether a plan can be prepared, and has nodes of one part; where `most` is given, no more to keep."""
        nodes, is_plain = grid.steps * plan.scheme.nodes, plan.scheme.can_prepare(plan.load)
        if not is_plain or nodes > stack_march.NODES or plan.load.wheels or plan.systems.spin is not None:
            return False  # with wheels or a spin, the march begins with another velocity than the start
        return max(nodes if plan.load.terms else 1, plan.states(grid)) <= (most or stack_march.NODES)

    def states(self, p: Any, W: Any, scale: float) -> States | None:
        """Return the states of `run`, in memory that the next call of this thread overwrites; None as there."""
        _, squares, _ = self._march(p, W, scale)
        march: Any = self._march
        return march.states if squares < self._safe else None

    def run(self, p: Any, W: Any, scale: float) -> Trajectory | None:
        """Return the run from the quaternion `p`, scalar last, and W; None where it fails or is not prepared."""
        if scale != 1 and self.is_damped:
            return None
        found, squares, fastest = self._march(p, W, scale)
        if not squares < self._safe:
            return None
        run = Trajectory._later(self._known, partial(self._march.read, found))
        vars(run)["_fastest"] = sqrt(fastest)
        if scale != 1:
            load = [term | {"scale": scale * term["scale"]} for term in self._terms]
            vars(run).update(load=load, potentials=self._held and scale * self._held)
        return run


def whole_of(plan: Plan, grid: Stretches) -> IVP:
    """Return the problem of a plan at rest, the first and the last state stored."""
    return plan.problem(AT_REST, grid, np.array([0, grid.steps]))


def held_by(load: Load) -> Load | None:
    """Return the potentials of a load, None where it has none."""
    return Load(load.potentials) if load.potentials else None


@lru_cache(maxsize=16)
def _cached(plan: Plan, grid: Stretches) -> PreparedPlan:
    require_resolution(plan.t_start, plan.t_end, grid)
    return PreparedPlan(plan, grid)


def known(
    plan: Plan, begin: Starts, grid: Stretches, progress: bool = False, events: tuple[Event, ...] = ()
) -> PreparedPlan | None:
    """Return the prepared plan of a run that is so plain and small that it is kept; None for others."""
    is_plain = begin.memory is None and begin.normal is None and begin.grid is None and plan.output_times is None
    is_small = is_plain and not progress and not events and PreparedPlan.accepts(plan, grid, CACHED_NODES)
    return prepared if is_small and (prepared := _cached(plan, grid)).increases else None


def run_of(
    plan: Plan,
    begin: Starts,
    progress: bool = False,
    events: tuple[Event, ...] = (),
) -> Trajectory:
    """Return the run of a plan from a start, with the step of the plan or one that is chosen for the start.

    The steps are those of the run without output times and events.

    Raises
    ------
    ValueError, SimulationError, SimulationInterrupt
        As `nontwist.simulate`.
    """
    if plan.grid is None and (events or (plan.output_times is not None and not plan.is_controlled)):
        shows = "nothing" if plan.scheme.has_series(plan.systems, plan.load) else plan.shows
        try:
            steps = run_of(plan._replace(output_times=None, shows=shows), begin)
        except SimulationError as error:
            if error.partial is None:
                raise
            steps = error.partial  # as far as it comes
        assert steps.stretches is not None
        own = plan._replace(scheme=steps.integrator)
        if plan.output_times is None and plan.is_between:
            swing = swing_rate(plan.systems, plan.linearised(begin).load, begin.load_scale)
            own = own._replace(output_times=times_shown(plan, begin, steps.material_angular_velocity, swing))
        run = integrated(own, begin, steps.stretches, progress, events)
        return replace(run, tolerance=steps.tolerance, error_estimate=steps.error_estimate, warning=steps.warning)
    if plan.grid is not None:
        prepared = known(plan, begin, plan.grid, progress, events)
        if not (prepared and prepared.is_quiet):
            is_quiet = check_cost(plan, begin, plan.grid)
            if prepared:
                prepared.is_quiet = is_quiet
        return with_warning(plan, integrated(plan, begin, plan.grid, progress, events, prepared), prepared)
    if plan.is_controlled:
        return controlled_run(plan, begin, progress)
    load, t0, t1 = plan.grid_load, plan.t_start, plan.t_end
    grid = rest_of(begin.grid, load, t0, t1) or plan.automatic(begin)
    check_cost(plan, begin, grid)
    while True:
        try:
            run = integrated(plan, begin, grid, progress, (), known(plan, begin, grid, progress))
        except SimulationError as error:
            if error.status not in (Status.TURN, Status.STALLED):
                raise
            grid = plan.automatic(begin, grid.longest / 4)
            continue
        fastest = float(np.sqrt(np.square(run.material_angular_velocity).sum(axis=1)).max())
        turn = fastest * grid.longest
        if turn <= TURN * (1 + 1e-9):
            warn_of_grid(plan.load, plan.systems, t0, t1, grid)
            return with_warning(plan, run)
        grid = plan.automatic(begin, grid.longest * TURN / (1.02 * turn))


def with_warning(plan: Plan, run: Trajectory, prepared: PreparedPlan | None = None, known: float = 0.0) -> Trajectory:
    """Return a run, with a warning where its step is too coarse.

    Of speeds up to `known`, rad/s, only the run itself tells.
    """
    grid = run.stretches
    if grid is None:
        return run
    quiet = prepared.unremarkable if prepared else unremarkable(plan.scheme, grid.longest, plan.t_end - plan.t_start)
    if run._fastest <= quiet:
        return run
    text = coarseness(plan.scheme, prepared.whole if prepared else whole_of(plan, grid), run._fastest)
    if text is None:
        if prepared:
            prepared.unremarkable = run._fastest  # there is nothing to say of slower runs either
        return run
    if run._fastest > known:
        warn(text)
    return run._warned(text)


def controlled_run(plan: Plan, begin: Starts, progress: bool = False) -> Trajectory:
    """Return the run of a plan with a tolerance; where it has output times, its steps are those without them."""
    has_times, own = plan.is_between or plan.output_times is not None, plan
    if has_times:
        has_series = plan.scheme.has_series(plan.systems, plan.load)
        own = plan._replace(output_times=None, store=1, shows="nothing" if has_series else plan.shows)
    first, states = first_of(plan, begin)
    check_cost(own._replace(scheme=first.scheme), begin, finer(first.grid), states)
    with progress_bar(1, "runs") if progress else nullcontext() as report:
        found, goal, estimate = controlled(own, begin, first=first, intervals=plan.means, progress=report)
    own, problem, outcome = own._replace(scheme=found.scheme), found.problem, found.outcome
    warn_of_grid(plan.load, plan.systems, plan.t_start, plan.t_end, problem.grid)
    if has_times and outcome.failures[0, 0] != Status.INTERRUPTED:
        if (times := plan.output_times) is None:
            times = times_shown(plan, begin, outcome.states.velocity[0], first.swing)
        nodes = None if plan.load.wheels or outcome.failures[0, 0] else outcome.march
        problem = own._replace(output_times=times).problem(begin, problem.grid)
        outcome = completion.march(found.scheme, replace(problem, intervals=plan.means, marched=nodes))
    run = trajectory(own, problem, outcome)
    return replace(run, tolerance=goal, error_estimate=estimate)


def first_of(plan: Plan, begin: Starts) -> tuple[First, int]:
    """Return what the run of a plan with a tolerance begins with, and how many states it stores, about."""
    fastest = plan.fastest(begin)
    is_long = plan.is_between or (plan.output_times is not None and plan.scheme.has_series(plan.systems, plan.load))
    first = first_run(plan._replace(shows="nothing") if is_long else plan, begin, fastest)
    if plan.output_times is not None:
        return first, len(plan.output_times)
    shown = finer(first.grid).steps
    if plan.is_between:
        shown = int((plan.t_end - plan.t_start) / apart_shown(plan, fastest, first.swing))
    return first, stored_count(max(1, shown), plan.store)


def times_shown(plan: Plan, begin: Starts, velocities: Array, swing: float) -> Array:
    """Return the times at which states are stored that nobody has chosen: it turns by 0.05 rad at most in between."""
    fastest = float(np.sqrt(np.nanmax(np.square(velocities).sum(axis=1))))
    longest = apart_shown(plan, fastest, swing)
    return plan.problem(begin, stretches_of(plan.grid_load, plan.t_start, plan.t_end, longest)).stored_times


def check_cost(plan: Plan, begin: Starts, grid: Stretches, states: int | None = None) -> bool:
    """Refuse runs that exceed the memory; warn of long runs, of slow loads, and of a given step off the breakpoints.

    Return whether nothing was said. `states` is how many are stored, if not those of the grid.
    """
    scheme, load = plan.scheme, plan.load
    is_quiet = not (load.terms and scheme.is_compiled) or warn_of_cost(load)
    whole = plan.problem(begin, grid, np.array([0, grid.steps]))
    is_quiet &= announce(notices.run_cost(scheme, whole, states or plan.states(grid)), scheme, whole)
    if not plan.off_grid and plan.grid is not None:
        is_quiet &= warn_of_grid(load, plan.systems, plan.t_start, plan.t_end, grid)
    return is_quiet & say([plan.remark(begin, whole)])


def integrated(
    plan: Plan,
    begin: Starts,
    grid: Stretches,
    progress: bool = False,
    events: tuple[Event, ...] = (),
    prepared: PreparedPlan | None = None,
) -> Trajectory:
    """Return the run on a grid."""
    if events:
        problem = replace(plan.problem(begin, grid), intervals=True)
        found = march_to_events(plan.scheme, problem, events)
        return trajectory(plan, replace(problem, output_times=found.times), found.outcome, found)
    if prepared:
        run = prepared.run(begin.quaternion[0], begin.velocity[0].tolist(), float(begin.load_scale[0]))
        if run is not None:
            return run
    with progress_bar(grid.steps) if progress else nullcontext() as report:
        problem = replace(plan.problem(begin, grid), intervals=plan.means, progress=report)
        return trajectory(plan, problem, completion.march(plan.scheme, problem))


def trajectory(plan: Plan, problem: IVP, outcome: Outcome, ended: Ended | None = None) -> Trajectory:
    """Return the run of an outcome; raise an error that holds the partial run where it has failed."""
    failure, good = outcome.failure(), int(outcome.good[0])
    time = problem.stored_times[:good]
    if outcome.end is not None:
        time = np.append(time[:-1], problem.times(outcome.end))
    message = failure_message(problem, failure) if failure is not None else (ended and ended.message) or "done"
    known = outcome.intervals
    if known is None:
        unknown = np.broadcast_to(np.nan, (1, problem.stored_times.size - 1, 3))
        known = Intervals(unknown[:, :, :0], unknown, unknown[:, :, 0], None)
    own = problem.member(0)
    means: Any = {name: None if x is None else x[: max(good - 1, 0)] for name, x in known.of_one.items()}
    run = Trajectory(
        system=problem.system,
        integrator=plan.scheme,
        stretches=None if problem.off_grid else problem.grid,
        load=own.load.description,
        time=time,
        states=outcome.states.part(0, slice(good)),
        status=int(failure.status) if failure else 0,
        message=message,
        memory=None if outcome.memory is None else outcome.memory[0],
        events=ended and ended.events,
        potentials=held_by(own.load),
        **means,
    )
    if failure is None:
        return run
    if failure.status is Status.INTERRUPTED:
        raise SimulationInterrupt(message, run)
    status, began, h = int(failure.status), problem.began(failure.step), problem.step_at(failure.step)
    raise SimulationError(message, status, began, h, failure.residual, run) from failure.cause


@dataclass(frozen=True, eq=False)
class Prepared:
    """Everything that a run needs: integrator, body, load and time grid, and the start."""

    plan: Plan
    begin: Starts
    events: tuple[Event, ...] = ()

    @cached_property
    def grid(self) -> Stretches:
        """The time grid; an estimate where none is given, a ValueError where there are too many steps."""
        if self.plan.is_controlled:
            return finer(self.first[0].grid)
        return self.plan.grid or self.plan.automatic(self.begin)

    @cached_property
    def first(self) -> tuple[First, int]:
        """What a run to a tolerance begins with, and how many states it stores."""
        return first_of(self.plan, self.begin)

    @property
    def scheme(self) -> Integrator:
        """The integrator; where a tolerance chooses its order, the one that it begins with."""
        return self.first[0].scheme if self.plan.is_controlled else self.plan.scheme

    @cached_property
    def states(self) -> int:
        """How many states are stored; a ValueError where they do not fit into memory."""
        return self.first[1] if self.plan.is_controlled else self.plan.states(self.grid)

    @property
    def on_grid(self) -> Prepared:
        """The same with output at its nodes, and without events."""
        return Prepared(self.plan._replace(output_times=None, shows="steps"), self.begin)

    def refined(self, run: Trajectory, n: int) -> Prepared:
        """Return the same with n times as many steps as one of its runs in each stretch, and the same times stored."""
        grid, store = run.stretches, self.plan.store
        assert grid is not None
        own = (self.plan.t_start, *grid.borders[1:]), (0, *grid.numbers[1:])  # not those of a run that it continues
        finer = stretched(own[0], n * np.diff(own[1]))
        kept = store if isinstance(store, str) else n * store
        return Prepared(self.plan._replace(scheme=run.integrator, grid=finer, store=kept), self.begin)

    def even_step(self, run: Trajectory) -> float | None:
        """Return the `time.step` of runs as accurate as this one of it, None where none has the kinks."""
        plan, grid = self.plan, run.stretches
        assert grid is not None
        if len(grid.sizes) == 1:
            return grid.longest
        return even_step(grid.longest, plan.grid_load, plan.t_start, plan.t_end)

    def run(self, progress: bool = False) -> Trajectory:
        """Integrate it; errors as `nontwist.simulate`."""
        return run_of(self.plan, self.begin, progress, self.events)


# What a run will be like, forecast before it runs: steps, size, time, turn a step, and the phase error to expect.
#
# With |w| the largest velocity that energy and impulse allow, the phase error (`notices`) is a bound on the
# lag of a steady rotation. `split` moves a free body exactly; `exact` and `continuous` do not step.


class Forecast(NamedTuple):
    """What to expect of a run, returned by `Problem.forecast`; nothing is run.

    Examples
    --------
    >>> from nontwist import Problem, standard
    >>> coming = Problem(standard([3, 4, 5]), t_end=20, step=0.01, angular_velocity=(0, 2, 0)).forecast()
    >>> coming.steps, coming.states, round(coming.turn, 3), coming.problems
    (2000, 2001, 1.146, ())
    """

    loads: tuple[str, ...]  #: in words, those of files with the extent of their tables
    steps: int
    step: float  #: s, the longest
    states: int  #: stored
    size: int  #: bytes of memory, about
    seconds: float  #: on one core, about; compilation left out
    turn: float  #: degrees a step, at most
    phase_error: float | None  #: degrees at the end, about; None where the integrator makes none by stepping
    sweep_seconds: float | None  #: on one core, of all members; None where there is no sweep
    warnings: tuple[str, ...]
    problems: tuple[Any, ...]  #: a body or a load that the integrator does not take, too little memory


def forecast(prepared: Prepared, members: int | None = None) -> Forecast:
    """Return what a run will be like, and a sweep of so many; problems are pairs of a keyword and the reason."""
    plan, begin, grid, states = prepared.plan, prepared.begin, prepared.grid, prepared.states
    scheme, load, N, h = prepared.scheme, plan.load, grid.steps, grid.longest
    fastest = plan.fastest(begin)
    degrees, phase = math.degrees(h * fastest), None
    task = plan.problem(begin, grid, np.array([0, N]))
    cost, problems = notices.run_cost(scheme, task, states), []
    if reason := refusal(scheme, task):
        is_taken = refusal(resolve_integrator(DEFAULT, None), task) is None
        problems.append(("integrator" if is_taken else "load", reason))
    elif reason := notices.excess(cost):
        problems.append(("store", reason))
    swept = None if members is None else notices.members_cost(scheme, task, members, 2).seconds
    messages = load_messages(load, plan.systems, plan.t_start, plan.t_end, grid)
    if not problems and (notice := notices.notice(cost)) is not None:
        messages.append(notice)
    if not problems and (remark := plan.remark(begin, task)) is not None:
        messages.append(remark)
    if isinstance(scheme, Compiled) and not plan.is_controlled:
        phase = math.degrees(phase_error(scheme, task, fastest))
        if (text := coarseness(scheme, task, fastest)) is not None:
            messages.append(text)
    words = tuple(type(term).words(term.description) for term in load.terms)
    told = tuple(messages), tuple(problems)
    return Forecast(words, N, h, states, cost.size, cost.seconds, degrees, phase, swept, *told)
