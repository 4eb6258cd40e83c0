"""Runs that continue one another, joined into one; and the points of a body along a run."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, DataArray, Dataset, as_array, as_floats, require_finite
from ..geometry.attitudes import without_jumps
from ..loads.kinds import FUNCTIONS, load_in_words, load_of
from ..loads.load import with_torques
from ..loads.memory_terms import carried_on, recorded_wheels
from .datasets import RUN, as_dataset, recorded
from .trajectory import Trajectory

SAME = 1e-9  # rad, and of the velocity relative to its size: how far the states at a seam may be apart
FACTORS = "load_scale", "wheel_torque"  # of a member of an ensemble, in the load of its part
NEEDED = "time", "quaternion", "material_angular_velocity"


def join_runs(*runs: Dataset) -> Dataset:
    """Join runs of one body, each of which continues the one before, into one run.

    Parameters
    ----------
    *runs : Dataset
        Runs of `simulate`, or read with `open_run`, in chronological order. Loads and integrators may differ.

    Returns
    -------
    Dataset
        The variables that all runs have. The state where two runs meet appears once. The attributes are those of the
        last run, so that the result can be continued; `joined` contains start, end, load, integrator and step of each
        part, in JSON.

    Raises
    ------
    ValueError
        There are no runs; something is not a run; the bodies differ; a run does not begin at the state in which the one
        before ended; a number is not finite; or an attribute is damaged.

    Examples
    --------
    >>> from nontwist import join_runs, nontwisting, pulse, simulate
    >>> body, how = nontwisting([3, 4, 5]), {"step": 0.1, "integrator": "lie-midpoint"}
    >>> first = simulate(body, t_end=1, material_angular_velocity=(0, 2, 0), **how)
    >>> second = simulate(body, t_end=2, start=first, load=pulse((1, 0, 0), start=1, end=1.4), **how)
    >>> whole = join_runs(first, second)
    >>> whole.sizes["time"], whole.time.values[[0, 10, 20]].tolist()
    (21, [0.0, 1.0, 2.0])
    """
    import xarray

    if not runs:
        raise ValueError("give the runs to join, in chronological order")
    runs = tuple(as_dataset(run, RUN, NEEDED, ("system", "integrator", "load")) for run in runs)
    for run in runs:
        if not run.sizes["time"]:
            raise ValueError("a run without states cannot be joined")
        for name, variable in run.variables.items():
            if variable.dtype.kind == "f":
                require_finite(variable.values, str(name))
    for k, (one, other) in enumerate(pairwise(runs), start=1):
        _require_seam(one, other, k)
    names = [str(name) for name in runs[0].data_vars if name not in FACTORS and all(name in run for run in runs)]
    parts = [run[names].isel(time=slice(int(k > 0), None)) for k, run in enumerate(runs)]
    found, wheels = dict[str, Any](), [recorded_wheels(recorded(run, "load")) for run in runs]
    for name in names:
        dims = runs[0][name].dims
        moving = next((dim for dim in ("time", "midtime", "event") if dim in dims), None)
        arrays = [part[name].transpose(*dims).values for part in parts]
        if name == "internal_state":
            arrays = [
                carried_on(z, had, [one.size for one in wheels[-1]]) for z, had in zip(arrays, wheels, strict=True)
            ]
        array = arrays[0] if moving is None else np.concatenate(arrays, axis=dims.index(moving))
        found[name] = (dims, without_jumps(array) if name == "quaternion" else array, runs[0][name].attrs)
    along = dict[str, Any]()
    for key, coordinate in runs[0].coords.items():
        values = [part.coords[key].values for part in parts if key in part.coords]
        moves = coordinate.dims and coordinate.dims[0] in ("time", "midtime", "event")
        if moves and len(values) < len(parts):  # of events that not all runs look for
            continue
        along[str(key)] = (coordinate.dims, np.concatenate(values) if moves else coordinate.values, coordinate.attrs)
    record = {name: value for name, value in runs[-1].attrs.items() if name not in ("step", "origin", "segments")}
    if len({run.attrs.get("step") for run in runs}) == 1 and "step" in record | runs[0].attrs:
        record |= {name: runs[0].attrs[name] for name in ("step", "origin") if name in runs[0].attrs}
    own = [part for run in runs for part in parts_of(run)]
    return xarray.Dataset(found, along, record | {"joined": json.dumps(own), "load": json.dumps(own[-1]["load"])})


def parts_of(run: Dataset) -> list[dict[str, Any]]:
    """Return span, load, integrator and time grid of each run that was joined into this one, or of itself alone."""
    if "joined" in run.attrs:
        return list(recorded(run, "joined"))
    if not run.sizes["time"]:
        raise ValueError("the run has no states")
    t_start, t_end = map(float, run["time"].values[[0, -1]])
    part = {"t_start": t_start, "t_end": t_end, "load": _own_load(run), "integrator": recorded(run, "integrator")}
    return [part | {name: run.attrs[name] for name in ("step", "segments") if name in run.attrs}]


def _own_load(run: Dataset) -> list[dict[str, Any]]:
    """Return the records of the load of a run; of a member of an ensemble with the factor and torques of its own."""
    records: list[dict[str, Any]] = recorded(run, "load")
    if "load_scale" in run:
        records = [one | {"scale": run["load_scale"].item() * one["scale"]} for one in records]
    if "wheel_torque" not in run:
        return records
    each = iter(run["wheel_torque"].values[:, None])
    torques = [next(each) if "wheel" in one else None for one in records]
    return [
        one
        if torque is None or not one.keys().isdisjoint(FUNCTIONS)
        else with_torques(load_of([one]), torque).description[0]
        for one, torque in zip(records, torques, strict=True)
    ]


def loads_in_words(parts: list[dict[str, Any]]) -> list[str]:
    """Return the load of a run in words, a line for each of its parts where they have different ones."""
    loads = [load_in_words(part["load"]) for part in parts]
    if len(set(loads)) == 1:
        return loads[:1]
    spans = [f"{part['t_start']:.6g} s to {part['t_end']:.6g} s" for part in parts]
    return [f"{span}: {load}" for span, load in zip(spans, loads, strict=True)]


def _require_seam(one: Any, other: Any, k: int) -> None:
    """Raise a ValueError where the run `other`, number k from 0, does not continue `one`."""
    if one.attrs["system"] != other.attrs["system"]:
        raise ValueError(f"run {k} is of another body than run {k - 1}")
    end, begin = float(one.time[-1]), float(other.time[0])
    if end != begin:
        raise ValueError(f"run {k} begins at t = {begin:.12g} s, but run {k - 1} ends at t = {end:.12g} s")
    p, q = (run.quaternion.isel(time=at).values for run, at in ((one, -1), (other, 0)))
    a, b = (run.material_angular_velocity.isel(time=at).values for run, at in ((one, -1), (other, 0)))
    apart = 2 * min(np.linalg.norm(p - q), np.linalg.norm(p + q))
    if apart > SAME or np.linalg.norm(a - b) > SAME * max(np.linalg.norm(a), np.linalg.norm(b)):
        raise ValueError(
            f"run {k} does not begin where run {k - 1} ends: {apart:.2g} rad and {np.linalg.norm(a - b):.2g} rad/s "
            "apart; start=run continues a run"
        )


# Positions and velocities of material points of a run.
#
# A point of the body is `X = θ¹ D1 + θ² D2 + θ³ D3` (eq-reference-conf). In space it is at `x = θ^i d_i`
# (eq_position_vector_rigidbody) and moves with `x' = θ^i d_i'` (eq_velocity_vector_rigidbody). Both are linear in the
# directors and their velocities, which are used as the integrator has them. On tangent velocities `x' = w × x`. The
# director velocities of energy-momentum under load are not tangent at the nodes: x' then has a part along x, and it is
# this x' whose kinetic energy `∫ ρ/2 |x'|²` is K (eq-director-K).


POSITION = {"units": "m", "long_name": "position of a material point", "symbol": "x"}
VELOCITY = {"units": "m s-1", "long_name": "velocity of a material point", "symbol": "x'"}


@overload
def point_position(run: Dataset, X: ArrayLike) -> DataArray: ...
@overload
def point_position(run: Trajectory, X: ArrayLike) -> Array: ...
def point_position(run: Dataset | Trajectory, X: ArrayLike) -> DataArray | Array:
    """Return the position ``x = θ^i d_i`` of material points in space (eq_position_vector_rigidbody).

    Parameters
    ----------
    run : Dataset of `simulate` or `simulate_ensemble`, or Trajectory
        It must have the variable `directors`; an ensemble has it only if ``variables=`` names it.
    X : (3,) or (n, 3) array, m
        Components θ^i of one point or of n points along the directors, from the fixed point (eq-reference-conf).

    Returns
    -------
    DataArray or array, m, spatial components from the fixed point
        For a dataset, a DataArray with the dimensions (time, axis), or (time, point, axis) for n points, with `member`
        first for ensembles; NaN where the run has NaN. For a Trajectory, a (k, 3) or (k, n, 3) array.

    Raises
    ------
    ValueError
        X is not an array of finite numbers of this shape, or `run` is not a run or has no variable `directors`.

    Examples
    --------
    The tip of a body that turns about its second director, by 2 rad:

    >>> from nontwist import nontwisting, point_position, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, step=0.1, angular_velocity=(0, 2, 0), integrator="split")
    >>> tip = point_position(run, (0, 0, 0.5))
    >>> tip.sel(time=1).values.round(6)  # 0.5 (sin 2, 0, cos 2)
    array([ 0.454649,  0.      , -0.208073])
    >>> tip.dims, tip.attrs["units"]
    (('time', 'axis'), 'm')
    """
    return _along(run, X, "directors", POSITION)


@overload
def point_velocity(run: Dataset, X: ArrayLike) -> DataArray: ...
@overload
def point_velocity(run: Trajectory, X: ArrayLike) -> Array: ...
def point_velocity(run: Dataset | Trajectory, X: ArrayLike) -> DataArray | Array:
    """Return the velocity ``x' = θ^i d_i'`` of material points in space (eq_velocity_vector_rigidbody).

    It equals w × x wherever the director velocities are tangent, that is, except at the nodes of `energy-momentum`
    under load. There x' also has a part along x.

    Parameters
    ----------
    run : Dataset of `simulate` or `simulate_ensemble`, or Trajectory
        It must have the variable `director_velocities`; an ensemble has it only if ``variables=`` names it.
    X : (3,) or (n, 3) array, m
        Components θ^i of one point or of n points along the directors, from the fixed point (eq-reference-conf).

    Returns
    -------
    DataArray or array, m/s, spatial components
        Laid out as the positions of `point_position`; NaN where the run has NaN.

    Raises
    ------
    ValueError
        X is not an array of finite numbers of this shape, or `run` is not a run or has no variable
        `director_velocities`.

    Examples
    --------
    >>> from nontwist import integrate, nontwisting, point_velocity
    >>> start = {"angular_velocity": (0, 2, 0)}
    >>> run = integrate(nontwisting([3, 4, 5]), t_end=1, step=0.1, integrator="split", **start)
    >>> point_velocity(run, [(0, 0, 0.5), (0, 0.5, 0)])[0].round(6)  # w × x
    array([[1., 0., 0.],
           [0., 0., 0.]])
    """
    return _along(run, X, "director_velocities", VELOCITY)


def _along(run: Any, X: ArrayLike, name: str, attributes: dict[str, str]) -> DataArray | Array:
    """Return Σ θ^i a_i for the rows a_i of a variable of a run."""
    X = as_floats(X, "X")
    X = as_array(X, "X", (3,) if X.ndim == 1 else (None, 3))
    if isinstance(run, Trajectory):
        return X @ getattr(run, name)
    run = as_dataset(run, f"a Trajectory, or {RUN}")
    if name not in run.data_vars:
        known = ", ".join(map(str, run.data_vars))
        raise ValueError(f"the run has no variable {name!r}; it has {known}; for ensembles pass variables=[{name!r}]")
    if not {"director", "axis"} <= {*run[name].dims}:
        raise ValueError(f"{name} must have the dims director and axis, got {', '.join(map(str, run[name].dims))}")
    variable = run[name].transpose(..., "director", "axis")
    rows = as_floats(variable.values, name)
    if rows.shape[-2:] != (3, 3):
        raise ValueError(f"{name} must have three directors of three components, got {rows.shape[-2:]}; select later")
    import xarray

    points = () if X.ndim == 1 else ("point",)
    coordinates = {key: value for key, value in variable.coords.items() if "director" not in value.dims}
    dims = (*variable.dims[:-2], *points, "axis")
    return xarray.DataArray(X @ rows, coordinates, dims, attributes["long_name"].split()[0], attributes)
