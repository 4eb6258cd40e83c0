"""Terms that are forces on the directors: those that are given, and those of potentials.

**Director forces**, the generalised load Q = (f¹, f², f³) of the paper, do the virtual work ``δW = Σ f^i·δd_i``.
Rotations ``δd_i = δθ × d_i`` see their moment Σ d_i × f^i alone; the director form sees all of them, and what has no
moment changes its multipliers λ.

**Potentials** of space vectors seen from the body, γ = Λᵀa, count as energy, not as work. V depends on the
attitude through γ_j = a·d_j, three numbers for each vector, so the director d_j bears the force
``-a ∂V/∂γ_j``. A load that is a potential can be added, scaled and swept like any other, may be a function, and is
recorded as loads are, by its data or its name. In a run V belongs to the energy: it is in `potential_energy`, its
moment not in `moment`, its work not in `load_work`.

A linear potential is a dead force, and is marched as one (`integrators.load_samples.as_marched`).

**Where a body is on an elliptic orbit.** Kepler's equation: the eccentric anomaly E belongs to the mean one M by ``f(E)
= E - e sin E - M = 0``, 0 <= e < 1. In the plane, perigee first, radius and distance over the major half-axis are

    r/a = (cos E - e, sqrt(1 - e²) sin E),        |r|/a = 1 - e cos E = 1 - e + 2e sin²(E/2).

Newton's iteration. E is odd and ``E - M`` has the period 2π, so let 0 <= M <= π; then f' >= 1 - e > 0 and f'' = e sin E
>= 0 on [0, π]. M + e, M/(1 - e) and π bound the solution: f >= 0 there, as sin E <= 1, sin E <= E, and f(π) = π - M.
From the least of them each iterate of a convex growing function lies between the solution and the one before, so the
iterates fall, each at least to 2/3 of its distance (f near cubic, e near 1) and quadratically in the end, until f is 0
up to the round-off of its terms: after at most 32 iterations for any e that is a double, 3 to 5 up to e = 0.9. One more
on the numbers as they are, with derivatives or without, gives derivatives by M and e.

The moment of the gravity gradient, 3 n² (a/|r|)³ c × J c, is that of a circular orbit whose vector c has the length
(a/|r|)^{3/2}; n = sqrt(GM/a³).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

import numpy as np

from ..geometry.arrays import Array, dot
from ..geometry.values import vector_text
from ..kernels.control import Variables, whilst
from ..kernels.dual import Dual, plain, tangent
from ..kernels.elements import any_of, copysign, cos, floor, larger, sin, smaller, sqrt
from ..kernels.vectors import Matrix, Vector
from ..spec import Spec
from .functions import Call, array, checked, differentiated, state
from .terms import ForceTerm, Frame, Record, Tabulated, along, function_in_words

SPACE_AND_BODY = 18  # numbers of a node: forces in space, then along the directors


class DirectorForces(ForceTerm):
    """A term of kind "forces": three forces on the directors, from the time and the state.

    A subclass has the text ``forces(t, directors, angular_velocity)``, which returns them in space, a row for each.
    """

    kind = "forces"


@dataclass(frozen=True, eq=False)
class ForceTable(Tabulated, DirectorForces):
    """Forces on the three directors, linear between its times and zero outside."""

    in_kernels = True
    forces_of: Annotated[Array, Spec("the forces on d1, d2, d3", option="values", unit="N m", shape=("times", 3, 3))]
    times: Annotated[Array, Spec("", unit="s", shape=(None,), rule="increasing", is_fixed=True)]
    frame: Frame

    @property
    def values(self) -> Array:
        """The forces."""
        return self.forces_of

    def forces_at(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the forces in space."""
        rows = self.samples(np.array([t])).reshape(3, 3)
        return rows if self.frame == "space" else rows @ directors

    @classmethod
    def words(cls, record: Record) -> str:
        """Return how long the table is."""
        return f"table of {len(record['times'])} director forces {along(record['frame'])}"


@dataclass(frozen=True, eq=False)
class ForceFunction(DirectorForces):
    """What a function of time, directors and angular velocity gives, rows of (3, 3) in `frame`."""

    director_forces: Callable[..., Any]
    frame: Frame

    @property
    def called(self) -> Callable[..., Any]:
        """The function."""
        return self.director_forces

    def text(self, call: Call, x: Sequence[Any]) -> list[Any]:
        """Return the forces in space."""
        rows = call(self.called, state(x), (3, 3))
        if self.frame == "body":
            rows = (array(rows, 3, 3) @ array(x[:9], 3, 3)).ravel().tolist()
        return rows

    @classmethod
    def words(cls, record: Record) -> str:
        """Return factor and name."""
        return function_in_words(record, f"director forces of {record['director_forces']}", record["frame"])


MOST_VECTORS = 4
I3 = np.eye(3)
ZEROS: Any = (0.0, 0.0, 0.0)
NO_MATRIX: Any = (ZEROS,) * 3
in_space = partial(Spec, shape=(3,), rule="direction in space", is_fixed=True)


class Potential(ForceTerm):
    """A term of kind "potential": V, and its gradient, of space vectors seen from the body.

    A subclass has the text ``potential(directors)``, V of the rows d_i. Its gradient follows by duals. The vectors are
    then the axes of space, of which the directors are what is seen.
    """

    kind = "potential"

    @property
    def vectors(self) -> Array:
        """The space vectors a, (k, 3)."""
        return I3

    @property
    def counts(self) -> tuple[int, int]:  # type: ignore[override]
        """How many numbers γ has."""
        return self.vectors.size, 0

    def level(self, call: Call, x: Sequence[Any]) -> Any:
        """Return V of the numbers of γ, and those of the term behind them, by a way to call functions (`functions`)."""
        n = self.vectors.size
        own: Any = self.with_numbers(x[n:])
        return call(own.called, (array(x[:n], 3, 3).T,), ())[0]

    def text(self, call: Call, x: Sequence[Any]) -> list[Any]:
        """Return V and its gradient."""
        n = self.vectors.size
        if call is checked:
            self.level(call, x)
            call = differentiated
        V = self.level(call, [Dual(y, [float(i == j) for j in range(n)]) for i, y in enumerate(x)])
        return [plain(V), *(tangent(V, j) for j in range(n))]

    def value(self, gamma: Array) -> Array:
        """Return V of γ, (..., k, 3), without the factor, one after the other."""
        flat = gamma.reshape(-1, self.vectors.size)
        values = [self.level(checked, g.tolist()) if np.isfinite(g).all() else np.nan for g in flat]
        return np.array(values).reshape(gamma.shape[:-2])

    def gradient_text(self, call: Call, x: Sequence[Any]) -> Sequence[Any]:
        """Return the gradient of V by the numbers of γ, by a way to call functions."""
        return self.text(call, x)[1:]

    def slope(self, gamma: Array) -> Array:
        """Return the gradient of V at γ, (k, 3), without the factor."""
        return np.array(self.gradient_text(checked, gamma.ravel().tolist())).reshape(gamma.shape)

    @property
    def dead_force(self) -> Array | None:
        """The dead force that a linear potential is, (3, 3) rows, without the factor; else None."""
        return None

    constant = 0.0  # J: V less that of the dead force, without the factor

    def vectors_at(self, times: Array) -> Array:
        """Return the space vectors at times (...), (..., k, 3) or (k, 3) where they stand still."""
        return self.vectors

    def energy(self, directors: Array, times: Array) -> Array:
        """Return V at directors (..., 3, 3) and times (...), J, with the factor."""
        gamma = dot(directors[..., None, :, :], self.vectors_at(times)[..., None, :])  # for any number alike: no BLAS
        return self.scale * self.value(gamma)

    def forces_at(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the forces ``-a ∂V/∂γ_j`` on the directors, rows of (3, 3), N m, without the factor."""
        a = self.vectors_at(np.array(t))
        return -self.slope(a @ directors.T).T @ a


class OfOneVector(Potential):
    """A potential ``V = l·γ + ½ γ·Qγ`` of one vector."""

    in_kernels = True
    linear: Any
    quadratic: Any

    def value(self, gamma: Array) -> Array:
        """Return V."""
        g = gamma[..., 0, :]
        return dot(g, self.linear + dot(g[..., None, :], self.quadratic) / 2)

    def gradient_text(self, call: Call, x: Sequence[Any]) -> Vector:
        """Return l + Qγ."""
        return Matrix(*self.quadratic) @ Vector(*x) + Vector(*self.linear)


@dataclass(frozen=True, eq=False, kw_only=True)
class Quadratic(OfOneVector):
    """The potential linear·γ + γ·quadratic γ / 2 of a space vector seen from the body, γ = Λᵀ vector."""

    linear: Annotated[Array, Spec("along the directors, J per unit of the vector", shape=(3,))] = ZEROS
    quadratic: Annotated[Array, Spec("symmetric, J per unit of the vector squared", shape=(3, 3), rule="symmetric")] = (
        NO_MATRIX
    )
    vector: Annotated[Array, Spec("a vector in space", shape=(3,), is_fixed=True)]

    @property
    def varying(self) -> list[str]:
        """The coefficients; of one that is linear these alone."""
        return ["linear", "quadratic"][: 1 if self.dead_force is not None else 2]

    @property
    def vectors(self) -> Array:
        """The space vector."""
        return self.vector[None]

    @property
    def dead_force(self) -> Array | None:
        """Its rows are -l_j a."""
        return None if self.quadratic.any() else -np.outer(self.linear, self.vector)

    @classmethod
    def words(cls, record: Record) -> str:
        """Return whether it is linear, and in which vector."""
        kind = "quadratic" if np.any(record["quadratic"]) else "linear"
        return f"{kind} potential of the space vector {vector_text(record['vector'])}"


@dataclass(frozen=True, eq=False)
class Spring(Potential):
    """A spring between a point of the body and one of space."""

    in_kernels = True
    stiffness: Annotated[float, Spec("", unit="N/m", rule="positive")]
    point: Annotated[Array, Spec("from the fixed point, along the directors", unit="m", shape=(3,), is_fixed=True)]
    anchor: Annotated[Array, Spec("from the fixed point, in space", unit="m", shape=(3,), is_fixed=True)]
    rest_length: Annotated[float, Spec("", unit="m", rule="not negative")] = 0.0

    @property
    def varying(self) -> list[str]:
        """The stiffness; of one with a rest length this as well."""
        return ["stiffness", "rest_length"][: 1 if self.dead_force is not None else 2]

    @property
    def vectors(self) -> Array:
        """The place of the anchor."""
        return self.anchor[None]

    @property
    def constant(self) -> float:  # type: ignore[override]
        """Return ½ k (|ρ|² + |a|²)."""
        return self.stiffness * self.square / 2

    @property
    def square(self) -> float:
        """Return |ρ|² + |a|²."""
        return float(self.point @ self.point + self.anchor @ self.anchor)

    def length(self, gamma: Array) -> Array:
        """Return ℓ."""
        return np.sqrt(np.maximum(self.square - 2 * dot(gamma[..., 0, :], self.point), 0.0))

    def value(self, gamma: Array) -> Array:
        """Return V."""
        return self.stiffness * (self.length(gamma) - self.rest_length) ** 2 / 2

    def gradient_text(self, call: Call, x: Sequence[Any]) -> Vector:
        """Return ``-k (1 - L/ℓ) ρ``."""
        rho = Vector(*self.point.tolist())
        length = sqrt(larger(self.square - 2.0 * (rho @ Vector(*x)), 0.0))
        slack = self.rest_length / length if self.rest_length else 0.0
        return (-self.stiffness * (1.0 - slack)) * rho

    @property
    def dead_force(self) -> Array | None:
        """Of rest length 0 the rows k ρ_j a: V = ½ k (|ρ|² + |a|²) - k ρ·γ."""
        return None if self.rest_length else self.stiffness * np.outer(self.point, self.anchor)

    @classmethod
    def words(cls, record: Record) -> str:
        """Return stiffness, both ends, rest length."""
        rest = f", rest length {record['rest_length']:.6g} m" if record["rest_length"] else ""
        ends = f"from {vector_text(record['point'])} m in the body to {vector_text(record['anchor'])} m in space"
        return f"spring {record['scale'] * record['stiffness']:.6g} N/m {ends}{rest}"


@dataclass(frozen=True, eq=False)
class GravityGradient(OfOneVector):
    """The gravity gradient on an orbit."""

    mean_motion: Annotated[float, Spec("", unit="rad/s", rule="positive")]
    radial: Annotated[Array, in_space("the radius at start, perigee of an ellipse, in space")] = (1.0, 0.0, 0.0)  # type: ignore[assignment]
    normal: Annotated[Array, in_space("the normal of the orbit, in space")] = (0.0, 0.0, 1.0)  # type: ignore[assignment]
    start: Annotated[float, Spec("", unit="s", is_fixed=True)] = 0.0
    eccentricity: Annotated[float, Spec("", rule="at least 0 and below 1")] = 0.0
    inertia: Any = None  # J, (3, 3), when a run has told its body
    linear = np.zeros(3)

    def __post_init__(self) -> None:
        super().__post_init__()
        fastest = self.mean_motion * ((1 + (e := self.eccentricity)) / (1 - e) ** 3) ** 0.5  # at perigee
        self._set(resolution=0.3 / fastest)
        if self.inertia is not None:  # a copy
            return
        if abs(cosine := self.radial @ self.normal) > 1e-9:
            raise ValueError(f"normal must be orthogonal to radial, but the cosine between them is {cosine:.3g}")
        r = self.radial - cosine * self.normal
        self._set(radial=r / np.linalg.norm(r), inertia=np.full((3, 3), np.nan))

    @property
    def varying(self) -> list[str]:
        """The mean motion; of an ellipse the eccentricity as well."""
        return ["mean_motion", "eccentricity"][: 1 + bool(self.eccentricity)]

    def of_body(self, inertia: Array) -> GravityGradient:
        """Return the term for a body with this inertia."""
        return replace(self, inertia=inertia)

    @property
    def vectors(self) -> Array:
        """The radius at the time `start`."""
        return self.radial[None]

    def vectors_at(self, times: Array) -> Array:
        """Return the direction of the radius, on an ellipse times (a/|r|)^{3/2}."""
        angle = (self.mean_motion * (times - self.start))[..., None, None]
        x, y = on_orbit(angle, self.eccentricity) if self.eccentricity else (np.cos(angle), np.sin(angle))
        return x * self.radial + y * np.cross(self.normal, self.radial)

    @property
    def quadratic(self) -> Array:
        """Return Q = 3n²J."""
        return 3 * self.mean_motion**2 * self.inertia

    @classmethod
    def words(cls, record: Record) -> str:
        """Return the form of the orbit, and the mean motion."""
        e = record.get("eccentricity", 0.0)
        orbit = f"an orbit of eccentricity {e:.6g}" if e else "a circular orbit"
        return f"gravity gradient on {orbit}, mean motion {record['mean_motion']:.6g} rad/s"


@dataclass(frozen=True, eq=False)
class PotentialFunction(Potential):
    """A potential that is a function, with its gradient."""

    potential: Callable[..., Any]
    gradient: Callable[..., Any]
    vectors_of: Array  # (k, 3)
    single: bool  # whether γ is given as (3,)

    @property
    def vectors(self) -> Array:
        """The space vectors."""
        return self.vectors_of

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape in which the functions get γ."""
        return (3,) if self.single else self.vectors_of.shape

    def level(self, call: Call, x: Sequence[Any]) -> Any:
        """Return V of the numbers of γ."""
        return call(self.potential, (array(x, *self.shape),), ())[0]

    def text(self, call: Call, x: Sequence[Any]) -> list[Any]:
        """Return V and what the gradient gives."""
        return [self.level(call, x), *call(self.gradient, (array(x, *self.shape),), self.shape)]

    @classmethod
    def words(cls, record: Record) -> str:
        """Return factor and name."""
        return function_in_words(record, f"potential {record['potential']}")


NOISE = 2.0**-51  # of f, over E: above the round-off of its terms


def on_orbit(M: Any, e: Any) -> tuple[Any, Any]:
    """Return (a/|r|)^{3/2} times the direction of the radius, along perigee and along the velocity there."""
    turns = 2.0 * math.pi * floor(plain(M) / (2.0 * math.pi) + 0.5)
    m, k = plain(M) - turns, plain(e)
    size = abs(m)

    v = Variables(E=smaller(smaller(size + k, size / (1.0 - k)), 0.0 * size + math.pi))
    v.f = v.E - k * sin(v.E) - size
    for _ in whilst(lambda: any_of(v.f > NOISE * v.E)):
        v.E = v.E - larger(v.f, 0.0 * v.f) / (1.0 - k * cos(v.E))
        v.f = v.E - k * sin(v.E) - size
    E = copysign(v.E, m)
    E = E - (E - e * sin(E) - (M - turns)) / (1.0 - e * cos(E))
    half = 2.0 * sin(0.5 * E) * sin(0.5 * E)
    distance = 1.0 - e + e * half
    length = 1.0 / (distance * distance * sqrt(distance))
    return length * (1.0 - e - half), length * sqrt((1.0 - e) * (1.0 + e)) * sin(E)
