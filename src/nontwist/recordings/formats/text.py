"""Tables in texts: CSV and its like, logs of raw counts of Gyroflow with their factors, OpenSim storage (.sto, .mot).

The header of OpenSim ends with ``endheader``; it holds ``DataType=Quaternion`` for quaternions, ``w,x,y,z`` in a field
each, and ``inDegrees=yes`` or ``no`` for angles. Labels follow, then rows, separated by tabs or blanks, or by commas
where a spreadsheet has saved the file.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ...errors import InputError
from ..options import ReadOptions
from ..table import Table, place
from ..text import decoded, fields_of, read_table
from .content import Content, by_name, stacked

SCALES = {"t": ("tscale", "s"), "g": ("gscale", "rad/s"), "a": ("ascale", "g"), "m": ("mscale", "")}


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
        key, unit = SCALES.get(header[:1], ("", ""))
        is_scaled = key in above and (header == "t" or header[1:] in ("x", "y", "z"))
        values = content.table.numbers(header) * float(above[key]) if is_scaled else content.table.columns[header]
        columns[f"{header} ({unit})" if is_scaled and unit else header] = values
    note = "counts: times the factors in the lines above them"
    return replace(content, table=replace(content.table, columns=columns), notes=(*content.notes, note))


def read_opensim(path: Path, how: ReadOptions) -> Content:
    """Read a storage file."""
    lines = decoded(path.read_bytes()).splitlines()
    above = [line.strip(" \t,;\r") for line in lines]
    end = next((k for k, line in enumerate(above) if line.lower() == "endheader"), None)
    if end is None:
        raise InputError("no-endheader")
    stated = {key.strip().lower(): value.strip() for key, _, value in (line.partition("=") for line in above[:end])}
    numbered = [(k, line) for k, line in enumerate(lines[end + 1 :], end + 2) if line.strip(" \t,;")]
    if len(numbered) < 2:
        raise InputError("no-rows")
    first = numbered[0][1]
    sign = next((one for one in ",;" if one in first and "\t" not in first), None)
    labels, *cells = [fields_of(line, sign) for _, line in numbered]
    if sign == ";" and not any("." in cell for cell in cells[0]):
        cells = [[cell.replace(",", ".") for cell in row] for row in cells]
    places = np.array([k for k, _ in numbered[1:]])
    for k, row in enumerate(cells):
        if len(row) != len(labels):
            raise InputError("labels", place=place(k, places), count=len(row), labels=len(labels))
    columns = (np.array(one, dtype=object) for one in zip(*cells, strict=True))
    table = Table(by_name("column", zip(labels, columns, strict=True)), places)
    if stated.get("datatype", "").lower() == "quaternion" or any("," in cell for cell in cells[0]):
        return _quaternions(table)
    units: dict[str, Literal["deg", "rad"]] = {"yes": "deg", "no": "rad"}
    unit = units.get(stated.get("indegrees", "").lower())
    note = "angles: " + (f"{unit}, as inDegrees={stated['indegrees']} says" if unit else "the header has no inDegrees")
    numbers = {label: table.numbers(label) for label in labels}
    return Content(Table(numbers, places), angle_unit=unit, notes=(note,))


def _quaternions(table: Table) -> Content:
    bodies, time = {}, None
    for label, cells in table.columns.items():
        if label.lower() == "time":
            time = table.numbers(label)
        else:
            numbers = stacked([cell.split(",") for cell in cells], 4, f"quaternion {label!r}", table.lines)
            bodies[label] = np.roll(numbers, -1, axis=1)
    note = "orientation: quaternions of OpenSim, scalar first"
    return Content(bodies=bodies, time=time, notes=(note,), lines=table.lines)
