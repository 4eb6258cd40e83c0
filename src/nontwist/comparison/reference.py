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

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import partial
from math import ceil, log2
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ..analysis.invariants import Invariant, drift, quantities, twist_defect
from ..analysis.trajectory import Trajectory
from ..driver import completion
from ..driver.grid import count_steps, kinks, stretches_of, with_spin_kinks
from ..driver.notices import COARSE_STEP
from ..driver.planning import planned, resolve_integrator
from ..driver.runs import integrate
from ..driver.single_run import run_of, trajectory
from ..driver.starts import start_of_one
from ..driver.tolerance import CHANGE, EPS, LARGER, moved
from ..geometry.arrays import Array, as_array
from ..geometry.values import as_list, short_repr
from ..integrators import INTEGRATORS, Continuous, Exact, Gauss, Integrator, LieMidpoint, SimulationError
from ..integrators.problem import Stretches, stretched
from ..loads import Load
from ..models.stack import stacked
from ..models.system import DirectorSystem

# Which integrators and which steps are compared, and the times that all runs share.

Choice = str | tuple[str, int] | Integrator

COARSEST, SERIES, LEAST, FEWEST = 32, 7, 4, 10
SHARED, STORED = 1000, 10_000


def chosen(integrators: Sequence[Choice] | None) -> dict[str, Integrator]:
    """Return the integrators to compare, by label.

    None: every order of every integrator; one whose setting is a tolerance, at 1e-6, 1e-9 and 1e-12.

    Raises
    ------
    ValueError
        An unknown name or order, something that is no integrator, one given twice, or none at all.
    """
    if isinstance(integrators, str):
        raise ValueError(f"integrators must be a list, got {integrators!r}; write [{integrators!r}]")
    if integrators is None:
        schemes = [scheme for cls in INTEGRATORS.values() for scheme in cls.variants()]
    else:
        schemes = [_integrator(choice) for choice in as_list(integrators, "integrators")]
    if not schemes:
        raise ValueError("integrators is empty; leave it out to compare all that accept the body and the load")
    found: dict[str, Integrator] = {}
    for scheme in schemes:
        name = label(scheme)
        if name in found:
            raise ValueError(f"integrators contains {name!r} twice")
        found[name] = scheme
    return found


def label(scheme: Integrator, *, tolerance: bool = True) -> str:
    """Return the name of an integrator with its order, its tolerance and what else is not the default."""
    parts = [scheme.name]
    for field in fields(scheme):
        value = getattr(scheme, field.name)
        if field.name == "order":
            parts.append(f"{value}")
        elif field.name == "rtol":
            parts += [short(value)] * tolerance
        elif field.name == "atol":
            usual = math.isclose(value, scheme.rtol / 100)  # type: ignore[attr-defined]
            parts += [f"atol {short(value)}"] * (tolerance and not usual)
        elif value != field.default:
            parts.append(f"{field.name} {value:g}" if isinstance(value, float) else str(value))
    return " ".join(parts)


def short(x: float, digits: int = 1) -> str:
    """Return a small or large number in few characters: 1e-9, 3.2e-14."""
    mantissa, exponent = f"{x:.{digits}e}".split("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"


def grids(
    steps: Sequence[float] | None, t_start: float, t_end: float, automatic: float, load: Load
) -> dict[float, Stretches]:
    """Return the time grids by their longest step, coarse to fine.

    None: up to seven, each with twice the steps of the one before; the first has about 32 times the automatic step, at
    least 10 steps, and the breakpoints of the load as nodes.

    Raises
    ------
    ValueError
        As `simulate` for one step; no steps.
    """
    span = t_end - t_start
    if steps is None:
        first = stretches_of(load, t_start, t_end, min(span / FEWEST, COARSEST * automatic), resolves=False)
        most = SERIES if len(first.sizes) == 1 else max(LEAST, 2 + ceil(log2(max(1.0, first.longest / automatic))))
        series = [stretched(first.borders, 2**k * np.diff(first.numbers)) for k in range(min(SERIES, most))]
        return {grid.longest: grid for grid in series}
    found = {float(h): stretched((t_start, t_end), (count_steps(span, h),)) for h in as_array(steps, "steps", (None,))}
    if not found:
        raise ValueError("steps is empty; leave it out for a series about the automatic step")
    return dict(sorted(found.items(), reverse=True))


def shared_intervals(numbers: Sequence[int]) -> int:
    """Return the most equal intervals, at most 1000, whose ends every grid of `numbers` steps holds."""
    return _divisor(math.gcd(*numbers), SHARED)


def stored_intervals(N: int, shared: int) -> int:
    """Return the most equal intervals that N steps make, the shared ones among them, at most 10 000."""
    return shared * _divisor(N // shared, STORED // shared)


def _divisor(n: int, most: int) -> int:
    return max(k for k in range(1, min(n, most) + 1) if n % k == 0)


def _integrator(choice: Choice) -> Integrator:
    if isinstance(choice, (str, Integrator)):
        return resolve_integrator(choice, None)
    if isinstance(choice, (tuple, list)) and len(choice) == 2 and isinstance(choice[0], str):
        return resolve_integrator(*choice)
    raise ValueError(f"an integrator is a name, a pair (name, order) or an instance, got {short_repr(choice)}")


# The runs of a comparison: each is compared with the reference once, and then timed.


REFUSED, LONG, SHORT = -1, 0.3, 0.01


class Case(NamedTuple):
    """The problem, its reference solution and its invariants."""

    system: DirectorSystem
    arguments: dict[str, Any]  # of `integrate`, without integrator and times
    t_end: float
    reference: Reference
    shared: int  # intervals
    invariants: dict[str, Invariant]
    scales: dict[str, float]  # by unit
    known_warnings: set[str]  # already issued


class Outcome(NamedTuple):
    """The result of one run: numbers by name, status, message, and the call to be timed."""

    numbers: dict[str, float]
    status: int
    message: str
    call: Callable[[], Trajectory]


def compared(case: Case, scheme: Integrator, grid: Stretches) -> Outcome:
    """Run once and compare with the reference; this also compiles what the timed calls need."""
    call, exact = partial(_run, case, scheme, grid, False), case.reference.run
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            run = _run(case, scheme, grid, True)
        except ValueError as error:
            return Outcome({}, REFUSED, str(error), call)
        except SimulationError as error:
            return Outcome({}, int(error.status), str(error), call)
    stride = (len(run.time) - 1) // case.shared
    attitude, momentum = attitude_distance(run, exact, stride), momentum_distance(run, exact, stride)
    found = {"attitude_error": attitude[-1], "momentum_error": momentum[-1]}
    found |= {"attitude_error_max": attitude.max(), "momentum_error_max": momentum.max()}
    data = run.to_dataset()
    x = quantities(data)
    found |= {name: drift(one, x, case.scales[one.units]) for name, one in case.invariants.items()}
    if (defect := twist_defect(data)) is not None:
        found["twist_defect"] = defect
    issued = sorted({text for text in texts_of(caught) if not text.startswith(COARSE_STEP)} - case.known_warnings)
    return Outcome({name: float(x) for name, x in found.items()}, 0, "; ".join(["done", *issued]), call)


def texts_of(caught: list[warnings.WarningMessage]) -> set[str]:
    """Return what warnings say."""
    return {str(warning.message) for warning in caught}


def _run(case: Case, scheme: Integrator, grid: Stretches, keep_states: bool) -> Trajectory:
    """Run to the end; store the states at the shared times and between them, or the last one only."""
    times = case.reference.run.time
    if scheme.any_times:
        return integrate(case.system, times=times if keep_states else times[-1:], integrator=scheme, **case.arguments)
    N = grid.steps
    store: Any = N // stored_intervals(N, case.shared) if keep_states else "end"
    return run_on(case.system, grid, store, scheme, case.arguments)


def shortest_times(calls: dict[Any, Callable[[], Trajectory]], repeats: int) -> dict[Any, float]:
    """Return the shortest time of each call, s; calls alternate, so that a slow phase of the machine affects all alike.

    A call that took longer than `LONG` is not repeated. One shorter than `SHORT` is timed twice in a row: the first
    time includes what other calls have left cold.
    """
    best = dict.fromkeys(calls, np.inf)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(repeats):
            for key, call in calls.items():
                for first in (True, False):
                    if best[key] < SHORT or (first and not LONG < best[key] < np.inf):
                        start = perf_counter()
                        call()
                        best[key] = min(best[key], perf_counter() - start)
    return best


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


def automatic_run(system: DirectorSystem, arguments: dict[str, Any], t_end: float | None) -> Trajectory:
    """Return a run to the end at the automatic step, of 0.05 rad, by an integrator of order 2 that takes the load."""
    load, t_start = arguments["load"], arguments["t_start"]
    if not load.memories:
        return integrate(system, t_end=t_end, store="end", integrator=LieMidpoint(), **arguments)
    begin = start_of_one(system, **{name: arguments[name] for name in STARTS}, t_start=t_start)
    plan = planned(system, load, Gauss(order=2), None, t_start, t_end, None, None, "end", begin.time)
    return run_of(plan._replace(grid=plan.automatic(begin)), begin)


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
    jumps = kinks(with_spin_kinks(arguments["load"], stacked(system)), times[0], times[-1])
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
    if not (arguments["load"].is_dry or arguments["load"].memories):
        name += " and continuous DOP853"
        beside = [
            integrate(system, times=times, integrator=Continuous(rtol=rtol), **arguments) for rtol in (1e-12, 1e-13)
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
    begin = start_of_one(system, **given, t_start=t_start)
    plan = planned(system, load, scheme, None, t_start, grid.borders[-1], None, None, "end", begin.time)
    if not isinstance(store, np.ndarray):
        return run_of(plan._replace(grid=grid, store=store), begin)
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
    return run.observables("material_momentum")["material_momentum"]
