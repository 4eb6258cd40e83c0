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
import warnings
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from ..analysis.invariants import Invariant, invariants
from ..driver.grid import fits, inside, kinks, with_spin_kinks
from ..driver.notices import progress_bar
from ..driver.problem import OfComparison, Problem, posed, start_of, takes
from ..geometry.arrays import Array
from ..geometry.values import as_whole
from ..integrators import Integrator, Status
from ..loads import as_load
from ..models.stack import stacked
from ..models.system import DirectorSystem, as_system
from .reference import (
    REFUSED,
    Case,
    Choice,
    Outcome,
    Reference,
    automatic_run,
    chosen,
    compared,
    grids,
    label,
    reference,
    shared_intervals,
    shortest_times,
    texts_of,
)

if TYPE_CHECKING:
    import xarray

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
) -> xarray.Dataset:
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
        Number of timed runs; the shortest time counts.
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
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
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
    for text in sorted(known | ({_few(shared)} if shared < FEW else set())):
        warnings.warn(text, UserWarning, stacklevel=2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exact = reference(case, at)
    kept = invariants(body, load.description)
    first = next(iter(numbers))
    jobs = [(name, h) for name, s in schemes.items() for h in (numbers if not s.any_times else [first])]
    outcomes = {}
    with progress_bar(len(jobs), "comparing") if progress else nullcontext() as report:
        for k, (name, h) in enumerate(jobs):
            if report:
                report(k / len(jobs))
            outcomes[name, h] = compared(case, exact, kept, schemes[name], found[h], known)
    if integrators is None:
        schemes = {name: s for name, s in schemes.items() if outcomes[name, first].status != REFUSED}
    for key, seconds in shortest_times({k: o.call for k, o in outcomes.items() if o.status == 0}, repeats).items():
        outcomes[key].numbers["run_time"] = seconds
    table = {(name, h): outcomes[name, h if (name, h) in outcomes else first] for name in schemes for h in numbers}
    data = comparison_dataset(schemes, numbers, table, exact, kept)
    return data.assign_attrs(meets_kinks=int(meets_kinks))


def _few(shared: int) -> str:
    return (
        f"the steps share only {shared + 1} times, so the largest errors are those at these alone; steps that are "
        "multiples of one another share more"
    )


# A comparison as a dataset: what was measured on (integrator, step), measured orders, names, units, record.


CLEAR = 20.0

_RUNS = ("integrator", "step")
VARIABLES: dict[str, tuple[str, str, str]] = {
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
    outcomes: Mapping[tuple[str, float], Outcome],
    reference: Reference,
    invariants: Mapping[str, Invariant],
) -> xarray.Dataset:
    """Return the dataset that `nontwist.compare` describes; `outcomes` by label and step."""
    import xarray

    def array(name: str) -> Array:
        return np.array([[outcomes[i, h].numbers.get(name, np.nan) for h in counts] for i in schemes])

    steps, run, scales = np.array(list(counts)), reference.run, reference.scales
    momentum = scales["kg m2 s-1"]
    variables: dict[str, Any] = {}
    for name, bar, size, growth in (
        ("attitude", reference.attitude_error, 1.0, reference.growth[0]),
        ("momentum", reference.momentum_error, momentum, reference.growth[1]),
    ):
        largest = array(f"{name}_error_max")
        noise = np.maximum(bar, np.finfo(np.float64).eps * np.sqrt(list(counts.values())) * size * growth)
        orders = measured_orders(largest, steps, CLEAR * noise)
        variables |= {f"{name}_error": (_RUNS, array(f"{name}_error")), f"{name}_error_max": (_RUNS, largest)}
        variables |= {f"{name}_order": (_RUNS, orders), f"{name}_below_bar": (_RUNS, largest <= bar)}
        variables[f"{name}_reference_error"] = ((), bar)
    variables["drift"] = (("invariant", *_RUNS), np.array([array(name) for name in invariants]))
    if run.system.axis is not None:
        variables["twist_defect"] = (_RUNS, array("twist_defect"))
    variables["run_time"] = (_RUNS, array("run_time"))
    variables["status"] = (_RUNS, np.array([[outcomes[i, h].status for h in counts] for i in schemes]))
    variables["message"] = (_RUNS, np.array([[outcomes[i, h].message for h in counts] for i in schemes]))
    described = {}
    for name, (dims, values) in variables.items():
        units, long_name, symbol = VARIABLES[name]
        described[name] = (dims, values, {"units": units, "long_name": long_name, "symbol": symbol})
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
