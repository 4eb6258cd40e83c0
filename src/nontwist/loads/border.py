"""From what callers give to loads; the fields of terms check it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from numpy.typing import ArrayLike

from ..geometry.arrays import as_array
from ..geometry.values import as_list
from .base import Load
from .terms import Term


def load_of(cls: Callable[..., Term], *given: Any, **more: Any) -> Load:
    """Return a term of these fields as a load."""
    return cls(*given, **more).load


def values_of(name: str, values: ArrayLike | None) -> ArrayLike:
    """Return the values of a table of the load `name`; a ValueError where there are none."""
    if values is None:
        raise ValueError(f"{name} needs the values that belong to its times: {name}(times, values)")
    return values


def of_function(
    cls: Callable[..., Term], *given: Any, breakpoints: Iterable[float] = (), compiled: bool = False
) -> Load:
    """Return a term that is a function as a load, compiled now where that is asked for: it raises if that fails."""
    times = tuple(as_array(as_list(breakpoints, "breakpoints"), "breakpoints", (None,)).tolist())
    term = cls(*given, breakpoints=times, compiled=compiled)
    if compiled:
        _ = term.c_function
    return term.load
