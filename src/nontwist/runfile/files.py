"""From files to plain data: the TOML of a run file, and what it names beside it. Nothing executes.

Whatever the bytes of a run file are, they end in data or in one line that says what is wrong and where, within about a
second.

Each file that a run file names is read once, and each body is made once: checks, forecast, run and every block of a
sweep ask the same `Folder`. So the hash in a result is that of the numbers that were used, whatever becomes of the file
meanwhile.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import tomllib
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from pydantic import BaseModel

from ..errors import InputError, RunFileError
from ..geometry.arrays import Array
from ..io.whole import require_regular
from ..models.mesh import read_mesh
from ..recordings.table import number, place
from ..recordings.text import read_table as read_text_table
from ..units import MOMENT, MOMENTUM, TIME, known, split_unit

if TYPE_CHECKING:
    from ..models.system import DirectorSystem
    from .body import Body

# Beyond it products overflow: the moment of inertia of the sun is 6e46 kg m², of a molecule 1e-46.
LARGEST_NUMBER = 1e60
SMALLEST_NUMBER = 1e-60  # smaller ones count as 0
LARGEST = 1_000_000  # bytes
DEEPEST = 32  # parts of a dotted key; tomllib's time grows with the square of them
TOML = 'TOML: [body] on a line, below it kind = "standard"; nontwist example shows whole files'
VALUES = 'numbers (0.5, not .5), "text", true, false, [lists] and { tables }; no expressions such as 1/7'
LEFT_OUT = object()
EITHER = ("step", "tolerance")  # of the table [time]
_PLACE = re.compile(r" ?\((?:at line (\d+), column (\d+)|at end of document)\)")


# Plain data written: JSON's numbers and strings are TOML's, only tables differ.

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(data: dict[str, Any]) -> str:
    """Return plain data as TOML: scalars first, then a table for each dict and for each entry of a list of dicts."""
    lines, tables = [], list[str]()
    for key, item in data.items():
        if isinstance(item, dict):
            tables += ["", f"[{toml_key(key)}]", *starmap(_line, item.items())]
        elif isinstance(item, list) and item and all(isinstance(entry, dict) for entry in item):
            for entry in item:
                tables += ["", f"[[{toml_key(key)}]]", *starmap(_line, entry.items())]
        else:
            lines.append(_line(key, item))
    return "\n".join([*lines, *tables]).strip() + "\n"


def _line(key: str, item: Any) -> str:
    return f"{toml_key(key)} = {toml_value(item)}"


def toml_key(key: str) -> str:
    """Return a key, in quotes where it needs them."""
    return key if _BARE.fullmatch(key) else toml_value(key)


def toml_value(value: Any) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, dict):
        return "{ " + ", ".join(starmap(_line, value.items())) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, str):
        return "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in json.dumps(value, ensure_ascii=False))
    if isinstance(value, (bool, int, float)):
        return str(value).lower() if isinstance(value, bool) else repr(value)
    return str(value)


def plain(value: Any) -> Any:
    """Return a value as TOML has it; columns of pandas and xarray as their numbers."""
    if hasattr(value, "__array__"):
        return np.asarray(value).tolist()
    if isinstance(value, tuple | list | range):
        return [*map(plain, value)]
    return value


# What is wrong with a run file, one line each: "file: key: what was given -> what is accepted".


LONGEST = 60  # letters of a value that are shown
Keys = tuple[str | int, ...]


class Fault(NamedTuple):
    """One thing that is wrong."""

    key: str  #: dotted, entries of lists counted from 0; or a line of the file
    given: str
    accepted: str

    def __str__(self) -> str:
        return f"{self.key}: {self.given} -> {self.accepted}"


def printable(text: str) -> str:
    """Return a text without what a terminal would act on, shortened."""
    text = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text)
    return text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."


def shown(value: Any) -> str:
    """Return a value as a message shows it: as TOML, shortened."""
    if isinstance(value, BaseModel):
        value = value.model_dump(exclude_unset=True)
    if isinstance(value, dict):
        return f"a table with {printable(', '.join(map(toml_key, value)))}" if value else "an empty table"
    if isinstance(value, list) and any(isinstance(entry, dict) for entry in value):
        return "a list of tables"
    return printable(toml_value(value))


def dotted(path: Keys) -> str:
    """Return a path as a key: ``load.0.amplitude``."""
    return ".".join(printable(toml_key(str(part))) for part in path)


# Bytes read.


class Unbounded(float):
    """Not a number, or infinity for one too large, which shows itself as it was written."""

    text: str

    def __repr__(self) -> str:
        return self.text


def _number(text: str) -> float:
    """Return a number; one too large as infinity, which is accepted nowhere; one too small as 0."""
    value = float(text)
    if abs(value) <= LARGEST_NUMBER:
        return value if abs(value) >= SMALLEST_NUMBER else 0.0
    refused = Unbounded(math.copysign(math.inf, value) if value == value else math.nan)
    refused.text = text
    return refused


def bounded(data: Any) -> Any:
    """Return plain data whose numbers are those that `_number` makes of their texts."""
    if isinstance(data, dict):
        return {key: bounded(value) for key, value in data.items()}
    if isinstance(data, list):
        return [bounded(value) for value in data]
    if not isinstance(data, int | float) or isinstance(data, Unbounded):
        return data
    if data == 0 or SMALLEST_NUMBER <= abs(data) <= LARGEST_NUMBER or data != data:
        return data
    return _number("1e4000" if abs(data) >= 10**4000 and isinstance(data, int) else repr(data))


def document(name: str, content: bytes, size: int = 0) -> dict[str, Any]:
    """Return the content of a run file, of which `content` may be the beginning, as plain data.

    Raises
    ------
    RunFileError
        Too large, not UTF-8, not TOML; with the line and the remedy.
    """
    if content[:8] == b"\x89HDF\r\n\x1a\n":
        raise _refused(name, "the file", "a result (NetCDF)", "a run file (TOML); nontwist info shows results")
    if name.endswith(".py"):
        raise _refused(name, "the file", "a Python script", f"a run file (TOML); python {name} runs scripts")
    if (size := max(size, len(content))) > LARGEST:
        accepted = f'at most {LARGEST / 1e6:g} MB; a long table goes into a CSV file: [[load]] kind = "csv"'
        raise _refused(name, "the file", f"{size / 1e6:.7g} MB", accepted)
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise _refused(name, "line 1", "UTF-16 text", "UTF-8 text: save the file in this encoding")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        given = f"the byte 0x{content[error.start]:02x}, which is not UTF-8"
        raise _refused(name, f"line {line}", given, "UTF-8 text: save the file in this encoding") from error
    return parsed(name, text.replace("\r\n", "\n"))


def parsed(name: str, text: str) -> dict[str, Any]:
    """Return TOML as plain data; errors as in `document`."""
    tokens = re.split(r"[,=\[\]{}#\n]", text.replace(" ", "").replace("\t", ""))
    if any(len(re.findall(r"[^.]\.", token)) > DEEPEST for token in tokens):
        raise _refused(name, "the file", f"a key of more than {DEEPEST} parts", "keys such as body.inertia")
    try:
        return bounded(tomllib.loads(text, parse_float=_number))
    except RecursionError as error:
        raise _refused(name, "the file", "lists or tables nested too deeply", "lists of lists of numbers") from error
    except tomllib.TOMLDecodeError as error:
        raise RunFileError(name, (_explained(text, str(error)),)) from error
    except ValueError as error:  # digits beyond Python's limit
        raise _refused(name, "the file", "a number of thousands of digits", "numbers up to 1e60") from error


def split_override(override: str) -> tuple[list[str], Any]:
    """Return the parts of the key and the value of "key=value"; the value is TOML, `LEFT_OUT` where there is none.

    Raises
    ------
    ValueError
        No "=", or a value that is not TOML.
    """
    key, sign, text = (part.strip() for part in override.partition("="))
    if not (sign and key):
        raise ValueError(f"{override} -> KEY=VALUE, for example body.mass=2.5")
    if not text:
        return key.split("."), LEFT_OUT
    try:
        value = parsed("", f"value = {text}\n")
    except RunFileError as error:
        quoted = f"; for text '{key}={json.dumps(text)}'" if re.fullmatch(r"[A-Za-z_][\w./ -]*", text) else ""
        if decimal := re.fullmatch(r"([+-]?\d+),(\d+)", text):
            quoted = f"; with a decimal point {key}={decimal[1]}.{decimal[2]}"
        raise ValueError(f"{override}: {text} is not a TOML value -> {VALUES}{quoted}") from error
    if value.keys() != {"value"}:
        raise ValueError(f"{override} -> one value on one line")
    return key.split("."), value["value"]


def overridden(name: str, data: dict[str, Any], overrides: Iterable[str]) -> dict[str, Any]:
    """Return `data` with the values of overrides "key=value" put in; a RunFileError where there is no place for one.

    "key=" removes a key. Of step and tolerance, which exclude each other, one that is put in removes the other.
    """
    chosen = dict[str, Any]()
    for override in overrides:
        keys, value = split_override(override)
        _put(name, f"set {override}", data, keys, value)
        chosen[".".join(keys)] = value
    for one, other in (EITHER, EITHER[::-1]):
        if chosen.get(f"time.{one}", LEFT_OUT) is not LEFT_OUT and f"time.{other}" not in chosen:
            data["time"].pop(other, None)
    return data


def _put(name: str, where: str, data: Any, keys: list[str], value: Any) -> None:
    at: Any
    for k, key in enumerate(keys):
        place, is_last, at = dotted(tuple(keys[:k])), k == len(keys) - 1, key
        if isinstance(data, list):
            if not (key.isdecimal() and int(key) < len(data)):
                raise _refused(name, where, f"{place} has no entry {key}", f"0 to {len(data) - 1}")
            at = int(key)
        elif not isinstance(data, dict):
            raise _refused(name, where, f"{place} is {shown(data)}, not a table", "a key of the file")
        elif key not in data and not (is_last and value is LEFT_OUT):
            data[key] = {}
        if not is_last:
            data = data[at]
        elif value is not LEFT_OUT:
            data[at] = value
        elif isinstance(data, list) or at in data:
            del data[at]


def _refused(name: str, key: str, given: str, accepted: str) -> RunFileError:
    return RunFileError(name, (Fault(key, given, accepted),))


KEY = r"([\w.-]+)\s*=\s*"
SLIPS = (  # patterns of lines that people write, and what TOML has in their place
    (rf"{KEY}([+-]?\d+),(\d+)\s*(#.*)?", "a decimal point: {0} = {1}.{2}"),
    (
        r".*=\s*\[\s*[+-]?\d+([.,]\d+)?(,\d+)?\s*(;|\s[+-]?\d).*",
        "decimal points, and commas between numbers: [0.5, 0.0, -1.0]",
    ),
    (".*[“”„‟«»‘’‚].*", 'straight quotes: "standard"'),
    (r"([a-z_]+)", "a table in brackets, [{0}], or a value, {0} = ..."),
    (rf"{KEY}([A-Za-z_][\w -]*?)\s*(#.*)?", 'text in quotes: {0} = "{1}"'),
    (rf"{KEY}([+-]?[\d.]+)\s*[A-Za-z°].*", "a number without a unit (kg, m, s, N m, rad): {0} = {1}"),
)


def _explained(text: str, message: str) -> Fault:
    """Return what tomllib says in the words of somebody who writes their first run file."""
    place, reason = _PLACE.search(message), _PLACE.sub("", message)
    lines = text.rstrip("\n").split("\n")
    number = min(int(place[1]), len(lines)) if place and place[1] else len(lines)
    line = printable(lines[number - 1].strip())
    if text.lstrip()[:1] == "{":
        return Fault("line 1", "this looks like JSON", TOML)
    if re.match(r"(---|[\w-]+\s*:(\s|$))", line):
        return Fault(f"line {number}", f"{line} looks like YAML", TOML)
    if "overwrite" in reason or "twice" in reason:
        many = re.match(r"\[+\s*(load|event|sweep\.over)\s*\]", line)
        accepted = f"double brackets around each: [[{many[1]}]]" if many else "each key and table once"
        return Fault(f"line {number}", f"{line} is given a second time", accepted)
    for pattern, accepted in SLIPS:
        if word := re.fullmatch(pattern, line):
            return Fault(f"line {number}", line, accepted.format(*word.groups()))
    column = f", column {place[2]}" if place and place[2] else ""
    return Fault(f"line {number}{column}", f"{line} ({reason[:1].lower()}{reason[1:]})", f"TOML, with {VALUES}")


# Tables in CSV files: a line of headers, then times alone, or with the momentum of a rotor or three components.

LARGEST_TABLE = 200_000_000  # bytes
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
            content = file.read(LARGEST_TABLE + 1)
    except (OSError, ValueError) as error:
        raise ValueError(f"it cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(content) > LARGEST_TABLE:
        raise InputError("table-large", size=LARGEST_TABLE / 1e6)
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
    from ..io.run_files import open_run

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
        return self._kept[key]
