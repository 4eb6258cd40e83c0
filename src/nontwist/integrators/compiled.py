"""The base of integrators with compiled steps: what a scheme says of its step, and the marches that take it.

Dissipation is an option of the two midpoint schemes: energy falls, momentum stays. Energy-dissipating,
momentum-conserving variants (Armero & Romero, Comput. Methods Appl. Mech. Engrg. 190 (2001) 2603, 6783; Gebhardt,
Romero & Rolfes, Comput. Mech. 65 (2020) 405). χ ∈ [0, 1] sets how much: χ = 0 is the conserving scheme. What is
dissipated is the nutation: free motion tends to the rotation about the axis of the largest moment of inertia, ``K ≥
|π|²/(2 J_max)``, and a permanent rotation loses nothing. It is of the scheme, not of the body: at a given time it
vanishes with the step, as h of order 1, as h² of order 2.

A body with a constrained axis cannot lose energy so: of the non-twisting body K is a function of Π_⊥, which free motion
keeps.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import atan, inf
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..engine.generalised import MOMENT
from ..engine.marching import Text
from ..engine.records import Parts
from ..geometry.arrays import Array, as_number
from ..geometry.attitudes import States
from ..geometry.values import among
from ..loads import Load
from .integrator import IVP, Integrator, Outcome

ONCE, MIDDLE = np.ones(1), np.full(1, 0.5)


class Needs(NamedTuple):
    """What the march of a scheme has to have."""

    action: int = MOMENT  # what director forces and potentials are for it (`engine.generalised`)
    table: Array | None = None  # coefficients
    beside: int = 0  # numbers of a member beside `State`
    # Numbers beside the workspace, for so many internal states: of each body in lanes, of all.
    scratch: Callable[[int], tuple[int, int]] = lambda internal: (0, 0)


@dataclass(frozen=True)
class Compiled(Integrator):
    """A compiled step, by default a midpoint step of order 2, for one body and for stacks.

    A scheme may have several kinds of motion, each with equations of its own.
    """

    is_compiled: ClassVar[bool] = True
    has_derivatives: ClassVar[bool] = True
    together: ClassVar[float] = 5.0
    observes: ClassVar[bool] = True
    is_director_scheme: ClassVar[bool] = False  # carries W and N, gives λ; else it carries the momentum
    in_lanes: ClassVar[bool] = True  # whether bodies are marched side by side
    # What linearises steps, of what there is, and of the inputs asked for; None: the text itself.
    linear: ClassVar[Any] = None
    dissipation = 0.0  # its degree χ
    order: int = 2

    @abstractmethod
    def text(self, motion: str) -> Text:
        """Return the text of the step (`engine.marching`) for a kind of motion."""

    def motion(self, parts: Parts, is_nonprincipal: bool, has_vertical: bool) -> str:
        """Return the kind of motion of bodies: "explicit" where nothing is to be solved, "" where it does not matter.

        Parameters
        ----------
        parts : Parts
            What acts on them.
        is_nonprincipal : bool
            Whether the constrained axis is not principal, or they spin about it as prescribed.
        has_vertical : bool
            Whether all dead forces have one direction in space.
        """
        return ""

    def stages(self, parts: Parts) -> tuple[Array, Array]:
        """Return the fractions of a step that are taken at once, and its nodes of the load; by default the middle."""
        return ONCE, MIDDLE

    @property
    def needs(self) -> Needs:
        """What a march has to have for it."""
        return Needs()

    def lag(self, theta: float) -> float:
        """Return by how much a step misses the turn `theta` of a steady rotation, rad."""
        return abs(2 * atan(theta / 2) - theta)

    def march(self, problem: IVP, threads: int = 1) -> Outcome:
        """Integrate all members, in lanes where there are many."""
        from .marched_stacks import march_stack

        self.require(problem)
        return march_stack(problem, threads, self)

    def between(self, problem: IVP, states: States) -> States | None:
        """Return the states of one body at the times asked for, given those at all nodes of its grid."""
        if not self.has_series(problem.systems, problem.load):
            return None
        from .dense import states_between

        return states_between(self, problem, states)

    def can_prepare(self, load: Load) -> bool:
        """Whether `prepared` lays out problems under this load: no functions in Python, memory, or dry friction."""
        is_plain = not load.terms or (load.is_compiled and not (load.memories or load.frictions))
        return type(self).march is Compiled.march and is_plain

    def prepared(self, problem: IVP, work: float = inf) -> Any:
        """Return the march of a problem of one body laid out once, for any start; `work` as for `PreparedMarch`."""
        from .marched_stacks import PreparedMarch, dense_of
        from .stack_march import StackMarch

        self.require(problem)
        if (dense := dense_of(replace(problem, intervals=False), self)) is not None:
            from .dense import PreparedDense

            return PreparedDense(problem, dense, PreparedMarch(dense.march, work))
        return PreparedMarch(StackMarch(problem, self), work)


ORDERS = (1, 2)  # with dissipation
REFUSAL = (
    "{} has no dissipation for a body with a constrained axis: the energy of the non-twisting body is a function of "
    "the momenta that it keeps, and cannot fall; leave dissipation out"
)


@dataclass(frozen=True)
class Dissipative(Compiled):
    """A midpoint scheme of order 2 whose energy may be made to fall."""

    order: int = 2
    dissipation: float = 0.0

    def __post_init__(self) -> None:
        chi = as_number(self.dissipation, "dissipation")
        if not 0 <= chi <= 1:
            raise ValueError(f"dissipation must be a number from 0 to 1, got {chi:g}")
        if among(self.order, (1,)) and chi == 0:
            raise ValueError(f"{self.name} has the order 1 with dissipation= alone, the order 2 with it or without")
        if not (chi > 0 and among(self.order, ORDERS)):
            super().__post_init__()

    def refusal(self, problem: IVP) -> str | None:
        """Return why bodies with a constrained axis that are to lose energy are not accepted."""
        return REFUSAL.format(self.name) if self.dissipation and problem.systems.axis is not None else None
