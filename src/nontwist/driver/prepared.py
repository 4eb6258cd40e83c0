"""A problem made ready to run, once: check, forecast, run and every block of a sweep use the same `Prepared`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from ..analysis.trajectory import Trajectory
from ..integrators import Integrator
from ..integrators.time_grid import Stretches, stretched
from .events import Event
from .grid import automatic_grid, even_step, stored_count
from .planning import Plan
from .single_run import first_run, run_of
from .starts import Starts


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
            return self.first[1]
        how = (plan.systems, self.begin.velocity, plan.paced, plan.t_start, plan.t_end)
        return plan.grid or automatic_grid(*how, is_a_stable=plan.scheme.is_a_stable)

    @cached_property
    def first(self) -> tuple[Integrator, Stretches, int]:
        """The integrator, the grid and the number of states that a run to a tolerance begins with."""
        return first_run(self.plan._replace(shows=self.shows), self.begin)

    @property
    def scheme(self) -> Integrator:
        """The integrator; where a tolerance chooses its order, the one that it begins with."""
        return self.first[0] if self.plan.is_controlled else self.plan.scheme

    @cached_property
    def states(self) -> int:
        """How many states are stored; a ValueError where they do not fit into memory."""
        if self.plan.asked is not None:
            return len(self.plan.asked)
        if self.plan.is_controlled:
            return self.first[2]
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
        return even_step(grid.longest, plan.paced, plan.t_start, plan.t_end)

    def run(self, progress: bool = False) -> Trajectory:
        """Integrate it; errors as `nontwist.simulate`."""
        return run_of(self.plan._replace(shows=self.shows), self.begin, progress, self.grid, self.events)
