"""Derivatives of runs: linearised steps, chained as `engine.linearised` has it, forward and back.

`Growth` is how much orthonormal changes of a state grow along a run, by the same matrices.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..engine.known_steps import LANES, STEPS
from ..engine.linearised import chain_back, chain_forward, grow
from ..engine.records import State, pack, side_by_side
from ..geometry.arrays import Array, aligned
from ..geometry.attitudes import BASIS, ENTRIES, States
from ..kernels import machine_code
from ..kernels.kernel import address_of
from ..kernels.memory import size_of
from .linearised_runs import (
    LONGEST,
    Chunk,
    EntriesOf,
    InputDerivatives,
    Linearised,
    StepMask,
    StepNodes,
    Workspace,
    ranged,
)
from .stepping import PerThread

TOGETHER = 32, 4, 1  # steps between two times at which changes are made orthonormal
CANCELLED, NOTHING = 1e-6, 1e-300  # of the largest growth between them: what has lost digits; no growth


def forward(steps: Linearised, states: States, start: Array, entries: EntriesOf, is_stored: StepMask) -> Array:
    """Return the changes of the states at the ends of the stored steps, (stored, 6, count): attitude, then W.

    `start` is the change of the first one, (rows, count), `is_stored` an array of 0 and 1, one for each step.
    """
    count, own = start.shape[1], steps.workspace()
    padded = -(-count // LANES) * LANES
    x, found = aligned(steps.rows, padded), aligned(int(is_stored.sum()), 6, padded, empty=True)
    x[:, :count] = steps.in_frame(start)
    for chunk in steps.chunks(count, entries, is_stored):
        steps.run(chain_forward(steps.rows), own, chunk, states, state=x, states=found[chunk.first_stored :])
    return steps.in_frame(found[:, :, :count], back=True)


def back(
    steps: Linearised, states: States, slopes: Array, entries: EntriesOf, is_stored: StepMask, count: int
) -> tuple[Array, Array]:
    """Return the derivatives of f by the first state, (rows,), and by the parameters of the entries, (count,).

    `slopes` are those by the states at the ends of the stored steps, (stored, 6).
    """
    x, scratch, own = np.zeros(steps.rows), np.empty(steps.width), steps.workspace()
    found = np.zeros(-(-count // LANES) * LANES)
    slopes = np.ascontiguousarray(steps.in_frame(slopes[:, :, None])[:, :, 0])
    for chunk in steps.chunks(count, entries, is_stored, back=True):
        arrays = {"state": x, "scratch": scratch, "states": slopes[chunk.first_stored :], "found": found}
        steps.run(chain_back, own, chunk, states, **arrays)
    return steps.in_frame(x[:, None], back=True)[:, 0], found[:count]


Calls = list[tuple[NDArray[np.int64], int, Chunk]]  # blocks, their addresses, and steps


def are_solved(steps: Linearised, run: Any, calls: Calls, states: States | None = None) -> bool:
    """Let changes go through all steps; return whether these are solved again, given the states at all nodes."""
    for block, address, chunk in calls:
        if states is not None and steps.is_called:
            pack(block, STEPS, **chunk.states(states))
        run(address)
        steps.require_no_error()
        if block[STEPS.failed]:
            block[STEPS.failed] = 0
            return False
    return True


class PreparedTangents:
    """The derivatives of runs of one plan from any start, laid out once, from many threads if need be.

    Parameters
    ----------
    steps : Linearised
    count : int
        How many parameters there are.
    entries : what they do to the inputs of steps
    is_stored : (steps,) array of 0 and 1
    """

    def __init__(self, steps: Linearised, count: int, entries: EntriesOf, is_stored: StepMask) -> None:
        self._steps, self._chunks = steps, list(steps.chunks(count, entries, is_stored))
        self._stored_count, self._count, self._threads = int(is_stored.sum()), count, PerThread(lambda: (None,) * 6)
        self._run = chain_forward(steps.rows).function

    def __call__(self, states: States, start: Array, factor: float) -> Array | None:
        """Return the changes of the states at the start and at the stored steps, (1 + stored, 6, count).

        `states` are those at all nodes, in memory that belongs to this thread; `factor` that of the load. None where a
        step is not solved again.
        """
        known, x, found, scale, calls, _ = self._threads.own
        if known is not states:
            known, x, found, scale, calls, _ = self._threads.own = self._workspace(states)
        scale[0], x[:, : self._count] = factor, self._steps.in_frame(start)
        if not are_solved(self._steps, self._run, calls, states):
            return None
        changes: Array = np.empty((1 + len(found), *start[:6].shape))
        changes[0], changes[1:] = start[:6], self._steps.in_frame(found[:, :, : self._count], back=True)
        return changes

    def _workspace(self, states: States) -> Any:
        """Return memory for one thread: its states, X, what is found, the factor, calls, and all of it."""
        steps, padded = self._steps, -(-self._count // LANES) * LANES
        x, scale = aligned(steps.rows, padded), np.ones(1)
        found = aligned(self._stored_count, 6, padded, empty=True)
        own, calls = steps.workspace(), Calls()
        for chunk in self._chunks:
            ends = found[chunk.first_stored :]
            block = steps.block(own, chunk, states, factor=scale, state=x, states=ends)
            calls.append((block, address_of(block), chunk))
        return states, x, found, scale, calls, own


class ForwardTangents:
    """As `PreparedTangents`, of a traced scheme and few parameters: the steps are taken and linearised at once.

    A turn of the start alone, by a parameter that does nothing else, turns all of a run that does not see its attitude.
    """

    MOST = 3 * LANES

    def __init__(self, steps: Linearised, start: Array, entries: EntriesOf, is_stored: StepMask) -> None:
        is_turned = start[:3].any(axis=0) & (not steps.see_attitude)
        self._turned, self._others = np.flatnonzero(is_turned), np.flatnonzero(~is_turned)
        self._steps, self._stored_count, side = steps, int(is_stored.sum()), machine_code.lanes()
        place, self._count = np.cumsum(~is_turned) - 1, len(self._others)

        def entries_of(nodes: StepNodes) -> Iterator[InputDerivatives]:
            return (one._replace(parameter=place[one.parameter]) for one in entries(nodes))

        self._chunks = list(steps.chunks(self._count, entries_of, is_stored))
        inputs = set().union(*(chunk.arrays["columns"].tolist() for chunk in self._chunks))
        self._turn = None if steps.frame is None else steps.in_frame(np.eye(steps.rows))
        self._padded, self._kernel = -(-self._count // side) * side, steps.forward_run(tuple(sorted(inputs))).function
        self._start = self._parted(start)
        self._threads = PerThread(self._workspace)

    def _parted(self, start: Array) -> tuple[Array, Array, Array]:
        """Return the changes of the first state as they are returned, carried along, and turned."""
        carried = start if self._turn is None else self._turn @ start
        return start[:6], carried[:, self._others], carried[:3, self._turned]

    def __call__(self, p: Any, W: Any, start: Array | None, factor: float) -> Array | None:
        """Return the changes of the states of the run from the quaternion p, scalar last, and W; None where it fails.

        They are (1 + stored, 6, count), at the start and at the stored steps; None stands for the start that is known.
        """
        x, state, found, turns, scale, calls, _ = self._threads.own
        first, carried, turned = self._start if start is None else self._parted(start)
        scale[0], state[:], x[: len(carried), : self._count] = factor, 0.0, carried
        state[-7:-3], state[-3:] = p, W
        if not are_solved(self._steps, self._kernel, calls):
            return None
        changes, ends = np.zeros((len(found) + 1, *first.shape)), found[:, :, : self._count]
        if self._turn is not None:
            B = self._turn[:3, :3].T
            ends, turns = self._turn[:6, :6].T @ ends, B @ turns
        changes[0], changes[1:, :, self._others] = first, ends
        if len(self._turned):
            changes[1:, :3, self._turned] = turns @ turned
        return changes

    def _workspace(self) -> Any:
        """Return memory for one thread: changes, state, what is found, turns, the factor, calls, and all of it."""
        steps, rows, count = self._steps, self._steps.rows, self._stored_count
        x, fixed = (aligned(steps.width, self._padded) for _ in range(2))
        state, turns = aligned(size_of(State) + 7), np.zeros((count, 3, 3))
        found, scale = aligned(count, 6, self._padded, empty=True), np.ones(1)
        own, calls = steps.workspace(), Calls()
        how: dict[str, Any] = {"factor": scale, "state": x, "changes": fixed, "carried": state, "start": state[-7:]}
        for chunk in self._chunks:
            fixed[rows:] = 0.0
            fixed[chunk.arrays["used"], : self._count] = chunk.arrays["changes"][:, : self._count]
            how |= {"states": found[chunk.first_stored :], "turns": turns[chunk.first_stored :]}
            how |= {"padded": self._padded, "is_first": chunk.first == 0}
            block = steps.block(own, chunk, **how)
            calls.append((block, address_of(block), chunk))
        x[:] = fixed
        return x, state, found, turns, scale, calls, (own, fixed)


class Growth:
    """The growth along the runs of a problem of one body, laid out once for states of any start.

    Parameters
    ----------
    steps : Linearised
        Without inputs.
    """

    def __init__(self, steps: Linearised) -> None:
        self._steps, axis = steps, steps.axis
        first = np.eye(steps.rows, 6)
        if axis.any():
            across = np.linalg.svd(axis[None])[2][1:].T
            first = np.zeros((steps.rows, 5))
            first[:3, :3], first[3:6, 3:] = np.eye(3), across
        self.count = first.shape[1]
        random = np.random.default_rng(0).normal(size=(self.count, self.count))
        self._first = first @ np.linalg.qr(random)[0]  # along nothing in particular
        self._chunks: list[Chunk] | None = None

    def keep(self) -> Growth:
        """Keep what acts on the steps, for many runs, and return this."""
        self._chunks = list(self._steps.chunks())
        return self

    def sums(self, states: States, own: Workspace) -> tuple[Array, Array]:
        """Return times, s, and the logarithms of what changes have grown by until each of them, (times, count).

        At these times changes are made orthonormal: so often that round-off of those that grow most does not hide how
        the others do.

        Parameters
        ----------
        states : States
            At all nodes.
        own : Workspace
            Of the steps, for this thread alone.

        Raises
        ------
        SimulationError
            The equations of a step are not solved again.
        """
        for together in TOGETHER:
            parts = ranged(self._steps.problem.steps, LONGEST)
            ends = [np.append(np.arange(k + together, last, together), last) for k, last in parts]
            times = self._steps.problem.times(np.concatenate(ends))
            lengths = self._lengths(states, own, together, len(times))
            if together == 1 or (lengths.min(axis=1) > CANCELLED * lengths.max(axis=1)).all():
                break
        return times, np.cumsum(np.log(np.maximum(lengths, NOTHING)), axis=0)

    def _lengths(self, states: States, own: Workspace, together: int, count: int) -> Array:
        """Return by what changes grow until each time, (times, count)."""
        steps, k = self._steps, self.count
        fastest = float(np.sqrt(np.square(states.velocity).sum(axis=1)).max()) or 1.0
        units = np.repeat([1.0, fastest], [3, steps.rows - 3])  # rad/s of a change that counts as 1 rad
        arrays, at = side_by_side(state=(steps.rows, LANES), weights=(6,), metric=(6, 6), normal=(steps.rows,))
        arrays["state"][:, :k], arrays["weights"][:] = units[:, None] * steps.in_frame(self._first), 1 / units[:6] ** 2
        B = np.eye(3) if steps.frame is None else steps.frame
        T = np.array([[(B @ dN @ B.T)[e] for dN in BASIS] for e in ENTRIES])  # to entries in the body
        arrays["metric"][:] = T.T @ T / fastest**2
        arrays["normal"][3:6] = fastest * (steps.axis if steps.frame is None else steps.axis @ steps.frame)
        lengths, done = np.empty((count, k)), 0
        for chunk in self._chunks or steps.chunks():
            steps.run(grow(steps.rows), own, chunk, states, grown=k, together=together, lengths=lengths[done:], **at)
            done += -(-(chunk.last - chunk.first) // together)
        return lengths
