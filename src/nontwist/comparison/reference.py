"""The reference solution that runs are compared with, and its error bar.

Where there is a closed-form solution, it is the reference. Its error bar is the effect of a change of the start and the
load by two units of round-off, measured with a change 32 times larger (`moved`): no arithmetic in double precision is
more accurate.

Else the reference is gauss of order 8 at h/8, with h the automatic step, and the error bar its distance from
the same at h/4; breakpoints of the load are nodes of both. SciPy's DOP853 checks it independently, at the tolerances
1e-13 and 1e-12, but not under dry friction, which it does not take: where its run at 1e-13 is farther from the
reference than from its run at 1e-12, that distance is the error bar. Round-off that h/4 and h/8 share is in neither
distance: N steps of a rounded h end at N h (1 ± ε/2), the same time for both. The bar is therefore not smaller than the
effect of the change above and of times that are longer by half a unit of round-off, together; nor than one unit of
round-off.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..analysis.invariants import quantities, scales
from ..analysis.trajectory import Trajectory
from ..driver import completion
from ..driver.grid import kinks, with_spin_kinks
from ..driver.problem import Problem, plan_of
from ..driver.single_run import Prepared, trajectory
from ..driver.starts import Starts
from ..driver.tolerance import CHANGE, LARGER, moved
from ..geometry.arrays import EPS, Array
from ..integrators import Continuous, Exact, Gauss, Integrator, LieMidpoint
from ..integrators.costs import Cost
from ..integrators.ivp import Segments, segmented
from ..loads import as_load
from ..models.stack import stacked


class Case(NamedTuple):
    """The problem, without integrator, steps and stored times, its checked start, and the longest step for 0.05 rad."""

    problem: Problem
    begin: Starts
    automatic: float  # s

    def run(self, scheme: Integrator, times: Array) -> Trajectory:
        """Return the run with output at times."""
        plan = plan_of(self.problem, self.begin, integrator=scheme, times=times, t_end=None)
        return Prepared(plan, self.begin).run()

    def run_on(self, grid: Segments, store: Any, scheme: Integrator) -> Trajectory:
        """Return the run on a grid; `store` as of `integrate`, or the numbers of the nodes."""
        plan = plan_of(self.problem, self.begin, integrator=scheme, t_end=grid.borders[-1], store="end")
        if not isinstance(store, np.ndarray):
            return Prepared(plan._replace(grid=grid, store=store), self.begin).run()
        problem = plan.problem(self.begin, grid, store, intervals=True)
        return trajectory(scheme, problem, completion.checked_march(scheme, problem))

    def cost_on(self, grid: Segments) -> Cost:
        """Return what a run of order 2 on a grid costs, its end stored."""
        plan = plan_of(self.problem, self.begin, integrator=Gauss(order=2), t_end=grid.borders[-1], store="end")
        return Prepared(plan._replace(grid=grid), self.begin).cost

    @property
    def moved(self) -> Case:
        """The same with the start and the load changed by `CHANGE`."""
        return self._replace(begin=moved(self.begin))


SAME = 1e-12  # of the span, of times that are one
LATER = EPS / 2 * LARGER  # of times


class Reference(NamedTuple):
    """The true motion at the compared times, with what is known of its attitude and of its material momentum."""

    run: Trajectory
    name: str
    bar: Array  # (2,), rad and kg m² s⁻¹: their error bars
    growth: Array  # (2,): under a change of the start, relative to that; at least 1
    scales: dict[str, float]  # the sizes of quantities, by unit


def automatic_run(problem: Problem, begin: Starts) -> Trajectory:
    """Return a run to the end at the automatic step, of 0.05 rad, by an integrator of order 2 that takes the load."""
    scheme = Gauss(order=2) if as_load(problem.load).memories else LieMidpoint()
    plan = plan_of(problem, begin, integrator=scheme, store="end")
    if plan.is_controlled:
        plan = plan._replace(grid=plan.automatic(begin))
    return Prepared(plan, begin).run()


def reference(case: Case, times: Array) -> Reference:
    """Return the reference at increasing times, from the start to the end."""
    try:
        run, name = case.run(Exact(), times), "exact"
    except ValueError:
        run, name, bar, moves = _stepped(case, times)
    else:
        moves = bars(run, case.moved.run(Exact(), times))
        bar = moves / LARGER
    sizes = np.array([1.0, np.linalg.norm(material_momentum(run), axis=1).max()])
    changes = CHANGE * sizes
    growth = np.maximum(1.0, moves / np.where(changes > 0, changes, 1.0))
    return Reference(run, name, np.maximum(bar, EPS * sizes), growth, scales(quantities(run.to_dataset()), run.system))


def _stepped(case: Case, times: Array) -> tuple[Trajectory, str, Array, Array]:
    """Return the run by steps, its name, its error bars, and how far a change of the start by `CHANGE` moves it."""
    load = as_load(case.problem.load)
    jumps = kinks(with_spin_kinks(load, stacked(case.problem.system)), times[0], times[-1])
    apart = abs(jumps[:, None] - times).min(axis=1) > SAME * np.ptp(times)  # 0.3 and 3 × 0.1 are one time
    borders = np.union1d(times, jumps[apart])
    least = np.ceil(4 * np.diff(borders) / case.automatic)
    pair = [segmented(borders, n * least) for n in (1, 2)]
    late = segmented(times[0] + (borders - times[0]) * (1 + LATER), least)
    stored = [np.array(grid.numbers)[np.searchsorted(borders, times)] for grid in pair]
    coarse, run = (case.run_on(*each, Gauss(order=8)) for each in zip(pair, stored, strict=True))
    moves = bars(coarse, case.moved.run_on(pair[0], stored[0], Gauss(order=8)))
    lags = bars(coarse, case.run_on(late, stored[0], Gauss(order=8)))
    name, loose, independent = "gauss 8 at h/8, beside h/4", run, run
    if not (load.is_dry or load.memories):
        name += " and continuous DOP853"
        loose, independent = (case.run(Continuous(rtol=rtol), times) for rtol in (1e-12, 1e-13))
    bar = error_bar(bars(run, coarse), bars(run, independent), bars(independent, loose))
    return run, name, np.maximum(bar, (moves + lags) / LARGER), moves


def error_bar(own: ArrayLike, gap: ArrayLike, gap_of_other: ArrayLike) -> Array:
    """Return the error bar from the gaps of the scheme to itself, of both solutions, and of the other one to itself."""
    return np.where(gap > np.maximum(own, gap_of_other), gap, own)


def bars(a: Trajectory, b: Trajectory) -> Array:
    """Return the largest distances of attitude and material momentum, (2,), between two runs at the same times."""
    return distances(a, b).max(axis=1)


def distances(a: Trajectory, b: Trajectory, stride: int = 1) -> Array:
    """Return ‖Λ_a - Λ_b‖_F / √2 = 2 sin(θ/2), θ the angle between the attitudes, rad, and |Π_a - Π_b|, kg m² s⁻¹.

    They are two rows, at the times of b; every `stride`-th time of a is one of b.
    """
    attitude = np.linalg.norm(a.directors[::stride] - b.directors, axis=(1, 2)) / np.sqrt(2)
    momentum = np.linalg.norm(material_momentum(a)[::stride] - material_momentum(b), axis=1)
    return np.array([attitude, momentum])


def material_momentum(run: Trajectory) -> Array:
    """Return Π, (n, 3)."""
    return run.observables("material_momentum")["material_momentum"]
