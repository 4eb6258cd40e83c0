"""What a problem keeps, whatever the integrator, and how far a run drifts from it.

- Without load and dead forces K stays, as constraints do no work on ``n·W = 0`` (eq-director-K); under dead forces
  K + V, with V = -Σ f^i·d_i; under a load K + V - A, with A the work that the scheme's balance reports (`load_work`).
- A free standard body keeps the spatial momentum π (eq-standard). Dead forces along one direction g, as gravity gives,
  have a moment orthogonal to g, so π·g stays. The moment -μ Λn of a constraint spoils both.
- A free body held about a principal axis n, so the non-twisting one (eq-nonholonomic), keeps Π_⊥, the material momentum
  orthogonal to n, since J W × W is parallel to n: Π1 and Π2 for n = E3.
- Directors stay orthonormal.

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
from ..models.system import PRINCIPAL, DirectorSystem
from .trajectory import Trajectory
from .variables import observables_of_one

if TYPE_CHECKING:
    import xarray

STATES = ("kinetic_energy", "potential_energy", "spatial_momentum", "material_momentum", "orthonormality_defect")
ALONG_ONE = 1e-12  # second singular value of the dead forces over the first: below it they have one direction


class Quantities(NamedTuple):
    """What invariants are made of, along a run."""

    kinetic_energy: Array  # (n,), J
    potential_energy: Array
    spatial_momentum: Array  # (n, 3), kg m²/s
    material_momentum: Array
    orthonormality_defect: Array  # (n,)
    work: Array  # (n,), J, of the load so far
    supply: float  # largest |m||w|h of an interval


class Invariant(NamedTuple):
    """A quantity that stays: symbol, unit, and its values (n, ...) along a run."""

    symbol: str
    units: str
    values: Callable[[Quantities], Array]


class Drift(NamedTuple):
    """How far an invariant drifted."""

    symbol: str
    units: str
    relative: float
    absolute: float


def quantities(run: xarray.Dataset | Trajectory) -> Quantities:
    """Return what the invariants of a run are made of."""
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
    """Return the invariants of `system`, by name; `loaded` tells whether there is a load."""
    n, dead = system.axis, system.dead_force
    heavy = bool(dead.any())
    free = not loaded and not heavy
    found: dict[str, Invariant] = {}
    if loaded:
        symbol = "K+V−A" if heavy else "K−A"
        found["energy_balance"] = Invariant(symbol, "J", lambda x: x.kinetic_energy + x.potential_energy - x.work)
    elif heavy:
        found["total_energy"] = Invariant("K+V", "J", lambda x: x.kinetic_energy + x.potential_energy)
    else:
        found["kinetic_energy"] = Invariant("K", "J", lambda x: x.kinetic_energy)
    if n is None and free:
        found["spatial_momentum"] = Invariant("π", "kg m2 s-1", lambda x: x.spatial_momentum)
    elif n is None and not loaded and (g := _direction(dead)) is not None:
        found["vertical_momentum"] = Invariant("π·g", "kg m2 s-1", lambda x: x.spatial_momentum @ g)
    elif n is not None and free and _is_principal(system.convected_inertia, n):
        plane = np.eye(3) - np.outer(n, n)
        found["material_momentum"] = Invariant("Π⊥", "kg m2 s-1", lambda x: x.material_momentum @ plane)
    found["orthonormality"] = Invariant("d·d", "1", lambda x: x.orthonormality_defect)
    return found


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
        The energy balance under load is left out where the run has no `load_work`, as a member of a sweep.
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


def _is_principal(J: Array, n: Array) -> bool:
    return bool(abs(J @ n - (n @ J @ n) * n).max() <= PRINCIPAL * np.linalg.norm(J, 2))


def _direction(dead_force: Array) -> Array | None:
    """Return the direction of all dead forces, None where they have more than one."""
    _, sizes, directions = np.linalg.svd(dead_force)
    one: Array | None = directions[0] if sizes[1] <= ALONG_ONE * sizes[0] else None
    return one
