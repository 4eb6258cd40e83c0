"""Potentials of space vectors seen from the body, γ = Λᵀa: terms of a load that counts as energy, not as work.

V depends on the attitude through γ_j = a·d_j, three numbers for each vector, so the director d_j bears the force
``-a ∂V/∂γ_j``. A load that is a potential can be added, scaled and swept like any other, may be a function, and is
recorded as loads are, by its data or its name. In a run V belongs to the energy: it is in `potential_energy`, its
moment not in `moment`, its work not in `load_work`.

A linear potential is a dead force, and is marched as one (`integrators.load_samples.as_marched`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ..geometry.arrays import Array
from ..geometry.values import vector_text
from .terms import ForceTerm, Kind, Record, checked_value, function_in_words

POTENTIAL_REMEDY = "let function return a finite number (J) and gradient its derivatives by γ (N m) for every γ"
MOST_VECTORS = 4
I3 = np.eye(3)


@dataclass(frozen=True, eq=False)
class Potential(ForceTerm):
    """A term of kind "potential": V, and its gradient, of space vectors seen from the body."""

    kinds: ClassVar[tuple[Kind, ...]] = ("potential",)

    if TYPE_CHECKING:

        @property
        def vectors(self) -> Array:
            """The space vectors a, (k, 3)."""

    def value(self, gamma: Array) -> Array:
        """Return V of γ, (..., k, 3), without the factor."""
        raise NotImplementedError

    def slope(self, gamma: Array) -> Array:
        """Return the gradient of V at γ, (k, 3), without the factor."""
        raise NotImplementedError

    @property
    def dead_force(self) -> Array | None:
        """The dead force that a linear potential is, (3, 3) rows, without the factor; else None."""
        return None

    def vectors_at(self, times: Array) -> Array:
        """Return the space vectors at times (...), (..., k, 3) or (k, 3) where they stand still."""
        return self.vectors

    def energy(self, directors: Array, times: Array) -> Array:
        """Return V at directors (..., 3, 3) and times (...), J, with the factor."""
        gamma = np.einsum("...jx,...vx->...vj", directors, self.vectors_at(times))
        return self.scale * self.value(gamma)

    def forces(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the forces ``-a ∂V/∂γ_j`` on the directors, rows of (3, 3), N m, without the factor."""
        a = self.vectors_at(np.array(t))
        found: Array = -self.slope(a @ directors.T).T @ a
        return found


class OfOneVector(Potential):
    """A potential ``V = l·γ + ½ γ·Qγ`` of one vector."""

    linear: Any
    quadratic: Any

    def value(self, gamma: Array) -> Array:
        """Return V."""
        g = gamma[..., 0, :]
        found: Array = g @ self.linear + np.sum(g @ self.quadratic * g, axis=-1) / 2
        return found

    def slope(self, gamma: Array) -> Array:
        """Return l + Qγ."""
        found: Array = self.linear + gamma @ self.quadratic
        return found


@dataclass(frozen=True, eq=False)
class Quadratic(OfOneVector):
    """The potential ``V = l·γ + ½ γ·Qγ`` of one vector."""

    linear: Array  # l, (3,)
    quadratic: Array  # Q, (3, 3), symmetric
    vector: Array  # a, (3,)

    @property
    def vectors(self) -> Array:
        """The space vector."""
        return self.vector[None]

    @property
    def dead_force(self) -> Array | None:
        """Its rows are -l_j a."""
        return None if self.quadratic.any() else -np.outer(self.linear, self.vector)

    @staticmethod
    def words(record: Record) -> str:
        """Return whether it is linear, and in which vector."""
        kind = "quadratic" if np.any(record["quadratic"]) else "linear"
        return f"{kind} potential of the space vector {vector_text(record['vector'])}"


@dataclass(frozen=True, eq=False)
class Spring(Potential):
    """A spring between a point of the body and one of space, ``V = ½ k (ℓ - L)²``."""

    stiffness: float
    point: Array  # ρ, (3,), in the body
    anchor: Array  # a, (3,), in space
    rest_length: float

    @property
    def vectors(self) -> Array:
        """The place of the anchor."""
        return self.anchor[None]

    @property
    def square(self) -> float:
        """Return |ρ|² + |a|²."""
        return float(self.point @ self.point + self.anchor @ self.anchor)

    def length(self, gamma: Array) -> Array:
        """Return ℓ."""
        found: Array = np.sqrt(np.maximum(self.square - 2 * gamma[..., 0, :] @ self.point, 0.0))
        return found

    def value(self, gamma: Array) -> Array:
        """Return V."""
        found: Array = self.stiffness * (self.length(gamma) - self.rest_length) ** 2 / 2
        return found

    def slope(self, gamma: Array) -> Array:
        """Return ``-k (1 - L/ℓ) ρ``."""
        slack = self.rest_length / self.length(gamma) if self.rest_length else 0.0
        found: Array = -self.stiffness * (1 - slack) * self.point[None]
        return found

    @property
    def dead_force(self) -> Array | None:
        """Of rest length 0 the rows k ρ_j a: V = ½ k (|ρ|² + |a|²) - k ρ·γ."""
        return None if self.rest_length else self.stiffness * np.outer(self.point, self.anchor)

    @staticmethod
    def words(record: Record) -> str:
        """Return stiffness, both ends, rest length."""
        rest = f", rest length {record['rest_length']:.6g} m" if record["rest_length"] else ""
        ends = f"from {vector_text(record['point'])} m in the body to {vector_text(record['anchor'])} m in space"
        return f"spring {record['scale'] * record['stiffness']:.6g} N/m {ends}{rest}"


@dataclass(frozen=True, eq=False)
class GravityGradient(OfOneVector):
    """The gravity gradient on a circular orbit, ``V = (3/2) n² c·Jc``, c the direction of the radius in the body."""

    mean_motion: float  # n, rad/s
    radial: Array  # r of the time `start`, (3,), unit
    normal: Array  # o, (3,), unit
    start: float
    inertia: Array  # J, (3, 3); NaN until a run tells its body
    linear = np.zeros(3)

    def of_body(self, inertia: Array) -> GravityGradient:
        """Return the term for a body with this inertia."""
        return replace(self, inertia=inertia)

    @property
    def vectors(self) -> Array:
        """The radius at the time `start`."""
        return self.radial[None]

    def vectors_at(self, times: Array) -> Array:
        """Return the direction of the radius."""
        angle = (self.mean_motion * (times - self.start))[..., None, None]
        found: Array = np.cos(angle) * self.radial + np.sin(angle) * np.cross(self.normal, self.radial)
        return found

    @property
    def quadratic(self) -> Array:
        """Return Q = 3n²J."""
        return 3 * self.mean_motion**2 * self.inertia

    @staticmethod
    def words(record: Record) -> str:
        """Return the mean motion."""
        return f"gravity gradient on a circular orbit, mean motion {record['mean_motion']:.6g} rad/s"


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

    def value(self, gamma: Array) -> Array:
        """Return V, of one γ after the other."""
        flat = gamma.reshape(-1, *self.shape)
        values = [self.checked_value(g) if np.isfinite(g).all() else np.nan for g in flat]
        return np.array(values).reshape(gamma.shape[:-2])

    def slope(self, gamma: Array) -> Array:
        """Return what the gradient gives."""
        g = gamma.reshape(self.shape)
        self.checked_value(g)
        return self._called(self.gradient, "gradient", g, self.shape).reshape(-1, 3)

    def checked_value(self, gamma: Array) -> float:
        """Return V of one γ; a ValueError where it is no finite number."""
        return float(self._called(self.potential, "potential", gamma, ()))

    def _called(self, function: Callable[..., Any], what: str, gamma: Array, shape: tuple[int, ...]) -> Array:
        function, place = getattr(function, "py_func", function), lambda: f"γ = {gamma.tolist()}"
        return checked_value(function, what, (gamma.copy(),), "γ", shape, place, POTENTIAL_REMEDY)

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape in which the functions get γ."""
        return (3,) if self.single else (len(self.vectors_of), 3)

    @cached_property
    def traceable(self) -> Any:
        """V and its gradient as a text; None where they run in Python."""
        from .compiled import potential_of

        return potential_of(self.potential, self.gradient, self.shape) if self.compile else None

    @staticmethod
    def words(record: Record) -> str:
        """Return factor and name."""
        return function_in_words(record, f"potential {record['potential']}")
