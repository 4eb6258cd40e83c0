"""Atomic writes of files and folders, by one process at a time; every writer of the package uses them.

A file is written under a temporary name beside its place, forced to the disk and renamed: after a kill or a power cut
there is all of it or none. A lock file beside it keeps a second writer out; the lock ends with its process.
The remains of a killed process, ``.NAME.part`` and ``.NAME.lock``, are removed by the next writer of NAME.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from ..errors import ExistingFileError

# Refusal of files that are not regular: reading a FIFO blocks, some devices never end.

KINDS = ((stat.S_ISFIFO, "a FIFO"), (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"), (stat.S_ISSOCK, "a socket"))


def require_regular(path: str | os.PathLike[str]) -> None:
    """Raise an OSError where `path` is a FIFO, a device or a socket; other faults are found on opening it."""
    mode = os.stat(path).st_mode
    for is_kind, name in KINDS:
        if is_kind(mode):
            raise OSError(errno.EINVAL, f"it is {name}, not a regular file; copy its content into a file", str(path))


@contextmanager
def written(path: str | os.PathLike[str], *, force: bool = False) -> Iterator[BinaryIO]:
    """Yield a file whose content appears at `path` when it is complete and on the disk.

    Raises
    ------
    FileExistsError
        There is a file of this name, and `force` was not given.
    BlockingIOError
        Another process holds it.
    OSError
        There is no such folder, it cannot be written, it is full, or the place is a folder or a device; nothing is left
        behind.
    """
    with reserved_path(path, force=force) as place, atomic_file(place) as file:
        yield file


def require_free(*paths: str | os.PathLike[str], force: bool = False) -> None:
    """Raise the errors of `written` at once, before long work."""
    for path in paths:
        with reserved_path(path, force=force):
            pass


@contextmanager
def reserved_path(path: str | os.PathLike[str], *, force: bool = False) -> Iterator[Path]:
    """Lock an output for this process, and yield its real path; errors as in `written`.

    Notes
    -----
    Where the file system refuses locks, there is none.
    """
    place = Path(os.path.realpath(path))
    if not place.parent.is_dir():
        raise FileNotFoundError(f"there is no folder {place.parent}; make it first")
    if place.exists() and not place.is_file():
        raise OSError(f"{path} is not a file that could be replaced; choose another name")
    with locked(place, str(path)):
        if place.exists() and not force:
            raise ExistingFileError("exists", path=path)
        yield place


@contextmanager
def atomic_file(place: Path) -> Iterator[BinaryIO]:
    """Yield a file that appears at `place` when it is complete and on the disk."""
    with atomic_path(place) as temporary, open(temporary, "wb") as file:
        yield file
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def atomic_path(place: Path) -> Iterator[Path]:
    """Yield a temporary path beside `place`; what is made there, a file or a new folder, is renamed when complete.

    Errors of the system name `place`.
    """
    temporary = place.with_name(f".{place.name}.part")
    try:
        _remove(temporary)
        yield temporary
        os.replace(temporary, place)
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(place)) from error
    finally:
        _remove(temporary)
    with contextlib.suppress(OSError):  # the new name outlives a power cut, where the system can force a folder
        entry = os.open(place.parent, os.O_RDONLY)
        try:
            os.fsync(entry)
        finally:
            os.close(entry)


def _remove(place: Path) -> None:
    if place.is_dir():
        shutil.rmtree(place, ignore_errors=True)
    else:
        place.unlink(missing_ok=True)


@contextmanager
def locked(place: Path, name: str) -> Iterator[None]:
    """Lock a path for this process; a BlockingIOError where another process holds it."""
    lock = place.with_name(f".{place.name}.lock")
    file = _lock(lock, name)
    try:
        yield
    finally:
        if os.name == "posix":
            lock.unlink(missing_ok=True)  # while it is locked: the next writer creates a new one
        os.close(file)
        if os.name != "posix":
            with contextlib.suppress(OSError):  # another process has opened it
                lock.unlink(missing_ok=True)


def _lock(lock: Path, name: str) -> int:
    from portalocker import LOCK_EX, LOCK_NB, AlreadyLocked, LockException
    from portalocker import lock as lock_file

    while True:
        try:
            file = os.open(lock, os.O_CREAT | os.O_RDWR, 0o666)
        except OSError as error:
            raise OSError(error.errno, error.strerror, name) from None
        try:
            lock_file(file, LOCK_EX | LOCK_NB)
        except AlreadyLocked:
            os.close(file)
            raise BlockingIOError(f"another process is writing {name}; wait for it, or choose another name") from None
        except LockException:  # a file system without locks
            return file
        if _is_still(lock, file):
            return file
        os.close(file)


def _is_still(lock: Path, file: int) -> bool:
    """Whether `lock` is the open `file`, not one that its holder has removed meanwhile."""
    try:
        return os.path.samestat(os.stat(lock), os.fstat(file))
    except FileNotFoundError:
        return False
