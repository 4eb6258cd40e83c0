"""What is wrong with a recording, in a sentence, before and after a fit."""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array
from .bodies import Model
from .measuring import finite_rows

FEWEST, LEAST_TURN, MOST_TURN = 12, 1.0, 1.5  # samples; rad over all; rad from sample to sample
PLATEAU, EQUAL = 4, 0.1  # equal largest values in a row that are no chance; share of other equal ones in coarse data
WHITE = 5.0  # standard errors of a correlation that is none
STRAY = 8.0  # times the noise: no noise
WINDOW, TURN, DEGREE = 14, 1.5, 8  # samples and rad, at least, of a window; of the polynomial in it
MISFIT = 2.0  # residuals over the scatter of the samples: no noise leaves these
EXACT = 1e-4  # of the speed: residuals that need no noise
FINE = 1e-9  # rad: noise of attitudes at least
DIFFERENCES = np.array([1, -6, 15, -20, 15, -6, 1])


def noise_of(rates: Array) -> float:
    """Return the standard deviation of the noise of samples of a smooth motion, by their sixth differences."""
    if len(rates) < 2 * len(DIFFERENCES):
        return 0.0
    found = np.stack([np.convolve(column, DIFFERENCES, "valid") for column in rates.T])
    return float(np.median(abs(found)) / 0.6745 / np.linalg.norm(DIFFERENCES))


def scatter_of(time: Array, samples: Array, rates: Array | None = None) -> float:
    """Return the standard deviation of samples about polynomials, each over a window of `TURN` rad at least.

    A motion is as smooth as that and noise is not, also where a sensor filters its highest frequencies. So no model
    leaves much less, and the right one does not leave much more. Three numbers of each sample are free; `rates` are the
    angular velocities where the samples are not.
    """
    turned = float(np.trapezoid(np.linalg.norm(samples if rates is None else rates, axis=1), time))
    count = max(1, min(len(time) // WINDOW, int(turned / TURN)))
    squares = free = 0.0
    for rows in np.array_split(np.arange(len(time)), count):
        degree = min(DEGREE, len(rows) // 2)
        t = (time[rows] - time[rows].mean()) / np.ptp(time[rows])
        A = np.polynomial.legendre.legvander(2 * t, degree)
        squares += float(((samples[rows] - A @ np.linalg.lstsq(A, samples[rows], rcond=None)[0]) ** 2).sum())
        free += 3 * (len(rows) - degree - 1)
    return float(np.sqrt(squares / free))


def haste_of(model: Model, time: Array, rates: Array) -> float:
    """Return how many times as fast as the body turns W changes, 1 at least: a rotor turns W at about |h|/J.

    The change is ``√(mean |W(t + d) - W(t)|² - 6 σ²)/d`` with the shortest delay d at which noise is the smaller part.
    """
    square, noise = float((rates**2).sum(axis=1).mean()), 6 * noise_of(rates) ** 2
    for lag in () if model.wheel is None else (1, 2, 4, 8, 16):
        change = float(((rates[lag:] - rates[:-lag]) ** 2).sum(axis=1).mean()) if lag < len(rates) else 0.0
        if change > 2 * noise:
            delay = lag * float(np.median(np.diff(time)))
            return max(1.0, float(np.sqrt(change - noise)) / max(delay * square, 1e-300))
    return 1.0


def noise_of_attitudes(quaternions: Array) -> float:
    """Return the standard deviation of the noise of attitudes, rad: of a quaternion it is half as large."""
    return max(2 * noise_of(quaternions[finite_rows(quaternions)]), FINE)


def scatter_of_attitudes(time: Array, quaternions: Array | None, rates: Array) -> float:
    """Return the standard deviation of attitudes about a smooth motion of these angular velocities, rad; 0 without."""
    if quaternions is None:
        return 0.0
    good = finite_rows(quaternions)
    return 2 * scatter_of(time[good], quaternions[good], rates[good])


def require_turning(model: Model, time: Array, rates: Array, where: str) -> None:
    """Raise a ValueError where a body turns too little, or too much from sample to sample."""
    if len(time) < FEWEST:
        raise ValueError(f"{where}: {len(time)} samples are too few, a fit needs {FEWEST}; use a longer interval")
    speed = haste_of(model, time, rates) * np.linalg.norm(rates, axis=1)
    turned = float(np.trapezoid(speed, time))
    if turned < LEAST_TURN:
        raise ValueError(
            f"{where}: the body turns by only {turned:.2g} rad in {time[-1] - time[0]:.3g} s, too little to determine "
            "an inertia: turn it faster, throw it higher; or is the unit rad/s?"
        )
    between = float(np.median(np.diff(time)) * speed.max())
    if between > MOST_TURN:
        raise ValueError(
            f"{where}: the body turns by up to {between:.3g} rad from one sample to the next, too coarse: record at "
            f"{speed.max() / 0.5:.3g} Hz or more, or turn it more slowly; or is the unit deg/s?"
        )


def require_unsaturated(time: Array, rates: Array, where: str) -> None:
    """Raise a ValueError where an axis has reached its largest reading."""
    speed = np.linalg.norm(rates, axis=1)
    for axis, column in zip("xyz", rates.T, strict=True):
        for level in (column.max(), column.min()):
            at = np.flatnonzero(column == level)
            others = (np.diff(column) == 0) & (column[1:] != level)
            borders = np.flatnonzero(np.concatenate([[True], np.diff(at) != 1, [True]]))
            if np.diff(borders).max() >= PLATEAU and others.mean() < EQUAL and abs(level) > 0.5 * speed.max():
                raise ValueError(
                    f"{where}: the gyroscope is saturated: {len(at)} samples of axis {axis} read {level:.6g} rad/s, "
                    f"the first at t = {time[at[0]]:.6g} s; turn the body more slowly, or give the sensor a larger "
                    "range"
                )


def correlation(residual: Array, lag: int = 1) -> float:
    """Return the correlation of residuals with their neighbours, or with those `lag` samples before, over all axes."""
    r = residual - residual.mean(axis=0)
    return float((r[lag:] * r[:-lag]).sum() / max((r * r).sum(), 1e-300))


def new_of(residual: Array) -> float:
    """Return which part of residuals is new at each sample where they are noise that goes on as φᵏ, else 1.

    That is ``√(1 - φ²)``, and ``r_k - φ r_k-1`` are then white. What a wrong model leaves is smooth: beside white noise
    it makes these correlated.
    """
    phi, chance = correlation(residual), WHITE / np.sqrt(residual.size)
    new = residual[1:] - phi * residual[:-1]
    if phi < chance or max(abs(correlation(new, lag)) for lag in (1, 2)) > chance:
        return 1.0
    return float(np.sqrt(1 - phi**2))
