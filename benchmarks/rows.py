"""What a benchmark reports: a figure measured in this run beside what it is held to."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Row:
    """One figure; `goal` is a lower bound unless `at_most`. None: there is nothing to hold it to."""

    name: str
    measured: float | None
    unit: str
    goal: float | None = None
    at_most: bool = False
    note: str = ""

    @property
    def verdict(self) -> str:
        """Return "met", "missed", or what stands in the way of a verdict."""
        if self.measured is None:
            return "not measured"
        if self.goal is None:
            return ""
        return "met" if (self.measured <= self.goal if self.at_most else self.measured >= self.goal) else "MISSED"

    @property
    def value(self) -> str:
        """Return the figure with its unit."""
        return "–" if self.measured is None else f"{digits(self.measured)} {self.unit}".strip()

    @property
    def bound(self) -> str:
        """Return the goal as text."""
        return "" if self.goal is None else f"{'≤' if self.at_most else '≥'} {self.goal:g}"


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
