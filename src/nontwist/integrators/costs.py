"""What a march will take, told before it is spent: steps or pieces, seconds on one core, bytes.

The times are orders of magnitude, measured on a slow core, compilation left out; an integrator declares those of its
own steps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from ..loads.terms import Function

if TYPE_CHECKING:
    from .base import Problem

SAMPLE_NS, CALL_NS, PYTHON_NS = 60, 10_000, 300_000  # a node of a load; in Python; a substep with a load of the state


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
