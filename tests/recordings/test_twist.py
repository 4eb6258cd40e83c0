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
from nontwist.curves import solid_angle
from refusals import says


def smooth(seed, n=400):
    """A random smooth motion with Λ(0) ≠ I; (time, Rotation)."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 4, n)
    a, b = rng.normal(size=(2, 3, 3))
    f = np.stack([np.sin((k + 1) * 0.7 * t + k) for k in range(3)], axis=1)
    return t, Rotation.from_rotvec(f @ a) * Rotation.from_rotvec(f[::-1] @ b) * Rotation.from_rotvec([0.5, -1, 2])


def test_solid_angle_of_swing_twist():
    t, R = smooth(0)
    result = twist(R, t, axis=[0.1, -0.7, 0.4])
    assert result.twist_angle[0] == 0
    require_balance(result)


def require_balance(result):
    rest = result.swing_twist_angle - result.twist_angle - result.solid_angle
    assert (np.asarray(rest) + np.pi) % (2 * np.pi) - np.pi == pytest.approx(0, abs=1e-14)


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


@pytest.mark.parametrize(
    ("delta", "seen"), [*((x, "body") for x in (0, 1e-15, 1e-14, 1e-12, 1e-3)), (1e-8, "space"), (1e-8, "relative")]
)
def test_solid_angle_past_antipode(delta, seen):
    """Three passes on either side, against the closed form; straight through counts as on the left."""
    for side in (1, -1):
        motion, expected, distance = circles(side * delta)
        result = SEEN[seen](motion)
        gap = result.solid_angle - expected
        if side < 0 and delta < 1e-13:  # on which side nobody can tell
            gap = (gap + 2 * np.pi) % (4 * np.pi) - 2 * np.pi
        allowed = abs(result.error_estimate) + 1e-13 + 1e-14 / np.maximum(distance, 1e-15)
        assert np.all((abs(gap) <= allowed)[distance > 1e-13])
        require_balance(result)
        assert np.all((-np.pi <= result.swing_twist_angle) & (result.swing_twist_angle <= np.pi))


@pytest.mark.parametrize("meridian", [0.5, -2, np.pi, 0])
def test_solid_angle_to_antipode(meridian):
    """There along the meridian 0, back along another, with a stay at the antipode: a lune of twice their angle.

    At the antipode itself Ω and the half circle that leads back are those of the sample before.
    """
    theta = np.linspace(0, np.pi, 21)[:, None]
    stay = np.linspace([0, np.pi, 0], [meridian, np.pi, 0.7], 9)
    angles = np.concatenate([theta * [0, 1, 0], stay, [meridian, 0, 0.7] + theta[::-1] * [0, 1, 0]])
    result = twist(Rotation.from_euler("ZYZ", angles), order=2)
    assert result.solid_angle.values == pytest.approx(np.repeat([0, 2 * meridian], [31, 20]), abs=1e-13)
    require_balance(result)


@pytest.mark.parametrize("seed", [0, 3])
def test_solid_angle_so_far(seed):
    """Of random walks with wide steps, with the start as the pole; samples close to the antipode among them."""
    walk = [Rotation.from_rotvec([1, 2, 3])]
    for step in Rotation.from_rotvec(np.random.default_rng(seed).normal(size=(60, 3)) * 0.7):
        walk.append(walk[-1] * step)
    walk[30] = walk[0] * Rotation.from_rotvec([np.pi - 10.0 ** -(3 + seed), 0, 0])
    motion = Rotation.concatenate(walk)
    d3 = motion.apply([0, 0, 1])
    result = quietly(lambda: twist(motion, order=2))
    expected = [solid_angle(d3[: k + 1], pole=d3[0]) for k in range(61)]
    assert result.solid_angle.values == pytest.approx(expected, abs=1e-8)


def test_twist_rate_is_the_derivative():
    t = np.linspace(0, 2, 2001)
    result = twist(Rotation.from_rotvec(np.outer(np.sin(t), [0, 0, 1])), t)
    assert result.twist_rate.values == pytest.approx(np.cos(t), abs=2e-6)
    assert result.path_length[-1] < 1e-12
    assert result.twist_angle.values == pytest.approx(np.sin(t), abs=1e-14)
    slow = Rotation.from_rotvec(np.outer(np.arange(5), [0, 0, 1e-9])).as_quat()
    for signs in (1, [[1], [-1], [1], [1], [-1]]):
        found = twist(slow * signs, scalar_first=False).attrs["largest_turn_between_samples"]
        assert found == pytest.approx(1e-9, rel=1e-6)


def test_simulated_spatial_turn():
    """About its own axis: nontwist.validation."""
    run = simulate(standard([3, 4, 5]), times=np.linspace(0, 3, 1201), angular_velocity=[1, 2, 3], integrator="exact")
    rate, weights = run.angular_velocity.sel(axis="z").values, np.tile([4.0, 2.0], 600)
    integral = (rate[0] - rate[-1] + weights @ rate[1:]) / 1200
    result = twist(run, axis_frame="space")
    assert abs(float(result.twist_angle[-1]) - integral) < result.error_estimate[-1] < 1e-7


T, R = smooth(5, 60)
FORMS = {
    "Rotation": lambda: (R, T),
    "matrices": lambda: (R.as_matrix(), T),
    "quaternions, flipped signs": lambda: (R.as_quat() * np.where(np.arange(60) % 3, 1, -1)[:, None], T),
    "DataFrame, a column again": lambda: (pandas.concat([table(), table()[["Time (s)"]]], axis=1), None),
    "DataFrame, matrix": lambda: (matrix_table(), None),
    "DataFrame, by number": lambda: (pandas.DataFrame(R.as_quat(), columns=["q1", "q2", "q3", "q4"]), T),
    "DataArray": lambda: (xarray.DataArray(R.as_quat(), {"time": T, "quat": list("xyzw")}, ("time", "quat")), None),
    "Dataset": lambda: (
        xarray.Dataset({"directors": (("time", "director", "axis"), np.swapaxes(R.as_matrix(), 1, 2))}, {"time": T}),
        None,
    ),
}


def table(names=("Time (s)", "W", "X", "Y", "Z"), time=T):
    return pandas.DataFrame(dict(zip(names, [time, *np.roll(R.as_quat(), 1, axis=1).T], strict=True)))


def matrix_table():
    return pandas.DataFrame({"t": T} | {f"R{i + 1}{j + 1}": R.as_matrix()[:, i, j] for i in range(3) for j in range(3)})


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_motion(form):
    motion, time = FORMS[form]()
    result, expected = twist(motion, time, scalar_first=False), twist(R, T)
    for name in (*expected.data_vars, "time"):
        assert result[name].values == pytest.approx(expected[name].values, abs=1e-9), name


def test_units_and_times():
    milliseconds = table(("time (ms)", "w", "x", "y", "z"), 1000 * T)
    assert twist(milliseconds).time.values == pytest.approx(T)
    dates = pandas.Timestamp("2026-01-01") + pandas.to_timedelta(T, unit="s")
    assert twist(R, dates).time.values == pytest.approx(T, abs=1e-8)
    plain = twist(R)
    assert ("twist_rate" in plain, plain.time.attrs["units"]) == (False, "1")
    run = integrate(standard([1, 2, 2.5]), t_end=1, step=0.01, angular_velocity=[1, 2, 3])
    assert np.array_equal(twist(run).twist_angle, twist(run.to_dataset()).twist_angle)


def test_infinite_rows_are_dropped():
    values, time = R.as_quat(), T.copy()
    values[[7, 8]], values[20], time[30] = np.nan, 0, np.nan
    with says(UserWarning):
        result = twist(values, time, scalar_first=False)
    assert (result.sizes["time"], result.attrs["samples_left_out"]) == (56, 4)
    kept = np.setdiff1d(np.arange(60), [7, 8, 20, 30])
    assert np.array_equal(result.twist_angle, twist(R[kept].as_quat(), T[kept], scalar_first=False).twist_angle)
    values[9] *= 1.5  # named by its number in the recording
    with pytest.raises(ValueError, match=re.escape("quaternion[9] must have the length 1, it has 1.5")):
        quietly(lambda: twist(values, time, scalar_first=False))


def test_unsorted_and_duplicate_times():
    swapped, double = np.arange(60), np.insert(np.arange(60), 31, 30)
    swapped[[10, 11]] = [11, 10]
    for order, told in (
        (swapped, "times are not in order, the first at row 11; rows are sorted by time"),
        (double, "^dropped 1 row with duplicate timestamps, the first is row 31$"),
    ):
        with pytest.warns(UserWarning, match=told):
            result = twist(R[order], T[order])
        assert result.twist_angle.values == pytest.approx(twist(R, T).twist_angle.values)


def test_wide_steps_are_warned_of():
    wild = Rotation.from_rotvec(np.outer([0, 0.1, 2.0, 2.1], [1, 0, 0]))
    with says(UserWarning) as seen:
        twist(wild)
    assert len(seen) == 1
    assert seen[0].filename == __file__


REFUSED = {
    "antipodal": lambda: twist(Rotation.from_rotvec([[0, 0, 0], [0.1, 0, 0], [0.1 + np.pi, 0, 0]])),
    "quaternion order": lambda: twist(R.as_quat(), T),
    "length": lambda: twist(np.r_[R.as_quat()[:5], [[0, 0, 0, 2]]], scalar_first=False),
    "one attitude": lambda: twist(np.eye(3)),
    "two sets": lambda: twist(table().assign(qw=1, qx=0, qy=0, qz=0)),
    "unknown scalar": lambda: twist(table(("t", "q0", "q1", "q2", "q3"))),
}


def quietly(call):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return call()


@pytest.mark.parametrize("case", REFUSED)
def test_refused_with_the_row(case):
    with says():
        quietly(REFUSED[case])


KNOWN = [[0, 0, 0, 1], [1, 0, 0, 0], [0, 0, 1, 0], [0.6, 0, 0, 0.8], [np.nan] * 4, [0.5, 0.5, 0.5, 0.5]]
VALUES = st.one_of(st.floats(-1, 1), st.sampled_from([np.nan, np.inf, 0.0, 1.0, -1.0, 1e300, 1e-300]))
ROWS = st.one_of(
    st.lists(st.lists(VALUES, min_size=4, max_size=4), min_size=1, max_size=8),
    st.lists(st.sampled_from(KNOWN), min_size=2, max_size=12),
)
TIMES = st.lists(VALUES, min_size=12, max_size=12)


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


@pytest.mark.parametrize("count", [40, pytest.param(10_000, marks=pytest.mark.long)])
def test_fuzzed_recordings(count):
    settings(max_examples=count, deadline=None, derandomize=True)(given(ROWS, TIMES)(fuzz))()


TINY = [0.0, *(10.0**-k for k in (3, 90, 104, 107, 109, 158, 320))]
MORE = [10.0**-k for k in range(3, 321)]
OFFSETS = {
    "random": lambda n, rng: rng.standard_normal((n, 2)),
    "of all sizes": lambda n, rng: rng.standard_normal((n, 2)) * 10.0 ** rng.uniform(-300, 0, (n, 1)),
    "growing": lambda n, rng: rng.standard_normal((n, 2)) * np.geomspace(1e-300, 1, n)[:, None],
}


@pytest.mark.parametrize("sizes", [TINY, pytest.param(MORE, marks=pytest.mark.long)])
@pytest.mark.parametrize("offsets", OFFSETS)
@pytest.mark.parametrize("order", [2, 4])
def test_barely_moving_axis(order, offsets, sizes):
    """Squares and cubes of the offsets are too small for floats; the twist is right, and nothing is NaN or warned of.

    The area that is swept is less than the square of the offset, 5 of which are the largest, at each step.
    """
    n = 400
    t, rng = np.arange(n) / 100, np.random.default_rng(0)
    spin = np.tile([1e-14, 1.0], (n, 1))
    for size in sizes:
        motion = Rotation.from_quat(np.concatenate([size * OFFSETS[offsets](n, rng), spin], axis=1))
        for found in (twist(motion, t, order=order), twist(motion, order=order)):
            assert np.isfinite(found.to_array()).all(), size
            assert abs(found.twist_angle.values).max() < 1e-14 + n * (10 * size) ** 2
            assert found.error_estimate.values[-1] < 2e-14 + n * (10 * size) ** 2
            assert found.noise_estimate.values[-1] <= 4 * size


@pytest.mark.parametrize(("word", "axis"), [("x", [1, 0, 0]), ("z", [0, 0, 1]), ("-Y", [0, -1, 0])])
def test_an_axis_by_its_letter(word, axis):
    t, motion = smooth(0)
    assert twist(motion, t, axis=word).identical(twist(motion, t, axis=axis))


def test_rates_at_large_times():
    """The squares of the intervals overflow at 1e208 s; powers of two change no digit."""
    t = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 20))
    motion = Rotation.from_rotvec(np.outer(np.sin(t), [0.1, 0.2, 0.3]))
    plain = twist(motion, t).twist_rate.values
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for power in (1018, 690, -300):
            assert np.array_equal(twist(motion, t * 2.0**power).twist_rate.values, plain * 2.0**-power)


def test_twist_of_a_run():
    """10 rad between stored states: attitudes alone show 2.6 back, and the integrator has counted all."""
    run = simulate(standard([3, 4, 5]), t_end=10, step=0.01, store=50, angular_velocity=[0.01, 0, 20])
    for one in (run, run.isel(time=slice(3, 9))):
        found = twist(one)  # without a warning of wide steps
        assert found.attrs["largest_turn_between_samples"] == pytest.approx(10, rel=1e-6)
        assert found.twist_angle[-1].item() == pytest.approx(20 * np.ptp(one.time.values), rel=1e-6)
        bare = one.drop_vars("mean_twist_rate")
        with pytest.warns(
            UserWarning, match=r"steps of more than a right angle, the first from row 0 to row 1 \(573°\)"
        ):
            assert twist(bare).attrs["largest_turn_between_samples"] == pytest.approx(10, rel=1e-6)


@pytest.mark.parametrize("sign", [1, -1])
def test_twist_of_few_states(sign):
    """ψ, its rate and the frame of a run do not depend on which states are stored; Ω is τ - ψ."""
    body, how = standard([2, 3, 4]), {"t_end": 6, "order": 8, "material_angular_velocity": (0.7, 1.1, 0.9)}
    fine, run = simulate(body, step=0.005, **how), simulate(body, step=0.05, store=12, **how)
    found, sampled = twist(run, axis=[0, 0, sign]), twist(fine.drop_vars("mean_twist_rate"), axis=[0, 0, sign])
    for name in ("twist_angle", "frame"):
        assert found[name].values == pytest.approx(sampled[name].values[::120], abs=1e-8), name
    counted = sign * 0.005 * np.append(0, fine.mean_twist_rate.values.cumsum())[::120]
    assert found.twist_angle.values == pytest.approx(counted, abs=1e-12)
    assert np.array_equal(found.twist_rate, sign * run.twist_rate)
    assert not found[["error_estimate", "noise_estimate"]].to_array().any()
    require_balance(found)
    plain = twist(integrate(body, step=0.05, store=12, **how), axis=[0, 0, sign])
    assert plain.twist_angle.values == pytest.approx(counted, abs=1e-12)
    halves = fine.isel(time=slice(None, None, 2), midtime=slice(None, None, 2))  # means that are not of these intervals
    assert twist(halves, axis=[0, 0, sign]).twist_angle.values[-1] == pytest.approx(counted[-1], abs=1e-5)


def swaying(t):
    return Rotation.from_euler("ZYX", np.stack([t, 0.5 * np.sin(1.1 * t), 0.8 * np.sin(0.9 * t)], axis=1))


@pytest.mark.parametrize(("change", "rows", "told"), [("z", slice(500, None), "1 jump"), ("x", [500], "2 jumps")])
def test_jump_of_the_attitude(change, rows, told):
    """A heading that is reset, and a wild sample: 15° between steps of 1°."""
    t = np.arange(0, 20, 0.02)
    q = swaying(t).as_quat()
    twist(swaying(t), t)
    q[rows] = (Rotation.from_euler(change, 15, degrees=True) * swaying(t)[rows]).as_quat()
    with pytest.warns(
        UserWarning, match=rf"^{told} of the attitude, the largest of 1\d(\.\d)?° from row \d+ to row 50"
    ) as found:
        wrong = twist(q, t, scalar_first=False)
    assert len(found) == 1
    assert wrong.attrs["largest_turn_between_samples"] > np.radians(14)


def test_no_jump_in_held_samples():
    t = np.arange(0, 3, 0.02)
    twist(Rotation.from_euler("z", np.repeat(t[::3], 3)[:, None]), t)
    twist(Rotation.from_euler("z", np.where(t < 1, 0, 5 * (t - 1))[:, None]), t)  # it starts to move


@pytest.mark.filterwarnings("ignore:1 gap longer")
def test_turns_lost_in_a_gap():
    """The body turns by a whole turn in 6 s, as its speed before and behind shows."""
    t = np.arange(0, 20, 0.02)
    t = t[(t < 8) | (t >= 14)]
    with pytest.warns(
        UserWarning, match=r"\(3\d\d°\): the motion in between is a guess, and whole turns may be missing$"
    ):
        found = twist(Rotation.from_euler("ZX", np.stack([t, 0.2 * np.sin(t)], axis=1)), t)
    assert found.attrs["largest_turn_between_samples"] == pytest.approx(6, rel=0.05)
