"""The steps of a march in which no moment acts, in stretches: a scheme that is exact without load covers each at once.

In such a stretch the march carries the state in which the stretch began; the states that are stored in it are evaluated
from there, and so is the state at its end. So what a stretch gives does not depend on where the march pauses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..loads import Load
from .problem import IVP


class Coasting:
    """Stretches of equal steps in which a load is known to be zero, in a grid.

    Attributes
    ----------
    begin : (k,) int array, number of the first step of each
    end : (k,) int array, number of the step that follows the last one
    """

    def __init__(self, problem: IVP, load: Load | None) -> None:
        """Find the stretches; without a load, of a scheme that is not exact, there are none."""
        self.begin: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self.end = self.begin
        if load is not None:
            begin = problem.steps_until(np.concatenate([[-np.inf], load.acting[:, 1]]))
            end = problem.steps_ended(np.concatenate([load.acting[:, 0], [np.inf]]))
            begin, end, numbers = begin[end > begin], end[end > begin], np.array(problem.grid.numbers[1:-1])
            is_inside = np.searchsorted(begin, numbers) > np.searchsorted(end, numbers, side="right")
            self.begin, self.end = np.union1d(begin, numbers[is_inside]), np.union1d(end, numbers[is_inside])
        self._passed = np.concatenate([[0], np.cumsum(self.end - self.begin)])

    def __len__(self) -> int:
        return len(self.begin)

    def stretch_of(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the number of the stretch that each step is in, -1 where it is in none."""
        j = np.searchsorted(self.begin, steps, side="right") - 1
        return np.where(j == np.searchsorted(self.end, steps, side="right"), j, -1)

    def before(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return how many of the steps before each are in a stretch."""
        if not len(self):
            return np.zeros_like(steps)
        j = np.searchsorted(self.begin, steps, side="right")
        last = np.maximum(j - 1, 0)
        return np.where(j > 0, self._passed[last] + np.minimum(steps, self.end[last]) - self.begin[last], 0)
