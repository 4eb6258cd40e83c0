"""TOML written: JSON's numbers and strings are TOML's, only tables differ."""

from __future__ import annotations

import json
import re
from typing import Any

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(data: dict[str, Any]) -> str:
    """Return plain data as TOML: scalars first, then a table for each dict and for each entry of a list of dicts."""
    lines, tables = [], []
    for key, item in data.items():
        if isinstance(item, dict):
            tables.append((f"[{toml_key(key)}]", item))
        elif isinstance(item, list) and item and all(isinstance(entry, dict) for entry in item):
            tables += [(f"[[{toml_key(key)}]]", entry) for entry in item]
        else:
            lines.append(f"{toml_key(key)} = {toml_value(item)}")
    for head, table in tables:
        lines += ["", head, *(f"{toml_key(key)} = {toml_value(item)}" for key, item in table.items())]
    return "\n".join(lines).strip() + "\n"


def toml_key(key: str) -> str:
    """Return a key, in quotes where it needs them."""
    return key if _BARE.fullmatch(key) else toml_value(key)


def toml_value(value: Any) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{toml_key(key)} = {toml_value(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, str):
        return "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in json.dumps(value, ensure_ascii=False))
    if isinstance(value, (bool, int, float)):
        return str(value).lower() if isinstance(value, bool) else repr(value)
    return str(value)
