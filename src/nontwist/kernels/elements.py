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
from typing import Any

import numpy as np

from .tracing import TraceError, tracer, writer


@lru_cache
def kind_of(scalar: str, n: int) -> str:
    """Return the type of n lanes of a type."""
    return scalar if n == 1 else f"<{n} x {scalar}>"


@lru_cache(maxsize=4096)
def literal(x: float, n: int) -> str:
    """Return n lanes of a number."""
    one = f"0x{int.from_bytes(struct.pack('>d', x)):016X}"
    return one if n == 1 else "<" + ", ".join([f"double {one}"] * n) + ">"


class Traced:
    """A value that is known when the code runs.

    Attributes
    ----------
    n : int
        Lanes.
    """

    __slots__ = ("home", "n", "name")
    scalar = ""

    def __init__(self, name: str, n: int = 1) -> None:
        self.name, self.n, self.home = name, n, writer().region

    @property
    def kind(self) -> str:
        """Its type in LLVM."""
        return kind_of(self.scalar, self.n)

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

    def __bool__(self) -> bool:
        raise TraceError(writer().branching)

    def __float__(self) -> float:
        raise TraceError(writer().converting)

    __int__ = __index__ = __float__

    def compared(self, sign: str, other: Any) -> Any:
        """Return the mask of a comparison."""
        raise NotImplementedError

    def __lt__(self, o: Any) -> Any:
        return self.compared("lt", o)

    def __le__(self, o: Any) -> Any:
        return self.compared("le", o)

    def __gt__(self, o: Any) -> Any:
        return self.compared("gt", o)

    def __ge__(self, o: Any) -> Any:
        return self.compared("ge", o)

    def __eq__(self, o: object) -> Any:
        return self.compared("eq", o)

    def __ne__(self, o: object) -> Any:
        return self.compared("ne", o)

    __hash__ = None  # type: ignore[assignment]


class Mask(Traced):
    """A truth value, or one for each lane."""

    __slots__ = ()
    scalar = "i1"

    def __and__(self, o: Any) -> Mask:
        return _joined("and", self, o)

    def __or__(self, o: Any) -> Mask:
        return _joined("or", self, o)

    def __xor__(self, o: Any) -> Mask:
        return _joined("xor", self, o)

    __rand__, __ror__, __rxor__ = __and__, __or__, __xor__

    def __invert__(self) -> Mask:
        return _joined("xor", self, True)

    def __mul__(self, o: Any) -> Any:
        return select(self, 1.0, 0.0) * o

    def __add__(self, o: Any) -> Any:
        return select(self, 1.0, 0.0) + o

    __rmul__, __radd__ = __mul__, __add__


def _joined(op: str, a: Mask, b: Any) -> Mask:
    n = max(a.n, getattr(b, "n", 1))
    return Mask(writer().value(f"{op} {kind_of('i1', n)} {a.used(n)}, {mask_with(b, n)}"), n)


def mask_with(x: Any, n: int) -> str:
    """Return the name or the literal of a mask with n lanes."""
    if isinstance(x, Mask):
        return x.used(n)
    if not isinstance(x, (bool, np.bool_)):
        raise TraceError(f"{type(x).__name__} is not a mask: compare numbers")
    one = "true" if x else "false"
    return one if n == 1 else "<" + ", ".join([f"i1 {one}"] * n) + ">"


class Element(Traced):
    """A double, or a vector of doubles, one for each lane."""

    __slots__ = ()
    scalar = "double"

    def __add__(self, o: Any) -> Any:
        return _arithmetic("fadd", self, o, self)

    def __radd__(self, o: Any) -> Any:
        return _arithmetic("fadd", o, self, self)

    def __sub__(self, o: Any) -> Any:
        return _arithmetic("fsub", self, o, self)

    def __rsub__(self, o: Any) -> Any:
        return _arithmetic("fsub", o, self, self)

    def __mul__(self, o: Any) -> Any:
        return _arithmetic("fmul", self, o, self)

    def __rmul__(self, o: Any) -> Any:
        return _arithmetic("fmul", o, self, self)

    def __truediv__(self, o: Any) -> Any:
        return _arithmetic("fdiv", self, o, self)

    def __rtruediv__(self, o: Any) -> Any:
        return _arithmetic("fdiv", o, self, self)

    def __neg__(self) -> Element:
        return Element(writer().value(f"fneg {self.kind} {self.used(self.n)}"), self.n)

    def __pos__(self) -> Element:
        return self

    def __abs__(self) -> Element:
        return intrinsic("fabs", self)

    def __pow__(self, k: Any) -> Any:
        return power(self, k)

    def __rpow__(self, a: Any) -> Any:
        return c_function("pow", a, self) if is_number(a) else NotImplemented

    def __mod__(self, o: Any) -> Any:
        return remainder(self, o) if is_number(o) else NotImplemented

    def __rmod__(self, o: Any) -> Any:
        return remainder(o, self) if is_number(o) else NotImplemented

    def __floordiv__(self, o: Any) -> Any:
        return whole_quotient(self, o) if is_number(o) else NotImplemented

    def __rfloordiv__(self, o: Any) -> Any:
        return whole_quotient(o, self) if is_number(o) else NotImplemented

    def compared(self, sign: str, other: Any) -> Any:
        """Return the mask of a comparison; with what is no number only `!=` holds."""
        if not is_number(other):
            return NotImplemented
        n, order = max(self.n, getattr(other, "n", 1)), "u" if sign == "ne" else "o"
        names = f"{operand(self, n)}, {operand(other, n)}"
        return Mask(writer().value(f"fcmp {order}{sign} {kind_of('double', n)} {names}"), n)


def is_number(x: Any) -> bool:
    """Whether x stands for one number, or one a lane, in arithmetic with elements."""
    return isinstance(x, (Element, Whole, float, int, np.number)) and not isinstance(x, (bool, complex))


def operand(x: Any, n: int) -> str:
    """Return the name or the literal of a number with n lanes."""
    if isinstance(x, Element):
        return x.used(n)
    if isinstance(x, Whole):
        return real(x).used(n)
    if not is_number(x):
        raise TraceError(f"{type(x).__name__} is not a number here")
    return literal(float(x), n)


def _arithmetic(op: str, a: Any, b: Any, own: Element) -> Any:
    other = b if a is own else a
    if type(other) is not Element and not is_number(other):
        return NotImplemented
    n = max(own.n, getattr(other, "n", 1))
    names = [operand(a, n), operand(b, n)]
    if op in ("fadd", "fmul"):  # in one order, so that a line and its mirror image are one
        names.sort()
    return Element(writer().value(f"{op} {kind_of('double', n)} {names[0]}, {names[1]}"), n)


class Whole(Traced):
    """A whole number of 64 bits: a count, a place, an address."""

    __slots__ = ()
    scalar = "i64"

    def __add__(self, o: Any) -> Any:
        return _whole_arithmetic("add", self, o)

    def __sub__(self, o: Any) -> Any:
        return _whole_arithmetic("sub", self, o)

    def __rsub__(self, o: Any) -> Any:
        return _whole_arithmetic("sub", o, self)

    def __mul__(self, o: Any) -> Any:
        return _whole_arithmetic("mul", self, o)

    def __truediv__(self, o: Any) -> Any:
        return real(self) / o

    def __rtruediv__(self, o: Any) -> Any:
        return o / real(self)

    __radd__, __rmul__ = __add__, __mul__

    def compared(self, sign: str, other: Any) -> Any:
        """Return the mask of a comparison."""
        if isinstance(other, (float, Element)):
            return real(self).compared(sign, other)
        signed = sign if sign in ("eq", "ne") else f"s{sign}"
        return Mask(writer().value(f"icmp {signed} i64 {whole(self)}, {whole(other)}"))


def _whole_arithmetic(op: str, a: Any, b: Any) -> Any:
    if all(isinstance(x, (Whole, int, np.integer)) for x in (a, b)):
        return Whole(writer().value(f"{op} i64 {whole(a)}, {whole(b)}"))
    if not all(is_number(x) for x in (a, b)):
        return NotImplemented
    return getattr(operator, op)(*(real(x) if isinstance(x, Whole) else x for x in (a, b)))


def whole(x: Any) -> str:
    """Return the name or the literal of a whole number."""
    if isinstance(x, Whole):
        return x.used()
    if isinstance(x, (int, np.integer)):
        return str(int(x))
    raise TraceError(f"{type(x).__name__} is not a whole number")


def real(x: Any) -> Any:
    """Return a whole number as a double."""
    if isinstance(x, Whole):
        return Element(writer().value(f"sitofp i64 {x.used()} to double"))
    return float(x)


def intrinsic(name: str, *args: Any) -> Element:
    """Call a function of LLVM, lane by lane."""
    t, n = writer(), max(getattr(a, "n", 1) for a in args)
    kind, full = kind_of("double", n), f"llvm.{name}.{'' if n == 1 else f'v{n}'}f64"
    t.declare(full, f"{kind} @{full}({', '.join([kind] * len(args))})")
    return Element(t.value(f"call {kind} @{full}({', '.join(f'{kind} {operand(a, n)}' for a in args)})"), n)


def c_function(name: str, *args: Any) -> Element:
    """Call a function of the C library for each lane."""
    t, n = writer(), max(getattr(a, "n", 1) for a in args)
    t.declare(name, f"double @{name}({', '.join(['double'] * len(args))}) nounwind willreturn memory(none)")
    names, found = [operand(a, n) for a in args], "undef"
    for l in range(n):
        own = names
        if n > 1:
            own = [t.value(f"extractelement {kind_of('double', n)} {x}, i32 {l}") for x in names]
        one = t.value(f"call double @{name}({', '.join(f'double {x}' for x in own)})")
        if n == 1:
            return Element(one)
        found = t.value(f"insertelement {kind_of('double', n)} {found}, double {one}, i32 {l}")
    return Element(found, n)


# Functions of one number. NumPy calls them by these names on arrays of elements and duals, as methods.

C_NAMES = {"arcsin": "asin", "arccos": "acos", "arctan": "atan"}
FUNCTIONS = ("sqrt", "floor", "sin", "cos", "tan", "exp", "log", "sinh", "cosh", "tanh", *C_NAMES)


def _function_of_floats(name: str) -> Callable[[Any], Any]:
    """Return a function of plain numbers: of floats that of the C library, with IEEE's results outside its domain."""
    of_floats: Callable[[float], float] = getattr(math, C_NAMES.get(name, name))

    def function(x: Any) -> Any:
        if isinstance(x, (float, int)):
            kind = type(x) if isinstance(x, float) else float
            try:
                return kind(of_floats(x))
            except OverflowError:
                return kind(math.inf if name != "floor" else x)
            except ValueError:
                return kind(-math.inf if name == "log" and x == 0.0 else x if name == "floor" else math.nan)
        of_more_digits = getattr(x, "context", None)  # mpmath
        return getattr(np, name)(x) if of_more_digits is None else getattr(of_more_digits, C_NAMES.get(name, name))(x)

    return function


def _function(name: str) -> Callable[[Any], Any]:
    of_floats = _function_of_floats(name)

    def function(x: Any) -> Any:
        if isinstance(x, Element):
            return intrinsic(name, x) if name in ("sqrt", "floor") else c_function(C_NAMES.get(name, name), x)
        if isinstance(x, Whole):
            return function(real(x))
        own = getattr(type(x), name, None) if not hasattr(x, "dtype") and not hasattr(x, "context") else None
        return of_floats(x) if own is None else own(x)

    function.__name__ = function.__qualname__ = name
    setattr(Element, name, function)
    return function


sqrt, floor, sin, cos, tan, exp, log, sinh, cosh, tanh, arcsin, arccos, arctan = map(_function, FUNCTIONS)


def arctan2(y: Any, x: Any) -> Any:
    """Return the angle of the point (x, y)."""
    for a in (y, x):
        if hasattr(a, "tangents"):
            return a.angle(y, x)
    if isinstance(y, Element) or isinstance(x, Element):
        return c_function("atan2", y, x)
    return math.atan2(y, x) if isinstance(y, float) and isinstance(x, float) else np.arctan2(y, x)


Element.arctan2 = arctan2  # type: ignore[attr-defined]


def power(x: Any, k: Any) -> Any:
    """Return x to a power: of a whole one that is known products."""
    if hasattr(k, "tangents") or (isinstance(k, Traced) and hasattr(x, "tangents")):
        return (k if hasattr(k, "tangents") else x).raised(x, k)
    if isinstance(k, Traced):
        return c_function("pow", x, k)
    if isinstance(k, float) and k == int(k):
        k = int(k)
    if isinstance(k, int):
        if k < 0:
            return 1.0 / power(x, -k)
        if k < 2:
            return x if k else 0.0 * x + 1.0
        half = power(x, k // 2)
        return half * half * x if k % 2 else half * half
    if k == 0.5:
        return sqrt(x)
    return exp(k * log(x))


def fmod(a: Any, b: Any) -> Any:
    """Return the remainder of a over b with the sign of a, as C has it."""
    for x in (a, b):
        if hasattr(x, "tangents"):
            return x.left(a, b)
    return c_function("fmod", a, b)


def remainder(a: Any, b: Any) -> Any:
    """Return the remainder of a over b with the sign of b, as Python's ``a % b``."""
    r = fmod(a, b)
    return select((r != 0.0) & ((r < 0.0) ^ (b < 0.0)), r + b, r)


def whole_quotient(a: Any, b: Any) -> Any:
    """Return the quotient rounded down, as Python's ``a // b``."""
    return floor((a - remainder(a, b)) / b + 0.5)


def fma(a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once where the processor can; of tuples b and c entry by entry."""
    if isinstance(b, tuple):
        return b._make(fma(a, x, y) for x, y in zip(b, c, strict=True))  # type: ignore[attr-defined]
    for x in (a, b, c):
        if hasattr(x, "tangents"):
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
        return remade(a, [select(mask, x, y) for x, y in zip(a, b, strict=True)])
    if a is b or a is None:
        return a
    for x in (a, b):
        if hasattr(x, "tangents"):
            return x.selected(mask, a, b)
    if not isinstance(mask, Mask):
        return np.where(mask, a, b)
    n, kind = max(x.n for x in (mask, a, b) if isinstance(x, Traced)), Element
    if any(isinstance(x, (Mask, bool)) for x in (a, b)):
        names, kind = [mask_with(x, n) for x in (a, b)], Mask  # type: ignore[assignment]
    elif all(isinstance(x, (Whole, int)) for x in (a, b)):
        names, kind = [whole(x) for x in (a, b)], Whole  # type: ignore[assignment]
    else:
        names = [operand(x, n) for x in (a, b)]
    values = ", ".join(f"{kind_of(kind.scalar, n)} {x}" for x in names)
    return kind(writer().value(f"select {mask.kind} {mask.used(mask.n)}, {values}"), n)


def remade(like: Any, parts: Any) -> Any:
    """Return a tuple of the type of another one."""
    return like._make(parts) if hasattr(like, "_make") else tuple(parts)


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


def splat(x: Any, like: Any) -> Any:
    """Return x with as many lanes as another number has; an array of its shape."""
    if isinstance(like, Element):
        return Element(operand(x, like.n), like.n)
    return x + np.zeros(np.shape(like)) if np.ndim(like) else x


def lanes_of(x: Element, first: int, count: int) -> Element:
    """Return some of the lanes of a number."""
    t, name = writer(), x.used(x.n)
    if count == 1:
        return Element(t.value(f"extractelement {x.kind} {name}, i32 {first}"))
    order = ", ".join(f"i32 {first + k}" for k in range(count))
    return Element(t.value(f"shufflevector {x.kind} {name}, {x.kind} undef, <{count} x i32> <{order}>"), count)


def sum_of_lanes(x: Any) -> Any:
    """Return the sum of all lanes."""
    if tracer() is None or x.n == 1:
        return x
    half = x.n // 2
    return sum_of_lanes(lanes_of(x, 0, half) + lanes_of(x, half, half))


def largest_of(x: Any) -> Any:
    """Return the largest of all lanes."""
    if tracer() is None or x.n == 1:
        return x
    half = x.n // 2
    return largest_of(larger(lanes_of(x, 0, half), lanes_of(x, half, half)))
