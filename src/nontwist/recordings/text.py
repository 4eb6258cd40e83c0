"""Tables in text files, in all their dialects: of recordings, of loads, of the speed of a rotor.

The first line that is mostly numbers, and after which another is, is the first row. The headers are in the line above
it, or in the last comment (``#``, ``//``, ``%``) where that has as many fields; a line of units between them joins
them. Names of bodies in further lines join them too: OptiTrack Motive has lines ``Type``, ``Name``, ``ID`` and
``Rotation`` above ``X Y Z W``; Qualisys QTM has ``BODY_NAMES``, and the name before the first header of each body.
Separators are commas, semicolons, tabs or blanks; the decimal mark may be a comma. Encodings are UTF-8, UTF-16 with its
mark, or else Windows-1252.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from ..errors import InputError
from ..geometry.values import counted
from ..units import is_unit
from .table import Lines, Table, number

PREAMBLE = 200  # lines that may be above the data
DIGITS = 4  # of a date or a time of day, at least
LONGEST = 200_000_000  # letters of a stream
COMMENTS = ("//", "#", "%")
_COMMA, _POINT = (re.compile(rf"-?\d+{mark}\d+(e[-+]?\d+)?", re.IGNORECASE) for mark in (",", r"\."))
_RECORD = re.compile(r"\$?[A-Z]\w*(,|$)")
_FACTOR = re.compile(r"(?i)\b(lsb|scale|sensitivity|factor)")
Source = Path | io.StringIO


def read_table(source: Path | TextIO) -> tuple[Table, bool, tuple[str, ...]]:
    """Return the table of a file or a stream of text, whether it has no headers but numbers from 1, and notes."""
    source, lines = _beginning(source)
    if not any(line.strip() for line in lines):
        raise InputError("empty")
    told = [k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith(COMMENTS)]
    if not told:
        raise InputError("comments-only")
    _require_one_kind([lines[k] for k in told])
    first = _first_row(lines, told)
    has_rows = first is not None
    if first is None:  # the headers are then in the first line that is not a comment
        first = told[0] + 1
    separator = _separator(lines[first if has_rows else first - 1])
    if separator is None and 0 < first < len(lines) and _by_single_blanks(lines[first - 1], lines[first]):
        separator = " "  # fields may be empty, as MT Manager writes them
    row = fields_of(lines[first], separator) if has_rows else []
    named = headers_of(lines[:first], separator, row)
    names = [str(k + 1) for k in range(len(row))] if named is None else distinct(named)
    if separator is None and 0 < len(row) < len(names):
        raise InputError("empty-fields", headers=len(names), fields=len(row))
    if not has_rows and first < len(lines) and len(fields_of(lines[first], separator)) > len(names):
        return Table({name: np.array([]) for name in names}), False, ()  # prose, not a table
    frame, places, notes = read_rows(source, separator, first, names, decimal=_decimal(lines[first:], separator))
    notes += tuple(f"stated above the rows: {line.strip()}" for line in lines[:first] if _FACTOR.search(line))
    if frame is None:
        return Table({name: np.array([]) for name in names}), named is None, ()
    return Table({str(name): frame[name].to_numpy() for name in frame.columns}, places), named is None, notes


def _require_one_kind(lines: Sequence[str]) -> None:
    """Refuse a log whose rows begin with the words of their kinds, which have numbers of fields of their own."""
    kinds: dict[str, set[int]] = {}
    for line in lines:
        if _RECORD.match(line):
            kinds.setdefault(line.partition(",")[0], set()).add(line.count(","))
    count = sum(_RECORD.match(line) is not None for line in lines)
    if count > len(lines) / 2 and len(kinds) > 1 and len(set().union(*kinds.values())) > 1:
        raise InputError("records", kinds=", ".join(sorted(kinds)))


def _beginning(source: Path | TextIO) -> tuple[Source, list[str]]:
    """Return a source that can be read twice, and its first lines."""
    if isinstance(source, Path):
        with open(source, encoding=encoding_of(source), errors="replace") as file:
            lines = [file.readline() for _ in range(PREAMBLE)]
        if any("\x00" in line for line in lines):
            raise InputError("not-text")
        return source, lines
    content = source.read(LONGEST + 1)
    if len(content) > LONGEST:
        raise InputError("long-stream", size=LONGEST / 1e6)
    return io.StringIO(content), content.removeprefix("\ufeff").splitlines(keepends=True)[:PREAMBLE]


def decoded(content: bytes) -> str:
    """Return the text of a file."""
    return content.decode(_encoding(content[: 2**16]), errors="replace")


def encoding_of(path: Path) -> str:
    """Return how the text of a file is encoded, from its first 64 kB."""
    with open(path, "rb") as file:
        return _encoding(file.read(2**16))


def _encoding(start: bytes) -> str:
    if start[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
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
    if _COMMA.search(bare) and (";" in bare or "\t" in bare.strip()):
        best = ";" if ";" in bare else "\t"
    return best if bare.strip().count(best) else None


def fields_of(line: str, separator: str | None) -> list[str]:
    """Return the fields of a line, those in quotes without them; None: separated by blanks."""
    line = line.rstrip("\r\n")
    if separator is None:
        return line.split()
    fields = (
        next(csv.reader([line], delimiter=separator, skipinitialspace=True)) if '"' in line else line.split(separator)
    )
    return [field.strip() for field in fields]


def _decimal(rows: Sequence[str], separator: str | None) -> str:
    """Return the decimal mark of the first row that has one."""
    for row in rows:
        fields = fields_of(row, separator)
        if any(_COMMA.fullmatch(one) for one in fields):
            return ","
        if any(_POINT.fullmatch(one) for one in fields):
            return "."
    return "."


def _by_single_blanks(headers: str, row: str) -> bool:
    """Whether only single blanks, with empty fields between two of them, give a row as many fields as its headers."""
    count = len(headers.split())
    return len(row.split()) < count == len(row.rstrip("\r\n").split(" "))


def _number(field: str) -> float | None:
    return number(field.replace(",", ".") if _COMMA.fullmatch(field) else field)


def _first_row(lines: Sequence[str], told: Sequence[int]) -> int | None:
    """Return the first row of data: mostly numbers; above it rows may be missing, but for a time."""

    def is_data(line: str) -> bool:
        fields = [field for field in fields_of(line, _separator(line)) if field]
        count = sum(_number(field) is not None for field in fields)
        return count >= 3 and 2 * count > len(fields)

    def is_gap(line: str, row: str) -> bool:
        all_fields, separator = fields_of(line, _separator(row)), _separator(row)
        fields = [field for field in all_fields if field]
        numbers = [_number(field) is not None for field in fields]
        dates = [sum(letter.isdigit() for letter in field) >= DIGITS for field in fields]
        return len(all_fields) == len(fields_of(row, separator)) and any(numbers) and all(map(max, numbers, dates))

    rows = [k for k in told if is_data(lines[k])]
    after = dict(zip(told, [*told[1:], told[-1]], strict=True))
    first = next((k for k in rows if after[k] in rows), rows[0] if rows else None)  # numbers of bodies are no row
    while first is not None and first - 1 in told and is_gap(lines[first - 1], lines[first]):
        first -= 1
    return first


def headers_of(above: Sequence[str], separator: str | None, row: Sequence[str]) -> list[str] | None:
    """Return the headers of a row of data, from the lines above it; None where there are none."""
    told = [line for line in above if line.strip() and not line.lstrip().startswith(COMMENTS)]
    units: list[str] = []
    if len(told) > 1:
        fields = [field.strip('[]() "') for field in fields_of(told[-1], separator)]
        if any(fields) and all(map(is_unit, fields)):
            units, told = fields, told[:-1]
    filled = _filled(row)
    if told:
        names = _cleaned(told[-1], separator, len(row))
        if len([name for name in names if name]) == filled < len(names):  # Qualisys: two tabs between two bodies
            names = [name for name in names if name]
        names = _with_bodies(told[:-1], names, separator)
        if row and filled > len(names):
            raise InputError("more-fields", headers=len(names), fields=len(row))
        if len(units) == len(names):
            names = [f"{name} ({unit})" if unit else name for name, unit in zip(names, units, strict=True)]
        return names
    for line in reversed(above):
        text = line.strip().lstrip("#/% ")
        for sign in (separator, _separator(text)):
            if len(names := _cleaned(text, sign, len(row))) == len(row) and None in map(number, names):
                return names
    return None


def _with_bodies(above: Sequence[str], names: list[str], separator: str | None) -> list[str]:
    """Return the headers with the name of their body before them, where lines above tell it."""
    rows = [_cleaned(line, separator, len(names)) for line in above]
    if bodies := next((row[1:] for row in rows if row[0] == "BODY_NAMES"), []):
        body, joined = "", []
        for name in names:
            start = next((one for one in bodies if name.startswith(f"{one} ")), None)
            body, name = (start, name[len(start) + 1 :]) if start else (body, name)
            joined.append(f"{body} {name}".strip())
        return joined
    rows = [row for row in rows if len(row) == len(names)]
    if len(set(names)) == len(names) or len(rows) < 3:
        return names
    bodies = next((row for row in rows if "Name" in row[:2]), rows[1])
    all_names = zip(bodies, rows[-1], names, strict=True)
    return [f"{body} {kind} {name}".strip() if kind else name for body, kind, name in all_names]


def _filled(fields: Sequence[str]) -> int:
    """Return the number of fields without the empty ones at the end."""
    return max((k + 1 for k, one in enumerate(fields) if one), default=0)


def _cleaned(line: str, separator: str | None, count: int) -> list[str]:
    """Return the headers in a line, without quotes and without what a separator at its end leaves."""
    names = [name.strip().strip('"').strip() for name in fields_of(line, separator)]
    while len(names) > count > 0 and not names[-1]:
        names.pop()
    return names


def distinct(names: Sequence[str]) -> list[str]:
    """Return the headers, the repeated ones with a number as pandas gives them."""
    seen: dict[str, int] = {}
    found = []
    for name in names:
        seen[name] = seen.get(name, -1) + 1
        found.append(f"{name}.{seen[name]}" if seen[name] else name)
    return found


def read_rows(
    source: Source, separator: str | None, first: int, names: list[str], **more: Any
) -> tuple[Any, Lines | None, tuple[str, ...]]:
    """Return the rows below the first lines as a DataFrame, their lines, and what was left out between them."""
    import pandas

    how: dict[str, Any] = {"sep": r"\s+" if separator is None else separator, "header": None, "names": names, **more}
    how |= {"index_col": False, "skipinitialspace": separator != " ", "low_memory": False}
    encoding = encoding_of(source) if isinstance(source, Path) else None
    frame, failed = None, None
    try:
        frame = pandas.read_csv(source, encoding=encoding, encoding_errors="replace", skiprows=first, **how)
    except pandas.errors.EmptyDataError:
        return None, None, ()
    except pandas.errors.ParserError as error:
        failed = error
    blank = "\r\n" + (" \t" if separator is None else " \t".replace(separator, ""))
    places, left_out, is_split = [], 0, False
    for k, line in _lines_from(source, encoding, first, blank):
        places.append(k)
        is_split |= line.count('"') % 2 == 1  # a field of several lines: rows are not lines
    if frame is None or not pandas.api.types.is_numeric_dtype(frame.dtypes.iloc[0]):
        lines = _lines_from(source, encoding, first, blank)
        kept = [(k, line) for k, line in lines if not line.lstrip().startswith(COMMENTS)]
        left_out = len(places) - len(kept)
        if left_out:
            places = [k for k, _ in kept]
            try:
                frame, failed = pandas.read_csv(io.StringIO("".join(line for _, line in kept)), **how), None
            except pandas.errors.ParserError as error:
                failed = error
    if failed is not None:
        found = re.search(r"line (\d+)", str(failed))
        at = None if found is None or is_split else places[int(found[1]) - 1] if left_out else int(found[1])
        where = "a line" if at is None else f"line {at}"
        raise InputError("fields", place=where, count=len(names)) from failed
    notes = (f"left out: {counted(left_out, 'line')} of comments between the rows",) if left_out else ()
    return frame, None if is_split or frame is None or len(places) != len(frame) else np.array(places), notes


def _lines_from(source: Source, encoding: str | None, first: int, blank: str) -> Iterator[tuple[int, str]]:
    """Yield the lines after the first ones that hold more than characters in `blank`, with their numbers from 1."""
    with ExitStack() as stack:
        if isinstance(source, Path):
            lines: Any = stack.enter_context(open(source, encoding=encoding, errors="replace"))
        else:
            lines = source.getvalue().splitlines(keepends=True)
        yield from ((k, line) for k, line in enumerate(lines, 1) if k > first and line.strip(blank))
