"""CSV in its dialects: separators, decimal commas, comments, lines before the headers and units below them.

The first line that is mostly numbers, and after which another is, is the first row of data; `headings` finds the
headers above it. UTF-8, UTF-16 with its mark, or else Windows-1252.
"""

from __future__ import annotations

import codecs
import io
import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from ...analysis.places import Lines
from ...analysis.tables import Reading
from ...analysis.time_values import number
from ...geometry.values import counted
from .content import Content
from .headings import COMMENTS, distinct, fields_of, headers_of

PREAMBLE = 200  # lines that may stand before the data
DIGITS = 4  # of a date or a time of day, at least
LONGEST = 200_000_000  # letters of a stream
_COMMA = re.compile(r"-?\d+,\d+(e[-+]?\d+)?", re.IGNORECASE)


def read_text(source: Path | Any, how: Reading) -> Content:
    """Read a file or a text stream."""
    if isinstance(source, Path):
        with open(source, encoding=_encoding(source), errors="replace") as file:
            lines = [file.readline() for _ in range(PREAMBLE)]
        if any("\x00" in line for line in lines):
            raise ValueError("it is not a text file; the file suffix determines the format: see the table of formats")
    else:
        content = source.read(LONGEST + 1)
        if len(content) > LONGEST:
            raise ValueError(f"the stream is longer than {LONGEST / 1e6:g} MB; save it in a file")
        lines = content.removeprefix("\ufeff").splitlines(keepends=True)[:PREAMBLE]
        source = io.StringIO(content)
    columns, headless, places, notes = _table(source, lines, how)
    return Content(columns=columns, chosen=tuple(columns) if headless else None, notes=notes, lines=places)


def _encoding(path: Path) -> str:
    """Return how the text of a file is encoded, from its first 64 kB."""
    with open(path, "rb") as file:
        start = file.read(2**16)
    if start[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(start)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _separator(line: str) -> str | None:
    """Return what separates the fields of a line, None for blanks."""
    bare = re.sub(r'"[^"]*"', "", line)
    best = max(";\t,", key=lambda sign: (bare.count(sign), -";\t,".index(sign)))
    if ";" in bare and _COMMA.search(bare):
        best = ";"
    elif "\t" in bare.strip() and _COMMA.search(bare):
        best = "\t"
    return best if bare.strip().count(best) else None


def _by_single_blanks(headers: str, row: str) -> bool:
    """Whether only single blanks, with empty fields between two of them, give a row as many fields as its headers."""
    count = len(headers.split())
    return len(row.split()) < count == len(row.rstrip("\r\n").split(" "))


def _is_data(line: str) -> bool:
    """Whether most fields of a line are numbers or missing, and some are numbers."""
    fields = fields_of(line.rstrip("\r\n"), _separator(line))
    told = [field for field in fields if field]
    count = sum(_number(field) is not None for field in told)
    return count >= 3 and 2 * count > len(told)


def _is_gap(line: str, row: str) -> bool:
    """Whether a line above a row of data is one as well, in which most is missing: numbers, or a time, alone."""
    separator = _separator(row)
    fields = fields_of(line.rstrip("\r\n"), separator)
    told = [field for field in fields if field]
    numbers = [_number(field) is not None for field in told]
    dates = [sum(letter.isdigit() for letter in field) >= DIGITS for field in told]
    as_many = len(fields) == len(fields_of(row.rstrip("\r\n"), separator))
    return as_many and any(numbers) and all(one or date for one, date in zip(numbers, dates, strict=True))


def _number(field: str) -> float | None:
    return number(field.replace(",", ".")) if _COMMA.fullmatch(field) else number(field)


def _table(
    source: Any, lines: Sequence[str], how: Reading
) -> tuple[dict[str, Any], bool, Lines | None, tuple[str, ...]]:
    """Return the columns by header, whether they have none but their numbers, their lines, and what was left out."""
    import pandas

    if not any(line.strip() for line in lines):
        raise ValueError("the first line is empty; it must contain the headers of the columns")
    told = [k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith(COMMENTS)]
    if not told:
        raise ValueError("the file has comments only; below them it must contain the headers of the columns, and rows")
    rows = [_is_data(lines[k]) for k in told]
    after = [*rows[1:], True]  # numbers of bodies above the headers are no row
    first = next((k for k, row, more in zip(told, rows, after, strict=True) if row and more), None)
    first = next((k for k, row in zip(told, rows, strict=True) if row), None) if first is None else first
    while first is not None and first - 1 in told and _is_gap(lines[first - 1], lines[first]):
        first -= 1
    if first is None:  # no row of numbers: the headers are in the first line that is no comment, and messages name them
        first = told[0] + 1
        separator = _separator(lines[first - 1])
    else:
        separator = _separator(lines[first])
    if separator is None and 0 < first < len(lines) and _by_single_blanks(lines[first - 1], lines[first]):
        separator = " "  # fields may be empty, as MT Manager writes them
    row = fields_of(lines[first].rstrip("\r\n"), separator) if first in told and any(rows) else []
    named = headers_of(lines[:first], separator, row, _separator)
    names = _numbered(len(row), lines[first].strip() if row else "", how) if named is None else named
    if separator is None and 0 < len(row) < len(names):
        raise ValueError(
            f"there are {len(names)} headers, but {len(row)} fields in the first row of numbers, and blanks between "
            "them do not show which are empty; export it with commas or tabs"
        )
    if not any(rows) and first < len(lines) and len(fields_of(lines[first].rstrip("\r\n"), separator)) > len(names):
        return {name: np.array([]) for name in distinct(names)}, False, None, ()  # prose, not a table
    decimal = "," if any(_COMMA.fullmatch(field) for field in row) else "."
    table, places, notes = _frame(pandas, source, separator, first, distinct(names), decimal)
    return {str(name): table[name].to_numpy() for name in table.columns}, named is None, places, notes


def _frame(
    pandas: Any, source: Any, separator: str | None, first: int, names: list[str], decimal: str
) -> tuple[Any, Lines | None, tuple[str, ...]]:
    """Return the rows from line `first` on, their lines, and what was left out between them."""
    how: dict[str, Any] = {"sep": r"\s+" if separator is None else separator, "header": None, "names": names}
    how |= {"index_col": False, "decimal": decimal, "skipinitialspace": separator != " ", "encoding_errors": "replace"}
    how["low_memory"] = False
    encoding = _encoding(source) if isinstance(source, Path) else None
    try:
        table = pandas.read_csv(source, encoding=encoding, skiprows=first, **how)
        failed = None
    except pandas.errors.EmptyDataError:
        return pandas.DataFrame({name: [] for name in names}, dtype=float), None, ()
    except pandas.errors.ParserError as error:
        table, failed = None, error
    blank = "\r\n" + (" \t" if separator is None else " \t".replace(separator, ""))
    places, count, is_split = [], 0, False
    for k, line in _lines_from(source, encoding, first, blank):
        places.append(k)
        is_split |= line.count('"') % 2 == 1  # a field of several lines: rows are not lines
    if table is None or not pandas.api.types.is_numeric_dtype(table.dtypes.iloc[0]):
        lines = _lines_from(source, encoding, first, blank)
        kept = [(k, line) for k, line in lines if not line.lstrip().startswith(COMMENTS)]
        count = len(places) - len(kept)
        if count:
            places = [k for k, _ in kept]
            try:
                table, failed = pandas.read_csv(io.StringIO("".join(line for _, line in kept)), **how), None
            except pandas.errors.ParserError as error:
                failed = error
    if failed is not None:
        found = re.search(r"line (\d+)", str(failed))
        at = None if found is None or is_split else places[int(found[1]) - 1] if count else int(found[1])
        where = "a line" if at is None else f"line {at}"
        raise ValueError(
            f"{where} does not have the {len(names)} fields of the first; correct or delete it"
        ) from failed
    notes = (f"left out: {counted(count, 'line')} of comments between the rows",) if count else ()
    return table, None if is_split or len(places) != len(table) else np.array(places), notes


def _lines_from(source: Any, encoding: str | None, first: int, blank: str) -> Iterator[tuple[int, str]]:
    """Yield the lines after the first ones that hold more than characters in `blank`, with their numbers from 1."""
    with ExitStack() as stack:
        if isinstance(source, Path):
            lines = stack.enter_context(open(source, encoding=encoding, errors="replace"))
        else:
            lines = source.getvalue().splitlines(keepends=True)
        yield from ((k, line) for k, line in enumerate(lines, 1) if k > first and line.strip(blank))


def _numbered(count: int, line: str, how: Reading) -> list[str]:
    """Return the numbers of columns that have no headers, where their count says what they are."""
    angles = how.euler is not None or how.rotation_vector
    if how.columns is None and count not in ((3, 4) if angles else (4, 5, 9, 10)):
        raise ValueError(
            f"the first line holds numbers, not the headers of the columns: {line.strip()[:60]}; of {count} columns "
            "name [TIME,] 4 of a quaternion or 9 of a matrix by their numbers from 1: --columns (columns=)"
        )
    return [str(k + 1) for k in range(count)]
