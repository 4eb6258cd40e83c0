"""A problem made ready to run, once: check, forecast, run and every block of a sweep use the same `Prepared`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from ..analysis.trajectory import Trajectory
from ..integrators import Integrator
from ..integrators.compiled import Compiled
from ..integrators.time_grid import Stretches, stretched
from . import costs
from .contacts import refusal
from .costs import coarseness, phase_error
from .events import Event
from .grid import even_step, load_messages, stored_count
from .planning import Plan
from .single_run import first_of, run_of
from .starts import Starts
from .tolerance import First, finer


@dataclass(frozen=True, eq=False)
class Prepared:
    """Everything that a run needs: integrator, body, load and time grid, and the start."""

    plan: Plan
    begin: Starts
    events: tuple[Event, ...] = ()
    shows: Literal["steps", "between"] = "between"  # what a run stores, as `Plan.shows`

    @cached_property
    def grid(self) -> Stretches:
        """The time grid; an estimate where none is given, a ValueError where there are too many steps."""
        plan = self.plan
        if plan.is_controlled:
            return finer(self.first[0].grid)
        return plan.grid or plan.automatic(self.begin)

    @cached_property
    def first(self) -> tuple[First, int]:
        """What a run to a tolerance begins with, and how many states it stores."""
        return first_of(self.plan._replace(shows=self.shows), self.begin)

    @property
    def scheme(self) -> Integrator:
        """The integrator; where a tolerance chooses its order, the one that it begins with."""
        return self.first[0].scheme if self.plan.is_controlled else self.plan.scheme

    @cached_property
    def states(self) -> int:
        """How many states are stored; a ValueError where they do not fit into memory."""
        if self.plan.asked is not None:
            return len(self.plan.asked)
        if self.plan.is_controlled:
            return self.first[1]
        return stored_count(self.grid.steps, self.plan.store)

    @property
    def on_grid(self) -> Prepared:
        """The same with output at its nodes, and without events."""
        return Prepared(self.plan._replace(asked=None), self.begin, shows="steps")

    def refined(self, run: Trajectory, n: int) -> Prepared:
        """Return the same with n times as many steps as one of its runs in each stretch, and the same times stored."""
        grid, store = run.stretches, self.plan.store
        assert grid is not None
        finer = stretched(grid.borders, n * np.diff(grid.numbers))
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
        return run_of(self.plan._replace(shows=self.shows), self.begin, progress, self.grid, self.events)


# What a run will be like, forecast before it runs: steps, size, time, turn a step, and the phase error to expect.
#
# With |w| the largest velocity that energy and impulse allow, the phase error (`driver.costs`) is a bound on the
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
    cost, problems = costs.run_cost(scheme, task, states), []
    if reason := refusal(scheme, task):
        problems.append(("integrator", reason))
    elif reason := costs.excess(cost):
        problems.append(("store", reason))
    swept = None if members is None else costs.members_cost(scheme, task, members, 2).seconds
    messages = load_messages(load, plan.systems, plan.t_start, plan.t_end, grid)
    if not problems and (notice := costs.notice(cost)) is not None:
        messages.append(notice)
    if not problems and (remark := scheme.remark(task)) is not None:
        messages.append(remark)
    if isinstance(scheme, Compiled) and not plan.is_controlled:
        phase = math.degrees(phase_error(scheme, task, fastest))
        if (text := coarseness(scheme, task, fastest)) is not None:
            messages.append(text)
    words = tuple(type(term).words(term.description) for term in load.terms)
    told = tuple(messages), tuple(problems)
    return Forecast(words, N, h, states, cost.size, cost.seconds, degrees, phase, swept, *told)
