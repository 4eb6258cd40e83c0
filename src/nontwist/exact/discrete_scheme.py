"""The paper's director scheme in closed form, for the free non-twisting body (eq-discrete-nonholonomic).

The step ``Δd_i = h w × d_{i,m}``, ``d_m`` the mean of both ends, is the Cayley rotation of h w: a rotation about w by

    θ_h = 2 atan(|w| h/2).

It keeps w × d_i as the velocity at both ends, for w × d_n + w × d_{n+1} = 2 w × d_m; hence W, Π1, Π2 and K are constant
to the last step, for every h, and the discrete body turns about a fixed axis by θ_h a step. At the time t the scheme of
step h/k has turned by φ_k = (t k/h) 2 atan(|w| h/2k), and two rotations about one axis lie ``2√2 sin(|φ - φ'|/2)``
apart, so the second quotient (eq-stwo) is sin(|φ1 - φ2|/2)/sin(|φ2 - φ4|/2) = 4 + O(h²). The differences of the angles
follow from 2 atan(x/2) - atan(x) = atan(x³/(4 + 3x²)), which does not cancel.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_array, as_positive, norm, ratio
from ..geometry.values import as_whole
from ..models.bodies import D3
from .free_bodies import Motion, checked_attitude, checked_times, planar, rotations_about

MOST = 10_000_000  # states, 1 GB


def discrete_angle(angular_velocity: ArrayLike, step: float) -> float:
    """Return the angle θ_h = 2 atan(|w| h/2), rad, by which the free discrete body turns in one step.

    Parameters
    ----------
    angular_velocity : (3,) array, rad/s
        In the body or in space; without twist.
    step : float, s
        h, positive; any size: θ_h stays below π.

    Raises
    ------
    ValueError
        An argument has the wrong shape or is not finite, or the step is not positive.

    Examples
    --------
    >>> from nontwist import exact
    >>> round(exact.discrete_angle((0, 2, 0), 0.5), 6)  # 2 atan(1/2), where the body itself turns by 1 rad
    0.927295
    """
    rate = float(np.linalg.norm(as_array(angular_velocity, "angular_velocity", (3,))))
    return float(2 * np.arctan(rate * _step(step) / 2))


def discrete_free(
    inertia: ArrayLike,
    material_angular_velocity: ArrayLike,
    step: float,
    steps: int,
    rotation: Any = None,
    *,
    physical: bool = True,
) -> Motion:
    """Return all states of the scheme "energy-momentum", order 2, on the free non-twisting body, in closed form.

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Convected inertia; the third axis is principal.
    material_angular_velocity : (3,) array, rad/s
        W, without a component along the third axis.
    step : float, s
        h.
    steps : int
        N, at least 0.
    rotation : (3, 3) array or scipy Rotation, optional
        Λ at t = 0; the identity by default.
    physical : bool
        As in `nontwist.standard`.

    Returns
    -------
    attitude : (N+1, 3, 3) array
        Λ at t = n h: turned by n θ_h about W.
    material_angular_velocity : (N+1, 3) array, rad/s
        Constant.

    Raises
    ------
    ValueError
        As `free_nontwisting`; or `step` or `steps` is invalid.

    Notes
    -----
    Exact for the equations of the scheme; derived in the docstring of the module. Accuracy: round-off, and the ulp of n
    θ_h.

    Examples
    --------
    >>> from nontwist import exact, nontwisting, rotation, simulate
    >>> attitude, W = exact.discrete_free([3, 4, 5], (0, 2, 0), step=0.5, steps=3)
    >>> rotation(attitude).magnitude().round(6)
    array([0.      , 0.927295, 1.85459 , 2.781886])

    The same by the scheme itself, step by step:

    >>> how = {"t_end": 1.5, "step": 0.5, "integrator": "energy-momentum"}
    >>> run = simulate(nontwisting([3, 4, 5]), material_angular_velocity=(0, 2, 0), **how)
    >>> rotation(run).magnitude().round(6)
    array([0.      , 0.927295, 1.85459 , 2.781886])
    """
    (_, W), R = planar(inertia, material_angular_velocity, physical), checked_attitude(rotation)
    count = as_whole(steps, "steps", 0, MOST)
    rate = float(np.linalg.norm(W))
    axis = W / rate if rate > 0 else D3
    n = np.arange(count + 1, dtype=np.float64)
    return rotations_about(R, axis, n * discrete_angle(W, step)), np.broadcast_to(W, (len(n), 3)).copy()


def discrete_second_quotient(angular_velocity: ArrayLike, step: float, times: ArrayLike) -> Array:
    """Return the second quotient Q_II of the director scheme on the free non-twisting body (eq-stwo).

    Parameters
    ----------
    angular_velocity : (3,) array, rad/s
        In the body or in space; not 0.
    step : float, s
        h, the largest of the three steps h, h/2 and h/4.
    times : (k,) array, s
        Multiples of h; at 0 the limit is returned.

    Returns
    -------
    (k,) array
        ``sin(|φ1 - φ2|/2)/sin(|φ2 - φ4|/2)``. Accuracy: round-off of the arguments of the sines.

    Raises
    ------
    ValueError
        An argument has the wrong shape or is not finite, the step is not positive, or the body is at rest.

    Examples
    --------
    >>> from nontwist import exact
    >>> [exact.discrete_second_quotient((0, 2, 0), h, [1]).round(3).item() for h in (0.1, 0.05, 0.025)]
    [3.978, 3.994, 3.999]
    """
    h, t = _step(step), checked_times(times)
    w = as_array(angular_velocity, "angular_velocity", (3,))
    if not w.any():
        raise ValueError("angular_velocity is zero: a body at rest has no second quotient")
    x = float(norm(w)) * h / 2
    if x < 1e-100:  # x³ underflows
        return np.full(len(t), 4.0)
    coarse, fine = _lag(x), 2 * _lag(x / 2)
    a, b = np.sin(np.outer([coarse / h, fine / h], t))
    return ratio(a, b, coarse / fine)


def _lag(x: float) -> float:
    """Return 2 atan(x/2) - atan(x)."""
    r = 2 / x
    return math.atan(x / (r * r + 3))


def _step(step: float) -> float:
    return float(as_positive(step, "step", (), "s"))
