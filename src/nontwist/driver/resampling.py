"""A run at other times: by power series at its stored states, otherwise by substeps from the stored state before.

Where stored states lie on one trajectory, as those of `gauss` do, the states between them are found as those of a run
with ``times=`` (`integrators.dense`). Otherwise what lies between two of them is what the run has passed through: whole
steps of the run, and one more from the last node. So a state has the order of the integrator, and it keeps what the
integrator keeps at any length of a step; it is that of ``times=``, to the round-off of a state that is taken up again.
No kink of the load is crossed: a stored interval is divided there.
"""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..analysis.datasets import RUN, as_dataset, recorded
from ..analysis.joining import parts_of
from ..analysis.trajectory import state_dataset, stretches_from
from ..geometry.arrays import Array, as_array
from ..geometry.attitudes import States, states_of, without_jumps
from ..integrators import INTEGRATORS, IVP, Integrator, SimulationError
from ..integrators.problem import FIT, Stretches, started, stretched
from ..loads import Load, Term, as_load, body_moment
from ..loads.base import of_body
from ..loads.kinds import load_of
from ..models.stack import stacked
from ..models.system import DirectorSystem
from . import completion
from .grid import kinks, with_spin_kinks
from .notices import failure_message

if TYPE_CHECKING:
    import xarray

NEEDED = "time", "quaternion", "directors", "director_velocities", "material_angular_velocity"


def resample(run: xarray.Dataset, times: ArrayLike, load: Load | Term | None = None) -> xarray.Dataset:
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
    run = as_dataset(run, RUN, NEEDED, ("system", "integrator", "load"))
    t, x = run["time"].values, as_array(times, "times", (None,))
    if t.size < 2:
        raise ValueError("the run has a single state; nothing can be interpolated")
    outside = (x < t[0]) | (x > t[-1])
    if outside.any():
        bad = int(np.argmax(outside))
        raise ValueError(f"times[{bad}] = {x[bad]:.12g} s lies outside of the run, {t[0]:.12g} s to {t[-1]:.12g} s")
    if len(parts := parts_of(run)) > 1:
        return _resampled_parts(run, parts, x, load)
    return _resampled(run, x, load, float(t[-1]))


def _resampled(run: xarray.Dataset, x: Array, load: Load | Term | None, t_end: float) -> xarray.Dataset:
    """Return a run with one load at times from its first stored state to `t_end`, after its last one perhaps."""
    t = run["time"].values
    until = np.append(t, t_end)
    system, scheme = DirectorSystem.from_json(run.attrs["system"]), _integrator(run)
    load = load_of(recorded(run, "load")) if load is None else as_load(load)
    load = of_body(load, system.inertia)
    q, v = (run[name].transpose("time", "director", "axis").values for name in NEEDED[2:4])
    p, W = (run[name].transpose("time", ...).values for name in (NEEDED[1], NEEDED[4]))
    N = states_of(q, v)[2]
    stored = States(p, W, N if abs(N).max() > completion.TANGENT * max(abs(W).max(), 1e-300) else None)
    if load.remembering:
        as_dataset(run, RUN, ("internal_state",))
        stored = stored._replace(internal=run["internal_state"].transpose("time", ...).values)
    wanted, place = np.unique(x, return_inverse=True)
    of = np.searchsorted(t, wanted, side="right") - 1
    found, rest = stored.part(of), np.flatnonzero(t[of] != wanted)
    body, whole = stacked(system), stretched(t, np.ones(len(t) - 1))

    def problem(k: int, grid: Stretches, output_times: Array) -> IVP:
        """Return the problem that starts with the stored state number `k`."""
        n, own = grid.steps, started(stored.part(k))
        ends = load, grid.borders[0], grid.borders[-1], n, np.array([0, n])
        return IVP(
            body, own.pop("quaternion"), own.pop("velocity"), *ends, output_times=output_times, stretches=grid, **own
        )

    if len(rest) and wanted[-1] < t[-1]:
        one = replace(problem(0, whole, wanted[rest]), stored=np.arange(len(t)))
        inner = completion.between(scheme, one, stored)
        if inner is not None:
            _put(found, rest, inner)
            rest = rest[:0]
    groups = [(int(k), rest[of[rest] == k]) for k in np.unique(of[rest])]
    if scheme.any_times:
        groups = [(0, rest)] if len(rest) else []
    pace = with_spin_kinks(load, body)
    for k, here in groups:
        output_times = wanted[here]
        grid = stretched((t[k], output_times[-1]), (1,)) if scheme.any_times else _grid(run, pace, t[k], until[k + 1])
        one = replace(problem(k, grid, output_times), off_grid=scheme.any_times)
        outcome = completion.march(scheme, one)
        if (failure := outcome.failure()) is not None:
            message = failure_message(one, failure)
            status, h = int(failure.status), grid.longest
            raise SimulationError(message, status, float(t[k]), h, failure.residual) from failure.cause
        _put(found, here, outcome.states.part(0))
    states = found.part(place)
    states = states._replace(quaternion=without_jumps(states.quaternion))
    return state_dataset(system, load, x, states).assign_attrs(run.attrs | {"resampled": "between stored states"})


def _resampled_parts(
    run: xarray.Dataset, parts: list[dict[str, Any]], times: Array, load: Load | Term | None
) -> xarray.Dataset:
    """Return a run of several parts at other times, with the load, the integrator and the steps of each part."""
    import xarray

    if load is not None and any(part["load"] != parts[0]["load"] for part in parts):
        raise ValueError(
            "the parts of the run have different loads: leave load= out, or resample each before join_runs"
        )
    t, found = run["time"].values, []
    needed = [name for name in (*NEEDED[1:], "internal_state") if name in run]
    seam: Any = None
    of = np.searchsorted([part["t_end"] for part in parts[:-1]], times)  # at a seam the earlier one
    spans = [(max(part["t_start"], t[0]), min(part["t_end"], t[-1])) for part in parts]
    kept = [k for k, (first, last) in enumerate(spans) if first < last]
    of = np.clip(of, kept[0], kept[-1])
    for k in kept:
        part, (first, last) = parts[k], spans[k]
        attrs = {name: json.dumps(part[name]) for name in ("load", "integrator")}
        attrs |= {name: part[name] for name in ("step", "stretches") if name in part}
        own = run[needed].isel(time=(t >= first) & (t <= last))
        if own["time"][:1].values != [first]:  # the state at the seam is not stored
            own = xarray.concat([seam, own], "time", data_vars="minimal", join="override", combine_attrs="override")
        own.attrs = {"system": run.attrs["system"], **attrs}
        output_times = times[of == k]
        ended = _resampled(own, np.append(output_times, last), load, last)
        seam = ended[needed].isel(time=slice(-1, None))
        found.append((np.flatnonzero(of == k), ended.isel(time=slice(0, len(output_times)))))
    names = [name for name in found[0][1].data_vars if all(name in one for _, one in found)]
    whole = xarray.concat([one[names] for _, one in found], "time", data_vars="minimal")
    whole = whole.isel(time=np.argsort(np.concatenate([places for places, _ in found])))
    whole["quaternion"].values[:] = without_jumps(whole["quaternion"].values.copy())
    return whole.assign_attrs(run.attrs | {"resampled": found[0][1].attrs["resampled"]})


def _put(found: States, at: Any, states: States) -> None:
    for target, source in zip(found, states, strict=True):
        if target is not None and source is not None:
            target[at] = source


def _grid(run: Any, load: Load, a: float, b: float) -> Stretches:
    """Return the grid of the run between two stored times; all kinks of the load are nodes of it."""
    known, h = stretches_from(run.attrs.get("stretches")), float(run.attrs.get("step") or b - a)
    if known is not None:
        load = load + body_moment(known.borders, np.zeros((len(known.borders), 3)))
    borders = np.concatenate([[a], kinks(load, a, b), [b]])
    if known is not None:
        h = np.array(known.sizes)[np.searchsorted(known.borders[1:-1], (borders[1:] + borders[:-1]) / 2)]
    return stretched(borders, np.maximum(1, np.ceil(np.diff(borders) / h * (1 - FIT))))


def _integrator(run: Any) -> Integrator:
    known = recorded(run, "integrator")
    try:
        name = known.pop("name")
        if name not in INTEGRATORS:
            raise ValueError(f"nontwist.integrators.INTEGRATORS has no {name}")
        return INTEGRATORS[name](**known)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"the integrator of the run cannot be taken up again: {error}") from error
