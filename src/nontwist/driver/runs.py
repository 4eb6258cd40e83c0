"""`integrate` and `simulate`: one run, as plain arrays or as a dataset."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Unpack

from ..analysis.trajectory import Trajectory
from ..integrators import SimulationInterrupt
from ..models.system import DirectorSystem
from .problem import OfRun, Problem, posed, prepared, takes
from .single_run import run_of

if TYPE_CHECKING:
    import xarray

    from .starts import BodyState

    Event = Callable[[float, BodyState], float]
    Events = Event | Sequence[Event]


@takes(OfRun, "progress")
def simulate(
    system: DirectorSystem | Problem,
    *,
    progress: bool = False,
    **keywords: Unpack[OfRun],
) -> xarray.Dataset:
    """Integrate the motion of a body and return it as a dataset.

    Parameters
    ----------
    system : DirectorSystem or Problem
        The body: `standard`, `nontwisting`, `suslov`, `heavy_top`, `with_gravity`; or a whole problem.
    t_end : float, s
        Optional where `times` are given.
    step : float, s, optional
        Must divide the span. None: the breakpoints of the load are nodes, with equal steps between neighbouring
        breakpoints. `gauss` of an order above 2 meets a tolerance of 1e-8, and stores states that are 0.05 rad apart,
        and 0.2 rad of a swing or of the gyration that rotors and wheels cause, up to 20,000 states; with other
        integrators the body turns by at most 0.05 rad per step. The longest step is recorded, with `stretches`.
    tolerance : float, rad, optional
        Instead of `step`: the steps, and the order unless it is given, are chosen such that the error of the attitude,
        and that of W relative to its largest magnitude (for a body at rest: to 1 rad per run), are below the tolerance
        at all stored states. `error_estimate` is the difference of two runs.
    t_start : float, s, optional
        By default 0, or the end of `start`.
    start : Dataset or Trajectory, optional
        Continue from the last state of a run, including the director velocities. A motion without velocities (see
        `rotation`) provides only its last attitude. If whole steps of that run lead to `t_end`, its time grid is
        continued as well: with lie-midpoint and energy-momentum the states are then, bit for bit, those of a single
        run; otherwise they agree to round-off, or to the tolerance where steps are chosen for one. Of a body with
        another inertia W is kept, with a warning.
    rotation : Rotation, (3, 3) Λ, (4,) quaternion, DataArray, ..., optional
        Initial attitude, body to space; the identity by default. See `nontwist.rotation` for all forms; Euler angles
        are ``Rotation.from_euler("ZXZ", angles)`` of SciPy, modified Rodrigues parameters ``Rotation.from_mrp(p)``.
    scalar_first : bool, optional
        Order of a quaternion given as a plain array.
    material_angular_velocity : (3,) array, rad/s, optional
        Initial angular velocity W in body components. Give this or `angular_velocity`; at rest by default.
    angular_velocity : (3,) array, rad/s, optional
        Initial angular velocity w in space.
    load : Load, optional
        External moments.
    integrator : str or Integrator
        A key of `INTEGRATORS` or an instance of an integrator.
    order : int, optional
        Order of accuracy of the integrator. By default that of the integrator; with `tolerance` the order with the
        least cost.
    times : (k,) array, s, optional
        Increasing times at which to output, instead of at every step. Not together with `store`, nor, with "exact" and
        "continuous", with `step`. The steps are those of the run without them, and a state between two nodes has the
        order and the invariants of the integrator. What is on `midtime` belongs to the intervals between these times.
    store : int or "end"
        Store every `store`-th state, or only the first and the last. All by default; `simulate_ensemble` stores only
        the ends by default.
    events : callable or list of callables, optional
        Functions ``event(t, state)`` of the time and a `BodyState`, with the attributes `direction` and `terminal` of
        SciPy's `solve_ivp`: an event occurs where a function crosses zero. Roots are found to 1e-12 h + 4 eps |t|. The
        function is evaluated at least every quarter of a radian that the body turns, and more often where it comes
        near zero in between; if it only touches zero, the event is missed.
    project : bool
        Remove an initial spin about the constrained axis instead of refusing it.
    progress : bool
        Show a progress bar on stderr; not with `events`.

    Returns
    -------
    xarray.Dataset
        States on `time`; moments, multipliers and work on `midtime`, one entry per stored interval. With `events`,
        `t_events` and the states at these times are on `event`, in chronological order; the coordinate `event_name`
        contains the names of the functions. If an event has ended the run, its state is the last one, and the attribute
        `message` names the event.

    Raises
    ------
    ValueError
        An argument is invalid, or an event function fails; the message names it.
    SimulationError
        The run cannot continue, or its result is not finite or not complete; `partial` contains the states before the
        failure.
    SimulationInterrupt
        Ctrl-C was pressed; `partial` contains the completed part.

    Warns
    -----
    UserWarning
        A breakpoint of the load is off the step grid; a table of the load ends at a non-zero value before `t_end`; a
        load is a Python function, which costs about 0.1 ms per step; or the run will take more than 10 s or 1 GB.

    Examples
    --------
    A body spinning about its middle axis turns over:

    >>> from nontwist import simulate, standard
    >>> run = simulate(standard([3, 4, 5]), t_end=20, material_angular_velocity=(0.1, 2, 0))
    >>> W2 = run.material_angular_velocity.sel(director=2)
    >>> round(float(W2[0]), 2), round(float(W2.min()), 2)
    (2.0, -2.0)
    >>> run.spatial_momentum.attrs["units"]
    'kg m2 s-1'

    End the run when the body has turned over, with output every 5 s until then:

    >>> def turned_over(t, state):
    ...     return state.material_angular_velocity[1] + 1.9
    >>> turned_over.terminal = True
    >>> how = {"times": [0, 5, 10, 15, 20], "material_angular_velocity": (0.1, 2, 0)}
    >>> run = simulate(standard([3, 4, 5]), events=turned_over, **how)
    >>> run.time.values.round(3)
    array([ 0.   ,  5.   , 10.   , 11.614])
    """
    problem = posed("simulate", system, keywords, OfRun)
    run = dataset_of(solved(problem, progress))
    return run if problem.file is None else run.assign_attrs(problem.file.record())


def dataset_of(run: Trajectory) -> xarray.Dataset:
    """Return the dataset of a run; a SimulationInterrupt that holds the run where Ctrl-C strikes meanwhile."""
    try:
        return run.to_dataset()
    except KeyboardInterrupt as stop:
        message = f"{str(stop) or 'interrupted'} while the dataset was made; partial holds the complete run"
        raise SimulationInterrupt(message, run) from None


@takes(OfRun, "progress")
def integrate(
    system: DirectorSystem | Problem,
    *,
    progress: bool = False,
    **keywords: Unpack[OfRun],
) -> Trajectory:
    """Integrate the motion of a body as `simulate` does, and return plain arrays instead of a dataset.

    Parameters
    ----------
    system, t_end, step, tolerance, t_start, start, rotation, scalar_first, material_angular_velocity
        As in `simulate`.
    angular_velocity, load, integrator, order, times, store, events, project, progress
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
    return solved(posed("integrate", system, keywords, OfRun), progress)


def solved(problem: Problem, progress: bool = False) -> Trajectory:
    """Return the run of a problem; errors as `simulate`."""
    made = prepared(problem)
    return run_of(made.plan._replace(shows=made.shows), made.begin, progress, events=made.events)
