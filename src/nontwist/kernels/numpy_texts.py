"""NumPy for traced numbers: arrays that hold them, and its functions as texts.

NumPy's own arrays hold any objects, and most of its functions work on them by the operators of the entries. Here are
the others: functions of one or two numbers, comparisons, and those that branch on what they are given.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from . import elements
from .control import Variables, whilst
from .dual import Dual
from .elements import Mask, Traced, Whole, real, select
from .machine_code import TraceError, is_text, writer
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
