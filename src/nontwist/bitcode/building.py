"""The bitcode of all kernels, and the manifest that goes with it.

Kernels are on the list by being declared with `@kernel`. Those of one module are lowered in one process, since they
share what they call, and modules in several. A module is built anew where its text has changed.
"""

from __future__ import annotations

import gc
import json
import os
import re
import sys
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from gzip import compress
from hashlib import sha256
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from ..geometry import texts
from ..geometry.compiled import Kernel, numba
from ..geometry.machine_code import HOME, MANIFEST, ROOT, file_of
from . import lowering
from .lowering import TARGETS, bitcode, lowered

Files = dict[str, tuple[bytes, dict[str, Any]]]
FIRST = ("gauss_linear",)


def modules() -> list[str]:
    """Return the modules of the package that declare kernels for Numba, those that take longest first."""
    package, root = ROOT.name, Path(ROOT)
    found = [
        ".".join(path.relative_to(root).with_suffix("").parts)
        for path in sorted(root.rglob("*.py"))
        if re.search(r"^from \S*\bcompiled import .*\bkernel\b", path.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    order = {name: number for number, name in enumerate(FIRST)}
    return [f"{package}.{name}" for name in sorted(found, key=lambda name: order.get(name.split(".")[-1], len(FIRST)))]


def kernels(module: str) -> dict[str, Kernel]:
    """Return the kernels that a module declares."""
    found = vars(import_module(module)).items()
    return {k: v for k, v in found if isinstance(v, Kernel) and v.is_kernel and v.__module__ == module}


def build_module(module: str) -> tuple[str, dict[str, Any], Files]:
    """Return the module, what its kernels are made of, and their files with what the manifest says of them."""
    gc.disable()  # a fifth of the time of Numba
    own, made = kernels(module), Files()
    paths = texts.files(module)
    facts = {"files": _inside(paths), "sha256": texts.hash_of(paths)}
    for name, kernel in own.items():
        code = lowered(kernel)
        for target in TARGETS:
            whole, symbols = bitcode(code, target, kernel.unroll, kernel.vectorize)
            data = compress(whole, mtime=0)
            made[file_of(target, module, name)] = data, {"sha256": sha256(data).hexdigest(), "symbols": symbols}
    return module, facts, made


def build(workers: int | None = None) -> list[str]:
    """Make the bitcode that is missing or stale, in several processes; return the modules that were built."""
    home, about = Path(HOME), _known()
    wanted = modules()
    stale = [module for module in wanted if not _is_fresh(about, home, module)]
    if stale:
        print(f"compiling the kernels of {len(stale)} modules for {', '.join(TARGETS)}", file=sys.stderr, flush=True)
    about["texts"] = {module: facts for module, facts in about["texts"].items() if module in wanted}
    with ProcessPoolExecutor(workers or os.cpu_count(), mp_context=get_context("spawn")) as pool:
        for done in as_completed([pool.submit(build_module, module) for module in stale]):
            module, facts, made = done.result()
            print(f"  {module}: {len(made)} files", file=sys.stderr, flush=True)
            about["texts"][module] = facts
            for file, (data, entry) in made.items():
                (home / file).parent.mkdir(exist_ok=True)
                (home / file).write_bytes(data)
                about["files"][file] = entry
            _write(home / MANIFEST, about)  # so that what is done stays, should the rest fail
    keep = {file_of(target, module, name) for module in wanted for name in kernels(module) for target in TARGETS}
    about["files"] = {file: about["files"][file] for file in sorted(keep)}
    for path in home.rglob("*.bc.gz"):
        if path.relative_to(home).as_posix() not in keep:
            path.unlink()
    _write(home / MANIFEST, about)
    return stale


def _write(path: Path, about: dict[str, Any]) -> None:
    whole = path.with_suffix(".part")
    whole.write_text(json.dumps(about, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    whole.replace(path)


def _known() -> dict[str, Any]:
    """Return what the manifest of an earlier build says, no file where there is none or it was made otherwise."""
    from llvmlite import binding

    made_by = {"numba": numba().__version__, "lowering": sha256(Path(lowering.__file__).read_bytes()).hexdigest()}
    how = {"llvm": list(binding.llvm_version_info), "made_by": made_by}
    with suppress(OSError, ValueError):
        about: dict[str, Any] = json.loads((Path(HOME) / MANIFEST).read_text(encoding="utf-8"))
        if {name: about.get(name) for name in how} == how:
            return about
    return {**how, "texts": {}, "files": {}}


def _is_fresh(about: dict[str, Any], home: Path, module: str) -> bool:
    """Whether the files of a module are there as the manifest says, made of the text as it is."""
    names, paths = kernels(module), texts.files(module)
    if about["texts"].get(module) != {"files": _inside(paths), "sha256": texts.hash_of(paths)}:
        return False
    files = [file_of(target, module, name) for name in names for target in TARGETS]
    return all(file in about["files"] and _has(home / file, about["files"][file]["sha256"]) for file in files)


def _inside(paths: Iterable[str]) -> list[str]:
    return [Path(path).relative_to(ROOT).as_posix() for path in paths]


def _has(path: Path, digest: str) -> bool:
    return path.is_file() and sha256(path.read_bytes()).hexdigest() == digest
