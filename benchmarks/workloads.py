"""The motions over [0, 5] s that all tools integrate, and their attitudes at the end, independent of the package.

A: free non-twisting body; B: non-twisting body under a triangular pulse given along the moving directors; C: free
standard body; T: heavy top. Attitudes come from Taylor series in extended precision
of the quaternion form ``p' = p W / 2``, ``J W' = J W × W + M - μ n``, and two orders of them must agree.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from nontwist import DirectorSystem, Load, heavy_top, nontwisting, pulse, standard

Array = np.ndarray[Any, Any]
J = np.array([[3, -1 / 7, 0], [-1 / 7, 4, 0], [0, 0, 5]])
GRAVITY = (0.0, 0.0, -9.81)
AGREE = 1e-14


@dataclass(frozen=True, eq=False)
class Workload:
    """A motion: a body with its inertia J, its start, its moment along the moving directors as a table."""

    key: str
    title: str
    velocity: tuple[float, float, float]  # W at t = 0, rad/s
    has_axis: bool = False  # non-twisting
    knots: tuple[float, ...] = ()
    moments: tuple[tuple[float, float, float], ...] = ()
    mass: float = 0.0
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    t_end: float = 5.0

    @cached_property
    def system(self) -> DirectorSystem:
        """The body for the package."""
        if self.mass:
            return heavy_top(J, self.mass, self.centre, GRAVITY)
        return nontwisting(J) if self.has_axis else standard(J)

    @cached_property
    def load(self) -> Load | None:
        """The load for the package."""
        return pulse(self.moments[1], self.knots[0], self.knots[-1]) if self.knots else None

    @property
    def pieces(self) -> list[tuple[float, float, Array, Array]]:
        """Intervals with the moment ``m0 + t m1`` on each: (start, end, m0, m1)."""
        if not self.knots:
            return [(0.0, self.t_end, np.zeros(3), np.zeros(3))]
        found = []
        for (t0, t1), (m0, m1) in zip(pairwise(self.knots), pairwise(np.array(self.moments)), strict=True):
            slope = (m1 - m0) / (t1 - t0)
            found.append((t0, t1, m0 - slope * t0, slope))
        return [*found, (self.knots[-1], self.t_end, np.zeros(3), np.zeros(3))]

    @cached_property
    def reference(self) -> Array:
        """Λ at t_end, (3, 3)."""
        reference = taylor(self, 30, 250)
        other = taylor(self, 24, 400)
        gap = float(np.linalg.norm(reference - other)) / np.sqrt(2)
        if gap > AGREE:
            raise RuntimeError(f"the references of {self.key} differ by {gap:.2g}")
        return reference

    def error(self, attitude: ArrayLike) -> float:
        """Return ``|Λ - Λ_ref|_F / √2``, rad where it is small."""
        return float(np.linalg.norm(np.asarray(attitude) - self.reference)) / np.sqrt(2)


WORKLOADS = (
    Workload("A", "free non-twisting body", (6.0, -18.0, 0.0), True),
    Workload(
        "B",
        "non-twisting body, pulse along its directors",
        (1.5, 4.5, 0.0),
        True,
        (0.0, 0.5, 1.0),
        ((0.0, 0.0, 0.0), (-61.8125, -26.875, 0.0), (0.0, 0.0, 0.0)),
    ),
    Workload("C", "free standard body", (6.0, -18.0, 1.0)),
    Workload("T", "heavy top", (1.0, -2.0, 6.0), mass=2.0, centre=(0.1, 0.2, 0.5)),
)


def workload(key: str) -> Workload:
    """Return the workload of a key."""
    return next(w for w in WORKLOADS if w.key == key)


def attitude(p: ArrayLike) -> Array:
    """Return Λ of a quaternion, scalar first, of any length, with which an array may begin."""
    found: Array = Rotation.from_quat(np.asarray(p, dtype=float)[:4], scalar_first=True).as_matrix()
    return found


def inverse(A: Array) -> Array:
    """Return the inverse of a symmetric (3, 3) array, in its own precision."""
    cofactors = np.array([np.cross(A[1], A[2]), np.cross(A[2], A[0]), np.cross(A[0], A[1])])
    return cofactors / (A[0] @ cofactors[0])


def rates(w: Workload) -> Callable[..., tuple[Any, ...]]:
    """Return ``f(p0, p1, p2, p3, W1, W2, W3, M1, M2, M3) -> (p', W')`` on scalars of any kind.

    Without W3, M3 and W3' for the non-twisting body.
    """
    (a, b, c), (_, d, e), (_, _, f) = J.tolist()
    if w.has_axis:
        (k11, k12), (_, k22) = np.linalg.inv(J[:2, :2]).tolist()

        def nontwisting(p0: Any, p1: Any, p2: Any, p3: Any, W1: Any, W2: Any, M1: Any, M2: Any) -> tuple[Any, ...]:
            return (
                -0.5 * (p1 * W1 + p2 * W2),
                0.5 * (p0 * W1 - p3 * W2),
                0.5 * (p0 * W2 + p3 * W1),
                0.5 * (p1 * W2 - p2 * W1),
                k11 * M1 + k12 * M2,
                k12 * M1 + k22 * M2,
            )

        return nontwisting

    (k11, k12, k13), (_, k22, k23), (_, _, k33) = inverse(J).tolist()
    heavy = w.mass > 0
    c1, c2, c3 = (w.mass * -GRAVITY[2] * x for x in w.centre)

    def free(
        p0: Any, p1: Any, p2: Any, p3: Any, W1: Any, W2: Any, W3: Any, M1: Any, M2: Any, M3: Any
    ) -> tuple[Any, ...]:
        P1, P2, P3 = a * W1 + b * W2 + c * W3, b * W1 + d * W2 + e * W3, c * W1 + e * W2 + f * W3
        T1, T2, T3 = P2 * W3 - P3 * W2 + M1, P3 * W1 - P1 * W3 + M2, P1 * W2 - P2 * W1 + M3
        if heavy:
            n1, n2, n3 = 2.0 * (p0 * p2 - p1 * p3), -2.0 * (p2 * p3 + p0 * p1), 2.0 * (p1 * p1 + p2 * p2) - 1.0
            T1, T2, T3 = T1 + c2 * n3 - c3 * n2, T2 + c3 * n1 - c1 * n3, T3 + c1 * n2 - c2 * n1
        return (
            -0.5 * (p1 * W1 + p2 * W2 + p3 * W3),
            0.5 * (p0 * W1 + p2 * W3 - p3 * W2),
            0.5 * (p0 * W2 + p3 * W1 - p1 * W3),
            0.5 * (p0 * W3 + p1 * W2 - p2 * W1),
            k11 * T1 + k12 * T2 + k13 * T3,
            k12 * T1 + k22 * T2 + k23 * T3,
            k13 * T1 + k23 * T2 + k33 * T3,
        )

    return free


def taylor(w: Workload, order: int, steps: int) -> Array:
    """Return Λ at t_end by Taylor series in extended precision, `steps` over the whole time."""
    real = np.longdouble
    J_, n = w.system.convected_inertia.astype(real), np.array([0, 0, 1], dtype=real)
    K = inverse(J_)
    if w.has_axis:
        K = K - np.outer(K @ n, K @ n) / (n @ K @ n)
    force = w.system.dead_force.astype(real)
    p, W = np.zeros((order + 1, 4), dtype=real), np.zeros((order + 1, 3), dtype=real)
    p[0], W[0] = (1, 0, 0, 0), w.velocity

    def one(m0: Array, m1: Array, h: Any) -> None:
        for k in range(order):
            past, back = slice(0, k + 1), slice(k, None, -1)
            a, b = p[past], W[back]
            dp = np.append(-(a[:, 1:] * b).sum(), (a[:, :1] * b + np.cross(a[:, 1:], b)).sum(0)) / 2
            torque = np.cross(W[past] @ J_, b).sum(0) + (m0 if k == 0 else m1 if k == 1 else 0)
            if w.mass:
                c = a.T @ p[back]  # products p_i p_j
                R = np.array(
                    [
                        [c[0, 0] + c[1, 1] - c[2, 2] - c[3, 3], 2 * (c[1, 2] - c[0, 3]), 2 * (c[1, 3] + c[0, 2])],
                        [2 * (c[1, 2] + c[0, 3]), c[0, 0] - c[1, 1] + c[2, 2] - c[3, 3], 2 * (c[2, 3] - c[0, 1])],
                        [2 * (c[1, 3] - c[0, 2]), 2 * (c[2, 3] + c[0, 1]), c[0, 0] - c[1, 1] - c[2, 2] + c[3, 3]],
                    ]
                )
                G = force @ R  # rows: the forces in the body
                torque = torque + np.array([G[1, 2] - G[2, 1], G[2, 0] - G[0, 2], G[0, 1] - G[1, 0]])
            p[k + 1], W[k + 1] = dp / (k + 1), K @ torque / (k + 1)
        powers = real(h) ** np.arange(order + 1)
        p[0], W[0] = powers @ p, powers @ W

    for t0, t1, m0, m1 in w.pieces:
        count = max(1, round(steps * (t1 - t0) / w.t_end))
        h = real(t1 - t0) / count
        for k in range(count):
            one((m0 + m1 * (t0 + k * h)).astype(real), m1.astype(real), h)
    return attitude(p[0]).astype(float)
