"""The steps of a march in which no moment acts, in stretches: a scheme that is exact without load covers each at once.

In such a stretch the march carries the state in which the stretch began; the states that are stored in it are evaluated
from there, and so is the state at its end. So what a stretch gives does not depend on where the march pauses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..loads import Load
from .problem import Problem


class Coasting:
    """Stretches of equal steps in which a load is known to be zero, in a grid.

    Attributes
    ----------
    begin : (k,) int array, number of the first step of each
    end : (k,) int array, number of the step that follows the last one
    """

    def __init__(self, problem: Problem, load: Load | None) -> None:
        """Find the stretches; without a load, of a scheme that is not exact, there are none."""
        acting = np.empty((0, 2)) if load is None else load.acting
        begin = problem.steps_until(np.concatenate([[-np.inf], acting[:, 1]]))
        end = problem.steps_ended(np.concatenate([acting[:, 0], [np.inf]]))
        is_long = (end > begin) & (load is not None)
        begin, end = begin[is_long], end[is_long]
        numbers = np.array(problem.grid.numbers)
        inner = numbers[1:-1][self._inside(begin, end, numbers[1:-1])]
        self.begin: NDArray[np.int64] = np.union1d(begin, inner)
        self.end: NDArray[np.int64] = np.union1d(end, inner)
        self._passed = np.concatenate([[0], np.cumsum(self.end - self.begin)])

    @staticmethod
    def _inside(begin: NDArray[np.int64], end: NDArray[np.int64], numbers: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which nodes lie inside a stretch."""
        return np.searchsorted(begin, numbers) > np.searchsorted(end, numbers, side="right")

    def __len__(self) -> int:
        return len(self.begin)

    def stretch_of(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the number of the stretch that each step is in, -1 where it is in none."""
        j = np.searchsorted(self.begin, steps, side="right") - 1
        return np.where(j == np.searchsorted(self.end, steps, side="right"), j, -1)

    def before(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return how many of the steps before each are in a stretch."""
        j = np.searchsorted(self.begin, steps, side="right")
        last = np.maximum(j - 1, 0)
        if not len(self):
            return np.zeros_like(steps)
        return np.where(j > 0, self._passed[last] + np.minimum(steps, self.end[last]) - self.begin[last], 0)
