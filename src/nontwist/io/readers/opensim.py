"""OpenSim storage (.sto, .mot): quaternions of bodies, ``w,x,y,z`` in a field each, or columns of numbers.

The header ends with ``endheader``; it holds ``DataType=Quaternion`` for quaternions and ``inDegrees=yes`` or ``no`` for
angles. Labels follow, then rows, separated by tabs or blanks.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from ...analysis.places import Lines, RowError, naming, place
from ...analysis.tables import Reading
from ...analysis.time_values import number
from .content import Content, stacked


def read_opensim(path: Path, how: Reading) -> Content:
    """Read a storage file."""
    with open(path, encoding="utf-8-sig", errors="replace") as file:
        stated: dict[str, str] = {}
        lines = enumerate(file, 1)
        for _, line in lines:
            if line.strip().lower() == "endheader":
                break
            key, equals, value = line.partition("=")
            if equals:
                stated[key.strip().lower()] = value.strip()
        else:
            raise ValueError(
                "there is no line 'endheader', which ends the header of .sto and .mot files; give a table without "
                "it a name that ends in .csv"
            )
        numbered = [(k, line.split()) for k, line in lines if line.strip()]
    places, rows = np.array([k for k, _ in numbered[1:]]), [row for _, row in numbered]
    if len(rows) < 2:
        raise ValueError("there is no row of data below its labels")
    labels, *cells = rows
    for k, row in enumerate(cells):
        if len(row) != len(labels):
            raise ValueError(f"{place(k, places)} has {len(row)} fields, its labels are {len(labels)}")
    with naming(places):
        return _content(labels, cells, stated, places)


def _content(labels: list[str], cells: list[list[str]], stated: dict[str, str], lines: Lines) -> Content:
    if stated.get("datatype", "").lower() == "quaternion" or any("," in cell for cell in cells[0]):
        return _quaternions(labels, cells, lines)
    units: dict[str, Literal["deg", "rad"]] = {"yes": "deg", "no": "rad"}
    unit = units.get(stated.get("indegrees", "").lower())
    columns = {
        label: np.array([_float(row[j], label, k) for k, row in enumerate(cells)]) for j, label in enumerate(labels)
    }
    note = "angles: " + (f"{unit}, as inDegrees={stated['indegrees']} says" if unit else "the header has no inDegrees")
    return Content(columns=columns, angle_unit=unit, notes=(note,), lines=lines)


def _quaternions(labels: list[str], cells: list[list[str]], lines: Lines) -> Content:
    bodies, time = {}, None
    for j, label in enumerate(labels):
        if label.lower() == "time":
            time = np.array([_float(row[j], label, k) for k, row in enumerate(cells)])
            continue
        parts = [[_float(x, label, k) for x in row[j].split(",")] for k, row in enumerate(cells)]
        bodies[label] = np.roll(stacked(parts, 4, f"quaternion {label!r}", lines), -1, axis=1)
    return Content(bodies=bodies, time=time, notes=("orientation: quaternions of OpenSim, scalar first",), lines=lines)


def _float(text: str, label: str, row: int) -> float:
    value = number(text)
    if value is None:
        raise RowError(f"the column {label!r} holds {text!r} in", row, ", which is not a number")
    return value
