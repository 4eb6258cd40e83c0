"""Reduction of arrays to the number of a check."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array
from .checks import Check, Kind


def error(name: str, errors: ArrayLike, tolerance: float, source: str, kind: Kind) -> Check:
    """Return the check that the largest absolute value of `errors` is 0."""
    return Check(name, 0.0, float(np.max(np.abs(errors))), tolerance, source, kind)


def drift(values: Array) -> float:
    """Return the largest change from the first value along the first axis, relative to the largest value."""
    return float(abs(values - values[0]).max() / abs(values).max())


def furthest(values: ArrayLike, expected: float) -> float:
    """Return the one of the `values` that lies furthest from `expected`."""
    flat = np.ravel(np.asarray(values, dtype=np.float64))
    return float(flat[np.argmax(abs(flat - expected))])


def slope(counts: ArrayLike, errors: ArrayLike, expected: float) -> float:
    """Return the order that `errors` show, of runs with `counts` steps, from each to the next: the one furthest off."""
    e, n = np.asarray(errors, dtype=np.float64), np.asarray(counts, dtype=np.float64)
    return furthest(np.log(e[:-1] / e[1:]) / np.log(n[1:] / n[:-1]), expected)


def turns_apart(one: ArrayLike, other: ArrayLike) -> Array:
    """Return the difference of angles, rad, modulo a turn, in [-π, π)."""
    gap: Array = np.remainder(np.asarray(one) - np.asarray(other) + np.pi, 2 * np.pi) - np.pi
    return gap
