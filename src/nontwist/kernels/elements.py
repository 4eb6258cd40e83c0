"""The numbers of traced texts: doubles, one or several side by side (lanes), whole numbers and masks.

Their operators write LLVM code (`tracing`). Every function here takes plain floats as well, and computes; where it
makes sense also arrays, complex numbers and numbers of more digits. Operations are those of IEEE 754, lane by lane,
nothing reordered, nothing contracted: floats, one body and bodies in lanes have the same bits.
"""

from __future__ import annotations

import math
import operator
import struct
from collections.abc import Callable
from fractions import Fraction
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from .tracing import TraceError, tracer, writer

# What operators are in LLVM. An order of doubles is false where there is no number.
ORDERS = ("lt", "le", "gt", "ge", "eq", "ne")
OF_DOUBLES = {"add": "fadd", "sub": "fsub", "mul": "fmul", "truediv": "fdiv"}
OF_DOUBLES |= {name: f"fcmp {'u' if name == 'ne' else 'o'}{name}" for name in ORDERS}
OF_WHOLES = {"add": "add", "sub": "sub", "mul": "mul"}
OF_WHOLES |= {name: f"icmp {name if name in ('eq', 'ne') else f's{name}'}" for name in ORDERS}
OF_MASKS = {"and": "and", "or": "or", "xor": "xor"}


@lru_cache
def kind_of(scalar: str, n: int) -> str:
    """Return the type of n lanes of a type."""
    return scalar if n == 1 else f"<{n} x {scalar}>"


@lru_cache(maxsize=4096)
def literal(scalar: str, one: str, n: int) -> str:
    """Return n lanes of a number."""
    return one if n == 1 else "<" + ", ".join([f"{scalar} {one}"] * n) + ">"


class Number:
    """What has the operators of a number: `combined` says what they give."""

    __slots__ = ()
    __hash__ = None  # type: ignore[assignment]
    value: Any  # and derivatives, of `Dual`
    chain: Any

    def combined(self, name: str, a: Any, b: Any) -> Any:
        """Return what the operator of this name gives; NotImplemented for what is no number."""
        raise NotImplementedError

    def __pos__(self) -> Any:
        return self


def _operator(name: str, is_reflected: bool = False) -> Callable[[Any, Any], Any]:
    if is_reflected:
        return lambda own, other: own.combined(name, other, own)
    return lambda own, other: own.combined(name, own, other)


class Traced(Number):
    """A value that is known when the code runs.

    Attributes
    ----------
    n : int
        Lanes.
    """

    __slots__ = ("home", "n", "name")
    scalar = ""
    lines: ClassVar[dict[str, str]] = {}  # of LLVM, by the names of operators

    def __init__(self, name: str, n: int = 1) -> None:
        self.name, self.n, self.home = name, n, writer().region

    @property
    def kind(self) -> str:
        """Its type in LLVM."""
        return kind_of(self.scalar, self.n)

    @classmethod
    def named(cls, x: Any, n: int = 1) -> str:
        """Return the name or the literal of x as such a value with n lanes."""
        raise NotImplementedError

    @classmethod
    def takes(cls, x: Any) -> bool:
        """Whether x is such a value, without a change of type."""
        raise NotImplementedError

    def used(self, n: int = 1) -> str:
        """Return its name with n lanes; refuse one that was made in a region that is closed."""
        if self.home.is_closed:
            what = f"a number that was made within the {self.home.kind} at {self.home.where} is used outside of it"
            raise TraceError(f"{what}: keep it in Variables")
        if self.n == n:
            return self.name
        if self.n != 1:
            raise TraceError(f"{self.n} lanes meet {n}")
        t, kind = writer(), kind_of(self.scalar, n)
        first = t.value(f"insertelement {kind} undef, {self.scalar} {self.name}, i32 0")
        return t.value(f"shufflevector {kind} {first}, {kind} undef, <{n} x i32> zeroinitializer")

    def combined(self, name: str, a: Any, b: Any) -> Any:
        """Return what an operator gives, of other kinds as of doubles."""
        line = self.lines.get(name)
        if line is not None and (name in OF_MASKS or (self.takes(a) and self.takes(b))):
            return written(line, type(self), a, b)
        if not (is_number(a) and is_number(b)):
            return NotImplemented
        return BY_FUNCTIONS.get(name, getattr(operator, name))(real(a), real(b))

    def __bool__(self) -> bool:
        raise TraceError(writer().branching)

    def __float__(self) -> float:
        raise TraceError(writer().converting)

    __int__ = __index__ = __float__


class Mask(Traced):
    """A truth value, or one for each lane."""

    __slots__ = ()
    scalar, lines = "i1", OF_MASKS

    @classmethod
    def takes(cls, x: Any) -> bool:
        """Whether x is a truth value."""
        return isinstance(x, (Mask, bool, np.bool_))

    @classmethod
    def named(cls, x: Any, n: int = 1) -> str:
        """Return the name or the literal of a mask with n lanes."""
        if isinstance(x, Mask):
            return x.used(n)
        if not cls.takes(x):
            raise TraceError(f"{type(x).__name__} is not a mask: compare numbers")
        return literal("i1", "true" if x else "false", n)

    def __invert__(self) -> Any:
        return written("xor", Mask, self, True)


class Element(Traced):
    """A double, or a vector of doubles, one for each lane."""

    __slots__ = ()
    scalar, lines = "double", OF_DOUBLES

    @classmethod
    def takes(cls, x: Any) -> bool:
        """Whether x stands for one number, or one a lane."""
        return type(x) is Element or is_number(x)

    @classmethod
    def named(cls, x: Any, n: int = 1) -> str:
        """Return the name or the literal of a number with n lanes."""
        if isinstance(x, Traced):
            return str(real(x).used(n))
        if not is_number(x):
            raise TraceError(f"{type(x).__name__} is not a number here")
        return literal("double", f"0x{int.from_bytes(struct.pack('>d', x)):016X}", n)

    def __neg__(self) -> Element:
        return written("fneg", Element, self)

    def __abs__(self) -> Element:
        return intrinsic("fabs", self)


class Whole(Traced):
    """A whole number of 64 bits: a count, a place, an address."""

    __slots__ = ()
    scalar, lines = "i64", OF_WHOLES

    @classmethod
    def takes(cls, x: Any) -> bool:
        """Whether x is a whole number."""
        return isinstance(x, (Whole, int, np.integer))

    @classmethod
    def named(cls, x: Any, n: int = 1) -> str:
        """Return the name or the literal of a whole number."""
        if isinstance(x, Whole):
            return x.used(n)
        if not cls.takes(x):
            raise TraceError(f"{type(x).__name__} is not a whole number")
        return str(int(x))


for _name in (*OF_DOUBLES, "pow", "mod", "floordiv"):
    setattr(Number, f"__{_name}__", _operator(_name))
    if _name not in ORDERS:
        setattr(Number, f"__r{_name}__", _operator(_name, True))
for _name in OF_MASKS:
    setattr(Mask, f"__{_name}__", _operator(_name))
    setattr(Mask, f"__r{_name}__", _operator(_name, True))


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
    return made(writer().value(f"{op} {kind_of(kind.scalar, n)} {', '.join(names)}"), n)


def intrinsic(name: str, *args: Any) -> Element:
    """Call a function of LLVM, lane by lane."""
    t, n = writer(), max(getattr(a, "n", 1) for a in args)
    kind, full = kind_of("double", n), f"llvm.{name}.{'' if n == 1 else f'v{n}'}f64"
    t.declare(full, f"{kind} @{full}({', '.join([kind] * len(args))})")
    return Element(t.value(f"call {kind} @{full}({', '.join(f'{kind} {Element.named(a, n)}' for a in args)})"), n)


def c_function(name: str, *args: Any) -> Element:
    """Call a function of the C library for each lane."""
    t, n = writer(), max(getattr(a, "n", 1) for a in args)
    t.declare(name, f"double @{name}({', '.join(['double'] * len(args))}) nounwind willreturn memory(none)")
    names, found = [Element.named(a, n) for a in args], "undef"
    for l in range(n):
        own = names
        if n > 1:
            own = [t.value(f"extractelement {kind_of('double', n)} {x}, i32 {l}") for x in names]
        one = t.value(f"call double @{name}({', '.join(f'double {x}' for x in own)})")
        if n == 1:
            return Element(one)
        found = t.value(f"insertelement {kind_of('double', n)} {found}, double {one}, i32 {l}")
    return Element(found, n)


# Functions of one number. NumPy calls them by these names on arrays of numbers, as methods.

NAMES = "sqrt floor sin cos tan exp log sinh cosh tanh arcsin arccos arctan"
MORE_NAMES = "arcsinh arccosh arctanh cbrt ceil exp2 expm1 log10 log1p log2 rint trunc"
IN_LLVM = ("sqrt", "floor", "ceil", "rint", "trunc")


def _of_one(name: str) -> Callable[[Any], Any]:
    in_c, of_arrays = name.replace("arc", "a"), getattr(np, name)
    of_floats: Callable[[float], float] = getattr(math, in_c, of_arrays)

    def function(x: Any) -> Any:
        if isinstance(x, Traced):
            return intrinsic(in_c, real(x)) if name in IN_LLVM else c_function(in_c, real(x))
        if isinstance(x, Number):
            value = function(x.value)
            return x.chain(value, SLOPES[name](x.value, value))
        if isinstance(x, (float, int)):
            kind = type(x) if isinstance(x, float) else float
            try:
                return kind(of_floats(x))
            except (OverflowError, ValueError):  # outside its domain: what IEEE says
                with np.errstate(all="ignore"):
                    return kind(of_arrays(float(x)))
        of_more_digits = getattr(x, "context", None)  # mpmath
        return of_arrays(x) if of_more_digits is None else getattr(of_more_digits, in_c)(x)

    function.__name__ = function.__qualname__ = name
    setattr(Number, name, function)
    return function


FUNCTIONS: dict[str, Callable[..., Any]] = {name: _of_one(name) for name in [*NAMES.split(), *MORE_NAMES.split()]}
sqrt, floor, sin, cos, tan, exp, log, sinh, cosh, tanh, arcsin, arccos, arctan, *_ = FUNCTIONS.values()

# Their derivatives, given x and f(x). At 0 the square root has tangents 0 where those of x are, and stays finite.
SLOPES: dict[str, Callable[[Any, Any], Any]] = {
    "sqrt": lambda x, y: 0.5 / (y + 1e-140),
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
    "arccosh": lambda x, y: 1.0 / sqrt(x * x - 1.0),
    "arcsinh": lambda x, y: 1.0 / sqrt(x * x + 1.0),
    "arctanh": lambda x, y: 1.0 / (1.0 - x * x),
    "cbrt": lambda x, y: 1.0 / (3.0 * y * y),
    "exp2": lambda x, y: math.log(2.0) * y,
    "expm1": lambda x, y: y + 1.0,
    "log10": lambda x, y: 1.0 / (math.log(10.0) * x),
    "log1p": lambda x, y: 1.0 / (1.0 + x),
    "log2": lambda x, y: 1.0 / (math.log(2.0) * x),
    **dict.fromkeys(("floor", "ceil", "rint", "trunc"), lambda x, y: 0.0),
}


# Functions of two numbers, and their derivatives by both, given a, b and f(a, b): the angle of the point (x, y), of y
# and x; the remainder with the sign of a; powers.


def _of_two(name: str, in_c: str, slopes: Callable[[Any, Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def function(a: Any, b: Any) -> Any:
        for x in (a, b):
            if hasattr(x, "tangents"):
                return x.of_two(function, slopes, a, b)
        if isinstance(a, Traced) or isinstance(b, Traced):
            return c_function(in_c, a, b)
        of_floats = isinstance(a, float) and isinstance(b, float)
        return getattr(math, in_c)(a, b) if of_floats else getattr(np, name)(a, b)

    setattr(Number, name, function)
    return function


def _slopes_of_angle(y: Any, x: Any, _: Any) -> Any:
    over = 1.0 / (x * x + y * y)
    return x * over, -y * over


FUNCTIONS["arctan2"] = arctan2 = _of_two("arctan2", "atan2", _slopes_of_angle)
FUNCTIONS["fmod"] = fmod = _of_two("fmod", "fmod", lambda a, b, r: (1.0, -(a - r) / b))
_raised = _of_two("power", "pow", lambda x, k, y: (k * y / x, y * log(x)))


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


def fma(a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once where the processor can; of tuples b and c entry by entry."""
    if isinstance(b, tuple):
        return mapped(lambda x, y: fma(a, x, y), b, c)
    for x in (a, b, c):
        if hasattr(x, "fused"):
            return x.fused(a, b, c)
    if any(isinstance(x, Element) for x in (a, b, c)):
        return intrinsic("fma", a, b, c) if writer().is_fused else a * b + c
    if not all(isinstance(x, (float, int)) for x in (a, b, c)):
        return a * b + c
    try:
        exact = Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c))
        return np.float64(float(exact)) if exact else a * b + c
    except (ValueError, OverflowError):  # not finite, or not to be
        return a * b + c


def select(mask: Any, a: Any, b: Any) -> Any:
    """Return a where the mask is set, else b: of numbers, and of tuples and records of them."""
    if isinstance(mask, (bool, np.bool_)):
        found = a if mask else b
        return np.float64(found) if type(found) is float else found  # which divides by 0 as IEEE does
    if isinstance(a, tuple):
        return mapped(lambda x, y: select(mask, x, y), a, b)
    if a is b or a is None:
        return a
    for x in (a, b):
        if hasattr(x, "tangents"):
            return x.selected(mask, a, b)
    if not isinstance(mask, Mask):
        return np.where(mask, a, b)
    n = max(x.n for x in (mask, a, b) if isinstance(x, Traced))
    kind = next(kind for kind in (Mask, Whole, Element) if kind.takes(a) and kind.takes(b))
    values = ", ".join(f"{kind_of(kind.scalar, n)} {kind.named(x, n)}" for x in (a, b))
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


def copysign(a: Any, b: Any) -> Any:
    """Return a with the sign of b."""
    return intrinsic("copysign", a, b) if isinstance(a, Element) or isinstance(b, Element) else math.copysign(a, b)


def sum_of_lanes(x: Any) -> Any:
    """Return the sum of all lanes."""
    return _of_lanes(operator.add, x)


def largest_of(x: Any) -> Any:
    """Return the largest of all lanes."""
    return _of_lanes(larger, x)


def _of_lanes(joined: Callable[[Any, Any], Any], x: Any) -> Any:
    """Return what comes of joining the halves of the lanes, until one is left."""
    if tracer() is None or x.n == 1:
        return x
    half = x.n // 2
    return _of_lanes(joined, joined(lanes_of(x, 0, half), lanes_of(x, half, half)))


def lanes_of(x: Any, first: int, count: int) -> Any:
    """Return some of the lanes of a number."""
    order = ", ".join(f"i32 {first + k}" for k in range(count))
    line = f"shufflevector {x.kind} {x.used(x.n)}, {x.kind} undef, <{count} x i32> <{order}>"
    return Element(writer().value(line if count > 1 else f"extractelement {x.kind} {x.used(x.n)}, {order}"), count)
