"""What a reader of a format returns, and what readers share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal

import numpy as np

from ...errors import InputError
from ...geometry.arrays import Array
from ..table import Lines, Table, place


@dataclass(frozen=True)
class Content:
    """The content of a file.

    Attributes
    ----------
    table : Table
        Orientation and time are found by its headers, as in CSV.
    bodies : mapping of name to array
        (n, 4) quaternions, scalar last, or (n, 3, 3) matrices Λ, which map body to space.
    loose : mapping of name to (n, 4) array
        Quaternions for which the format does not define the position of the scalar.
    spins : mapping of name to (n, 3) array
        Spatial angular velocities, rad/s, if the file states them.
    time : (n,) array, s, or None
        Times of the samples of the bodies.
    start : float or None
        The time at which `time` is 0, s since 1970.
    angle_unit : str or None
        "deg" or "rad", if the file states it for all its columns.
    sampled : bool
        Whether `time` was computed from the rate that the caller gave.
    notes : sequence of str
        What the file states about its conventions, and what was not read.
    lines : (n,) array or None
        The line of each row of the bodies in a file of text, from 1, by which messages name it.
    directed : bool
        The format defines that `bodies` map body to space.
    headless : bool
        The table has numbers from 1 in place of headers.
    """

    table: Table = field(default_factory=Table)
    bodies: Mapping[str, Array] = field(default_factory=dict)
    loose: Mapping[str, Array] = field(default_factory=dict)
    spins: Mapping[str, Array] = field(default_factory=dict)
    time: Array | None = None
    start: float | None = None
    angle_unit: Literal["deg", "rad"] | None = None
    sampled: bool = False
    notes: tuple[str, ...] = ()
    lines: Lines | None = None
    directed: bool = True
    headless: bool = False


@contextmanager
def readable(what: str, help_with: str = "") -> Iterator[None]:
    """Turn every exception that a library raises on a damaged file into an InputError, but for those of the system.

    Parameters
    ----------
    what : str
        The format, as in "spin log": the message is "it is not a readable spin log: damaged, cut short or ...".
    help_with : str
        Text that is appended to the message.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # libraries raise what they like
        if isinstance(error, OSError) and error.errno is not None:
            raise
        why = f"damaged, cut short or something else{help_with}"
        raise InputError("unreadable", what=what, why=why) from error


def library(name: str, extra: str) -> Any:
    """Import the library that reads a format; an ImportError names the extra that installs it."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(f"this format is read by {name}: pip install 'nontwist[{extra}]'", name=name) from error


def by_name(kind: str, streams: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Return streams by their names; an InputError names those that two have."""
    found: dict[str, Any] = {}
    for name, values in streams:
        if name in found:
            raise InputError("same-name", kind=kind, name=name)
        found[name] = values
    return found


def stacked(rows: list[list[float]], width: int, what: str, lines: Lines | None = None) -> Array:
    """Return rows of numbers as an array; an InputError names the first that has another length."""
    for k, row in enumerate(rows):
        if len(row) != width:
            raise InputError("row-length", place=place(k, lines), what=what, count=len(row), width=width)
    return np.array(rows, dtype=float).reshape(-1, width)
