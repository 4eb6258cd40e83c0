"""Statistics of motions over time: drift of the invariants, extrema, means, total twist.

They are taken over the ends of all steps, whatever is stored; those of the reaction moment over its means on the steps.
Integrals over time have the order of the integrator: they are integrated with the steps. The invariants are
K + V less the work of the load and the momentum of `invariants.conserved_momentum`.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import accumulate

import numpy as np

from ..geometry.arrays import Array
from ..geometry.values import among, as_list, nearest, shown
from ..integrators.problem import FIRST, INTEGRAL, LEAST, MOST, OBSERVED
from ..loads.potentials import Potential
from ..models.stack import SystemStack
from .invariants import conserved_momentum
from .variables import VARIABLES

STATISTICS = ("drift", "extrema", "averages", "total_twist")
_ENDS = list(accumulate(OBSERVED.values()))
PLACES = {name: slice(end - OBSERVED[name], end) for name, end in zip(OBSERVED, _ENDS, strict=True)}
_NO_VARIABLES = ("energy", "vertical_momentum")
Described = dict[str, tuple[tuple[str, ...], Array, dict[str, str]]]


def checked(reduce: str | Iterable[str]) -> tuple[str, ...]:
    """Return the names of statistics; ValueError where one is unknown."""
    names = (reduce,) if isinstance(reduce, str) else tuple(as_list(reduce, "reduce"))
    for name in names:
        if not among(name, STATISTICS):
            raise ValueError(f"unknown statistic {shown(name)}; {nearest(name, STATISTICS)}")
    return names


def named(
    observed: Array,
    names: Iterable[str],
    systems: SystemStack,
    loaded: bool,
    span: float,
    potentials: tuple[Potential, ...] = (),
) -> Described:
    """Return the variables of the requested statistics, from what was observed of each member, (m, 4, COLUMNS)."""
    found: Described = {}
    shown = [name for name in OBSERVED if name not in _NO_VARIABLES]
    if systems.axis is None:
        shown.remove("reaction_moment")
    if not (potentials or systems.has_dead_force):
        shown.remove("potential_energy")

    def add(name: str, base: str, words: str, symbol: str, values: Array) -> None:
        dims, units, long_name, letter = VARIABLES[base]
        values = values if values.shape[1] > 1 else values[:, 0]
        found[name] = (
            ("member", *dims[1:]),
            values,
            {"units": units, "long_name": words.format(long_name), "symbol": symbol.format(letter)},
        )

    if "drift" in names:
        changes = np.maximum(observed[:, MOST] - observed[:, FIRST], observed[:, FIRST] - observed[:, LEAST])
        energy = "largest change of the energy less the work of the load"
        add("energy_drift", "kinetic_energy", energy, "max |ΔH|", changes[:, PLACES["energy"]])
        records = [term.description for term in potentials]
        if (base := conserved_momentum(systems, loaded, records)) is not None:
            drift = changes[:, PLACES[base]].max(axis=1, keepdims=True)
            attributes = {"units": "kg m2 s-1", "long_name": f"largest change of a component of the {_WORDS[base]}"}
            found["momentum_drift"] = (("member",), drift[:, 0], {**attributes, "symbol": "max |Δπ|"})
    for name in shown if "extrema" in names else ():
        add(f"{name}_min", name, "least {}", "min {}", observed[:, LEAST, PLACES[name]])
        add(f"{name}_max", name, "greatest {}", "max {}", observed[:, MOST, PLACES[name]])
    for name in shown if "averages" in names else ():
        add(f"{name}_mean", name, "{}, mean over time", "mean {}", observed[:, INTEGRAL, PLACES[name]] / span)
    if "total_twist" in names:
        attributes = {"units": "rad", "long_name": "twist about the body axis, all turns", "symbol": "ψ"}
        found["total_twist"] = (("member",), observed[:, INTEGRAL, PLACES["twist_rate"]][:, 0], attributes)
    return found


_WORDS = {
    "spatial_momentum": "spatial angular momentum",
    "material_momentum": "material angular momentum",
    "vertical_momentum": "spatial angular momentum along gravity",
}
