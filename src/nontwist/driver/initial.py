"""The state a run starts from: directors and their velocities."""

from __future__ import annotations

import json
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..analysis import observables as obs
from ..analysis.datasets import as_dataset
from ..analysis.motions import rotation as as_rotation
from ..geometry.arrays import Array, as_array, as_number
from ..integrators.time_grid import Before
from ..models.system import DirectorSystem

SPIN, I3 = 1e-9, np.eye(3)
MOST_STEPS = 2**53  # whose numbers are whole floats
NEEDED = ("directors", "director_velocities", "time")


class State(NamedTuple):
    """Directors and their velocities as rows; where they come from a run its end, memory of the integrator and grid."""

    directors: Array
    velocities: Array
    time: float | None
    memory: Array | None = None
    grid: Before | None = None


def initial_state(
    system: DirectorSystem,
    start: Any,
    rotation: Any,
    scalar_first: bool | None,
    material_angular_velocity: ArrayLike | None,
    angular_velocity: ArrayLike | None,
    project: bool,
) -> State:
    """Return the checked initial state; parameters as in `nontwist.simulate`.

    Raises
    ------
    ValueError
        Contradictory or malformed input, or spin about the constrained axis.
    """
    if start is not None and rotation is not None:
        raise ValueError("give start= or rotation=, not both")
    if material_angular_velocity is not None and angular_velocity is not None:
        raise ValueError("give material_angular_velocity= or angular_velocity=, not both")
    carried = last_state(start) if start is not None else None
    if carried is None:
        q = _directors(rotation if start is None else start, scalar_first)
        if angular_velocity is not None:
            w = as_array(angular_velocity, "angular_velocity", (3,))
        elif material_angular_velocity is not None:
            w = as_array(material_angular_velocity, "material_angular_velocity", (3,)) @ q
        else:
            w = np.zeros(3)
        if system.axis is not None:
            w = w - _spin(q, w, system.axis, project)
        return State(q, obs.tangent_velocities(q, w), None)
    if material_angular_velocity is not None or angular_velocity is not None:
        raise ValueError("start= is a run and brings its velocities; leave the angular velocity out")
    q, v = carried.directors, carried.velocities
    if system.axis is not None and not same_axis(start, system.axis):
        v = v - obs.tangent_velocities(q, _spin(q, obs.angular_velocity(q, v), system.axis, project))
    return carried._replace(velocities=v)


def _directors(rotation: Any, scalar_first: bool | None) -> Array:
    if rotation is None:
        return I3.copy()
    R = as_rotation(rotation, scalar_first=scalar_first)
    q: Array = (R if R.single else R[-1]).as_matrix().T.copy()
    return q


def last_state(start: Any) -> State | None:
    """Return the last state of a run, or None where `start` holds no velocities."""
    if hasattr(start, "data_vars"):
        as_dataset(start, "a run for start=", [name for name in NEEDED if name in start])
    if hasattr(start, "director_velocities"):
        require_states(start)
        last = [np.array(getattr(start, name))[-1] for name in ("directors", "director_velocities", "time")]
        as_rotation(last[0].T)
        velocities = as_array(last[1], "director_velocities", (3, 3))
        return State(last[0], velocities, float(last[2]), _memory(start), grid_of(start))
    return None


def grid_of(start: Any) -> Before | None:
    """Return the time grid of a run up to its end, None where it has none."""
    step, origin = getattr(start, "step", None), getattr(start, "origin", None)
    if step is None:
        return None
    h, first, last = as_number(step, "the step of start="), float(start.time[0]), float(start.time[-1])
    begin = first if origin is None else as_number(origin, "the origin of start=")
    return Before(begin, round((last - begin) / h), h) if h > 0 and (last - begin) / h < MOST_STEPS else None


def _memory(start: Any) -> Array | None:
    """Return what the integrator carried at the end of a run."""
    text = getattr(start, "attrs", {}).get("memory")
    if text is None:
        return getattr(start, "memory", None)
    try:
        return np.array(json.loads(text), dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"the attribute memory of start= is damaged: {error}") from error


def require_states(start: Any) -> None:
    """Raise a ValueError where a run has no state to continue from."""
    if not np.size(getattr(start, "time", 0)):
        raise ValueError("start= has no states: there is nothing to continue from")


def same_axis(start: Any, axis: Array) -> bool:
    """Whether the run `start` obeyed the same constraint: its nodes may then carry what the scheme left there."""
    own = getattr(start, "system", None)
    if not isinstance(own, DirectorSystem):
        text = getattr(start, "attrs", {}).get("system")
        if text is None:
            return False
        own = DirectorSystem.from_json(text)
    return own.axis is not None and bool(abs(own.axis - axis).max() <= SPIN)


def _spin(q: Array, w: Array, axis: Array, project: bool) -> Array:
    """Return the part of w along the constrained axis, (3,); refuse it unless it is to be removed."""
    n = axis @ q
    spin = float(w @ n)
    if abs(spin) > SPIN * sqrt(w @ w) and not project:
        raise ValueError(
            f"the initial angular velocity has the component {spin:.6g} rad/s along the constrained body axis "
            f"{np.round(axis, 12).tolist()}; project=True removes it"
        )
    along: Array = spin * n
    return along
