"""Kernels: texts that Python calls. They are traced and compiled by their first call, once for a process.

A kernel declares what it is called with: ``@kernel("f8[:, :], i8 -> i8, f8")`` (`signatures`). A kernel of ``"i8"``
takes the address of its C function itself: a march with a block, say.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import update_wrapper
from typing import Any

import numpy as np

from . import machine_code
from .elements import Whole
from .memory import memory_at
from .signatures import Signature
from .tracing import Tracer, tracing

ENTRY = "kernel"


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
        self._kept: list[Any] = []  # arrays that the code reads

    @property
    def function(self) -> Any:
        """The C function of one address; made now, if it was not called before."""
        with machine_code.LOCK:
            if self._function is None:
                self._function = machine_code.function_of(self.code(), ENTRY)
            return self._function

    @property
    def address(self) -> int:
        """The address of the C function."""
        return int(ctypes.cast(self.function, ctypes.c_void_p).value or 0)

    def code(self, is_fused: bool | None = None) -> str:
        """Trace the text; return LLVM's."""
        t = Tracer(self.lanes or machine_code.lanes(), machine_code.is_fused() if is_fused is None else is_fused)
        with tracing(t):
            t.open(ENTRY, "i64 %a0")
            self._trace(Whole("%a0"))
            t.line("ret void")
            t.close()
        self._kept = t.kept
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
        function(scratch.__array_interface__["data"][0])
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
        address = scratch.ctypes.data

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
