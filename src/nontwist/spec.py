"""Descriptions of options: a frozen dataclass whose fields say what they mean makes signatures, docstrings and checks.

    @dataclass(frozen=True, kw_only=True)
    class ReadOptions:
        rate: Annotated[float | None, Spec("Samples per second.", "HZ")] = None

    @takes(ReadOptions)
    def read_motion(source, columns=None, **options): ...

`read_motion` then has the keyword `rate` in its signature and in its docstring, and the commands have ``--rate HZ``.
"""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from .errors import InputError, PythonOptions
from .geometry.values import among, hinted, short_repr

F = TypeVar("F", bound=Callable[..., Any])
BOUNDS: dict[str, Any] = {
    "positive": (lambda x: x <= 0, "must be positive"),
    "not negative": (lambda x: x < 0, "must not be negative"),
    "at least 0 and below 1": (lambda x: (x < 0) | (x >= 1), "must be at least 0 and below 1"),
}
SYMMETRIC = 1e-12  # of a matrix, relative
NAMES: dict[Any, str] = {str: "str", bool: "bool", float: "float", Sequence: "sequence of str"}
WORDS: dict[Any, str] = {str: "a text", bool: "True or False", float: "a number", Sequence: "a list of texts"}


@dataclass(frozen=True)
class Spec:
    """What a field means, in sentences for docstrings and helps; how a command writes its value and option; its unit.

    Sentences name options as those of messages do: ``{option[rate]}``. Of a field that is a number or an array, `shape`
    says which, a name in it being the length of another field, and `rule` what else holds: "positive", "not negative",
    "at least 0 and below 1", "increasing", "symmetric", "direction in the body" or "direction in space". `option` is
    its name for callers, if it has another. One that `is_fixed` is no parameter of derivatives.
    """

    text: str
    metavar: str = ""
    option: str = ""
    unit: str = ""
    shape: tuple[int | str | None, ...] = ()
    rule: str = ""
    is_fixed: bool = False


@cache
def specs(owner: Any) -> dict[str, tuple[Any, Any, Spec]]:
    """Return type, default and description of the fields of a dataclass, or parameters of a function, that have one."""
    hints = get_type_hints(owner, include_extras=True)
    if is_dataclass(owner):
        defaults: dict[str, Any] = {one.name: one.default for one in fields(owner)}
    else:
        parameters = inspect.signature(owner).parameters.values()
        defaults = {one.name: MISSING if one.default is one.empty else one.default for one in parameters}
    described = ((name, get_args(hints.get(name))) for name in defaults if get_origin(hints.get(name)) is Annotated)
    return {name: (kind, defaults[name], spec) for name, (kind, spec) in described}


def as_specified(record: Any, name: str) -> Any:
    """Return the value of a field that is a word, a number or an array; a ValueError where it is not as described."""
    import numpy as np

    from .geometry.arrays import as_array, as_direction, increasing, refuse

    kind_of_record: Any = type(record)
    value, (kind, default, spec) = getattr(record, name), specs(kind_of_record)[name]
    name = spec.option or name
    if get_origin(kind) is Literal:
        if not among(value, get_args(kind)):
            words = get_args(kind)
            known = " or ".join(map(repr, words)) if len(words) == 2 else f"one of {', '.join(words)}"
            raise ValueError(f"{name} must be {known}, got {short_repr(value)}")
        return value
    if value is None and default is None:
        return None
    if spec.rule.startswith("direction in "):
        return as_direction(value, name, spec.rule.removeprefix("direction in "))
    array = as_array(value, name, tuple(np.size(getattr(record, n)) if isinstance(n, str) else n for n in spec.shape))
    if spec.rule in BOUNDS:
        is_wrong, words = BOUNDS[spec.rule]
        refuse(is_wrong(array), name, lambda i: f"{words}, got {array[i]:g} {spec.unit}".rstrip())
    if spec.rule == "increasing":
        increasing(array, jumps=True)
    if spec.rule == "symmetric":
        if (gap := abs(array - array.T).max()) > SYMMETRIC * abs(array).max():
            raise ValueError(f"{name} is not symmetric: entries differ by {gap:.3g}; give (A + Aᵀ)/2")
        return (array + array.T) / 2
    return array if spec.shape else float(array)


def require_types(record: Any) -> None:
    """Raise an InputError where a field of a dataclass holds what its type excludes."""
    kind_of_record: Any = type(record)
    for name, (kind, _, _) in specs(kind_of_record).items():
        value = getattr(record, name)
        if not any(_fits(value, one) for one in _kinds(kind)):
            raise InputError("type", name=name, words=_named(kind, WORDS, "'"), value=short_repr(value))


def _kinds(kind: Any) -> tuple[Any, ...]:
    return get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)


def _fits(value: Any, kind: Any) -> bool:
    import numpy as np

    if get_origin(kind) is Literal:
        return isinstance(value, str) and value in get_args(kind)
    if get_origin(kind) is Sequence:
        return isinstance(value, Sequence) and not isinstance(value, str) and all(isinstance(x, str) for x in value)
    if kind is float:
        return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    return isinstance(value, (bool, np.bool_) if kind is bool else kind)


def takes(cls: type, *names: str) -> Callable[[F], F]:
    """Give a function fields of `cls`, by default all, as keywords in its signature and docstring.

    They take the place of ``**options``, and of a line ``{cls}`` below Parameters.
    """

    def described(function: F) -> F:
        chosen = {name: one for name, one in specs(cls).items() if not names or name in names}
        with_keywords(function, {name: (kind, default) for name, (kind, default, _) in chosen.items()})
        rows = []
        for name, (kind, default, spec) in chosen.items():
            filled = textwrap.fill(spec.text.format(option=PythonOptions()), 108)
            unit = f", {spec.unit}" if spec.unit else ""
            rows.append(f"{name} : {_named(kind)}{unit}{', optional' if default is None else ''}")
            rows.append(textwrap.indent(filled, "    "))
        text = inspect.cleandoc(function.__doc__ or "")  # as Python 3.13 keeps it
        function.__doc__ = text.replace(f"{{{cls.__name__}}}\n", "\n".join(rows) + "\n")
        return hinted(function)

    return described


def with_keywords(function: Any, keywords: Mapping[str, tuple[Any, Any]], last: Sequence[str] = ()) -> None:
    """Give a function keywords in its signature, by name their types and defaults, in place of ``**keywords``.

    Its own keywords stand before them, but for those named `last`, and win over those of the same name.
    """
    signature, kind = inspect.signature(function), inspect.Parameter
    own = {name: one for name, one in signature.parameters.items() if one.kind is not kind.VAR_KEYWORD}
    more = [
        kind(name, kind.KEYWORD_ONLY, default=default, annotation=form)
        for name, (form, default) in keywords.items()
        if name not in own
    ]
    before, behind = ([one for name, one in own.items() if (name in last) == is_last] for is_last in (False, True))
    function.__signature__ = signature.replace(parameters=[*before, *more, *behind])


def _named(kind: Any, names: Mapping[Any, str] = NAMES, mark: str = '"') -> str:
    """Return the types of which a value may be one, but for that of None; words stand between quotation marks."""
    return " or ".join(
        " or ".join(f"{mark}{word}{mark}" for word in get_args(one))
        if get_origin(one) is Literal
        else names[get_origin(one) or one]
        for one in _kinds(kind)
        if one is not type(None)
    )
