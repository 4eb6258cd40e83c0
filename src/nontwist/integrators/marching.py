"""From a `Problem` through the compiled march to a `March`: the frame, the start, the loads at the nodes, failures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.arrays import Array
from ..geometry.compiled import interpreted
from ..loads import Load
from ..loads.compiled import callback
from .base import Failure, March, Problem, Status
from .composition import fractions, nodes

if TYPE_CHECKING:
    from .midpoint_kernel import Body, Grid, More, Output

BLOCK, SLOW_BLOCK = 2**17, 2**8  # nodes that are sampled and marched at a time; with a load in Python
ROUND_OFF, SAME = 16 * float(np.finfo(np.float64).eps), 1e-12
I3 = np.eye(3)
SIZE = 13  # of `state` in the kernel


def march(problem: Problem, order: int, director_scheme: bool) -> March:
    """March with the composition of the given order, of the director scheme or of lie-midpoint."""
    from . import midpoint_kernel as kernel

    called, reasons = problem.load.called, [""]
    gamma, middles = fractions(order), nodes(order)
    basis = basis_of(problem.system.axis)
    state, normal = start(problem, basis, director_scheme)
    body, more = body_of(problem, basis)
    grid = kernel.Grid(problem.step, gamma, np.empty(0), problem.stored)
    out = output(problem, basis, state, director_scheme)
    run: Any = kernel.march
    function, block = None, BLOCK
    if called.terms and called.is_compiled:
        function = callback(tuple((term.compiled, term.scale) for term in called.terms))
    elif called.terms:
        run, block = interpreted(kernel).march, SLOW_BLOCK
        function = python_moment(called, reasons)

    def block_of(times: Array, moving: Array, space: Array, first: int, done: int) -> Any:
        body_now, grid_now = body._replace(moving=moving @ basis), grid._replace(times=times)
        more_now = more and more._replace(space=space)
        plain = more_now and tuple(more_now), tuple(body_now), tuple(grid_now), tuple(out)
        result = run(state, normal, function, *plain, first, done)
        if result[0] == Status.LOAD and run is kernel.march and more_now is not None:
            reasons.append(reason_in_python(problem, state, normal, more_now, body_now, grid_now, result[-1]))
        return (*result, reasons)

    done, failure = in_blocks(problem, middles, block, block_of)
    directors, velocities, *rest = out
    memory = np.concatenate([state, np.zeros(9) if normal is None else normal.ravel()])
    multipliers, moment, work, iterations = (a[:done] for a in rest)
    states = directors[: done + 1], velocities[: done + 1]
    return March(*states, multipliers, moment, work, iterations, failure, memory)


def in_blocks(
    problem: Problem, middles: Array, size: int, run: Callable[[Array, Array, Array, int, int], Any]
) -> tuple[int, Failure | None]:
    """March over the grid in blocks of about `size` nodes, which lie at the fractions `middles` of each step.

    ``run(times, moving, space, first, done)`` gets the loads at the nodes of its block and returns the status, the
    number of the next step or of the failed one, the stored intervals, the residual, the turn, the node and the reasons
    of failures, the last of which counts. Returns the stored intervals and the failure. Loads that are wrong in the
    first block are wrong input, a ValueError; later ones are a failure of the run.
    """
    done, steps = 0, max(1, size // len(middles))
    for first in range(0, problem.steps, steps):
        k = np.arange(first, min(first + steps, problem.steps), dtype=np.float64)
        times = problem.times(k[:, None] + middles).ravel()
        try:
            moving, space = (sampled(problem.load, times, kind) for kind in ("body", "space"))
        except ValueError as error:
            if first == 0:
                raise
            return done, Failure(Status.LOAD, first, np.nan, np.nan, str(error))
        status, step, done, residual, turn, node, reasons = run(times, moving, space, first, done)
        if status != Status.OK:
            reason = reasons[-1]
            if status == Status.LOAD and not reason:
                reason = f"the load is not finite at t = {times[min(node, len(times) - 1)]:.12g} s"
            return done, Failure(Status(status), step, residual, turn, reason)
        if problem.progress:
            problem.progress(step)
    return done, None


def body_of(problem: Problem, basis: Array) -> tuple[Body, More | None]:
    """Return the body and its load for the kernel, the samples left out; None where it needs nothing more."""
    from .midpoint_kernel import Body, More

    system, load, none = problem.system, problem.load, np.zeros((1, 3))
    E, dead, damping = (
        basis.T @ system.euler_inertia @ basis,
        basis.T @ system.dead_force,
        basis.T @ load.damping @ basis,
    )
    pushed = bool(load.called.terms) or any(term.kind == "space" for term in load.terms)
    heavy, damped, tilted = bool(dead.any()), bool(damping.any()), bool((basis != I3).any())
    more = More(heavy, dead, damped, damping, pushed, none, tilted, basis)
    body = Body(E, system.axis is not None, bool(load.terms), none)
    return body, more if heavy or damped or pushed or tilted else None


def basis_of(axis: Array | None) -> Array:
    """Return the frame, as columns in body components, that the smallest rotation of E3 to ±`axis` gives."""
    if axis is None:
        return I3.copy()
    x, y, z = axis if axis[2] >= 0 else -axis
    f = 1 / (1 + z)
    basis = np.array([[1 - x * x * f, -x * y * f, x], [-x * y * f, 1 - y * y * f, y], [-x, -y, z]])
    return basis if axis[2] >= 0 else basis * [1, -1, -1]


def start(problem: Problem, basis: Array, director_scheme: bool) -> tuple[Array, Array | None]:
    """Return `state` and `normal` of the kernel at the start; those of the run before where they are still it."""
    q, v, memory = problem.directors, problem.velocities, problem.memory
    if memory is not None and memory.shape == (SIZE + 9,) and _is_of(memory, basis, q, v):
        state, N = memory[:SIZE].copy(), memory[SIZE:].reshape(3, 3).copy()
    else:
        V = (basis.T @ v) @ (basis.T @ q).T
        N = (V + V.T) / 2
        N[abs(N) <= ROUND_OFF * abs(V).max()] = 0.0
        state = np.zeros(SIZE)
        state[:4] = quaternion((basis.T @ q).T)
        state[4:7] = (V[1, 2] - V[2, 1]) / 2, (V[2, 0] - V[0, 2]) / 2, (V[0, 1] - V[1, 0]) / 2
    if problem.system.axis is not None:
        W, guess = state[4:7], state[10:13]
        if not director_scheme or abs(W[2]) <= ROUND_OFF * abs(W).max():
            W[2] = 0.0
        guess[2] = 0.0
    return state, N if director_scheme else None


def _is_of(memory: Array, basis: Array, q: Array, v: Array) -> bool:
    """Whether `memory` is of the state (q, v)."""
    own, v_own = states_of(memory[:SIZE], memory[SIZE:].reshape(3, 3), basis)
    return bool(abs(own - q).max() <= SAME and abs(v_own - v).max() <= SAME * abs(v).max())


def states_of(state: Array, normal: Array, basis: Array) -> tuple[Array, Array]:
    """Return the directors and their velocities, as rows, of what the kernel carries."""
    from . import midpoint_kernel

    attitude = getattr(midpoint_kernel.attitude, "py_func", midpoint_kernel.attitude)
    x, y, z = state[4:7]
    V = np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]]) + normal
    q = np.array(attitude(tuple(state[:4].tolist()))).T
    return basis @ q, basis @ V @ q


def quaternion(R: Array) -> Array:
    """Return the unit quaternion, scalar first, of a rotation matrix (Shepperd)."""
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    trace = a + e + i
    rows = (
        (1 + trace, h - f, c - g, d - b),
        (h - f, 1 - trace + 2 * a, b + d, c + g),
        (c - g, b + d, 1 - trace + 2 * e, f + h),
        (d - b, c + g, f + h, 1 - trace + 2 * i),
    )
    p = np.array(rows[max(range(4), key=lambda k: rows[k][k])])
    unit: Array = p / np.sqrt(p @ p)
    return unit


def output(problem: Problem, basis: Array, state: Array, director_scheme: bool) -> Output:
    """Return the arrays that a march fills, the start written."""
    from .midpoint_kernel import Output

    n, axis = len(problem.stored) - 1, problem.system.axis is not None
    directors, velocities = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3, 3))
    directors[0], velocities[0] = problem.directors, problem.velocities
    if not director_scheme:
        tangent = states_of(state, np.zeros((3, 3)), basis)[1]
        if abs(tangent - velocities[0]).max() > SAME * abs(tangent).max():
            velocities[0] = tangent
    columns = (6 if director_scheme else 0) + axis
    sums = np.zeros((n, columns)), np.zeros((n, 3)), np.zeros(n), np.zeros(n, dtype=np.int64)
    return Output(directors, velocities, *sums)


def sampled(load: Load, times: Array, kind: Any) -> Array:
    """Return the terms of one kind at `times`, (n, 3); one row of zeros where there is none."""
    return load.sample(times, kind) if any(term.kind == kind for term in load.terms) else np.zeros((1, 3))


def python_moment(load: Load, reasons: list[str]) -> Callable[..., tuple[float, float, float]]:
    """Return what the kernel calls: `load` on tuples; where it fails NaN, and the reason goes to `reasons`."""

    def function(t: float, q: tuple[float, ...], w: tuple[float, float, float]) -> tuple[float, float, float]:
        try:
            x, y, z = load.state_moment(t, np.array(q).reshape(3, 3), np.array(w)).tolist()
        except ValueError as error:
            reasons.append(str(error))
            return np.nan, np.nan, np.nan
        return x, y, z

    return function


def reason_in_python(
    problem: Problem, state: Array, normal: Array | None, more: More, body: Body, grid: Grid, node: int
) -> str:
    """Return why a compiled load failed: what its Python function says at the same node."""
    from . import midpoint_kernel as kernel

    t = float(grid.times[node])
    reasons = [f"the load is not finite at t = {t:.12g} s"]
    body = body._replace(moving=body.moving[node:][:1] if len(body.moving) > 1 else body.moving)
    more = more._replace(space=more.space[node:][:1] if len(more.space) > 1 else more.space)
    part = grid.fractions[node % len(grid.fractions)][None]
    grid = grid._replace(fractions=part, times=grid.times[node:][:1], stored=np.array([0, 1]))
    out = output(replace(problem, stored=grid.stored), more.basis, state, normal is not None)
    copies = state.copy(), None if normal is None else normal.copy()
    function = python_moment(problem.load.called, reasons)
    interpreted(kernel).march(*copies, function, tuple(more), tuple(body), tuple(grid), tuple(out), 0, 0)
    return reasons[-1]
