"""Does an orientation map sensor to earth or earth to sensor? Columns of a gyroscope or an accelerometer may tell.

Let Λ map sensor to earth. The gyroscope measures w = vee(Λᵀ Λ') in the sensor; of the inverse Λᵀ the same formula gives
vee(Λ Λ'ᵀ) = -Λ w. The cosine between what is computed and what was measured, over the whole recording, tells which of
the two is meant, whatever the unit. A gyroscope knows no earth, so nothing is to be assumed of its axes.

The angular velocity in space, w_s = vee(Λ' Λᵀ), that motion capture states of its segments is told apart likewise: -w_s
is what a gyroscope on the inverse Λᵀ would measure.

An accelerometer measures the specific force, on average g upwards: Λ a has a constant direction in space, Λᵀ a has not
if the sensor tilts about more than the vertical. Its test is the length of the mean of the unit vectors.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from .headers import ACCELEROMETER, GYROSCOPE, three_axes
from .time_values import numbers

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

AGREES, MARGIN = 0.7, 0.3  # cosine of a convention that fits the gyroscope, and by how much the other fits worse
ORDER, APART = 0.9, 0.15  # the same for the place of the scalar: a wrong one permutes the components
STEADY, TILTS = 0.97, 0.05  # length of the mean direction of gravity, and how much shorter the other must be
FEWEST = 10  # rows that tell anything


def vectors(columns: Mapping[str, NDArray[np.generic]], names: tuple[str, ...]) -> Array | None:
    """Return the (n, 3) columns whose names are one of `names` and x, y, z, or None."""
    for _, three in three_axes(list(columns), names)[:1]:
        try:
            return np.stack([numbers(columns, header) for header in three], axis=1)
        except ValueError:
            return None
    return None


def gyroscope_cosines(R: Rotation, measured: Array) -> tuple[float, float]:
    """Return the cosines between the gyroscope and the angular velocity of R, and of its inverse."""
    turned = (R[:-1].inv() * R[1:]).as_rotvec()
    back = -R[:-1].apply(turned)
    between = (measured[1:] + measured[:-1]) / 2

    def cosine(a: Array) -> float:
        size = np.linalg.norm(a) * np.linalg.norm(between)
        return float((a * between).sum() / size) if size > 0 else 0.0

    return cosine(turned), cosine(back)


def gravity_lengths(R: Rotation, measured: Array) -> tuple[float, float]:
    """Return the lengths of the mean direction of gravity in space, by R and by its inverse."""
    up = measured / np.maximum(np.linalg.norm(measured, axis=1, keepdims=True), 1e-300)
    one, other = (float(np.linalg.norm(S.apply(up).mean(axis=0))) for S in (R, R.inv()))
    return one, other


def verdict(
    quat: Array, columns: Mapping[str, NDArray[np.generic]], spin: Array | None = None
) -> tuple[bool | None, str]:
    """Return whether (n, 4) quaternions look inverted, and what says so.

    None where neither the columns nor `spin`, the (n, 3) angular velocity in space, tell.
    """
    inverse = quat * [-1, -1, -1, 1]
    for what, attitudes, measured in (
        ("agreement with the gyroscope", quat, vectors(columns, GYROSCOPE)),
        ("agreement with the angular velocity", inverse, None if spin is None else -spin),
        ("steadiness of gravity", quat, vectors(columns, ACCELEROMETER)),
    ):
        if measured is None:
            continue
        good = np.isfinite(measured).all(axis=1) & np.isfinite(quat).all(axis=1) & quat.any(axis=1)
        if good.sum() < FEWEST:
            continue
        from scipy.spatial.transform import Rotation

        turns = what.startswith("agreement")
        test, level, margin = (gyroscope_cosines, AGREES, MARGIN) if turns else (gravity_lengths, STEADY, TILTS)
        one, other = test(Rotation.from_quat(attitudes[good]), measured[good])
        if max(one, other) >= level and abs(one - other) >= margin:
            return other > one, f"{what} {one:.2f} as it is, {other:.2f} inverted"
    return None, ""


def scalar_by_values(values: Array, columns: Mapping[str, NDArray[np.generic]]) -> tuple[bool | None, str]:
    """Return whether the scalar of quaternions comes first, where the gyroscope agrees with one order only."""
    measured = vectors(columns, GYROSCOPE)
    if measured is None or len(values) < FEWEST:
        return None, ""
    from scipy.spatial.transform import Rotation

    good = np.isfinite(measured).all(axis=1) & np.isfinite(values).all(axis=1) & values.any(axis=1)
    if good.sum() < FEWEST:
        return None, ""
    best = {}
    for first in (True, False):
        quat = np.roll(values, -1, axis=1) if first else values
        best[first] = max(gyroscope_cosines(Rotation.from_quat(quat[good]), measured[good]))
    if max(best.values()) >= ORDER and abs(best[True] - best[False]) >= APART:
        return best[True] > best[False], "by the gyroscope"
    return None, ""
