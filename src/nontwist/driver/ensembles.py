"""`simulate_ensemble`: many bodies, starts and scales of one load, from `integrators.ensemble` to a dataset."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..analysis import ensemble_dataset, reductions
from ..engine.bodies import frames
from ..geometry.arrays import Array, as_number
from ..geometry.values import as_whole
from ..integrators import Integrator, Status
from ..integrators.base import Failure
from ..integrators.ensemble import Ensemble, Outcome
from ..loads import Load, as_load
from ..models.stack import SystemStack, stacked
from ..models.system import DirectorSystem
from . import one_by_one
from .completion import verified
from .costs import members_cost
from .grid import (
    FEWEST,
    SMALL,
    TURN,
    asked_times,
    count_steps,
    free_memory,
    joined,
    refined_count,
    require_resolution,
    stored_steps,
)
from .runs import announce, callers_level, failure_message, progress_bar, resolve_integrator, warn_of_cost, warn_of_grid
from .starts import Starts, starts

if TYPE_CHECKING:
    import xarray


def simulate_ensemble(
    system: DirectorSystem | SystemStack,
    *,
    t_end: float | None = None,
    step: float | None = None,
    t_start: float | None = None,
    start: Any = None,
    rotation: Any = None,
    scalar_first: bool | None = None,
    material_angular_velocity: ArrayLike | None = None,
    angular_velocity: ArrayLike | None = None,
    load: Load | None = None,
    load_scale: ArrayLike = 1.0,
    integrator: str | Integrator = "lie-midpoint",
    order: int | None = None,
    times: ArrayLike | None = None,
    store: int | Literal["end"] = "end",
    variables: str | Iterable[str] = ("quaternion", "material_angular_velocity"),
    reduce: str | Iterable[str] = (),
    project: bool = False,
    progress: bool = False,
    threads: int | None = None,
) -> xarray.Dataset:
    """Integrate the motions of many bodies, or of one from many starts, and return them as one dataset.

    Each argument with a member axis has m entries along it, first, or 1 for all members. A member has the same bits
    whatever the number of threads and whoever its neighbours are.

    Parameters
    ----------
    system : DirectorSystem or SystemStack
        One body, or ``DirectorSystem.stack([...])`` of m.
    t_end, step, t_start, scalar_first, load, integrator, order, times, project, progress
        As in `nontwist.simulate`, the same for all members. ``step=None``: no member turns by more than 0.05 rad a
        step, by a bound from its energy, and the load is resolved.
    start : Dataset or Trajectory, optional
        Continue from the last states of an ensemble, or all members from that of a run, on its time grid where whole
        steps of it lead to `t_end`.
    rotation : Rotation, (m, 3, 3) or (3, 3) Λ, (m, 4) or (4,) quaternions, ..., optional
        Initial attitudes; the identity by default.
    material_angular_velocity : (m, 3) or (3,) array, rad/s, optional
        Initial angular velocities W in body components; or
    angular_velocity : (m, 3) or (3,) array, rad/s, optional
        w in space. At rest by default.
    load_scale : float or (m,) array
        Factors of the load.
    store : int or "end"
        Keep every `store`-th state, or only the first and the last: the default, since all may not fit into memory.
    variables : "all" or names, optional
        Of what is kept of the states; the quaternion and the material angular velocity by default, from which the
        others follow. ``()``: nothing, for reductions alone.
    reduce : names, optional
        Taken over all steps, whatever is stored. "drift": `energy_drift` (kinetic and potential energy less the work
        of the load) and, where it is conserved, `momentum_drift`. "extrema": `..._min` and `..._max` of energies,
        momenta, twist rate, reaction moment. "averages": `..._mean` of the same over time. "total_twist".
    threads : int, optional
        All processors by default.

    Returns
    -------
    xarray.Dataset
        Variables of `simulate` with the dim `member` first, reductions, and the `status` of each member. A member that
        fails does not stop the others: from there on its numbers are NaN, and the variable `message` says why.

    Raises
    ------
    ValueError
        Wrong input; the message names the value.

    Warns
    -----
    UserWarning
        Members have failed; and as in `simulate`.

    Notes
    -----
    `lie-midpoint` and `energy-momentum` march 8 members at a time, `split` one after the other, `exact` evaluates its
    closed solutions, all in compiled code. All else goes member by member, at the cost of one `integrate` each. A load
    in Python is called for each member.

    Examples
    --------
    Four starts at once, and the energy of each after a second:

    >>> from nontwist import nontwisting, simulate_ensemble
    >>> body, W = nontwisting([3, 4, 5]), [[0, 0.5, 0], [0, 1, 0], [0, 1.5, 0], [0, 2, 0]]
    >>> many = simulate_ensemble(body, t_end=1, material_angular_velocity=W, variables="kinetic_energy")
    >>> many.kinetic_energy.isel(time=-1).values.round(9)
    array([0.5, 2. , 4.5, 8. ])
    """
    scheme, load = resolve_integrator(integrator, order), as_load(load)
    kept, asked_for = ensemble_dataset.checked(variables), reductions.checked(reduce)
    systems = stacked(system)
    begin = starts(
        systems,
        start,
        rotation,
        scalar_first,
        material_angular_velocity,
        angular_velocity,
        load_scale,
        project,
    )
    t0 = as_number(t_start, "t_start") if t_start is not None else begin.time or 0.0
    asked = None if times is None else asked_times(scheme, times, t0, t_end, step, 1 if store == "end" else store)
    if asked is None and t_end is None:
        raise ValueError("give t_end=" + (" or times=" if scheme.any_times else ""))
    t1 = as_number(t_end, "t_end") if asked is None else float(asked[-1])  # type: ignore[arg-type]
    if not t1 > t0:
        raise ValueError(f"t_end must be after t_start, got t_start = {t0:g} s, t_end = {t1:g} s")
    if asked_for and scheme.any_times:
        raise ValueError(f"{scheme.name} takes no steps to reduce over; keep states with times=, or take lie-midpoint")
    N = 1
    if asked is None and not (scheme.any_times and store == "end"):
        N = count_steps(t1 - t0, step) if step is not None else _automatic_count(systems, begin, load, t0, t1)
    stored = stored_steps(N, store) if asked is None else np.array([0, 1])
    count = len(asked) if asked is not None else len(stored)
    _require_memory(kept, len(begin.quaternion), count)
    if scheme.is_compiled:
        warn_of_cost(load)
        warn_of_grid(load, t0, t1, N)
    with progress_bar(len(begin.quaternion), "members") if progress else nullcontext() as report:
        ensemble = Ensemble(
            systems,
            begin.quaternion,
            begin.velocity,
            load,
            begin.load_scale,
            t0,
            t1,
            N,
            stored,
            asked,
            begin.normal,
            bool(asked_for),
            None if report is None else lambda part: report(part * len(begin.quaternion)),
            joined(begin.grid, t0, t1, N) if asked is None else None,
        )
        m, crew = len(ensemble), _threads(threads)
        size = int(ensemble_dataset.bytes_of(kept, m, count))
        one = ensemble.member(0)
        announce(members_cost(scheme, one, m, count, size, crew), scheme, one)
        outcome = run_block(scheme, ensemble, crew)
    return _with_messages(ensemble_dataset.dataset(scheme, ensemble, outcome, kept, asked_for), ensemble, outcome)


def run_block(scheme: Integrator, ensemble: Ensemble, threads: int = 1) -> Outcome:
    """Return what becomes of an ensemble: a function of its arguments alone, in the quickest way there is.

    Raises
    ------
    ValueError
        As the integrator; the steps are below the resolution of the times.
    """
    require_resolution(ensemble.t_start, ensemble.t_end, ensemble.steps)
    outcome = scheme.march_many(ensemble, threads)
    return verified(ensemble, outcome if outcome is not None else one_by_one.march(scheme, ensemble, threads))


def messages(ensemble: Ensemble, outcome: Outcome) -> dict[int, str]:
    """Return why members have failed, with the remedies that `simulate` names."""
    found = {}
    for i in np.flatnonzero(outcome.failures[:, 0] != Status.OK).tolist():
        status, step, residual, turn = outcome.failures[i].tolist()
        failure = Failure(Status(int(status)), int(step), residual, turn, outcome.reasons.get(i, ""))
        found[i] = failure_message(ensemble, failure)
    return found


def _with_messages(many: xarray.Dataset, ensemble: Ensemble, outcome: Outcome) -> xarray.Dataset:
    failed = messages(ensemble, outcome)
    if not failed:
        return many.assign_attrs(message="done")
    first = next(iter(failed))
    summary = f"{len(failed)} of {len(ensemble)} members have failed, the first is {first}: {failed[first]}"
    warnings.warn(summary, UserWarning, stacklevel=callers_level())
    texts = [failed.get(i, "") for i in range(len(ensemble))]
    many["message"] = ("member", np.array(texts, dtype=object), {"long_name": "why the run of the member ended"})
    return many.assign_attrs(message=summary)


def _threads(threads: int | None) -> int:
    if threads is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return as_whole(threads, "threads", 1)


def _automatic_count(systems: SystemStack, begin: Starts, load: Load, t0: float, t1: float) -> int:
    """Return N such that no member turns by more than `TURN` in a step, by the bound of `grid.automatic_count`.

    The impulse is bounded by the integral of |m|, so the bound holds and nothing need be run again.
    """
    if load.called.terms:
        raise ValueError("a load that is a function of the state has no bound: give step=")
    assert systems.dead_force is not None
    _, E, M = frames(systems)
    moments = (np.trace(E, axis1=1, axis2=2)[:, None] - E[:, range(3), range(3)]) * M[:, None]
    smallest = moments.min(axis=1) if systems.axis is None else moments[:, :2].min(axis=1)
    span, samples = t1 - t0, 2000
    times = t0 + span * (np.arange(samples) + 0.5) / samples
    total = load.sample(times, "body"), load.sample(times, "space")
    impulse = sum(float(np.linalg.norm(part, axis=1).sum()) for part in total) * span / samples
    kinetic = np.einsum("mi,mij,mj->m", begin.velocity, _for_all(systems.convected_inertia, begin), begin.velocity) / 2
    root = np.sqrt(2 * kinetic) + abs(begin.load_scale) * impulse / np.sqrt(smallest)
    forces = np.linalg.norm(systems.dead_force, axis=2).sum(axis=1)
    fastest = float(np.sqrt((root**2 + 4 * forces) / smallest).max())
    return refined_count(max(FEWEST, span * fastest / TURN, span / load.resolution), load, t0, t1)


def _for_all(values: Array, begin: Starts) -> Array:
    return np.broadcast_to(values, (len(begin.quaternion), *values.shape[1:]))


def _require_memory(variables: tuple[str, ...], members: int, times: int) -> None:
    needed = ensemble_dataset.bytes_of(variables, members, times)
    if needed > SMALL and needed > (free := free_memory()):
        raise ValueError(
            f"{members} members with {times} states each need {needed / 1e9:.3g} GB, {free / 1e9:.3g} GB are free; "
            "store fewer states or variables, or run the members in parts"
        )
