"""What a kernel is called with, declared as in ``"f8[:, :], i8 -> i8, f8"``.

Numbers are of 64 bits, floating or whole; arrays of them are contiguous, the last index running fastest. In machine
code every kernel is a C function of one address. Where its arguments are others, they and its results lie there, each
number in 8 bytes, each array as its address and its shape.
"""

from __future__ import annotations

import re
from struct import Struct
from typing import Any

import numpy as np

WORD = r"(f8|i8)(?:\[(:(?:, :)*)\])?"
LETTERS = {"f8": "d", "i8": "q"}
TYPES = {"f8": np.dtype(np.float64), "i8": np.dtype(np.int64)}
Place = tuple[str, int, int]


class Signature:
    """Arguments and results of a kernel, and where they lie.

    Attributes
    ----------
    is_address : bool
        Whether the only argument is an address, which is passed as it is.
    places, results : list of (kind, place in units of 8 bytes, number of axes)

    Raises
    ------
    ValueError
        Words that are none.
    """

    def __init__(self, words: str) -> None:
        inputs, _, outputs = words.partition(" -> ")
        self.is_address = words == "i8"
        self.places, end = _places(inputs, 0)
        self.results, self._size = _places(outputs, end)
        self._first = 8 * end
        self._in = Struct("=" + "".join("q" * (1 + axes) if axes else LETTERS[kind] for kind, _, axes in self.places))
        self._out = Struct("=" + "".join(LETTERS[kind] for kind, _, _ in self.results))

    def laid_out(self, arguments: tuple[Any, ...]) -> tuple[Any, list[tuple[Any, Any]]]:
        """Return the memory that a C function takes, and arrays that are not contiguous with copies that are.

        Raises
        ------
        TypeError
            An array of numbers of another kind, or with another number of axes.
        """
        numbers: list[Any] = []
        copies: list[tuple[Any, Any]] = []
        for (kind, _, axes), value in zip(self.places, arguments, strict=True):
            if not axes:
                numbers.append(value)
                continue
            if not (value.ndim == axes and value.dtype == TYPES[kind]):
                raise TypeError(f"a kernel takes an array of {kind} with {axes} axes")
            if not value.flags.c_contiguous:
                copies.append((value, value := value.copy(order="C")))
            numbers += value.__array_interface__["data"][0], *value.shape
        scratch: Any = np.empty(self._size, dtype=np.int64)
        self._in.pack_into(scratch, 0, *numbers)
        return scratch, copies

    def results_in(self, scratch: Any) -> Any:
        """Return the results that a C function has left in its memory, a number where it is one."""
        found = self._out.unpack_from(scratch, self._first)
        return found if len(found) > 1 else found[0] if found else None


def _places(words: str, place: int) -> tuple[list[Place], int]:
    """Return where the arguments that are declared lie, from a place on, and the place behind them."""
    found = []
    for word in re.split(r", (?!:)", words) if words else []:
        match = re.fullmatch(WORD, word)
        if match is None:
            raise ValueError(f"{word!r} is not what a kernel takes: write 'f8[:, :], i8 -> f8', for instance")
        found.append((match[1], place, (match[2] or "").count(":")))
        place += 1 + found[-1][2]
    return found, place
