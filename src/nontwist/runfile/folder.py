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
from typing import TYPE_CHECKING, Any, TypeVar

from ..models.mesh import read_mesh
from .csv_table import Table, read_table

if TYPE_CHECKING:
    from ..models.system import DirectorSystem
    from .body import Body

T = TypeVar("T")


def _result(path: Path, sha256: str | None) -> tuple[Any, str]:
    from ..errors import ResultFileError
    from ..io import open_run

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
