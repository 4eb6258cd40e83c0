"""`integrate` and `simulate`: the one way from a problem to a run."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..analysis import observables as obs
from ..analysis.trajectory import Trajectory
from ..geometry.arrays import as_number
from ..geometry.compiled import interruptible
from ..geometry.values import nearest, shown
from ..integrators import INTEGRATORS, Integrator, Problem, SimulationError, SimulationInterrupt, Status
from ..integrators.base import Failure
from ..integrators.costs import Cost
from ..integrators.ensemble import Ensemble
from ..loads import Load, as_load
from ..loads.terms import name_of
from ..models.system import DirectorSystem, as_system
from . import completion, costs
from .grid import (
    TURN,
    asked_times,
    automatic_count,
    count_steps,
    joined,
    load_messages,
    refined_count,
    stored_count,
    stored_steps,
)
from .initial import initial_state
from .signals import shown_bar

if TYPE_CHECKING:
    import xarray


def simulate(
    system: DirectorSystem,
    *,
    t_end: float | None = None,
    step: float | None = None,
    t_start: float | None = None,
    start: Any = None,
    rotation: Any = None,
    scalar_first: bool | None = None,
    material_angular_velocity: ArrayLike | None = None,
    angular_velocity: ArrayLike | None = None,
    load: Load | None = None,
    integrator: str | Integrator = "lie-midpoint",
    order: int | None = None,
    times: ArrayLike | None = None,
    store: int | Literal["end"] = 1,
    project: bool = False,
    progress: bool = False,
) -> xarray.Dataset:
    """Integrate the motion of a body and return it as a dataset.

    Parameters
    ----------
    system : DirectorSystem
        The body: `standard`, `nontwisting`, `suslov`, `heavy_top`, `with_gravity`.
    t_end : float, s
        May be left out where `times` are given.
    step : float, s, optional
        Must divide the span. None: the body turns by at most 0.05 rad a step and the load is resolved; the step taken
        is recorded in the run.
    t_start : float, s, optional
        0, or where `start` ends.
    start : Dataset or Trajectory, optional
        Continue from the last state of a run, director velocities included. A motion without velocities (see
        `rotation`) gives its last attitude. Where whole steps of that run lead to `t_end`, its time grid is continued
        as well: the step has its bits, and loads are sampled at the nodes of one run from the first start to `t_end`.
        With lie-midpoint and energy-momentum the states are then, bit for bit, those of that one run, wherever it has
        the same step: always after an interrupt, and from T to 2 T after a run from 0 to T. Otherwise, and for other
        integrators, they agree to round-off.
    rotation : Rotation, (3, 3) Λ, (4,) quaternion, DataArray, ..., optional
        Initial attitude, body to space; the identity by default. See `nontwist.rotation` for all forms.
    scalar_first : bool, optional
        Order of a quaternion given as a plain array.
    material_angular_velocity : (3,) array, rad/s, optional
        Initial angular velocity W in body components; or
    angular_velocity : (3,) array, rad/s, optional
        w in space. At rest by default.
    load : Load, optional
        External moments.
    integrator : str or Integrator
        A key of `INTEGRATORS` or an instance.
    order : int, optional
        Order of the integrator, its own default by default.
    times : (k,) array, s, optional
        Output at exactly these times, increasing, for integrators that can ("exact" and "continuous"); `step` and
        `store` are then left out.
    store : int or "end"
        Keep every `store`-th state, or only the first and the last. All by default; `simulate_ensemble` keeps the ends.
    project : bool
        Remove an initial spin about the constrained axis instead of refusing it.
    progress : bool
        Show a bar on stderr.

    Returns
    -------
    xarray.Dataset
        States on `time`; moments, multipliers and work on `midtime`, one entry per stored interval.

    Raises
    ------
    ValueError
        Wrong input; the message names the value.
    SimulationError
        The run cannot continue, or its result is not finite or not complete; what was good is in its `partial`.
    SimulationInterrupt
        Ctrl-C; what was done is in its `partial`.

    Warns
    -----
    UserWarning
        A breakpoint of the load is off the step grid; a table of the load ends at a non-zero value before `t_end`; a
        load is a Python function, which costs about 0.1 ms a step. The run will take more than 10 s or 1 GB.

    Examples
    --------
    Spun about its middle axis, a body turns over:

    >>> from nontwist import simulate, standard
    >>> run = simulate(standard([3, 4, 5]), t_end=20, material_angular_velocity=(0.1, 2, 0))
    >>> W2 = run.material_angular_velocity.sel(director=2)
    >>> round(float(W2[0]), 2), round(float(W2.min()), 2)
    (2.0, -2.0)
    >>> run.spatial_momentum.attrs["units"]
    'kg m2 s-1'
    """
    arguments = {name: value for name, value in locals().items() if name != "system"}
    run = integrate(system, **arguments)
    try:
        return run.to_dataset()
    except KeyboardInterrupt as stop:
        message = f"{str(stop) or 'interrupted'} while the dataset was made; partial holds the complete run"
        raise SimulationInterrupt(message, run) from None


def integrate(
    system: DirectorSystem,
    *,
    t_end: float | None = None,
    step: float | None = None,
    t_start: float | None = None,
    start: Any = None,
    rotation: Any = None,
    scalar_first: bool | None = None,
    material_angular_velocity: ArrayLike | None = None,
    angular_velocity: ArrayLike | None = None,
    load: Load | None = None,
    integrator: str | Integrator = "lie-midpoint",
    order: int | None = None,
    times: ArrayLike | None = None,
    store: int | Literal["end"] = 1,
    project: bool = False,
    progress: bool = False,
) -> Trajectory:
    """Integrate the motion of a body and return plain arrays: what `simulate` does, without its dataset.

    Parameters
    ----------
    system, t_end, step, t_start, start, rotation, scalar_first, material_angular_velocity, angular_velocity, load
        As in `simulate`.
    integrator, order, times, store, project, progress
        As in `simulate`.

    Returns
    -------
    Trajectory

    Raises
    ------
    ValueError, SimulationError, SimulationInterrupt
        As `simulate`.

    Warns
    -----
    UserWarning
        As `simulate`.

    Examples
    --------
    >>> from nontwist import integrate, nontwisting
    >>> trajectory = integrate(nontwisting([3, 4, 5]), t_end=1, step=0.01, angular_velocity=(0, 2, 0), store="end")
    >>> trajectory.time
    array([0., 1.])
    >>> round(float(trajectory.rotation[-1].magnitude()), 6)
    2.0
    """
    scheme, system = resolve_integrator(integrator, order), as_system(system)
    state = initial_state(system, start, rotation, scalar_first, material_angular_velocity, angular_velocity, project)
    t0 = as_number(t_start, "t_start") if t_start is not None else state.time or 0.0
    asked = None if times is None else asked_times(scheme, times, t0, t_end, step, store)
    if asked is not None:
        t1 = float(asked[-1])
    elif t_end is not None:
        t1 = as_number(t_end, "t_end")
    else:
        raise ValueError("give t_end=" + (" or times=" if scheme.any_times else ""))
    if not t1 > t0:
        raise ValueError(f"t_end must be after t_start, got t_start = {t0:g} s, t_end = {t1:g} s")
    load = as_load(load)
    if load.terms and scheme.is_compiled:
        warn_of_cost(load)

    def problem(N: int, stored: NDArray[np.int64], report: Callable[[int], None] | None = None) -> Problem:
        q, v, _, memory, _ = state
        before = joined(state.grid, t0, t1, N) if asked is None else None
        return Problem(system, q, v, load, t0, t1, N, stored, asked, report, memory, before)

    def announced(N: int, states: int) -> None:
        whole = problem(N, np.array([0, N]))
        announce(costs.run_cost(scheme, whole, states), scheme, whole)

    if asked is not None:
        announced(1, len(asked))
        return _run(scheme, problem(1, np.array([0, 1])))

    def attempt(N: int) -> Trajectory:
        if not progress:
            return _run(scheme, problem(N, stored_steps(N, store)))
        with progress_bar(N) as report:
            return _run(scheme, problem(N, stored_steps(N, store), report))

    if step is not None:
        N = count_steps(t1 - t0, step)
        announced(N, stored_count(N, store))
        warn_of_grid(load, t0, t1, N)
        return attempt(N)
    K = float(obs.kinetic_energy(state.velocities, system.euler_inertia))
    N = automatic_count(system, K, load, t0, t1)
    announced(N, stored_count(N, store))
    while True:
        try:
            run = attempt(N)
        except SimulationError as error:
            if error.status not in (Status.TURN, Status.STALLED):
                raise
            N = refined_count(4 * N, load, t0, t1)
            continue
        fastest = float(np.linalg.norm(obs.angular_velocity(run.directors, run.director_velocities), axis=1).max())
        turn = fastest * (t1 - t0) / N
        if turn <= TURN * (1 + 1e-9):
            warn_of_grid(load, t0, t1, N)
            return run
        N = refined_count(1.02 * N * turn / TURN, load, t0, t1)


def resolve_integrator(integrator: str | Integrator, order: int | None) -> Integrator:
    """Return the integrator of a name or an instance, of the order asked for."""
    if isinstance(integrator, Integrator):
        if order is not None:
            raise ValueError("an integrator given as an instance brings its order; leave order= out")
        return integrator
    if not isinstance(integrator, str) or integrator not in INTEGRATORS:
        raise ValueError(f"unknown integrator {shown(integrator)}; {nearest(integrator, INTEGRATORS)}")
    scheme = INTEGRATORS[integrator]
    if order is None:
        return scheme()
    if not scheme.orders:
        raise ValueError(f"{integrator} has no option order; got order = {order!r}")
    return scheme(order=order)  # type: ignore[call-arg]


def _run(scheme: Integrator, problem: Problem) -> Trajectory:
    with interruptible():
        result = completion.march(scheme, problem)
    h, failure = problem.step, result.failure
    time = problem.output[: len(result.directors)]
    if result.end is not None:
        time = np.append(time[:-1], problem.times(result.end))
    message = "done" if failure is None else failure_message(problem, failure)
    run = Trajectory(
        problem.system,
        scheme,
        h if problem.asked is None else None,
        problem.load.description,
        time,
        *result[:6],
        int(failure.status) if failure else 0,
        message,
        result.memory,
        None if problem.before is None else problem.before.origin,
    )
    if failure is None:
        return run
    if failure.status is Status.INTERRUPTED:
        raise SimulationInterrupt(message, run)
    raise SimulationError(message, int(failure.status), problem.began(failure.step), h, failure.residual, run)


def failure_message(problem: Problem | Ensemble, failure: Failure) -> str:
    """Return where and why a march stopped, with a remedy."""
    h, on_grid, began = problem.step, problem.asked is None, problem.began(failure.step)
    if failure.status is Status.INTERRUPTED:
        steps = f", after {failure.step} of {problem.steps} steps" if on_grid else ""
        return f"{failure.reason or 'interrupted'} at t = {began:.12g} s{steps}"
    where = f"step {failure.step} at t = {began:.12g} s" if on_grid else f"after t = {began:.12g} s"
    if failure.reason:
        return f"{where}: {failure.reason}"
    if failure.status is Status.BROKEN:
        return f"{where}: the directors are no longer orthonormal (defect {failure.residual:.3g}); try a smaller step"
    remedy = float(f"{h * min(0.5, 0.5 / max(failure.turn, 1e-3)):.0e}")
    cause = f"the body turns {failure.turn:.2g} rad in one step"
    if failure.status is Status.STALLED:
        cause = f"Newton's iteration stalled at a residual of {failure.residual:.3g} ({cause})"
    return f"{where}: {cause}; try step <= {remedy:g}"


def warn_of_grid(load: Load, t0: float, t1: float, N: int) -> None:
    """Warn of breakpoints off the grid and of tables that end too early."""
    if not load.terms:
        return
    for message in load_messages(load, t0, t1, N):
        warnings.warn(message, UserWarning, stacklevel=callers_level())


def warn_of_cost(load: Load) -> None:
    """Warn of loads that run in Python."""
    slow = [name_of(term.function) for term in load.called.terms if term.compiled is None]
    if slow:
        warnings.warn(
            f"the load {', '.join(slow)} runs in Python, 4 to 8 calls of it and about 0.1 ms a (sub)step; "
            "moment(function, compiled=True) is about 100 times faster",
            UserWarning,
            stacklevel=callers_level(),
        )


def announce(cost: Cost, scheme: Integrator, problem: Problem) -> None:
    """Refuse what does not fit into the free memory; warn of what will run, and take more than 10 s or 1 GB."""
    if (reason := costs.excess(cost)) is not None:
        raise ValueError(reason)
    if (text := costs.notice(cost)) is not None and scheme.refusal(problem) is None:
        warnings.warn(text, UserWarning, stacklevel=callers_level())


def callers_level() -> int:
    """Return the stack level, seen from the caller of this function, of the first frame outside the package."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("nontwist."):
        level, frame = level + 1, frame.f_back
    return level


@contextmanager
def progress_bar(N: int, what: str = "steps") -> Iterator[Callable[[float], None]]:
    """Show a bar on stderr and give what takes the number of those that are done."""
    from rich.console import Console
    from rich.progress import Progress

    with shown_bar(Progress(console=Console(stderr=True))) as bar:
        task = bar.add_task(what, total=N)
        yield lambda done: bar.update(task, completed=done)
