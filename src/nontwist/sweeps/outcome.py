"""How a sweep proceeds, and the errors of sweeps and their stores."""

from __future__ import annotations

from typing import NamedTuple


class SweepError(RuntimeError):
    """Raised if blocks of a sweep fail; the others are complete. `failed` maps block numbers to reasons."""

    def __init__(self, message: str, failed: dict[int, str]) -> None:
        super().__init__(message, failed)
        self.failed = failed

    def __str__(self) -> str:
        return str(self.args[0])


class SweepStoreError(ValueError):
    """Raised for a folder that is not the store of this sweep, or was changed; the message has one line.

    Examples
    --------
    >>> from pathlib import Path
    >>> from nontwist import SweepStoreError, open_sweep
    >>> Path("empty").mkdir()
    >>> try:
    ...     open_sweep("empty")
    ... except SweepStoreError as error:
    ...     print(error)
    empty is not the store of a sweep: it is not a Zarr group with a folder blocks
    """


class DamagedBlockError(SweepStoreError):
    """A block that was changed after it was written: `where` it is, and the `reason`."""

    def __init__(self, where: str, reason: str) -> None:
        super().__init__(where, reason)
        self.reason = reason

    def __str__(self) -> str:
        return f"{self.args[0]}: {self.reason}; run the sweep again to recompute the block"


class Progress(NamedTuple):
    """The progress of a sweep."""

    done: int  #: members
    members: int
    failed: int  #: members that have failed
    rate: float  #: members a second since the beginning of this call
    left: float  #: s
