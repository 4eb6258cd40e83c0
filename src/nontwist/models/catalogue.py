"""The bodies of the package: each a function that returns a `DirectorSystem`.

Gravity acts on the centre of mass ``r = Σ ρ_i d_i`` with ρ in body components, so its potential ``-m g·r`` is linear
in the directors and its director forces ``f^i = m ρ_i g`` are constant: a dead force.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_array, as_positive
from .system import DirectorSystem, convected_inertia, euler_inertia, require_principal, require_room

D3 = np.array([0.0, 0.0, 1.0])


def standard(inertia: ArrayLike) -> DirectorSystem:
    """Return the standard rigid body with a fixed point, free to turn (eq-standard, eq_weak_form_rigid_body).

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Convected inertia J about the fixed point, in body components.

    Returns
    -------
    DirectorSystem

    Raises
    ------
    ValueError
        `inertia` is not (3, 3) or (3,), not finite, not symmetric (beyond 1e-12 relative), not positive definite, or
        violates the triangle inequality (beyond 1e-9 tr J: plates and rods are bodies).
    """
    return DirectorSystem(euler_inertia(inertia), name="standard")


def nontwisting(inertia: ArrayLike) -> DirectorSystem:
    """Return the body on a non-twisting frame (eq-nonholonomic, eq_weak_form_rigid_body_alternative).

    The body may not turn about its own third director: ``w·d3 = 0``.

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Convected inertia J about the fixed point; D3 must be a principal direction (eq-irho-decomp).

    Returns
    -------
    DirectorSystem

    Raises
    ------
    ValueError
        As `standard`; and when D3 is not principal beyond 1e-9 relative (`suslov` takes such a body).
    """
    E = euler_inertia(inertia)
    require_principal(convected_inertia(E), D3)
    E[:2, 2] = E[2, :2] = 0.0
    return DirectorSystem(E, D3, name="nontwisting")


def suslov(inertia: ArrayLike, axis: ArrayLike) -> DirectorSystem:
    """Return the Suslov body: it may not turn about a body axis, principal or not.

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Convected inertia J about the fixed point.
    axis : (3,) array
        The blocked axis n in body components, any length but zero: ``W·n = 0``.

    Returns
    -------
    DirectorSystem

    Raises
    ------
    ValueError
        As `standard`; and when `axis` is zero or not finite.
    """
    return DirectorSystem(euler_inertia(inertia), as_array(axis, "axis", (3,)), name="suslov")


def heavy_top(
    inertia: ArrayLike, mass: float, centre_of_mass: ArrayLike, gravity: ArrayLike = (0, 0, -9.81)
) -> DirectorSystem:
    """Return the heavy top: a standard body under gravity.

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Convected inertia J about the **fixed point** (not the centre of mass).
    mass : float, kg
    centre_of_mass : (3,) array, m
        From the fixed point, in body components.
    gravity : (3,) array, m/s²
        In space.

    Returns
    -------
    DirectorSystem

    Raises
    ------
    ValueError
        As `standard` and `with_gravity`.
    """
    return replace(with_gravity(standard(inertia), mass, centre_of_mass, gravity), name="heavy_top")


def with_gravity(
    system: DirectorSystem, mass: float, centre_of_mass: ArrayLike, gravity: ArrayLike = (0, 0, -9.81)
) -> DirectorSystem:
    """Return `system` under gravity, for every body; other dead forces stay.

    Parameters
    ----------
    system : DirectorSystem
    mass : float, kg
    centre_of_mass : (3,) array, m
        From the fixed point, in body components.
    gravity : (3,) array, m/s²
        In space.

    Returns
    -------
    DirectorSystem

    Raises
    ------
    ValueError
        Mass not positive or not finite, or an inertia smaller than ``mass |centre_of_mass|²`` requires.
    """
    m = float(as_positive(mass, "mass", (), "kg"))
    rho, g = as_array(centre_of_mass, "centre_of_mass", (3,)), as_array(gravity, "gravity", (3,))
    require_room(system.euler_inertia, m, rho)
    force: Array = system.dead_force + m * np.outer(rho, g)
    return replace(system, dead_force=force, name=f"{system.name} under gravity")
