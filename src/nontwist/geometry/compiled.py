"""The one way in which this package compiles a kernel."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])


def kernel(function: Function) -> Function:
    """Compile `function` with Numba, keeping the machine code on disk where a directory for it can be written.

    Plain loops and scalars only, no exceptions inside: a kernel returns a status. Division by zero gives
    infinities as in NumPy. The interpreter lock is released while it runs.
    """
    try:
        return cast(Function, njit(cache=True, nogil=True, error_model="numpy")(function))
    except RuntimeError:  # Numba has found no directory that it may write to
        return cast(Function, njit(nogil=True, error_model="numpy")(function))
