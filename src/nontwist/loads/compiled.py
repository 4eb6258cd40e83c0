"""Compiled functions of the state: traced, as C functions of one signature, so that no kernel is compiled again.

A C function is ``void (t, directors, angular_velocity, found)``, of a moment, of forces on the directors or, of γ in
place of the directors, of a potential and its gradient. What a function finds beside its arguments is fixed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from threading import RLock
from typing import Any
from weakref import WeakValueDictionary

from ..kernels import machine_code
from ..kernels.dual import plain, seeded, tangent
from ..kernels.elements import Element
from ..kernels.memory import Pointer, call, scratch
from ..kernels.tracing import tracing
from ..kernels.user_functions import UserTracer, traced
from .c_functions import CFunction, Moment, address_of
from .memory import MOMENTS
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


def function_of(term: Term) -> Any:
    """Return the C function that writes what a term gives; a ValueError where its text cannot be traced."""
    own = term.called
    return own if isinstance(own, CFunction) else _made(lambda *given: _traced(term, _numbers(term, *given)))


def slopes_of(term: Term) -> MachineFunction | None:
    """Return what writes these with their derivatives, by each argument and number of the term; of C functions None."""

    def text(*given: Any) -> list[Any]:
        x = seeded((*_numbers(term, *given), *term.numbers))
        return [y for z in _traced(term, x) for y in (plain(z), *(tangent(z, j) for j in range(len(x))))]

    return None if isinstance(term.called, CFunction) else _made(text)


def _traced(term: Term, x: tuple[Any, ...]) -> list[Any]:
    return term.text(lambda function, given, shape: traced(function, given, shape, _name(function)), x)


def _numbers(term: Term, t: Any, first: Pointer, second: Pointer) -> tuple[Any, ...]:
    """Return all arguments: the time is the last one of a function of the state."""
    n, m = term.counts
    return (*(first[k] for k in range(n)), *(second[k] for k in range(m)), *[t][: bool(m)])


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


@lru_cache(maxsize=256)
def response_of(parts: tuple[tuple[Any, float, int], ...]) -> Any:
    """Return the C functions of terms with memory as one: moments times their factors, then z' of one and the other.

    `parts` are C functions, factors, and how many internal states each has.
    """

    def total(t: Any, state: Pointer, z: Pointer) -> list[Any]:
        moments, rates, first = [0.0] * MOMENTS, list[Any](), 0
        for part, factor, count in parts:
            own = scratch(MOMENTS + count)
            call(part.address, t, state, z.shifted(first), own)
            moments = [factor * own[k] + moments[k] for k in range(MOMENTS)]
            rates, first = rates + [own[MOMENTS + k] for k in range(count)], first + count
        return moments + rates

    return _made(total, tuple(part for part, *_ in parts))


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
