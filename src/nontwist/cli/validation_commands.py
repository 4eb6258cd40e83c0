"""`nontwist validate`: every oracle of the package, measured on this machine."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..validation import GROUPS
from .options import Force
from .outcomes import DIFFERS

if TYPE_CHECKING:
    from ..validation import Check

WORKERS = min(2, os.cpu_count() or 1)


def _known(groups: list[str] | None) -> list[str] | None:
    if unknown := [name for name in groups or () if name not in GROUPS]:
        raise typer.BadParameter(f"{unknown[0]!r} is none of {', '.join(GROUPS)}")
    return groups


def validate_command(
    group: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", callback=_known, help=f"One of {', '.join(GROUPS)}; repeatable. (default: all)"),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON with every digit instead of tables.")] = False,
    page: Annotated[Path | None, typer.Option(help="Write the page of the documentation to this file.")] = None,
    force: Force = False,
) -> None:
    """Validate this installation: printed digits, closed forms, invariants, measured orders, independent solutions.

    Tables go to stdout. Exit code 1 when a check fails. All groups take about a minute, longer on the first run.
    """
    from rich.console import Console

    from ..io.whole import require_free, written
    from ..validation import validate

    if page is not None:
        require_free(page, force=force)
    errors, console = Console(stderr=True), Console()
    with errors.status("starting") as status:
        result = validate(group or None, workers=WORKERS, progress=status.update)
    if page is not None:
        with written(page, force=force) as file:
            file.write(result.to_markdown().encode())
        errors.print(f"written: {page}", markup=False)
    if as_json:
        typer.echo(result.to_json())
    else:
        for name, checks in result.groups.items():
            console.print(_rich(name, checks), "")
        console.print(result.summary, markup=False)
    if not result.holds:
        raise typer.Exit(DIFFERS)


def _rich(group: str, checks: tuple[Check, ...]) -> object:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from ..validation.report import numbers, verdict

    sources = list(dict.fromkeys(check.source for check in checks))
    listed = "\n".join(f"[{k + 1}] {source}" for k, source in enumerate(sources))
    shown = Table(title=group, title_justify="left", box=box.SIMPLE_HEAD, padding=0, pad_edge=False)
    shown.caption, shown.caption_justify = Text(listed), "left"
    shown.add_column("check")
    for name in ("expected", "measured", "tolerance"):
        shown.add_column(name, justify="right", no_wrap=True)
    shown.add_column("verdict")
    shown.add_column("source", justify="right")
    for check in checks:
        words = Text(verdict(check), "green" if check.holds else "bold red")
        shown.add_row(Text(check.name), *numbers(check), words, Text(f"[{sources.index(check.source) + 1}]"))
    return shown
