"""Bodies with wheels, integrated as gyrostats (`loads.wheels`): by every scheme, where h is known beforehand.

A problem with wheels becomes that of what carries them, of inertia J_c, with rotors of momentum h, or loads with memory
h. Its constraints and their multipliers are the same. What is said of its intervals becomes again what is said of the
body with its wheels locked, of momentum J W = J_c W + z, z = Σ I (n·W) n, and energy ½ W·J W = ½ W·J_c W + ½ W·z: the
mean moment of the load has beside that on the carrier the change of Λz, its work that of ½ W·z.

The work of a motor whose torque is known beforehand, ``A = ∫ τ Ω dt = Δh²/2I - n·∫ τ W dt``, follows from the integrals
of W and of t W over the stages of each step, and has its order. The energy of the whole changes by these works and by
those of other loads, to round-off.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss

from ..geometry.arrays import Array
from ..geometry.attitudes import States, attitudes
from ..loads import Load
from ..loads.wheels import Driven, Wheel
from ..models.stack import SystemStack, stacked
from ..models.system import DirectorSystem, euler_inertia
from .problem import IVP, Outcome

COMMANDED = 4  # internal states of a wheel that takes a torque beside its own
X, WEIGHTS = (leggauss(8)[0] + 1) / 2, leggauss(8)[1] / 2


def internal_states(systems: SystemStack, load: Load, time: float, velocity: Array, scale: Array) -> Array:
    """Return the internal states at the start of runs that continue none, (m, k), given W, (m, 3)."""
    found = np.tile(load.internal_state, (len(velocity), 1))
    W = velocity if systems.axis is None else velocity + systems.spin_at(time)[:, None] * systems.axis
    for wheel, column in wheel_columns(load):
        found[:, column] = wheel.inertia * (scale * wheel.scale * wheel.speed + W @ wheel.direction)
    return found


def wheel_columns(load: Load) -> Iterator[tuple[Wheel, int]]:
    """Yield each wheel, and the column of its h among the internal states."""
    column = 0
    for wheel in load.wheels:
        yield wheel, column
        column += wheel.state0.size


def driven_columns(load: Load) -> list[int]:
    """Return the columns of the wheels of which h is known beforehand."""
    return [column + k for wheel, column in wheel_columns(load) if wheel.is_driven for k in range(wheel.state0.size)]


def carrier(system: DirectorSystem, load: Load) -> DirectorSystem:
    """Return what carries the wheels of a body; a ValueError where nothing is left of it."""
    J = system.convected_inertia - sum(one.locked for one in load.wheels)
    if (least := np.linalg.eigvalsh(J)[0]) <= 0:
        raise ValueError(
            "the inertia of a body includes that of its wheels, locked: without it, J - Σ I n nᵀ, the least principal "
            f"moment is {least:.6g} kg m², and must be positive; add the wheels to the inertia, or make them lighter"
        )
    return replace(system, euler_inertia=euler_inertia(J, physical=False), physical=False)


def commanded(load: Load) -> Load:
    """Return a load whose wheels take torques beside their own: the last of `COMMANDED` internal states."""
    return Load(
        tuple(replace(one.unscaled, is_commanded=True) if isinstance(one, Wheel) else one for one in load.terms)
    )


def as_gyrostat(problem: IVP) -> IVP:
    """Return a problem of one body, with wheels, as that of their carrier."""
    one = problem.member(0)
    assert one.internal is not None
    z, t, columns = one.internal[0], one.t_start, iter(wheel_columns(one.load))

    def term_of(wheel: Wheel) -> Driven | Wheel:
        _, column = next(columns)
        own = wheel.unscaled
        if not wheel.is_driven:
            return own
        return Driven(own, t, float(z[column]), breakpoints=own.breakpoints, resolution=own.resolution)

    load = Load(tuple(term_of(term) if isinstance(term, Wheel) else term for term in one.load.terms))
    internal = np.delete(one.internal, driven_columns(one.load), axis=1) if load.memories else None
    return replace(one, systems=stacked(carrier(one.system, one.load)), load=load, internal=internal)


def with_wheels(problem: IVP, states: States, times: Array) -> States:
    """Return the states of `as_gyrostat` at times, with all internal states of the problem but works."""
    assert problem.internal is not None
    at, driven, first = np.append(problem.t_start, times), driven_columns(problem.load), problem.internal
    shape = states.velocity.shape[:-1]  # of one body, or of several
    internal = np.full((*shape, first.shape[1]), np.nan)
    if states.internal is not None:
        internal[..., np.delete(np.arange(first.shape[1]), driven)] = states.internal
    for wheel, column in wheel_columns(problem.load):
        if wheel.is_driven:
            change = wheel.scale * (wheel.impulse(at)[1:] - wheel.impulse(at)[0])
            momenta = first[:, column, None] + problem.load_scale[:, None] * change
            internal[..., column] = momenta if len(shape) > 1 else momenta[0]
    return states._replace(internal=internal)


def of_locked(problem: IVP, outcome: Outcome) -> Outcome:
    """Return the outcome of `as_gyrostat` as that of the body with its wheels, locked."""
    times = outcome.times(problem)
    outcome = outcome._replace(states=with_wheels(problem, outcome.states, times))
    if outcome.intervals is None:
        return outcome
    if outcome.intervals.velocity_integrals is not None:
        _set_works(problem, outcome.states.internal, outcome.intervals.velocity_integrals, times)
    p, W, locked = outcome.states.quaternion, outcome.states.velocity, sum(one.locked for one in problem.load.wheels)
    z, intervals, length = W @ locked, outcome.intervals, np.diff(times)
    with np.errstate(all="ignore"):  # states behind a failure are undefined
        moment = np.diff(np.einsum("mkij,mkj->mki", attitudes(p), z), axis=1) / length[:, None]
    work = np.diff((W * z).sum(axis=-1), axis=1) / 2
    return outcome._replace(
        intervals=intervals._replace(moment=intervals.moment + moment, load_work=intervals.load_work + work)
    )


# ---- the work of motors whose torques are known beforehand


def with_works(problem: IVP) -> IVP:
    """Return a problem with the outputs of which works are made: also the start, and kinks of torques."""
    kinks = {t for one in problem.load.wheels if one.is_driven for t in one.breakpoints}
    if not any(one.is_driven and one.works for one in problem.load.wheels):
        return problem
    inner = [t for t in kinks if problem.t_start < t < problem.stored_times[-1]]
    times = np.union1d(problem.stored_times, [problem.t_start, *inner])
    output_times = problem.output_times if len(times) == len(problem.stored_times) else times
    return replace(problem, intervals=True, output_times=output_times)


def _set_works(problem: IVP, z: Array | None, velocity_integrals: Array, times: Array) -> None:
    """Put the works of driven wheels to the states."""
    first = problem.internal
    assert z is not None
    assert first is not None
    for wheel, column in wheel_columns(problem.load):
        if wheel.is_driven and wheel.works:
            factor, h = wheel.scale * problem.load_scale[:, None], z[..., column]
            slope, impulse = factor * wheel.slope_of_torque(times), factor * np.diff(wheel.impulse(times))
            along = velocity_integrals.reshape(*velocity_integrals.shape[:2], 2, 3) @ wheel.direction
            works = work_of(wheel.inertia, times, h, slope, impulse, along[..., 0], along[..., 1])
            z[..., column + 1] = first[:, column + 1, None] + np.cumsum(np.insert(works, 0, 0.0, axis=1), axis=1)


def work_of(
    inertia: Any, times: Array, h: Array, slope: Array, impulse: Array, along: Array, velocity_moment: Array
) -> Array:
    """Return the work of a motor, ``∫ τ Ω dt = Δh²/2I - ∫ τ n·W dt``, τ linear between n + 1 times, (..., n).

    `h` are the momenta, (..., n + 1), `slope` is that of τ, `impulse` ∫ τ dt; `along` is ∫ n·W dt, `velocity_moment`
    ∫ t n·W dt.
    """
    torque = impulse / np.diff(times) - slope * (times[1:] + times[:-1]) / 2
    found: Array = np.diff(h) * (h[..., 1:] + h[..., :-1]) / (2 * inertia) - torque * along - slope * velocity_moment
    return found


def set_works_between(problem: IVP, states: States, nodes: States, velocities: Callable[[Array], Array]) -> None:
    """Put the works of driven wheels to the states at the times asked for, given those at all nodes of the grid.

    They are quadratures of τ Ω since the node before; `velocities` gives W at increasing times.
    """
    times, grid = problem.stored_times, problem.times(np.arange(problem.steps + 1))
    number = np.searchsorted(grid, times, side="right") - 1
    since = times - grid[number]
    at, place = np.unique(grid[number, None] + since[:, None] * X, return_inverse=True)
    W, first = velocities(at), problem.internal
    assert states.internal is not None
    assert nodes.internal is not None
    assert first is not None
    for wheel, column in wheel_columns(problem.load):
        if wheel.is_driven and wheel.works:
            change = wheel.impulse(at) - wheel.impulse(np.array([problem.t_start]))
            speed = (first[0, column] + wheel.scale * change) / wheel.inertia - W @ wheel.direction
            power = (wheel.scale * wheel.torque_at(at) * speed)[place].reshape(len(times), -1)
            states.internal[:, column + 1] = nodes.internal[number, column + 1] + since * (power @ WEIGHTS)
