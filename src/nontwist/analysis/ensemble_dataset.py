"""An ensemble as a dataset: the variables of a run with a member axis in front, status of each member, statistics."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from ..integrators.base import IVP, Integrator, Outcome, Status
from .statistics import named
from .trajectory import FORMAT_VERSION, grid_record, nodes_of, versions
from .variables import (
    MEMBERS,
    SIZES,
    STATE,
    Acting,
    about,
    assembled,
    coordinates,
    described,
    names_of,
    nodal,
    observables,
)

if TYPE_CHECKING:
    import xarray


def checked(variables: str | Iterable[str]) -> tuple[str, ...]:
    """Return the names of variables in the order of a run; ValueError where one is unknown."""
    return names_of(variables, "an ensemble", "; those of intervals come as statistics, with reduce=")


def bytes_of(variables: Iterable[str], members: int, times: int) -> float:
    """Return the bytes that the states of an ensemble take while they are computed."""
    numbers = [math.prod(SIZES.get(dim, 4) for dim in about(name)[0][1:]) for name in variables if name not in STATE]
    return 8.0 * members * (times * (7 + sum(numbers) + 36 * bool(numbers)) + 25)


def dataset(
    scheme: Integrator, ensemble: IVP, outcome: Outcome, variables: tuple[str, ...], reduce: tuple[str, ...]
) -> xarray.Dataset:
    """Return the outcome of an ensemble as a dataset; the caller adds the messages of failures."""
    systems = ensemble.systems
    if variables == nodal():
        variables = nodes_of(ensemble.load.description)
    acting = Acting.of(ensemble.load, ensemble.stored_times, ensemble.load_scale)
    found = described(observables(variables, systems, outcome.states, acting), ("member",))
    if outcome.states.internal is not None:
        found |= described({"internal_state": outcome.states.internal}, ("member",))
    if outcome.observed is not None:
        span = ensemble.t_end - ensemble.t_start
        loaded = bool(ensemble.load.without_potentials.terms)
        found |= named(outcome.observed, reduce, systems, loaded, span, ensemble.load.potentials)
    statuses = {int(status): status.name.lower() for status in Status}
    found["status"] = ("member", outcome.failures[:, 0].astype(np.int64), status_attributes(statuses))
    found |= _of_members(ensemble)
    used = {dim for dims, *_ in found.values() for dim in ([dims] if isinstance(dims, str) else dims)}
    along: dict[str, Any] = {"wheel": np.arange(1, 1 + len(ensemble.load.wheels))} if ensemble.load.wheels else {}
    placed = coordinates(used, member=np.arange(len(ensemble)), time=ensemble.stored_times, **along)
    return assembled(found, placed, _record(scheme, ensemble))


def status_attributes(meanings: dict[int, str]) -> dict[str, Any]:
    """Return the attributes of a status by member, from the meaning of each value."""
    flags = {"flag_values": list(meanings), "flag_meanings": " ".join(meanings.values())}
    return {"long_name": "how the run of the member ended", **flags}


def _of_members(ensemble: IVP) -> dict[str, Any]:
    """Return the variables that differ between members, without the starts: bodies and scales of the load."""
    systems, found = ensemble.systems, dict[str, Any]()
    if len(systems) > 1:
        dead = systems.dead_force if systems.has_dead_force else None
        bodies = zip(MEMBERS, (systems.euler_inertia, systems.axis, dead, systems.spin_factor), strict=False)
        found = {name: array for name, array in bodies if array is not None}
    if len(ensemble.load_scale) > 1:
        found["load_scale"] = ensemble.load_scale
    return described(found, ("member",))


def _record(scheme: Integrator, ensemble: IVP) -> dict[str, Any]:
    """Return the settings of the runs as plain attributes."""
    systems, scale = ensemble.systems, ensemble.load_scale
    load = float(scale[0]) * ensemble.load if len(scale) == 1 and ensemble.load.terms else ensemble.load
    body = {"system": systems[0].to_json()} if len(systems) == 1 else {}
    return {
        "format_version": FORMAT_VERSION,
        "title": f"{len(ensemble)} {systems.name} rigid bodies, {scheme.name}",
        "conventions": "Λ maps body to space; directors are the rows of the (3, 3) arrays, d_i = Λ E_i; quaternions "
        "have the scalar last; what failed members have not reached is NaN",
        **body,
        "load": json.dumps(load.description),
        "integrator": json.dumps({"name": scheme.name, **asdict(scheme)}),
        **grid_record(None if ensemble.off_grid else ensemble.grid, float(ensemble.stored_times[0])),
        "versions": json.dumps(versions()),
    }
