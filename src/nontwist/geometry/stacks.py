"""Stacks of vectors, matrices and angles: leading axes, lengths, angles between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, as_array, refuse

TOLERANCE = 1e-9  # departure from unit length, tangency or orthogonality up to which an argument is accepted
EPS = float(np.finfo(np.float64).eps)
TINY = float(np.finfo(np.float64).tiny)


def stack(value: ArrayLike, name: str, tail: tuple[int, ...]) -> Array:
    """Return `value` as finite floats of the shape (..., *tail), with any number of leading axes."""
    return as_array(value, name, (..., *tail), np.inf)


def unit_vectors(value: ArrayLike, name: str) -> Array:
    """Return `value` (..., 3) as floats; ValueError where it is not a unit vector."""
    d = stack(value, name, (3,))
    refuse(np.abs(norm(d) - 1.0) > TOLERANCE, name, "is not a unit vector")
    return d


def norm(v: Array) -> Array:
    """Length of the vectors `v` (..., 3), accurate also where their squares overflow or underflow."""
    with np.errstate(over="ignore"):
        return np.asarray(np.hypot(np.hypot(v[..., 0], v[..., 1]), v[..., 2]))


def dot(a: Array, b: Array) -> Array:
    """Scalar product of the vectors `a` and `b` (..., 3)."""
    return np.asarray((a * b).sum(axis=-1))


def arcs(d: Array) -> Array:
    """Angles between neighbouring unit vectors (n, 3), rad."""
    chord = np.linalg.norm(np.diff(d, axis=0), axis=1)
    return np.asarray(2 * np.arcsin(np.minimum(chord / 2, 1.0)))


def principal_angle(angle: ArrayLike) -> Array:
    """Return `angle`, rad, modulo 2π in (-π, π]."""
    full = np.asarray(angle, dtype=np.float64)
    rest = full - 2 * np.pi * np.rint(full / (2 * np.pi))
    return np.where(rest <= -np.pi, np.pi, rest)


def ratio(a: Array, b: Array, at_zero: float) -> Array:
    """Quotient a/b, `at_zero` where b = 0."""
    return np.asarray(np.divide(a, b, out=np.full(np.broadcast(a, b).shape, at_zero), where=b != 0.0))
