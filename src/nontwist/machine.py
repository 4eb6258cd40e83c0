"""What this process may use of the machine: memory and cores."""

from __future__ import annotations

import os
from pathlib import Path


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
