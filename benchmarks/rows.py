"""What a benchmark reports: a figure measured in this run."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Row:
    """One figure."""

    name: str
    measured: float | None
    unit: str
    note: str = ""

    @property
    def value(self) -> str:
        """Return the figure with its unit."""
        return "–" if self.measured is None else f"{digits(self.measured)} {self.unit}".strip()


@dataclass(frozen=True)
class Table:
    """Cells as text under a header, for what one figure a line cannot say."""

    title: str
    header: list[str]
    cells: list[list[str]]


def digits(x: float) -> str:
    """Return three significant digits, written out where the number is of usual size."""
    if x and not 1e-3 <= abs(x) < 1e7:
        return f"{x:.2e}"
    return np.format_float_positional(x, precision=3, unique=False, fractional=False, trim="-")


def seconds(call: Callable[[], Any], passes: int = 7) -> float:
    """Return the median time of a call after one that is not counted."""
    call()
    times = []
    for _ in range(passes):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return median(times)
