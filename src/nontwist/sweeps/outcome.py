"""How a sweep proceeds, and the errors of sweeps and their stores."""

from __future__ import annotations

from typing import NamedTuple

from ..errors import SweepStoreError


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
