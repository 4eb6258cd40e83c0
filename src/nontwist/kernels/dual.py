"""Numbers with derivatives: what a text makes of them are its value and its tangents, exact to round-off."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from . import elements
from .elements import cos, cosh, fma, power, remade, select, sin, sinh, sqrt

# The derivative of f, given x and f(x). At 0 the square root has tangents 0 where those of x are, and stays finite.
DERIVATIVES: dict[str, Callable[[Any, Any], Any]] = {
    "sqrt": lambda x, y: 0.5 / (y + 1e-140),
    "floor": lambda x, y: 0.0,
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
}


class Dual:
    """A number and its derivatives in some directions: numbers, or the floats 0.0 and 1.0, which cost nothing."""

    __slots__ = ("tangents", "value")

    def __init__(self, value: Any, tangents: Sequence[Any]) -> None:
        self.value, self.tangents = value, tangents

    def lifted(self, x: Any) -> Dual:
        """Return x as a dual number with as many directions."""
        return x if isinstance(x, Dual) else Dual(x, [0.0] * len(self.tangents))

    def chain(self, value: Any, slope: Any) -> Dual:
        """Return a function of this number, given its value and its derivative."""
        return Dual(value, [_product(slope, t) for t in self.tangents])

    def __pos__(self) -> Dual:
        return self

    def __neg__(self) -> Dual:
        return Dual(-self.value, [t if _is_zero(t) else -t for t in self.tangents])

    def __add__(self, o: Any) -> Any:
        if isinstance(o, Dual):
            return Dual(self.value + o.value, [_sum(a, b) for a, b in zip(self.tangents, o.tangents, strict=True)])
        return Dual(self.value + o, self.tangents) if _is_plain(o) else NotImplemented

    __radd__ = __add__

    def __sub__(self, o: Any) -> Any:
        if isinstance(o, Dual):
            rows = zip(self.tangents, o.tangents, strict=True)
            return Dual(self.value - o.value, [_difference(a, b) for a, b in rows])
        return Dual(self.value - o, self.tangents) if _is_plain(o) else NotImplemented

    def __rsub__(self, o: Any) -> Any:
        return Dual(o - self.value, (-self).tangents) if _is_plain(o) else NotImplemented

    def __mul__(self, o: Any) -> Any:
        if isinstance(o, Dual):
            v, w, rows = self.value, o.value, zip(self.tangents, o.tangents, strict=True)
            return Dual(v * w, [_fused(v, b, _product(w, a)) for a, b in rows])
        return self.chain(self.value * o, o) if _is_plain(o) else NotImplemented

    __rmul__ = __mul__

    def __truediv__(self, o: Any) -> Any:
        return self * (1.0 / o) if isinstance(o, Dual) or _is_plain(o) else NotImplemented

    def __rtruediv__(self, o: Any) -> Any:
        if not _is_plain(o):
            return NotImplemented
        r = 1.0 / self.value
        found = r if type(o) is float and o == 1.0 else o * r
        return self.chain(found, -found * r)

    def __abs__(self) -> Any:
        return select(self.value < 0.0, -self, self)

    def __pow__(self, k: Any) -> Any:
        return power(self, k)

    def __bool__(self) -> bool:
        return bool(self.value)

    def __float__(self) -> float:
        return float(self.value)  # which traced numbers refuse

    def __mod__(self, o: Any) -> Any:
        return elements.remainder(self, o)

    def __rmod__(self, o: Any) -> Any:
        return elements.remainder(o, self)

    def __rpow__(self, a: Any) -> Any:
        return power(a, self)

    def __floordiv__(self, o: Any) -> Any:
        return elements.whole_quotient(self, o)

    def __rfloordiv__(self, o: Any) -> Any:
        return elements.whole_quotient(o, self)

    def __eq__(self, o: object) -> Any:
        return self.value == getattr(o, "value", o)

    def __ne__(self, o: object) -> Any:
        return self.value != getattr(o, "value", o)

    __hash__ = None  # type: ignore[assignment]

    def __lt__(self, o: Any) -> Any:
        return self.value < getattr(o, "value", o)

    def __le__(self, o: Any) -> Any:
        return self.value <= getattr(o, "value", o)

    def __gt__(self, o: Any) -> Any:
        return self.value > getattr(o, "value", o)

    def __ge__(self, o: Any) -> Any:
        return self.value >= getattr(o, "value", o)

    def fused(self, a: Any, b: Any, c: Any) -> Dual:
        """Return a b + c."""
        a, b, c = self.lifted(a), self.lifted(b), self.lifted(c)
        rows = zip(a.tangents, b.tangents, c.tangents, strict=True)
        tangents = [_fused(a.value, y, _fused(b.value, x, z)) for x, y, z in rows]
        return Dual(fma(a.value, b.value, c.value), tangents)

    def selected(self, mask: Any, a: Any, b: Any) -> Dual:
        """Return a where the mask is set, else b."""
        a, b = self.lifted(a), self.lifted(b)
        tangents = [
            x if _is_zero(x) and _is_zero(y) else select(mask, x, y)
            for x, y in zip(a.tangents, b.tangents, strict=True)
        ]
        return Dual(select(mask, a.value, b.value), tangents)

    def of_two(self, f: Callable[[Any, Any], Any], slopes: Callable[[Any, Any, Any], Any], a: Any, b: Any) -> Dual:
        """Return f(a, b), given its derivatives at a, b and f(a, b)."""
        a, b = self.lifted(a), self.lifted(b)
        value = f(a.value, b.value)
        by_a, by_b = slopes(a.value, b.value, value)
        rows = zip(a.tangents, b.tangents, strict=True)
        return Dual(value, [_fused(by_a, x, _product(by_b, y)) for x, y in rows])

    def angle(self, y: Any, x: Any) -> Dual:
        """Return the angle of the point (x, y)."""

        def slopes(y: Any, x: Any, _: Any) -> Any:
            over = 1.0 / (x * x + y * y)
            return x * over, -y * over

        return self.of_two(elements.arctan2, slopes, y, x)

    def raised(self, x: Any, k: Any) -> Dual:
        """Return x to the power k."""
        return self.of_two(
            lambda x, k: elements.c_function("pow", x, k), lambda x, k, y: (k * y / x, y * elements.log(x)), x, k
        )

    def left(self, a: Any, b: Any) -> Dual:
        """Return the remainder of a over b with the sign of a."""
        return self.of_two(elements.fmod, lambda a, b, r: (1.0, -(a - r) / b), a, b)


def _method(name: str) -> Callable[[Dual], Dual]:
    function, slope = getattr(elements, name), DERIVATIVES[name]

    def of_dual(x: Dual) -> Dual:
        value = function(x.value)
        return x.chain(value, slope(x.value, value))

    return of_dual


for _name in DERIVATIVES:
    setattr(Dual, _name, _method(_name))
Dual.arctan2 = lambda y, x: y.angle(y, x)  # type: ignore[attr-defined]


def _is_plain(x: Any) -> bool:
    """Whether x is a number without tangents, of whatever kind."""
    return not isinstance(x, (tuple, list, bool)) and getattr(getattr(x, "dtype", None), "kind", "") != "O"


def _is_zero(x: Any) -> bool:
    """Whether a tangent is 0 by its making; what was computed is no such constant, whatever its value."""
    return type(x) is float and x == 0.0


def _sum(a: Any, b: Any) -> Any:
    return b if _is_zero(a) else a if _is_zero(b) else a + b


def _difference(a: Any, b: Any) -> Any:
    return a if _is_zero(b) else -b if _is_zero(a) else a - b


def _product(a: Any, b: Any) -> Any:
    """Return a times a tangent b."""
    return 0.0 if _is_zero(a) or _is_zero(b) else a if type(b) is float and b == 1.0 else a * b


def _fused(a: Any, x: Any, y: Any) -> Any:
    """Return a x + y of tangents x, y."""
    if _is_zero(a) or _is_zero(x):
        return y
    if _is_zero(y):
        return _product(a, x)
    return a + y if type(x) is float and x == 1.0 else fma(a, x, y)


def seeded(x: Sequence[Any], directions: Sequence[int] | None = None) -> Any:
    """Return the numbers as duals, the derivatives in the directions of some of them; all, unless told."""
    chosen = range(len(x)) if directions is None else directions
    duals = [Dual(a, [1.0 if i == j else 0.0 for j in chosen]) if i in chosen else a for i, a in enumerate(x)]
    return remade(x, duals)


def plain(x: Any) -> Any:
    """Return the values without their tangents; of tuples entry by entry."""
    return remade(x, [plain(y) for y in x]) if isinstance(x, tuple) else x.value if isinstance(x, Dual) else x


def tangent(x: Any, j: int) -> Any:
    """Return the derivatives in direction j; of tuples entry by entry."""
    if isinstance(x, tuple):
        return remade(x, [tangent(y, j) for y in x])
    return x.tangents[j] if isinstance(x, Dual) else 0.0


def tangents_of(x: Any) -> list[Any]:
    """Return the derivatives of a tuple of duals, in one direction after the other."""
    return [tangent(x, j) for j in range(len(x[0].tangents))]


def jacobian(f: Callable[[Any], Any], x: Any) -> list[Any]:
    """Return the columns of the derivative of f at a tuple of numbers."""
    found = f(seeded(x))
    return [tangent(found, j) for j in range(len(x))]
