"""One run: from a plan and a start to a trajectory, with a step that is given or chosen.

A problem made ready to run, once: check, forecast, run and every block of a sweep use the same `Prepared`.
"""

from __future__ import annotations

import math
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from math import inf, sqrt
from typing import Any, NamedTuple

import numpy as np

from ..analysis.trajectory import Trajectory
from ..errors import warn
from ..geometry.arrays import largest_size
from ..geometry.attitudes import States
from ..integrators import DEFAULT, IVP, Integrator, SimulationError, SimulationInterrupt, Status, stack_march
from ..integrators.compiled import Compiled
from ..integrators.continuous import MOST, Continuous, least_steps
from ..integrators.costs import Cost, seconds_of_call
from ..integrators.integrator import Outcome
from ..integrators.ivp import Intervals, Segments, segmented
from ..integrators.load_samples import as_gyrostat
from ..loads import Load
from ..machine import cached_property
from . import completion, notices
from .contacts import refusal
from .events import Ended, Event, march_to_events
from .first_steps import First, apart_shown, damped_steps, expected_grid, first_run
from .grid import MOST as MOST_STATES
from .grid import TURN, even_step, load_messages, require_resolution, rest_of_grid, segments_of, stored_count
from .notices import progress_bar
from .planning import Plan, resolve_integrator
from .starts import AT_REST, Starts
from .tolerance import controlled

RUNS = 7 / 3  # to a tolerance, in steps of the last: a coarse one, one that is disturbed by round-off, a finer one
CALLS = 25  # of a load in Python at a stage of a step that is chosen, in all runs together
CACHED_NODES = 2**13  # at most, of a plan whose preparation is cached


class PreparedPlan:
    """A plan with its grid laid out and its load sampled, ready for starts."""

    def __init__(self, plan: Plan, grid: Segments, work: float = inf) -> None:
        problem = plan.problem(AT_REST, grid, intervals=True)
        self._march, self._terms, body = plan.scheme.prepared(problem, work), plan.load.description, plan.systems[0]
        self.expect: Any = getattr(self._march, "expect", lambda steps: None)
        # Damping and linear potentials are scaled when they are laid out: another factor needs another preparation.
        linear = any(term.dead_force is not None for term in plan.load.potentials)
        self.is_damped, self._held = bool(plan.load.damping.any()) or linear, held_by(plan.load)
        self.whole, self.is_quiet = whole_of(plan, grid), False  # whether there is nothing to say of its costs
        self.increases = completion.increases(problem)
        self.unremarkable = notices.unremarkable(plan.scheme, grid.longest, plan.t_end - plan.t_start)
        self._safe = completion.SAFE / max(1.0, float(abs(body.euler_inertia).max()))
        self._known = {
            "system": body,
            "integrator": plan.scheme,
            "segments": None if problem.off_grid else problem.grid,
            "load": self._terms,
            "time": problem.stored_times,
            "potentials": self._held,
        }

    @staticmethod
    def accepts(plan: Plan, grid: Segments, most: int | None = None) -> bool:
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


def whole_of(plan: Plan, grid: Segments) -> IVP:
    """Return the problem of a plan at rest, the first and the last state stored."""
    return plan.problem(AT_REST, grid, np.array([0, grid.steps]))


def held_by(load: Load) -> Load | None:
    """Return the potentials of a load, None where it has none."""
    return Load(load.potentials) if load.potentials else None


@lru_cache(maxsize=16)
def _cached(plan: Plan, grid: Segments) -> PreparedPlan:
    require_resolution(plan.t_start, plan.t_end, grid)
    return PreparedPlan(plan, grid, 0)


def known(
    plan: Plan, begin: Starts, grid: Segments, progress: bool = False, events: tuple[Event, ...] = ()
) -> PreparedPlan | None:
    """Return the prepared plan of a run that is so plain and small that it is kept; None for others."""
    is_plain = all(x is None for x in (begin.memory, begin.normal, begin.grid, plan.output_times))
    is_plain = is_plain and plan.load.is_immutable and not (progress or events)
    is_small = is_plain and PreparedPlan.accepts(plan, grid, CACHED_NODES)
    if not is_small or not (prepared := _cached(plan, grid)).increases:
        return None
    prepared.expect(grid.steps)
    return prepared


def with_warning(plan: Plan, run: Trajectory, prepared: PreparedPlan | None = None, known: float = 0.0) -> Trajectory:
    """Return a run, with a warning where its step is too coarse.

    Of speeds up to `known`, rad/s, only the run itself tells.
    """
    grid = run.segments
    if grid is None:
        return run
    quiet = (
        prepared.unremarkable
        if prepared
        else notices.unremarkable(plan.scheme, grid.longest, plan.t_end - plan.t_start)
    )
    if run._fastest <= quiet:
        return run
    text = notices.coarseness(plan.scheme, prepared.whole if prepared else whole_of(plan, grid), run._fastest)
    if text is None:
        if prepared:
            prepared.unremarkable = run._fastest  # there is nothing to say of slower runs either
        return run
    if run._fastest > known:
        warn(text)
    return run._later(vars(run) | {"warning": text}, vars(run).get("_read"))  # what was not read is still not


def integrated(
    plan: Plan,
    begin: Starts,
    grid: Segments,
    progress: bool = False,
    events: tuple[Event, ...] = (),
    prepared: PreparedPlan | None = None,
    marched: Any = None,
) -> Trajectory:
    """Return the run on a grid; `marched`: its march without output times, where it is known."""
    if events:
        problem = plan.problem(begin, grid, intervals=True)
        found = march_to_events(plan.scheme, problem, events)
        return trajectory(plan.scheme, replace(problem, output_times=found.times), found.outcome, found)
    if prepared:
        run = prepared.run(begin.quaternion[0], begin.velocity[0].tolist(), float(begin.load_scale[0]))
        if run is not None:
            return run
    with progress_bar(grid.steps) if progress else nullcontext() as report:
        problem = plan.problem(begin, grid, intervals=plan.means, progress=report, marched=marched)
        outcome = completion.checked_march(plan.scheme, problem)
    if outcome.failures[0, 0] == Status.TOO_MANY and (steps := damped_steps(plan, begin)):
        outcome.reasons[0] = f"{outcome.reasons[0]}; use {steps}"
    return trajectory(plan.scheme, problem, outcome)


def trajectory(scheme: Integrator, problem: IVP, outcome: Outcome, ended: Ended | None = None) -> Trajectory:
    """Return the run of an outcome; raise an error that holds the partial run where it has failed."""
    failure, good = outcome.failure(), int(outcome.good[0])
    time = problem.stored_times[:good]
    if outcome.end is not None:
        time = np.append(time[:-1], problem.times(outcome.end))
    message = notices.failure_message(problem, failure) if failure is not None else (ended and ended.message) or "done"
    known = outcome.intervals
    if known is None:
        unknown = np.broadcast_to(np.nan, (1, problem.stored_times.size - 1, 3))
        known = Intervals(unknown[:, :, :0], unknown, unknown[:, :, 0], None)
    own = problem.member(0)
    means: Any = {name: None if x is None else x[: max(good - 1, 0)] for name, x in known.of_one.items()}
    run = Trajectory(
        system=problem.system,
        integrator=scheme,
        segments=None if problem.off_grid else problem.grid,
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
    def fastest(self) -> float:
        """The largest |W| that energy and impulse allow, rad/s, about."""
        return self.plan.fastest(self.begin)

    @cached_property
    def first(self) -> First | None:
        """What a run to a tolerance begins with; None for others."""
        return first_run(self.plan.of_steps, self.begin, self.fastest) if self.plan.is_controlled else None

    @cached_property
    def grid(self) -> Segments:
        """The time grid; an estimate where none is given, a ValueError where there are too many steps."""
        plan, begin = self.plan, self.begin
        if self.first is not None:
            return expected_grid(plan.of_steps, self.first)
        rest = None if plan.grid else rest_of_grid(begin.grid, plan.grid_load, plan.t_start, plan.t_end)
        return plan.grid or rest or plan.automatic(begin)

    @property
    def scheme(self) -> Integrator:
        """The integrator; where a tolerance chooses its order, the one that it begins with."""
        return self.plan.scheme if self.first is None else self.first.scheme

    @cached_property
    def states(self) -> int:
        """How many states are stored; a ValueError where they do not fit into memory."""
        plan, shown = self.plan, self.grid.steps
        if plan.output_times is not None:
            return len(plan.output_times)
        if plan.is_between and self.first is not None:
            apart = apart_shown(plan, self.first.pace, self.first.swing)
            shown = max(1, int((apart.lengths(plan.t_end) / apart.values).sum()))
            if shown > MOST_STATES:
                raise ValueError(
                    f"figures need {shown:.3g} states, and at most {MOST_STATES:.0e} are stored: choose times= or "
                    "store='end'"
                )
        return stored_count(shown, plan.store)

    @cached_property
    def whole(self) -> IVP:
        """The problem, with the first and the last state stored."""
        return self.plan.problem(self.begin, self.grid, np.array([0, self.grid.steps]))

    @property
    def cost(self) -> Cost:
        """What it costs, about."""
        cost, load = notices.run_cost(self.scheme, self.whole, self.states), self.plan.load
        if self.first is None:
            return cost
        cost = cost._replace(seconds=cost.seconds + (RUNS - 1) * self.scheme.cost(self.whole, 2).seconds)
        if load.is_compiled:
            return cost
        calls = CALLS * cost.parts * self.scheme.nodes
        return cost._replace(seconds=max(cost.seconds, calls * seconds_of_call(load, self.whole)))

    @property
    def remark(self) -> str | None:
        """What the integrator says about the steps, or None."""
        return self.plan._replace(scheme=self.scheme).remark(self.begin, self.whole)

    def announced(self) -> bool:
        """Refuse what exceeds the memory; warn of long runs, of slow loads, and of a given step off the breakpoints.

        Return whether nothing was said.
        """
        plan, scheme, load = self.plan, self.scheme, self.plan.load
        if isinstance(scheme, Continuous) and least_steps(scheme, self.whole) > MOST:
            raise ValueError(
                f"{scheme.method} of SciPy would take more than {MOST:.0e} steps, as damping is so fast; use "
                f"{damped_steps(plan, self.begin) or 'the integrator gauss'}"
            )
        is_quiet = not (load.terms and scheme.is_compiled) or notices.warn_of_cost(load)
        is_quiet &= notices.announce(self.cost, scheme, self.whole)
        if not plan.off_grid and plan.grid is not None:
            is_quiet &= notices.warn_of_grid(load, plan.systems, plan.t_start, plan.t_end, self.grid)
        return is_quiet & notices.say([self.remark])

    @property
    def on_grid(self) -> Prepared:
        """The same with output at its nodes, and without events."""
        return Prepared(self.plan._replace(output_times=None, shows="steps"), self.begin)

    def refined(self, run: Trajectory, n: int) -> Prepared:
        """Return the same with n times as many steps as one of its runs in each segment, and the same times stored."""
        grid, store = run.segments, self.plan.store
        assert grid is not None
        own = (self.plan.t_start, *grid.borders[1:]), (0, *grid.numbers[1:])  # not those of a run that it continues
        finer = segmented(own[0], n * np.diff(own[1]))
        kept = store if isinstance(store, str) else n * store
        return Prepared(self.plan._replace(scheme=run.integrator, grid=finer, store=kept), self.begin)

    def even_step(self, run: Trajectory) -> float | None:
        """Return the `time.step` of runs as accurate as this one of it, None where none has the kinks."""
        plan, grid = self.plan, run.segments
        assert grid is not None
        if len(grid.sizes) == 1:
            return grid.longest
        return even_step(grid.longest, plan.grid_load, plan.t_start, plan.t_end)

    def run(self, progress: bool = False) -> Trajectory:
        """Integrate it; errors as `nontwist.simulate`.

        Where steps are chosen, outputs that do not lie on them, and events, are found by a second run on the same grid.
        """
        plan, begin, events = self.plan, self.begin, self.events
        prepared = known(plan, begin, plan.grid, progress, events) if plan.grid is not None else None
        if not (prepared and prepared.is_quiet):
            is_quiet = self.announced()
            if prepared:
                prepared.is_quiet = is_quiet
        if plan.grid is not None:
            return with_warning(plan, integrated(plan, begin, plan.grid, progress, events, prepared), prepared)
        is_whole, choose = not events and plan.of_steps is plan, self._controlled if self.first else self._short_steps
        try:
            steps, march = choose(progress and not events)
        except SimulationError as error:
            if is_whole or error.partial is None:
                raise
            steps, march = error.partial, None  # as far as it comes
        if is_whole:
            return steps
        assert steps.segments is not None
        own = plan._replace(scheme=steps.integrator)
        if self.first is not None and plan.is_between and plan.output_times is None:
            sizes = np.sqrt(np.square(steps.material_angular_velocity).sum(axis=1))
            longest = apart_shown(plan, self.first.pace.measured(steps.time, sizes), self.first.swing)
            shown = segments_of(plan.grid_load, plan.t_start, plan.t_end, longest)
            own = own._replace(output_times=plan.problem(begin, shown).stored_times)
        run = integrated(own, begin, steps.segments, events=events, marched=march)
        vars(run).update(tolerance=steps.tolerance, error_estimate=steps.error_estimate, warning=steps.warning)
        return run

    def _controlled(self, progress: bool) -> tuple[Trajectory, Any]:
        """Return the run to a tolerance that finds the steps, and its march, in which outputs can be found."""
        plan, own = self.plan, self.plan.of_steps
        with progress_bar(1, "runs") if progress else nullcontext() as report:
            found, goal, error = controlled(own, self.begin, first=self.first, intervals=plan.means, progress=report)
        notices.warn_of_grid(plan.load, plan.systems, plan.t_start, plan.t_end, found.grid)
        run = trajectory(found.scheme, found.problem, found.outcome)
        vars(run).update(tolerance=goal, error_estimate=error)
        return run, None if plan.load.wheels else found.outcome.march

    def _short_steps(self, progress: bool) -> tuple[Trajectory, None]:
        """Return the run that finds steps in which the body turns by at most 0.05 rad."""
        plan, begin, grid = self.plan.of_steps, self.begin, self.grid
        while True:
            try:
                run = integrated(plan, begin, grid, progress, (), known(plan, begin, grid, progress))
            except SimulationError as error:
                if error.status not in (Status.TURN, Status.STALLED):
                    raise
                grid = plan.automatic(begin, grid.longest / 4)
                continue
            turn = largest_size(run.material_angular_velocity) * grid.longest
            if turn <= TURN * (1 + 1e-9):
                notices.warn_of_grid(plan.load, plan.systems, plan.t_start, plan.t_end, grid)
                return with_warning(plan, run), None
            grid = plan.automatic(begin, grid.longest * TURN / (1.02 * turn))


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


def forecast(prepared: Prepared, swept: tuple[int, int, bool] | None = None) -> Forecast:
    """Return what a run will be like, and a sweep of so many members and ensembles, with extrema or not.

    Problems are pairs of a keyword and the reason.
    """
    plan, scheme, grid, task, cost = prepared.plan, prepared.scheme, prepared.grid, prepared.whole, prepared.cost
    load, h, fastest, problems, phase = plan.load, grid.longest, prepared.fastest, [], None
    marched = as_gyrostat(task) if load.wheels else task
    if reason := refusal(scheme, marched):
        is_taken = refusal(resolve_integrator(DEFAULT, None), marched) is None
        problems.append(("integrator" if is_taken else "load", reason))
    elif reason := notices.excess(cost):
        problems.append(("store", reason))
    seconds = None if swept is None else notices.sweep_seconds(scheme, task, *swept[:2])
    if seconds is not None and swept is not None and swept[2]:
        seconds += completion.extrema_seconds(scheme, task, swept[0])
    messages = load_messages(load, plan.systems, plan.t_start, plan.t_end, grid)
    if not problems and (notice := notices.notice(cost)) is not None:
        messages.append(notice)
    if not problems and prepared.remark is not None:
        messages.append(prepared.remark)
    if isinstance(scheme, Compiled) and not plan.is_controlled:
        phase = math.degrees(notices.phase_error(scheme, task, fastest))
        if (text := notices.coarseness(scheme, task, fastest)) is not None:
            messages.append(text)
    words = tuple(type(term).words(term.description) for term in load.terms)
    told, turn = (tuple(messages), tuple(problems)), math.degrees(h * fastest)
    return Forecast(words, grid.steps, h, prepared.states, cost.size, cost.seconds, turn, phase, seconds, *told)
