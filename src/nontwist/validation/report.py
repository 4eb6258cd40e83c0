"""The result of a validation, and the format of its numbers.

On the page that belongs to the documentation an error is written as the power of ten above it, so that the page stays
the same where round-off differs; the terminal and the JSON have the digits.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from importlib import import_module

from .checks import GROUPS, KINDS, Check
from .references import REFERENCES


@dataclass(frozen=True)
class Validation:
    """All checks of a validation, in the order of their groups; the notes say what was not checked, and why."""

    checks: tuple[Check, ...]
    notes: tuple[str, ...] = ()

    @property
    def holds(self) -> bool:
        """Whether every check passes."""
        return all(check.holds for check in self.checks)

    @property
    def groups(self) -> dict[str, tuple[Check, ...]]:
        """The checks by their groups."""
        names = dict.fromkeys(check.group for check in self.checks)
        return {name: tuple(check for check in self.checks if check.group == name) for name in names}

    @property
    def summary(self) -> str:
        """How many checks pass."""
        return f"{sum(check.holds for check in self.checks)} of {len(self.checks)} checks pass"

    def to_json(self) -> str:
        """Return versions, verdict and all checks, with every digit."""
        from ..analysis.trajectory import versions

        rows = [asdict(check) | {"holds": check.holds} for check in self.checks]
        found = {"holds": self.holds, "versions": versions(), "checks": rows, "notes": self.notes}
        return json.dumps(found, indent=1, ensure_ascii=False)

    def to_markdown(self) -> str:
        """Return the page of the documentation: one table for each group."""
        from ..analysis.trajectory import versions

        made = ", ".join(f"{name} {number}" for name, number in versions().items())
        lines = [*HEAD, "", f"**{self.summary}** ({made}).", ""]
        lines += ["The column *truth* has these values:", ""]
        lines += [f"- **{kind}**: {words}." for kind, words in KINDS.items()]
        for group, checks in self.groups.items():
            lines += ["", f"## {group}", "", words_of(group), ""]
            lines += [HEADER, "| --- | --- | ---: | ---: | ---: | --- | --- |"]
            for check in checks:
                cells = [check.name, check.kind, *numbers(check, bound=True), verdict(check), check.source]
                lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
        cited = " ".join(check.source for check in self.checks)
        lines += ["", "## References", "", PAPER]
        lines += [f"- {short}: {full}." for short, full in REFERENCES.items() if short in cited]
        return "\n".join(lines) + "\n"


PAPER = "- Labels such as eq-nonholonomic: the paper, as in [errata](errata.md); files in docs/ belong to this project."
HEADER = "| what | truth | expected | measured | tolerance | verdict | source |"
HEAD = (
    "# Validation",
    "",
    "Written by `make validate`, which measures every number on this page, in about a minute, without network access.",
    "A check passes if the measured and the expected number differ by no more than the tolerance. Where the expected",
    "number is 0, the measured one is the largest error, rounded up here to a power of ten. `nontwist validate` prints",
    "more digits, `nontwist validate --json` all digits, and `--group` with a heading of this page runs one table.",
)


def words_of(group: str) -> str:
    """Return the docstring of the module of a group."""
    return (import_module(f"{__package__}.{GROUPS[group]}").__doc__ or "").strip()


def verdict(check: Check) -> str:
    """Return "PASS" or "FAIL"."""
    return "PASS" if check.holds else "FAIL"


def numbers(check: Check, bound: bool = False) -> tuple[str, str, str]:
    """Return expected, measured and tolerance as text, with the digits that the tolerance resolves.

    With `bound` an error is the power of ten above it, if the tolerance is no smaller.
    """
    tolerance = f"{check.tolerance:.2g}"
    if check.expected == 0 and check.tolerance > 0:
        above = 10.0 ** math.ceil(math.log10(check.measured)) if check.measured > 0 else 0.0
        rounded = bound and 0 < above <= check.tolerance
        return "0", f"< {above:g}" if rounded else f"{check.measured:.2g}", tolerance
    places = -math.floor(math.log10(check.tolerance)) if check.tolerance > 0 else 0
    places += check.kind == "order"
    return f"{check.expected:.{places}f}", f"{check.measured:.{places}f}", tolerance
