"""Numbers with derivatives: what a text makes of them are its value and its tangents, exact to round-off."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any

from .elements import BY_FUNCTIONS, ORDERS, SLOPES, Derived, Mask, fma, mapped, real, remade, select


class Dual(Derived):
    """A number and its derivatives in some directions: numbers, or the floats 0.0 and 1.0, which cost nothing."""

    __slots__ = ("tangents", "value")

    def __init__(self, value: Any, tangents: Sequence[Any]) -> None:
        self.value, self.tangents = value, tangents

    def lifted(self, x: Any) -> Dual:
        """Return x as a dual number with as many directions."""
        return x if isinstance(x, Dual) else Dual(x, [0.0] * len(self.tangents))

    def through(self, f: Callable[..., Any], slopes: Callable[..., Any], x: Sequence[Any]) -> Dual:
        """Return f(*x), given its derivatives at x and f(*x); of one argument its derivative."""
        values = [y.value if isinstance(y, Dual) else y for y in x]
        value = f(*values)
        found = slopes(*values, value)
        return self.chain(value, found if isinstance(found, tuple) else (found,), x)

    def chain(self, value: Any, slopes: Sequence[Any], x: Sequence[Any]) -> Dual:
        """Return a function of some numbers, given its value and its derivative by each."""
        terms = [(slope, y.tangents) for slope, y in zip(slopes, x, strict=True) if isinstance(y, Dual)]
        tangents: list[Any] = [0.0] * len(self.tangents)
        for k in range(len(tangents)):
            for slope, own in terms:
                tangents[k] = _fused(slope, own[k], tangents[k])
        return Dual(value, tangents)

    def combined(self, name: str, a: Any, b: Any) -> Any:
        """Return what an operator gives; comparisons are those of the values."""
        v, w = plain(a), plain(b)
        if name in ORDERS:
            return getattr(operator, name)(v, w)
        if not (_is_plain(v) and _is_plain(w)) or (_is_array(w if self is a else v) and not _is_array(self.value)):
            return NotImplemented
        if isinstance(v, Mask) or isinstance(w, Mask):
            a, b = (real(x) if isinstance(x, Mask) else x for x in (a, b))
        if name in SLOPES:
            return self.through(getattr(operator, name), SLOPES[name], (a, b))
        if name != "truediv":
            return BY_FUNCTIONS[name](a, b)
        if isinstance(a, Dual):
            return a * (1.0 / b)
        r = 1.0 / w
        found = r if type(a) is float and a == 1.0 else a * r
        return self.chain(found, (-found * r,), (b,))

    def __neg__(self) -> Dual:
        return Dual(-self.value, [_tangent_product(-1.0, t) for t in self.tangents])

    def __abs__(self) -> Any:
        return select(self.value < 0.0, -self, self)

    def __bool__(self) -> bool:
        return bool(self.value)

    def __float__(self) -> float:
        raise TypeError(
            "a number with derivatives cannot become a float, which has none: use functions of NumPy in the place of "
            "float() and math, or plain(x) for the value alone"
        )

    def selected(self, mask: Any, a: Any, b: Any) -> Dual:
        """Return a where the mask is set, else b."""
        a, b = self.lifted(a), self.lifted(b)
        pairs = zip(a.tangents, b.tangents, strict=True)
        tangents = [x if _is_zero(x) and _is_zero(y) else select(mask, x, y) for x, y in pairs]
        return Dual(select(mask, a.value, b.value), tangents)


def _is_plain(x: Any) -> bool:
    """Whether x is a number without tangents, of whatever kind."""
    if isinstance(x, (tuple, list, bool)) or getattr(x, "is_series", False):
        return False
    return getattr(getattr(x, "dtype", None), "kind", "") != "O"


def _is_array(x: Any) -> bool:
    """Whether x is an array: with a number with derivatives it makes an array of these, unless their value is one."""
    return getattr(x, "ndim", 0) > 0


def _is_zero(x: Any) -> bool:
    """Whether a tangent is 0 by its making; what was computed is no such constant, whatever its value."""
    return type(x) is float and x == 0.0


def _tangent_product(a: Any, b: Any) -> Any:
    """Return a times a tangent b."""
    if _is_zero(a) or _is_zero(b):
        return 0.0
    if type(a) is float and abs(a) == 1.0:
        return b if a > 0.0 else -b
    return a if type(b) is float and b == 1.0 else a * b


def _fused(a: Any, x: Any, y: Any) -> Any:
    """Return a x + y of tangents x, y."""
    if _is_zero(a) or _is_zero(x):
        return y
    if _is_zero(y):
        return _tangent_product(a, x)
    if type(a) is float and abs(a) == 1.0:
        return y + x if a > 0.0 else y - x
    return a + y if type(x) is float and x == 1.0 else fma(a, x, y)


def seeded(x: Sequence[Any], directions: Sequence[int] | None = None) -> Any:
    """Return the numbers as duals, the derivatives in the directions of some of them; all, unless told."""
    chosen = range(len(x)) if directions is None else directions
    duals = [Dual(a, [1.0 if i == j else 0.0 for j in chosen]) if i in chosen else a for i, a in enumerate(x)]
    return remade(x, duals)


def plain(x: Any) -> Any:
    """Return the values without their tangents; of tuples entry by entry."""
    return mapped(lambda y: y.value if isinstance(y, Dual) else y, x)


def tangent(x: Any, j: int) -> Any:
    """Return the derivatives in direction j; of tuples entry by entry."""
    return mapped(lambda y: y.tangents[j] if isinstance(y, Dual) else 0.0, x)


def tangents_of(x: Any) -> list[Any]:
    """Return the derivatives of a tuple of duals, in one direction after the other."""
    return [tangent(x, j) for j in range(len(x[0].tangents))]


def jacobian(f: Callable[[Any], Any], x: Any) -> list[Any]:
    """Return the columns of the derivative of f at a tuple of numbers."""
    found = f(seeded(x))
    return [tangent(found, j) for j in range(len(x))]
