"""The base of all tables of a run file: strict numbers, no NaN, no infinity, no unknown key.

The description of a field says what is accepted. It stands in the JSON Schema, in the pages, and behind the arrow of
every message, so that there is one wording of it.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, reduce
from operator import or_
from typing import Annotated, Any, NamedTuple, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    GetJsonSchemaHandler,
    Tag,
    TypeAdapter,
    ValidationError,
    WithJsonSchema,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema

from ..geometry.arrays import AXES
from ..geometry.values import guess, nearest

# TOML written: JSON's numbers and strings are TOML's, only tables differ.

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


# What is wrong with a run file, one line each: "file: key: what was given -> what is accepted".


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


def problems_of(error: ValidationError, data: Any, root: type[Section], at: Keys = ()) -> Iterator[Fault]:
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
            yield Fault(key, "unknown key", (keys if known else "left out: this table has no keys") + belongs)
        elif one["type"] == "missing" or given is None:
            yield Fault(key, "missing", accepted)
        else:
            accepted = accepted or one["msg"].removeprefix("Input should be ")
            if suggestion := _suggestion(given, accepted):
                accepted = suggestion + accepted.removesuffix(YOUR_OWN)
            yield Fault(key, shown(given), accepted + _limit(given))


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


LARGEST_NUMBER = (
    1e60  # beyond it products overflow: the moment of inertia of the sun is 6e46 kg m², of a molecule 1e-46
)

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
YOUR_OWN = "; your own once its module is imported (nontwist --import MODULE)"
AN_AXIS = '3 numbers, not all 0, or "x", "y", "z", "-x", "-y", "-z": '


def _components(value: Any) -> Any:
    return AXES.get(value, value) if isinstance(value, str) else value


_AXIS_SCHEMA = {"anyOf": [TypeAdapter(Vector).json_schema(), {"enum": list(AXES), "type": "string"}]}


def _turning(value: list[float]) -> list[float]:
    if not any(value):
        raise ValueError("an axis of length zero has no direction")
    return value


Axis = Annotated[Vector, BeforeValidator(_components), AfterValidator(_turning), WithJsonSchema(_AXIS_SCHEMA)]
Matrix = Annotated[list[Vector], Field(min_length=3, max_length=3)]
Positive = Annotated[float, Field(gt=0)]


class Section(BaseModel):
    """A table of a run file."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)

    @classmethod
    def keys(cls) -> list[str]:
        """Return the keys, as a message on an unknown one lists them."""
        return [*cls.model_fields]


@dataclass(frozen=True, eq=False)
class OneOf:
    """Annotation of a word that is a key of `known`, or of a table that has the form of its ``kind`` in `known`.

    The dict is read whenever a file is read or the schema is made. `last` joins the last word to the others. If it is
    `open`, modules may add to it when they are imported.
    """

    known: Mapping[str, Any]
    last: str = ", "
    open: bool = False

    @property
    def words(self) -> str:
        """What is accepted."""
        *first, last = (f'"{name}"' for name in self.known)
        return f"{', '.join(first)}{self.last}{last}{YOUR_OWN * self.open}"

    @property
    def tagged(self) -> tuple[tuple[str, type[Section]], ...]:
        """The forms of tables with their tags, ``<kind>``."""
        return tuple((f"<{kind}>", form) for kind, form in self.known.items())

    @property
    def _table(self) -> TypeAdapter[Any]:
        return _any_of(self.tagged, f"one of {self.words}")

    def _word(self, word: str) -> str:
        if word not in self.known:
            raise ValueError(self.words)
        return word

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        if source is str:
            return core_schema.no_info_after_validator_function(self._word, handler(source))
        return core_schema.no_info_plain_validator_function(lambda value: self._table.validate_python(value))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        if schema["type"] == "function-after":
            return {"description": self.words, "enum": list(self.known), "type": "string"}
        return handler(self._table.core_schema)


@cache
def _any_of(tagged: tuple[tuple[str, type[Section]], ...], accepted: str) -> TypeAdapter[Any]:
    def tag(value: Any) -> str | None:
        kind = value.get("kind") if isinstance(value, dict) else getattr(value, "kind", None)
        return f"<{kind}>" if isinstance(kind, str) else None

    forms: Any = reduce(or_, (Annotated[form, Tag(kind)] for kind, form in tagged))
    return TypeAdapter(Annotated[forms, Discriminator(tag, custom_error_type="kind", custom_error_message=accepted)])


def words_of(field: FieldInfo) -> str:
    """Return what a key accepts."""
    return next((one.words for one in field.metadata if isinstance(one, OneOf)), field.description or "")


def by_key(*known: str) -> Callable[[Any], str | None]:
    """Return what tells forms apart that are tables with one of the keys `known` each: the tag is ``<key>``."""

    def form(value: Any) -> str | None:
        if isinstance(value, Section):
            value = value.__class__.model_fields
        found = [key for key in known if key in value] if isinstance(value, dict) else []
        return f"<{found[0]}>" if len(found) == 1 else None

    return form


def by_shape(value: Any) -> str:
    """Return ``<table>``, ``<rows>``, ``<values>`` or ``<number>``, the tags of forms that are told apart by shape."""
    if isinstance(value, (dict, Section)):
        return "<table>"
    if isinstance(value, list):
        return "<rows>" if value and isinstance(value[0], list) else "<values>"
    return "<number>"
