"""A run as plain arrays, and as a dataset with names, units and the record of how it was made."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry.arrays import Array, Dataset, Rotation, largest_size
from ..geometry.attitudes import States, director_velocities, directors
from ..geometry.values import counted
from ..integrators import Integrator
from ..integrators.ivp import Intervals, Segments
from ..loads import Load
from ..loads.friction import ROUND_OFF
from ..loads.kinds import is_rotor, load_of, rotors_of
from ..machine import cached_property
from ..models.equations import LABELS
from ..models.system import DirectorSystem
from .variables import (
    EVENTS,
    NODES,
    OBSERVABLES,
    ROTORS,
    WHEELS,
    Acting,
    Described,
    Wheels,
    assembled,
    described,
    labelled,
    names_of,
    observables_of_one,
)

FORMAT_VERSION = 1
READ_LATER = {"states", "memory", *Intervals._fields}


class Events(NamedTuple):
    """The events of a run, in the order of their times."""

    names: tuple[str, ...]  # of the event functions
    number: NDArray[np.int64]  # (k,) of the function
    time: Array  # (k,)
    quaternion: Array  # (k, 4)
    velocity: Array  # (k, 3)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A run: n + 1 stored states and the n intervals between them.

    Attributes
    ----------
    system : DirectorSystem
    integrator : Integrator
    segments : Segments, or None where the output times were given
        The segments of equal steps between the kinks of the load: `borders` (s), `numbers` of the nodes there, `sizes`
        of their steps (s).
    load : list of dict, the load as data
    time : (n+1,) array, s
    states : States
        The stored states as a tuple of arrays: quaternions and W; `internal`, the internal states of loads with memory,
        None where there are none. Some integrators add N, the symmetric part of the
        director velocities in the body (11, 22, 33, 23, 13, 12), or the directors themselves, which leave SO(3) by the
        error of the integrator.
    multipliers : (n, m) array, N m
        Mean over each interval: λ and μ (m = 7: 11, 22, 33, 23, 13, 12, nh), λ (6), μ (1) or none (0).
    moment : (n, 3) array, N m, spatial
        Mean moment of the load over each interval: its impulse divided by the length of the interval. Gravity is not
        included.
    load_work : (n,) array, J
        Work of the load over each interval, by the energy balance of the scheme.
    newton_iterations : (n,) array of int, or None for integrators without iteration
        Maximum over each interval.
    status : int, see `Status`
    message : str
    tolerance, error_estimate : float, or None where the step was given
        The tolerance of the run and the estimate of its error: the larger of the error of the attitude (rad) and that
        of W relative to its largest magnitude.
    warning : str, or None
        The warning about a step that is too coarse.
    dead_moment : (n, 3) array, N m, spatial, or None where the integrator does not compute it
        For bodies with a constrained axis, the mean moment of gravity, other dead forces and linear potentials over
        each interval; for other bodies 0. Under other potentials it is not known.
    twist : (n,) array, rad, or None where the integrator does not count it
        Twist over each interval, about the constrained axis or E3, from the stages of the steps.
    dissipated_energy : (n,) array, J, or None without dry friction
        What dry friction takes over each interval.
    memory : array, or None
        The last internal state of the integrator, from which `start=` continues bit for bit.
    potentials : Load
        The potentials of the load, from which `potential_energy` is computed.
    events : Events, or None where none were asked for
        `names` of the event functions; `number` of the function, `time` (s), `quaternion` and `velocity` of each event.

    Examples
    --------
    >>> from nontwist import integrate, nontwisting
    >>> start = {"material_angular_velocity": (0, 2, 0)}
    >>> trajectory = integrate(nontwisting([3, 4, 5]), t_end=1, step=0.1, integrator="split", **start)
    >>> trajectory.directors.shape
    (11, 3, 3)
    >>> round(float(trajectory.rotation[-1].magnitude()), 9)
    2.0
    >>> trajectory.to_dataset().kinetic_energy.attrs["units"]
    'J'
    """

    system: DirectorSystem
    integrator: Integrator
    segments: Segments | None
    load: list[dict[str, Any]]
    time: Array
    states: States
    multipliers: Array
    moment: Array
    load_work: Array
    newton_iterations: NDArray[np.int64] | None
    status: int = 0
    message: str = "done"
    memory: Array | None = field(default_factory=lambda: None)  # no class attribute: see __getattr__
    dead_moment: Array | None = field(default_factory=lambda: None)
    twist: Array | None = field(default_factory=lambda: None)
    dissipated_energy: Array | None = field(default_factory=lambda: None)
    tolerance: float | None = None
    error_estimate: float | None = None
    warning: str | None = None
    events: Events | None = None
    potentials: Load | None = None

    @property
    def t_events(self) -> list[Array]:
        """Times of the events, s, one array for each event function, as in SciPy's `solve_ivp`."""
        if self.events is None:
            return []
        return [self.events.time[self.events.number == k] for k in range(len(self.events.names))]

    def __repr__(self) -> str:
        span = " to ".join(f"{t:.6g}" for t in (*self.time[:1], *self.time[-1:]))
        states = counted(len(self.time), "state")
        return f"<Trajectory: {self.system!r}, {self.integrator.name}, {span} s, {states}: {self.message}>"

    @classmethod
    def _later(cls, known: dict[str, Any], read: Callable[[], dict[str, Any]] | None) -> Trajectory:
        """Return a run of the `known` attributes; `read` gives others once one is asked for, or the next `_read`."""
        run = cls.__new__(cls)
        attributes = vars(run)
        attributes.update(known)
        attributes["_read"] = read
        return run

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            while name not in vars(self):
                read = vars(self).get("_read")
                if read is None or name not in READ_LATER:
                    raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
                vars(self).update(read())  # twice where threads meet, with the same numbers
            return vars(self)[name]

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes, all of them read."""
        return vars(self) | {known.name: getattr(self, known.name) for known in fields(self)} | {"_read": None}

    @property
    def step(self) -> float | None:
        """The step, s, or the longest one if steps differ; None where the output times were given."""
        return None if self.segments is None else self.segments.longest

    @property
    def origin(self) -> float | None:
        """Start of the time grid, s, if it is before the first state, else None."""
        if self.segments is None or not len(self.time):
            return None
        return grid_record(self.segments, float(self.time[0])).get("origin")

    @cached_property
    def rotation(self) -> Rotation:
        """Λ at the stored times as a `scipy.spatial.transform.Rotation`; maps body to space."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.quaternion)

    @property
    def quaternion(self) -> Array:
        """Unit quaternions of Λ at the stored times, (n+1, 4), scalar last."""
        return self.states.quaternion

    @property
    def material_angular_velocity(self) -> Array:
        """W at the stored times, (n+1, 3), rad/s."""
        return self.states.velocity

    @cached_property
    def _fastest(self) -> float:
        """The largest |W| at the stored times, rad/s."""
        return largest_size(self.material_angular_velocity)

    @cached_property
    def directors(self) -> Array:
        """The directors at the stored times, rows d_i of (n+1, 3, 3)."""
        own_directors = self.states.directors
        return directors(self.quaternion) if own_directors is None else own_directors[:, 0]

    @cached_property
    def director_velocities(self) -> Array:
        """Their velocities, rows of (n+1, 3, 3), 1/s."""
        own_directors = self.states.directors
        return director_velocities(self.directors, *self.states[1:3]) if own_directors is None else own_directors[:, 1]

    @property
    def rotor_momentum(self) -> Array | None:
        """Momentum of rotors and wheels relative to the body, in body components, (n+1, 3), kg m² s⁻¹; None: none."""
        has_rotors = any(map(is_rotor, self.load))
        return self.observables("rotor_momentum")["rotor_momentum"] if has_rotors else None

    @property
    def wheel_momentum(self) -> Array:
        """Axial momentum of each wheel of the load in space, (n+1, k), kg m² s⁻¹."""
        return self.observables("wheel_momentum")["wheel_momentum"]

    @property
    def sticking(self) -> NDArray[np.int64]:
        """The number of dry frictions of the load whose rates are zero at the stored times, (n+1,)."""
        own, W = load_of(one for one in self.load if "dry_friction" in one).frictions, self.material_angular_velocity
        zero = ROUND_OFF * np.linalg.norm(W, axis=1)
        return sum((abs(term.rates(W)) <= zero for term in own), np.zeros(len(W), dtype=np.int64))

    def observables(self, variables: str | Iterable[str]) -> dict[str, Array]:
        """Return variables of the stored states by name, without a dataset.

        Parameters
        ----------
        variables : "all" or names
            Such as "kinetic_energy" and "spatial_momentum".

        Returns
        -------
        dict of str to (n, ...) array
            In the order of the variables of a run; SI units.

        Raises
        ------
        ValueError
            There is no variable of this name.
        """
        names = names_of(variables, "a trajectory", "; those of intervals are its attributes")
        acting = Acting(self.potentials or Load(), rotors_of(self.load), Wheels.of(self.load), self.time)
        return observables_of_one(names, self.system, self.states, acting)

    def to_dataset(self) -> Dataset:
        """Return the run as an `xarray.Dataset` with all observables, units and the attributes of `record`."""
        return self._dataset({})

    def _dataset(self, more: Mapping[str, Described], **labels: ArrayLike) -> Dataset:
        """Return the run as a dataset with `more` variables and the `labels` of their dims."""
        variables: dict[str, Any] = self.observables(nodes_of(self.load))
        if self.states.internal is not None:
            variables["internal_state"] = self.states.internal
        variables |= {"moment": self.moment, "load_work": self.load_work}
        if count := self.multipliers.shape[1]:
            variables["multipliers"] = self.multipliers
        if self.system.axis is not None:
            variables["reaction_moment"] = -self.multipliers[:, -1]
            if self.dead_moment is not None:
                rate = np.diff(variables["spatial_momentum"], axis=0) / np.diff(self.time)[:, None]
                variables["spatial_reaction_moment"] = rate - self.moment - self.dead_moment
        if self.dissipated_energy is not None:
            variables |= {"dissipated_energy": self.dissipated_energy, "sticking": self.sticking}
        if self.twist is not None:
            variables["mean_twist_rate"] = self.twist / np.diff(self.time)
        if self.newton_iterations is not None:
            variables["newton_iterations"] = self.newton_iterations
        beside = dict[str, Described]()
        if self.events is not None:
            variables |= dict(zip(EVENTS, self.events[2:], strict=True))
            names = np.array(self.events.names, dtype=np.str_)[self.events.number]
            beside["event_name"] = (("event",), names, {"long_name": "name of the event function"})
        along: dict[str, Any] = {"time": self.time, "midtime": (self.time[1:] + self.time[:-1]) / 2}
        along["wheel"] = np.arange(1, 1 + sum("wheel" in one for one in self.load))
        along["constraint"] = list(LABELS[-1:] if count == 1 else LABELS[:count])
        return assembled(labelled({**described(variables), **more, **beside}, **along, **labels), self.record())

    def record(self) -> dict[str, Any]:
        """Return how the run was made, as plain attributes that suffice to repeat it."""
        memory = {} if self.memory is None else {"memory": json.dumps(self.memory.tolist())}
        return {
            "format_version": FORMAT_VERSION,
            "title": f"{self.system.name} rigid body, {self.integrator.name}",
            "conventions": "Λ maps body to space; directors are the rows of the (3, 3) arrays, d_i = Λ E_i; "
            "quaternions have the scalar last; reaction_moment = -multipliers[nh]",
            "system": self.system.to_json(),
            "load": json.dumps(self.load),
            "integrator": json.dumps({"name": self.integrator.name, **asdict(self.integrator)}),
            **grid_record(self.segments, float(self.time[0]) if len(self.time) else None),
            **({} if self.warning is None else {"warning": self.warning}),
            **({} if self.tolerance is None else {"tolerance": self.tolerance, "error_estimate": self.error_estimate}),
            **({} if self.events is None else {"events": json.dumps(self.events.names)}),
            "status": self.status,
            "message": self.message,
            "versions": json.dumps(versions()),
            **memory,
        }


def grid_record(segments: Segments | None, first: float | None) -> dict[str, Any]:
    """Return a time grid as plain attributes: its longest step, its origin, and the segments where there are more.

    The origin is left out where it is the time `first` of the first state.
    """
    if segments is None:
        return {}
    borders, numbers, sizes = segments
    found: dict[str, Any] = {"step": segments.longest}
    if borders[0] != first:
        found["origin"] = borders[0]
    if len(sizes) > 1:
        found["segments"] = json.dumps({"borders": borders, "numbers": numbers})
    return found


def segments_from(record: Any) -> Segments | None:
    """Return the segments of a record, as an attribute of a run or as they are; None where there are none.

    Raises
    ------
    ValueError
        The record is damaged.
    """
    if record is None or isinstance(record, Segments):
        return record
    try:
        known = json.loads(record)
        borders, numbers = np.array(known["borders"], dtype=np.float64), np.array(known["numbers"])
        steps = np.diff(numbers)
        if not (borders.ndim == 1 and numbers.dtype.kind == "i" and len(borders) == len(numbers) > 1):
            raise ValueError("borders and numbers do not match")
        if not ((np.diff(borders) > 0).all() and np.isfinite(borders).all() and (steps > 0).all()):
            raise ValueError("borders and numbers must increase")
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"the attribute segments of start= is damaged: {error}") from error
    sizes = np.diff(borders) / steps
    return Segments(tuple(borders.tolist()), tuple(numbers.tolist()), tuple(sizes.tolist()))


@cache
def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that a run depends on; looked up once."""
    from importlib.metadata import version

    packages = {name: version(name) for name in ("nontwist", "numpy", "scipy", "llvmlite", "xarray")}
    return {"python": platform.python_version(), **packages}


def state_dataset(system: DirectorSystem, load: Load, time: Array, states: States) -> Dataset:
    """Return all observables of states of a body under a load on `time`."""
    found = observables_of_one(nodes_of(load.description), system, states, Acting.of(load, time))
    if states.internal is not None:
        found["internal_state"] = states.internal
    return assembled(labelled(described(found), time=time, wheel=np.arange(1, 1 + len(load.wheels))), {})


def nodes_of(records: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Return the names of the variables of states that a run under the load of these records has."""
    rotors = ROTORS if any(map(is_rotor, records)) else ()
    return (*NODES, *rotors, *(WHEELS if any("wheel" in one for one in records) else ()), *OBSERVABLES)
