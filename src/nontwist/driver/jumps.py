"""Loads that jump with the state, other than dry friction: why the iteration of a step stalls.

Where what a function of the state returns jumps on the way of a step, its equations may have no solution, at any
length: on either side of the jump the load pushes the body to the other. A stall is looked into once: from the
beginning of the step, W and internal states change at their rates there, and moments, and rates of internal states,
are followed over two steps. The interval of the largest change is halved again and again: the change of a smooth
function becomes small with it, and a jump stays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ..geometry.arrays import Array
from ..geometry.attitudes import attitudes, directors
from ..geometry.values import number_text, vector_text
from ..integrators.base import IVP, Failure, Integrator, Status
from ..integrators.problem import onward
from ..loads.base import state_moment_at
from ..loads.memory import Memory, Wheel
from ..loads.terms import Term
from . import completion
from .contacts import Contacts

GLANCES, HALVINGS = 64, 40
LEFT = 0.4  # of the change between two of the times: what a jump leaves of it, half of it beside a sign of exactly 0
WAYS = (
    "the load {} jumps with the state, at about t = {} s {}, so that a step there may have no solution at any length; "
    "end the run a few steps before with events= and continue it on the other side, choose the moment of each step "
    "with stepper, use {} for friction, or make the law smooth over a scale of your choice, as with np.tanh(x / scale)"
)
BESIDE = 1e-6  # of the span: so far from a jump are values that are told, as a sign of exactly 0 is 0
RATES = "in z' "  # of internal states
Value = Callable[[float, Array, Array, Array], Array]  # of time, directors as rows, W, and internal states


def named_jump(scheme: Integrator, problem: IVP, failure: Failure) -> Failure:
    """Return how a problem of one body has failed: where its load jumps, if that is why an iteration has stalled."""
    values = list(_values(problem))
    if failure.status is not Status.STALLED or not values or problem.load.is_dry:  # of which parts were looked into
        return failure
    at = Contacts(scheme, problem)
    p, W, z, t = at.state.quaternion, at.state.velocity, at.state.internal, float(problem.times(failure.step))
    if failure.step:
        before = completion.unchecked(scheme, onward(problem, 0, failure.step))
        if before.failure() is not None:
            return failure
        states = before.states.part(0)
        p, W, z = states.quaternion[-1], states.velocity[-1], None if states.internal is None else states.internal[-1]
    z = np.zeros(0) if z is None else z
    try:
        path = _path(at, t, p, W, z)
    except ValueError:
        return failure
    for term, value, unit in values:
        found = _jump(lambda s, value=value: value(t + s, *path(s)), 2 * problem.step_at(failure.step))  # type: ignore[misc]
        if found is not None:
            s, x, y = found
            name, friction = _name(term, not unit), "coulomb=" if isinstance(term, Wheel) else "dry_friction"
            what = f"{'' if unit else RATES}from {vector_text(x)} to {vector_text(y)} {unit}".rstrip()
            text = WAYS.format(name, number_text(t + s, ".6g"), what, friction)
            return failure._replace(status=Status.JUMP, reason=text)
    return failure


def _values(problem: IVP) -> Iterator[tuple[Term, Value, str]]:
    """Yield what functions of the state return that may jump: of which term, what, and the unit."""
    load = problem.load
    for term in load.terms:
        if term.kind in ("state", "forces") and not term.in_kernels:
            yield term, lambda t, q, W, z, term=term: state_moment_at(term.load, t, q, W @ q), "N m"  # type: ignore[misc]
    for term, place in load.placed:
        if not isinstance(term, Wheel):
            yield term, lambda *at, own=(term, place): _answers(*own, *at)[0], "N m"
            yield term, lambda *at, own=(term, place): _answers(*own, *at)[1], ""
        elif not term.is_driven:
            yield term, lambda *at, own=(term, place): _answers(*own, *at)[1][:1], "N m"  # torque less friction


def _answers(term: Memory, place: slice, t: float, q: Array, W: Array, z: Array) -> tuple[Array, Array]:
    return term.answers(t, q, W, z[place])


def _path(at: Contacts, t: float, p: Array, W: Array, z: Array) -> Callable[[float], tuple[Array, Array, Array]]:
    """Return the function that gives directors, W and z at a time after t, at the rates there."""
    from scipy.spatial.transform import Rotation

    q = directors(p)
    K, rates = at.forces(t, q, W, z.copy() if z.size else None)
    turning = at.Q @ K

    def state(s: float) -> tuple[Array, Array, Array]:
        turned = attitudes(p) @ Rotation.from_rotvec(s * W + s * s / 2 * turning).as_matrix()
        return turned.T, W + s * turning, z + s * rates

    return state


def _jump(value: Callable[[float], Array], span: float) -> tuple[float, Array, Array] | None:
    """Return where a function jumps in a span, and its values there; None where it does not, or fails."""
    try:
        times = np.linspace(0.0, span, GLANCES + 1)
        values = np.array([value(s) for s in times.tolist()])
        k = int(np.argmax(abs(np.diff(values, axis=0)).max(axis=1)))
        (a, b), (x, y) = times[k : k + 2].tolist(), values[k : k + 2]
        whole = abs(y - x).max()
        for _ in range(HALVINGS):
            m = value(c := (a + b) / 2)
            a, b, x, y = (c, b, m, y) if abs(y - m).max() >= abs(m - x).max() else (a, c, x, m)
        is_function = np.array_equal(value(a), x) and np.array_equal(value(b), y)  # no random number, for one
        ends = value(a - BESIDE * span), value(b + BESIDE * span)
    except ValueError:
        return None
    return (a, *ends) if is_function and abs(y - x).max() > LEFT * whole > 0 else None


def _name(term: Term, is_rate: bool) -> str:
    """Return the name of the function of a term that jumps."""
    called = term.memory if is_rate else term.called  # type: ignore[attr-defined]
    if getattr(called, "__self__", None) is term:
        return type(term).__name__.lower() if isinstance(term, Wheel) else type(term).__name__
    return str(getattr(called, "__name__", "of a C function"))
