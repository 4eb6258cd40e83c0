"""Moments of the state as C functions: compiled ones by Numba, those in Python behind a callback."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from ..geometry.arrays import Array
from ..geometry.compiled import numba
from ..geometry.elements import Moment
from ..loads import Load
from ..loads.base import REMEDY

Parts = tuple[tuple[Callable[..., Any], float], ...]


class Called:
    """The terms of a load that are called while a run marches, as one C function.

    Attributes
    ----------
    address : int
        Of the function, 0 where there is nothing to call.
    error : exception or None
        What the last call of a function in Python raised.
    """

    def __init__(self, load: Load) -> None:
        self.load, self.address = load.called, 0
        self._function: Any = None
        self.error: BaseException | None = None
        if self.load.terms:
            compiled = self.load.is_compiled
            parts = tuple((term.compiled, term.scale) for term in self.load.terms) if compiled else ()
            self._function = c_function(parts) if compiled else Moment(self._call)
            self.address = self._function.address if compiled else _address(self._function)

    def _call(self, t: float, directors: Any, angular_velocity: Any, moment: Any) -> None:
        q, w = np.array(directors[:9]).reshape(3, 3), np.array(angular_velocity[:3])
        try:
            moment[0], moment[1], moment[2] = self.load.state_moment(t, q, w).tolist()
        except BaseException as error:  # it must not pass through the kernel
            self.error = error
            moment[0] = np.nan

    def reason(self, t: float, directors: Array, angular_velocity: Array) -> str:
        """Return why the function has failed: what Python says at the same state."""
        if self.error is None:
            try:
                self.load.state_moment(t, directors, angular_velocity)
            except ValueError as error:
                self.error = error
        return str(self.error or f"the load is not finite at t = {t:.12g} s; {REMEDY}")


def _address(function: Any) -> int:
    import ctypes

    return ctypes.cast(function, ctypes.c_void_p).value or 0


@lru_cache(maxsize=256)
def c_function(parts: Parts) -> Any:
    """Return the sum of compiled functions times their factors as a C function; the same parts give the same one."""
    types: Any = numba().types
    cfunc, njit = numba().cfunc, numba().njit
    total, factor = parts[0]
    for other, scale in parts[1:]:
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
