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

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ..analysis.trajectory import Trajectory
from ..analysis.variables import observables_of_one
from ..driver import completion
from ..driver.grid import kinks, paced
from ..driver.planning import planned
from ..driver.runs import integrate
from ..driver.single_run import run_of, trajectory
from ..driver.starts import start_of_one
from ..driver.tolerance import CHANGE, EPS, LARGER, moved
from ..geometry.arrays import Array
from ..integrators import Continuous, Exact, Gauss, Integrator
from ..integrators.time_grid import Stretches, stretched
from ..models.stack import stacked
from ..models.system import DirectorSystem

SAME = 1e-12  # of the span, of times that are one
STARTS = "start", "rotation", "scalar_first", "material_angular_velocity", "angular_velocity", "project"
LATER = EPS / 2 * LARGER  # of times


class Reference(NamedTuple):
    """The true motion at the compared times, the error bars of attitude (rad) and material momentum, and its name."""

    run: Trajectory
    attitude_error: float
    momentum_error: float
    name: str
    growth: tuple[float, float]  # of attitude and momentum, under a change of the start, relative to that; at least 1


def reference(system: DirectorSystem, arguments: dict[str, Any], automatic: Trajectory, times: Array) -> Reference:
    """Return the reference at increasing times, from the start to the end.

    Parameters
    ----------
    system : DirectorSystem
    arguments : dict
        Those of `integrate`, without the integrator and the times.
    automatic : Trajectory
        A run at the automatic step, to the end.
    times : (k,) array, s
    """
    try:
        run = integrate(system, times=times, integrator=Exact(), **arguments)
    except ValueError:
        return _stepped(system, arguments, automatic, times)
    moves = bars(run, integrate(system, times=times, integrator=Exact(), **_moved(system, arguments)))
    attitude, momentum = moves
    return _reference(run, (attitude / LARGER, momentum / LARGER), moves, "exact")


def _moved(system: DirectorSystem, arguments: dict[str, Any]) -> dict[str, Any]:
    """Return arguments with the start and the load changed by `CHANGE`."""
    given, t_start = {name: arguments[name] for name in STARTS}, arguments["t_start"]
    begin = moved(start_of_one(system, **given, t_start=t_start))
    start = {"rotation": Rotation.from_quat(begin.quaternion[0]), "material_angular_velocity": begin.velocity[0]}
    start |= {"project": True, "t_start": t_start if begin.time is None else begin.time}
    return arguments | dict.fromkeys(STARTS) | start | {"load": (1 + CHANGE) * arguments["load"]}


def _stepped(system: DirectorSystem, arguments: dict[str, Any], automatic: Trajectory, times: Array) -> Reference:
    jumps = kinks(paced(arguments["load"], stacked(system)), times[0], times[-1])
    apart = abs(jumps[:, None] - times).min(axis=1) > SAME * (times[-1] - times[0])  # 0.3 and 3 × 0.1 are one time
    borders = np.union1d(times, jumps[apart])
    least = np.ceil(4 * np.diff(borders) / float(automatic.step or 1))
    pair = [stretched(borders, n * least) for n in (1, 2)]
    late = stretched(times[0] + (borders - times[0]) * (1 + LATER), least)
    stored = [np.array(grid.numbers)[np.searchsorted(borders, times)] for grid in pair]
    coarse, run = (run_on(system, *each, Gauss(order=8), arguments) for each in zip(pair, stored, strict=True))
    moves = bars(coarse, run_on(system, pair[0], stored[0], Gauss(order=8), _moved(system, arguments)))
    lags = bars(coarse, run_on(system, late, stored[0], Gauss(order=8), arguments))
    name, beside = "gauss 8 at h/8, beside h/4", [run, run]
    if not arguments["load"].is_dry:
        name += " and continuous DOP853"
        beside = [
            integrate(system, times=times, integrator=Continuous(rtol=rtol, atol=rtol / 100), **arguments)
            for rtol in (1e-12, 1e-13)
        ]
    loose, independent = beside
    gaps = bars(run, coarse), bars(run, independent), bars(independent, loose)
    attitude, momentum = (
        max(error_bar(*three), (by_start + by_time) / LARGER)
        for three, by_start, by_time in zip(zip(*gaps, strict=True), moves, lags, strict=True)
    )
    return _reference(run, (attitude, momentum), moves, name)


def run_on(
    system: DirectorSystem, grid: Stretches, store: Any, scheme: Integrator, arguments: dict[str, Any]
) -> Trajectory:
    """Return the run on a grid; `store` as of `integrate`, or the numbers of the nodes."""
    load, t_start, given = arguments["load"], arguments["t_start"], {name: arguments[name] for name in STARTS}
    begin, every = start_of_one(system, **given, t_start=t_start), 1 if isinstance(store, np.ndarray) else store
    plan = planned(system, load, scheme, None, t_start, grid.borders[-1], None, None, every, begin.time)
    if not isinstance(store, np.ndarray):
        return run_of(plan._replace(grid=grid), begin)
    problem = replace(plan.problem(begin, grid, store), intervals=True)
    return trajectory(plan, problem, completion.march(scheme, problem))


def _reference(run: Trajectory, bar: tuple[float, float], moves: tuple[float, float], name: str) -> Reference:
    """Return the reference; `moves`: how far a change of the start by `CHANGE` moves attitude and momentum."""
    largest = float(np.linalg.norm(material_momentum(run), axis=1).max())
    growth = max(1.0, moves[0] / CHANGE), max(1.0, moves[1] / (CHANGE * largest or 1.0))
    return Reference(run, max(bar[0], EPS), max(bar[1], EPS * largest), name, growth)


def error_bar(own: float, gap: float, gap_of_other: float) -> float:
    """Return the error bar from the gaps of the scheme to itself, of both solutions, and of the other one to itself."""
    return gap if gap > max(own, gap_of_other) else own


def bars(a: Trajectory, b: Trajectory) -> tuple[float, float]:
    """Return the largest distances of attitude and material momentum between two runs at the same times."""
    return float(attitude_distance(a, b).max()), float(momentum_distance(a, b).max())


def attitude_distance(a: Trajectory, b: Trajectory, stride: int = 1) -> Array:
    """Return ‖Λ_a - Λ_b‖_F / √2 = 2 sin(θ/2) at the times of b, θ the angle between the attitudes, rad.

    Every `stride`-th time of a is one of b.
    """
    distance: Array = np.linalg.norm(a.directors[::stride] - b.directors, axis=(1, 2)) / np.sqrt(2)
    return distance


def momentum_distance(a: Trajectory, b: Trajectory, stride: int = 1) -> Array:
    """Return |Π_a - Π_b| at the times of b, kg m² s⁻¹."""
    distance: Array = np.linalg.norm(material_momentum(a)[::stride] - material_momentum(b), axis=1)
    return distance


def material_momentum(run: Trajectory) -> Array:
    """Return Π, (n, 3)."""
    return observables_of_one(("material_momentum",), run.system, run.states)["material_momentum"]
