"""Power series: a text that is run on them gives each coefficient by those before it, tangents of duals included.

The solution ``x(t) = Σ x_n tⁿ`` of ``x' = f(x)`` has ``(n + 1) x_{n+1} = f_n``, the coefficients of f on the series of
x; those of a product are ``Σ a_i b_{n-i}``. The text of f stands in the code once for all n: it makes a list of
products, whose coefficients are kept in memory, and the machine counts n. Sums, and products with constants, are made
where they are used.
"""

from __future__ import annotations

import operator
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple

from .control import Variables, loop
from .dual import Dual
from .elements import Number, fma
from .memory import scratch

AT_ONCE = 24  # numbers of products that are summed side by side


class Recurrence:
    """What has to be kept of the series of a text.

    Parameters
    ----------
    order : int
        The power of the last coefficient.
    tangents, lanes : int
        Of each number; directions lie side by side in lanes. Without tangents, it is the numbers that do.
    room : function
        Gives memory for so many numbers.
    """

    def __init__(self, order: int, tangents: int = 0, lanes: int = 1, room: Callable[[int], Any] = scratch) -> None:
        self.order, self.tangents, self.lanes, self._room = order, tangents, lanes, room
        self.size = 1 + tangents * lanes if tangents else lanes  # of a coefficient
        self.count = 0  # of series in memory
        self._sums, self._products = defaultdict[int, list[Stored]](list), defaultdict[int, list[Product]](list)

    def read(self, memory: Any, n: Any) -> Any:
        """Return a coefficient in memory."""
        at, lanes = n * self.size, self.lanes
        if not self.tangents:
            return memory.load(at, lanes)
        return Dual(memory[at], [memory.load(at + 1 + k * lanes, lanes) for k in range(self.tangents)])

    def write(self, memory: Any, n: Any, x: Any) -> None:
        """Write a coefficient to memory."""
        at, lanes = n * self.size, self.lanes
        if not self.tangents:
            memory.store(at, x, lanes)
            return
        memory[at] = x.value
        for k, tangent in enumerate(x.tangents):
            memory.store(at + 1 + k * lanes, tangent, lanes)

    def unknown(self) -> Stored:
        """Return a series whose first coefficient is to be put."""
        return Stored(self, self._room((self.order + 1) * self.size))

    def sum(self, series: Series) -> Stored:
        """Return a series that is kept in memory as its coefficients are made."""
        found = Stored(self, self._room(self.order * self.size), series.level, series.__getitem__)
        self._sums[found.level].append(found)
        return found

    def product(self, a: Series, b: Series) -> Stored:
        """Return the product of two series, which is kept as well; the factor that was made first counts upwards."""
        factors = a.stored, b.stored
        found = Stored(self, self._room(self.order * self.size), 1 + max(a.level, b.level))
        self._products[found.level].append(Product(found, *sorted(factors, key=operator.attrgetter("number"))))
        return found

    def solve(self, unknowns: Sequence[Stored], rates: Sequence[Series], first: Any = 0, last: Any = None) -> None:
        """Make the coefficients of the unknowns beyond the power `first`, all or up to the power `last`."""
        for n in loop(first, self.order if last is None else last):
            for level in range(1 + max([0, *self._sums, *self._products])):
                products, some = self._products[level], max(1, AT_ONCE // (1 + self.tangents))
                for k in range(0, len(products), some):
                    convolve(products[k : k + some], n)
                for one in self._sums[level]:
                    one.put(n, one.made(n))
            for x, rate in zip(unknowns, rates, strict=True):
                x.put(n + 1, rate[n] * (1.0 / (1.0 + n)))


class Series(Number):
    """A power series of numbers: ``x[n]`` is a coefficient.

    Its level says how many products one after the other lead to a coefficient from those of the unknowns.
    """

    def __init__(self, of: Recurrence, coefficient: Callable[[Any], Any], level: int) -> None:
        self.of, self._coefficient, self.level = of, coefficient, level

    def __getitem__(self, n: Any) -> Any:
        return self._coefficient(n)

    @cached_property
    def stored(self) -> Stored:
        """The same series, kept in memory."""
        return self.of.sum(self)

    def combined(self, name: str, a: Any, b: Any) -> Any:
        """Return a sum or a product, also with numbers."""
        if isinstance(a, tuple) or isinstance(b, tuple):
            return NotImplemented
        if name != "mul":
            operation = getattr(operator, name)
            return Series(self.of, lambda n: operation(a[n], b[n]), max(a.level, b.level))
        x, y = ((one.value if isinstance(one, Constant) else one) for one in (a, b))
        if isinstance(x, Series) and isinstance(y, Series):
            return x.of.product(x, y)
        if isinstance(x, Series):
            x, y = y, x
        return Series(y.of, lambda n: x * y[n], y.level) if isinstance(y, Series) else Constant(x * y)

    def __neg__(self) -> Series:
        return Series(self.of, lambda n: -self[n], self.level)


class Stored(Series):
    """A series in memory; `made` gives a coefficient by those of others."""

    def __init__(self, of: Recurrence, memory: Any, level: int = 0, made: Callable[[Any], Any] | None = None) -> None:
        self.of, self.memory, self.level, self.made = of, memory, level, made or self.__getitem__
        of.count += 1
        self.number = of.count

    def __getitem__(self, n: Any) -> Any:
        return self.of.read(self.memory, n)

    def put(self, n: Any, x: Any) -> None:
        """Write a coefficient."""
        self.of.write(self.memory, n, x)

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


class Product(NamedTuple):
    """A product of series."""

    of: Stored
    a: Stored
    b: Stored


class Constant(Series):
    """A series of one coefficient, which may be a dual number."""

    level = 0

    def __init__(self, value: Any) -> None:
        self.value = value

    def __neg__(self) -> Constant:
        return Constant(-self.value)


def convolve(products: Sequence[Product], n: Any) -> None:
    """Make coefficient n of products, side by side: none has to wait for another."""
    v = Variables(x=tuple(a[0] * b[n] for _, a, b in products))
    for i in loop(1, n + 1):
        v.x = tuple(fma(a[i], b[n - i], x) for (_, a, b), x in zip(products, v.x, strict=True))
    for (of, _, _), x in zip(products, v.x, strict=True):
        of.put(n, x)
