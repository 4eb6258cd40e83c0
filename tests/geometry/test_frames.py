"""Non-twisting frames: measured orders, closed forms, invariants, and what wrong or awkward input meets."""

from functools import partial

import mpmath
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.spatial.transform import Rotation

from many_digits import exact, mp_cross, mp_dot
from nontwist.exact import polygon_turn
from nontwist.geometry.curve_frames import frame_along, frame_of_curve
from nontwist.geometry.frames import closed_frame, frame_error_estimate, holonomy, nontwisting_frame, solid_angle
from nontwist.validation.frame_checks import path as angles
from nontwist.validation.frame_checks import transported
from nontwist.validation.frame_checks import triad_at as triad
from refusals import refused_as

AXES = np.eye(3)
assert_allclose = partial(np.testing.assert_allclose, rtol=0)


def sphere(theta, phi):
    return triad(*np.broadcast_arrays(theta, phi))[2]


def latitude(theta, n, turns=1):
    return sphere(theta, 2 * np.pi * turns * np.arange(n) / n)


def path(t):
    return sphere(*angles(t))


EVEN = np.linspace(0, 3, 161)


def start(d3):
    d1 = np.cross(d3, [0.3, 0.5, 0.8])
    return d1 / np.linalg.norm(d1)


def roll(frames, d1):
    """Angle about d3 from `d1` to the frames."""
    side = np.cross(frames[..., 2, :], d1)
    return np.arctan2(np.sum(frames[..., 0, :] * side, -1), np.sum(frames[..., 0, :] * d1, -1))


def modulo(angle, period=2 * np.pi):
    return np.abs((np.asarray(angle) + period / 2) % period - period / 2).max()


def slope(counts, errors):
    return -np.polyfit(np.log(counts), np.log(errors), 1)[0]


def jittered(n):
    return uneven(np.random.default_rng(n).uniform(0.3, 1.7, n))


def uneven(steps):
    return np.append(0, 3 * np.cumsum(steps) / np.sum(steps))


# A long step between stays of a thousandth of it, each of several samples, has no curvature to go by.
THOUSANDFOLD = [1, 1100], [1, 30, 900], [2, 1500, 2, 2.5]
TIMES = {f"steps {steps}": lambda n, steps=steps: uneven(np.resize(steps, n)) for steps in THOUSANDFOLD}
TIMES |= {"jittered": jittered, "through a stop of d3": lambda n: (np.linspace(0.0137, 3, n + 1) - 1.5) ** 3 / 1.5}


@pytest.mark.parametrize("name", TIMES)
def test_order_four(name):
    """On even samples and steps 1:2:4, and of order 2: nontwist.validation."""
    counts, errors = (160, 320, 640, 1280), []
    for t in map(TIMES[name], counts):
        exact = transported(t)
        errors.append(np.abs(roll(nontwisting_frame(path(t), exact[0]), exact)).max())
    assert slope(counts, errors) == pytest.approx(4, abs=0.1)
    assert name != "jittered" or errors[-1] < 5e-10


@pytest.mark.parametrize("theta", [0.3, 1.9])
def test_latitude_circle(theta):
    """The polygon encloses what n triangles with the pole do; backwards, three times, about other poles as well."""
    n = 2001
    polygon = 2 * np.pi - 2 * n * np.arctan(np.cos(theta) * np.tan(np.pi / n))
    d3, three = latitude(theta, n), latitude(theta, 3 * n, turns=3)
    assert modulo(holonomy(d3[::-1]) + polygon) < 1e-12
    assert modulo(solid_angle(d3) - polygon, 4 * np.pi) < 1e-12
    assert (abs(holonomy(d3)) < np.pi, abs(solid_angle(d3)) < 2 * np.pi) == (True, True)
    assert solid_angle(d3, pole=(0, 0, 5)) == pytest.approx(polygon, abs=1e-12)
    found = [solid_angle(three, pole=(0, 0, z)) for z in (1, -1)] + [solid_angle(three[::-1], pole=(0, 0, 1))]
    assert found == pytest.approx([3 * polygon, 3 * polygon - 12 * np.pi, -3 * polygon], abs=1e-11)


def octant(n):
    t = np.arange(n)[:, None] / n * np.pi / 2
    sides = [np.cos(t) * AXES[i] + np.sin(t) * AXES[(i + 1) % 3] for i in range(3)]
    return np.concatenate([*sides, AXES[:1]])


def wavy(n):
    """A closed path."""
    t = 2 * np.pi * np.arange(n) / n
    return sphere(1 + 0.4 * np.sin(3 * t), t + 0.3 * np.cos(t))


def test_order_of_closed_frames():
    counts, exact = (100, 200, 400), closed_frame(wavy(20_000))[1]
    for order, tolerance in ((2, 0.02), (4, 0.1)):
        errors = [abs(closed_frame(wavy(n), order=order)[1] - exact) for n in counts]
        assert slope(counts, errors) == pytest.approx(order, abs=tolerance)
    errors = [abs(closed_frame(octant(n))[1] - np.pi / 2) for n in counts]
    assert slope(counts, errors) == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("size", [1e-7, 1e-4, 1e-2, 1.0])
def test_triangle_areas_against_many_digits(size):
    """L'Huilier's sum of angles at 60 digits: another formula, another arithmetic."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        points = rng.normal(size=3) + size * rng.normal(size=(3, 3))
        points /= np.linalg.norm(points, axis=1)[:, None]
        with mpmath.workdps(60):
            a, b, c = (exact(v) / mpmath.norm(exact(v)) for v in points)
            sides = [mpmath.acos(mp_dot(u, v)) for u, v in ((b, c), (c, a), (a, b))]
            s = sum(sides) / 2
            product = mpmath.tan(s / 2) * mpmath.fprod(mpmath.tan((s - side) / 2) for side in sides)
            expected = float(4 * mpmath.atan(mpmath.sqrt(product)) * mpmath.sign(mp_dot(a, mp_cross(b, c))))
        # Points known to an ulp have an area known to their distance times an ulp.
        reach = np.abs(points - points[0]).max()
        with np.errstate(all="raise"):
            assert solid_angle(points) == pytest.approx(expected, abs=1e-15 * reach + 1e-13 * reach**2)


@pytest.mark.filterwarnings("ignore:.*right angle:UserWarning")
def test_polygon_invariants():
    for seed in range(14):
        n, turn = 3 + seed % 7, Rotation.random(rng=seed).as_matrix()
        d3 = np.random.default_rng(seed).normal(size=(n, 3))
        d3 /= np.linalg.norm(d3, axis=1)[:, None]
        area, halves = solid_angle(d3), solid_angle(d3[:3]) + solid_angle(d3[[0, *range(2, n)]])
        same = [*map(solid_angle, (np.roll(d3, 2, axis=0), d3 @ turn.T, np.repeat(d3, 2, axis=0))), halves]
        same += [-solid_angle(d3[::-1]), solid_angle(d3, pole=turn[0])]
        assert modulo(np.array(same) - area, 4 * np.pi) < 1e-12
        assert modulo(np.array([holonomy(d3), polygon_turn(d3)]) - area) < 1e-13
        assert modulo(closed_frame(d3, order=2)[1] - area) < 1e-11


def test_vertices_at_the_poles():
    d3 = np.array([[0, 0, 1.0], [1, 0, 0], [0, 0, -1], [0, 1, 0]])
    assert [solid_angle(d3), holonomy(d3)] == pytest.approx([np.pi, np.pi], abs=1e-14)
    for n in range(3, 30):
        circle = latitude(np.pi / 2, n)
        for equator in (circle, circle[::-1], circle[:, [1, 2, 0]]):
            assert -2 * np.pi < solid_angle(equator) <= 2 * np.pi
            assert [abs(solid_angle(equator)), holonomy(equator)] == pytest.approx([2 * np.pi, 0], abs=1e-13)
    assert solid_angle(AXES[:2]) == solid_angle(AXES[:1]) == 0.0


@pytest.mark.parametrize("order", [2, 4])
def test_closed_frames_close(order):
    once = wavy(400)
    d1, angle = start(once[0]), closed_frame(once, order=order)[1]
    for d3 in (once, np.concatenate([once, once[:1]])):
        (frames, same), open_frames = (of(d3, d1, order=order) for of in (closed_frame, nontwisting_frame))
        assert same == pytest.approx(angle, abs=1e-13)
        orthonormal(frames)
        # The twist against the open frame is even along the path: minus the holonomy at the length of the whole.
        twisted = np.unwrap(roll(frames, open_frames[:, 0]))
        length = np.linalg.norm(np.roll(once, -1, axis=0) - once, axis=1)
        expected = -angle * np.append(0, np.cumsum(length))[: len(frames)] / length.sum()
        assert_allclose(twisted, expected, atol=1e-5 if order == 4 else 1e-12)
    assert_allclose(frames[-1], frames[0], atol=1e-13)
    for shift in (1, 2, 70):
        assert closed_frame(np.roll(once, shift, axis=0), order=order)[1] == pytest.approx(angle, abs=1e-13)


def orthonormal(frames):
    assert_allclose(frames @ frames.mT, np.broadcast_to(AXES, frames.shape), atol=1e-14)


@pytest.mark.parametrize("order", [2, 4])
def test_geometry_not_time_counts(order):
    """Turning space turns the frame, turning the start turns every frame by as much, going back undoes the way."""
    d3, d1 = path(jittered(160)), start(path(0.0))
    frames = nontwisting_frame(d3, d1, order=order)
    turn = Rotation.from_rotvec([0.7, 1.1, -0.4]).as_matrix()
    assert_allclose(nontwisting_frame(d3 @ turn.T, turn @ d1, order=order), frames @ turn.T, atol=1e-13)
    other = nontwisting_frame(d3, np.cos(0.9) * frames[0, 0] + np.sin(0.9) * frames[0, 1], order=order)
    assert_allclose(roll(other, frames[:, 0]), 0.9, atol=1e-13)
    back = nontwisting_frame(d3[::-1], frames[-1, 0], order=order)
    assert_allclose(back[::-1], frames, atol=1e-13)
    almost = d3 * np.where(np.arange(161) == 7, 1 + 1e-10, 1)[:, None]
    kept = almost.copy()
    assert_allclose(nontwisting_frame(almost, d1, order=order), frames, atol=1e-14)
    for of in (closed_frame, solid_angle, frame_error_estimate):
        of(almost)
    assert_array_equal(almost, kept)
    strided = np.asfortranarray(np.repeat(d3, 2, axis=0))[::2]
    assert_array_equal(nontwisting_frame(strided, d1, order=order), frames)


def test_leading_axes():
    paths = [path(jittered(n)) for n in (60, 60, 60)] + [latitude(a, 61) for a in (0.4, 1.2, 2.0)]
    d3, d1 = np.reshape(paths, (2, 3, 61, 3)), np.reshape([start(one[0]) for one in paths], (2, 3, 3))
    functions = nontwisting_frame, lambda *x: closed_frame(*x)[0], lambda *x: closed_frame(*x)[1]
    functions += lambda d3, _: holonomy(d3), lambda d3, _: frame_error_estimate(d3)
    for of, shape in zip(functions, [(61, 3, 3), (61, 3, 3), (), (), (61,)], strict=True):
        found = of(d3, d1)
        assert found.shape == (2, 3, *shape)
        assert_array_equal(found.reshape(6, *shape), [of(*one) for one in zip(paths, d1.reshape(6, 3), strict=True)])
    assert solid_angle(d3, pole=AXES[2]).shape == (2, 3)


def test_the_first_d1():
    assert_array_equal(nontwisting_frame([[0, 0, 1.0]]), [np.eye(3)])
    assert_array_equal(nontwisting_frame([[1.0, 0, 0]])[0], AXES[[1, 2, 0]])
    d3, wish = path(EVEN[:10]), np.array([3.0, 4.0, 5.0])  # not orthogonal, not unit: projected
    frames, across = nontwisting_frame(d3, wish), wish - (d3[0] @ wish) * d3[0]
    assert_allclose(frames[0, 0], across / np.linalg.norm(across), atol=1e-15)
    assert_allclose(nontwisting_frame(d3, 1e-300 * wish), frames, atol=1e-14)


@pytest.mark.parametrize("noise", [0.0, 1e-15, 1e-12, 1e-8])
def test_order_four_with_repeated_samples(noise):
    """And near repetitions change no other frame."""
    rng, plain, d1 = np.random.default_rng(3), path(EVEN), start(path(0.0))
    best = nontwisting_frame(plain, d1)
    for times in (np.full(161, 2), rng.integers(1, 4, 161), np.where(np.arange(161) == 80, 500, 1)):
        d3 = np.repeat(plain, times, axis=0)
        d3 = d3 + noise * rng.normal(size=d3.shape)
        d3 /= np.linalg.norm(d3, axis=1)[:, None]
        frames = nontwisting_frame(d3, d1)
        assert np.abs(roll(frames[np.cumsum(times) - 1], best[:, 0])).max() < 1e-14 + 10 * noise
        if times.max() == 2:
            assert_allclose(frames[::2], nontwisting_frame(d3[::2], d1), atol=2e-14)


def test_coning_at_rest():
    """A hundred circles of 1e-6 rad turn the frame by 1e-10 pi in all, whatever came before."""
    loops, arrival = sphere(1e-6, 2 * np.pi * np.arange(4000) / 40), sphere(np.linspace(0.5, 0.01, 50), 0.0)
    way, whole = np.concatenate([arrival, loops[:1]]), np.concatenate([arrival, loops, loops[:1]])
    stay = nontwisting_frame(whole, AXES[1])
    turned = roll(stay[-1], nontwisting_frame(way, AXES[1])[-1, 0])
    # A path as long as a thousandth of the chord before it is taken for a stay: it encloses less than a circle would.
    lost = (1e-3 * 0.01) ** 2 / (4 * np.pi)
    assert turned == pytest.approx(100 * np.pi * 1e-12, abs=lost)
    assert_allclose(nontwisting_frame(whole[::-1], stay[-1, 0])[::-1], stay, atol=lost)


def test_error_estimate_at_corners():
    for n in (30, 31):
        d3 = octant(n)
        error = np.abs(roll(nontwisting_frame(d3), nontwisting_frame(d3, order=2)[:, 0])).max()
        assert 0.5 * error < frame_error_estimate(d3)[-1] < 5 * error
    t = np.linspace(0, 46, 100_001)
    circle = np.stack([0.6 * np.cos(t), np.sin(t), 0.8 * np.cos(t)], -1)
    tangent = np.stack([-0.6 * np.sin(t), np.cos(t), -0.8 * np.sin(t)], -1)
    error, estimate = np.abs(roll(nontwisting_frame(circle, tangent[0]), tangent)), frame_error_estimate(circle)
    assert np.all(error <= estimate)
    assert estimate[-1] < 3e-12


def test_frame_along_a_function():
    times = np.array([0.0, 0.1, 0.5, 0.500001, 2.0, 3.0])
    fine = np.union1d(times, np.linspace(0, 3, 61))
    exact = transported(fine)[np.searchsorted(fine, times)]
    for rtol, most in ((1e-6, 400), (1e-12, 1400)):
        calls = []
        frames = frame_along(lambda t: calls.append(t) or path(t), times, exact[0], rtol=rtol)  # noqa: B023
        assert len(calls) < most
        assert (min(calls), max(calls)) == (0.0, 3.0)
        assert np.abs(roll(frames, exact)).max() < max(rtol, 5e-13)
    assert_allclose(frames[:, 2], path(times), atol=2e-16)
    long, short = frame_along(lambda t: (1 + 9e-10) * path(t), [2.0]), nontwisting_frame([(1 - 9e-10) * path(2.0)])
    assert_allclose(long, short, atol=3e-16)
    for turns in (8, 32):  # many turns between two output times, as many as samples at the start
        ends = frame_along(lambda t: sphere(0.7, 2 * np.pi * turns * t), [0.0, 1.0], rtol=1e-6)  # noqa: B023
        assert modulo(roll(ends[1], ends[0, 0]) - 2 * np.pi * turns * (1 - np.cos(0.7))) < 1e-6


def test_tolerance_at_a_kink():
    """Two latitude arcs joined by a corner at an awkward time."""
    corner = 1 / np.pi

    def kinked(t):
        return triad(*map(np.array, (0.9, t) if t < corner else (0.9 + t - corner, 2 * corner - t)))

    # Against (e_theta, e_phi) the frame turns by minus the integral of cos(theta) phi'.
    turned = -np.cos(0.9) * corner + (np.sin(0.9 + 1 - corner) - np.sin(0.9))
    south, east, _ = kinked(1.0)
    for rtol in (1e-6, 1e-10):
        frames = frame_along(lambda t: kinked(t)[2], [0.0, 1.0], kinked(0.0)[0], rtol=rtol)
        assert np.abs(roll(frames[1], np.cos(turned) * south + np.sin(turned) * east)) < rtol
    calls = []
    with pytest.raises(RuntimeError, match=r"cannot meet rtol = 1\.0e-200"):
        frame_along(lambda t: calls.append(t) or path(t), [0.0, 1.0], rtol=1e-200)
    assert len(calls) < 1000
    with pytest.raises(ValueError, match=r"function\(0\.5\) must be a unit vector, got \[0\.0, 0\.0, 1\.5\]"):
        frame_along(lambda t: [0, 0, 1 if t < 0.5 else 1 + t], [0, 0.25, 0.5, 1.0])


def helix(t):
    points = np.stack([np.cos(t), np.sin(t), 0.5 * t], -1)
    return points, np.stack([-np.sin(t), np.cos(t), 0.5 + 0 * t], -1)


@pytest.mark.parametrize("k", [0, 1])
def test_curve_without_numbers(k):
    given = [np.array([[0.0, 0, 0], [1, 0, 0], [2, 1, 0]]), np.array([[1.0, 0, 0], [1, 1, 0], [1, 1, 1]])]
    given[k][1, 2] = np.nan
    with pytest.raises(ValueError, match=rf"^{('points', 'tangents')[k]}\[1, 2\]"):
        frame_of_curve(*given)


def test_awkward_points():
    points, tangents = helix(np.linspace(0, 3, 41))
    frames = frame_of_curve(points, 7 * tangents)
    twice = frame_of_curve(np.repeat(points, 2, axis=0), np.repeat(tangents, 2, axis=0))
    assert_allclose(twice[::2], frames, atol=1e-14)
    assert_allclose(frame_of_curve(1e-6 * points + 3, tangents), frames, atol=1e-9)
    orthonormal(frames)
    assert_allclose(frame_of_curve(points, 1e-200 * tangents), frames, atol=1e-14)
    line = np.outer(np.linspace(0, 3, 41), [1.0, 2.0, 2.0])
    straight = frame_of_curve(line, np.add(line, [1.0, 2.0, 2.0]))
    assert_allclose(straight, np.broadcast_to(straight[0], straight.shape), atol=1e-15)
    assert_array_equal(frame_of_curve(points[None], 7 * tangents[None])[0], frames)


@pytest.mark.parametrize("size", [1e-300, 1e-162, 1e155, 1e307])
def test_unit_of_length(size):
    """Squares of these lengths are no floats."""
    points, tangents = helix(np.arange(40) * np.pi / 20)
    assert_allclose(frame_of_curve(size * points, tangents), frame_of_curve(points, tangents), atol=1e-14)
    d3, oval = tangents / np.linalg.norm(tangents, axis=1)[:, None], points * [2, 1, 0]  # not uniform
    (small, _), (plain, _) = (closed_frame(d3, points=one) for one in (size * oval, oval))
    assert_allclose(small, plain, atol=1e-14)


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("size", [0.0, 1e-104, 1e-108, 1e-158, 1e-300])
def test_barely_moving_directors(size, order):
    d3 = np.insert(size * np.random.default_rng(0).standard_normal((100, 2)), 2, 1, axis=1)
    closed, angle = closed_frame(d3, order=order)
    for frames in (nontwisting_frame(d3, order=order), closed):
        assert_allclose(frames, np.broadcast_to(AXES, frames.shape), atol=1e-15)
    assert [angle, holonomy(d3), solid_angle(d3)] == pytest.approx([0, 0, 0], abs=1e-15 if size else 0)
    assert frame_error_estimate(d3, order=order).max() < 1e-14


def changed(place, value):
    d3 = path(EVEN[:21])
    d3[place] = value
    return d3


D3, HALF = path(EVEN[:21]), sphere(np.linspace(0, np.pi, 21), 0.0)
LONG, BACK = changed(7, D3[7] * (1 + 1e-8)), changed(7, -D3[6])
test_refusals = refused_as(
    {
        "d1 along d3": lambda: nontwisting_frame(D3, -2 * D3[0]),
        "length of a member": lambda: nontwisting_frame(np.stack([D3, LONG])),
        "antipodal": lambda: nontwisting_frame(BACK, order=2),
        "antipodal, holonomy": lambda: holonomy(BACK),
        "antipodal at the end": lambda: closed_frame(HALF),
        "antipodal at the end, area": lambda: solid_angle(HALF),
        "pole": lambda: solid_angle([(0, 0, 1), (1, 0, 0), (0, 0, -1), (0, 1, 0)], pole=(0, 0, 1)),
        "function's length": lambda: frame_along(lambda t: 2 * AXES[0], [0.0, 1.0]),
        "jump": lambda: frame_along(lambda t: path(t if t < 1 / 3 else t + 0.1), [0.0, 1.0]),
        "no tangent": lambda: frame_of_curve(D3, np.where(np.arange(21)[:, None] == 5, 0, D3)),
        "chord": lambda: frame_of_curve([[0, 0, 0], [1.0, 0, 0]], [[1.0, 0, 0], [-1.0, 0, 0]]),
    },
    kind=(ValueError, RuntimeError),
)


@pytest.mark.parametrize("order", [2, 4])
def test_directors_that_are_nearly_wrong(order):
    nontwisting_frame(HALF, order=order)
    nontwisting_frame(AXES)  # just a right angle: no warning
    with pytest.warns(UserWarning, match=r"d3\[2\] is more than a right angle") as caught:
        nontwisting_frame(sphere(np.array([0.0, 0.5, 0.5 + 1.58]), 0.0))
    assert caught[0].filename == __file__
