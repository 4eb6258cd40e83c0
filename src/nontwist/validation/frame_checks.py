"""Validation of rotations, the unit sphere, non-twisting frames and twist.

**geometry**: The formulas of sec-geometry on random points of S² and SO(3), each compared with an independent formula.

The tolerance is 8 ulp of 1 for one map, and 16 for an identity of two maps or two implementations. exp and log of SO(3)
are compared with those of SciPy; dexp(θ) = ∫ exp(s θ̂) ds with Gauss quadrature of the integral, 24 nodes; Cayley's map
with a linear solver. On S² the checks are identities: exp inverts log, transport preserves lengths, and transport
around a geodesic triangle turns a vector by the area of the triangle, here computed from its sides (L'Huilier).

**frames**: Non-twisting frames of sampled directors, holonomy, solid angles.

On a path with the colatitude θ(t) and the longitude φ(t), a vector that is transported without twist turns relative to
south and east by -∫ φ' cos θ dt. This integral, here by Gauss quadrature, gives every frame below in closed form.
Frames of order 4 refer to the smooth path through the samples; those of order 2, `holonomy` and `solid_angle` refer to
the geodesic polygon of the samples.

**twist**: The twist of known motions, and how it differs from the swing–twist angle.

A triad given by ZYZ angles (φ, θ, χ) twists about its own z axis by ψ = ∫ (χ' + φ' cos θ) dt, here by Gauss quadrature.
The swing–twist angle τ of the rotation since the start differs from ψ by the solid angle Ω of the path of the axis,
closed by a great circle: τ - ψ = Ω modulo 2π.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from .. import exact
from ..driver.runs import simulate
from ..geometry import rotations, sphere
from ..geometry.arrays import Array
from ..geometry.curve_frames import frame_along, frame_of_curve
from ..geometry.frames import closed_frame, holonomy, nontwisting_frame, solid_angle
from ..loads import sine
from ..recordings.twisting import twist
from .checks import Check
from .problems import SAMPLES, all_are, error, order, spun, turns_apart

COUNT, I3 = 2000, np.eye(3)
ONE_MAP, TWO_MAPS = 8 * np.finfo(float).eps, 16 * np.finfo(float).eps
TRANSPORT = "eq-parallel-transport-2-sphere"


def rotation_vectors(rng: np.random.Generator) -> Array:
    """Return random rotation vectors, rad, their lengths spread from 1e-9 to π."""
    lengths = np.append(10 ** rng.uniform(-9, 0, COUNT // 2), rng.uniform(1, np.pi, COUNT // 2))
    return points(rng) * lengths[:, None]


def rotation_group() -> Iterator[Check]:
    """Check exp, log, dexp and Cayley's map of SO(3)."""
    theta = rotation_vectors(np.random.default_rng(1))
    R, scale = rotations.exp(theta), np.linalg.norm(theta, axis=1)[:, None]
    gap = R - Rotation.from_rotvec(theta).as_matrix()
    yield error("SO(3): exp against SciPy", gap, TWO_MAPS, "eq-rodrigues", "independent")
    gap = (rotations.log(R) - theta) / scale
    yield error("SO(3): log(exp(θ)) - θ over |θ|", gap, TWO_MAPS, "eq-rodrigues", "invariant")
    gap = [R.mT @ R - I3, R @ rotations.exp(-theta) - I3]
    yield error("SO(3): RᵀR - I and exp(θ) exp(-θ) - I", gap, TWO_MAPS, "eq-sothree", "invariant")
    x, weights = np.polynomial.legendre.leggauss(24)
    gap = rotations.dexp(theta) - np.einsum(
        "k,knij->nij", weights / 2, rotations.exp((x[:, None, None] + 1) / 2 * theta)
    )
    yield error("SO(3): dexp against the integral of exp(s θ̂)", gap, ONE_MAP, "eq-dexp", "closed form")
    gap = rotations.dexp(theta) @ rotations.dexp_inverse(theta) - I3
    yield error("SO(3): dexp dexp⁻¹ - I", gap, TWO_MAPS, "eq-dexp", "invariant")
    half = rotations.hat(theta) / 2
    gap = rotations.cayley(theta) - np.linalg.solve(I3 - half, I3 + half)
    source = "Hairer, Lubich & Wanner, IV.8.3"
    yield error("SO(3): Cayley against (I - ŵ/2)⁻¹ (I + ŵ/2)", gap, ONE_MAP, source, "closed form")


def derivative() -> Iterator[Check]:
    """Check the derivative of exp by Richardson's extrapolation of central differences."""
    rng = np.random.default_rng(2)
    theta, rate = rng.normal(size=(2, COUNT, 3))

    def difference(e: float) -> Array:
        return (rotations.exp(theta + e * rate) - rotations.exp(theta - e * rate)) / (2 * e)

    numeric = (64 * difference(1e-2) - 20 * difference(2e-2) + difference(4e-2)) / 45
    spin = rotations.hat(np.einsum("nij,nj->ni", rotations.dexp(theta), rate))
    gap = numeric - spin @ rotations.exp(theta)
    yield error("SO(3): exp(θ)' - hat(dexp(θ) θ') exp(θ)", gap, 1e-8, "eq-dexp", "independent")


def sphere_maps() -> Iterator[Check]:
    """Check exp, log and parallel transport on S²."""
    rng = np.random.default_rng(3)
    a, b, c = points(rng), points(rng), points(rng)
    gap = sphere.exp(a, sphere.log(a, b)) - b
    yield error("S²: exp(log(d)) - d", gap, TWO_MAPS, "eq-exp-2-sphere", "invariant")
    v = sphere.project(a, rng.normal(size=(COUNT, 3)))
    w = sphere.transport(a, b, v)
    gap = np.append(np.linalg.norm(w, axis=1) / np.linalg.norm(v, axis=1) - 1, np.sum(w * b, axis=1))
    yield error("S²: transport keeps lengths and stays tangent", gap, TWO_MAPS, TRANSPORT, "invariant")
    back = sphere.transport(c, a, sphere.transport(b, c, w))
    turn = np.arctan2(np.sum(np.cross(v, back) * a, axis=1), np.sum(v * back, axis=1))
    sides = np.array([sphere.distance(p, q) for p, q in ((b, c), (c, a), (a, b))])
    s, volume = sides.sum(0) / 2, np.sum(a * np.cross(b, c), axis=1)
    fat = abs(volume) > 0.01  # L'Huilier's root loses digits where one side is nearly the sum of the others
    root = np.sqrt((np.tan(s / 2) * np.tan((s - sides) / 2).prod(0))[fat])
    gap = turns_apart(turn[fat], 4 * np.arctan(root) * np.sign(volume[fat]))
    yield error("S²: transport around triangles turns by their area", gap, 1e-12, "subs-stwo", "closed form")


def covariant_derivative() -> Iterator[Check]:
    """Transport a field along the circle of colatitude θ: it turns by cos θ a radian of longitude."""
    t, theta = np.linspace(0, 1, 401), 0.7
    south, east, d3 = triad_at(np.full_like(t, theta), t)
    turn = np.cos(theta) * t[:, None]
    parallel = np.cos(turn) * south - np.sin(turn) * east
    gap = sphere.covariant_derivative(d3, parallel, t)
    yield error("S²: covariant derivative of a parallel field", gap, 1e-9, "eq-cov-projection", "closed form")


def darboux_vector() -> Iterator[Check]:
    """Check the angular velocity of a triad with a given twist rate: w × d3 = d3', w·d3 = ψ'."""
    rng = np.random.default_rng(4)
    d3, psi_dot = points(rng), rng.normal(size=COUNT)
    rate = sphere.project(d3, rng.normal(size=(COUNT, 3)))
    w = rotations.darboux_vector(d3, rate, psi_dot)
    gap = np.append(np.cross(w, d3) - rate, np.sum(w * d3, axis=1) - psi_dot)
    yield error("Darboux vector: w × d3 - d3' and w·d3 - ψ', rad/s", gap, TWO_MAPS, "eq-w_twist", "closed form")


def points(rng: np.random.Generator) -> Array:
    """Return random points of the sphere."""
    d = rng.normal(size=(COUNT, 3))
    return d / np.linalg.norm(d, axis=1)[:, None]


BISHOP, REFLECTION, GIRARD = "Bishop 1975; eq-non-twisting", "Wang, Jüttler, Zheng & Liu 2008", "Girard, Gauss–Bonnet"
ORDERS: tuple[Literal[2, 4], ...] = (2, 4)
COUNTS = (160, 320, 640, 1280)
GAUSS = np.polynomial.legendre.leggauss(10)


def triad_at(theta: Array, phi: Array) -> tuple[Array, Array, Array]:
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
    return (2 - 0.3 * np.sin(t)) * np.cos(path(t)[0])


def transported(t: Array) -> Array:
    """Return d1 on that path, transported from the direction south at the first of the times `t`."""
    south, east, _ = triad_at(*path(t))
    angle = -integral(turning, t)[:, None]
    return np.cos(angle) * south + np.sin(angle) * east


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
                frames = nontwisting_frame(triad_at(*path(t))[2], d1[0], order=k)
                errors.append(np.linalg.norm(frames[:, 0] - d1, axis=1).max())
            yield order(f"frames of order {k}, {name}", k, COUNTS, errors, tolerance, BISHOP)
    errors = []
    for n in COUNTS:
        t = np.linspace(0, 3, n + 1)
        d1, tangents = transported(t), triad_at(*path(t))[2]
        curve = integral(lambda s: triad_at(*path(s))[2], t)
        errors.append(np.linalg.norm(frame_of_curve(curve, tangents, d1[0])[:, 0] - d1, axis=1).max())
    yield order("frames of a curve, double reflection", 4, COUNTS, errors, 0.1, REFLECTION)


def closed_paths() -> Iterator[Check]:
    """Go around latitude circles and the octant."""
    n = 2001
    for theta in (0.3, 1.0, 1.9, 2.7):
        phi = 2 * np.pi * np.arange(n) / n
        d3, circle = triad_at(np.full_like(phi, theta), phi)[2], f"circle of colatitude {theta:g}"
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
    d3 = triad_at(*path(np.linspace(0, 300, 10**6)))[2]
    for k in ORDERS:
        frames = nontwisting_frame(d3, order=k)
        gram = frames @ frames.mT - np.eye(3)
        yield error(f"frames of order {k}, 10⁶ samples: orthonormality", gram, 1e-14, "eq-non-twisting", "invariant")


def smooth_paths() -> Iterator[Check]:
    """Follow a great circle six times around, and transport a frame along a function instead of samples."""
    t = np.linspace(0, 40, 5001)
    south, _, d3 = triad_at(t, np.full_like(t, 0.3))
    gap = nontwisting_frame(d3, south[0])[:, 0] - south
    yield error("great circle, six times around: d1", gap, 1e-13, TRANSPORT, "closed form")
    t = np.linspace(0, 3, 7)
    d1 = transported(np.linspace(0, 3, 601))[::100]
    gap = frame_along(lambda s: triad_at(*path(np.array(s)))[2], t, d1[0], rtol=1e-10)[:, 0] - d1
    yield error("frame along a function, rtol = 1e-10: d1", gap, 1e-9, BISHOP, "closed form")


TWIST_COUNTS = (160, 320, 640)


def twist_orders() -> Iterator[Check]:
    """Measure the order of the twist of a motion in ZYZ angles."""
    exact = 4 + integral(turning, np.linspace(0, 2, 41))[-1]
    for k in ORDERS:
        errors = []
        for n in TWIST_COUNTS:
            t = np.linspace(0, 2, n + 1)
            theta, phi = path(t)
            R = Rotation.from_euler("ZYZ", np.stack([phi, theta, t**2], axis=1))
            errors.append(abs(float(twist(R, t, order=k).twist_angle[-1]) - exact))
        yield order(f"twist of order {k}, ZYZ angles", k, TWIST_COUNTS, errors, 0.1, "eq-w_twist")


def codman() -> Iterator[Check]:
    """Raise an arm that hangs sideways, swing it to the front, lower it: no twist, a quarter turn of swing–twist."""
    s, down = np.linspace(0, np.pi / 2, 91), Rotation.from_rotvec([np.pi, 0, 0])
    up = spun(s, [0, -1, 0]) * down
    front = spun(s, [0, 0, 1]) * up[-1]
    back = spun(s, [-1, 0, 0]) * front[-1]
    end = twist(Rotation.concatenate([up, front[1:], back[1:]]), order=2).isel(time=-1)
    yield error("Codman's paradox: twist, rad", float(end.twist_angle), 1e-12, "Codman 1934", "closed form")
    name = "Codman's paradox: swing–twist angle, rad"
    yield all_are(name, -np.pi / 2, end.swing_twist_angle, 1e-12, "Codman 1934", "closed form")


def random_motions() -> Iterator[Check]:
    """Compare τ - ψ with Ω on five random motions, and the twist of a joint with its own turn."""
    gaps, t = [], np.linspace(0, 4, 400)
    f = np.stack([np.sin((k + 1) * 0.7 * t + k) for k in range(3)], axis=1)
    spin = spun(t, [0, 0, 0.3])
    for seed in range(5):
        a, b, n = np.split(np.random.default_rng(seed).normal(size=(7, 3)), [3, 6])
        R = Rotation.from_rotvec(f @ a) * Rotation.from_rotvec(f[::-1] @ b) * Rotation.from_rotvec([0.5, -1, 2])
        found = twist(R, t, axis=n[0])
        gaps.append(turns_apart(found.swing_twist_angle - found.twist_angle, found.solid_angle))
    yield error("τ - ψ - Ω of random motions, rad", gaps, 1e-6, "subs-non-twisting-frame", "invariant")
    gap = twist(R * spin, t, relative_to=R).twist_angle.values - 0.3 * t
    yield error("joint that turns at 0.3 rad/s: relative twist, rad", gap, 1e-12, "eq-w_twist", "closed form")


def runs() -> Iterator[Check]:
    """Measure the twist of simulated bodies: none, and ∫ w·d3 by Simpson's rule."""
    load = sine([3, 2, 0], 0.7)
    run = simulate(SAMPLES["nontwisting"], t_end=3, step=0.005, order=2, angular_velocity=(1, 2, 0), load=load)
    psi = twist(run, order=2).twist_angle.values
    yield error("loaded non-twisting body: twist, rad", psi, 1e-12, "eq-non-twisting", "invariant")
    run = simulate(SAMPLES["standard"], times=np.linspace(0, 3, 1201), angular_velocity=(1, 2, 3), integrator="exact")
    rate = run.twist_rate.values
    simpson = (rate[0] - rate[-1] + np.tile([4.0, 2.0], 600) @ rate[1:]) / 1200
    gap = float(twist(run).twist_angle[-1]) - simpson
    yield error("free standard body: twist less ∫ w·d3, rad", gap, 1e-7, "eq-w_twist", "closed form")


CHECKS = {
    "geometry": (rotation_group, derivative, sphere_maps, covariant_derivative, darboux_vector),
    "frames": (orders, closed_paths, long_paths, smooth_paths),
    "twist": (twist_orders, codman, random_motions, runs),
}
