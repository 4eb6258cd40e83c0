"""Functions that a user wrote in Python with NumPy, as texts: the same code, with other meanings of names.

What a function finds under a name, global, built in or in a closure, is fixed when it is traced. NumPy and `math` are
then functions of traced numbers (`numpy_texts`), those in Python are traced like the function itself, lists and arrays
cannot be changed, nor what objects hold. What would be lost without a word is refused: what is kept between calls,
printed, random, or rounded to another type, and exceptions that are caught.
"""

from __future__ import annotations

import builtins
import dis
import math
import numbers as numbers_of_python
from collections import deque
from collections.abc import Callable
from enum import Enum
from functools import cache, partial, reduce, wraps
from itertools import pairwise
from pathlib import Path
from traceback import walk_tb
from types import BuiltinFunctionType, CellType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any, NoReturn

import numpy as np

from .dual import Dual
from .elements import Number, Traced, real, remade, select
from .machine_code import TraceError, Tracer, is_text, tracing, writer
from .numpy_texts import IN_MATH, array_of, is_traced, traceable

MOST_LINES = 30_000
REMEDY = "np.where(condition, a, b), np.interp of a table, or compiled=False"
KEEPING = {"STORE_GLOBAL", "DELETE_GLOBAL"}
KEEPING_IN_OBJECTS = {"STORE_ATTR", "DELETE_ATTR"}
KEPT = "{} is changed, but what is compiled keeps nothing between calls: use compiled=False"
UNKNOWN = {"random", "_random", "secrets", "uuid", "time", "datetime", "logging"}  # modules
UNKNOWN |= {"threading", "os", "posix", "nt", "sys", "io", "_io"}


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
        self.builtins = vars(builtins) | BUILTINS | {"__import__": lambda *about: self(builtins.__import__(*about))}

    def __call__(self, x: Any) -> Any:
        """Return what stands for a value while functions are traced."""
        if id(x) not in self._known:
            self._known[id(x)] = (x, self._made(x))  # x is kept, so that its number remains its own
        return self._known[id(x)][1]

    def _made(self, x: Any) -> Any:
        x = getattr(x, "py_func", x)  # compiled by Numba
        if (unknown := _unknown(x)) is not None:
            return unknown
        if isinstance(x, ModuleType):
            return self._object(x) if x.__name__.split(".")[0] in ("numpy", "math") else x
        if isinstance(x, MethodType):
            return MethodType(self(x.__func__), self(x.__self__))
        if isinstance(x, partial):
            return partial(self(x.func), *map(self, x.args), **{name: self(y) for name, y in x.keywords.items()})
        is_of_numpy = isinstance(x, np.ufunc) or (getattr(x, "__module__", None) or "").split(".")[0] == "numpy"
        if callable(x) and not isinstance(x, type) and is_of_numpy:
            return self._object(x) if isinstance(type(x).__call__, FunctionType) else traceable(x)
        if isinstance(x, FunctionType):
            return self._function(x)
        if isinstance(x, BuiltinFunctionType):
            return MATHS.get(x, x)
        if x is float or x is np.float64:
            return Float
        if isinstance(x, dict):
            return FROZEN[dict]({name: self(y) for name, y in x.items()})
        if isinstance(x, (list, deque)):
            return FROZEN[list if isinstance(x, list) else deque](map(self, x))
        if isinstance(x, set):
            return FROZEN[set](x)
        if isinstance(x, tuple):
            return remade(x, map(self, x))
        if isinstance(x, np.ndarray):
            x = x.copy()
            x.flags.writeable = False
        return x if isinstance(x, (np.ndarray, type, Enum)) else self._object(x)

    def _object(self, x: Any) -> Any:
        """Return what stands for an object, whose attributes and methods are rebound when they are asked for."""
        kind = type(x)
        methods = [name for name in dir(kind) if isinstance(getattr(kind, name, None), FunctionType)]
        if not (methods or hasattr(x, "__dict__")):
            return x
        own: dict[str, Callable[..., Any]] = {
            name: lambda _, *arguments, name=name: getattr(x, name)(*arguments)
            for name in methods
            if name.startswith("__") and name not in ("__new__", "__init__", "__del__")
        }
        own |= {"__getattribute__": lambda _, name: self(getattr(x, name)), "__setattr__": _refused(KEPT.format("it"))}
        own["__call__"] = lambda _, *arguments, **options: self(x.__call__)(*arguments, **options)
        return object.__new__(type(kind.__name__, (), own))

    def _function(self, f: FunctionType) -> Callable[..., Any]:
        copied = cache(lambda: self._copy(f))
        return wraps(f)(lambda *arguments, **options: copied()(*arguments, **options))

    def _copy(self, f: FunctionType) -> Callable[..., Any]:
        """Return a function with the same code and other names."""
        if not is_text(f.__code__.co_filename):
            return f
        _require_no_memory(f.__code__)
        known = {n: self(f.__globals__[n]) for n in _names(f.__code__) if n in f.__globals__}
        known |= {"__builtins__": self.builtins, "__name__": f.__module__}
        cells = tuple(map(self._cell, f.__closure__ or ()))
        copy = FunctionType(f.__code__, known, f.__name__, tuple(map(self, f.__defaults__ or ())), cells)
        copy.__kwdefaults__ = {name: self(x) for name, x in (f.__kwdefaults__ or {}).items()}
        return copy

    def _cell(self, cell: CellType) -> CellType:
        try:
            return CellType(self(cell.cell_contents))
        except ValueError:  # it is empty
            return cell


class Unknown:
    """What gives something else at each call, or acts: it is refused when it is used."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        return Unknown(f"{self._name}.{name}")()

    def __call__(self, *_: Any, **__: Any) -> Any:
        """Refuse it."""
        raise TraceError(
            f"{self._name} gives something else at each call, what is compiled does not: use compiled=False"
        )

    __iter__ = __next__ = __enter__ = __call__


def _unknown(x: Any) -> Unknown | None:
    """Return what stands for a module of such, or for what is of one; None for anything else."""
    module, name = getattr(x, "__module__", None), getattr(x, "__name__", type(x).__name__)
    if isinstance(x, ModuleType):
        module = name
    elif module is None:  # a method, or an object
        owner = type(getattr(x, "__self__", x))
        module, name = owner.__module__, f"{owner.__module__}.{name}"
    else:
        name = f"{module}.{name}"
    is_of_one = module.split(".")[0] in UNKNOWN or module.startswith("numpy.random")
    return Unknown(name) if is_of_one or hasattr(type(x), "__next__") else None


def _names(code: CodeType) -> set[str]:
    inner = (_names(c) for c in code.co_consts if isinstance(c, CodeType))
    return set(code.co_names).union(*inner)


def _require_no_memory(code: CodeType, outer: tuple[str, ...] | None = None) -> None:
    """Refuse what would be kept between calls, and exceptions that are caught; in functions within it as well."""
    keeping, outer = (KEEPING | KEEPING_IN_OBJECTS, code.co_freevars) if outer is None else (KEEPING, outer)
    steps = list(dis.get_instructions(code))
    for step, following in pairwise(steps):
        line = getattr(following.positions, "lineno", None) or code.co_firstlineno
        if step.opname in keeping or (step.opname == "STORE_DEREF" and step.argval in outer):
            line = getattr(step.positions, "lineno", None) or code.co_firstlineno
            raise TraceError(KEPT.format(step.argval), (code.co_filename, line))
        if step.opname == "PUSH_EXC_INFO" and following.opname != "WITH_EXCEPT_START":
            why = "it catches exceptions, which what is compiled does not raise: use np.where, or compiled=False"
            raise TraceError(why, (code.co_filename, line))
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            _require_no_memory(inner, outer)


# ---- what is built in


def _refused(why: str) -> Callable[..., NoReturn]:
    def function(*_: Any, **__: Any) -> NoReturn:
        raise TraceError(why)

    return function


ITEMS = "__setitem__ __delitem__ clear pop"
CHANGES: dict[type, str] = {
    list: f"{ITEMS} append extend insert remove reverse sort __iadd__ __imul__",
    dict: f"{ITEMS} popitem setdefault update __ior__",
    set: "add clear discard pop remove update __iand__ __ior__ __isub__ __ixor__",
    deque: f"{ITEMS} append appendleft extend extendleft insert popleft remove reverse rotate __iadd__ __imul__",
}
FROZEN: dict[type, type] = {}  # what stands for containers outside of functions
for _kind, _changes in CHANGES.items():
    _refusal = _refused(f"a {_kind.__name__} outside the function is changed: use compiled=False")
    FROZEN[_kind] = type(_kind.__name__, (_kind,), dict.fromkeys(_changes.split(), _refusal))


class _Floats(type):
    def __instancecheck__(cls, x: Any) -> bool:
        return isinstance(x, (float, Traced, Dual))


class Float(float, metaclass=_Floats):
    """What `float` is: traced numbers are floats already."""

    dtype = np.dtype(np.float64)

    def __new__(cls, x: Any = 0.0) -> Any:
        """Return the number as a float."""
        if isinstance(x, np.ndarray) and x.size == 1:
            x = x.item()
        return x if isinstance(x, Dual) else real(x)


def _of_all(plain: Callable[..., Any], of_two: Callable[..., Any]) -> Callable[..., Any]:
    def function(*given: Any, **options: Any) -> Any:
        entries = list(given[0]) if len(given) == 1 else list(given)
        return plain(entries, **options) if options or not is_traced(entries) else reduce(of_two, entries)

    return function


def _type(x: Any, *others: Any) -> Any:
    return type(x, *others) if others else Float if isinstance(x, (Traced, Dual)) else x.__class__


_shared = {here: getattr(math, there) for here, there in IN_MATH.items() if hasattr(math, there)}
MATHS: dict[Any, Any] = {function: traceable(getattr(np, name)) for name, function in _shared.items()}
MATHS[math.hypot] = lambda *x: reduce(traceable(np.hypot), x)
MATHS[math.log] = lambda x, *base: traceable(np.log)(x) / (traceable(np.log)(*base) if base else 1.0)
BUILTINS: dict[str, Any] = {"float": Float, "type": _type}
BUILTINS["max"] = _of_all(max, lambda a, b: select(b > a, b, a))
BUILTINS["min"] = _of_all(min, lambda a, b: select(b < a, b, a))
NOT_COMPILED = "{}() happens when Python calls a function, not when machine code does: leave it out"
ACTING = ("print", "input", "open", "exec", "eval", "globals", "setattr", "delattr")
BUILTINS |= {name: _refused(NOT_COMPILED.format(name)) for name in ACTING}
MATHS |= {getattr(builtins, name): function for name, function in BUILTINS.items()}
numbers_of_python.Real.register(Number)


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
        code = getattr(function, "__code__", None)
        first = (code.co_filename, code.co_firstlineno) if code else None
        found = array_of(rebound(function)(*arguments))
        if writer().refusals:  # which it has caught
            raise writer().refusals[0]
        if found.shape != shape:
            known = {(3, 3): "three rows of three numbers", (3,): "three numbers", (): "one number"}
            rows = known.get(shape) or f"a list of {shape[0]} number{'s' * (shape[0] > 1)}"
            raise TraceError(f"it returns {_what(found)}; return {rows}", first)
        for x in found.ravel().tolist():
            if isinstance(x, (complex, str, bytes)) or x is None:
                raise TraceError(f"it returns {x!r}; return numbers", first)
        return [Float(x) for x in found.ravel().tolist()]
    except Exception as error:
        with tracing(None):
            reason = _reason(error, rebound, first)
        raise ValueError(f"the load {name} cannot be compiled: {reason}") from error


def _what(found: Any) -> str:
    if found.shape:
        return f"{len(found)} value{'s' * (len(found) != 1)}" if found.ndim == 1 else f"the shape {found.shape}"
    return "one value" if isinstance(found.item(), (Traced, Dual, float, int)) else f"{type(found.item()).__name__}"


LIBRARIES = (str(Path(dis.__file__).parent), "site-packages")


def _reason(error: Exception, rebound: Rebound, first: tuple[str, int] | None) -> str:
    """Return what is wrong, and the line of the user."""
    frames = ((f, line) for f, line in walk_tb(error.__traceback__) if f.f_builtins is rebound.builtins)
    places = [first, *((f.f_code.co_filename, line) for f, line in frames), getattr(error, "place", None)]
    own = [place for place in places if place and not any(folder in place[0] for folder in LIBRARIES)]
    place = own[-1] if own else first
    if isinstance(error, TraceError):
        why = error.why
    elif isinstance(error, RecursionError):
        why = "it calls itself without end: use compiled=False"
    else:
        why = f"{type(error).__name__}: {error}"
        if not isinstance(error, (NameError, AttributeError)):
            why += "; functions of NumPy and math can be compiled, others need compiled=False"
    return why if place is None else f"{why} ({place[0]}, line {place[1]})"
