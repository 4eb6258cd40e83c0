"""The invariants of a problem, whatever the integrator, and the drift of a run from them.

- Without load and dead forces K is constant, as constraints do no work on ``n·W = 0`` (eq-director-K); under dead
  forces and potentials K + V, with V = -Σ f^i·d_i and what the potentials add; under a load K + V - A, with A the work
  in the balance of the scheme (`load_work`).
- Under the gravity gradient on a circular orbit, mean motion n about o, V depends on time and K + V changes; of a body
  without constraint and load K + V - n o·π is constant, as n o·π' = n o·m = ∂V/∂t. With rotors of momentum h it is
  K + V - A - n o·(π + Λh): they turn the moment m into that of π + Λh, and do the work A only if h changes.
- A free standard body conserves the spatial momentum π (eq-standard). Dead forces along one direction g, as of gravity,
  and potentials of vectors along it have a moment orthogonal to g, so π·g is constant. The moment -μ Λn of a constraint
  changes both.
- A free body with a principal constrained axis n, as the non-twisting one (eq-nonholonomic), conserves Π_⊥, the
  material momentum orthogonal to n, since J W × W is parallel to n: Π1 and Π2 for n = E3.
- Directors are orthonormal.
- A run of several parts that were joined conserves what is conserved in all of them, under all of their loads at once.
  Where parts have other potentials or rotors, V or h jumps between them, and no energy or momentum is kept.

Drifts are the largest distance from the value at the start over the size of the quantity: for energies the largest K,
the largest |A|, the size of V, Σ|f^i| and by how much it changes under potentials, and the largest |m||w|h of an
interval, which a constraint may let cancel in m·w, together; for momenta the largest |π|; where that is zero, 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array, Dataset
from ..loads.kinds import is_rotor
from ..models.stack import PARALLEL, SystemStack, is_principal, stacked
from ..models.system import DirectorSystem
from .datasets import RUN, as_dataset
from .joining import parts_of
from .trajectory import Trajectory

Records = Sequence[Mapping[str, Any]]
STATES = ("kinetic_energy", "potential_energy", "spatial_momentum", "material_momentum", "orthonormality_defect")


class Quantities(NamedTuple):
    """The quantities along a run from which invariants are computed."""

    kinetic_energy: Array  # (n,), J
    potential_energy: Array
    spatial_momentum: Array  # (n, 3), kg m² s⁻¹
    material_momentum: Array
    orthonormality_defect: Array  # (n,)
    work: Array  # (n,), J, of the load so far
    supply: float  # largest |m||w|h of an interval
    total_momentum: Array  # (n, 3), with the rotors
    varies: float = 0.0  # by how much V changes under potentials, J


class Invariant(NamedTuple):
    """A conserved quantity: symbol, unit, its values (n, ...) along a run; whether it counts the work of the load."""

    symbol: str
    units: str
    values: Callable[[Quantities], Array]
    has_work: bool = False


class Drift(NamedTuple):
    """The drift of an invariant."""

    symbol: str
    units: str
    relative: float
    absolute: float


def acting_in(run: Dataset) -> tuple[Records, bool, bool]:
    """Return the records of the loads of a run, whether energy dissipates, whether V and h are the same in it.

    Of one that was joined these are those of all of its parts together.
    """
    parts = parts_of(run)
    stored = [[one for one in part["load"] if one["kind"] == "potential" or is_rotor(one)] for part in parts]
    records: list[Mapping[str, Any]] = list(parts[0]["load"])
    for part in parts[1:]:
        records += [one for one in part["load"] if one not in records]
    dissipates = any(bool(part["integrator"].get("dissipation")) for part in parts)
    return records, dissipates, stored.count(stored[0]) == len(stored)


def work_of(run: Dataset) -> tuple[Array, NDArray[np.int64]]:
    """Return the work of the load from the first state to each, and the intervals that follow all but the last one."""
    place = np.searchsorted(run["midtime"].values, run["time"].values)
    if not np.diff(place).all():
        raise ValueError("the run has states without the interval between them: select times alone, with time=")
    return np.append(0.0, np.cumsum(run["load_work"].values))[place], place[:-1]


def quantities(run: Dataset) -> Quantities:
    """Return the quantities from which the invariants of a run are computed."""
    states = {name: run[name].values for name in STATES}
    work, supply, V = np.zeros(run.sizes["time"]), 0.0, states["potential_energy"]
    if "load_work" in run:
        speed = np.linalg.norm(run["angular_velocity"].values, axis=1)
        work, place = work_of(run)
        moment = np.linalg.norm(run["moment"].values, axis=1)[place]
        supplies = moment * np.maximum(speed[1:], speed[:-1]) * np.diff(run["time"].values)
        supply = float(supplies.max(initial=0.0))
    total = run["total_momentum" if "total_momentum" in run else "spatial_momentum"].values
    varies = float(np.ptp(V)) if potentials(acting_in(run)[0]) and len(V) else 0.0
    return Quantities(**states, work=work, supply=supply, total_momentum=total, varies=varies)


def potentials(records: Records) -> list[Mapping[str, Any]]:
    """Return the records of a load that are those of potentials."""
    return [record for record in records if record["kind"] == "potential"]


def _orbit(records: Records) -> Mapping[str, Any] | None:
    """Return the record of the gravity gradient, None where there is none."""
    return next((record for record in records if "mean_motion" in record), None)


def _vectors(records: Records) -> Array:
    """Return the space vectors of potentials, (k, 3)."""
    keys = "vector", "anchor", "vectors_of", "radial"
    named = (next((record[key] for key in keys if key in record), np.eye(3)) for record in records)  # those of your own
    return np.concatenate([np.zeros((0, 3)), *(np.reshape(one, (-1, 3)) for one in named)])


def invariants(system: DirectorSystem, records: Records, dissipates: bool = False) -> dict[str, Invariant]:
    """Return the invariants of `system` under a load of these records, by name; no energy of one that dissipates."""
    held, others = potentials(records), [record for record in records if record["kind"] != "potential"]
    loaded, gyrostat, orbit = bool(others), all(map(is_rotor, others)), _orbit(held)
    systems, heavy = stacked(system), bool(system.dead_force.any() or held)
    found: dict[str, Invariant] = {}
    work, total = ("−A", "π+Λh") if loaded else ("", "π")
    if orbit is not None:
        others_act = orbit.get("eccentricity") or system.dead_force.any() or dissipates or len(held) > 1
        if system.axis is None and gyrostat and not others_act:
            symbol = f"K+V{work}−n o·{f'({total})' if loaded else total}"
            found["jacobi_integral"] = Invariant(symbol, "J", partial(_energy, loaded, orbit), loaded)
    elif system.spin is not None or dissipates:
        if system.spin is not None and not (loaded or heavy):
            found["transverse_form"] = Invariant("2J₃K−Π²", "kg2 m4 s-2", partial(_transverse_form, system))
    else:
        name = "energy_balance" if loaded else "total_energy" if heavy else "kinetic_energy"
        symbol = ("K+V" if heavy else "K") + work
        found[name] = Invariant(symbol, "J", partial(_energy, loaded, None), loaded)
    momentum = conserved_momentum(systems, loaded and not (gyrostat and system.axis is None), held)
    if momentum == "spatial_momentum":
        found["total_momentum" if loaded else momentum] = Invariant(total, "kg m2 s-1", lambda x: x.total_momentum)
    elif momentum == "vertical_momentum":
        g, symbol = _vertical(systems, held)[0], f"({total})·g" if loaded else "π·g"
        found[momentum] = Invariant(symbol, "kg m2 s-1", lambda x: x.total_momentum @ g)
    elif momentum is not None and (n := system.axis) is not None:
        plane = np.eye(3) - np.outer(n, n)
        found[momentum] = Invariant("Π⊥", "kg m2 s-1", lambda x: x.material_momentum @ plane)
    found["orthonormality"] = Invariant("d·d", "1", lambda x: x.orthonormality_defect)
    return found


def _energy(loaded: bool, orbit: Mapping[str, Any] | None, x: Quantities) -> Array:
    """Return ``K + V - A - n o·(π + Λh)``: A of a load alone, n o·(π + Λh) on an orbit, h the momenta of the rotors."""
    E = x.kinetic_energy + x.potential_energy
    if loaded:
        E = E - x.work
    return E if orbit is None else E - orbit["mean_motion"] * (x.total_momentum @ np.array(orbit["normal"]))


def _transverse_form(system: DirectorSystem, x: Quantities) -> Array:
    """Return ``2 J3 K - |Π|²``, which a free body with a prescribed spin about n keeps; J3 = n·J n."""
    n = system.axis
    assert n is not None
    return 2 * (n @ system.convected_inertia @ n) * x.kinetic_energy - np.square(x.material_momentum).sum(axis=1)


def _vertical(systems: SystemStack, records: Records) -> Array:
    """Return the direction that the dead forces of each body and the vectors of all potentials share, 0: none."""
    e, vectors = systems.vertical, _vectors(records)
    vectors = vectors[vectors.any(axis=1)]
    if not len(vectors):
        return e
    v = vectors[0] / np.linalg.norm(vectors[0])
    across = vectors - (vectors @ v)[:, None] * v
    if (np.linalg.norm(across, axis=1) > PARALLEL * np.linalg.norm(vectors, axis=1)).any():
        return np.zeros_like(e)
    is_free = ~systems.dead_force.any(axis=(1, 2))
    is_along = is_free | (np.linalg.norm(np.cross(e, v), axis=1) <= PARALLEL) & e.any(axis=1)
    return np.where(is_along[:, None], v, 0.0)


def conserved_momentum(systems: SystemStack, loaded: bool, records: Records = ()) -> str | None:
    """Return the momentum that all of these bodies conserve, None where not all of them conserve one.

    `records`: those of potentials.
    """
    dead, held = systems.dead_force, bool(_vectors(records).any())
    if loaded or dead is None or systems.spin is not None or _orbit(records) is not None:
        return None
    if systems.axis is None:
        if not (dead.any() or held):
            return "spatial_momentum"
        return "vertical_momentum" if _vertical(systems, records).any(axis=1).all() else None
    return "material_momentum" if is_principal(systems).all() and not (dead.any() or held) else None


def scales(x: Quantities, system: DirectorSystem) -> dict[str, float]:
    """Return the sizes that drifts are relative to, by unit."""
    energy = x.kinetic_energy.max() + np.linalg.norm(system.dead_force, axis=1).sum() + abs(x.work).max() + x.supply
    largest = max(np.linalg.norm(pi, axis=1).max() for pi in (x.spatial_momentum, x.total_momentum))
    sizes = {"J": float(energy + x.varies), "kg m2 s-1": float(largest)}
    sizes["kg2 m4 s-2"] = float(np.square(x.material_momentum).sum(axis=1).max())
    return {"1": 1.0} | {unit: size or 1.0 for unit, size in sizes.items()}


def drift(invariant: Invariant, x: Quantities, scale: float) -> float:
    """Return the largest distance of an invariant from its value at the start, over `scale`; of a defect, from zero."""
    values = invariant.values(x)
    start = 0.0 if invariant.units == "1" else values[0]
    return float(np.linalg.norm((values - start).reshape(len(values), -1), axis=1).max()) / scale


def drifts(run: Dataset | Trajectory) -> dict[str, Drift]:
    """Return the drift of every invariant of a run: what its problem conserves, and how well the run does.

    Without load K is constant; under gravity and potentials K + V; under a moment the energy less its work. A free
    standard body conserves the spatial momentum π, a heavy top its vertical component, and a free body with a principal
    constrained axis the material momentum orthogonal to this axis (eq-standard, eq-nonholonomic). Directors are
    orthonormal. Other quantities, such as the momentum of a body under a moment, have no drift and are not listed.
    A joined run has the drifts of what all its parts conserve: none of energies and momenta where its parts have other
    potentials or rotors.

    Parameters
    ----------
    run : Dataset or Trajectory
        Of `simulate` or `integrate`, or read with `open_run`.

    Returns
    -------
    dict
        By the name of the invariant, named tuples: its ``symbol`` and ``units``; ``absolute``, the largest distance
        from the value at the start; and ``relative``, the same over the size of the quantity, of energies the sum of
        the largest K, |A| and |V|, of momenta the largest |π|. The energy balance under load is left out of runs
        without `load_work`.

    Raises
    ------
    ValueError
        `run` is not a run, lacks variables, or is an ensemble.

    Examples
    --------
    >>> from nontwist import drifts, simulate, standard
    >>> run = simulate(standard([3, 4, 5]), t_end=10, material_angular_velocity=(0.1, 2, 0))
    >>> {name: drift.relative < 1e-13 for name, drift in drifts(run).items()}
    {'kinetic_energy': True, 'spatial_momentum': True, 'orthonormality': True}
    """
    data = run.to_dataset() if isinstance(run, Trajectory) else run
    data = as_dataset(data, RUN, ("time", *STATES), ("system", "load", "integrator"))
    system, x = DirectorSystem.from_json(data.attrs["system"]), quantities(data)
    sizes = scales(x, system)
    found, (records, dissipates, is_one) = {}, acting_in(data)
    for name, invariant in invariants(system, records, dissipates).items():
        if not is_one and invariant.units != "1":
            continue
        if not invariant.has_work or "load_work" in data:
            absolute = drift(invariant, x, 1.0)
            found[name] = Drift(invariant.symbol, invariant.units, absolute / sizes[invariant.units], absolute)
    return found


def in_words(name: str) -> str:
    """Return the name of an invariant in words."""
    return name.replace("_", " ").replace("jacobi", "Jacobi")


def twist_defect(run: Dataset) -> float | None:
    """Return the largest |w·Λn - c|, rad/s, c the prescribed spin, 0 without; None for a body without the axis n."""
    system = DirectorSystem.from_json(run.attrs["system"])
    if system.axis is None:
        return None
    spin = 0.0 if system.spin is None else system.spin.at(run["time"].values)
    return float(abs(run["twist_rate"].values - spin).max())
