"""Derivatives of the terms of a load by their parameters, at the nodes of some steps.

A parameter of a term is a number of a field, or its factor. Of what depends on time alone, of dead forces and of
damping the derivatives are those of its own text, by duals; of values of tables they are the weights with which a
table takes them. Times at which a term jumps are no parameters: a run is not smooth in them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import warn
from ..geometry.arrays import Array
from ..kernels.dual import Dual, tangent
from .calls import name_of, plainly
from .forces import ForceTable
from .potentials import Potential, PotentialFunction
from .terms import Damping, Rotor, Table, Term, within

STEP = 1e-6  # of the time, for functions that take no duals


class Slopes(NamedTuple):
    """Derivatives of numbers: at a row of what is asked for, of a component, by a parameter."""

    row: NDArray[np.int64]
    component: NDArray[np.int64]
    parameter: NDArray[np.int64]
    value: Array

    @classmethod
    def of(cls, dense: Array) -> Slopes:
        """Return those of an array (rows, components, parameters)."""
        row, component, parameter = np.nonzero(dense)
        return cls(row, component, parameter, dense[row, component, parameter])


def with_parameter(term: Term, name: str, value: Array) -> Term:
    """Return a term with another value of one of its parameters, in the shape of its record."""
    name = "forces_of" if isinstance(term, ForceTable) and name == "values" else name
    plain: Any = {name: value if value.ndim else float(value)}
    return replace(term, **plain)


def moment_slopes(term: Term, name: str, times: Array) -> Slopes:
    """Return the derivatives of a moment of the time at (n,) times by a parameter; three components each."""
    if isinstance(term, Table):
        return table_slopes(term, name, times)
    return Slopes.of(term.samples(times)[..., None] if name == "scale" else term.scale * _slopes(term, times, name))


def moment_rates(term: Term, times: Array) -> Array:
    """Return the derivatives of a moment of the time by it, (n, 3), with the factor."""
    return term.scale * _slopes(term, times)[..., 0]


def forces_rates(term: ForceTable, times: Array) -> Array:
    """Return the derivatives of forces by the time, (n, 18), without the factor."""
    found, first = np.zeros((len(times), 18)), 9 * (term.frame == "body")
    found[:, first : first + 9] = _tangents(term.columns(Dual(times, [1.0])), 1, len(times))[..., 0]
    return found


def _slopes(term: Term, times: Array, name: str = "") -> Array:
    """Return the derivatives of a moment by the numbers of a field, or by the time, (n, 3, count)."""
    seeded = term.seeded(name) if name else term
    count = np.size(getattr(term, name)) if name else 1
    if term.is_text:
        return _tangents(seeded.columns(times if name else Dual(times, [1.0])), count, len(times))
    try:
        rows = [plainly(seeded.called, (t if name else Dual(t, [1.0]),), (3,)) for t in times.tolist()]
        return np.concatenate([_tangents(row, count, 1) for row in rows])
    except Exception:  # of any kind, where a function of a user takes no duals
        warn(differenced([differences_of(term)]))
    if not name:
        e = STEP * max(1.0, float(abs(times).max()))
        return ((term.samples(times + e) - term.samples(times - e)) / (2 * e))[..., None]
    value, found = np.asarray(getattr(term, name)), np.empty((len(times), 3, count))
    for k, unit in enumerate(np.eye(count).reshape(count, *value.shape)):
        e = STEP * max(1.0, float(abs(value).max()))
        ahead, behind = (with_parameter(term, name, value + x * unit).samples(times) for x in (e, -e))
        found[..., k] = (ahead - behind) / (2 * e)
    return found


def differences_of(term: Term) -> str:
    """Return the name of the function of a term that differences are taken of."""
    return name_of(term.gradient if isinstance(term, PotentialFunction) else term.called).removeprefix("__main__.")


def differenced(names: Iterable[str]) -> str:
    """Return what a warning says of functions that differences are taken of."""
    return (
        f"derivatives of {' and '.join(names)} are central differences, accurate to about ten digits, as numbers with "
        "derivatives are not taken; functions of NumPy take them, those of math and float() do not, and a moment "
        "accepts exact derivatives: moment(function, derivative=...)"
    )


def _tangents(columns: Any, count: int, rows: int) -> Array:
    """Return the derivatives of columns, numbers along times, (rows, columns, count)."""
    found = [[np.broadcast_to(tangent(y, j), rows) for j in range(count)] for y in columns]
    return np.moveaxis(np.array(found, dtype=np.float64), -1, 0)


def table_slopes(term: Table | ForceTable, name: str, times: Array) -> Slopes:
    """Return the derivatives of what is linear between times by its values, or by its factor.

    Forces are the 18 numbers of `loads.base.forces_sampled`.
    """
    values = term.values.reshape(len(term.times), -1)
    first, n = 9 * (isinstance(term, ForceTable) and term.frame == "body"), values.shape[1]
    if name == "scale":
        found = Slopes.of(np.stack(within(term.times, values, times), axis=1)[..., None])
    else:
        inside = np.flatnonzero((times >= term.times[0]) & (times < term.times[-1]))
        row, entry, weight = _weights(term.times, times[inside])
        found = _each_axis(inside[row], entry, term.scale * weight, n)
    return found._replace(component=found.component + first)


def rotor_slopes(term: Rotor, name: str, times: Array) -> Slopes:
    """Return the derivatives of the momentum of a rotor at (n,) times by a parameter; three components each."""
    if name == "scale":
        return Slopes.of(term.momentum(times)[..., None])
    if name == "rotor":
        across, h = np.eye(3) - np.outer(term.rotor, term.rotor), np.interp(times, term.times, term.values)
        return Slopes.of(term.scale * h[:, None, None] * across)
    row, entry, weight = _weights(term.times, times)
    component = np.tile(np.arange(3), len(row))
    value = np.repeat(term.scale * weight, 3) * term.rotor[component]
    return Slopes(np.repeat(row, 3), component, np.repeat(entry, 3), value)


def fixed_slopes(term: Term, name: str) -> Slopes:
    """Return the derivatives of a damping matrix, or of the dead force of a linear potential."""
    own = term if name == "scale" else term.seeded(name)
    assert isinstance(own, Damping | Potential)
    fixed: Any = own.damping if isinstance(own, Damping) else own.dead_force
    if name == "scale":
        return Slopes.of(fixed.reshape(1, 9, 1))
    return Slopes.of(term.scale * _tangents(fixed.ravel().tolist(), np.size(getattr(term, name)), 1))


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
