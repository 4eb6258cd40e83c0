"""Control flow of texts: loops, branches, what changes in them, and parts that are traced once and called.

They are generators, so that the same text runs on floats: ``for i in loop(n):`` counts in the machine, ``for _ in
whilst(condition):`` repeats, ``for _ in when(condition):`` does or does not. `break`, `continue` and `return` cannot
leave them. A Python name that changes in them would be wrong without a word: what changes are `Variables`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from .dual import Dual, plain
from .elements import Element, Mask, Traced, Whole, llvm_type, mapped
from .machine_code import TraceError, tracer, writer


def whilst(condition: Callable[[], Any]) -> Iterator[None]:
    """Repeat while a condition, a function without arguments, holds."""
    t = tracer()
    if t is None:
        while condition():
            yield
        return
    head, body, end = t.labels("while", "do", "done")
    t.label(head)
    with t.within("loop"):
        t.line(f"br i1 {condition().used()}, label %{body}, label %{end}\n{body}:")
        yield
    t.line(f"br label %{head}\n{end}:")


_repeated = whilst  # a loop has a condition of this name


def loop(first: Any, last: Any = None, step: int = 1, whilst: Callable[[], Any] | None = None) -> Iterator[Any]:
    """Count from `first`, 0 unless told, up to `last`, without it; stop where a condition does not hold."""
    if last is None:
        first, last = 0, first
    if tracer() is not None:
        Whole.named(last)  # which refuses another number
    v = Variables(at=first)
    for _ in _repeated(lambda: v.at < last if whilst is None else (v.at < last) & whilst()):
        yield v.at
        v.at = v.at + step


def when(condition: Any) -> Iterator[None]:
    """Do what follows where a condition holds: one truth value, not one for each lane."""
    if not isinstance(condition, Mask):
        if condition:
            yield
        return
    if condition.n != 1:
        raise TraceError("`when` takes one truth value: any_of(mask)")
    t = writer()
    then, end = t.labels("then", "end")
    t.line(f"br i1 {condition.used()}, label %{then}, label %{end}\n{then}:")
    with t.within("branch"):
        yield
    t.label(end)


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
            self._slots[name] = mapped(lambda x: _slot(x, name), value)
        mapped(lambda slot, x: _put(slot, x, name), self._slots[name], value)

    def __getattr__(self, name: str) -> Any:
        if name not in self._slots:
            raise AttributeError(f"there is no variable {name}")
        return self._slots[name] if tracer() is None else mapped(_get, self._slots[name])


class Slot:
    """Memory on the stack for one variable."""

    __slots__ = ("kind", "n", "name", "of")

    def __init__(self, of: type[Traced], n: int) -> None:
        self.of, self.n, self.kind = of, n, llvm_type(of.scalar, n)
        self.name = writer().slot(self.kind)


def _slot(x: Any, name: str) -> Any:
    if isinstance(x, Dual):
        return Dual(_slot(x.value, name), [_slot(t, name) for t in x.tangents])
    if x is None:
        return None
    for kind, lanes in ((Mask, 1), (Whole, 1), (Element, writer().lanes)):
        if isinstance(x, (kind, *kind.plain)):
            return Slot(kind, getattr(x, "n", lanes))
    raise TraceError(f"{name} cannot be a variable: {type(x).__name__}")


def _put(slot: Any, x: Any, name: str) -> None:
    if isinstance(slot, Dual):
        for own, y in zip((slot.value, *slot.tangents), (plain(x), *slot.lifted(x).tangents), strict=True):
            _put(own, y, name)
    elif slot is not None and x is not None:
        writer().store_slot(slot.kind, slot.of.named(x, slot.n), slot.name)
    elif slot is not x:
        raise TraceError(f"{name} was None first, or is now")


def _get(slot: Any) -> Any:
    if isinstance(slot, Dual):
        return Dual(_get(slot.value), [_get(own) for own in slot.tangents])
    return None if slot is None else slot.of(writer().load_slot(slot.kind, slot.name), slot.n)
