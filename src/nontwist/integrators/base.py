"""What every integrator takes and returns, and how one fails.

An integrator is data: a frozen dataclass with a name, an order, its options and one `march` from a `Problem` to a
`March`. Steps lie on the uniform grid of `time_grid`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..geometry.values import among, shown
from ..loads import Load
from ..models.system import DirectorSystem
from .costs import Cost, steps_cost
from .time_grid import Before, OnGrid

if TYPE_CHECKING:
    from .ensemble import Ensemble, Outcome

ORTHONORMAL = 1e-9


class Status(IntEnum):
    """How a run ended.

    Examples
    --------
    >>> from nontwist import Status, nontwisting, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, angular_velocity=(0, 1, 0))
    >>> Status(run.attrs["status"]).name, run.attrs["message"]
    ('OK', 'done')
    """

    OK = 0  #: t_end reached, all numbers finite, times increasing
    TURN = 1  #: more than half a turn in one step
    STALLED = 2  #: Newton's iteration does not converge
    BROKEN = 3  #: the directors are no longer a right-handed orthonormal triad
    LOAD = 4  #: a load that depends on the state failed
    SOLVER = 5  #: SciPy's solver gave up
    INTERRUPTED = 6  #: stopped from outside: Ctrl-C, SIGTERM, SIGHUP
    NOT_FINITE = 7  #: a number of the result is infinite or NaN
    INCOMPLETE = 8  #: the integrator returned without an error and without all states


@dataclass(frozen=True, eq=False)
class Problem(OnGrid):
    """An initial value problem on a uniform time grid."""

    system: DirectorSystem
    directors: Array  # (3, 3) at t_start, rows d_i
    velocities: Array  # (3, 3) at t_start, rows d_i'
    load: Load
    t_start: float
    t_end: float
    steps: int
    stored: NDArray[np.int64]
    asked: Array | None = None
    progress: Callable[[int], None] | None = None
    memory: Array | None = None  # the `March.memory` of the run that ended in this state
    before: Before | None = None


class Failure(NamedTuple):
    """Where and how a march stopped."""

    status: Status
    step: int  # number of the step that failed, from 0
    residual: float
    turn: float  # rad the body turns in that step
    reason: str = ""


class March(NamedTuple):
    """The stored states of a run; where it failed, those before the failure.

    The multipliers have a column for each of 11, 22, 33, 23, 13, 12 where the integrator has them, then one for the
    nonholonomic constraint where the body has an axis.
    """

    directors: Array  # (n+1, 3, 3)
    velocities: Array  # (n+1, 3, 3)
    multipliers: Array  # (n, m) means over the stored intervals: m = 6 (λ), 7 (λ, μ), 1 (μ) or 0
    moment: Array  # (n, 3) mean moment of the load
    load_work: Array  # (n,)
    newton_iterations: NDArray[np.int64] | None  # (n,) maximum over the interval
    failure: Failure | None = None
    memory: Array | None = None  # the last state as the integrator carries it, to continue bit for bit
    end: int | None = None  # number of steps at the last state, where it is not one that was to be stored


class Step(NamedTuple):
    """One step of a scheme."""

    directors: Array
    velocities: Array
    multipliers: Array
    moment: Array
    load_work: float
    newton_iterations: int
    failure: Failure | None


class SimulationError(RuntimeError):
    """A run that cannot go on.

    Attributes
    ----------
    status : int, see `Status`
    time : float, s, where the failed step begins
    step : float, s, the step size
    residual : float, of the equations of the failed step
    partial : Trajectory, what was good before

    Examples
    --------
    >>> from nontwist import SimulationError, simulate, standard
    >>> try:
    ...     run = simulate(standard([3, 4, 5]), t_end=1, step=0.5, material_angular_velocity=(0, 0, 20))
    ... except SimulationError as error:
    ...     print(error)
    ...     run = error.partial.to_dataset()  # here the start alone
    step 0 at t = 0 s: the body turns 10 rad in one step; try step <= 0.03
    """

    def __init__(
        self, message: str, status: int, time: float, step: float, residual: float, partial: Any = None
    ) -> None:
        super().__init__(message)
        self.status, self.time, self.step, self.residual, self.partial = status, time, step, residual, partial

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.status, self.time, self.step, self.residual, self.partial)


class SimulationInterrupt(KeyboardInterrupt):
    """A run that was stopped from outside, by Ctrl-C or any other `KeyboardInterrupt`.

    Attributes
    ----------
    partial : Trajectory
        What was done: `start=` goes on from it. Its status is `Status.INTERRUPTED`, or `Status.OK` where the run was
        complete and only its dataset was not yet made.

    Examples
    --------
    Half-way through, a load does what Ctrl-C would; then the run goes on without it:

    >>> from nontwist import SimulationInterrupt, moment, nontwisting, simulate
    >>> def interrupting(t, directors, angular_velocity):
    ...     if t > 1:
    ...         raise KeyboardInterrupt
    ...     return 0, 0, 0
    >>> body, how = nontwisting([3, 4, 5]), {"t_end": 2, "step": 0.25, "integrator": "continuous"}
    >>> try:
    ...     simulate(body, angular_velocity=(0, 5, 0), load=moment(interrupting), **how)
    ... except SimulationInterrupt as stop:
    ...     print(stop)
    ...     rest = simulate(body, start=stop.partial, **how)
    interrupted at t = 0.75 s, after 3 of 8 steps
    >>> rest.time.values[[0, -1]]
    array([0.75, 2.  ])
    """

    def __init__(self, message: str, partial: Any) -> None:
        super().__init__(message)
        self.partial = partial

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.partial)


@dataclass(frozen=True)
class Integrator(ABC):
    """Base of all integrators: the options are the fields, `order` among them where there is a choice."""

    name: ClassVar[str]
    orders: ClassVar[tuple[int, ...]] = ()
    limit: ClassVar[str] = ""  # why there is no higher order
    any_times: ClassVar[bool] = False  # whether output may stand at any times
    is_compiled: ClassVar[bool] = False  # whether a load in Python slows it down
    substep_ns: ClassVar[float] = 100_000.0  # of a substep on a slow core; by default as in Python
    together: ClassVar[float] = 0.0  # times that `march_many` is quicker than `march`; 0 where there is none
    sources: ClassVar[Mapping[str, str]] = {}  # of what it claims, by kind of check: "order"; "invariant" where exact
    counts: ClassVar[Mapping[int, tuple[int, ...]]] = {  # steps in 2 s, to measure an order with
        1: (256, 512, 1024),
        2: (64, 128, 256),
        4: (32, 64, 128),
        6: (24, 32, 48),
        8: (20, 24, 32),
    }

    def __post_init__(self) -> None:
        order = getattr(self, "order", None)
        if self.orders and not among(order, self.orders):
            known = ", ".join(map(str, self.orders))
            why = f": {self.limit}" if self.limit and isinstance(order, int) and order > self.orders[-1] else ""
            raise ValueError(f"{self.name} has the order {known}; got order = {shown(order)}{why}")

    @classmethod
    def variants(cls) -> list[Self]:
        """Return one of every order: what is compared where nothing is chosen."""
        return [cls(order=k) for k in cls.orders] if cls.orders else [cls()]  # type: ignore[call-arg]

    @classmethod
    def measuring(cls, order: int) -> tuple[int, ...]:
        """Return numbers of steps that show the order; a ValueError where `counts` lacks it."""
        if order not in cls.counts:
            raise ValueError(
                f"{cls.name} has the order {order}, but {cls.__name__}.counts no steps to measure it with: "
                f"counts = Integrator.counts | {{{order}: (n, 2 * n, 4 * n)}}"
            )
        return cls.counts[order]

    @abstractmethod
    def march(self, problem: Problem) -> March:
        """Integrate `problem`; a failure is part of the result, not an exception.

        Raises
        ------
        ValueError
            What `refusal` returns; a load that is wrong from the start.
        """

    def refusal(self, problem: Problem) -> str | None:
        """Return why `march` will refuse this body, start or load; None where it takes them. Nothing is run."""
        return None

    def cost(self, problem: Problem, states: int) -> Cost:
        """Return what `march` will take, about, when `states` are stored; `problem.stored` is not looked at."""
        return steps_cost(problem, problem.steps, 1, self.substep_ns)

    def march_many(self, ensemble: Ensemble, threads: int) -> Outcome | None:
        """Integrate many problems at once; None where there is no quicker way than one after the other."""
        return None


def march(problem: Problem, constraints: int, step: Callable[[int, Array, Array], Step], precision: Any) -> March:
    """Repeat ``step(k, directors, velocities)`` over the grid, with a state in `precision`, and keep what is stored."""
    q, v, stored = problem.directors.astype(precision), problem.velocities.astype(precision), problem.stored
    directors, velocities = np.empty((len(stored), 3, 3)), np.empty((len(stored), 3, 3))
    directors[0], velocities[0] = q, v
    n = len(stored) - 1
    multipliers, moment = np.zeros((n, constraints)), np.zeros((n, 3))
    work, iterations = np.zeros(n), np.zeros(n, dtype=np.int64)
    done, failure = 0, None
    try:
        for k in range(problem.steps):
            one = step(k, q, v)
            failure = one.failure or _broken(k, one.directors)
            if failure:
                break
            q, v = one.directors, one.velocities
            length = stored[done + 1] - stored[done]
            multipliers[done] += one.multipliers / length
            moment[done] += one.moment / length
            work[done] += one.load_work
            iterations[done] = max(iterations[done], one.newton_iterations)
            if k + 1 == stored[done + 1]:
                directors[done + 1], velocities[done + 1] = q, v
                done += 1
            if problem.progress:
                problem.progress(k + 1)
    except KeyboardInterrupt as stop:
        failure = Failure(Status.INTERRUPTED, int(stored[done]), np.nan, np.nan, str(stop))
    return March(
        directors[: done + 1],
        velocities[: done + 1],
        multipliers[:done],
        moment[:done],
        work[:done],
        iterations[:done],
        failure,
    )


def _broken(k: int, q: Array) -> Failure | None:
    defect = float(abs(q @ q.T - np.eye(3)).max())
    if defect <= ORTHONORMAL and np.linalg.det(q.astype(float)) > 0:
        return None
    return Failure(Status.BROKEN, k, defect, np.nan)
