"""`nontwist validate`: that it can fail, what it says, and that its sources exist. All of its groups: a long test."""

import json
import re
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from rich.cells import cell_len
from typer.testing import CliRunner

import exact_reference as reference
from nontwist import validate
from nontwist.cli import app
from nontwist.validation import GROUPS, KINDS, Check, sphere_and_rotations
from nontwist.validation.free_bodies import many_digits
from nontwist.validation.problems import drift, error, furthest, slope, turns_apart
from nontwist.validation.report import numbers, share
from test_labels import labels

PAGE = Path(__file__).parents[1] / "docs" / "validation.md"
COMMITTED = json.loads(PAGE.with_suffix(".json").read_text(encoding="utf-8"))


def nontwist(*arguments):
    return CliRunner().invoke(app, ["validate", *arguments], env={"COLUMNS": "80"})


def rows(page):
    """Cells of the table of a page."""
    table = [line for line in page.splitlines() if line.startswith("| **")]
    return [[cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in table]


def test_a_group_holds():
    found = []
    result = validate("geometry", progress=found.append)
    assert result.holds
    assert len(result.checks) == 12
    assert all(check.group == "geometry" and check.kind in KINDS for check in result.checks)
    assert all(np.isfinite([check.expected, check.measured]).all() for check in result.checks)
    assert found == ["0 of 1 groups done: geometry"]
    assert result.summary == "12 of 12 checks pass"


QUICK = {  # the functions of validation that stand in place of tests, but for those of minutes
    "paper_digits": ("multiplier", "closed_form", "remainder", "impulse", "parameter"),
    "equations_of_motion": ("both_forms", "transported_momentum", "identities", "variations", "runs"),
    "free_bodies": (
        "nontwisting_body",
        "digits",
        "continuous",
        "symmetric",
        "gyrostat",
        "driven_wheel",
        "montgomery",
        "euler_angles",
        "fitted",
    ),
    "loaded_bodies": ("fixed_axis", "quadratures", "multipliers", "friction", "orbit", "lagging_magnets"),
    "suslov_bodies": ("digits", "continuous", "asymptotes", "orders"),
    "tops": ("precession",),
    "measured_orders": ("resampling",),
    "conserved": ("balances", "constraints"),
    "sampled_frames": ("orders", "closed_paths", "long_paths", "callables"),
    "known_twists": ("orders", "codman", "random_motions", "runs"),
}
FIRST = {  # of these that take longer, the first check
    "measured_orders": ("orders",),
    "conserved": ("million_steps",),
    "nonreversible": ("against_dop853", "long_runs"),
    "compiled_steps": ("parity",),
}
CASES = [(module, name, None) for module, names in QUICK.items() for name in names]
CASES += [(module, name, 1) for module, names in FIRST.items() for name in names]


@pytest.mark.parametrize(("module", "name", "count"), CASES)
def test_quick_checks_hold(module, name, count):
    """And their tolerances, kinds and sources are those that the page promises."""
    found = list(islice(getattr(import_module(f"nontwist.validation.{module}"), name)(), count))
    assert found
    assert [check for check in found if not check.holds] == []
    promised = {check["name"]: [check[key] for key in ("tolerance", "kind", "source")] for check in COMMITTED["checks"]}
    for check in found:
        assert [check.tolerance, check.kind, check.source] == promised[check.name]


def wrong():
    """The checks of geometry, the first with another expected value."""
    for k, check in enumerate(c for function in CHECKS for c in function()):
        yield replace(check, expected=1.0, tolerance=1e-9) if k == 0 else check


CHECKS = sphere_and_rotations.CHECKS


def test_a_wrong_expected_value_fails(monkeypatch, tmp_path):
    monkeypatch.setattr(sphere_and_rotations, "CHECKS", (wrong,))
    result = nontwist("--group", "geometry", "--page", str(tmp_path / "page.md"))
    assert result.exit_code == 1
    lines = result.stdout.splitlines()
    assert sum(" FAIL " in line for line in lines) == 1
    assert sum(" PASS " in line for line in lines) == 11
    assert "11 of 12 checks pass" in lines
    assert max(map(cell_len, lines)) <= 80
    page = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert "**11 of 12 checks pass**" in page
    (row,) = rows(page)
    assert float(row[3]) > 1
    assert row[4] == "SO(3): exp against SciPy"


def test_nan_fails():
    assert not Check("nan", 0, float("nan"), 1, "Bishop 1975", "invariant").holds
    assert not error("nan", [0, np.nan], 1, "Bishop 1975", "invariant").holds
    assert Check("count", 3, 3, 0, "Bishop 1975", "printed").holds


def test_json_and_the_page_have_every_check(tmp_path):
    result = nontwist("--group", "geometry", "--json", "--page", str(tmp_path / "page.md"))
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    assert found["holds"]
    assert set(found["versions"]) == {"python", "nontwist", "numpy", "scipy", "llvmlite", "xarray"}
    assert [check["name"] for check in found["checks"]] == [check.name for check in validate("geometry").checks]
    assert json.loads((tmp_path / "page.json").read_text(encoding="utf-8")) == found
    page = (tmp_path / "page.md").read_text(encoding="utf-8")
    (row,) = rows(page)
    shares = [abs(one["measured"] - one["expected"]) / one["tolerance"] for one in found["checks"] if one["tolerance"]]
    assert row[0].startswith("**geometry**: ")
    assert row[1] == "12"
    assert sum(int(part.partition(" ")[0]) for part in row[2].split(", ")) == 12
    assert row[3] == f"{max(shares):.1g}"
    assert row[5] == f"{found['seconds']['geometry']:.1f}"
    assert found["seconds"]["geometry"] > 0
    assert "[page.json](page.json)" in page
    assert all(f"{name} {number}" in page for name, number in found["versions"].items())
    assert "written" in result.stderr
    assert "written" not in result.stdout


def test_errors_are_reported(tmp_path):
    result = nontwist("--group", "geometri")
    assert result.exit_code == 2
    words = " ".join(result.stderr.replace("│", " ").split())
    assert f"'geometri' is not one of {', '.join(GROUPS)}" in words
    known = f"did you mean geometry? known are {', '.join(GROUPS)}"
    with pytest.raises(ValueError, match=re.escape(f"unknown group 'geometri'; {known}")):
        validate(["geometry", "geometri"])
    result = nontwist("--group", "geometry", "--page", str(tmp_path / "no" / "page.md"))
    assert (result.exit_code, result.stderr) == (5, f"there is no folder {tmp_path}/no; make it first\n")


NUMBERS = {
    "a value to its tolerance": ((468 / 7, 66.85714285, 1e-9), ("66.857142857", "66.857142850", "1e-09")),
    "an error": ((0, 3.21e-14, 1e-12), ("0", "3.2e-14", "1e-12")),
    "an error of 0": ((0, 0.0, 1e-12), ("0", "0", "1e-12")),
    "a count": ((15, 14, 0), ("15", "14", "0")),
    "an order": ((2, 1.9996, 0.01), ("2.000", "2.000", "0.01")),
}


@pytest.mark.parametrize("case", NUMBERS)
def test_numbers_as_text(case):
    values, texts = NUMBERS[case]
    kind = "order" if case == "an order" else "closed form"
    assert numbers(Check("", *values, "", kind)) == texts


def test_shares_of_the_tolerance():
    shares = [share(Check("", 2, measured, tolerance, "", "printed")) for measured, tolerance in SHARES]
    assert shares == [0.5, 2, 0, np.inf, np.inf]


SHARES = [(2.5, 1), (0, 1), (2, 0), (3, 0), (np.nan, 1)]


def test_measures():
    assert slope([10, 20, 40], [1, 0.25, 0.0725], 2) == pytest.approx(np.log2(0.25 / 0.0725))
    assert slope([10, 30], [1, 3.0**-4], 4) == pytest.approx(4)
    assert furthest([1.9, 2.2, 2.1], 2) == 2.2
    assert drift(np.array([4.0, 3, 5])) == pytest.approx(0.2)
    assert turns_apart(3.0 + 2 * np.pi, [3.0, 2.5]) == pytest.approx([0, 0.5])


def test_the_committed_page_is_that_of_these_groups():
    page, checks = PAGE.read_text(encoding="utf-8"), COMMITTED["checks"]
    counts = {group: str(sum(check["group"] == group for check in checks)) for group in GROUPS}
    assert {row[0].partition("**: ")[0][2:]: row[1] for row in rows(page)} == counts
    assert f"**{len(checks)} of {len(checks)} checks pass**" in page
    assert all(check["holds"] for check in checks)
    assert len({check["name"] for check in checks}) == len(checks)  # no two rows of one name


def test_sources_exist():
    """Labels of the paper, known references, or modules; errata with the number of a section."""
    sections = re.findall(r"^## (\d+)\.", (PAGE.parent / "errata.md").read_text(encoding="utf-8"), re.MULTILINE)
    for source in {check["source"] for check in COMMITTED["checks"]}:
        assert source
        for part in source.split("; "):
            erratum = re.search(r" \(docs/errata.md, (\d+)\)$", part)
            assert erratum is None or erratum.group(1) in sections
            name = part[: erratum.start()] if erratum else part
            if name.startswith("nontwist."):
                assert find_spec(name)
            elif name not in labels():
                assert any(name.startswith(short) for short in COMMITTED["references"]), name


def test_many_digits_are_those_of_the_reference():
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
