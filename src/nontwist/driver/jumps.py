"""Loads that jump with the state: why the iteration of a step stalls, found and named.

Where the moment of a function of the state jumps on the way of a step, its equations may have no solution, at any
length: on either side of the jump the load pushes the body to the other. A stall is looked into once: from the
beginning of the step, W changes at its rate there, and the moment is followed over two steps. The interval of its
largest change is halved again and again: the change of a smooth function becomes small with it, and a jump stays.
"""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array
from ..geometry.attitudes import attitudes, directors
from ..geometry.values import number_text, vector_text
from ..integrators.base import IVP, Failure, Integrator, Status
from ..integrators.problem import onward
from ..loads import Load
from ..loads.base import state_moment_at
from ..loads.terms import Term
from ..models.system import DirectorSystem
from .rubbing import torque

PIECES, HALVINGS = 64, 40
LEFT = 0.5  # of the change between two of the times: what a jump leaves of it
WAYS = (
    "the load {} jumps with the state, at about t = {} s from {} to {} N m, so that a step there may have no solution "
    "at any length; end the run there with events= and continue it on the other side, choose the moment of each step "
    "with stepper, use dry_friction for friction, or make the law smooth over a scale of your choice, as with "
    "np.tanh(x / scale)"
)


def named(scheme: Integrator, problem: IVP, failure: Failure) -> Failure:
    """Return how a problem of one body has failed: where its load jumps, if that is why an iteration has stalled."""
    terms = [term for term in problem.load.terms if term.kind in ("state", "forces") and not term.in_kernels]
    if failure.status is not Status.STALLED or not terms or problem.load.remembering:
        return failure  # beside internal states a moment is more than a function of the state
    p, W, t = problem.quaternion[0], problem.velocity[0], float(problem.times(failure.step))
    if failure.step:
        outcome = scheme.march(onward(problem, 0, failure.step))
        p, W = outcome.states.quaternion[0, -1], outcome.states.velocity[0, -1]
    for term in terms:
        if (text := _jump(problem.system, problem.load, term, (t, p, W), problem.step_at(failure.step))) is not None:
            return failure._replace(status=Status.JUMP, reason=text)
    return failure


def _jump(body: DirectorSystem, load: Load, term: Term, start: tuple[float, Array, Array], h: float) -> str | None:
    """Return where a term jumps in two steps h from a time, a quaternion and W; None where it does not, or fails."""
    from scipy.spatial.transform import Rotation

    (t, p, W), q = start, directors(start[1])
    rate = np.linalg.solve(body.convected_inertia, torque(body, load, t, q, W))

    def moment(s: float) -> Array:
        turned = attitudes(p) @ Rotation.from_rotvec(s * W + s * s / 2 * rate).as_matrix()
        return state_moment_at(term.load, t + s, turned.T, turned @ (W + s * rate))

    try:
        times = np.linspace(0.0, 2 * h, PIECES + 1)
        values = np.array([moment(s) for s in times.tolist()])
        k = int(np.argmax(abs(np.diff(values, axis=0)).max(axis=1)))
        (a, b), (x, y) = times[k : k + 2].tolist(), values[k : k + 2]
        whole = abs(y - x).max()
        for _ in range(HALVINGS):
            m = moment(c := (a + b) / 2)
            a, b, x, y = (c, b, m, y) if abs(y - m).max() >= abs(m - x).max() else (a, c, x, m)
        is_function = np.array_equal(moment(a), x) and np.array_equal(moment(b), y)  # no random number, for one
    except ValueError:
        return None
    if not (is_function and abs(y - x).max() > LEFT * whole > 0):
        return None
    called, at = term.called, number_text(t + a, ".6g")
    is_text = getattr(called, "__self__", None) is term
    name = type(term).__name__ if is_text else getattr(called, "__name__", "of a C function")
    return WAYS.format(name, at, vector_text(x), vector_text(y))
