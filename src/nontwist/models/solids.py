"""Inertias of point masses and solids, and the parallel axis theorem.

The inertia of a body is determined by its second moment of mass, the Euler inertia (eq-euler-inertia)

    E = ∫ x ⊗ x dm,        J = tr(E) I - E,

with x from the point that J is about. For point masses the integral is a sum. A solid of uniform density that is
symmetric about three planes has a diagonal E at its centre, the mean square of each coordinate times m: a side of
length l gives l²/12, a semi-axis a of an ellipsoid a²/5, the radius R of a disc R²/4 (with a bore r: (R² + r²)/4).
With the centre of mass at r from the point P, ``x = r + y`` and ``∫ y dm = 0``, so

    E_P = E_com + m r ⊗ r,

the parallel axis theorem. E and J add up over the parts of a body: shift each part to one point, add
the parts, subtract the holes. Everything here is a convected inertia J, (3, 3), kg m², in body components.

**The principal frame of an inertia**, with a chosen axis as E3. J is symmetric, so ``J = R diag(values) Rᵀ`` with a
rotation R: its columns are the principal axes in body components. What has the components u in the body has Rᵀ u in the
principal frame. Eigenvectors are not unique, and depend on the library. Here the frame is determined by J and the
choice of its third axis: E3 is a principal axis with a sign, E1 belongs to the smaller of the two other values, E2 = E3
× E1 makes the frame right-handed. Where a value is repeated its axes fill a plane or the space, every direction in it
is principal, and the one nearest to a preferred direction is taken.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_array, as_direction, as_positive, refuse
from ..geometry.values import hinted
from .system import SYMMETRY, checked_inertia, convected_inertia, euler_inertia, require_mass

ON_A_LINE = 1e-14  # second moment across the line through all points, relative to that along it: below is round-off


@hinted
def of_points(
    masses: ArrayLike, positions: ArrayLike, about: ArrayLike | Literal["centre_of_mass"] = (0, 0, 0)
) -> Array:
    """Return the inertia of point masses.

    Parameters
    ----------
    masses : (n,) array, kg
        Not negative.
    positions : (n, 3) array, m
        In body components.
    about : (3,) array, m, or "centre_of_mass"
        The reference point of the inertia, for instance the fixed point of the body.

    Returns
    -------
    (3, 3) array, kg m²
        Points in one plane through `about` form a flat body, with an Euler inertia that is singular across the plane.
        All bodies of the package accept it. Points on one line have no inertia about it: only a body that is held about
        the line accepts it, as `nontwisting` of points along the third axis.

    Raises
    ------
    ValueError
        A mass is negative, all masses are zero, or all points with mass lie at `about`.

    Examples
    --------
    >>> from nontwist import inertia
    >>> inertia.of_points([1, 2], [[0.5, 0, 0], [0, 0.2, 0]]).round(3)
    array([[0.08, 0.  , 0.  ],
           [0.  , 0.25, 0.  ],
           [0.  , 0.  , 0.33]])
    """
    m = as_array(masses, "masses", (None,))
    x = as_array(positions, "positions", (len(m), 3))
    refuse(m < 0, "masses", lambda i: f"must not be negative, got {m[i]:g} kg")
    if not m.any():
        raise ValueError(f"the {len(m)} masses add up to 0 kg: there is no body")
    if isinstance(about, str):
        if about != "centre_of_mass":
            raise ValueError(f"about must be a point (3,) in m or 'centre_of_mass', got {about!r}")
        point = m @ x / m.sum()
    else:
        point = as_array(about, "about", (3,))
    y = np.sqrt(m)[:, None] * (x - point)
    E = y.T @ y
    (_, second, largest), axes = np.linalg.eigh(E)
    if not largest:
        raise ValueError(
            f"all {len(m)} masses lie at {point.tolist()} m and have no inertia about it; give another about="
        )
    return convected_inertia(largest * np.outer(axes[:, 2], axes[:, 2]) if second <= ON_A_LINE * largest else E)


@hinted
def of_cuboid(mass: float, lengths: ArrayLike) -> Array:
    """Return the inertia of a solid cuboid about its centre.

    Parameters
    ----------
    mass : float, kg
        Density times volume, ``lengths[0] * lengths[1] * lengths[2]``.
    lengths : (3,) array, m
        Full edge lengths along the body axes.

    Returns
    -------
    (3, 3) array, kg m²

    Raises
    ------
    ValueError
        The mass or a length is not positive. (A plate is a cuboid of small thickness.)

    Examples
    --------
    A book, which turns over when thrown with a spin about its middle axis:

    >>> from nontwist import inertia
    >>> inertia.of_cuboid(1.2, (0.2, 0.3, 0.04)).diagonal().round(6)
    array([0.00916, 0.00416, 0.013  ])
    """
    m, l = _mass(mass), as_positive(lengths, "lengths", (3,), "m")
    return convected_inertia(np.diag(m * l**2 / 12))


@hinted
def of_cylinder(
    mass: float, radius: float, length: float, *, inner_radius: float = 0.0, axis: ArrayLike = (0, 0, 1)
) -> Array:
    """Return the inertia of a circular cylinder, solid or hollow, about its centre.

    Parameters
    ----------
    mass : float, kg
        Density times volume, ``pi * (radius**2 - inner_radius**2) * length``.
    radius, length : float, m
    inner_radius : float, m
        Radius of the bore; 0 for a solid cylinder.
    axis : (3,) array, or "x", "y", "z", "-x", "-y", "-z"
        Direction of the cylinder in the body, of any length but zero.

    Returns
    -------
    (3, 3) array, kg m²

    Raises
    ------
    ValueError
        Mass, radius or length is not positive, `inner_radius` is not between 0 and `radius`, or `axis` is zero.

    Examples
    --------
    A flywheel with a bore, its axis along z:

    >>> from nontwist import inertia
    >>> inertia.of_cylinder(2.0, 0.1, 0.03, inner_radius=0.08).diagonal().round(6)
    array([0.00835, 0.00835, 0.0164 ])
    """
    m, R = _mass(mass), float(as_positive(radius, "radius", (), "m"))
    L, r = float(as_positive(length, "length", (), "m")), float(as_array(inner_radius, "inner_radius", ()))
    if not 0 <= r < R:
        raise ValueError(f"inner_radius must lie between 0 and radius = {R:g} m, got {r:g} m")
    n = as_direction(axis, "axis")
    along = np.outer(n, n)
    return m * (R**2 + r**2) / 2 * along + m * (3 * (R**2 + r**2) + L**2) / 12 * (np.eye(3) - along)


@hinted
def of_ellipsoid(mass: float, semi_axes: ArrayLike) -> Array:
    """Return the inertia of a solid ellipsoid about its centre.

    Parameters
    ----------
    mass : float, kg
        Density times volume, ``4/3 * pi * semi_axes[0] * semi_axes[1] * semi_axes[2]``.
    semi_axes : (3,) array, m
        Semi-axes along the body axes; for a sphere, three times its radius.

    Returns
    -------
    (3, 3) array, kg m²

    Raises
    ------
    ValueError
        The mass or a semi-axis is not positive.

    Examples
    --------
    A sphere, 2/5 m r²:

    >>> from nontwist import inertia
    >>> inertia.of_ellipsoid(3.0, (0.1, 0.1, 0.1)).diagonal().round(6)
    array([0.012, 0.012, 0.012])
    """
    m, a = _mass(mass), as_positive(semi_axes, "semi_axes", (3,), "m")
    return convected_inertia(np.diag(m * a**2 / 5))


def shift(inertia: ArrayLike, mass: float, offset: ArrayLike, *, to_centre_of_mass: bool = False) -> Array:
    """Return an inertia about another point, by the parallel axis theorem.

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Inertia about the centre of mass; with `to_centre_of_mass`, about the point.
    mass : float, kg
    offset : (3,) array, m
        Vector between the centre of mass and the point, in body components; its sign does not matter.
    to_centre_of_mass : bool
        Shift from the point to the centre of mass instead.

    Returns
    -------
    (3, 3) array, kg m²
        Inertia about the point; with `to_centre_of_mass`, about the centre of mass.

    Raises
    ------
    ValueError
        `inertia` is not an inertia (see `standard`) or is smaller than ``mass |offset|²`` requires, or the mass is not
        positive.

    Examples
    --------
    A hammer about the end of its handle, the handle along z:

    >>> from nontwist import inertia
    >>> handle = inertia.shift(inertia.of_cylinder(0.2, 0.015, 0.3), 0.2, (0, 0, 0.15))
    >>> head = inertia.shift(inertia.of_cuboid(0.5, (0.1, 0.03, 0.03)), 0.5, (0, 0, 0.3))
    >>> (handle + head).diagonal().round(6)
    array([0.051086, 0.051465, 0.000477])
    """
    J, m, r = checked_inertia(inertia), _mass(mass), as_array(offset, "offset", (3,))
    of_the_mass = convected_inertia(m * np.outer(r, r))
    if not to_centre_of_mass:
        return J + of_the_mass
    require_mass(euler_inertia(J), m, r)
    return checked_inertia(J - of_the_mass)  # raises where no inertia remains


def _mass(mass: float) -> float:
    return float(as_positive(mass, "mass", (), "kg"))


Rank = Literal["smallest", "middle", "largest"]
RANKS = get_args(Rank)


def principal_frame(
    inertia: ArrayLike, third: Rank | ArrayLike = "largest", *, physical: bool = True
) -> tuple[Array, Array]:
    """Return the principal values and axes of an inertia, with the chosen axis as the third.

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Convected inertia J, about the fixed point of the body.
    third : "smallest", "middle", "largest" or (3,) array
        Which principal axis becomes E3: by its moment of inertia, or the one nearest to a direction given in body
        components, with the sign of the direction. Of axes equally near, that of the largest moment is chosen.
    physical : bool
        As in `standard`.

    Returns
    -------
    values : (3,) array, kg m²
        Principal moments about E1, E2, E3; ``values[0] <= values[1]``.
    rotation : (3, 3) array
        R with the principal axes E1, E2, E3 as columns in body components, det R = 1: ``R.T @ J @ R`` is the inertia in
        the principal frame, and ``R.T @ u`` gives the components of a vector u. The largest component of E1, and of E3
        unless a direction determines its sign, is positive (the first of equals). If values are equal, to 1e-12 of the
        largest, the axes are projections of body axes: the longest projection, and of equal ones the last for E3, the
        first for E1.

    Raises
    ------
    ValueError
        `inertia` is not an inertia (see `standard`), or `third` is an unknown word or a direction of length 0.

    Notes
    -----
    `nontwisting` requires D3 to be principal. Described in this frame, any body can be made non-twisting about the
    principal axis of choice. With `rotation=R` the original axes are along those of space at the start, as below; their
    attitude in the run is ``rotation(run) * Rotation.from_matrix(R).inv()``.

    Examples
    --------
    >>> from nontwist import nontwisting, simulate
    >>> from nontwist.inertia import principal_frame
    >>> values, R = principal_frame([[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]], third="smallest")
    >>> values.round(6)
    array([3.99845 , 5.136556, 2.864994])
    >>> body = nontwisting(values)  # and with_gravity(body, mass, R.T @ centre_of_mass)
    >>> W = R.T @ [0.3, 1.0, 2.0]  # an angular velocity given along the original axes
    >>> run = simulate(body, t_end=1, rotation=R, material_angular_velocity=W, project=True)
    >>> round(float(abs(run.twist_rate).max()), 9)
    0.0
    """
    J = checked_inertia(inertia, physical)
    values, axes = np.linalg.eigh(J)
    near = SYMMETRY * values[2]
    if isinstance(third, str):
        if third not in RANKS:
            raise ValueError(f"third must be one of {', '.join(RANKS)}, or a direction (3,) in the body; got {third!r}")
        k = RANKS.index(third)
        E3 = _axis(axes[:, abs(values - values[k]) <= near], np.eye(3)[::-1])
    else:
        direction = as_direction(third, "third")
        spaces = [axes[:, abs(values - value) <= near] for value in values[::-1]]
        space = spaces[_first_largest([float(np.linalg.norm(direction @ space)) for space in spaces])]
        E3 = _axis(space, direction[None])
        E3 = -E3 if E3 @ direction < 0 else E3
    plane = np.linalg.svd(E3[None])[2][1:]
    two, turn = np.linalg.eigh(plane @ J @ plane.T)
    E1 = _axis(plane.T @ turn[:, two - two[0] <= near], np.eye(3))
    R = np.stack([E1, np.cross(E3, E1), E3], axis=1) + 0.0
    moments: Array = np.einsum("ik,ij,jk->k", R, J, R)
    return moments, R


def _axis(space: Array, preferred: Array) -> Array:
    """Return the only axis in `space` (columns), with a definite sign, or the projection of a `preferred` direction."""
    if space.shape[1] == 1:
        n: Array = space[:, 0]
        return n if n[_first_largest(abs(n))] > 0 else -n
    projections = preferred @ space @ space.T
    n = projections[_first_largest(np.linalg.norm(projections, axis=1))]
    return n / np.linalg.norm(n)


def _first_largest(sizes: ArrayLike) -> int:
    """Index of the largest, of those equal to round-off the first."""
    sizes = np.asarray(sizes)
    return int(np.argmax(sizes >= sizes.max() * (1 - 1e-9)))
