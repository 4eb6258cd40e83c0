"""What is no number is refused by name, by all that takes numbers, in words that say what helps."""

from decimal import Decimal
from fractions import Fraction
from functools import cache, partial

import numpy as np
import pandas
import pytest
import scipy.sparse

import nontwist as nt
from conftest import NONTWISTING
from nontwist import exact, plot, sphere
from nontwist.geometry.arrays import as_array, as_floats, as_number
from nontwist.geometry.values import as_function, as_list, as_path, as_whole, guess
from nontwist.runfile import read_run_file
from refusals import refused_as

BODY = NONTWISTING


@cache
def run():
    return nt.simulate(BODY, t_end=1, step=0.5, angular_velocity=(0, 1, 0))


@cache
def many():
    return nt.simulate_ensemble(BODY, t_end=1, step=0.5, angular_velocity=[(0, 1, 0), (1, 0, 0)])


MASKED = np.ma.masked_array([1.0, 2.0, 0.0], [0, 1, 0])
REFUSED = {
    "complex": [1j, 4, 5],
    "masked": MASKED,
    "masked in a list": [MASKED[0], np.ma.masked, 1.0],
    "dates": np.array(["2026-01-01"] * 3, "M8[s]"),
    "durations": np.array([1, 2, 3], "m8[s]"),
    "objects": np.array([1, 2, 3], dtype=object),
    "texts": ["1", "2", "3"],
    "nothing": [1, None, 3],
    "rows": [[1], [1, 2], 3],
    "a large entry": [1, 10**400, 3],
}


test_no_number = refused_as({name: partial(nt.standard, value) for name, value in REFUSED.items()})


def test_dates_are_twist_times():
    motion = run().directors.values.mT
    dates = np.array([0, 500, 1000], "M8[ms]")
    assert nt.twist(motion, dates).time.values.tolist() == [0.0, 0.5, 1.0]
    with pytest.raises(ValueError, match="time has masked values"):
        nt.twist(motion, np.ma.masked_array([0, 1, 2], [0, 1, 0]))
    with pytest.raises(ValueError, match="the column 'w' is complex; real numbers are taken"):
        nt.rotation(pandas.DataFrame({"w": [1j, 1], "x": [0, 0], "y": [0, 0], "z": [0, 0]}))


@pytest.mark.parametrize(
    "value",
    [
        [1, 2, 3],
        (Fraction(1), Decimal(2), 2**70 / 2**69 + 1),
        np.array([1, 2, 3], "u1"),
        np.ma.masked_array([1, 2, 3]),
        pandas.Series([1, 2, 3], dtype="Int64"),
        np.array([1, 2, 3], np.longdouble),
    ],
)
def test_numbers_of_every_kind(value):
    found = as_array(value, "W", (3,))
    assert found.dtype == np.float64
    assert found.tolist() == [1.0, 2.0, 3.0]


def test_copies_are_taken():
    given = np.zeros(3)
    as_floats(given, "W")[0] = 1.0
    assert given[0] == 0.0
    assert as_floats(True, "W") == 1.0
    assert as_number(np.float32(0.5), "h") == 0.5
    assert as_array(1, "v", (...,)).shape == ()
    with pytest.raises(ValueError, match=r"v must have the shape \(\.\.\., 3\), got \(3, 2\)"):
        as_array(np.zeros((3, 2)), "v", (..., 3))
    with pytest.raises(ValueError, match="inertia must be a number, got <"):
        nt.standard(scipy.sparse.eye_array(3))


def test_extended_precision_overflow():
    if np.finfo(np.longdouble).max == np.finfo(np.float64).max:
        pytest.skip("long doubles are doubles here")
    with pytest.raises(ValueError, match=r"W\[1\] = inf is not finite"):
        as_array(np.array([1, np.longdouble("1e4000")]), "W", (2,))


test_wrong_things = refused_as(
    [
        lambda: nt.simulate(BODY, t_end=1, load=3),
        lambda: nt.Load((3,)),
        lambda: nt.Load().sample([0], "x"),
        lambda: nt.wheel("x", 0.1, breakpoints=None),
        lambda: nt.simulate(BODY, t_end=1, integrator=[]),
        lambda: nt.integrators.LieMidpoint(order=[4]),
        lambda: nt.comparison.second_quotient(1, 2, 3),
        lambda: plot.energy(run(), ax=3),
        lambda: plot.directors(run(), director=[1]),
        lambda: plot.path(run(), triads=-1),
        lambda: plot.new_axes(panels=21),
        lambda: plot.new_axes(height=101),
        lambda: plot.energy(run().isel(time=[])),
        lambda: nt.simulate(BODY, t_end=2, start=run().isel(time=[])),
        lambda: nt.simulate_ensemble(BODY, t_end=2, start=many().assign(quaternion=1j * many().quaternion)),
        lambda: nt.open_run(3.5),
        lambda: read_run_file(b"x"),
        lambda: read_run_file("x", [3]),
        lambda: nt.save_run(run().assign(a=("time", [1j, 0, 0])), "a.nc"),
        lambda: nt.view(run(), title=3),
        lambda: nt.validate(workers=0),
        lambda: nt.reproduce("x", cases=[[]]),
        lambda: exact.discrete_free([3, 4, 5], (0, 1, 0), 0.1, 10**12),
        lambda: exact.free_standard([3, 4, 5], (1, 2, 3), MASKED),
        lambda: nt.rotation(MASKED),
        lambda: sphere.distance(MASKED, (0, 0, 1)),
    ]
)


test_damaged_run = refused_as(
    [
        lambda: nt.resample(run().drop_vars("directors"), [0.1]),
        lambda: nt.resample(run().drop_attrs(), [0.1]),
        lambda: nt.resample(run().isel(axis=0), [0.1]),
        lambda: nt.resample(run().assign(directors=run().directors * 1j), [0.1]),
    ]
)


def test_values_that_are_no_arrays():
    assert as_whole(np.int32(3), "n", 1) == 3
    assert as_list(iter("ab"), "names") == ["a", "b"]
    assert as_path("a", "path").name == "a"
    assert as_function(len, "f") is len
    with pytest.raises(ValueError, match=r"n must be a whole number >= 1, got a value of type int"):
        as_whole(-(10**5000), "n", 1)


def test_short_words_are_guessed_nearly():
    """Of three letters one makes another unit: rps is rev/s or rad/s, and no rpm."""
    units = ["rad/s", "deg/s", "rpm"]
    assert guess("rps", units) == ""
    assert guess("RPM", units) == "did you mean rpm? "
    assert guess("mss", ["mass", "body"]) == "did you mean mass? "
