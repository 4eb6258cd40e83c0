"""Compiled moments: functions of the state as C functions of one signature, so that no kernel is compiled again."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from ..geometry.compiled import numba
from ..geometry.elements import call_moment, doubles, shifted
from .c_functions import CFunction

Parts = tuple[tuple[Callable[..., Any], float], ...]


def compiled_moment(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a compiled function of one float and two tuples that calls `function`; a C function as it is.

    It returns NaN where `function` raises or returns another number of values than 3.

    Raises
    ------
    ValueError
        Numba cannot compile `function`; with the reason.
    """
    if isinstance(function, CFunction):
        return function
    from numba.core.dispatcher import Dispatcher
    from numba.core.errors import NumbaError

    njit = numba().njit
    inner = function if isinstance(function, Dispatcher) else njit(error_model="numpy")(function)
    nan = float("nan")

    def moment(t, directors, w):  # type: ignore[no-untyped-def]
        d, v = np.empty((3, 3)), np.empty(3)
        for i in range(3):
            v[i] = w[i]
            for j in range(3):
                d[i, j] = directors[3 * i + j]
        try:
            m = inner(t, d, v)
            if len(m) != 3:
                return nan, nan, nan
            return float(m[0]), float(m[1]), float(m[2])
        except Exception:
            return nan, nan, nan

    compiled = njit(error_model="numpy")(moment)
    try:
        c_function(((compiled, 1.0),))
    except NumbaError as error:
        name = getattr(function, "__name__", repr(function))
        raise ValueError(f"the load {name} cannot be compiled: {error}") from error
    result: Callable[..., Any] = compiled
    return result


@lru_cache(maxsize=256)
def c_function(parts: Parts) -> Any:
    """Return the sum of compiled functions times their factors as a C function; the same parts give the same one."""
    total, factor = parts[0]
    if len(parts) == 1 and factor == 1 and isinstance(total, CFunction):
        return total
    types: Any = numba().types
    cfunc, njit = numba().cfunc, numba().njit
    (total, factor), *others = [(_on_tuples(f) if isinstance(f, CFunction) else f, scale) for f, scale in parts]
    for other, scale in others:
        total = njit(error_model="numpy")(_sum(total, factor, other, scale))
        factor = 1.0
    pointer = types.CPointer(types.f8)

    def moment(t, d, w, out):  # type: ignore[no-untyped-def]
        m = total(t, (d[0], d[1], d[2], d[3], d[4], d[5], d[6], d[7], d[8]), (w[0], w[1], w[2]))
        out[0], out[1], out[2] = factor * m[0], factor * m[1], factor * m[2]

    return cfunc(types.void(types.f8, pointer, pointer, pointer), error_model="numpy")(moment)


def _sum(f: Callable[..., Any], a: float, g: Callable[..., Any], b: float) -> Callable[..., Any]:
    def both(t, directors, w):  # type: ignore[no-untyped-def]
        x, y = f(t, directors, w), g(t, directors, w)
        return a * x[0] + b * y[0], a * x[1] + b * y[1], a * x[2] + b * y[2]

    return both


def _on_tuples(function: CFunction) -> Callable[..., Any]:
    address = function.address

    def moment(t, directors, w):  # type: ignore[no-untyped-def]
        numbers = np.empty(15)
        for k in range(9):
            numbers[k] = directors[k]
        for k in range(3):
            numbers[9 + k] = w[k]
        start = doubles(numbers.ctypes.data)
        call_moment(address, t, start, shifted(start, 9), shifted(start, 12))
        return numbers[12], numbers[13], numbers[14]

    compiled: Callable[..., Any] = numba().njit(error_model="numpy")(moment)
    return compiled
