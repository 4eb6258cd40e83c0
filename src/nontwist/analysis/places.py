"""Where a row of a recording is: the line of its file, as an editor numbers it, or its row, counted from 0.

Readers of text keep the line of each row, comments, headers and blank lines counted; `read_motion` passes them on as
the coordinate `line`, so that a selection of samples keeps its own. Arrays and binary files have rows alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

Lines = NDArray[np.int64]


def place(row: int, lines: Lines | None) -> str:
    """Return the name of a row: ``line 19`` where its line is known, else ``row 17``."""
    return f"row {row}" if lines is None else f"line {lines[row]}"


def lines_of(motion: Any) -> Lines | None:
    """Return the line of each row of a DataArray of `read_motion`; None for all else."""
    line = motion.coords.get("line") if hasattr(motion, "dims") else None
    return None if line is None or line.ndim != 1 else line.values


class RowError(ValueError):
    """A row cannot be used; the message names it by its line where `lines` tell it."""

    def __init__(self, before: str, row: int, after: str, lines: Lines | None = None) -> None:
        super().__init__(f"{before} {place(row, lines)}{after}")
        self.parts = before, row, after


@contextmanager
def naming(lines: Lines | None) -> Iterator[None]:
    """Name the rows of errors by these lines."""
    try:
        yield
    except RowError as error:
        raise RowError(*error.parts, lines) from error
