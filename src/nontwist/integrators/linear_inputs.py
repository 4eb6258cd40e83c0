"""The inputs of linearised steps, the nodes of the load in them, and what parameters do to these inputs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array


class Entries(NamedTuple):
    """What parameters do to an input of steps: dinput[component] = value · dparameter, at a step, or at all of them."""

    name: str  # of the input
    component: NDArray[np.int64]
    parameter: NDArray[np.int64]
    value: Array
    step: NDArray[np.int64] | None = None  # None: at every step

    def turned(self, T: Array | None) -> Entries:
        """Return what they do to the input times a matrix, node by node; None: to the input itself."""
        if T is None:
            return self
        if not (T - T[0, 0] * np.eye(len(T))).any():
            return self._replace(value=T[0, 0] * self.value)
        places = self.component % len(T)
        rows, which = np.nonzero(T[:, places])
        step = None if self.step is None else self.step[which]
        component = self.component[which] - places[which] + rows
        return Entries(self.name, component, self.parameter[which], T[rows, places[which]] * self.value[which], step)

    def without_zeros(self) -> Entries:
        """Return the entries that are not 0."""
        which = np.flatnonzero(self.value)
        step = None if self.step is None else self.step[which]
        return Entries(self.name, self.component[which], self.parameter[which], self.value[which], step)


Sampled = Callable[["Nodes"], Iterable[Entries]]


class Nodes(NamedTuple):
    """Some steps and the nodes of the load in them."""

    first: int
    last: int
    begin: Array  # (steps,) times
    end: Array
    sizes: Array
    middles: Array  # (s,) fractions
    times: Array  # (steps · s,) of the nodes

    @property
    def of_nodes(self) -> NDArray[np.int64]:
        """The number of the step of each node."""
        return np.repeat(np.arange(self.first, self.last), len(self.middles))
