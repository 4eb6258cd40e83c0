"""The principal frame of an inertia, with a chosen axis as E3.

J is symmetric, so ``J = R diag(values) Rᵀ`` with a rotation R: its columns are the principal axes in body components.
What has the components u in the body has Rᵀ u in the principal frame. Eigenvectors are not unique, and depend
on the library. Here the frame is determined by J and the choice of its third axis: E3 is a
principal axis with a sign, E1 belongs to the smaller of the two other values, E2 = E3 × E1 makes the frame
right-handed. Where a value is repeated its axes fill a plane or the space, every direction in it is principal, and the
one nearest to a preferred direction is taken.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_array
from .system import SYMMETRY, checked_inertia

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
        direction = as_array(third, "third", (3,))
        if not direction.any():
            raise ValueError("third is zero: it must be a direction in the body")
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
