"""A run at other times: interpolation on SO(3), not component by component.

Between stored states the attitude is Λ_k exp(θ̂(t)) with the cubic Hermite polynomial θ that meets the rotations and the
angular velocities of both ends: θ(t_k) = 0, θ'(t_k) = W_k, θ(t_{k+1}) = log(Λ_kᵀ Λ_{k+1}), and θ'(t_{k+1}) =
dexp⁻¹(-θ_{k+1}) W_{k+1}, for W = dexp(-θ) θ' are the body components (eq-dexp with exp on the left). The attitude is of
order 4 in the length of the intervals, the velocity of order 3.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..geometry import rotations
from ..geometry.arrays import Array, as_array
from ..geometry.attitudes import quaternions
from ..models.system import DirectorSystem
from .datasets import RUN, as_dataset
from .trajectory import state_dataset

if TYPE_CHECKING:
    import xarray


def resample(run: xarray.Dataset, times: ArrayLike) -> xarray.Dataset:
    """Return the states of a run at other times.

    Parameters
    ----------
    run : Dataset
        Of `simulate`, or read with `open_run`.
    times : (k,) array, s
        Within the run.

    Returns
    -------
    Dataset
        All variables on `time`, velocities tangent. Moments, multipliers and work belong to the stored intervals and
        are dropped.

    Raises
    ------
    ValueError
        Not a run, a time outside of it, or fewer than two stored states.

    Examples
    --------
    >>> from nontwist import nontwisting, resample, rotation, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, step=0.1, angular_velocity=(0, 2, 0), integrator="split")
    >>> rotation(resample(run, [0.25, 0.333])).magnitude().round(6)
    array([0.5  , 0.666])
    """
    as_dataset(run, RUN, ("time", "directors", "material_angular_velocity"), ("system",))
    t, x = run["time"].values, as_array(times, "times", (None,))
    if t.size < 2:
        raise ValueError("the run has a single state; nothing can be interpolated")
    outside = (x < t[0]) | (x > t[-1])
    if outside.any():
        bad = int(np.argmax(outside))
        raise ValueError(f"times[{bad}] = {x[bad]:.12g} s lies outside of the run, {t[0]:.12g} s to {t[-1]:.12g} s")
    q = run["directors"].transpose("time", "director", "axis").values
    W = run["material_angular_velocity"].transpose("time", "director").values
    k = np.clip(np.searchsorted(t, x, side="right") - 1, 0, t.size - 2)
    theta, rate = _hermite(q[k], q[k + 1], W[k], W[k + 1], (t[k + 1] - t[k])[:, None], (x - t[k])[:, None])
    directors = np.swapaxes(rotations.exp(theta), -1, -2) @ q[k]
    velocity = (rotations.dexp(-theta) @ rate[..., None])[..., 0]
    velocity[x == t[-1]] = W[-1]
    directors[x == t[-1]] = q[-1]
    system = DirectorSystem.from_json(run.attrs["system"])
    states = state_dataset(system, x, quaternions(directors), velocity)
    return states.assign_attrs(run.attrs | {"resampled": "cubic on SO(3) between stored states"})


def _hermite(q0: Array, q1: Array, W0: Array, W1: Array, h: Array, t: Array) -> tuple[Array, Array]:
    end = rotations.log(q0 @ np.swapaxes(q1, -1, -2))
    slope = (rotations.dexp_inverse(-end) @ W1[..., None])[..., 0]
    s = t / h
    a, b = 3 * end - h * (2 * W0 + slope), h * (W0 + slope) - 2 * end
    theta: Array = s * (h * W0 + s * (a + s * b))
    rate: Array = W0 + s * (2 * a + 3 * s * b) / h
    return theta, rate
