"""From a plan and a start to a run; `propagator`: many runs of one plan, checked and laid out once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import count
from math import sqrt
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..analysis.trajectory import Trajectory
from ..geometry.arrays import LARGEST, as_number, vector
from ..geometry.compiled import interruptible
from ..integrators import Integrator, Problem, SimulationError, SimulationInterrupt, Status, stack_march
from ..integrators.base import Outcome
from ..integrators.composed import Composed
from ..integrators.composition import fractions
from ..loads import Load
from ..models.system import DirectorSystem, as_system
from . import completion, costs
from .grid import TURN, automatic_count, refined_count, require_resolution, stored_count
from .notices import announce, failure_message, progress_bar, warn_of_cost, warn_of_grid
from .planning import Plan, planned
from .starts import SPIN, Starts, last_attitude, start_of_one

FEW = 2**12  # nodes of a run that is laid out as a whole, and kept
IDENTITY, STILL, NAME = (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0), "material_angular_velocity"
AT_REST = Starts(np.array([IDENTITY]), np.zeros((1, 3)))


def propagator(
    system: DirectorSystem,
    *,
    t_end: float | None = None,
    step: float | None = None,
    t_start: float | None = None,
    times: ArrayLike | None = None,
    load: Load | None = None,
    integrator: str | Integrator = "lie-midpoint",
    order: int | None = None,
    store: int | Literal["end"] = "end",
    project: bool = False,
) -> Propagator:
    """Return a function from starts to runs of one body, under one load, over one span of time.

    Everything that does not depend on the start is checked, laid out and sampled here, once. A call then costs a few µs
    besides the integration itself, where `integrate` takes a hundred: for fits, shooting, Monte Carlo in your own loop.

    Parameters
    ----------
    system : DirectorSystem
        The body: `standard`, `nontwisting`, `suslov`, `heavy_top`, `with_gravity`.
    t_end, step, t_start, times, load, integrator, order, project
        As in `simulate`. ``step=None`` chooses a step for each start anew, which takes as long as `integrate` does.
    store : int or "end"
        Keep every `store`-th state, or only the first and the last, as by default.

    Returns
    -------
    Propagator

    Raises
    ------
    ValueError
        Wrong input; the message names the value.

    Warns
    -----
    UserWarning
        As `simulate`.

    Examples
    --------
    How far a body turns in 1 s, from three starts:

    >>> from nontwist import nontwisting, propagator
    >>> run = propagator(nontwisting([3, 4, 5]), t_end=1, step=0.01)
    >>> [run(material_angular_velocity=(0, W, 0)).rotation[-1].magnitude().round(6).item() for W in (1, 2, 3)]
    [1.0, 2.0, 3.0]
    """
    system = as_system(system)
    every = 1 if times is not None and store == "end" else store
    plan = planned(system, load, integrator, order, t_start, t_end, times, step, every)
    if plan.steps is not None:
        announced(plan, AT_REST, plan.steps)
    return Propagator(system, plan, project)


class Propagator:
    """A function from starts to runs, made by `propagator`.

    It holds no state: any number of threads may call it at once.

    Attributes
    ----------
    system : DirectorSystem
    load : Load
    integrator : Integrator
    t_start, t_end : float, s

    Examples
    --------
    >>> from nontwist import propagator, sine, standard
    >>> run = propagator(standard([3, 4, 5]), t_end=2, step=0.01, load=sine((0, 0, 1), frequency=0.5))
    >>> W0 = (0.1, 2, 0)
    >>> [run(material_angular_velocity=W0, load_scale=c).load_work.sum().round(3).item() for c in (0, 1, 2)]
    [0.0, 0.018, 0.014]
    """

    def __init__(self, system: DirectorSystem, plan: Plan, project: bool) -> None:
        self.system, self._plan, self._project = system, plan, project
        self._axis = None if system.axis is None else system.axis.tolist()
        self._prepared = None
        if plan.steps is not None:
            require_resolution(plan.t_start, plan.t_end, plan.steps)
            self._prepared = Prepared(plan, plan.steps) if Prepared.suits(plan, plan.steps) else None

    def __call__(
        self,
        *,
        material_angular_velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
        rotation: Any = None,
        scalar_first: bool | None = None,
        start: Any = None,
        load_scale: float = 1.0,
    ) -> Trajectory:
        """Return the run from a start: the bits of `integrate` with the same arguments.

        Parameters
        ----------
        material_angular_velocity, angular_velocity, rotation, scalar_first, start
            As in `simulate`. The span stays that of the propagator, whenever `start` ends.
        load_scale : float
            Factor of the load.

        Returns
        -------
        Trajectory

        Raises
        ------
        ValueError, SimulationError, SimulationInterrupt
            As `simulate`.
        """
        is_plain = type(load_scale) is float and abs(load_scale) <= LARGEST
        scale = float(load_scale if is_plain else as_number(load_scale, "load_scale"))
        if self._prepared is not None and start is None and angular_velocity is None:
            W = STILL if material_angular_velocity is None else vector(material_angular_velocity, NAME)
            p = IDENTITY if rotation is None else last_attitude(rotation, scalar_first)[0]
            W, is_held = self._held(W)
            if is_held and (run := self._prepared.run(p, W, scale)) is not None:
                return run
        begin = start_of_one(
            self.system, start, rotation, scalar_first, material_angular_velocity, angular_velocity, self._project
        )
        begin = begin._replace(load_scale=np.array([scale]))
        if self._plan.steps is None:
            return run_of(self._plan, begin)
        return marched(self._plan, begin, self._plan.steps)

    def _held(self, W: tuple[float, float, float]) -> tuple[tuple[float, float, float], bool]:
        """Return W without its part along the constrained axis, and whether that is round-off or to be removed."""
        if self._axis is None:
            return W, True
        (x, y, z), (a, b, c) = W, self._axis
        spin = x * a + y * b + z * c
        is_held = self._project or abs(spin) <= SPIN * sqrt(x * x + y * y + z * z)
        return (x - spin * a, y - spin * b, z - spin * c), is_held

    @property
    def load(self) -> Load:
        """The load."""
        return self._plan.load

    @property
    def integrator(self) -> Integrator:
        """The integrator."""
        return self._plan.scheme

    @property
    def t_start(self) -> float:
        """Time of the starts, s."""
        return self._plan.t_start

    @property
    def t_end(self) -> float:
        """Time at which runs end, s."""
        return self._plan.t_end

    def __repr__(self) -> str:
        scheme, steps = self._plan.scheme, self._plan.steps
        order = f" of order {scheme.order}" if isinstance(scheme, Composed) else ""
        how = "" if self._plan.asked is not None or steps is None else f", {steps} steps"
        return f"<Propagator: {self.system!r}, {scheme.name}{order}, {self.t_start:g} to {self.t_end:g} s{how}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Propagator, (self.system, self._plan, self._project)


class Prepared:
    """A plan whose steps are laid out and whose load is sampled: what only lacks a start."""

    def __init__(self, plan: Plan, steps: int) -> None:
        from ..integrators.prepared_march import PreparedMarch

        assert isinstance(plan.scheme, Composed)
        problem = replace(plan.problem(AT_REST, steps), intervals=True)
        self._march, self._terms, body = PreparedMarch(problem, plan.scheme), plan.load.description, plan.systems[0]
        self._damped = bool(plan.load.damping.any())  # is laid out with its scale
        self._safe = completion.SAFE / max(1.0, float(abs(body.euler_inertia).max()))
        self._known = {
            "system": body,
            "integrator": plan.scheme,
            "step": problem.step,
            "load": self._terms,
            "time": problem.output,
        }

    @staticmethod
    def suits(plan: Plan, steps: int, most: int | None = None) -> bool:
        """Whether a plan can be prepared: for a compiled step and load, and nodes that fit into one part, or `most`."""
        if getattr(type(plan.scheme), "march", None) is not Composed.march or not plan.load.is_compiled:
            return False
        assert isinstance(plan.scheme, Composed)
        return steps * len(fractions(plan.scheme.order)) <= min(stack_march.NODES, most or stack_march.NODES)

    def run(self, p: Any, W: Any, scale: float) -> Trajectory | None:
        """Return the run from the quaternion `p`, scalar last, and W; None where it fails or must be laid out anew."""
        if scale != 1 and self._damped:
            return None
        found, numbers, is_done = self._march(p, W, scale)
        if not (is_done and completion.sum_of_squares(numbers) < self._safe):
            return None
        run = Trajectory.__new__(Trajectory)
        vars(run).update(self._known)
        vars(run).update(found)
        if scale != 1:
            vars(run)["load"] = [term | {"scale": scale * term["scale"]} for term in self._terms]
        return run


@lru_cache(maxsize=64)
def asked_before(plan: Plan, steps: int) -> Iterator[int]:
    """Return what counts how often a plan was met before: to lay it out pays from the second time on."""
    return count()


@lru_cache(maxsize=16)
def prepared(plan: Plan, steps: int) -> Prepared:
    """Return what is laid out for a plan, kept for the calls that follow."""
    return Prepared(plan, steps)


def run_of(plan: Plan, begin: Starts, progress: bool = False) -> Trajectory:
    """Return the run that a start makes of a plan, with the step of the plan or one that is chosen for the start.

    Raises
    ------
    ValueError, SimulationError, SimulationInterrupt
        As `nontwist.simulate`.
    """
    if plan.steps is not None:
        announced(plan, begin, plan.steps)
        return marched(plan, begin, plan.steps, progress)
    load, t0, t1 = plan.load, plan.t_start, plan.t_end
    N = automatic_count(plan.systems, begin.velocity, load, t0, t1, begin.load_scale)
    announced(plan, begin, N)
    while True:
        try:
            run = marched(plan, begin, N, progress)
        except SimulationError as error:
            if error.status not in (Status.TURN, Status.STALLED):
                raise
            N = refined_count(4 * N, load, t0, t1)
            continue
        fastest = float(np.sqrt(np.square(run.material_angular_velocity).sum(axis=1)).max())
        turn = fastest * (t1 - t0) / N
        if turn <= TURN * (1 + 1e-9):
            warn_of_grid(load, t0, t1, N)
            return run
        N = refined_count(1.02 * N * turn / TURN, load, t0, t1)


def announced(plan: Plan, begin: Starts, steps: int) -> None:
    """Refuse what does not fit into memory; warn of what takes long, of slow loads, of a grid that the caller gave."""
    scheme, load = plan.scheme, plan.load
    if load.terms and scheme.is_compiled:
        warn_of_cost(load)
    states = len(plan.asked) if plan.asked is not None else stored_count(steps, plan.store)
    whole = plan.problem(begin, steps, np.array([0, steps]))
    announce(costs.run_cost(scheme, whole, states), scheme, whole)
    if plan.asked is None and plan.steps is not None:
        warn_of_grid(load, plan.t_start, plan.t_end, steps)


def marched(plan: Plan, begin: Starts, steps: int, progress: bool = False) -> Trajectory:
    """Return the run of so many steps."""
    is_new = begin.memory is None and begin.normal is None and begin.grid is None
    is_new = is_new and not progress and plan.asked is None and Prepared.suits(plan, steps, FEW)
    if is_new and next(asked_before(plan, steps)):
        require_resolution(plan.t_start, plan.t_end, steps)
        W, scale = begin.velocity[0].tolist(), float(begin.load_scale[0])
        run = prepared(plan, steps).run(begin.quaternion[0], W, scale)
        if run is not None:
            return run
    problem = replace(plan.problem(begin, steps), intervals=True)
    if not progress:
        with interruptible():
            return trajectory(plan, problem, completion.march(plan.scheme, problem))
    with progress_bar(steps) as report, interruptible():
        problem = replace(problem, progress=report)
        return trajectory(plan, problem, completion.march(plan.scheme, problem))


def trajectory(plan: Plan, problem: Problem, outcome: Outcome) -> Trajectory:
    """Return the run that has come out; an error that holds it where it has failed."""
    failure, good, h = outcome.failure(), int(outcome.good[0]), problem.step
    time = problem.output[:good]
    if outcome.end is not None:
        time = np.append(time[:-1], problem.times(outcome.end))
    message = "done" if failure is None else failure_message(problem, failure)
    assert outcome.intervals is not None
    multipliers, moment, work, iterations = outcome.intervals
    means = slice(max(good - 1, 0))
    run = Trajectory(
        problem.system,
        plan.scheme,
        h if problem.asked is None else None,
        problem.member(0).load.description,
        time,
        outcome.states.part(0, slice(good)),
        multipliers[0, means],
        moment[0, means],
        work[0, means],
        None if iterations is None else iterations[0, means],
        int(failure.status) if failure else 0,
        message,
        None if outcome.memory is None else outcome.memory[0],
        None if problem.before is None else problem.before.origin,
    )
    if failure is None:
        return run
    if failure.status is Status.INTERRUPTED:
        raise SimulationInterrupt(message, run)
    raise SimulationError(message, int(failure.status), problem.began(failure.step), h, failure.residual, run)
