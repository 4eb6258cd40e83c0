"""The motion of one body relative to another, from two recordings: clocks, times, mountings.

**Times.** Where the two have other times, the attitudes of the second are interpolated at those of the first: by a
spline of rotations with continuous angular acceleration (order 4 in the spacing, SciPy's `RotationSpline`), or along
great circles (order 2) for motions with corners at their samples. Only times that both cover are kept.

**Clocks of two files.** Dates that overlap put both on one clock; if the angular speeds match closely at another shift
alone, this is said. Other recordings that begin at another time, or have another rate, are of two clocks: the shift is
looked for. The same times are of one clock where they do not begin at zero. Where they do, one system may have made
both, or two that count from their own beginnings: only angular speeds that match closely at a shift tell.

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

from ..geometry.arrays import Array
from ..geometry.values import counted, number_text
from .clocks import CLOSE, SURE, fitted_clock, speed_correlation, while_shaken
from .samples import GAP, Motion, Samples, samples

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

STILL = 1.0  # s, of the pose that is looked for
FEWEST = 5  # samples of it
MOVES = np.radians(3)  # a pose that turns by more is no rest
WORSE, ALIKE = 2.0, 0.05  # how many times, and at least, 1 - correlation is by dates that are contradicted
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
    if shake is not None and (beside is None or clocks == "shared"):
        raise ValueError(
            "--shake (shake=) aligns two clocks: add --clocks shift (clocks='shift') or --clocks drift (clocks='drift')"
            if beside is not None
            else "--shake (shake=) is of two sensors: name the second, --relative-to FILE (relative_to=)"
        )
    if beside is None:
        found, other = samples(motion)
    else:
        by_default, clocks = clocks is None, clocks or _clocks_of_files(motion, beside, shake)
        if clocks == "shared" and shake is None and _same_times(motion, beside):
            found, other = samples(motion, replace(beside, time=motion.time))
        else:
            found, other = _resampled(motion, beside, clocks, shake, order, by_default)
    if align == "static":
        found, other = _segments(found, other, static)
    return found if other is None else replace(found, quaternion=(other.rotation.inv() * found.rotation).as_quat())


def _clocks_of_files(motion: Motion, beside: Motion, shake: Array | None) -> Literal["shared", "shift"]:
    """Return whether two files share a clock; a ValueError where nothing tells, not even a shake."""
    if motion.time is None or beside.time is None:
        return "shift"
    ahead = _ahead(motion, beside)
    if ahead is not None:
        first, last = (ahead + np.nanmin(beside.time), ahead + np.nanmax(beside.time))
        return "shared" if first < np.nanmax(motion.time) and last > np.nanmin(motion.time) else "shift"
    if beside.start != motion.start or shake is not None:
        return "shift"
    n = min(len(motion.time), len(beside.time))
    if n < 2 or not np.array_equal(motion.time[:n], beside.time[:n], True):
        return "shift"
    (a, _), (b, _) = samples(motion), samples(beside)
    assert a.time is not None
    assert b.time is not None
    step = float(np.median(np.diff(a.time)))
    if abs(a.time[0]) > step:
        return "shared"
    fit = fitted_clock(a.rotation, a.time, b.rotation, b.time, drift=False)
    if abs(fit.shift) <= step:
        return "shared"
    if fit.correlation >= CLOSE:
        return "shift"
    raise ValueError(
        f"both recordings have the same times, but their angular speeds match best {abs(fit.shift):.3g} s apart "
        f"(correlation {fit.correlation:.2f}), which may be the motion of the joint; use --clocks shared if both come "
        "from one clock, --clocks shift if they come from two; --shake T0,T1 (shake=) names the time in which both "
        "sensors were shaken together"
    )


def _ahead(motion: Motion, beside: Motion) -> float | None:
    """Return by how much the second recording begins after the first, by the dates of both, s."""
    return None if motion.start is None or beside.start is None else beside.start - motion.start


def _same_times(motion: Motion, beside: Motion) -> bool:
    """Whether both have the same times, or no more than one has any; a ValueError where their numbers differ."""
    if motion.time is None or beside.time is None:
        if len(beside.values) != len(motion.values):
            raise ValueError(
                f"relative_to has {len(beside.values)} samples, the motion {len(motion.values)}: without times of both "
                "they must have been recorded simultaneously; --rate gives times, of the second file alone in "
                "--relative-options (time=, relative_time=)"
            )
        return True
    return np.array_equal(beside.time, motion.time, True) and beside.start == motion.start


def _resampled(
    motion: Motion, beside: Motion, clocks: str, shake: Array | None, order: int, by_default: bool
) -> tuple[Samples, Samples]:
    """Return both at the times of the first; `by_default`: nobody chose the clocks."""
    if motion.time is None or beside.time is None:
        raise ValueError(
            "clocks are aligned from times; give those of both recordings: --rate, of one file alone in "
            "--relative-options (time=, relative_time=)"
        )
    a, _ = samples(motion)
    try:
        b, _ = samples(beside)
    except ValueError as error:
        raise ValueError(f"relative_to: {error}") from error
    notes = [*a.notes, *(f"relative_to: {note}" for note in b.notes)]
    assert a.time is not None
    assert b.time is not None
    ahead = _ahead(motion, beside)
    s, facts = b.time + (ahead or 0.0), tuple[str, ...]()
    if clocks == "shared":
        if ahead is not None:
            late, alike = float(s[0] - a.time[0]), speed_correlation(a.rotation, a.time, b.rotation, s, shake)
            facts = (
                f"clock of relative_to: that of the dates of both files, by which it begins {abs(late):.4g} s "
                f"{'before' if late < 0 else 'after'} the other (correlation of the angular speeds"
                f"{while_shaken(shake)} {alike:.3f})",
            )
            notes += _doubts(a, b, s, shake, alike) if by_default else []
    else:
        fit = fitted_clock(a.rotation, a.time, b.rotation, s, drift=clocks == "drift", shake=shake)
        s = fit.times(s)
        facts = (fit.words(),)
        notes += fit.doubts
        if fit.correlation < (CLOSE if shake is None else SURE):
            why = (
                "the joint moves as well; shake both sensors together, and name that time, --shake T0,T1 (shake=), or "
                "use --clocks shared (clocks='shared') if both come from one clock"
                if shake is None
                else f"sensors that are shaken together, hard, reach {SURE:g}; check the times of --shake (shake=)"
            )
            notes.append(
                f"the clocks are aligned by angular speeds that match with a correlation of {fit.correlation:.2f} "
                f"alone: {why}"
            )
    step = np.diff(s)
    gap = step > GAP * np.median(step)  # nothing is known of what the second sensor did there
    k = np.searchsorted(s, a.time)
    inside = (a.time >= s[0]) & (a.time <= s[-1])
    inside &= ~gap[np.clip(k, 1, step.size) - 1] | np.isin(a.time, s)
    if inside.sum() < 2:
        raise ValueError(
            f"the recordings do not overlap: one is from {a.time[0]:.6g} s to {a.time[-1]:.6g} s, the other from "
            f"{s[0]:.6g} s to {s[-1]:.6g} s; --clocks shift (clocks='shift') finds how their clocks differ"
        )
    outside = int((~inside).sum())
    if outside:
        notes.append(f"dropped {counted(outside, 'row')} at times that relative_to does not cover")
    kept = Samples(a.quaternion[inside], a.time[inside], a.rows[inside], a.left_out + outside, notes, facts, a.lines)
    return kept, replace(kept, quaternion=_at(b.rotation, s, a.time[inside], order).as_quat())


def _doubts(a: Samples, b: Samples, s: Array, shake: Array | None, alike: float) -> list[str]:
    """Say that the angular speeds contradict the dates, where they match closely, and far better, at another shift.

    `alike` is their correlation by the dates. Half the sum of squares of the difference of both speeds, reduced to
    norm one, is 1 - correlation.
    """
    assert a.time is not None
    try:
        fit = fitted_clock(a.rotation, a.time, b.rotation, s, drift=False, shake=shake)
    except ValueError:  # too few samples, or bodies that move on their own
        return []
    if fit.correlation < CLOSE or 1 - alike < WORSE * (1 - fit.correlation) or 1 - alike < ALIKE:
        return []
    return [
        f"the dates are used, but the angular speeds match best with relative_to shifted by {fit.shift:+.6g} s "
        f"(correlation {fit.correlation:.3f} against {alike:.3f}); use --clocks shift (clocks='shift') if the "
        "devices' clocks differ, --clocks shared (clocks='shared') if not"
    ]


def _at(rotation: Rotation, time: Array, wanted: Array, order: int) -> Rotation:
    from scipy.spatial.transform import RotationSpline, Slerp

    if order == 2 or time.size < 4:
        return Slerp(time, rotation)(wanted)
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
    remedy = "choose another one" if static else "--static T0,T1 (static=) says where it is"
    moves = f"the sensors are not at rest in the static pose; {remedy}"
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
            raise ValueError(
                f"no sample is between {static[0]:g} and {static[1]:g}; they are from {time[0]:.6g} to {time[-1]:.6g}"
            )
        return chosen
    length = STILL if timed else FEWEST - 1.0
    last = np.searchsorted(time, time + length, side="right") - 1
    first = np.flatnonzero((last - np.arange(time.size) >= FEWEST - 1) & (time + length <= time[-1]))
    if not first.size:
        return np.arange(min(FEWEST, time.size))
    k = first[np.argmin(turns[last[first]] - turns[first])]
    return np.arange(k, last[k] + 1)
