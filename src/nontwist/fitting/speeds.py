r"""The speed of a rotor as recorded: linear between knots, whose values are fitted with all else.

A tachometer reads ``Ω(t_k) + noise``. Its values at the knots are unknowns of the fit, and its readings are residuals
beside those of the gyroscope, over the noise that they have about the best such line; so the error of the speed is part
of every interval.

How many knots: 1, 2, 4, ... equal intervals are tried, and the number with the least
``n log(rss/n) + k log n`` is found (Schwarz, Annals of Statistics 6, 1978, 461-464). The gyroscope may feel a change of
speed that the tachometer hides in its noise: where the speed is not one line, intervals are a quarter as long, and as
long as the residuals of the gyroscope are not white they are halved. A speed of constant error, or a rotor whose
inertia has one, is a factor with a prior (`bodies`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..geometry.arrays import Array
from .motions import Kicks

MOST, EXACT = 64, 1e-6  # intervals; of the largest speed: noise at least
FEWEST, AHEAD = 4, 2  # readings; halvings of the intervals that the tachometer asks for
BLOCK, PANEL = 6000, 8  # numbers, and columns, that BLAS leaves to one thread


@dataclass(frozen=True)
class Speed:
    """Readings of a speed, rad/s, at their times, the knots, first values there, and the noise of a reading."""

    time: Array
    readings: Array
    knots: Array
    values: Array
    noise: float

    def at(self, time: Array) -> Array:
        """Return the speed at times by the values at the knots, (n, k)."""
        return hats(self.knots, time)

    @cached_property
    def rows(self) -> tuple[Array, Array]:
        """H and y, as few rows as there are knots: ``y - H values`` is as long as the residuals of all readings."""
        both = np.column_stack([self.at(self.time), self.readings]) / self.noise
        reduced = triangle(both)
        return reduced[:, :-1], reduced[:, -1]

    def kicks(self, first: float, last: float, values: Array) -> Kicks:
        """Return how the speed and its rate start at one time, and change until another, by the values at the knots."""
        slopes = np.diff(np.eye(len(self.knots)), axis=0) / np.diff(self.knots)[:, None]
        piece = int(np.clip(np.searchsorted(self.knots, first, "right") - 1, 0, len(slopes) - 1))
        inner = [n for n in range(piece + 1, len(slopes)) if self.knots[n] < last]
        jumps = np.diff(slopes, axis=0)[np.array(inner, dtype=int) - 1]
        return Kicks(
            self.knots[inner] - first, jumps @ values, jumps, np.stack([self.at(np.array([first]))[0], slopes[piece]])
        )


def hats(knots: Array, time: Array) -> Array:
    """Return the functions that are linear between knots, 1 at one and 0 at all others, at times, (n, k)."""
    return np.stack([np.interp(time, knots, unit) for unit in np.eye(len(knots))], axis=1)


def triangle(A: Array) -> Array:
    """Return R of a product QR of a matrix; a matrix of few rows as it is.

    R takes up one block of rows after the other: BLAS would share a larger one among threads, which on a busy machine
    wait for each other a hundred times as long as they work.
    """
    from scipy.linalg.lapack import dtpqrt

    columns = A.shape[1]
    if len(A) <= columns:
        return A
    R = np.zeros((columns, columns), order="F")
    for rows in np.array_split(A, -(-A.size // BLOCK)):
        R = dtpqrt(0, min(PANEL, columns), R, rows)[0]
    return np.asarray(np.triu(R))


def as_speed(time: Array, readings: Array) -> Speed:
    """Return readings with knots that are enough for them; those that are not finite do not count."""
    good = np.isfinite(readings)
    if good.sum() < FEWEST:
        raise ValueError(f"{good.sum()} readings of the speed are too few; a fit needs {FEWEST}")
    trials, count = [], 1
    while count <= min(MOST, good.sum() // 3):
        trials.append(_with(time[good], readings[good], np.linspace(time[0], time[-1], count + 1)))
        count *= 2
    scores = [len(one.time) * 2 * np.log(one.noise) + len(one.knots) * np.log(len(one.time)) for one in trials]
    best = int(np.argmin(scores))
    return trials[min(best + AHEAD, len(trials) - 1) if best else 0]


def refined(speed: Speed) -> Speed | None:
    """Return a speed with twice as many intervals; None where there are enough."""
    count = 2 * (len(speed.knots) - 1)
    if count > min(MOST, len(speed.time) // 3):
        return None
    return _with(speed.time, speed.readings, np.linspace(speed.knots[0], speed.knots[-1], count + 1))


def _with(time: Array, readings: Array, knots: Array) -> Speed:
    R = triangle(np.column_stack([hats(knots, time), readings]))
    values = np.asarray(np.linalg.lstsq(R[:, :-1], R[:, -1], rcond=1e-8)[0], dtype=float)
    rss = float(((R[:, -1] - R[:, :-1] @ values) ** 2).sum())
    least = EXACT * max(float(abs(readings).max()), 1e-300)
    return Speed(time, readings, knots, values, max(float(np.sqrt(rss / max(len(time) - len(knots), 1))), least))


def constant(time: Array, value: float) -> Speed:
    """Return a speed that is known and constant."""
    ends = time[[0, -1]]
    return Speed(ends, np.full(2, value), ends, np.full(2, value), EXACT * max(abs(value), 1e-300))
