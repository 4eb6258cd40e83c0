"""The numbers of a run or of a sweep for other programs: flat columns with units in their headers, as CSV, NPZ or JSON.

A column is called after its variable and the labels along dimensions other than time, or member of a sweep:
``spatial_momentum_x [kg m2 s-1]``, ``directors_3_z``. Dimensionless ones have no unit.
"""

from __future__ import annotations

import itertools
import json
import math
import warnings
from collections.abc import Iterable
from math import prod
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np
from numpy.typing import NDArray

from ..errors import InputWarning, callers_level
from ..geometry.attitudes import euler_angles

if TYPE_CHECKING:
    import xarray

ROWS = 2**13  # formatted at a time
STATES, INTERVALS, EVENTS, MEMBERS = "time", "midtime", "event", "member"
Columns = dict[str, NDArray[Any]]


def columns(run: xarray.Dataset, along: str) -> Columns:
    """Return the columns along the dimension `along`, such as "time", by header; that coordinate, or names, first."""
    names = [name for name in run.data_vars if along in run[name].dims]
    first = {"event_name": run["event_name"].values.astype(np.str_)} if along == EVENTS and EVENTS in run.dims else {}
    return first | {
        header: values
        for name in ([along, *names] if along in run.coords else names)
        for header, values in _of_variable(run[name], along)
    }


def _all_columns(run: xarray.Dataset) -> Columns:
    """Return the columns of states, intervals and events, or of members."""
    return {**columns(run, _lines(run)), **columns(run, INTERVALS), **columns(run, EVENTS)}


def _lines(run: xarray.Dataset) -> str:
    """Return along what a table has its lines: of a sweep along its members, of events alone along them."""
    return next((along for along in (STATES, MEMBERS) if along in run.dims), EVENTS)


def _of_variable(variable: xarray.DataArray, along: str) -> Iterable[tuple[str, NDArray[Any]]]:
    variable = variable.transpose(along, ...)
    labels = [[str(label) for label in variable[dim].values] for dim in variable.dims[1:]]
    unit = variable.attrs.get("units", "1")
    suffix = "" if unit == "1" else f" [{unit}]"
    flat = variable.values.reshape(variable.sizes[along], prod(map(len, labels)))
    for k, label in enumerate(itertools.product(*labels)):
        yield "_".join([str(variable.name), *label]) + suffix, flat[:, k]


def in_degrees(run: xarray.Dataset) -> xarray.Dataset:
    """Return a run or a sweep with angles, their rates and their units in degrees; the attributes stay as they are.

    Derivatives by parameters stay as well: their units are those of the parameters, too.
    """
    turned = run.copy()
    for name, variable in run.data_vars.items():
        unit, *rest = variable.attrs.get("units", "1").split(" ")
        if unit == "rad" and "parameter" not in variable.dims:
            units = " ".join(["degree", *rest])
            turned[name] = variable.copy(data=np.degrees(variable.values)).assign_attrs(units=units)
    return turned


def with_euler(run: xarray.Dataset, letters: str) -> xarray.Dataset:
    """Return a run or a sweep with Euler angles and their rates beside its variables; InputWarning in gimbal lock."""
    p, W = run["quaternion"], run["material_angular_velocity"]
    along, shape = p.dims[:-1], p.shape[:-1]
    angles, rates, is_locked = euler_angles(p.values.reshape(-1, 4), W.values.reshape(-1, 3), letters)
    if is_locked.any():
        first = np.broadcast_to(run[along[-1]].values, shape).ravel()[int(is_locked.argmax())]
        facts: dict[str, Any] = {"count": int(is_locked.sum()), "along": along[-1], "first": f"{first:.6g}"}
        warnings.warn(InputWarning("gimbal-lock", letters=letters, **facts), stacklevel=callers_level())
    own = {"long_name": f"Euler angles {letters}, as SciPy has them", "units": "rad"}
    dims = (*along, "angle")
    return run.assign(
        euler_angles=(dims, angles.reshape(*shape, 3), own),
        euler_rates=(dims, rates.reshape(*shape, 3), {"long_name": "their rates", "units": "rad s-1"}),
    ).assign_coords(angle=[1, 2, 3])


def write_csv(run: xarray.Dataset, stream: TextIO, *, decimal_comma: bool = False) -> None:
    """Write a line for each stored state, or member of a sweep, or event where the run has columns of events alone.

    Columns of intervals belong to the state that ends them: the first is empty. Numbers have as many digits as
    reading them back exactly requires. Decimal commas come with semicolons between columns.
    """
    import pandas

    marks: dict[str, Any] = {"sep": ";", "decimal": ","} if decimal_comma else {}
    states, intervals = (columns(run, along) for along in (_lines(run), INTERVALS))
    for first in range(0, max(run.sizes[_lines(run)], 1), ROWS):
        table = pandas.DataFrame({header: values[first : first + ROWS] for header, values in states.items()})
        for header, values in intervals.items():
            ended = pandas.Series(values[max(first - 1, 0) : first + ROWS - 1])
            ended.index += 0 if first else 1
            table[header] = ended.astype("Int64") if ended.dtype.kind == "i" else ended
        table.to_csv(stream, index=False, header=not first, lineterminator="\n", **marks)


def write_npz(run: xarray.Dataset, file: Any) -> None:
    """Write an array for each column, and the record of the run as the string `record` (JSON)."""
    arrays: dict[str, Any] = _all_columns(run)
    np.savez(file, record=np.array(json.dumps(record(run), ensure_ascii=False)), **arrays)


def write_json(run: xarray.Dataset, stream: TextIO) -> None:
    """Write an object: ``record``, and ``columns`` with a list of numbers each; what is not finite is null."""
    found = _all_columns(run)
    stream.write('{"record": ' + json.dumps(record(run), ensure_ascii=False) + ', "columns": {')
    for k, (header, values) in enumerate(found.items()):
        numbers = finite(values.tolist())
        stream.write((", " if k else "") + json.dumps(header) + ": " + json.dumps(numbers, allow_nan=False))
    stream.write("}}\n")


def record(run: xarray.Dataset) -> dict[str, Any]:
    """Return the attributes of a run as plain data, those in JSON decoded."""
    return {str(name): _plain(value) for name, value in run.attrs.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, str) and value[:1] in ("{", "["):
        try:
            return json.loads(value)
        except ValueError:
            return value
    return finite(value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value)


def finite(value: Any) -> Any:
    """Return plain data with None for numbers that are not finite, which JSON does not have."""
    if isinstance(value, dict):
        return {key: finite(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
