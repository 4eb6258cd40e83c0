"""The numbers of version 0.2.0, whose kernels were compiled by Numba: a covering array of problems, recomputed.

Its stored rows have every pair of choices that 0.2.0 accepts, `refused` ones the others. Of each array of numbers they
tell name, shape, first place, and growth: how many times larger a relative change of the start by 1e-10 is at most in
it; of numbers of iterations, how much they may differ. Motions that jump were left out. What made the file is in its
history: `covering/record.py`.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from nontwist.loads import LOADS as KINDS

from .problems import DIFFERENCED, DIFFERENTIATED, LOADS, Problem, factors, made_load, outcome, schemes

ROUNDING = 1e-12  # of the largest number of an array, times its growth
SMALLEST = 0.1  # of what numbers are compared with; what is below it is a difference of larger ones
DERIVATIVES = 1e-11  # of derivatives, whose equations are solved otherwise than in 0.2.0
DIFFERENCES = 1e-7  # of derivatives, where 0.2.0 took central differences of a function
BETWEEN = 1e-7  # of states between steps of gauss: 0.2.0 took one more step (`integrators.dense`)
MEANS, BETWEEN_MEANS = ("moment", "multipliers", "load_work"), 1e-6  # of moments between such states, and their work
ADAPTIVE = 1e-9  # of SciPy's solver: it chooses its steps by errors, which round-off changes
REDUCED = ("compiled potential", "long spring", "potential", "quadratic", "sum of all")  # since 0.3.0
SPRING = 1.5 / 2 * (0.2**2 + 0.8**2 + 0.7**2 + 0.9**2)  # J: ½ k (|ρ|² + |a|²), which statistics of 0.2.0 left out
QUICK = 17  # every so manieth problem is in the quick suite
with np.load(Path(__file__).parents[1] / "data" / "covering_0.2.0.npz") as stored:
    TABLE, NUMBERS = json.loads(str(stored["contents"])), stored["numbers"]
ROWS = [Problem(*row) for row in TABLE["rows"]]
HELD = ("nontwisting", "suslov", "spin")  # bodies with a constrained axis, which have no dissipation


def bound_of(problem, name, growth):
    """How far a number may be off, relative to the largest of its array."""
    if problem.load in DIFFERENCED and problem.way in DIFFERENTIATED:
        return DIFFERENCES
    if is_between(problem):
        return BETWEEN_MEANS if name.endswith(MEANS) else BETWEEN
    if problem.scheme == "continuous":
        return ADAPTIVE
    return (DERIVATIVES if problem.way in DIFFERENTIATED else ROUNDING) * growth


def is_between(problem):
    is_asked = problem.output.startswith("times") or problem.way in ("events", "terminal")
    return problem.scheme.startswith("gauss") and is_asked


def is_extreme(problem, name):
    is_dense = problem.scheme.startswith("gauss") and problem.scheme != "gauss 2"
    return problem.way == "statistics" and is_dense and name.endswith(("_min", "_max")) and "reaction" not in name


def check(place):
    problem = ROWS[place]
    found, is_held = outcome(problem), any(word in problem.body for word in HELD)
    if problem.way == "stepper" and problem.scheme.endswith("dissipative") and is_held:
        assert found == "ValueError"  # 0.2.0 refused it of runs alone
        return
    assert not isinstance(found, str), f"{problem} is refused with {found}"
    assert found.keys() == {name for name, *_ in TABLE["contents"][place]}
    for name, shape, first, growth in TABLE["contents"][place]:
        assert found[name].shape == tuple(shape), name
        array = NUMBERS[first : first + found[name].size].reshape(shape)
        if (problem.load, problem.way) == ("spring", "statistics") and name.startswith("potential_energy_"):
            array = array + SPRING * np.array([1.4, 1.35, 1.3])
        more, is_count = found[name] - array, name.endswith("newton_iterations")  # of which fewer are welcome
        if is_extreme(problem, name):  # between nodes as well since 0.3.0, by 0.005 of the largest number
            size, beyond = max(SMALLEST, abs(array).max(initial=0)), -more if name.endswith("_min") else more
            assert beyond.min() >= -ROUNDING * growth * size, name
            assert beyond.max() <= 0.006 * size, name
            continue
        gap = (more if is_count else abs(more)).max(initial=0)
        if is_count and is_between(problem):  # of whole steps now
            continue
        if found[name].dtype.kind == "i":
            assert gap <= (growth if is_count else 0), f"{problem}, {name}: {gap}"
            continue
        gap, bound = gap / max(SMALLEST, abs(array).max(initial=0)), bound_of(problem, name, growth)
        assert gap <= bound, f"{problem}, {name}: {gap:.2g}, bound {bound:.2g}"


@pytest.mark.parametrize("place", range(0, len(ROWS), QUICK))
def test_a_problem_has_its_numbers(place):
    check(place)


@pytest.mark.long
def test_all_problems_have_their_numbers():
    failed = []
    for place in range(len(ROWS)):
        try:
            check(place)
        except AssertionError as error:
            failed.append(str(error).splitlines()[0])
    assert not failed, "\n".join([f"{len(failed)} of {len(ROWS)} differ", *failed])


@pytest.mark.parametrize("quick", [True, pytest.param(False, marks=pytest.mark.long)])
def test_what_was_refused_still_is(quick):
    refused = [(Problem(*row), name) for row, name in TABLE["refused"]]
    for problem, name in refused[:: QUICK if quick else 1]:
        is_reduced = problem.way == "statistics" and problem.load in REDUCED
        assert isinstance(outcome(problem), dict) if is_reduced else outcome(problem) == name, problem


def test_array_covers_the_registries():
    assert len(ROWS) >= 300
    for place, names in enumerate(factors()):
        assert set(names) == {row[place] for row in ROWS}
    kinds = {type(term) for name in LOADS for term in made_load(name).terms}
    ours = {name for name, kind in KINDS.items() if kind.__module__.startswith("nontwist.")}
    assert kinds == {KINDS[name] for name in ours - {"wheel", "memory", "dry_friction"}}  # which 0.2.0 had not
    assert set(schemes()) <= {row.scheme for row in ROWS}
