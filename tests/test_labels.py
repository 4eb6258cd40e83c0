"""Every label of the paper that is cited exists in the paper."""

import re
from importlib.resources import files
from pathlib import Path

ROOT = Path(__file__).parents[1]
CITED = re.compile(r"(?<![\w-])(?:eq|tab|sec|subs|fig)[-_:][A-Za-z][\w:-]*[\w]")


def labels():
    return set(files("nontwist.paper").joinpath("labels.txt").read_text().split())


def citations():
    places = [path for folder in ("src", "tests", "docs") for path in (ROOT / folder).rglob("*.[pm][yd]")]
    return {(match, path.name) for path in places for match in CITED.findall(path.read_text(encoding="utf-8"))}


def test_every_cited_label_exists():
    known = {label.lower() for label in labels()}  # docstrings may begin with a capital
    assert {(label, place) for label, place in citations() if label.lower() not in known} == set()


def test_labels_are_cited_at_all():
    assert len({label for label, _ in citations()}) > 30
    assert len(labels()) == 83
