"""A march of one body that is laid out once and called with starts, from many threads if need be.

The loads are sampled when the march is prepared. Each thread has memory of its own, with a block of addresses that
point there. A call writes the start into it, calls compiled code once (`engine.outputs`), and copies the results.
"""

from __future__ import annotations

from functools import partial
from struct import Struct
from typing import Any

import numpy as np

from ..engine.layout import put, side_by_side, views
from ..engine.outputs import HEAD, PREPARED, run_prepared
from ..engine.records import BLOCK, BODY
from ..engine.workspace import enter
from ..geometry.arrays import Array
from ..geometry.attitudes import States
from .listing import listed
from .marching import intervals_in, states_in
from .members import PerThread
from .stack_march import StackMarch

READ = "quaternions", "velocities", "normals", "intervals", "states"
START, FOUND = Struct("=8d"), Struct("=2d")


class PreparedMarch:
    """The march of one body whose start is left open."""

    def __init__(self, march: StackMarch) -> None:
        self._march, (parts,), steps = march, march.groups, march.stack.steps
        march.sample(parts, 0, steps)
        self._todo = listed(march, parts, 1, 0, steps)
        self._unit, self._run = float(march.bodies[0, BODY.unit]), run_prepared.function
        self._factors = march.factors[0]
        self._spans = {name: (part, shape[1:] or shape) for name, (part, shape) in march.spans.items() if name in READ}
        self._threads = PerThread(self._workspace)

    def __call__(self, p: Any, W: Any, scale: float) -> tuple[Array, float, float]:
        """March from the quaternion `p`, scalar last, and W.

        Return the numbers found, for `read`, the sum of their squares, infinite where the run has failed, and the
        largest |W|² of the stored states.
        """
        memory, start, address, _ = self._threads.own
        START.pack_into(start, 0, *p, *W, scale / self._unit)
        self._run(address)
        return memory.copy(), *FOUND.unpack_from(start, 8 * PREPARED.squares)

    def read(self, found: Array) -> dict[str, Any]:
        """Return the states of a run from the numbers found; its `_read` returns the rest."""
        arrays = views(found, self._spans)
        return {"states": states_in(arrays, self._march.skipped), "_read": partial(self._rest, arrays)}

    def _rest(self, arrays: dict[str, Array]) -> dict[str, Any]:
        means = intervals_in(self._march, arrays, self._march.skipped)._asdict()
        return means | {"memory": arrays["states"] * self._factors}

    @property
    def states(self) -> States:
        """The states of the last call of this thread, in memory that its next call overwrites."""
        found: States = self._threads.own[3][0]
        return found

    def _workspace(self) -> tuple[Array, memoryview, int, Any]:
        """Return memory for one thread: results, the start and what comes back, the address of the head, all of it."""
        march, (arrays, places) = self._march, side_by_side(**self._march.shapes)
        memory, call = arrays["quaternions"].base, np.zeros(HEAD.size + PREPARED.size, dtype=np.int64)
        assert memory is not None
        block, *alive = march.laid(self._todo)
        put(block, BLOCK, **places, scales=call[HEAD.size + PREPARED.factor :])
        put(call, HEAD, block=block, numbers=len(memory), enter=enter.address)
        put(call, HEAD, run=march.driver(self._todo).address)
        start = call[HEAD.size :].data.cast("B")
        return memory, start, call.ctypes.data, (states_in(arrays, march.skipped).part(0), call, block, alive)
