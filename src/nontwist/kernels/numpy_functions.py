"""NumPy's functions on traced numbers: arrays of them, and what NumPy and `math` are for texts that a user writes.

NumPy's own arrays hold any objects, and most of its functions work on them by the operators of the entries. Here are
the others: functions of one or two numbers, comparisons, and those that branch on what they are given.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from . import elements
from .control import Variables, whilst
from .dual import Dual
from .elements import Mask, Traced, Whole, select
from .memory import doubles
from .tracing import TraceError, writer


class Numbers(np.ndarray[Any, Any]):
    """An array of numbers, traced ones among them, of dtype object."""

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, out: Any = (), **options: Any) -> Any:
        options = _without_types(options)
        if method == "reduce" and options.get("axis", 0) is None and not options.get("keepdims"):
            inputs, options["axis"] = (inputs[0].ravel(),), 0  # the order of functions of ours is known
        found = getattr(_on_objects(ufunc), method)(*map(_bare, inputs), **options)
        if out:
            out[0][...] = found
            return out[0]
        return numbers(found)

    def __array_function__(self, function: Any, types: Any, arguments: Any, options: Any) -> Any:
        if function in FUNCTIONS:
            return FUNCTIONS[function](*arguments, **options)
        return numbers(super().__array_function__(function, types, arguments, options))

    def astype(self, dtype: Any, *_: Any, **__: Any) -> Any:
        """Return a copy; traced numbers are floats already."""
        if np.dtype(dtype).kind not in "fO":
            raise TraceError(f"traced numbers cannot become {np.dtype(dtype)}")
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
    if isinstance(x, (tuple, list)):
        return any(map(is_traced, x))
    if isinstance(x, np.ndarray):
        return x.dtype == object and any(map(is_traced, x.ravel().tolist()))
    return isinstance(x, (Traced, Dual))


def _bare(x: Any) -> Any:
    return x.view(np.ndarray) if isinstance(x, Numbers) else x


def _without_types(options: dict[str, Any]) -> dict[str, Any]:
    return {name: x for name, x in options.items() if name not in ("dtype", "casting", "order", "subok", "where")}


# ---- functions of one or two numbers


def _truth(x: Any) -> Any:
    return x if isinstance(x, (Mask, bool, np.bool_)) else x != 0.0


def _maximum(a: Any, b: Any) -> Any:
    return select((a >= b) | (a != a), a, b)


def _minimum(a: Any, b: Any) -> Any:
    return select((a <= b) | (a != a), a, b)


def _sign(x: Any) -> Any:
    return select(x > 0.0, 1.0, select(x < 0.0, -1.0, x))


def _clip(x: Any, low: Any = None, high: Any = None) -> Any:
    x = x if low is None else _maximum(x, low)
    return x if high is None else _minimum(x, high)


TRACED: dict[str, Callable[..., Any]] = {
    "bitwise_and": lambda a, b: a & b,
    "bitwise_or": lambda a, b: a | b,
    "clip": _clip,
    "float_power": elements.power,
    "floor_divide": elements.whole_quotient,
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
    "reciprocal": lambda x: 1.0 / x,
    "remainder": elements.remainder,
    "sign": _sign,
    "square": lambda x: x * x,
    **elements.FUNCTIONS,
    "power": lambda x, k: x**k,
    **dict.fromkeys(("absolute", "fabs"), abs),
    **dict.fromkeys(("deg2rad", "radians"), lambda x: x * (math.pi / 180.0)),
    **dict.fromkeys(("rad2deg", "degrees"), lambda x: x * (180.0 / math.pi)),
}
OPERATORS = {"less": "lt", "less_equal": "le", "greater": "gt", "greater_equal": "ge", "equal": "eq", "not_equal": "ne"}
IN_MATH = {name: elements.IN_C.get(name, name.replace("arc", "a")) for name in elements.FUNCTIONS}
IN_MATH |= {name: name for name in ("degrees", "fabs", "isfinite", "isinf", "isnan", "radians")}


@lru_cache
def _on_objects(ufunc: Any) -> Any:
    """Return what a function of NumPy is on arrays of objects."""
    if ufunc.__name__ in OPERATORS:
        return np.frompyfunc(getattr(operator, OPERATORS[ufunc.__name__]), 2, 1)
    traced = TRACED.get(ufunc.__name__)
    if traced is None:
        return ufunc
    plain = ufunc if ufunc.__name__ != "clip" else np.clip
    return np.frompyfunc(lambda *x: traced(*x) if any(map(is_traced, x)) else plain(*x), ufunc.nin, ufunc.nout)


def applied(ufunc: Any, *arguments: Any, **options: Any) -> Any:
    """Return what a function of NumPy gives for numbers, lists or arrays of them."""
    if not any(map(is_traced, arguments)):
        return ufunc(*arguments, **options)
    return numbers(_on_objects(ufunc)(*map(_bare, arguments), **_without_types(options)))


# ---- functions of arrays


def _each(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return a function of numbers, entry by entry."""
    return numbers(np.frompyfunc(function, len(arguments), 1)(*map(_bare, arguments)))


def where(condition: Any, a: Any = None, b: Any = None) -> Any:
    """Return a where the condition holds, else b, entry by entry."""
    if a is None or b is None:
        raise TraceError("np.where takes three arguments here: np.where(condition, a, b)")
    return _each(lambda c, x, y: select(_truth(c), x, y), condition, a, b)


def choose(conditions: Any, values: Any, default: Any = 0.0) -> Any:
    """Return the first of the values whose condition holds."""
    found = default
    for condition, value in reversed(list(zip(conditions, values, strict=True))):
        found = where(condition, value, found)
    return found


def clip(x: Any, low: Any = None, high: Any = None, **_: Any) -> Any:
    """Return x within bounds, entry by entry."""
    return _each(_clip, x, low, high)


def norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    """Return the lengths of vectors, of a matrix the root of the sum of all squares."""
    if ord not in (None, 2, "fro") or (ord == 2 and axis is None and np.ndim(x) != 1):
        raise TraceError("np.linalg.norm takes no other `ord` here: write the norm by its formula")
    x = array_of(x)
    return applied(np.sqrt, np.sum(x * x, axis=axis, keepdims=keepdims))


def interp(x: Any, known: Any, values: Any, left: Any = None, right: Any = None) -> Any:
    """Return values that are linear between known places: a table, which stays in memory."""
    if is_traced(known) or is_traced(values):
        raise TraceError("the places and values of np.interp must be known")
    known, values = (np.array(a, dtype=np.float64) for a in (known, values))
    if known.ndim != 1 or known.shape != values.shape or not len(known):
        raise ValueError("np.interp takes as many places as values")
    ends = [float(end if given is None else given) for given, end in ((left, values[0]), (right, values[-1]))]
    table = np.stack([known, values, np.append(np.diff(values) / np.diff(known), 0.0)], axis=1)
    writer().kept.append(table)
    return _each(lambda y: _interpolated(y, table, *ends), x)


def _interpolated(x: Any, table: Any, left: float, right: float) -> Any:
    if not isinstance(x, Dual):
        return _value_and_slope(x, table, left, right)[0]
    value, slope = _value_and_slope(x.value, table, left, right)
    return x.chain(value, (slope,), (x,))


def _value_and_slope(x: Any, table: Any, left: float, right: float) -> tuple[Any, Any]:
    x, memory, count = x + 0.0, doubles(Whole(str(table.ctypes.data))), len(table)
    v = Variables(first=0, last=count)
    for _ in whilst(lambda: v.last - v.first > 1):
        middle: Any = Whole(writer().value(f"lshr i64 {(v.first + v.last).used()}, 1"))
        is_behind = x >= memory[3 * middle]
        v.first, v.last = select(is_behind, middle, v.first), select(is_behind, v.last, middle)
    place, is_outside = 3 * v.first, (x < table[0, 0]) | (x > table[-1, 0])
    found = memory[place + 2] * (x - memory[place]) + memory[place + 1]
    found = select(x < table[0, 0], left, select(x > table[-1, 0], right, found))
    return select(x == table[-1, 0], table[-1, 1], found), select(is_outside, 0.0, memory[place + 2])


FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: where,
    np.select: choose,
    np.clip: clip,
    np.linalg.norm: norm,
    np.interp: interp,
}
LIKE = ("zeros_like", "ones_like", "empty_like", "full_like")
FROM = ("array", "asarray", "asanyarray", "ascontiguousarray", "copy", "diag")
NEW = ("zeros", "ones", "empty", "full", "eye", "identity", "linspace", *LIKE, *FROM)


def called(function: Any) -> Callable[..., Any]:
    """Return a function of NumPy for traced numbers; arrays of floats that it makes can hold them."""
    if isinstance(function, np.ufunc):
        return Ufunc(function)
    if function in FUNCTIONS:
        own = FUNCTIONS[function]
        return lambda *a, **o: own(*a, **o) if is_traced([*a, *o.values()]) else function(*a, **o)
    is_new = function.__name__ in NEW

    def of_traced(*arguments: Any, **options: Any) -> Any:
        if is_new and is_traced(arguments):
            options = _without_types(options)
            arguments = tuple(a for a in arguments if not isinstance(a, type))
            if "array" in function.__name__:
                options["dtype"] = object
        elif not is_traced(arguments):
            arguments = tuple(map(_known, arguments))
        found = function(*arguments, **options)
        if is_new and isinstance(found, np.ndarray) and found.dtype.kind == "f":
            found = (np.zeros_like(found) if "empty" in function.__name__ else found).astype(object)
        return numbers(found)

    return of_traced


def _known(x: Any) -> Any:
    """Return an array of objects that are all known as one of floats."""
    return np.array(x.tolist(), dtype=np.float64) if isinstance(x, Numbers) else x


class Ufunc:
    """A function of NumPy, entry by entry, with its methods."""

    def __init__(self, ufunc: Any) -> None:
        self._ufunc = ufunc

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Return its values."""
        return applied(self._ufunc, *arguments, **options)

    def __getattr__(self, name: str) -> Any:
        found = getattr(_on_objects(self._ufunc), name)
        return (lambda *a, **o: numbers(found(*map(_bare, a), **_without_types(o)))) if callable(found) else found
