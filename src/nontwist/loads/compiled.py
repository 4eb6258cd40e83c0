"""Compiled moments: functions of the state as C functions of one signature, so that no kernel is compiled again.

Within such a C function each part of a load is a compiled function of the time and of pointers to directors, angular
velocity and to room for three numbers, which returns the moment. Nothing allocates memory.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from ..geometry.compiled import announced, numba, numba_or_none, part
from ..geometry.elements import call_moment, shifted, sixteen
from .c_functions import CFunction

Parts = tuple[tuple[Callable[..., Any], float], ...]


def compiled_moment(function: Callable[..., Any], name: str) -> Callable[..., Any]:
    """Return the function of a load of this name as a part of a load; a C function as it is.

    It returns NaN where `function` raises or returns another number of values than 3.

    Raises
    ------
    ValueError
        Numba cannot compile `function`; with the reason.
    ImportError
        Numba is not installed.
    """
    if isinstance(function, CFunction):
        return function
    with announced(f"compiling the load {name}"):
        return _compiled(function, name)


@lru_cache
def _frame() -> tuple[Any, Any]:
    """Return what is done before a function is called and after: compiled once, for all of them."""
    carray = numba().carray

    def copies(own, directors, w):  # type: ignore[no-untyped-def]
        for k in range(9):  # a function may write to its arguments
            own[k] = directors[k]
        for k in range(3):
            own[9 + k] = w[k]
        return carray(own, (3, 3)), carray(shifted(own, 9), (3,))

    def numbers(m):  # type: ignore[no-untyped-def]
        x, y, z = m
        return float(x), float(y), float(z)

    return part(copies, forceinline=True), part(numbers, forceinline=True)


def _compiled(function: Callable[..., Any], name: str) -> Callable[..., Any]:
    (copies, numbers), nan, inner = _frame(), float("nan"), _inlined(function)

    def moment(t, directors, w, room):  # type: ignore[no-untyped-def]
        d, v = copies(sixteen(), directors, w)
        try:
            return numbers(inner(t, d, v))
        except Exception:
            return nan, nan, nan

    compiled: Callable[..., Any] = part(moment, forceinline=True)
    _require_compilable(lambda: c_function(((compiled, 1.0),)), name)
    return compiled


def is_compilable(parts: Parts) -> bool:
    """Whether `c_function` makes a C function of these parts: it needs Numba for all but a C function as it is."""
    return (len(parts) == 1 and parts[0][1] == 1 and isinstance(parts[0][0], CFunction)) or numba_or_none() is not None


@lru_cache(maxsize=256)
def c_function(parts: Parts) -> Any:
    """Return the sum of parts times their factors as a C function; the same parts give the same one."""
    total, factor = parts[0]
    if len(parts) == 1 and factor == 1 and isinstance(total, CFunction):
        return total
    types: Any = numba().types
    cfunc = numba().cfunc
    (total, factor), *others = [(_part(f) if isinstance(f, CFunction) else f, scale) for f, scale in parts]
    for other, scale in others:
        total = part(_sum(total, factor, other, scale))
        factor = 1.0
    pointer = types.CPointer(types.f8)

    def moment(t, d, w, out):  # type: ignore[no-untyped-def]
        m = total(t, d, w, out)
        out[0], out[1], out[2] = factor * m[0], factor * m[1], factor * m[2]

    return cfunc(types.void(types.f8, pointer, pointer, pointer), error_model="numpy")(moment)


def _sum(f: Callable[..., Any], a: float, g: Callable[..., Any], b: float) -> Callable[..., Any]:
    def both(t, directors, w, room):  # type: ignore[no-untyped-def]
        x, y = f(t, directors, w, room), g(t, directors, w, room)
        return a * x[0] + b * y[0], a * x[1] + b * y[1], a * x[2] + b * y[2]

    return both


def _part(function: CFunction) -> Callable[..., Any]:
    address = function.address

    def moment(t, directors, w, room):  # type: ignore[no-untyped-def]
        call_moment(address, t, directors, w, room)
        return room[0], room[1], room[2]

    compiled: Callable[..., Any] = part(moment)
    return compiled


def compiled_forces(function: Callable[..., Any], is_body: bool) -> Callable[..., Any]:
    """Return forces on the directors, given along them or not, as a part of a load that writes 9 numbers in space.

    Raises
    ------
    ValueError, ImportError
        As `compiled_moment`.
    """
    name = getattr(function, "__name__", repr(function))
    with announced(f"compiling the load {name}"):
        (copies, numbers), nan, inner = _frame(), float("nan"), _inlined(function)

        def forces(t, directors, w, out):  # type: ignore[no-untyped-def]
            d, v = copies(sixteen(), directors, w)
            try:
                f0, f1, f2 = inner(t, d, v)
                rows = (numbers(f0), numbers(f1), numbers(f2))
            except Exception:
                rows = ((nan, nan, nan), (nan, nan, nan), (nan, nan, nan))
            for i in range(3):
                f = rows[i]
                for x in range(3):
                    if is_body:
                        out[3 * i + x] = f[0] * directors[x] + f[1] * directors[3 + x] + f[2] * directors[6 + x]
                    else:
                        out[3 * i + x] = f[x]

        compiled: Callable[..., Any] = part(forces)
        _require_compilable(lambda: forces_c_function(((compiled, 1.0),)), name)
    return compiled


@lru_cache(maxsize=256)
def forces_c_function(parts: Parts) -> Any:
    """Return the sum of forces on the directors times their factors as a C function; 9 numbers follow its arguments."""
    types: Any = numba().types
    cfunc = numba().cfunc
    (total, factor), *others = parts
    for other, scale in others:
        total, factor = part(_sum_of_forces(total, factor, other, scale)), 1.0
    pointer = types.CPointer(types.f8)

    def forces(t, d, w, out):  # type: ignore[no-untyped-def]
        total(t, d, w, out)
        for k in range(9):
            out[k] = factor * out[k]

    return cfunc(types.void(types.f8, pointer, pointer, pointer), error_model="numpy")(forces)


def _sum_of_forces(f: Callable[..., Any], a: float, g: Callable[..., Any], b: float) -> Callable[..., Any]:
    def both(t, directors, w, out):  # type: ignore[no-untyped-def]
        room = sixteen()
        f(t, directors, w, room)
        g(t, directors, w, out)
        for k in range(9):
            out[k] = a * room[k] + b * out[k]

    return both


@lru_cache(maxsize=256)
def compiled_potential(potential: Callable[..., Any], gradient: Callable[..., Any], shape: tuple[int, ...]) -> Any:
    """Return a potential and its gradient as a C function of γ that writes both, one behind the other.

    Raises
    ------
    ValueError, ImportError
        As `compiled_moment`.
    """
    name = getattr(potential, "__name__", repr(potential))
    with announced(f"compiling the potential {name}"):
        carray, nan, value, slope = numba().carray, float("nan"), _inlined(potential), _inlined(gradient)
        count = int(np.prod(shape))
        is_single = len(shape) == 1
        types: Any = numba().types
        pointer = types.CPointer(types.f8)

        def both(t, gamma, _, out):  # type: ignore[no-untyped-def]
            own = sixteen()
            for k in range(count):
                own[k] = gamma[k]
            g = carray(own, shape)
            try:
                out[0] = float(value(g))
                for k in range(count):
                    own[k] = gamma[k]
                found = slope(g)
                for k in range(count):
                    out[1 + k] = float(found[k]) if is_single else float(found[k // 3][k % 3])
            except Exception:
                for k in range(count + 1):
                    out[k] = nan

        made: list[Any] = []
        signature = types.void(types.f8, pointer, pointer, pointer)
        _require_compilable(lambda: made.append(numba().cfunc(signature, error_model="numpy")(both)), name)
    return made[0]


def _inlined(function: Callable[..., Any]) -> Any:
    """Return a function of a caller as compiled code takes it."""
    numba()
    from numba.core.dispatcher import Dispatcher

    return function if isinstance(function, Dispatcher) else part(function, forceinline=True)


def _require_compilable(make: Callable[[], Any], name: str) -> None:
    try:
        make()
    except Exception as error:  # not all are NumbaErrors: AttributeError of np.nosuch, UnsupportedBytecodeError
        raise ValueError(f"the load {name} cannot be compiled: {_reason(str(error))}") from error


def _reason(report: str) -> str:
    """Return what is wrong, and the line of the caller, of a report of Numba: the innermost failure comes first."""
    lines = [line.strip() for line in report.splitlines()]
    said = [line for line in lines if line and not line.startswith("Failed in ")]
    if not said:
        return report
    reason = f"{said[0]} {said[1].removeprefix('>>> ')}" if said[0].endswith(":") and len(said) > 1 else said[0]
    places = (re.fullmatch(r"During: .* at (.+) \((\d+)\)", line) for line in lines)
    place = next((found for found in places if found and found[1] != __file__), None)
    if place:
        return f"{reason} ({place[1]}, line {place[2]})"
    count = re.fullmatch(r"\('wrong tuple length for m: ', 'expected 3, got (\d+)'\)", reason)  # `numbers` in `_frame`
    return f"it returns {count[1]} values; return the three components of the moment" if count else reason
