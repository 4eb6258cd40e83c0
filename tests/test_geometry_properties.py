"""What the kernels of S² and SO(3) must keep whatever the arguments: group axioms, inverses, isometry, holonomy."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from nontwist.geometry import rotations, sphere

prove = settings(derandomize=True, max_examples=120, deadline=None)
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


# The group SO(3)


@prove
@given(long_vectors, long_vectors)
def test_closure_products_of_rotations_are_rotations(a, b):
    assert rotations.is_rotation(rotations.exp(a) @ rotations.exp(b), tolerance=4e-15)
    assert rotations.is_rotation(rotations.cayley(a) @ rotations.cayley(b), tolerance=4e-15)


@prove
@given(long_vectors)
def test_identity_and_inverse(a):
    R = rotations.exp(a)
    np.testing.assert_array_equal(rotations.exp(0 * a), np.eye(3))
    np.testing.assert_array_equal(rotations.exp(-a), R.T)
    close(rotations.exp(-a) @ R, np.eye(3))
    np.testing.assert_array_equal(rotations.cayley(-a), rotations.cayley(a).T)


@prove
@given(directions, turns, turns)
def test_rotations_about_one_axis_are_a_one_parameter_group(n, a, b):
    close(rotations.exp(a * n) @ rotations.exp(b * n), rotations.exp((a + b) * n), atol=4e-15 * (1 + abs(a) + abs(b)))


@prove
@given(long_vectors, long_vectors)
def test_conjugation_turns_the_axis(a, b):
    R, S = rotations.exp(a), rotations.exp(b)
    close(R @ S @ R.T, rotations.exp(R @ b), atol=4e-15 * (1 + np.linalg.norm(b)))
    close(R @ rotations.hat(b) @ R.T, rotations.hat(R @ b), atol=4e-15 * (1 + np.linalg.norm(b)))


@prove
@given(vectors)
def test_log_is_the_inverse_of_exp(a):
    close(rotations.log(rotations.exp(a)), a, atol=2e-15 * np.linalg.norm(a))


@prove
@given(long_vectors, long_vectors)
def test_exp_is_the_inverse_of_log(a, b):
    R = rotations.exp(a) @ rotations.exp(b)
    assert np.linalg.norm(rotations.log(R)) <= np.pi * (1 + 1e-15)
    close(rotations.exp(rotations.log(R)), R)


@prove
@given(vectors.filter(lambda a: np.linalg.norm(a) < 3))
def test_cayley_and_its_inverse(a):
    close(rotations.cayley_inverse(rotations.cayley(a)), a, atol=4e-15 * np.linalg.norm(a))
    angle = np.linalg.norm(a)
    close(np.linalg.norm(rotations.log(rotations.cayley(a))), 2 * np.arctan(angle / 2), atol=4e-15 * angle)


@prove
@given(long_vectors, triples)
def test_cayley_turns_about_the_mean_of_the_ends(w, d):
    end = rotations.cayley(w) @ d
    close(end - d, np.cross(w, (end + d) / 2), atol=4e-15 * (1 + np.linalg.norm(w)))


@prove
@given(long_vectors)
def test_dexp_and_its_inverse(a):
    angle = np.linalg.norm(a)
    gap = abs(angle - 2 * np.pi * max(1, round(angle / (2 * np.pi))))
    assume(gap > 1e-3)
    close(rotations.dexp(a) @ rotations.dexp_inverse(a), np.eye(3), atol=1e-14 * (1 + angle**2 / gap))
    # the derivative seen from the other side: dexp(−θ) = dexp(θ)ᵀ = exp(θ)ᵀ dexp(θ)
    np.testing.assert_array_equal(rotations.dexp(-a), rotations.dexp(a).T)
    close(rotations.exp(a).T @ rotations.dexp(a), rotations.dexp(a).T, atol=4e-15 * (1 + angle))
    close(rotations.dexp(a) @ a, a, atol=4e-15 * angle)


# The sphere S²


@prove
@given(directions, long_vectors)
def test_exp_stays_on_the_sphere(d0, v):
    assert sphere.on_sphere(sphere.exp(d0, tangent(d0, v)), tolerance=2e-15)


@prove
@given(directions, vectors)
def test_log_is_the_inverse_of_exp_on_the_sphere(d0, v):
    v = tangent(d0, v)
    angle = np.linalg.norm(v)
    assume(angle < np.pi - 2e-14)
    # rounding exp(v) to floats moves it by eps, and log magnifies that by 1 / (π − |v|)
    close(sphere.log(d0, sphere.exp(d0, v)), v, atol=8e-16 * (1 + np.pi / (np.pi - angle)))


@prove
@given(directions, directions)
def test_exp_is_the_inverse_of_log_on_the_sphere(d0, d):
    assume(np.linalg.norm(d0 + d) > 1e-14)
    v = sphere.log(d0, d)
    assert sphere.in_tangent_bundle(d0, v, tolerance=4e-15)
    close(sphere.exp(d0, v), d, atol=2e-15)
    close(np.linalg.norm(v), sphere.distance(d0, d), atol=1e-15)


@prove
@given(directions, directions, directions)
def test_distance_is_a_metric(a, b, c):
    assert sphere.distance(a, a) == 0
    close(sphere.distance(a, b), sphere.distance(b, a), atol=1e-15)
    assert sphere.distance(a, c) <= sphere.distance(a, b) + sphere.distance(b, c) + 2e-15


@prove
@given(directions, directions, st.floats(0, 1))
def test_geodesics_run_at_constant_speed_and_join_their_ends(d0, d, s):
    assume(np.linalg.norm(d0 + d) > 1e-6)
    point, whole = sphere.geodesic(d0, sphere.log(d0, d), s), sphere.distance(d0, d)
    close(sphere.distance(d0, point), s * whole)
    close(sphere.distance(point, d), (1 - s) * whole)


@prove
@given(directions, directions, triples, triples)
def test_transport_is_an_isometry_between_the_tangent_planes(d0, d, a, b):
    assume(np.linalg.norm(d0 + d) > 1e-14)
    a, b = tangent(d0, a), tangent(d0, b)
    moved_a, moved_b = sphere.transport(d0, d, a), sphere.transport(d0, d, b)
    close(moved_a @ moved_b, a @ b)
    close(d @ np.cross(moved_a, moved_b), d0 @ np.cross(a, b))  # nor is the orientation changed
    close(moved_a @ d, 0)
    close(sphere.transport(d, d0, moved_a), a)


@prove
@given(directions, directions, st.floats(0.01, 0.99), triples)
def test_transport_is_parallel_along_the_geodesic(d0, d, s, w):
    assume(np.linalg.norm(d0 + d) > 1e-3)
    v, w = sphere.log(d0, d), tangent(d0, w)
    close(sphere.transport(d0, d, v), -sphere.log(d, d0), atol=1e-14 / np.linalg.norm(d0 + d))
    half = sphere.geodesic(d0, v, s)
    close(
        sphere.transport(half, d, sphere.transport(d0, half, w)),
        sphere.transport(d0, d, w),
        atol=1e-14 / np.linalg.norm(d0 + d),
    )


@prove
@given(directions, directions, triples, long_vectors)
def test_rotations_commute_with_log_and_transport(d0, d, w, a):
    assume(np.linalg.norm(d0 + d) > 1e-3)
    R, w, magnified = rotations.exp(a), tangent(d0, w), 1e-14 / np.linalg.norm(d0 + d)
    close(R @ sphere.log(d0, d), sphere.log(R @ d0, R @ d), atol=magnified)
    turned = sphere.transport(R @ d0, R @ d, sphere.project(R @ d0, R @ w))
    close(R @ sphere.transport(d0, d, w), turned, atol=magnified)


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


@prove
@given(directions, directions, triples)
def test_projection_is_idempotent_and_symmetric(d, a, b):
    w = sphere.project(d, a)
    close(sphere.project(d, w), w, atol=4e-16)
    close(w @ b, a @ sphere.project(d, b))
    u = 1.11e-16  # each pass leaves at most 9 u of its vector along d, the product here adds 3 u
    assert abs(w @ d) <= 4e-16 * np.linalg.norm(w) + 12 * u * 9 * u * np.linalg.norm(a)


@prove
@given(directions, long_vectors)
def test_rotations_split_from_any_director_to_its_image(d, a):
    R = rotations.exp(a)
    perp, parallel = sphere.split_tensor(R, d, R @ d)
    close(perp + parallel, R)
    close(parallel @ d, R @ d)
    close(perp @ d, 0)


# Frames


@prove
@given(long_vectors, turns, turns)
def test_twists_about_the_third_director_add_up(a, psi, phi):
    q = rotations.exp(a)
    both = rotations.twisted_triad(rotations.twisted_triad(q, psi), phi)
    close(both, rotations.twisted_triad(q, psi + phi), atol=1e-14)
    np.testing.assert_array_equal(both[2], q[2])
    assert rotations.is_rotation(both, tolerance=1e-14)


@prove
@given(long_vectors, long_vectors)
def test_twist_rate_is_the_spin_about_the_third_director(a, w):
    q = rotations.exp(a)
    q_dot = np.cross(w, q)
    psi_dot, size = rotations.twist_rate(q, q_dot), 1 + np.linalg.norm(w)
    close(psi_dot, w @ q[2], atol=2e-15 * size)
    close(rotations.darboux_vector(q[2], q_dot[2], psi_dot), w, atol=2e-15 * size)
    close(rotations.frame_map(q, np.eye(3)), q.T)
