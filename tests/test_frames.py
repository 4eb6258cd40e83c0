"""Non-twisting frames: measured orders, closed forms, invariants, and what wrong or awkward input meets."""

import warnings

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from many_digits import exact, mp_cross, mp_dot
from nontwist.geometry.curves import frame_along, frame_of_curve
from nontwist.geometry.frames import closed_frame, frame_error_estimate, holonomy, nontwisting_frame, solid_angle
from refusals import refused_as

AXES = np.eye(3)


def sphere(theta, phi):
    theta, phi = np.broadcast_arrays(theta, phi)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)


def latitude(theta, n, turns=1):
    return sphere(theta, 2 * np.pi * turns * np.arange(n) / n)


def path(t):
    return sphere(1 + 0.4 * np.sin(3 * t), 2 * t + 0.3 * np.cos(t))


def path_rate(t):
    theta, phi = 1 + 0.4 * np.sin(3 * t), 2 * t + 0.3 * np.cos(t)
    along = np.array([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), -np.sin(theta)])
    across = np.array([-np.sin(phi), np.cos(phi), 0]) * np.sin(theta)
    return 1.2 * np.cos(3 * t) * along + (2 - 0.3 * np.sin(t)) * across


def start(d3):
    d1 = np.cross(d3, [0.3, 0.5, 0.8])
    return d1 / np.linalg.norm(d1)


def transported(times, clock=lambda t: t, rate=lambda t: 1.0):
    """d1 at `times` by the equation d1' = -(d1.d3') d3 itself, d3 = path(clock(t))."""

    def right(t, y):
        return -(y @ path_rate(clock(t))) * rate(t) * path(clock(t))

    y0 = start(path(clock(times[0])))
    out = solve_ivp(right, (times[0], times[-1]), y0, "DOP853", dense_output=True, rtol=1e-13, atol=1e-14)
    return out.sol(times).T


def roll(frames, d1):
    """Angle about d3 from `d1` to the frames."""
    side = np.cross(frames[..., 2, :], d1)
    return np.arctan2(np.sum(frames[..., 0, :] * side, -1), np.sum(frames[..., 0, :] * d1, -1))


def modulo(angle, period=2 * np.pi):
    return np.abs((np.asarray(angle) + period / 2) % period - period / 2).max()


def slope(counts, errors):
    return -np.polyfit(np.log(counts), np.log(errors), 1)[0]


def octant(n):
    t = np.arange(n)[:, None] / n * np.pi / 2
    sides = [np.cos(t) * AXES[i] + np.sin(t) * AXES[(i + 1) % 3] for i in range(3)]
    return np.concatenate([*sides, AXES[:1]])


COUNTS = np.array([80, 160, 320, 640, 1280])


def uniform(n):
    return np.linspace(0, 3, n + 1)


def alternating(n):
    steps = np.resize([1.0, 2.0, 4.0], n)  # two steps in turn would let errors cancel
    return np.append(0, 3 * np.cumsum(steps) / steps.sum())


def jittered(n):
    steps = np.random.default_rng(n).uniform(0.3, 1.7, n)
    return np.append(0, 3 * np.cumsum(steps) / steps.sum())


@pytest.mark.parametrize(
    ("grid", "order", "tolerance"),
    [(uniform, 2, 0.02), (alternating, 4, 0.1), (jittered, 4, 0.2)],
)
def test_order(grid, order, tolerance):
    errors = []
    for n in COUNTS:
        t = grid(n)
        exact = transported(t)
        errors.append(np.abs(roll(nontwisting_frame(path(t), exact[0], order=order), exact)).max())
    assert slope(COUNTS, errors) == pytest.approx(order, abs=tolerance)
    assert errors[-1] < (2e-5 if order == 2 else 5e-10)


@pytest.mark.parametrize(("steps", "order"), [([1, 900], 4), ([1, 1100], 4), ([1, 30, 900], 4), ([2, 1500, 2, 2.5], 4)])
def test_order_where_steps_differ_a_thousandfold(steps, order):
    """A long step between stays of a thousandth of it, each of several samples, has no curvature to go by."""
    errors = []
    for n in (100, 200):
        t = np.append(0, np.cumsum(np.resize(steps, n)))
        t = 3 * t / t[-1]
        exact = transported(t)
        errors.append(np.abs(roll(nontwisting_frame(path(t), exact[0]), exact)).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.1)


def test_order_four_through_a_stop_of_d3():
    def clock(t):
        return (t - 1.5) ** 3 / 1.5

    def rate(t):
        return 2 * (t - 1.5) ** 2

    errors = []
    for n in COUNTS[1:]:
        t = np.linspace(0.0137, 3, n + 1)
        exact = transported(t, clock, rate)
        errors.append(np.abs(roll(nontwisting_frame(path(clock(t)), exact[0]), exact)).max())
    assert slope(COUNTS[1:], errors) == pytest.approx(4, abs=0.15)


def test_order_of_double_reflection():
    """On a space curve of varying speed; the tangent's own transport equation is the reference."""

    def x(t):
        return np.stack([t + 0.3 * t**2, np.sin(2 * t), np.cos(3 * t)], -1)

    def dx(t):
        return np.stack([1 + 0.6 * t, 2 * np.cos(2 * t), -3 * np.sin(3 * t)], -1)

    def ddx(t):
        return np.stack([0.6 + 0 * t, -4 * np.sin(2 * t), -9 * np.cos(3 * t)], -1)

    def right(t, y):
        speed = np.linalg.norm(dx(t))
        tangent = dx(t) / speed
        return -(y @ (ddx(t) / speed)) * tangent

    y0 = start(dx(0.0) / np.linalg.norm(dx(0.0)))
    exact = solve_ivp(right, (0, 3), y0, "DOP853", dense_output=True, rtol=1e-13, atol=1e-14).sol
    errors = []
    for n in COUNTS:
        t = uniform(n)
        errors.append(np.abs(roll(frame_of_curve(x(t), dx(t), y0), exact(t).T)).max())
    assert slope(COUNTS, errors) == pytest.approx(4, abs=0.1)
    assert errors[-1] < 1e-7


@pytest.mark.parametrize("order", [2, 4])
def test_great_circle_is_exact(order):
    t = np.linspace(0, 40, 5001)
    turn = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
    d3 = np.stack([np.cos(t), np.sin(t), 0 * t], -1) @ turn.T
    tangent = np.stack([-np.sin(t), np.cos(t), 0 * t], -1) @ turn.T
    frames = nontwisting_frame(d3, tangent[0], order=order)
    np.testing.assert_allclose(frames[:, 0], tangent, atol=1e-13)
    np.testing.assert_allclose(frames[:, 1], np.broadcast_to(turn[:, 2], (5001, 3)), atol=1e-13)


@pytest.mark.parametrize("theta", [0.3, 1.0, 1.9, 2.7])
def test_latitude_circle(theta):
    """The smooth circle encloses 2 pi (1 - cos theta); its polygon what n triangles with the pole enclose."""
    n, cap = 2001, 2 * np.pi * (1 - np.cos(theta))
    side = np.pi / n  # half the difference of longitude
    polygon = 2 * np.pi - 2 * n * np.arctan(np.cos(theta) * np.tan(side))
    d3 = latitude(theta, n)
    assert modulo(closed_frame(d3)[1] - cap) < 1e-11
    assert modulo(closed_frame(d3, order=2)[1] - polygon) < 1e-12
    assert modulo(holonomy(d3) - polygon) < 1e-12
    assert modulo(holonomy(d3[::-1]) + polygon) < 1e-12
    assert -np.pi < holonomy(d3) <= np.pi
    assert modulo(solid_angle(d3) - polygon, 4 * np.pi) < 1e-12
    assert -2 * np.pi < solid_angle(d3) <= 2 * np.pi
    assert solid_angle(d3, pole=(0, 0, 5)) == pytest.approx(polygon, abs=1e-12)
    three = latitude(theta, 3 * n, turns=3)
    assert solid_angle(three, pole=(0, 0, 1)) == pytest.approx(3 * polygon, abs=1e-11)
    assert solid_angle(three[::-1], pole=(0, 0, 1)) == pytest.approx(-3 * polygon, abs=1e-11)
    assert solid_angle(three, pole=(0, 0, -1)) == pytest.approx(3 * polygon - 12 * np.pi, abs=1e-11)


def test_order_of_closed_frame():
    def t(n):
        return 2 * np.pi * np.arange(n) / n

    def closed(t):
        return sphere(1 + 0.4 * np.sin(3 * t), t + 0.3 * np.cos(t))

    exact = closed_frame(closed(t(20000)))[1]
    counts = np.array([100, 200, 400, 800])
    for order, tolerance in ((2, 0.02), (4, 0.1)):
        errors = [abs(closed_frame(closed(t(n)), order=order)[1] - exact) for n in counts]
        assert slope(counts, errors) == pytest.approx(order, abs=tolerance)


def test_octant():
    for polygon, sign in ((AXES, 1), (AXES[::-1], -1), (AXES[[1, 2, 0, 1]], 1), (octant(7), 1), (octant(50)[::-1], -1)):
        expected = sign * np.pi / 2
        assert holonomy(polygon) == pytest.approx(expected, abs=1e-13)
        assert solid_angle(polygon) == pytest.approx(expected, abs=1e-13)
        assert closed_frame(polygon, order=2)[1] == pytest.approx(expected, abs=1e-13)
        loop = np.concatenate([polygon, polygon[:1]])
        frames = nontwisting_frame(loop, order=2)
        assert roll(frames[-1], frames[0, 0]) == pytest.approx(expected, abs=1e-13)


def test_corners_lower_order_four_to_two():
    counts = np.array([30, 60, 120, 240])
    errors = [abs(closed_frame(octant(n))[1] - np.pi / 2) for n in counts]
    assert slope(counts, errors) == pytest.approx(2, abs=0.1)


def exact_area(triangle):
    """L'Huilier's sum of angles at 60 digits: another formula, another arithmetic."""
    with mpmath.workdps(60):
        a, b, c = (exact(v) / mpmath.norm(exact(v)) for v in triangle)
        sides = [mpmath.acos(mp_dot(u, v)) for u, v in ((b, c), (c, a), (a, b))]
        s = sum(sides) / 2
        product = mpmath.tan(s / 2) * mpmath.fprod(mpmath.tan((s - side) / 2) for side in sides)
        return float(4 * mpmath.atan(mpmath.sqrt(product)) * mpmath.sign(mp_dot(a, mp_cross(b, c))))


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**31), size=st.sampled_from([1e-7, 1e-4, 1e-2, 1.0]))
def test_triangle_areas_against_many_digits(seed, size):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=3) + size * rng.normal(size=(3, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    with np.errstate(all="raise"):
        area = solid_angle(points)
    # Points known to an ulp have an area known to their distance times an ulp.
    reach = np.abs(points - points[0]).max()
    assert area == pytest.approx(exact_area(points), abs=1e-15 * reach + 1e-13 * reach**2)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**31), n=st.integers(3, 9))
def test_polygon_invariants(seed, n):
    rng = np.random.default_rng(seed)
    d3 = rng.normal(size=(n, 3))
    d3 /= np.linalg.norm(d3, axis=1)[:, None]
    area = solid_angle(d3)
    turn = Rotation.random(random_state=seed % 1000).as_matrix()
    assert modulo(solid_angle(np.roll(d3, 2, axis=0)) - area, 4 * np.pi) < 1e-12
    assert modulo(solid_angle(d3 @ turn.T) - area, 4 * np.pi) < 1e-12
    assert modulo(solid_angle(d3[::-1]) + area, 4 * np.pi) < 1e-12
    assert modulo(solid_angle(np.repeat(d3, 2, axis=0)) - area, 4 * np.pi) < 1e-12
    halves = solid_angle(d3[:3]) + (solid_angle(d3[[0, *range(2, n)]]) if n > 3 else 0.0)
    assert modulo(halves - area, 4 * np.pi) < 1e-12
    assert modulo(holonomy(d3) - area) < 1e-12
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert modulo(closed_frame(d3, order=2)[1] - area) < 1e-11
    assert modulo(solid_angle(d3, pole=turn[0]) - area, 4 * np.pi) < 1e-12


def test_vertices_at_the_poles_are_not_special():
    d3 = np.array([[0, 0, 1.0], [1, 0, 0], [0, 0, -1], [0, 1, 0]])
    assert solid_angle(d3) == pytest.approx(np.pi, abs=1e-14)
    assert holonomy(d3) == pytest.approx(np.pi, abs=1e-14)
    for n in range(3, 30):
        for equator in (latitude(np.pi / 2, n), latitude(np.pi / 2, n)[::-1], latitude(np.pi / 2, n)[:, [1, 2, 0]]):
            assert -2 * np.pi < solid_angle(equator) <= 2 * np.pi
            assert abs(solid_angle(equator)) == pytest.approx(2 * np.pi, abs=1e-13)
            assert holonomy(equator) == pytest.approx(0.0, abs=1e-13)
    assert solid_angle(AXES[[0, 1]]) == 0.0
    assert solid_angle(AXES[:1]) == 0.0


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("repeat", [False, True])
def test_closed_frames_close(order, repeat):
    t = 2 * np.pi * np.arange(401) / 400
    d3 = sphere(1 + 0.4 * np.sin(3 * t), t)
    frames, angle = closed_frame(d3 if repeat else d3[:-1], start(d3[0]), order=order)
    open_frames = nontwisting_frame(d3 if repeat else d3[:-1], start(d3[0]), order=order)
    assert frames.shape == open_frames.shape
    if repeat:
        np.testing.assert_allclose(frames[-1], frames[0], atol=1e-13)
        assert angle == pytest.approx(closed_frame(d3[:-1], order=order)[1], abs=1e-13)
    np.testing.assert_allclose(
        np.einsum("nij,nkj->nik", frames, frames), np.broadcast_to(AXES, (len(frames), 3, 3)), atol=1e-14
    )
    # The twist against the open frame is even along the path: minus the holonomy at the length of the whole.
    twisted = np.unwrap(roll(frames, open_frames[:, 0]))
    length = np.linalg.norm(np.diff(d3, axis=0), axis=1)
    expected = -angle * np.append(0, np.cumsum(length))[: len(frames)] / length.sum()
    np.testing.assert_allclose(twisted, expected, atol=1e-5 if order == 4 else 1e-12)


@pytest.mark.parametrize("order", [2, 4])
def test_a_closed_path_has_no_first_sample(order):
    t = 2 * np.pi * (np.arange(150) + np.random.default_rng(2).uniform(-0.3, 0.3, 150)) / 150
    d3 = sphere(1 + 0.4 * np.sin(3 * t), t)
    for shift in (1, 2, 70):
        angle = closed_frame(np.roll(d3, shift, axis=0), order=order)[1]
        assert angle == pytest.approx(closed_frame(d3, order=order)[1], abs=1e-13)


@pytest.mark.parametrize("order", [2, 4])
def test_geometry_not_time_counts(order):
    """Turning space turns the frame, turning the start turns every frame by as much, going back undoes the way."""
    d3, d1 = path(jittered(160)), start(path(0.0))
    frames = nontwisting_frame(d3, d1, order=order)
    turn = Rotation.from_rotvec([0.7, 1.1, -0.4]).as_matrix()
    np.testing.assert_allclose(nontwisting_frame(d3 @ turn.T, turn @ d1, order=order), frames @ turn.T, atol=1e-13)
    other = nontwisting_frame(d3, np.cos(0.9) * frames[0, 0] + np.sin(0.9) * frames[0, 1], order=order)
    np.testing.assert_allclose(roll(other, frames[:, 0]), 0.9, atol=1e-13)
    back = nontwisting_frame(d3[::-1], frames[-1, 0], order=order)
    np.testing.assert_allclose(back[::-1], frames, atol=1e-13)


def test_leading_axes():
    d3 = np.stack([path(jittered(n)) for n in (60, 60, 60)] + [latitude(a, 61) for a in (0.4, 1.2, 2.0)]).reshape(
        2, 3, 61, 3
    )
    d1 = np.stack([start(v) for v in d3[..., 0, :].reshape(-1, 3)]).reshape(2, 3, 3)
    frames, closed = nontwisting_frame(d3, d1), closed_frame(d3, d1)
    assert frames.shape == closed[0].shape == (2, 3, 61, 3, 3)
    assert closed[1].shape == holonomy(d3).shape == solid_angle(d3, pole=AXES[2]).shape == (2, 3)
    for i in np.ndindex(2, 3):
        np.testing.assert_array_equal(frames[i], nontwisting_frame(d3[i], d1[i]))
        np.testing.assert_array_equal(closed[0][i], closed_frame(d3[i], d1[i])[0])
        assert closed[1][i] == closed_frame(d3[i], d1[i])[1]
        assert holonomy(d3)[i] == holonomy(d3[i])
        np.testing.assert_array_equal(frame_error_estimate(d3)[i], frame_error_estimate(d3[i]))


def test_the_first_d1():
    np.testing.assert_array_equal(nontwisting_frame([[0, 0, 1.0]]), [np.eye(3)])
    np.testing.assert_array_equal(nontwisting_frame([[1.0, 0, 0]])[0], AXES[[1, 2, 0]])
    d3 = path(uniform(10))
    frames = nontwisting_frame(d3, [3.0, 4.0, 5.0])  # not orthogonal, not unit: projected
    wish = np.array([3.0, 4.0, 5.0]) - (d3[0] @ [3.0, 4.0, 5.0]) * d3[0]
    np.testing.assert_allclose(frames[0, 0], wish / np.linalg.norm(wish), atol=1e-15)
    np.testing.assert_allclose(nontwisting_frame(d3, [3e-300, 4e-300, 5e-300]), frames, atol=1e-14)


def test_constant_and_repeated_directors():
    d3 = np.broadcast_to([0.6, 0.0, 0.8], (50, 3))
    for order in (2, 4):
        frames = nontwisting_frame(d3, order=order)
        np.testing.assert_allclose(frames, np.broadcast_to(frames[0], frames.shape), atol=1e-15)
        frames, angle = closed_frame(d3, order=order)
        assert angle == pytest.approx(0.0, abs=1e-15)
        np.testing.assert_allclose(frames, np.broadcast_to(frames[0], frames.shape), atol=1e-15)
    assert holonomy(d3) == solid_angle(d3) == 0.0
    assert frame_error_estimate(d3).max() < 1e-14


@pytest.mark.parametrize("noise", [0.0, 1e-15, 1e-12, 1e-8])
def test_order_four_survives_repeated_and_nearly_repeated_samples(noise):
    rng = np.random.default_rng(3)
    plain, d1 = path(uniform(160)), start(path(0.0))
    best = nontwisting_frame(plain, d1)
    for times in (np.full(161, 2), rng.integers(1, 4, 161), np.where(np.arange(161) == 80, 500, 1)):
        d3 = np.repeat(plain, times, axis=0)
        d3 = d3 + noise * rng.normal(size=d3.shape)
        d3 /= np.linalg.norm(d3, axis=1)[:, None]
        frames = nontwisting_frame(d3, d1)[np.cumsum(times) - 1]
        assert np.abs(roll(frames, best[:, 0])).max() < 1e-14 + 10 * noise


@pytest.mark.parametrize("noise", [1e-15, 1e-8, 1e-6])
def test_near_repetitions_change_no_other_frame(noise):
    d3 = np.repeat(path(uniform(160)), 2, axis=0)
    d3 = d3 + noise * np.random.default_rng(3).normal(size=d3.shape)
    d3 /= np.linalg.norm(d3, axis=1)[:, None]
    d1 = start(d3[0])
    np.testing.assert_allclose(nontwisting_frame(d3, d1)[::2], nontwisting_frame(d3[::2], d1), atol=2e-14)


def test_small_coning_at_rest_is_kept():
    """A hundred circles of 1e-6 rad turn the frame by 1e-10 pi in all, whatever came before."""
    loops = sphere(1e-6, 2 * np.pi * np.arange(4000) / 40)
    arrival = sphere(np.linspace(0.5, 0.01, 50), 0.0)
    way = nontwisting_frame(np.concatenate([arrival, loops[:1]]), AXES[1])
    stay = nontwisting_frame(np.concatenate([arrival, loops, loops[:1]]), AXES[1])
    turned = roll(stay[-1], way[-1, 0])
    # A path as long as a thousandth of the chord before it is taken for a stay: it encloses less than a circle would.
    lost = (1e-3 * 0.01) ** 2 / (4 * np.pi)
    assert turned == pytest.approx(100 * np.pi * 1e-12, abs=lost)
    leave = nontwisting_frame(np.concatenate([arrival, loops, loops[:1]])[::-1], stay[-1, 0])
    np.testing.assert_allclose(leave[::-1], stay, atol=lost)


def test_the_input_is_not_changed():
    d3 = path(uniform(20)) * (1 + 1e-10)
    kept = d3.copy()
    nontwisting_frame(d3), closed_frame(d3), solid_angle(d3), frame_error_estimate(d3)
    np.testing.assert_array_equal(d3, kept)
    strided = np.asfortranarray(np.repeat(d3, 2, axis=0))[::2]
    np.testing.assert_array_equal(nontwisting_frame(strided), nontwisting_frame(d3))


def test_error_estimate_at_corners_and_at_round_off():
    for n in (30, 31, 60, 61):
        d3 = octant(n)
        error = np.abs(roll(nontwisting_frame(d3), nontwisting_frame(d3, order=2)[:, 0])).max()
        assert 0.5 * error < frame_error_estimate(d3)[-1] < 5 * error
    t = np.linspace(0, 46, 300_001)
    circle = np.stack([0.6 * np.cos(t), np.sin(t), 0.8 * np.cos(t)], -1)
    tangent = np.stack([-0.6 * np.sin(t), np.cos(t), -0.8 * np.sin(t)], -1)
    error = np.abs(roll(nontwisting_frame(circle, tangent[0]), tangent))
    assert np.all(error <= frame_error_estimate(circle))
    assert frame_error_estimate(circle)[-1] < 3e-12


def test_frame_along_a_function():
    times = np.array([0.0, 0.1, 0.5, 0.500001, 2.0, 3.0])
    exact = transported(times)
    for rtol, most in ((1e-6, 400), (1e-10, 800), (1e-12, 1400)):
        calls = []
        frames = frame_along(lambda t: calls.append(t) or path(t), times, exact[0], rtol=rtol)  # noqa: B023
        assert len(calls) < most
        assert min(calls) == 0.0 and max(calls) == 3.0  # noqa: PT018
        assert np.abs(roll(frames, exact)).max() < max(rtol, 5e-13)
    np.testing.assert_allclose(frames[:, 2], path(times), atol=2e-16)
    np.testing.assert_allclose(frame_along(path, [2.0]), nontwisting_frame([path(2.0)]), atol=3e-16)
    # Many turns between two output times, as many as samples at the start.
    for turns in (8, 32, 64, 256):

        def circle(t, turns=turns):
            return sphere(0.7, 2 * np.pi * turns * t)

        ends = frame_along(circle, [0.0, 1.0], rtol=1e-6)
        assert modulo(roll(ends[1], ends[0, 0]) - 2 * np.pi * turns * (1 - np.cos(0.7))) < 1e-6


def test_frame_along_meets_its_tolerance_at_a_kink():
    """Two latitude arcs joined by a corner at an awkward time."""
    corner = 1 / np.pi

    def phi(t):
        return np.where(t < corner, t, 2 * corner - t)

    def theta(t):
        return np.where(t < corner, 0.9, 0.9 + (t - corner))

    def kinked(t):
        return sphere(theta(t), phi(t))

    # Against (e_theta, e_phi) the frame turns by minus the integral of cos(theta) phi'.
    turned = -np.cos(0.9) * corner + (np.sin(0.9 + 1 - corner) - np.sin(0.9))
    d1 = sphere(0.9 + np.pi / 2, 0.0)
    e1, e2 = sphere(theta(1.0) + np.pi / 2, phi(1.0)), sphere(np.pi / 2, phi(1.0) + np.pi / 2)
    expected = np.cos(turned) * e1 + np.sin(turned) * e2
    for rtol in (1e-6, 1e-10):
        assert np.abs(roll(frame_along(kinked, [0.0, 1.0], d1, rtol=rtol)[1], expected)) < rtol


def test_frame_of_curve_of_awkward_points():
    t = uniform(40)
    helix = np.stack([np.cos(t), np.sin(t), 0.5 * t], -1)
    tangents = 7 * np.stack([-np.sin(t), np.cos(t), 0.5 + 0 * t], -1)
    frames = frame_of_curve(helix, tangents)
    twice = frame_of_curve(np.repeat(helix, 2, axis=0), np.repeat(tangents, 2, axis=0))
    np.testing.assert_allclose(twice[::2], frames, atol=1e-14)
    np.testing.assert_allclose(frame_of_curve(1e-6 * helix + 3, tangents), frames, atol=1e-9)
    np.testing.assert_allclose(np.einsum("nij,nkj->nik", frames, frames), np.broadcast_to(AXES, (41, 3, 3)), atol=1e-14)
    np.testing.assert_allclose(frame_of_curve(helix, 1e-200 * tangents), frames, atol=1e-14)
    line = np.outer(t, [1.0, 2.0, 2.0])
    straight = frame_of_curve(line, np.add(line, [1.0, 2.0, 2.0]))
    np.testing.assert_allclose(straight, np.broadcast_to(straight[0], straight.shape), atol=1e-15)
    np.testing.assert_array_equal(frame_of_curve(helix[None], tangents[None])[0], frames)


@pytest.mark.parametrize("size", [1e-300, 1e-170, 1e-162, 1e-158, 1e155, 1e200, 1e307])
def test_frames_of_curves_in_any_unit_of_length(size):
    """Squares of these lengths are no floats."""
    t = np.arange(40) * np.pi / 20
    helix = np.stack([np.cos(t), np.sin(t), 0.5 * t], -1)
    tangents = np.stack([-np.sin(t), np.cos(t), 0.5 + 0 * t], -1)
    np.testing.assert_allclose(frame_of_curve(size * helix, tangents), frame_of_curve(helix, tangents), atol=1e-14)
    d3 = tangents / np.linalg.norm(tangents, axis=1)[:, None]
    points = helix * [2, 1, 0]  # not uniform
    (small, _), (plain, _) = (closed_frame(d3, points=one) for one in (size * points, points))
    np.testing.assert_allclose(small, plain, atol=1e-14)


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("size", [1e-104, 1e-108, 1e-158, 1e-300])
def test_directors_that_move_by_next_to_nothing(size, order):
    xy = size * np.random.default_rng(0).standard_normal((100, 2))
    d3 = np.concatenate([xy, np.ones((100, 1))], axis=1)
    for frames in (nontwisting_frame(d3, order=order), closed_frame(d3, order=order)[0]):
        np.testing.assert_allclose(frames, np.broadcast_to(AXES, frames.shape), atol=1e-15)
    assert frame_error_estimate(d3, order=order).max() < 1e-14


def changed(place, value):
    d3 = path(uniform(20))
    d3[place] = value
    return d3


D3, HALF = path(uniform(20)), sphere(np.linspace(0, np.pi, 21), 0.0)
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
    almost = changed(7, D3[7] * (1 + 1e-10))
    np.testing.assert_allclose(nontwisting_frame(almost, order=order), nontwisting_frame(D3, order=order), atol=1e-14)
    nontwisting_frame(HALF, order=order)
    nontwisting_frame(AXES)  # just a right angle: no warning
    with pytest.warns(UserWarning, match=r"d3\[2\] is more than a right angle") as caught:
        nontwisting_frame(sphere(np.array([0.0, 0.5, 0.5 + 1.58]), 0.0))
    assert caught[0].filename == __file__


def test_a_tolerance_below_round_off_is_not_tried():
    calls = []
    with pytest.raises(RuntimeError, match=r"cannot meet rtol = 1\.0e-200"):
        frame_along(lambda t: calls.append(t) or path(t), [0.0, 1.0], rtol=1e-200)
    assert len(calls) < 1000


def test_the_first_vector_of_a_function_that_is_no_unit_vector_is_named():
    with pytest.raises(ValueError, match=r"function\(0\.5\) must be a unit vector, got \[0\.0, 0\.0, 1\.5\]"):
        frame_along(lambda t: [0, 0, 1 if t < 0.5 else 1 + t], [0, 0.25, 0.5, 1.0])
