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
