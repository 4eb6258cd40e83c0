"""The base of all tables of a run file: strict numbers, no NaN, no infinity, no unknown key.

The description of a field says what is accepted. It stands in the JSON Schema, in the pages, and behind the arrow of
every message, so that there is one wording of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, reduce
from operator import or_
from typing import Annotated, Any

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
    WithJsonSchema,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema

from ..geometry.arrays import AXES

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
