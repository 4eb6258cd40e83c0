"""What a reader of a format returns, and what readers share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from ...errors import InputError
from ...geometry.arrays import Array
from ..table import Lines, Table, number, place


@dataclass(frozen=True)
class Content:
    """The content of a file.

    `table` has orientation and time by its headers, as in CSV.
    `bodies` are (n, 4) quaternions, scalar last, or (n, 3, 3) matrices Λ, by name; they map body to space, which the
    format defines where they are `directed`. `loose` are quaternions for which it does not define where the scalar is.
    `spins` are spatial angular velocities, (n, 3), rad/s, if the file states them; `time`, s, that of the samples of
    the bodies, counted from `start`, s since 1970, and `sampled` at the rate that the caller gave. `angle_unit` is
    stated for all columns. `notes` tell the conventions of the file, and what was not read. `lines` are those of the
    rows of the bodies in a file of text, from 1, by which messages name them.
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


def by_name(kind: str, streams: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Return streams by their names; an InputError names those that two have."""
    found: dict[str, Any] = {}
    for name, values in streams:
        if name in found:
            raise InputError("same-name", kind=kind, name=name)
        found[name] = values
    return found


def stacked(rows: Sequence[Sequence[Any]], width: int, what: str, lines: Lines | None = None) -> Array:
    """Return rows of numbers as an array; an InputError names the first of another length, or that is no number."""
    for k, row in enumerate(rows):
        if len(row) != width:
            raise InputError("row-length", place=place(k, lines), what=what, count=len(row), width=width)
    try:
        return np.array(rows, dtype=float).reshape(-1, width)
    except ValueError:
        k, wrong = next((k, cell) for k, row in enumerate(rows) for cell in row if number(cell) is None)
    raise InputError("not-a-number", what=f"the {what}", value=wrong, place=place(k, lines))
