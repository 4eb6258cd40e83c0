"""The texts that a kernel is made of, and their hash: machine code that was made of others is not used."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterable
from enum import Enum
from functools import lru_cache
from hashlib import sha256
from importlib.util import resolve_name
from typing import Any

from . import elements


def read(path: str) -> bytes:
    """Return the bytes of a file of the package, which may lie in an archive that Python imports from.

    Raises
    ------
    OSError
        It is not there, or cannot be read.
    """
    loader: Any = sys.modules[__name__.split(".")[0]].__spec__.loader  # type: ignore[union-attr]
    found: bytes = loader.get_data(path)
    return found


def hash_of(paths: Iterable[str]) -> str:
    """Return the hash of the texts in these files."""
    return sha256(b"\0".join(map(read, paths))).hexdigest()


@lru_cache
def files(module: str) -> tuple[str, ...]:
    """Return the files of the texts that the kernels of a module are made of: its own, and those it imports from.

    Followed is what a kernel takes over when it is compiled: kernels, numbers, tuples of them, enumerations and what
    `elements` lowers, as they are imported by name at the beginning of a text.
    """
    found = dict[str, None]()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        path = getattr(sys.modules[name], "__file__", None)
        if path is None or path in found:
            continue
        found[path] = None
        for node in ast.parse(read(path)).body:
            if isinstance(node, ast.ImportFrom):
                package = sys.modules[name].__package__ or ""
                home = resolve_name("." * node.level + (node.module or ""), package) if node.level else node.module
                if home in sys.modules and any(_is_frozen(vars(sys.modules[home]).get(a.name)) for a in node.names):
                    waiting.append(home)
    return tuple(sorted(found))


def _is_frozen(value: Any) -> bool:
    from .compiled import Kernel

    is_enumeration = isinstance(value, type) and issubclass(value, Enum)
    is_element = getattr(value, "__module__", None) == elements.__name__
    return isinstance(value, (Kernel, int, float, tuple)) or is_enumeration or is_element
