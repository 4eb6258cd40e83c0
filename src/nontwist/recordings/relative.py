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

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, InputWarning, Option
from ..geometry.arrays import Array
from ..geometry.values import counted, number_text
from .clocks import ClockFit, fitted_clock, speed_correlation, while_shaken, within
from .motions import Motion
from .samples import GAP, Samples, samples

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

STILL = 1.0  # s, of the pose that is looked for
FEWEST = 5  # samples of it
MOVES = np.radians(3)  # a pose that turns by more is no rest
HALF_HOUR, MOST_ZONES, DAY = 1800.0, 28, 86400.0  # s, of which time zones are whole numbers, up to 14 h
CLOCKS = ("shared", "shift", "drift")


def relative_motion(
    motion: Motion,
    beside: Motion | None,
    *,
    clocks: Literal["shared", "shift", "drift"] | None,
    shake: Array | None,
    align: Literal["static"] | None,
    static: tuple[float, float] | None,
    order: int,
) -> Samples:
    """Return the attitudes of `motion`, relative to those of `beside` where there is one, cleaned and noted.

    `shake`, (k, 2), are times of `motion` at which both moved as one.
    """
    if static is not None and align is None:
        raise InputError("static-alone")
    if beside is None and (shake is not None or clocks in ("shift", "drift")):
        name = "shake" if shake is not None else "clocks"
        raise InputError("one-sensor", name=Option(name))
    if shake is not None and clocks == "shared":
        raise InputError("shake-of-one-clock")
    if beside is None:
        found, other = samples(motion)
    elif clocks in (None, "shared") and shake is None and _same_rows(motion, beside):
        found, other = samples(motion, replace(beside, time=motion.time))
    else:
        found, other = _resampled(
            motion, beside, "shift" if clocks is None and shake is not None else clocks, shake, order
        )
    if align == "static":
        found, other = _segments(found, other, static)
    return found if other is None else replace(found, quaternion=(other.rotation.inv() * found.rotation).as_quat())


def _same_rows(motion: Motion, beside: Motion) -> bool:
    """Whether rows of both are of the same times, or no more than one has any; an InputError where counts differ."""
    if motion.time is None or beside.time is None:
        if len(beside.values) != len(motion.values):
            raise InputError("sample-counts", other=len(beside.values), count=len(motion.values))
        return True
    return np.array_equal(beside.time, motion.time, True) and beside.start == motion.start


def _resampled(
    motion: Motion, beside: Motion, clocks: str | None, shake: Array | None, order: int
) -> tuple[Samples, Samples]:
    """Return both at the times of the first."""
    if motion.time is None or beside.time is None:
        raise InputError("no-times")
    a, _ = samples(motion)
    try:
        b, _ = samples(beside)
    except InputError as error:
        raise error.about("relative_to") from error
    assert a.time is not None
    assert b.time is not None
    notes = [*a.notes, *(note.about("relative_to") for note in b.notes)]
    starts = [one for one in (motion.start, beside.start) if one is not None]
    dated = None if len(starts) < 2 else starts[1] - starts[0]
    if dated is not None and min(starts) < DAY:  # a time of day
        dated -= DAY * round(dated / DAY)
    s, facts, fit = b.time + (dated or 0.0), tuple[str, ...](), None
    overlap = bool(len(starts) != 1 and s[0] < a.time[-1] and s[-1] > a.time[0])
    zone = 0.0 if overlap or dated is None or clocks is not None else _zone(a.time, s)
    if zone:
        s = s + zone
        notes.append(InputWarning("time-zones", hours=abs(zone) / 3600))
    if clocks in ("shift", "drift") or (clocks is None and not overlap and not zone):
        fit = fitted_clock(a.rotation, a.time, b.rotation, s, drift=clocks == "drift", shake=shake)
        s, facts = fit.times(s), (fit.words(),)
    elif clocks is None or dated is not None:
        late = float(s[0] - a.time[0])
        alike = speed_correlation(a.rotation, a.time, b.rotation, s, shake)
        which = "times as they are" if dated is None else "that of the dates of both files"
        facts = (
            f"clock of relative_to: {which}, by which it begins {abs(late):.4g} s {'before' if late < 0 else 'after'} "
            f"the other (correlation of the angular speeds{while_shaken(shake)} {alike:.3f})",
        )
    inside = _covered(a.time, s)
    if inside.sum() < 2:
        ends = {"first": a.time[0], "last": a.time[-1], "other_first": s[0], "other_last": s[-1]}
        raise InputError("no-overlap", **ends)
    outside = int((~inside).sum())
    if outside:
        notes.append(InputWarning("not-covered", rows=counted(outside, "row")))
    t = a.time[inside]
    kept = Samples(a.quaternion[inside], t, a.rows[inside], a.left_out + outside, notes, facts, a.lines)
    other = _at(b.rotation, s, t, order)
    if fit is not None:
        _require_common(
            kept.rotation, other, np.ones(inside.sum(), np.bool_) if shake is None else within(t, shake), fit
        )
    return kept, replace(kept, quaternion=other.as_quat())


def _require_common(one: Rotation, other: Rotation, counts: NDArray[np.bool_], fit: ClockFit) -> None:
    """Raise an InputError where a shift is not decisive, as two bodies turn against each other as much as they turn."""
    sizes = [(r[:-1].inv() * r[1:]).magnitude()[counts[1:]] for r in (other.inv() * one, one, other)]
    against, *own = (float((size**2).sum()) for size in sizes)
    if against >= min(own):
        raise InputError("relative-motion", shift=fit.shift)


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


def _at(rotation: Rotation, time: Array, wanted: Array, order: int) -> Rotation:
    from scipy.spatial.transform import RotationSpline, Slerp

    if order == 2 or time.size < 4:
        return Slerp(time, rotation)(np.clip(wanted, time[0], time[-1]))
    return RotationSpline(time, rotation)(wanted)


def _segments(
    found: Samples, other: Samples | None, static: tuple[float, float] | None
) -> tuple[Samples, Samples | None]:
    """Return the attitudes of segments whose axes are those of space in the static pose."""
    bodies = [found] if other is None else [found, other]
    time = found.rows.astype(float) if found.time is None else found.time
    turns = sum(np.append(0.0, np.cumsum((one.rotation[:-1].inv() * one.rotation[1:]).magnitude())) for one in bodies)
    chosen = _pose(time, np.asarray(turns), static, found.time is not None)
    means = [one.rotation[chosen].mean() for one in bodies]
    away = max(
        float((mean.inv() * one.rotation[chosen]).magnitude().max()) for mean, one in zip(means, bodies, strict=True)
    )
    unit = "s" if found.time is not None else "(row, from 0)"
    note = (
        f"static pose {'given' if static else 'chosen'}, from {time[chosen][0]:.6g} to {time[chosen][-1]:.6g} {unit}, "
        f"which moves by up to {number_text(np.degrees(away), '.2g')}°: there the axes of the body are those of space"
    )
    moves = InputWarning("pose-moves")
    found = replace(found, notes=[*found.notes, *([moves] if away > MOVES else [])], facts=(*found.facts, note))
    aligned = [
        replace(one, quaternion=(one.rotation * mean.inv()).as_quat())
        for one, mean in zip([found, *bodies[1:]], means, strict=True)
    ]
    return aligned[0], aligned[1] if other is not None else None


def _pose(time: Array, turns: Array, static: tuple[float, float] | None, timed: bool) -> Any:
    """Return the rows of the static pose: given, or the second in which the bodies turn least."""
    if static is not None:
        chosen = np.flatnonzero((time >= static[0]) & (time <= static[1]))
        if not chosen.size:
            ends = {"start": time[0], "end": time[-1]}
            raise InputError("no-pose", first=static[0], last=static[1], **ends)
        return chosen
    length = STILL if timed else FEWEST - 1.0
    last = np.searchsorted(time, time + length, side="right") - 1
    first = np.flatnonzero((last - np.arange(time.size) >= FEWEST - 1) & (time + length <= time[-1]))
    if not first.size:
        return np.arange(min(FEWEST, time.size))
    k = first[np.argmin(turns[last[first]] - turns[first])]
    return np.arange(k, last[k] + 1)
