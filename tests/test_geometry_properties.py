"""What the kernels of S² and SO(3) keep whatever the arguments: group axioms, isometry, commutation with rotations.

Inverses, the derivative of exp, and holonomy on as many points: `nontwist.validation.frames`; each kernel against many
digits: `test_rotations`, `test_sphere`.
"""

import numpy as np
from numpy.testing import assert_array_equal

from nontwist.geometry import rotations, sphere

COUNT, RNG = 1000, np.random.default_rng(1)
LENGTHS = np.where(np.arange(COUNT) % 2, 10 ** RNG.uniform(-300, 0, COUNT), RNG.uniform(0, 3.14, COUNT))
TURNS = np.where(np.arange(COUNT) % 3, LENGTHS, RNG.uniform(-20, 20, COUNT))


def directions():
    d = RNG.normal(size=(COUNT, 3))
    return d / np.linalg.norm(d, axis=1)[:, None]


def close(got, want, bound=4e-15):
    gap = np.reshape(abs(np.subtract(got, want)), (COUNT, -1)).max(axis=1)
    assert (gap <= bound).all(), (gap / bound).max()


def dot(a, b):
    return np.einsum("ni,ni->n", a, b)


def of(R, v):
    """The matrices times the vectors."""
    return np.einsum("nij,nj->ni", R, v)


def test_rotations_are_a_group():
    """Closure, identity, inverses, conjugation; subgroups of one axis; the transform of Cayley turns about the mean."""
    a, b, d = RNG.permutation(TURNS)[:, None] * directions(), TURNS[:, None] * directions(), directions()
    R, S, C, sizes = rotations.exp(a), rotations.exp(b), rotations.cayley(a), 1 + abs(TURNS)
    assert rotations.is_rotation([R @ S, C @ rotations.cayley(b)], tolerance=4e-15).all()
    assert_array_equal(rotations.exp(0 * a)[0], np.eye(3))
    for kernel in (rotations.exp, rotations.cayley, rotations.dexp):
        assert_array_equal(kernel(-a), kernel(a).mT)
    close(R @ S @ R.mT, rotations.exp(of(R, b)), 4e-15 * sizes)
    close(R @ rotations.hat(b) @ R.mT, rotations.hat(of(R, b)), 4e-15 * sizes)
    close(S @ rotations.exp(-0.3 * b), rotations.exp(0.7 * b), 4e-15 * (1 + 1.3 * abs(TURNS)))
    assert (np.linalg.norm(rotations.log(R @ S), axis=1) <= np.pi * (1 + 1e-15)).all()
    close(rotations.exp(rotations.log(R @ S)), R @ S)
    close(of(C, d) - d, np.cross(a, (of(C, d) + d) / 2), 4e-15 * (1 + np.linalg.norm(a, axis=1)))


def test_geodesics_and_transport_keep_distances_and_angles_and_commute_with_rotations():
    d0, d, c = directions(), directions(), directions()
    v, a, b = sphere.log(d0, d), *(sphere.project(d0, directions()) for _ in "ab")
    R, s, magnified = (
        rotations.exp(TURNS[:, None] * directions()),
        RNG.uniform(0.01, 0.99, COUNT),
        1e-14 / np.linalg.norm(d0 + d, axis=1),
    )
    whole, point = sphere.distance(d0, d), sphere.geodesic(d0, v, s)
    assert sphere.in_tangent_bundle(d0, v, tolerance=4e-15).all()
    assert sphere.on_sphere(sphere.exp(d0, TURNS[:, None] * a), tolerance=2e-15).all()
    close(np.linalg.norm(v, axis=1), whole, 1e-15)
    close(sphere.distance(d, d0), whole, 1e-15)
    assert not sphere.distance(c, c).any()
    assert (sphere.distance(d0, c) <= whole + sphere.distance(d, c) + 2e-15).all()
    close(sphere.distance(d0, point), s * whole)
    close(sphere.distance(point, d), (1 - s) * whole)
    moved, other = sphere.transport(d0, d, a), sphere.transport(d0, d, b)
    close(dot(moved, other), dot(a, b))
    close(dot(d, np.cross(moved, other)), dot(d0, np.cross(a, b)))  # nor is the orientation changed
    close(sphere.transport(d, d0, moved), a)
    close(sphere.transport(d0, d, v), -sphere.log(d, d0), magnified)
    close(sphere.transport(point, d, sphere.transport(d0, point, a)), moved, magnified)
    ends = of(R, d0), of(R, d)
    close(of(R, v), sphere.log(*ends), magnified)
    close(of(R, moved), sphere.transport(*ends, sphere.project(ends[0], of(R, a))), magnified)


def test_projections_and_splits():
    d, a, b = directions(), directions(), directions()
    w = sphere.project(d, a)
    close(sphere.project(d, w), w, 4e-16)
    close(dot(w, b), dot(a, sphere.project(d, b)))
    close(
        dot(w, d), 0 * w[:, 0], 4e-16 * np.linalg.norm(w, axis=1) + 1.4e-30
    )  # the second pass leaves what is along d of its own
    R = rotations.exp(TURNS[:, None] * directions())
    perp, parallel = sphere.split_tensor(R, d, of(R, d))
    close(perp + parallel, R)
    close(of(parallel, d), of(R, d))
    close(of(perp, d), 0 * d)
