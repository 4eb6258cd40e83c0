"""Where the numbers of a text write what they do: functions of LLVM in the making, line by line.

While a function is traced its numbers are names of values (`elements`), and each operator writes one line. Nothing is
inferred. A line that is repeated is written once in its region and in what that region encloses; what a variable holds
is known where it was set.
"""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

_UNSEEN = (str(Path(__file__).parent), str(Path(np.__file__).parent), contextlib.__file__, "<frozen")
_local = threading.local()  # what this thread traces


def is_text(file: str) -> bool:
    """Whether a file is outside this folder and NumPy."""
    return not file.startswith(_UNSEEN)


class TraceError(TypeError):
    """What cannot be traced: why, what to write instead, and where.

    Attributes
    ----------
    why : str
        Without the place.
    place : tuple of (str, int), optional
        File and line, if that is not where it was found.
    """

    def __init__(self, why: str, place: tuple[str, int] | None = None) -> None:
        self.why, self.place = why, place
        super().__init__(f"{why} ({_line_of_text()})")


def _line_of_text() -> str:
    """Return file and line of the innermost text, outside this folder and NumPy."""
    frame = sys._getframe(1)
    while frame.f_back is not None and not is_text(frame.f_code.co_filename):
        frame = frame.f_back
    return f"{frame.f_code.co_filename}:{frame.f_lineno}"


class Region:
    """Lines between which control may enter or leave: a function, a loop, a branch.

    Attributes
    ----------
    known : dict
        Names of values by the lines that gave them, and what slots hold.
    written : set of str
        Slots that were written.
    """

    def __init__(self, kind: str) -> None:
        self.kind, self.where, self.is_closed = kind, _line_of_text(), False
        self.known: dict[str, str] = {}
        self.written: set[str] = set()


class Function:
    """A function in the making."""

    def __init__(self, head: str) -> None:
        self.head, self.regions = head, [Region("function")]
        self.slots: list[str] = []
        self.lines: list[str] = []

    def text(self, result: str) -> str:
        """Close the function; return its text."""
        if len(self.regions) != 1:
            raise TraceError(f"break or return left the {self.regions[-1].kind} at {self.regions[-1].where}")
        self.regions[0].is_closed = True
        slots, lines = "\n  ".join(self.slots), "\n  ".join(self.lines)
        return f"define {self.head.format(result)} {{\nentry:\n  {slots}\n  br label %start\nstart:\n  {lines}\n}}\n"


class Tracer:
    """A module of LLVM in the making.

    Attributes
    ----------
    lanes : int
        How many lanes variables have that begin as plain floats.
    is_fused : bool
        Whether the processor has a fused multiply-add.
    made : dict
        Names of the parts that were traced, by what they were traced for; None while that lasts.
    keepalive : list
        What must live as long as the machine code.
    branching, converting : str
        What is said where Python would branch on a traced number, or ask for its value.
    """

    branching = (
        "what depends on traced numbers cannot steer Python: write select(condition, a, b), "
        "`for _ in when(condition)` or `for _ in whilst(...)`"
    )
    converting = "a traced number has no value yet, so it is not a float: use the functions of this language"
    has_vectors = True  # whether numbers side by side are taken at once

    def __init__(self, lanes: int, is_fused: bool) -> None:
        self.lanes, self.is_fused = lanes, is_fused
        self.made: dict[Any, Any] = {}
        self.keepalive: list[Any] = []
        self._declared: dict[str, str] = {}
        self._functions: list[str] = []
        self._open: list[Function] = []
        self._count = 0

    @property
    def function(self) -> Function:
        """The function that is written now."""
        return self._open[-1]

    @property
    def region(self) -> Region:
        """The innermost region that is open."""
        return self._open[-1].regions[-1]

    def open(self, name: str, arguments: str, is_internal: bool = False, is_rare: bool = False) -> None:
        """Begin a function; one that is rare is not optimised."""
        linkage, attributes = ("internal ", "noinline nounwind") if is_internal else ("", "nounwind")
        self._open.append(Function(f"{linkage}{{}} @{name}({arguments}) {attributes}{' optnone' * is_rare}"))

    def close(self, result: str = "void") -> None:
        """End the function that is open."""
        self._functions.append(self._open.pop().text(result))

    def number(self) -> int:
        """Return a number that no name has yet."""
        self._count += 1
        return self._count

    def line(self, text: str) -> None:
        """Write a line."""
        self.function.lines.append(text)

    def value(self, text: str, is_pure: bool = True) -> str:
        """Write ``name = text`` and return the name; a pure line that is known is not written again."""
        function = self._open[-1]
        if is_pure:
            for region in reversed(function.regions):
                name = region.known.get(text)
                if name is not None:
                    return name
        self._count += 1
        name = f"%v{self._count}"
        function.lines.append(f"{name} = {text}")
        if is_pure:
            function.regions[-1].known[text] = name
        return name

    def slot(self, kind: str, count: int = 1) -> str:
        """Return the name of memory on the stack, the same at each passage."""
        name = f"%s{self.number()}"
        self.function.slots.append(f"{name} = alloca {kind}, i64 {count}")
        return name

    def store_slot(self, kind: str, name: str, slot: str) -> None:
        """Write a value to a slot."""
        self.line(f"store {kind} {name}, ptr {slot}")
        self.region.known[slot] = name
        self.region.written.add(slot)

    def load_slot(self, kind: str, slot: str) -> str:
        """Return what a slot holds; within a loop nothing is known of what came before it."""
        for region in reversed(self.function.regions):
            if slot in region.known:
                return region.known[slot]
            if region.kind == "loop":
                break
        found = self.region.known[slot] = self.value(f"load {kind}, ptr {slot}", is_pure=False)
        return found

    def label(self, name: str) -> None:
        """Go on under a label."""
        self.line(f"br label %{name}\n{name}:")

    def in_place_of(self, name: str) -> Callable[..., Any] | None:
        """Return the text of a function of C, where there are none of these."""
        return None

    def traces(self, function: Any, arguments: tuple[Any, ...]) -> bool:
        """Trace the text of the function at an address, where functions cannot be called; return whether it did."""
        return False

    def table(self, array: Any) -> str:
        """Return the address of an array, which lives as long as the machine code."""
        self.keepalive.append(array)
        return str(array.ctypes.data)

    def declare(self, name: str, text: str) -> str:
        """Declare a function of LLVM or of the C library; return its name."""
        self._declared[name] = f"declare {text}"
        return name

    @contextmanager
    def within(self, kind: str) -> Iterator[None]:
        """Open a region. What is left by `break` stays open, which `close` refuses."""
        function, region = self.function, Region(kind)
        function.regions.append(region)
        yield
        function.regions.pop()
        region.is_closed = True
        for outer in function.regions:
            for slot in region.written:
                outer.known.pop(slot, None)
        function.regions[-1].written |= region.written

    @property
    def text(self) -> str:
        """The module."""
        return "\n".join([*self._functions, *self._declared.values(), ""])


def tracer() -> Tracer | None:
    """Return what this thread traces into, None where texts compute."""
    return getattr(_local, "tracer", None)


def writer() -> Tracer:
    """Return what this thread traces into."""
    return _local.tracer


def width() -> int:
    """Return how many lanes the kernel has that is traced; 1 where texts compute."""
    found = tracer()
    return 1 if found is None else found.lanes


@contextmanager
def tracing(into: Tracer) -> Iterator[Tracer]:
    """Let the texts of this thread write into a module."""
    before, _local.tracer = tracer(), into
    try:
        yield into
    finally:
        _local.tracer = before
