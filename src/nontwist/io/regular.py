"""Files to read are regular ones: a FIFO waits for a writer for ever, and some devices never end."""

from __future__ import annotations

import errno
import os
import stat

KINDS = ((stat.S_ISFIFO, "a FIFO"), (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"), (stat.S_ISSOCK, "a socket"))


def require_regular(path: str | os.PathLike[str]) -> None:
    """Raise an OSError where `path` is a FIFO, a device or a socket; what is wrong otherwise, opening it tells."""
    mode = os.stat(path).st_mode
    for is_kind, name in KINDS:
        if is_kind(mode):
            raise OSError(errno.EINVAL, f"it is {name}, not a regular file; copy its content into a file", str(path))
