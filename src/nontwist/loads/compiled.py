"""Compiled functions of the state: traced, as C functions of one signature, so that no kernel is compiled again.

A C function is ``void (t, directors, angular_velocity, found)``, of a moment, of forces on the directors or, of γ in
place of the directors, of a potential and its gradient. What a function finds beside its arguments is fixed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from threading import RLock
from typing import Any, NamedTuple
from weakref import WeakValueDictionary

from ..kernels import machine_code
from ..kernels.dual import plain, seeded, tangent
from ..kernels.elements import Element
from ..kernels.memory import Pointer, call, scratch
from ..kernels.tracing import tracing
from ..kernels.user_functions import UserTracer, traced
from .c_functions import Moment, address_of
from .terms import Term

ENTRY, ARGUMENTS = "load", "double %t, ptr %directors, ptr %velocity, ptr %found"
Parts = tuple[tuple[Any, float], ...]
_known: WeakValueDictionary[str, MachineFunction] = WeakValueDictionary()
_lock = RLock()


class MachineFunction:
    """A C function that was traced.

    Attributes
    ----------
    address : int
    """

    def __init__(self, code: str, owners: tuple[Any, ...]) -> None:
        self._function = machine_code.function_of(code, ENTRY, kind=Moment)
        self.address, self._owners = address_of(self._function), owners


class Traceable(NamedTuple):
    """The text of a term that is a function, as it is compiled."""

    term: Term

    @property
    def compiled(self) -> MachineFunction:
        """The C function that writes the numbers that it gives; a ValueError where it cannot be traced."""
        return _made(lambda *given: self.text(*self._numbers(*given)))

    @property
    def slopes(self) -> MachineFunction:
        """The C function that writes these with their derivatives, by each argument and number of the term."""

        def text(*given: Any) -> list[Any]:
            x = seeded((*self._numbers(*given), *self.term.numbers))
            return [y for z in self.text(*x) for y in (plain(z), *(tangent(z, j) for j in range(len(x))))]

        return _made(text)

    def text(self, *x: Any) -> list[Any]:
        """Return what the term gives for traced numbers."""
        return self.term.text(lambda function, given, shape: traced(function, given, shape, _name(function)), x)

    def _numbers(self, t: Any, first: Pointer, second: Pointer) -> tuple[Any, ...]:
        """Return all arguments: the time is the last one of a function of the state."""
        counts = self.term.counts
        state = tuple(memory[k] for memory, count in zip((first, second), counts, strict=True) for k in range(count))
        return (*state, t) if counts[1] else state


def _name(function: Any) -> str:
    """Return what a message calls a function: a text of a term by its class."""
    owner = getattr(function, "__self__", None)
    return type(owner).__name__ if isinstance(owner, Term) else getattr(function, "__name__", repr(function))


@lru_cache(maxsize=256)
def c_function(parts: Parts, count: int = 3) -> Any:
    """Return the sum of C functions of so many numbers times their factors; the same parts give the same one."""
    if len(parts) == 1 and parts[0][1] == 1:
        return parts[0][0]

    def total(t: Any, d: Pointer, w: Pointer) -> list[Any]:
        own, found = scratch(count), [0.0] * count
        for part, factor in parts:
            call(part.address, t, d, w, own)
            found = [factor * own[k] + found[k] for k in range(count)]
        return found

    return _made(total, tuple(part for part, _ in parts))


def _made(text: Callable[..., list[Any]], owners: tuple[Any, ...] = ()) -> MachineFunction:
    """Return the C function that writes the numbers that a text gives; the same code is compiled once."""
    t = UserTracer(1, machine_code.is_fused())
    with tracing(t):
        t.open(ENTRY, ARGUMENTS)
        found = text(Element("%t"), Pointer("%directors"), Pointer("%velocity"))
        for k, x in enumerate(found):
            Pointer("%found")[k] = x
        t.line("ret void")
        t.close()
    with _lock:
        made = _known.get(t.text)
        if made is None:
            made = _known[t.text] = MachineFunction(t.text, (*owners, *t.kept))
    return made
