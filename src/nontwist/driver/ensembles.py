"""`simulate_ensemble`: many bodies, starts and scales of one load, from their starts to a dataset."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, Unpack

import numpy as np

from ..analysis import statistics
from ..errors import InputError, Option, warn
from ..geometry.arrays import largest_size
from ..geometry.values import among, as_whole, short_repr
from ..integrators import Status
from ..integrators.base import IVP, Outcome
from ..integrators.problem import stretched
from ..models.stack import SystemStack
from ..models.system import DirectorSystem
from . import completion
from .grid import SMALL, free_memory
from .notices import (
    announce,
    coarseness,
    cores,
    failure_message,
    members_cost,
    progress_bar,
    say,
    warn_of_cost,
    warn_of_grid,
)
from .planning import require_observed
from .problem import OfEnsemble, Problem, every_stored, plan_of, posed, starts_of, takes
from .tolerance import controlled, finer, first_run

if TYPE_CHECKING:
    import xarray


@takes(OfEnsemble, "variables", "reduce", "progress", "threads", "device", store="end")
def simulate_ensemble(
    system: DirectorSystem | SystemStack | Problem,
    *,
    variables: str | Iterable[str] = ("quaternion", "material_angular_velocity"),
    reduce: str | Iterable[str] = (),
    progress: bool = False,
    threads: int | None = None,
    device: Literal["cpu", "gpu"] = "cpu",
    **keywords: Unpack[OfEnsemble],
) -> xarray.Dataset:
    """Integrate the motions of many bodies, or of one from many starts, and return them as one dataset.

    Each argument with a member axis, which is its first, has m entries along it, or 1 for all members. The result of a
    member is the same, bit for bit, whatever the number of threads and the other members.

    Parameters
    ----------
    system : DirectorSystem, SystemStack or Problem
        One body, or ``DirectorSystem.stack([...])`` of m; or a whole problem.
    t_end, step, tolerance, t_start, scalar_first, load, integrator, order, times, project, progress
        As in `nontwist.simulate`, the same for all members. ``step=None``: a tolerance of 1e-8 with `gauss`; with other
        integrators no member turns by more than 0.05 rad per step, by a bound from its energy, and the load is
        resolved. With a tolerance all members share one grid, determined by the least accurate member.
    start : Dataset or Trajectory, optional
        Continue from the last states of an ensemble, or start all members from the last state of a run. Its time grid
        is continued if whole steps of it lead to `t_end`.
    rotation : Rotation, (m, 3, 3) or (3, 3) Λ, (m, 4) or (4,) quaternions, ..., optional
        Initial attitudes; the identity by default.
    material_angular_velocity : (m, 3) or (3,) array, rad/s, optional
        Initial angular velocities W in body components. Give these or `angular_velocity`; at rest by default.
    angular_velocity : (m, 3) or (3,) array, rad/s, optional
        Initial angular velocities w in space.
    load_scale : float or (m,) array
        Factors that multiply the load.
    store : int or "end"
        Store every `store`-th state, or only the first and the last, which is the default since all may not fit into
        memory.
    variables : "all" or names, optional
        Variables of the stored states; by default the quaternion and the material angular velocity, from which the
        others follow. ``()``: none, for statistics alone.
    reduce : names, optional
        Statistics over all steps, whatever is stored. "drift": `energy_drift` (kinetic and potential energy less the
        work of the load) and, where momentum is conserved, `momentum_drift`. "extrema": `..._min` and `..._max` of
        energies, momenta, twist rate and reaction moment. "averages": `..._mean`, the means of the same over time.
        "total_twist".
    threads : int, optional
        Number of threads; by default one per processor.
    device : "cpu" or "gpu"
        Where the members march: "gpu" is the first one of NVIDIA, one member a thread, for `gauss`, `lie-midpoint` and
        `energy-momentum`. It has not been tried on a GPU.

    Returns
    -------
    xarray.Dataset
        Variables of `simulate` with the dimension `member` first, statistics, and the `status` of each member. A member
        that fails does not stop the others: from the failure on its numbers are NaN, and the variable `message` states
        the reason.

    Raises
    ------
    ValueError
        An argument is invalid; the message names it. There is no GPU, or a part of the load does not run there.

    Warns
    -----
    UserWarning
        Members have failed; or as in `simulate`.

    Notes
    -----
    `gauss`, `lie-midpoint` and `energy-momentum` integrate 8 members at a time, `split` one after the other, and
    `exact` evaluates its closed forms, all in compiled code. `continuous` integrates one member after the other in
    Python. A Python load is called for each member.

    Examples
    --------
    Four starts at once, and the energy of each after a second:

    >>> from nontwist import nontwisting, simulate_ensemble
    >>> body, W = nontwisting([3, 4, 5]), [[0, 0.5, 0], [0, 1, 0], [0, 1.5, 0], [0, 2, 0]]
    >>> many = simulate_ensemble(body, t_end=1, material_angular_velocity=W, variables="kinetic_energy")
    >>> many.kinetic_energy.isel(time=-1).values.round(9)
    array([0.5, 2. , 4.5, 8. ])
    """
    names, requested = statistics.checked_variables(variables), statistics.checked_statistics(reduce)
    task = posed("simulate_ensemble", system, keywords, OfEnsemble, store="end")
    begin, store = starts_of(task), task.store
    plan = plan_of(task, begin, store=every_stored(task))
    systems = plan.systems
    scheme, load, t0, t1, m = plan.scheme, plan.load, plan.t_start, plan.t_end, len(begin.quaternion)
    if requested:
        require_observed(scheme, load)
    if on_gpu := is_gpu(device):
        from ..integrators.gpu import require

        require(scheme, load)
    grid, first = plan.grid, None
    if grid is None and scheme.any_times and store == "end":
        grid = stretched((t0, t1), (1,))
    if plan.is_controlled and grid is None:
        plan = plan.estimated(begin)
        first = first_run(plan, begin)
        scheme, grid = first.scheme, finer(first.grid)
    if grid is None:
        grid = plan.automatic(begin, is_bound=True)
    problem = replace(plan.problem(begin, grid), observed=bool(requested), on_gpu=on_gpu)
    count = len(problem.stored_times)
    _require_memory(names, m, count)
    if scheme.is_compiled:
        warn_of_cost(load)
        warn_of_grid(load, systems, t0, t1, grid)
        say([plan._replace(scheme=scheme).remark(begin, problem)])
    size, one = int(statistics.bytes_of(names, m, count)), problem.member(0)
    workers = cores() if threads is None else as_whole(threads, "threads", 1)
    if not on_gpu:
        announce(members_cost(scheme, one, m, count, size, workers), scheme, one)
    kept: dict[str, Any] = {}
    with progress_bar(m, "members") if progress else nullcontext() as report:
        if plan.is_controlled:
            on_grid = plan._replace(output_times=None)  # the steps do not heed output times
            found = controlled(on_grid, begin, workers, first, on_gpu, observed=bool(requested), progress=report)
            scheme, problem, outcome, *numbers = found
            kept = dict(zip(("tolerance", "error_estimate"), numbers, strict=True))
            if plan.output_times is not None:
                own = plan._replace(scheme=scheme).problem(begin, problem.grid)
                problem = replace(own, observed=bool(requested), on_gpu=on_gpu)
                outcome = completion.march(scheme, problem, workers)
        else:
            problem = replace(problem, progress=report)
            outcome = completion.march(scheme, problem, workers)
    done = outcome.states.velocity[outcome.failures[:, 0] == Status.OK]
    if not plan.is_controlled and (text := coarseness(scheme, problem, largest_size(done))) is not None:
        warn(text)
        kept["warning"] = text
    many = statistics.dataset(scheme, problem, outcome, names, requested).assign_attrs(kept)
    return with_messages(many, problem, outcome)


def is_gpu(device: Any) -> bool:
    """Whether a device is the GPU, and not the processor; an InputError where it is neither."""
    if not among(device, ("cpu", "gpu")):
        raise InputError("type", name=Option("device"), words="'cpu' or 'gpu'", value=short_repr(device))
    return bool(device == "gpu")


def messages(problem: IVP, outcome: Outcome) -> dict[int, str]:
    """Return the messages of failed members, as `simulate` raises them."""
    failed = np.flatnonzero(outcome.failures[:, 0] != Status.OK).tolist()
    return {i: failure_message(problem, failure) for i in failed if (failure := outcome.failure(i)) is not None}


def with_messages(many: xarray.Dataset, problem: IVP, outcome: Outcome) -> xarray.Dataset:
    """Return an ensemble with the messages of failed members, and warn of them."""
    failed = messages(problem, outcome)
    if not failed:
        return many.assign_attrs(message="done")
    first = next(iter(failed))
    summary = f"{len(failed)} of {len(problem)} members have failed, the first is {first}: {failed[first]}"
    warn(summary)
    texts = [failed.get(i, "") for i in range(len(problem))]
    many["message"] = ("member", np.array(texts, dtype=object), {"long_name": "why the run of the member ended"})
    return many.assign_attrs(message=summary)


def _require_memory(variables: tuple[str, ...], members: int, times: int) -> None:
    needed = statistics.bytes_of(variables, members, times)
    if needed > SMALL and needed > (free := free_memory()):
        raise ValueError(
            f"{members} members with {times} states each need {needed / 1e9:.3g} GB, {free / 1e9:.3g} GB are free; "
            "store fewer states or variables, or run the members in parts"
        )
