"""Validation of the datasets that a caller passes."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

from ..geometry.arrays import in_order
from ..geometry.values import short_repr
from ..models.equations import LABELS
from ..models.system import DirectorSystem
from .variables import COORDINATES, TIMES, VARIABLES

RUN = "a run of nontwist.simulate"
BODY = {"euler_inertia": "euler_inertia", "constrained_axis": "axis", "dead_force": "dead_force"}
FIRST = ("member", *TIMES, "event")  # of the dims of a variable; directors, axes and components of quaternions are last


def as_dataset(
    data: Any, what: str, variables: Iterable[str] = (), attributes: Iterable[str] = (), texts: Iterable[str] = ()
) -> Any:
    """Return `data` in the order of labels; a ValueError where it is no Dataset, or lacks variables or attributes.

    Texts are variables, too. Variables of runs must have the dims of runs, others any; they are returned in the order
    of runs. A part has its intervals alone, a member of an ensemble its own body.
    """
    if not hasattr(data, "data_vars"):
        many = isinstance(data, (list, tuple)) and any(hasattr(one, "data_vars") for one in data)
        given = f"a {type(data).__name__} of them: give one by one, f(*runs)" if many else short_repr(data)
        raise ValueError(f"expected {what} as a Dataset, got {given}")
    for name in [*variables, *texts]:
        if name not in data.variables:
            raise ValueError(f"expected {what} with {name!r}; this Dataset has {', '.join(map(str, data))}")
        dims = VARIABLES[name][0] if name in VARIABLES else (name,) if name in TIMES else data[name].dims
        if {*dims} != {*data[name].dims}:
            found = ", ".join(map(str, data[name].dims)) or "none"
            raise ValueError(f"{name} must have the dims {', '.join(dims)}, got {found}")
        if data[name].dtype.kind not in ("OTU" if name in texts else "fiub"):
            kind = "text" if name in texts else "real numbers"
            raise ValueError(f"{name} must contain {kind}, got {data[name].dtype}")
    data = of_member(data)
    for name in attributes:
        if name not in data.attrs:
            raise ValueError(f"expected {what} with the attribute {name!r}; this Dataset does not have it")
    count = data.sizes.get("constraint", 0)
    along = COORDINATES | {"constraint": list(LABELS[-1:] if count == 1 else LABELS[:count])}  # where they were dropped
    data = data.assign_coords(
        {dim: own for dim, own in along.items() if dim not in data.coords and data.sizes.get(dim) == len(own)}
    )
    data = in_order(data).transpose(*FIRST, ..., *COORDINATES, missing_dims="ignore")
    for dim in TIMES:
        if dim in data.indexes and not data.indexes[dim].is_monotonic_increasing:
            data = data.sortby(dim)
    if "midtime" not in data.coords or not data.sizes.get("time"):
        return data
    t, middle = data["time"].values, data["midtime"].values  # of a part, run.sel(time=slice(1, 2)), these are all there
    inside = (t[0] <= middle) & (middle <= t[-1])
    return data if inside.all() else data.isel(midtime=inside)


def as_comparison(data: Any, numbers: Iterable[str], attributes: Iterable[str], texts: Iterable[str]) -> Any:
    """Return `data` on (integrator, step), steps from coarse to fine; a ValueError where it is not a comparison."""
    data = as_dataset(data, "a comparison of nontwist.compare", numbers, attributes, texts)
    for dim in ("integrator", "step", *(["invariant"] if "drift" in numbers else [])):
        if not data.sizes.get(dim):
            raise ValueError(f"the comparison has no dim {dim}, or none is left: choose by lists, .isel({dim}=[0])")
    if data["attitude_reference_error"].ndim or not data.indexes["integrator"].is_unique:
        raise ValueError("the comparison has an integrator twice, or was changed by where: choose by lists, with sel")
    return data.transpose("integrator", "step", ...).sortby("step", ascending=False)


def of_member(data: Any) -> Any:
    """Return a member of an ensemble with the body that is its own; anything else as it is."""
    if not hasattr(data, "data_vars") or "member" in data.dims:
        return data
    if "euler_inertia" in data and "system" not in data.attrs and "spin" not in data:
        given = {key: data[name].values for name, key in BODY.items() if name in data}
        data = data.assign_attrs(system=DirectorSystem(**given, physical=False).to_json())
    return data


def body_of(run: Any) -> DirectorSystem:
    """Return the body of a run; a ValueError where it does not state it."""
    return DirectorSystem.from_json(as_dataset(run, RUN, (), ("system",)).attrs["system"])


def recorded(run: Any, name: str) -> Any:
    """Return what an attribute of a run records as JSON; a ValueError where it is damaged."""
    try:
        return json.loads(run.attrs[name])
    except (TypeError, ValueError) as error:
        raise ValueError(f"the attribute {name} of the run is damaged: {error}") from error
