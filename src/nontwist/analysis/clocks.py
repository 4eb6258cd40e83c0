"""Clocks of two recordings: one shift, or a shift and a drift, that make them one.

A sensor on a body turns at the angular speed |w|, whatever its axes are and whatever frame it reports to; so two
sensors on one body, or on neighbouring ones that move together, show the same course of |w|. The time of the second
sensor s and that of the first t are taken to be related by

    t = s0 + shift + (1 + drift) (s - s0),        s0 its first sample.

1. Both speeds (angles between samples over their intervals, at the midpoints) are interpolated on one uniform grid.
2. The normalized cross-correlation r of the n points that overlap, computed with sums by FFT (D. Padfield, IEEE
   Trans. Image Process. 21 (2012) 2706-2718: means and norms are those of the overlap), is most significant at the
   shift: where artanh(r) √n, normal with variance 1 for independent points (R. A. Fisher), is greatest. With a drift
   the first recording is then cut in windows, each is found in the second near this shift, and a line through the
   shifts of those that match, by the median of slopes (P. Sen, J. Am. Stat. Assoc. 63 (1968) 1379-1389), gives shift
   and drift.
3. Shift and drift are refined to a fraction of a sample: with both speeds reduced to mean zero and norm one, the sum of
   squares of their difference is 2 (1 - correlation), whose least value Gauss and Newton's method finds.

Motions that repeat have many shifts that fit nearly as well; this is said. Recordings whose speeds do not match are
refused, as any shift would be a guess: two segments of an arm move by themselves as well, so both sensors are shaken
together at the start, and at the end for a drift.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.arrays import Array

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

LEAST = 0.7  # correlation below which recordings do not match
CLOSE = 0.9  # below which the shift is told to be uncertain
MATCHES = 0.7  # of a window
OVERLAP = 0.3  # of the shorter recording that must overlap
WINDOWS, SHORTEST = 12, 50  # windows for the drift, and samples of the shortest
RIVAL = 0.03  # a second shift whose correlation comes as close is told
DRIFT, SEARCH = 1e-3, 0.5  # largest drift, and how far a window is looked for besides, s
MOST = 2_000_000  # points of the grid


@dataclass(frozen=True)
class ClockFit:
    """How the clock of the second recording is mapped to that of the first; `rival`: another fits nearly as well."""

    origin: float
    shift: float
    drift: float
    correlation: float
    rival: str

    def times(self, time: Array) -> Array:
        """Return times of the second recording on the clock of the first."""
        return self.origin + self.shift + (1 + self.drift) * (time - self.origin)

    def words(self) -> str:
        """Say what was found."""
        drift = f", drift {1e6 * self.drift:+.3g} ppm" if self.drift else ""
        return (
            f"clock of relative_to: shifted by {self.shift:+.6g} s{drift} (correlation of the angular speeds "
            f"{self.correlation:.3f})"
        )


def fitted_clock(a: Rotation, t: Array, b: Rotation, s: Array, *, drift: bool) -> ClockFit:
    """Return the clock that makes the angular speeds of a(t) and b(s) agree best.

    Raises
    ------
    ValueError
        They do not agree, or there are too few samples.
    """
    from scipy.optimize import least_squares

    if min(t.size, s.size) < SHORTEST:
        raise ValueError(
            f"clocks are aligned from at least {SHORTEST} samples; there are {t.size} and {s.size}: --clocks shared "
            "(clocks='shared') uses their times unchanged"
        )
    step = max(min(np.median(np.diff(t)), np.median(np.diff(s))), (t[-1] - t[0]) / MOST, (s[-1] - s[0]) / MOST)
    va, vb = (_speed(rotation, time) for rotation, time in ((a, t), (b, s)))
    grid_a, grid_b = (np.arange(time[0], time[-1], step) for time in (t, s))
    fa, fb = np.interp(grid_a, *va), np.interp(grid_b, *vb)
    lag, rival = _whole(fa, fb, step)
    shift, slope = t[0] - s[0] - lag * step, 0.0
    if drift:
        ahead, slope = _windowed(fa, fb, step, lag)
        shift += ahead
    span = max(s[-1] - s[0], step)

    def unlike(x: Array) -> Array:
        there = s[0] + (grid_a - s[0] - shift - x[0] * step) / (1 + slope + (x[1] * step / span if drift else 0.0))
        return _difference(fa, vb, there, s)

    found = least_squares(unlike, np.zeros(1 + drift))
    correlation = 1 - float((found.fun**2).sum()) / 2
    if not correlation >= LEAST:
        raise ValueError(
            f"the clocks cannot be aligned: the angular speeds of the two recordings do not match (correlation "
            f"{correlation:.2f} at best); --clocks shared (clocks='shared') uses their times unchanged"
        )
    more = float(found.x[1]) * step / span if drift else 0.0
    return ClockFit(float(s[0]), float(shift + found.x[0] * step), float(slope + more), correlation, rival)


def speed_correlation(a: Rotation, t: Array, b: Rotation, s: Array) -> float:
    """Return the correlation of the angular speeds of a(t) and b(s) where both are known, by these times."""
    time, speed = _speed(a, t)
    return 1 - float((_difference(speed, _speed(b, s), time, s) ** 2).sum()) / 2


def _difference(f: Array, other: tuple[Array, Array], there: Array, s: Array) -> Array:
    """Return f minus the other speed at the times `there`, both reduced, 0 where the other is unknown."""
    inside = (there >= s[0]) & (there <= s[-1])
    return _reduced(np.where(inside, f, 0.0), inside) - _reduced(
        np.where(inside, np.interp(there, *other), 0.0), inside
    )


def _speed(rotation: Rotation, time: Array) -> tuple[Array, Array]:
    """Return the midpoints of the intervals and the angular speeds, rad/s."""
    return (time[1:] + time[:-1]) / 2, (rotation[:-1].inv() * rotation[1:]).magnitude() / np.diff(time)


def _reduced(f: Array, inside: Any) -> Array:
    """Return a signal with mean zero and norm one where it counts."""
    g = np.where(inside, f - f[inside].mean() if inside.any() else 0.0, 0.0)
    norm = np.linalg.norm(g)
    return np.asarray(g / norm if norm > 0 else g)


def _correlation(a: Array, b: Array, least: int) -> tuple[Array, Array]:
    """Return lags (b[i + lag] beside a[i]) and the normalized cross-correlation of what overlaps by `least` points."""
    from scipy.signal import correlate, correlation_lags

    a, b = a - a.mean(), b - b.mean()
    one, other = np.ones(a.size), np.ones(b.size)

    def sums(x: Array, y: Array) -> Array:
        return np.asarray(correlate(y, x, mode="full", method="fft"))

    n = np.round(sums(one, other))
    n = np.maximum(n, 1)
    of_a, of_b = sums(a, other), sums(one, b)
    above = sums(a, b) - of_a * of_b / n
    below = np.maximum(sums(a * a, other) - of_a**2 / n, 0) * np.maximum(sums(one, b * b) - of_b**2 / n, 0)
    scale = 1e-9 * (a @ a) * (b @ b)
    found = np.where((n >= least) & (below > scale), above / np.sqrt(np.maximum(below, scale + 1e-300)), -1.0)
    return correlation_lags(b.size, a.size), found


def _whole(a: Array, b: Array, step: float) -> tuple[int, str]:
    """Return the lag at which a is found in b, and what is to be said of another that fits nearly as well."""
    least = max(int(OVERLAP * min(a.size, b.size)), 10)
    lags, found = _correlation(a, b, least)
    beside = np.minimum(b.size - lags, a.size) - np.maximum(-lags, 0)
    score = np.arctanh(np.clip(found, -0.999999, 0.999999)) * np.sqrt(np.maximum(beside, 0))
    best = int(np.argmax(score))
    left = right = best
    while left > 0 and score[left - 1] < score[left]:
        left -= 1
    while right < score.size - 1 and score[right + 1] < score[right]:
        right += 1
    rivals = np.where(beside >= beside[best] / 2, found, -1.0)
    rivals[left : right + 1] = -1.0
    k = int(np.argmax(rivals))
    if found[k] < found[best] - RIVAL:
        return int(lags[best]), ""
    return int(lags[best]), (
        f"another shift of the clocks, {(lags[best] - lags[k]) * step:+.4g} s from the one found, fits nearly as well "
        f"(correlation {found[k]:.3f} against {found[best]:.3f}): the motion repeats; shake both sensors together at "
        "the start"
    )


def _windowed(a: Array, b: Array, step: float, lag: int) -> tuple[float, float]:
    """Return shift at the start of b, besides that of `lag`, and drift, from windows of a found in b nearby."""
    from scipy.stats import theilslopes

    size = max(a.size // WINDOWS, SHORTEST)
    near = int(np.ceil(max(DRIFT * a.size, SEARCH / step)))
    where, shifts = [], []
    for k in range(0, a.size - size + 1, max(size // 2, 1)):
        piece = a[k : k + size]
        first = max(k + lag - near, 0)
        part = b[first : k + lag + near + size]
        if part.size < size or piece.std() == 0:
            continue
        lags, found = _correlation(piece, part, size)
        best = int(np.argmax(found))
        if found[best] >= MATCHES and 0 < best < found.size - 1:
            where.append((first + lags[best] + size / 2) * step)
            shifts.append((k + lag - first - lags[best]) * step)
    if len(where) < 2:
        return 0.0, 0.0
    slope, at_start, *_ = theilslopes(shifts, where)
    return float(at_start), float(slope)
