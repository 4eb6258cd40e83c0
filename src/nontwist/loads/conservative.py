"""The loads that have a potential: each a function that returns a `Load`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_array, as_floats, as_number
from ..geometry.values import as_function, short_repr
from .kinds import made, of_function
from .load import Load
from .potentials import MOST_VECTORS, GravityGradient, PotentialFunction, Quadratic, Spring

# Of a central difference, over |γ|; of its error; states that are tried.
DIFFERENCE, SLACK, SAMPLES = 1e-5, 1e-6, 5


def potential(
    vectors: ArrayLike,
    function: Callable[[Array], float] | None = None,
    gradient: Callable[[Array], ArrayLike] | None = None,
    *,
    linear: ArrayLike | None = None,
    quadratic: ArrayLike | None = None,
    compiled: bool = False,
) -> Load:
    """Return a potential V of vectors a fixed in space, as a function of their body components γ = Λᵀa.

    Its forces on the directors are ``-a ∂V/∂γ_j``, its moment is ``Λ (γ × ∂V/∂γ)``. V is part of the energy of a run,
    not of the work of its load. `lie-midpoint` and `energy-momentum` use discrete gradients: they conserve K + V and,
    for a body without constraint, the momentum along a if all vectors are parallel. `gauss` conserves both if V is
    given by coefficients, and K + V of other potentials to its order. `split` and `continuous` conserve them to their
    orders.

    Parameters
    ----------
    vectors : (3,) array, or (k, 3) with k up to 4
        Vectors a in space, in the unit of V divided by that of the coefficients.
    function : callable
        ``function(gamma) -> V``, J, with gamma of the shape of `vectors`. V is also evaluated between the attitudes of
        a step, where |γ| is smaller than |a|.
    gradient : callable
        ``gradient(gamma)``: the derivatives of V with respect to gamma, of its shape.
    linear : (3,) or (k, 3) array
        l of ``V = Σ l·γ``, with or without `quadratic`.
    quadratic : (3, 3) or (k, 3, 3) array
        Q, symmetric, of ``V = Σ ½ γ·Qγ``.
    compiled : bool
        Compile function and gradient, as `nontwist.moment` does.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        Shapes are wrong, Q is not symmetric, neither functions nor coefficients are given, V is not finite, the
        gradient is not that of the function, or they cannot be compiled.

    Examples
    --------
    A body that aligns itself with a line, whichever end is up, V = -c/2 (d3·e)²:

    >>> from nontwist import potential, simulate, standard
    >>> line = potential((0, 0, 1), quadratic=[[0, 0, 0], [0, 0, 0], [0, 0, -3]])
    >>> body, W = standard([3, 4, 5]), (1, 2, 0.5)
    >>> run = simulate(body, t_end=10, step=0.1, load=line, material_angular_velocity=W)
    >>> energy = (run.kinetic_energy + run.potential_energy).values
    >>> bool(abs(energy - energy[0]).max() < 1e-12)
    True
    """
    a = as_floats(vectors, "vectors")
    single = a.ndim == 1
    a = as_array(a[None] if single else a, "vectors", (None, 3))
    if not 1 <= len(a) <= MOST_VECTORS:
        raise ValueError(f"vectors must be 1 to {MOST_VECTORS} vectors, got {len(a)}; add potentials of fewer vectors")
    by_function, by_numbers = function is not None or gradient is not None, linear is not None or quadratic is not None
    if by_function == by_numbers:
        raise ValueError("potential needs function= and gradient=, or coefficients: linear=, quadratic=")
    if by_numbers:
        k = len(a)
        lines, Q = _of_each(linear, "linear", (k, 3)), _of_each(quadratic, "quadratic", (k, 3, 3))
        return Load(tuple(Quadratic(linear=lines[i], quadratic=Q[i], vector=a[i]) for i in range(k)))
    if function is None or gradient is None:
        given = f"; {short_repr(function)} is no function" if function is not None and not callable(function) else ""
        raise ValueError(
            f"potential needs both: function= gives V, gradient= its derivatives by γ{given}; coefficients are "
            "given by name, linear= and quadratic="
        )
    functions = as_function(function, "function"), as_function(gradient, "gradient")
    _require_gradient(PotentialFunction(*functions, a, single, compiled=False))
    return of_function(PotentialFunction, *functions, a, single, compiled=compiled)


def spring(stiffness: float, point: ArrayLike, anchor: ArrayLike, rest_length: float = 0.0) -> Load:
    """Return a spring between a point of the body and a point of space, ``V = ½ k (ℓ - L)²``.

    With rest length 0 it is a dead force on the directors, and every integrator treats it as one.

    Parameters
    ----------
    stiffness : float, N/m
    point : (3,) array, m
        From the fixed point, in body components.
    anchor : (3,) array, m
        From the fixed point, in space.
    rest_length : float, m

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        The stiffness is not positive, the rest length is negative, or a number is not finite.

    Examples
    --------
    >>> from nontwist import simulate, spring, standard
    >>> load = spring(20, point=(0, 0, 1), anchor=(1, 0, 1), rest_length=0.8)
    >>> run = simulate(standard([2, 2, 1]), t_end=5, step=0.01, load=load, integrator="lie-midpoint")
    >>> energy = (run.kinetic_energy + run.potential_energy).values
    >>> bool(abs(energy - energy[0]).max() < 1e-13)
    True
    """
    return made(Spring, stiffness, point, anchor, rest_length)


def dipole(moment: ArrayLike, field: ArrayLike) -> Load:
    """Return a dipole of the body in a uniform field, ``V = -(Λ m)·B``: a dead force.

    Parameters
    ----------
    moment : (3,) array, A m² or C m
        m, in body components.
    field : (3,) array, T or V/m
        B, in space.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        A shape is wrong, or a number is not finite.

    Examples
    --------
    The energy of a compass needle aligned with the field:

    >>> from nontwist import dipole, standard
    >>> load = dipole((0, 0, 2), field=(0, 0, 3))
    >>> load.potential_energy([[1, 0, 0], [0, 1, 0], [0, 0, 1]]).item()
    -6.0
    """
    m, B = as_array(moment, "moment", (3,)), as_array(field, "field", (3,))
    return Quadratic(linear=-m, vector=B).load


def gravity_gradient(
    mean_motion: float,
    radial: ArrayLike = (1, 0, 0),
    normal: ArrayLike = (0, 0, 1),
    start: float = 0.0,
    *,
    eccentricity: float = 0.0,
    perigee_time: float | None = None,
) -> Load:
    """Return the gravity gradient on an orbit, ``V = (3/2) (GM/r³) c·Jc``, with the body moment ``3 (GM/r³) c × Jc``.

    c = Λᵀ r/|r| is the direction from the centre of the earth, and r moves about it counter-clockwise as seen from the
    normal o of the orbit. J is the inertia of the body of the run, here about the centre of mass. K + V is not
    conserved. On a circular orbit GM/r³ is n², and for a body without constraint and other loads ``K + V - n o·π`` is
    conserved: by `gauss` exactly at every order, in axes that turn with the orbit, by the other integrators, and by
    `gauss` with further loads, to their order. On an ellipse nothing but orthonormality is conserved.

    Parameters
    ----------
    mean_motion : float, rad/s
        n; along an orbit of major half-axis a about a planet of gravitational parameter GM, n² = GM/a³.
    radial : (3,) array
        Direction of r at the time `start`, in space; of an ellipse that of perigee.
    normal : (3,) array
        Direction of o, orthogonal to `radial`.
    start : float, s
    eccentricity : float
        e, at least 0 and below 1. Kepler's equation is solved to round-off at every evaluation.
    perigee_time : float, s, optional
        Another name of `start`, for ellipses.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        The mean motion is not positive, a direction has length 0, the directions are not orthogonal, the eccentricity
        is not at least 0 and below 1, or both `start` and `perigee_time` are given.

    Examples
    --------
    A satellite whose long axis points at the earth, and that turns with the orbit, keeps pointing at the earth:

    >>> import numpy as np
    >>> from nontwist import gravity_gradient, simulate, standard
    >>> n = 1.1e-3
    >>> satellite, start = standard([20, 80, 90]), {"angular_velocity": (0, 0, n)}
    >>> orbit = 2 * np.pi / n
    >>> run = simulate(satellite, t_end=orbit, step=orbit / 100, load=gravity_gradient(n), **start)
    >>> run.directors.sel(director=1).values[-1].round(6) + 0.0  # after one orbit
    array([1., 0., 0.])

    On an ellipse the radius does not turn evenly, and the satellite librates:

    >>> run = simulate(satellite, t_end=2 * orbit, load=gravity_gradient(n, eccentricity=0.02), **start)
    >>> rate = run.angular_velocity.sel(axis="z") / n
    >>> round(rate.min().item(), 2), round(rate.max().item(), 2)
    (0.85, 1.16)
    """
    if perigee_time is not None:
        if as_number(start, "start"):
            raise ValueError("start and perigee_time are one time: give one of them")
        start = as_number(perigee_time, "perigee_time")
    return made(GravityGradient, mean_motion, radial, normal, start, eccentricity)


def _of_each(value: ArrayLike | None, name: str, shape: tuple[int, ...]) -> Array:
    """Return coefficients of all vectors, zeros where there are none; those of one may come without its axis."""
    if value is None:
        return np.zeros(shape)
    given = as_floats(value, name)
    return as_array(given[None] if shape[0] == 1 and given.ndim == len(shape) - 1 else given, name, shape)


def _require_gradient(term: PotentialFunction) -> None:
    """Raise a ValueError where V is not finite, or where its gradient contradicts central differences of it."""
    rng = np.random.default_rng(0)
    for _ in range(SAMPLES):
        R = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        gamma = term.vectors @ (R * np.sign(np.linalg.det(R)))
        slope, level = term.slope(gamma), abs(term.value(gamma))
        e = DIFFERENCE * float(abs(gamma).max() or 1.0)
        steps = np.eye(gamma.size).reshape(-1, *gamma.shape) * e
        ahead, behind = term.value(gamma + steps), term.value(gamma - steps)
        found = ((ahead - behind) / (2 * e)).reshape(gamma.shape)
        size = max(abs(slope).max(), abs(found).max())
        noise = SLACK * size + 1e-15 * float(level + abs(ahead).max() + abs(behind).max()) / e
        if (gap := abs(found - slope)).max() > noise:
            v, j = np.unravel_index(int(gap.argmax()), gap.shape)
            raise ValueError(
                f"gradient contradicts function: at γ = {gamma.tolist()} the derivative of V by component {j} of "
                f"vector {v} is {found[v, j]:.9g} by central differences, but gradient gives {slope[v, j]:.9g}"
            )
