"""Kernels: texts that Python calls. They are traced and compiled by their first call, once for a process.

A kernel declares what it is called with: ``@kernel("f8[:, :], i8 -> i8, f8")``. Numbers are of 64 bits, floating or
whole; arrays of them are contiguous, the last index running fastest. In machine code every kernel is a C function of
one address. Where its arguments are others, they and its results lie there, each number in 8 bytes, each array as its
address and its shape. A kernel of ``"i8"`` takes the address itself: a march with a block, say.

A part of a text that is long stands once: it is traced as a function of its own, and called (`part`).
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Iterator
from functools import partial, update_wrapper, wraps
from struct import Struct
from typing import Any, TypeVar

import numpy as np

from . import machine_code
from .elements import Traced, Whole, remade
from .machine_code import TraceError, Tracer, tracer, tracing
from .memory import Pointer, View, memory_at, passed

ENTRY = "kernel"
WORD = r"(f8|i8)(?:\[(:(?:, :)*)\])?"
LETTERS = {"f8": "d", "i8": "q"}
TYPES = {"f8": np.dtype(np.float64), "i8": np.dtype(np.int64)}
Place = tuple[str, int, int]


class Signature:
    """Arguments and results of a kernel, and where they lie.

    Attributes
    ----------
    is_address : bool
        Whether the only argument is an address, which is passed as it is.
    places, results : list of (kind, place in units of 8 bytes, number of axes)

    Raises
    ------
    ValueError
        Words that are none.
    """

    def __init__(self, words: str) -> None:
        inputs, _, outputs = words.partition(" -> ")
        self.is_address = words == "i8"
        self.places, end = _argument_places(inputs, 0)
        self.results, self._size = _argument_places(outputs, end)
        self._first = 8 * end
        self._in = Struct("=" + "".join("q" * (1 + axes) if axes else LETTERS[kind] for kind, _, axes in self.places))
        self._out = Struct("=" + "".join(LETTERS[kind] for kind, _, _ in self.results))

    def laid_out(self, arguments: tuple[Any, ...]) -> tuple[Any, list[tuple[Any, Any]]]:
        """Return the memory that a C function takes, and arrays that are not contiguous with copies that are.

        Raises
        ------
        TypeError
            An array of numbers of another kind, or with another number of axes.
        """
        numbers: list[Any] = []
        copies: list[tuple[Any, Any]] = []
        for (kind, _, axes), value in zip(self.places, arguments, strict=True):
            if not axes:
                numbers.append(value)
                continue
            if not (value.ndim == axes and value.dtype == TYPES[kind]):
                raise TypeError(f"a kernel takes an array of {kind} with {axes} axes")
            if not value.flags.c_contiguous:
                copies.append((value, value := value.copy(order="C")))
            numbers += address_of(value), *value.shape
        scratch: Any = np.empty(self._size, dtype=np.int64)
        self._in.pack_into(scratch, 0, *numbers)
        return scratch, copies

    def results_in(self, scratch: Any) -> Any:
        """Return the results that a C function has left in its memory, a number where it is one."""
        found = self._out.unpack_from(scratch, self._first)
        return found if len(found) > 1 else found[0] if found else None


def address_of(array: Any) -> int:
    """Return the address of the numbers of an array, 0 for None."""
    if array is None:
        return 0
    try:
        return ctypes.addressof(ctypes.c_char.from_buffer(array))
    except (TypeError, ValueError):  # read-only, or empty: in ten times the time
        return int(array.__array_interface__["data"][0])


def _argument_places(words: str, place: int) -> tuple[list[Place], int]:
    """Return where the arguments that are declared lie, from a place on, and the place behind them."""
    found = []
    for word in re.split(r", (?!:)", words) if words else []:
        match = re.fullmatch(WORD, word)
        if match is None:
            raise ValueError(f"{word!r} is not what a kernel takes: write 'f8[:, :], i8 -> f8', for instance")
        found.append((match[1], place, (match[2] or "").count(":")))
        place += 1 + found[-1][2]
    return found, place


class Kernel:
    """A text with its machine code.

    Attributes
    ----------
    text : function
        The text; called with floats and arrays of NumPy it computes.
    lanes : int
        Lanes that its floats stand for; 0 for those of the processor at hand.
    """

    def __init__(self, text: Callable[..., Any], words: str, lanes: int = 1) -> None:
        update_wrapper(self, text)
        self.text, self.lanes, self.signature = text, lanes, Signature(words)
        self._function: Any = None
        self._quick: Any = None
        self._work = 0.0  # steps so far
        self._keepalive: list[Any] = []  # arrays that the code reads

    @property
    def function(self) -> Any:
        """The C function of one address; made now, if it was not called before."""
        with machine_code.LOCK:
            if self._function is None:
                self._function = machine_code.function_of(self.code(), ENTRY)
            return self._function

    def function_for(self, work: float) -> Any:
        """Return the C function for so many more steps: of code that is made quickly, until better code is worth it."""
        self._work += work
        if self._function is not None or self._work >= machine_code.ENOUGH:
            return self._function or self.function
        if self._quick is None:
            with machine_code.LOCK:
                self._quick = self._quick or machine_code.function_of(self.code(), ENTRY, level=machine_code.QUICK)
        return self._quick

    @property
    def address(self) -> int:
        """The address of the C function."""
        return machine_code.pointer_address(self.function)

    def code(self) -> str:
        """Trace the text; return LLVM's."""
        t = Tracer(self.lanes or machine_code.lanes(), machine_code.is_fused())
        with tracing(t):
            t.open(ENTRY, "i64 %a0")
            self._trace(Whole("%a0"))
            t.line("ret void")
            t.close()
        self._keepalive += t.keepalive
        return t.text

    def _trace(self, address: Any) -> None:
        if self.signature.is_address:
            self.text(address)
            return
        memory = {kind: memory_at(address, kind == "i8") for kind in ("f8", "i8")}
        arguments: list[Any] = []
        for kind, place, axes in self.signature.places:
            if axes:
                at, *shape = (memory["i8"][place + k] for k in range(1 + axes))
                arguments.append(memory_at(at, kind == "i8", tuple(shape)))
            else:
                arguments.append(memory[kind][place])
        found = self.text(*arguments)
        results = found if isinstance(found, tuple) else (found,)
        for (kind, place, _), x in zip(self.signature.results, results, strict=False):
            memory[kind][place] = x

    def __call__(self, *arguments: Any) -> Any:
        """Call the machine code; return its results, a number where it is one.

        An array that is not contiguous is copied, and what became of it is copied back.

        Raises
        ------
        TypeError
            An array of numbers of another kind, or with another number of axes.
        """
        function = self._function or self.function
        if self.signature.is_address:
            return function(*arguments)
        scratch, copies = self.signature.laid_out(arguments)
        function(address_of(scratch))
        for value, copy in copies:
            if value.flags.writeable:
                value[...] = copy
        return self.signature.results_in(scratch)

    def bound(self, *arguments: Any) -> Callable[[], Any]:
        """Return a function that calls the machine code with arguments that are laid out once; arrays are contiguous.

        Raises
        ------
        TypeError
            As for a call; an array that is not contiguous.
        """
        function, (scratch, copies) = self.function, self.signature.laid_out(arguments)
        if copies:
            raise TypeError("an array is not contiguous")
        address = address_of(scratch)

        def call() -> Any:
            function(address)
            return self.signature.results_in(scratch)

        call.arguments = arguments  # type: ignore[attr-defined]  # which have to live as long
        return call

    def on_floats(self, *arguments: Any) -> Any:
        """Let the text compute with these arguments, without machine code."""
        if not self.signature.is_address:
            pairs = zip(self.signature.places, arguments, strict=True)
            arguments = tuple(a if axes else np.float64(a) if kind == "f8" else int(a) for (kind, _, axes), a in pairs)
        with np.errstate(all="ignore"):
            return self.text(*arguments)


def kernel(words: str, lanes: int = 1) -> Callable[[Callable[..., Any]], Kernel]:
    """Make a kernel of a text, given what it is called with, and the lanes that its floats stand for (`Kernel`)."""
    return lambda text: Kernel(text, words, lanes)


Text = TypeVar("Text", bound=Callable[..., Any])


def part(text: Text, is_rare: bool = False) -> Text:
    """Trace a text once for each kind of its arguments, as a function that is called: numbers go in and come out.

    What is no traced number, memory or tuple of them is a constant of the part, and must be hashable. A part cannot
    call itself. One that is rare is compiled several times as fast, and runs slower. Its numbers are the same.
    """

    @wraps(text)
    def called(*arguments: Any) -> Any:
        t = tracer()
        if t is None:
            return text(*arguments)
        numbers: list[Any] = []
        constants: list[Any] = []
        makers = [_flatten(a, numbers, constants) for a in arguments]
        given = [passed(a) for a in numbers]
        key = (text, tuple(kind for kind, _ in given), tuple(constants))
        if key not in t.made:
            t.made[key] = None
            t.made[key] = _trace_part(t, text, makers, [kind for kind, _ in given], is_rare)
        if t.made[key] is None:
            raise TraceError(f"{text.__name__} calls itself")
        name, result, count, make = t.made[key]
        line = f"call {result} @{name}({', '.join(f'{kind} {x}' for kind, x in given)})"
        if count == 0:
            t.line(line)
            return make(iter(()))
        found = t.value(line, is_pure=False)
        return make(t.value(f"extractvalue {result} {found}, {k}") for k in range(count))

    return called  # type: ignore[return-value]


def rare(text: Text) -> Text:
    """Make a part that seldom runs."""
    return part(text, True)


def _trace_part(t: Tracer, text: Any, makers: list[Any], kinds: list[str], is_rare: bool) -> tuple[Any, ...]:
    """Trace a part; return its name, the type of its results, their number, and what makes them of names."""
    name = f"part{t.number()}"
    t.open(name, ", ".join(f"{kind} %a{k}" for k, kind in enumerate(kinds)), True, is_rare)
    names = iter([f"%a{k}" for k in range(len(kinds))])
    found: list[Any] = []
    make = _flatten(text(*(maker(names) for maker in makers)), found, [])
    given = [passed(x) for x in found]
    result, value = "{" + ", ".join(kind for kind, _ in given) + "}" if given else "void", "undef"
    for k, (kind, x) in enumerate(given):
        value = t.value(f"insertvalue {result} {value}, {kind} {x}, {k}")
    t.line(f"ret {result} {value}" if given else "ret void")
    t.close(result)
    return name, result, len(given), make


def _flatten(a: Any, numbers: list[Any], constants: list[Any]) -> Callable[[Iterator[str]], Any]:
    """Take the numbers of an argument; return what makes it anew of names."""
    if isinstance(a, (tuple, View)):
        parts = a if isinstance(a, tuple) else (a._record, a._memory, a._lanes, a._stride)
        makers = [_flatten(x, numbers, constants) for x in parts]
        constants.append((type(a), len(parts)))
        made = partial(remade, a) if isinstance(a, tuple) else lambda found: View(*found)
        return lambda names: made([maker(names) for maker in makers])
    if isinstance(a, Pointer):
        numbers.append(a)
        constants.append(a.is_whole)
        shape = _flatten(a.shape, numbers, constants)
        return lambda names: Pointer(next(names), a.is_whole, shape(names))
    if isinstance(a, Traced):
        numbers.append(a)
        return lambda names: type(a)(next(names), a.n)
    constants.append(a)
    return lambda names: a
