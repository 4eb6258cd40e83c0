"""Every label of the paper that is cited exists in the paper."""

from pathlib import Path

from nontwist.paper.tables import LABEL, printed_numbers

ROOT = Path(__file__).parents[2]


def labels():
    return set(printed_numbers())


def test_every_cited_label_exists():
    places = [path for folder in ("src", "tests", "docs") for path in (ROOT / folder).rglob("*.[pm][yd]")]
    cited = {match.lower(): path for path in places for match in LABEL.findall(path.read_text(encoding="utf-8"))}
    assert {label: cited[label] for label in cited.keys() - {label.lower() for label in labels()}} == {}
    assert len(cited) > 30  # docstrings may begin with a capital
    assert len(labels()) == 83
