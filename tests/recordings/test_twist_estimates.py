"""Estimates of what sampling and noise do to a twist, against generated recordings whose twist is known."""

import math

import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from many_digits import exact, mp_cross, mp_dot
from nontwist import twist
from nontwist.curves import frame_error_estimate, nontwisting_frame, solid_angle
from nontwist.recordings.twist_noise import noise_level, noise_of_rounding, rounding


def axis_path(rng):
    """d3(t) of two rotations in turn, each about a vector that is a sum of three harmonics."""
    a, b = rng.normal(size=(2, 3, 3))
    phase, rate, start = rng.uniform(0, 2 * np.pi, (2, 3)), np.array([0.7, 1.4, 2.1]), Rotation.random(rng=rng)

    def d3(t):
        one, other = (
            Rotation.from_rotvec(np.sin(np.multiply.outer(t, rate) + p) @ v) for p, v in zip(phase, (a, b), strict=True)
        )
        return one.apply(other.apply(start.apply([0, 0, 1])))

    return d3


KINDS = {
    "smooth": ((1, 15), lambda rng, n: np.ones(n)),
    "jittered": ((1, 15), lambda rng, n: rng.uniform(0.3, 1.7, n)),
    "random": ((1, 15), lambda rng, n: rng.exponential(size=n) + 1e-3),
    "sparse": ((7, 20), lambda rng, n: np.ones(n)),
    "sparse, jittered": ((7, 20), lambda rng, n: rng.uniform(0.3, 1.7, n)),
}


def recording(kind, seed):
    """A path of the axis, and times such that it travels so many degrees from sample to sample in the mean."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    (least, most), steps = KINDS[kind]
    d3, end = axis_path(rng), rng.uniform(6, 18)
    length = np.linalg.norm(np.diff(d3(np.linspace(0, end, 2000)), axis=0), axis=1).sum()
    n = int(length / np.radians(least * (most / least) ** rng.uniform())) + 8
    return d3, np.append(0, end * np.cumsum(steps := steps(rng, n)) / steps.sum())


def exact_frames(d3, t, parts=16):
    fine = np.append((t[:-1, None] + np.diff(t)[:, None] * np.arange(parts) / parts).ravel(), t[-1])
    return nontwisting_frame(d3(fine))[::parts]


def angle(frames, true):
    return np.arctan2(np.sum(frames[:, 0] * true[:, 1], axis=1), np.sum(frames[:, 0] * true[:, 0], axis=1))


def ratio(d3, t, order, frames):
    """The estimate over the largest error along a recording."""
    error = abs(angle(nontwisting_frame(d3(t), frames[0, 0], order=order), frames)).max()
    return frame_error_estimate(d3(t), order=order)[-1] / error


@pytest.mark.filterwarnings("ignore:.*more than a right angle:UserWarning")
@pytest.mark.parametrize(("kind", "count"), [
    ("smooth", 20), ("random", 20), ("sparse, jittered", 20),
    *(pytest.param(kind, 1000, marks=pytest.mark.long) for kind in KINDS),
])  # fmt: skip
def test_estimate_bounds_the_error(kind, count):
    found = []
    for seed in range(count):
        d3, t = recording(kind, seed)
        frames = exact_frames(d3, t)
        found.append([ratio(d3, t, order, frames) for order in (2, 4)])
    found = np.array(found)
    assert (np.mean((found >= 1) & (found <= 5), axis=0) >= 0.95).all()
    assert np.median(found, axis=0) == pytest.approx([1, 2], abs=0.6)


def test_limit_of_the_estimate():
    """Twice it at order 4, and once at order 2: the leading term is that of the error, also at uneven steps."""
    d3 = axis_path(np.random.default_rng(5))
    for steps in (np.ones(4000), np.random.default_rng(1).uniform(0.2, 1.8, 4000), np.resize([1.0, 7.0], 4000)):
        t = np.append(0, 5 * np.cumsum(steps) / steps.sum())
        frames = exact_frames(d3, t, 4)
        assert [ratio(d3, t, order, frames) for order in (2, 4)] == pytest.approx([1, 2], rel=0.06)


@pytest.mark.filterwarnings("ignore:.*right angle:UserWarning")
@pytest.mark.parametrize("sigma", [1e-4, 1e-2])
def test_level_of_noise(sigma):
    found = []
    for seed in range(10):
        d3, t = recording("smooth", seed)
        u = d3(t) + sigma * np.random.default_rng(seed).normal(size=(len(t), 3))
        u /= np.linalg.norm(u, axis=1)[:, None]
        found.append([noise_level(u, time) / sigma for time in (t, None)])
    assert np.median(found, axis=0) == pytest.approx(1, abs=0.1)


def test_level_of_many_even_samples():
    t, levels = np.linspace(0, 6, 20_000), []
    u = axis_path(np.random.default_rng(4))(t) + 1e-3 * np.random.default_rng(5).normal(size=(len(t), 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    for m in (2, 4, 6, 8):
        rest, normal = np.diff(u, m, axis=0), np.cross(u[m // 2 : m // 2 - m], u[m:] - u[:-m])
        across = np.sum(rest * normal, axis=1) / np.linalg.norm(normal, axis=1)
        levels.append(np.sqrt(np.mean(across**2) / math.comb(2 * m, m)))
    nearest = next(level for level in levels if level <= 1.2 * min(levels))
    assert noise_level(u, t) == pytest.approx(nearest, rel=1e-9)


def test_smooth_recording():
    d3, t = axis_path(np.random.default_rng(2)), np.linspace(0, 6, 2000)
    uneven = np.sort(np.random.default_rng(3).uniform(0, 6, 2000))
    for given, times, most in ((t, t, 1e-12), (uneven, uneven, 1e-8), (t, t + 1e-3 * np.sin(t), 1e-9)):
        assert noise_level(d3(given), times) < most
    assert np.isnan(noise_level(d3(t[:11]), t[:11]))
    assert noise_level(np.broadcast_to([0.0, 0, 1], (50, 3)), np.arange(50.0)) == 0


def test_noise_with_uneven_steps():
    """Products of eight of their quotients are too small for floats; nothing is NaN or warned of."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        xy = np.geomspace(1e-300, 1e-3, 40)[:, None] * rng.standard_normal((40, 2))
        found = noise_level(np.concatenate([xy, np.ones((40, 1))], axis=1), None)
        assert 0 <= found < 1e-3


@pytest.mark.filterwarnings("ignore:.*right angle:UserWarning")
@pytest.mark.parametrize("count", [20, pytest.param(400, marks=pytest.mark.long)])
@pytest.mark.parametrize(("sigma", "order", "rate"), [(1e-3, 4, 1.0), (2e-2, 2, 0.0), (2e-2, 4, 0.0)])
def test_effect_of_noise(sigma, order, rate, count):
    """The deviation from the twist of the clean recording, in units of the estimate: 1 in the mean square.

    With the rate 0 the axis rests, and all that is left is σ²√(n/2) and the ends.
    """
    d3 = axis_path(np.random.default_rng(11))
    t = np.linspace(0, 8, 1500)
    clean = Rotation.from_matrix(nontwisting_frame(d3(rate * t)).transpose(0, 2, 1))
    true, found = twist(clean, t, order=order).twist_angle.values, []
    for seed in range(count):
        errors = Rotation.from_rotvec(sigma * np.random.default_rng(seed).normal(size=(1500, 3)))
        noisy = twist(errors * clean, t, order=order)
        assert noisy.attrs["noise_level"] == pytest.approx(sigma, rel=0.15)
        found.append((noisy.twist_angle.values - true)[[300, 1499]] / noisy.noise_estimate.values[[300, 1499]])
    rms = np.sqrt(np.mean(np.square(found), axis=0))
    assert rms == pytest.approx(1, abs=0.35 if count < 100 else 0.15)


def exact_fan(polygon, pole):
    """Sum of the triangles from the pole to the sides, at 50 digits."""
    with mpmath.workdps(50):
        p, *points = (exact(v) / mpmath.norm(exact(v)) for v in (pole, *polygon))
        pairs = zip(points, points[1:] + points[:1], strict=True)
        parts = [(mp_dot(p, mp_cross(a, b)), 1 + mp_dot(p, a) + mp_dot(p, b) + mp_dot(a, b)) for a, b in pairs]
        return float(sum(2 * mpmath.atan2(*one) for one in parts))


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("delta", [1e-3, 1e-9, 1e-12])
def test_solid_angle_beside_the_antipode(delta, side):
    rng = np.random.default_rng(4)
    for _ in range(3):
        turn = Rotation.random(rng=rng)
        ends = np.array([[1.0, side * delta, -1e-1], [-1.0, side * delta, -0.3], [0.1, 0.5, 1]])  # a side beside -z
        vertex = np.array([[side * delta, 0.4 * delta, -1], [0.5, 0.3, 0.4], [0.2, -0.6, 0.3]])
        for polygon in (ends, vertex):
            polygon = turn.apply(polygon / np.linalg.norm(polygon, axis=1)[:, None])
            pole = turn.apply([0, 0, 1.0])
            assert solid_angle(polygon, pole=pole) == pytest.approx(exact_fan(polygon, pole), abs=1e-15 / delta + 1e-14)


@pytest.mark.parametrize(
    ("tilt", "rate", "unit", "inverse"), [(0.05, 0.1, 0.01, False), (1.2, 0.0, 0.01, True), (0.3, 1.0, 2**-7, False)]
)
def test_rounding_is_noise_that_recurs(tilt, rate, unit, inverse):
    """Of a spinning top: rounded attitudes are off alike in every turn, and their corners are not resolved."""
    t = np.arange(0, 100, 0.01)
    motion = Rotation.from_euler("ZXZ", np.stack([rate * t, np.full_like(t, tilt), 3 * t], axis=1))
    motion = motion.inv() if inverse else motion
    found = twist(np.round(motion.as_quat() / unit) * unit, t, scalar_first=False)
    error = abs(found.twist_angle - twist(motion, t).twist_angle).values
    assert found.noise_level == pytest.approx(unit / np.sqrt(3), rel=0.1)
    assert np.all(error[1:] < 4 * found.noise_estimate[1:])
    assert error.max() > found.noise_estimate.max() / 30
    assert found.error_estimate[-1] < 0.06


@pytest.mark.parametrize(("unit", "is_one"), [(0.7e-6, False), (1.5e-6, True), (0.09, True), (0.15, False)])
def test_units_of_rounding(unit, is_one):
    motion = Rotation.random(9000, rng=1)
    for values, squares in ((motion.as_quat(), 3), (motion.as_matrix(), 24)):
        given = np.round(values / unit) * unit
        assert rounding(given) == pytest.approx(is_one * unit / math.sqrt(squares), rel=1e-6)
        missing = given.copy()
        missing[7] = np.inf
        assert rounding(missing) == pytest.approx(rounding(given), rel=1e-6)  # without a warning of NumPy
        given[10] += 1.5e-3 * unit
        assert rounding(values) == rounding(given) == rounding(given[:11]) == 0
    still = noise_of_rounding(np.tile([0.0, 0, 1], (9, 1)), motion.as_quat()[:9], 0.1)
    assert still == pytest.approx([0, *[math.sqrt(0.02)] * 8])  # of the ends alone
    path, same = np.arange(9)[:, None] * [0.1, 0, 0] + [0, 0, 1], np.tile([0.6, 0, 0, 0.8], (9, 1))
    assert noise_of_rounding(path, same, 0.1)[-1] == pytest.approx(0.1 * math.sqrt(0.7**2 + 2))  # errors that recur
