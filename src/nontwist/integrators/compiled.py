"""The base of integrators with compiled steps."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from math import atan
from typing import TYPE_CHECKING, ClassVar

from .base import Integrator, Outcome, Prepared, Problem
from .costs import Cost, steps_cost

if TYPE_CHECKING:
    from ..loads import Load
    from .scheme import Scheme


@dataclass(frozen=True)
class Compiled(Integrator):
    """A compiled step, by default a midpoint step of order 2, for one body and for stacks."""

    is_compiled: ClassVar[bool] = True
    has_derivatives: ClassVar[bool] = True
    together: ClassVar[float] = 3.0
    observes: ClassVar[bool] = True
    order: int = 2

    @property
    def nodes(self) -> int:
        """Nodes of the load in a step."""
        return 1

    def lag(self, theta: float) -> float:
        """Return by how much a step misses the turn `theta` of a steady rotation, rad."""
        return abs(2 * atan(theta / 2) - theta)

    @abstractmethod
    def _scheme(self, constrained: bool) -> Scheme:
        """Return the compiled marches of the step, for bodies with a constrained axis or without."""

    def march(self, problem: Problem, threads: int = 1) -> Outcome:
        """Integrate all members, in lanes where there are many."""
        from .marching import march

        self.require(problem.systems, problem.load)
        return march(problem, self.order, threads, self._scheme(problem.systems.axis is not None))

    def can_prepare(self, load: Load) -> bool:
        """Whether `prepared` lays out problems under this load: one that no function in Python is called for."""
        return type(self).march is Compiled.march and load.is_compiled

    def prepared(self, problem: Problem) -> Prepared:
        """Return the march of a problem of one body laid out once, for any start."""
        from .prepared_march import PreparedMarch

        return PreparedMarch(problem, self)

    def cost(self, problem: Problem, states: int) -> Cost:
        """Return the estimated cost of `march`."""
        return steps_cost(problem, problem.steps, self.nodes, self.substep_ns)
