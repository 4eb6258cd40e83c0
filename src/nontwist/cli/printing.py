"""What commands print: data on stdout, as tables for people and JSON for programs; messages on stderr."""

from __future__ import annotations

import re
import shlex
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import chain
from typing import TYPE_CHECKING, Any, Literal

from ..errors import ShellOptions, Worded
from ..geometry.values import counted

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text
    from xarray import Dataset as Dataset
else:  # which is slow to import, for annotations
    Dataset = Any

imported: list[str] = []  # the modules that the running command has imported with --import
RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def words(said: Any) -> str:
    """Return an error or a warning in the words of a command line."""
    return said.worded(ShellOptions()) if isinstance(said, Worded) else str(said)


def say(text: str, style: str = "") -> None:
    """Print a message on stderr, in colour where that is wanted; one that cannot be shown is no error."""
    from rich.console import Console

    with suppress(OSError):
        Console(stderr=True, highlight=False).print(text, style=style, markup=False, emoji=False, soft_wrap=True)


def stdout() -> Console:
    """Return where data is printed; a closed pipe raises BrokenPipeError there."""
    from rich.console import Console

    class Stdout(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    return Stdout(highlight=False)


def show(text: str) -> None:
    """Print a line of data as it is, but for line breaks."""
    stdout().print(text, markup=False, emoji=False)


@contextmanager
def printed_warnings(subject: object = "") -> Iterator[None]:
    """Print warnings on stderr as they come, each once, with what they are about, as the name of a file."""
    printed, about_it = set[str](), f"{subject}: " if str(subject) else ""

    def told(message: Warning | str, *where: Any, **more: Any) -> None:
        if str(message) not in printed:
            say(f"{about_it}warning: {words(message)}", "yellow")
        printed.add(str(message))

    with warnings.catch_warnings(action="always", category=UserWarning):
        warnings.showwarning = told
        yield


def say_next(*commands: Sequence[object], sets: Sequence[str] | None = None, done: str = "") -> None:
    """Say what was done, and what may be typed next: commands by their words, with the same --set and --import."""
    again = [("--set", one) for one in sets or ()] + [("--import", module) for module in imported]
    typed = ", ".join(shlex.join(["nontwist", *map(str, words), *chain(*again)]) for words in commands)
    say("; ".join(filter(None, (done, f"next: {typed}" * bool(commands)))))


def say_written(places: Iterable[object], *commands: Sequence[object]) -> None:
    """Say which files were written, and what may be typed next."""
    say_next(*commands, done=f"written: {', '.join(map(str, places))}")


def print_variables(variables: Mapping[str, Mapping[str, Any]], spare: tuple[str, ...], **more: list[str]) -> None:
    """Print names, units and meanings of variables, and further columns of words before the meanings."""
    about = variables.values()
    columns = {"name": [*variables], "unit": [shown_unit(one["units"]) for one in about]}
    print_table("variables", columns | more | {"meaning": [one["long_name"] for one in about]}, spare=spare)


def print_rows(title: str, rows: dict[str, str]) -> None:
    """Print a title and two columns."""
    print_table(title, {"": list(rows), " ": list(rows.values())})


def print_table(
    title: str, columns: Mapping[str, Sequence[str | Text]], spare: tuple[str, ...] = (), right: tuple[str, ...] = ()
) -> None:
    """Print columns by their headings, without a line of headings where they are blank.

    No word is cut: lines are broken between words, and where there is no room the columns `spare` are left out, the
    first one first. Only a word that is wider than the terminal is broken, in the last column.

    Parameters
    ----------
    title : str
    columns : mapping from str to sequence of str or Text
    spare : tuple of str, optional
        Headings of columns that may be left out.
    right : tuple of str, optional
        Headings of columns that are aligned on the right.
    """
    from rich.table import Table
    from rich.text import Text

    console = stdout()
    kept = {
        heading: [cell if isinstance(cell, Text) else Text(cell) for cell in cells]
        for heading, cells in columns.items()
    }
    spared = list(spare)
    while (widths := widths_within(kept, console.width - 3 * len(kept) - 1, folded=not spared)) is None and spared:
        del kept[spared.pop(0)]
    headed = any(heading.strip() for heading in kept)
    table = Table(show_header=headed)
    for heading, width in zip(kept, widths or [8] * len(kept), strict=True):
        justify: Literal["left", "right"] = "right" if heading in right else "left"
        table.add_column(heading, width=width, justify=justify, overflow="fold")
    for row in zip(*kept.values(), strict=True):
        table.add_row(*row)
    console.print(Text(title, style="table.title"))  # as wide as the terminal, not as the table
    console.print(table)


def print_fitting(table: Table) -> None:
    """Print a table of numbers; where the terminal is too narrow its last columns are left out, drifts first."""
    from rich.measure import Measurement

    console, dropped = stdout(), []
    wide = console.options.update(width=10**4)
    while len(table.columns) > 2 and Measurement.get(console, wide, table).maximum > console.width:
        drifts = [one for one in table.columns[2:] if str(one.header).startswith(("drift", "twist"))]
        one = (drifts or table.columns)[-1]
        dropped.append(" ".join(str(one.header).split()))
        table.columns.remove(one)
        for k, column in enumerate(table.columns):
            column._index = k
    console.print(table)
    if dropped:
        say(f"a wider terminal shows {counted(len(dropped), 'more column')}: {', '.join(reversed(dropped))}")


def widths_within(columns: Mapping[str, Sequence[str | Text]], room: int, folded: bool = False) -> list[int] | None:
    """Return widths of columns that fill `room` at most and cut no word, None where there are none.

    With `folded` words of the last column may be cut.
    """
    from rich.cells import cell_len

    texts = [[heading, *map(str, cells)] for heading, cells in columns.items()]
    least = [max((cell_len(word) for text in column for word in text.split()), default=0) for column in texts]
    widths = [max(cell_len(line) for text in column for line in (text.splitlines() or [""])) for column in texts]
    if folded:
        least = [*least[:-1], 1]
    while sum(widths) > room:
        loose = [k for k, width in enumerate(widths) if width > least[k]]
        if not loose:
            return None
        widths[max(loose, key=lambda k: widths[k])] -= 1
    return widths


def shown_unit(unit: str) -> str:
    """Return a unit of a dataset as people write it: ``kg m² s⁻¹`` for ``kg m2 s-1``, rad/s for ``rad s-1``."""
    if unit in ("1", "degree"):
        return {"1": "", "degree": "°"}[unit]
    raised = re.sub(r"(?<=[A-Za-z])-?\d+", lambda power: power[0].translate(RAISED), unit)
    return raised.replace("rad s⁻¹", "rad/s")
