r"""The interval of a recording in which a body moves as its model does: from release to catch.

Where an accelerometer reads almost nothing the body falls freely. Far from the centre of mass it reads the centripetal
acceleration as well, so this is only a first guess. Without it, or about a pivot, windows in which the body turns by
some rad (`SEED`, more where more is fitted) are ranked by the residual of the weak form (`estimating`): a hand exerts
moments, the air hardly. A recording of a body on which something acts may well be one motion from end to end, so its
beginning and, where that is one, the whole of it are tried before its windows. Guesses that noise explains count first.

The model is fitted to a first guess and predicts what comes before and after; the interval grows as long as the
prediction agrees with the recording within the errors of both, is fitted again, and so on until neither side grows.
Backwards, ``-W(-t)`` is a motion of the same body (`motions.Motion`).

All this is done with means of samples over turns of `THIN`, which differ from W by ``W'' h²/24``, about 1e-4 of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SENTENCES, InputError
from ..geometry.arrays import Array
from ..machine import cached_property
from ..recordings.reading import Rates
from .estimating import FEWEST as PART
from .estimating import Guess, acting, allowed, balanced, in_lanes, turns, whole_of, windowed
from .measuring import READINGS, Gyroscope, speed_of
from .predictions import Motion, RunawayError, Track, responses
from .shooting import Shooting, Stretch, haste_of, noise_of
from .solving import Solution, inverse
from .unknowns import TRACELESS, G, Model

THIN = 0.05  # rad, of the fastest turn
SEED, SHARE = (2.0, 4.0), 0.2  # rad, least and most, for a free body; of all that it turns
MOST_WINDOWS, BLOCK, SEEDS, ROUNDS = 10_000, 500, 3, 10
SLOW = 0.3  # of the fastest window: slower ones are no throw
FLOOR = 0.001  # of the speed: what sensors are off by besides noise
OFF, SMOOTHED = 4.0, 5  # mean square of the deviation over its variance, over so many samples
FREE, NOISY = 0.02, 0.05  # of the speed: larger residuals are no motion of the model, unless noise is as large
EXPLAINED = 2.0  # times the noise: residuals that it explains
LIKELY = 0.05  # residual of the weak form: larger ones need no fit
FEWEST, CALLS = 20, 20  # samples of a window; trials of a fit
MORE = 2.0  # times the residuals that a window may leave: those of rough fits in lanes that need no other
FALL, SHORTEST = 0.3, 0.1  # g; s


class NoMotionError(InputError):
    """Nowhere does a body of the model move as recorded."""

    def __init__(self, code: str, within: str = "", fits: str = "", remedy: str = "", **fields: Any) -> None:
        super().__init__(code, within, fits=fits, remedy=remedy, **fields)

    def with_what_fits(self, found: dict[str, str]) -> InputError:
        """Return the error that also says what fits, and which option it needs."""
        return InputError(self.code, self.within, **self.fields | found)


FITS = "{fits}{remedy}"
SENTENCES["no-motion"] = (
    "no {what} found: nowhere does the angular velocity follow {law} to {percent:g} %; was it {begun}, and is it "
    "rigid? Name an interval: {option[interval]}" + FITS
)


def falls(time: Array, acceleration: Array) -> list[tuple[int, int]]:
    """Return the intervals in which an accelerometer, in g or m/s², reads almost nothing, the longest first."""
    size = np.linalg.norm(acceleration, axis=1)
    usual = np.median(size[np.isfinite(size)]) if np.isfinite(size).any() else 0.0
    unit = G if usual > np.sqrt(G) else 1.0
    low = np.concatenate([[False], np.nan_to_num(size, nan=np.inf) < FALL * unit, [False]])
    first, last = np.flatnonzero(low[1:] & ~low[:-1]), np.flatnonzero(~low[1:] & low[:-1])
    length = time[last - 1] - time[first]
    return [(int(first[k]), int(last[k])) for k in np.argsort(-length) if length[k] >= SHORTEST]


@dataclass(frozen=True)
class Search:
    """The search of a recording for a motion of a model."""

    recording: Rates
    model: Model
    gyroscope: Gyroscope
    is_brief: bool = False
    tried: dict[tuple[int, int], list[Solution]] = field(default_factory=dict, repr=False, compare=False)

    def found(self) -> tuple[int, int, str]:
        """Return the samples of the longest motion, from `first` to before `last`, and how it was found.

        Raises
        ------
        NoMotionError
            Nothing in the recording looks like a motion of the model.
        """
        one = self.recording
        fastest = self.haste * float(np.linalg.norm(one.rates, axis=1).max() * np.median(np.diff(one.time)))
        m = int(np.clip(THIN / fastest, 1, max(len(one.time) // FEWEST, 1)))
        columns: dict[str, Any] = {
            name: _means(getattr(one, name), m) for name in ("time", "rates", "acceleration", "speed")
        }
        (a, b), how = replace(self, recording=replace(one, **columns)).best()
        return a * m, b * m if (b + 1) * m <= len(one.time) else len(one.time), how

    @property
    def time(self) -> Array:
        """Times of the samples, s."""
        return self.recording.time

    @property
    def rates(self) -> Array:
        """Angular velocities, rad/s."""
        return self.recording.rates

    @cached_property
    def haste(self) -> float:
        """How many times as fast as the body turns W changes."""
        return haste_of(self.model, self.time, self.rates)

    @cached_property
    def angle(self) -> Array:
        """How far the motion has gone at the samples, rad: the body has turned, or a rotor has turned W."""
        speed = self.haste * np.linalg.norm(self.rates[1:] + self.rates[:-1], axis=1) / 2
        return np.concatenate([[0.0], np.cumsum(speed * np.diff(self.time))])

    @cached_property
    def many(self) -> float:
        """How many times as many numbers as of a free body are fitted."""
        fitted = self.model.basis.shape[1] + self.model.more + 3 * (self.model.pivot is not None)
        return float(max(fitted / TRACELESS.shape[1], 1.0))

    @property
    def seed(self) -> float:
        """How far the body turns in a window, rad."""
        return self.many * float(np.clip(SHARE * self.angle[-1], *SEED))

    @cached_property
    def acting(self) -> tuple[Array, Array]:
        """What acts beside at the samples, per unit of what is fitted."""
        return acting(self.model, self.time, self.rates, self.speed)

    @cached_property
    def speed(self) -> Array | None:
        """The speed of the rotor at the samples as it was read; None without one."""
        if self.recording.speed is None:
            return None
        there = np.isfinite(self.recording.speed)
        return np.interp(self.time, self.time[there], self.recording.speed[there])

    def best(self) -> tuple[tuple[int, int], str]:
        """Return the samples of the longest motion, and how it was found."""
        acceleration, every = self.recording.acceleration, (0, len(self.time))
        for fall in [] if acceleration is None or self.model.pivot is not None else falls(self.time, acceleration):
            if (grown := self.grown(*fall)) is not None:
                return grown, "the accelerometer reads almost nothing"
        first, last = np.array([every]).T
        if not self.model.is_free and self.misfits(first, last, min(SEED[0] / self.angle[-1], 1.0)) < LIKELY:
            begun = self.grown(0, min(int(np.searchsorted(self.angle, self.seed)) + FEWEST, every[1]), EXPLAINED)
            if begun == every or (begun is not None and self.grown(*every, EXPLAINED) is not None):
                return every, "the whole recording is one motion"
        seeds = list(self.windows(self.seed))
        passes = (seeds, EXPLAINED), (seeds, np.inf), (self.windows(self.seed / 2), EXPLAINED)
        for windows, explained in passes[: 1 if self.is_brief else 3]:
            if (longest := self.longest(windows, explained)) is not None:
                return longest, "the smallest residual"
        what, law = "free motion", "J W' = J W × W"
        if not self.model.is_free:
            what, law = f"motion {self.model.words}", "the equation of such a body"
        how = "thrown" if self.model.pivot is None else "let go"
        raise NoMotionError("no-motion", what=what, law=law, percent=100 * FREE, begun=how)

    def longest(self, seeds: Iterable[tuple[int, int]], explained: float) -> tuple[int, int] | None:
        """Return the interval in which the body turns most, of those that the first windows grow to."""
        best, tried = (0.0, 0, 0), 0
        for a, b in seeds:
            if a < best[2] and b > best[1]:
                continue
            tried += 1
            if (grown := self.grown(a, b, explained)) is not None:
                best = max(best, (float(self.angle[grown[1] - 1] - self.angle[grown[0]]), *grown))
            if tried == SEEDS or best[0] > self.angle[-1] / 2:
                break
        return best[1:] if best[0] > 0 else None

    def misfits(self, first: NDArray[np.intp], last: NDArray[np.intp], share: float) -> Array:
        """Return what the weak form leaves in windows, over parts of this share of each.

        It is r.m.s., of the moments that turning by a radian takes, and infinite where it does not tell.
        """
        begin, duration = self.time[first], self.time[last - 1] - self.time[first]
        least = PART * float(np.quantile(np.diff(self.time), 0.8))
        half = np.minimum(np.maximum(share * duration, least), duration) / 2
        parts = np.linspace(0.0, 1.0, max(round(4 / share) - 3, 1))
        centres = (begin + half)[:, None] + np.outer(duration - 2 * half, parts)
        rows, whole = windowed(self.time, self.rates, centres.ravel(), np.repeat(half, len(parts)), *self.acting)
        turned = half / duration * (self.angle[last - 1] - self.angle[first]) * self.speeds(first, last)
        every = np.where(whole[:, None, None], allowed(self.model, rows), 0.0).reshape(len(first), -1, rows.shape[2])
        every, samples = every / (turned[:, None, None] + 1e-300), 3 * whole.reshape(len(first), -1).sum(axis=1)
        w, left = balanced(every, self.model, 0.0)
        wheel, enough = self.model.wheel, samples >= every.shape[2]
        told = (w[:, -1] > 0) | (wheel is None or wheel.axis is None or self.model.pivot is not None)
        misfits = np.sqrt((left**2).sum(axis=1) / np.maximum(samples, 1))
        return np.where(told & enough, misfits, np.inf)

    def speeds(self, first: NDArray[np.intp], last: NDArray[np.intp]) -> Array:
        """Return the speeds of the body in windows, r.m.s., rad/s."""
        squares = np.concatenate([[0.0], np.cumsum((self.rates**2).sum(axis=1))])
        return np.sqrt((squares[last] - squares[first]) / (last - first))

    def windows(self, seed: float) -> Iterator[tuple[int, int]]:
        """Yield windows of `seed` rad, those first that look like a motion of the model."""
        if self.angle[-1] <= seed:
            yield 0, len(self.time)
            return
        count = int(min(MOST_WINDOWS, max(2, np.ceil(4 * (self.angle[-1] / seed - 1)))))
        turned = np.linspace(0, self.angle[-1] - seed, count)
        first = np.searchsorted(self.angle, turned)
        last = np.minimum(np.maximum(np.searchsorted(self.angle, turned + seed) + 1, first + FEWEST), len(self.time))
        speeds, blocks = self.speeds(first, last), np.array_split(np.arange(count), int(np.ceil(count / BLOCK)))
        misfits = np.concatenate([self.misfits(first[one], last[one], 1 / (4 * self.many)) for one in blocks])
        good = misfits < LIKELY
        good &= speeds >= SLOW * speeds[good].max(initial=0.0)
        yield from ((int(first[k]), int(last[k])) for k in np.argsort(misfits, kind="stable") if good[k])

    def grown(self, a: int, b: int, explained: float = np.inf) -> tuple[int, int] | None:
        """Return the interval around a first guess, None where the guess itself is no motion of the model.

        Its residuals may be `explained` times the noise.
        """
        if b - a < FEWEST:
            return None
        found: tuple[int, int] | None = None
        starts: list[Guess] | None = None
        open_first = open_last = True
        for _ in range(ROUNDS):
            speed = float(np.sqrt((self.rates[a:b] ** 2).sum(axis=1).mean()))
            noise = max(noise_of(self.rates[a:b]), FLOOR * speed)
            most = min(max(FREE * speed, min(2 * noise, NOISY * speed)), explained * noise)
            fit = self.fitted(a, b, noise, starts, most)
            if fit is None or fit.spread > most:
                return found
            found, length = (a, b), b - a
            earlier = np.arange(a - 1, max(a - 1 - length, -1), -1)[: length * open_first]
            later = np.arange(b, min(b + length, len(self.time)))[: length * open_last]
            before, after = (self.agreeing(fit, a, rows, noise) for rows in (earlier, later))
            open_first, open_last = 0 < before == len(earlier), 0 < after == len(later)
            a, b = a - before, b + after
            starts = [self.guess(fit, a, a + before)]
            if before + after == 0:
                break
        return found

    def fitted(self, a: int, b: int, noise: float, starts: list[Guess] | None, most: float) -> Solution | None:
        """Return the fit of samples `a` to before `b`; None where it leaves much more than `most`, or is no motion."""
        tried = self.tried.get((a, b)) if starts is None else None
        try:
            if tried is None:
                stretch = Stretch(self.time[a:b], self.rates[a:b], speed_of(self.recording, slice(a, b)))
                tried = in_lanes(Shooting([stretch], self.gyroscope, noise, self.model), starts)
            if starts is None:
                self.tried[a, b] = tried
            return None if min(one.spread for one in tried) > MORE * most else whole_of(tried, True, CALLS)
        except RunawayError:
            return None

    def guess(self, fit: Solution, first: int, at: int) -> Guess:
        """Return a fit that begins at one sample as a guess of a fit from another one before it."""
        unknowns, model = fit.unknowns, fit.problem.model
        down = unknowns.starts[0, 3:]
        downs = [] if model.pivot is None else [turns(self.time[first : at + 1], self.rates[first : at + 1])[-1] @ down]
        return Guess(model, unknowns.inertia, unknowns.more, downs)

    def agreeing(self, fit: Solution, a: int, rows: NDArray[np.intp], floor: float) -> int:
        """Return how many samples beyond a fit from `a` on agree with what it predicts for them."""
        readings = self.recording.speed
        if not len(rows):
            return 0
        at, model, sense = fit.unknowns, fit.problem.model, -1 if rows[0] < a else 1
        through = np.arange(a, rows[-1] + sense, sense)
        if readings is not None and np.isfinite(readings[through]).sum() < READINGS:
            return 0
        times, flip, line, of_speeds = sense * self.time[rows], np.ones(model.size), None, np.zeros((0, 0))
        flip[:3] = sense
        speed = speed_of(self.recording, through, sense)
        if speed is not None:
            line, of_speeds = speed.line(sense * self.time[a], times[-1], speed.values), speed.rows[0]
        motion = Motion(model, at.inertia, at.more, sense)
        try:
            ((values, D),) = responses(motion, [Track(flip * at.starts[0], times - sense * self.time[a], line)])
        except RunawayError:
            return 0
        y, by_W, by_gyroscope = self.gyroscope.reads(sense * values[:, :3], None, at.gyroscope)
        start, own, by_speeds = np.split(sense * by_W @ D[:, :3], [model.size, model.size + 6 + model.more], axis=2)
        P = np.concatenate([own[:, :, :6] @ model.basis, own[:, :, 6:], by_gyroscope, start * flip], axis=2)
        A = fit.weighted[1]
        C = inverse(A.T @ A)[: P.shape[2], : P.shape[2]]
        parts = (P, C), (by_speeds, np.linalg.pinv(of_speeds.T @ of_speeds, hermitian=True))
        variance = floor**2 + sum(((X @ covariance) * X).sum(axis=2) for X, covariance in parts)
        off = ((self.rates[rows] - y) ** 2 / variance).mean(axis=1)
        smooth = np.convolve(off, np.ones(SMOOTHED) / SMOOTHED, "same") if len(off) >= SMOOTHED else off
        bad = np.flatnonzero((smooth > OFF) | (off > 4 * OFF))
        return len(rows) if not len(bad) else max(int(bad[0]) - SMOOTHED, 0)


def _means(values: Array | None, m: int) -> Array | None:
    """Return means over every m samples; nan where none is a number."""
    if values is None or m == 1:
        return values
    blocks = values[: len(values) // m * m].reshape(-1, m, *values.shape[1:])
    count = np.isfinite(blocks).sum(axis=1)
    return np.where(count > 0, np.nan_to_num(blocks).sum(axis=1) / np.maximum(count, 1), np.nan)
