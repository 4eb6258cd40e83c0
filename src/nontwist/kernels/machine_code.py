"""From texts to LLVM code, line by line, and from that to machine code, in memory.

Traced code is clean: it needs three passes, where LLVM's own pipelines would take many times as long for the same
speed; nor is its code any faster at LLVM's higher levels. At the lowest it is made in a fifth of the time and takes up
to twice as long: by it kernels begin (`Kernel.function_for`). Nothing is kept on disk. LLVM is imported by the first
kernel.

While a function is traced its numbers are names of values (`elements`), and each operator writes one line. Nothing is
inferred. A line that is repeated is written once in its region and in what that region encloses; what a variable holds
is known where it was set.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

PASSES = ("sroa", "simplify_cfg", "aggressive_dce")
QUICK, LEVEL = 0, 1  # what LLVM does for speed when it chooses instructions and registers; it changes no bit
ENOUGH = 50_000  # steps that a kernel takes before code of the level is worth the time that it takes to make
LOCK = threading.RLock()  # LLVM is asked by one thread at a time, and by none while the process forks
KIND = ctypes.CFUNCTYPE(None, ctypes.c_int64)
_numbers = itertools.count()
_locked: list[Any] = []


def _before_fork() -> None:
    LOCK.acquire()
    ffi = sys.modules.get("llvmlite.binding.ffi")
    _locked.append(getattr(getattr(ffi, "lib", None), "_lock", None) or nullcontext())
    _locked[-1].__enter__()  # engines are freed under llvmlite's own lock, by whichever thread drops them


def _after_fork() -> None:
    _locked.pop().__exit__(None, None, None)
    LOCK.release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before_fork, after_in_parent=_after_fork, after_in_child=_after_fork)


@lru_cache
def binding() -> Any:
    """Return what binds LLVM, which is imported by the first call."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm


@lru_cache
def processor() -> tuple[str, str]:
    """Return the name of the processor at hand, and its features as code is made for them.

    Left alone LLVM takes vectors of 512 bits wherever there are any. On Intel's processors, for which C compilers
    prefer 256, that makes kernels about two times slower.
    """
    with LOCK:
        name, features = binding().get_host_cpu_name(), binding().get_host_cpu_features().flatten()
    if "+avx512f" in features.split(",") and not name.startswith("znver"):
        features += ",+prefer-256-bit"
    return name, features


def is_fused() -> bool:
    """Whether the processor has a fused multiply-add. Without it `fma` is a b + c: that of C takes far longer."""
    known = processor()[1].split(",")
    return "+fma" in known or ("-fma" not in known and binding().get_process_triple().startswith(("aarch64", "arm64")))


def lanes() -> int:
    """Return how many bodies march side by side: as many as two registers of doubles hold, or one of AVX.

    With the 16 registers of AVX eight bodies are no faster than four, and take twice the time to compile.
    """
    known = processor()[1].split(",")
    return 8 if "+avx512f" in known else 4 if "+avx" in known else 2


def _target(level: int) -> Any:
    llvm, (name, features) = binding(), processor()
    return llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(
        cpu=name, features=features, opt=level, codemodel="jitdefault", jit=True
    )


@lru_cache
def _engine() -> Any:
    return binding().create_lljit_compiler(_target(LEVEL))


def simplify(module: Any, target: Any) -> None:
    """Run the passes on a module for a target."""
    llvm = binding()
    module.triple, module.data_layout = target.triple, str(target.target_data)
    manager = llvm.create_new_module_pass_manager()
    for name in PASSES:
        getattr(manager, f"add_{name}_pass")()
    manager.run(module, llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options()))


def pointer_address(pointer: Any) -> int:
    """Return the address that a function pointer of ctypes holds, 0 for null."""
    return ctypes.cast(pointer, ctypes.c_void_p).value or 0


def function_of(code: str, entry: str, kind: Any = KIND, level: int | None = None) -> Any:
    """Return a function of LLVM code as one of C. It runs without the interpreter lock.

    Parameters
    ----------
    code : str
        A module.
    entry : str
        Name of the function in it.
    kind : type, optional
        Of the function, as `ctypes` has it: ``void (int64_t)``.
    level : int, optional
        `QUICK`, or by default `LEVEL`.
    """
    with LOCK:
        llvm, target = binding(), _target(LEVEL if level is None else level)
        module = llvm.parse_assembly(code)
        simplify(module, target)
        symbol = f"{entry}{next(_numbers)}"
        module.get_function(entry).name = symbol
        code = target.emit_object(module)
        builder = llvm.JITLibraryBuilder().add_object_img(code).export_symbol(symbol).add_current_process()
        owner = builder.link(_engine(), symbol)
        function: Any = kind(owner[symbol])
        function.owner = owner  # which frees the code when it goes
    return function


_FOLDERS = (str(Path(__file__).parent), str(Path(np.__file__).parent), contextlib.__file__, "<frozen")
_local = threading.local()  # what this thread traces


def is_text(file: str) -> bool:
    """Whether a file is outside this folder and NumPy."""
    return not file.startswith(_FOLDERS)


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
        self.why, self.place, found = why, place, tracer()
        if found is not None:
            found.refusals.append(self)
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


class FunctionCode:
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
    refusals : list of TraceError
        All that was refused, also where the text has caught it.
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
        self.refusals: list[TraceError] = []
        self._declared: dict[str, None] = {}
        self._functions: list[str] = []
        self._open: list[FunctionCode] = []
        self._count = 0

    @property
    def function(self) -> FunctionCode:
        """The function that is written now."""
        return self._open[-1]

    @property
    def region(self) -> Region:
        """The innermost region that is open."""
        return self._open[-1].regions[-1]

    def open(self, name: str, arguments: str, is_internal: bool = False, is_rare: bool = False) -> None:
        """Begin a function; one that is rare is not optimised."""
        linkage, attributes = ("internal ", "noinline nounwind") if is_internal else ("", "nounwind")
        self._open.append(FunctionCode(f"{linkage}{{}} @{name}({arguments}) {attributes}{' optnone' * is_rare}"))

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

    def labels(self, *words: str) -> list[str]:
        """Return words as labels that are new."""
        number = self.number()
        return [f"{word}{number}" for word in words]

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

    def declare(self, text: str) -> None:
        """Declare a function of LLVM or of the C library."""
        self._declared[f"declare {text}"] = None

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
        return "\n".join([*self._functions, *self._declared, ""])


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
def tracing(into: Tracer | None) -> Iterator[Tracer | None]:
    """Let the texts of this thread write into a module; into none they compute."""
    before, _local.tracer = tracer(), into
    try:
        yield into
    finally:
        _local.tracer = before


def lanes_of_text() -> int:
    """Return how many numbers a text takes side by side that is free to choose; 1 where it computes."""
    return 1 if tracer() is None else lanes()
