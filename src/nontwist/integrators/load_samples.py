"""What a march samples of a load beforehand, and what it makes of a load before it does.

In a step a prescribed spin W3 goes along the chord between c at both ends, a polynomial of a degree not above the
number of stages, so W3 = c at every node, whatever the grid is: of a table whose kinks are nodes it is c itself, and
the order is that of the scheme.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..engine.generalised import EXACT
from ..engine.layout import address_of
from ..engine.records import BODY, FORCES, Parts
from ..geometry.arrays import Array
from ..loads import Load
from ..loads.base import forces_sampled, with_moments
from ..loads.forces import ForceTable
from ..loads.potentials import GravityGradient
from ..loads.terms import Damping
from ..models.stack import SystemStack
from .compiled import Compiled
from .problem import IVP
from .rotors import at_nodes

Ends = tuple[Array, Array, Array]

WIDTHS = {"times": 1, "moving": 3, "space": 3, "forces": FORCES, "rotor": 6, "spin": 1}  # numbers of a node
BYTES = 8 * np.array(list(WIDTHS.values()))
Samples = tuple[Array | None, ...]
NOTHING: Samples = (None,) * len(WIDTHS)


def sampled(
    systems: SystemStack, load: Load, unit: float, times: Callable[[], Array], steps: Callable[[], Ends], middles: Array
) -> Samples:
    """Return what acts at nodes: times, moments along the frame and in space, forces, rotors, spin; None: none.

    Parameters
    ----------
    systems, load : as they are marched
    unit : of time
    times : called where a load acts: the times of the nodes, step by step
    steps : called where something acts along the chord of a step: where steps begin and end, and their lengths
    middles : the nodes of a step, as fractions
    """
    found: dict[str, Array | None] = dict.fromkeys(WIDTHS)
    if load.terms:
        kinds, at = {term.kind for term in load.terms}, times()
        found["times"] = at
        found["moving"] = load.sample(at, "body") if "body" in kinds else None
        found["space"] = load.sample(at, "space") if "space" in kinds else None
        found["forces"] = forces_sampled(load, at) if has_table(load) else None
    if load.rotors or systems.spin is not None:
        begin, end, length = steps()
        if systems.spin is not None and not systems.spin.is_constant:  # its changes in the steps
            change = (systems.spin.at(end) - systems.spin.at(begin)) * unit
            found["spin"] = np.repeat(change, len(middles))
        found["rotor"] = at_nodes(load, begin, end, length, middles, unit) if load.rotors else None
    return tuple(found.values()) if load.terms or found["spin"] is not None else NOTHING


def has_table(load: Load) -> bool:
    """Whether a load has tables of forces on the directors."""
    return any(isinstance(term, ForceTable) for term in load.terms)


def parts_of(
    systems: SystemStack, load: Load, bodies: Array, scheme: Compiled, **known: Any
) -> tuple[list[Parts], NDArray[np.int64]]:
    """Return what there is in marches of bodies under a load, as they are marched, and in which one each body is."""
    kinds, spin = {term.kind for term in load.terms}, systems.spin
    shared = Parts(
        is_director_scheme=scheme.is_director_scheme,
        is_constrained=systems.axis is not None,
        dissipates=bool(scheme.dissipation),
        moving="body" in kinds,
        space="space" in kinds,
        damping=any(isinstance(term, Damping) for term in load.terms),  # also of a factor 0: members have the same bits
        rotor=bool(load.rotors),
        spin=spin is not None and not spin.is_constant,
        forces=has_table(load),
        is_exact=scheme.needs.action == EXACT,
    )._replace(**known)
    columns = slice(BODY.dead, BODY.damping), slice(BODY.off, BODY.free), slice(BODY.vertical, BODY.dissipation)
    is_dead, is_slanted, has_vertical = (bodies[:, own].any(axis=1) for own in columns)
    flags = is_dead + 2 * (is_slanted | (spin is not None)) + 4 * has_vertical
    found, which = np.unique(flags, return_inverse=True)

    def parts_with(flags: int) -> Parts:
        parts = shared._replace(dead=bool(flags & 1))
        return parts._replace(motion=scheme.motion(parts, bool(flags & 2), bool(flags & 4)))

    marched = [parts_with(one) for one in found.tolist()]
    groups = list(dict.fromkeys(marched))
    return groups, np.array([groups.index(parts) for parts in marched])[which]


def addresses(samples: Samples, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return where the samples at nodes of these numbers lie, (nodes, kinds); 0: there are none."""
    first = np.array([address_of(array) for array in samples])
    return np.where(first > 0, first + BYTES * nodes[:, None], 0)


def as_marched(problem: IVP, is_director_scheme: bool) -> tuple[SystemStack, Load]:
    """Return bodies and load as a march takes them: linear potentials as dead forces, tables of forces as moments.

    Forces that are tables along the directors stay forces in a director scheme, whose multipliers know them.
    """
    load, systems = problem.load, problem.systems
    if not is_director_scheme:
        load = with_moments(load)
    linear = [term for term in load.potentials if term.dead_force is not None]
    if not linear:
        return systems, load
    force = np.zeros((3, 3))
    for term in linear:
        force += term.scale * np.asarray(term.dead_force)
    dead = systems.dead_force + problem.load_scale[:, None, None] * force
    m = len(dead)
    axis = None if systems.axis is None else np.broadcast_to(systems.axis, (m, 3))
    E = np.broadcast_to(systems.euler_inertia, (m, 3, 3))
    rest = Load(tuple(term for term in load.terms if term not in linear))
    return replace(systems, euler_inertia=E, axis=axis, dead_force=dead), rest


def orbit_of(systems: SystemStack, load: Load, unit: float) -> Array | None:
    """Return rate, in radians in a unit of time, and axis of the orbit that `gauss` sees the rows from, else None.

    That is where the gravity gradient of a circular orbit acts alone: all else is given in a frame that stands still,
    and an ellipse turns at no constant rate.
    """
    term = load.terms[0] if len(load.terms) == 1 else None
    if not isinstance(term, GravityGradient) or term.eccentricity or systems.has_dead_force:
        return None
    return np.array([term.mean_motion * unit, *term.normal])
