"""What a march will take, told before it is spent: steps or pieces, seconds on one core, bytes.

The times are orders of magnitude, measured on a slow core, compilation left out; an integrator declares those of its
own steps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..loads.terms import Function

if TYPE_CHECKING:
    from ..loads import Load
    from ..models.system import DirectorSystem
    from .base import Problem

SAMPLE_NS, CALL_NS, PYTHON_NS = 60, 10_000, 200_000  # a node of a load; in Python; a substep with a load of the state


class Cost(NamedTuple):
    """What a march will take, about."""

    parts: int
    unit: str  #: what the parts are: steps, pieces of a load, states
    seconds: float  #: on one core
    size: int  #: bytes beside the stored states


def steps_cost(problem: Problem, steps: int, substeps: int, substep_ns: float) -> Cost:
    """Return the cost of steps that take `substep_ns` nanoseconds a substep without their load."""
    load, ns = problem.load, substep_ns
    if not load.is_compiled:
        ns = max(ns, PYTHON_NS)
    sampled = [term for term in load.terms if term.kind != "state"]
    ns += sum(CALL_NS if isinstance(term, Function) else SAMPLE_NS for term in sampled)
    return Cost(steps, "steps", steps * substeps * ns * 1e-9, 0)


def largest_velocity(system: DirectorSystem, kinetic_energy: float, load: Load, t_start: float, t_end: float) -> float:
    """Return what |w| can reach, rad/s, as far as it follows from energy and impulse.

    With I the smallest moment of inertia about an axis that the body can turn about, |w| is at most sqrt(2 K / I), and
    K grows by the work of gravity, at most 2 Σ|f^i|, and by the impulse p of the load, to (sqrt(2 K) + p/sqrt(I))²/2.
    """
    span = t_end - t_start
    J, n = system.convected_inertia, system.axis
    plane = np.eye(3) if n is None else np.linalg.svd(n[None])[2][1:]
    smallest = float(np.linalg.eigvalsh(plane @ J @ plane.T)[0])
    times = t_start + span * (np.arange(2000) + 0.5) / 2000
    impulse = np.cumsum(load.sample(times, "body") + load.sample(times, "space"), axis=0) * span / 2000
    root = np.sqrt(2 * kinetic_energy) + np.linalg.norm(impulse, axis=1).max() / np.sqrt(smallest)
    return float(np.sqrt((root**2 + 4 * np.linalg.norm(system.dead_force, axis=1).sum()) / smallest))
