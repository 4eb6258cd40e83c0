"""The formulas of sec-geometry on random points of S² and SO(3), each compared with an independent formula.

The tolerance is 8 ulp of 1 for one map, and 16 for an identity of two maps or two implementations. exp and log of SO(3)
are compared with those of SciPy; dexp(θ) = ∫ exp(s θ̂) ds with Gauss quadrature of the integral, 24 nodes; Cayley's map
with a linear solver. On S² the checks are identities: exp inverts log, transport preserves lengths, and transport
around a geodesic triangle turns a vector by the area of the triangle, here computed from its sides (L'Huilier).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from ..geometry import rotations, sphere
from ..geometry.arrays import Array
from .checks import Check
from .problems import error, turns_apart

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
        slope: Array = (rotations.exp(theta + e * rate) - rotations.exp(theta - e * rate)) / (2 * e)
        return slope

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
    c, s, o = np.cos(theta), np.sin(theta), np.ones_like(t)
    d3 = np.stack([s * np.cos(t), s * np.sin(t), c * o], axis=1)
    south, east = np.stack([c * np.cos(t), c * np.sin(t), -s * o], axis=1), np.stack([-np.sin(t), np.cos(t), 0 * o], 1)
    parallel = np.cos(c * t)[:, None] * south - np.sin(c * t)[:, None] * east
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
    unit: Array = d / np.linalg.norm(d, axis=1)[:, None]
    return unit


CHECKS = (rotation_group, derivative, sphere_maps, covariant_derivative, darboux_vector)
