"""What the kernels of S² and SO(3) must keep whatever the arguments: group axioms, inverses, isometry, holonomy."""

from __future__ import annotations

from math import hypot

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from nontwist.geometry import rotations, sphere

prove = settings(derandomize=True, max_examples=60, deadline=None)
entry = st.floats(-1, 1, allow_subnormal=False)
triples = st.tuples(entry, entry, entry).map(np.array)
directions = triples.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v))
angles = st.one_of(st.floats(1e-300, 1e-6), st.floats(0, 3.14), st.floats(3.14, np.pi - 1e-14))
turns = st.one_of(angles, st.floats(-20, 20))
vectors = st.builds(lambda n, angle: n * angle, directions, angles)
long_vectors = st.builds(lambda n, angle: n * angle, directions, turns)


def tangent(d, v):
    """A tangent vector at d as long as v."""
    w = sphere.project(d, v)
    assume(np.linalg.norm(w) > 1e-2 * np.linalg.norm(v) > 0)
    return sphere.project(d, w * (np.linalg.norm(v) / np.linalg.norm(w)))


def close(got, want, atol=4e-15):
    np.testing.assert_allclose(got, want, rtol=0, atol=atol + 1e-322)  # two subnormal units


@prove
@given(long_vectors, long_vectors, triples)
def test_rotations_are_a_group(a, b, d):
    """Closure, identity, inverses, conjugation, a logarithm of each; the transform of Cayley turns about the mean."""
    R, S, C = rotations.exp(a), rotations.exp(b), rotations.cayley(a)
    assert rotations.is_rotation([R @ S, C @ rotations.cayley(b)], tolerance=4e-15).all()
    assert_array_equal(rotations.exp(0 * a), np.eye(3))
    assert_array_equal(rotations.exp(-a), R.T)
    assert_array_equal(rotations.cayley(-a), C.T)
    close(rotations.exp(-a) @ R, np.eye(3))
    close(R @ S @ R.T, rotations.exp(R @ b), atol=4e-15 * (1 + np.linalg.norm(b)))
    close(R @ rotations.hat(b) @ R.T, rotations.hat(R @ b), atol=4e-15 * (1 + np.linalg.norm(b)))
    assert np.linalg.norm(rotations.log(R @ S)) <= np.pi * (1 + 1e-15)
    close(rotations.exp(rotations.log(R @ S)), R @ S)
    close(C @ d - d, np.cross(a, (C @ d + d) / 2), atol=4e-15 * (1 + np.linalg.norm(a)))


@prove
@given(directions, turns, turns)
def test_rotations_about_one_axis_are_a_one_parameter_group(n, a, b):
    close(rotations.exp(a * n) @ rotations.exp(b * n), rotations.exp((a + b) * n), atol=4e-15 * (1 + abs(a) + abs(b)))


@prove
@given(vectors)
def test_logarithms_are_inverses(a):
    angle = np.linalg.norm(a)
    close(rotations.log(rotations.exp(a)), a, atol=2e-15 * angle)
    if angle < 3:
        close(rotations.cayley_inverse(rotations.cayley(a)), a, atol=4e-15 * angle)
        close(np.linalg.norm(rotations.log(rotations.cayley(a))), 2 * np.arctan(angle / 2), atol=4e-15 * angle)


@prove
@given(long_vectors)
def test_dexp_and_its_inverse(a):
    angle = np.linalg.norm(a)
    gap = abs(angle - 2 * np.pi * max(1, round(angle / (2 * np.pi))))
    assume(gap > 1e-3)
    close(rotations.dexp(a) @ rotations.dexp_inverse(a), np.eye(3), atol=1e-14 * (1 + angle**2 / gap))
    # the derivative seen from the other side: dexp(−θ) = dexp(θ)ᵀ = exp(θ)ᵀ dexp(θ)
    assert_array_equal(rotations.dexp(-a), rotations.dexp(a).T)
    close(rotations.exp(a).T @ rotations.dexp(a), rotations.dexp(a).T, atol=4e-15 * (1 + angle))
    close(rotations.dexp(a) @ a, a, atol=4e-15 * angle)


@prove
@given(directions, long_vectors, vectors)
def test_geodesics_stay_on_the_sphere_and_log_tells_their_start(d0, far, near):
    assert sphere.on_sphere(sphere.exp(d0, tangent(d0, far)), tolerance=2e-15)
    v = tangent(d0, near)
    angle = np.linalg.norm(v)
    assume(angle < np.pi - 2e-14)
    # rounding exp(v) to floats moves it by eps, and log magnifies that by 1 / (π − |v|)
    close(sphere.log(d0, sphere.exp(d0, v)), v, atol=8e-16 * (1 + np.pi / (np.pi - angle)))


@prove
@given(directions, directions, directions, triples, triples)
def test_distances_are_a_metric_and_transport_is_an_isometry(d0, d, c, a, b):
    assume(np.linalg.norm(d0 + d) > 1e-14)
    v = sphere.log(d0, d)
    assert sphere.in_tangent_bundle(d0, v, tolerance=4e-15)
    close(sphere.exp(d0, v), d, atol=2e-15)
    close(np.linalg.norm(v), sphere.distance(d0, d), atol=1e-15)
    assert sphere.distance(c, c) == 0
    close(sphere.distance(d0, d), sphere.distance(d, d0), atol=1e-15)
    assert sphere.distance(d0, c) <= sphere.distance(d0, d) + sphere.distance(d, c) + 2e-15
    a, b = tangent(d0, a), tangent(d0, b)
    moved_a, moved_b = sphere.transport(d0, d, a), sphere.transport(d0, d, b)
    close(moved_a @ moved_b, a @ b)
    close(d @ np.cross(moved_a, moved_b), d0 @ np.cross(a, b))  # nor is the orientation changed
    close(moved_a @ d, 0)
    close(sphere.transport(d, d0, moved_a), a)


@prove
@given(directions, directions, st.floats(0.01, 0.99), triples, long_vectors)
def test_geodesics_have_constant_speed_transport_is_parallel_and_rotations_commute(d0, d, s, w, a):
    assume(np.linalg.norm(d0 + d) > 1e-3)
    v, w, magnified = sphere.log(d0, d), tangent(d0, w), 1e-14 / np.linalg.norm(d0 + d)
    point, whole = sphere.geodesic(d0, v, s), sphere.distance(d0, d)
    close(sphere.distance(d0, point), s * whole)
    close(sphere.distance(point, d), (1 - s) * whole)
    moved = sphere.transport(d0, d, w)
    close(sphere.transport(d0, d, v), -sphere.log(d, d0), atol=magnified)
    close(sphere.transport(point, d, sphere.transport(d0, point, w)), moved, atol=magnified)
    R = rotations.exp(a)
    close(R @ v, sphere.log(R @ d0, R @ d), atol=magnified)
    close(R @ moved, sphere.transport(R @ d0, R @ d, sphere.project(R @ d0, R @ w)), atol=magnified)


@prove
@given(directions, triples, triples, long_vectors)
def test_projections_and_splits(d, a, b, turn):
    w = sphere.project(d, a)
    close(sphere.project(d, w), w, atol=4e-16)
    close(w @ b, a @ sphere.project(d, b))
    u = 1.11e-16  # each pass leaves at most 9 u of its vector along d, the product here adds 3 u
    assert abs(w @ d) <= 4e-16 * hypot(*w) + 12 * u * 9 * u * hypot(*a)
    R = rotations.exp(turn)
    perp, parallel = sphere.split_tensor(R, d, R @ d)
    close(perp + parallel, R)
    close(parallel @ d, R @ d)
    close(perp @ d, 0)


@prove
@given(long_vectors, turns, turns, long_vectors)
def test_twists_add_up_and_their_rate_is_the_spin_about_the_third_director(a, psi, phi, w):
    q = rotations.exp(a)
    both = rotations.twisted_triad(rotations.twisted_triad(q, psi), phi)
    close(both, rotations.twisted_triad(q, psi + phi), atol=1e-14)
    assert_array_equal(both[2], q[2])
    assert rotations.is_rotation(both, tolerance=1e-14)
    q_dot = np.cross(w, q)
    psi_dot, size = rotations.twist_rate(q, q_dot), 1 + np.linalg.norm(w)
    close(psi_dot, w @ q[2], atol=2e-15 * size)
    close(rotations.darboux_vector(q[2], q_dot[2], psi_dot), w, atol=2e-15 * size)
    close(rotations.frame_map(q, np.eye(3)), q.T)


@prove
@given(directions, directions, directions, triples)
def test_closed_geodesic_triangles_turn_by_their_area(a, b, c, w):
    sides = [np.linalg.norm(p + q) for p, q in ((a, b), (b, c), (c, a))]
    assume(min(sides) > 1e-2)
    w = tangent(a, w)
    turned = sphere.transport(c, a, sphere.transport(b, c, sphere.transport(a, b, w)))
    # counter-clockwise seen from outside is positive, in the area as in the angle
    area = 2 * np.arctan2(np.linalg.det([a, b, c]), 1 + a @ b + b @ c + c @ a)
    angle = np.arctan2(a @ np.cross(w, turned), w @ turned)
    assert abs((angle - area + np.pi) % (2 * np.pi) - np.pi) < 1e-14 / min(sides) ** 2
