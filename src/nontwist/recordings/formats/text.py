"""CSV and its like: columns by their headers; logs of raw counts of Gyroflow, with their factors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from ..options import ReadOptions
from ..text import read_table
from .content import Content

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
