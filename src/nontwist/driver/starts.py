"""The starts of a run or an ensemble: attitudes and velocities, checked and broadcast; a run is an ensemble of one."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..analysis.datasets import as_dataset, recorded
from ..analysis.trajectory import Trajectory, segments_from
from ..errors import SENTENCES, InputError, InputWarning, warn
from ..geometry.arrays import LARGEST, Array, Rotation, as_array, as_floats, as_number, in_order, vector
from ..geometry.attitudes import attitudes, states_of
from ..geometry.values import short_repr, vector_text
from ..integrators.ivp import Segments
from ..loads import Load
from ..loads.kinds import load_in_words
from ..loads.memory_terms import Column, recorded_wheels
from ..loads.terms import Record
from ..models.stack import SystemStack, stacked
from ..models.system import DirectorSystem
from .grid import is_too_short

# The state of a body at one time, as a value: what events and closed loops look at.

Vector = tuple[float, float, float]


class BodyState:
    """The state of a body at one time, as passed to an event function.

    All numbers are floats or tuples of floats, but for the array of the directors.

    Examples
    --------
    >>> from nontwist import simulate, standard
    >>> def level(t, state):
    ...     return state.directors[2, 2]
    >>> run = simulate(standard([3, 4, 5]), t_end=1, angular_velocity=(2, 0, 0), events=level, integrator="exact")
    >>> run.t_events.values.round(6)
    array([0.785398])
    """

    __slots__ = ("_axes", "_numbers", "_time", "_wheels")
    _axes: tuple[tuple[float, ...], ...]  # inertia and axis of each wheel
    _numbers: tuple[float, ...]
    _time: float
    _wheels: tuple[tuple[float, ...], ...]  # h first

    @property
    def time(self) -> float:
        """Time t, s."""
        return self._time

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """Unit quaternion of Λ, body to space, scalar last; its sign does not jump from state to state."""
        return self._numbers[0:4]  # type: ignore[return-value]

    @property
    def material_angular_velocity(self) -> Vector:
        """Angular velocity W in body components, rad/s."""
        return self._numbers[4:7]  # type: ignore[return-value]

    @property
    def internal_state(self) -> tuple[float, ...]:
        """The internal states z of loads with memory, one behind the other; none: ()."""
        return self._numbers[7:]

    @property
    def _carried(self) -> tuple[tuple[float, ...], tuple[Column, ...]]:
        """The internal states from which a run goes on, and where those of wheels are if not as in the load of it."""
        return self._numbers[7:], ()

    @property
    def wheel_momentum(self) -> tuple[float, ...]:
        """Axial momentum of each wheel in space, kg m² s⁻¹."""
        return tuple(one[0] for one in self._wheels)

    @property
    def wheel_speed(self) -> tuple[float, ...]:
        """Speed of each wheel relative to the body, rad/s."""
        x, y, z = self.material_angular_velocity
        found = zip(self._wheels, self._axes, strict=True)
        return tuple(h / I - (a * x + b * y + c * z) for (h, *_), (I, a, b, c) in found)

    @property
    def angular_velocity(self) -> Vector:
        """Angular velocity w = ΛW in space, rad/s."""
        x, y, z, s, a, b, c = self._numbers[:7]
        p, q, r = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
        return a + s * p + y * r - z * q, b + s * q + z * p - x * r, c + s * r + x * q - y * p

    @property
    def directors(self) -> Array:
        """The directors d_i, rows of (3, 3): the axes of the body in space."""
        x, y, z, s = self._numbers[:4]
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y + s * z), 2 * (x * z - s * y)],
                [2 * (x * y - s * z), 1 - 2 * (x * x + z * z), 2 * (y * z + s * x)],
                [2 * (x * z + s * y), 2 * (y * z - s * x), 1 - 2 * (x * x + y * y)],
            ]
        )

    @property
    def rotation(self) -> Rotation:
        """Attitude Λ, body to space, as a `scipy.spatial.transform.Rotation`, made on access."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self._numbers[:4])

    def __repr__(self) -> str:
        from ..geometry.values import vector_text

        p, W = vector_text(self.quaternion), vector_text(self.material_angular_velocity)
        return f"<{type(self).__name__}: t = {self._time:.12g} s, quaternion {p}, W {W} rad/s>"


def wheel_axes_of(load: Load) -> tuple[tuple[float, ...], ...]:
    """Return inertia and axis of each wheel."""
    return tuple((one.inertia, *one.direction.tolist()) for one in load.wheels)


def body_state(time: float, p: Any, W: Any, internal: Any = (), axes: Any = (), columns: Any = ()) -> BodyState:
    """Return the state of a quaternion, scalar last, W, and internal states, lists of floats, and `columns` of h."""
    state = BodyState()
    state._time, state._numbers = time, (*p, *W, *internal)
    state._axes, state._wheels = axes, tuple((internal[k],) for k in columns)
    return state


SAME = 1e-9  # relative: up to it spins, axes and inertias are the same
EPS = 2.0**-52
NEEDED = ("directors", "director_velocities", "time")
SENTENCES["start-other-inertia"] = (
    "the run that is continued is of another body, with an inertia that differs by up to {most:.3g} kg m²: its "
    "attitude and angular velocity are kept, and the momentum jumps; to start another body, give its rotation and "
    "angular velocity"
)
SENTENCES["start-other-memory"] = (
    "the run that is continued has {had}, and the load {has}: {kept}; continue with the load of that run, or start "
    "from its rotation and angular velocity, with speed= of wheels"
)
KEPT = "momenta and internal states are kept, and speeds are not"
SENTENCES["start-at-rest"] = (
    "start= has times and attitudes, but no velocities: only its last attitude is taken, at rest at t = {time} s; "
    "open_run reads a run with its velocities, and rotation= is an attitude without time"
)
OF_ALL = "a table or a function is that of all members, wheel(torque=...)"
SENTENCES["wheel-torque-type"] = (
    "wheel_torque must be an array of numbers, a torque in N m for each wheel of each member, got {value}; " + OF_ALL
)
SENTENCES["wheel-torque-without-wheels"] = (
    "wheel_torque= needs wheels in load=: add wheel(axis, inertia) for each torque"
)
SENTENCES["wheel-torque-shape"] = (
    "wheel_torque must have the shape (m, {count}) or ({count},), a number for each wheel of the load in its order, "
    "got {shape}; " + OF_ALL
)
SENTENCES["wheel-torque-not-finite"] = (
    "wheel_torque{place} = {value}, the torque of a wheel in N m, must be a finite number; 0 adds none"
)


class Starts(NamedTuple):
    """Attitudes, velocities and scales at the start, a row for each member; of a run to continue, its end and grid."""

    quaternion: Array  # (m, 4) scalar last
    velocity: Array  # (m, 3) W
    normal: Array | None = None  # (m, 6) N
    load_scale: Array = np.ones(1)  # (1,) or (m,)
    time: float | None = None
    grid: Segments | None = None  # counted from there
    memory: Array | None = None  # (m, ...)
    internal: Array | None = None  # (m, k) internal states of loads with memory
    wheels: tuple[Column, ...] = ()  # whose states are among them
    removed: Array = np.zeros(1)  # (1,) or (m,), rad/s: the part of W along the constrained axis before it was removed
    wheel_torque: Array | None = None  # (1, w) or (m, w), beside the torques of the load, N m


AT_REST = Starts(np.array([[0.0, 0.0, 0.0, 1.0]]), np.zeros((1, 3)))
AT_REST.quaternion.flags.writeable = AT_REST.velocity.flags.writeable = False  # all runs that begin so share it


def starts(
    system: DirectorSystem | SystemStack,
    start: Any = None,
    rotation: Any = None,
    scalar_first: bool | None = None,
    material_angular_velocity: ArrayLike | None = None,
    angular_velocity: ArrayLike | None = None,
    load_scale: ArrayLike = 1.0,
    project: bool = False,
    t_start: float | None = None,
    many: bool = False,
    load: Load | None = None,
    wheel_torque: Any = None,
) -> Starts:
    """Return checked starts; parameters as in `nontwist.simulate`, of `many` as in `nontwist.simulate_ensemble`.

    A load that does not carry on the wheels and the memory of the run to continue is warned of.

    Raises
    ------
    ValueError
        Contradictory or malformed input, member axes that do not fit together, or spin about a constrained axis.
    """
    if start is not None and rotation is not None:
        raise ValueError("give start= or rotation=, not both")
    if material_angular_velocity is not None and angular_velocity is not None:
        raise ValueError("give material_angular_velocity= or angular_velocity=, not both")
    is_material = angular_velocity is None
    name, given = "material_angular_velocity", material_angular_velocity
    if not is_material:
        name, given = "angular_velocity", angular_velocity
    along, other = ("axis", "angular_velocity") if is_material else ("director", "material_angular_velocity")
    if along in getattr(given, "dims", ()):
        raise ValueError(f"{name} has its components along {along!r}: give it as {other}=")
    if isinstance(start, dict):
        own = ", ".join(f"{name}=" for name in start) or "rotation=, material_angular_velocity="
        raise ValueError(f"start must be a run or a state, got a dict; give its entries themselves: {own}")
    systems, start = stacked(system), _of_member(start)
    begin = _continued(start, many)
    if begin is not None:
        if given is not None:
            raise ValueError("start= is a run and brings its velocities; leave the angular velocity out")
        begin, axis = _carrying(begin, start, systems, load)
    else:
        if given is None and hasattr(start, "time"):
            warn(InputWarning("start-at-rest", time=t_start or 0))
        attitude = rotation if start is None else start
        p = _quaternions(attitude, scalar_first) if many else last_attitude(attitude, scalar_first, rotation is None)
        W = np.zeros((1, 3)) if given is None else _vectors(given, name, many)
        begin, axis = Starts(p, W if is_material else along_frame(p, W)), systems.axis
    if not many:
        scale = np.array([as_number(load_scale, "load_scale")])
        return _projected(begin, systems, axis, project, t_start)._replace(load_scale=scale)
    factors = as_array(load_scale, "load_scale", (...,))
    if factors.ndim > 1:
        raise ValueError(f"load_scale must be a number or have the shape (m,), got {factors.shape}")
    torques = None if wheel_torque is None else _wheel_torques(wheel_torque, len(load.wheels) if load else 0)
    begin = begin._replace(load_scale=factors.reshape(-1), wheel_torque=torques)
    m = _members(begin, len(systems), "rotation" if start is None else "start", name)
    return _broadcast(_projected(begin, systems, axis, project, t_start), m)


def _continued(start: Any, many: bool) -> Starts | None:
    """Return the last states of a run to continue; None where `start` is not one."""
    if start is None:
        return None
    begin = _of_run(start) if many or "member" in getattr(start, "dims", ()) else last_state(start)
    if not many and begin is not None and (m := len(begin.quaternion)) > 1:
        raise ValueError(f"start= is an ensemble of {m} runs; continue one of them: start.isel(member=0)")
    return begin


def _carrying(begin: Starts, start: Any, systems: SystemStack, load: Load | None) -> tuple[Starts, Array | None]:
    """Return the states of a run with what its wheels and its memory carry, and the axis that is new to it."""
    if isinstance(start, BodyState):
        if begin.internal is not None and not (load and load.remembering):
            raise ValueError(
                f"start= has {begin.internal.size} internal states, of wheels or memory, and the load none"
            )
        now = wheel_axes_of(load) if load is not None else ()
        if begin.internal is not None and not _are_same(start._axes, now):
            had, has = ("; ".join(map(_wheel_in_words, many)) or "no wheels" for many in (start._axes, now))
            warn(InputWarning("start-other-memory", had=had, has=has, kept=KEPT))
        return begin, systems.axis
    records = _records(start)
    begin = begin._replace(wheels=tuple(recorded_wheels(records)))
    if load is not None:
        _require_memory(records, load, begin)
    return begin, _new_axis(start, systems)


def along_frame(p: Array, w: Array) -> Array:
    """Return ``W = Λᵀ w`` of quaternions and vectors in space, (m, 3)."""
    R = attitudes(p)
    return R[:, 0] * w[:, :1] + R[:, 1] * w[:, 1:2] + R[:, 2] * w[:, 2:]


def _broadcast(begin: Starts, m: int) -> Starts:
    """Return m states of what has one or m."""
    p, W, N = np.broadcast_to(begin.quaternion, (m, 4)), np.broadcast_to(begin.velocity, (m, 3)), begin.normal
    return begin._replace(quaternion=p, velocity=W, normal=None if N is None else np.broadcast_to(N, (m, 6)))


def as_rotation(value: Any, scalar_first: bool | None = None) -> Any:
    """Return attitudes as SciPy's `Rotation`; what reads them is imported where there are some."""
    from ..recordings.motions import rotation

    return rotation(value, scalar_first=scalar_first)


def last_attitude(rotation: Any, scalar_first: bool | None, is_motion: bool = False) -> Array:
    """Return the quaternion of an attitude, of a motion the last, (1, 4); errors as `one_attitude`."""
    if rotation is None:
        return AT_REST.quaternion
    return one_attitude(rotation, scalar_first, "rotation", is_motion).as_quat()[None]


def one_attitude(value: Any, scalar_first: bool | None, name: str, is_motion: bool = False) -> Rotation:
    """Return an attitude, of a motion the last; a ValueError where several have no times and are not called one."""
    R: Rotation = as_rotation(value, scalar_first=scalar_first)
    if R.single:
        return R
    if len(shape := R.as_quat().shape[:-1]) > 1 or not len(R):
        several = "; run.isel(member=0) is one run of an ensemble" * ("member" in getattr(value, "dims", ()))
        raise ValueError(f"{name} must be one attitude or one motion, got attitudes of the shape {shape}{several}")
    has_times = "time" in value.dims if hasattr(value, "dims") else hasattr(value, "time") or hasattr(value, "columns")
    if len(R) > 1 and not (is_motion or has_times):
        several = "; simulate_ensemble takes several" * (name == "rotation")
        raise ValueError(f"{name} must be one attitude, got {len(R)}: {name}=Q[0] is the first{several}")
    return R[-1]


def _quaternions(rotation: Any, scalar_first: bool | None) -> Array:
    if rotation is None:
        return AT_REST.quaternion
    quaternion: Array = as_rotation(rotation, scalar_first=scalar_first).as_quat()
    if quaternion.ndim > 2:
        raise ValueError(f"rotation must have one member axis, got {quaternion.ndim - 1}")
    return quaternion.reshape(-1, 4)


def _vectors(value: Any, name: str, many: bool) -> Array:
    if hasattr(value, "dims"):
        value = in_order(value).transpose(..., *{"director", "axis"}.intersection(value.dims))
    if many and (given := as_floats(value, name)).ndim == 2:
        return as_array(given, name, (None, 3))
    return np.array([vector(value, name)], dtype=np.float64)


def _wheel_torques(value: Any, count: int) -> Array:
    """Return a torque for each wheel, (1, w) or (m, w), N m; an InputError for anything else."""
    try:
        found = as_floats(value, "wheel_torque")
    except ValueError:
        raise InputError("wheel-torque-type", value=short_repr(value)) from None
    if not count:
        raise InputError("wheel-torque-without-wheels")
    if found.ndim not in (1, 2) or found.shape[-1] != count:
        raise InputError("wheel-torque-shape", shape=found.shape, count=count)
    bad = np.argwhere(~(abs(found) <= LARGEST))
    if len(bad):
        place = tuple(bad[0].tolist())
        raise InputError("wheel-torque-not-finite", place=list(place), value=f"{found[place]:g}")
    return found.reshape(-1, count)


def _members(begin: Starts, systems: int, attitude: str, velocity: str) -> int:
    """Return the number of members; a ValueError where two axes of members have other lengths than 1."""
    torques = 1 if begin.wheel_torque is None else len(begin.wheel_torque)
    lengths = {"system": systems, attitude: len(begin.quaternion), velocity: len(begin.velocity)}
    lengths |= {"load_scale": len(begin.load_scale), "wheel_torque": torques}
    m = max(lengths.values())
    if 0 in lengths.values():
        empty = next(name for name, n in lengths.items() if n == 0)
        raise ValueError(f"{empty} has no members")
    if any(n not in (1, m) for n in lengths.values()):
        found = ", ".join(f"{name} {n}" for name, n in lengths.items() if n > 1)
        raise ValueError(f"every member axis must have the same length, or 1; the lengths are: {found}")
    return m


def _projected(begin: Starts, systems: SystemStack, axis: Array | None, project: bool, t_start: float | None) -> Starts:
    """Remove the part of W along the constrained axes `axis`, which a prescribed spin brings.

    More than round-off, and other than that spin, is refused unless `project`. Without `axis` the start is one of this
    constraint, and kept.
    """
    if axis is None:
        if systems.axis is None:
            return begin
        return begin._replace(removed=(begin.velocity * systems.axis).sum(axis=1))
    W, is_one = begin.velocity, len(begin.velocity) == len(axis) == 1
    velocity, spin, fine = separate_spin(*((W[0].tolist(), axis[0].tolist()) if is_one else (W.T, axis.T)))
    time = begin.time or 0.0 if t_start is None else as_number(t_start, "t_start")
    if not project and not np.all(fine):
        along, prescribed = np.atleast_1d(spin), systems.spin_at(time)
        fine = np.atleast_1d(fine) | (abs(along - prescribed) <= SAME * np.linalg.norm(W, axis=1))
    if not project and not np.all(fine):
        k = int(np.argmin(fine))
        n = np.round(axis[k if len(axis) > 1 else 0], 12).tolist()
        member = "" if is_one else f" of member {k}"
        other = ""
        if systems.spin is not None:
            rate = prescribed[k if len(prescribed) > 1 else 0]
            other = f", about which its prescribed spin is {rate:.6g} rad/s: give that, or none"
        raise ValueError(
            f"the initial angular velocity{member} has the component {along[k]:.6g} rad/s along the "
            f"constrained body axis {n}{other}; project=True removes it"
        )
    across = np.ascontiguousarray(np.array(velocity).T.reshape(-1, 3))
    return begin._replace(velocity=across, removed=np.atleast_1d(spin))


def separate_spin(W: Any, axis: Any) -> tuple[tuple[Any, Any, Any], Any, Any]:
    """Return W without its component along the unit axis, that component, and whether it is round-off.

    The three components are numbers, or arrays. Where only round-off is left of W, nothing is; where only round-off
    would be removed, nothing is either, so that to remove it twice is to remove it once.
    """
    (x, y, z), (a, b, c) = W, axis
    spin, round_off = x * a + y * b + z * c, 4 * EPS * (abs(x) + abs(y) + abs(z))
    removed = spin * (abs(spin) > round_off)
    u, v, w = x - removed * a, y - removed * b, z - removed * c
    is_left = 1.0 * (abs(u) + abs(v) + abs(w) > round_off)
    return (u * is_left, v * is_left, w * is_left), spin, abs(spin) <= SAME * (x * x + y * y + z * z) ** 0.5


def last_state(start: Any) -> Starts | None:
    """Return the last state of a run, or None where `start` holds no velocities."""
    if isinstance(start, BodyState):
        z, wheels = start._carried
        p, W = np.array([start.quaternion]), np.array([start.material_angular_velocity])
        return Starts(p, W, time=start.time, internal=np.array([z]) if z else None, wheels=wheels)
    if hasattr(start, "data_vars"):
        has_velocities = "director_velocities" in start
        start = as_dataset(start, "a run for start=", [name for name in NEEDED if has_velocities or name in start])
    if not hasattr(start, "director_velocities"):
        return None
    require_states(start)
    if isinstance(start, Trajectory):
        own = start.states.part(slice(-1, None))
        time, internal = float(start.time[-1]), own.internal
        memory = None if start.memory is None else start.memory[None]
        return Starts(*own[:3], np.ones(1), time, remaining_grid_of(start), memory, internal)
    q, v, time = (np.array(getattr(start, name))[-1] for name in NEEDED)
    as_rotation(q.T)
    p, W, N = states_of(q, as_array(v, "director_velocities", (3, 3)))
    if "quaternion" in start and start["quaternion"].values[-1] @ p < 0:
        p = -p
    internal = start["internal_state"].values[-1:] if "internal_state" in start else None
    return Starts(
        p[None], W[None], N[None], np.ones(1), float(time), remaining_grid_of(start), _memory(start), internal
    )


def remaining_grid_of(start: Any) -> Segments | None:
    """Return the time grid of a run, counted from where it ends, with what it has left; None where it has none."""
    step, origin = getattr(start, "step", None), getattr(start, "origin", None)
    if step is None:
        return None
    h, first, last = as_number(step, "the step of start="), float(start.time[0]), float(start.time[-1])
    if (known := segments_from(getattr(start, "segments", None))) is not None and len(known.sizes) > 1:
        j = max(int(np.searchsorted(known.borders, last)) - 1, 0)
        return known.after(known.numbers[j] + round((last - known.borders[j]) / known.sizes[j]))
    begin = first if origin is None else as_number(origin, "the origin of start=")
    if not h > 0 or is_too_short(last - begin, h):
        return None
    return Segments((begin, last), (-round((last - begin) / h), 0), (h,))


def _memory(start: Any) -> Array | None:
    """Return the internal state of the integrator at the end of a run, (1, k)."""
    text = getattr(start, "attrs", {}).get("memory")
    if text is None:
        return None
    try:
        return np.array(json.loads(text), dtype=np.float64)[None]
    except (TypeError, ValueError) as error:
        raise ValueError(f"the attribute memory of start= is damaged: {error}") from error


def require_states(start: Any) -> None:
    """Raise a ValueError where a run has no state to continue from."""
    if not np.size(getattr(start, "time", 0)):
        raise ValueError("start= has no states: there is nothing to continue from")


def _systems_of(start: Any) -> SystemStack | None:
    """Return what a run is of, as far as it states that."""
    if "euler_inertia" in getattr(start, "data_vars", {}):
        axes = start.constrained_axis.values if "constrained_axis" in start else None
        return SystemStack(start.euler_inertia.values, axes, physical=False)
    own = getattr(start, "system", None)
    if not isinstance(own, DirectorSystem) and (text := getattr(start, "attrs", {}).get("system")) is not None:
        own = DirectorSystem.from_json(text)
    return stacked(own) if isinstance(own, DirectorSystem) else None


def _new_axis(start: Any, systems: SystemStack) -> Array | None:
    """Return the axes that constrain bodies as they did not in the run `start`, whose states obey its own constraints.

    A body of another inertia is warned of.
    """
    if (found := _systems_of(start)) is None:
        return systems.axis
    gap, size, axis = abs(found.inertia - systems.inertia).max(axis=(1, 2)), abs(systems.inertia), systems.axis
    if (gap > SAME * size.max(axis=(1, 2))).any():
        warn(InputWarning("start-other-inertia", most=float(gap.max())))
    if axis is None or found.axis is None or found.axis.shape != axis.shape:
        return axis
    return None if abs(found.axis - axis).max() <= SAME else axis


def _records(start: Any) -> Sequence[Record]:
    """Return what the load at the end of a run is, as far as it states that."""
    if isinstance(start, Trajectory):
        return start.load
    return recorded(start, "load") if "load" in start.attrs else []


def _require_memory(records: Sequence[Record], load: Load, begin: Starts) -> None:
    """Warn of wheels and a memory that the load does not carry on; a ValueError where a run has lost their states."""
    before, now = ([one for one in many if one["kind"] == "memory"] for many in (records, load.description))
    if before and now and begin.internal is None:
        raise ValueError("start= lacks internal_state, from which its wheels and memory continue; keep all variables")
    a, b = ([(one["inertia"], *one["wheel"]) for one in many if "wheel" in one] for many in (before, now))
    if before and not (len(before) == len(now) and _are_same(a, b)):
        had, has = (load_in_words(many) if many else "none" for many in (before, now))
        warn(InputWarning("start-other-memory", had=had, has=has, kept=KEPT if now else "what they have is lost"))


def _are_same(before: Sequence[Sequence[float]], now: Sequence[Sequence[float]]) -> bool:
    """Whether wheels, each of an inertia and an axis, are the same."""
    return len(before) == len(now) and np.allclose(before, now, rtol=SAME, atol=0.0)


def _wheel_in_words(wheel: Sequence[float]) -> str:
    return f"wheel of {wheel[0]:.6g} kg m² about {vector_text(wheel[1:])}"


def _of_member(start: Any) -> Any:
    """Return the ensemble of one that a member of an ensemble is; anything else as it is."""
    if not hasattr(start, "data_vars") or "member" in start.dims:
        return start
    is_one = "material_angular_velocity" in start and "director_velocities" not in start
    return start.expand_dims("member") if is_one or "member" in start.coords else start


def _of_run(start: Any) -> Starts:
    """Return the last states of an ensemble, or that of a run."""
    require_states(start)
    if "member" not in getattr(start, "dims", ()):
        state = last_state(start)
        if state is None or state.time is None:
            raise ValueError("start= must be a run or an ensemble; for attitudes alone there is rotation=")
        return state._replace(memory=None)
    names = [name for name in ("quaternion", "material_angular_velocity") if name not in start]
    if names:
        them = "them" if len(names) > 1 else "it"
        raise ValueError(f"start= lacks {' and '.join(names)}; store {them} with variables= in the earlier run")
    if "time" not in start.indexes:
        words = "give rotation=start.quaternion, material_angular_velocity=start.material_angular_velocity and t_start="
        raise ValueError(f"start= has no dimension time; {words}")
    if others := [str(dim) for dim in start.quaternion.dims if dim not in ("member", "time", "quat")]:
        raise ValueError(f"start= has the dimension {others[0]}, and not member: start.rename({others[0]}='member')")
    last = as_dataset(start, "an ensemble for start=").isel(time=-1)
    p, W = (as_floats(last[name].values, f"start.{name}") for name in ("quaternion", "material_angular_velocity"))
    N = None
    failed = np.flatnonzero(~np.isfinite(p).all(axis=1))
    if failed.size:
        raise ValueError(f"{failed.size} members of start= have failed, the first is {int(failed[0])}")
    if "director_velocities" in start:
        v = as_floats(last.director_velocities.values, "start.director_velocities")
        _, W, N = states_of(attitudes(p).swapaxes(1, 2), v)
    elif "energy-momentum" in start.attrs.get("integrator", ""):
        raise ValueError("start= lacks director_velocities, which energy-momentum carries on")
    internal = last["internal_state"].values if "internal_state" in start else None
    return Starts(p, W, N, time=float(last.time), grid=remaining_grid_of(start), internal=internal)
