"""The invariants of a problem, whatever the integrator, and the drift of a run from them.

- Without load and dead forces K is constant, as constraints do no work on ``n·W = 0`` (eq-director-K); under dead
  forces K + V, with V = -Σ f^i·d_i; under a load K + V - A, with A the work in the balance of the scheme (`load_work`).
- A free standard body conserves the spatial momentum π (eq-standard). Dead forces along one direction g, as of gravity,
  have a moment orthogonal to g, so π·g is constant. The moment -μ Λn of a constraint changes both.
- A free body with a principal constrained axis n, as the non-twisting one (eq-nonholonomic), conserves Π_⊥, the
  material momentum orthogonal to n, since J W × W is parallel to n: Π1 and Π2 for n = E3.
- Directors are orthonormal.

Drifts are the largest distance from the value at the start over the size of the quantity: for energies the largest K,
the largest |A|, the size of V, Σ|f^i|, and the largest |m||w|h of an interval, which a constraint may let cancel in
m·w, together; for momenta the largest |π|; where that is zero, 1.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..geometry.arrays import Array
from ..models.stack import SystemStack, is_principal, stacked
from ..models.system import DirectorSystem
from .trajectory import Trajectory
from .variables import observables_of_one

if TYPE_CHECKING:
    import xarray

STATES = ("kinetic_energy", "potential_energy", "spatial_momentum", "material_momentum", "orthonormality_defect")


class Quantities(NamedTuple):
    """The quantities along a run from which invariants are computed."""

    kinetic_energy: Array  # (n,), J
    potential_energy: Array
    spatial_momentum: Array  # (n, 3), kg m²/s
    material_momentum: Array
    orthonormality_defect: Array  # (n,)
    work: Array  # (n,), J, of the load so far
    supply: float  # largest |m||w|h of an interval


class Invariant(NamedTuple):
    """A conserved quantity: symbol, unit, and its values (n, ...) along a run."""

    symbol: str
    units: str
    values: Callable[[Quantities], Array]


class Drift(NamedTuple):
    """The drift of an invariant."""

    symbol: str
    units: str
    relative: float
    absolute: float


def quantities(run: xarray.Dataset | Trajectory) -> Quantities:
    """Return the quantities from which the invariants of a run are computed."""
    if isinstance(run, Trajectory):
        states = observables_of_one((*STATES, "angular_velocity"), run.system, run.states)
        time, moment, load_work = run.time, run.moment, run.load_work
    else:
        states = {name: run[name].values for name in STATES}
        if "load_work" not in run:
            return Quantities(**states, work=np.zeros(run.sizes["time"]), supply=0.0)
        time, moment, load_work = (run[name].values for name in ("time", "moment", "load_work"))
        states["angular_velocity"] = run["angular_velocity"].values
    speed = np.linalg.norm(states.pop("angular_velocity"), axis=1)
    supply = np.linalg.norm(moment, axis=1) * np.maximum(speed[1:], speed[:-1]) * np.diff(time)
    return Quantities(**states, work=np.append(0.0, np.cumsum(load_work)), supply=float(supply.max(initial=0.0)))


def invariants(system: DirectorSystem, loaded: bool) -> dict[str, Invariant]:
    """Return the invariants of `system`, by name; `loaded`: whether there is a load."""
    systems, heavy = stacked(system), bool(system.dead_force.any())
    found: dict[str, Invariant] = {}
    if loaded:
        symbol = "K+V−A" if heavy else "K−A"
        found["energy_balance"] = Invariant(symbol, "J", lambda x: x.kinetic_energy + x.potential_energy - x.work)
    elif heavy:
        found["total_energy"] = Invariant("K+V", "J", lambda x: x.kinetic_energy + x.potential_energy)
    else:
        found["kinetic_energy"] = Invariant("K", "J", lambda x: x.kinetic_energy)
    momentum = conserved_momentum(systems, loaded)
    if momentum == "spatial_momentum":
        found[momentum] = Invariant("π", "kg m2 s-1", lambda x: x.spatial_momentum)
    elif momentum == "vertical_momentum":
        g = systems.vertical[0]
        found[momentum] = Invariant("π·g", "kg m2 s-1", lambda x: x.spatial_momentum @ g)
    elif momentum is not None and (n := system.axis) is not None:
        plane = np.eye(3) - np.outer(n, n)
        found[momentum] = Invariant("Π⊥", "kg m2 s-1", lambda x: x.material_momentum @ plane)
    found["orthonormality"] = Invariant("d·d", "1", lambda x: x.orthonormality_defect)
    return found


def conserved_momentum(systems: SystemStack, loaded: bool) -> str | None:
    """Return the momentum that all of these bodies conserve, None where not all of them conserve one."""
    dead = systems.dead_force
    if loaded or dead is None:
        return None
    if systems.axis is None:
        if not dead.any():
            return "spatial_momentum"
        return "vertical_momentum" if systems.vertical.any(axis=1).all() else None
    return "material_momentum" if is_principal(systems).all() and not dead.any() else None


def scales(x: Quantities, system: DirectorSystem) -> dict[str, float]:
    """Return the sizes that drifts are relative to, by unit."""
    energy = x.kinetic_energy.max() + np.linalg.norm(system.dead_force, axis=1).sum() + abs(x.work).max() + x.supply
    sizes = {"J": float(energy), "kg m2 s-1": float(np.linalg.norm(x.spatial_momentum, axis=1).max())}
    return {"1": 1.0} | {unit: size or 1.0 for unit, size in sizes.items()}


def drift(invariant: Invariant, x: Quantities, scale: float) -> float:
    """Return the largest distance of an invariant from its value at the start, over `scale`; of a defect, from zero."""
    values = invariant.values(x)
    start = 0.0 if invariant.units == "1" else values[0]
    return float(np.linalg.norm((values - start).reshape(len(values), -1), axis=1).max()) / scale


def drifts(run: xarray.Dataset) -> dict[str, Drift]:
    """Return the drift of every invariant of a run, by name.

    Parameters
    ----------
    run : Dataset
        Of `simulate`, or read with `open_run`.

    Returns
    -------
    dict of str to Drift
        Without the energy balance under load where the run has no `load_work`, as a member of a sweep.
    """
    system, x = DirectorSystem.from_json(run.attrs["system"]), quantities(run)
    sizes = scales(x, system)
    found = {}
    for name, invariant in invariants(system, bool(json.loads(run.attrs["load"]))).items():
        if name != "energy_balance" or "load_work" in run:
            absolute = drift(invariant, x, 1.0)
            found[name] = Drift(invariant.symbol, invariant.units, absolute / sizes[invariant.units], absolute)
    return found


def twist_defect(run: xarray.Dataset) -> float | None:
    """Return the largest |w·Λn|, rad/s, of a body that may not turn about n; None for one that may."""
    if DirectorSystem.from_json(run.attrs["system"]).axis is None:
        return None
    return float(abs(run["twist_rate"].values).max())
