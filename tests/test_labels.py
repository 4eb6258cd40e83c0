"""Every label of the paper that is cited exists in the paper."""

from pathlib import Path

from nontwist.paper.tables import LABEL, printed_numbers

ROOT = Path(__file__).parents[1]


def labels():
    return set(printed_numbers())


def citations():
    places = [path for folder in ("src", "tests", "docs") for path in (ROOT / folder).rglob("*.[pm][yd]")]
    return {(match, path.name) for path in places for match in LABEL.findall(path.read_text(encoding="utf-8"))}


def test_every_cited_label_exists():
    known = {label.lower() for label in labels()}  # docstrings may begin with a capital
    assert {(label, place) for label, place in citations() if label.lower() not in known} == set()


def test_labels_are_cited_at_all():
    assert len({label for label, _ in citations()}) > 30
    assert len(labels()) == 83
