"""The labels of the paper's equations, sections, figures and tables, and the numbers that LaTeX prints for them."""

from __future__ import annotations

import json
import re
from functools import cache
from importlib.resources import files

LABEL = re.compile(r"(?<![\w-])(?:eq|tab|sec|subs|fig)[-_:][A-Za-z][\w:-]*\w")
KINDS = {"eq": "", "sec": "Section ", "subs": "Section ", "fig": "Figure ", "tab": "Table "}


@cache
def printed_numbers() -> dict[str, str]:
    """Return the printed number of each label, as ``"46"`` or ``"2.1"``, in the order of the paper."""
    numbers: dict[str, str] = _data()["labels"]
    return numbers


@cache
def theorems() -> tuple[str, ...]:
    """Return the printed numbers of the theorems, which have no labels."""
    return tuple(_data()["theorems"])


def printed(label: str, row: str = "") -> str:
    """Return how the paper prints a label: "(46)", or "(46b)" with a row; "Section 2.1", "Figure 3", "Table 4".

    Raises
    ------
    KeyError
        The paper has no such label.
    """
    number, kind = printed_numbers()[label], KINDS[re.split("[-_:]", label)[0]]
    return f"{kind}{number}" if kind else f"({number}{row})"


def _data() -> dict[str, dict[str, str]]:
    data: dict[str, dict[str, str]] = json.loads(files(__package__).joinpath("labels.json").read_text(encoding="utf-8"))
    return data
