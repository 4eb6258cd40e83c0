"""`lyapunov` and `lyapunov_ensemble`: how fast neighbouring motions part from each other."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from typing import Unpack

import numpy as np

from ..analysis import statistics
from ..errors import warn
from ..geometry.arrays import Array, Dataset
from ..geometry.attitudes import States
from ..geometry.values import as_whole
from ..integrators import IVP, Integrator, SimulationError, Status
from ..integrators.integrator import Outcome
from ..integrators.ivp import Segments
from ..integrators.linearised_runs import Linearised, scheme_of
from ..integrators.stepping import in_threads
from ..integrators.stepping import progress as counted
from ..integrators.tangents import Growth
from ..machine import cores
from ..models.stack import SystemStack
from ..models.system import DirectorSystem
from . import completion
from .derivatives import Solved, differentiable
from .notices import announce, members_cost, progress_bar, say, warn_of_grid, with_messages
from .planning import Plan
from .problem import OfMany, OfMotion, Problem, plan_of, posed, start_of, starts_of, takes
from .starts import Starts
from .tolerance import controlled

LARGEST, MOST = 2**26, 256  # bytes of the states of members that are marched at a time, and their number
LINEARISED = 6.0  # times the cost of a step in lanes, of its states, its matrices and the growth
KNOWN = {"units": "s-1", "long_name": "mean rate of growth from the start", "symbol": "λ"}


@takes(OfMotion)
def lyapunov(system: DirectorSystem | Problem, **keywords: Unpack[OfMotion]) -> Dataset:
    """Return the Lyapunov exponents of a motion, from its tangent flow.

    Small changes of the attitude and of W, orthonormal at the start, are propagated along the run and
    orthonormalised every 32 steps or more often (Benettin, Galgani, Giorgilli & Strelcyn, Meccanica 15 (1980) 9).
    The exponents are the means of the logarithms of their growth factors. In a regular motion all tend to zero,
    like log(t)/t; in a chaotic one the largest remains positive. Their sum is the rate at which phase-space volumes
    grow. For a standard body it is 0, or with damping -tr(J⁻¹C), and under its weight the exponents form pairs ±λ.
    A Suslov body approaches a steady rotation, so volumes shrink without damping.

    Parameters
    ----------
    system : DirectorSystem or Problem
        The body: `standard`, `nontwisting`, `suslov`, `heavy_top`, `with_gravity`; or a whole problem.
    t_end, step, tolerance, t_start, start, rotation, scalar_first, material_angular_velocity
        As in `simulate`.
    angular_velocity, load, integrator, order, project
        As in `sensitivities`.

    Returns
    -------
    xarray.Dataset
        ``lyapunov_exponent`` on `time` and `exponent`: the means from the start to each time, 1/s, ordered such that
        the first is the largest at the end. There are 6, or 5 for a body with a constrained axis.

    Raises
    ------
    ValueError, SimulationError, SimulationInterrupt
        As `sensitivities`.

    Warns
    -----
    UserWarning
        As `simulate`; or the integrator is `energy-momentum`, whose state has six more directions, which neither grow
        nor shrink: they hide exponents below zero.

    Examples
    --------
    A rotation about the middle axis is unstable, and neighbouring motions diverge at the rate
    ``W2 sqrt((J3 - J2)(J2 - J1)/(J1 J3))``:

    >>> from nontwist import lyapunov, standard
    >>> found = lyapunov(standard([3, 4, 5]), t_end=500, step=0.1, material_angular_velocity=(0, 2, 0))
    >>> found.lyapunov_exponent.values[-1, 0].round(2).item(), round(2 / 15**0.5, 2)
    (0.52, 0.52)
    """
    import xarray

    problem = posed("lyapunov", system, keywords, OfMotion)
    begin = start_of(problem)
    plan = plan_of(problem, begin, store="end")
    known = Solved(plan, begin, "rotation")
    _warn_of_hidden(plan._replace(scheme=known.run.integrator), begin, known.problem.grid)
    steps = Linearised(known.problem, known.run.integrator, ())
    growth = Growth(steps)
    times, sums = growth.sums(known.run.states, steps.workspace())
    means = sums / (times - known.problem.t_start)[:, None]
    time = "time", times, {"units": "s", "long_name": "time", "symbol": "t"}
    along = {"time": time, "exponent": np.arange(1, means.shape[1] + 1)}
    return xarray.Dataset({"lyapunov_exponent": (("time", "exponent"), means, KNOWN)}, along)


def _warn_of_hidden(plan: Plan, begin: Starts, grid: Segments) -> None:
    if scheme_of(plan.scheme, plan.load).is_director_scheme:
        warn("energy-momentum hides exponents below zero; use gauss or lie-midpoint for these")
    if plan.grid is not None:  # that a given step does not resolve decays is said of every run
        return
    rate, order = plan.linearised(begin).decay(begin), getattr(plan.scheme, "order", 2)
    if grid.longest * rate > order:
        warn(
            f"steps of up to {grid.longest:.3g} s do not resolve decays at up to {rate:.3g} 1/s, whose exponents are "
            f"then too near to 0; give step <= {order / rate:.1g}"
        )


@takes(OfMany, "progress", "threads")
def lyapunov_ensemble(
    system: DirectorSystem | SystemStack | Problem,
    *,
    progress: bool = False,
    threads: int | None = None,
    **keywords: Unpack[OfMany],
) -> Dataset:
    """Return the Lyapunov exponents of many motions: a map of order and chaos over starts, bodies or loads.

    For each member these are the exponents that `lyapunov` returns for the end of its run. `lie-midpoint` is the
    cheapest integrator, and conserves the energy of a heavy body. The exponents of a regular motion are about log(t)/t,
    so longer runs give sharper maps.

    Parameters
    ----------
    system, t_end, step, tolerance, t_start, start, rotation, scalar_first, material_angular_velocity
        As in `simulate_ensemble`.
    angular_velocity, load, load_scale, wheel_torque, integrator, order, project, progress, threads
        As in `simulate_ensemble`; "gauss", "lie-midpoint" and "energy-momentum" have derivatives.

    Returns
    -------
    xarray.Dataset
        ``lyapunov_exponent`` on `member` and `exponent`, 1/s: the means over the whole run, the first of them the
        largest; and the `status` of each member. The numbers of members that have failed are NaN, and the variable
        `message` states the reason.

    Raises
    ------
    ValueError
        As `simulate_ensemble` and `sensitivities`.

    Warns
    -----
    UserWarning
        As `simulate_ensemble`, except for the warning about phase errors of coarse steps; and as `lyapunov`.

    Examples
    --------
    A body set spinning about each of its three axes. Near the middle axis neighbouring motions diverge at the rate
    ``W2 sqrt((J3 - J2)(J2 - J1)/(J1 J3))``, near the others no faster than in proportion to time:

    >>> import numpy as np
    >>> from nontwist import lyapunov_ensemble, standard
    >>> how = {"t_end": 500, "step": 0.1, "integrator": "lie-midpoint"}
    >>> found = lyapunov_ensemble(standard([3, 4, 5]), material_angular_velocity=2 * np.eye(3), **how)
    >>> found.lyapunov_exponent.sel(exponent=1).values.round(2)
    array([0.01, 0.52, 0.01])
    """
    task = posed("lyapunov_ensemble", system, keywords, OfMany)
    begin = starts_of(task)
    plan = plan_of(task, begin, store="end")
    systems = plan.systems
    differentiable(plan, begin)
    workers = cores() if threads is None else as_whole(threads, "threads", 1)
    scheme, grid = plan.scheme, plan.grid
    if plan.is_controlled:
        found = controlled(plan, begin, workers)[0]
        scheme, grid = found.scheme, found.problem.grid
    if grid is None:
        grid = plan.automatic(begin, is_bound=True)
    plan = plan._replace(scheme=scheme)
    _warn_of_hidden(plan, begin, grid)
    problem = plan.problem(begin._replace(grid=None), grid)
    warn_of_grid(plan.load, systems, plan.t_start, plan.t_end, grid)
    say([plan.remark(begin, problem)])
    one = problem.member(0)
    cost = members_cost(scheme, one, len(problem), 2, 0, workers)
    announce(cost._replace(seconds=LINEARISED * cost.seconds), scheme, one)
    with progress_bar(len(problem), "members") if progress else nullcontext() as report:
        sums, outcome = grown(scheme, replace(problem, progress=report), workers)
    many = statistics.dataset(scheme, problem, outcome, (), ())
    means = sums / (plan.t_end - plan.t_start)
    many["lyapunov_exponent"] = (("member", "exponent"), means, KNOWN)
    many["exponent"] = np.arange(1, means.shape[1] + 1)
    return with_messages(many, problem, outcome)


def grown(scheme: Integrator, problem: IVP, threads: int) -> tuple[Array, Outcome]:
    """Return the logarithms of what changes grow by until the end, (m, 6 or 5), NaN of members that fail.

    The outcome is without states: they are marched, and their steps linearised, some members at a time.
    """
    m, nodes = len(problem), np.arange(problem.steps + 1)
    is_alike = len(problem.systems) == len(problem.load_scale) == 1 and problem.wheel_torque is None
    shared = Linearised(problem.member(0), scheme, ())
    common = Growth(shared).keep() if is_alike else None
    sums, failures, reasons = np.full((m, Growth(shared).count), np.nan), np.zeros((m, 4)), dict[int, str | Exception]()

    def block(first: int, last: int) -> None:
        part = replace(problem.part(first, last), stored=nodes)
        outcome = completion.checked_march(scheme, part)
        failures[first:last] = outcome.failures
        reasons.update({first + k: reason for k, reason in outcome.reasons.items()})
        own = shared.workspace()
        for k in np.flatnonzero(outcome.failures[:, 0] == Status.OK).tolist():
            growth = common
            if growth is None:
                steps = Linearised(part.member(k), scheme, ())
                growth, own = Growth(steps), steps.workspace()
            try:
                sums[first + k] = growth.sums(outcome.states.part(k), own)[1][-1]
            except SimulationError as error:
                failures[first + k] = error.status, problem.steps_until(error.time), np.nan, np.nan
                reasons[first + k] = str(error)

    size = LARGEST // (8 * 13 * len(nodes)) // 8 * 8
    size = int(np.clip(size, 8, min(MOST, max(-(-m // (4 * threads)) // 8 * 8, 8))))
    in_threads(block, (0, m), size, threads, counted(problem))
    states = States(problem.quaternion[:, None], problem.velocity[:, None])
    return sums, Outcome(states, np.zeros(m, dtype=np.int64), failures, reasons)
