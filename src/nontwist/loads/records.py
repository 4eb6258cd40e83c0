"""From the record of a load in a run back to the load."""

from __future__ import annotations

from collections.abc import Iterable

from .base import Load
from .catalogue import body_moment, damping, pulse, sine, space_moment
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
        if "function" in record:
            raise ValueError(
                f"the load of the run holds the function {record['function']}, which its dataset does not keep: "
                "give the load with load="
            )
        try:
            load = load + float(record["scale"]) * _term(record)
        except (KeyError, TypeError) as error:
            raise ValueError(f"the record of the load is damaged: {error}") from error
    return load


def _term(record: Record) -> Load:
    if "pulse" in record:
        return pulse(record["pulse"], record["start"], record["end"], shape=record["shape"], frame=record["kind"])
    if "sine" in record:
        return sine(record["sine"], record["frequency"], phase=record["phase"], frame=record["kind"])
    if "damping" in record:
        return damping(record["damping"])
    make = body_moment if record["kind"] == "body" else space_moment
    return make(record["times"], record["values"])
