"""Every fault ends as it should; what is done stands in `faults`."""

import inspect
from pathlib import Path

import pytest

pytest.importorskip("resource")
from faults import FAULTS, LONG

PAGE = Path(__file__).parents[1] / "docs" / "faults.md"


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.long] * (name in LONG)) for name in FAULTS])
def test_fault(name, tmp_path):
    assert FAULTS[name](tmp_path)


def test_the_page_tells_of_each():
    page = PAGE.read_text(encoding="utf-8")
    for fault in FAULTS.values():
        assert " ".join(inspect.getdoc(fault).split()).replace("|", "\\|") in page
