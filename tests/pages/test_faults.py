"""Every fault ends as it should; what is done stands in `faults`."""

from pathlib import Path

import pytest

pytest.importorskip("resource")
from faults import FAULTS, LONG
from faults.__main__ import page

PAGE = Path(__file__).parents[2] / "docs" / "faults.md"


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.long] * (name in LONG)) for name in FAULTS])
def test_fault(name, tmp_path):
    assert FAULTS[name](tmp_path)


def test_the_page_names_each():
    assert PAGE.read_text(encoding="utf-8") == page()
