"""What the package says of its inputs: tests compare codes and fields; sentences are in one golden file.

`python tests/refusals.py` renews the file, tests/data/sentences.json, where sentences have changed; a reader judges the
difference.
"""

import inspect
import json
import os
import re
import sys
import tempfile
import warnings
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest

import nontwist
from nontwist.errors import InputError, InputWarning

GOLDEN = Path(__file__).parent / "data" / "sentences.json"
PLACES = (  # what is not the same on every machine, and what is put in its place
    (re.escape(tempfile.gettempdir()) + r"/pytest-of-[^/]+/pytest-\d+/(popen-gw\d+/)?[^/]+/", ""),
    (re.escape(str(Path(nontwist.__file__).parent)), "NONTWIST"),
    (re.escape(str(GOLDEN.parents[2])), "ROOT"),
    (r"(\d\.\d{5})\d{3,}", r"\1…"),
    (" at 0x[0-9a-f]+", ""),
    (r"\b(?!test_)[a-z]+\.(?=test_)", ""),  # the folder of a test
    (r"\d{5,} bytes, \d{5,} were", "… bytes, … were"),
    ("float division by zero", "division by zero"),
)
FOUND: dict[str, list[str]] = {}
RENEW = "NONTWIST_ANY_SENTENCE" in os.environ  # as faults are planted: sentences find none of them


@contextmanager
def refused(code, **fields):
    """Expect an InputError with this code and, among its fields, these."""
    with pytest.raises(InputError) as told:
        yield told
    assert told.value.code == code, told.value
    assert {name: told.value.fields.get(name) for name in fields} == fields


@contextmanager
def warned(*codes):
    """Expect these warnings, in this order and no others, of inputs; give the list of them."""
    caught = []
    with warnings.catch_warnings(record=True) as every:
        warnings.simplefilter("always")
        yield caught
    caught += [one.message for one in every if isinstance(one.message, InputWarning)]
    assert tuple(one.code for one in caught) == codes, [str(one.message) for one in every]


def refused_as(calls, kind=ValueError):
    """Return a test that each of the calls raises this kind of error, with the sentence of the golden file."""
    if not isinstance(calls, dict):
        calls = {str(i): call for i, call in enumerate(calls)}

    @pytest.mark.parametrize("call", calls.values(), ids=calls)
    def refusing(call):
        with says(kind):
            call()

    return refusing


@contextmanager
def says(kind=ValueError):
    """Expect this kind of error or warnings with the sentence that the golden file has for this place in this test."""
    if kind is UserWarning:
        with pytest.warns(kind) as told:
            yield told
        said("\n".join(f"{one.category.__name__}: {one.message}" for one in told))
        return
    with pytest.raises(kind) as told:
        yield told
    said(f"{told.type.__name__}: {told.value}")


def said(sentence):
    """Require this sentence to be that of the golden file for this place in this test."""
    file, _, test = os.environ["PYTEST_CURRENT_TEST"].rpartition(" ")[0].partition("::")
    key = f"{Path(file).name}::{test}"
    for pattern, place in PLACES:
        sentence = re.sub(pattern, place, sentence)
    found = FOUND.setdefault(key, [])
    found.append(sentence)
    if not RENEW:
        assert sentence == (golden().get(key, []) + [None] * len(found))[len(found) - 1]


@cache
def golden():
    return json.loads(GOLDEN.read_text(encoding="utf-8"))


class Renewal:
    """Runs the tests that look at the golden file, and no others."""

    def pytest_collection_modifyitems(self, items):
        known = golden()
        items[:] = [
            one
            for one in items
            if f"{one.path.name}::{one.name}" in known or re.search(r"\bsa(ys|id)\(", inspect.getsource(one.function))
        ]


def renew(*files):
    """Make the golden file again from what is said now, or its part of these files."""
    global RENEW
    RENEW = True
    folder = GOLDEN.parents[1]
    users = files or [
        str(one) for one in folder.rglob("test_*.py") if "from refusals import" in one.read_text(encoding="utf-8")
    ]
    status = pytest.main(["-q", "-n", "0", "-p", "no:cacheprovider", *users], plugins=[Renewal()])
    kept = golden() if files else {}
    text = json.dumps(dict(sorted((kept | FOUND).items())), indent=1, ensure_ascii=False)
    GOLDEN.write_text(text + "\n", encoding="utf-8")
    return status


if __name__ == "__main__":
    import refusals

    sys.exit(refusals.renew(*sys.argv[1:]))
