"""Clocks of two recordings: one shift, or a shift and a drift, that make them one.

A sensor on a body turns at the angular speed |w|, whatever its axes are and whatever frame it reports to; so two
sensors on one body, or on neighbouring ones that move together, show the same course of |w|. The time of the second
sensor s and that of the first t are taken to be related by

    t = s0 + shift + (1 + drift) (s - s0),        s0 its first sample.

1. Both speeds (angles between samples over their intervals, at the midpoints) are interpolated on one uniform grid.
2. The normalized cross-correlation r of the n points that overlap, computed with sums by FFT (D. Padfield, IEEE
   Trans. Image Process. 21 (2012) 2706-2718: means and norms are those of the overlap), is most significant at the
   shift: where artanh(r) √n, normal with variance 1 for independent points (R. A. Fisher), is greatest. For a drift
   the second recording is stretched by one drift after the other, in steps of a tenth of a second over its length, as
   shakes at both ends match at few of them only. The drift at which the shift is most significant is taken.
3. Shift and drift are refined to a fraction of a sample: with both speeds reduced to mean zero and norm one, the sum of
   squares of their difference is 2 (1 - correlation), whose least value Levenberg and Marquardt's method finds. Noise
   would make a least value at every sample; for a drift the speeds are smoothed before 2.
4. How far each of 12 parts of the recording alone would move the drift, to first order, tells how far it can be
   trusted: that is its part of the gradient over the second derivatives of the whole. The root of the sum of squares of
   these moves is the standard deviation of the drift (H. White, Econometrica 48 (1980) 817-838, by clusters); of 12, 24
   and 48 parts the largest counts. It is small where both sensors are shaken together at either end, whatever the joint
   does in between, and large where the motion of the joint decides.

Motions that repeat have many shifts that fit nearly as well; this is said. Recordings whose speeds do not match are
refused, as any shift would be a guess: two segments of an arm move by themselves as well, so both sensors are shaken
together at the start, and at the end for a drift. Where the caller says when, the sums of 2, the difference of 3 and
the parts of 4 are those of the shaken samples alone, each with all of the other recording, and must match more closely:
in seconds of unrelated motion a correlation of 0.8 is found by chance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array, sum_of_squares
from ..geometry.values import counted

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

LEAST = 0.7  # correlation below which recordings do not match
CLOSE = 0.9  # below which the shift is told to be uncertain, and sensors were not shaken together
SURE = 0.97  # the same where both were shaken together
MATCHES = 0.7  # of a window
OVERLAP = 0.3  # of the shorter recording that must overlap
WINDOWS, SHORTEST = 12, 50  # windows in which a drift must match, and samples of the shortest
RIVAL = 0.03  # a second shift whose correlation comes as close is told
DRIFT, SEARCH = 1e-3, 0.5  # largest drift, and how far a window is looked for besides, s
SMOOTH = 0.1  # s, full width at half maximum of what smooths the speeds for a drift
REACH = 0.025  # s, of second derivatives: noise within this time does not count
PARTS = (12, 24, 48)  # into which a recording is cut for the uncertainty of its drift
VAGUE = 30e-6  # a drift that is more uncertain is told: clocks of quartz differ by little more
TRIED, MOST_TRIED = 0.1, 32  # s by which drifts that are tried differ over the recording; how many to each side
STEADY = 1e-9  # of the largest speed: changes below it are round-off
MOST = 2_000_000  # points of the grid
ALONE: Literal["lm"] = "lm"  # Levenberg and Marquardt's method by MINPACK, without BLAS, whose threads compete


@dataclass(frozen=True)
class ClockFit:
    """How the clock of the second recording is mapped to that of the first.

    `unsure` is twice the standard deviation of the drift, None where none was looked for; `doubts` tell in words that
    another clock fits nearly as well, or that the drift is a guess. `within` are the words of `while_shaken`.
    """

    origin: float
    shift: float
    drift: float
    unsure: float | None
    correlation: float
    doubts: tuple[str, ...]
    within: str = ""

    def times(self, time: Array) -> Array:
        """Return times of the second recording on the clock of the first."""
        return self.origin + self.shift + (1 + self.drift) * (time - self.origin)

    def words(self) -> str:
        """Say what was found."""
        shift, drift = f"{self.shift:+.5f}", ""
        if self.unsure is not None:
            most = f"{_rounded(1e6 * self.unsure, 1):g}" if np.isfinite(self.unsure) else "unknown"
            drift = f" at its first sample, drift {_rounded(1e6 * self.drift, 3):+g} ± {most} ppm"
        return (
            f"clock of relative_to: shifted by {shift.rstrip('0').rstrip('.')} s{drift} (correlation of the angular "
            f"speeds{self.within} {self.correlation:.3f})"
        )


def fitted_clock(a: Rotation, t: Array, b: Rotation, s: Array, *, drift: bool, shake: Array | None = None) -> ClockFit:
    """Return the clock that makes the angular speeds of a(t) and b(s) agree best.

    `shake`, (k, 2), are intervals of t in which both moved as one; the speeds at other times are ignored.

    Raises
    ------
    ValueError
        They do not agree, or there are too few samples.
    """
    from scipy.optimize import least_squares

    many = t.size if shake is None else int(_within(t, shake).sum())
    if min(many, s.size) < SHORTEST:
        raise ValueError(
            f"clocks are aligned from at least {SHORTEST} samples; there are {many} and {s.size}: --clocks shared "
            "(clocks='shared') uses their times unchanged"
            if shake is None
            else f"clocks are aligned from at least {SHORTEST} samples; there are {many} in --shake (shake=), which is "
            f"in the times of the first recording, {t[0]:.6g} s to {t[-1]:.6g} s, and {s.size} in the second"
        )
    step = max(min(np.median(np.diff(t)), np.median(np.diff(s))), (t[-1] - t[0]) / MOST, (s[-1] - s[0]) / MOST)
    va, vb = (_speed(rotation, time) for rotation, time in ((a, t), (b, s)))
    grid_a, grid_b = (np.arange(time[0], time[-1], step) for time in (t, s))
    fa, fb = np.interp(grid_a, *va), np.interp(grid_b, *vb)
    shaken = np.ones(grid_a.size, dtype=np.bool_) if shake is None else _within(grid_a, shake)
    if shake is not None and shaken.sum() < SHORTEST:
        raise ValueError(
            "the clocks cannot be aligned: the recordings last so long, "
            f"{t[-1] - t[0]:.6g} s and {s[-1] - s[0]:.6g} s, that they are compared in steps of {step:.3g} s, with "
            f"{shaken.sum()} of them in --shake (shake=); cut off what lies far from it"
        )
    if any(np.ptp(f) <= STEADY * f.max() for f in (fa[shaken], fb)):
        raise ValueError(
            "the clocks cannot be aligned: a sensor rests or turns at one speed all the time"
            f"{' of --shake (shake=)' if shake is not None else ''}; shake both together; --clocks shared "
            "(clocks='shared') uses their times unchanged"
        )
    lag, rival = _whole(fa, fb, step, shaken)
    shift, span = float(t[0] - s[0] - lag * step), float(max(s[-1] - s[0], step))

    def clock(x: Array) -> tuple[float, float]:
        """Return shift and drift of x: in steps, the drift those that it makes over the second recording."""
        return float(shift + x[0] * step), float(x[1] * step / span) if drift else 0.0

    def unlike(x: Array, f: Array, other: tuple[Array, Array]) -> Array:
        ahead, slope = clock(x)
        there = s[0] + (grid_a - s[0] - ahead) / (1 + slope)
        inside = shaken & (there >= s[0]) & (there <= s[-1])
        return _reduced(f, inside) - _reduced(np.interp(there, *other), inside)

    unsure, doubts = None, list[str]()
    if not drift:
        x = least_squares(unlike, np.zeros(1), method=ALONE, args=(fa, vb)).x
    else:
        smooth_a, smooth_b = _smoothed(fa, step), _smoothed(fb, step)
        start = _scanned(smooth_a, smooth_b, step, lag, shaken)
        x, deviation = _refined(
            lambda x: unlike(x, smooth_a, (grid_b, smooth_b))[shaken],
            start,
            max(REACH / step, 1.0),
            2 * DRIFT * span / step,
        )
        unsure = float(2 * deviation * step / span)
        ahead, slope = clock(x)
        _, rival = _whole(fa, _stretched(fb, slope), step, shaken)
        middle = float(grid_a[grid_a.size // 2])
        lag = round(((middle - s[0] - ahead) / (1 + slope) - (middle - t[0])) / step)
        where, size = _windows(smooth_a, smooth_b, step, lag, shaken)
        first, last = max(t[0], s[0] + ahead), min(t[-1], s[0] + ahead + (1 + slope) * span)
        doubts = doubts_of_drift(where, size, unsure, float(last - first), step)
    correlation = 1 - sum_of_squares(unlike(x, fa, vb)) / 2
    if not correlation >= (LEAST if shake is None else CLOSE):
        raise ValueError(
            f"the clocks cannot be aligned: the angular speeds of the two recordings do not match (correlation "
            f"{correlation:.2f} at best); --shake T0,T1 (shake=) names the time in which both sensors were shaken "
            "together; --clocks shared (clocks='shared') uses their times unchanged, if both come from one clock"
            if shake is None
            else f"the clocks cannot be aligned: the angular speeds in --shake (shake=) match with a correlation of "
            f"{correlation:.2f} at best, {CLOSE:g} is required; name times of the first recording in which both "
            "sensors were shaken together, hard, with the joint at rest"
        )
    fit = ClockFit(float(s[0]), *clock(x), unsure, correlation, (*[rival] * bool(rival), *doubts))
    return fit if shake is None else replace(fit, within=while_shaken(shake))


def while_shaken(shake: Array | None) -> str:
    """Return, in words, when both were shaken; nothing where that was not told."""
    return "" if shake is None else f" from {' and '.join(f'{first:.12g} to {last:.12g} s' for first, last in shake)}:"


def speed_correlation(a: Rotation, t: Array, b: Rotation, s: Array, shake: Array | None = None) -> float:
    """Return the correlation of the angular speeds of a(t) and b(s) where both are known, and within `shake`.

    It is 0 where one of them does not change.
    """
    time, speed = _speed(a, t)
    inside = (time >= s[0]) & (time <= s[-1])
    if shake is not None:
        inside &= _within(time, shake)
    return float((_reduced(speed, inside) * _reduced(np.interp(time, *_speed(b, s)), inside)).sum())


def _within(time: Array, shake: Array) -> NDArray[np.bool_]:
    """Whether times are in one of these intervals, (k, 2)."""
    return np.asarray(((time[:, None] >= shake[:, 0]) & (time[:, None] <= shake[:, 1])).any(axis=1))


def _speed(rotation: Rotation, time: Array) -> tuple[Array, Array]:
    """Return the midpoints of the intervals and the angular speeds, rad/s."""
    return (time[1:] + time[:-1]) / 2, (rotation[:-1].inv() * rotation[1:]).magnitude() / np.diff(time)


def _reduced(f: Array, inside: Any) -> Array:
    """Return a signal with mean zero and norm one where it counts."""
    g = np.where(inside, f - f[inside].mean() if inside.any() else 0.0, 0.0)
    norm = np.sqrt(sum_of_squares(g))
    return np.asarray(g / norm if norm > 0 else g)


def _correlation(a: Array, b: Array, shaken: NDArray[np.bool_], least: int) -> tuple[Array, Array, Array]:
    """Return lags (b[i + lag] beside a[i]), the normalized cross-correlation, and of how many points it is.

    It is that of the points of a that are `shaken`, where they overlap with b by `least` points.
    """
    from scipy.signal import correlate, correlation_lags

    a, b = np.where(shaken, a - a[shaken].mean(), 0.0), b - b.mean()
    one, other = shaken.astype(np.float64), np.ones(b.size)

    def sums(x: Array, y: Array) -> Array:
        return np.asarray(correlate(y, x, mode="full", method="fft"))

    n = np.maximum(np.round(sums(one, other)), 1)
    of_a, of_b = sums(a, other), sums(one, b)
    above = sums(a, b) - of_a * of_b / n
    below = np.maximum(sums(a * a, other) - of_a**2 / n, 0) * np.maximum(sums(one, b * b) - of_b**2 / n, 0)
    scale = 1e-9 * sum_of_squares(a) * sum_of_squares(b)
    found = np.where((n >= least) & (below > scale), above / np.sqrt(np.maximum(below, scale + 1e-300)), -1.0)
    return correlation_lags(b.size, a.size), found, n


def _scores(a: Array, b: Array, shaken: NDArray[np.bool_]) -> tuple[Array, Array, Array, Array]:
    """Return lags, correlations, how many points overlap, and how significant each correlation is."""
    lags, found, n = _correlation(a, b, shaken, max(int(OVERLAP * min(shaken.sum(), b.size)), 10))
    return lags, found, n, np.arctanh(np.clip(found, -0.999999, 0.999999)) * np.sqrt(n)


def _whole(a: Array, b: Array, step: float, shaken: NDArray[np.bool_]) -> tuple[int, str]:
    """Return the lag at which a is found in b, and what is to be said of another that fits nearly as well."""
    lags, found, beside, score = _scores(a, b, shaken)
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


def _smoothed(f: Array, step: float) -> Array:
    """Return a signal smoothed by a window of Hann, which is symmetric and so shifts nothing."""
    half = round(SMOOTH / step)
    if half < 2:
        return f
    window = np.hanning(2 * half + 1)[1:-1]
    return np.convolve(np.pad(f, half - 1, mode="edge"), window / window.sum(), mode="valid")


def _windows(a: Array, b: Array, step: float, lag: int, shaken: NDArray[np.bool_]) -> tuple[Array, float]:
    """Return where windows of a match in b nearby, s from the start of b, and their greatest length."""
    longest = max(a.size // WINDOWS, SHORTEST)
    near = int(np.ceil(max(DRIFT * a.size, SEARCH / step)))
    where = []
    for begin, end in np.flatnonzero(np.diff(shaken, prepend=False, append=False)).reshape(-1, 2):
        size = min(longest, end - begin)
        for k in range(begin, end - size + 1, max(size // 2, 1)):
            piece = a[k : k + size]
            first = max(k + lag - near, 0)
            part = b[first : max(k + lag + near + size, 0)]
            if part.size < size or piece.std() == 0:
                continue
            lags, found, _ = _correlation(piece, part, np.ones(size, dtype=np.bool_), size)
            best = int(np.argmax(found))
            if found[best] >= MATCHES and 0 < best < found.size - 1:
                where.append((first + lags[best] + size / 2) * step)
    return np.array(where), longest * step


def _stretched(b: Array, slope: float, thin: int = 1) -> Array:
    """Return every so many-th point of a signal that lasts longer by this part."""
    return np.asarray(np.interp(np.arange(0, (1 + slope) * b.size, thin) / (1 + slope), np.arange(b.size), b))


def _scanned(a: Array, b: Array, step: float, lag: int, shaken: NDArray[np.bool_]) -> Array:
    """Return shift, besides that of `lag`, and drift, both in steps, at which a is found in b most clearly."""
    thin = max(int(SMOOTH / 2 / step), 1)
    count = min(int(np.ceil(DRIFT * b.size * step / TRIED)), MOST_TRIED)
    best, found = -np.inf, np.zeros(2)
    for slope in np.linspace(-DRIFT, DRIFT, 2 * count + 1):
        lags, _, _, score = _scores(a[::thin], _stretched(b, slope, thin), shaken[::thin])
        k = int(np.argmax(score))
        if score[k] > best:
            best, found = float(score[k]), np.array([lag - thin * lags[k], slope * (b.size - 1)])
    return found


def _refined(unlike: Callable[[Array], Array], start: Array, reach: float, most: float) -> tuple[Array, float]:
    """Return what makes two signals least unlike, and the standard deviation of its second number.

    It is the start, and the deviation infinite, where they are not least unlike at one place within `reach`, or where
    that number exceeds `most`.
    """
    from scipy.optimize import least_squares

    def slopes(x: Array) -> Array:
        """Return derivatives, over two samples: within one the interpolated signals have corners."""
        return np.stack([(unlike(x + e) - unlike(x - e)) / 2 for e in np.eye(2)], axis=1)

    def cost(x: Array) -> float:
        return sum_of_squares(unlike(x)) / 2

    x = least_squares(unlike, start, slopes, method=ALONE).x
    steps, signs = reach * np.eye(2), ((1, 1), (1, -1), (-1, 1), (-1, -1))
    bent = np.array([[sum(i * j * cost(x + i * p + j * q) for i, j in signs) for q in steps] for p in steps])
    if abs(x[1]) > most or not np.linalg.eigvalsh(bent)[0] > 0:
        return start, float("inf")
    moves = np.einsum("ij,j", slopes(x), np.linalg.inv(bent / (2 * reach) ** 2)[1]) * unlike(x)
    known = np.flatnonzero(moves)
    moves = moves[known[0] : known[-1] + 1] if known.size else moves
    by_parts = [[part.sum() for part in np.array_split(moves, parts)] for parts in PARTS]
    return x, max(float(np.linalg.norm(sums)) for sums in by_parts)


def _rounded(x: float, digits: int) -> float:
    return float(f"{x:.{digits}g}")


def doubts_of_drift(where: Array, size: float, unsure: float, length: float, step: float) -> list[str]:
    """Say that a drift is a guess, by its uncertainty or by the windows of this size, s, that match."""
    separate, last = 0, -np.inf
    for start in np.sort(where):
        if start >= last + size:
            separate, last = separate + 1, start
    parts = float(np.ptp(where)) + size if separate else 0.0
    if not np.isfinite(unsure):
        why = "the angular speeds do not decide it"
    elif unsure > VAGUE or unsure * length > step:
        late = _rounded(1e3 * unsure * length, 2)
        why = f"it is uncertain by {_rounded(1e6 * unsure, 2):g} ppm, which makes {late:g} ms over {length:.4g} s"
    elif separate < 2 or parts < length / 2:
        matching = counted(separate, "separate part")
        why = f"the angular speeds match in {matching}, within {parts:.3g} s of {length:.4g} s"
    else:
        return []
    return [
        f"the drift of the clocks is a guess: {why}; shake both sensors together at the start and at the end, or use "
        "--clocks shift (clocks='shift')"
    ]
