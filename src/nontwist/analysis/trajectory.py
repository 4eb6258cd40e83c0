"""A run as plain arrays, and as a dataset with names, units and the record of how it was made."""

from __future__ import annotations

import json
import platform
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..integrators import Integrator
from ..models.constraints import LABELS
from ..models.system import DirectorSystem
from . import observables as obs

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
    directors : (n+1, 3, 3) array, rows d_i
    director_velocities : (n+1, 3, 3) array, 1/s
    multipliers : (n, m) array, N m
        Mean over each interval: λ and μ (m = 7: 11, 22, 33, 23, 13, 12, nh), λ (6), μ (1) or none (0).
    moment : (n, 3) array, N m, spatial
        Mean moment of the load over each interval, its impulse over the length; gravity not included.
    load_work : (n,) array, J, as the energy balance of the scheme says
    newton_iterations : (n,) array of int, maximum over each interval; None where nothing is iterated
    status : int, see `Status`
    message : str
    memory : array, the last state as the integrator carries it: `start=` continues from it bit for bit
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
    directors: Array
    director_velocities: Array
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

        return Rotation.from_matrix(np.swapaxes(self.directors, -1, -2))

    def to_dataset(self) -> xarray.Dataset:
        """Return the run as an `xarray.Dataset` with all observables, units and the record of how it was made."""
        import xarray

        states = state_dataset(self.system, self.time, self.directors, self.director_velocities)
        interval: dict[str, Any] = {"moment": self.moment, "load_work": self.load_work}
        coordinates: dict[str, Any] = {
            "midtime": (
                "midtime",
                (self.time[1:] + self.time[:-1]) / 2,
                {"units": "s", "long_name": "middle of the interval", "symbol": "t_m"},
            )
        }
        if count := self.multipliers.shape[1]:
            interval["multipliers"] = self.multipliers
            coordinates["constraint"] = list(LABELS[-1:] if count == 1 else LABELS[:count])
        if self.system.axis is not None:
            interval["reaction_moment"] = -self.multipliers[:, -1]
        if self.newton_iterations is not None:
            interval["newton_iterations"] = self.newton_iterations
        intervals = xarray.Dataset(_described(interval), coordinates)
        return states.merge(intervals).assign_attrs(self.record())

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
    """Return the versions of Python and of the packages that a run depends on; looked up once, at 1 ms each."""
    packages = {name: version(name) for name in ("nontwist", "numpy", "scipy", "numba", "xarray")}
    return {"python": platform.python_version(), **packages}


def state_dataset(system: DirectorSystem, time: Array, q: Array, v: Array) -> xarray.Dataset:
    """Return all observables of the states (q, v) on `time`."""
    import xarray

    w, pi = obs.angular_velocity(q, v), obs.spatial_momentum(q, v, system.euler_inertia)
    variables = {
        "directors": q,
        "director_velocities": v,
        "quaternion": obs.quaternions(q),
        "angular_velocity": w,
        "spatial_momentum": pi,
        "material_angular_velocity": obs.material(q, w),
        "material_momentum": obs.material(q, pi),
        "kinetic_energy": obs.kinetic_energy(v, system.euler_inertia),
        "potential_energy": obs.potential_energy(q, system),
        "twist_rate": obs.twist_rate(q, v, system),
        "orthonormality_defect": obs.orthonormality_defect(q),
    }
    coordinates = {
        "time": ("time", time, {"units": "s", "long_name": "time", "symbol": "t"}),
        "director": [1, 2, 3],
        "axis": ["x", "y", "z"],
        "quat": ["x", "y", "z", "w"],
    }
    return xarray.Dataset(_described(variables), coordinates)


_NODE, _VECTOR, _BODY, _MID = ("time",), ("time", "axis"), ("time", "director"), ("midtime",)
VARIABLES: dict[str, tuple[tuple[str, ...], str, str, str]] = {
    "directors": (("time", "director", "axis"), "1", "directors", "d_i"),
    "director_velocities": (("time", "director", "axis"), "s-1", "director velocities", "d_i'"),
    "quaternion": (("time", "quat"), "1", "unit quaternion of Λ, scalar last", "p"),
    "angular_velocity": (_VECTOR, "rad s-1", "spatial angular velocity", "w"),
    "spatial_momentum": (_VECTOR, "kg m2 s-1", "spatial angular momentum", "π"),
    "material_angular_velocity": (_BODY, "rad s-1", "material angular velocity", "W"),
    "material_momentum": (_BODY, "kg m2 s-1", "material angular momentum", "Π"),
    "kinetic_energy": (_NODE, "J", "kinetic energy", "K"),
    "potential_energy": (_NODE, "J", "potential energy of the dead forces", "V"),
    "twist_rate": (_NODE, "rad s-1", "twist rate about the body axis", "ψ'"),
    "orthonormality_defect": (_NODE, "1", "largest entry of |q qᵀ - I|", "δ"),
    "moment": (("midtime", "axis"), "N m", "mean moment of the load", "m"),
    "multipliers": (("midtime", "constraint"), "N m", "mean Lagrange multipliers", "λ, μ"),
    "reaction_moment": (_MID, "N m", "mean moment of the constraint on the body about its axis", "-μ"),
    "load_work": (_MID, "J", "work of the load over the interval", "A"),
    "newton_iterations": (_MID, "1", "largest number of Newton iterations of a step", "n"),
}


def _described(variables: dict[str, Any]) -> dict[str, tuple[tuple[str, ...], Array, dict[str, str]]]:
    described = {}
    for name, array in variables.items():
        dims, units, long_name, symbol = VARIABLES[name]
        described[name] = (dims, array, {"units": units, "long_name": long_name, "symbol": symbol})
    return described
