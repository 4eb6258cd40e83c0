"""No power of 0.2.0 goes silently: what a row of the table says is the same, is."""

import pytest

from powers.collect import accuracy_of, alike, is_run, names, result, table

ROWS = table()
THERE = {
    (kind, name if row["now"] == "same" else row["now"].removeprefix("renamed: "))
    for (kind, name), row in ROWS.items()
    if row["now"] != "gone"
}


def test_same_or_renamed():
    assert sorted(THERE - names()) == []


def test_what_changes_says_why():
    assert [row for row in ROWS.values() if row["now"] != "same" and not row["why"]] == []
    assert all(row["now"] in ("same", "gone") or row["now"].startswith("renamed: ") for row in ROWS.values())


def test_nearly_all_calls_are_made():
    assert all(row["call"] for row in ROWS.values())
    assert sum(row["result"].startswith("not run") for row in ROWS.values()) < 0.05 * len(ROWS)


@pytest.mark.parametrize(
    ("old", "new", "is_alike"),
    [
        ("float, 1 numbers |2| +1.00000000", "float, 1 numbers |2.000000001| +1.00000000", True),
        ("float, 1 numbers |2| +1.00000000", "float, 1 numbers |2.00000001| +1.00000000", False),
        ("float, 1 numbers |2| +1.00000000", "float, 1 numbers |2| -1.00000000", False),
        ("float, 1 numbers |2| +1.00000000", "int, 1 numbers |2| +1.00000000", False),
        ("ValueError: one", "ValueError: two", True),
        ("ValueError: one", "TypeError: one", False),
        ("ValueError: one", "bool True", False),
        ("exit 2: one", "exit 3: one", False),
        ("exit 0; prints", "exit 0; prints; run.nc: written", False),
    ],
)
def test_results_are_compared_by_numbers(old, new, is_alike):
    assert alike(old, new) == is_alike


@pytest.mark.long
@pytest.mark.parametrize("kind", sorted({kind for kind, _ in ROWS}))
def test_results_are_the_same(kind):
    rows = [row for row in ROWS.values() if row["kind"] == kind and is_run(row)]
    found = [(row["name"], row["call"], row["result"], result(row["call"]), accuracy_of(row)) for row in rows]
    assert [one for one in found if not alike(*one[2:])] == []
