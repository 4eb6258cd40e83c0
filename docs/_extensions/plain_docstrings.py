"""Docstrings are plain text first: |M| in them is a length, and what a module's docstring indents is a formula."""

import re
from typing import Any

from sphinx.application import Sphinx

LITERAL = re.compile(r"(``.+?``|`[^`]+`)")


def escaped(line: str) -> str:
    """Return a line with its bars escaped, those between backticks excepted."""
    return "".join(part if part.startswith("`") else part.replace("|", r"\|") for part in LITERAL.split(line))


def formulas(lines: list[str]) -> list[str]:
    """Return the lines of a module's docstring with each indented paragraph as a literal block."""
    made: list[str] = []
    for line in lines:
        indented = line.startswith("    ")
        if indented and not (made and made[-1].startswith("    ")):
            above = next((one for one in reversed(made) if one.strip()), "")
            is_markup = above.startswith(("    ", "..")) or above.endswith("::")
            made += [] if is_markup else ["::", ""]
        made.append(line if indented else escaped(line))
    return made


def mend(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Make reStructuredText of a docstring, its examples left alone."""
    lines[:] = formulas(lines) if what == "module" else [line if ">>>" in line else escaped(line) for line in lines]


def setup(app: Sphinx) -> dict[str, bool]:
    """Mend last, when numpydoc is done."""
    app.connect("autodoc-process-docstring", mend, priority=900)
    return {"parallel_read_safe": True}
