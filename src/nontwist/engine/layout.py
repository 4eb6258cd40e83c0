"""Where numbers lie in memory: the places of a row's fields, what is put there, and arrays in one piece of memory."""

from __future__ import annotations

from collections import namedtuple
from itertools import accumulate, pairwise
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array

Spans = dict[str, tuple[slice, tuple[int, ...]]]


def layout(name: str, **sizes: int) -> Any:
    """Return the places, one attribute each, at which so many numbers begin one after the other, and their `size`."""
    make: Any = namedtuple
    return make(name, [*sizes, "size"])(0, *accumulate(sizes.values()))


def put(row: NDArray[np.int64], where: Any, **values: Any) -> None:
    """Write numbers, and addresses of arrays, to the places of these names; 0 for None."""
    for name, x in values.items():
        row[getattr(where, name)] = address_of(x) if x is None or isinstance(x, np.ndarray) else x


def address_of(array: NDArray[Any] | None) -> int:
    """Return the address of an array, 0 for None."""
    return 0 if array is None else array.__array_interface__["data"][0]


def side_by_side(**shapes: tuple[int, ...]) -> tuple[dict[str, Array], dict[str, int]]:
    """Return arrays of zeros that lie in one piece of memory, and their addresses; 0 for one without entries."""
    parts = spans(shapes)
    memory = np.zeros(max(part.stop for part, _ in parts.values()))
    base = address_of(memory)
    found = {name: base + 8 * part.start if part.stop > part.start else 0 for name, (part, _) in parts.items()}
    return views(memory, parts), found


def spans(shapes: dict[str, tuple[int, ...]]) -> Spans:
    """Return where arrays of these shapes lie in a slab."""
    ends = pairwise([0, *accumulate(map(prod, shapes.values()))])
    return {name: (slice(*end), shape) for (name, shape), end in zip(shapes.items(), ends, strict=True)}


def views(memory: Array, parts: Spans) -> dict[str, Array]:
    """Return the arrays of a slab in its memory, or in a copy of it."""
    return {name: memory[part].reshape(shape) for name, (part, shape) in parts.items()}
