"""Functions that a user wrote in Python with NumPy, as texts: the same code, with other meanings of names.

What a function finds under a name, global, built in or in a closure, is fixed when it is traced. NumPy and `math` are
then those of `numpy_functions`, functions in Python are traced like the function itself, lists and arrays cannot be
changed. What would be lost without a word is refused: what is kept between calls, printed, or random.
"""

from __future__ import annotations

import builtins
import dis
import math
from collections.abc import Callable
from functools import partial, reduce, wraps
from types import BuiltinFunctionType, CellType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from .dual import Dual
from .elements import Traced, real
from .numpy_functions import IN_MATH, applied, array_of, called, is_traced
from .tracing import TraceError, Tracer, is_text

MOST_LINES = 30_000
REMEDY = "np.where(condition, a, b), np.interp of a table, or compiled=False"
KEEPING = {"STORE_GLOBAL", "DELETE_GLOBAL", "STORE_ATTR", "DELETE_ATTR"}
UNKNOWN = ("random", "time", "secrets", "numpy.random", "threading", "os", "sys", "io")  # modules


class UserTracer(Tracer):
    """A module of LLVM in the making, of a function of a user."""

    branching = f"it branches (if, while, and, or, not) on the time or the state: use {REMEDY}"
    converting = f"it needs the time or the state as a plain number: use functions of NumPy and math, {REMEDY}"

    def value(self, text: str, is_pure: bool = True) -> str:
        """Write a line; refuse too many."""
        if self._count > MOST_LINES:
            raise TraceError(
                f"its loops are written out, which takes more than {MOST_LINES} operations: use a shorter formula, "
                "np.interp of a table, or compiled=False"
            )
        return super().value(text, is_pure)


class Rebound:
    """The names of functions that are traced, in one trace.

    Attributes
    ----------
    builtins : dict
        What is built in, of these functions alone.
    """

    def __init__(self) -> None:
        self._known: dict[int, tuple[Any, Any]] = {}
        self.builtins = vars(builtins) | BUILTINS | {"__import__": self._imported}

    def __call__(self, x: Any) -> Any:
        """Return what stands for a value while functions are traced."""
        if id(x) not in self._known:
            self._known[id(x)] = (x, self._made(x))  # x is kept, so that its number remains its own
        return self._known[id(x)][1]

    def _made(self, x: Any) -> Any:
        x = getattr(x, "py_func", x)  # compiled by Numba
        if isinstance(x, ModuleType):
            return self._module(x)
        if isinstance(x, FunctionType):
            return called(x) if _is_of(x, "numpy") else self._function(x)
        if isinstance(x, MethodType):
            return MethodType(self(x.__func__), x.__self__)
        if isinstance(x, partial):
            return partial(self(x.func), *x.args, **x.keywords)
        if isinstance(x, np.ufunc) or (callable(x) and not isinstance(x, type) and _is_of(type(x), "numpy")):
            return called(x)
        if isinstance(x, BuiltinFunctionType):
            return called(x) if _is_of(x, "numpy") else MATHS.get(x, x)
        if x is float or x is np.float64:
            return Float
        if type(x) in FROZEN:
            return FROZEN[type(x)](x)
        if isinstance(x, np.ndarray):
            x = x.copy()
            x.flags.writeable = False
        return x

    def _module(self, module: ModuleType) -> Any:
        name = module.__name__
        if name in UNKNOWN:
            return Unknown(name)
        return Names(module, self) if name.split(".")[0] in ("numpy", "math") else module

    def _imported(self, *about: Any) -> Any:
        return self(builtins.__import__(*about))

    def _function(self, f: FunctionType) -> Callable[..., Any]:
        made: list[Callable[..., Any]] = []

        @wraps(f)
        def traced(*arguments: Any, **options: Any) -> Any:
            if not made:
                made.append(self._copy(f))
            return made[0](*arguments, **options)

        return traced

    def _copy(self, f: FunctionType) -> Callable[..., Any]:
        """Return a function with the same code and other names."""
        if not is_text(f.__code__.co_filename):
            return f
        _require_no_memory(f.__code__)
        names = {n: f.__globals__[n] for n in _names(f.__code__) if n in f.__globals__}
        known = {n: self(x) for n, x in names.items()}
        known |= {"__builtins__": self.builtins, "__name__": f.__module__}
        cells = tuple(map(self._cell, f.__closure__ or ()))
        copy = FunctionType(f.__code__, known, f.__name__, f.__defaults__, cells)
        copy.__kwdefaults__ = f.__kwdefaults__
        return copy

    def _cell(self, cell: CellType) -> CellType:
        try:
            return CellType(self(cell.cell_contents))
        except ValueError:  # it is empty
            return cell


class Unknown:
    """A module whose functions give something else at each call."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        what = f"{self._name}.{name}"
        raise TraceError(f"{what} gives something else at each call, what is compiled does not: use compiled=False")


class Names:
    """NumPy or `math`, or a module of theirs, for traced numbers."""

    def __init__(self, module: ModuleType, rebound: Rebound) -> None:
        self._module, self._rebound = module, rebound

    def __getattr__(self, name: str) -> Any:
        return self._rebound(getattr(self._module, name))


def _is_of(x: Any, package: str) -> bool:
    return (getattr(x, "__module__", None) or "").split(".")[0] == package


def _names(code: CodeType) -> set[str]:
    inner = (_names(c) for c in code.co_consts if isinstance(c, CodeType))
    return set(code.co_names).union(*inner)


def _require_no_memory(code: CodeType) -> None:
    """Refuse what would be kept between calls."""
    for step in dis.get_instructions(code):
        is_outer = step.opname == "STORE_DEREF" and step.argval in code.co_freevars
        if step.opname in KEEPING or is_outer:
            line = getattr(step.positions, "lineno", None) or code.co_firstlineno
            why = f"{step.argval} is changed, but what is compiled keeps nothing between calls: use compiled=False"
            raise RefusedError(why, (code.co_filename, line))


class RefusedError(Exception):
    """Why a function cannot be traced, and where, if that is not where it was found."""

    def __init__(self, why: str, place: tuple[str, int] | None = None) -> None:
        super().__init__(why)
        self.why, self.place = why, place


# ---- what cannot be changed


def _fixed(kind: type, changes: str) -> type:
    """Return the kind of lists, or of dictionaries, whose methods of these names are refused."""

    def refused(self: Any, *_: Any) -> Any:
        raise TraceError(f"a {kind.__name__} outside the function is changed: use compiled=False")

    return type(kind.__name__, (kind,), dict.fromkeys(changes.split(), refused))


ITEMS = "__setitem__ __delitem__ clear pop"
FROZEN: dict[type, type] = {
    list: _fixed(list, f"{ITEMS} append extend insert remove reverse sort __iadd__ __imul__"),
    dict: _fixed(dict, f"{ITEMS} popitem setdefault update __ior__"),
    set: _fixed(set, "add clear discard pop remove update __iand__ __ior__ __isub__ __ixor__"),
}


# ---- built-in functions


class _Floats(type):
    def __instancecheck__(cls, x: Any) -> bool:
        return isinstance(x, (float, Traced, Dual))


class Float(float, metaclass=_Floats):
    """What `float` is: traced numbers are floats already."""

    def __new__(cls, x: Any = 0.0) -> Any:
        """Return the number as a float."""
        if isinstance(x, np.ndarray) and x.size == 1:
            x = x.item()
        return x if isinstance(x, Dual) else real(x)


def _largest(name: str, of_two: Any) -> Callable[..., Any]:
    plain = getattr(builtins, name)

    def function(*given: Any, **options: Any) -> Any:
        entries = list(given[0]) if len(given) == 1 else given
        if options or not is_traced(list(entries)):
            return plain(entries, **options)
        return reduce(partial(applied, of_two), entries)

    return function


def _refused(name: str) -> Callable[..., Any]:
    def function(*_: Any, **__: Any) -> Any:
        raise TraceError(f"{name}() happens when Python calls a function, not when machine code does: leave it out")

    return function


MATHS: dict[Any, Any] = {
    getattr(math, there): called(getattr(np, here)) for here, there in IN_MATH.items() if hasattr(math, there)
}
MATHS[math.hypot] = lambda *x: reduce(partial(applied, np.hypot), x)
BUILTINS: dict[str, Any] = {
    "max": _largest("max", np.maximum),
    "min": _largest("min", np.minimum),
    "float": Float,
    **{name: _refused(name) for name in ("print", "input", "open", "exec", "eval")},
}


# ---- tracing


def traced(function: Any, arguments: tuple[Any, ...], shape: tuple[int, ...], name: str) -> list[Any]:
    """Return the numbers that a function of a user gives, row by row, for traced ones and arrays of them.

    Raises
    ------
    ValueError
        It cannot be traced, or gives something of another shape: why, on which line, and what to write instead.
    """
    rebound, function = Rebound(), getattr(function, "py_func", function)
    try:
        if not isinstance(function, (FunctionType, MethodType, partial)):  # an instance that can be called
            function = function.__call__
        found = array_of(rebound(function)(*arguments))
        if found.shape != shape:
            rows = "three rows of three numbers" if shape == (3, 3) else "three numbers" if shape else "one number"
            raise RefusedError(f"it returns {_what(found)}; return {rows}")
        return [_number(x) for x in found.ravel().tolist()]
    except Exception as error:
        raise ValueError(f"the load {name} cannot be compiled: {_reason(error, rebound, function)}") from error


def _what(found: Any) -> str:
    if found.shape:
        return f"{len(found)} values" if found.ndim == 1 else f"the shape {found.shape}"
    return "one value" if isinstance(found.item(), (Traced, Dual, float, int)) else f"{type(found.item()).__name__}"


def _number(x: Any) -> Any:
    if isinstance(x, (complex, str, bytes)) or x is None:
        raise RefusedError(f"it returns {x!r}; return numbers")
    return Float(x)


def _reason(error: Exception, rebound: Rebound, function: Any) -> str:
    """Return what is wrong, and the line of the user."""
    code = getattr(function, "__code__", None)
    place = (code.co_filename, code.co_firstlineno) if code else None
    trace = error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_builtins is rebound.builtins:
            place = trace.tb_frame.f_code.co_filename, trace.tb_lineno
        trace = trace.tb_next
    if isinstance(error, (RefusedError, TraceError)):
        why, place = error.why, getattr(error, "place", None) or place
    elif isinstance(error, RecursionError):
        why = "it calls itself without end: use compiled=False"
    else:
        why = f"{type(error).__name__}: {error}"
        if not isinstance(error, (NameError, AttributeError)):
            why += "; functions of NumPy and math can be compiled, others need compiled=False"
    return why if place is None else f"{why} ({place[0]}, line {place[1]})"
