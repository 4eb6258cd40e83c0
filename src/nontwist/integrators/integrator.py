"""What an integrator is, and the errors of a run that fails.

An integrator is data: a frozen dataclass with a name, orders, options and one method: `march` takes a `IVP`, a
stack of bodies, and returns its `Outcome`, or `march_one` takes the problem of one. Steps are those of `problem`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import inf, pi
from typing import Any, ClassVar, Self

from ..errors import SimulationError, SimulationInterrupt, Status
from ..geometry.attitudes import States
from ..geometry.values import among, short_repr
from ..loads import Load
from ..loads.memory_terms import Wheel
from ..models.stack import SystemStack
from .costs import Cost, steps_cost, undersampled, unresolved
from .ivp import IVP, Failure, March, Outcome
from .stepping import one_by_one, outcome_of

SPIN = "{} does not accept a prescribed spin; use the integrator gauss"  # where a scheme has none
BEYOND_JUMPS = (  # of a load; {}: what has a law of friction
    "end the run a few steps before with events= and continue it on the other side, choose the moment of each step "
    "with stepper, use {} for friction, or make the law smooth over a scale of your choice, as with np.tanh(x / scale)"
)
__all__ = ["IVP", "Failure", "Integrator", "March", "Outcome", "SimulationError", "SimulationInterrupt", "Status"]


@dataclass(frozen=True)
class Integrator:
    """Base class of all integrators: a frozen dataclass whose fields are its options.

    If there is more than one order, `order` is among the fields. A single order becomes this field by itself.
    """

    name: ClassVar[str]
    orders: ClassVar[tuple[int, ...]] = ()
    removed: ClassVar[Mapping[int, str]] = {}  # orders of earlier versions: what to take instead
    controlled_orders: ClassVar[tuple[int, ...]] = ()  # from which a tolerance chooses; none: all from 4 on
    is_exact_without_load: ClassVar[bool] = False  # whether free bodies are moved by closed solutions
    is_a_stable: ClassVar[bool] = False  # whether damped modes of any rate decay in steps of any length
    any_times: ClassVar[bool] = False  # whether it takes no steps of the grid, and so stops anywhere by itself
    is_compiled: ClassVar[bool] = False  # whether a load in Python slows it down
    substep_ns: ClassVar[float] = 100_000.0  # of a substep on a slow core; by default as in Python
    together: ClassVar[float] = 0.0  # speed-up of a member of a stack over a run; 0: none
    has_derivatives: ClassVar[bool] = False  # whether its steps can be linearised (`linearised`)
    remembers: ClassVar[bool] = False  # whether it takes loads with memory
    observes: ClassVar[bool] = False  # whether it computes statistics over its steps
    splits_steps: ClassVar[bool] = False  # whether steps are split where dry friction changes between its modes
    sources: ClassVar[Mapping[str, str]] = {}  # of what it claims, by kind of check: "order"; "invariant" where exact
    counts: ClassVar[dict[int, tuple[int, ...]]] = {  # steps in 2 s, to measure an order with
        1: (256, 512, 1024),
        2: (64, 128, 256),
        4: (32, 64, 128),
        6: (24, 32, 48),
        8: (20, 24, 32),
    }

    def has_series(self, systems: SystemStack, load: Load) -> bool:
        """Whether its nodes lie on one trajectory, nearly, and states between them are found by power series."""
        return False

    def between(self, problem: IVP, states: States) -> States | None:
        """Return the states of one body at the times asked for, given those at all nodes of its grid.

        None where nodes do not lie on one trajectory, nearly.
        """
        return None

    def __init_subclass__(cls) -> None:
        if len(cls.orders) == 1:  # before `dataclass` reads the annotations
            cls.__annotations__["order"] = int
            if "order" not in vars(cls):
                cls.order = cls.orders[0]  # type: ignore[attr-defined]

    def __post_init__(self) -> None:
        order: Any = getattr(self, "order", None)
        if self.orders and not among(order, self.orders):
            if reason := unregistrable(self.name, type(self)):
                raise ValueError(reason)
            known = ", ".join(map(str, self.orders))
            why = f": {self.removed[order]}" if among(order, self.removed) else ""
            raise ValueError(f"{self.name} has the order {known}; got order = {short_repr(order)}{why}")

    @classmethod
    def variants(cls) -> list[Self]:
        """Return an instance of every order, as `compare` uses by default."""
        return [cls(order=k) for k in cls.orders] if cls.orders else [cls()]  # type: ignore[call-arg]

    @classmethod
    def measuring(cls, order: int) -> tuple[int, ...]:
        """Return the numbers of steps with which the order is measured; a ValueError if `counts` lacks it."""
        if order not in cls.counts:
            raise ValueError(
                f"{cls.name} has the order {order}, but {cls.__name__}.counts no steps to measure it with: "
                f"counts = Integrator.counts | {{{order}: (n, 2 * n, 4 * n)}}"
            )
        return cls.counts[order]

    def march(self, problem: IVP, threads: int = 1) -> Outcome:
        """Integrate all members; by default one after the other, by `march_one`.

        Parameters
        ----------
        problem : IVP
            Of one body or of many.
        threads : int

        Returns
        -------
        Outcome
            A failure is part of it, not an exception.

        Raises
        ------
        ValueError
            What `refusal` returns; a load that is wrong from the start.
        KeyboardInterrupt
            In a stack of more than one.
        """
        if problem.output_times is None or self.any_times:
            return one_by_one(lambda one: outcome_of(one, self.march_one(one)), problem, threads)
        from .stepping import at_any_times

        return one_by_one(lambda one: outcome_of(one, at_any_times(self.march_one, one)), problem, threads)

    def march_one(self, problem: IVP) -> March:
        """Integrate a problem of one body. Integrators that do not define `march` define this method."""
        raise NotImplementedError(f"{type(self).__name__} defines neither march nor march_one")

    def can_prepare(self, load: Load) -> bool:
        """Return whether `prepared` accepts problems under this load."""
        return False

    def prepared(self, problem: IVP, work: float = inf) -> Any:
        """Prepare the march of a problem of one body whose start is left open; a ValueError as of `march`.

        Threads may share it. It is called as ``found, squares, fastest = prepared(p, W, scale)``, with the quaternion
        p, scalar last, W, and the factor of the load. What is found is for its method `read`, which returns fields of
        a run; `squares` is the sum of the squares of these numbers, infinite where the run has failed, and `fastest`
        the largest |W|² of the stored states, 0 where no velocity is too large for the step. `work`: how many steps
        its calls will take; what is compiled for few has a method `expect`, to be told of more.
        """
        raise NotImplementedError

    def refusal(self, problem: IVP) -> str | None:
        """Return why `march` does not accept these bodies, start or load, without running it; None if it does."""
        return None

    def require(self, problem: IVP) -> None:
        """Raise what `refusal` returns as a ValueError; it takes dry friction nowhere but in a run."""
        if problem.load.is_dry:
            what = "dry_friction" if problem.load.frictions else "coulomb= of a wheel"
            raise ValueError(f"{what} acts in runs and ensembles alone; use simulate, or simulate_ensemble")
        if (reason := self.refusal(problem)) is not None:
            raise ValueError(reason)

    def require_memory(self, load: Load) -> None:
        """Raise a ValueError where a load has memory, and the integrator does not solve for it."""
        if load.memories and not self.remembers:
            are_wheels = any(isinstance(one, Wheel) for one in load.memories)
            what = "wheels with friction, or a torque that is a function" if are_wheels else "loads with memory"
            name = self.name + " with dissipation" * bool(getattr(self, "dissipation", 0.0))
            raise ValueError(f"{name} does not take {what}; use gauss, which solves for their states")

    def remark(self, problem: IVP) -> str | None:
        """Return a warning about the step of a run of this problem, or None."""
        if self.any_times:
            return None
        return undersampled(problem, self.nodes) or unresolved(
            problem, max(getattr(self, "order", 2), 2), self.is_a_stable
        )

    @property
    def automatic(self) -> float | None:
        """The tolerance of a run if neither step nor tolerance is given; None: at most 0.05 rad per step."""
        return None

    @property
    def nodes(self) -> int:
        """Nodes of the load in a step."""
        return 1

    @property
    def effort(self) -> float:
        """The cost of a step, relative to that of a step of order 2: as measured, proportional to its nodes."""
        return float(self.nodes)

    @property
    def largest_turn(self) -> float:
        """The largest turn in a step, rad, up to which the right solution of its equations is found."""
        return pi / 3

    def turns_exactly(self, problem: IVP) -> bool:
        """Return whether steps of any length are exact for a steady rotation of the bodies of a problem."""
        return self.is_exact_without_load and problem.is_free

    def lag(self, theta: float) -> float:
        """Return the error of a step that turns by `theta`, rad, in a steady rotation; 0 if it is unknown."""
        return 0.0

    def cost(self, problem: IVP, states: int) -> Cost:
        """Return the estimated cost of `march` if this number of `states` is stored; `problem.stored` is ignored."""
        return steps_cost(problem, problem.steps, self.nodes, self.substep_ns)


def unregistrable(name: str, cls: type[Integrator]) -> str | None:
    """Return why a class cannot be an integrator of this name, and what to do; None if it can."""
    if not (isinstance(cls, type) and issubclass(cls, Integrator)):
        return f"INTEGRATORS[{name!r}] must be a subclass of Integrator, got {short_repr(cls)}"
    own = getattr(cls, "name", None)
    if own is None:
        return f"{cls.__name__} has no name: add name = {name!r} to it"
    if name != own:
        return f"INTEGRATORS[{name!r}] is the class {cls.__name__}, whose name is {own!r}: use this as the key"
    if cls.orders and "order" not in {field.name for field in fields(cls)}:
        if "order" in vars(cls).get("__annotations__", ()):
            return f"{cls.__name__} is not a dataclass: add @dataclass(frozen=True) above the class"
        orders = ", ".join(map(str, cls.orders))
        return f"{cls.__name__} has the orders {orders}, but no field order: add order: int = {cls.orders[0]} to it"
    return None
