"""`compare`: one problem, many integrators and steps: errors, orders, drifts, times.

The attitude error is ``‖Λ - Λ_ref‖_F / √2 = 2 sin(θ/2)`` with θ the angle between the attitudes, the momentum error
``|Π - Π_ref|``; both are taken at times that the grids of all runs share. With an error ``c h^n`` the measured order
between two steps h_1 > h_2 is

    n = log(e_1 / e_2) / log(h_1 / h_2),

here from the largest errors over the shared times: the error at one time may pass through zero. It is given only where
e_2 is 20 times larger than the error bar of the reference and than the round-off of N steps: noise has no order. That
of a step is eps times the size of the quantity, and grows by the end as a change of the start does, by a factor A that
is measured; of N steps it is A eps √N.

Integrators without a step (closed-form solutions, tolerances) run once. Their numbers are repeated at every step;
`takes_steps` is False. Another tolerance is another instance.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import fields
from functools import partial
from math import ceil, log2
from time import perf_counter
from typing import Any, Unpack

import numpy as np

from ..analysis.invariants import Invariant, drift, invariants, quantities, twist_defect
from ..analysis.trajectory import Trajectory
from ..driver.grid import count_steps, fits, inside, kinks, segments_of, with_spin_kinks
from ..driver.notices import COARSE_STEP, notice, progress_bar
from ..driver.planning import resolve_integrator
from ..driver.problem import OfComparison, Problem, posed, start_of, takes
from ..geometry.arrays import Array, Dataset, as_array
from ..geometry.values import as_list, as_whole, short_repr
from ..integrators import INTEGRATORS, Integrator, SimulationError, Status
from ..integrators.ivp import Segments, segmented
from ..loads import Load, as_load
from ..models.stack import stacked
from ..models.system import DirectorSystem, as_system
from .reference import Case, Reference, automatic_run, distances, reference

FEW = 4
BESIDE = ("step", "tolerance", "integrator", "order", "store")  # which a problem may have


@takes(OfComparison, "progress")
def compare(
    system: DirectorSystem | Problem,
    *,
    integrators: Sequence[Choice] | None = None,
    steps: Sequence[float] | None = None,
    repeats: int = 5,
    progress: bool = False,
    **keywords: Unpack[OfComparison],
) -> Dataset:
    """Run many integrators at many steps on one problem and compare them with a reference solution.

    Parameters
    ----------
    system, t_end, t_start, start, rotation, scalar_first, material_angular_velocity, angular_velocity, load, project
        The problem, as in `nontwist.simulate`.
    integrators : sequence, optional
        Names, pairs (name, order), instances such as ``Continuous(rtol=1e-8, atol=1e-10)``. By default every order of
        every integrator that accepts the body and the load, `continuous` at the tolerances 1e-6, 1e-9 and 1e-12.
    steps : sequence of float, s, optional
        Each must divide the span. By default up to seven, each half of the one before, from about 32 times the
        automatic step (of 0.05 rad) to half of it, with the breakpoints of the load as nodes; `step` is the longest
        one. Integrators that take no steps have the same numbers at all of them.
    repeats : int
        Number of timed runs, fewer where they take more than 5 s in all; the shortest time counts.
    progress : bool
        Show a bar on stderr.

    Returns
    -------
    xarray.Dataset
        On (integrator, step), steps from coarse to fine; NaN where a run failed: `attitude_error` (rad),
        `momentum_error` (kg m² s⁻¹) at the end; `attitude_error_max`, `momentum_error_max` over the shared times;
        `attitude_order`, `momentum_order`, measured against the step before, NaN where this is not possible;
        `attitude_below_bar`, `momentum_below_bar`, whether the largest error is within the error bar of the reference,
        `attitude_reference_error`, `momentum_reference_error`; `drift` of each `invariant`, relative to
        `invariant_scale`; for bodies with a constrained axis `twist_defect`, the largest |w·Λn - c| (rad/s), c the
        prescribed spin, 0 without; `run_time` (s) of a call that stores only the end; `status` (0 done, -1 refused,
        else as `Status`); `message`. The attribute `reference` names the reference solution. The attribute
        `meets_kinks` is 0 where the steps miss breakpoints of the load: the measured orders are then unreliable, and no
        integrator is reported as the fastest. `nontwist.comparison.summary` and `table` show the dataset as
        tables, `nontwist.plot.work_precision` draws it.

    Raises
    ------
    ValueError
        The problem is invalid, an integrator or an order is unknown, or a step does not divide the span. An integrator
        that cannot solve this problem is reported and does not raise.
    SimulationError
        The problem cannot be run, even at small steps.

    Warns
    -----
    UserWarning
        As `simulate`; or the steps have few times in common.

    Examples
    --------
    >>> from nontwist import compare, standard
    >>> schemes = [("energy-momentum", 2), ("gauss", 4), "exact"]
    >>> how = {"material_angular_velocity": (0.5, 2, 0.1), "steps": [0.1, 0.05], "repeats": 1}
    >>> data = compare(standard([3, 4, 5]), t_end=2, integrators=schemes, **how)
    >>> data.attitude_order.isel(step=-1).values.round(1)  # what takes no steps has none
    array([ 2.,  4., nan])
    """
    schemes = chosen(integrators)
    repeats = as_whole(repeats, "repeats", 1)
    problem = posed("compare", system, keywords, OfComparison, aside=BESIDE)
    problem = problem.replace(**dict.fromkeys(BESIDE))  # type: ignore[arg-type]
    body, load, begin = as_system(problem.system), as_load(problem.load), start_of(problem)
    with warnings.catch_warnings(record=True, action="always") as caught:
        automatic = automatic_run(problem, begin)
    known = texts_of(caught)
    t0, t1 = (float(t) for t in automatic.time)
    pace, case = with_spin_kinks(load, stacked(body)), Case(problem, begin, automatic.step or t1 - t0)
    found = grids(steps, t0, t1, case.automatic, pace)
    numbers = {h: grid.steps for h, grid in found.items()}
    shared = shared_intervals(list(numbers.values()))
    coarsest = next(iter(found.values()))
    at = np.interp(np.linspace(0, coarsest.steps, shared + 1), coarsest.numbers, coarsest.borders)
    meets_kinks = set(kinks(pace, t0, t1).tolist()) <= set(coarsest.borders)
    meets_kinks |= all(fits(inside(pace.breakpoints, t0, t1), N) for N in numbers.values())
    stepping = sum(not scheme.any_times for scheme in schemes.values())
    finest = max(found.values(), key=lambda grid: grid.steps)
    each, runs = case.cost_on(finest), 2 * stepping * sum(numbers.values()) / finest.steps
    long = notice(each._replace(seconds=runs * each.seconds, parts=round(runs * each.parts)), "comparison")
    for text in sorted(known | {text for text in (_few(shared) if shared < FEW else None, long) if text}):
        warnings.warn(text, UserWarning, stacklevel=2)
    with warnings.catch_warnings(action="ignore"):
        exact = reference(case, at)
    kept = invariants(body, load.description)
    first = next(iter(numbers))
    jobs = [(name, h) for name, s in schemes.items() for h in (numbers if not s.any_times else [first])]
    calls, outcomes = {}, {}
    with progress_bar(len(jobs), "comparing") if progress else nullcontext() as report:
        for k, (name, h) in enumerate(jobs):
            if report:
                report(k / len(jobs))
            calls[name, h], outcomes[name, h] = compared(case, exact, kept, schemes[name], found[h], known)
    if integrators is None:
        schemes = {name: s for name, s in schemes.items() if outcomes[name, first]["status"] != REFUSED}
    done = {key: call for key, call in calls.items() if outcomes[key]["status"] == 0}
    for key, seconds in shortest_times(done, repeats).items():
        outcomes[key]["run_time"] = seconds
    data = comparison_dataset(schemes, numbers, outcomes, exact, kept)
    return data.assign_attrs(meets_kinks=int(meets_kinks))


def _few(shared: int) -> str:
    return (
        f"the steps share only {shared + 1} times, so the largest errors are those at these alone; steps that are "
        "multiples of one another share more"
    )


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
) -> dict[float, Segments]:
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
        first = segments_of(load, t_start, t_end, min(span / FEWEST, COARSEST * automatic), resolves=False)
        most = SERIES if len(first.sizes) == 1 else max(LEAST, 2 + ceil(log2(max(1.0, first.longest / automatic))))
        series = [segmented(first.borders, 2**k * np.diff(first.numbers)) for k in range(min(SERIES, most))]
        return {grid.longest: grid for grid in series}
    found = {float(h): segmented((t_start, t_end), (count_steps(span, h),)) for h in as_array(steps, "steps", (None,))}
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


REFUSED, LONG, SHORT, ENOUGH = -1, 0.3, 0.01, 5.0


def compared(
    case: Case, true: Reference, kept: dict[str, Invariant], scheme: Integrator, grid: Segments, known: set[str]
) -> tuple[Callable[[], Trajectory], dict[str, Any]]:
    """Run once and compare with the reference; this also compiles what the timed calls need.

    `kept` are the invariants, and `known` what warnings have said already. Returned are the call to be timed, and
    the `MEASURES` and drifts that one run has, its status and message among them.
    """
    exact, shared = true.run, len(true.run.time) - 1
    if scheme.any_times:
        run_to, call = partial(case.run, scheme, exact.time), partial(case.run, scheme, exact.time[-1:])
    else:
        store = grid.steps // stored_intervals(grid.steps, shared)
        run_to, call = partial(case.run_on, grid, store, scheme), partial(case.run_on, grid, "end", scheme)
    with warnings.catch_warnings(record=True, action="always") as caught:
        try:
            run = run_to()
        except (ValueError, SimulationError) as error:
            return call, {"status": int(getattr(error, "status", REFUSED)), "message": str(error)}
    data = run.to_dataset()
    x = quantities(data)
    found: dict[str, Any] = {name: drift(one, x, true.scales[one.units]) for name, one in kept.items()}
    for of, errors in zip(COMPARED, distances(run, exact, (len(run.time) - 1) // shared), strict=True):
        found |= {f"{of}_error": errors[-1], f"{of}_error_max": errors.max()}
    issued = sorted({text for text in texts_of(caught) if not text.startswith(COARSE_STEP)} - known)
    found |= {"twist_defect": twist_defect(data), "status": 0, "message": "; ".join(["done", *issued])}
    return call, found


def texts_of(caught: list[warnings.WarningMessage]) -> set[str]:
    """Return what warnings say."""
    return {str(warning.message) for warning in caught}


def shortest_times(calls: dict[Any, Callable[[], Trajectory]], repeats: int) -> dict[Any, float]:
    """Return the shortest time of each call, s; calls alternate, so that a slow phase of the machine affects all alike.

    A call that took longer than `LONG` is not repeated, nor is any after `ENOUGH` in all. One shorter than `SHORT` is
    timed twice in a row: the first time includes what other calls have left cold.
    """
    best, spent = dict.fromkeys(calls, np.inf), 0.0
    with warnings.catch_warnings(action="ignore"):
        for _ in range(repeats):
            if spent > ENOUGH:
                break
            for key, call in calls.items():
                for first in (True, False):
                    if best[key] < SHORT or (first and not LONG < best[key] < np.inf):
                        start = perf_counter()
                        call()
                        took = perf_counter() - start
                        best[key], spent = min(best[key], took), spent + took
    return best


# A comparison as a dataset: what was measured on (integrator, step), measured orders, names, units, record.


CLEAR = 20.0
COMPARED = ("attitude", "momentum")
_RUNS = ("integrator", "step")
MEASURES: dict[str, tuple[str, str, str]] = {
    "attitude_error": ("rad", "attitude error at the end", "e_Λ"),
    "attitude_error_max": ("rad", "largest attitude error at the shared times", "max e_Λ"),
    "attitude_order": ("1", "measured order of the attitude, from the step before", "n_Λ"),
    "attitude_below_bar": ("1", "largest attitude error within the error bar of the reference", "e_Λ ≤ bar"),
    "attitude_reference_error": ("rad", "error bar of the reference attitude", "bar_Λ"),
    "momentum_error": ("kg m2 s-1", "material momentum error at the end", "e_Π"),
    "momentum_error_max": ("kg m2 s-1", "largest material momentum error at the shared times", "max e_Π"),
    "momentum_order": ("1", "measured order of the material momentum, from the step before", "n_Π"),
    "momentum_below_bar": ("1", "largest momentum error within the error bar of the reference", "e_Π ≤ bar"),
    "momentum_reference_error": ("kg m2 s-1", "error bar of the reference material momentum", "bar_Π"),
    "drift": ("1", "largest drift from the start, relative to invariant_scale", "Δ"),
    "twist_defect": ("rad s-1", "largest error of the twist rate about the constrained axis", "max |w·Λn - c|"),
    "run_time": ("s", "shortest time of a call that stores the end only", "T"),
    "status": ("1", "0 done, -1 refused, else how the run failed", "status"),
    "message": ("1", "message and warnings of the run", "message"),
}


def comparison_dataset(
    schemes: Mapping[str, Integrator],
    counts: Mapping[float, int],
    outcomes: Mapping[tuple[str, float], Mapping[str, Any]],
    reference: Reference,
    invariants: Mapping[str, Invariant],
) -> Dataset:
    """Return the dataset that `nontwist.compare` describes.

    `outcomes` by label and step, of what takes no steps at the first one.
    """
    import xarray

    first, steps, scales = next(iter(counts)), np.array(list(counts)), reference.scales

    def array(name: str) -> Array:
        rows = [[outcomes.get((i, h), outcomes[i, first]) for h in counts] for i in schemes]
        return np.array([[one.get(name, np.nan) for one in row] for row in rows])

    found: dict[str, Any] = {"drift": (("invariant", *_RUNS), np.array([array(name) for name in invariants]))}
    sizes = 1.0, scales["kg m2 s-1"]
    for of, bar, size, growth in zip(COMPARED, reference.bar, sizes, reference.growth, strict=True):
        largest = array(f"{of}_error_max")
        noise = np.maximum(bar, np.finfo(np.float64).eps * np.sqrt(list(counts.values())) * size * growth)
        found[f"{of}_order"] = _RUNS, measured_orders(largest, steps, CLEAR * noise)
        found |= {f"{of}_below_bar": (_RUNS, largest <= bar), f"{of}_reference_error": ((), bar)}
    described = {}
    for name, (units, long_name, symbol) in MEASURES.items():
        if name != "twist_defect" or reference.run.system.axis is not None:
            own = {"units": units, "long_name": long_name, "symbol": symbol}
            described[name] = *(found[name] if name in found else (_RUNS, array(name))), own
    values = list(schemes.values())
    coordinates: dict[str, Any] = {
        "integrator": list(schemes),
        "step": ("step", steps, {"units": "s", "long_name": "step", "symbol": "h"}),
        "invariant": list(invariants),
        "step_count": ("step", list(counts.values())),
        "family": ("integrator", [scheme.name for scheme in values]),
        "method": ("integrator", [label(scheme, tolerance=False) for scheme in values]),
        "order": ("integrator", [getattr(scheme, "order", 0) for scheme in values], {"long_name": "0: has none"}),
        "takes_steps": ("integrator", [not scheme.any_times for scheme in values]),
        "invariant_symbol": ("invariant", [one.symbol for one in invariants.values()]),
        "invariant_units": ("invariant", [one.units for one in invariants.values()]),
        "invariant_scale": ("invariant", [scales[one.units] for one in invariants.values()]),
    }
    return xarray.Dataset(described, coordinates, _attributes(reference))


def measured_orders(errors: Array, steps: Array, floors: Array) -> Array:
    """Return the slopes of log error over log step from the step before, (m, n), the first column NaN.

    NaN as well where an error is missing, not above its floor, or not smaller than the one before: then it does not
    depend on the step, is round-off, or the step is too coarse to speak of an order.
    """
    orders = np.full(errors.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = np.log(errors[:, :-1] / errors[:, 1:]) / np.log(steps[:-1] / steps[1:])
    orders[:, 1:] = np.where((errors[:, 1:] > floors[1:]) & (slopes > 0), slopes, np.nan)
    return orders


def _attributes(reference: Reference) -> dict[str, Any]:
    run = reference.run
    record = run.record()
    copied = {name: record[name] for name in ("format_version", "conventions", "system", "load", "versions")}
    states = {"directors": run.directors[0].tolist(), "director_velocities": run.director_velocities[0].tolist()}
    return {
        "title": f"{run.system.name} body{' under load' * bool(run.load)}, {run.time[0]:g} to {run.time[-1]:g} s",
        **copied,
        "start": json.dumps(states),
        "t_start": float(run.time[0]),
        "t_end": float(run.time[-1]),
        "shared_times": len(run.time),
        "reference": reference.name,
        "status_meaning": json.dumps({REFUSED: "REFUSED", **{int(status): status.name for status in Status}}),
    }
