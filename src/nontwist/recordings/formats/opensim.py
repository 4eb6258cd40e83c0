"""OpenSim storage (.sto, .mot): quaternions of bodies, ``w,x,y,z`` in a field each, or columns of numbers.

The header ends with ``endheader``; it holds ``DataType=Quaternion`` for quaternions and ``inDegrees=yes`` or ``no`` for
angles. Labels follow, then rows, separated by tabs or blanks, or by commas where a spreadsheet has saved the file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from ...errors import InputError
from ..options import ReadOptions
from ..table import Table, place
from ..text import decoded, fields_of
from .content import Content, by_name, stacked


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
