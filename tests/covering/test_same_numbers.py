"""The numbers of version 0.2.0, whose kernels were compiled by Numba: a covering array of problems, recomputed."""

import numpy as np
import pytest

from nontwist.loads import LOADS as KINDS

from .problems import DIFFERENCED, DIFFERENTIATED, LOADS, factors, made_load, outcome, pairs_of, schemes
from .record import Recorded, scale_of

ROUNDING = 1e-12  # of the largest number of an array, times its growth
DERIVATIVES = 1e-11  # of derivatives, whose equations are solved otherwise than in 0.2.0
DIFFERENCES = 1e-7  # of derivatives, where 0.2.0 took central differences of a function
BETWEEN = 1e-7  # of states between steps of gauss: 0.2.0 took one more step (`integrators.dense`)
MEANS, BETWEEN_MEANS = ("moment", "multipliers", "load_work"), 1e-6  # of moments between such states, and their work
ADAPTIVE = 1e-9  # of SciPy's solver: it chooses its steps by errors, which round-off changes
HELD = ("nontwisting", "suslov", "spin")  # bodies with a constrained axis, which have no dissipation
REDUCED = ("compiled potential", "long spring", "potential", "quadratic", "sum of all")  # since 0.3.0
QUICK = 17  # every so manieth problem is in the quick suite
RECORDED = Recorded()


def check(place):
    problem, (expected, growth) = RECORDED.rows[place], RECORDED.numbers(place)
    found = outcome(problem)
    if (
        problem.way == "stepper"
        and problem.scheme.endswith("dissipative")
        and any(word in problem.body for word in HELD)
    ):
        assert found == "ValueError"  # 0.2.0 refused it of runs alone
        return
    assert not isinstance(found, str), f"{problem} is refused with {found}"
    assert found.keys() == expected.keys()
    for name, array in expected.items():
        assert found[name].shape == array.shape, name
        gap = abs(found[name] - array).max(initial=0)
        is_between = problem.scheme.startswith("gauss") and (
            problem.output.startswith("times") or problem.way in ("events", "terminal")
        )
        if found[name].dtype.kind == "i":
            if is_between and name.endswith("newton_iterations"):  # of whole steps now
                continue
            is_count = name.endswith("newton_iterations")  # fewer are welcome
            more = (found[name] - array).max(initial=0) if is_count else gap
            assert more <= (growth[name] if is_count else 0), f"{problem}, {name}: {more}"
            continue
        bound = (DERIVATIVES if problem.way in DIFFERENTIATED else ROUNDING) * growth[name]
        if problem.load in DIFFERENCED and problem.way in DIFFERENTIATED:
            bound = DIFFERENCES
        elif is_between:
            bound = BETWEEN_MEANS if name.endswith(MEANS) else BETWEEN
        elif problem.scheme == "continuous":
            bound = ADAPTIVE
        assert gap <= bound * scale_of(array), f"{problem}, {name}: {gap / scale_of(array):.2g}, bound {bound:.2g}"


@pytest.mark.parametrize("place", range(0, len(RECORDED.rows), QUICK))
def test_a_problem_has_its_numbers(place):
    check(place)


@pytest.mark.long
def test_all_problems_have_their_numbers():
    failed = []
    for place in range(len(RECORDED.rows)):
        try:
            check(place)
        except AssertionError as error:
            failed.append(str(error).splitlines()[0])
    assert not failed, "\n".join([f"{len(failed)} of {len(RECORDED.rows)} differ", *failed])


@pytest.mark.parametrize("quick", [True, pytest.param(False, marks=pytest.mark.long)])
def test_what_was_refused_still_is(quick):
    for problem, name in RECORDED.refused[:: QUICK if quick else 1]:
        is_reduced = problem.way == "statistics" and problem.load in REDUCED
        assert isinstance(outcome(problem), dict) if is_reduced else outcome(problem) == name, problem


def test_every_choice_of_the_registries_is_in_the_array():
    assert len(RECORDED.rows) >= 300
    for place, names in enumerate(factors()):
        assert set(names) == {row[place] for row in RECORDED.rows}
    kinds = {type(term) for name in LOADS for term in made_load(name).terms}
    ours = {name for name, kind in KINDS.items() if kind.__module__.startswith("nontwist.")}
    assert kinds == {KINDS[name] for name in ours - {"wheel", "memory", "dry_friction"}}  # which 0.2.0 had not
    assert set(schemes()) <= {row.scheme for row in RECORDED.rows}


def test_every_pair_is_in_the_array_or_refused():
    known = {pair for row in [*RECORDED.rows, *(row for row, _ in RECORDED.refused)] for pair in pairs_of(row)}
    names = factors()
    count = sum(len(a) * len(b) for i, a in enumerate(names) for b in names[i + 1 :])
    assert len(known) == count


def test_no_motion_amplifies_much():
    growth = np.array([max(one[3] for one in arrays) for arrays in RECORDED.contents])
    assert np.quantile(growth, 0.9) < 1e3
