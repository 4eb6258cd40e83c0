"""What callers give of loads, checked."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_array, increasing
from ..geometry.values import among, as_list, shown
from .base import Load
from .terms import Term


def table(name: str, times: ArrayLike, values: ArrayLike | None, *tail: int) -> tuple[Array, Array, dict[str, Any]]:
    """Return times and values (k, *tail) of a table of the load `name`, checked; what is known of its smoothness."""
    if values is None:
        raise ValueError(f"{name} needs the values that belong to its times: {name}(times, values)")
    t = as_array(times, "times", (None,))
    return (
        t,
        as_array(values, "values", (t.size, *tail)),
        {"breakpoints": tuple(t.tolist()), "resolution": increasing(t)},
    )


def of_function(term: Term, compiled: bool) -> Load:
    """Return a term as a load, compiled now where that is asked for: it raises where that is not possible."""
    if compiled:
        _ = term.compiled
    return Load((term,))


def breaks(times: Iterable[float]) -> tuple[float, ...]:
    """Return breakpoints that a caller gives, as a tuple."""
    return tuple(as_array(as_list(times, "breakpoints"), "breakpoints", (None,)).tolist())


def frame_of(frame: Literal["body", "space"]) -> Literal["body", "space"]:
    """Return a frame; a ValueError where it is none."""
    if not among(frame, ("body", "space")):
        raise ValueError(f"frame must be 'body' or 'space', got {shown(frame)}")
    return frame
