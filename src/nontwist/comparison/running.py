"""The runs of a comparison: each is compared with the reference once, and then timed."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ..analysis.invariants import Invariant, drift, quantities
from ..analysis.trajectory import Trajectory
from ..analysis.variables import observables_of_one
from ..driver.coarseness import COARSE_STEP
from ..driver.runs import integrate
from ..integrators import Integrator, SimulationError
from ..integrators.time_grid import Stretches
from ..models.system import DirectorSystem
from .reference import Reference, attitude_distance, momentum_distance, run_on
from .settings import stored_intervals

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
    x = quantities(run)
    found |= {name: drift(one, x, case.scales[one.units]) for name, one in case.invariants.items()}
    if case.system.axis is not None:
        spin = case.system.spin
        rate = observables_of_one(("twist_rate",), run.system, run.states)["twist_rate"]
        found["twist_defect"] = abs(rate - (0.0 if spin is None else spin.at(run.time))).max()
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
