"""The inputs of linearised steps, the nodes of the load in them, and what parameters do to these inputs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from .called_loads import Evaluated

# The inputs of a step, and how many numbers each has; those of `NODAL` at every node of the load. The rate of an orbit
# is an input where a step is seen from there (`orbiting`).
INPUTS = {"inertia": 6, "axis": 3, "dead": 9, "damping": 9, "step": 1, "spin": 1, "rate": 3, "orbit": 1}
NODAL = {"moving": 3, "space": 3, "rotor": 3}


class Entries(NamedTuple):
    """What parameters do to an input of steps: dinput[component] = value · dparameter, at a step, or at all of them."""

    name: str  # of the input
    component: NDArray[np.int64]
    parameter: NDArray[np.int64]
    value: Array
    step: NDArray[np.int64] | None = None  # None: at every step


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
    called: Evaluated | None = None  # what depends on the state there

    @property
    def of_nodes(self) -> NDArray[np.int64]:
        """The number of the step of each node."""
        return np.repeat(np.arange(self.first, self.last), len(self.middles))

    @property
    def places(self) -> NDArray[np.int64]:
        """Where the three numbers of each node begin among those of its step."""
        s = len(self.middles)
        return np.tile(3 * np.arange(s), self.last - self.first)
