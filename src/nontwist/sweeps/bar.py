"""A bar on stderr: members done, rate, time left."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ..driver.costs import duration
from ..driver.signals import shown_bar
from .outcome import Progress


@contextmanager
def bar(members: int) -> Iterator[Callable[[Progress], None]]:
    """Show a bar, on a terminal until the end; yield the function that takes a `Progress`."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("members"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[words]}"))
    console = Console(stderr=True)
    with shown_bar(Bar(*columns, console=console, transient=console.is_terminal)) as one:
        task = one.add_task("members", total=members, words="")

        def report(now: Progress) -> None:
            one.update(task, completed=now.done, words=words(now))

        yield report


def words(now: Progress) -> str:
    """Return rate, time left and failures in words."""
    failures = f", {now.failed} failed" if now.failed else ""
    return f"{now.rate:.3g}/s, {duration(now.left)} left{failures}"
