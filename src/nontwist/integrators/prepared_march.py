"""A march of one body that is laid out once and called with starts, from many threads if need be.

A call copies the block of addresses, moves those of results and workspace to memory of its own, writes the start there
and runs the kernels: what lasts a few µs beside them. The loads are sampled when the march is prepared.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..engine import states as between
from ..engine.layout import BLOCK, BODY, SUMS, WORK
from ..geometry.arrays import Array
from .problem import Problem
from .stack_march import NODES, Scheme, StackMarch


class Found(NamedTuple):
    """What a call gives, all of it in one piece of memory; columns as in `problem.Outcome`, for one member."""

    quaternion: Array  # (k, 4)
    velocity: Array  # (k, 3)
    normal: Array | None  # (k, 6)
    multipliers: Array
    moment: Array
    load_work: Array
    iterations: Array  # (n,) floats
    memory: Array  # the state as it is carried


class PreparedMarch:
    """The march of a problem of one body whose start is left open."""

    def __init__(self, problem: Problem, order: int, scheme: Scheme) -> None:
        march = self._march = StackMarch(problem, order, scheme)
        march.take(0, problem.steps, 0)
        self._kernel, enter = scheme.one[int(march.forms[0])], between.enter
        self._enter: Any = enter
        self._how = (1, not scheme.is_director_scheme, problem.systems.axis is not None, scheme.is_director_scheme)
        self._unit, self._factors = float(march.bodies[0, BODY.unit]), march.factors[0]
        owner: Any = march.arrays["quaternions"].base
        base, count = int(march.block[BLOCK.quaternions]), len(problem.stored)
        results = len(owner)
        self._size, self._results, self._step = results + 1 + WORK.size, results, march.arrays["step"].copy()
        block = march.block.copy()
        block[BLOCK.end] = 1
        own = [getattr(BLOCK, name) for name, address in march.addresses.items() if address]
        block[BLOCK.scales], block[BLOCK.workspace] = base + 8 * results, base + 8 * (results + 1)
        own += [BLOCK.scales, BLOCK.workspace]
        self._moved = np.zeros(BLOCK.size, dtype=np.int64)
        self._moved[own] = 1
        self._block = block - base * self._moved
        places = {name: (int(block[getattr(BLOCK, name)]) - base) // 8 for name in march.addresses}

        def part(name: str, rows: int, columns: int) -> tuple[slice, tuple[int, int]]:
            return slice(places[name], places[name] + rows * columns), (rows, columns)

        self._steps, self._failure = places["step"], places["failures"]
        self._quaternion, self._velocity = part("quaternions", count, 4), part("velocities", count, 3)
        self._normal = part("normals", count, 6) if scheme.is_director_scheme else None
        self._intervals = part("intervals", count - 1, SUMS.size)
        self._states = part("states", 1, len(self._factors))[0]
        first = SUMS.lam if scheme.is_director_scheme else SUMS.mu
        self._columns = slice(first, SUMS.mu if problem.systems.axis is None else SUMS.moment)
        self._at_velocity = places["velocities"]

    @staticmethod
    def suits(problem: Problem, stages: int) -> bool:
        """Whether the march of a problem can be prepared: its nodes fit into one part, and its load is compiled."""
        return problem.steps * stages <= NODES and problem.load.is_compiled

    def __call__(self, p: Any, W: Any, scale: float) -> tuple[Found, Array, bool]:
        """March from the quaternion `p`, scalar last, and W; return what is found, all its numbers, and its success."""
        memory = np.zeros(self._size)
        block = self._block + memory.__array_interface__["data"][0] * self._moved
        at = self._at_velocity
        memory[0:4], memory[at : at + 3] = p, W
        memory[self._steps : self._steps + 2] = self._step
        memory[self._results] = scale / self._unit
        address = block.__array_interface__["data"][0]
        self._enter(address, *self._how)
        self._kernel(address)
        intervals = memory[self._intervals[0]].reshape(self._intervals[1])
        found = Found(
            memory[self._quaternion[0]].reshape(self._quaternion[1]),
            memory[self._velocity[0]].reshape(self._velocity[1]),
            None if self._normal is None else memory[self._normal[0]].reshape(self._normal[1]),
            intervals[:, self._columns],
            intervals[:, SUMS.moment : SUMS.work],
            intervals[:, SUMS.work],
            intervals[:, SUMS.iterations],
            memory[self._states] * self._factors,
        )
        return found, memory[: self._results], memory[self._failure] == 0.0
