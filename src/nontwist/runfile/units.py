"""Units of the numbers of a run file, from the descriptions of their keys."""

from __future__ import annotations

import re

from ..units import RATE, in_datasets
from .document import RunFile
from .section import Section

UNITS = ("kg m² s⁻¹", "kg m²", "N m s", "N m", "N/m", "rad/s", "m/s²", "Hz", "rad", "kg/m³", "kg", "m", "s")
UNIT = re.compile(rf"(?:^|, )({'|'.join(map(re.escape, UNITS))})(?=[:;,]|$)")


def unit_of(file: RunFile, key: str) -> str | None:
    """Return the unit of the numbers under a dotted key, as ``load.0.frequency``; None if it is not one of these."""
    value, text = file, ""
    for part in key.split("."):
        if isinstance(value, list) and part.isdecimal() and int(part) < len(value):
            value = value[int(part)]
        elif isinstance(value, Section) and part in type(value).model_fields:
            if (unit := getattr(value, "unit", None)) in RATE:
                return in_datasets(unit)
            text = type(value).model_fields[part].description or text
            value = getattr(value, part)
    found = UNIT.search(text)
    return in_datasets(found[1]) if found else None
