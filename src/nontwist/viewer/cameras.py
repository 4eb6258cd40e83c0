"""Where a scene is seen from: the side of the paths, and from above the horizon where there is a vertical."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..geometry.arrays import Array

if TYPE_CHECKING:
    from .drawing import Motion

AZIMUTH, ELEVATION = 0.61, 0.42  # rad
LOWEST, HIGHEST = 0.2, 0.7  # rad: elevations from which a vertical is seen as one
ONE_SIDED = 0.3  # length of the mean of points on the unit sphere from which on they are on one side
PLANE = 0.1  # of the squares of horizontal distances: the part across a vertical plane, at most


class Camera(NamedTuple):
    """Azimuth and elevation, rad, in upright axes: rows, the third of which is up on the picture."""

    azimuth: float
    elevation: float
    upright: Array = np.eye(3)

    def view(self) -> Array:
        """Return right, up and towards the reader, rows."""
        a, e = self.azimuth, self.elevation
        ca, sa, ce, se = np.cos(a), np.sin(a), np.cos(e), np.sin(e)
        view: Array = np.array([[-sa, ca, 0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]]) @ self.upright
        return view


def camera_of(motions: list[Motion]) -> Camera:
    """Return the camera that is not chosen by the user.

    It is on the side where the paths are, if they are on one. Up is z, or, of bodies that weigh, opposite to gravity;
    then it is above the horizon, and across the plane in which a pendulum swings.
    """
    down = next((motion.down for motion in motions if motion.down is not None), None)
    upright = np.eye(3) if down is None else _turned_up(-down)
    points = np.concatenate([motion.path for motion in motions]) @ upright.T
    x, y, z = points.mean(0)
    azimuth, elevation = AZIMUTH, ELEVATION
    if np.hypot(np.hypot(x, y), z) > ONE_SIDED:
        azimuth = np.arctan2(y, x) + 0.4
        elevation = np.clip(np.arctan2(z, np.hypot(x, y)) - 0.3, -1.2, 1.2)
    if down is not None:
        elevation = np.clip(elevation, LOWEST, HIGHEST)
        azimuth = _across(points[:, :2], azimuth)
    return Camera(float(azimuth), float(elevation), upright)


def _turned_up(up: Array) -> Array:
    """Return the smallest rotation that turns `up` to z, as a matrix; about x where it is opposite."""
    from scipy.spatial.transform import Rotation

    axis, angle = np.cross(up, [0.0, 0.0, 1.0]), np.arctan2(np.hypot(up[0], up[1]), up[2])
    size = np.linalg.norm(axis)
    if size == 0:
        return np.eye(3) if up[2] > 0 else np.diag([1.0, -1.0, -1.0])
    turned: Array = Rotation.from_rotvec(angle / size * axis).as_matrix()
    return turned


def _across(flat: Array, otherwise: float) -> float:
    """Return the azimuth that looks across the vertical plane of a path; `otherwise` where it is in none."""
    mean = flat.mean(0)
    spread, directions = np.linalg.eigh((flat - mean).T @ (flat - mean) / len(flat))
    normal = directions[:, 0]
    if max(spread[0], (mean @ normal) ** 2) > PLANE * spread[1]:
        return otherwise
    normal = normal * np.sign(normal @ [np.cos(AZIMUTH), np.sin(AZIMUTH)])
    return float(np.arctan2(normal[1], normal[0])) + 0.3
