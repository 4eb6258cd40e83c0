"""The free motion of one body by closed-form solutions, laid out once and called with starts, from many threads."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from struct import Struct
from threading import local
from typing import Any

import numpy as np

from ..exact.free_constants import OK
from ..exact.free_kernels import free_members
from ..geometry.arrays import Array, sum_of_squares
from ..geometry.attitudes import States
from .exact_march import free_intervals, refusal
from .problem import Problem


class PreparedSolution:
    """The solution of a problem of one free body whose start is left open.

    Raises
    ------
    ValueError
        There is no closed-form solution.
    """

    def __init__(self, problem: Problem) -> None:
        if reason := refusal(problem):
            raise ValueError(reason)
        self._systems, since = problem.systems, problem.output - problem.t_start
        self._place, self._count, self._threads = int(since[0] == 0.0), len(since), local()
        self._since = since[self._place :].copy()
        self._empty = np.full(7 * self._count, np.nan)
        self._start = Struct(f"=4d{8 * (4 * self._count - 4)}x3d")

    def __call__(self, p: Any, W: Any, scale: float) -> tuple[Array, float, float]:
        """Evaluate the solution from the quaternion `p`, scalar last, and W; as `PreparedMarch`.

        There is no load, so no factor, and no step that a velocity could be too large for.
        """
        try:
            memory, solve = self._threads.own
        except AttributeError:
            memory, solve = self._threads.own = self._workspace()
        memory[:] = self._empty
        self._start.pack_into(memory, 0, *p, *W)
        status, _ = solve()
        return memory.copy(), sum_of_squares(memory) if status == OK else inf, 0.0

    def read(self, found: Array) -> dict[str, Any]:
        """Return fields of a run from the numbers found."""
        p, W = self._states(found)
        means = free_intervals(self._systems, W[:1], self._count - 1)
        return {"states": States(p, W), **means.of_one, "memory": None}

    def _states(self, found: Array) -> tuple[Array, Array]:
        """Return views of the quaternions and of W."""
        k = self._count
        return found[: 4 * k].reshape(k, 4), found[4 * k :].reshape(k, 3)

    def _workspace(self) -> tuple[Array, Callable[[], Any]]:
        """Return memory for one thread, and the kernel that works on it."""
        memory = self._empty.copy()
        p, W = self._states(memory)
        J, axis, given = self._systems.convected_inertia, self._systems.axis, (self._since, self._place, 0, 1)
        axes = np.zeros((0, 3)) if axis is None else axis
        return memory, free_members.bound(J, axes, *given, p[None], W[None])
