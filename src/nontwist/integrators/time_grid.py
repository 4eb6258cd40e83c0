"""The uniform time grid of a run or an ensemble, and of a run that it continues.

A run from t_start to t_end in N steps has the nodes ``t_k = t_start + (t_end - t_start) k / N``. A run that continues
another one has the nodes of the whole: with the origin t_0 of that grid and n steps of it before t_start,
``t_k = t_0 + (t_end - t_0) (n + k) / (n + N)``, and the step is, bit for bit, that of the run before. In both cases the
first and the last node are t_start and t_end bit for bit, and no node lies outside.
"""

from __future__ import annotations

from functools import cached_property
from math import ceil
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array


class PreviousGrid(NamedTuple):
    """The grid of a run up to its end."""

    origin: float  # s
    steps: int  # from the origin to the end
    step: float  # s


class OnGrid:
    """What has a time grid; the attributes are fields of the dataclasses derived from this one."""

    t_start: float
    t_end: float
    steps: int
    stored: NDArray[np.int64]  # numbers of the steps whose ends are kept, 0 and `steps` among them
    asked: Array | None  # output times that need not lie on the grid
    before: PreviousGrid | None  # the grid that this one continues

    @property
    def step(self) -> float:
        """Step size h, s."""
        return (self.t_end - self.t_start) / self.steps if self.before is None else self.before.step

    @cached_property
    def output(self) -> Array:
        """Times at which states are stored, s."""
        return self.times(self.stored) if self.asked is None else self.asked

    def times(self, k: Any) -> Array:
        """Return the times of the nodes of the numbers `k`."""
        k = np.asarray(k)
        inner = self._at(self._steps_before + k)
        return np.where(k == self.steps, self.t_end, np.where(k == 0, self.t_start, inner))

    def nodes(self, first: int, last: int, middles: Array) -> Array:
        """Return the times at the fractions `middles` of the steps from number `first` to `last`, one after another."""
        return self._at((self._steps_before + np.arange(first, last))[:, None] + middles).ravel()

    def steps_until(self, time: float) -> int:
        """Return the number of steps that begin before a time."""
        last = (time - self.t_start) / self.step
        return self.steps if last > self.steps - 1 else ceil(max(0.0, last))

    def began(self, step: int) -> float:
        """Return the time at which a step begins; of asked times that with this number, t_start before the first."""
        if self.asked is None:
            return float(self.times(step))
        return float(self.asked[step]) if step >= 0 else self.t_start

    @property
    def _steps_before(self) -> int:
        return 0 if self.before is None else self.before.steps

    def _at(self, x: Any) -> Array:
        """Return the times `x` steps after the origin."""
        origin = self.t_start if self.before is None else self.before.origin
        times = origin + (self.t_end - origin) * x / (self._steps_before + self.steps)
        inside: Array = np.clip(times, self.t_start, self.t_end)
        return inside
