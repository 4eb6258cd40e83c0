"""What a run file will be like, in the words of its keys."""

from __future__ import annotations

from ..driver.forecast import Forecast
from ..driver.forecast import forecast as forecast_of
from ..integrators import DEFAULT
from .document import RunFile
from .problems import Problem, shown
from .tables import Time

CAPABLE = f"an integrator that can: {DEFAULT} takes every body and load"


def forecast(run_file: RunFile) -> Forecast:
    """Return what a run will be like; nothing is run."""
    coming = forecast_of(run_file.prepared, None if run_file.sweep is None else run_file.sweep.members)
    keys = {
        "integrator": ("integrator.name", run_file.integrator.name, CAPABLE),
        "store": ("time.store", run_file.time.store, Time.model_fields["store"].description or ""),
    }
    problems = []
    for name, reason in coming.problems:
        key, value, accepted = keys[name]
        problems.append(Problem(key, f"{shown(value)} ({reason})", accepted))
    loads = tuple(one.in_words(run_file._folder) for one in run_file.load)
    return coming._replace(loads=loads, problems=tuple(problems))
