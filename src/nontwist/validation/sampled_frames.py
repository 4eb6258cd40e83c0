"""Non-twisting frames of sampled directors, holonomy, solid angles.

On a path with the colatitude θ(t) and the longitude φ(t), a vector that is transported without twist turns relative to
south and east by -∫ φ' cos θ dt. This integral, here by Gauss quadrature, gives every frame below in closed form.
Frames of order 4 refer to the smooth path through the samples; those of order 2, `holonomy` and `solid_angle` refer to
the geodesic polygon of the samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Literal

import numpy as np

from .. import exact
from ..geometry.arrays import Array
from ..geometry.curves import frame_along, frame_of_curve
from ..geometry.frames import closed_frame, holonomy, nontwisting_frame, solid_angle
from .checks import Check
from .problems import all_are, error, order, turns_apart

BISHOP, REFLECTION, GIRARD = "Bishop 1975; eq-non-twisting", "Wang, Jüttler, Zheng & Liu 2008", "Girard, Gauss–Bonnet"
TRANSPORT = "eq-parallel-transport-2-sphere"
ORDERS: tuple[Literal[2, 4], ...] = (2, 4)
COUNTS = (160, 320, 640, 1280)
GAUSS = np.polynomial.legendre.leggauss(10)


def sphere(theta: Array, phi: Array) -> tuple[Array, Array, Array]:
    """Return the unit vectors south, east and outwards at a colatitude and a longitude."""
    c, s, o = np.cos(theta), np.sin(theta), np.zeros_like(phi)
    south = np.stack([c * np.cos(phi), c * np.sin(phi), -s], axis=-1)
    east = np.stack([-np.sin(phi), np.cos(phi), o], axis=-1)
    return south, east, np.cross(south, east)


def path(t: Array) -> tuple[Array, Array]:
    """Return θ and φ of the path of the order tests."""
    return 1 + 0.4 * np.sin(3 * t), 2 * t + 0.3 * np.cos(t)


def turning(t: Array) -> Array:
    """Return φ' cos θ on that path."""
    rate: Array = (2 - 0.3 * np.sin(t)) * np.cos(path(t)[0])
    return rate


def transported(t: Array) -> Array:
    """Return d1 on that path, transported from the direction south at the first of the times `t`."""
    south, east, _ = sphere(*path(t))
    angle = -integral(turning, t)[:, None]
    d1: Array = np.cos(angle) * south + np.sin(angle) * east
    return d1


def integral(f: Callable[[Array], Array], t: Array) -> Array:
    """Return ∫ f from t[0] to each of `t`, along the first axis."""
    x, weights = GAUSS
    half = np.diff(t)[:, None] / 2
    inside = np.moveaxis(f((t[1:] + t[:-1])[:, None] / 2 + half * x), 1, -1) @ weights
    parts = (half[:, 0] * inside.T).T
    return np.concatenate([np.zeros_like(parts[:1]), np.cumsum(parts, axis=0)])


def orders() -> Iterator[Check]:
    """Measure the orders of frames on even and uneven samples, and of double reflection on a curve."""
    for k, tolerance in zip(ORDERS, (0.02, 0.1), strict=True):
        for name, spacing in {"even samples": (1.0,), "steps 1:2:4": (1.0, 2.0, 4.0)}.items():
            errors = []
            for n in COUNTS:
                steps = np.resize(spacing, n)
                t = np.append(0.0, 3 * np.cumsum(steps) / steps.sum())
                d1 = transported(t)
                frames = nontwisting_frame(sphere(*path(t))[2], d1[0], order=k)
                errors.append(np.linalg.norm(frames[:, 0] - d1, axis=1).max())
            yield order(f"frames of order {k}, {name}", k, COUNTS, errors, tolerance, BISHOP)
    errors = []
    for n in COUNTS:
        t = np.linspace(0, 3, n + 1)
        d1, tangents = transported(t), sphere(*path(t))[2]
        curve = integral(lambda s: sphere(*path(s))[2], t)
        errors.append(np.linalg.norm(frame_of_curve(curve, tangents, d1[0])[:, 0] - d1, axis=1).max())
    yield order("frames of a curve, double reflection", 4, COUNTS, errors, 0.1, REFLECTION)


def closed_paths() -> Iterator[Check]:
    """Go around latitude circles and the octant."""
    n = 2001
    for theta in (0.3, 1.0, 1.9, 2.7):
        phi = 2 * np.pi * np.arange(n) / n
        d3, circle = sphere(np.full_like(phi, theta), phi)[2], f"circle of colatitude {theta:g}"
        cap = 2 * np.pi * (1 - np.cos(theta))
        polygon = 2 * np.pi - 2 * n * np.arctan(np.cos(theta) * np.tan(np.pi / n))
        gap = turns_apart(closed_frame(d3)[1], cap)
        yield error(f"{circle}: turn of frames of order 4, rad", gap, 1e-11, BISHOP, "closed form")
        turns = np.array([closed_frame(d3, order=2)[1], holonomy(d3), exact.polygon_turn(d3)])
        gap = turns_apart(turns, polygon)
        yield error(f"{circle}, polygon of {n} sides: turn, rad", gap, 1e-11, GIRARD, "closed form")
        gap = np.array([float(solid_angle(d3, pole=(0, 0, 1))) - polygon, float(exact.latitude_turn(theta)) - cap])
        yield error(f"{circle}: solid angles of polygon and cap, sr", gap, 1e-12, GIRARD, "closed form")
    corners = np.eye(3)
    turns = np.array([f(corners) for f in (holonomy, solid_angle, exact.polygon_turn)])
    turns = np.append(turns, closed_frame(corners, order=2)[1])
    yield all_are("octant: turn, four ways, rad", np.pi / 2, turns, 1e-13, GIRARD, "closed form")
    d1 = nontwisting_frame(np.concatenate([corners, corners[:1]]), order=2)[:, 0]
    gap = np.cross(d1[0], d1[-1]) - corners[0]
    yield error("octant: d1 transported around, a quarter turn", gap, 1e-13, TRANSPORT, "closed form")


def long_paths() -> Iterator[Check]:
    """Follow a path of 10⁶ samples."""
    d3 = sphere(*path(np.linspace(0, 300, 10**6)))[2]
    for k in ORDERS:
        frames = nontwisting_frame(d3, order=k)
        gram = frames @ frames.mT - np.eye(3)
        yield error(f"frames of order {k}, 10⁶ samples: orthonormality", gram, 1e-14, "eq-non-twisting", "invariant")


def smooth_paths() -> Iterator[Check]:
    """Follow a great circle six times around, and transport a frame along a function instead of samples."""
    t = np.linspace(0, 40, 5001)
    south, _, d3 = sphere(t, np.full_like(t, 0.3))
    gap = nontwisting_frame(d3, south[0])[:, 0] - south
    yield error("great circle, six times around: d1", gap, 1e-13, TRANSPORT, "closed form")
    t = np.linspace(0, 3, 7)
    d1 = transported(np.linspace(0, 3, 601))[::100]
    gap = frame_along(lambda s: sphere(*path(np.array(s)))[2], t, d1[0], rtol=1e-10)[:, 0] - d1
    yield error("frame along a function, rtol = 1e-10: d1", gap, 1e-9, BISHOP, "closed form")


CHECKS = (orders, closed_paths, long_paths, smooth_paths)
