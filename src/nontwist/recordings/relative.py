"""The motion of one body relative to another, from two recordings: clocks, times, mountings.

**Clocks.** Times and dates are taken as they are: two recordings whose times overlap are of one clock. Where they
cannot be, as their times do not overlap, dates that are whole or half hours apart are of two time zones; of all others
the shift is looked for in their angular speeds, and taken if it is decisive (`clocks`). What the speeds say of a clock
that is taken is a fact beside it, as neighbouring segments of an arm move on their own.

**Times.** Where the two have other times, the attitudes of the second are interpolated at those of the first: by a
spline of rotations with continuous angular acceleration (order 4 in the spacing, SciPy's `RotationSpline`), or along
great circles (order 2) for motions with corners at their samples. Only times that both cover, to half an interval, are
kept.

**Mountings.** A sensor is strapped to its segment in an attitude M that nobody knows: it reports R = S M, where S is
that of the segment. In a pose in which the axes of the segment are those of space, S = 1 and R₀ = M, so

    S(t) = R(t) R₀ᵀ

for both sensors, if both report to the same space. The axis of the twist is then a direction of space in that pose: of
an arm that hangs, the vertical. Without it, the axis is one of the sensor. The mounting of the second sensor alone, or
a turn of its space about any axis, does not change the twist about an axis of the first: a constant rotation from the
left moves path and non-twisting frame as one.

The pose is where both turn least, within one second, or where the caller says. Its attitude is the mean over it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, InputWarning, Option
from ..geometry.arrays import Array, sum_of_squares
from ..geometry.values import counted, number_text
from .attitudes import Motion
from .clocks import fitted_clock, speed_correlation, turns, within
from .motions import GAP, Samples, samples

STILL = 1.0  # s, of the pose that is looked for
FEWEST = 5  # samples of it
MOVES = np.radians(3)  # a pose that turns by more is no rest
HALF_HOUR, MOST_ZONES, DAY = 1800.0, 28, 86400.0  # s, of which time zones are whole numbers, up to 14 h
CLOCKS = ("shared", "shift", "drift")


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
        raise error.about("relative_to") from error
    t, s, A, B = np.asarray(a.time), np.asarray(b.time), a.rotation, b.rotation
    notes, facts, fit = [*a.notes, *(note.about("relative_to") for note in b.notes)], tuple[str, ...](), None
    starts = [one for one in (motion.start, beside.start) if one is not None]
    is_dated, which = len(starts) == 2, "times as they are"
    if is_dated:
        late, which = starts[1] - starts[0], "that of the dates of both files"
        s = s + (late - DAY * round(late / DAY) if min(starts) < DAY else late)  # a time of day, or a date
    is_shared = len(starts) != 1 and bool(s[0] < t[-1] and s[-1] > t[0])
    if is_dated and clocks is None and not is_shared and (zone := _zone(t, s)):
        s, is_shared = s + zone, True
        notes.append(InputWarning("time-zones", hours=abs(zone) / 3600))
    if clocks in ("shift", "drift") or (clocks is None and not is_shared):
        fit = fitted_clock(A, t, B, s, drift=clocks == "drift", shake=shake)
        s, facts = fit.times(s), (fit.words(),)
    elif clocks is None or is_dated:
        late, alike = float(s[0] - t[0]), speed_correlation(A, t, B, s)
        begins = f"by which it begins {abs(late):.4g} s {'before' if late < 0 else 'after'} the other"
        facts = (f"clock of relative_to: {which}, {begins} (correlation of the angular speeds {alike:.3f})",)
    inside = _covered(t, s)
    if inside.sum() < 2:
        raise InputError("no-overlap", first=t[0], last=t[-1], other_first=s[0], other_last=s[-1])
    if outside := int((~inside).sum()):
        notes.append(InputWarning("not-covered", rows=counted(outside, "row")))
    t, A = t[inside], A[inside]
    kept = Samples(a.quaternion[inside], t, a.rows[inside], a.left_out + outside, notes, facts, a.lines)
    B = RotationSpline(s, B)(t) if order == 4 and s.size >= 4 else Slerp(s, B)(np.clip(t, s[0], s[-1]))
    if fit is not None:
        counts = within(t, shake)[1:]
        against, *own = (sum_of_squares(turns(R)[counts]) for R in (B.inv() * A, A, B))
        if against >= min(own):  # two bodies turn against each other as much as they turn
            raise InputError("relative-motion", shift=fit.shift)
    return [kept, replace(kept, quaternion=B.as_quat())]


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
