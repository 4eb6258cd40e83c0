"""Ensembles as datasets: variables with a member axis in front, status and statistics by member; measured orders.

Statistics of motions over time, drift of the invariants, extrema, means and total twist, are taken over the ends of all
steps, whatever is stored; those of the reaction moment over its means on the steps. Extrema are those between the ends
as well, where states have power series there (`completion.with_extrema`). Integrals over time have the order of the
integrator: they are integrated with the steps. The invariants are K + V less the work of the load and the momentum of
`invariants.conserved_momentum`.

Measured orders from three runs with steps h, h/2, h/4 (eq:second_quotient).

With an expansion ``ξ(t, h) = ξ(t) + h^n ψ_n(t) + …`` the second quotient of precision

    Q_II(t) = |ξ(t, h) - ξ(t, h/2)| / |ξ(t, h/2) - ξ(t, h/4)|

tends to 2^n. For a symmetric scheme the expansion has even powers only, hence Q_II = 2^n + O(h²).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import asdict
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebval, chebvander

from ..geometry.arrays import Array, DataArray, Dataset, as_number
from ..geometry.values import among, as_list, nearest, short_repr
from ..integrators.integrator import IVP, Integrator, Outcome, Status
from ..integrators.ivp import FIRST, INTEGRAL, LEAST, MOST, OBSERVED
from ..loads.load import with_torques
from ..loads.potentials import Potential
from ..models.stack import SystemStack
from .datasets import RUN, as_dataset
from .invariants import conserved_momentum
from .trajectory import FORMAT_VERSION, grid_record, nodes_of, versions
from .variables import (
    MEMBERS,
    SIZES,
    STATE,
    VARIABLES,
    Acting,
    about,
    assembled,
    described,
    labelled,
    names_of,
    nodal,
    observables,
)


def checked_variables(variables: str | Iterable[str]) -> tuple[str, ...]:
    """Return the names of variables in the order of a run; ValueError where one is unknown."""
    return names_of(variables, "an ensemble", "; those of intervals come as statistics, with reduce=")


def bytes_of(variables: Iterable[str], members: int, times: int) -> float:
    """Return the bytes that the states of an ensemble take while they are computed."""
    numbers = [math.prod(SIZES.get(dim, 4) for dim in about(name)[0][1:]) for name in variables if name not in STATE]
    return 8.0 * members * (times * (7 + sum(numbers) + 36 * bool(numbers)) + 25)


def dataset(
    scheme: Integrator, ensemble: IVP, outcome: Outcome, variables: tuple[str, ...], reduce: tuple[str, ...]
) -> Dataset:
    """Return the outcome of an ensemble as a dataset; the caller adds the messages of failures."""
    systems = ensemble.systems
    if variables == nodal():
        variables = nodes_of(ensemble.load.description)
    acting = Acting.of(ensemble.load, ensemble.stored_times, ensemble.load_scale)
    found = described(observables(variables, systems, outcome.states, acting), ("member",))
    if outcome.states.internal is not None:
        found |= described({"internal_state": outcome.states.internal}, ("member",))
    if outcome.observed is not None:
        span = ensemble.t_end - ensemble.t_start
        loaded = bool(ensemble.load.without_potentials.terms)
        found |= named(outcome.observed, reduce, systems, loaded, span, ensemble.load.potentials)
    statuses = {int(status): status.name.lower() for status in Status}
    found["status"] = (("member",), outcome.failures[:, 0].astype(np.int64), status_attributes(statuses))
    found |= _of_members(ensemble)
    wheels = np.arange(1, 1 + len(ensemble.load.wheels))
    labels = {"member": np.arange(len(ensemble)), "time": ensemble.stored_times, "wheel": wheels}
    return assembled(labelled(found, **labels), _record(scheme, ensemble))


def status_attributes(meanings: dict[int, str]) -> dict[str, Any]:
    """Return the attributes of a status by member, from the meaning of each value."""
    flags = {"flag_values": list(meanings), "flag_meanings": " ".join(meanings.values())}
    return {"long_name": "how the run of the member ended", **flags}


def _of_members(ensemble: IVP) -> dict[str, Any]:
    """Return the variables that differ between members, without the starts: bodies and scales of the load."""
    systems, found = ensemble.systems, dict[str, Any]()
    if len(systems) > 1:
        dead = systems.dead_force if systems.has_dead_force else None
        bodies = zip(MEMBERS, (systems.euler_inertia, systems.axis, dead, systems.spin_factor), strict=False)
        found = {name: array for name, array in bodies if array is not None}
    each = {name: getattr(ensemble, name) for name in ("load_scale", "wheel_torque")}
    found |= {name: array for name, array in each.items() if array is not None and len(array) > 1}
    return described(found, ("member",))


def _record(scheme: Integrator, ensemble: IVP) -> dict[str, Any]:
    """Return the settings of the runs as plain attributes."""
    systems, load, scale, torques = ensemble.systems, ensemble.load, ensemble.load_scale, ensemble.wheel_torque
    load = float(scale[0]) * load if len(scale) == 1 and load.terms else load
    load = with_torques(load, torques[0]) if torques is not None and len(torques) == 1 else load
    body = {"system": systems[0].to_json()} if len(systems) == 1 else {}
    return {
        "format_version": FORMAT_VERSION,
        "title": f"{len(ensemble)} {systems.name} rigid bodies, {scheme.name}",
        "conventions": "Λ maps body to space; directors are the rows of the (3, 3) arrays, d_i = Λ E_i; quaternions "
        "have the scalar last; what failed members have not reached is NaN",
        **body,
        "load": json.dumps(load.description),
        "integrator": json.dumps({"name": scheme.name, **asdict(scheme)}),
        **grid_record(None if ensemble.off_grid else ensemble.grid, float(ensemble.stored_times[0])),
        "versions": json.dumps(versions()),
    }


STATISTICS = ("drift", "extrema", "averages", "total_twist")
_ENDS = list(accumulate(OBSERVED.values()))
PLACES = {name: slice(end - OBSERVED[name], end) for name, end in zip(OBSERVED, _ENDS, strict=True)}
_NO_VARIABLES = ("energy", "vertical_momentum")
KNOTS = -np.cos(np.pi * np.arange(21) / 20)  # of a step: polynomials follow a quantity that turns by 6 rad in it
NEAR, NEWTON = 0.05, 5  # of its span: how far values at knots are below its extrema, at most; iterations
Described = dict[str, tuple[tuple[str, ...], Array, dict[str, str]]]


def checked_statistics(reduce: str | Iterable[str]) -> tuple[str, ...]:
    """Return the names of statistics; ValueError where one is unknown."""
    names = (reduce,) if isinstance(reduce, str) else tuple(as_list(reduce, "reduce"))
    for name in names:
        if not among(name, STATISTICS):
            raise ValueError(f"unknown statistic {short_repr(name)}; {nearest(name, STATISTICS)}")
    return names


def named(
    observed: Array,
    names: Iterable[str],
    systems: SystemStack,
    loaded: bool,
    span: float,
    potentials: tuple[Potential, ...] = (),
) -> Described:
    """Return the variables of the requested statistics, from what was observed of each member, (m, 4, COLUMNS)."""
    found: Described = {}
    shown = [name for name in OBSERVED if name not in _NO_VARIABLES]
    if systems.axis is None:
        shown.remove("reaction_moment")
    if not (potentials or systems.has_dead_force):
        shown.remove("potential_energy")

    def add(name: str, base: str, words: str, symbol: str, values: Array) -> None:
        dims, units, long_name, letter = VARIABLES[base]
        values = values if dims[1:] else values[:, 0]
        found[name] = (
            ("member", *dims[1:]),
            values,
            {"units": units, "long_name": words.format(long_name), "symbol": symbol.format(letter)},
        )

    if "drift" in names:
        changes = np.maximum(observed[:, MOST] - observed[:, FIRST], observed[:, FIRST] - observed[:, LEAST])
        energy = "largest change of the energy less the work of the load"
        add("energy_drift", "kinetic_energy", energy, "max |ΔH|", changes[:, PLACES["energy"]])
        records = [term.description for term in potentials]
        if (base := conserved_momentum(systems, loaded, records)) is not None:
            drift = changes[:, PLACES[base]].max(axis=1, keepdims=True)
            of = "spatial angular momentum along gravity" if base == "vertical_momentum" else VARIABLES[base][2]
            attributes = {"units": "kg m2 s-1", "long_name": f"largest change of a component of the {of}"}
            found["momentum_drift"] = (("member",), drift[:, 0], {**attributes, "symbol": "max |Δπ|"})
    for name in shown if "extrema" in names else ():
        add(f"{name}_min", name, "least {}", "min {}", observed[:, LEAST, PLACES[name]])
        add(f"{name}_max", name, "greatest {}", "max {}", observed[:, MOST, PLACES[name]])
    for name in shown if "averages" in names else ():
        add(f"{name}_mean", name, "{}, mean over time", "mean {}", observed[:, INTEGRAL, PLACES[name]] / span)
    if "total_twist" in names:
        attributes = {"units": "rad", "long_name": "twist about the body axis, all turns", "symbol": "ψ"}
        found["total_twist"] = (("member",), observed[:, INTEGRAL, PLACES["twist_rate"]][:, 0], attributes)
    return found


def highest(values: Array) -> Array:
    """Return the greatest values, (m,), of functions with these at the knots of all steps, (m, n).

    In each step a function is the polynomial through its values at the knots.
    """
    count = len(KNOTS) - 1
    own = values[:, np.arange(0, values.shape[1] - 1, count)[:, None] + np.arange(count + 1)]
    found = values.max(axis=1)
    near = found - NEAR * (found - values.min(axis=1))
    member, step = np.nonzero(own.max(axis=2) >= near[:, None])
    series = np.linalg.solve(chebvander(KNOTS, count), own[member, step].T)
    slope, x = chebder(series), KNOTS[own[member, step].argmax(axis=1)]
    bend = chebder(slope)
    for _ in range(NEWTON):
        b = chebval(x, bend, tensor=False)
        x = np.clip(x - np.divide(chebval(x, slope, tensor=False), b, out=np.zeros_like(b), where=b < 0), -1, 1)
    np.maximum.at(found, member, chebval(x, series, tensor=False))
    return found


def second_quotient(run_h: Dataset, run_h2: Dataset, run_h4: Dataset, *, variable: str = "directors") -> DataArray:
    """Return the second quotient of precision Q_II (eq:second_quotient).

    Parameters
    ----------
    run_h, run_h2, run_h4 : Dataset
        Runs of one problem with steps h, h/2 and h/4; the others must contain every time of the first.
    variable : str
        The variable ξ; the paper uses the nine director components, with the Euclidean norm.

    Returns
    -------
    DataArray
        Over time, from the second stored time of `run_h`. NaN where the finer two runs agree to the last bit.

    Raises
    ------
    ValueError
        An argument is not a run, bodies, loads or integrators differ, the steps are not in the ratio 4 : 2 : 1, a finer
        run lacks a time of the first, or a variable is missing.

    Examples
    --------
    >>> from nontwist import nontwisting, simulate
    >>> from nontwist.comparison import second_quotient
    >>> start = {"material_angular_velocity": (1, -2, 0), "integrator": "energy-momentum"}
    >>> runs = [simulate(nontwisting([3, 4, 5]), t_end=1, step=h, **start) for h in (0.02, 0.01, 0.005)]
    >>> round(second_quotient(*runs)[-1].item(), 2)  # 2² of a scheme of order 2
    4.0
    """
    import xarray

    runs = [as_dataset(run, RUN, ("time",), ("step",)) for run in (run_h, run_h2, run_h4)]
    if any(run.sizes["time"] < 2 for run in runs):
        raise ValueError("a run has fewer than two states: orders are measured at the times after its start")
    for name in ("system", "load", "integrator"):
        if len({str(run.attrs.get(name)) for run in runs}) > 1:
            raise ValueError(f"the runs must be of one problem and differ in their steps alone; their {name} differs")
    steps = [as_number(run.attrs["step"], "the step of a run") for run in runs]
    if not np.allclose([steps[0] / 2, steps[0] / 4], steps[1:], rtol=1e-9):
        raise ValueError(f"the steps must be h, h/2, h/4; got {', '.join(f'{h:.12g}' for h in steps)} s")
    time = runs[0]["time"][1:]
    x, x2, x4 = (_at(run, variable, time.values) for run in runs)
    numerator, denominator = (np.linalg.norm(d.reshape(len(d), -1), axis=1) for d in (x - x2, x2 - x4))
    with np.errstate(divide="ignore", invalid="ignore"):
        quotient = np.where(denominator > 0, numerator / denominator, np.nan)
    attrs = {"units": "1", "long_name": "second quotient of precision", "symbol": "Q_II", "variable": variable}
    return xarray.DataArray(quotient, {"time": time}, ("time",), "second_quotient", attrs)


def observed_order(run_h: Dataset, run_h2: Dataset, run_h4: Dataset, *, variable: str = "directors") -> DataArray:
    """Return the observed order ``log2 Q_II`` over time.

    Parameters
    ----------
    run_h, run_h2, run_h4, variable
        As in `second_quotient`.

    Returns
    -------
    DataArray
        Over time, at the times of `second_quotient`; NaN where the quotient is NaN or 0.

    Raises
    ------
    ValueError
        As `second_quotient`.

    Examples
    --------
    >>> from nontwist import simulate, standard
    >>> from nontwist.comparison import observed_order
    >>> start = {"material_angular_velocity": (1, 2, 0.1), "integrator": "gauss", "order": 4}
    >>> runs = [simulate(standard([3, 4, 5]), t_end=2, step=h, **start) for h in (0.1, 0.05, 0.025)]
    >>> round(observed_order(*runs)[-1].item(), 1)
    4.0
    """
    quotient = second_quotient(run_h, run_h2, run_h4, variable=variable)
    attrs = quotient.attrs | {"long_name": "observed order", "symbol": "n"}
    order: Any = np.log2(quotient.where(quotient > 0))
    return order.rename("observed_order").assign_attrs(attrs)


def _at(run: Dataset, variable: str, time: Array) -> Array:
    if not among(variable, run.data_vars):
        raise ValueError(f"the run has no variable {short_repr(variable)}; it has {', '.join(map(str, run.data_vars))}")
    run = as_dataset(run, RUN, (variable,))
    if "time" not in run[variable].dims:
        raise ValueError(f"{variable} has no dim time: choose a variable of the states")
    own = run["time"].values
    index = np.clip(np.searchsorted(own, time), 1, len(own) - 1)
    index -= (time - own[index - 1]) < (own[index] - time)
    gap = abs(own[index] - time)
    if gap.max() > 1e-9 * (own[-1] - own[0]):
        raise ValueError(
            f"the run with step {run.attrs['step']:.12g} s does not contain the time {time[np.argmax(gap)]:.12g} s"
        )
    return run[variable].values[index]
