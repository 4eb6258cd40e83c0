"""Angles that depend on a path alone.

**Montgomery 1991.** When the momentum of a free standard body has gone once around its curve in the body, in the time
T, the body has turned about the momentum, fixed in space, by

    Δψ = 2 K T/|π| - Ω     (mod 2π, right-handed),

Ω the solid angle of the closed curve Π/|Π|, counter-clockwise positive. In the closed solution of `free_bodies`, T = 4
K(k)/|λ| and Δψ is what ψ gains in it; the periodic part of ψ drops out.

**Non-twisting frames** (subs-non-twisting-frame) transported once around a closed curve on the sphere turn by its solid
angle: on the circle of colatitude θ by 2π (1 - cos θ); around a geodesic polygon by 2π less the sum of its exterior
angles (Girard, Gauss–Bonnet).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_array, principal_angle, unit_vectors
from ..models.system import checked_inertia
from .free_bodies import checked_velocity, momentum_cycle

_SHORT = 1e-12


def montgomery_angle(inertia: ArrayLike, material_angular_velocity: ArrayLike, *, physical: bool = True) -> float:
    """Return the angle by which a free standard body turns about its momentum in one `momentum_period`.

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
    material_angular_velocity : (3,) array, rad/s
        W at any point of the motion.
    physical : bool
        As in `nontwist.standard`.

    Returns
    -------
    float, rad, in (-π, π]
        2 K T/|π| - Ω (Montgomery 1991), right-handed about π. For a steady rotation about the axis of the smallest or
        the largest moment, the limit of small circles. Accuracy: a few ulp of 2 K T/|π| times the condition number of
        the problem.

    Raises
    ------
    ValueError
        As `free_standard`; or the momentum never returns, see `momentum_period`.

    Examples
    --------
    >>> from nontwist import exact, rotation
    >>> J, W = (3, 4, 5), (0.1, 2, 0.1)
    >>> round(exact.montgomery_angle(J, W), 6)
    2.457833

    The same from the attitude after one period of the momentum:

    >>> attitude, _ = exact.free_standard(J, W, [exact.momentum_period(J, W)])
    >>> rotation(attitude).magnitude().round(6)
    array([2.457833])
    """
    _, angle = _period(inertia, material_angular_velocity, physical)
    return float(principal_angle(angle))


def momentum_period(inertia: ArrayLike, material_angular_velocity: ArrayLike, *, physical: bool = True) -> float:
    """Return the period T = 4 K(k)/|λ|, s, of the momentum in the body (Landau & Lifshitz §37).

    Parameters
    ----------
    inertia, material_angular_velocity, physical
        As in `montgomery_angle`.

    Returns
    -------
    float, s
        Accuracy as in `montgomery_angle`.

    Raises
    ------
    ValueError
        As `free_standard`; or the momentum never returns: at rest, on the separatrix and the middle axis, and where it
        is constant because two moments are equal.

    Examples
    --------
    >>> from nontwist import exact
    >>> J, W = (3, 4, 5), (0.1, 2, 0.1)
    >>> T = exact.momentum_period(J, W)
    >>> round(T, 6)
    33.877768
    >>> exact.free_standard(J, W, [T])[1].round(9)
    array([[0.1, 2. , 0.1]])
    """
    return _period(inertia, material_angular_velocity, physical)[0]


def latitude_turn(colatitude: ArrayLike) -> Array:
    """Return the angle 2π (1 - cos θ), rad, by which a non-twisting frame turns on a circle of latitude.

    d3 moves once around the circle, counter-clockwise about the pole θ = 0 seen from outside. The angle is in [0, 4π],
    not reduced modulo 2π.

    Parameters
    ----------
    colatitude : float or array, rad
        θ, from 0 to π.

    Returns
    -------
    array, rad
        With the shape of `colatitude`. Accuracy: round-off (computed as 4π sin²(θ/2)).

    Raises
    ------
    ValueError
        An angle is outside [0, π].

    Examples
    --------
    Foucault's pendulum in Paris, at 48.85° north, transported around once a day:

    >>> import numpy as np
    >>> from nontwist import exact
    >>> turn = np.degrees(exact.latitude_turn(np.radians(90 - 48.85)))
    >>> round(float(turn) - 360, 2)  # seen from the ground, which turns by 360°
    -271.08
    """
    theta = as_array(colatitude, "colatitude", (...,))
    if np.any((theta < 0) | (theta > math.pi)):
        raise ValueError(f"colatitude must lie between 0 and pi, got {theta.tolist()}")
    return np.asarray(4 * math.pi * np.sin(theta / 2) ** 2)


def polygon_turn(vertices: ArrayLike) -> float:
    """Return the angle, rad, by which a non-twisting frame turns as d3 moves once around a geodesic polygon.

    Parameters
    ----------
    vertices : (n, 3) array
        Unit vectors; the last is joined to the first by the shorter arc of a great circle. Sides may cross.

    Returns
    -------
    float
        In (-π, π]: the enclosed solid angle modulo 2π, counter-clockwise positive, from the exterior angles
        (Gauss–Bonnet). Accuracy: round-off divided by the length of the shortest side.

    Raises
    ------
    ValueError
        There are fewer than 2 vertices, they are not unit vectors, or neighbours coincide or are antipodal.

    Examples
    --------
    A right angle around an octant of the sphere:

    >>> import numpy as np
    >>> from nontwist import exact
    >>> round(np.degrees(exact.polygon_turn([[1, 0, 0], [0, 1, 0], [0, 0, 1]])).item(), 9)
    90.0
    """
    u = unit_vectors(as_array(vertices, "vertices", (None, 3)), "vertices")
    if len(u) < 2:
        raise ValueError(f"a polygon needs at least 2 vertices, got {len(u)}")
    normal = np.cross(u, np.roll(u, -1, axis=0))  # of the side from i to i + 1
    length = np.linalg.norm(normal, axis=1)
    if length.min() < _SHORT:
        k = int(np.argmin(length))
        raise ValueError(f"vertices[{k}] and vertices[{(k + 1) % len(u)}] coincide or are antipodal")
    before = np.roll(normal, 1, axis=0)
    sines, cosines = np.sum(u * np.cross(before, normal), axis=1), np.sum(before * normal, axis=1)
    return float(principal_angle(-np.arctan2(sines, cosines).sum()))


def _period(inertia: ArrayLike, material_angular_velocity: ArrayLike, physical: bool) -> tuple[float, float]:
    J, W = checked_inertia(inertia, physical), checked_velocity(material_angular_velocity)
    T, angle = momentum_cycle(J, W)
    if not math.isfinite(T):
        raise ValueError(f"the momentum of this motion never returns in the body: W = {W.tolist()} rad/s")
    return T, angle
