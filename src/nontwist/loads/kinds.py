"""The visible list of the kinds of terms, and a load in words."""

from __future__ import annotations

from collections.abc import Iterable

from ..geometry.values import Registry
from .forces import ForceFunction, ForceTable
from .potentials import GravityGradient, PotentialFunction, Quadratic, Spring
from .terms import Damping, Function, Pulse, Record, Rotor, Sine, Table, Term, unregistrable

TERMS: Registry[type[Term]] = Registry(
    {
        "pulse": Pulse,
        "sine": Sine,
        "times": Table,
        "function": Function,
        "damping": Damping,
        "rotor": Rotor,
        "forces_of": ForceTable,
        "director_forces": ForceFunction,
        "linear": Quadratic,
        "stiffness": Spring,
        "mean_motion": GravityGradient,
        "potential": PotentialFunction,
    },
    unregistrable,
    "rename the first field of your class",
)
FUNCTIONS = ("function", "director_forces", "potential")  # fields of a record that name a function


def load_in_words(records: Iterable[Record]) -> str:
    """Return the terms of a load in words, from their records; of a kind that another package adds, its name."""
    words = []
    for record in records:
        name = next(key for key in [*record, ""] if key not in ("kind", "scale"))
        words.append(TERMS[name].words(record) if name in TERMS else f"{name} (its module is not imported)")
    return "; ".join(words) or "none"
