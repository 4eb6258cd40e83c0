"""The base of all tables of a run file: strict numbers, no NaN, no infinity, no unknown key.

The description of a field says what is accepted. It stands in the JSON Schema, in the pages, and behind the arrow of
every message, so that there is one wording of it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, reduce
from operator import or_
from typing import Annotated, Any, get_args, get_origin

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
from pydantic_core import CoreSchema, core_schema

from ..geometry.arrays import AXES
from ..geometry.values import guess, nearest
from .files import LARGEST_NUMBER, Fault, Keys, dotted, shown, toml_value

YOUR_OWN = "; your own once its module is imported (nontwist --import MODULE)"
AN_AXIS = '3 numbers, not all 0, or "x", "y", "z", "-x", "-y", "-z": '
ALIASES = {  # names of other programs
    **dict.fromkeys(("omega", "w"), "angular_velocity"),
    **dict.fromkeys(("dt", "timestep", "h"), "step"),
    **dict.fromkeys(("duration", "tspan"), "t_end"),
    **dict.fromkeys(("J", "I"), "inertia"),
    **dict.fromkeys(("attitude", "orientation"), "rotation"),
    **{"m": "mass", "g": "gravity", "solver": "name"},
}
REPEATED = ("load", "event", "sweep")  # of lists of tables
IN_TOML = {"project=True": "start.project = true", "physical=False": "body.physical = false"}


def in_toml(text: str) -> str:
    """Return a message with the keys of run files for the arguments in Python."""
    for python, toml in IN_TOML.items():
        text = text.replace(python, toml)
    return text


class Section(BaseModel):
    """A table of a run file."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)

    @classmethod
    def known(cls) -> list[str]:
        """Return the keys, as a message on an unknown one lists them."""
        return [*cls.model_fields]


def entry(accepted: str, default: Any = ..., **bounds: Any) -> Any:
    """Return a key of a table: what it accepts in words, its default, and bounds of its value."""
    return Field(default, description=accepted, **bounds)


def _components(value: Any) -> Any:
    return AXES.get(value, value) if isinstance(value, str) else value


def _turning(value: list[float]) -> list[float]:
    if not any(value):
        raise ValueError("an axis of length zero has no direction")
    return value


Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Matrix = Annotated[list[Vector], Field(min_length=3, max_length=3)]
Positive = Annotated[float, Field(gt=0)]
_AXIS_SCHEMA = {"anyOf": [TypeAdapter(Vector).json_schema(), {"enum": list(AXES), "type": "string"}]}
Axis = Annotated[Vector, BeforeValidator(_components), AfterValidator(_turning), WithJsonSchema(_AXIS_SCHEMA)]


# Values of several forms: words and tables of a registry, and unions that are told apart by what is given.


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

    def tagged(self, source: Any = None) -> dict[str, type[Section]]:
        """Return the forms of tables by their tags, ``<kind>``."""
        return {f"<{kind}>": form for kind, form in self.known.items()}

    @property
    def _table(self) -> TypeAdapter[Any]:
        return _any_of(tuple(self.tagged().items()), f"one of {self.words}")

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


class ByForm:
    """Annotation of a union: tables are told apart by their first keys, lists of lists from lists and numbers."""

    def tagged(self, source: Any) -> dict[str, Any]:
        """Return the members of a union by their tags, ``<key>`` of a table, of others how deep lists are nested."""
        return {_tag_of(form): form for form in get_args(source)}

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        forms = self.tagged(source)
        tables = [tag for tag, form in forms.items() if _is_table(form)]

        def tag(value: Any) -> str | None:
            if isinstance(value, Section):
                return _tag_of(type(value))
            if not isinstance(value, dict):
                return f"<{_depth(value)}>"
            found = [tag for tag in tables if len(tables) == 1 or tag[1:-1] in value]
            return found[0] if len(found) == 1 else None

        choices = {tag: handler.generate_schema(form) for tag, form in forms.items()}
        return core_schema.tagged_union_schema(choices, tag)


def _is_table(form: Any) -> bool:
    return isinstance(form, type) and issubclass(form, Section)


def _tag_of(form: Any) -> str:
    if _is_table(form):
        return f"<{next(iter(form.model_fields))}>"
    depth = 0
    while (inner := get_args(form)) and get_origin(form) in (Annotated, list):
        depth += get_origin(form) is list
        form = inner[0]
    return f"<{depth}>"


def _depth(value: Any) -> int:
    depth = 0
    while isinstance(value, list):
        depth, value = depth + 1, value[0] if value else None
    return depth


BY_FORM = ByForm()


# From what is found to be wrong to faults of the file, with a guess at what was meant.


def words_of(table: Any, name: str) -> str:
    """Return what a key of a table accepts."""
    field = table.model_fields[name]
    return next((one.words for one in field.metadata if isinstance(one, OneOf)), field.description or "")


class Faults(list[Fault]):
    """What is wrong with a run file, as it is found."""

    @contextmanager
    def of(self, at: str, table: Section, name: str, accepted: str = "") -> Iterator[None]:
        """Take a ValueError for what is wrong with a key of the table that is `at` this place.

        It is the key with which the message begins, or that it names as an argument, ``step=``; else, or where that is
        missing and `name` is not, `name`.
        """
        try:
            yield
        except ValueError as error:
            said, keys = str(error), type(table).model_fields
            named = [
                word for pair in re.findall(r"^(\w+)|\b(\w+)=(?!True|False)", said) for word in pair if word in keys
            ]
            if named and (getattr(table, named[0]) is not None or getattr(table, name) is None):
                name = named[0]
            value = getattr(table, name)
            given = f"{'missing' if value is None else shown(value)} ({in_toml(said)})"
            self.append(Fault(f"{at}.{name}", given, accepted or words_of(type(table), name)))


def problems_of(error: ValidationError, data: Any, root: type[Section], at: Keys = ()) -> Iterator[Fault]:
    """Yield what pydantic found, one fault for each key.

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
        text, word = shown(given), str(path[-1])
        if one["type"] == "extra_forbidden":
            text, accepted = "unknown key", _known(word, table, kinds, root)
            outer = _described(one["loc"][:-2], root)[0]
            if outer not in (table, root) and word in outer.known():
                accepted = f"did you mean {dotted((*at, *path[:-2], word))}? {accepted}"
        elif one["type"] == "missing" or given is None:
            text = "missing"
        else:
            accepted = accepted or one["msg"].removeprefix("Input should be ")
            if suggestion := _suggestion(given, accepted):
                accepted = suggestion + accepted.removesuffix(YOUR_OWN)
            if isinstance(given, float) and not math.isfinite(given):
                accepted += f"; finite, at most {LARGEST_NUMBER:g}"
        yield Fault(dotted(at + path), text, accepted)


def _known(word: str, table: Any, kinds: Mapping[str, Any], root: Any) -> str:
    """Return the keys that a table has in place of an unknown one, and where that belongs."""
    known = table.known()
    others = [toml_value(kind.strip("<>")) for kind, form in kinds.items() if word in {*form.known()} - {*known}]
    belongs = f"; it belongs to kind = {' or '.join(others)}" if others else ""
    if not known:
        return f"left out: this table has no keys{belongs}"
    elsewhere = _elsewhere(word, table, root)
    return (f"{elsewhere}known are {', '.join(known)}" if elsewhere else nearest(word, known)) + belongs


def _elsewhere(word: str, table: Any, root: Any) -> str:
    """Return a question for the key of another table that has this name, or that this name stands for elsewhere."""
    name = ALIASES.get(word, word)
    if name in table.known() and name != word:
        return f"did you mean {name}? "
    if table is not root or name in root.known():
        return ""
    tables = ((key, form) for key in root.model_fields if key not in REPEATED for form in _forms(root, key).values())
    place = next((f"{key}.{name}" for key, form in tables if name in form.known()), None)
    return f"did you mean {place}? " if place else ""


def _suggestion(given: Any, accepted: str) -> str:
    """Return a guess at what was meant, where `accepted` names words in quotes."""
    words = re.findall(r'"([^".][^"]*)"', accepted)  # the ending of a file is none
    if given in words and accepted.startswith("a list"):
        return f'did you mean ["{given}"]? '
    return guess(given, words, '"')


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


def _described(loc: Keys, root: Any) -> tuple[Any, str, Mapping[str, Any]]:
    """Return the innermost table along `loc`, the description of the innermost key, and the kinds of that table."""
    table, accepted, forms, kinds = root, "a table", dict[str, Any](), dict[str, Any]()
    for part in loc:
        if part in forms:
            table, kinds = forms[str(part)], forms
        elif part in table.model_fields:
            accepted, forms = words_of(table, str(part)), _forms(table, str(part))
            table, kinds = (forms[""], {}) if "" in forms else (table, kinds)
    return table, accepted, kinds


def _forms(table: Any, name: str) -> dict[str, Any]:
    """Return the tables that a key of a table allows, with their tags."""
    field = table.model_fields[name]
    return dict(_tables(Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation))


def _tables(annotation: Any) -> Iterator[tuple[str, Any]]:
    if _is_table(annotation):
        yield "", annotation
    parts = get_args(annotation)
    told = [part for part in parts if isinstance(part, (OneOf, ByForm))]
    for one in told:
        yield from ((tag, form) for tag, form in one.tagged(parts[0]).items() if _is_table(form))
    for part in () if told else parts:
        yield from _tables(part)
