"""Parts of texts that are traced once into a kernel and called from there on, so that long code stands once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial, wraps
from typing import Any, TypeVar

from .elements import Traced, remade
from .memory import Pointer, View, passed
from .tracing import TraceError, Tracer, tracer

Text = TypeVar("Text", bound=Callable[..., Any])


def part(text: Text, is_rare: bool = False) -> Text:
    """Trace a text once for each kind of its arguments, as a function that is called: numbers go in and come out.

    What is no traced number, memory or tuple of them is a constant of the part, and must be hashable. A part cannot
    call itself. One that is rare is compiled five times as fast, and runs slower. Its numbers are the same.
    """

    @wraps(text)
    def called(*arguments: Any) -> Any:
        t = tracer()
        if t is None:
            return text(*arguments)
        numbers: list[Any] = []
        constants: list[Any] = []
        makers = [_taken(a, numbers, constants) for a in arguments]
        given = [passed(a) for a in numbers]
        key = (text, tuple(kind for kind, _ in given), tuple(constants))
        if key not in t.made:
            t.made[key] = None
            t.made[key] = _traced(t, text, makers, [kind for kind, _ in given], is_rare)
        if t.made[key] is None:
            raise TraceError(f"{text.__name__} calls itself")
        name, result, count, make = t.made[key]
        found = t.value(f"call {result} @{name}({', '.join(f'{kind} {x}' for kind, x in given)})", is_pure=False)
        return make(t.value(f"extractvalue {result} {found}, {k}") for k in range(count))

    return called  # type: ignore[return-value]


def rare(text: Text) -> Text:
    """Make a part that seldom runs."""
    return part(text, True)


def _traced(t: Tracer, text: Any, makers: list[Any], kinds: list[str], is_rare: bool) -> tuple[Any, ...]:
    """Trace a part; return its name, the type of its results, their number, and what makes them of names."""
    name = f"part{t.number()}"
    t.open(name, ", ".join(f"{kind} %a{k}" for k, kind in enumerate(kinds)), True, is_rare)
    names = iter([f"%a{k}" for k in range(len(kinds))])
    found: list[Any] = []
    make = _taken(text(*(maker(names) for maker in makers)), found, [])
    given = [passed(x) for x in found]
    result, value = "{" + ", ".join(kind for kind, _ in given) + "}", "undef"
    for k, (kind, x) in enumerate(given):
        value = t.value(f"insertvalue {result} {value}, {kind} {x}, {k}")
    t.line(f"ret {result} {value}")
    t.close(result)
    return name, result, len(given), make


def _taken(a: Any, numbers: list[Any], constants: list[Any]) -> Callable[[Iterator[str]], Any]:
    """Take the numbers of an argument; return what makes it anew of names."""
    if isinstance(a, (tuple, View)):
        parts = a if isinstance(a, tuple) else (a._record, a._memory, a._lanes, a._stride)
        makers = [_taken(x, numbers, constants) for x in parts]
        constants.append((type(a), len(parts)))
        made = partial(remade, a) if isinstance(a, tuple) else lambda found: View(*found)
        return lambda names: made([maker(names) for maker in makers])
    if isinstance(a, Pointer):
        numbers.append(a)
        constants.append(a.is_whole)
        shape = _taken(a.shape, numbers, constants)
        return lambda names: Pointer(next(names), a.is_whole, shape(names))
    if isinstance(a, Traced):
        numbers.append(a)
        return lambda names: type(a)(next(names), a.n)
    constants.append(a)
    return lambda names: a
