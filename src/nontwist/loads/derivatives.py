"""Derivatives of the terms of a load by their parameters, at the nodes of some steps.

A parameter of a term is a number of its record: the factor, the peak of a pulse or a sine, frequency and phase, the
values of a table, the entries of a damping matrix, the momenta of a rotor and its axis, the coefficients of a
potential, the stiffness of a spring, the mean motion of an orbit. Times at which a term jumps are none: a run is not
smooth in them.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from .forces import ForceTable
from .potentials import GravityGradient, Potential, Quadratic, Spring
from .terms import PULSES, Damping, Pulse, Rotor, Sine, Table, Term, within

STEP = 1e-6  # of the time, for functions


class Slopes(NamedTuple):
    """Derivatives of numbers: at a row of what is asked for, of a component, by a parameter."""

    row: NDArray[np.int64]
    component: NDArray[np.int64]
    parameter: NDArray[np.int64]
    value: Array


def parameters_of(term: Term) -> dict[str, tuple[list[str], str]]:
    """Return the parameters of a term: a label for each number, and their unit."""
    xyz = ["1", "2", "3"] if term.kind == "body" else ["x", "y", "z"]
    found: dict[str, tuple[list[str], str]] = {"scale": ([""], "1")}
    if isinstance(term, Pulse):
        found["pulse"] = xyz, "N m"
    if isinstance(term, Sine):
        found |= {"sine": (xyz, "N m"), "frequency": ([""], "Hz"), "phase": ([""], "rad")}
    if isinstance(term, Table):
        found["values"] = [f"{k},{c}" for k in range(len(term.times)) for c in xyz], "N m"
    if isinstance(term, ForceTable):
        pairs = product(range(1, 4), xyz if term.frame == "space" else "123")
        places = [f"{i}{x}" for i, x in pairs]
        found["values"] = [f"{k},{place}" for k in range(len(term.times)) for place in places], "N m"
    if isinstance(term, Quadratic):
        found["linear"] = ["1", "2", "3"], "1"
        if term.dead_force is None:
            found["quadratic"] = ["11", "22", "33", "23", "13", "12"], "1"
    if isinstance(term, Spring):
        found["stiffness"] = [""], "N m-1"
        if term.dead_force is None:
            found["rest_length"] = [""], "m"
    if isinstance(term, GravityGradient):
        found["mean_motion"] = [""], "rad s-1"
    if isinstance(term, Damping):
        found["damping"] = [f"{i}{j}" for i, j in product("123", repeat=2)], "N m s"
    if isinstance(term, Rotor):
        found |= {"values": ([str(k) for k in range(len(term.times))], "kg m2 s-1"), "rotor": (["1", "2", "3"], "1")}
    return found


def with_parameter(term: Term, name: str, value: Array) -> Term:
    """Return a term with another value of one of its parameters, in the shape of its record."""
    if name == "rotor":
        if not value.any():
            raise ValueError("axis of the rotor is zero: it must be a direction in the body")
        value = value / abs(value).max()  # whose square may underflow
        value = value / np.linalg.norm(value)
    plain: Any = {name: value if value.ndim else float(value)}
    if isinstance(term, Sine) and name == "frequency":
        if value <= 0:
            raise ValueError(f"frequency must be positive, got {value:g} Hz")
        plain["resolution"] = 1 / (20 * plain[name])
    if isinstance(term, GravityGradient) and name == "mean_motion":
        plain["resolution"] = term.resolution * term.mean_motion / plain[name]
    if isinstance(term, Table) and name == "values":
        plain["end_value"] = float(np.linalg.norm(value[-1]))
    return replace(term, **plain)


def moment_slopes(term: Term, name: str, times: Array) -> Slopes:
    """Return the derivatives of a moment of the time at (n,) times by a parameter; three components each."""
    if name == "scale":
        return _outer(term.samples(times))
    if isinstance(term, Pulse):
        s = (times - term.start) / (term.end - term.start)
        return _diagonal(term.scale * np.where((s >= 0) & (s < 1), PULSES[term.shape][0](s), 0.0))
    if isinstance(term, Sine):
        angle = 2 * np.pi * term.frequency * times + term.phase
        if name == "sine":
            return _diagonal(term.scale * np.sin(angle))
        by = 2 * np.pi * times if name == "frequency" else 1.0
        return _outer(term.scale * (by * np.cos(angle))[:, None] * term.sine)
    assert isinstance(term, Table)
    return table_slopes(term, name, times)


def table_slopes(term: Table | ForceTable, name: str, times: Array) -> Slopes:
    """Return the derivatives of what is linear between times by its values, or by its factor.

    Forces are the 18 numbers of `loads.base.forces_sampled`.
    """
    values = term.values if isinstance(term, Table) else term.forces_of.reshape(-1, 9)
    first, n = 9 * (isinstance(term, ForceTable) and term.frame == "body"), values.shape[1]
    if name == "scale":
        found = _outer(within(term.times, values, times))
    else:
        inside = np.flatnonzero((times >= term.times[0]) & (times < term.times[-1]))
        row, entry, weight = _weights(term.times, times[inside])
        found = _each_axis(inside[row], entry, term.scale * weight, n)
    return found._replace(component=found.component + first)


def moment_rates(term: Term, times: Array) -> Array:
    """Return the derivatives of a moment of the time by it, (n, 3), with the factor; of functions by differences."""
    if isinstance(term, Sine):
        angle = 2 * np.pi * term.frequency * times + term.phase
        found: Array = term.scale * (2 * np.pi * term.frequency * np.cos(angle))[:, None] * term.sine
    elif isinstance(term, Table):
        found = term.scale * np.stack([chord(term.times, column, times) for column in term.values.T], axis=1)
    elif isinstance(term, Pulse):
        length = term.end - term.start
        s = (times - term.start) / length
        slopes = {"triangle": np.sign(0.5 - s) * 2.0, "rectangle": 0.0 * s, "half-sine": np.pi * np.cos(np.pi * s)}
        rate = np.where((s >= 0) & (s < 1), slopes[term.shape], 0.0) / length
        found = term.scale * rate[:, None] * term.pulse
    else:
        e = STEP * max(1.0, float(abs(times).max()))
        found = term.scale * (term.samples(times + e) - term.samples(times - e)) / (2 * e)
    return found


def forces_rates(term: ForceTable, times: Array) -> Array:
    """Return the derivatives of forces by the time, (n, 18), without the factor."""
    found, first = np.zeros((len(times), 18)), 9 * (term.frame == "body")
    for k, f in enumerate(term.forces_of.reshape(-1, 9).T):
        found[:, first + k] = chord(term.times, f, times)
    return found


def chord(known: Array, values: Array, times: Array) -> Array:
    """Return the slope of a table at times: 0 outside."""
    if len(known) == 1:
        return np.zeros(len(times))
    k = np.clip(np.searchsorted(known, times, side="right") - 1, 0, len(known) - 2)
    inside = (times >= known[0]) & (times < known[-1])
    found: Array = np.where(inside, np.diff(values)[k] / np.diff(known)[k], 0.0)
    return found


def rotor_slopes(term: Rotor, name: str, times: Array) -> Slopes:
    """Return the derivatives of the momentum of a rotor at (n,) times by a parameter; three components each."""
    if name == "scale":
        return _outer(term.momentum(times))
    if name == "rotor":
        across = np.eye(3) - np.outer(term.rotor, term.rotor)
        h = term.scale * np.interp(times, term.times, term.values)
        n = len(times)
        row, component, parameter = np.indices((n, 3, 3)).reshape(3, -1)
        return Slopes(row, component, parameter, (h[:, None, None] * across).ravel())
    row, entry, weight = _weights(term.times, times)
    n = len(row)
    component = np.tile(np.arange(3), n)
    value = np.repeat(term.scale * weight, 3) * term.rotor[component]
    return Slopes(np.repeat(row, 3), component, np.repeat(entry, 3), value)


def fixed_slopes(term: Term, name: str) -> Slopes | None:
    """Return the derivatives of a damping matrix, or of the dead force of a linear potential; else None."""
    force = term.dead_force if isinstance(term, Potential) else None
    if force is not None:
        if isinstance(term, Quadratic) and name == "linear":
            k = np.arange(9)
            return Slopes(0 * k, k, k // 3, -term.scale * term.vector[k % 3])
        return _flat(term.scale / term.stiffness * force if isinstance(term, Spring) and name == "stiffness" else force)
    if not isinstance(term, Damping):
        return None
    if name == "scale":
        return _flat(term.damping)
    k = np.arange(9)
    return Slopes(0 * k, k, k, np.full(9, term.scale))


def _flat(matrix: Array) -> Slopes:
    k = np.arange(9)
    return Slopes(0 * k, k, 0 * k, np.array(matrix, dtype=np.float64).ravel())


def _outer(rows: Array) -> Slopes:
    """Return the derivatives by one parameter, of which these rows are all components."""
    row, component = np.indices(rows.shape).reshape(2, -1)
    return Slopes(row, component, np.zeros_like(row), rows.ravel())


def _diagonal(factor: Array) -> Slopes:
    """Return the derivatives by three parameters, each of which is times this factor a component."""
    row, component = np.indices((len(factor), 3)).reshape(2, -1)
    return Slopes(row, component, component, np.repeat(factor, 3))


def _each_axis(row: NDArray[np.int64], entry: NDArray[np.int64], weight: Array, n: int = 3) -> Slopes:
    component = np.tile(np.arange(n), len(row))
    return Slopes(np.repeat(row, n), component, n * np.repeat(entry, n) + component, np.repeat(weight, n))


def _weights(known: Array, times: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return which values a linear interpolation takes: rows of `times`, entries of `known`, weights."""
    if len(known) == 1:
        n = len(times)
        return np.arange(n), np.zeros(n, dtype=np.int64), np.ones(n)
    k = np.clip(np.searchsorted(known, times, side="right") - 1, 0, len(known) - 2)
    x = np.clip((times - known[k]) / (known[k + 1] - known[k]), 0.0, 1.0)
    rows = np.arange(len(times))
    return np.concatenate([rows, rows]), np.concatenate([k, k + 1]), np.concatenate([1 - x, x])
