"""Errors and warnings about what a user gave: a code, the facts, and a sentence that names options as they are typed.

`SENTENCES` has a template for each code, to which the rooms of the package add theirs. ``{option[body]}`` is the option
`body`, in Python ``body=``, in a shell ``--body``; ``{option[rate=50]}`` one with its value. A field of the type
`Option` is an option as well. Tests and programs read `code` and `fields`.
"""

from __future__ import annotations

import sys
import warnings
from typing import Any

SENTENCES = {
    "type": "{name} must be {words}, got {value}",
    "euler": "{option[euler]} requires 3 axes, neighbours unlike: ZYX about moving, zyx fixed axes; got {letters!r}",
    "gimbal-lock": "{letters} is in gimbal lock at {count} states, the first at {along} = {first}: the rates of its "
    "first and third angle are infinite there; another {option[euler]} avoids it",
    "option-without-effect": "{name} has no effect, as {why}; omit it",
}


class Option(str):
    """The name of an option, among the fields of an error."""


class PythonOptions:
    """The words for options in Python: ``body=``, ``inverse=True``."""

    def __getitem__(self, key: str) -> str:
        """Return the words for an option, or an option with its value."""
        return key if "=" in key else f"{key}="


class ShellOptions:
    """The words for options on a command line: ``--body``, ``--inverse``; `names` maps those that differ."""

    def __init__(self, **names: str) -> None:
        self.names = {"scalar_first=False": "--scalar-last"} | names

    def __getitem__(self, key: str) -> str:
        """Return the words for an option, or an option with its value."""
        if key in self.names:
            return self.names[key]
        name, _, value = key.partition("=")
        word = self.names.get(name, f"--{name.replace('_', '-')}")
        value = value.strip("'")
        return word if value in ("", "True") else f"{word} {value}"


class Worded:
    """What is said of an input: `code`, the key of its sentence; `fields`, the facts; `within`, what it is about."""

    def __init__(self, code: str, within: str = "", **fields: Any) -> None:
        self.code, self.within, self.fields = code, within, fields
        super().__init__(self.worded(PythonOptions()))  # type: ignore[call-arg]

    def worded(self, option: Any) -> str:
        """Return the sentence with the words that `option` has for options."""
        fields = {key: option[one] if isinstance(one, Option) else one for key, one in self.fields.items()}
        return (f"{self.within}: " if self.within else "") + SENTENCES[self.code].format(option=option, **fields)

    def about(self, within: str) -> Any:
        """Return the same about an input that is named."""
        return type(self)(self.code, within, **self.fields)

    def __reduce__(self) -> Any:
        """Return what makes a copy, as pickle needs it."""
        return _again, (type(self), self.code, self.within, self.fields)


class InputError(Worded, ValueError):
    """An input that cannot be used.

    Attributes
    ----------
    code : str
        Which error it is, as ``no-body``.
    fields : dict
        The facts that its sentence states.
    """


class InputWarning(Worded, UserWarning):
    """Something about an input that its user should know; with a `code` and `fields`, as those of an `InputError`."""


def _again(kind: Any, code: str, within: str, fields: dict[str, Any]) -> Any:
    return kind(code, within, **fields)


def warn(message: str) -> None:
    """Warn at the line of the caller of the package."""
    warnings.warn(message, UserWarning, stacklevel=callers_level())


def callers_level() -> int:
    """Return the stack level, seen from the caller of this function, of the first frame outside the package."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("nontwist."):
        level, frame = level + 1, frame.f_back
    return level
