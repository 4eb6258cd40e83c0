"""SIGTERM, which job schedulers and `kill` send, as what Ctrl-C does: the part done is kept."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def sigterm_interrupts() -> Iterator[None]:
    """Let SIGTERM raise a KeyboardInterrupt in the block, in the main thread: a run stops with `SimulationInterrupt`.

    Raises
    ------
    ValueError
        Outside of the main thread, where Python takes no signals.
    """

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt("SIGTERM")

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
