"""Functions that a user wrote in Python with NumPy, as texts: the same code, with other meanings of names.

What a function finds under a name, global, built in or in a closure, is fixed when it is traced. NumPy and `math` are
then functions of traced numbers, those in Python are traced like the function itself, lists and arrays cannot be
changed, nor what objects hold. What would be lost without a word is refused: what is kept between calls, printed,
random, or rounded to another type, and exceptions that are caught.

NumPy's own arrays hold any objects, and most of its functions work on them by the operators of the entries. Here are
the others: functions of one or two numbers, comparisons, and those that branch on what they are given.
"""

from __future__ import annotations

import builtins
import dis
import math
import numbers as numbers_of_python
import sys
from collections import deque
from collections.abc import Callable
from enum import Enum
from functools import cache, lru_cache, partial, reduce, wraps
from itertools import pairwise
from pathlib import Path
from traceback import walk_tb
from types import BuiltinFunctionType, CellType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any, NoReturn

import numpy as np

from . import elements
from .control import Variables, whilst
from .dual import Dual
from .elements import Mask, Number, Traced, Whole, real, remade, select
from .machine_code import TraceError, Tracer, is_text, tracing, writer
from .memory import doubles


class Numbers(np.ndarray[Any, Any]):
    """An array of numbers, traced ones among them, of dtype object."""

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, out: Any = (), **options: Any) -> Any:
        if ufunc.__name__.startswith("logical"):
            options.pop("dtype", None)  # of truth values, as they are
        options, own = _without_types(options), _on_objects(ufunc)
        chosen = options.pop("where", True) if method == "__call__" and out else True
        if ufunc is np.add and method in ("reduce", "accumulate"):
            inputs = tuple(map(_counted, inputs))
        if method == "reduce" and options.get("axis", 0) is None and not options.get("keepdims"):
            inputs, options["axis"] = (inputs[0].ravel(),), 0  # the order of functions of ours is known
        if own is ufunc and "OO->?" in ufunc.types:
            options["dtype"] = object  # a comparison, which gives masks
        bare = [x.view(np.ndarray) if isinstance(x, Numbers) else x for x in inputs]
        found = numbers(getattr(own, method)(*bare, **options))
        if not out:
            return found
        out[0][...] = found if chosen is True else where(chosen, found, out[0])
        return out[0]

    def __array_function__(self, function: Any, types: Any, arguments: Any, options: Any) -> Any:
        if function in FUNCTIONS:
            return FUNCTIONS[function](*arguments, **options)
        return numbers(super().__array_function__(function, types, arguments, options))

    @property
    def dtype(self) -> Any:
        """Of doubles, which is what the user's code asks for; NumPy's own asks for that of objects."""
        is_of_user = is_text(sys._getframe(1).f_code.co_filename)
        return np.dtype(np.float64) if is_of_user else np.ndarray.dtype.__get__(self)

    def astype(self, dtype: Any, *_: Any, **__: Any) -> Any:
        """Return a copy; traced numbers are floats already."""
        _require_doubles(dtype)
        return self.copy()


def numbers(x: Any) -> Any:
    """Return arrays of objects, also in tuples and lists, as `Numbers`."""
    if type(x) is np.ndarray and x.dtype == object:
        return x.view(Numbers)
    return type(x)(map(numbers, x)) if type(x) in (tuple, list) else x


def array_of(entries: Any) -> Any:
    """Return an array of numbers."""
    return numbers(np.array(entries, dtype=object))


def is_traced(x: Any) -> bool:
    """Whether a number, or one within an array, a tuple or a list, is traced."""
    if isinstance(x, np.ndarray):
        return x.dtype == object and is_traced(x.ravel().tolist())
    return any(map(is_traced, x)) if isinstance(x, (tuple, list)) else isinstance(x, (Traced, Dual))


def _without_types(options: dict[str, Any]) -> dict[str, Any]:
    _require_doubles(options.get("dtype"))
    known = {name: x for name, x in options.items() if name not in ("dtype", "casting", "order", "subok")}
    return {name: x for name, x in known.items() if name != "where" or x is not True}


def _require_doubles(dtype: Any) -> None:
    if np.dtype(dtype) not in (np.float64, np.dtype(object)):
        raise TraceError(f"traced numbers cannot become {np.dtype(dtype)}")


def _counted(x: Any) -> Any:
    """Return an array with numbers in the place of masks."""
    return np.frompyfunc(lambda y: real(y) if isinstance(y, Mask) else y, 1, 1)(x)


# ---- functions of one or two numbers


def _truth(x: Any) -> Any:
    return x if isinstance(x, (Mask, bool, np.bool_)) else x != 0.0


def _maximum(a: Any, b: Any) -> Any:
    return select((a >= b) | (a != a), a, b)


def _minimum(a: Any, b: Any) -> Any:
    return select((a <= b) | (a != a), a, b)


TRACED: dict[str, Callable[..., Any]] = {
    **elements.FUNCTIONS,
    "clip": lambda x, low, high: _minimum(_maximum(x, low), high),
    "float_power": elements.power,
    "fmax": lambda a, b: select((a >= b) | (b != b), a, b),
    "fmin": lambda a, b: select((a <= b) | (b != b), a, b),
    "heaviside": lambda x, half: select(x > 0.0, 1.0, select(x < 0.0, 0.0, select(x == 0.0, half, x))),
    "isfinite": lambda x: abs(x) < math.inf,
    "isinf": lambda x: abs(x) == math.inf,
    "isnan": lambda x: x != x,
    "logical_and": lambda a, b: _truth(a) & _truth(b),
    "logical_not": lambda x: ~_truth(x),
    "logical_or": lambda a, b: _truth(a) | _truth(b),
    "logical_xor": lambda a, b: _truth(a) ^ _truth(b),
    "maximum": _maximum,
    "minimum": _minimum,
    "power": lambda x, k: x**k,
    "sign": lambda x: select(x > 0.0, 1.0, select(x < 0.0, -1.0, x)),
    "fabs": abs,
    **dict.fromkeys(("deg2rad", "radians"), lambda x: x * (math.pi / 180.0)),
    **dict.fromkeys(("rad2deg", "degrees"), lambda x: x * (180.0 / math.pi)),
}
IN_MATH = {name: elements.IN_C.get(name, name.replace("arc", "a")) for name in elements.FUNCTIONS}
IN_MATH |= {name: name for name in ("degrees", "fabs", "isfinite", "isinf", "isnan", "radians")}


@lru_cache
def _on_objects(ufunc: Any) -> Any:
    """Return what a function of NumPy is on arrays of objects."""
    traced = TRACED.get(ufunc.__name__)
    if traced is None:
        return ufunc
    plain = ufunc if ufunc.__name__ != "clip" else np.clip
    return np.frompyfunc(lambda *x: traced(*x) if is_traced(x) else plain(*x), ufunc.nin, ufunc.nout)


# ---- functions of arrays


def where(condition: Any, a: Any = None, b: Any = None) -> Any:
    """Return a where the condition holds, else b, entry by entry."""
    if a is None or b is None:
        raise TraceError("np.where takes three arguments here: np.where(condition, a, b)")
    return numbers(np.frompyfunc(lambda c, x, y: select(_truth(c), x, y), 3, 1)(condition, a, b))


def choose(conditions: Any, values: Any, default: Any = 0.0) -> Any:
    """Return the first of the values whose condition holds."""
    found = default
    for condition, value in reversed(list(zip(conditions, values, strict=True))):
        found = where(condition, value, found)
    return found


def norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    """Return the lengths of vectors, of a matrix the root of the sum of all squares."""
    if ord not in (None, 2, "fro") or (ord == 2 and axis is None and np.ndim(x) != 1):
        raise TraceError("np.linalg.norm takes no other `ord` here: write the norm by its formula")
    x = array_of(x)
    return np.sqrt(np.sum(x * x, axis=axis, keepdims=keepdims))


def interp(x: Any, known: Any, values: Any, left: Any = None, right: Any = None) -> Any:
    """Return values that are linear between known places: a table, which stays in memory."""
    if is_traced([known, values]):
        raise TraceError("the places and values of np.interp must be known")
    known, values = (np.array(a, dtype=np.float64) for a in (known, values))
    if known.ndim != 1 or known.shape != values.shape or not len(known):
        raise ValueError("np.interp takes as many places as values")
    if not (np.diff(known) >= 0.0).all():
        raise ValueError("the places of np.interp must not decrease")
    ends = [float(end if given is None else given) for given, end in ((left, values[0]), (right, values[-1]))]
    table = np.stack([known, values, np.append(np.diff(values) / np.diff(known), 0.0)], axis=1)
    memory = doubles(Whole(writer().table(table)))
    return numbers(np.frompyfunc(lambda y: _interpolated(y, memory, table, *ends), 1, 1)(x))


def _interpolated(x: Any, memory: Any, table: Any, left: float, right: float) -> Any:
    x, v = x + 0.0, Variables(first=0, last=len(table))
    for _ in whilst(lambda: v.last - v.first > 1):
        middle: Any = Whole(writer().value(f"lshr i64 {(v.first + v.last).used()}, 1"))
        is_behind = x >= memory[3 * middle]
        v.first, v.last = select(is_behind, middle, v.first), select(is_behind, v.last, middle)
    place, (first, last) = 3 * v.first, (table[0], table[-1])
    found = memory[place + 2] * (x - memory[place]) + memory[place + 1]
    found = select(x < first[0], left, select(x > last[0], right, found))
    return select(x == last[0], last[1], found)


FUNCTIONS: dict[Any, Callable[..., Any]] = {np.where: where, np.select: choose, np.linalg.norm: norm, np.interp: interp}
LIKE = ("zeros_like", "ones_like", "empty_like", "full_like")
FROM = ("array", "asarray", "asanyarray", "ascontiguousarray", "copy", "diag")
NEW = ("zeros", "ones", "empty", "full", "eye", "identity", "linspace", *LIKE, *FROM)


def traceable(function: Any) -> Callable[..., Any]:
    """Return a function of NumPy for traced numbers; arrays of floats that it makes can hold them."""
    name, is_of_entries = function.__name__, isinstance(getattr(function, "__self__", function), np.ufunc)

    def of_traced(*arguments: Any, **options: Any) -> Any:
        is_given = is_traced([*arguments, *options.values()])
        if is_given and function in FUNCTIONS:
            return FUNCTIONS[function](*arguments, **options)
        if is_of_entries or function is np.clip:
            arguments = tuple(array_of(x) if is_traced(x) else x for x in arguments)
        elif not is_given:
            arguments = tuple(map(_known, arguments))
        elif name in NEW:
            types = [a for a in arguments if isinstance(a, (type, np.dtype))]
            arguments = tuple(a for a in arguments if not isinstance(a, (type, np.dtype)))
            for dtype in types:
                _require_doubles(dtype)
            options = _without_types(options) | ({"dtype": object} if "array" in name else {})
        found = function(*arguments, **options)
        if name in NEW and isinstance(found, np.ndarray) and found.dtype == np.float64:
            found = (np.zeros_like(found) if "empty" in name else found).astype(object)
        return numbers(found)

    for method in ("reduce", "accumulate", "reduceat", "outer", "at"):
        if hasattr(function, method):
            setattr(of_traced, method, traceable(getattr(function, method)))
    return of_traced


def _known(x: Any) -> Any:
    """Return an array of objects that are all known as one of floats."""
    return np.array(x.tolist(), dtype=np.float64) if isinstance(x, Numbers) else x


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
            return Names(x, self) if x.__name__.split(".")[0] in ("numpy", "math") else x
        if isinstance(x, MethodType):
            return MethodType(self(x.__func__), self(x.__self__))
        if isinstance(x, partial):
            return partial(self(x.func), *map(self, x.args), **{name: self(y) for name, y in x.keywords.items()})
        if callable(x) and not isinstance(x, type) and (isinstance(x, np.ufunc) or _is_of_numpy(x)):
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


class Names:
    """A module for traced numbers."""

    def __init__(self, module: ModuleType, rebound: Rebound) -> None:
        self._module, self._rebound = module, rebound

    def __getattr__(self, name: str) -> Any:
        return self._rebound(getattr(self._module, name))


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


def _is_of_numpy(x: Any) -> bool:
    return (getattr(x, "__module__", None) or "").split(".")[0] == "numpy"


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
