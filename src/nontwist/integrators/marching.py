"""What the marches of `split` share: the frame, the start, the loads at the nodes, failures."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..engine.bodies import bases_of
from ..geometry.arrays import Array
from ..loads import Load
from ..models.system import DirectorSystem
from .base import Failure, March, Problem, Status

I3, ZEROS = np.eye(3), np.zeros((3, 3))
NONE = np.zeros((1, 3))
SIZE = 13  # of `state` in the kernel


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
    number of the next step or of the failed one, the stored intervals, the residual, the turn and the reason of a
    failure. Returns the stored intervals and the failure. Loads that are wrong in the first block are wrong input, a
    ValueError; later ones are a failure of the run.

    An interrupt strikes anywhere, mostly when a block has been marched and not yet been counted. So what the march
    changes, the state `carried` and the sums over the open interval in `out`, is put back to the end of the last block
    that counts. One assignment makes a block count; after the first, before which nothing is worth keeping.
    """
    done, length = 0, max(1, size // len(middles))
    counted: tuple[int, int, list[tuple[NDArray[Any], NDArray[Any]]]] = 0, 0, []
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
            status, step, done, residual, turn, reason = run(times, moving, space, first, done)
            if status != Status.OK:
                return done, Failure(Status(status), step, residual, turn, reason)
            if last < problem.steps:
                changing: list[NDArray[Any]] = [*carried, *(sums[done : done + 1] for sums in out[2:])]
                counted = done, last, [(array, array.copy()) for array in changing]
            if problem.progress:
                problem.progress(step / problem.steps)
    except KeyboardInterrupt as stop:
        done, last, before = counted
        for array, value in before:
            array[...] = value
        return done, Failure(Status.INTERRUPTED, last, np.nan, np.nan, str(stop))
    return done, None


class Output(NamedTuple):
    """What a march fills; all but the first two are sums over intervals, zero at first."""

    directors: Array
    velocities: Array
    multipliers: Array
    moment: Array
    work: Array
    iterations: NDArray[np.int64]


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
    basis = I3 if system.axis is None else bases_of(system.axis[None])[0]
    E, J = (basis.T @ A @ basis for A in (system.euler_inertia, system.convected_inertia))
    force = basis.T @ system.dead_force
    return TurnedBody(basis, bool((basis != I3).any()), E, J, force, bool(force.any()))


def begun(q: Array, v: Array, basis: Array) -> tuple[Array, Array, float]:
    """Return `state` and `normal` of the kernel for given rows, and how large the second is beside the velocities."""
    from . import split_kernel

    begin: Any = split_kernel.begin
    state, N = np.zeros(SIZE), np.empty((3, 3))
    return state, N, begin(q, v, basis, state, N)


def states_of(state: Array, normal: Array, basis: Array) -> tuple[Array, Array]:
    """Return the directors and their velocities, as rows, of what the kernel carries."""
    from . import split_kernel

    write: Any = split_kernel.states
    q, v = np.empty((3, 3)), np.empty((3, 3))
    write(state, normal, basis, q, v)
    return q, v


def sampled(load: Load, times: Array, kind: Any) -> Array:
    """Return the terms of one kind at `times`, (n, 3); `NONE`, one row of zeros, where there is none."""
    return load.sample(times, kind) if any(term.kind == kind for term in load.terms) else NONE
