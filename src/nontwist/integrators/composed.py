"""The base of integrators whose compiled step of order 2 is composed to higher orders (`composition`)."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from .base import Integrator, Outcome, Prepared, Problem
from .composition import fractions
from .costs import Cost, steps_cost

if TYPE_CHECKING:
    from ..loads import Load
    from .scheme import Scheme


@dataclass(frozen=True)
class Composed(Integrator):
    """A compiled step of order 2 and its symmetric compositions, for one body and for stacks."""

    is_compiled: ClassVar[bool] = True
    together: ClassVar[float] = 3.0
    observes: ClassVar[bool] = True
    order: int = 2

    @property
    def nodes(self) -> int:
        """Nodes of the load in a step."""
        return len(fractions(self.order))

    @property
    def effort(self) -> float:
        """The cost of a step, relative to that of a step of order 2."""
        return float(self.nodes)

    @property
    def largest_turn(self) -> float:
        """The turn in a step up to which no substep turns the body by more than 60°, rad."""
        return float(np.pi / 3 / abs(fractions(self.order)).max())

    def lag(self, theta: float) -> float:
        """Return by how much a step misses the turn `theta` of a steady rotation, rad."""
        gamma = fractions(self.order)
        return float(abs(np.sum(2 * np.arctan(gamma * theta / 2)) - theta))

    @abstractmethod
    def _scheme(self, constrained: bool) -> Scheme:
        """Return the compiled marches of the step, for bodies with a constrained axis or without."""

    def march(self, problem: Problem, threads: int = 1) -> Outcome:
        """Integrate all members, in lanes where there are many."""
        from .marching import march

        self.require(problem.systems)
        return march(problem, self.order, threads, self._scheme(problem.systems.axis is not None))

    def can_prepare(self, load: Load) -> bool:
        """Whether `prepared` lays out problems under this load: one that no function in Python is called for."""
        return type(self).march is Composed.march and load.is_compiled

    def prepared(self, problem: Problem) -> Prepared:
        """Return the march of a problem of one body laid out once, for any start."""
        from .prepared_march import PreparedMarch

        return PreparedMarch(problem, self)

    def cost(self, problem: Problem, states: int) -> Cost:
        """Return the estimated cost of `march`."""
        return steps_cost(problem, problem.steps, self.nodes, self.substep_ns)
