"""`integrate`, `simulate` and `resample`: one run, as plain arrays or as a dataset, and its states at other times.

Other times. Where stored states lie on one trajectory, as those of `gauss` do, the states between them are found by
power series, as those of a run with ``times=`` (`integrators.dense`). Otherwise what lies between two of them is what
the run has passed through: whole steps of the run, and one more from the last node. So a state has the order of the
integrator, and it keeps what the integrator keeps at any length of a step; it is that of ``times=``, to the round-off
of a state that is taken up again. No kink of the load is crossed: a stored interval is divided there.
"""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from ..analysis.datasets import RUN, as_dataset
from ..analysis.joining import parts_of
from ..analysis.trajectory import Trajectory, segments_from, state_dataset
from ..geometry.arrays import Array, Dataset, as_array, require_finite
from ..geometry.attitudes import States, states_of, without_jumps
from ..integrators import INTEGRATORS, IVP, Integrator, SimulationError, SimulationInterrupt
from ..integrators.ivp import FIT, Segments, segmented, started
from ..loads import Load, Term, as_load, body_moment
from ..loads.kinds import load_of
from ..loads.load import of_body, with_torques
from ..models.stack import stacked
from ..models.system import DirectorSystem
from . import completion
from .grid import kinks, with_spin_kinks
from .notices import failure_message
from .problem import OfRun, Problem, posed, prepared, takes


@takes(OfRun, "progress")
def simulate(
    system: DirectorSystem | Problem,
    *,
    progress: bool = False,
    **keywords: Unpack[OfRun],
) -> Dataset:
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
        and 0.2 rad of a swing, or of the gyration that rotors and wheels cause if 20,000 states show it; with other
        integrators the body turns by at most 0.05 rad per step. The longest step is recorded, with `segments`.
    tolerance : float, rad, optional
        Instead of `step`: the steps, and the order unless it is given, are chosen such that the error of the attitude,
        and that of W relative to its largest magnitude (for a body at rest: to 1 rad per run), are below the tolerance
        at all stored states. `error_estimate` is the difference of two runs.
    t_start : float, s, optional
        By default 0, or the end of `start`.
    start : Dataset, Trajectory or BodyState, optional
        Continue from the last state of a run, including the director velocities; or from a state that an event or a
        stepper has seen, with its time, and its wheels if the load has them. A motion without velocities (see
        `rotation`) provides only its last attitude, with a warning where it has times. If whole steps of that run lead
        to `t_end`, its time grid is continued as well: with lie-midpoint and energy-momentum the states are then, bit
        for bit, those of a single run; otherwise they agree to round-off, or to the tolerance where steps are chosen
        for one. Of a body with another inertia W is kept, of other wheels their momenta, with a warning.
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
        A breakpoint of the load is off the step grid; a table of moments or forces ends at a non-zero value before
        `t_end`; a load is a Python function, which costs about 0.1 ms per step; or the run will take more than 10 s or
        1 GB.

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
    run = dataset_of(run_of(problem, progress))
    return run if problem.file is None else run.assign_attrs(problem.file.record())


def dataset_of(run: Trajectory) -> Dataset:
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
    return run_of(posed("integrate", system, keywords, OfRun), progress)


def run_of(problem: Problem, progress: bool = False) -> Trajectory:
    """Return the run of a problem; errors as `simulate`."""
    return prepared(problem).run(progress)


NEEDED = "time", "quaternion", "directors", "director_velocities", "material_angular_velocity"


def resample(run: Dataset, times: ArrayLike, load: Load | Term | None = None) -> Dataset:
    """Return the states of a run at other times, as its integrator finds them between the stored states.

    Parameters
    ----------
    run : Dataset
        A run of `simulate`, or one read with `open_run`.
    times : (k,) array, s
        Within the run.
    load : Load, optional
        The load of the run. Required if it contains functions: a dataset records only their names.

    Returns
    -------
    Dataset
        All variables on `time`, with the order of accuracy of the integrator. Moments, multipliers and work belong to
        the stored intervals and are dropped; ``simulate(..., times=times)`` returns them.

    Raises
    ------
    ValueError
        `run` is not a run or has fewer than two stored states, a time is outside it, its integrator is not in
        `INTEGRATORS`, its load contains functions and is not given, or it is given although parts that were joined
        have different ones.
    SimulationError
        A substep fails.

    Examples
    --------
    >>> from nontwist import nontwisting, resample, rotation, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, step=0.1, angular_velocity=(0, 2, 0), integrator="split")
    >>> rotation(resample(run, [0.25, 0.333])).magnitude().round(6)
    array([0.5  , 0.666])
    """
    if hasattr(run, "dims") and not hasattr(run, "data_vars"):
        raise ValueError("resample takes runs, whose equations it integrates; Slerp of SciPy interpolates a recording")
    run = as_dataset(run, RUN, NEEDED, ("system", "integrator", "load"))
    t, x = run["time"].values, as_array(times, "times", (None,))
    if t.size < 2:
        raise ValueError("the run has a single state; nothing can be interpolated")
    outside = (x < t[0]) | (x > t[-1])
    if outside.any():
        bad = int(np.argmax(outside))
        raise ValueError(f"times[{bad}] = {x[bad]:.12g} s lies outside of the run, {t[0]:.12g} s to {t[-1]:.12g} s")
    parts, system = parts_of(run), DirectorSystem.from_json(run.attrs["system"])
    if load is not None and any(part["load"] != parts[0]["load"] for part in parts):
        raise ValueError(
            "the parts of the run have different loads: leave load= out, or resample each before join_runs"
        )
    for name in NEEDED:  # a failed member has none from some time on
        require_finite(run[name].values, name)
    p, q, v, W = (run[name].values for name in NEEDED[1:])
    N, z = states_of(q, v)[2], run["internal_state"].values if "internal_state" in run else None
    stored = States(p, W, N if abs(N).max() > completion.TANGENT * max(abs(W).max(), 1e-300) else None, internal=z)
    spans = [(max(part["t_start"], t[0]), min(part["t_end"], t[-1])) for part in parts]
    kept = [k for k, (first, last) in enumerate(spans) if first < last]
    of = np.searchsorted([part["t_end"] for part in parts[:-1]], x)  # at a seam the earlier one
    of, found, states = np.clip(of, kept[0], kept[-1]), [], stored
    for k in kept:
        (first, last), here, seam = spans[k], of == k, states.part(slice(-1, None))
        acting = load_of(parts[k]["load"]) if load is None else _of_member(run, as_load(load))
        acting = of_body(acting, system.inertia)
        if acting.remembering:
            as_dataset(run, RUN, ("internal_state",))
        own = (t >= first) & (t <= last)
        nodes, states = t[own], stored.part(own)
        if nodes[0] != first:  # the state at the seam is not stored
            nodes, pairs = np.append(first, nodes), zip(seam, states, strict=True)
            states = States(*(x if x is None else np.concatenate([a, x]) for a, x in pairs))  # type: ignore[arg-type]
        at = x[here] if len(parts) == 1 else np.append(x[here], last)
        states = _between(parts[k], system, acting, nodes, states, at, last)
        found.append((np.flatnonzero(here), state_dataset(system, acting, x[here], states.part(slice(here.sum())))))
    whole = found[0][1]
    if len(found) > 1:
        import xarray

        names = [name for name in whole.data_vars if all(name in one for _, one in found)]
        whole = xarray.concat([one[names] for _, one in found], "time", data_vars="minimal")
        whole = whole.isel(time=np.argsort(np.concatenate([places for places, _ in found])))
        whole["quaternion"].values[:] = without_jumps(whole["quaternion"].values.copy())
    own = {"load": json.dumps(parts[-1]["load"]), "resampled": "between stored states"}
    return whole.assign_attrs(run.attrs | own)


def _of_member(run: Dataset, load: Load) -> Load:
    """Return the load of an ensemble as that of a member, which has factors and torques of its own."""
    if "load_scale" in run:
        load = run["load_scale"].item() * load
    return with_torques(load, run["wheel_torque"].values) if "wheel_torque" in run else load


def _between(
    part: dict[str, Any], system: DirectorSystem, load: Load, t: Array, stored: States, x: Array, t_end: float
) -> States:
    """Return the states of a part of a run at times from its first known one to `t_end`, after its last one perhaps."""
    scheme, body = _integrator(part["integrator"]), stacked(system)
    stored = stored if load.remembering else stored._replace(internal=None)
    wanted, place = np.unique(x, return_inverse=True)
    of = np.searchsorted(t, wanted, side="right") - 1
    found, rest = stored.part(of), np.flatnonzero(t[of] != wanted)

    def problem(k: int, grid: Segments, output_times: Array) -> IVP:
        """Return the problem that starts with the stored state number `k`."""
        n, own = grid.steps, started(stored.part(k))
        ends = load, grid.borders[0], grid.borders[-1], n, np.array([0, n])
        return IVP(
            body, own.pop("quaternion"), own.pop("velocity"), *ends, output_times=output_times, segments=grid, **own
        )

    if len(rest) and wanted[-1] < t[-1]:
        one = replace(problem(0, segmented(t, np.ones(len(t) - 1)), wanted[rest]), stored=np.arange(len(t)))
        if (inner := completion.between(scheme, one, stored)) is not None:
            _put(found, rest, inner)
            rest = rest[:0]
    groups = [(int(k), rest[of[rest] == k]) for k in np.unique(of[rest])]
    if scheme.any_times:
        groups = [(0, rest)] if len(rest) else []
    pace, until = with_spin_kinks(load, body), np.append(t, t_end)
    for k, here in groups:
        output_times = wanted[here]
        grid = segmented((t[k], output_times[-1]), (1,)) if scheme.any_times else _grid(part, pace, t[k], until[k + 1])
        one = replace(problem(k, grid, output_times), off_grid=scheme.any_times)
        outcome = completion.checked_march(scheme, one)
        if (failure := outcome.failure()) is not None:
            message = failure_message(one, failure)
            status, h = int(failure.status), grid.longest
            raise SimulationError(message, status, float(t[k]), h, failure.residual) from failure.cause
        _put(found, here, outcome.states.part(0))
    states = found.part(place)
    return states._replace(quaternion=without_jumps(states.quaternion))


def _put(found: States, at: Any, states: States) -> None:
    for target, source in zip(found, states, strict=True):
        if target is not None and source is not None:
            target[at] = source


def _grid(part: dict[str, Any], load: Load, a: float, b: float) -> Segments:
    """Return the grid of the run between two stored times; all kinks of the load are nodes of it."""
    known, h = segments_from(part.get("segments")), float(part.get("step") or b - a)
    if known is not None:
        load = load + body_moment(known.borders, np.zeros((len(known.borders), 3)))
    borders = np.concatenate([[a], kinks(load, a, b), [b]])
    if known is not None:
        h = np.array(known.sizes)[np.searchsorted(known.borders[1:-1], (borders[1:] + borders[:-1]) / 2)]
    return segmented(borders, np.maximum(1, np.ceil(np.diff(borders) / h * (1 - FIT))))


def _integrator(known: dict[str, Any]) -> Integrator:
    try:
        name = known.pop("name")
        if name not in INTEGRATORS:
            raise ValueError(f"nontwist.integrators.INTEGRATORS has no {name}")
        return INTEGRATORS[name](**known)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"the integrator of the run cannot be taken up again: {error}") from error
