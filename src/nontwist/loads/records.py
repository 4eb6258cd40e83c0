"""From the record of a load in a run back to the load."""

from __future__ import annotations

from collections.abc import Iterable

from .base import Load
from .catalogue import body_moment, damping, pulse, rotor, sine, space_moment
from .generalised import director_forces, gravity_gradient, potential, spring
from .kinds import FUNCTIONS
from .terms import Record


def load_of(records: Iterable[Record]) -> Load:
    """Return the load that `Load.description` has recorded.

    Raises
    ------
    ValueError
        A term is a function, which a record names and does not hold; or the record is damaged.
    """
    load = Load()
    for record in records:
        if function := next((record[key] for key in FUNCTIONS if key in record), None):
            raise ValueError(
                f"the load of the run holds the function {function}, which is not stored in the dataset; pass load="
            )
        try:
            load = load + float(record["scale"]) * _term(record)
        except (KeyError, TypeError) as error:
            raise ValueError(f"the record of the load is damaged: {error}") from error
    return load


def rotors_of(records: Iterable[Record]) -> Load:
    """Return the rotors of the load that `Load.description` has recorded."""
    return load_of(record for record in records if "rotor" in record)


def _term(record: Record) -> Load:
    if "pulse" in record:
        return pulse(record["pulse"], record["start"], record["end"], shape=record["shape"], frame=record["kind"])
    if "sine" in record:
        return sine(record["sine"], record["frequency"], phase=record["phase"], frame=record["kind"])
    if "damping" in record:
        return damping(record["damping"])
    if "rotor" in record:
        times, values = record["times"], record["values"]
        return rotor(record["rotor"], values[0]) if len(times) == 1 else rotor(record["rotor"], times, values)
    if "forces_of" in record:
        return director_forces(record["times"], record["forces_of"], frame=record["frame"])
    if "linear" in record:
        return potential(record["vector"], linear=record["linear"], quadratic=record["quadratic"])
    if "stiffness" in record:
        return spring(*(record[key] for key in ("stiffness", "point", "anchor", "rest_length")))
    if "mean_motion" in record:
        return gravity_gradient(*(record[key] for key in ("mean_motion", "radial", "normal", "start")))
    make = body_moment if record["kind"] == "body" else space_moment
    return make(record["times"], record["values"])
