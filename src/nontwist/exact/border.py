"""Validation of the arguments of the closed-form solutions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..geometry import rotations
from ..geometry.arrays import Array, as_array, as_floats
from ..models.catalogue import D3
from ..models.system import checked_inertia, require_principal

SPIN = 1e-9
Motion = tuple[Array, Array]


def checked_attitude(rotation: Any) -> Array:
    """Return the initial attitude Λ (3, 3), of a matrix or an object with `as_matrix`; ValueError for no rotation."""
    if rotation is None:
        return np.eye(3)
    R = as_array(rotation.as_matrix() if hasattr(rotation, "as_matrix") else rotation, "rotation", (3, 3))
    if not rotations.is_rotation(R):
        raise ValueError("rotation is not a rotation (orthonormal, right-handed)")
    return R


def checked_velocity(value: ArrayLike) -> Array:
    """Return the material angular velocity W (3,), rad/s."""
    return as_array(value, "material_angular_velocity", (3,))


def checked_times(times: ArrayLike) -> Array:
    """Return the times (k,), s; a single one as (1,)."""
    return as_array(as_floats(times, "times", 1), "times", (None,))


def without_spin(W: Array, axis: Array) -> Array:
    """Return `W` without its round-off along the constrained `axis`; ValueError where it is more than that."""
    spin = float(W @ axis)
    if abs(spin) > SPIN * float(np.linalg.norm(W)):
        raise ValueError(
            f"material_angular_velocity has the component {spin:.6g} rad/s along the constrained body axis "
            f"{np.round(axis, 12).tolist()}"
        )
    return W - spin * axis


def planar(inertia: ArrayLike, velocity: ArrayLike, physical: bool) -> tuple[Array, Array]:
    """Return J (3, 3) and W of a non-twisting body, D3 principal to the last bit (eq-irho-decomp)."""
    J = checked_inertia(inertia, physical, D3)
    require_principal(J, D3)
    J[:2, 2] = J[2, :2] = 0.0
    return J, without_spin(checked_velocity(velocity), D3)
