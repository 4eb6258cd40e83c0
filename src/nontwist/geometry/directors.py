"""Validation of sampled directors: unit vectors, the first d1 chosen or made orthogonal."""

from __future__ import annotations

import math
import warnings

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arrays import Array, as_floats, require_finite

# Largest deviation of directors from unit length; they are normalised to round-off.
TOLERANCE = 1e-9


def vectors(value: ArrayLike, name: str) -> Array:
    """Return `value` as a new array (..., n, 3) with n >= 1; a ValueError for any other shape."""
    array = as_floats(value, name)
    if array.ndim < 2 or array.shape[-1] != 3 or array.shape[-2] == 0:
        raise ValueError(f"{name} must have the shape (..., n, 3) with n >= 1, got {array.shape}")
    return array


def in_range(points: Array) -> Array:
    """Return points (m, n, 3), those of each member over a power of two, so that squares of distances are floats."""
    exponent = np.frexp(np.abs(points).max(axis=(1, 2), keepdims=True))[1]
    found: Array = np.ldexp(points, -exponent)
    return found


def places(lead: tuple[int, ...], member: int, *samples: int) -> list[str]:
    """Index of `samples` in the argument of the caller, ``[member indices, sample]``."""
    front = [str(int(i)) for i in np.unravel_index(member, lead)] if lead else []
    return ["[" + ", ".join([*front, str(int(i))]) + "]" for i in samples]


def unit_directors(d3: ArrayLike, name: str = "d3", tolerance: float = TOLERANCE) -> tuple[Array, tuple[int, ...]]:
    """Check that `d3` (..., n, 3) are unit vectors and make them so to round-off.

    Returns
    -------
    (m, n, 3) array and the leading axes, whose product is m.

    Raises
    ------
    ValueError
        Another shape; an entry that is not finite or a vector that is not of unit length (the message names its index).
    """
    array = vectors(d3, name)
    lead = array.shape[:-2]
    u = array.reshape(-1, *array.shape[-2:])
    x, y, z = np.moveaxis(u, -1, 0)
    size = np.sqrt(x * x + y * y + z * z)
    is_wrong = ~(np.abs(size - 1.0) <= tolerance)  # not a number is wrong as well
    if is_wrong.any():
        k, i = np.argwhere(is_wrong)[0].tolist()
        require_finite(array, name)
        (at,) = places(lead, k, i)
        raise ValueError(f"{name}{at} must be a unit vector, its length is {math.hypot(*u[k, i]):.12g}")
    u /= size[..., None]
    return u, lead


def first_d1(d1: ArrayLike | None, first: Array, lead: tuple[int, ...]) -> Array:
    """Return unit vectors (m, 3) orthogonal to `first` (m, 3), from `d1` (..., 3) or the coordinate axes, projected.

    Without `d1`: the coordinate axis least aligned with the first director (the first of equals), projected; so
    d3 = (0, 0, 1) has d1 = (1, 0, 0), d2 = (0, 1, 0).
    """
    if d1 is None:
        preferred = np.eye(3)[np.argmin(np.abs(first), axis=1)]
    else:
        given = as_floats(d1, "d1")
        try:
            preferred = np.broadcast_to(given, (*lead, 3)).reshape(-1, 3)
        except ValueError as error:
            raise ValueError(f"d1 must be one vector, or one for each member: shape {(*lead, 3)}") from error
        require_finite(given, "d1")
        largest = np.abs(preferred).max(axis=1, keepdims=True)
        preferred = preferred / np.where(largest > 0.0, largest, 1.0)
    start = preferred
    for _ in range(2):  # the second time removes the round-off of the first
        start = start - np.sum(start * first, axis=1, keepdims=True) * first
    size = np.linalg.norm(start, axis=1, keepdims=True)
    bad = np.flatnonzero(size[:, 0] <= 1e-8 * np.linalg.norm(preferred, axis=1))
    if bad.size:
        member = [int(i) for i in np.unravel_index(bad[0], lead)] if lead else ""
        raise ValueError(f"d1{member} must not be zero or parallel to the first director")
    start /= size
    start -= np.sum(start * first, axis=1, keepdims=True) * first
    found: Array = start / np.linalg.norm(start, axis=1, keepdims=True)
    return found


def triad_about(n: Array) -> Array:
    """Return the triad (3, 3), rows, with the third director n and the first of `first_d1`."""
    e1 = first_d1(None, n[None], ())[0]
    return np.stack([e1, np.cross(n, e1), n])


def transported(
    u: Array, lead: tuple[int, ...], d1: ArrayLike | None, rolls: tuple[Array, NDArray[np.int64]], period: int
) -> Array:
    """Frames (m, n, 3, 3) along the unit directors `u` (m, n, 3); warn of wide steps, refuse antipodal ones.

    Messages count samples modulo `period`, so that the closing side of a polygon ends at sample 0.
    """
    from .frame_kernels import transport

    frames = np.empty((*u.shape, 3))
    k, a, b, wide_k, wide = transport(u, first_d1(d1, u[:, 0], lead), *rolls, frames)
    if k >= 0:
        one, other = places(lead, k, a % period, b % period)
        raise ValueError(f"d3{one} and d3{other} are antipodal: the shortest path between them is not unique")
    if wide >= 0:
        (at,) = places(lead, wide_k, wide % period)
        message = f"d3{at} is more than a right angle from the sample before it: the path between the two is a guess"
        warnings.warn(message, stacklevel=3)
    return frames


def shaped(values: Array, lead: tuple[int, ...]) -> float | Array:
    """One value for each member: a float where there are no leading axes."""
    return values.reshape(lead) if lead else float(values[0])
