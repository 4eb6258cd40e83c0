"""The numbers of traced texts: doubles, one or several side by side (lanes), whole numbers and masks.

Their operators write LLVM code (`machine_code`). Every function here takes plain floats as well, and computes; where it
makes sense also arrays, complex numbers and numbers of more digits. Operations are those of IEEE 754, lane by lane,
nothing reordered, nothing contracted: floats, one body and bodies in lanes have the same bits.
"""

from __future__ import annotations

import ctypes
import math
import operator
import os
import struct
from collections.abc import Callable
from functools import cache, lru_cache
from typing import Any, ClassVar

import numpy as np

from . import machine_code
from .machine_code import TraceError, tracer, writer

# What operators are in LLVM. An order of doubles is false where there is no number.
ORDERS = ("lt", "le", "gt", "ge", "eq", "ne")
OF_DOUBLES = {"add": "fadd", "sub": "fsub", "mul": "fmul", "truediv": "fdiv"}
OF_DOUBLES |= {name: f"fcmp {'u' if name == 'ne' else 'o'}{name}" for name in ORDERS}
OF_WHOLES = {"add": "add", "sub": "sub", "mul": "mul"}
OF_WHOLES |= {name: f"icmp {name if name in ('eq', 'ne') else f's{name}'}" for name in ORDERS}
OF_MASKS = {"and": "and", "or": "or", "xor": "xor"}
OF_LLVM = ("sqrt", "floor", "ceil", "rint", "trunc", "copysign", "fabs", "fma")  # other functions are of C
LITERALS: dict[str, Callable[[Any], str]] = {
    "i1": lambda x: "true" if x else "false",
    "i64": lambda x: str(int(x)),
    "double": lambda x: f"0x{int.from_bytes(struct.pack('>d', x)):016X}",
}


@lru_cache
def llvm_type(scalar: str, n: int) -> str:
    """Return the type of n lanes of a type."""
    return scalar if n == 1 else f"<{n} x {scalar}>"


class Number:
    """What has the operators of a number: `combined` says what they give."""

    __slots__ = ()
    __hash__ = None  # type: ignore[assignment]

    def combined(self, name: str, a: Any, b: Any) -> Any:
        """Return what the operator of this name gives; NotImplemented for what is no number."""
        raise NotImplementedError

    def __pos__(self) -> Any:
        return self

    conjugate = __pos__


class Traced(Number):
    """A value that is known when the code runs.

    Attributes
    ----------
    n : int
        Lanes.
    scalar, words, plain : str, str, tuple of type
        What it is in LLVM, in words, and in Python.
    lines : dict
        What its operators are in LLVM.
    """

    __slots__ = ("home", "n", "name")
    scalar, words = "", ""
    plain: ClassVar[tuple[type, ...]] = ()
    lines: ClassVar[dict[str, str]] = {}

    def __init__(self, name: str, n: int = 1) -> None:
        self.name, self.n, self.home = name, n, writer().region

    @property
    def kind(self) -> str:
        """Its type in LLVM."""
        return llvm_type(self.scalar, self.n)

    @classmethod
    def takes(cls, x: Any) -> bool:
        """Whether x is such a value, without a change of type."""
        return isinstance(x, (cls, *cls.plain))

    @classmethod
    def named(cls, x: Any, n: int = 1) -> str:
        """Return the name or the literal of x as such a value with n lanes."""
        if type(x) is cls:
            return x.used(n)
        if not cls.takes(x):
            raise TraceError(f"{type(x).__name__} is not a {cls.words}")
        if isinstance(x, Traced):
            return str(real(x).used(n))
        one = LITERALS[cls.scalar](x)
        return one if n == 1 else "<" + ", ".join([f"{cls.scalar} {one}"] * n) + ">"

    def used(self, n: int = 1) -> str:
        """Return its name with n lanes; refuse one that was made in a region that is closed."""
        if self.home.is_closed:
            what = f"a number that was made within the {self.home.kind} at {self.home.where} is used outside of it"
            raise TraceError(f"{what}: keep it in Variables")
        if self.n == n:
            return self.name
        if self.n != 1:
            raise TraceError(f"{self.n} lanes meet {n}")
        t, kind = writer(), llvm_type(self.scalar, n)
        first = t.value(f"insertelement {kind} undef, {self.scalar} {self.name}, i32 0")
        return t.value(f"shufflevector {kind} {first}, {kind} undef, <{n} x i32> zeroinitializer")

    def combined(self, name: str, a: Any, b: Any) -> Any:
        """Return what an operator gives, of other kinds as of doubles."""
        line = self.lines.get(name)
        if line is not None and (type(a) is type(b) or name in OF_MASKS or (self.takes(a) and self.takes(b))):
            return written(line, type(self), a, b)
        if not (is_number(a) and is_number(b)):
            return NotImplemented
        return BY_FUNCTIONS.get(name, getattr(operator, name))(real(a), real(b))

    def __repr__(self) -> str:
        if tracer() is None:
            return object.__repr__(self)
        raise TraceError(writer().converting)

    def __bool__(self) -> bool:
        raise TraceError(writer().branching)

    def __float__(self) -> float:
        raise TraceError(writer().converting)

    __int__ = __index__ = __float__


class Mask(Traced):
    """A truth value, or one for each lane."""

    __slots__ = ()
    scalar, words, plain, lines = "i1", "mask: compare numbers", (bool, np.bool_), OF_MASKS

    def combined(self, name: str, a: Any, b: Any) -> Any:
        """Return what an operator gives: the product of two is a mask, as in NumPy."""
        if type(a) is type(b) and name in ("add", "mul"):
            if name == "add":
                raise TraceError(
                    "the sum of two conditions is one in NumPy, and 2 in Python: use np.logical_or, or 1.0 *"
                )
            return a & b
        return super().combined(name, a, b)

    def __invert__(self) -> Any:
        return written("xor", Mask, self, True)


class Whole(Traced):
    """A whole number of 64 bits: a count, a place, an address."""

    __slots__ = ()
    scalar, words, plain, lines = "i64", "whole number", (int, np.integer), OF_WHOLES


class Element(Traced):
    """A double, or a vector of doubles, one for each lane."""

    __slots__ = ()
    scalar, words, plain, lines = "double", "number here", (float,), OF_DOUBLES

    @classmethod
    def takes(cls, x: Any) -> bool:
        """Whether x stands for one number, or one a lane."""
        return is_number(x)

    def __neg__(self) -> Element:
        return written("fneg", Element, self)

    def __abs__(self) -> Element:
        return call_function("fabs", self)


def _give_operators(to: type[Number], names: tuple[str, ...]) -> None:
    for name in names:
        setattr(to, f"__{name}__", lambda own, other, name=name: own.combined(name, own, other))
        if name not in ORDERS:
            setattr(to, f"__r{name}__", lambda own, other, name=name: own.combined(name, other, own))


_give_operators(Number, (*OF_DOUBLES, "pow", "mod", "floordiv"))
_give_operators(Mask, tuple(OF_MASKS))


def is_number(x: Any) -> bool:
    """Whether x stands for one number, or one a lane, in arithmetic with elements."""
    return isinstance(x, (Traced, float, int, np.number)) and not isinstance(x, (bool, complex))


def real(x: Any) -> Any:
    """Return a number of any kind as a double."""
    if isinstance(x, Whole):
        return Element(writer().value(f"sitofp i64 {x.used()} to double"))
    if isinstance(x, Mask):
        return select(x, 1.0, 0.0)
    return x if isinstance(x, Element) else float(x)


def written(op: str, kind: type[Traced], *args: Any) -> Any:
    """Write an operation of LLVM on values of one kind, lane by lane; comparisons give masks."""
    n = max([getattr(a, "n", 1) for a in args])
    names = [kind.named(a, n) for a in args]
    if op in ("fadd", "fmul"):  # in one order, so that a line and its mirror image are one
        names.sort()
    made = Mask if "cmp" in op else kind
    return made(writer().value(f"{op} {llvm_type(kind.scalar, n)} {', '.join(names)}"), n)


def call_function(name: str, *args: Any) -> Element:
    """Call a function of LLVM lane by lane, or one of the C library for each lane."""
    t, n = writer(), max(getattr(a, "n", 1) for a in args)
    kind, is_of_llvm = llvm_type("double", n), name in OF_LLVM
    if not is_of_llvm and (own := t.in_place_of(name)) is not None:
        return own(*args)
    names = [Element.named(a, n) for a in args]
    if n > 1 and not is_of_llvm:
        all_lanes, vectors = "undef", [Element(x, n) for x in names]
        for l in range(n):
            one = call_function(name, *(lanes_of(x, l, 1) for x in vectors))
            all_lanes = t.value(f"insertelement {kind} {all_lanes}, double {one.name}, i32 {l}")
        return Element(all_lanes, n)
    full = f"llvm.{name}.{'' if n == 1 else f'v{n}'}f64" if is_of_llvm else name
    effects = "" if is_of_llvm else " nounwind willreturn memory(none)"
    t.declare(f"{kind} @{full}({', '.join([kind] * len(args))}){effects}")
    return Element(t.value(f"call {kind} @{full}({', '.join(f'{kind} {x}' for x in names)})"), n)


TINY = 1e-140  # beside it roots at 0 have tangents 0 where those of their arguments are, and stay finite


def _derivatives() -> dict[str, Callable[..., Any]]:
    """Return operators and functions, by NumPy's names: their derivatives, given their arguments and their value."""
    return {
        "add": lambda a, b, _: (1.0, 1.0),
        "sub": lambda a, b, _: (1.0, -1.0),
        "mul": lambda a, b, _: (b, a),
        "sqrt": lambda x, y: 0.5 / (y + TINY),
        "sin": lambda x, y: cos(x),
        "cos": lambda x, y: -sin(x),
        "tan": lambda x, y: 1.0 + y * y,
        "exp": lambda x, y: y,
        "log": lambda x, y: 1.0 / x,
        "sinh": lambda x, y: cosh(x),
        "cosh": lambda x, y: sinh(x),
        "tanh": lambda x, y: 1.0 - y * y,
        "arcsin": lambda x, y: 1.0 / sqrt(1.0 - x * x),
        "arccos": lambda x, y: -1.0 / sqrt(1.0 - x * x),
        "arctan": lambda x, y: 1.0 / (1.0 + x * x),
        "arctan2": lambda y, x, _: (x * (over := 1.0 / (x * x + y * y)), -y * over),
        "copysign": lambda a, b, _: (select((a < 0.0) ^ (b < 0.0), -1.0, 1.0), 0.0),
        "fmod": lambda a, b, r: (1.0, -(a - r) / b),
        "power": lambda x, k, y: (k * y / x, y * log(x)),
        "floor": lambda x, y: 0.0,
        "hypot": lambda a, b, y: (a / (y + TINY), b / (y + TINY)),
        "arccosh": lambda x, y: 1.0 / sqrt(x * x - 1.0),
        "arcsinh": lambda x, y: 1.0 / sqrt(x * x + 1.0),
        "arctanh": lambda x, y: 1.0 / (1.0 - x * x),
        "cbrt": lambda x, y: 1.0 / (3.0 * y * y),
        "exp2": lambda x, y: math.log(2.0) * y,
        "expm1": lambda x, y: y + 1.0,
        "log10": lambda x, y: 1.0 / (math.log(10.0) * x),
        "log1p": lambda x, y: 1.0 / (1.0 + x),
        "log2": lambda x, y: 1.0 / (math.log(2.0) * x),
        **dict.fromkeys(("ceil", "rint", "trunc"), lambda x, y: 0.0),
    }


SLOPES = _derivatives()
IN_C = {"arctan2": "atan2", "power": "pow"}


def _function(name: str, slopes: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function that NumPy has under a name; its arrays of numbers call it by that name, as a method."""
    in_c, of_arrays = IN_C.get(name, name.replace("arc", "a")), getattr(np, name)
    of_floats: Callable[..., float] = getattr(math, in_c, of_arrays)

    def function(*x: Any) -> Any:
        dual = dual_of(*x)
        if dual is not None:
            return dual.through(function, slopes, x)
        if any(isinstance(a, Traced) for a in x):
            return call_function(in_c, *x)
        if all(isinstance(a, (float, int)) for a in x):
            kind = type(x[0]) if isinstance(x[0], float) else float
            try:
                return kind(of_floats(*x))
            except (OverflowError, ValueError):  # outside its domain: what IEEE says
                with np.errstate(all="ignore"):
                    return kind(of_arrays(*map(float, x)))
        of_more_digits = getattr(x[0], "context", None)  # mpmath
        return of_arrays(*x) if of_more_digits is None else getattr(of_more_digits, in_c)(*x)

    function.__name__ = function.__qualname__ = name
    setattr(Number, name, function)
    return function


FUNCTIONS = {name: _function(name, slopes) for name, slopes in SLOPES.items() if name not in OF_DOUBLES}
sqrt, sin, cos, tan, exp, log, sinh, cosh, tanh, arcsin, arccos, arctan, *_others = FUNCTIONS.values()
arctan2, copysign, fmod, _raised, floor, *_ = _others


def power(x: Any, k: Any) -> Any:
    """Return x to a power: of a whole one that is known products."""
    if isinstance(k, Number):
        return _raised(x, k)
    if isinstance(k, float) and k == int(k):
        k = int(k)
    if isinstance(k, int):
        if k < 0:
            return 1.0 / power(x, -k)
        if k < 2:
            return x if k else 0.0 * x + 1.0
        half = power(x, k // 2)
        return half * half * x if k % 2 else half * half
    return sqrt(x) if k == 0.5 else exp(k * log(x))


def remainder(a: Any, b: Any) -> Any:
    """Return the remainder of a over b with the sign of b, as Python's ``a % b``."""
    r = fmod(a, b)
    return select((r != 0.0) & ((r < 0.0) ^ (b < 0.0)), r + b, r)


def whole_quotient(a: Any, b: Any) -> Any:
    """Return the quotient rounded down, as Python's ``a // b``."""
    return floor((a - remainder(a, b)) / b + 0.5)


BY_FUNCTIONS: dict[str, Callable[[Any, Any], Any]] = {"pow": power, "mod": remainder, "floordiv": whole_quotient}


class Derived(Number):
    """A number with derivatives (`dual.Dual`)."""

    __slots__ = ()


def dual_of(*args: Any) -> Any:
    """Return the first number with derivatives among some, None where there is none."""
    for x in args:
        if isinstance(x, Derived):
            return x
    return None


def fma(a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once where the processor can; of tuples b and c entry by entry."""
    if isinstance(b, tuple):
        return mapped(lambda x, y: fma(a, x, y), b, c)
    dual = None if any(getattr(x, "is_series", False) for x in (a, b, c)) else dual_of(a, b, c)
    if dual is not None:
        return dual.through(lambda c, a, b: fma(a, b, c), lambda c, a, b, _: (1.0, b, a), (c, a, b))
    if any(isinstance(x, Element) for x in (a, b, c)) and all(map(is_number, (a, b, c))):
        return call_function("fma", a, b, c) if writer().is_fused else a * b + c
    if not all(isinstance(x, (float, int)) for x in (a, b, c)) or not machine_code.is_fused():
        return a * b + c
    return np.float64(_fma_of_floats()(a, b, c))


@cache
def _fma_of_floats() -> Callable[..., float]:
    """Return that of the C library."""
    function = ctypes.CDLL("ucrtbase" if os.name == "nt" else None).fma
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double] * 3
    return function


def select(mask: Any, a: Any, b: Any) -> Any:
    """Return a where the mask is set, else b: of numbers, and of tuples and records of them."""
    if isinstance(mask, (bool, np.bool_)):
        found = a if mask else b
        return np.float64(found) if type(found) is float else found  # which divides by 0 as IEEE does
    if isinstance(a, tuple):
        return mapped(lambda x, y: select(mask, x, y), a, b)
    if a is b or a is None:
        return a
    dual = dual_of(a, b)
    if dual is not None:
        return dual.selected(mask, a, b)
    if not isinstance(mask, Mask):
        return np.where(mask, a, b)
    n = max(x.n for x in (mask, a, b) if isinstance(x, Traced))
    kind = next(kind for kind in (Mask, Whole, Element) if kind.takes(a) and kind.takes(b))
    values = ", ".join(f"{llvm_type(kind.scalar, n)} {kind.named(x, n)}" for x in (a, b))
    return kind(writer().value(f"select {mask.kind} {mask.used(mask.n)}, {values}"), n)


def remade(like: Any, parts: Any) -> Any:
    """Return a tuple of the type of another one."""
    return like._make(parts) if hasattr(like, "_make") else tuple(parts)


def mapped(function: Callable[..., Any], x: Any, *others: Any) -> Any:
    """Return a function of numbers; of tuples and records entry by entry."""
    if isinstance(x, tuple):
        return remade(x, [mapped(function, *each) for each in zip(x, *others, strict=True)])
    return function(x, *others)


def larger(a: Any, b: Any) -> Any:
    """Return a where it is larger, else b."""
    return select(a > b, a, b)


def smaller(a: Any, b: Any) -> Any:
    """Return a where it is smaller, else b."""
    return select(a < b, a, b)


def logical_not(mask: Any) -> Any:
    """Return the mask that is set where another is not."""
    return ~mask if isinstance(mask, Mask) else np.logical_not(mask)


def without(a: Any, b: Any) -> Any:
    """Return the mask that is set where a is and b is not."""
    return a & logical_not(b)


def any_of(mask: Any) -> Any:
    """Whether a mask is set in any lane."""
    if not isinstance(mask, Mask):
        return bool(np.any(mask))
    if mask.n == 1:
        return mask
    bits = writer().value(f"bitcast {mask.kind} {mask.used(mask.n)} to i{mask.n}")
    return Mask(writer().value(f"icmp ne i{mask.n} {bits}, 0"))


def all_lanes(join: Callable[[Any, Any], Any], x: Any) -> Any:
    """Return what comes of joining the halves of the lanes, until one is left: the sum of all, or the largest."""
    if tracer() is None or x.n == 1:
        return x
    half = x.n // 2
    return all_lanes(join, join(lanes_of(x, 0, half), lanes_of(x, half, half)))


def lanes_of(x: Any, first: int, count: int) -> Any:
    """Return some of the lanes of a number."""
    order = ", ".join(f"i32 {first + k}" for k in range(count))
    line = f"shufflevector {x.kind} {x.used(x.n)}, {x.kind} undef, <{count} x i32> <{order}>"
    return Element(writer().value(line if count > 1 else f"extractelement {x.kind} {x.used(x.n)}, {order}"), count)
