"""A march of one body that is laid out once and called with starts, from many threads if need be.

The loads are sampled when the march is prepared. Each thread has memory of its own, with a block of addresses that
point there; a call writes the start into it, runs the kernels, and copies the results.
"""

from __future__ import annotations

from struct import Struct
from threading import local
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..engine import states as between
from ..engine.layout import BLOCK, BODY, SUMS, WORK
from ..geometry.arrays import Array
from ..geometry.attitudes import States
from .composed import Composed
from .problem import Problem
from .stack_march import StackMarch


class PreparedMarch:
    """The march of a problem of one body whose start is left open."""

    def __init__(self, problem: Problem, integrator: Composed) -> None:
        scheme = integrator._scheme(problem.systems.axis is not None)
        march = self._march = StackMarch(problem, integrator.order, scheme)
        form = int(march.forms[0])
        march.sample(form, 0, problem.steps)
        march.block[BLOCK.steps] = problem.steps
        director, count, self._threads = scheme.is_director_scheme, len(problem.stored), local()
        enter: Any = between.enter
        self._enter, self._kernel = enter.ready, scheme.one[form].ready
        self._room = scheme.room(1)
        self._unit, self._factors = float(march.bodies[0, BODY.unit]), march.factors[0]
        results = march.arrays["quaternions"].base
        assert results is not None
        self._results, places, at = len(results), {}, int(march.block[BLOCK.quaternions])
        self._block = march.block.copy()
        self._block[BLOCK.end] = 1
        for name, address in march.addresses.items():
            if address:
                places[name] = (address - at) // 8
                self._block[getattr(BLOCK, name)] -= at
        self._moved = [getattr(BLOCK, name) for name in places]
        self._empty = np.zeros(self._results)
        self._empty[places["step"] : places["step"] + 2] = march.arrays["step"]
        self._start = Struct(f"=4d{8 * (places['velocities'] - 4)}x3d")
        n = count - 1
        self._parts = [
            (slice(places[name], places[name] + rows * columns), (rows, columns))
            for name, rows, columns in [
                ("quaternions", count, 4),
                ("velocities", count, 3),
                ("intervals", n, SUMS.size),
                *([("normals", count, 6)] if director else []),
            ]
        ]
        self._states, self._failure = (
            slice(places["states"], places["states"] + march.arrays["states"].shape[1]),
            places["failures"],
        )
        self._columns = slice(
            SUMS.lam if director else SUMS.mu, SUMS.mu if problem.systems.axis is None else SUMS.moment
        )

    def __call__(self, p: Any, W: Any, scale: float) -> tuple[dict[str, Any], Array, bool]:
        """March from the quaternion `p`, scalar last, and W; return fields of a run, all numbers, and the success."""
        try:
            memory, factor, address, _ = self._threads.own
        except AttributeError:
            memory, factor, address, _ = self._threads.own = self._workspace()
        memory[:] = self._empty
        self._start.pack_into(memory, 0, *p, *W)
        factor[0] = scale / self._unit
        self._enter(address)
        self._kernel(address)
        found = memory.copy()
        p, W, intervals, *N = (found[part].reshape(shape) for part, shape in self._parts)
        return (
            {
                "states": States(p, W, *N),
                "multipliers": intervals[:, self._columns],
                "moment": intervals[:, SUMS.moment : SUMS.work],
                "load_work": intervals[:, SUMS.work],
                "newton_iterations": intervals[:, SUMS.iterations].astype(np.int64),
                "memory": found[self._states] * self._factors,
            },
            found,
            found[self._failure] == 0.0,
        )

    def _workspace(self) -> tuple[Array, Array, int, NDArray[np.int64]]:
        """Return memory for one thread: results, the factor of the load, and the address of a block that it keeps."""
        memory, block = np.zeros(self._results + 1 + WORK.size + self._room), self._block.copy()
        at = memory.ctypes.data
        block[self._moved] += at
        block[BLOCK.scales], block[BLOCK.workspace] = at + 8 * self._results, at + 8 * (self._results + 1)
        return memory[: self._results], memory[self._results : self._results + 1], block.ctypes.data, block
