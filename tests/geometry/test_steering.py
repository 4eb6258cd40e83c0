"""The shortest motions without twist reach their targets, and no other motion without twist is shorter."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nontwist import rotations, steer, twist

RNG = np.random.default_rng(5)
EYE = np.eye(3)


def targets():
    """Attitudes of all kinds: at random, near none, near turns about d3, near turns of π, near both."""
    found = list(Rotation.random(60, rng=RNG))
    for _ in range(30):
        small = 10.0 ** RNG.uniform(-17, 0, 4)
        any_, about = RNG.normal(size=(2, 3))
        found += [
            Rotation.from_rotvec(any_ * small[:3]),
            Rotation.from_rotvec(any_ * small[0] + [0, 0, RNG.uniform(-np.pi, np.pi)]),
            Rotation.from_rotvec((np.pi - small[0]) * about / np.linalg.norm(about)),
            Rotation.from_rotvec((np.pi - small[0]) * (flat := about * [1, 1, small[1]]) / np.linalg.norm(flat)),
        ]
    return found


def test_targets_are_reached():
    start = Rotation.from_rotvec([1, -2, 0.5])
    for R in targets():
        way = steer(start, start * R)
        ends = way.rotation([0, 1])
        assert (ends[0].inv() * start).magnitude() < 1e-15
        assert (ends[1].inv() * start * R).magnitude() < 1e-13


def test_twist_and_length():
    t = np.linspace(0, 1, 2001)
    for R in Rotation.random(2, rng=RNG):
        way = steer(EYE, R)
        motion = way.rotation(t)
        W = way.material_angular_velocity(t)
        assert abs(W[:, 2]).max() == 0
        assert abs(np.linalg.norm(W, axis=1) - way.length).max() < 1e-13 * way.length
        found = twist(motion, t)
        assert abs(found.twist_angle).max() < 1e-9
        assert abs(found.path_length[-1] - way.length) < 1e-5
        seen = (motion[:-1].inv() * motion[1:]).as_rotvec() / np.diff(t)[:, None]
        assert abs(seen - (W[1:] + W[:-1]) / 2).max() < 1e-5 * way.length**3
        d3 = motion.as_matrix()[:, :, 2]
        centre = np.sin(way.radius) * way.direction + np.cos(way.radius) * EYE[2]
        assert abs(d3 @ centre - np.cos(way.radius)).max() < 1e-14


def test_shortest_without_twist():
    """Of motions in a few pieces, each with a fixed axis across d3."""
    for _ in range(150):
        angles, directions = RNG.uniform(0, 2.5, 4), RNG.uniform(0, 2 * np.pi, 4)
        R = Rotation.identity()
        for angle, phi in zip(angles, directions, strict=True):
            R = R * Rotation.from_rotvec(angle * np.array([np.cos(phi), np.sin(phi), 0]))
        assert steer(EYE, R).length <= angles.sum() + 1e-13


@pytest.mark.parametrize("angle", [1e-300, 1e-12, 0.1, 1, 2, np.pi, -0.5, -np.pi])
def test_turns_about_the_axis(angle):
    way = steer(EYE, rotations.exp([0, 0, angle]))
    assert way.length == pytest.approx(np.sqrt(abs(angle) * (4 * np.pi - abs(angle))), rel=1e-14)
    assert way.direction.tolist() == [1, 0, 0]
    assert np.sign(way.curvature) == np.sign(angle)


def test_turns_across_the_axis():
    for angle in (0.1, 1.0, 3.0, np.pi):
        way = steer(EYE, rotations.exp([0, angle, 0]))
        assert way.length == pytest.approx(angle, rel=1e-15)
        assert way.radius == pytest.approx(np.pi / 2, rel=1e-15)
        assert abs(way.direction - [0, 1, 0]).max() < 1e-15
    nothing = steer(EYE, EYE)
    assert (nothing.length, nothing.curvature) == (0, pytest.approx(0, abs=1e-16))
    assert nothing.rotation([0, 0.5]).magnitude().max() == 0


def test_what_is_refused():
    way = steer(EYE, rotations.exp([0, 1, 0]))
    for function in (way.rotation, way.material_angular_velocity):
        with pytest.raises(ValueError, match=r"^fraction must be from 0 to 1, got numbers from 0 to 1\.5$"):
            function([0, 1.5])
    with pytest.raises(ValueError, match="rotation"):
        steer(EYE, np.ones((3, 3)))
