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
from ..kernels.control import loop
from ..kernels.dual import Dual, plain, tangent
from ..kernels.elements import Element
from ..kernels.kernel import Kernel
from ..kernels.memory import Doubles, Pointer, View, call, doubles, put, room
from ..kernels.numpy_functions import array_of
from ..kernels.tracing import tracing
from ..kernels.user_functions import UserTracer, traced
from ..kernels.vectors import Matrix, Vector
from .c_functions import CFunction, Moment, address_of

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


def compiled_moment(function: Callable[..., Any], name: str) -> Any:
    """Return the function of a load of this name as a C function; one of C as it is.

    Raises
    ------
    ValueError
        `function` cannot be traced; with the reason.
    """
    if isinstance(function, CFunction):
        return function
    return _made(lambda t, d, w: traced(function, (t, _array(d, (3, 3)), _array(w, (3,))), (3,), name))


class States(NamedTuple):
    """States at which a moment is differentiated."""

    states: int
    times: Doubles
    directors: Doubles  # (states, 9)
    velocities: Doubles  # (states, 3)
    found: Doubles  # (states, 3, 14): the moment, its derivatives by the directors, the velocity, the time


def compiled_slopes(function: Callable[..., Any], name: str) -> Kernel:
    """Return the kernel that evaluates and differentiates a moment at `States`.

    Raises
    ------
    ValueError
        As `compiled_moment`.
    """

    def text(address: Any) -> None:
        b = View(States, doubles(address))
        for i in loop(b.states):
            place = (b.directors, 9 * i, 9), (b.velocities, 3 * i, 3), (b.times, i, 1)
            given = [memory[first + k] for memory, first, count in place for k in range(count)]
            x = [Dual(y, [float(j == k) for j in range(13)]) for k, y in enumerate(given)]
            found = traced(function, (x[12], array_of(x[:9]).reshape(3, 3), array_of(x[9:12])), (3,), name)
            for c, y in enumerate(found):
                put(b.found, (plain(y), *(tangent(y, j) for j in range(13))), 14 * (3 * i + c))

    return UserKernel(text, "i8")


class UserKernel(Kernel):
    """A kernel of a function of a user."""

    tracer = UserTracer


def compiled_forces(function: Callable[..., Any], is_body: bool) -> Any:
    """Return forces on the directors, given along them or not, as a C function that writes 9 numbers in space.

    Raises
    ------
    ValueError
        As `compiled_moment`.
    """
    name = getattr(function, "__name__", repr(function))

    def forces(t: Any, d: Pointer, w: Pointer) -> list[Any]:
        directors = Matrix(*(Vector(*(d[3 * i + x] for x in range(3))) for i in range(3)))
        rows = traced(function, (t, _array(d, (3, 3)), _array(w, (3,))), (3, 3), name)
        if not is_body:
            return rows
        return [sum((rows[3 * i + j] * directors[j][x] for j in range(3)), 0.0) for i in range(3) for x in range(3)]

    return _made(forces)


def compiled_potential(potential: Callable[..., Any], gradient: Callable[..., Any], shape: tuple[int, ...]) -> Any:
    """Return a potential and its gradient as a C function of γ that writes both, one behind the other.

    Raises
    ------
    ValueError
        As `compiled_moment`.
    """
    value_name, slope_name = (getattr(f, "__name__", repr(f)) for f in (potential, gradient))

    def both(t: Any, gamma: Pointer, _: Any) -> list[Any]:
        value = traced(potential, (_array(gamma, shape),), (), value_name)
        return value + traced(gradient, (_array(gamma, shape),), shape, slope_name)

    return _made(both)


@lru_cache(maxsize=256)
def c_function(parts: Parts, count: int = 3) -> Any:
    """Return the sum of C functions of so many numbers times their factors; the same parts give the same one."""
    if len(parts) == 1 and parts[0][1] == 1:
        return parts[0][0]

    def total(t: Any, d: Pointer, w: Pointer) -> list[Any]:
        own, found = room(count), [0.0] * count
        for part, factor in parts:
            call(part.address, t, d, w, own)
            found = [factor * own[k] + found[k] for k in range(count)]
        return found

    return _made(total, tuple(part for part, _ in parts))


def _array(memory: Pointer, shape: tuple[int, ...]) -> Any:
    return array_of([memory[k] for k in range(prod(shape))]).reshape(shape)


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
