"""Validation of arguments that are not arrays: whole numbers, words, lists, paths, functions."""

from __future__ import annotations

import math
import os
import sys
from collections import UserDict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import wraps
from inspect import signature
from numbers import Integral
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

_LONGEST_REPR = 80  # characters of a value in a message
T = TypeVar("T", bound=type)
F = TypeVar("F", bound=Callable[..., Any])


class Registry(UserDict[str, T]):
    """Classes by name, to which other modules add their own: ``registry[name] = cls``.

    Parameters
    ----------
    known : mapping
        The classes of the package.
    wrong : callable
        Returns what is wrong with a key and a class, and what to do, or None if they are accepted.
    other : str
        How to choose another key.

    Raises
    ------
    ValueError
        A class is added that is wrong, or whose key another class has. A class that is defined again replaces itself.
    """

    def __init__(self, known: Mapping[str, T], wrong: Callable[[str, T], str | None], other: str) -> None:
        self._wrong, self._other = wrong, other
        super().__init__(known)

    def __setitem__(self, key: str, cls: T) -> None:
        if (reason := self._wrong(key, cls)) is not None:
            raise ValueError(reason)
        if key in self and not _defined_again(self[key], cls):
            old = self[key]
            raise ValueError(
                f"{key!r} is already the key of the class {old.__qualname__} of {old.__module__}: {self._other}"
            )
        super().__setitem__(key, cls)


class MadeByName(Mapping[str, Any]):
    """What is made when it is looked at, by names, which may become more."""

    def __init__(self, names: Callable[[], Iterable[str]], make: Callable[[str], Any]) -> None:
        self._names, self._make = names, make

    def __getitem__(self, name: str) -> Any:
        if name not in self._names():
            raise KeyError(name)
        return self._make(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names())

    def __len__(self) -> int:
        return len([*iter(self)])


def _defined_again(old: type, new: type) -> bool:
    """Return whether a class was defined twice: in a module that was imported again, or in a copy of it."""
    if old.__qualname__ != new.__qualname__:
        return False
    return old.__module__ == new.__module__ or [*old.__annotations__] == [*new.__annotations__]


def short_repr(value: Any) -> str:
    """Return `value` for a message, in at most 80 characters, whatever it is."""
    try:
        text = repr(value)
        text = " ".join(text.split()) if "\n" in text else text
    except Exception:  # as for whole numbers with more than 4300 digits
        text = f"a value of type {type(value).__name__}"
    return text if len(text) <= _LONGEST_REPR else f"{text[: _LONGEST_REPR - 3]}..."


def number_text(x: float, spec: str) -> str:
    """Return a number by a format, such as ".1g"; from 1e-3 to 1e5 without an exponent: 20, not 2e+01."""
    text = format(x, spec)
    return f"{float(text):.12g}" if "e" in text and 1e-3 <= abs(float(text)) <= 1e5 else text


def error_place(error: float) -> int:
    """Return the power of ten of the last digit of an uncertainty > 0: its first, or its second after a 1."""
    first, power = f"{error:.1e}".split("e")
    return int(power) - (first[0] == "1")


def error_text(error: float) -> str:
    """Return an uncertainty in one digit, or in two if the first is 1; it is at most 5 % below `error`."""
    if not 1e-290 < error < math.inf:
        return number_text(error, ".1g")
    unit = 10.0 ** error_place(error)
    return number_text(max(round(error / unit), math.ceil(0.95 * error / unit)) * unit, ".2g")


def text_to_place(x: float, place: int) -> str:
    """Return a number rounded to a power of ten, the last digit of its uncertainty, with zeros up to it."""
    if x and not 1e-3 <= abs(x) <= 1e5:
        return format(x, f".{max(math.floor(math.log10(abs(x))) - place + 1, 1)}g")
    return f"{round(x, -place) + 0.0:.{max(-place, 0)}f}"


def counted(number: int, noun: str) -> str:
    """Return a number of things, in the singular or the plural: "1 row", "2 rows"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def vector_text(values: Iterable[float], scale: float = 1.0) -> str:
    """Return numbers, times `scale`, in four digits: "(1, −0.5, 0)"."""
    return f"({', '.join(f'{scale * float(x):.4g}' for x in values)})".replace("-", "−")


ALIASES = {  # names of other programs
    "angular_velocity": "omega omega0 w w0 velocity",
    "material_angular_velocity": "omega omega0 W W0 Omega velocity",
    "rotation": "attitude orientation quaternion quat q q0 R R0",
    "step": "dt h step_size time_step timestep max_step",
    "t_end": "duration tspan t_span T tmax t_max t_final tf",
    "times": "t t_eval",
    "tolerance": "tol rtol atol",
    "load": "torque moment force",
    "integrator": "method solver scheme",
    "name": "solver",
    "inertia": "J I",
    "mass": "m",
    "gravity": "g",
    "centre_of_mass": "length l com",
    "body_moment": "torque moment force",
    "space_moment": "torque moment force",
    "wheel_torque": "torque",
    "time": "t t0 t_start rate",
    "start": "perigee_time",
    "speed": "rpm omega omega0 W",
    "length": "height h",
    "angle_unit": "degrees deg",
    "of_ellipsoid": "of_sphere of_ball sphere",
    "of_cylinder": "of_rod of_disc of_disk cylinder",
    "of_cuboid": "of_box of_block box",
}


def meant(word: str, known: Collection[str] = ALIASES) -> list[str]:
    """Return the known words by which a word of other programs may be meant."""
    return [ours for ours, others in ALIASES.items() if word in others.split() and ours in known]


def guess(word: Any, known: Iterable[str], quote: str = "") -> str:
    """Return a question for the known word that is nearest to `word`, a space behind it; "" where none is near."""
    from difflib import get_close_matches

    small = {one.casefold(): one for one in known}
    name = word.casefold() if isinstance(word, str) else ""
    least = 0.6 if len(name) > 3 else 0.7  # of three letters one makes another unit: rps, rpm
    near = get_close_matches(name, small, 1, least) or [part for part in name.split("_") if part in small]
    return f"did you mean {quote}{small[near[0]]}{quote}? " if near else ""


def unknown_keyword(function: str, name: str, known: Collection[str]) -> TypeError:
    """Return the error of a call with a keyword that a function does not have."""
    from difflib import get_close_matches

    near = meant(name, known) or get_close_matches(name, known, 1, 0.65)
    hint = f"did you mean {' or '.join(f'{one}=' for one in near)}?" if near else f"it takes {', '.join(known)}"
    return TypeError(f"{function}() got an unexpected keyword argument {name!r}; {hint}")


def hinted(function: F) -> F:
    """Make a function say what it takes, or which keyword is meant, where it is called with something else."""

    @wraps(function)
    def call(*arguments: Any, **keywords: Any) -> Any:
        try:
            return function(*arguments, **keywords)
        except TypeError as error:
            known = [name for name in signature(function).parameters if name != "self"]
            if wrong := [name for name in keywords if name not in known]:
                raise unknown_keyword(function.__qualname__, wrong[0], known) from None
            if error.__traceback__ is None or error.__traceback__.tb_next is not None:  # not of the call itself
                raise
            raise TypeError(f"{error}; it takes {', '.join(known)}") from None

    return call  # type: ignore[return-value]


class PublicModule(ModuleType):
    """A module of the public interface: it lists its public names alone, and guesses which of them is meant."""

    def __dir__(self) -> list[str]:
        own = (name for name, x in vars(self).items() if getattr(x, "__module__", "") == self.__name__)
        return vars(self).get("__all__") or [name for name in own if not name.startswith("_")]

    def __getattr__(self, name: str) -> Any:
        known = [] if name.startswith("_") else dir(self)
        near = " or ".join(meant(name, known))
        hint = f"did you mean {near}? " if near else guess(name, known)
        has = f"; {hint}it has {', '.join(known)}" if known else ""
        raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}{has}")


PublicModule.__name__ = "module"  # what Python says that it is, where one is called


def public(name: str) -> None:
    """Make a module, by its name, one of the public interface."""
    sys.modules[name].__class__ = PublicModule


def nearest(word: Any, known: Iterable[str]) -> str:
    """Return the known word nearest to `word` with a question, then all."""
    words = list(known)
    return f"{guess(word, words)}known are {', '.join(words)}"


def among(value: Any, known: Iterable[Any]) -> bool:
    """Return whether `value` is a number or a word, and one of `known`."""
    return (isinstance(value, str) or _is_whole(value)) and value in known


def require_among(value: Any, name: str, known: tuple[Any, ...]) -> None:
    """Raise a ValueError where `value` is none of some words or numbers."""
    if not among(value, known):
        *first, last = map(repr, known)
        raise ValueError(f"{name} must be {', '.join(first)} or {last}, got {short_repr(value)}")


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) or (isinstance(value, Integral) and hasattr(value, "__index__"))  # no timedelta64


def as_whole(value: Any, name: str, least: int, most: int | None = None) -> int:
    """Return `value` as an int; a ValueError where it is no whole number from `least` to `most`."""
    if isinstance(value, bool) or not _is_whole(value) or value < least:
        raise ValueError(f"{name} must be a whole number >= {least}, got {short_repr(value)}")
    if most is not None and value > most:
        raise ValueError(f"{name} must be at most {most}, got {short_repr(value)}")
    return int(value)


def as_list(value: Any, name: str) -> list[Any]:
    """Return what an iterable holds; a ValueError where `value` is a word, or not iterable."""
    try:
        if isinstance(value, (str, bytes)):
            raise TypeError
        return list(value)
    except TypeError as error:
        raise ValueError(f"{name} must be a list, got {short_repr(value)}") from error


def as_path(value: Any, name: str) -> Path:
    """Return `value` as a path; a ValueError where it is neither a string nor a path."""
    if not isinstance(value, (str, os.PathLike)) or not isinstance(os.fspath(value), str):
        raise ValueError(f"{name} must be a path, a string or an os.PathLike; got {short_repr(value)}")
    return Path(value)


def as_function(value: Any, name: str) -> Callable[..., Any]:
    """Return `value`; a ValueError where it cannot be called."""
    if not callable(value):
        raise ValueError(f"{name} must be a function, got {short_repr(value)}")
    return value
