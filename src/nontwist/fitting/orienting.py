r"""Recorded orientation: unit quaternions in the state, residuals as rotation vectors, angular velocity to start from.

An attitude Λ, body to space, is a unit quaternion q = (v, w), and ``q' = ½ q (W, 0)`` is quadratic in the state
(`bodies`):

    v' = ½ (w W + v × W) ,     w' = -½ v·W .

The inertia is in recorded attitudes by W alone. The frame of the recording is arbitrary, as the first attitude of each
is fitted. A recorded attitude is ``Λ exp(φ̂)``, and φ, a rotation vector in body components, is its residual. Where the
model turns by δ, to ``Λ exp(δ̂)``, this becomes φ - T δ with

    T = 1 - ½ φ̂ + φ̂²/12 + O(|φ|⁴) ,     δ = 2 vec(q̄ ∂q) .

q and -q are one attitude. Those of a recording are chosen so that neighbours are close, as those of a motion are.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..geometry.attitudes import without_jumps
from ..geometry.tensors import LEVI
from .quality import noise_of, scatter_of

ARC, FEWEST = 0.4, 4  # rad to each side of a sample, and samples, whose attitudes give its angular velocity
FINE = 1e-9  # rad: noise at least


def finite_rows(quaternions: Array) -> NDArray[np.intp]:
    """Return the rows in which there is an attitude."""
    return np.flatnonzero(np.isfinite(quaternions).all(axis=1))


def continuous(quaternions: Array) -> Array:
    """Return quaternions of either sign so that each is close to the one before."""
    found = np.array(quaternions)
    good = finite_rows(found)
    found[good] = without_jumps(found[good])
    return found


def derived_rates(time: Array, quaternions: Array) -> Array:
    """Return angular velocities by parabolas through the rotation vectors to neighbouring attitudes, (n, 3)."""
    from scipy.spatial.transform import Rotation

    R = Rotation.from_quat(quaternions)
    steps = (R[:-1].inv() * R[1:]).magnitude()
    speed = float(np.sqrt(np.mean((steps / np.diff(time)) ** 2)))
    half = ARC / max(speed, 1e-300)
    rates = np.empty((len(time), 3))
    for k, t in enumerate(time):
        near = slice(
            min(int(np.searchsorted(time, t - half)), max(k - FEWEST, 0)),
            max(int(np.searchsorted(time, t + half, "right")), k + FEWEST + 1),
        )
        turned = (R[k].inv() * R[near]).as_rotvec()
        rates[k] = np.polynomial.polynomial.polyfit(time[near] - t, turned, 2)[1]
    return rates


def noise_of_attitudes(quaternions: Array) -> float:
    """Return the standard deviation of the noise of attitudes, rad: of a quaternion it is half as large."""
    return max(2 * noise_of(quaternions[finite_rows(quaternions)]), FINE)


def scatter_of_attitudes(part: Any) -> float:
    """Return the standard deviation of the attitudes of a part of a fit about a smooth motion, rad; 0 without."""
    if part.quaternions is None:
        return 0.0
    good = finite_rows(part.quaternions)
    return 2 * scatter_of(part.time[good], part.quaternions[good], part.measured[good])


def gaps(recorded: Array, model: Array) -> Array:
    """Return the rotation vectors from attitudes of a model to recorded ones, in body components, (n, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray((Rotation.from_quat(model).inv() * Rotation.from_quat(recorded)).as_rotvec())


def gaps_by(gap: Array, model: Array, slope: Array) -> Array:
    """Return the derivatives of these by numbers on which the quaternions of the model depend, (n, 3, k)."""
    v, w = model[:, :3], model[:, 3]
    size = (model**2).sum(axis=1)[:, None, None]
    across = np.einsum("aib,ni->nab", LEVI, v)  # of v × ·
    turned = w[:, None, None] * slope[:, :3] - v[:, :, None] * slope[:, 3:] - across @ slope[:, :3]
    hat = np.einsum("aib,ni->nab", LEVI, gap)
    T = np.eye(3) - hat / 2 + hat @ hat / 12
    return np.asarray(-2 * T @ turned / size)
