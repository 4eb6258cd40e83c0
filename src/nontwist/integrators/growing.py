"""How orthonormal changes of a state grow along runs: the steps linearised, and the growth of `engine.chained`."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from ..engine.chained import LANES, grow
from ..engine.chained import Growth as Block
from ..engine.known_steps import STEPS
from ..engine.layout import side_by_side
from ..geometry.arrays import Array
from ..geometry.attitudes import States
from ..geometry.tensors import BASIS, ENTRIES
from ..kernels.memory import view_of
from .linearised import Linearised, StepLoads, Workspace

TOGETHER = 32  # steps between two orthonormalisations


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
        self._pieces: list[StepLoads] | None = None

    def keep(self) -> Growth:
        """Keep what acts on the steps, for many runs, and return this."""
        self._pieces = list(self._acting())
        return self

    def _acting(self) -> Iterator[StepLoads]:
        steps = self._steps
        return (StepLoads(*piece, steps.sampled(steps.nodes(*piece))) for piece in steps.pieces(steps.part))

    @cached_property
    def times(self) -> Array:
        """The times at which changes are orthonormal again, s."""
        pieces = self._steps.pieces(self._steps.part)
        ends = [np.append(np.arange(first + TOGETHER, last, TOGETHER), last) for first, last in pieces]
        return self._steps.problem.times(np.concatenate(ends))

    def sums(self, states: States, own: Workspace) -> Array:
        """Return the logarithms of what changes have grown by until each of the times, (times, count).

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
        steps, k = self._steps, self.count
        fastest = float(np.sqrt(np.square(states.velocity).sum(axis=1)).max()) or 1.0
        units = np.repeat([1.0, fastest], [3, steps.rows - 3])  # rad/s of a change that counts as 1 rad
        arrays, at = side_by_side(state=(steps.rows, LANES), weights=(steps.rows,), normal=(steps.rows,))
        arrays["state"][:, :k], arrays["weights"][:] = units[:, None] * steps.turned(self._first), 1 / units**2
        arrays["normal"][3:6] = fastest * (steps.axis if steps.frame is None else steps.axis @ steps.frame)
        lengths, done, run = np.empty((len(self.times), k)), 0, grow(steps.rows)
        block = view_of(Block)
        block.width, block.stride, block.changes, block.every = steps.width, own.block[STEPS.stride], k, TOGETHER
        block.matrices = own.matrices
        for name, place in at.items():
            setattr(block, name, place)
        for loads in self._pieces or self._acting():
            steps.matrices(own, loads, states)
            if steps.rows > 6 and steps.frame is not None:  # changes of N count by its entries in the body
                turn_normals(own.matrices.reshape(steps.rows, steps.width, -1), steps.frame)
            block.steps, block.lengths = loads.last - loads.first, lengths[done:]
            run(block.address)
            done += -(-(loads.last - loads.first) // TOGETHER)
        return np.cumsum(np.log(lengths), axis=0)


def turn_normals(matrices: Array, B: Array) -> None:
    """Turn what matrices (rows, columns, steps) do to N, and by N, from the frame of the columns of B to the body."""
    T = np.stack([np.array([(B @ dN @ B.T)[e] for e in ENTRIES]) for dN in BASIS], axis=1)
    matrices[:, 6:12] = np.einsum("rck,cd->rdk", matrices[:, 6:12], np.linalg.inv(T))
    matrices[6:12] = np.einsum("dr,rck->dck", T, matrices[6:12])
