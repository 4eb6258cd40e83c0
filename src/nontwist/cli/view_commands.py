"""`nontwist view`: a page on which runs can be watched."""

from __future__ import annotations

import warnings
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from .options import Force
from .outcomes import say


def view_command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run, NetCDF.")],
    other: Annotated[Path | None, typer.Argument(metavar="[RUN2]", help="A second run, shown beside it.")] = None,
    out: Annotated[Path | None, typer.Option(help="The page to write; RUN-view.html here by default.")] = None,
    show: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in the browser.")] = True,
    force: Force = False,
) -> None:
    """Write a page on which one or two runs can be watched, offline: sphere, body, frame, twist, momenta, energy.

    One HTML file of about 5 MB. Exit code 3 for a file that is no run, 5 for one that cannot be read or
    written, or that exists.
    """
    from ..io import open_run
    from ..io.whole import require_free
    from ..viewer import view

    target = out or Path(f"{run.stem}-view.html")
    require_free(target, force=force)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        runs = [open_run(path) for path in ([run] if other is None else [run, other])]
        page = view(*runs)
    for warning in caught:
        say(f"warning: {warning.message}")
    written = page.save(target, force=force)
    say(f"written: {written} ({len(page.html.encode()) / 1e6:.1f} MB)")
    if show and not webbrowser.open(written.resolve().as_uri()):
        say(f"no browser was found; open {written} in one")
