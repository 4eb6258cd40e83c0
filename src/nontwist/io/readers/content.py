"""What a reader returns: the columns of a table, or the attitudes of bodies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...analysis.places import Lines, place
from ...geometry.arrays import Array


@dataclass(frozen=True)
class Content:
    """The content of a file.

    Attributes
    ----------
    columns : mapping of header to (n,) array
        Orientation and time are found by the headers, as in CSV.
    chosen : sequence of str or None
        The columns that are read if the caller names none: those of a table without headers.
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
        What the file states about its conventions.
    lines : (n,) array or None
        The line of each row in a file of text, from 1.
    directed : bool
        The format defines that `bodies` map body to space.
    """

    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    chosen: tuple[str, ...] | None = None
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


@contextmanager
def reading(what: str, help_with: str = "") -> Iterator[None]:
    """Turn every exception that a library raises on a damaged file into a ValueError.

    Only an OSError of the system, such as one for a missing file, is raised as it is.

    Parameters
    ----------
    what : str
        The format, as in "spin log": the message is "it is not a readable spin log: damaged, cut short or ...".
    help_with : str
        Text that is appended to the message.
    """
    try:
        yield
    except (ValueError, OSError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise _unreadable(what, help_with) from error
    except Exception as error:  # libraries raise what they like
        raise _unreadable(what, help_with) from error


def _unreadable(what: str, help_with: str) -> ValueError:
    return ValueError(f"it is not a readable {what}: damaged, cut short or something else{help_with}")


def library(name: str, extra: str) -> Any:
    """Import the library that reads a format; an ImportError names the extra that installs it."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(f"this format is read by {name}: pip install 'nontwist[{extra}]'", name=name) from error


def stacked(rows: list[list[float]], width: int, what: str, lines: Lines | None = None) -> Array:
    """Return rows of numbers as an array; a ValueError names the first that has another length."""
    for k, row in enumerate(rows):
        if len(row) != width:
            raise ValueError(f"{place(k, lines)} of the {what} has {len(row)} numbers instead of {width}")
    return np.array(rows, dtype=float).reshape(-1, width)
