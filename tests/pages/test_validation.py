"""`nontwist validate`: that it can fail, what it says, and that its sources exist. All of its groups: a long test."""

import json
import re
from dataclasses import replace
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest
from rich.cells import cell_len

import exact_reference as reference
from conftest import ended
from nontwist import validate
from nontwist.validation import GROUPS, KINDS, Check, frame_checks
from nontwist.validation.checks import module_of, numbers, share
from nontwist.validation.closed_forms import many_digits
from nontwist.validation.problems import all_are, drift, error, order, turns_apart
from paper.test_labels import labels
from refusals import said, says

PAGE = Path(__file__).parents[2] / "docs" / "validation.md"
COMMITTED = json.loads(PAGE.with_suffix(".json").read_text(encoding="utf-8"))


def rows(page):
    """Cells of the table of a page."""
    table = [line for line in page.splitlines() if line.startswith("| **")]
    return [[cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in table]


CHECKS = {f"{group}-{check.__name__}": check for group in GROUPS for check in module_of(group).CHECKS[group]}
# Of those that take longer, the first checks.
FIRST = {"orders-orders": 1, "invariants-million_steps": 1, "nonreversible-against_dop853": 6}
FIRST |= {"nonreversible-long_runs": 3, "compiled-parity": 2, "free-fitted": 1, "loaded-friction": 1}
FIRST |= {"loaded-integrators": 2, "loaded-multipliers": 4, "loaded-oil": 1, "paper-tables": 4}
FIRST |= {f"invariants-{name}": 1 for name in ("random_bodies", "exchange", "forced")}


@pytest.mark.parametrize("name", CHECKS)
def test_quick_checks_hold(name):
    """And what is known, tolerances, kinds and sources are those that the page promises, and orders as they were.

    No tolerance is fitted to what it measures: that of an order tells it from the next ones, and others are powers of
    ten where no formula gives them.
    """
    found = list(islice(CHECKS[name](), FIRST.get(name)))
    assert found
    assert [check for check in found if not check.holds] == []
    promised = {check["name"]: check for check in COMMITTED["checks"]}
    for check in found:
        for key in ("expected", "tolerance", "kind", "source"):
            assert getattr(check, key) == promised[check.name][key]
        if check.kind == "order":
            assert check.tolerance < 0.25
            assert check.measured == pytest.approx(promised[check.name]["measured"], abs=0.002)
        elif not re.match("SO|S²|Darboux|.* turns: |case .: Q_II|.* kink|.* share", check.name):
            assert f"{check.tolerance:e}".startswith(("1.000000e", "0.000000e"))


def test_a_wrong_expected_value_fails(monkeypatch, tmp_path):
    checks = [check for function in frame_checks.CHECKS["geometry"] for check in function()]
    checks[0] = replace(checks[0], expected=1.0, tolerance=1e-9)
    monkeypatch.setitem(frame_checks.CHECKS, "geometry", (lambda: checks,))
    page = tmp_path / "page.md"
    lines = ended(1, "validate", "--group", "geometry", "--page", page, COLUMNS="80").stdout.splitlines()
    assert [sum(f" {word} " in line for line in lines) for word in ("FAIL", "PASS")] == [1, 11]
    assert "11 of 12 checks pass" in lines
    assert max(map(cell_len, lines)) <= 80
    assert "**11 of 12 checks pass**" in page.read_text(encoding="utf-8")
    (row,) = rows(page.read_text(encoding="utf-8"))
    assert float(row[3]) > 1
    assert row[4] == "SO(3): exp against SciPy"


def test_failing_check_ends_no_other(monkeypatch):
    def broken():
        yield from checks[:3]
        raise ArithmeticError("it broke")

    checks = [check for function in frame_checks.CHECKS["geometry"] for check in function()]
    monkeypatch.setitem(frame_checks.CHECKS, "geometry", (broken, lambda: checks[3:]))
    group = validate("geometry")
    assert group.summary == "12 of 13 checks pass"
    assert group.checks[3].name == "exceptions of broken: ArithmeticError: it broke"


def test_all_checks_on_the_page(tmp_path):
    told, begin = [], perf_counter()
    group = validate("geometry", progress=told.append)
    assert 0 < group.seconds["geometry"] < perf_counter() - begin
    assert told == ["0 of 1 groups done: geometry"]
    assert group.summary == "12 of 12 checks pass"
    assert all(check.group == "geometry" and check.kind in KINDS for check in group.checks)
    result = ended(0, "validate", "--group", "geometry", "--json", "--page", tmp_path / "page.md")
    assert "written" in result.stderr
    found = json.loads(result.stdout)
    assert json.loads((tmp_path / "page.json").read_text(encoding="utf-8")) == found
    assert group.holds
    assert found["holds"]
    assert set(found["versions"]) == {"python", "nontwist", "numpy", "scipy", "llvmlite", "xarray"}
    assert [check["name"] for check in found["checks"]] == [check.name for check in group.checks]
    page = (tmp_path / "page.md").read_text(encoding="utf-8")
    (row,) = rows(page)
    shares = [abs(one["measured"] - one["expected"]) / one["tolerance"] for one in found["checks"] if one["tolerance"]]
    assert row[0].startswith("**geometry**: ")
    assert [int(row[1]), sum(int(part.partition(" ")[0]) for part in row[2].split(", "))] == [12, 12]
    assert [row[3], row[5]] == [f"{max(shares):.1g}", f"{found['seconds']['geometry']:.1f}"]
    assert "[page.json](page.json)" in page
    assert all(f"{name} {number}" in page for name, number in found["versions"].items())


def test_errors_are_reported(tmp_path):
    for code, *arguments in ((2, "geometri"), (5, "geometry", "--page", tmp_path / "no" / "page.md")):
        said(ended(code, "validate", "--group", *arguments).stderr.rpartition("Error: ")[2])
    with says():
        validate(["geometry", "geometri"])


def test_numbers_and_shares():
    for values, texts in (
        ((468 / 7, 66.85714285, 1e-9), ("66.857142857", "66.857142850", "1e-09")),
        ((0, 3.21e-14, 1e-12), ("0", "3.2e-14", "1e-12")),
        ((0, 0.0, 1e-12), ("0", "0", "1e-12")),
        ((15, 14, 0), ("15", "14", "0")),
    ):
        assert numbers(Check("", *values, "", "closed form")) == texts
    assert numbers(Check("", 2, 1.9996, 0.01, "", "order")) == ("2.000", "2.000", "0.01")
    for measured, tolerance, expected in ((2.5, 1, 0.5), (0, 1, 2), (2, 0, 0), (3, 0, np.inf), (np.nan, 1, np.inf)):
        check = Check("", 2, measured, tolerance, "", "printed")
        assert (share(check), check.holds) == (expected, expected <= 1)
    assert not error("nan", [0, np.nan], 1, "Bishop 1975", "invariant").holds


def test_measures():
    assert order("", 2, [10, 20, 40], [1, 0.25, 0.0725], 0.1, "Bloch").measured == pytest.approx(np.log2(0.25 / 0.0725))
    assert order("", 4, [10, 30], [[1, 3.0**-4], [1, 3.0**-3.9]], 0.1, "Bloch").measured == pytest.approx(3.9)
    assert all_are("", 2, [1.9, 2.2, 2.1], 0.1, "Bloch", "printed").measured == 2.2
    assert drift(np.array([4.0, 3, 5])) == pytest.approx(0.2)
    assert turns_apart(3.0 + 2 * np.pi, [3.0, 2.5]) == pytest.approx([0, 0.5])


def test_committed_page():
    page, checks = PAGE.read_text(encoding="utf-8"), COMMITTED["checks"]
    counts = {group: str(sum(check["group"] == group for check in checks)) for group in GROUPS}
    assert {row[0].partition("**: ")[0][2:]: row[1] for row in rows(page)} == counts
    assert f"**{len(checks)} of {len(checks)} checks pass**" in page
    assert all(check["holds"] for check in checks)
    assert len({check["name"] for check in checks}) == len(checks)  # no two rows of one name


def test_sources_exist():
    """Labels of the paper, known references, or modules; errata with the number of a section."""
    errata = (PAGE.parent / "errata.md").read_text(encoding="utf-8")
    sections = ["", *re.findall(r"^## (\d+)\.", errata, re.MULTILINE)]
    for part in {part for check in COMMITTED["checks"] for part in check["source"].split("; ")}:
        name, _, section = (
            part.removesuffix(")").partition(" (docs/errata.md, ") if "errata" in part else (part, "", "")
        )
        assert section in sections
        known = name in labels() or any(name.startswith(short) for short in COMMITTED["references"])
        assert known or (name.startswith("nontwist.") and find_spec(name)), name


def test_many_digits_of_the_reference():
    """One motion of each kind, computed again."""
    data = many_digits()
    motion = next(motion for motion in data["free"] if "-1e-12" in motion["name"])
    exact = reference.elliptic_top(motion["moments"], np.array(motion["velocity"]), motion["time"])
    assert np.array_equal(exact, motion["attitude"])
    motion = data["suslov"][2]
    R, W = reference.taylor_top(data["suslov_inertia"], motion["velocity"], motion["time"], axis3=True)
    assert np.array_equal(R, motion["attitude"])
    assert np.array_equal(W, motion["velocity_at_the_end"])


@pytest.mark.long
def test_everything_holds():
    """In two processes, as the command runs it; and every row is in the committed file."""
    result = validate(workers=2)
    assert [check.name for check in result.checks if not check.holds] == []
    assert [check.name for check in result.checks] == [check["name"] for check in COMMITTED["checks"]]
