"""The folder of a run file: each file that it names is read once, and each body is made once.

Checks, forecast, run and every block of a sweep ask the same `Folder`. So the hash in a result is that of the numbers
that were used, whatever becomes of the file meanwhile.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array
from ..io.whole import require_regular
from ..models.mesh import read_mesh
from ..recordings.table import number, place
from ..recordings.text import read_table as read_text_table
from ..units import MOMENT, MOMENTUM, TIME, known, split_unit
from .toml_data import LARGEST_NUMBER

if TYPE_CHECKING:
    from ..models.system import DirectorSystem
    from .body import Body

# Tables in CSV files: a line of headers, then times alone, or with the momentum of a rotor or three components.

LARGEST = 200_000_000  # bytes
# By the number of columns: the units of what follows the time, those that are meant, and in words.
MEANT = {
    1: (TIME, {"s"}, ""),
    2: (MOMENTUM, {"Nms", "kgm2/s"}, ", momenta in kg m² s⁻¹"),
    4: (MOMENT, {"Nm"}, ", moments in N m"),
}


class Table(NamedTuple):
    """The columns of a table, the time first, and the hash of the file that they were read from."""

    columns: list[Array]
    sha256: str


def read_table(path: Path, chosen: list[str] | None, sha256: str | None, count: int = 4) -> Table:
    """Return a table of so many columns; a ValueError where it cannot be read, or does not have the hash `sha256`."""
    try:
        require_regular(path)
        with path.open("rb") as file:
            content = file.read(LARGEST + 1)
    except (OSError, ValueError) as error:
        raise ValueError(f"it cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(content) > LARGEST:
        raise InputError("table-large", size=LARGEST / 1e6)
    found = hashlib.sha256(content).hexdigest()
    if sha256 not in (None, found):
        raise InputError("table-changed", sha256=found)
    return Table(columns_of(content, chosen, count), found)


def columns_of(content: bytes, chosen: list[str] | None, count: int = 4) -> list[Array]:
    """Return so many columns of a text table: times alone, or with one number or three components for each.

    Parameters
    ----------
    content : bytes
        In one of the dialects of `nontwist.recordings.text`, with headers.
    chosen : list of str, optional
        Headers, the time first. Not needed where there are no other columns.
    count : 4, 2 or 1

    Raises
    ------
    InputError
        No headers, no such column, another number of columns, one in brackets another unit than s, N m and kg m² s⁻¹,
        or a cell that holds no number up to 1e60 (with its line).
    """
    table, _ = read_text_table(content)
    names = table.headers
    if table.headless:
        raise InputError("table-headers")
    wanted = names if chosen is None else chosen
    if len(wanted) != count:
        choice = "column = ... must name one of them" if count == 1 else f"columns = [...] must name {count} of them"
        raise InputError("table-columns", found=len(names), names=", ".join(names), choice=choice)
    table.require(*wanted)
    if not len(table):
        raise InputError("no-rows")
    columns = []
    for k, name in enumerate(wanted):
        units, meant, words = (TIME, {"s"}, MEANT[count][2]) if k == 0 else MEANT[count]
        stated = split_unit(name)[1]
        unit = known(stated, units)
        is_other = unit is not None or (stated is not None and units is MOMENTUM)
        if is_other and unit not in meant:
            raise InputError("table-unit", name=name, unit=stated, words=words)
        cells = table.columns[name]
        numbers = np.array([np.nan if (x := number(cell)) is None else x for cell in cells.tolist()])
        if (bad := ~(abs(numbers) <= LARGEST_NUMBER)).any():
            row = int(np.argmax(bad))
            is_empty = cells[row] != cells[row]  # not a number
            holds = "is empty" if is_empty else f"contains {str(cells[row])!r}, not a finite number,"
            raise InputError("table-cell", name=name, holds=holds, place=place(row, table.lines))
        columns.append(numbers)
    return columns


T = TypeVar("T")


def _result(path: Path, sha256: str | None) -> tuple[Any, str]:
    from ..errors import ResultFileError
    from ..io.results import open_run

    try:
        run, found = open_run(path), hashlib.sha256(path.read_bytes()).hexdigest()
    except (OSError, ResultFileError) as error:
        raise ValueError(str(getattr(error, "strerror", None) or error)) from error
    if sha256 not in (None, found):
        raise ValueError(f"its content has changed: its hash is {found}")
    return run, found


@dataclass(frozen=True)
class Folder:
    """Where a run file lies, and what was read and made there."""

    path: Path
    _kept: dict[Hashable, Any] = field(default_factory=dict, repr=False, compare=False)

    def system(self, body: Body) -> DirectorSystem:
        """Return a body; a ValueError where no body has such numbers."""
        return self._once(("body", body.model_dump_json()), lambda: body.system(self))

    def table(self, file: str, columns: list[str] | None, sha256: str | None, count: int = 4) -> Table:
        """Return the columns and the hash of a CSV file; a ValueError as `read_table`."""
        key = "csv", file, *(columns or ()), sha256, count
        return self._once(key, lambda: read_table(self._at(file), columns, sha256, count))

    def mesh(self, file: str) -> Any:
        """Return vertices and faces; errors as `read_mesh`."""
        return self._once(("mesh", file), lambda: read_mesh(self._at(file)))

    def result(self, file: str, sha256: str | None) -> tuple[Any, str]:
        """Return the run in a result file, and its hash; a ValueError where it cannot be read or has another hash."""
        return self._once(("run", file, sha256), lambda: _result(self._at(file), sha256))

    def _at(self, file: str) -> Path:
        """Return the path of a file; its name is in UTF-8, as the run file is, whatever the locale."""
        return self.path / os.fsdecode(file.encode())

    def _once(self, key: Hashable, make: Callable[[], T]) -> T:
        if key not in self._kept:
            self._kept[key] = make()
        found: T = self._kept[key]
        return found
