"""The runs of a comparison: each is held to the truth once, and then timed."""

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
from ..driver.runs import integrate
from ..integrators import Integrator, SimulationError
from ..models.system import DirectorSystem
from .reference import Reference, attitude_distance, momentum_distance
from .settings import stored_intervals

REFUSED, LONG = -1, 0.3


class Case(NamedTuple):
    """The problem, its truth and what it keeps."""

    system: DirectorSystem
    how: dict[str, Any]  # what `integrate` takes, but for integrator and times
    t_end: float
    truth: Reference
    shared: int  # intervals
    kept: dict[str, Invariant]
    sizes: dict[str, float]  # by unit
    known: set[str]  # warnings that have been given


class Outcome(NamedTuple):
    """What became of one run: its numbers by name, how it ended, and the call that is timed."""

    numbers: dict[str, float]
    status: int
    message: str
    call: Callable[[], Trajectory]


def measured(case: Case, scheme: Integrator, N: int) -> Outcome:
    """Run once, hold the run to the truth, and say what happened; this also warms the run up."""
    call, truth = partial(_run, case, scheme, N, False), case.truth.run
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            run = _run(case, scheme, N, True)
        except ValueError as error:
            return Outcome({}, REFUSED, str(error), call)
        except SimulationError as error:
            return Outcome({}, int(error.status), str(error), call)
    stride = (len(run.time) - 1) // case.shared
    attitude, momentum = attitude_distance(run, truth, stride), momentum_distance(run, truth, stride)
    found = {"attitude_error": attitude[-1], "momentum_error": momentum[-1]}
    found |= {"attitude_error_max": attitude.max(), "momentum_error_max": momentum.max()}
    x = quantities(run)
    found |= {name: drift(kept, x, case.sizes[kept.units]) for name, kept in case.kept.items()}
    if case.system.axis is not None:
        found["twist_defect"] = abs(observables_of_one(("twist_rate",), run.system, run.states)["twist_rate"]).max()
    told = sorted({str(warning.message) for warning in caught} - case.known)
    return Outcome({name: float(x) for name, x in found.items()}, 0, "; ".join(["done", *told]), call)


def _run(case: Case, scheme: Integrator, N: int, whole: bool) -> Trajectory:
    """Run to the end; keep the states at the shared times and between them, or the last one only."""
    times = case.truth.run.time
    if scheme.any_times:
        return integrate(case.system, times=times if whole else times[-1:], integrator=scheme, **case.how)
    store: Any = N // stored_intervals(N, case.shared) if whole else "end"
    step = (times[-1] - times[0]) / N
    return integrate(case.system, t_end=case.t_end, step=step, store=store, integrator=scheme, **case.how)


def timed(calls: dict[Any, Callable[[], Trajectory]], repeats: int) -> dict[Any, float]:
    """Return the shortest time of each call, s; they take turns, as a slow moment hits all alike then.

    A call that took longer than `LONG` is not repeated.
    """
    best = dict.fromkeys(calls, np.inf)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(repeats):
            for key, call in calls.items():
                if not LONG < best[key] < np.inf:
                    start = perf_counter()
                    call()
                    best[key] = min(best[key], perf_counter() - start)
    return best
