"""`nontwist validate`: every oracle of the package, measured on this machine."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..validation import GROUPS
from .options import Force, Opt, require_suffix
from .outcomes import DIFFERS, say, stdout
from .summaries import print_table

if TYPE_CHECKING:
    from ..validation import Check

WORKERS = min(2, os.cpu_count() or 1)


def _known(groups: list[str] | None) -> list[str] | None:
    if unknown := [name for name in groups or () if name not in GROUPS]:
        raise typer.BadParameter(f"{unknown[0]!r} is not one of {', '.join(GROUPS)}")
    return groups


def validate_command(
    group: Annotated[
        list[str] | None, Opt(f"One of {', '.join(GROUPS)}. Repeatable.", "NAME", default="all", check=_known)
    ] = None,
    as_json: Annotated[bool, Opt("Print JSON with every digit instead of tables.", option="--json")] = False,
    page: Annotated[
        Path | None, Opt("Write a summary to this file (.md), and all checks beside it (.json).", "PATH")
    ] = None,
    force: Force = False,
) -> None:
    """Check this installation against printed digits, closed forms, invariants and independent solutions.

    Prints tables. Exits with status 1 if a check fails. All groups take about a minute, longer on the first run.
    """
    from rich.console import Console

    from ..io.whole import require_free, written
    from ..validation import validate

    if page is not None:
        require_suffix(page, ".md", option="--page")
        files = page, page.with_suffix(".json")
        for file in files:
            require_free(file, force=force)
    errors = Console(stderr=True)
    with errors.status("starting") as status:
        result = validate(group or None, workers=WORKERS, progress=status.update)
    if page is not None:
        for file, text in zip(files, (result.to_markdown(files[1].name), result.to_json() + "\n"), strict=True):
            with written(file, force=force) as stream:
                stream.write(text.encode())
            errors.print(f"written: {file}", markup=False, emoji=False)
    if as_json:
        typer.echo(result.to_json())
    else:
        for name, checks in result.groups.items():
            _print(name, checks)
        stdout().print(result.summary, markup=False, emoji=False)
    for note in result.notes:
        say(note)
    if not result.holds:
        raise typer.Exit(DIFFERS)


def _print(group: str, checks: tuple[Check, ...]) -> None:
    from rich.text import Text

    from ..validation.report import numbers, verdict

    sources = list(dict.fromkeys(check.source for check in checks))
    expected, measured, tolerance = zip(*map(numbers, checks), strict=True)
    columns = {
        "check": [check.name for check in checks],
        "expected": expected,
        "measured": measured,
        "tolerance": tolerance,
        "verdict": [Text(verdict(check), "green" if check.holds else "bold red") for check in checks],
        "source": [f"[{sources.index(check.source) + 1}]" for check in checks],
    }
    print_table(group, columns, spare=("source",), right=("expected", "measured", "tolerance", "source"))
    for k, source in enumerate(sources):
        stdout().print(f"[{k + 1}] {source}", markup=False, emoji=False)
    stdout().print()
