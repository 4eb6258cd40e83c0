"""The concordance with the paper is complete and true; numbers stand beside labels in the documentation."""

import inspect
import json
import re
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

from nontwist.paper.tables import printed, printed_numbers
from nontwist.validation import GROUPS

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "theory" / "concordance.md"
THEOREMS = json.loads((ROOT / "src/nontwist/paper/labels.json").read_text(encoding="utf-8"))["theorems"]
PAGES = [ROOT / "docs" / f"{name}.md" for name in ("errata", "theory/bodies", "theory/frame", "theory/integration")]
TEXT = PAGE.read_text(encoding="utf-8")
ROWS = [
    [cell.strip() for cell in line.strip("|").split(" | ")]
    for line in TEXT.splitlines()
    if line.startswith("| ") and not line.startswith(("| paper |", "| --- |"))
]
LABELLED = {row[0].rpartition("`")[0].rpartition("`")[2] or row[0]: row for row in ROWS}


def test_the_paper_has_its_numbers():
    """Ends and beginnings that the paper's own text refers to; the whole was compared with pdfLaTeX's .aux file."""
    assert len(printed_numbers()) == 83
    assert THEOREMS == ["3.1", "3.2", "3.3", "3.4", "4.1", "4.2", "4.3", "5.1", "5.2"]
    for label, shown in (
        ("eq-stwo", "(1)"),
        ("eq-variation-convected", "(46)"),
        ("eq:second_quotient", "(123)"),
        ("subs-non-twisting-frame", "Section 2.3"),
        ("fig-trajectory-c", "Figure 9"),
        ("tab-invariants_ml", "Table 4"),
    ):
        assert printed(label) == shown
    assert printed("eq-standard", "b") == "(51b)"
    equations = [int(n) for label, n in printed_numbers().items() if label.startswith("eq")]
    assert equations == sorted(set(equations))


def test_rows_of_equations_and_theorems():
    expected = {label: f"{printed(label)} `{label}`" for label in printed_numbers() if label.startswith("eq")}
    expected |= {f"Theorem {number}": f"Theorem {number}" for number in THEOREMS}
    assert len(ROWS) == len(LABELLED)
    assert {name: row[0] for name, row in LABELLED.items()} == expected


@pytest.mark.parametrize("name", LABELLED)
def test_rows_name_existing_things(name):
    """Names are public or modules, tests exist; one of these files or of the pages of theory cites the label."""
    _, statement, code, test = LABELLED[name]
    assert statement
    files = [file_of(found) for found in re.findall(r"`~(nontwist\.[\w.]+)`", code)]
    for file, function in re.findall(r"`(\w+\.py)::(\w+)`", test):
        files += (ROOT / "tests").glob(f"*/{file}")
        assert f"def {function}(" in files[-1].read_text(encoding="utf-8"), function
    for group in re.findall(r"validation: (\w+)", test):
        assert group in GROUPS
        files += [ROOT / "docs" / "validation.json", ROOT / "docs" / "validation.md"]
    if not code.startswith("–"):
        assert "`" in code
        assert test != "–"
    if "`" in LABELLED[name][0] and code != "–" and test != "–":
        cited = re.compile(rf"(?<![\w-]){re.escape(name)}(?![\w-])", re.IGNORECASE)
        places = {*files, *PAGES}
        assert [path for path in places if cited.search(path.read_text(encoding="utf-8"))], f"{name}: {places}"


def file_of(name):
    """The file that a public name or a module is written in; an error where there is none."""
    module, _, last = name.removeprefix("nontwist.").rpartition(".")
    with suppress(ModuleNotFoundError):
        if spec := find_spec(name):
            return Path(spec.origin)
    space = getattr(import_module("nontwist"), module) if module else import_module("nontwist")
    assert last in getattr(space, "__all__", vars(space)), f"{name} is not public"
    return Path(inspect.getsourcefile(getattr(space, last)))


def test_numbers_beside_labels(monkeypatch):
    pytest.importorskip("sphinx")
    monkeypatch.syspath_prepend(ROOT / "docs" / "_extensions")
    numbers = import_module("equation_numbers")
    for text, numbered in {
        "Unit sphere (eq-stwo).": "Unit sphere (eq-stwo (1)).",
        "A sign in eq-standard (b) and eq-nonholonomic": "A sign in eq-standard (51b) and eq-nonholonomic (69)",
        "eq-nonholonomic (a = 1)": "eq-nonholonomic (69) (a = 1)",
        "tab-sqp_ic; subs-stwo": "tab-sqp_ic Table 1; subs-stwo Section 2.1",
        "pre-eq-stwo, eq-" + "stwox": "pre-eq-stwo, eq-" + "stwox",
        "eq-pi-split, eq-pi-split-components": "eq-pi-split (39), eq-pi-split-components (40)",
    }.items():
        assert numbers.numbered(text) == numbered
    assert (numbers.named("(51b)"), numbers.named("Section 2.1")) == ("eq.\N{NO-BREAK SPACE}51b", "Section 2.1")
