"""Power series: a text that is run on them gives each coefficient by those before it, tangents of duals included.

The solution ``x(t) = Σ x_n tⁿ`` of ``x' = f(x)`` has ``(n + 1) x_{n+1} = f_n``, the coefficients of f on the series of
x; those of a product are ``Σ a_i b_{n-i}``. The text of f stands in the code once for all n: it makes a list of
products, whose coefficients are kept in memory, and the machine counts n. Sums, and products with constants, are made
where they are used.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

from .control import Variables, loop
from .dual import Dual
from .elements import Number, fma
from .memory import scratch


class Recurrence:
    """What has to be kept of the series of a text.

    Parameters
    ----------
    order : int
        The power of the last coefficient.
    tangents, lanes : int
        Of each number; directions lie side by side in lanes.
    """

    def __init__(self, order: int, tangents: int, lanes: int = 1) -> None:
        self.order, self.tangents, self.lanes = order, tangents, lanes
        self.size = 1 + tangents * lanes  # of a coefficient
        self._made: list[Stored] = []

    def unknown(self) -> Stored:
        """Return a series whose first coefficient is to be put."""
        return Stored(self, scratch((self.order + 1) * self.size))

    def kept(self, coefficient: Callable[[Any], Any]) -> Stored:
        """Return a series that is kept in memory as its coefficients are made."""
        found = Stored(self, scratch(self.order * self.size), coefficient)
        self._made.append(found)
        return found

    def solve(self, unknowns: Sequence[Stored], rates: Sequence[Series]) -> None:
        """Make all coefficients of the unknowns from the first ones."""
        for n in loop(self.order):
            for one in self._made:
                one.put(n, one.made(n))
            for x, rate in zip(unknowns, rates, strict=True):
                x.put(n + 1, rate[n] * (1.0 / (1.0 + n)))


class Series(Number):
    """A power series of numbers, duals as a rule: ``x[n]`` is a coefficient."""

    def __init__(self, of: Recurrence, coefficient: Callable[[Any], Any]) -> None:
        self.of, self._coefficient = of, coefficient

    def __getitem__(self, n: Any) -> Any:
        return self._coefficient(n)

    @cached_property
    def stored(self) -> Stored:
        """The same series, kept in memory."""
        return self.of.kept(self._coefficient)

    def combined(self, name: str, a: Any, b: Any) -> Any:
        """Return a sum or a product, also with numbers."""
        if isinstance(a, tuple) or isinstance(b, tuple):
            return NotImplemented
        if name != "mul":
            operation = getattr(operator, name)
            return Series(self.of, lambda n: operation(a[n], b[n]))
        x, y = ((one.value if isinstance(one, Constant) else one) for one in (a, b))
        if isinstance(x, Series) and isinstance(y, Series):
            s, t = x.stored, y.stored
            return self.of.kept(lambda n: convolution(s, t, n))
        if isinstance(x, Series):
            x, y = y, x
        return Series(y.of, lambda n: x * y[n]) if isinstance(y, Series) else Constant(x * y)

    def __neg__(self) -> Series:
        return Series(self.of, lambda n: -self[n])


class Constant(Series):
    """A series of one coefficient, which may be a dual number."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __neg__(self) -> Constant:
        return Constant(-self.value)


class Stored(Series):
    """A series in memory; `made` gives a coefficient by those before it."""

    def __init__(self, of: Recurrence, memory: Any, made: Callable[[Any], Any] | None = None) -> None:
        self.of, self.memory, self.made = of, memory, made or (lambda n: self[n])

    def __getitem__(self, n: Any) -> Dual:
        at, lanes = n * self.of.size, self.of.lanes
        return Dual(self.memory[at], [self.memory.load(at + 1 + k * lanes, lanes) for k in range(self.of.tangents)])

    def put(self, n: Any, x: Dual) -> None:
        """Write a coefficient."""
        at, lanes = n * self.of.size, self.of.lanes
        self.memory[at] = x.value
        for k, tangent in enumerate(x.tangents):
            self.memory.store(at + 1 + k * lanes, tangent, lanes)

    @property
    def stored(self) -> Stored:
        """Itself."""
        return self

    def at(self, t: Any) -> Any:
        """Return the sum of the series."""
        v = Variables(x=self[self.of.order])
        for n in loop(1, self.of.order + 1):
            v.x = v.x * t + self[self.of.order - n]
        return v.x


def convolution(a: Series, b: Series, n: Any) -> Any:
    """Return coefficient n of a product."""
    v = Variables(x=a[0] * b[n])
    for i in loop(1, n + 1):
        v.x = fma(a[i], b[n - i], v.x)
    return v.x
