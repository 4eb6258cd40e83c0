"""Derivatives of the terms of a load: by their parameters, at the nodes of some steps, and by the state.

A parameter of a term is a number of a field, or its factor. Of what depends on time alone, of dead forces and of
damping the derivatives are those of its own text, by duals; of values of tables they are the weights with which a
table takes them. Times at which a term jumps are no parameters: a run is not smooth in them.

By the state all is differentiated by dual numbers in kernels (`engine.generalised`, `functions`), but functions that
run in Python (`slopes_of`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import warn
from ..geometry.arrays import Array, as_floats
from ..geometry.attitudes import BASIS
from ..kernels.dual import Dual, plain, tangent
from ..spec import specs
from .functions import CFunction, checked, name_of, plainly
from .memory_terms import Wheel
from .potentials import ForceTable, Potential, PotentialFunction
from .terms import Damping, Rotor, Tabulated, Term

DIFFERENCE = float(2.0 ** np.round(np.log2(np.finfo(np.float64).eps) / 3))  # of a central difference, of the scale
SLACK = 1e-9  # of a value by duals
LATER = "later"  # what a parameter is called that moves times


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


def changes_of_field(term: Term, name: str) -> Array:
    """Return what a field changes by along each of its numbers as a parameter, (count, numbers)."""
    value, rule = np.asarray(getattr(term, name)), specs(type(term))[name][2].rule
    if rule == "symmetric":
        return BASIS.reshape(-1, value.size)
    along = np.eye(value.size)
    return along - np.outer(value, value) if rule.startswith("direction") else along


def slopes_of_time(term: Term, name: str, times: Array, later: Array | None = None) -> Slopes:
    """Return the derivatives of a moment of the time, or of a table of forces, at (n,) times by a parameter.

    With the name `LATER` it is what makes the times `later`. Forces are the 18 numbers of `loads.base.forces_sampled`.
    """
    if name == "scale":
        found = Slopes.of(term.samples(times)[..., None])
    elif later is not None:
        found = Slopes.of(term.scale * _derivatives_of_term(term, times) * later[:, None, None])
    elif isinstance(term, Tabulated):
        inside = np.flatnonzero((times >= term.times[0]) & (times < term.times[-1]))
        row, entry, weight = _weights(term.times, times[inside])
        n = term.values[0].size
        component = np.tile(np.arange(n), len(row))
        parameter = n * np.repeat(entry, n) + component
        found = Slopes(np.repeat(inside[row], n), component, parameter, np.repeat(term.scale * weight, n))
    else:
        found = Slopes.of(term.scale * _derivatives_of_term(term, times, name) @ changes_of_field(term, name).T)
    is_along = isinstance(term, ForceTable) and term.frame == "body"
    return found._replace(component=found.component + 9 * is_along)


def _derivatives_of_term(term: Term, times: Array, name: str = "") -> Array:
    """Return the derivatives of a moment by the numbers of a field, or by the time, (n, 3, count)."""
    count = np.size(getattr(term, name)) if name else 1
    if term.columns is not None:
        seeded = term.seeded(name) if name else term
        return derivatives_of_columns(seeded.columns(times if name else Dual(times, [1.0])), count, len(times))
    first = 1 + sum(np.size(getattr(term, other)) for other in term.varying[: term.varying.index(name)]) if name else 0
    found = [slopes_of(term, np.array([t, *term.numbers])) for t in times.tolist()]
    if differences := {function for _, function in found} - {""}:
        warn(differenced(differences))
    return np.array([table[:, 1 + first : 1 + first + count] for table, _ in found]).reshape(len(times), 3, count)


def value_of(term: Term, x: Array) -> Array:
    """Return what a text gives without its factor: of γ, V and its gradient; else forces or a moment.

    The arguments are directors, angular velocity, time, or what there is of these; the numbers of the term may follow.
    """
    return np.array(term.text(checked, x.tolist()))


def slopes_of(term: Term, x: Array, speed: float = 1.0, has_time: bool = True) -> tuple[Array, str]:
    """Return what `value_of` does, and its derivatives, (numbers, 1 + arguments); the function that is differenced.

    The derivatives are those that the term has, else by duals of floats. Where a function does not take them they are
    central differences, with a step of ``eps^(1/3)`` of the scale of an argument, 1 for a director: the rounding of the
    function, eps over the step, and what the difference leaves out, the square of the step times a third derivative,
    are both some 1e-11 of the scale.

    Parameters
    ----------
    term : Term
    x : array
    speed : float, rad/s
        The scale of velocities.
    has_time : bool
        Whether those by the time are asked for.
    """
    value, n, has_own = value_of(term, x), len(x), term.derivative is not None
    is_of_state = term.kind == "state" or term.kind == "forces"
    found = None if (has_own and n == 13) or isinstance(term.called, CFunction) else _by_duals(term, x)
    is_exact = found is not None and np.allclose(found[:, 0], value, SLACK, SLACK * float(abs(value).max()))
    if found is None or not is_exact:
        found, scale = np.zeros((len(value), 1 + n)), np.maximum(abs(x), 1.0)
        places = [k for k in range(12 * has_own, n) if has_time or k != 12 or not is_of_state]
        if isinstance(term, Potential):
            scale = np.maximum(abs(x), float(abs(x).max() or 1.0))
        elif is_of_state:
            scale[:12] = np.repeat([1.0, speed], [9, 3])
        for k in places:
            ahead, behind = x.copy(), x.copy()
            ahead[k] += DIFFERENCE * scale[k]
            behind[k] -= DIFFERENCE * scale[k]
            found[:, 1 + k] = (value_of(term, ahead) - value_of(term, behind)) / (ahead[k] - behind[k])
        if isinstance(term, Potential):  # of V its gradient, which its differences in a step are compared with
            found[0, 1 : len(value)] = value[1:]
    found[:, 0] = value
    if has_own:
        by_directors, by_velocity = own_derivative(term, float(x[12]), x[:9].reshape(3, 3), x[9:12])
        found[:, 1:10], found[:, 10:13] = by_directors.reshape(3, 9), by_velocity
    return found, "" if is_exact or has_own else name_of_function(term)


def _by_duals(term: Term, x: Array) -> Array | None:
    """Return what `slopes_of` does, by duals of floats; None where a function does not take them."""
    duals = [Dual(y, [row]) for y, row in zip(x.tolist(), np.eye(len(x)), strict=True)]
    try:
        found = term.text(plainly, duals)
        return np.array([[plain(y), *(y.tangents[0] if isinstance(y, Dual) else 0.0 * x)] for y in found], np.float64)
    except Exception:  # which a function of a user may raise, of any kind
        return None


def own_derivative(term: Term, t: float, directors: Array, velocity: Array) -> tuple[Array, Array]:
    """Call the derivative that a term of kind "state" has.

    Raises
    ------
    ValueError
        It raised, or returned something else than finite arrays (3, 3, 3) and (3, 3).
    """
    assert term.derivative is not None
    name, shapes = name_of(term.derivative), ((3, 3, 3), (3, 3))
    remedy = (
        "let it return two arrays: by the directors, (3, 3, 3), its entry [c, i, x] the derivative of the component c "
        "by directors[i, x], and by the angular velocity, (3, 3)"
    )
    try:
        by = term.derivative(t, directors.copy(), velocity.copy())
        found = [as_floats(part, f"the derivative {name}") for part in by]
    except Exception as error:
        raise ValueError(
            f"the derivative {name} raised {type(error).__name__} at t = {t:.12g} s: {error}; {remedy}"
        ) from error
    if tuple(part.shape for part in found) != shapes:
        got = ", ".join(str(part.shape) for part in found)
        raise ValueError(f"the derivative {name} returned the shapes {got} at t = {t:.12g} s; {remedy}")
    if not all(np.isfinite(part).all() for part in found):
        raise ValueError(f"the derivative {name} is not finite at t = {t:.12g} s; {remedy}")
    return found[0], found[1]


def name_of_function(term: Term) -> str:
    """Return the name of the function of a term, as of the motor of a wheel."""
    own = term.gradient if isinstance(term, PotentialFunction) else getattr(term, "motor", None)
    return name_of(own or getattr(term, "friction", None) or term.called).removeprefix("__main__.")


def differenced(names: Iterable[str]) -> str:
    """Return what a warning says of functions that differences are taken of."""
    return (
        f"derivatives of {' and '.join(names)} are central differences, accurate to about ten digits, as numbers with "
        "derivatives are not taken; compiled=True takes them of numpy.where too, others of functions of NumPy, none "
        "of math and float(); and a moment accepts exact derivatives: moment(function, derivative=...)"
    )


def derivatives_of_columns(columns: Any, count: int, rows: int) -> Array:
    """Return the derivatives of columns, numbers along times, (rows, columns, count)."""
    found = [[np.broadcast_to(tangent(y, j), rows) for j in range(count)] for y in columns]
    return np.moveaxis(np.array(found, dtype=np.float64), -1, 0)


def momentum_slopes(term: Rotor | Wheel, name: str, times: Array, later: Array) -> Slopes:
    """Return the derivatives of the momentum of a rotor at (n,) times by a parameter; three components each.

    With the name `LATER`, also of a wheel, it is what makes the times `later`.
    """
    if name == LATER:
        return Slopes.of(((term.scale * term.history(times)[1] * later)[:, None] * term.direction)[..., None])
    assert isinstance(term, Rotor)
    if name == "scale":
        return Slopes.of(term.momentum(times)[..., None])
    if name == "rotor":
        across, h = np.eye(3) - np.outer(term.rotor, term.rotor), term.history(times)[0]
        return Slopes.of(term.scale * h[:, None, None] * across)
    row, entry, weight = _weights(term.times, times)
    component = np.tile(np.arange(3), len(row))
    value = np.repeat(term.scale * weight, 3) * term.rotor[component]
    return Slopes(np.repeat(row, 3), component, np.repeat(entry, 3), value)


def fixed_slopes(term: Term, name: str) -> Array:
    """Return the derivatives of a damping matrix, or of the dead force of a linear potential, (9, count)."""
    own = term if name == "scale" else term.seeded(name)
    assert isinstance(own, Damping | Potential)
    fixed: Any = own.damping if isinstance(own, Damping) else own.dead_force
    if name == "scale":
        return np.reshape(fixed, (9, 1))
    return term.scale * derivatives_of_columns(fixed.ravel().tolist(), np.size(getattr(term, name)), 1)[0]


def _weights(known: Array, times: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return which values a linear interpolation takes: rows of `times`, entries of `known`, weights."""
    if len(known) == 1:
        n = len(times)
        return np.arange(n), np.zeros(n, dtype=np.int64), np.ones(n)
    k = np.clip(np.searchsorted(known, times, side="right") - 1, 0, len(known) - 2)
    x = np.clip((times - known[k]) / (known[k + 1] - known[k]), 0.0, 1.0)
    rows = np.arange(len(times))
    return np.concatenate([rows, rows]), np.concatenate([k, k + 1]), np.concatenate([1 - x, x])
