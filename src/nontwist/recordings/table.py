"""A table of a recording: columns by header, and where each row is in its file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Array, as_floats

Lines = NDArray[np.int64]
Rows = NDArray[np.int64] | NDArray[np.bool_]


def place(row: int, lines: Lines | None) -> str:
    """Return the name of a row: ``line 19`` of a file of text, as an editor numbers it, else ``row 17``, from 0."""
    return f"row {row}" if lines is None else f"line {lines[row]}"


def listed(names: Iterable[str]) -> str:
    """Return names for a message: as many, and as much of each, as can be read."""
    shown = [name if len(name) <= 80 else f"{name[:80]}..." for name in names]
    return ", ".join(shown[:60]) + (f" and {len(shown) - 60} more" if len(shown) > 60 else "")


def number(value: object) -> float | None:
    """Return `value` as a float, or None if it is not a number."""
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return None


@dataclass(frozen=True)
class Table:
    """Columns of equal length; `lines`, where known, are those of the rows in a file of text, from 1.

    It is `headless` where the file has no headers; they are numbers then, from 1.
    """

    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    lines: Lines | None = None
    headless: bool = False

    @property
    def headers(self) -> list[str]:
        """The headers, in the order of the file."""
        return list(self.columns)

    def __len__(self) -> int:
        return max((len(values) for values in self.columns.values()), default=0)

    def require(self, *names: str) -> None:
        """Raise an InputError where there is no such column."""
        for name in names:
            if name not in self.columns:
                raise InputError("no-column", name=name, names=listed(self.columns))

    def at(self, rows: Rows) -> Table:
        """Return some of the rows."""
        lines = None if self.lines is None else self.lines[rows]
        return replace(self, columns={name: values[rows] for name, values in self.columns.items()}, lines=lines)

    def numbers(self, name: str) -> Array:
        """Return a column as floats; an InputError names the row that holds something else."""
        self.require(name)
        values = np.asarray(self.columns[name])
        if values.dtype.kind in "cmM":
            return as_floats(values, f"the column {name!r}")
        try:
            return values.astype(np.float64)
        except (TypeError, ValueError):
            bad = np.array([number(one) is None for one in values.tolist()])
        # beside decimal commas, what is not a number with a point either
        worse = bad & [number(str(one).replace(",", ".")) is None for one in values.tolist()]
        k = int(np.argmax(worse if worse.any() else bad))
        raise InputError("not-a-number", what=f"the column {name!r}", value=values[k], place=place(k, self.lines))

    def vectors(self, names: Sequence[str]) -> Array:
        """Return several columns, (n, k)."""
        return np.stack([self.numbers(name) for name in names], axis=1)
