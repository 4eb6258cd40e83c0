r"""What sensors on a body would have recorded of a run.

A gyroscope of rate f reads ``y_k = s E exp(-θ̂) W(t_k - τ) + b + n_k``, with a scale s, scales E = diag(e) of its axes,
which the rotation vector θ turns against the directors, a delay τ, a constant bias b, and white noise n of the
one-sided density d, rad/s/√Hz, as data sheets state it: filtered to half the rate, each sample has the standard
deviation ``d √(f/2)``. Nothing is quantised, saturated or filtered.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .analysis.datasets import RUN, as_dataset
from .analysis.variables import assembled, labelled
from .driver.runs import resample
from .geometry.arrays import Dataset, as_array, as_number, as_positive
from .geometry.rotations import exp
from .geometry.values import as_whole, public

__all__ = ["gyroscope"]
public(__name__)
LAST = 1e-9  # of a sample: how far beyond the end of a run its last one may be


def gyroscope(
    run: Dataset,
    noise: float = 0.0,
    bias: ArrayLike = (0.0, 0.0, 0.0),
    scale: float = 1.0,
    rate: float | None = None,
    seed: int = 0,
    *,
    delay: float = 0.0,
    misalignment: ArrayLike = (0.0, 0.0, 0.0),
    axis_scales: ArrayLike = (1.0, 1.0, 1.0),
) -> Dataset:
    """Return what a gyroscope fixed in the body would have recorded of a run.

    Parameters
    ----------
    run : Dataset
        A run of `simulate`, or one read with `open_run`.
    noise : float, rad/s/√Hz
        One-sided density of the white noise, not negative. Each sample has the standard deviation noise · √(rate/2).
    bias : (3,) array, rad/s
        Bias along the axes of the gyroscope.
    scale : float
        Ratio of reading to angular velocity, the same for all axes.
    rate : float, Hz, optional
        Samples per second, from the start of the run; states between stored ones are computed by `resample`. By default
        the stored states are the samples, which must be evenly spaced if there is noise.
    seed : int
        Seed of the noise, 0 or more.
    delay : float, s
        Delay of the readings relative to their times, not negative. The first sample is taken at the end of the delay.
    misalignment : (3,) array, rad
        Rotation vector from the directors to the axes of the gyroscope.
    axis_scales : (3,) array
        Scales of the single axes, in addition to the common scale.

    Returns
    -------
    Dataset
        `gyroscope`, (time, director), rad/s, an input of `nontwist.fit_inertia`.

    Raises
    ------
    ValueError
        `run` is not a run or is shorter than two samples, the noise or the delay is negative, a scale or the rate is
        not positive, or a delay is given without a rate.
    SimulationError
        The run cannot be continued between its stored states.

    Examples
    --------
    >>> from nontwist import sensors, simulate, standard
    >>> run = simulate(standard([1, 2, 2.5]), t_end=0.5, material_angular_velocity=(3, 8, 1))
    >>> recording = sensors.gyroscope(run, noise=1e-4, bias=(0.01, 0, 0), rate=400, seed=1)
    >>> recording.gyroscope.shape
    (201, 3)
    >>> recording.gyroscope.values[0].round(2)
    array([3.01, 8.  , 1.  ])
    """
    run = as_dataset(run, RUN, ("time", "material_angular_velocity"))
    density, s = as_number(noise, "noise"), float(as_positive(scale, "scale", (), ""))
    if density < 0:
        raise ValueError(f"noise must not be negative, got {density:g} rad/s/√Hz")
    b, seed = as_array(bias, "bias", (3,)), as_whole(seed, "seed", 0)
    late, Q = as_number(delay, "delay"), exp(as_array(misalignment, "misalignment", (3,))).T
    e = as_positive(axis_scales, "axis_scales", (3,), "")
    if late < 0:
        raise ValueError(f"delay must not be negative, got {late:g} s")
    t = run["time"].values
    if t.size < 2:
        raise ValueError("the run has a single state; a recording needs two samples")
    if rate is not None:
        hertz = float(as_positive(rate, "rate", (), "Hz"))
        first, last = int(np.ceil(late * hertz - LAST)), int(np.ptp(t) * hertz + LAST)
        if last - first < 1:
            raise ValueError(f"the run lasts {np.ptp(t):.6g} s, less than two samples at a rate of {hertz:g} Hz")
        begin, t = t[0], np.minimum(t[0] + np.arange(first, last + 1) / hertz, t[-1])
        run = resample(run, np.maximum(t - late, begin))
    elif late:
        raise ValueError("a delay needs rate=, in Hz: delayed samples lie between the stored states")
    else:
        hertz = (t.size - 1) / float(np.ptp(t))
        if density > 0 and abs(np.diff(t) * hertz - 1).max() > 1e-6:
            raise ValueError("the stored states are not evenly spaced: pass rate=, in Hz")
    W = run["material_angular_velocity"].values
    spread = density * np.sqrt(hertz / 2)
    y = s * e * (W @ Q.T) + b + spread * np.random.default_rng(seed).normal(size=W.shape)
    attrs = {"units": "rad s-1", "long_name": "reading of a gyroscope, simulated", "symbol": "y"}
    record = {"title": "gyroscope, simulated", "noise": density, "bias": b, "scale": s, "rate": hertz, "seed": seed}
    record |= {"delay": late, "misalignment": np.asarray(misalignment, dtype=np.float64), "axis_scales": e}
    dims = ("time", "director")
    return assembled(labelled({"gyroscope": (dims, y, attrs)}, time=t), record)
