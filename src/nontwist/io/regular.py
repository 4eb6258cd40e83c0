"""Refusal of files that are not regular: reading a FIFO blocks, and some devices never end."""

from __future__ import annotations

import errno
import os
import stat

KINDS = ((stat.S_ISFIFO, "a FIFO"), (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"), (stat.S_ISSOCK, "a socket"))


def require_regular(path: str | os.PathLike[str]) -> None:
    """Raise an OSError where `path` is a FIFO, a device or a socket; other faults are found on opening it."""
    mode = os.stat(path).st_mode
    for is_kind, name in KINDS:
        if is_kind(mode):
            raise OSError(errno.EINVAL, f"it is {name}, not a regular file; copy its content into a file", str(path))


def free_memory() -> int:
    """Return the memory that can be taken without swapping, in bytes."""
    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            lines = dict(line.split(":") for line in file)
        return int(lines["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):  # not Linux: physical memory, where the system tells
        names = getattr(os, "sysconf_names", {})
        if "SC_PHYS_PAGES" not in names:
            return 2**62
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
