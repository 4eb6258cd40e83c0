"""From the LLVM code of a text to machine code, in memory: a few passes, the processor at hand, one engine.

Traced code is clean: it needs three passes, where LLVM's own pipelines would take many times as long for the same
speed; nor is its code any faster at LLVM's higher levels, where it is made in 1.4 times the time. Nothing is kept on
disk. LLVM is imported by the first kernel.
"""

from __future__ import annotations

import ctypes
import itertools
import os
import sys
import threading
from contextlib import nullcontext
from functools import lru_cache
from typing import Any

PASSES = ("sroa", "simplify_cfg", "aggressive_dce")
LEVEL = 1  # of what LLVM does for speed when it chooses instructions and registers; bits are the same at every one
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


def is_fused(features: str | None = None) -> bool:
    """Whether the processor has a fused multiply-add. Without it `fma` is a b + c: that of C takes far longer."""
    known = (processor()[1] if features is None else features).split(",")
    return "+fma" in known or ("-fma" not in known and binding().get_process_triple().startswith(("aarch64", "arm64")))


def lanes() -> int:
    """Return how many bodies march side by side: as many as two registers of doubles hold, or one of AVX.

    With the 16 registers of AVX eight bodies are no faster than four, and take twice the time to compile.
    """
    known = processor()[1].split(",")
    return 8 if "+avx512f" in known else 4 if "+avx" in known else 2


def _target(features: str | None) -> Any:
    llvm, (name, known) = binding(), processor()
    return llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(
        cpu=name, features=known if features is None else features, opt=LEVEL, codemodel="jitdefault", jit=True
    )


@lru_cache
def _engine(features: str | None) -> Any:
    return binding().create_lljit_compiler(_target(features))


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


def function_of(code: str, entry: str, features: str | None = None, kind: Any = KIND) -> Any:
    """Return a function of LLVM code as one of C. It runs without the interpreter lock.

    Parameters
    ----------
    code : str
        A module.
    entry : str
        Name of the function in it.
    features : str, optional
        Of the processor, in place of those of the one at hand.
    kind : type, optional
        Of the function, as `ctypes` has it: ``void (int64_t)``.
    """
    with LOCK:
        llvm, target = binding(), _target(features)
        module = llvm.parse_assembly(code)
        simplify(module, target)
        symbol = f"{entry}{next(_numbers)}"
        module.get_function(entry).name = symbol
        code = target.emit_object(module)
        builder = llvm.JITLibraryBuilder().add_object_img(code).export_symbol(symbol).add_current_process()
        owner = builder.link(_engine(features), symbol)
        function: Any = kind(owner[symbol])
        function.owner = owner  # which frees the code when it goes
    return function
