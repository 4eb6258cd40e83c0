"""Tables in text files, in all their dialects: of recordings, of loads, of the speed of a rotor.

The first line that is mostly numbers, and after which another is, is the first row. The headers are in the line above
it, or in the last comment (``#``, ``//``, ``%``) where that has as many fields; a line of units between them joins
them. Names of bodies in further lines join them too: OptiTrack Motive has lines ``Type``, ``Name``, ``ID`` and
``Rotation`` above ``X Y Z W``; Qualisys QTM has ``BODY_NAMES``, and the name before the first header of each body.
Separators are commas, semicolons, tabs or blanks; the decimal mark may be a comma. Encodings are UTF-8, UTF-16 with its
mark, or else Windows-1252.

Logs of raw counts of Gyroflow (.gcsv) have their factors above the headers. Segments of a CCSDS AEM are joined.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import accumulate, islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from ..errors import InputError
from ..geometry.values import counted
from ..units import is_unit
from .options import ReadOptions
from .table import Content, Table, number, numbered

PREAMBLE = 200  # lines that may be above the data
DIGITS = 4  # of a date or a time of day, at least
LONGEST = 200_000_000  # letters of a stream
COMMENTS = ("//", "#", "%")
SCALES = {"t": ("tscale", " (s)")}
SCALES |= {
    f"{one}{x}": (f"{one}scale", unit) for one, unit in (("g", " (rad/s)"), ("a", " (g)"), ("m", "")) for x in "xyz"
}
_COMMA, _POINT = (re.compile(rf"[-+]?\d+{mark}\d+(e[-+]?\d+)?", re.IGNORECASE) for mark in (",", r"\."))
_UNSURE = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}")  # perhaps thousands
FEW = 3  # different numbers with such a mark, and as many below 1000 without one, are thousands
MISSING = {"NA", "N/A", "#N/A", "<NA>", "NULL", "null", "None"}  # as R and others write it, and pandas reads it
_RECORD = re.compile(r"\$?[A-Z]\w*(,|$)")
_FACTOR = re.compile(r"(?i)\b(lsb|scale|sensitivity|factor|ATTITUDE_DIR|REF_FRAME_[AB])")
_SEGMENT = re.compile(r"\s*(?:((?!\w+_TIME|INTERPOL)[A-Z_]+)\s*=\s*(.*?)\s*$|[A-Z_]+\s*=|(?:META|DATA)_ST\w+\s*$)")
_SCALAR = re.compile(r"\s*(?:QUATERNION_TYPE\s*=\s*(FIRST|LAST)|CCSDS_AEM_VERS\s*=\s*2)")  # of a CCSDS AEM


def read_table(source: Path | TextIO | bytes) -> tuple[Table, tuple[str, ...]]:
    """Return the table of a text, and notes."""
    content = source.read_bytes() if isinstance(source, Path) else source
    if not isinstance(content, bytes):
        text = content.read(LONGEST + 1)
        if len(text) > LONGEST:
            raise InputError("long-stream", size=LONGEST / 1e6)
        content = text.encode(errors="replace")
    lines = list(islice(opened(content), PREAMBLE))
    if any("\x00" in line for line in lines):
        raise InputError("not-text")
    told = [k for k, line in enumerate(lines) if line.strip() and not _is_comment(line)]
    if not told:
        raise InputError("comments-only" if any(map(str.strip, lines)) else "empty")
    _require_one_kind([lines[k] for k in told])
    first_row = _first_row(lines, told)
    first = told[0] + 1 if first_row is None else first_row  # the headers are then in the first line of no comment
    separator = _separator(lines[first - (first_row is None)])
    if separator is None and 0 < first < len(lines):
        count, line = len(lines[first - 1].split()), lines[first]
        if len(line.split()) < count == len(line.rstrip("\r\n").split(" ")):
            separator = " "  # fields may be empty, as MT Manager writes them
    row = [] if first_row is None else fields_of(lines[first], separator)
    headers = _headers(lines[:first], separator, row)
    names = numbered(map(str, range(1, len(row) + 1)) if headers is None else headers)
    if separator is None and 0 < len(row) < len(names):
        raise InputError("empty-fields", headers=len(names), fields=len(row))
    is_prose = first_row is None and first < len(lines) and len(fields_of(lines[first], separator)) > len(names)
    table, notes = _rows(b"" if is_prose else content, separator, first, names)
    factors = (f"stated above the rows: {line.strip()}" for line in lines[:first] if _FACTOR.search(line))
    first_is = next((found[1] == "FIRST" for found in map(_SCALAR.match, lines[:first]) if found), None)
    return replace(table, headless=headers is None, scalar_first=first_is), (*notes, *factors)


def opened(content: bytes) -> TextIO:
    """Return the lines of a file of text."""
    return io.TextIOWrapper(io.BytesIO(content), _encoding(content), errors="replace")


def _encoding(content: bytes) -> str:
    if content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return "utf-16"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(content[: 2**16])
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(COMMENTS) or line.startswith("COMMENT ")  # of CCSDS


def _require_one_kind(lines: Sequence[str]) -> None:
    """Refuse a log whose rows begin with the words of their kinds, which have numbers of fields of their own."""
    records = [line for line in lines if _RECORD.match(line)]
    kinds = {line.partition(",")[0] for line in records}
    counts = {line.count(",") for line in records}
    if len(records) > len(lines) / 2 and len(kinds) > 1 and len(counts) > 1:
        raise InputError("records", kinds=", ".join(sorted(kinds)))


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
    quoted = csv.reader([line], delimiter=separator, skipinitialspace=True)
    return [field.strip() for field in (next(quoted) if '"' in line else line.split(separator))]


def _decimal(rows: Iterable[str], separator: str | None) -> str:
    """Return the decimal mark of the first row where it is not perhaps one of thousands; of none, commas alone are."""
    has_commas = has_points = False
    for row in rows:
        if "." not in row and ("," not in row or (separator == "," and '"' not in row)):
            continue
        fields = fields_of(row, separator)
        commas, points = (list(filter(one.fullmatch, fields)) for one in (_COMMA, _POINT))
        if not all(map(_UNSURE.fullmatch, commas)):
            return ","
        if not commas and not all(map(_UNSURE.fullmatch, points)):
            return "."
        has_commas, has_points = has_commas or bool(commas), has_points or bool(points)
    return "," if has_commas and not has_points else "."


def _is_number(field: str) -> bool:
    return number(field.replace(",", ".") if _COMMA.fullmatch(field) else field) is not None


def _first_row(lines: Sequence[str], told: Sequence[int]) -> int | None:
    """Return the first row of data: mostly numbers; above it rows may be missing, but for a time."""
    rows = []
    for k in told:
        fields = [field for field in fields_of(lines[k], _separator(lines[k])) if field]
        count = sum(map(_is_number, fields))
        if count >= 3 and 2 * count > len(fields):
            rows.append(k)
    after = dict(zip(told, [*told[1:], told[-1]], strict=True))
    first = next((k for k in rows if after[k] in rows), rows[0] if rows else None)  # numbers of bodies are no row
    while first is not None and first - 1 in told:
        separator = _separator(lines[first])
        above = fields_of(lines[first - 1], separator)
        numbers = [field in MISSING or _is_number(field) for field in above if field]
        dates = [sum(map(str.isdigit, field)) >= DIGITS for field in above if field]
        is_row = any(numbers) and all(map(max, numbers, dates))
        if not is_row or len(above) != len(fields_of(lines[first], separator)):
            break
        first -= 1
    return first


def _headers(above: Sequence[str], separator: str | None, row: Sequence[str]) -> list[str] | None:
    """Return the headers of a row of data, from the lines above it; None where there are none."""
    told = [_cleaned(line, separator, len(row)) for line in above if line.strip() and not _is_comment(line)]
    units = [field.strip("[]() ") for field in told[-1]] if len(told) > 1 else []
    units = units if any(units) and all(map(is_unit, units)) else []
    if told:
        *told, names = told[:-1] if units else told
        filled = max((k + 1 for k, one in enumerate(row) if one), default=0)
        if sum(map(bool, names)) == filled < len(names):  # two tabs between bodies (Qualisys), one at the end (Shimmer)
            units, names = ([one for one, name in zip(line, names, strict=False) if name] for line in (units, names))
        if len(names) == 1 < filled:  # a title, as of CCSDS and STK
            return None
        names = _with_bodies(told, names)
        if filled > len(names):
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


def _with_bodies(rows: list[list[str]], names: list[str]) -> list[str]:
    """Return the headers with the name of their body before them, where lines above tell it."""
    if bodies := next((row[1:] for row in rows if row[0] == "BODY_NAMES"), []):
        body, joined = "", []
        for name in names:
            start = next((one for one in bodies if name.startswith(f"{one} ")), None)
            body, name = (start, name[len(start) + 1 :]) if start else (body, name)
            joined.append(f"{body} {name}".strip())
        return joined
    rows = [row for row in rows if len(row) == len(names) and sum(map(bool, row)) > 1]
    if len(set(names)) == len(names) or not rows:
        return names
    if len(rows) < 3:  # a name stands above the first of its columns, as Vicon writes it
        filled: Iterable[str] = accumulate(rows[-1], lambda before, own: own or before)
        return [f"{body} {name}".strip() for body, name in zip(filled, names, strict=True)]
    bodies = next((row for row in rows if "Name" in row[:2]), rows[1])
    all_names = zip(bodies, rows[-1], names, strict=True)
    return [f"{body} {kind} {name}".strip() if kind else name for body, kind, name in all_names]


def _cleaned(line: str, separator: str | None, count: int) -> list[str]:
    """Return the headers in a line, without quotes and without what a separator at its end leaves."""
    names = [name.strip().strip('"').strip() for name in fields_of(line, separator)]
    while len(names) > count > 0 and not names[-1]:
        names.pop()
    return names


def _rows(content: bytes, separator: str | None, first: int, names: list[str]) -> tuple[Table, tuple[str, ...]]:
    """Return the rows below the first lines, and what was left out between them."""
    import pandas

    decimal = _decimal(islice(opened(content), first, None), separator)
    blank = "".join({*"\r\n \t"} - {separator})
    places, comments, is_split, widest = array("q"), list[int](), False, 0
    segment = {one[1]: one[2] for one in map(_SEGMENT.match, islice(opened(content), first)) if one}
    for k, line in islice(enumerate(opened(content), 1), first, None):
        found = _SEGMENT.match(line) if segment else None
        if found and segment.get(found[1]) != found[2]:
            raise InputError("segments", place=f"line {k}", key=found[1], now=found[2], was=segment.get(found[1]))
        if found or _is_comment(line):
            comments.append(k)
        elif line.strip(blank):
            places.append(k)
            is_split |= line.count('"') % 2 == 1  # a field of several lines: rows are not lines
            last = line
            if widest < len(names):
                widest = max(widest, 1 + line.count(separator or " "))
    if places and not re.search(r"\d", last) and len(fields_of(last, separator)) < len(names):  # END, DATA_STOP
        comments.append(places.pop())
    if separator is not None and 0 < widest < len(names):
        raise InputError("more-fields", headers=len(names), fields=widest)
    if not places:
        return Table({name: np.array([]) for name in names}), ()
    encoding = _encoding(content)
    if comments:
        kept, first = set(places), 0
        content = "".join(line for k, line in enumerate(opened(content), 1) if k in kept).encode(encoding, "replace")
    how: dict[str, Any] = {"sep": r"\s+" if separator is None else separator, "header": None, "names": names}
    how |= {"index_col": False, "skipinitialspace": separator != " ", "low_memory": False, "decimal": decimal}
    how |= {"encoding": encoding, "encoding_errors": "replace", "skiprows": first}
    try:
        frame = pandas.read_csv(io.BytesIO(content), **how)
    except pandas.errors.ParserError as error:
        found = re.search(r"line (\d+)", str(error))
        at = places[int(found[1]) - 1] if found and comments else found and found[1]
        where = "a line" if at is None or is_split else f"line {at}"
        raise InputError("fields", place=where, count=len(names)) from error
    pointed = frame.select_dtypes(["object", "string"]) if decimal == "," else frame.iloc[:, :0]
    thousands = [str(name) for name, column in pointed.items() if _are_thousands(column.dropna().astype(str))]
    if doubtful := [name for name, column in frame.select_dtypes("float").items() if _may_be_thousands(column)]:
        texts = pandas.read_csv(io.BytesIO(content), **how | {"usecols": doubtful, "dtype": str})
        thousands += [name for name in doubtful if _has_both(texts[name].dropna(), decimal)]
    notes = (f"left out: {counted(len(comments), 'line')} of comments between the rows",) if comments else ()
    lines = np.array(places) if not is_split and len(places) == len(frame) else None
    return Table({str(name): frame[name].to_numpy() for name in frame.columns}, lines, thousands=thousands), notes


def _are_thousands(fields: Iterable[str]) -> bool:
    """Whether fields of a column have points, all before three digits, beside decimal commas."""
    found = [field.strip() for field in fields if _POINT.fullmatch(field.strip())]
    return bool(found) and all(map(_UNSURE.fullmatch, found))


def _may_be_thousands(numbers: Any) -> bool:
    """Whether numbers below 1000 have three digits behind their mark, but no number below 1 has any."""
    x = abs(numbers.to_numpy())
    x = x[np.isfinite(x) & (x > 0)]
    part = x[x != np.round(x)]
    if part.size < FEW or part.min() < 1 or x.max() >= 1000:
        return False
    return bool(abs(1000 * x - np.round(1000 * x)).max() < 1e-6)


def _has_both(texts: Any, mark: str) -> bool:
    """Whether numbers have three digits behind their mark, and others, which are not 0, no mark."""
    marked, whole = ({one.strip() for one in texts if (mark in one) == is_in} for is_in in (True, False))
    return all(map(_UNSURE.fullmatch, marked)) and min(len(marked), len(whole - {"0"})) >= FEW


def read_text(source: Path | Any, how: ReadOptions) -> Content:
    """Read a file or a text stream."""
    table, notes = read_table(source)
    return Content(table, notes=notes)


def read_gyroflow(path: Path, how: ReadOptions) -> Content:
    """Read a .gcsv file: counts times the factors that the lines above them state."""
    with open(path, encoding="utf-8", errors="replace") as file:
        above = dict(line.strip().split(",", 1) for line in file.readlines()[:30] if line.count(",") == 1)
    content = read_text(path, how)
    columns: dict[str, Any] = {}
    for header in content.table.headers:
        key, unit = SCALES.get(header, ("", ""))
        if key in above:
            columns[header + unit] = content.table.numbers(header) * float(above[key])
        else:
            columns[header] = content.table.columns[header]
    note = "counts: times the factors in the lines above them"
    return replace(content, table=replace(content.table, columns=columns), notes=(*content.notes, note))
