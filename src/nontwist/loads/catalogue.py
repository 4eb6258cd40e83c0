"""The loads without a potential, each a function that returns a `Load`; `conservative` has the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_array, as_floats, as_tensor, increasing
from ..geometry.values import as_function, as_list, hinted, short_repr
from .friction import DryFriction
from .functions import as_c_function, is_c_function
from .kinds import made, of_function
from .load import Load
from .memory_terms import MemoryFunction, Wheel
from .potentials import ForceFunction, ForceTable
from .terms import EVER, Damping, Function, Moment, Pulse, Rotor, Sine, Table

Forces = Callable[[float, Array, Array], ArrayLike]


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
        The table, piecewise linear between its times and 0 outside. Omit it with a function.
    breakpoints : sequence of float, s
        Times at which the function or its derivatives jump. The times of a table are its breakpoints.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        Shapes are wrong, times do not increase, a number is not finite, or the function is a C function.

    Examples
    --------
    A triangle over 1 s with the impulse 2 N m s, which the body receives exactly:

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
    >>> load = space_moment(lambda t: (1, 2, 6 * t))
    >>> run = simulate(standard([3, 4, 5]), t_end=2, step=0.1, load=load)
    >>> run.spatial_momentum.values[-1].round(9)  # the integral of the moment, however the body has turned
    array([ 2.,  4., 12.])
    """
    return _moment_of_time("space", times, values, breakpoints)


def moment(
    function: Moment,
    breakpoints: Sequence[float] = (),
    compiled: bool = False,
    *,
    derivative: Callable[..., Any] | None = None,
) -> Load:
    """Return a moment that depends on the state.

    Parameters
    ----------
    function : callable, or a C function
        ``function(t, directors, angular_velocity) -> (3,)``: the spatial moment, N m, from the time, the directors as
        rows of a (3, 3) array and the spatial angular velocity. It is called at the stages of a step: `lie-midpoint`
        and `energy-momentum` pass the averaged directors at its middle, a little shorter than one, `gauss` those at its
        Gauss nodes, a little shorter or longer. They are not normalised, since otherwise K + V would not be conserved.
        `split` passes unit vectors, at the middles of its substeps. A C function is
        ``void (double t, const double *directors, const double *angular_velocity, double *moment)``, with directors row
        by row: a function pointer of `ctypes` with its ``argtypes`` and ``restype``, a `scipy.LowLevelCallable` without
        user data, or a function compiled by ``numba.cfunc``. Kernels call it directly, without the interpreter lock,
        and for ensembles from several threads. Its address is valid in one process only, so a load with it cannot be
        pickled.
    breakpoints : sequence of float, s
        Times at which the function or its derivatives jump.
    compiled : bool
        Compile the function, once. It may use functions of NumPy and `math`, arrays, and loops over ranges, but cannot
        branch on the time or the state: ``np.where(condition, a, b)`` does, and ``np.interp`` reads a table. The values
        of globals and closures are fixed at this point; a copy, a pickle and `continuous` take them anew, so give what
        changes as a default: ``k=k``. Without compilation a run proceeds at the speed of Python, and warns once.
    derivative : callable, optional
        Used by `nontwist.sensitivities` and `nontwist.gradient`. Without it the function is differentiated exactly, by
        dual numbers, or, where it does not take them, by central differences. ``derivative(t, directors,
        angular_velocity)`` returns two arrays: the derivatives of the moment with respect to the directors, (3, 3, 3),
        whose entry [c, i, x] is that of component c with respect to ``directors[i, x]``; and with respect to the
        angular velocity, (3, 3). It runs in Python. Derivatives with respect to time, which only `duration` needs, are
        then central differences.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        The function cannot be compiled (the message states the reason and the line), or a C function has another
        signature or user data.

    Examples
    --------
    A spring that pulls the third director upright, 2 N m per radian at small angles, released at 60°:

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
    is_c = is_c_function(function)
    function = as_c_function(function) if is_c else as_function(function, "function")
    own = None if derivative is None else as_function(derivative, "derivative")
    return of_function(Function, "state", function, own, breakpoints=breakpoints, compiled=compiled or is_c)


def memory_load(
    derivative: Callable[..., ArrayLike],
    moment: Callable[..., ArrayLike],
    state0: ArrayLike,
    *,
    scale: ArrayLike = 1.0,
    frame: Literal["body", "space"] = "space",
    breakpoints: Sequence[float] = (),
    compiled: bool = False,
) -> Load:
    """Return a moment with memory: it depends on internal states z of its own, with equations of their own.

    An actuator that lags, liquid in a tank, the hysteresis of a magnetic rod. `gauss` solves for z in the same step as
    for the body, to its order; so do `lie-midpoint` and `energy-momentum`. A run has z as ``internal_state``.

    Parameters
    ----------
    derivative, moment : callable
        ``derivative(t, z, directors, angular_velocity) -> (k,)`` is z', and
        ``moment(t, z, directors, angular_velocity) -> (3,)`` the moment, N m. Directors are rows of a (3, 3) array, at
        the stages of a step a little shorter or longer than one.
    state0 : float or (k,) array
        z at the start.
    scale : float or (k,) array
        How large z becomes: its error counts relative to this, or to the largest z where that is more, as that of the
        attitude in radians does.
    frame : "space" or "body"
        What moment and angular velocity are components along: fixed axes, or the moving directors. What is exchanged
        between the body and a part that turns in it is kept to round-off with "body".
    breakpoints : sequence of float, s
        Times at which a function or its derivatives jump.
    compiled : bool
        Compile both functions, as in `nontwist.moment`.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        `state0` is empty or not a list of real numbers, `scale` is not positive, `frame` is unknown, or a function
        cannot be compiled.

    Examples
    --------
    A motor that gets a moment of 2 N m at once reaches it with a lag of 0.5 s:

    >>> from nontwist import memory_load, simulate, standard
    >>> def derivative(t, z, directors, angular_velocity):
    ...     return (2 - z) / 0.5
    >>> def moment(t, z, directors, angular_velocity):
    ...     return z[0], 0.0, 0.0
    >>> motor = memory_load(derivative, moment, state0=0, compiled=True)
    >>> run = simulate(standard([1, 2, 3]), t_end=1, step=0.1, load=motor)
    >>> run.internal_state.values[-1].round(9)  # 2 (1 - exp(-2))
    array([1.72932943])
    """
    z, scales = as_floats(state0, "state0", 1), as_floats(scale, "scale")
    functions = as_function(derivative, "derivative"), as_function(moment, "moment")
    scales = np.full(z.shape, scales) if scales.ndim == 0 else scales
    return of_function(MemoryFunction, *functions, z, scales, frame, breakpoints=breakpoints, compiled=compiled)


def damping(coefficient: ArrayLike) -> Load:
    """Return viscous damping ``m = -Λ C Λᵀ w``.

    Parameters
    ----------
    coefficient : float, 3 values or (3, 3) array, N m s
        Isotropic, along the directors, or a matrix C in body components with positive semidefinite symmetric part.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        The shape is wrong, or a coefficient is negative.

    Examples
    --------
    >>> from nontwist import damping, nontwisting, simulate
    >>> run = simulate(nontwisting([2, 2, 1]), t_end=1, step=0.01, angular_velocity=(0, 3, 0), load=damping(0.5))
    >>> round(run.angular_velocity.values[-1, 1].item(), 6)  # 3 exp(-0.5/2)
    2.336402
    """
    C = as_floats(coefficient, "damping")
    C = as_tensor(C if C.ndim else np.full(3, C), "damping", "a number, 3 values or a (3, 3) array")
    smallest = float(np.linalg.eigvalsh((C + C.T) / 2)[0])
    if smallest < -1e-12 * abs(C).max():
        raise ValueError(f"damping must not be negative, got {smallest:g} N m s (-1 * damping(c) drives the body)")
    return Damping(C).load


def pulse(
    amplitude: ArrayLike,
    start: float = 0.0,
    end: float = 1.0,
    *,
    shape: Literal["triangle", "rectangle", "half-sine"] = "triangle",
    frame: Literal["body", "space"] = "body",
) -> Load:
    """Return a moment of fixed direction that acts from `start` to `end` (eq-loads_time_variation is the triangle).

    Parameters
    ----------
    amplitude : (3,) array, N m
        The peak.
    start, end : float, s
    shape : "triangle", "rectangle" or "half-sine"
        The impulse is 1/2, 1 or 2/π times amplitude and duration.
    frame : "body" or "space"
        Components along the moving directors or along fixed axes.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        `end` is not after `start`, `shape` or `frame` is unknown, or a number is not finite.

    Examples
    --------
    >>> from nontwist import nontwisting, pulse, simulate
    >>> push = pulse((0, 2, 0), end=0.5, shape="rectangle")  # an impulse of 1 N m s
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, step=0.05, load=push)
    >>> round(run.kinetic_energy[-1].item(), 9), round(run.load_work.sum().item(), 9)
    (0.125, 0.125)
    """
    return made(Pulse, frame, amplitude, start, shape, end=end)


def constant(moment: ArrayLike, *, frame: Literal["body", "space"] = "body") -> Load:
    """Return a moment that does not change.

    Parameters
    ----------
    moment : (3,) array, N m
    frame : "body" or "space"
        Components along the moving directors or along fixed axes.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        `moment` is not of three finite numbers, or `frame` is unknown.

    Examples
    --------
    >>> from nontwist import constant, simulate, standard
    >>> run = simulate(standard([3, 4, 5]), t_end=2, load=constant((1, 2, 3), frame="space"))
    >>> run.spatial_momentum.values[-1].round(9)  # the moment times 2 s, however the body has turned
    array([2., 4., 6.])
    """
    return made(Pulse, frame, as_array(moment, "moment", (3,)), -EVER, "rectangle", end=EVER)


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
        `frequency` is not positive, `frame` is unknown, or a number is not finite.

    Examples
    --------
    >>> from nontwist import sine
    >>> sine((0, 3, 0), frequency=2).sample([0, 0.125], "body")  # a quarter of a period later the peak
    array([[0., 0., 0.],
           [0., 3., 0.]])
    """
    return made(Sine, frame, amplitude, frequency, phase)


def rotor(axis: ArrayLike, momentum: ArrayLike, values: ArrayLike | None = None) -> Load:
    """Return a rotor of given momentum relative to the body, which makes this a gyrostat.

    The rotor is symmetric about its axis a, which passes through its centre of mass, so the inertia J of the gyrostat
    does not depend on the angle of the rotor. J is that of the body with the rotor locked. The momentum of the rotor
    relative to the body is h a. With π = Λ J W the total momentum is π + Λ h a, and the rotor exerts on the body the
    moment ``-(h Λa)' = Λ (h a × W - h' a)``. A rotor of constant h does no work: K = ½ W·J W is constant in free
    motion. A rotor that spins up adds -h' a·W to K'. K does not include the energy due to the relative rotation of the
    rotor, which its motor supplies.

    Parameters
    ----------
    axis : (3,) array, or "x", "y", "z", "-x", "-y", "-z"
        The direction a in body components, any length but zero.
    momentum : float, kg m² s⁻¹; or (k,) array, s, strictly increasing
        The constant momentum h, or the times of a table, with `values`.
    values : (k,) array, kg m² s⁻¹, optional
        h, piecewise linear between the times; before the first and after the last it is constant.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        The axis has length 0, shapes are wrong, times do not increase, or a number is not finite.

    Examples
    --------
    A momentum wheel spins up, and the satellite turns the other way:

    >>> from nontwist import rotor, simulate, standard
    >>> wheel = rotor((0, 0, 1), [1, 3], [0, 0.5])
    >>> run = simulate(standard([3, 4, 5]), t_end=4, step=0.5, load=wheel)
    >>> run.material_angular_velocity.values[[0, -1], 2].round(9)
    array([ 0. , -0.1])
    >>> abs(run.total_momentum).max().item() < 1e-15
    True
    """
    if values is not None:
        increasing(times := as_array(momentum, "times", (None,)))
        return made(Rotor, axis, times, values)
    h = as_floats(momentum, "momentum")
    if h.ndim:
        raise ValueError("rotor needs the values that belong to its times: rotor(axis, times, values)")
    return made(Rotor, axis, [0.0], as_array(h, "momentum", ())[None])


def dry_friction(limit: float, axis: ArrayLike | None = None) -> Load:
    """Return dry (Coulomb) friction, about an axis of the body or against w: a set-valued law, without a smoothing.

    About an axis a the moment is ``-limit sign(a·W) Λa``; while a·W = 0 it is what keeps a·W at 0, as long as that is
    at most the limit: the body sticks. Without an axis it is ``-limit w/|w|``, and the whole body sticks: w = 0
    exactly. `gauss` and `lie-midpoint` split their steps where the rate vanishes; other integrators refuse it, and
    beside `coulomb` of a wheel it needs an axis. A run has the variables `sticking` and `dissipated_energy`,
    an ensemble has not. Where friction about several axes, or about one beside a constrained axis, leaves the body a
    single axis to turn about, it turns about this one.

    Parameters
    ----------
    limit : float, N m
        The largest moment.
    axis : (3,) array, or "x", "y", "z", "-x", "-y", "-z", optional
        The direction a in body components, any length but zero.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        `limit` is negative, or the axis has length 0; in a sum, two act about one axis.

    Examples
    --------
    A wheel slows down from 2 rad/s by 0.5 rad/s², and stands after 4 s:

    >>> from nontwist import dry_friction, simulate, standard
    >>> run = simulate(standard([2, 2, 2]), t_end=6, angular_velocity=(0, 0, 2), load=dry_friction(1))
    >>> run.angular_velocity.sel(axis="z").interp(time=[2, 5]).values.round(9)
    array([1., 0.])
    >>> bool(run.sticking[-1]), round(run.dissipated_energy.sum().item(), 9)
    (True, 4.0)
    """
    return made(DryFriction, limit, axis)


@hinted
def wheel(
    axis: ArrayLike,
    inertia: float,
    speed: float = 0.0,
    torque: Any = None,
    viscous: float = 0.0,
    coulomb: float = 0.0,
    friction: Callable[[float], float] | None = None,
    *,
    breakpoints: Sequence[float] = (),
    compiled: bool = True,
) -> Load:
    """Return a wheel that the body carries, driven by a motor or free.

    The wheel is symmetric about its axis n, which passes through its centre of mass. The inertia J of the body includes
    that of the wheel, locked. The state of the wheel is its axial momentum ``h = inertia (Ω + n·W)`` in space, Ω its
    speed relative to the body; its motor changes it, ``h' = torque``. The total momentum changes by moments from
    outside alone.

    Parameters
    ----------
    axis : (3,) array, or "x", "y", "z", "-x", "-y", "-z"
        The direction n in body components, any length but zero.
    inertia : float, kg m²
        Moment of inertia of the wheel about its axis.
    speed : float, rad/s
        Ω at the start of a run. A run that continues another has the speeds of that.
    torque : float, N m; (times, values), s and N m; or a function ``f(t, speed) -> float``, optional
        Torque of the motor on the wheel, about its axis; of a table linear between the times and zero outside.
    viscous : float, N m s
        Friction in the bearing per unit of Ω.
    coulomb : float, N m
        Dry friction in the bearing: of this size against Ω while the wheel turns. Where Ω is zero the wheel sticks,
        Ω = 0 exactly, as long as no larger torque is needed to hold it. A slip that begins and ends within one step is
        missed: give a step that resolves the torque.
    friction : function ``f(speed) -> float``, N m, optional
        Friction of the sign of Ω, which is taken off the torque.
    breakpoints : sequence of float, s
        Times at which a torque that is a function or its derivatives jump.
    compiled : bool
        Compile the functions, as in `nontwist.moment`.

    Returns
    -------
    Load
        A factor multiplies speed and torque.

    Raises
    ------
    ValueError
        The axis has length 0, `inertia` is not positive, times do not increase, friction adds energy, or a number is
        not finite; of a run: ``J - Σ inertia n nᵀ``, what carries the wheels, is not positive definite; or the
        integrator does not solve for friction or a torque that is a function, as `split` and `exact` do not.

    See Also
    --------
    rotor : a rotor whose momentum relative to the body is given.

    Examples
    --------
    A motor slows a satellite down by 0.5 N m s:

    >>> from nontwist import simulate, standard, wheel
    >>> load = wheel("z", inertia=0.5, speed=2, torque=([0, 5], [0.1, 0.1]))
    >>> run = simulate(standard([3, 4, 5]), t_end=6, step=0.5, angular_velocity=(0, 0, 0.2), load=load)
    >>> run.angular_velocity.values[-1].round(9), run.wheel_momentum.values[[0, -1], 0].round(9)
    (array([0.        , 0.        , 0.08888889]), array([1.1, 1.6]))
    >>> run.total_momentum.values[[0, -1], 2].round(9)
    array([2., 2.])
    """
    is_table = isinstance(torque, (tuple, list))
    is_motor = callable(torque)
    is_number = not (is_table or is_motor or torque is None)
    is_pair = is_table and len(torque) == 2 and as_floats(torque[0], "torque").ndim == 1
    if is_table != is_pair or (is_number and as_floats(torque, "torque").ndim > 0):
        raise ValueError(f"torque must be a number, (times, values) or a function, got {short_repr(torque)}")
    if as_list(breakpoints, "breakpoints") and not is_motor:
        raise ValueError("breakpoints are times where a torque that is a function jumps; a table has its own")
    if friction is not None and not callable(friction):
        raise ValueError(
            f"friction must be a function of the speed, got {short_repr(friction)}; use viscous= or coulomb="
        )
    number, motor = (torque if is_number else 0.0), (torque if is_motor else None)
    table = torque if is_table else ((), ())
    given = axis, inertia, speed, number, *table, viscous, coulomb, friction, motor
    has_function = motor is not None or friction is not None
    if not has_function:
        return Wheel(*given).load
    return of_function(Wheel, *given, breakpoints=breakpoints, compiled=compiled)


def director_forces(
    times: ArrayLike | Forces,
    values: ArrayLike | None = None,
    *,
    frame: Literal["space", "body"] = "space",
    breakpoints: Sequence[float] = (),
    compiled: bool = False,
) -> Load:
    """Return forces on the three directors, the generalised load Q = (f¹, f², f³) of the paper.

    Their virtual work is ``Σ f^i·δd_i``, their moment Σ d_i × f^i. `energy-momentum` applies them as the paper does, at
    the mean directors, including their contribution to the multipliers λ; the other integrators apply only their
    moment.

    Parameters
    ----------
    times : (k,) array, s, strictly increasing; or a function
        ``function(t, directors, angular_velocity) -> (3, 3)``: the rows f^i, N m, from the time, the directors as rows
        and the spatial angular velocity; called like the function of `nontwist.moment`.
    values : (k, 3, 3) array, N m
        The rows f^i at these times, piecewise linear between them and 0 outside. Omit it with a function.
    frame : "space" or "body"
        Components along fixed axes, or along the moving directors: ``f^i = Σ_j values[i, j] d_j``.
    breakpoints : sequence of float, s
        Times at which the function or its derivatives jump. The times of a table are its breakpoints.
    compiled : bool
        Compile the function, as `nontwist.moment` does.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        Shapes are wrong, times do not increase, a number is not finite, `frame` is unknown, the function is a C
        function, or it cannot be compiled.

    Examples
    --------
    A weight of 2 N at the tip of the third director, during one second:

    >>> from nontwist import director_forces, simulate, standard
    >>> weight = [[0, 0, 0], [0, 0, 0], [0, 0, -2]]
    >>> load = director_forces([0, 1], [weight, weight])
    >>> horizontal = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]  # d3 along x
    >>> run = simulate(standard([2, 2, 1]), t_end=1, rotation=horizontal, load=load, integrator="energy-momentum")
    >>> fall = run.directors.sel(director=3, axis="z").values
    >>> bool(abs(run.load_work.sum().item() + 2 * (fall[-1] - fall[0])) < 1e-12)
    True
    """
    if not (callable(times) or is_c_function(times)):
        return made(ForceTable, _values_of("director_forces", values), times, frame)
    if values is not None:
        raise ValueError("director_forces accepts a function, or times and values, not both")
    if is_c_function(times):
        raise ValueError("director_forces accepts a function in Python, which compiled=True compiles; got a C function")
    return of_function(ForceFunction, times, frame, breakpoints=breakpoints, compiled=compiled)


def _moment_of_time(frame: str, times: Any, values: ArrayLike | None, breakpoints: Sequence[float]) -> Load:
    name = f"{frame}_moment"
    if is_c_function(times):
        raise ValueError(f"{name} accepts a function of time in Python; moment(function) accepts a C function")
    if not callable(times):
        if values is None and np.shape(times) == (3,):
            raise ValueError(f"{name} needs times and values, or a function; constant(...) is a moment that lasts")
        return made(Table, frame, times, _values_of(name, values))
    if values is not None:
        raise ValueError(f"{name} accepts a function, or times and values, not both")
    return of_function(Function, frame, times, breakpoints=breakpoints)


def _values_of(name: str, values: ArrayLike | None) -> ArrayLike:
    """Return the values of a table of the load `name`; a ValueError where there are none."""
    if values is None:
        raise ValueError(f"{name} needs the values that belong to its times: {name}(times, values)")
    return values
