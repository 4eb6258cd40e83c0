"""`nontwist reproduce`: the paper's tables and figures, digit by digit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import Force, Opt, require_folder
from .outcomes import DIFFERS, stdout
from .summaries import print_table, shown_unit

if TYPE_CHECKING:
    from ..paper.tables import Table as PaperTable


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
        _print(table)
    console = stdout()
    numbers = [row for table in result.tables for row in table.rows]
    agreeing = sum(row.agrees for row in numbers)
    console.print(
        f"{agreeing} of {len(numbers)} printed numbers agree; all on one page: {result.page}", markup=False, emoji=False
    )
    if printed_loads:
        console.print("Loads as printed; the tables belong to loads 20 times smaller (docs/errata.md, 1).")
    else:
        console.print("Loads of cases 2 and 3: those printed over 20 (docs/errata.md, 1; see --printed-loads).")
    if not result.agrees:
        raise typer.Exit(DIFFERS)


def _print(table: PaperTable) -> None:
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
