"""Derivatives of functions of the state that run in Python: their own, by duals of floats, or by central differences.

All else is differentiated by dual numbers in kernels: `engine.generalised`, and compiled functions (`compiled`). Where
a function does not take duals, the step of a difference is ``eps^(1/3)`` of the scale of an argument, 1 for a director:
the rounding of the function, eps over the step, and what the difference leaves out, the square of the step times a
third derivative, are both some 1e-11 of the scale.
"""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array, as_floats
from ..kernels.dual import Dual, plain
from .c_functions import CFunction
from .calls import checked, name_of, plainly
from .derivatives import STEP, differences_of
from .potentials import Potential
from .terms import Term

DIFFERENCE = float(2.0 ** np.round(np.log2(np.finfo(np.float64).eps) / 3))  # of a central difference, of the scale
SLACK = 1e-9  # of a value by duals


def value_of(term: Term, x: Array) -> Array:
    """Return what a text gives without its factor: of γ, V and its gradient; of the state, forces or a moment.

    The state is directors, angular velocity, time; the numbers of the term may follow.
    """
    return np.array(term.text(checked, x.tolist()))


def by_duals(term: Term, x: Array) -> Array | None:
    """Return what `slopes_of` does, by duals of floats; None where a function does not take them."""
    duals = [Dual(y, [row]) for y, row in zip(x.tolist(), np.eye(len(x)), strict=True)]
    try:
        found = term.text(plainly, duals)
        return np.array([[plain(y), *(y.tangents[0] if isinstance(y, Dual) else 0.0 * x)] for y in found], np.float64)
    except Exception:  # which a function of a user may raise, of any kind
        return None


def slopes_of(term: Term, x: Array, speed: float, has_time: bool) -> tuple[Array, str]:
    """Return what `value_of` does, and its derivatives, (numbers, 1 + arguments); the function that is differenced.

    Parameters
    ----------
    term : Term
    x : array
    speed : float, rad/s
        The scale of velocities.
    has_time : bool
        Whether those by the time are asked for.
    """
    derivative, value, n = term.derivative, value_of(term, x), len(x)
    found = None if derivative is not None or isinstance(term.called, CFunction) else by_duals(term, x)
    if found is not None and np.allclose(found[:, 0], value, SLACK, SLACK * float(abs(value).max())):
        found[:, 0] = value
        return found, ""
    found, places = np.zeros((len(value), 1 + n)), [*range(n)]
    found[:, 0] = value
    steps = DIFFERENCE * np.maximum(abs(x), float(abs(x).max() or 1.0) if isinstance(term, Potential) else 1.0)
    if not isinstance(term, Potential):
        steps[:13] = np.repeat([DIFFERENCE, DIFFERENCE * speed, STEP * max(1.0, abs(float(x[12])))], [9, 3, 1])
        places = [k for k in places if k != 12 or has_time]
    if derivative is not None:
        by_directors, by_velocity = own_derivative(term, float(x[12]), x[:9].reshape(3, 3), x[9:12])
        found[:, 1:10], found[:, 10:13] = by_directors.reshape(3, 9), by_velocity
        places = [k for k in places if k >= 12]
    for k in places:
        ahead, behind = x.copy(), x.copy()
        ahead[k] += steps[k]
        behind[k] -= steps[k]
        found[:, 1 + k] = (value_of(term, ahead) - value_of(term, behind)) / (ahead[k] - behind[k])
    if isinstance(term, Potential):  # of V its gradient, which its differences in a step are compared with
        found[0, 1 : len(value)] = value[1:]
    return found, "" if derivative is not None else differences_of(term)


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
