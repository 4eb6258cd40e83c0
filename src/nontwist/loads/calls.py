"""Functions that a user wrote, as they are called: with floats, checked; with numbers that have derivatives.

A text of a load calls them by one of these, or, while it is compiled, by `kernels.user_functions.traced`, so that it is
written once. Each takes a function, its arguments and the shape of what it gives, and returns the numbers row by row.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..geometry.arrays import as_floats
from ..kernels.user_functions import numbers

Call = Callable[[Callable[..., Any], tuple[Any, ...], tuple[int, ...]], list[Any]]
REMEDY = "let it return 3 finite numbers (N m) at every time and state, or try a smaller step"
OF_POTENTIALS = "let function return a finite number (J) and gradient its derivatives by γ (N m) for every γ"
GIVEN = {
    1: "the time",
    3: "the time, the directors and the angular velocity",
    4: "the time, the internal states, the directors and the angular velocity",
}


def array(x: Sequence[Any], *shape: int) -> Any:
    """Return a new array of numbers, of floats or of traced ones and those with derivatives."""
    return numbers(np.array(x)).reshape(shape or len(x))


def state(x: Sequence[Any]) -> tuple[Any, ...]:
    """Return time, directors and angular velocity from 13 numbers, the time behind the others."""
    return x[12], array(x[:9], 3, 3), array(x[9:12])


def plainly(function: Callable[..., Any], arguments: tuple[Any, ...], shape: tuple[int, ...]) -> list[Any]:
    """Call a function with numbers that have derivatives; an exception of any kind where it does not take them."""
    found = np.array(getattr(function, "py_func", function)(*arguments), dtype=object)
    if found.shape != shape:
        raise ValueError(f"it returned the shape {found.shape}")
    return found.ravel().tolist()


def differentiated(function: Callable[..., Any], arguments: tuple[Any, ...], shape: tuple[int, ...]) -> list[Any]:
    """Do as `plainly`; a ValueError where the function does not take numbers with derivatives."""
    try:
        return plainly(function, arguments, shape)
    except Exception as error:
        raise ValueError(
            f"{name_of(function)} cannot be differentiated: {error}; functions of NumPy take numbers with derivatives"
        ) from error


def checked(function: Callable[..., Any], arguments: tuple[Any, ...], shape: tuple[int, ...]) -> list[Any]:
    """Call a function with floats, and check what it returns.

    Raises
    ------
    ValueError
        It raised, or returned something else than finite numbers of the shape: where, and what to do.
    """
    function, is_of_time = getattr(function, "py_func", function), isinstance(arguments[0], float)
    name = "load" if is_of_time else "gradient" if shape else "potential"
    name = f"the {name} {getattr(function, '__name__', None) or repr(function)}"
    remedy = REMEDY if is_of_time else OF_POTENTIALS
    remedy = remedy.replace("3 finite", "3 rows of 3 finite") if shape == (3, 3) else remedy
    if is_of_time and not shape:
        remedy = remedy.replace("3 finite numbers", "a finite number")
    if is_of_time and len(shape) == 1 and shape != (3,):  # of internal states
        remedy = remedy.replace("3 finite numbers (N m)", f"as many finite numbers as state0, {shape[0]},")
    try:
        value = as_floats(function(*arguments), name)
    except Exception as error:
        if isinstance(error, TypeError) and not _takes(function, *arguments):
            remedy = f"it is called with {GIVEN[len(arguments)] if is_of_time else 'γ'}"
        raise ValueError(
            f"{name} raised {type(error).__name__} at {_place(arguments[0])}: {error}; {remedy}"
        ) from error
    if value.shape != shape:
        counted = {(): "a number", (3, 3): "3 rows of 3 numbers"}.get(shape) or f"{shape[0]} numbers"
        at = f"at {_place(arguments[0])} it returned shape {value.shape}"
        raise ValueError(f"{name} must return {counted}, {at}; {remedy}")
    if not np.isfinite(value).all():
        raise ValueError(f"{name} is not finite at {_place(arguments[0])}: {value.tolist()}; {remedy}")
    return value.ravel().tolist()


def _place(first: Any) -> str:
    return f"t = {first:.12g} s" if isinstance(first, float) else f"γ = {first.tolist()}"


def _takes(function: Callable[..., Any], *arguments: Any) -> bool:
    """Return whether a function can be called with these arguments, as far as its signature says."""
    try:
        inspect.signature(function).bind(*arguments)
    except TypeError:
        return False
    except ValueError:  # without a signature
        pass
    return True


def name_of(function: Callable[..., Any]) -> str:
    """Return what a function is called, its module first."""
    return f"{getattr(function, '__module__', '?')}.{getattr(function, '__qualname__', repr(function))}"
