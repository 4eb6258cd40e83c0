"""A run as plain arrays, and as a dataset with names, units and the record of how it was made."""

from __future__ import annotations

import json
import platform
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..geometry.attitudes import States, director_velocities, directors
from ..integrators import Integrator
from ..models.constraints import LABELS
from ..models.system import DirectorSystem
from .variables import COORDINATES, NODES, coordinates, described, observables_of_one

if TYPE_CHECKING:
    import xarray
    from scipy.spatial.transform import Rotation

FORMAT_VERSION = 1


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A run: n + 1 stored states and the n intervals between them.

    Attributes
    ----------
    system : DirectorSystem
    integrator : Integrator
    step : float, s, or None where the output times were given
    load : list of dict, the load as data
    time : (n+1,) array, s
    states : States
        The stored states as a tuple of arrays: quaternions, W, and where the integrator has them N, the symmetric part
        of the director velocities in the body (11, 22, 33, 23, 13, 12), or directors that leave SO(3) by its error.
    multipliers : (n, m) array, N m
        Mean over each interval: λ and μ (m = 7: 11, 22, 33, 23, 13, 12, nh), λ (6), μ (1) or none (0).
    moment : (n, 3) array, N m, spatial
        Mean moment of the load over each interval, its impulse over the length; gravity not included.
    load_work : (n,) array, J, by the energy balance of the scheme
    newton_iterations : (n,) array of int, maximum over each interval; None for integrators without iteration
    status : int, see `Status`
    message : str
    memory : array, the last internal state of the integrator: `start=` continues from it bit for bit
    origin : float, s, where the time grid begins if the run continues that of another one, else None

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
    step: float | None
    load: list[dict[str, Any]]
    time: Array
    states: States
    multipliers: Array
    moment: Array
    load_work: Array
    newton_iterations: NDArray[np.int64] | None
    status: int = 0
    message: str = "done"
    memory: Array | None = None
    origin: float | None = None

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
    def directors(self) -> Array:
        """The directors at the stored times, rows d_i of (n+1, 3, 3)."""
        carried = self.states.directors
        return directors(self.quaternion) if carried is None else carried[:, 0]

    @cached_property
    def director_velocities(self) -> Array:
        """Their velocities, rows of (n+1, 3, 3), 1/s."""
        carried = self.states.directors
        return director_velocities(self.directors, *self.states[1:3]) if carried is None else carried[:, 1]

    def to_dataset(self) -> xarray.Dataset:
        """Return the run as an `xarray.Dataset` with all observables, units and the record of how it was made."""
        import xarray

        variables: dict[str, Any] = observables_of_one(NODES, self.system, self.states)
        variables |= {"moment": self.moment, "load_work": self.load_work}
        along: dict[str, Any] = {"time": self.time, "midtime": (self.time[1:] + self.time[:-1]) / 2}
        if count := self.multipliers.shape[1]:
            variables["multipliers"] = self.multipliers
            along["constraint"] = list(LABELS[-1:] if count == 1 else LABELS[:count])
        if self.system.axis is not None:
            variables["reaction_moment"] = -self.multipliers[:, -1]
        if self.newton_iterations is not None:
            variables["newton_iterations"] = self.newton_iterations
        return xarray.Dataset(described(variables), coordinates((*along, *COORDINATES), **along), self.record())

    def record(self) -> dict[str, Any]:
        """Return how the run was made, as plain attributes: enough to run it again."""
        memory = {} if self.memory is None else {"memory": json.dumps(self.memory.tolist())}
        grid = {"step": self.step, "origin": self.origin}
        return {
            "format_version": FORMAT_VERSION,
            "title": f"{self.system.name} rigid body, {self.integrator.name}",
            "conventions": "Λ maps body to space; directors are the rows of the (3, 3) arrays, d_i = Λ E_i; "
            "quaternions have the scalar last; reaction_moment = -multipliers[nh]",
            "system": self.system.to_json(),
            "load": json.dumps(self.load),
            "integrator": json.dumps({"name": self.integrator.name, **asdict(self.integrator)}),
            **{name: value for name, value in grid.items() if value is not None},
            "status": self.status,
            "message": self.message,
            "versions": json.dumps(versions()),
            **memory,
        }


@cache
def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that a run depends on; looked up once."""
    from importlib.metadata import PackageNotFoundError, version

    packages = {name: version(name) for name in ("nontwist", "numpy", "scipy", "llvmlite", "xarray")}
    with suppress(PackageNotFoundError):  # it is an extra
        packages["numba"] = version("numba")
    return {"python": platform.python_version(), **packages}


def state_dataset(system: DirectorSystem, time: Array, p: Array, W: Array) -> xarray.Dataset:
    """Return all observables of states of a body with tangent velocities, (k, 4) and (k, 3), on `time`."""
    import xarray

    found = observables_of_one(NODES, system, States(p, W))
    return xarray.Dataset(described(found), coordinates(("time", *COORDINATES), time=time))
