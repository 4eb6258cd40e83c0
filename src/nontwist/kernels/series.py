"""Power series: a text that is run on them gives each coefficient by those before it, tangents of duals included.

The solution ``x(t) = Σ x_n tⁿ`` of ``x' = f(x)`` has ``(n + 1) x_{n+1} = f_n``, the coefficients of f on the series of
x; those of a product are ``Σ a_i b_{n-i}``. The text of f stands in the code once for all n: it makes a list of
products, whose coefficients are kept in memory, and the machine counts n. Sums, and products with constants, are made
where they are used.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any

from ..machine import cached_property
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
    allocate : function
        Gives memory for so many numbers.
    """

    def __init__(self, order: int, tangents: int = 0, lanes: int = 1, allocate: Callable[[int], Any] = scratch) -> None:
        self.order, self.tangents, self.lanes, self._allocate = order, tangents, lanes, allocate
        self.size = 1 + tangents * lanes if tangents else lanes  # of a coefficient
        self.stored = list[Stored]()  # in the order in which they were made

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
        """Return a series whose first coefficient is to be set."""
        return Stored(self, self._allocate((self.order + 1) * self.size))

    def keep(self, level: int, **how: Any) -> Stored:
        """Return a series that is kept in memory as its coefficients are made."""
        return Stored(self, self._allocate(self.order * self.size), level, **how)

    def solve(self, unknowns: Sequence[Stored], rates: Sequence[Series], first: Any = 0, last: Any = None) -> None:
        """Make the coefficients of the unknowns beyond the power `first`, all or up to the power `last`."""
        some = max(1, AT_ONCE // (1 + self.tangents))
        for n in loop(first, self.order if last is None else last):
            for level in range(1 + max(one.level for one in self.stored)):
                own = [one for one in self.stored if one.level == level]
                products = [one for one in own if one.factors]
                for k in range(0, len(products), some):
                    convolve(products[k : k + some], n)
                for one in own:
                    if one.made is not None:
                        one.set_coefficient(n, one.made(n))
            for x, rate in zip(unknowns, rates, strict=True):
                x.set_coefficient(n + 1, rate[n] * (1.0 / (1.0 + n)))


class Series(Number):
    """A power series of numbers: ``x[n]`` is a coefficient.

    Its level says how many products one after the other lead to a coefficient from those of the unknowns.
    """

    is_series = True

    def __init__(self, of: Recurrence, coefficient: Callable[[Any], Any], level: int) -> None:
        self.of, self._coefficient, self.level = of, coefficient, level

    def __getitem__(self, n: Any) -> Any:
        return self._coefficient(n)

    @cached_property
    def stored(self) -> Stored:
        """The same series, kept in memory."""
        return self.of.keep(self.level, made=self.__getitem__)

    def combined(self, name: str, a: Any, b: Any) -> Any:
        """Return a sum or a product; products with numbers, which may be dual, as well."""
        if isinstance(a, tuple) or isinstance(b, tuple):
            return NotImplemented
        if name != "mul":
            operation = getattr(operator, name)
            return Series(self.of, lambda n: operation(a[n], b[n]), max(a.level, b.level))
        if isinstance(a, Series) and isinstance(b, Series):  # the factor that was made first counts upwards
            factors = sorted((a.stored, b.stored), key=operator.attrgetter("number"))
            return self.of.keep(1 + max(a.level, b.level), factors=factors)
        number = b if self is a else a
        return Series(self.of, lambda n: number * self[n], self.level)

    def __neg__(self) -> Series:
        return Series(self.of, lambda n: -self[n], self.level)


class Stored(Series):
    """A series in memory; its coefficients are set, or `made` gives them by those of others, or it is a product."""

    def __init__(
        self,
        of: Recurrence,
        memory: Any,
        level: int = 0,
        made: Callable[[Any], Any] | None = None,
        factors: Sequence[Stored] = (),
    ) -> None:
        self.of, self.memory, self.level, self.made, self.factors = of, memory, level, made, factors
        self.number = len(of.stored)
        of.stored.append(self)

    def __getitem__(self, n: Any) -> Any:
        return self.of.read(self.memory, n)

    def set_coefficient(self, n: Any, x: Any) -> None:
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


def convolve(products: Sequence[Stored], n: Any) -> None:
    """Make coefficient n of products, side by side: none has to wait for another."""
    v = Variables(x=tuple(a[0] * b[n] for a, b in (one.factors for one in products)))
    for i in loop(1, n + 1):
        v.x = tuple(fma(a[i], b[n - i], x) for (a, b), x in zip((one.factors for one in products), v.x, strict=True))
    for one, x in zip(products, v.x, strict=True):
        one.set_coefficient(n, x)
