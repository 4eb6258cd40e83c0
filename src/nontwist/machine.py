"""What this process may use of the machine: memory and cores; and properties that do not hinder it when it forks."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from contextlib import nullcontext
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from functools import cached_property as cached_property
else:

    class cached_property(functools.cached_property):  # noqa: N801
        """That of Python 3.12: without the lock of 3.11, which a process forked meanwhile would find taken."""

        def __init__(self, function: Callable[[Any], Any]) -> None:
            super().__init__(function)
            self.lock = nullcontext()


def library(name: str, missing: str) -> Any:
    """Import a library that need not be there; an ImportError says what is `missing`, and how to install it."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(missing, name=name) from error


def free_memory() -> int:
    """Return the memory that can be taken without swapping, in bytes, within the limits of a container."""
    import psutil

    free: int = psutil.virtual_memory().available
    try:
        limit, used = (Path(f"/sys/fs/cgroup/memory.{name}").read_text(encoding="ascii") for name in ("max", "current"))
        return min(free, max(int(limit) - int(used), 0))
    except (OSError, ValueError):  # no container, or "max": no limit
        return free


def cores() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
