"""The result of a validation: a summary of its groups as a page, its rows as JSON, and the format of its numbers."""

from __future__ import annotations

import json
import math
from collections import Counter
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
        """Return versions, verdict, all checks with every digit, and the references that they cite."""
        from ..analysis.trajectory import versions

        rows = [asdict(check) | {"holds": check.holds} for check in self.checks]
        cited = " ".join(check.source for check in self.checks)
        references = {short: full for short, full in REFERENCES.items() if short in cited}
        found = {"holds": self.holds, "versions": versions(), "checks": rows, "references": references}
        return json.dumps(found | {"notes": self.notes}, indent=1, ensure_ascii=False)

    def to_markdown(self, rows: str | None = None) -> str:
        """Return a summary: one row for each group, and a link to the file of all `rows`, if there is one."""
        from ..analysis.trajectory import versions

        made = ", ".join(f"{name} {number}" for name, number in versions().items())
        lines = [*HEAD, *([f"[{rows}]({rows}) has every row, with its source."] if rows else [])]
        lines += ["", f"**{self.summary}** ({made}).", "", HEADER, "| --- | ---: | --- | ---: | --- |"]
        for group, checks in self.groups.items():
            kinds = Counter(check.kind for check in checks)
            worst = max(checks, key=share)
            counts = ", ".join(f"{n} {kind}" for kind, n in kinds.items())
            cells = [f"**{group}**: {words_of(group)}", str(len(checks)), counts, f"{share(worst):.1g}", worst.name]
            lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
        lines += ["", "The known values are of these kinds:", ""]
        lines += [f"- **{kind}**: {words}." for kind, words in KINDS.items()]
        return "\n".join(lines) + "\n"


HEADER = "| group | checks | kinds | largest share | check with this share |"
HEAD = (
    "# Validation",
    "",
    "`make validate` measures numbers with known values and writes this page, in about a minute, without network",
    "access. A check passes if the measured and the known number differ by no more than a tolerance, set beforehand.",
    "Below, the *share* is this difference over the tolerance. `nontwist validate` prints every check, `--group` those",
    "of one group.",
)


def words_of(group: str) -> str:
    """Return the first sentence of the docstring of the module of a group."""
    text = import_module(f"{__package__}.{GROUPS[group]}").__doc__ or ""
    return " ".join(text.partition("\n\n")[0].split())


def share(check: Check) -> float:
    """Return the error over the tolerance; infinity for a check that fails without one."""
    gap = abs(check.measured - check.expected)
    if check.tolerance > 0:
        return gap / check.tolerance if math.isfinite(gap) else math.inf
    return 0.0 if check.holds else math.inf


def verdict(check: Check) -> str:
    """Return "PASS" or "FAIL"."""
    return "PASS" if check.holds else "FAIL"


def numbers(check: Check) -> tuple[str, str, str]:
    """Return expected, measured and tolerance as text, with the digits that the tolerance resolves."""
    tolerance = f"{check.tolerance:.2g}"
    if check.expected == 0 and check.tolerance > 0:
        return "0", f"{check.measured:.2g}", tolerance
    places = -math.floor(math.log10(check.tolerance)) if check.tolerance > 0 else 0
    places += check.kind == "order"
    return f"{check.expected:.{places}f}", f"{check.measured:.{places}f}", tolerance
