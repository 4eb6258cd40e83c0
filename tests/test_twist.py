"""Twist of motions against what is known exactly, and recordings with everything that goes wrong in them."""

import functools
import re
import warnings

import mpmath
import numpy as np
import pandas
import pytest
import xarray
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nontwist import integrate, simulate, standard, twist
from nontwist.curves import nontwisting_frame, solid_angle
from nontwist.integrators import Continuous
from refusals import says

FINE = Continuous(rtol=1e-13, atol=1e-14)


def smooth(seed, n=400):
    """A random smooth motion with Λ(0) ≠ I; (time, Rotation)."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 4, n)
    a, b = rng.normal(size=(2, 3, 3))
    f = np.stack([np.sin((k + 1) * 0.7 * t + k) for k in range(3)], axis=1)
    return t, Rotation.from_rotvec(f @ a) * Rotation.from_rotvec(f[::-1] @ b) * Rotation.from_rotvec([0.5, -1, 2])


def modulo(x):
    return (np.asarray(x) + np.pi) % (2 * np.pi) - np.pi


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("seed", range(10))
def test_swing_twist_minus_twist_is_the_solid_angle(seed, order):
    t, R = smooth(seed)
    result = twist(R, t, axis=np.random.default_rng(seed).normal(size=3), order=order)
    assert result.twist_angle[0] == 0
    assert modulo(result.swing_twist_angle - result.twist_angle - result.solid_angle) == pytest.approx(0, abs=1e-14)


def test_solid_angle_against_a_frame_transported_there_and_back():
    """Independently of the triangles: the frame on the dense path, closed by a dense great circle, turns by Ω."""
    t, R = smooth(3, 400)
    dense = smooth(3, 20000)[1]
    result = twist(R, t)
    d = dense.apply([0, 0, 1])
    back = np.linspace(0, 1, 2000)[:, None]
    way = d[-1] + back * (d[0] - d[-1])
    loop = np.concatenate([d, way[1:] / np.linalg.norm(way[1:], axis=1)[:, None]])
    frame = nontwisting_frame(loop, order=2)
    turned = np.arctan2(frame[-1, 0] @ frame[0, 1], frame[-1, 0] @ frame[0, 0])
    assert modulo(turned - float(result.solid_angle[-1])) == pytest.approx(0, abs=3e-6)


@functools.cache
def circles(delta, turns=3, n=200):
    """Turns of the axis on a circle through its start, which passes the antipode of the start at `delta` on the left.

    The motion, Ω and the distance from the antipode. Ω is the sector of the small circle less the spherical triangle of
    centre, start and axis, 2 atan2(k sin φ, 1 + k cos φ) with k = tan²(ρ/2), to 40 digits.
    """
    rho, sign = np.pi / 2 - abs(delta) / 2, -1 if delta < 0 else 1
    phi = np.linspace(0, 2 * np.pi * turns, turns * n + 1)
    turn = Rotation.from_rotvec(np.outer(sign * phi, [np.sin(rho), 0, np.cos(rho)]))
    motion = Rotation.from_rotvec([0.3, 0.4, 0.5]) * turn * Rotation.from_rotvec(np.outer(0.3 * phi, [0, 0, 1]))
    with mpmath.workdps(40):
        k, cap = mpmath.tan(mpmath.mpf(rho) / 2) ** 2, 1 - mpmath.cos(mpmath.mpf(rho))
        cosines, sines = zip(*(mpmath.cos_sin(mpmath.mpf(x)) for x in phi), strict=True)
        pairs = zip(phi, cosines, sines, strict=True)
        area = [cap * mpmath.mpf(x) - 2 * mpmath.atan2(k * s, 1 + k * c) for x, c, s in pairs]
    return motion, sign * np.array(area, float), np.hypot(delta, 2 * np.cos(phi / 2))


SEEN = {
    "body": lambda motion: twist(motion),
    "space": lambda motion: -twist(motion.inv(), axis_frame="space"),
    "relative": lambda motion: twist(CARRIER * motion, relative_to=CARRIER),
}
CARRIER = smooth(7, 601)[1]


@pytest.mark.parametrize("seen", SEEN)
@pytest.mark.parametrize("delta", [0, 1e-15, 1e-14, 1e-12, 1e-9, 1e-8, 1e-7, 1e-3])
def test_solid_angle_past_the_antipode_of_the_start(delta, seen):
    """Three passes on either side, against the closed form; straight through counts as on the left."""
    for side in (1, -1):
        motion, expected, distance = circles(side * delta)
        result = SEEN[seen](motion)
        gap = result.solid_angle - expected
        if side < 0 and delta < 1e-13:  # on which side nobody can tell
            gap = (gap + 2 * np.pi) % (4 * np.pi) - 2 * np.pi
        far = distance > 1e-13
        allowed = abs(result.error_estimate) + 1e-13 + 1e-14 / np.maximum(distance, 1e-15)
        assert np.all((abs(gap) <= allowed)[far])
        rest = result.swing_twist_angle - result.twist_angle - result.solid_angle
        assert modulo(rest) == pytest.approx(0, abs=1e-14)
        assert np.all((-np.pi <= result.swing_twist_angle) & (result.swing_twist_angle <= np.pi))


def test_solid_angle_of_a_great_circle_that_has_a_sample_at_the_antipode():
    t = np.linspace(0, 1, 401)
    along = Rotation.from_rotvec(np.outer(2 * np.pi * 0.8 * t, [1, 0, 0]))
    motion = Rotation.from_rotvec([0.3, 0.4, 0.5]) * along * Rotation.from_rotvec(np.outer(2 * t, [0, 0, 1]))
    result = twist(motion, t)
    assert result.solid_angle.values == pytest.approx(np.where(t > 0.625, 2 * np.pi, 0), abs=1e-13)
    assert result.twist_angle.values == pytest.approx(2 * t, abs=1e-14)


@pytest.mark.parametrize("meridian", [0.5, -2, 3, np.pi, 0])
def test_solid_angle_from_the_start_to_its_antipode_and_back(meridian):
    """There along the meridian 0, back along another, with a stay at the antipode: a lune of twice their angle.

    At the antipode itself Ω and the half circle that leads back are those of the sample before.
    """
    theta = np.linspace(0, np.pi, 21)[:, None]
    stay = np.linspace([0, np.pi, 0], [meridian, np.pi, 0.7], 9)
    angles = np.concatenate([theta * [0, 1, 0], stay, [meridian, 0, 0.7] + theta[::-1] * [0, 1, 0]])
    result = twist(Rotation.from_euler("ZYZ", angles), order=2)
    expected = np.repeat([0, 2 * meridian], [31, 20])
    assert result.solid_angle.values == pytest.approx(expected, abs=1e-13)
    rest = result.swing_twist_angle - result.twist_angle - result.solid_angle
    assert modulo(rest) == pytest.approx(0, abs=1e-14)


@pytest.mark.parametrize("seed", range(4))
def test_solid_angle_is_that_of_the_polygon_so_far(seed):
    """Of random walks with wide steps, with the start as the pole; samples close to the antipode among them."""
    rng = np.random.default_rng(seed)
    steps = Rotation.from_rotvec(rng.normal(size=(60, 3)) * 0.7)
    walk = [Rotation.from_rotvec([1, 2, 3])]
    for step in steps:
        walk.append(walk[-1] * step)
    walk[30] = walk[0] * Rotation.from_rotvec([np.pi - 10.0 ** -(3 + seed), 0, 0])
    motion = Rotation.concatenate(walk)
    d3 = motion.apply([0, 0, 1])
    result = quietly(lambda: twist(motion, order=2))
    expected = [solid_angle(d3[: k + 1], pole=d3[0]) for k in range(61)]
    assert result.solid_angle.values == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("order", [2, 4])
def test_order_of_the_twist_angle(order):
    """Against ∫ w·d3 of a motion whose angular velocity is known."""

    def motion(n):
        t = np.linspace(0, 2, n + 1)
        return t, Rotation.from_euler("ZYZ", np.stack([2 * t + 0.3 * np.cos(t), 1 + 0.4 * np.sin(3 * t), t**2], axis=1))

    # for ZYZ angles (φ, θ, χ) the twist rate about the body's z axis is χ' + φ' cos θ
    x, weights = np.polynomial.legendre.leggauss(60)
    x = x + 1
    exact = 4.0 + weights @ ((2 - 0.3 * np.sin(x)) * np.cos(1 + 0.4 * np.sin(3 * x)))
    errors, estimates = [], []
    for n in (80, 160, 320):
        t, R = motion(n)
        result = twist(R, t, order=order)
        errors.append(abs(float(result.twist_angle[-1]) - exact))
        estimates.append(float(result.error_estimate[-1]))
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(order, abs=0.1)
    assert all(e <= s <= 500 * e for e, s in zip(errors, estimates, strict=True))


@pytest.mark.parametrize(
    ("radius", "sigma", "n", "order", "factor"),
    [
        (0, 1e-3, 400, 2, 1),
        (0, 1e-2, 1000, 2, 1),
        (0, 1e-3, 400, 4, 1.5),
        (0.8, 1e-4, 100, 2, 1),
        (0.8, 1e-4, 100, 4, 1),
    ],
)
def test_noise_of_the_samples_turns_the_frame_by_a_random_area(radius, sigma, n, order, factor):
    """σ s/√n of a path of length s and σ² √(n/2), which grows; a standard deviation of 400 is right to 3.5 %."""
    phi = np.linspace(0, 2 * np.pi, n + 1)
    d3 = np.stack([radius * np.cos(phi), radius * np.sin(phi), np.full(n + 1, np.sqrt(1 - radius**2))], axis=1)
    noise = sigma * np.random.default_rng(3).normal(size=(400, n + 1, 3))
    noise[:, [0, -1]] = 0
    noisy = d3 + noise
    noisy /= np.linalg.norm(noisy, axis=2, keepdims=True)
    frame, true = nontwisting_frame(noisy, order=order)[:, -1], nontwisting_frame(d3, order=order)[-1]
    turned = np.arctan2(frame[:, 0] @ true[1], frame[:, 0] @ true[0])
    expected = np.hypot(sigma * 2 * np.pi * radius / np.sqrt(n), factor * sigma**2 * np.sqrt(n / 2))
    assert turned.std() == pytest.approx(expected, rel=0.12)
    assert abs(turned.mean()) < 4 * expected / 20


def test_twist_rate_is_the_derivative():
    t = np.linspace(0, 2, 2001)
    R = Rotation.from_rotvec(np.outer(np.sin(t), [0, 0, 1]))
    result = twist(R, t)
    assert result.twist_rate.values == pytest.approx(np.cos(t), abs=2e-6)
    assert result.path_length[-1] < 1e-12
    assert result.twist_angle.values == pytest.approx(np.sin(t), abs=1e-14)


@pytest.mark.parametrize(("frame", "variable"), [("body", "twist_rate"), ("space", "angular_velocity")])
def test_a_simulated_standard_body_twists_by_the_integral_of_its_rate(frame, variable):
    run = simulate(standard([3, 4, 5]), times=np.linspace(0, 3, 1201), angular_velocity=[1, 2, 3], integrator=FINE)
    rate = run[variable] if frame == "body" else run[variable].sel(axis="z")
    h = 3 / 1200
    weights = np.tile([4.0, 2.0], 600)
    integral = h / 3 * (rate.values[0] - rate.values[-1] + weights @ rate.values[1:])
    result = twist(run, axis_frame=frame)
    error = abs(float(result.twist_angle[-1]) - integral)
    assert error < result.error_estimate[-1] < 1e-7


def test_relative_twist_of_a_joint():
    t, A = smooth(1)
    _, B = smooth(2)
    expected = twist(B.inv() * A, t).twist_angle.values
    assert twist(A, t, relative_to=B).twist_angle.values == pytest.approx(expected, abs=1e-12)


T, R = smooth(5, 60)
FORMS = {
    "Rotation": lambda: (R, T),
    "matrices": lambda: (R.as_matrix(), T),
    "quaternions, flipped signs": lambda: (R.as_quat() * np.where(np.arange(60) % 3, 1, -1)[:, None], T),
    "DataFrame": lambda: (table(), None),
    "DataFrame, a column again": lambda: (pandas.concat([table(), table()[["Time (s)"]]], axis=1), None),
    "DataFrame, matrix": lambda: (matrix_table(), None),
    "DataArray": lambda: (xarray.DataArray(R.as_quat(), {"time": T, "quat": list("xyzw")}, ("time", "quat")), None),
    "Dataset": lambda: (
        xarray.Dataset({"directors": (("time", "director", "axis"), np.swapaxes(R.as_matrix(), 1, 2))}, {"time": T}),
        None,
    ),
}


def table(names=("Time (s)", "W", "X", "Y", "Z"), time=T):
    return pandas.DataFrame(dict(zip(names, [time, *np.roll(R.as_quat(), 1, axis=1).T], strict=True)))


def matrix_table():
    cells = {f"R{i + 1}{j + 1}": R.as_matrix()[:, i, j] for i in range(3) for j in range(3)}
    return pandas.DataFrame({"t": T, **cells})


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_motion(form):
    motion, time = FORMS[form]()
    result = twist(motion, time, scalar_first=False)
    expected = twist(R, T)
    for name in expected.data_vars:
        assert result[name].values == pytest.approx(expected[name].values, abs=1e-9), name
    assert result.time.values == pytest.approx(T)


def test_a_trajectory():
    run = integrate(standard([1, 2, 2.5]), t_end=1, step=0.01, angular_velocity=[1, 2, 3])
    assert np.array_equal(twist(run).twist_angle, twist(run.to_dataset()).twist_angle)


def test_units_dates_and_no_times():
    milliseconds = table(("time (ms)", "w", "x", "y", "z"), 1000 * T)
    assert twist(milliseconds).time.values == pytest.approx(T)
    dates = pandas.Timestamp("2026-01-01") + pandas.to_timedelta(T, unit="s")
    assert twist(R, dates).time.values == pytest.approx(T, abs=1e-8)
    plain = twist(R)
    assert "twist_rate" not in plain
    assert plain.time.attrs["units"] == "1"


def spoiled(change):
    """The quaternions and times of R with `change(values, time)` made to them."""
    values, time = R.as_quat(), T.copy()
    change(values, time)
    return values, time


def test_rows_that_are_not_finite_are_dropped_with_a_warning():
    def change(values, time):
        values[[7, 8]] = np.nan
        values[20] = 0
        time[30] = np.nan

    values, time = spoiled(change)
    with says(UserWarning):
        result = twist(values, time, scalar_first=False)
    assert result.sizes["time"] == 56
    assert result.attrs["samples_left_out"] == 4
    assert np.isfinite(result.twist_angle).all()
    kept = np.setdiff1d(np.arange(60), [7, 8, 20, 30])
    assert np.array_equal(result.twist_angle, twist(R[kept].as_quat(), T[kept], scalar_first=False).twist_angle)


def test_unsorted_and_duplicate_times_are_repaired_with_a_warning():
    order = np.arange(60)
    order[[10, 11]] = [11, 10]
    with pytest.warns(UserWarning, match="times are not in order, the first at row 11; rows are sorted by time"):
        result = twist(R[order], T[order])
    assert result.twist_angle.values == pytest.approx(twist(R, T).twist_angle.values)
    double = np.insert(np.arange(60), 31, 30)
    with pytest.warns(UserWarning, match="^dropped 1 row with duplicate timestamps, the first is row 31$"):
        assert twist(R[double], T[double]).sizes["time"] == 60


def test_gaps_and_wide_steps_are_warned_of():
    t = np.arange(60) / 10
    t[20:] += 1
    slow = Rotation.from_rotvec(np.outer(t, [0.1, 0.2, 0]))
    with pytest.warns(UserWarning, match=r"^1 gap longer than 5 .* the longest of 1\.1 s from row 19 to row 20"):
        twist(slow, t)
    wild = Rotation.from_rotvec(np.outer([0, 0.1, 2.0, 2.1], [1, 0, 0]))
    with says(UserWarning) as seen:
        twist(wild)
    assert len(seen) == 1
    assert seen[0].filename == __file__


REFUSED = {
    "antipodal": lambda: twist(Rotation.from_rotvec([[0, 0, 0], [0.1, 0, 0], [0.1 + np.pi, 0, 0]])),
    "quaternion order": lambda: twist(R.as_quat(), T),
    "length": lambda: twist(np.r_[R.as_quat()[:5], [[0, 0, 0, 2]]], scalar_first=False),
    "other times": lambda: twist(table(), relative_to=table(time=T + 100)),
    "other length": lambda: twist(R, relative_to=R[:5]),
    "two sets": lambda: twist(table().assign(qw=1, qx=0, qy=0, qz=0)),
    "unknown scalar": lambda: twist(table(("t", "q0", "q1", "q2", "q3"))),
}


def quietly(call):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return call()


@pytest.mark.parametrize("case", REFUSED)
def test_refused_with_the_row(case):
    call = REFUSED[case]
    with says():
        quietly(call)


def test_a_row_is_named_by_its_number_in_the_recording():
    values, time = spoiled(lambda values, time: values.__setitem__(3, np.nan))
    values[9] *= 1.5
    with pytest.raises(ValueError, match=re.escape("quaternion[9] must have the length 1, it has 1.5")):
        quietly(lambda: twist(values, time, scalar_first=False))


ROWS = st.lists(st.deferred(lambda: st.lists(VALUES, min_size=4, max_size=4)), min_size=1, max_size=8)
VALUES = st.one_of(st.floats(-1, 1), st.sampled_from([np.nan, np.inf, 0.0, 1.0, -1.0, 1e300, 1e-300]))


def fuzz(rows, times):
    """A result without NaN, or a ValueError that names a row (or says that too few are left)."""
    try:
        result = quietly(lambda: twist(np.array(rows), np.array(times[: len(rows)]), scalar_first=False))
    except ValueError as error:
        message = str(error)
    else:
        message = ""
    if message:
        assert re.search(r"row \d+|\[\d+\]|at least 2 samples", message), message
        return
    for name in result.data_vars:
        assert np.isfinite(result[name]).all() or (name == "noise_estimate" and result.time.size < 12), name


@settings(max_examples=150, deadline=None, derandomize=True)
@given(ROWS, st.lists(VALUES, min_size=8, max_size=8))
def test_fuzzed_recordings(rows, times):
    fuzz(rows, times)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.lists(st.sampled_from(range(6)), min_size=2, max_size=12), st.lists(VALUES, min_size=12, max_size=12))
def test_fuzzed_sequences_of_rotations(choice, times):
    known = np.array([[0, 0, 0, 1], [1, 0, 0, 0], [0, 0, 1, 0], [0.6, 0, 0, 0.8], [np.nan] * 4, [0.5, 0.5, 0.5, 0.5]])
    fuzz(known[choice], times)


@pytest.mark.long
@settings(max_examples=10_000, deadline=None, derandomize=True)
@given(ROWS, st.lists(VALUES, min_size=8, max_size=8))
def test_ten_thousand_fuzzed_recordings(rows, times):
    fuzz(rows, times)


TINY = [
    0.0,
    *(10.0**-k for k in (3, 8, 20, 50, 90, 100, *range(103, 110), 130, 150, 154, 158, 160, 162, 200, 300, 320)),
]
MORE = [10.0**-k for k in range(3, 321)]
OFFSETS = {
    "random": lambda n, rng: rng.standard_normal((n, 2)),
    "smooth": lambda n, rng: np.stack([np.sin(np.arange(n) / 100), np.cos(np.arange(n) / 77)], axis=1),
    "of all sizes": lambda n, rng: rng.standard_normal((n, 2)) * 10.0 ** rng.uniform(-300, 0, (n, 1)),
    "growing": lambda n, rng: rng.standard_normal((n, 2)) * np.geomspace(1e-300, 1, n)[:, None],
}


@pytest.mark.parametrize("sizes", [TINY, pytest.param(MORE, marks=pytest.mark.long)])
@pytest.mark.parametrize("offsets", OFFSETS)
@pytest.mark.parametrize("order", [2, 4])
def test_an_axis_that_moves_by_next_to_nothing(order, offsets, sizes):
    """Squares and cubes of the offsets are too small for floats; the twist is right, and nothing is NaN or warned of.

    The area that is swept is less than the square of the offset, 5 of which are the largest, at each step.
    """
    n = 2000
    t, rng = np.arange(n) / 100, np.random.default_rng(0)
    spin = np.tile([1e-14, 1.0], (n, 1))
    for size in sizes:
        q = np.concatenate([size * OFFSETS[offsets](n, rng), spin], axis=1)
        for time in (t, None):
            found = twist(Rotation.from_quat(q), time, order=order)
            for name in found.data_vars:
                assert np.isfinite(found[name]).all(), (size, name)
            assert abs(found.twist_angle.values).max() < 1e-14 + n * (10 * size) ** 2
            assert found.error_estimate.values[-1] < 2e-14 + n * (10 * size) ** 2
            assert found.noise_estimate.values[-1] <= 4 * size


def test_the_turn_between_samples_is_right_to_round_off():
    slow = Rotation.from_rotvec(np.outer(np.arange(5), [0, 0, 1e-9]))
    assert twist(slow).attrs["largest_turn_between_samples"] == pytest.approx(1e-9, rel=1e-6)
    flipped = twist(slow.as_quat() * [[1], [-1], [1], [1], [-1]], scalar_first=False)
    assert flipped.attrs["largest_turn_between_samples"] == pytest.approx(1e-9, rel=1e-6)


@pytest.mark.parametrize(("word", "axis"), [("x", [1, 0, 0]), ("z", [0, 0, 1]), ("-Y", [0, -1, 0])])
def test_an_axis_by_its_letter(word, axis):
    t, motion = smooth(0)
    assert twist(motion, t, axis=word).identical(twist(motion, t, axis=axis))


def test_rates_at_times_of_any_size_are_the_same_numbers():
    """The squares of the intervals overflow at 1e208 s; powers of two change no digit."""
    t = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 20))
    motion = Rotation.from_rotvec(np.outer(np.sin(t), [0.1, 0.2, 0.3]))
    plain = twist(motion, t).twist_rate.values
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for power in (1018, 690, -300):
            assert np.array_equal(twist(motion, t * 2.0**power).twist_rate.values, plain * 2.0**-power)
