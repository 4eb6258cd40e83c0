"""What is wrong with a run file, one line each: "file: key: what was given -> what is accepted"."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any, NamedTuple, get_args

from pydantic import Tag, ValidationError

from ..geometry.values import guess, nearest
from .section import LARGEST_NUMBER, YOUR_OWN, OneOf, Section, words_of
from .toml_text import toml_key, toml_value

LONGEST = 60  # letters of a value that are shown
ALIASES = {  # names of other programs
    "omega": "angular_velocity",
    "w": "angular_velocity",
    "dt": "step",
    "timestep": "step",
    "h": "step",
    "duration": "t_end",
    "tspan": "t_end",
    "J": "inertia",
    "I": "inertia",
    "m": "mass",
    "attitude": "rotation",
    "orientation": "rotation",
    "solver": "name",
}
REPEATED = ("load", "event", "sweep")  # of lists of tables
Keys = tuple[str | int, ...]


class Problem(NamedTuple):
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
    if isinstance(value, Section):
        value = value.model_dump(exclude_unset=True)
    if isinstance(value, dict):
        return f"a table with {printable(', '.join(map(toml_key, value)))}" if value else "an empty table"
    if isinstance(value, list) and any(isinstance(entry, dict) for entry in value):
        return "a list of tables"
    return printable(toml_value(value))


def dotted(path: Keys) -> str:
    """Return a path as a key: ``load.0.amplitude``."""
    return ".".join(printable(toml_key(str(part))) for part in path)


def problems_of(error: ValidationError, data: Any, root: type[Section], at: Keys = ()) -> Iterator[Problem]:
    """Yield what pydantic found, one problem for each key.

    Parameters
    ----------
    error : ValidationError
    data : the document that was checked, as tomllib gave it
    root : the table it was checked against
    at : where `data` lies in the file
    """
    seen: set[Keys] = set()
    for one in error.errors(include_url=False):
        path, given = _in_data(one["loc"], data, one["type"] == "missing")
        table, accepted, kinds = _described(one["loc"], root)
        if one["type"] == "kind" and isinstance(given, dict):
            path, given, accepted = (*path, "kind"), given.get("kind"), one["msg"]
        if path in seen:
            continue
        seen.add(path)
        key = dotted(at + path)
        if one["type"] == "extra_forbidden":
            unknown = str(path[-1])
            others = [
                toml_value(str(kind).strip("<>"))
                for kind, form in kinds.items()
                if unknown in set(form.keys()) - set(table.keys())
            ]
            belongs = f"; it belongs to kind = {' or '.join(others)}" if others else ""
            elsewhere, known = _elsewhere(unknown, table, root), table.keys()
            keys = f"{elsewhere}known are {', '.join(known)}" if elsewhere else nearest(unknown, known)
            yield Problem(key, "unknown key", (keys if known else "left out: this table has no keys") + belongs)
        elif one["type"] == "missing" or given is None:
            yield Problem(key, "missing", accepted)
        else:
            accepted = accepted or one["msg"].removeprefix("Input should be ")
            if suggestion := _suggestion(given, accepted):
                accepted = suggestion + accepted.removesuffix(YOUR_OWN)
            yield Problem(key, shown(given), accepted + _limit(given))


def _suggestion(given: Any, accepted: str) -> str:
    """Return a guess at what was meant, where `accepted` names words in quotes."""
    words = re.findall(r'"([^".][^"]*)"', accepted)  # the ending of a file is none
    if given in words and accepted.startswith("a list"):
        return f'did you mean ["{given}"]? '
    return guess(given, words, '"')


def _elsewhere(word: str, table: type[Section], root: type[Section]) -> str:
    """Return a question for the key of another table that has this name, or that this name stands for elsewhere."""
    name, own, top = ALIASES.get(word, word), {*table.keys()}, {*root.keys()}
    if name in own and name != word:
        return f"did you mean {name}? "
    if table is not root or name in top:
        return ""
    tables = [(key, form) for key in root.model_fields for _, form in _forms(root.model_fields[key].annotation, "")]
    places = [f"{key}.{name}" for key, form in tables if name in {*form.keys()} and key not in REPEATED]
    return f"did you mean {places[0]}? " if places else ""


def _limit(given: Any) -> str:
    unbounded = isinstance(given, float) and not math.isfinite(given)
    return f"; finite, at most {LARGEST_NUMBER:g}" if unbounded else ""


def path_in(data: Any, loc: Keys) -> Keys:
    """Return the part of `loc` that is a path in `data`."""
    return _in_data(loc, data, False)[0]


def _in_data(loc: Keys, data: Any, missing: bool) -> tuple[Keys, Any]:
    """Return the part of `loc` that is a path in `data`, and what lies there; the rest is pydantic's own."""
    path: list[str | int] = []
    for k, part in enumerate(loc):
        found = part in data if isinstance(data, dict) else isinstance(data, list) and isinstance(part, int)
        if found:
            path.append(part)
            data = data[part]
        elif missing and k == len(loc) - 1:
            path.append(part)
    return tuple(path), data


def _described(loc: Keys, root: type[Section]) -> tuple[type[Section], str, dict[str | int, type[Section]]]:
    """Return the innermost table along `loc`, the description of the innermost key, and the kinds of that table."""
    forms: dict[str | int, type[Section]] = {}
    kinds: dict[str | int, type[Section]] = {}
    table, accepted = root, "a table"
    for part in loc:
        if part in forms:
            table, kinds = forms[part], forms
        elif part in table.model_fields:
            field = table.model_fields[str(part)]
            accepted, forms = words_of(field), dict(_forms(field.annotation, ""))
            table = forms.get("", table)
    return table, accepted, kinds


def _forms(annotation: Any, tag: str) -> Iterator[tuple[str, type[Section]]]:
    """Yield the tables that an annotation allows, with their tags."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        yield tag, annotation
    parts = get_args(annotation)
    own = next((part.tag for part in parts if isinstance(part, Tag)), tag)
    for part in parts:
        yield from part.tagged if isinstance(part, OneOf) else _forms(part, own)
