"""The kernels of S² against mpmath: errors in ulp of the result, for angles from 1e-300 to π and past it."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from numpy.polynomial import polynomial
from numpy.testing import assert_allclose, assert_array_equal

from many_digits import EPS, assert_ulps, exact, many_digits, mp_cross, mp_dot, ulps  # noqa: F401
from nontwist.geometry import sphere
from refusals import refused_as

TINY_ANGLES = [0.0, 1e-300, 1e-155, 1e-30, 1e-17]
ANGLES = [1e-15, 1e-8, 1e-4, 0.1, 1.0, np.pi / 2, np.nextafter(np.pi / 2, 2), 2.5, 3.1]
NEAR_PI = [np.pi - gap for gap in (1e-3, 1e-8, 1e-12, 1e-14, 2e-15, 1e-15)]
PAST_PI = [np.pi, np.nextafter(np.pi, 4), 3.2, 4.0, 2 * np.pi - 1e-8, 2 * np.pi, 7.0, 20.0, 100.0]
AXES = E1, E2, E3 = np.eye(3)


def rounded(v):
    return np.array([float(x) for x in v])


def mp_turn(d0, d):
    """Angle and unit axis of the smallest rotation from d0 to d, of any lengths; the axis is 0 for d0 = d."""
    n = mp_cross(d0, d)
    return mp.atan2(mp.norm(n), mp_dot(d0, d)), n / mp.norm(n) if mp.norm(n) else n


def mp_log(d0, d):
    angle, n = mp_turn(d0, d)
    return angle * mp_cross(n, d0) / mp.norm(d0)


def mp_transport(d0, d, w):
    """eq-parallel-transport-2-sphere, letter by letter."""
    to, back = mp_log(d0, d), mp_log(d, d0)
    return w - (to + back) * mp_dot(to, w) / mp.norm(to) ** 2 if mp.norm(to) else w


def mp_exp(d0, v):
    angle = mp.norm(v)
    return mp.cos(angle) * d0 + (mp.sin(angle) / angle * v if angle else 0 * v)


def starts(angles):
    """Triples d0, u across it, angle: pairs that many ulp-sized accidents have passed through, in all directions."""
    rng = np.random.default_rng(7)
    points = [*AXES, -E1, *rng.normal(size=(2, 3)), [1.0, 1e-8, 1e-200], [1.0, 1.0, 1.0], [0.6, 0.8, 0.0]]
    for point in points:
        d0 = exact(np.array(point) / np.linalg.norm(point))
        for seed in (AXES[1], AXES[2], rng.normal(size=3)):
            normal = mp_cross(d0, exact(seed))
            if mp.norm(normal) > 0.1:
                u = mp_cross(normal / mp.norm(normal), d0)
                yield from ((d0, u, mp.mpf(float(angle))) for angle in angles)


@pytest.mark.parametrize(
    ("angles", "factors"),
    [(TINY_ANGLES + ANGLES + NEAR_PI + PAST_PI, [1.0]), ([1e-300, 1e-8, 0.3, 1.0, 3.0], [-2.0, 0.0, 7.0])],
)
def test_exp_and_geodesic_against_mpmath(angles, factors):
    cases = list(starts(angles))
    d0 = np.array([rounded(p) for p, _, _ in cases])
    v = np.array([rounded(a * u) for _, u, a in cases])
    assert_array_equal(sphere.exp(d0, v), sphere.geodesic(d0, v, 1.0))
    for s in factors:
        want = [mp_exp(exact(p), mp.mpf(s) * exact(w)) for p, w in zip(d0, v, strict=True)]
        sizes = [max(1, abs(s) * mp.norm(exact(w))) for w in v]
        assert_ulps(f"geodesic {s}", [ulps(*case) for case in zip(sphere.geodesic(d0, v, s), want, sizes, strict=True)])
    for tiny in (1e-300, 3e-170, 1e-20):
        assert_array_equal(sphere.exp(E1, [0.0, tiny, -2 * tiny]), [1.0, tiny, -2 * tiny])


@pytest.fixture(scope="module")
def pairs():
    with mp.workdps(80):
        cases = list(starts(TINY_ANGLES + ANGLES + NEAR_PI))
        d0 = np.array([rounded(p) for p, _, _ in cases])
        return d0, np.array([rounded(mp.cos(a) * p + mp.sin(a) * u) for p, u, a in cases])


def test_log_and_distance_against_mpmath(pairs):
    """More is asked than 8 ulp × 1/(π − θ): given d0 and d, no digit is lost near π; of both the directions count."""
    d0, d = pairs
    v, angle = sphere.log(d0, d), sphere.distance(d0, d)
    want = [mp_log(exact(a), exact(b)) for a, b in zip(d0, d, strict=True)]
    sizes = [mp.norm(w) for w in want]
    assert sum(0 < size < 1e-15 for size in sizes) > 20
    assert sum(mp.pi - size < 4e-15 for size in sizes) > 20
    assert_ulps("log", [ulps(*case) for case in zip(v, want, sizes, strict=True)])
    assert_ulps("distance", [ulps([g], exact([0]) + size, size) for g, size in zip(angle, sizes, strict=True)])
    moderate = (angle > 1e-3) & (angle < 3.1)
    scaled = sphere.log(d0 * (1 + 5e-10), d * (1 - 5e-10))
    assert_allclose(scaled[moderate], v[moderate], rtol=0, atol=1e-13)


def test_transport_against_mpmath(pairs):
    d0, d = pairs
    w = np.cross(d0, np.random.default_rng(3).normal(size=d0.shape))
    got = sphere.transport(d0, d, w)
    want = [mp_transport(exact(a), exact(b), exact(x)) for a, b, x in zip(d0, d, w, strict=True)]
    assert_ulps("transport", [ulps(g, y, mp.norm(y)) for g, y in zip(got, want, strict=True)])
    assert_array_equal(sphere.transport(d0, d0, w), w)


def test_projection_against_mpmath():
    rng, errors = np.random.default_rng(5), []
    for p, u, angle in starts([0.0, 1e-12, 1e-6, 1.0, np.pi / 2]):
        d, v = rounded(p) * (1 + 5e-10 * rng.uniform(-1, 1)), 3e-7 * rounded(mp.cos(angle) * p + mp.sin(angle) * u)
        got, n = sphere.project(d, v), exact(d) / mp.norm(exact(d))
        errors.append(ulps(got, exact(v) - mp_dot(exact(v), n) * n, mp.norm(exact(v))))
        assert abs(float(mp_dot(exact(got), n))) <= EPS * (2 * np.linalg.norm(got) + 0.01 * np.linalg.norm(v))
    assert_ulps("project", errors)


def curve(t):
    """A point moving on the sphere and a field along it, with the derivative of the field."""
    a, b = 1.0 + 0.3 * np.sin(2 * t), 3 * t
    d = np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], -1)
    v = np.stack([np.cos(t), np.exp(-t), t**2], -1)
    return d, v, np.stack([-np.sin(t), -np.exp(-t), 2 * t], -1)


@pytest.mark.parametrize("unevenness", [0, 0.3])
def test_covariant_derivative_order(unevenness):
    errors = []
    for n in (100, 400):
        t = np.linspace(0, 2, n + 1)
        t[1:-1] += np.random.default_rng(2).uniform(-unevenness, unevenness, n - 1) * 2 / n
        d, v, v_dot = curve(t)
        errors.append(np.abs(sphere.covariant_derivative(d, v, t) - sphere.project(d, v_dot)).max())
    assert 3.7 < np.log(errors[0] / errors[1]) / np.log(4) < 4.4


@pytest.mark.parametrize("n", [2, 4, 9])
def test_covariant_derivative_of_polynomials(n):
    t = np.sort(np.random.default_rng(n).uniform(-1, 1, n))
    coefficients = np.arange(1.0, min(n, 5) + 1)[:, None] * [1.0, -2.0, 0.5]
    v = polynomial.polyval(t, coefficients).T
    v_dot = polynomial.polyval(t, polynomial.polyder(coefficients)).T
    d = curve(t)[0]
    found = sphere.covariant_derivative(d, v, t)
    assert_allclose(found, sphere.project(d, v_dot), rtol=0, atol=1e-10)
    back = sphere.covariant_derivative(d[::-1], v[::-1], -t[::-1])
    assert_allclose(back[::-1], -found, rtol=0, atol=1e-12 * np.abs(found).max())


def test_covariant_derivative_of_a_field():
    """Of v = sin(b·d) a × d, of random a and b."""
    rng = np.random.default_rng(4)
    d, w = tangents(rng, 50)
    for a, b in rng.normal(size=(5, 2, 3)):
        got = sphere.covariant_derivative_of_field(lambda d, a=a, b=b: np.sin(b @ d) * np.cross(a, d), d, w)
        growth = np.cos(d @ b) * (w @ b)
        derivative = growth[:, None] * np.cross(a, d) + np.sin(d @ b)[:, None] * np.cross(a, w)
        assert_allclose(got, sphere.project(d, derivative), rtol=0, atol=2e-11)
        assert_allclose(np.sum(got * d, axis=-1), 0, atol=1e-13)


def tangents(rng, count):
    """Points and tangent vectors there."""
    d = rng.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    return d, np.cross(d, rng.normal(size=(count, 3)))


def test_split_tensor():
    rng = np.random.default_rng(4)
    (d, _), (d_tilde, _) = tangents(rng, 10), tangents(rng, 10)
    onto, of = (np.eye(3) - one[..., :, None] * one[..., None, :] for one in (d_tilde, d))
    perp, parallel = onto @ rng.normal(size=(10, 3, 3)) @ of, 2.5 * d_tilde[:, :, None] * d[:, None, :]
    assert sphere.splits(perp + parallel, d * (1 + 9e-10), d_tilde * (1 + 9e-10)).all()
    for scale in (1e-290, 1.0, 1e290):
        got = np.array(sphere.split_tensor(scale * (perp + parallel), d, d_tilde)) / scale
        assert_allclose(got, [perp, parallel], rtol=0, atol=2e-14)
    assert_allclose(np.einsum("nij,nj->ni", got[0], d), 0, atol=5e-15)


def test_leading_axes():
    d, s = np.array([[0.6, 0.8, 0.0], [0.0, 0.6, 0.8]]), np.linspace(0, 1, 5)
    v = sphere.log(E1, d)
    path = sphere.geodesic(E1, v[:, None, :], s)
    assert_array_equal(path[1, 3], sphere.geodesic(E1, v[1], s[3]))
    moved, none = sphere.transport(E1, d[:, None], np.zeros((4, 3))), np.empty((0, 3))
    found = v, path, moved, sphere.distance(E1, none), sphere.log(E1, none), sphere.distance(E1, d[0])
    assert [one.shape for one in found] == [(2, 3), (2, 5, 3), (2, 4, 3), (0,), (0, 3), ()]


BAD, OFF = np.array([[1.0, 0.0, 0.0], [1.0, 1e-4, 0.0]]), np.array([[0.0, 1.0, 0.0], [1e-8, 1.0, 0.0]])
AWAY = np.array([[1.0, 0.0, 0.0], [0.0, 3e-16, -1.0], [0.0, 1.0, 0.0]])  # the second is antipodal to E3
TURN = AXES[[1, 2, 0]].T  # e1 → e2 → e3 → e1
UNSPLIT = {
    "other ends": TURN.T,
    "mixed": TURN + 1e-6 * np.outer(E1, E2),
    "mixed, across": (TURN + 1e-6 * np.outer(E1, E2)).T,
    "singular plane": np.outer(E2, E1) + np.outer(E1, E3),
    "no part along": TURN - np.outer(E1, E3),
    "zero": np.zeros((3, 3)),
}
test_refusals = refused_as(
    {
        "length": lambda: sphere.log([0.6, 0.8, 0.0], BAD),
        "not tangent": lambda: sphere.transport(E1, E1, OFF),
        "tensor": lambda: sphere.split_tensor([TURN, UNSPLIT["mixed"]], E3, E1),
        "antipodal": lambda: sphere.log([E3] * 3, AWAY),
        "antipodal, transport": lambda: sphere.transport(E3, AWAY[:, None, :], E1),
        "field off the plane": lambda: sphere.covariant_derivative_of_field(lambda d: d, E1, E2),
        "time": lambda: sphere.covariant_derivative([E1] * 3, [E1] * 3, [0, 1, 1]),
    }
)


def test_what_is_just_accepted():
    for d0 in np.random.default_rng(8).normal(size=(50, 3)):
        d0 /= np.linalg.norm(d0)
        with pytest.raises(ValueError, match="antipodal"):
            sphere.log(d0, -d0)
    assert sphere.distance(E3, AWAY[1]) == pytest.approx(np.pi, rel=EPS)
    assert sphere.on_sphere(BAD).tolist() == [True, False]
    assert sphere.in_tangent_bundle(E1, OFF).tolist() == [True, False]
    assert not sphere.in_tangent_bundle(BAD[1], E3)
    assert sphere.in_tangent_bundle(E1, OFF, tolerance=1e-7).all()
    assert sphere.splits([TURN, *UNSPLIT.values()], E3, E1).tolist() == [True] + 6 * [False]
    still = sphere.covariant_derivative_of_field(lambda d: np.cross(E3, d), E1, np.zeros((2, 3)))
    assert_array_equal(still, np.zeros((2, 3)))
