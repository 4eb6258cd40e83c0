"""`python -m covering.record`, from tests/: store what the installed package computes for a covering array of problems.

The file has one vector of numbers and a table of contents: rows of the array, and of each array of numbers its name,
shape, first place, and growth: how many times larger a relative change of the start by 1e-10 is at most in it.
"""

from __future__ import annotations

import json
from math import ceil
from pathlib import Path

import numpy as np

from .problems import Problem, covering, outcome

FILE = Path(__file__).parents[1] / "data" / "covering_0.2.0.npz"
CHANGE = 1e-10  # of the start, relative
CHANGES = (CHANGE, -CHANGE, 4e-16, -4e-16)  # the last ones for iterations, which round-off may end earlier or later
JUMP = 1e4  # a growth from which a problem is left out
SMALLEST = 0.1  # of what numbers are compared with; what is below it is a difference of larger ones


def scale_of(array):
    """Return the largest number of an array, to which errors are relative."""
    return max(SMALLEST, float(abs(array).max(initial=0)))


def growth(numbers, changed):
    """Return by how much a change of the start has grown in each array, at least 1; `JUMP` where a shape changes.

    Of numbers of iterations: how much they may differ.
    """
    found = {}
    for name, array in numbers.items():
        other = changed[name]
        if array.shape != other.shape:
            return dict.fromkeys(numbers, JUMP)
        gap = float(abs(array.astype(float) - other).max(initial=0))
        found[name] = 1 + int(gap) if array.dtype.kind == "i" else max(1, ceil(gap / scale_of(array) / CHANGE))
    return found


class Recorded:
    """The recorded problems: `rows`, `refused` rows with the class of their errors, and numbers of a row by its place.

    Attributes
    ----------
    rows : list of Problem
    contents : list, for each row, of (name, shape, first place, growth)
    refused : list of (Problem, class)
    """

    def __init__(self):
        with np.load(FILE) as stored:
            table, self._numbers = json.loads(str(stored["contents"])), stored["numbers"]
        self.rows = [Problem(*row) for row in table["rows"]]
        self.refused = [(Problem(*row), name) for row, name in table["refused"]]
        self.contents = table["contents"]

    def numbers(self, place):
        """Return the arrays of a row, and the growth of each."""
        found, grown = {}, {}
        for name, shape, first, growth in self.contents[place]:
            found[name] = self._numbers[first : first + int(np.prod(shape))].reshape(shape)
            grown[name] = growth
        return found, grown


def record():
    """Make the array, run it, and store its numbers; print how many there are and how they grow."""
    known, grown = {}, {}

    def is_accepted(row):
        known[row] = found = outcome(Problem(*row))
        if isinstance(found, str):
            return False
        changes = [growth(found, outcome(Problem(*row), change)) for change in CHANGES]
        grown[row] = {name: max(one[name] for one in changes) for name in found}
        is_smooth = max(grown[row].values()) < JUMP
        if not is_smooth:
            print("left out, a small change of the start makes it jump:", *row, sep=", ")
        return is_smooth

    rows, refused = covering(is_accepted)
    numbers, contents, first, greatest = [], [], 0, []
    for row in rows:
        found = known[row]
        contents.append([])
        for name, array in found.items():
            contents[-1].append((name, array.shape, first, grown[row][name]))
            numbers.append(array.ravel().astype(float))
            first += array.size
        greatest.append(max(grown[row].values()))
    refused = [row for row in refused if isinstance(known[row], str)]
    table = {"rows": rows, "refused": [(row, known[row]) for row in refused], "contents": contents}
    np.savez_compressed(FILE, numbers=np.concatenate(numbers), contents=np.array(json.dumps(table)))
    parts = np.percentile(greatest, [50, 90, 99, 100])
    print(f"{len(rows)} problems, {len(refused)} refused, {first} numbers, {FILE.stat().st_size / 1e6:.2f} MB")
    print(f"growth: median {parts[0]:.0f}, 90 % {parts[1]:.0f}, 99 % {parts[2]:.0f}, largest {parts[3]:.3g}")


if __name__ == "__main__":
    record()
