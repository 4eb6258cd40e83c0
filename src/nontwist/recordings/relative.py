"""The motion of one body relative to another, from two recordings: clocks, times, mountings.

**Clocks.** Times and dates are taken as they are: two recordings whose times overlap are of one clock. Where they
cannot be, as their times do not overlap, dates that are whole or half hours apart are of two time zones; of all others
the shift is looked for in their angular speeds, and taken if it is decisive. What the speeds say of a clock that is
taken is a fact beside it, as neighbouring segments of an arm move on their own.

**A shift, or a shift and a drift.** A sensor on a body turns at the angular speed |w|, whatever its axes are and
whatever frame it reports to; so two sensors on one body, or on neighbouring ones that move together, show the same
course of |w|. The time of the second sensor s and that of the first t are taken to be related by

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

A shift is taken only if it is decisive: the speeds must match closely, and no other shift nearly as well. Motions that
repeat have many, and two segments of an arm move by themselves as well: so both sensors are shaken together at the
start, and at the end for a drift. Where the caller says when, the sums of 2, the difference of 3 and the parts of 4 are
those of the shaken samples alone, each with all of the other recording, and must match more closely: in seconds of
unrelated motion a correlation of 0.8 is found by chance.

**Times.** Where the two have other times, the attitudes of the second are interpolated at those of the first: by a
spline of rotations with continuous angular acceleration (order 4 in the spacing, SciPy's `RotationSpline`, its ends
extrapolated), or along great circles (order 2) for motions with corners at their samples. Only times that both cover,
to half an interval, are kept.

**Mountings.** A sensor is strapped to its segment in an attitude M that nobody knows: it reports R = S M, where S is
that of the segment. In a pose in which the axes of the segment are those of space, S = 1 and R₀ = M, so

    S(t) = R(t) R₀ᵀ

for both sensors, if both report to the same space. The axis of the twist is then a direction of space in that pose: of
an arm that hangs, the vertical. Without it, the axis is one of the sensor. The mounting of the second sensor does not
change the twist about an axis of the first: a constant rotation from the left moves path and non-twisting frame as one.
Sensors without a magnetometer have headings of their own; where two move as one, their turns in space show that.

The pose is where both turn least, within one second, or where the caller says. Its attitude is the mean over it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, InputWarning, Option
from ..geometry.arrays import Array, Rotation, sum_of_squares
from ..geometry.values import counted, number_text
from .motions import GAP, Samples, samples
from .orientations import Motion

STILL = 1.0  # s, of the pose that is looked for
FEWEST = 5  # samples of it
MOVES = np.radians(3)  # a pose that turns by more is no rest
HALF_HOUR, MOST_ZONES, DAY = 1800.0, 28, 86400.0  # s, of which time zones are whole numbers, up to 14 h
CLOCKS, SECOND = ("shared", "shift", "drift"), "the second recording"
CLOSE, SURE = 0.95, 0.97  # least correlation of recordings, and of those that were shaken together
APART, SHAKEN_APART = 0.015, 0.0024  # by which turns agree less than in spaces of their own: cosines of 10° and 4°
LITTLE = 0.01  # of the turns: weight of a space that is common to both
ALIKE = 0.3  # least correlation of neighbouring segments on one clock, which move on their own
OVERLAP = 0.3  # of the shorter recording that must overlap
SHORTEST = 50  # samples
WHOLE, SHAKEN = 0.5, 0.75  # of the points, that a second shift must have: one that loses a shake is none
RIVAL = 0.03  # a second shift whose correlation comes as close leaves the shift open
DRIFT = 1e-3  # largest drift
SMOOTH = 0.1  # s, full width at half maximum of what smooths the speeds for a drift
REACH = 0.025  # s, of second derivatives: noise within this time does not count
PARTS = (12, 24, 48)  # into which a recording is cut for the uncertainty of its drift
VAGUE = 30e-6  # a drift that is more uncertain is refused: clocks of quartz differ by little more
TRIED, MOST_TRIED = 0.1, 32  # s by which drifts that are tried differ over the recording; how many to each side
STEADY = 1e-9  # of the largest speed: changes below it are round-off
MOST = 2_000_000  # points of the grid


def relative_motion(
    motion: Motion, beside: Motion | None, clocks: str | None, shake: Array | None, align: bool, static: Any, order: int
) -> Samples:
    """Return the attitudes of `motion`, relative to those of `beside` where there is one, cleaned and noted.

    `shake`, (k, 2), are times of `motion` at which both moved as one, `static`, (2,), of a pose by which to `align`.
    """
    if static is not None and not align:
        raise InputError("static-alone")
    if beside is None and (shake is not None or clocks in ("shift", "drift")):
        raise InputError("one-sensor", name=Option("clocks" if shake is None else "shake"))
    if shake is not None and clocks == "shared":
        raise InputError("shake-of-one-clock")
    clocks = "shift" if clocks is None and shake is not None else clocks
    if beside is None:
        bodies = samples(motion)
    elif clocks in ("shift", "drift") or not _same_rows(motion, beside):
        bodies = _resampled(motion, beside, clocks, shake, order)
    else:
        bodies = samples(motion, beside)
    if len(bodies) == 2:
        bodies[0].notes.extend(_spaces_apart(bodies[0], bodies[1], shake))
    if align:
        bodies = _segments(bodies, static)
    found, *others = bodies
    return replace(found, quaternion=(others[0].rotation.inv() * found.rotation).as_quat()) if others else found


def _same_rows(motion: Motion, beside: Motion) -> bool:
    """Whether rows of both are of the same times, or no more than one has any; an InputError where counts differ."""
    if motion.time is not None and beside.time is not None:
        return np.array_equal(beside.time, motion.time, True) and beside.start == motion.start
    if len(beside.values) != len(motion.values):
        raise InputError("sample-counts", other=len(beside.values), count=len(motion.values))
    return True


def _resampled(motion: Motion, beside: Motion, clocks: str | None, shake: Array | None, order: int) -> list[Samples]:
    """Return both at the times of the first."""
    from scipy.spatial.transform import RotationSpline, Slerp

    if motion.time is None or beside.time is None:
        raise InputError("no-times")
    [a] = samples(motion)
    try:
        [b] = samples(beside)
    except InputError as error:
        raise error.about(SECOND) from error
    t, s, A, B = np.asarray(a.time), np.asarray(b.time), a.rotation, b.rotation
    notes, facts, fit = [*a.notes, *(note.about(SECOND) for note in b.notes)], tuple[str, ...](), None
    starts = [one for one in (motion.start, beside.start) if one is not None]
    is_dated, which = len(starts) == 2, "times as they are"
    if is_dated:
        late, which = starts[1] - starts[0], "that of the dates of both"
        s = s + (late - DAY * round(late / DAY) if min(starts) < DAY else late)  # a time of day, or a date
    is_shared = len(starts) != 1 and bool(s[0] < t[-1] and s[-1] > t[0])
    if is_dated and clocks is None and not is_shared and (zone := _zone(t, s)):
        s, is_shared = s + zone, True
        notes.append(InputWarning("time-zones", hours=abs(zone) / 3600))
    if clocks in ("shift", "drift") or (clocks is None and not is_shared):
        try:
            fit = fitted_clock(A, t, B, s, drift=clocks == "drift", shake=shake)
        except InputError as error:
            if not is_dated or clocks is not None:
                raise
            raise InputError("dates-apart", hours=abs(s[0] - t[0]) / 3600) from error
        s, facts = fit.times, (fit.words,)
    elif clocks is None or is_dated:
        late, alike = float(s[0] - t[0]), speed_correlation(A, t, B, s)
        begins = f"by which it begins {abs(late):.4g} s {'before' if late < 0 else 'after'} the other"
        facts = (f"clock of {SECOND}: {which}, {begins} (correlation of the angular speeds {alike:.3f})",)
        if clocks is None and alike < CLOSE and (shift := _shift_by_speeds(A, t, B, s)):
            notes.append(InputWarning("clocks-differ", shift=shift, alike=alike))
        elif not is_dated and alike < ALIKE:
            notes.append(InputWarning("clocks-unlike", alike=alike))
    inside = _covered(t, s)
    if inside.sum() < 2:
        raise InputError("no-overlap", first=t[0], last=t[-1], other_first=s[0], other_last=s[-1])
    if outside := int((~inside).sum()):
        notes.append(InputWarning("not-covered", rows=counted(outside, "row")))
    t, A = t[inside], A[inside]
    kept = Samples(a.quaternion[inside], t, a.rows[inside], a.left_out + outside, notes, facts, a.lines)
    spline = order == 4 and s.size >= 4
    B = RotationSpline(*_prolonged(s, B))(t) if spline else Slerp(s, B)(np.clip(t, s[0], s[-1]))
    if fit is not None:
        counts = within(t, shake)[1:]
        against, *own = (sum_of_squares(turns(R)[counts]) for R in (B.inv() * A, A, B))
        if against >= min(own):  # two bodies turn against each other as much as they turn
            raise InputError("relative-motion", shift=fit.shift)
    return [kept, replace(kept, quaternion=B.as_quat())]


def _prolonged(s: Array, B: Rotation) -> tuple[Array, Rotation]:
    """Return times and attitudes with two more at half an interval from each end, where `RotationSpline` is steady.

    They are of the cubic through the four at this end, beside the mean rotation: those in between keep the order 4.
    """
    from scipy.spatial.transform import Rotation

    near, back = np.median(np.diff(s)) / 2, np.array([[-1.001], [-1.0]])
    for _ in range(2):  # the first end, and in reversed time the last
        k = np.unique(np.searchsorted(s, s[0] + near * np.array([0, 1.5, 3, 4.5])).clip(max=s.size - 1))
        away, tau = B[0].inv() * B[k], (s[k] - s[0]) / near
        mean = away[1].as_rotvec() / tau[1]
        rest = (away * Rotation.from_rotvec(-np.outer(tau, mean))).as_rotvec()
        ahead = Rotation.from_rotvec(np.polyval(np.polyfit(tau, rest, k.size - 1), back))
        B = Rotation.concatenate([B[0] * ahead * Rotation.from_rotvec(back * mean), B])[::-1]
        s = -np.append(s[0] + near * back, s)[::-1]
    return s, B


def _spaces_apart(a: Samples, b: Samples, shake: Array | None) -> list[InputWarning]:
    """Return what is to be said where two bodies move as one, but each in a space of its own.

    The turns of both in space, of which the second may be turned as fits best, then agree; as they are, they do not.
    """
    from scipy.spatial.transform import Rotation

    counts = slice(None) if a.time is None else within(a.time, shake)[1:]
    u, v = ((one.rotation[1:] * one.rotation[:-1].inv()).as_rotvec()[counts] for one in (a, b))
    size = float(np.linalg.norm(u) * np.linalg.norm(v))
    if len(u) < SHORTEST or size == 0:
        return []
    known = np.sqrt(LITTLE * size) * np.eye(3)  # decides what turns about one axis leave open
    turn, _ = Rotation.align_vectors(np.concatenate([u, known]), np.concatenate([v, known]))
    alike, best = float((u * v).sum() / size), float((u * turn.apply(v)).sum() / size)
    if best < CLOSE or alike > best - (APART if shake is None else SHAKEN_APART):
        return []
    return [InputWarning("spaces-apart", angle=np.degrees(turn.magnitude()), alike=alike, best=best)]


def _shift_by_speeds(a: Rotation, t: Array, b: Rotation, s: Array) -> float:
    """Return the shift of the times s that angular speeds decide, 0 where they do not or it is that of a sample."""
    try:
        shift = fitted_clock(a, t, b, s, drift=False).shift
    except InputError:
        return 0.0
    return shift if abs(shift) > np.median(np.diff(t)) + np.median(np.diff(s)) else 0.0


def _zone(t: Array, s: Array) -> float:
    """Return the whole number of half hours, up to 14 h, that make times overlap most; 0 where none does."""
    apart = float((t[0] + t[-1] - s[0] - s[-1]) / 2)
    shift = round(apart / HALF_HOUR) * HALF_HOUR
    near = abs(shift) <= MOST_ZONES * HALF_HOUR
    return shift if near and s[0] + shift < t[-1] and s[-1] + shift > t[0] else 0.0


def _covered(t: Array, s: Array) -> NDArray[np.bool_]:
    """Whether times are among those of the second sensor, and not in a gap, where nothing is known of it."""
    step = np.diff(s)
    near = np.median(step) / 2  # beyond its ends
    gap = step > GAP * np.median(step)
    k = np.searchsorted(s, t)
    inside = (t >= s[0] - near) & (t <= s[-1] + near)
    return np.asarray(inside & (~gap[np.clip(k, 1, step.size) - 1] | np.isin(t, s)))


def _segments(bodies: Sequence[Samples], static: Array | None) -> list[Samples]:
    """Return the attitudes of segments whose axes are those of space in the static pose.

    It is given, or the second in which the bodies turn least.
    """
    found, unit = bodies[0], "(row, from 0)" if bodies[0].time is None else "s"
    time = found.rows.astype(float) if found.time is None else found.time
    if static is not None:
        chosen = np.flatnonzero((time >= static[0]) & (time <= static[1]))
        if not chosen.size:
            raise InputError("no-pose", first=static[0], last=static[1], start=time[0], end=time[-1])
    else:
        turned = np.sum([np.append(0.0, np.cumsum(turns(one.rotation))) for one in bodies], axis=0)
        end = time + (FEWEST - 1.0 if found.time is None else STILL)
        last, chosen = np.searchsorted(time, end, side="right") - 1, np.arange(min(FEWEST, time.size))
        first = np.flatnonzero((last - np.arange(time.size) >= FEWEST - 1) & (end <= time[-1]))
        if first.size:
            k = first[np.argmin(turned[last[first]] - turned[first])]
            chosen = np.arange(k, last[k] + 1)
    means = [one.rotation[chosen].mean() for one in bodies]
    away = max(float((M.inv() * one.rotation[chosen]).magnitude().max()) for M, one in zip(means, bodies, strict=True))
    note = (
        f"static pose {'chosen' if static is None else 'given'}, from {time[chosen][0]:.6g} to {time[chosen][-1]:.6g} "
        f"{unit}, which moves by up to {number_text(np.degrees(away), '.2g')}°: there the axes of the body are those "
        "of space"
    )
    notes = [*found.notes, *([InputWarning("pose-moves")] if away > MOVES else [])]
    return [
        replace(one, quaternion=(one.rotation * M.inv()).as_quat(), notes=notes, facts=(*found.facts, note))
        for one, M in zip(bodies, means, strict=True)
    ]


class ClockFit(NamedTuple):
    """How the clock of the second recording differs from that of the first; its times by the first, and words for it.

    `unsure` is twice the standard deviation of the drift, None where none was looked for.
    """

    shift: float
    drift: float
    unsure: float | None
    times: Array
    words: str


def fitted_clock(a: Rotation, t: Array, b: Rotation, s: Array, *, drift: bool, shake: Array | None = None) -> ClockFit:
    """Return the clock that makes the angular speeds of a(t) and b(s) agree best.

    `shake`, (k, 2), are intervals of t in which both moved as one; the speeds at other times are ignored.

    Raises
    ------
    InputError
        The clock is not decided: speeds do not match, several shifts match, the drift is uncertain, samples are few.
    """
    many = int(within(t, shake).sum())
    if min(many, s.size) < SHORTEST:
        code = "few-to-align" if shake is None else "few-shaken"
        raise InputError(code, least=SHORTEST, count=many, other=s.size, first=t[0], last=t[-1])
    step = float(max(min(np.median(np.diff(t)), np.median(np.diff(s))), np.ptp(t) / MOST, np.ptp(s) / MOST))
    va, vb = (_speed(rotation, time) for rotation, time in ((a, t), (b, s)))
    grid_a, grid_b = (np.arange(time[0], time[-1], step) for time in (t, s))
    fa, fb = np.interp(grid_a, *va), np.interp(grid_b, *vb)
    shaken = within(grid_a, shake)
    if (count := min(shaken.sum(), grid_b.size)) < min(SHORTEST, many):
        raise InputError("long-recordings", step=step, count=count, length=np.ptp(t), other=np.ptp(s))
    if any(np.ptp(f) <= STEADY * f.max() for f in (fa[shaken], fb)):
        raise InputError("steady-speeds")
    lag, _, rival = _search(fa, fb, shaken)
    shift, span = float(t[0] - s[0] - lag * step), float(max(np.ptp(s), step))

    def clock(x: Array) -> tuple[float, float]:
        """Return shift and drift of x: in steps, the drift those that it makes over the second recording."""
        return float(shift + x[0] * step), float(x[1] * step / span) if drift else 0.0

    def unlike(x: Array, f: Array, other: tuple[Array, Array]) -> Array:
        ahead, slope = clock(x)
        there = s[0] + (grid_a - s[0] - ahead) / (1 + slope)
        inside = shaken & (there >= s[0]) & (there <= s[-1])
        return _reduced(f, inside) - _reduced(np.interp(there, *other), inside)

    unsure = None
    if drift:
        smooth_a, smooth_b, thin = _smoothed(fa, step), _smoothed(fb, step), max(int(SMOOTH / 2 / step), 1)
        count = min(int(np.ceil(DRIFT * fb.size * step / TRIED)), MOST_TRIED)
        found, slope, _ = _search(smooth_a, smooth_b, shaken, np.linspace(-DRIFT, DRIFT, 2 * count + 1), thin)
        start, reach, most = np.array([lag - found, slope * (fb.size - 1)]), REACH / step, 2 * DRIFT * span / step
        x, deviation = _refined(lambda x: unlike(x, smooth_a, (grid_b, smooth_b))[shaken], start, max(reach, 1.0), most)
        unsure = float(2 * deviation * step / span)
        _, _, rival = _search(fa, fb, shaken, [clock(x)[1]])
    else:
        x = _fitted(unlike, np.zeros(1), args=(fa, vb))
    correlation, least = 1 - sum_of_squares(unlike(x, fa, vb)) / 2, CLOSE if shake is None else SURE
    if not correlation >= least:
        raise InputError("unlike-speeds", correlation=correlation, least=least)
    if rival is not None:
        raise InputError("several-shifts", apart=rival[0] * step, other=rival[1], best=rival[2])
    if unsure is not None and not (unsure <= VAGUE and unsure * min(np.ptp(t), span) <= step):
        raise InputError("uncertain-drift", ppm=1e6 * unsure)
    ahead, slope = clock(x)
    shown, during = f"{ahead + 0.0:+.5f}".rstrip("0").rstrip("."), ""
    if unsure is not None:
        ppm, most = float(f"{1e6 * slope:.3g}"), float(f"{1e6 * unsure:.1g}")
        shown += f" s at its first sample, drift {ppm:+g} ± {most:g} ppm"
    if shake is not None:
        during = f" from {' and '.join(f'{first:.12g} to {last:.12g} s' for first, last in shake)}:"
    words = f"clock of {SECOND}: shifted by {shown}{' s' * (unsure is None)} (correlation of the angular speeds"
    times = s[0] + ahead + (1 + slope) * (s - s[0])
    return ClockFit(ahead, slope, unsure, times, f"{words}{during} {correlation:.3f})")


def speed_correlation(a: Rotation, t: Array, b: Rotation, s: Array) -> float:
    """Return the correlation of the angular speeds of a(t) and b(s) where both are known; 0 where one is steady."""
    time, speed = _speed(a, t)
    inside = (time >= s[0]) & (time <= s[-1])
    return float((_reduced(speed, inside) * _reduced(np.interp(time, *_speed(b, s)), inside)).sum())


def within(time: Array, shake: Array | None) -> NDArray[np.bool_]:
    """Whether times are in one of these intervals, (k, 2), or there are none."""
    first, last = [-np.inf, np.inf] if shake is None else shake.T
    return np.asarray(((time[:, None] >= first) & (time[:, None] <= last)).any(axis=1))


def turns(rotation: Rotation) -> Array:
    """Return the angles between neighbouring attitudes, rad."""
    return np.asarray((rotation[:-1].inv() * rotation[1:]).magnitude())


def _speed(rotation: Rotation, time: Array) -> tuple[Array, Array]:
    """Return the midpoints of the intervals and the angular speeds, rad/s."""
    return (time[1:] + time[:-1]) / 2, turns(rotation) / np.diff(time)


def _reduced(f: Array, inside: Any) -> Array:
    """Return a signal with mean zero and norm one where it counts."""
    g = np.where(inside, f - f[inside].mean() if inside.any() else 0.0, 0.0)
    norm = np.sqrt(sum_of_squares(g))
    return np.asarray(g / norm if norm > 0 else g)


def _scores(a: Array, b: Array, shaken: NDArray[np.bool_]) -> tuple[Array, Array, Array, Array]:
    """Return lags (b[i + lag] beside a[i]), how significant each correlation is, the correlation, of how many points.

    It is that of the points of a that are `shaken`, where enough of them overlap with b.
    """
    from scipy.signal import correlate, correlation_lags

    least = max(int(OVERLAP * min(shaken.sum(), b.size)), 10)
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
    return correlation_lags(b.size, a.size), np.arctanh(np.clip(found, -0.999999, 0.999999)) * np.sqrt(n), found, n


def _search(
    a: Array, b: Array, shaken: NDArray[np.bool_], slopes: Iterable[float] = (0.0,), thin: int = 1
) -> tuple[int, float, tuple[float, float, float] | None]:
    """Return lag and slope at which a is found in b most clearly, where b lasts longer by one of these slopes.

    And how many points away another lag fits nearly as well, with the correlations of both; every `thin`-th point
    counts.
    """
    best: tuple[Any, ...] = ()
    for slope in slopes:
        points = np.arange(0, (1 + slope) * b.size, thin) / (1 + slope)
        scores = _scores(a[::thin], np.interp(points, np.arange(b.size), b), shaken[::thin])
        if not best or scores[1].max() > best[1].max():
            best = (*scores, slope)
    lags, score, found, n, slope = best
    k, steps = int(np.argmax(score)), np.diff(score)
    left = max(np.flatnonzero(steps[:k] <= 0), default=-1) + 1
    right = k + min(np.flatnonzero(steps[k:] >= 0), default=score.size - 1 - k)
    rivals = np.where(n >= (WHOLE if shaken.all() else SHAKEN) * n[k], found, -1.0)
    rivals[left : right + 1] = -1.0
    j = int(np.argmax(rivals))
    rival = None if found[j] < found[k] - RIVAL else (float(lags[k] - lags[j]), float(found[j]), float(found[k]))
    return thin * int(lags[k]), slope, rival


def _smoothed(f: Array, step: float) -> Array:
    """Return a signal smoothed by a window of Hann, which is symmetric and so shifts nothing."""
    half = round(SMOOTH / step)
    if half < 2:
        return f
    window = np.hanning(2 * half + 1)[1:-1]
    return np.convolve(np.pad(f, half - 1, mode="edge"), window / window.sum(), mode="valid")


def _fitted(unlike: Callable[..., Array], start: Array, slopes: Any = "2-point", args: tuple[Any, ...] = ()) -> Array:
    """Return the least squares by Levenberg and Marquardt's method of MINPACK, without BLAS, whose threads compete."""
    from scipy.optimize import least_squares

    return np.asarray(least_squares(unlike, start, slopes, method="lm", args=args).x)


def _refined(unlike: Callable[[Array], Array], start: Array, reach: float, most: float) -> tuple[Array, float]:
    """Return what makes two signals least unlike, and the standard deviation of its second number.

    It is the start, and the deviation infinite, where they are not least unlike at one place within `reach`, or where
    that number exceeds `most`.
    """

    def slopes(x: Array) -> Array:
        """Return derivatives, over two samples: within one the interpolated signals have corners."""
        return np.stack([(unlike(x + e) - unlike(x - e)) / 2 for e in np.eye(2)], axis=1)

    x = _fitted(unlike, start, slopes)
    steps, signs = reach * np.eye(2), ((1, 1), (1, -1), (-1, 1), (-1, -1))
    costs = [[[i * j * sum_of_squares(unlike(x + i * p + j * q)) for i, j in signs] for q in steps] for p in steps]
    hessian = np.sum(costs, axis=2) / 2 / (2 * reach) ** 2
    if abs(x[1]) > most or not np.linalg.eigvalsh(hessian)[0] > 0:
        return start, float("inf")
    moves = np.einsum("ij,j", slopes(x), np.linalg.inv(hessian)[1]) * unlike(x)
    counted = np.trim_zeros(moves)
    by_parts = [[part.sum() for part in np.array_split(counted, parts)] for parts in PARTS]
    return x, max(float(np.linalg.norm(sums)) for sums in by_parts)
