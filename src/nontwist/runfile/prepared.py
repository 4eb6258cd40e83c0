"""A run file made ready to run, once: check, forecast, run and every block of a sweep use the same `Prepared`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from ..analysis.trajectory import Trajectory
from ..driver.grid import automatic_count, stored_count
from ..driver.planning import Plan
from ..driver.single_run import run_of
from ..driver.starts import Starts


@dataclass(frozen=True, eq=False)
class Prepared:
    """Everything that a run needs: integrator, body, load and time grid, and the start."""

    plan: Plan
    begin: Starts

    @cached_property
    def steps(self) -> int:
        """How many steps there are; an estimate where the file gives no step, a ValueError where they are too many."""
        plan = self.plan
        return plan.steps or automatic_count(plan.systems, self.begin.velocity, plan.load, plan.t_start, plan.t_end)

    @cached_property
    def states(self) -> int:
        """How many states are stored; a ValueError where they do not fit into memory."""
        return stored_count(self.steps, self.plan.store)

    def run(self, progress: bool = False) -> Trajectory:
        """Integrate it; errors as `nontwist.simulate`."""
        return run_of(self.plan, self.begin, progress, self.steps)
