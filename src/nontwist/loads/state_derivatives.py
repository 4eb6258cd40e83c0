"""Derivatives of functions of the state that run in Python: their own, or central differences of the function alone.

All else is differentiated by dual numbers: `engine.generalised`, and compiled functions (`compiled`). With the step
``eps^(1/3)`` of the scale of an argument, 1 for a director, the rounding of the function, eps over the step, and what
the difference leaves out, the square of the step times a third derivative, are both some 1e-11 of the scale.
"""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array, as_floats
from .derivatives import STEP
from .forces import DirectorForces, ForceFunction, ForceTable
from .potentials import PotentialFunction
from .terms import Damping, Function, Rotor, Term, name_of

DIFFERENCE = float(2.0 ** np.round(np.log2(np.finfo(np.float64).eps) / 3))  # of a central difference, of the scale


def without_derivative(terms: tuple[Term, ...]) -> list[str]:
    """Return the names of functions whose derivatives are differences, and of the classes of other such terms."""
    found = list[str]()
    for term in terms:
        is_function = term.kind == "state" or isinstance(term, DirectorForces | PotentialFunction)
        if not is_function or isinstance(term, Damping | Rotor | ForceTable) or term.derivative or term.slopes:
            continue
        function = {PotentialFunction: "gradient", ForceFunction: "director_forces", Function: "function"}.get(
            type(term)
        )
        found.append(name_of(type(term) if function is None else getattr(term, function)))
    return found


def value_of(term: Term, x: Array) -> Array:
    """Return what a function gives without its factor: of γ, V and its gradient; of the state, forces or a moment.

    The state is directors, angular velocity, time.
    """
    if isinstance(term, PotentialFunction):
        return np.array([term.checked_value(x.reshape(term.shape)), *term.slope(x).ravel()])
    state = float(x[12]), x[:9].reshape(3, 3), x[9:12]
    return term.forces(*state).ravel() if isinstance(term, DirectorForces) else term.moment(*state)


def slopes_of(term: Term, x: Array, speed: float, has_time: bool) -> Array:
    """Return what `value_of` does, and its derivatives, (numbers, 1 + arguments).

    Parameters
    ----------
    term : Term
    x : array
    speed : float, rad/s
        The scale of velocities.
    has_time : bool
        Whether those by the time are asked for.
    """
    is_potential, derivative = isinstance(term, PotentialFunction), None
    value, n = value_of(term, x), len(x)
    found = np.zeros((len(value), 1 + n))
    found[:, 0], places = value, range(n)
    if is_potential:
        steps = np.full(n, DIFFERENCE * float(abs(x).max() or 1.0))
    else:
        steps = np.repeat([DIFFERENCE, DIFFERENCE * speed, STEP * max(1.0, abs(float(x[12])))], [9, 3, 1])
        if (derivative := term.derivative) is not None:
            by_directors, by_velocity = own_derivative(term, float(x[12]), x[:9].reshape(3, 3), x[9:12])
            found[:, 1:10], found[:, 10:13] = by_directors.reshape(3, 9), by_velocity
        places = range(12 if derivative else 0, 12 + has_time)
    for k in places:
        ahead, behind = x.copy(), x.copy()
        ahead[k] += steps[k]
        behind[k] -= steps[k]
        found[:, 1 + k] = (value_of(term, ahead) - value_of(term, behind)) / (ahead[k] - behind[k])
    if is_potential:  # of V its gradient, which its differences in a step are compared with
        found[0, 1:] = value[1:]
    return found


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
