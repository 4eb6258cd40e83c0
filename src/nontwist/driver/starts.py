"""The starts of an ensemble: every argument with a member axis or without, checked and brought to one length."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..analysis.ensemble_dataset import attitudes
from ..analysis.motions import rotation as as_rotation
from ..geometry.arrays import Array, as_array, as_floats
from ..integrators.time_grid import Before
from ..models.stack import SystemStack
from .initial import SPIN, grid_of, last_state, require_states, same_axis


class Starts(NamedTuple):
    """Attitudes, velocities and scales at the start, one row for each member; the time where they come from a run."""

    quaternion: Array  # (m, 4) scalar last
    velocity: Array  # (m, 3) W
    normal: Array | None  # (m, 3, 3) symmetric part of the director velocities in the body
    load_scale: Array  # (1,) or (m,)
    time: float | None
    grid: Before | None


def starts(
    systems: SystemStack,
    start: Any,
    rotation: Any,
    scalar_first: bool | None,
    material_angular_velocity: ArrayLike | None,
    angular_velocity: ArrayLike | None,
    load_scale: ArrayLike,
    project: bool,
) -> Starts:
    """Return the checked starts; parameters as in `nontwist.simulate_ensemble`.

    Raises
    ------
    ValueError
        Contradictory or malformed input, member axes that do not fit together, or spin about a constrained axis.
    """
    if material_angular_velocity is not None and angular_velocity is not None:
        raise ValueError("give material_angular_velocity= or angular_velocity=, not both")
    given = material_angular_velocity is not None or angular_velocity is not None
    if start is not None and (rotation is not None or given):
        raise ValueError("start= brings attitudes and velocities; leave rotation= and the angular velocity out")
    normal, time, grid, name = None, None, None, "rotation"
    if start is not None:
        (quaternion, W, normal, time), grid, name = _of_run(systems, start), grid_of(start), "start"
    else:
        quaternion = _quaternions(rotation, scalar_first)
        W = np.zeros((1, 3))
    velocity_name = "angular_velocity" if angular_velocity is not None else "material_angular_velocity"
    if given:
        W = _vectors(angular_velocity if angular_velocity is not None else material_angular_velocity, velocity_name)
    factors = as_array(load_scale, "load_scale", (...,))
    if factors.ndim > 1:
        raise ValueError(f"load_scale must be a number or have the shape (m,), got {factors.shape}")
    scale = factors.reshape(-1)
    lengths = {"system": len(systems), name: len(quaternion), velocity_name: len(W), "load_scale": len(scale)}
    m = _common(lengths)
    if angular_velocity is not None:
        R = attitudes(quaternion)
        W = R[:, 0] * W[:, :1] + R[:, 1] * W[:, 1:2] + R[:, 2] * W[:, 2:]
    if systems.axis is not None and not _same_axes(start, systems.axis):
        W = _without_spin(W, systems.axis, project)
    normal = None if normal is None else np.broadcast_to(normal, (m, 3, 3))
    return Starts(np.broadcast_to(quaternion, (m, 4)), np.broadcast_to(W, (m, 3)), normal, scale, time, grid)


def _quaternions(rotation: Any, scalar_first: bool | None) -> Array:
    if rotation is None:
        return np.array([[0.0, 0.0, 0.0, 1.0]])
    quaternion: Array = as_rotation(rotation, scalar_first=scalar_first).as_quat()
    if quaternion.ndim > 2:
        raise ValueError(f"rotation must have one member axis, got {quaternion.ndim - 1}")
    return quaternion.reshape(-1, 4)


def _vectors(value: Any, name: str) -> Array:
    given = as_floats(value, name)
    return as_array(given, name, (None, 3)) if given.ndim == 2 else as_array(given, name, (3,))[None]


def _common(lengths: dict[str, int]) -> int:
    """Return the number of members."""
    m = max(lengths.values())
    if 0 in lengths.values():
        empty = next(name for name, n in lengths.items() if n == 0)
        raise ValueError(f"{empty} has no members")
    if any(n not in (1, m) for n in lengths.values()):
        found = ", ".join(f"{name} {n}" for name, n in lengths.items() if n > 1)
        raise ValueError(f"every member axis must have the same length, or 1; the lengths are: {found}")
    return m


def _without_spin(W: Array, axis: Array, project: bool) -> Array:
    """Take from W its part along the constrained axes, in place; more than round-off is refused unless `project`."""
    spin = W[:, 0] * axis[:, 0] + W[:, 1] * axis[:, 1] + W[:, 2] * axis[:, 2]
    if not project:
        size = np.sqrt(W[:, 0] * W[:, 0] + W[:, 1] * W[:, 1] + W[:, 2] * W[:, 2])
        bad = np.flatnonzero(abs(spin) > SPIN * size)
        if bad.size:
            k = int(bad[0])
            n = np.round(axis[k if len(axis) > 1 else 0], 12).tolist()
            raise ValueError(
                f"the initial angular velocity of member {k} has the component {spin[k]:.6g} rad/s along the "
                f"constrained body axis {n}; project=True removes it"
            )
    if len(W) < len(axis):
        W = np.repeat(W, len(axis), axis=0)
    for j in range(3):
        W[:, j] -= spin * axis[:, j]
    return W


def _same_axes(start: Any, axis: Array) -> bool:
    """Whether the run `start` obeyed the same constraints: its nodes may then carry what the scheme left there."""
    if start is None:
        return False
    if "constrained_axis" in getattr(start, "data_vars", {}):
        axes = start.constrained_axis.values
        return axes.shape == axis.shape and bool(abs(axes - axis).max() <= SPIN)
    return len(axis) == 1 and same_axis(start, axis[0])


def _of_run(systems: SystemStack, start: Any) -> tuple[Array, Array, Array | None, float]:
    """Return attitudes, W, the symmetric part of the director velocities and the time of the last state of a run."""
    from scipy.spatial.transform import Rotation

    require_states(start)
    if not hasattr(start, "member"):
        state = last_state(start)
        if state is None or state.time is None:
            raise ValueError("start= must be a run or an ensemble; for attitudes alone there is rotation=")
        quaternion = Rotation.from_matrix(state.directors.T).as_quat()[None]
        V = (state.velocities @ state.directors.T)[None]
    else:
        names = [name for name in ("quaternion", "material_angular_velocity") if name not in start]
        if names:
            raise ValueError(f"start= lacks {' and '.join(names)}: keep them with variables= in the run before")
        last = start.isel(time=-1)
        quaternion, W = last.quaternion.values, last.material_angular_velocity.values.copy()
        failed = np.flatnonzero(~np.isfinite(quaternion).all(axis=1))
        if failed.size:
            raise ValueError(f"{failed.size} members of start= have failed, the first is {int(failed[0])}")
        if "director_velocities" not in start:
            if "energy-momentum" in start.attrs.get("integrator", ""):
                raise ValueError("start= lacks director_velocities, which energy-momentum carries on")
            return quaternion, W, None, float(last.time)
        V = last.director_velocities.values @ attitudes(quaternion)
    W = np.stack([V[:, 1, 2] - V[:, 2, 1], V[:, 2, 0] - V[:, 0, 2], V[:, 0, 1] - V[:, 1, 0]], axis=1) / 2
    normal = (V + V.swapaxes(1, 2)) / 2
    return quaternion, W, normal, float(start.time[-1])
