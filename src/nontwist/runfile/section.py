"""The base of all tables of a run file: strict numbers, no NaN, no infinity, no unknown key.

The description of a field says what is accepted. It stands in the JSON Schema, in the pages, and behind the arrow of
every message, so that there is one wording of it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, dataclass
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    TypeAdapter,
    ValidationError,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from ..geometry.arrays import AXES
from ..geometry.values import guess, meant, nearest
from ..spec import Spec
from .files import LARGEST_NUMBER, Fault, Keys, dotted, plain, shown, toml_value

YOUR_OWN = "; your own once its module is imported (nontwist --import MODULE)"
AN_AXIS = '3 numbers, not all 0, or "x", "y", "z", "-x", "-y", "-z": '
UNKNOWN = "unknown key"
MOST_PROBLEMS = 100  # that are reported
IN_TOML = {"project=True": "start.project = true", "physical=False": "body.physical = false"}


def in_toml(text: str) -> str:
    """Return a message with the keys of run files for the arguments in Python."""
    for python, toml in IN_TOML.items():
        text = text.replace(python, toml)
    return text


class Section(BaseModel):
    """A table of a run file.

    What is wrong with its keys it says itself, as one error of the type "found": pydantic takes that to the tables
    around it, which put their keys before.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)
    kinds: ClassVar[Mapping[str, type[Section]]] = {}  # that may stand in its place, by what tells them
    is_whole: ClassVar[bool] = False  # whether it is the file

    @classmethod
    def known(cls) -> list[str]:
        """Return the keys, as a message on an unknown one lists them."""
        return [*cls.model_fields]

    @model_validator(mode="wrap")
    @classmethod
    def _checked(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        try:
            return handler(data)
        except ValidationError as error:
            if not isinstance(data, dict):
                raise
            found = dict[Keys, Found]()
            for one in found_in(error, cls):
                found.setdefault(one.path, one)
                if len(found) == MOST_PROBLEMS:
                    break
            raise PydanticCustomError("found", "wrong keys", {"found": [*found.values()]}) from None


def entry(accepted: str, default: Any = ..., unit: str = "", **bounds: Any) -> Any:
    """Return a key of a table: what it accepts in words, with ``{unit}`` for its unit, its default, and its bounds."""
    found: Any = Field(default, description=accepted.replace("{unit}", unit), **bounds)
    found.metadata.append(Spec(accepted, unit=unit))
    return found


def _turning(value: list[float]) -> list[float]:
    if not any(value):
        raise ValueError("an axis of length zero has no direction")
    return value


Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Matrix = Annotated[list[Vector], Field(min_length=3, max_length=3)]
Positive = Annotated[float, Field(gt=0)]
_AXIS_SCHEMA = {"anyOf": [TypeAdapter(Vector).json_schema(), {"enum": list(AXES), "type": "string"}]}
_OF_LETTER = BeforeValidator(lambda x: AXES.get(x, x) if isinstance(x, str) else x)
Axis = Annotated[Vector, _OF_LETTER, AfterValidator(_turning), WithJsonSchema(_AXIS_SCHEMA)]


# Keys that follow from a type and its description.


def key_of(form: Any, default: Any, spec: Spec) -> tuple[Any, Any]:
    """Return the type of a key, and the key."""
    kind = type_of(form, spec) if default is not None else type_of(form, spec) | None
    return kind, entry(accepted(form, spec), ... if default is MISSING else plain(default), unit=spec.unit)


def type_of(form: Any, spec: Spec) -> Any:
    """Return the type of a key from that of a field and its description."""
    if get_origin(form) is Literal:
        return form
    if spec.rule.startswith("direction"):
        return Axis
    found: Any = Positive if spec.rule == "positive" else float
    for n in reversed(spec.shape):
        least, most = (n, n) if isinstance(n, int) else (2 if spec.rule == "increasing" else None, None)
        found = Annotated[list[found], Field(min_length=least, max_length=most)]
    return found


def accepted(form: Any, spec: Spec) -> str:
    """Return what a key accepts, in words."""
    if get_origin(form) is Literal:
        *first, last = map('"{}"'.format, get_args(form))
        return spec.text or f"{', '.join(first)} or {last}"
    if spec.rule.startswith("direction"):
        return (AN_AXIS + spec.text).removesuffix(": ")
    number = "a positive number" if spec.rule == "positive" else "a number"
    words = "2 or more increasing numbers" if spec.rule == "increasing" else "numbers" if spec.shape else number
    for n in reversed(spec.shape):
        if isinstance(n, int):
            words = f"{n} {words}" if words == "numbers" else f"{n} rows of {words}"
        elif words != "numbers" and spec.rule != "increasing":
            words = f"rows of {words}" if len(spec.shape) == 2 else f"{words} for each"
    bound = spec.rule if spec.rule in ("not negative", "at least 0 and below 1") else ""
    return ", ".join(filter(None, (words, bound, spec.unit))) + f": {spec.text}" * bool(spec.text)


# Values of several forms: words and tables of a registry, and unions that are told apart by what is given.


@dataclass(frozen=True, eq=False)
class OneOf:
    """Annotation of a word that is a key of `known`, or of a table that has the form of its ``kind`` in `known`.

    The dict is read whenever a file is read or the schema is made. `last` joins the last word to the others. If it is
    `open`, modules may add to it when they are imported. `default` is the kind of a table without one, if there is one.
    """

    known: Mapping[str, Any]
    last: str = ", "
    open: bool = False
    default: str = ""

    @property
    def words(self) -> str:
        """What is accepted."""
        *first, last = (f'"{name}"' for name in self.known)
        return f"{', '.join(first)}{self.last}{last}{YOUR_OWN * self.open}"

    def _word(self, word: str) -> str:
        if word not in self.known:
            raise ValueError(self.words)
        return word

    def _table(self, value: Any) -> Section:
        if (kind := self._kind_of(value)) not in self.known:
            raise PydanticCustomError("kind", "{words}", {"words": f"one of {self.words}"})
        table: Section = self.known[kind].model_validate(value)
        return table

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        if source is str:
            return core_schema.no_info_after_validator_function(self._word, handler(source))
        source.kinds = self.known
        return core_schema.no_info_plain_validator_function(self._table)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        if schema["type"] == "function-after":
            return {"description": self.words, "enum": list(self.known), "type": "string"}
        choices: dict[Any, Any] = {kind: form.__pydantic_core_schema__ for kind, form in self.known.items()}
        return handler(core_schema.tagged_union_schema(choices, self._kind_of))

    def _kind_of(self, value: Any) -> str:
        kind = value.get("kind", self.default) if isinstance(value, dict) else getattr(value, "kind", None)
        return kind if isinstance(kind, str) else ""


class ByForm:
    """Annotation of a union: tables are told apart by their first keys, lists of lists from lists and numbers."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        forms = {_tag_of(form): form for form in get_args(source)}
        tables = {tag: form for tag, form in forms.items() if _is_table(form)}
        for form in tables.values():
            form.kinds = tables

        def tag(value: Any) -> str | None:
            if isinstance(value, Section):
                return _tag_of(type(value))
            if isinstance(value, dict):
                found = [tag for tag in tables if len(tables) == 1 or tag in value]
                return found[0] if len(found) == 1 else None
            depth = 0
            while isinstance(value, list):
                depth, value = depth + 1, value[0] if value else None
            return str(depth)

        choices = {tag: handler.generate_schema(form) for tag, form in forms.items()}
        return core_schema.tagged_union_schema(choices, tag)


def _is_table(form: Any) -> bool:
    return isinstance(form, type) and issubclass(form, Section)


def _tag_of(form: Any) -> str:
    """Return the first key of a table, of others how deep lists are nested."""
    return str(next(iter(form.model_fields)) if _is_table(form) else str(form).count("list["))


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
        missing and `name` is not, or what is `accepted` is given, `name`.
        """
        try:
            yield
        except ValueError as error:
            said, keys = str(error), type(table).model_fields
            named = [
                word for pair in re.findall(r"^(\w+)|\b(\w+)=(?!True|False)", said) for word in pair if word in keys
            ]
            if not accepted and named and (getattr(table, named[0]) is not None or getattr(table, name) is None):
                name = named[0]
            value = getattr(table, name)
            given = f"{'missing' if value is None else shown(value)} ({in_toml(said)})"
            self.append(Fault(f"{at}.{name}", given, accepted or words_of(type(table), name)))


class Found(NamedTuple):
    """A fault, in a table: the path of the key from there, and where an unknown one belongs, if that is known."""

    path: Keys
    given: str
    accepted: str
    place: Keys = ()

    def within(self, at: Keys, table: type[Section]) -> Found:
        """Return the same as it is found from a table around; an unknown key may belong there."""
        place = at + self.place if self.place else ()
        if at and self.given == UNKNOWN and len(self.path) == 1 and not table.is_whole:
            place = self.path if self.path[0] in table.known() else ()
        return self._replace(path=at + self.path, place=place)


def found_in(error: ValidationError, table: type[Section] = Section) -> Iterator[Found]:
    """Yield what pydantic has found in a table, and what tables in it have found themselves."""
    for one in error.errors(include_url=False):
        # names of forms stand between a key and the numbers of entries
        at, given = tuple(part for k, part in enumerate(one["loc"]) if k == 0 or isinstance(part, int)), one["input"]
        accepted = words_of(table, str(at[0])) if at and at[0] in table.model_fields else ""
        if one["type"] == "found":
            yield from (inner.within(at, table) for inner in one["ctx"]["found"])
        elif one["type"] == "extra_forbidden":
            yield _unknown(str(at[0]), table)
        elif one["type"] == "kind" and isinstance(given, dict):
            yield _refused((*at, "kind"), given.get("kind"), one["msg"])
        elif one["type"] == "missing":
            yield Found(at, "missing", accepted)
        else:
            yield _refused(at, given, accepted or one["msg"].removeprefix("Input should be "))


def _refused(path: Keys, given: Any, accepted: str) -> Found:
    if given is None:
        return Found(path, "missing", accepted)
    words = re.findall(r'"([^".][^"]*)"', accepted)  # the ending of a file is none
    is_listed = given in words and accepted.startswith("a list")
    suggestion = f'did you mean ["{given}"]? ' if is_listed else guess(given, words, '"')
    if suggestion:
        accepted = suggestion + accepted.removesuffix(YOUR_OWN)
    if isinstance(given, float) and not math.isfinite(given):
        accepted += f"; finite, at most {LARGEST_NUMBER:g}"
    return Found(path, shown(given), accepted)


def _unknown(word: str, table: type[Section]) -> Found:
    """Return what keys a table has in place of an unknown one, and where that belongs."""
    known, names = table.known(), (word, *meant(word))
    inner: dict[str, Any] = {key: one.annotation for key, one in table.model_fields.items() if table.is_whole}
    tables = {key: form.known() for key, form in inner.items() if _is_table(form)}
    place = next(((key, name) for key, own in tables.items() for name in names if name in own), ())
    accepted = nearest(word, known) if known else "left out: this table has no keys"
    own = [name for name in names if name in known]
    if own or place:
        accepted = "".join(f"did you mean {name}? " for name in own[:1]) + f"known are {', '.join(known)}"
    others = [kind for kind, form in table.kinds.items() if word in {*form.known()} - {*known}]
    told = [toml_value(kind) if "kind" in known else f"{{ {kind} = ... }}" for kind in others]
    if others:
        accepted += f"; it belongs to {'kind = ' * ('kind' in known)}{' or '.join(told)}"
    return Found((word,), UNKNOWN, accepted, place)


def problems_of(error: ValidationError, at: Keys = ()) -> Iterator[Fault]:
    """Yield what is wrong with a table, or with several; `at` is where it lies in the file."""
    for path, given, accepted, place in found_in(error):
        meant = f"did you mean {dotted(at + place)}? " if place else ""
        yield Fault(dotted(at + path), given, meant + accepted)
