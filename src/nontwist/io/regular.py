"""Refusal of files that are not regular: reading a FIFO blocks, some devices never end; and how much memory is free."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

KINDS = ((stat.S_ISFIFO, "a FIFO"), (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"), (stat.S_ISSOCK, "a socket"))


def require_regular(path: str | os.PathLike[str]) -> None:
    """Raise an OSError where `path` is a FIFO, a device or a socket; other faults are found on opening it."""
    mode = os.stat(path).st_mode
    for is_kind, name in KINDS:
        if is_kind(mode):
            raise OSError(errno.EINVAL, f"it is {name}, not a regular file; copy its content into a file", str(path))


def free_memory() -> int:
    """Return the memory that can be taken without swapping, in bytes, within the limits of a container."""
    import psutil

    free: int = psutil.virtual_memory().available
    try:
        limit, used = (Path(f"/sys/fs/cgroup/memory.{name}").read_text(encoding="ascii") for name in ("max", "current"))
        return min(free, max(int(limit) - int(used), 0))
    except (OSError, ValueError):  # no container, or "max": no limit
        return free
