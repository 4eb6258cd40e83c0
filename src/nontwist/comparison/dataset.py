"""A comparison as a dataset: what was measured on (integrator, step), measured orders, names, units, record."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..analysis.invariants import Invariant
from ..geometry.arrays import Array
from ..integrators import Integrator, Status
from .reference import Reference
from .running import REFUSED, Outcome
from .settings import label

if TYPE_CHECKING:
    import xarray

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
    "twist_defect": ("rad s-1", "largest twist rate about the constrained axis", "max |w·Λn|"),
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
    scales: Mapping[str, float],
) -> xarray.Dataset:
    """Return the dataset that `nontwist.compare` describes; `outcomes` by label and step."""
    import xarray

    def array(name: str) -> Array:
        return np.array([[outcomes[i, h].numbers.get(name, np.nan) for h in counts] for i in schemes])

    steps, run = np.array(list(counts)), reference.run
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
