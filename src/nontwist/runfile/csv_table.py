"""Tables in CSV files: a line of headers, then times alone, or with the momentum of a rotor or three components."""

from __future__ import annotations

import hashlib
import io
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..analysis.headers import split_unit
from ..analysis.time_values import known_unit
from ..geometry.arrays import Array
from ..io.regular import require_regular
from .section import LARGEST_NUMBER

LARGEST = 200_000_000  # bytes
COMMA, POINT = re.compile(rb"\d,\d"), re.compile(rb"\d\.\d")
# Units of moments other than N m, also written with a dot, as headers state them in brackets.
MOMENTS = re.compile(
    r"[µuμmkM]N[ .·⋅*]?m|[µuμmkM]?N[ .·⋅*]?[mc]m"
    r"|(lbf?|ozf?|kgf|gf|kp)[ .·⋅*-]?(ft|in|m|cm)|(ft|in)[ .·⋅*-]?(lbf?|ozf?)"
)


OTHER_UNITS = {  # by the number of columns: those that are refused of what follows the time, and the one that is meant
    1: (re.compile("(?!)"), ""),
    2: (
        re.compile(r"(?!N[ .·⋅*]?m[ .·⋅*]?s$|kg[ .·⋅*]?m(²|2|\^2|\*\*2)[ .·⋅*]?(/ ?s|s⁻¹|s-1|s\^-1)$).+"),
        ", momenta in kg m² s⁻¹",
    ),
    4: (MOMENTS, ", moments in N m"),
}


class Table(NamedTuple):
    """The columns of a table, the time first, and the hash of the file that they were read from."""

    columns: list[Array]
    sha256: str


def read_table(path: Path, chosen: list[str] | None, sha256: str | None, count: int = 4) -> Table:
    """Return a table of so many columns; a ValueError where it cannot be read, or does not have the hash `sha256`."""
    content = content_of(path)
    found = hashlib.sha256(content).hexdigest()
    if sha256 not in (None, found):
        raise ValueError(f"it has changed: its SHA-256 is {found}")
    return Table(columns_of(content, chosen, count), found)


def content_of(path: Path) -> bytes:
    """Return the content of a file; a ValueError where there is none, or where it is larger than `LARGEST`."""
    try:
        require_regular(path)
        with path.open("rb") as file:
            content = file.read(LARGEST + 1)
    except (OSError, ValueError) as error:
        raise ValueError(f"it cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(content) > LARGEST:
        raise ValueError(f"it is larger than {LARGEST / 1e6:g} MB")
    return content


def columns_of(content: bytes, chosen: list[str] | None, count: int = 4) -> list[Array]:
    """Return so many columns: times alone, or with one number or three components for each.

    Parameters
    ----------
    content : bytes
        UTF-8; columns separated by comma, semicolon or tab; headers in the first line. Between semicolons and tabs the
        decimal mark may be a comma.
    chosen : list of str, optional
        Headers, the time first. Not needed where there are no other columns.
    count : 4, 2 or 1

    Raises
    ------
    ValueError
        No headers, no such column, another number of columns, one in brackets another unit than s, N m and kg m² s⁻¹,
        or a cell that holds no number up to 1e60 (with its row).
    """
    import pandas

    try:
        header = content[: content.find(b"\n") if b"\n" in content else None].decode("utf-8-sig").strip()
    except UnicodeDecodeError as error:
        raise ValueError("it is not UTF-8") from error
    separator = max(",;\t", key=header.count)
    names = [name.strip().strip('"') for name in header.split(separator)]
    if not header or any(_is_number(name) for name in names):
        raise ValueError("its first line must contain the headers of the columns")
    wanted = names if chosen is None else chosen
    if len(wanted) != count:
        choice = "column = ... must name one of them" if count == 1 else f"columns = [...] must name {count} of them"
        raise ValueError(f"it has {len(names)} columns ({', '.join(names)}); {choice}")
    if missing := [name for name in wanted if name not in names]:
        raise ValueError(f"it has no column {missing[0]!r}; it has {', '.join(names)}")
    below = content.find(b"\n") + 1
    has_commas = separator != "," and COMMA.search(content, below) and not POINT.search(content, below)
    point = "," if has_commas else "."
    try:
        table = pandas.read_csv(
            io.BytesIO(content), sep=separator, decimal=point, skiprows=1, header=None, encoding="utf-8-sig"
        )
    except pandas.errors.EmptyDataError as error:
        raise ValueError("it has headers, but no row of numbers") from error
    except ValueError as error:
        found = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(error))
        reason = f"line {found[2]} has {found[3]} cells, those before {found[1]}" if found else str(error).strip()
        raise ValueError(f"it is not a table: {reason}") from error
    if len(table.columns) != len(names):
        raise ValueError(f"it has {len(names)} headers, but rows of {len(table.columns)} cells")
    columns = []
    for k, name in enumerate(wanted):
        unit = split_unit(name)[1] or ""
        others, meant = OTHER_UNITS[count]
        if known_unit(unit) not in (None, "s") if k == 0 else others.fullmatch(unit):
            raise ValueError(f"the column {name!r} states {unit}; times are in s{meant}: convert it")
        cells = table[names.index(name)]
        numbers = pandas.to_numeric(cells, errors="coerce").to_numpy(dtype=np.float64)
        if (bad := ~(abs(numbers) <= LARGEST_NUMBER)).any():
            k = int(np.argmax(bad))
            if pandas.isna(cells[k]):
                raise ValueError(f"the column {name!r} is empty in data row {k + 1}")
            raise ValueError(f"the column {name!r} contains {str(cells[k])!r} in data row {k + 1}, not a finite number")
        columns.append(numbers)
    return columns


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
