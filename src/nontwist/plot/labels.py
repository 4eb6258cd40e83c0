"""Labels of axes and curves: runs with their labels, symbols and units from the attributes of the data."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ..analysis.datasets import RUN, as_dataset

if TYPE_CHECKING:
    import xarray

    Runs = xarray.Dataset | Mapping[str, xarray.Dataset]
    Quotients = xarray.DataArray | Mapping[str, xarray.DataArray]

_LINE = 32  # characters along an axis 2 in long


def labelled(runs: Any) -> dict[str, Any]:
    """Return `runs` as a dictionary from labels to runs; a single run has the label ''.

    Raises
    ------
    ValueError
        Neither a run nor a mapping of runs, or an ensemble.
    """
    table = {"": runs} if hasattr(runs, "dims") else dict(runs) if isinstance(runs, Mapping) else {}
    if not table or not all(hasattr(run, "dims") for run in table.values()):
        got = {name: type(run).__name__ for name, run in table.items()} or type(runs).__name__
        raise ValueError(f"give a run (a Dataset), or several as {{'a label': run, 'another': run2}}; got {got}")
    for name, run in table.items():
        if "member" in run.dims:
            raise ValueError(f"{_named(name)} is an ensemble: choose a member, run.isel(member=0)")
        if not run.sizes.get("time"):
            raise ValueError(f"{_named(name)} has no times: nothing can be drawn over time")
    return {str(name): run for name, run in table.items()}


def variable(run: Any, label: str, name: str, remedy: str = "") -> Any:
    """Return the variable `name` of a run; a ValueError with the `remedy` where it has none."""
    if name not in run:
        raise ValueError(f"{_named(label)} has no {name}: {remedy or 'it has ' + ', '.join(map(str, run))}")
    as_dataset(run, RUN, (name,))
    return run[name]


def _named(label: str) -> str:
    return f"the run {label!r}" if label else "the run"


def symbol(data: Any, index: str = "") -> str:
    """Return the symbol of a variable, with an index, as mathematical text; an index replaces the i of d_i."""
    text = re.sub(r"_(\w\w+)", r"_{\\mathrm{\1}}", data.attrs["symbol"])
    if index and "_i" in text:
        return f"${text.replace('_i', f'_{{{index}}}')}$"
    return f"${text}_{{{index}}}$" if index else f"${text}$"


def unit(data: Any) -> str:
    """Return the unit of a variable, as in ' (kg m² s⁻¹)'; "" where it has none."""
    text = data.attrs.get("units", "1")
    return "" if text == "1" else " (" + re.sub(r"(?<=[A-Za-z])(-?\d+)", r"$^{\1}$", text) + ")"


def axis_label(data: Any) -> str:
    """Return name, symbol and unit of a variable, in one line or, where they are long, in two."""
    name = str(data.name).replace("_", " ")
    end = (symbol(data) if "symbol" in data.attrs else "") + unit(data)
    return name + ("\n" if visible(name + end) > _LINE else " ") + end


def visible(text: str) -> int:
    """Return the approximate number of visible characters of a text with mathematics."""
    return len(re.sub(r"\\[a-z]+|[${}_^\\]", "", text))
