"""What a march samples of a load beforehand, and what it makes of a load before it does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..engine.outputs import CALL
from ..engine.records import BLOCK, FORCES
from ..geometry.arrays import Array
from ..loads import Load
from ..loads.base import forces_sampled, with_moments
from ..loads.forces import ForceTable
from ..loads.potentials import GravityGradient
from ..models.stack import SystemStack
from .problem import Problem

WIDTHS = {"times": 1, "moving": 3, "space": 3, "forces": FORCES, "rotor": 6, "spin": 1}  # numbers of a node
SAMPLES = tuple(getattr(BLOCK, name) for name in WIDTHS)  # their places in a block
COLUMNS = tuple(getattr(CALL, name) for name in WIDTHS)  # and in a call
BYTES = tuple(8 * width for width in WIDTHS.values())
Samples = tuple[Array | None, ...]


def samples_of(load: Load, times: Array | None) -> Samples:
    """Return the times of nodes, moments along the frame and in space and director forces there; None: none."""
    if times is None or not load.terms:
        return None, None, None, None
    kinds = {term.kind for term in load.terms}
    body = load.sample(times, "body") if "body" in kinds else None
    space = load.sample(times, "space") if "space" in kinds else None
    has_table = any(isinstance(term, ForceTable) for term in load.terms)
    return times, body, space, forces_sampled(load, times) if has_table else None


def as_marched(problem: Problem, is_director_scheme: bool) -> tuple[SystemStack, Load]:
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
    assert systems.dead_force is not None
    dead = systems.dead_force + problem.load_scale[:, None, None] * force
    m = len(dead)
    axis = None if systems.axis is None else np.broadcast_to(systems.axis, (m, 3))
    E = np.broadcast_to(systems.euler_inertia, (m, 3, 3))
    return replace(systems, euler_inertia=E, axis=axis, dead_force=dead), Load(
        tuple(term for term in load.terms if term not in linear)
    )


def orbit_of(systems: SystemStack, load: Load, unit: float) -> Array | None:
    """Return rate, in radians in a unit of time, and axis of the orbit that `gauss` sees the rows from, else None.

    That is where the gravity gradient acts alone: all else is given in a frame that stands still.
    """
    term = load.terms[0] if len(load.terms) == 1 else None
    if not isinstance(term, GravityGradient) or systems.has_dead_force:
        return None
    return np.array([term.mean_motion * unit, *term.normal])
