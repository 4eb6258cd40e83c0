"""From a `Problem` through the compiled march to a `March`: the frame, the start, the loads at the nodes, failures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..geometry.arrays import Array
from ..geometry.compiled import interpreted
from ..loads import Load
from ..loads.compiled import callback
from ..loads.terms import REMEDY
from ..models.system import DirectorSystem
from .base import Failure, March, Problem, Status
from .composition import fractions, nodes

if TYPE_CHECKING:
    from .midpoint_kernel import Body, Grid, More, Output

BLOCK, SLOW_BLOCK = 2**17, 2**8  # nodes that are sampled and marched at a time; with a load in Python
SAME, TINY = 1e-12, 1e-300
I3, ZEROS = np.eye(3), np.zeros((3, 3))
NONE, NO_TIMES = np.zeros((1, 3)), np.empty(0)
SIZE = 13  # of `state` in the kernel


def march(problem: Problem, order: int, director_scheme: bool) -> March:
    """March with the composition of the given order, of the director scheme or of lie-midpoint."""
    from . import midpoint_kernel as kernel

    called, reasons = problem.load.called, [""]
    gamma, middles = fractions(order), nodes(order)
    turned = turned_body(problem.system)
    basis = turned.basis
    state, normal, is_tangent = start(problem, basis, director_scheme)
    body, more = body_of(problem, turned)
    grid = kernel.Grid(problem.step, gamma, NO_TIMES, problem.stored)
    out = output(problem, director_scheme)
    if not is_tangent:
        out.velocities[0] = states_of(state, np.zeros((3, 3)), basis)[1]
    run: Any = kernel.march
    function, block = None, BLOCK
    if called.terms and called.is_compiled:
        function = callback(tuple((term.compiled, term.scale) for term in called.terms))
    elif called.terms:
        run, block = interpreted(kernel).march, SLOW_BLOCK
        function = python_moment(called, reasons)

    def block_of(times: Array, moving: Array, space: Array, first: int, done: int) -> Any:
        body_now = body if moving is NONE else body._replace(moving=moving @ basis if turned.is_tilted else moving)
        grid_now, more_now = grid._replace(times=times), more and more._replace(space=space)
        plain = more_now and tuple(more_now), tuple(body_now), tuple(grid_now), tuple(out)
        result = run(state, normal, function, *plain, first, done)
        if result[0] == Status.LOAD and run is kernel.march and more_now is not None:
            reasons.append(reason_in_python(problem, state, normal, more_now, body_now, grid_now, result[-1]))
        return (*result, reasons)

    N = np.zeros((3, 3)) if normal is None else normal
    done, failure = in_blocks(problem, problem.steps, middles, block, block_of, [state, N], out)
    result = kept(problem, out, done, failure, lambda: states_of(state, N, basis))
    return result._replace(memory=np.concatenate([state, N.ravel()]))


def kept(
    problem: Problem, out: Output, done: int, failure: Failure | None, now: Callable[[], tuple[Array, Array]]
) -> March:
    """Return what was stored. A run that was interrupted ends in its state `now`, between two stored ones or not."""
    directors, velocities, multipliers, moment, work, iterations = out
    stored, end = problem.stored, None
    if failure is not None and failure.status is Status.INTERRUPTED and failure.step > stored[done]:
        end = failure.step
        directors[done + 1], velocities[done + 1] = now()
        for mean in (multipliers, moment):
            mean[done] *= (stored[done + 1] - stored[done]) / (end - stored[done])
        done += 1
    states = directors[: done + 1], velocities[: done + 1]
    return March(*states, multipliers[:done], moment[:done], work[:done], iterations[:done], failure, end=end)


def in_blocks(
    problem: Problem,
    steps: int,
    middles: Array,
    size: int,
    run: Callable[[Array, Array, Array, int, int], Any],
    carried: list[Array],
    out: Output,
) -> tuple[int, Failure | None]:
    """March over the first `steps` in blocks of about `size` nodes, which lie at the fractions `middles` of each step.

    ``run(times, moving, space, first, done)`` gets the loads at the nodes of its block and returns the status, the
    number of the next step or of the failed one, the stored intervals, the residual, the turn, the node and the reasons
    of failures, the last of which counts. Returns the stored intervals and the failure. Loads that are wrong in the
    first block are wrong input, a ValueError; later ones are a failure of the run.

    An interrupt strikes anywhere, mostly when a block has been marched and not yet been counted. So what the march
    changes, the state `carried` and the sums over the open interval in `out`, is put back to the end of the last block
    that counts. One assignment makes a block count; after the first, before which nothing is worth keeping.
    """
    done, length = 0, max(1, size // len(middles))
    counted: tuple[int, int, list[tuple[Array, Array]]] = 0, 0, []
    try:
        for first in range(0, steps, length):
            last = min(first + length, steps)
            times = problem.nodes(first, last, middles)
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
                    reason = f"the load is not finite at t = {times[min(node, len(times) - 1)]:.12g} s; {REMEDY}"
                return done, Failure(Status(status), step, residual, turn, reason)
            if last < problem.steps:
                changing = [*carried, *(sums[done : done + 1] for sums in out[2:])]
                counted = done, last, [(array, array.copy()) for array in changing]
            if problem.progress:
                problem.progress(step)
    except KeyboardInterrupt as stop:
        done, last, before = counted
        for array, value in before:
            array[...] = value
        return done, Failure(Status.INTERRUPTED, last, np.nan, np.nan, str(stop))
    return done, None


class TurnedBody(NamedTuple):
    """What the kernels know of a body, in the frame whose third direction is its axis."""

    basis: Array  # (3, 3) columns: the frame in body components
    is_tilted: bool  # whether that is not the body's own frame
    euler_inertia: Array
    inertia: Array  # convected
    dead_force: Array
    is_heavy: bool


@lru_cache(maxsize=16)
def turned_body(system: DirectorSystem) -> TurnedBody:
    """Return `system` in the frame of its axis, worked out once a system."""
    basis = basis_of(system.axis)
    E, J = (basis.T @ A @ basis for A in (system.euler_inertia, system.convected_inertia))
    force = basis.T @ system.dead_force
    return TurnedBody(basis, bool((basis != I3).any()), E, J, force, bool(force.any()))


def body_of(problem: Problem, turned: TurnedBody) -> tuple[Body, More | None]:
    """Return the body and its load for the kernel, the samples left out; None where it needs nothing more."""
    from .midpoint_kernel import Body, More

    load, basis = problem.load, turned.basis
    body = Body(turned.euler_inertia, problem.system.axis is not None, bool(load.terms), NONE)
    damping, pushed, damped = ZEROS, False, False
    if load.terms:
        damping = basis.T @ load.damping @ basis
        pushed = bool(load.called.terms) or any(term.kind == "space" for term in load.terms)
        damped = bool(damping.any())
    if not (turned.is_heavy or damped or pushed or turned.is_tilted):
        return body, None
    return body, More(turned.is_heavy, turned.dead_force, damped, damping, pushed, NONE, turned.is_tilted, basis)


def basis_of(axis: Array | None) -> Array:
    """Return the frame, as columns in body components, that the smallest rotation of E3 to ±`axis` gives."""
    if axis is None:
        return I3.copy()
    x, y, z = axis if axis[2] >= 0 else -axis
    f = 1 / (1 + z)
    basis = np.array([[1 - x * x * f, -x * y * f, x], [-x * y * f, 1 - y * y * f, y], [-x, -y, z]])
    return basis if axis[2] >= 0 else basis * [1, -1, -1]


def start(problem: Problem, basis: Array, director_scheme: bool) -> tuple[Array, Array | None, bool]:
    """Return `state` and `normal` of the kernel at the start, those of the run before where they are still it.

    The third value tells whether the velocities that the problem starts with are those of the state.
    """
    from .midpoint_kernel import ROUND_OFF

    q, v, memory = problem.directors, problem.velocities, problem.memory
    if memory is not None and memory.shape == (SIZE + 9,) and _is_of(memory, basis, q, v):
        state, N = memory[:SIZE].copy(), memory[SIZE:].reshape(3, 3).copy()
        across = abs(N).max() / max(abs(v).max(), TINY)
    else:
        state, N, across = begun(q, v, basis)
    if problem.system.axis is not None:
        x, y, z = (abs(w) for w in state[4:7].tolist())
        across = max(across, z / max(x, y, z, TINY))
        if not director_scheme or z <= ROUND_OFF * max(x, y, z):
            state[6] = 0.0
        state[12] = 0.0
    return state, N if director_scheme else None, director_scheme or across <= SAME


def begun(q: Array, v: Array, basis: Array) -> tuple[Array, Array, float]:
    """Return `state` and `normal` of the kernel for given rows, and how large the second is beside the velocities."""
    from . import midpoint_kernel

    begin: Any = midpoint_kernel.begin
    state, N = np.zeros(SIZE), np.empty((3, 3))
    return state, N, begin(q, v, basis, state, N)


def _is_of(memory: Array, basis: Array, q: Array, v: Array) -> bool:
    """Whether `memory` is of the state (q, v)."""
    own, v_own = states_of(memory[:SIZE], memory[SIZE:].reshape(3, 3), basis)
    return bool(abs(own - q).max() <= SAME and abs(v_own - v).max() <= SAME * abs(v).max())


def states_of(state: Array, normal: Array, basis: Array) -> tuple[Array, Array]:
    """Return the directors and their velocities, as rows, of what the kernel carries."""
    from . import midpoint_kernel

    write: Any = midpoint_kernel.states
    q, v = np.empty((3, 3)), np.empty((3, 3))
    write(state, normal, basis, q, v)
    return q, v


def spinning(W: Array) -> Array:
    """Return the components in the body of the velocities W × D_i, as rows."""
    x, y, z = W.tolist()
    return np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])


def output(problem: Problem, director_scheme: bool) -> Output:
    """Return the arrays that a march fills, the start written."""
    from .midpoint_kernel import Output

    n, axis = len(problem.stored) - 1, problem.system.axis is not None
    directors, velocities = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3, 3))
    directors[0], velocities[0] = problem.directors, problem.velocities
    columns = (6 if director_scheme else 0) + axis
    sums = np.zeros((n, columns)), np.zeros((n, 3)), np.zeros(n), np.zeros(n, dtype=np.int64)
    return Output(directors, velocities, *sums)


def sampled(load: Load, times: Array, kind: Any) -> Array:
    """Return the terms of one kind at `times`, (n, 3); `NONE`, one row of zeros, where there is none."""
    return load.sample(times, kind) if any(term.kind == kind for term in load.terms) else NONE


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
    reasons = [f"the load is not finite at t = {t:.12g} s; {REMEDY}"]
    body = body._replace(moving=body.moving[node:][:1] if len(body.moving) > 1 else body.moving)
    more = more._replace(space=more.space[node:][:1] if len(more.space) > 1 else more.space)
    part = grid.fractions[node % len(grid.fractions)][None]
    grid = grid._replace(fractions=part, times=grid.times[node:][:1], stored=np.array([0, 1]))
    out = output(replace(problem, stored=grid.stored), normal is not None)
    copies = state.copy(), None if normal is None else normal.copy()
    function = python_moment(problem.load.called, reasons)
    interpreted(kernel).march(*copies, function, tuple(more), tuple(body), tuple(grid), tuple(out), 0, 0)
    return reasons[-1]
