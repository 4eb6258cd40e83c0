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

from ..geometry.arrays import Array, as_floats
from ..geometry.values import vector_text
from .terms import LONGEST, Kind, Record, Term

POTENTIAL_REMEDY = "let function return a finite number (J) and gradient its derivatives by γ (N m) for every γ"
MOST_VECTORS = 4
I3 = np.eye(3)


@dataclass(frozen=True, eq=False)
class Potential(Term):
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

    def moment(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return their spatial moment, (3,), N m, without the factor."""
        found: Array = np.cross(directors, self.forces(t, directors, angular_velocity)).sum(axis=0)
        return found


@dataclass(frozen=True, eq=False)
class Quadratic(Potential):
    """The potential ``V = l·γ + ½ γ·Qγ`` of one vector."""

    linear: Array  # l, (3,)
    quadratic: Array  # Q, (3, 3), symmetric
    vector: Array  # a, (3,)

    @property
    def vectors(self) -> Array:
        """The space vector."""
        return self.vector[None]

    def value(self, gamma: Array) -> Array:
        """Return V."""
        g = gamma[..., 0, :]
        found: Array = g @ self.linear + np.sum(g @ self.quadratic * g, axis=-1) / 2
        return found

    def slope(self, gamma: Array) -> Array:
        """Return l + Qγ."""
        found: Array = self.linear + gamma @ self.quadratic
        return found

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
class GravityGradient(Potential):
    """The gravity gradient on a circular orbit, ``V = (3/2) n² c·Jc``, c the direction of the radius in the body."""

    mean_motion: float  # n, rad/s
    radial: Array  # r of the time `start`, (3,), unit
    normal: Array  # o, (3,), unit
    start: float
    inertia: Array  # J, (3, 3); NaN until a run tells its body

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

    def value(self, gamma: Array) -> Array:
        """Return V."""
        g = gamma[..., 0, :]
        found: Array = np.sum(g @ self.quadratic * g, axis=-1) / 2
        return found

    def slope(self, gamma: Array) -> Array:
        """Return 3n²Jc."""
        found: Array = gamma @ self.quadratic
        return found

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
        self.checked_value(gamma.reshape(self.shape))
        name = getattr(self.gradient, "__name__", repr(self.gradient))
        try:
            found = as_floats(_python(self.gradient)(gamma.reshape(self.shape).copy()), f"the gradient {name}")
        except Exception as error:
            raise ValueError(
                f"the gradient {name} raised {type(error).__name__}: {error}; {POTENTIAL_REMEDY}"
            ) from error
        if found.shape != self.shape:
            raise ValueError(
                f"the gradient {name} must return shape {self.shape}, got {found.shape}; {POTENTIAL_REMEDY}"
            )
        if not np.isfinite(found).all():
            raise ValueError(f"the gradient {name} is not finite at γ = {gamma.tolist()}; {POTENTIAL_REMEDY}")
        return found.reshape(-1, 3)

    def checked_value(self, gamma: Array) -> float:
        """Return V of one γ; a ValueError where it is no finite number."""
        name = getattr(self.potential, "__name__", repr(self.potential))
        try:
            found = as_floats(_python(self.potential)(gamma.copy()), f"the potential {name}")
        except Exception as error:
            raise ValueError(
                f"the potential {name} raised {type(error).__name__}: {error}; {POTENTIAL_REMEDY}"
            ) from error
        if found.shape != ():
            raise ValueError(f"the potential {name} must return a number, got shape {found.shape}; {POTENTIAL_REMEDY}")
        if not np.isfinite(found):
            raise ValueError(f"the potential {name} is not finite at γ = {gamma.tolist()}; {POTENTIAL_REMEDY}")
        return float(found)

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
        factor = "" if record["scale"] == 1 else f"{record['scale']:.6g} × "
        return f"{factor}potential {record['potential']}"[:LONGEST]


def _python(function: Callable[..., Any]) -> Callable[..., Any]:
    found: Callable[..., Any] = getattr(function, "py_func", function)
    return found
