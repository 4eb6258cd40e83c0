"""`nontwist reproduce` and `nontwist validate`: the tables of the paper, and every check of the package."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..validation import GROUPS
from .options import Force, Opt, require_folder, require_suffix
from .outcomes import DIFFERS, say, show
from .summaries import print_table, say_written, shown_unit

if TYPE_CHECKING:
    from ..paper.tables import Table as PaperTable
    from ..validation import Check


def reproduce_command(
    case: Annotated[list[int] | None, Opt("Case 1, 2 or 3. Repeatable.", "N", default="all", least=1, most=3)] = None,
    out: Annotated[Path, Opt("Folder for tables, figures and runs.", "FOLDER")] = Path("reproduction"),
    quick: Annotated[bool, Opt("Make the tables and one figure per case only.")] = False,
    printed_loads: Annotated[
        bool, Opt("Use the loads as printed, 20 times too large, to show how the tables then differ.")
    ] = False,
    force: Force = False,
) -> None:
    """Reproduce the three cases of the paper: six tables compared with the printed ones, four figures per case.

    Prints the tables and writes everything to OUT/case1 ... case3 and, in the order of the paper, to the page
    OUT/index.html. Exits with status 1 if a number differs.
    """
    from rich.console import Console

    from ..paper import reproduce

    require_folder(out)
    with Console(stderr=True).status("starting") as status:
        result = reproduce(
            out,
            case or (1, 2, 3),
            quick=quick,
            printed_loads=printed_loads,
            force=force,
            progress=lambda text: status.update(text),
        )
    for table in result.tables:
        _print_table(table)
    numbers = [row for table in result.tables for row in table.rows]
    agreeing = sum(row.agrees for row in numbers)
    show(f"{agreeing} of {len(numbers)} printed numbers agree; all on one page: {result.page}")
    if printed_loads:
        show("Loads as printed; the tables belong to loads 20 times smaller (docs/errata.md, 1).")
    else:
        show("Loads of cases 2 and 3: those printed over 20 (docs/errata.md, 1; see --printed-loads).")
    if not result.agrees:
        raise typer.Exit(DIFFERS)


def _print_table(table: PaperTable) -> None:
    from rich.text import Text

    rows = table.rows
    columns: dict[str, list[str] | list[Text]] = {
        "t (s)": [f"{row.time:g}" for row in rows],
        "quantity": [f"{row.quantity} ({shown_unit(row.unit)})".removesuffix(" ()") for row in rows],
        "paper": [f"{row.printed:.6f}" for row in rows],
        "computed": [f"{row.computed:.9f}" for row in rows],
        "difference": [f"{row.difference:.1e}" for row in rows],
        "verdict": [Text("agrees", "green") if row.agrees else Text("DIFFERS", "red") for row in rows],
    }
    numbers = ("t (s)", "paper", "computed", "difference")
    print_table(f"Case {table.case}: {table.title}", columns, spare=("difference", "quantity"), right=numbers)


# `nontwist validate`: every oracle of the package, measured on this machine.


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
        say_written(files)
    if as_json:
        typer.echo(result.to_json())
    else:
        for name, checks in result.groups.items():
            _print_checks(name, checks)
        show(result.summary)
    for note in result.notes:
        say(note)
    if not result.holds:
        raise typer.Exit(DIFFERS)


def _print_checks(group: str, checks: tuple[Check, ...]) -> None:
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
        show(f"[{k + 1}] {source}")
    show("")
