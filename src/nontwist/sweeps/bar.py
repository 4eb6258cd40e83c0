"""A bar on stderr: members done, how many a second, how long it still takes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ..driver.signals import shown
from .outcome import Progress


@contextmanager
def bar(members: int) -> Iterator[Callable[[Progress], None]]:
    """Show a bar and give what takes the `Progress`."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("members"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[words]}"))
    with shown(Bar(*columns, console=Console(stderr=True))) as one:
        task = one.add_task("members", total=members, words="")

        def report(now: Progress) -> None:
            one.update(task, completed=now.done, words=words(now))

        yield report


def words(now: Progress) -> str:
    """Return rate, time left and failures in words."""
    failures = f", {now.failed} failed" if now.failed else ""
    return f"{now.rate:.3g}/s, {duration(now.left)} left{failures}"


def duration(seconds: float) -> str:
    """Return a time span in two units at most: 70 µs, 1.2 s, 42 s, 3 min 5 s, 2 h 7 min, 3 d 4 h."""
    for size, unit in ((1e-3, "µs"), (1.0, "ms")):
        if 0 < seconds < size:
            return f"{float(f'{seconds / size * 1000:.2g}'):g} {unit}"
    if seconds < 59.5:
        return f"{seconds:.2g} s" if seconds < 9.5 else f"{seconds:.0f} s"
    s = round(seconds)
    for size, unit, smaller, name in ((86400, "d", 3600, "h"), (3600, "h", 60, "min"), (60, "min", 1, "s")):
        if s >= size:
            return f"{s // size} {unit} {s % size // smaller} {name}"
    return f"{s} s"
