"""The one way in which this package compiles a kernel, and how the same text runs uncompiled.

A kernel consists of plain loops, scalars and tuples; it returns a status where others would raise. Kernels that call
each other live in one module, because the cache notices a change in the file of a kernel only.
"""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any, TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., object])


def kernel(function: Function) -> Function:
    """Compile `function` with Numba, keeping the machine code on disk where a directory for it can be written.

    Division by zero gives infinities as in NumPy. The interpreter lock is released while it runs.
    """
    return _compiled(function)


def inlined(function: Function) -> Function:
    """Compile `function` as `kernel` does, into the kernels that call it: no arguments are passed through memory."""
    return _compiled(function, forceinline=True)


def _compiled(function: Function, **options: Any) -> Function:
    from numba import njit

    try:
        return cast(Function, njit(cache=True, nogil=True, error_model="numpy", **options)(function))
    except RuntimeError:  # Numba has found no directory that it may write to
        return cast(Function, njit(nogil=True, error_model="numpy", **options)(function))


def interpreted(module: ModuleType) -> SimpleNamespace:
    """Return the functions of `module` with all of its kernels uncompiled, so that they can call Python functions."""
    names = {name: getattr(value, "py_func", value) for name, value in vars(module).items()}
    for name, value in names.items():
        if isinstance(value, FunctionType) and value.__module__ == module.__name__:
            names[name] = FunctionType(value.__code__, names, name, value.__defaults__, value.__closure__)
    return SimpleNamespace(**names)
