"""Bodies with wheels, integrated as gyrostats (`loads.wheels`): by every scheme, since h is known beforehand.

A problem with wheels becomes that of what carries them, of inertia J_c, with rotors of momentum h. Its constraints and
their multipliers are the same. What is said of its intervals becomes again what is said of the body with its wheels
locked, of momentum J W = J_c W + z, z = Σ I (n·W) n, and energy ½ W·J W = ½ W·J_c W + ½ W·z: the mean moment of the
load has beside that on the carrier the change of Λz, its work that of ½ W·z.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..geometry.arrays import Array
from ..geometry.attitudes import attitudes
from ..loads import Load
from ..loads.wheels import Wheel
from ..models.stack import SystemStack, stacked
from ..models.system import DirectorSystem
from .problem import Outcome, Problem


def momenta(systems: SystemStack, load: Load, time: float, velocity: Array, scale: Array) -> Array:
    """Return the axial momenta h of the wheels of members whose wheels have their first speeds, (m, wheels)."""
    W = velocity if systems.axis is None else velocity + systems.spin_at(time)[:, None] * systems.axis
    found = [one.inertia * (scale * one.scale * one.speed + W @ one.direction) for one in load.wheels]
    return np.stack(found, axis=1)


def carrier(system: DirectorSystem, load: Load) -> DirectorSystem:
    """Return what carries the wheels of a body; a ValueError where nothing is left of it."""
    J = system.convected_inertia - sum(one.locked for one in load.wheels)
    if (least := np.linalg.eigvalsh(J)[0]) <= 0:
        raise ValueError(
            "the inertia of a body includes that of its wheels, locked: without it, J - Σ I n nᵀ, the least principal "
            f"moment is {least:.6g} kg m², and must be positive; add the wheels to the inertia, or make them lighter"
        )
    return replace(system, euler_inertia=np.trace(J) / 2 * np.eye(3) - J)


def as_gyrostat(problem: Problem) -> Problem:
    """Return a problem of one body, with wheels, as that of their carrier with rotors."""
    one = problem.member(0)
    assert one.wheels is not None
    h, t = iter(one.wheels[0].tolist()), one.t_start
    load = Load(tuple(term.begun(t, next(h)) if isinstance(term, Wheel) else term for term in one.load.terms))
    return replace(one, systems=stacked(carrier(one.system, one.load)), load=load, wheels=None)


def of_locked(problem: Problem, outcome: Outcome) -> Outcome:
    """Return the outcome of `as_gyrostat` with the moments and the work on the body with its wheels locked."""
    if outcome.intervals is None:
        return outcome
    p, W = outcome.states.quaternion, outcome.states.velocity
    z = W @ sum(one.locked for one in problem.load.wheels)
    kept, length = outcome.intervals, np.diff(problem.output)
    moment = np.diff(np.einsum("mkij,mkj->mki", attitudes(p), z), axis=1) / length[:, None]
    work = np.diff((W * z).sum(axis=-1), axis=1) / 2
    intervals = kept._replace(moment=kept.moment + moment, load_work=kept.load_work + work)
    return outcome._replace(intervals=intervals)
