"""An ensemble as a dataset: the variables of a run with a member axis in front, status of each member, reductions."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.arrays import Array
from ..geometry.values import among, as_list, shown
from ..integrators import Integrator, Status
from ..integrators.ensemble import Ensemble, Outcome
from ..models.stack import SystemStack
from . import observables as obs
from .reductions import named
from .trajectory import FORMAT_VERSION, VARIABLES, versions

if TYPE_CHECKING:
    import xarray

NODES = tuple(name for name, (dims, *_) in VARIABLES.items() if dims[0] == "time")
STATE = ("quaternion", "material_angular_velocity")


def checked(variables: str | Iterable[str]) -> tuple[str, ...]:
    """Return the names of variables in the order of a run; ValueError where one is unknown."""
    if isinstance(variables, str):
        names: Iterable[str] = NODES if variables == "all" else (variables,)
    else:
        names = as_list(variables, "variables")
    for name in names:
        if not among(name, NODES):
            hint = "; those of intervals come as reductions" if among(name, VARIABLES) else ""
            raise ValueError(f"an ensemble has no variable {shown(name)}{hint}; known are all, {', '.join(NODES)}")
    return tuple(name for name in NODES if name in names)


def bytes_of(variables: Iterable[str], members: int, times: int) -> float:
    """Return what the states of an ensemble take in memory while they are made."""
    sizes = {"time": 1, "director": 3, "axis": 3, "quat": 4}
    numbers = [int(np.prod([sizes[dim] for dim in VARIABLES[name][0]])) for name in variables if name not in STATE]
    return 8.0 * members * (times * (7 + sum(numbers) + 36 * bool(numbers)) + 25)


def dataset(
    scheme: Integrator, ensemble: Ensemble, outcome: Outcome, variables: tuple[str, ...], reduce: tuple[str, ...]
) -> xarray.Dataset:
    """Return the outcome of an ensemble as a dataset; messages of failures are left to the caller."""
    import xarray

    systems, described = ensemble.systems, dict[str, Any]()
    for name, values in states(variables, systems, outcome).items():
        dims, units, long_name, symbol = VARIABLES[name]
        described[name] = (("member", *dims), values, {"units": units, "long_name": long_name, "symbol": symbol})
    if outcome.watched is not None:
        span = ensemble.t_end - ensemble.t_start
        described |= named(outcome.watched, reduce, systems, bool(ensemble.load.terms), span)
    meanings = " ".join(status.name.lower() for status in Status)
    flags = {"flag_values": [int(status) for status in Status], "flag_meanings": meanings}
    status = outcome.failures[:, 0].astype(np.int64)
    described["status"] = ("member", status, {"long_name": "how the run of the member ended", **flags})
    described |= _of_members(ensemble)
    coordinates = {
        "member": np.arange(len(ensemble)),
        "time": ("time", ensemble.output, {"units": "s", "long_name": "time", "symbol": "t"}),
        "director": [1, 2, 3],
        "axis": ["x", "y", "z"],
        "quat": ["x", "y", "z", "w"],
    }
    used = {dim for dims, *_ in described.values() for dim in ([dims] if isinstance(dims, str) else dims)}
    return xarray.Dataset(
        described, {name: c for name, c in coordinates.items() if name in used}, _record(scheme, ensemble)
    )


def states(names: tuple[str, ...], systems: SystemStack, outcome: Outcome) -> dict[str, Array]:
    """Return variables of the stored states, (m, k, ...)."""
    p, W = outcome.quaternion, outcome.velocity
    found = {"quaternion": p, "material_angular_velocity": W}
    if set(names) <= set(found):
        return {name: found[name] for name in names}
    assert systems.dead_force is not None
    E, dead = systems.euler_inertia[:, None], systems.dead_force[:, None]
    n = np.array([[0.0, 0.0, 1.0]]) if systems.axis is None else systems.axis
    q = attitudes(p).swapaxes(-1, -2)
    x, y, z = np.moveaxis(W, -1, 0)
    o = np.zeros_like(x)
    V = np.stack([o, z, -y, -z, o, x, y, -x, o], axis=-1).reshape(*x.shape, 3, 3)
    v = (V if outcome.normal is None else V + outcome.normal) @ q
    pi = obs.spatial_momentum(q, v, E)
    made: dict[str, Callable[[], Array]] = {
        "directors": lambda: q,
        "director_velocities": lambda: v,
        "angular_velocity": lambda: obs.angular_velocity(q, v),
        "spatial_momentum": lambda: pi,
        "material_momentum": lambda: obs.material(q, pi),
        "kinetic_energy": lambda: obs.kinetic_energy(v, E),
        "potential_energy": lambda: -np.sum(q * dead, axis=(-2, -1)),
        "twist_rate": lambda: np.sum(W * n[:, None], axis=-1),
        "orthonormality_defect": lambda: obs.orthonormality_defect(q),
    }
    return {name: found[name] if name in found else made[name]() for name in names}


def attitudes(quaternion: Array) -> Array:
    """Return Λ (..., 3, 3) of unit quaternions (..., 4), scalar last, by plain sums: each has bits of its own."""
    x, y, z, w = np.moveaxis(quaternion, -1, 0)
    xx, yy, zz, xy, xz, yz, wx, wy, wz = 2 * np.array([x * x, y * y, z * z, x * y, x * z, y * z, w * x, w * y, w * z])
    rows = (1 - (yy + zz), xy - wz, xz + wy, xy + wz, 1 - (xx + zz), yz - wx, xz - wy, yz + wx, 1 - (xx + yy))
    return np.stack(rows, axis=-1).reshape(*x.shape, 3, 3)


def _of_members(ensemble: Ensemble) -> dict[str, Any]:
    """Return what differs from member to member but for the starts: bodies and scales of the load."""
    systems, found = ensemble.systems, dict[str, Any]()
    if len(systems) > 1:
        inertia = {"units": "kg m2", "long_name": "Euler inertia", "symbol": "E"}
        found["euler_inertia"] = (("member", "row", "column"), systems.euler_inertia, inertia)
        if systems.axis is not None:
            axis = {"units": "1", "long_name": "constrained body axis", "symbol": "n"}
            found["constrained_axis"] = (("member", "director"), systems.axis, axis)
        if systems.dead_force is not None and systems.dead_force.any():
            force = {"units": "N m", "long_name": "dead forces on the directors", "symbol": "f^i"}
            found["dead_force"] = (("member", "director", "axis"), systems.dead_force, force)
    if len(ensemble.load_scale) > 1:
        scale = {"units": "1", "long_name": "factor of the load", "symbol": "c"}
        found["load_scale"] = ("member", ensemble.load_scale, scale)
    return found


def _record(scheme: Integrator, ensemble: Ensemble) -> dict[str, Any]:
    """Return how the runs were made, as plain attributes."""
    systems, scale = ensemble.systems, ensemble.load_scale
    load = float(scale[0]) * ensemble.load if len(scale) == 1 and ensemble.load.terms else ensemble.load
    body = {"system": systems[0].to_json()} if len(systems) == 1 else {}
    return {
        "format_version": FORMAT_VERSION,
        "title": f"{len(ensemble)} {systems.name} rigid bodies, {scheme.name}",
        "conventions": "Λ maps body to space; directors are the rows of the (3, 3) arrays, d_i = Λ E_i; quaternions "
        "have the scalar last; NaN stands in what failed members have not reached",
        **body,
        "load": json.dumps(load.description),
        "integrator": json.dumps({"name": scheme.name, **asdict(scheme)}),
        **({} if ensemble.asked is not None else {"step": ensemble.step}),
        **({} if ensemble.before is None else {"origin": ensemble.before.origin}),
        "versions": json.dumps(versions()),
    }
