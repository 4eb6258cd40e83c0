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

from ..analysis.invariants import Invariant, drift, quantities, scales, twist_defect
from ..analysis.trajectory import Trajectory
from ..driver import completion
from ..driver.grid import count_steps, kinks, stretches_of, with_spin_kinks
from ..driver.notices import COARSE_STEP
from ..driver.planning import resolve_integrator
from ..driver.problem import Problem, plan_of
from ..driver.single_run import Prepared, trajectory
from ..driver.starts import Starts
from ..driver.tolerance import CHANGE, EPS, LARGER, moved
from ..geometry.arrays import Array, as_array
from ..geometry.values import as_list, short_repr
from ..integrators import INTEGRATORS, Continuous, Exact, Gauss, Integrator, LieMidpoint, SimulationError
from ..integrators.problem import Stretches, stretched
from ..loads import Load, as_load
from ..models.stack import stacked

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
    """The problem, without integrator, steps and stored times, its checked start, and the longest step for 0.05 rad."""

    problem: Problem
    begin: Starts
    automatic: float  # s

    def run(self, scheme: Integrator, times: Array) -> Trajectory:
        """Return the run with output at times."""
        plan = plan_of(self.problem, self.begin, integrator=scheme, times=times, t_end=None)
        return Prepared(plan, self.begin).run()

    def run_on(self, grid: Stretches, store: Any, scheme: Integrator) -> Trajectory:
        """Return the run on a grid; `store` as of `integrate`, or the numbers of the nodes."""
        plan = plan_of(self.problem, self.begin, integrator=scheme, t_end=grid.borders[-1], store="end")
        if not isinstance(store, np.ndarray):
            return Prepared(plan._replace(grid=grid, store=store), self.begin).run()
        problem = replace(plan.problem(self.begin, grid, store), intervals=True)
        return trajectory(scheme, problem, completion.march(scheme, problem))

    @property
    def moved(self) -> Case:
        """The same with the start and the load changed by `CHANGE`."""
        return self._replace(begin=moved(self.begin))


class Outcome(NamedTuple):
    """The result of one run: numbers by name, status, message, and the call to be timed."""

    numbers: dict[str, float]
    status: int
    message: str
    call: Callable[[], Trajectory]


def compared(
    case: Case, true: Reference, kept: dict[str, Invariant], scheme: Integrator, grid: Stretches, known: set[str]
) -> Outcome:
    """Run once and compare with the reference; this also compiles what the timed calls need.

    `kept` are the invariants, and `known` what warnings have said already.
    """
    exact, shared = true.run, len(true.run.time) - 1
    if scheme.any_times:
        run_to, call = partial(case.run, scheme, exact.time), partial(case.run, scheme, exact.time[-1:])
    else:
        store = grid.steps // stored_intervals(grid.steps, shared)
        run_to, call = partial(case.run_on, grid, store, scheme), partial(case.run_on, grid, "end", scheme)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            run = run_to()
        except ValueError as error:
            return Outcome({}, REFUSED, str(error), call)
        except SimulationError as error:
            return Outcome({}, int(error.status), str(error), call)
    stride = (len(run.time) - 1) // shared
    attitude, momentum = distances(run, exact, stride)
    found = {"attitude_error": attitude[-1], "momentum_error": momentum[-1]}
    found |= {"attitude_error_max": attitude.max(), "momentum_error_max": momentum.max()}
    data = run.to_dataset()
    x = quantities(data)
    found |= {name: drift(one, x, true.scales[one.units]) for name, one in kept.items()}
    if (defect := twist_defect(data)) is not None:
        found["twist_defect"] = defect
    issued = sorted({text for text in texts_of(caught) if not text.startswith(COARSE_STEP)} - known)
    return Outcome({name: float(x) for name, x in found.items()}, 0, "; ".join(["done", *issued]), call)


def texts_of(caught: list[warnings.WarningMessage]) -> set[str]:
    """Return what warnings say."""
    return {str(warning.message) for warning in caught}


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
LATER = EPS / 2 * LARGER  # of times


class Reference(NamedTuple):
    """The true motion at the compared times, the error bars of attitude (rad) and material momentum, and its name."""

    run: Trajectory
    attitude_error: float
    momentum_error: float
    name: str
    growth: tuple[float, float]  # of attitude and momentum, under a change of the start, relative to that; at least 1
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
        run = case.run(Exact(), times)
    except ValueError:
        return _stepped(case, times)
    moves = bars(run, case.moved.run(Exact(), times))
    attitude, momentum = moves
    return _reference(run, (attitude / LARGER, momentum / LARGER), moves, "exact")


def _stepped(case: Case, times: Array) -> Reference:
    load = as_load(case.problem.load)
    jumps = kinks(with_spin_kinks(load, stacked(case.problem.system)), times[0], times[-1])
    apart = abs(jumps[:, None] - times).min(axis=1) > SAME * (times[-1] - times[0])  # 0.3 and 3 × 0.1 are one time
    borders = np.union1d(times, jumps[apart])
    least = np.ceil(4 * np.diff(borders) / case.automatic)
    pair = [stretched(borders, n * least) for n in (1, 2)]
    late = stretched(times[0] + (borders - times[0]) * (1 + LATER), least)
    stored = [np.array(grid.numbers)[np.searchsorted(borders, times)] for grid in pair]
    coarse, run = (case.run_on(*each, Gauss(order=8)) for each in zip(pair, stored, strict=True))
    moves = bars(coarse, case.moved.run_on(pair[0], stored[0], Gauss(order=8)))
    lags = bars(coarse, case.run_on(late, stored[0], Gauss(order=8)))
    name, beside = "gauss 8 at h/8, beside h/4", [run, run]
    if not (load.is_dry or load.memories):
        name += " and continuous DOP853"
        beside = [case.run(Continuous(rtol=rtol), times) for rtol in (1e-12, 1e-13)]
    loose, independent = beside
    gaps = bars(run, coarse), bars(run, independent), bars(independent, loose)
    attitude, momentum = (
        max(error_bar(*three), (by_start + by_time) / LARGER)
        for three, by_start, by_time in zip(zip(*gaps, strict=True), moves, lags, strict=True)
    )
    return _reference(run, (attitude, momentum), moves, name)


def _reference(run: Trajectory, bar: tuple[float, float], moves: tuple[float, float], name: str) -> Reference:
    """Return the reference; `moves`: how far a change of the start by `CHANGE` moves attitude and momentum."""
    largest = float(np.linalg.norm(material_momentum(run), axis=1).max())
    growth = max(1.0, moves[0] / CHANGE), max(1.0, moves[1] / (CHANGE * largest or 1.0))
    sizes = scales(quantities(run.to_dataset()), run.system)
    return Reference(run, max(bar[0], EPS), max(bar[1], EPS * largest), name, growth, sizes)


def error_bar(own: float, gap: float, gap_of_other: float) -> float:
    """Return the error bar from the gaps of the scheme to itself, of both solutions, and of the other one to itself."""
    return gap if gap > max(own, gap_of_other) else own


def bars(a: Trajectory, b: Trajectory) -> tuple[float, float]:
    """Return the largest distances of attitude and material momentum between two runs at the same times."""
    attitude, momentum = distances(a, b)
    return float(attitude.max()), float(momentum.max())


def distances(a: Trajectory, b: Trajectory, stride: int = 1) -> tuple[Array, Array]:
    """Return ‖Λ_a - Λ_b‖_F / √2 = 2 sin(θ/2), θ the angle between the attitudes, rad, and |Π_a - Π_b|, kg m² s⁻¹.

    They are those at the times of b; every `stride`-th time of a is one of b.
    """
    attitude: Array = np.linalg.norm(a.directors[::stride] - b.directors, axis=(1, 2)) / np.sqrt(2)
    momentum: Array = np.linalg.norm(material_momentum(a)[::stride] - material_momentum(b), axis=1)
    return attitude, momentum


def material_momentum(run: Trajectory) -> Array:
    """Return Π, (n, 3)."""
    return run.observables("material_momentum")["material_momentum"]
