"""How a sweep goes, and how it ends where blocks cannot be made."""

from __future__ import annotations

from typing import NamedTuple


class SweepError(RuntimeError):
    """Blocks that cannot be made; the others are done. `failed` says why, by the numbers of the blocks."""

    def __init__(self, message: str, failed: dict[int, str]) -> None:
        super().__init__(message, failed)
        self.failed = failed

    def __str__(self) -> str:
        return str(self.args[0])


class Progress(NamedTuple):
    """How far a sweep is."""

    done: int  #: members
    members: int
    failed: int  #: members that have failed
    rate: float  #: members a second since the beginning of this call
    left: float  #: s
