"""Docstrings are plain text first: |M| in them is a length, and what a module's docstring indents is a formula."""

import re
from typing import Any

from sphinx.application import Sphinx

LITERAL = re.compile(r"(``.+?``|`[^`]+`)", re.DOTALL)
BELOW = re.compile(r"((?<!\w)Δ?[^\W\d_]|\))_(\{[^{}]*\}|[^\W_]{1,2}(?!\w)|[⊥∥])")  # d_i, Λ_{n+1}, π_⊥, but not t_end
ABOVE = re.compile(r"(?<=[\w)])\^(\{[^{}]*\}|[^\W_]{1,3}(?!\w))")  # f^i, O(h^2)


def escaped(text: str) -> str:
    """Return a text with its bars escaped, those between backticks excepted."""
    return "".join(part if part.startswith("`") else part.replace("|", r"\|") for part in LITERAL.split(text))


def set_in_type(text: str) -> str:
    """Return a text with its indices below the line and its powers above it, those between backticks excepted."""

    def index(match: re.Match[str]) -> str:
        return rf"{match[1]}\ :sub:`{match[2].strip('{}')}`\ "

    def power(match: re.Match[str]) -> str:
        return rf"\ :sup:`{match[1].strip('{}')}`\ "

    parts = LITERAL.split(text)
    return "".join(part if part.startswith("`") else ABOVE.sub(power, BELOW.sub(index, part)) for part in parts)


def formulas(text: str) -> str:
    """Return a module's docstring with each indented paragraph as a literal block."""
    made: list[str] = []
    for paragraph in re.split(r"\n\s*\n", text):
        is_formula = paragraph.startswith("    ")
        if is_formula and not (made and (made[-1].startswith("    ") or made[-1].endswith("::"))):
            made.append("::")
        made.append(paragraph if is_formula else set_in_type(escaped(paragraph)))
    return "\n\n".join(made)


def mend(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Make reStructuredText of a docstring, its examples left alone."""
    if what == "module":
        lines[:] = formulas("\n".join(lines)).split("\n")
    else:
        lines[:] = [line if ">>>" in line else escaped(line) for line in lines]


def setup(app: Sphinx) -> dict[str, bool]:
    """Mend last, when numpydoc is done."""
    app.connect("autodoc-process-docstring", mend, priority=900)
    return {"parallel_read_safe": True}
