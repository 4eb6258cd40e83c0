"""Control flow of texts: loops, branches, what changes in them, and parts that are traced once and called.

They are generators, so that the same text runs on floats: ``for i in loop(n):`` counts in the machine, ``for _ in
whilst(condition):`` repeats, ``for _ in when(condition):`` does or does not. `break`, `continue` and `return` cannot
leave them. A Python name that changes in them would be wrong without a word: what changes are `Variables`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from .dual import Dual, plain
from .elements import Element, Mask, Traced, Whole, kind_of, mask_with, operand, remade, whole
from .tracing import TraceError, Tracer, tracer, writer


def loop(first: Any, last: Any = None, step: int = 1, whilst: Callable[[], Any] | None = None) -> Iterator[Any]:
    """Count from `first`, 0 unless told, up to `last`, without it; stop where a condition does not hold."""
    if last is None:
        first, last = 0, first
    if tracer() is None:
        for i in range(first, last, step):
            if whilst is not None and not whilst():
                return
            yield i
        return
    t, slot = writer(), writer().slot("i64")
    head, body, end = _labels(t, "head", "body", "end")
    t.line(f"store i64 {whole(first)}, ptr {slot}")
    t.label(head)
    with t.within("loop"):
        now = Whole(t.value(f"load i64, ptr {slot}", is_pure=False))
        goes = Mask(t.value(f"icmp slt i64 {now.used()}, {whole(last)}"))
        if whilst is not None:
            goes = goes & whilst()
        t.line(f"br i1 {goes.used()}, label %{body}, label %{end}\n{body}:")
        yield now
        t.line(f"store i64 {(now + step).used()}, ptr {slot}")
    t.line(f"br label %{head}\n{end}:")


def whilst(condition: Callable[[], Any]) -> Iterator[None]:
    """Repeat while a condition, a function without arguments, holds."""
    t = tracer()
    if t is None:
        while condition():
            yield
        return
    head, body, end = _labels(t, "while", "do", "done")
    t.label(head)
    with t.within("loop"):
        t.line(f"br i1 {condition().used()}, label %{body}, label %{end}\n{body}:")
        yield
    t.line(f"br label %{head}\n{end}:")


def when(condition: Any) -> Iterator[None]:
    """Do what follows where a condition holds: one truth value, not one for each lane."""
    if not isinstance(condition, Mask):
        if condition:
            yield
        return
    if condition.n != 1:
        raise TraceError("`when` takes one truth value: any_of(mask)")
    t = writer()
    then, end = _labels(t, "then", "end")
    t.line(f"br i1 {condition.used()}, label %{then}, label %{end}\n{then}:")
    with t.within("branch"):
        yield
    t.label(end)


def _labels(t: Tracer, *words: str) -> list[str]:
    number = t.number()
    return [f"{word}{number}" for word in words]


class Variables:
    """Numbers, and tuples of them, that change in loops and branches: ``v = Variables(y=..., count=0)``, ``v.y = ...``.

    Each keeps the type of its first value; a plain float stands for as many lanes as the kernel has. Of dual numbers
    value and derivatives are kept.
    """

    _slots: dict[str, Any]

    def __init__(self, **values: Any) -> None:
        self.__dict__["_slots"] = {}
        for name, value in values.items():
            setattr(self, name, value)

    def __setattr__(self, name: str, value: Any) -> None:
        if tracer() is None:
            self._slots[name] = value
            return
        if name not in self._slots:
            self._slots[name] = _slots_of(value, name)
        _put(self._slots[name], value, name)

    def __getattr__(self, name: str) -> Any:
        if name not in self._slots:
            raise AttributeError(f"there is no variable {name}")
        return self._slots[name] if tracer() is None else _get(self._slots[name])


class Slot:
    """Memory on the stack for one variable."""

    __slots__ = ("kind", "n", "name", "of")

    def __init__(self, of: type[Traced], n: int) -> None:
        self.of, self.n, self.kind = of, n, kind_of(of.scalar, n)
        self.name = writer().slot(self.kind)


def _slots_of(x: Any, name: str) -> Any:
    if isinstance(x, tuple):
        return remade(x, [_slots_of(y, name) for y in x])
    if isinstance(x, Dual):
        return Dual(_slots_of(x.value, name), [_slots_of(t, name) for t in x.tangents])
    if isinstance(x, Traced):
        return Slot(type(x), x.n)
    for kind, of, n in ((bool, Mask, 1), (int, Whole, 1), (float, Element, writer().lanes)):
        if isinstance(x, kind):
            return Slot(of, n)
    if x is None:
        return None
    raise TraceError(f"{name} cannot be a variable: {type(x).__name__}")


def _put(slot: Any, x: Any, name: str) -> None:
    if isinstance(slot, tuple):
        for own, y in zip(slot, x, strict=True):
            _put(own, y, name)
    elif isinstance(slot, Dual):
        _put((slot.value, *slot.tangents), (plain(x), *slot.lifted(x).tangents), name)
    elif slot is None or x is None:
        if slot is not x:
            raise TraceError(f"{name} was None first, or is now")
    else:
        value = operand(x, slot.n) if slot.of is Element else mask_with(x, slot.n) if slot.of is Mask else whole(x)
        writer().put(slot.kind, value, slot.name)


def _get(slot: Any) -> Any:
    if isinstance(slot, tuple):
        return remade(slot, [_get(own) for own in slot])
    if isinstance(slot, Dual):
        return Dual(_get(slot.value), [_get(own) for own in slot.tangents])
    return None if slot is None else slot.of(writer().get(slot.kind, slot.name), slot.n)
