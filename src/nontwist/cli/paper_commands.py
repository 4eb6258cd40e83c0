"""`nontwist reproduce`: the paper's tables and figures, digit by digit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import Debug, Force
from .outcomes import DIFFERS, stdout

if TYPE_CHECKING:
    from ..paper.tables import Table as PaperTable


def reproduce_command(
    case: Annotated[
        list[int] | None, typer.Option(min=1, max=3, help="1, 2 or 3; repeatable.", show_default="all")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for tables, figures and runs.")] = Path("reproduction"),
    quick: Annotated[bool, typer.Option("--quick", help="Tables and one figure a case only.")] = False,
    printed_loads: Annotated[
        bool,
        typer.Option(
            "--printed-loads",
            help="Take the loads as printed, 20 times too large, to see by how much the tables are missed.",
        ),
    ] = False,
    force: Force = False,
    debug: Debug = False,
) -> None:
    """Reproduce the paper: three cases, six tables beside the printed ones, five figures a case.

    Tables go to stdout, everything to OUT/case1 ... case3 and, in the order of the paper, to the page OUT/index.html.
    Exit code 1 when a number does not agree.
    """
    from rich.console import Console

    from ..paper import reproduce

    with Console(stderr=True).status("starting") as status:
        result = reproduce(
            out,
            case or (1, 2, 3),
            quick=quick,
            printed_loads=printed_loads,
            force=force,
            progress=lambda text: status.update(text),
        )
    console = stdout()
    for table in result.tables:
        console.print(_rich(table))
    numbers = [row for table in result.tables for row in table.rows]
    agreeing = sum(row.agrees for row in numbers)
    console.print(f"{agreeing} of {len(numbers)} printed numbers agree; all on one page: {result.page}", markup=False)
    if printed_loads:
        console.print("Loads as printed; the tables belong to loads 20 times smaller (docs/errata.md, 1).")
    else:
        console.print("Loads of cases 2 and 3: those printed over 20 (docs/errata.md, 1; see --printed-loads).")
    if not result.agrees:
        raise typer.Exit(DIFFERS)


def _rich(table: PaperTable) -> object:
    from rich.table import Table

    shown = Table(title=f"Case {table.case}: {table.title}", title_justify="left")
    shown.add_column("t (s)", justify="right")
    shown.add_column("quantity")
    for name in ("paper", "computed", "difference"):
        shown.add_column(name, justify="right", no_wrap=True)
    shown.add_column("verdict")
    for k, row in enumerate(table.rows):
        name = row.quantity if row.unit == "1" else f"{row.quantity} ({row.unit})"
        verdict = "[green]agrees[/green]" if row.agrees else "[red]DIFFERS[/red]"
        numbers = (f"{row.printed:.6f}", f"{row.computed:.9f}", f"{row.difference:.1e}")
        last = k + 1 == len(table.rows) or table.rows[k + 1].time != row.time
        shown.add_row(f"{row.time:g}", name, *numbers, verdict, end_section=last and len(table.rows) > 5)
    return shown
