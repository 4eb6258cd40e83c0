"""The loads of the package: each a function that returns a `Load`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_array, as_floats
from ..geometry.values import among, as_function, as_list, shown
from .base import Kind, Load, Moment, Samples, Term, called


def body_moment(
    times: ArrayLike | Callable[[float], ArrayLike],
    values: ArrayLike | None = None,
    *,
    breakpoints: Sequence[float] = (),
) -> Load:
    """Return a moment given by its components along the moving directors.

    Parameters
    ----------
    times : (k,) array, s, strictly increasing; or a function ``f(t) -> (3,)``, N m
    values : (k, 3) array, N m
        The table, piecewise linear between its times and 0 outside. Left out with a function.
    breakpoints : sequence of float, s
        Where the function or its derivatives jump. A table's own times are its breakpoints.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        Wrong shapes, times not increasing, not finite.

    Examples
    --------
    A triangle over 1 s with the impulse 2 N m s, of which no part is lost:

    >>> from nontwist import body_moment, nontwisting, simulate
    >>> load = body_moment([0, 0.5, 1], [[0, 0, 0], [4, 0, 0], [0, 0, 0]])
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, step=0.1, load=load)
    >>> round(run.material_momentum.values[-1, 0].item(), 9)
    2.0
    """
    return _moment_of_time("body", times, values, breakpoints)


def space_moment(
    times: ArrayLike | Callable[[float], ArrayLike],
    values: ArrayLike | None = None,
    *,
    breakpoints: Sequence[float] = (),
) -> Load:
    """Return a moment given by its components along fixed axes.

    Parameters
    ----------
    times, values, breakpoints
        As in `body_moment`.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        As `body_moment`.

    Examples
    --------
    >>> from nontwist import simulate, space_moment, standard
    >>> load = space_moment(lambda t: (1, 2, 3))
    >>> run = simulate(standard([3, 4, 5]), t_end=2, step=0.1, load=load)
    >>> run.spatial_momentum.values[-1].round(9)  # the moment times 2 s, however the body has turned
    array([2., 4., 6.])
    """
    return _moment_of_time("space", times, values, breakpoints)


def moment(function: Moment, breakpoints: Sequence[float] = (), compiled: bool = False) -> Load:
    """Return a moment that depends on the state.

    Parameters
    ----------
    function : callable
        ``function(t, directors, angular_velocity) -> (3,)``: the spatial moment, N m, from the time, the directors as
        rows of a (3, 3) array and the spatial angular velocity. It is called at the middle of a step; there the
        energy-momentum schemes pass the averaged directors, which are not renormalised (else they would lose K + V).
    breakpoints : sequence of float, s
        Times where the function or its derivatives jump.
    compiled : bool
        Compile the function with Numba, once; the kernels are not compiled again for it. The values of globals and
        closures freeze then. Otherwise a run with this load marches at the speed of Python, and says so once.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        Numba cannot compile the function; with the reason.

    Examples
    --------
    A spring that pulls the third director upright, 2 N m a radian at first, let go at 60°:

    >>> from scipy.spatial.transform import Rotation
    >>> from nontwist import moment, nontwisting, simulate
    >>> def spring(t, directors, angular_velocity):
    ...     x, y, z = directors[2]
    ...     return 2 * y, -2 * x, 0.0  # 2 d3 × e_z
    >>> load, start = moment(spring, compiled=True), Rotation.from_euler("x", 60, degrees=True)
    >>> run = simulate(nontwisting([1, 1, 1]), t_end=3, step=0.01, load=load, rotation=start)
    >>> (run.kinetic_energy.values - 2 * run.directors.values[:, 2, 2])[[0, -1]].round(6)
    array([-1., -1.])
    """
    as_function(function, "function")
    load = _load("state", None, function, _breakpoints(breakpoints), np.inf, _name(function))
    if not compiled:
        return load
    from .compiled import compiled_moment

    plain = getattr(function, "py_func", function)
    return Load((replace(load.terms[0], function=plain, compiled=compiled_moment(function)),))


def damping(coefficient: ArrayLike) -> Load:
    """Return viscous damping ``m = -Λ C Λᵀ w``.

    Parameters
    ----------
    coefficient : float, 3 values or (3, 3) array, N m s
        Isotropic, along the body's directions, or a matrix C in body components with positive semidefinite
        symmetric part.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        Wrong shape, or a negative coefficient.

    Examples
    --------
    >>> from nontwist import damping, nontwisting, simulate
    >>> run = simulate(nontwisting([2, 2, 1]), t_end=1, step=0.01, angular_velocity=(0, 3, 0), load=damping(0.5))
    >>> round(run.angular_velocity.values[-1, 1].item(), 6)  # 3 exp(-0.5/2)
    2.336402
    """
    C = as_floats(coefficient, "damping")
    if C.ndim == 0 or C.shape == (3,):
        C = np.diag(np.broadcast_to(C, 3))
    C = as_array(C, "damping", (3, 3))
    smallest = float(np.linalg.eigvalsh((C + C.T) / 2)[0])
    if smallest < -1e-12 * abs(C).max():
        raise ValueError(f"damping must not be negative, got {smallest:g} N m s (-1 * damping(c) drives the body)")

    def function(t: float, d: Array, w: Array) -> Array:
        return -(C @ (d @ w)) @ d

    as_function(function, "function")
    load = _load("state", None, function, (), np.inf, {"damping": C.tolist()})
    return Load((replace(load.terms[0], damping=C),))


def pulse(
    amplitude: ArrayLike,
    start: float = 0.0,
    end: float = 1.0,
    *,
    shape: Literal["triangle", "rectangle", "half-sine"] = "triangle",
    frame: Literal["body", "space"] = "body",
) -> Load:
    """Return a moment of fixed direction that lasts from `start` to `end` (eq-loads_time_variation is the triangle).

    Parameters
    ----------
    amplitude : (3,) array, N m
        The peak.
    start, end : float, s
    shape : "triangle", "rectangle" or "half-sine"
        Impulse per amplitude and duration: 1/2, 1, 2/π.
    frame : "body" or "space"
        Components along the moving directors or along fixed axes.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        `end` not after `start`, an unknown shape or frame, not finite.

    Examples
    --------
    >>> from nontwist import nontwisting, pulse, simulate
    >>> push = pulse((0, 2, 0), end=0.5, shape="rectangle")  # an impulse of 1 N m s
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, step=0.05, load=push)
    >>> round(run.kinetic_energy[-1].item(), 9), round(run.load_work.sum().item(), 9)
    (0.125, 0.125)
    """
    peak = as_array(amplitude, "amplitude", (3,))
    a, b = float(as_array(start, "start", ())), float(as_array(end, "end", ()))
    if not a < b:
        raise ValueError(f"pulse must end after it starts, got start = {a:g} s, end = {b:g} s")
    if not among(shape, PULSES):
        raise ValueError(f"shape must be one of {', '.join(PULSES)}; got {shown(shape)}")
    profile, inner = PULSES[shape]

    def samples(times: Array) -> Array:
        s = (times - a) / (b - a)
        return np.where((s >= 0) & (s < 1), profile(s), 0.0)[:, None] * peak

    description = {"pulse": peak.tolist(), "start": a, "end": b, "shape": shape}
    breakpoints = (a, *(a + s * (b - a) for s in inner), b)
    return _load(_frame(frame), samples, None, breakpoints, (b - a) / 20, description, b)


PULSES: dict[str, tuple[Samples, tuple[float, ...]]] = {
    "triangle": (lambda s: 1 - abs(2 * s - 1), (0.5,)),
    "rectangle": (np.ones_like, ()),
    "half-sine": (lambda s: np.sin(np.pi * s), ()),
}


def sine(
    amplitude: ArrayLike, frequency: float, *, phase: float = 0.0, frame: Literal["body", "space"] = "body"
) -> Load:
    """Return the moment ``amplitude sin(2π frequency t + phase)``.

    Parameters
    ----------
    amplitude : (3,) array, N m
    frequency : float, Hz
    phase : float, rad
    frame : "body" or "space"

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        `frequency` not positive, an unknown frame, not finite.

    Examples
    --------
    >>> from nontwist import sine
    >>> sine((0, 3, 0), frequency=2).sample([0, 0.125], "body")  # a quarter of a period later the peak
    array([[0., 0., 0.],
           [0., 3., 0.]])
    """
    peak = as_array(amplitude, "amplitude", (3,))
    f, phi = float(as_array(frequency, "frequency", ())), float(as_array(phase, "phase", ()))
    if f <= 0:
        raise ValueError(f"frequency must be positive, got {f:g} Hz")

    def samples(times: Array) -> Array:
        return np.sin(2 * np.pi * f * times + phi)[:, None] * peak

    description = {"sine": peak.tolist(), "frequency": f, "phase": phi}
    return _load(_frame(frame), samples, None, (), 1 / (20 * f), description)


def _load(
    kind: Kind,
    samples: Samples | None,
    function: Moment | None,
    breakpoints: tuple[float, ...],
    resolution: float,
    description: dict[str, Any],
    end: float = np.inf,
) -> Load:
    return Load((Term(kind, samples, function, breakpoints, resolution, description, end=end),))


def _moment_of_time(kind: Kind, times: Any, values: ArrayLike | None, breakpoints: Sequence[float]) -> Load:
    if callable(times):
        if values is not None:
            raise ValueError(f"{kind}_moment takes a function, or times and values, not both")
        f: Callable[[float], ArrayLike] = times

        def samples(at: Array) -> Array:
            return np.array([called(f, float(t)) for t in at]).reshape(-1, 3)

        return _load(kind, samples, None, _breakpoints(breakpoints), np.inf, _name(f))
    if values is None:
        raise ValueError(f"{kind}_moment needs the values that belong to its times: {kind}_moment(times, values)")
    t = as_array(times, "times", (None,))
    m = as_array(values, "values", (t.size, 3))
    if t.size < 2:
        raise ValueError(f"a table needs at least 2 times, got {t.size}")
    gaps = np.diff(t)
    if gaps.min() <= 0:
        k = int(np.argmax(gaps <= 0))
        raise ValueError(f"times must increase, but times[{k + 1}] = {t[k + 1]:g} follows times[{k}] = {t[k]:g}")

    def interpolated(at: Array) -> Array:
        inside = (at >= t[0]) & (at < t[-1])
        return np.where(inside[:, None], np.stack([np.interp(at, t, column) for column in m.T], axis=1), 0.0)

    description = {"times": t.tolist(), "values": m.tolist(), "end_value": float(np.linalg.norm(m[-1]))}
    return _load(kind, interpolated, None, tuple(t.tolist()), float(gaps.min()), description, float(t[-1]))


def _breakpoints(times: Iterable[float]) -> tuple[float, ...]:
    return tuple(as_array(as_list(times, "breakpoints"), "breakpoints", (None,)).tolist())


def _frame(frame: Literal["body", "space"]) -> Literal["body", "space"]:
    if not among(frame, ("body", "space")):
        raise ValueError(f"frame must be 'body' or 'space', got {shown(frame)}")
    return frame


def _name(function: Callable[..., Any]) -> dict[str, Any]:
    return {"function": f"{getattr(function, '__module__', '?')}.{getattr(function, '__qualname__', repr(function))}"}
