"""Kernels that were compiled when the package was built: bitcode of LLVM, turned into code for the processor at hand.

Bitcode was optimised for a named target, x86-64-v3 or aarch64, so that code generation is all that is left: some 10 to
100 ms for a kernel, without Numba. Its IEEE operations are those of the text, on any processor; one without AVX2 gets
the same in narrower instructions, and one without FMA calls `fma` of the C library.

A damaged file would end the process, so each is compared with its hash before LLVM sees it. One that was made of
another text, or by a newer LLVM, is not used either.
"""

from __future__ import annotations

import ctypes
import json
from collections.abc import Callable
from functools import lru_cache
from hashlib import sha256
from pathlib import PurePath
from threading import RLock
from typing import Any
from zlib import decompress

from . import texts

ENTRY, MANIFEST, GZIP = "kernel", "manifest.json", 31
TARGETS = {"x86_64": "x86-64-v3", "aarch64": "aarch64", "arm64": "aarch64"}  # by the processors of triples
ROOT = PurePath(__file__).parents[1]
HOME = ROOT / "bitcode"
Function = Callable[[int], None]
_lock = RLock()
_engines: list[Any] = []  # which own the code, for as long as the process lives


class UnusableError(Exception):
    """Why there is no machine code of a kernel that was made beforehand, in words that follow its name."""


def function(module: str, name: str) -> Function:
    """Return a kernel of the package as a C function of one address; it runs without the interpreter lock.

    Raises
    ------
    UnusableError
        It is missing, damaged, unreadable, older than its text or not made for this machine.
    """
    with _lock:
        return ctypes.CFUNCTYPE(None, ctypes.c_int64)(_address(module, name))


def file_of(target: str, module: str, name: str) -> str:
    """Return the name of the file of a kernel, as the manifest lists it."""
    return f"{target}/{module.partition('.')[2]}.{name}.bc.gz"


def _address(module: str, name: str) -> int:
    about = _manifest()
    try:
        from llvmlite import binding
    except ImportError as error:
        raise UnusableError("needs llvmlite, which is not installed") from error
    processor = binding.get_process_triple().split("-")[0]
    target = TARGETS.get(processor)
    if target is None:
        raise UnusableError(f"was not made for {processor}")
    if tuple(about["llvm"]) > binding.llvm_version_info:
        raise UnusableError(f"needs LLVM {'.'.join(map(str, about['llvm']))}: pip install --upgrade llvmlite")
    file = file_of(target, module, name)
    entry = about["files"].get(file)
    if entry is None:
        raise UnusableError("is missing")
    if not _is_fresh(module):
        raise UnusableError("is older than its text")
    try:
        data = texts.read(str(HOME / file))
    except OSError as error:
        raise UnusableError(f"cannot be read ({error.strerror or 'it is not there'})") from error
    if sha256(data).hexdigest() != entry["sha256"]:
        raise UnusableError("is damaged")
    machine = _machine()
    code = binding.parse_bitcode(decompress(data, GZIP))
    code.triple, code.data_layout = machine.triple, str(machine.target_data)
    engine = binding.create_mcjit_compiler(code, machine)
    if absent := [symbol for symbol in entry["symbols"] if not _is_known(binding, symbol)]:  # an engine knows where
        raise UnusableError(f"needs {', '.join(absent)}, which this machine lacks")
    engine.finalize_object()
    _engines.append(engine)
    return int(engine.get_function_address(ENTRY))


@lru_cache
def _manifest() -> dict[str, Any]:
    try:
        found: dict[str, Any] = json.loads(texts.read(str(HOME / MANIFEST)))
        is_whole = found.keys() >= {"llvm", "texts", "files"}
    except OSError as error:
        raise UnusableError("is missing") from error
    except (ValueError, AttributeError) as error:
        raise UnusableError("is damaged") from error
    if not is_whole:
        raise UnusableError("is damaged")
    return found


@lru_cache
def _is_fresh(module: str) -> bool:
    """Whether the texts of a module are those that its bitcode was made of."""
    about = _manifest()["texts"].get(module)
    try:
        return about is not None and texts.hash_of(str(ROOT / file) for file in about["files"]) == about["sha256"]
    except OSError:  # a package without texts cannot be newer
        return True


def _machine() -> Any:
    """Return what generates code for the processor at hand, for one engine, which then owns it."""
    from llvmlite import binding

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    target = binding.Target.from_triple(binding.get_process_triple())
    name, features = processor()
    return target.create_target_machine(
        cpu=name, features=tuned(name, features) or features, opt=3, codemodel="jitdefault", jit=True
    )


@lru_cache
def processor() -> tuple[str, str]:
    """Return the name and the features of the processor at hand."""
    from llvmlite import binding

    return binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()


def tuned(name: str, features: str) -> str | None:
    """Return the features to make code for, None where they are those of the processor.

    Left alone LLVM takes vectors of 512 bits wherever there are any. On Intel's processors, for which C compilers
    prefer 256, that makes the kernels of this package, those in lanes as well, about two times slower.
    """
    wide = "+avx512f" in features.split(",") and not name.startswith("znver")
    return f"{features},+prefer-256-bit" if wide else None


def _is_known(binding: Any, symbol: str) -> bool:
    """Whether a symbol is there; for `sincos`, which glibc has, code for other systems calls what they have."""
    names = ("sin", "cos") if symbol == "sincos" else (symbol,)
    return all(binding.address_of_symbol(name) is not None for name in names)
