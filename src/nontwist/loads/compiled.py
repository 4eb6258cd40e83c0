"""Compiled functions of the state: traced, as C functions of one signature, so that no kernel is compiled again.

A C function is ``void (t, directors, angular_velocity, found)``, of a moment, of forces on the directors or, of γ in
place of the directors, of a potential and its gradient. What a function finds beside its arguments is fixed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import prod
from threading import RLock
from typing import Any, NamedTuple
from weakref import WeakValueDictionary

from ..kernels import machine_code
from ..kernels.dual import plain, seeded, tangent
from ..kernels.elements import Element
from ..kernels.memory import Pointer, call, scratch
from ..kernels.numpy_functions import array_of
from ..kernels.tracing import tracing
from ..kernels.user_functions import UserTracer, traced
from .c_functions import Moment, address_of

ENTRY, ARGUMENTS = "load", "double %t, ptr %directors, ptr %velocity, ptr %found"
OF_STATE = 9, 3  # numbers of directors and velocity
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
    """A function of a user as a text.

    Attributes
    ----------
    text : function
        Of lists of numbers.
    counts : tuple of int
        How many numbers there are in memory: of directors and velocity, behind which the time stands; of γ, and none.
    """

    text: Callable[..., list[Any]]
    counts: tuple[int, int]

    @property
    def compiled(self) -> MachineFunction:
        """The C function that writes the numbers that it gives; a ValueError where it cannot be traced."""
        return _made(lambda *given: self.text(*self._numbers(*given)))

    @property
    def slopes(self) -> MachineFunction:
        """The C function that writes these with their derivatives by each argument, row by row."""

        def text(*given: Any) -> list[Any]:
            x = seeded(self._numbers(*given))
            return [y for z in self.text(*x) for y in (plain(z), *(tangent(z, j) for j in range(len(x))))]

        return _made(text)

    def _numbers(self, t: Any, first: Pointer, second: Pointer) -> tuple[Any, ...]:
        """Return all arguments: the time is the last one of a function of the state."""
        state = tuple(
            memory[k] for memory, count in zip((first, second), self.counts, strict=True) for k in range(count)
        )
        return (*state, t) if self.counts[1] else state


def moment_of(function: Callable[..., Any], name: str) -> Traceable:
    """Return the function of a load of this name."""
    return Traceable(lambda *x: traced(function, _state(x), (3,), name), OF_STATE)


def forces_of(function: Callable[..., Any], is_body: bool) -> Traceable:
    """Return forces on the directors, given along them or not, as 9 numbers in space."""
    name = getattr(function, "__name__", repr(function))

    def forces(*x: Any) -> list[Any]:
        rows = traced(function, _state(x), (3, 3), name)
        if not is_body:
            return rows
        return [sum((rows[3 * i + j] * x[3 * j + c] for j in range(3)), 0.0) for i in range(3) for c in range(3)]

    return Traceable(forces, OF_STATE)


def potential_of(potential: Callable[..., Any], gradient: Callable[..., Any], shape: tuple[int, ...]) -> Traceable:
    """Return a potential and its gradient, one behind the other, as a function of γ."""
    value_name, slope_name = (getattr(f, "__name__", repr(f)) for f in (potential, gradient))

    def both(*x: Any) -> list[Any]:
        value = traced(potential, (array_of([*x]).reshape(shape),), (), value_name)
        return value + traced(gradient, (array_of([*x]).reshape(shape),), shape, slope_name)

    return Traceable(both, (prod(shape), 0))


def _state(x: tuple[Any, ...]) -> tuple[Any, ...]:
    return x[12], array_of([*x[:9]]).reshape(3, 3), array_of([*x[9:12]])


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
