"""`integrate` and `simulate`: the one way from a problem to a run."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..analysis import observables as obs
from ..analysis.trajectory import Trajectory
from ..geometry.arrays import as_array
from ..integrators import INTEGRATORS, Integrator, Problem, SimulationError, Status
from ..integrators.base import Failure
from ..loads import Load
from ..models.system import DirectorSystem
from .grid import TURN, asked_times, automatic_count, count_steps, off_grid_message, refined_count, stored_steps
from .initial import initial_state

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
        `rotation`) gives its last attitude.
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
        Output at exactly these times, increasing, for integrators that can (continuous); `step` and `store` are then
        left out.
    store : int or "end"
        Keep every `store`-th state, or only the first and the last.
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
        The run cannot go on; what was good is in its `partial`.

    Warns
    -----
    UserWarning
        A breakpoint of the load is off the step grid; a table of the load ends at a non-zero value before `t_end`; a
        load is a Python function, which costs about 0.3 ms a step.
    """
    arguments = {name: value for name, value in locals().items() if name != "system"}
    return integrate(system, **arguments).to_dataset()


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
    """Integrate the motion of a body and return plain arrays; parameters and errors as in `simulate`."""
    scheme = resolve_integrator(integrator, order)
    state = initial_state(system, start, rotation, scalar_first, material_angular_velocity, angular_velocity, project)
    t0 = float(as_array(t_start, "t_start", ())) if t_start is not None else state.time or 0.0
    asked = None if times is None else asked_times(scheme, times, t0, t_end, step, store)
    if asked is not None:
        t1 = float(asked[-1])
    elif t_end is not None:
        t1 = float(as_array(t_end, "t_end", ()))
    else:
        raise ValueError("give t_end=" + (" or times=" if scheme.any_times else ""))
    if not t1 > t0:
        raise ValueError(f"t_end must be after t_start, got t_start = {t0:g} s, t_end = {t1:g} s")
    load = load if load is not None else Load()
    problem = Problem(
        system, state.directors, state.velocities, load, t0, t1, 1, np.array([0, 1]), asked, memory=state.memory
    )
    if scheme.is_compiled:
        _warn_of_cost(load)
    if asked is not None:
        return _run(scheme, problem)

    def attempt(N: int) -> Trajectory:
        with _progress(N, progress) as report:
            return _run(scheme, replace(problem, steps=N, stored=stored_steps(N, store), progress=report))

    if step is not None:
        N = count_steps(t1 - t0, step)
        _warn(load, t0, t1, N)
        return attempt(N)
    K = float(obs.kinetic_energy(state.velocities, system.euler_inertia))
    N = automatic_count(system, K, load, t0, t1)
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
            _warn(load, t0, t1, N)
            return run
        N = refined_count(1.02 * N * turn / TURN, load, t0, t1)


def resolve_integrator(integrator: str | Integrator, order: int | None) -> Integrator:
    """Return the integrator of a name or an instance, of the order asked for."""
    if isinstance(integrator, Integrator):
        if order is not None:
            raise ValueError("an integrator given as an instance brings its order; leave order= out")
        return integrator
    if integrator not in INTEGRATORS:
        raise ValueError(f"unknown integrator {integrator!r}; known are {', '.join(INTEGRATORS)}")
    scheme = INTEGRATORS[integrator]
    if order is None:
        return scheme()
    if not scheme.orders:
        raise ValueError(f"{integrator} has no option order; got order = {order!r}")
    return scheme(order=order)  # type: ignore[call-arg]


def _run(scheme: Integrator, problem: Problem) -> Trajectory:
    result = scheme.march(problem)
    h, failure = problem.step, result.failure
    message = "done" if failure is None else _failure_message(problem, failure)
    run = Trajectory(
        problem.system,
        scheme,
        h if problem.asked is None else None,
        problem.load.description,
        problem.output[: len(result.directors)],
        *result[:6],
        int(failure.status) if failure else 0,
        message,
        result.memory,
    )
    if failure is not None:
        time = float(problem.times(np.array(failure.step)))
        raise SimulationError(message, int(failure.status), time, h, failure.residual, run)
    return run


def _failure_message(problem: Problem, failure: Failure) -> str:
    h, t = problem.step, float(problem.times(np.array(failure.step)))
    where = f"step {failure.step} at t = {t:.12g} s"
    if failure.reason:
        return f"{where}: {failure.reason}"
    if failure.status is Status.BROKEN:
        return f"{where}: the directors are no longer orthonormal (defect {failure.residual:.3g}); try a smaller step"
    remedy = float(f"{h * min(0.5, 0.5 / max(failure.turn, 1e-3)):.0e}")
    cause = f"the body turns {failure.turn:.2g} rad in one step"
    if failure.status is Status.STALLED:
        cause = f"Newton's iteration stalled at a residual of {failure.residual:.3g} ({cause})"
    return f"{where}: {cause}; try step <= {remedy:g}"


def _warn(load: Load, t0: float, t1: float, N: int) -> None:
    messages = [off_grid_message(load, t0, t1, N)]
    for term in load.terms:
        end = term.description.get("times", [t1])[-1]
        if end < t1 and term.description.get("end_value", 0.0) > 0:
            messages.append(
                f"a table of the load ends at t = {end:.12g} s with a non-zero value and is 0 from there to {t1:.12g} s"
            )
    for message in messages:
        if message:
            warnings.warn(message, UserWarning, stacklevel=_callers_level())


def _warn_of_cost(load: Load) -> None:
    slow = [term.description["function"] for term in load.called.terms if term.compiled is None]
    if slow:
        warnings.warn(
            f"the load {', '.join(slow)} runs in Python, and so does every step with it: about 0.3 ms a (sub)step and "
            "5 to 8 calls of it; moment(function, compiled=True) is about 1000 times faster",
            UserWarning,
            stacklevel=_callers_level(),
        )


def _callers_level() -> int:
    """Return the stack level, seen from the caller of this function, of the first frame outside the package."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals["__name__"].startswith("nontwist."):
        level, frame = level + 1, frame.f_back
    return level


@contextmanager
def _progress(N: int, show: bool) -> Iterator[Callable[[int], None] | None]:
    if not show:
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task("steps", total=N)
        yield lambda done: bar.update(task, completed=done)
