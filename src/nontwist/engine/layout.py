"""Where numbers lie in memory: the places of a row's fields, and arrays in one piece of memory."""

from __future__ import annotations

from collections import namedtuple
from itertools import accumulate
from math import prod
from typing import Any

import numpy as np

from ..geometry.arrays import Array


def layout(name: str, **sizes: int) -> Any:
    """Return the places, one attribute each, at which so many numbers begin one after the other, and their `size`."""
    make: Any = namedtuple
    return make(name, [*sizes, "size"])(0, *accumulate(sizes.values()))


def slab(**shapes: tuple[int, ...]) -> tuple[dict[str, Array], dict[str, int]]:
    """Return arrays of zeros that lie in one piece of memory, and their addresses; 0 for one without entries."""
    sizes = [prod(shape) for shape in shapes.values()]
    ends = [0, *accumulate(sizes)]
    memory = np.zeros(ends[-1])
    base, arrays, addresses = memory.ctypes.data, {}, {}
    for (name, shape), first, last in zip(shapes.items(), ends[:-1], ends[1:], strict=True):
        arrays[name] = memory[first:last].reshape(shape)
        addresses[name] = base + 8 * first if last > first else 0
    return arrays, addresses
