"""Validation of the datasets that a caller passes."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

from ..geometry.values import short_repr
from .variables import VARIABLES

RUN = "a run of nontwist.simulate"
ORDERS = ("0 1 2", "1 2 3", "d1 d2 d3", "x y z", "x y z w")  # of the labels of directors, axes and quaternions


def as_dataset(
    data: Any, what: str, variables: Iterable[str] = (), attributes: Iterable[str] = (), texts: Iterable[str] = ()
) -> Any:
    """Return `data` in the order of labels; a ValueError where it is no Dataset, or lacks variables or attributes.

    Texts are variables, too. Variables of runs must have the dims of runs, others any.
    """
    if not hasattr(data, "data_vars"):
        raise ValueError(f"expected {what} as a Dataset, got {short_repr(data)}")
    for name in [*variables, *texts]:
        if name not in data.variables:
            raise ValueError(f"expected {what} with {name!r}; this Dataset has {', '.join(map(str, data))}")
        dims = VARIABLES[name][0] if name in VARIABLES else data[name].dims
        if {*dims} != {*data[name].dims}:
            raise ValueError(f"{name} must have the dims {', '.join(dims)}, got {', '.join(map(str, data[name].dims))}")
        if data[name].dtype.kind not in ("OTU" if name in texts else "fiub"):
            kind = "text" if name in texts else "real numbers"
            raise ValueError(f"{name} must contain {kind}, got {data[name].dtype}")
    for name in attributes:
        if name not in data.attrs:
            raise ValueError(f"expected {what} with the attribute {name!r}; this Dataset does not have it")
    return in_order(data)


def in_order(data: Any) -> Any:
    """Return a Dataset or DataArray with directors, axes and components of quaternions in the order of their labels."""
    for dim in ("director", "axis", "quat"):
        own = [str(label) for label in data[dim].values] if dim in data.dims and dim in data.coords else []
        order = next((one for one in map(str.split, ORDERS) if sorted(own) == sorted(one)), own)
        if own != order:
            data = data.isel({dim: [own.index(label) for label in order]})
    return data


def recorded(run: Any, name: str) -> Any:
    """Return what an attribute of a run records as JSON; a ValueError where it is damaged."""
    try:
        return json.loads(run.attrs[name])
    except (TypeError, ValueError) as error:
        raise ValueError(f"the attribute {name} of the run is damaged: {error}") from error
