"""The time grid of a run or an ensemble: stretches of equal steps.

A run from t_start to t_end in N equal steps has the nodes ``t_k = t_start + (t_end - t_start) k / N``. Where a load has
kinks and the step is left open, there is a stretch of equal steps between any two of them, so that each kink is a node:
in a stretch from b to c, between the nodes of the numbers m and n, ``t_k = b + (c - b) (k - m) / (n - m)``.

A run that continues another one on its grid has the nodes of the whole. Its first stretch then begins before the run
does, with a node of a negative number, and the step is, bit for bit, that of the run before. The first and the last
node of a run are t_start and t_end bit for bit, as are all borders of stretches, and no node lies outside.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array

FIT = 1e-9  # of a number of steps


class Stretches(NamedTuple):
    """Stretches of equal steps, one after the other."""

    borders: tuple[float, ...]  # s: where each begins, and where the last one ends
    numbers: tuple[int, ...]  # of the nodes there, counted from the start of the run
    sizes: tuple[float, ...]  # s: the step of each

    @property
    def steps(self) -> int:
        """Number of steps of the run."""
        return self.numbers[-1]

    @property
    def longest(self) -> float:
        """The longest step, s."""
        return max(self.sizes)

    def steps_until(self, time: float) -> int:
        """Return how many steps, the last one not a whole one perhaps, lead to a time of the grid."""
        j = min(max(int(np.searchsorted(self.borders, time)) - 1, 0), len(self.sizes) - 1)
        return self.numbers[j] + int(np.ceil((time - self.borders[j]) / self.sizes[j] * (1 - FIT)))

    def after(self, number: int) -> Stretches:
        """Return what is left after the node of this number, with the stretch that it lies in or ends."""
        j = max(int(np.searchsorted(self.numbers, number)) - 1, 0)
        return Stretches(self.borders[j:], tuple(k - number for k in self.numbers[j:]), self.sizes[j:])


def stretched(borders: Any, counts: Any) -> Stretches:
    """Return stretches with so many steps between the borders, counted from the first of them."""
    if len(counts) == 1:
        (begin, end), (steps,) = borders, counts
        return Stretches((float(begin), float(end)), (0, int(steps)), ((float(end) - float(begin)) / int(steps),))
    ends, steps = np.asarray(borders, dtype=np.float64), np.asarray(counts, dtype=np.int64)
    numbers = np.concatenate([[0], np.cumsum(steps)])
    return Stretches(tuple(ends.tolist()), tuple(numbers.tolist()), tuple((np.diff(ends) / steps).tolist()))


class OnGrid:
    """Base class of what has a time grid. Subclasses are dataclasses and have the attributes as fields."""

    t_start: float
    t_end: float
    steps: int
    stored: NDArray[np.int64]  # numbers of the nodes whose states are stored, including 0 and `steps`
    output_times: Array | None  # where states are wanted, on the grid or not; None: at the nodes `stored`
    off_grid: bool  # whether the integrator ignores the grid and integrates from one output time to the next
    stretches: Stretches | None  # sections of equal steps; None: all steps are equal

    @cached_property
    def grid(self) -> Stretches:
        """The sections of equal steps."""
        return self.stretches or stretched((self.t_start, self.t_end), (self.steps,))

    @property
    def step(self) -> float:
        """The step size h, s.

        Raises
        ------
        ValueError
            Steps have different sizes: use `step_at`.
        """
        if len(self.grid.sizes) > 1:
            raise ValueError("the steps of this grid are not all equal: step_at(k) is the size of the step k")
        return self.grid.sizes[0]

    def step_at(self, k: Any) -> Any:
        """Return the size of step number `k`, s, or of each of several."""
        return self._arrays[2][self.stretch_of(k)]

    @cached_property
    def stored_times(self) -> Array:
        """Times at which states are stored, s."""
        return self.times(self.stored) if self.output_times is None else self.output_times

    def times(self, k: Any) -> Array:
        """Return the times of the nodes with the numbers `k`, s; step number k is between the nodes k and k + 1."""
        k = np.asarray(k)
        inner = self._at(k, self.stretch_of(k))
        return np.where(k == self.steps, self.t_end, np.where(k == 0, self.t_start, inner))

    def nodes(self, steps: NDArray[np.int64], middles: Array) -> Array:
        """Return the times at the fractions `middles` of the steps with these numbers, step by step, s."""
        k = steps[:, None]
        return self._at(k, self.stretch_of(k), middles).ravel()

    def steps_until(self, time: Array | float) -> Any:
        """Return the number of steps that begin before a time, or before each of several times."""
        return np.ceil(self._steps_at(time, "left")).astype(np.int64)

    def steps_ended(self, time: Array | float) -> Any:
        """Return the number of steps that end at or before a time, or each of several times."""
        return np.floor(self._steps_at(time, "right")).astype(np.int64)

    def _steps_at(self, time: Array | float, side: Literal["left", "right"]) -> Array:
        """Return times as numbers of steps; a border is the end, or else the beginning, of a stretch."""
        borders, numbers, sizes = self._arrays
        j = np.clip(np.searchsorted(borders, time, side=side) - 1, 0, len(sizes) - 1)
        found: Array = np.clip(numbers[j] + (time - borders[j]) / sizes[j], 0, numbers[j + 1])
        return found

    def began(self, step: int) -> float:
        """Return the time at which a step begins, s; off the grid, the output time with this number, or t_start."""
        if self.output_times is None or not self.off_grid:
            return float(self.times(step))
        return float(self.output_times[step]) if step >= 0 else self.t_start

    def stretch_of(self, k: Any) -> Any:
        """Return the numbers of the sections that contain the steps `k`."""
        if len(self.grid.sizes) == 1:
            return np.zeros(np.shape(k), np.int64)
        return np.searchsorted(self._arrays[1][1:-1], k, side="right")

    def _at(self, k: Any, j: Any, parts: Any = 0.0) -> Array:
        """Return the times at the fractions `parts` of the steps `k`, which are in the stretches `j`."""
        borders, numbers, _ = self._arrays
        b, c, n = borders[j], borders[j + 1], numbers[j]
        inside = b + (c - b) * ((k - n) + parts) / (numbers[j + 1] - n)
        found: Array = np.minimum(np.maximum(np.minimum(np.maximum(inside, b), c), self.t_start), self.t_end)
        return found

    @cached_property
    def _arrays(self) -> tuple[Array, NDArray[np.int64], Array]:
        return np.array(self.grid.borders), np.array(self.grid.numbers, dtype=np.int64), np.array(self.grid.sizes)
