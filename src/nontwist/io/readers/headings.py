"""Headers of columns, from the lines above the first row of data.

They are in the line above it, or in the last comment (``#``, ``//``, ``%``) where that has as many fields; a line of
units between them joins them. Names of bodies in further lines join them too: OptiTrack Motive has lines ``Type``,
``Name``, ``ID`` and ``Rotation`` or ``Position`` above ``X Y Z W``; Qualisys QTM has ``BODY_NAMES``, and the name
before the first header of each body.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ...analysis.headers import ANGLES
from ...analysis.time_values import known_unit, number

COMMENTS = ("//", "#", "%")
UNITS = {*ANGLES, "", "-", "no_units", "no units", "n/a", "g", "m/s^2", "m/s2", "m/(s^2)", "deg/s", "rad/s", "ut", "mt"}
UNITS |= {"deg c", "°c", "kpa", "hpa", "pa", "m", "mm"}


def fields_of(line: str, separator: str | None) -> list[str]:
    """Return the fields of a line, those in quotes without them; None: separated by blanks."""
    if separator is None:
        return line.split()
    if '"' in line:
        import csv

        return [field.strip() for field in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
    return [field.strip() for field in line.split(separator)]


def headers_of(
    above: Sequence[str], separator: str | None, row: Sequence[str], guess: Callable[[str], str | None]
) -> list[str] | None:
    """Return the headers of a row of data, from the lines above it; None where there are none.

    `guess` tells what separates the fields of a line.
    """
    told = [line.strip("\r\n") for line in above if line.strip() and not line.lstrip().startswith(COMMENTS)]
    units: list[str] = []
    if len(told) > 1:
        fields = [field.strip('[]() "') for field in fields_of(told[-1], separator)]
        if any(fields) and all(field.lower() in UNITS or known_unit(field) for field in fields):
            units, told = fields, told[:-1]
    if told:
        names = _cleaned(told[-1], separator, len(row))
        filled = [name for name in names if name]
        if len(filled) == len(_filled(row)) < len(names):  # Qualisys: two tabs between the headers of two bodies
            names = filled
        names = _with_bodies(told[:-1], names, separator)
        if row and len(_filled(row)) > len(names):
            raise ValueError(f"there are {len(names)} headers, but {len(row)} fields in the first row of numbers")
        if len(units) == len(names):
            names = [f"{name} ({unit})" if unit else name for name, unit in zip(names, units, strict=True)]
        return names
    for line in reversed(above):
        text = line.strip().lstrip("#/% ")
        for sign in (separator, guess(text)):
            if len(names := _cleaned(text, sign, len(row))) == len(row) and None in map(number, names):
                return names
    return None


def _with_bodies(above: Sequence[str], names: list[str], separator: str | None) -> list[str]:
    """Return the headers with the name of their body before them, where lines above tell it."""
    rows = [_cleaned(line, separator, len(names)) for line in above]
    listed = next((row[1:] for row in rows if row[0] == "BODY_NAMES"), [])
    if listed:
        body, joined = "", []
        for name in names:
            start = next((one for one in listed if name.startswith(f"{one} ")), None)
            body, name = (start, name[len(start) + 1 :]) if start else (body, name)
            joined.append(f"{body} {name}".strip())
        return joined
    rows = [row for row in rows if len(row) == len(names)]
    if len(set(names)) == len(names) or len(rows) < 3:
        return names
    told = next((row for row in rows if "Name" in row[:2]), rows[1])
    return [
        f"{body} {kind} {name}".strip() if kind else name
        for body, kind, name in zip(told, rows[-1], names, strict=True)
    ]


def _filled(fields: Sequence[str]) -> Sequence[str]:
    """Drop the empty fields at the end."""
    return fields[: max((k + 1 for k, field in enumerate(fields) if field), default=0)]


def _cleaned(line: str, separator: str | None, count: int) -> list[str]:
    """Return the headers in a line, without quotes and without what a separator at its end leaves."""
    names = [name.strip().strip('"').strip() for name in fields_of(line, separator)]
    while len(names) > count > 0 and not names[-1]:
        names.pop()
    return names


def distinct(names: Sequence[str]) -> list[str]:
    """Return the headers, the repeated ones with a number as pandas gives them."""
    seen: dict[str, int] = {}
    distinct = []
    for name in names:
        seen[name] = seen.get(name, -1) + 1
        distinct.append(f"{name}.{seen[name]}" if seen[name] else name)
    return distinct
