"""Runs that continue one another, joined into one."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.arrays import require_finite
from ..geometry.attitudes import without_jumps
from ..loads.kinds import load_in_words
from .datasets import RUN, as_dataset, recorded

if TYPE_CHECKING:
    import xarray

SAME = 1e-9  # rad, and of the velocity relative to its size: how far the states at a seam may be apart
NEEDED = "time", "quaternion", "material_angular_velocity"


def join_runs(*runs: xarray.Dataset) -> xarray.Dataset:
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
    for run in runs:
        as_dataset(run, RUN, NEEDED, ("system", "integrator", "load"))
        if not run.sizes["time"]:
            raise ValueError("a run without states cannot be joined")
        for name, variable in run.variables.items():
            if variable.dtype.kind == "f":
                require_finite(variable.values, str(name))
    for k, (one, other) in enumerate(pairwise(runs), start=1):
        _require_seam(one, other, k)
    names = [str(name) for name in runs[0].data_vars if all(name in run for run in runs)]
    parts = [run[names].isel(time=slice(int(k > 0), None)) for k, run in enumerate(runs)]
    found = dict[str, Any]()
    for name in names:
        dims = runs[0][name].dims
        moving = next((dim for dim in ("time", "midtime", "event") if dim in dims), None)
        arrays = [part[name].transpose(*dims).values for part in parts]
        array = arrays[0] if moving is None else np.concatenate(arrays, axis=dims.index(moving))
        found[name] = (dims, without_jumps(array) if name == "quaternion" else array, runs[0][name].attrs)
    along = dict[str, Any]()
    for key, coordinate in runs[0].coords.items():
        values = [part.coords[key].values for part in parts if key in part.coords]
        moves = coordinate.dims and coordinate.dims[0] in ("time", "midtime", "event")
        if moves and len(values) < len(parts):  # of events that not all runs look for
            continue
        along[str(key)] = (coordinate.dims, np.concatenate(values) if moves else coordinate.values, coordinate.attrs)
    record = {name: value for name, value in runs[-1].attrs.items() if name not in ("step", "origin", "stretches")}
    if len({run.attrs.get("step") for run in runs}) == 1 and "step" in record | runs[0].attrs:
        record |= {name: runs[0].attrs[name] for name in ("step", "origin") if name in runs[0].attrs}
    record["joined"] = json.dumps([part for run in runs for part in parts_of(run)])
    return xarray.Dataset(found, along, record)


def parts_of(run: xarray.Dataset) -> list[dict[str, Any]]:
    """Return span, load, integrator and time grid of each run that was joined into this one, or of itself alone."""
    if "joined" in run.attrs:
        return list(recorded(run, "joined"))
    t_start, t_end = map(float, run["time"].values[[0, -1]])
    part = {"t_start": t_start, "t_end": t_end, **{name: recorded(run, name) for name in ("load", "integrator")}}
    return [part | {name: run.attrs[name] for name in ("step", "stretches") if name in run.attrs}]


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
