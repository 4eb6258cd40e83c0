"""SIGTERM and SIGHUP interrupt a run as Ctrl-C does, so that the completed part is kept."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress


@contextmanager
def sigterm_interrupts() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise a KeyboardInterrupt in the block, in the main thread, so that partial runs are kept.

    The first signal counts; later ones are ignored until the block ends, because a terminal that closes and a service
    manager that stops a service send several. A signal that is ignored already, as under ``nohup``, stays ignored.

    Raises
    ------
    ValueError
        Outside of the main thread, where Python takes no signals.
    """
    known = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    handlers = {number: signal.getsignal(number) for number in known}
    before = {number: handler for number, handler in handlers.items() if handler not in (signal.SIG_IGN, None)}

    def interrupt(number: int, frame: FrameType | None) -> None:
        for one in before:
            signal.signal(one, signal.SIG_IGN)
        raise KeyboardInterrupt(f"interrupted ({signal.Signals(number).name})")

    try:
        for number in before:
            signal.signal(number, interrupt)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def shown_bar(bar: Progress) -> Iterator[Progress]:
    """Show a bar; a terminal that closes meanwhile raises no error."""
    bar.start()
    try:
        yield bar
    finally:
        with suppress(OSError):
            bar.stop()
