"""A march of one body that is laid out once and called with starts, from many threads if need be.

The loads are sampled when the march is prepared. Each thread has memory of its own, with a block of addresses that
point there for each stretch of equal steps. A call writes the start into it, calls compiled code once
(`engine.prepared`), and copies the results.
"""

from __future__ import annotations

from struct import Struct
from threading import local
from typing import Any

import numpy as np

from ..engine import states as between
from ..engine.outputs import CALLS, carry_out
from ..engine.prepared import GIVEN, HEAD, run_prepared
from ..engine.records import BLOCK, BODY, SUMS, WORK
from ..geometry.arrays import Array, aligned
from ..geometry.attitudes import States
from .compiled import Compiled
from .output_calls import calls, workspace
from .problem import Problem
from .stack_march import PLACES, StackMarch

TOTALS = "totals"  # the one array that the block does not know
START, FOUND = Struct("=8d"), Struct("=2d")


class PreparedMarch:
    """The march of a problem of one body whose start is left open."""

    def __init__(self, problem: Problem, integrator: Compiled) -> None:
        integrator.require(problem.systems, problem.load)
        scheme = integrator._scheme(problem.systems.axis is not None)
        march = self._march = StackMarch(problem, integrator.order, scheme)
        form = int(march.forms[0])
        march.sample(form, 0, problem.steps)
        kernel = march.kernel(form)
        director, count, self._threads = scheme.is_director_scheme, march.arrays["quaternions"].shape[1], local()
        self._room, self._calls, pieces = scheme.room(1), None, march.block[None, PLACES]
        if march.outputs is None:
            pieces, _ = march.pieces(0, problem.steps)
        else:
            self._calls = calls(march, form, 1, 0, problem.steps)
        self._unit, self._factors = float(march.bodies[0, BODY.unit]), march.factors[0]
        results = march.arrays["quaternions"].base
        assert results is not None
        self._results, places, at = len(results), {}, int(march.block[BLOCK.quaternions])
        blocks = self._blocks = np.repeat(march.block[None], len(pieces), axis=0)
        blocks[:, BLOCK.end], blocks[:, PLACES] = 1, pieces
        for name, address in march.addresses.items():
            places[name] = (address - at) // 8
            if address and name != TOTALS:
                blocks[:, getattr(BLOCK, name)] -= at
        self._moved = [getattr(BLOCK, name) for name, address in march.addresses.items() if address and name != TOTALS]
        self._totals = places[TOTALS]
        n, self._first = count - 1, march.skipped
        self._parts = [
            (slice(places[name], places[name] + rows * columns), (rows, columns))
            for name, rows, columns in [
                ("quaternions", count, 4),
                ("velocities", count, 3),
                ("intervals", n, SUMS.size),
                *([("normals", count, 6)] if director else []),
            ]
        ]
        state, size = places["states"], march.arrays["states"].shape[1]
        self._states = slice(state, state + size)
        self._head = {
            "numbers": self._results,
            "states": count,
            "stride": blocks.strides[0],
            "pieces": len(blocks),
            "enter": between.enter.address,
            "run": (kernel if self._calls is None else carry_out(march.parts)).address,
            "velocities": places["velocities"],
            "failure": places["failures"],
            "guesses": state + march.guesses.start,
            "guesses_end": state + size,
        }
        self._run = run_prepared.function
        self._columns = slice(
            SUMS.lam if director else SUMS.mu, SUMS.mu if problem.systems.axis is None else SUMS.moment
        )

    def __call__(self, p: Any, W: Any, scale: float) -> tuple[Array, float, float]:
        """March from the quaternion `p`, scalar last, and W.

        Return the numbers found, for `read`, the sum of their squares, infinite where the run has failed, and the
        largest |W|² of the stored states.
        """
        try:
            memory, given, address, _ = self._threads.own
        except AttributeError:
            memory, given, address, _ = self._threads.own = self._workspace()
        START.pack_into(given, 0, *p, *W, scale / self._unit)
        self._run(address)
        return memory.copy(), *FOUND.unpack_from(given, 8 * GIVEN.squares)

    def read(self, found: Array) -> dict[str, Any]:
        """Return fields of a run from the numbers found."""
        p, W, intervals, *N = (found[part].reshape(shape)[self._first :] for part, shape in self._parts)
        return {
            "states": States(p, W, *N),
            "multipliers": intervals[:, self._columns],
            "moment": intervals[:, SUMS.moment : SUMS.dead],
            "load_work": intervals[:, SUMS.work],
            "newton_iterations": intervals[:, SUMS.iterations].astype(np.int64),
            "dead_moment": intervals[:, SUMS.dead : SUMS.work] if self._march.gives_dead_moment else None,
            "twist": intervals[:, SUMS.twist] if self._march.gives_twist else None,
            "memory": found[self._states] * self._factors,
        }

    @property
    def states(self) -> States:
        """The states of the last call of this thread, in memory that its next call overwrites."""
        own: States = self._threads.own[3][-1]
        return own

    def _workspace(self) -> tuple[Array, memoryview, int, Any]:
        """Return memory for one thread: results, what is given and comes back, the address of the head, all of it."""
        memory, work, blocks = np.zeros(self._results + 1), aligned(WORK.size + self._room), self._blocks.copy()
        at = memory.ctypes.data
        blocks[:, self._moved] += at
        blocks[:, BLOCK.scales], blocks[:, BLOCK.workspace] = at + 8 * self._results, work.ctypes.data
        head, room = None, None
        if self._calls is not None:
            head, room = self._calls.head.copy(), workspace(1, self._march)
            head[CALLS.totals], head[CALLS.room] = at + 8 * self._totals, room.ctypes.data
            blocks[0, BLOCK.calls] = head.ctypes.data
        call = np.zeros(HEAD.size + GIVEN.size, dtype=np.int64)
        addresses = {"results": at, "factor": at + 8 * self._results, "blocks": blocks.ctypes.data}
        for name, number in (self._head | addresses).items():
            call[getattr(HEAD, name)] = number
        given = call[HEAD.size :].data.cast("B")
        found = memory[: self._results]
        p, W, _, *N = (found[part].reshape(shape)[self._first :] for part, shape in self._parts)
        return found, given, call.ctypes.data, (work, blocks, head, room, call, States(p, W, *N))
