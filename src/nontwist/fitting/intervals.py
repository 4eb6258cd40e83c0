r"""The interval of free motion in a recording: from release to catch.

Where an accelerometer reads almost nothing the body falls freely. Far from the centre of mass it reads the centripetal
acceleration as well, so this is only a first guess. Without it, windows in which the body turns by some rad (`SEED`)
are ranked by the residual of the weak form (`linear`): a hand exerts moments, the air hardly.

The model is fitted to a first guess and predicts what comes before and after; the interval grows as long as the
prediction agrees with the recording within the errors of both, is fitted again, and so on until neither side grows.
Backwards, ``-W(-t)`` is a free motion of the same body.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from .bodies import FREE_BODY, TRACELESS
from .estimating import estimate
from .linear import Guess, weak_form
from .motions import Motion, RunawayError, responses
from .quality import noise_of
from .shooting import Priors, Stretch
from .solving import Solution

SEED, SHARE = (2.0, 4.0), 0.2  # rad, least and most; of all that it turns
MOST_WINDOWS, SEEDS, ROUNDS = 200, 3, 10
SLOW = 0.3  # of the fastest window: slower ones are no throw
FLOOR = 0.001  # of the speed: what sensors are off by besides noise
OFF, SMOOTHED = 4.0, 5  # mean square of the deviation over its variance, over so many samples
FREE, NOISY = 0.02, 0.05  # of the speed: larger residuals are no free motion, unless noise is as large
LIKELY = 0.05  # residual of the weak form: larger ones need no fit
FEWEST, CALLS = 20, 20  # samples of a window; trials of a fit
FALL, SHORTEST = 0.3, 0.1  # g; s
G = 9.81


def falling(time: Array, acceleration: Array) -> tuple[int, int] | None:
    """Return the longest interval in which an accelerometer, in g or m/s², reads almost nothing."""
    size = np.linalg.norm(acceleration, axis=1)
    usual = np.median(size[np.isfinite(size)]) if np.isfinite(size).any() else 0.0
    unit = G if usual > np.sqrt(G) else 1.0
    low = np.concatenate([[False], np.nan_to_num(size, nan=np.inf) < FALL * unit, [False]])
    first, last = np.flatnonzero(low[1:] & ~low[:-1]), np.flatnonzero(~low[1:] & low[:-1])
    if not len(first):
        return None
    k = int(np.argmax(time[last - 1] - time[first]))
    a, b = int(first[k]), int(last[k])
    return (a, b) if time[b - 1] - time[a] >= SHORTEST else None


def free_motion(time: Array, rates: Array, acceleration: Array | None, priors: Priors) -> tuple[int, int, str]:
    """Return the samples of the longest free motion, from `first` to before `last`, and how it was found.

    Raises
    ------
    ValueError
        Nothing in the recording looks like free motion.
    """
    fall = None if acceleration is None else falling(time, acceleration)
    if fall is not None:
        grown = _grown(time, rates, *fall, priors)
        if grown is not None:
            return (*grown, "the accelerometer reads almost nothing")
    best: tuple[float, int, int] | None = None
    angle = np.concatenate([[0.0], np.cumsum(np.linalg.norm(rates[1:] + rates[:-1], axis=1) / 2 * np.diff(time))])
    tried = 0
    for a, b in _windows(time, rates, angle):
        if best is not None and a < best[2] and b > best[1]:
            continue
        grown = _grown(time, rates, a, b, priors)
        tried += 1
        if grown is not None:
            turned = float(angle[grown[1] - 1] - angle[grown[0]])
            best = max(best or (0.0, 0, 0), (turned, *grown))
        if tried == SEEDS or (best is not None and best[0] > angle[-1] / 2):
            break
    if best is None:
        raise ValueError(
            "no free motion found: nowhere does the angular velocity follow J W' = J W × W to "
            f"{100 * FREE:g} %; was it thrown, and is it rigid? --from and --to (interval=) name an interval"
        )
    return best[1], best[2], "the smallest residual"


def _windows(time: Array, rates: Array, angle: Array) -> list[tuple[int, int]]:
    """Return windows of `SEED` rad, those that look free first."""
    seed = float(np.clip(SHARE * angle[-1], *SEED))
    if angle[-1] <= seed:
        return [(0, len(time))]
    count = int(min(MOST_WINDOWS, max(2, np.ceil(4 * (angle[-1] / seed - 1)))))
    found = []
    for at in np.linspace(0, angle[-1] - seed, count):
        a, b = (int(k) for k in np.searchsorted(angle, (at, at + seed)))
        b = min(max(b + 1, a + FEWEST), len(time))
        made = weak_form([(time[a:b], rates[a:b])], seed / 4)
        if made is not None and made[1] < LIKELY:
            found.append((made[1], float(np.sqrt((rates[a:b] ** 2).sum(axis=1).mean())), a, b))
    fastest = max((speed for _, speed, *_ in found), default=0.0)
    return [(a, b) for _, speed, a, b in sorted(found) if speed >= SLOW * fastest]


def _grown(time: Array, rates: Array, a: int, b: int, priors: Priors) -> tuple[int, int] | None:
    """Return the free interval around a first guess, None where the guess itself is not free."""
    if b - a < FEWEST:
        return None
    shut_first = shut_last = False
    found: tuple[int, int] | None = None
    starts: list[Guess] | None = None
    for _ in range(ROUNDS):
        speed = float(np.sqrt((rates[a:b] ** 2).sum(axis=1).mean()))
        noise = max(noise_of(rates[a:b]), FLOOR * speed)
        try:
            fit = estimate(
                [Stretch(time[a:b], rates[a:b])], priors, noise, known_noise=True, starts=starts, calls=CALLS
            )
        except RunawayError:
            return found
        if fit.spread > max(FREE * speed, min(2 * noise, NOISY * speed)):
            return found
        found, starts, length = (a, b), [Guess(FREE_BODY, fit.unknowns.inertia, np.zeros(0), [])], b - a
        before = 0 if shut_first else _agrees(fit, time, rates, np.arange(a - 1, max(a - 1 - length, -1), -1), noise)
        after = 0 if shut_last else _agrees(fit, time, rates, np.arange(b, min(b + length, len(time))), noise)
        shut_first, shut_last = shut_first or before < min(length, a), shut_last or after < min(length, len(time) - b)
        a, b = a - before, b + after
        if before + after == 0:
            break
    return found


def _agrees(fit: Solution, time: Array, rates: Array, rows: NDArray[np.intp], floor: float) -> int:
    """Return how many samples beyond the fitted ones agree with what the fit predicts for them."""
    if not len(rows):
        return 0
    own, (start,) = fit.problem.stretches[0].time, fit.unknowns.starts
    back = time[rows[0]] < own[0]
    at = abs(time[rows] - own[0])
    sign = -1.0 if back else 1.0
    try:
        (W,), (D,) = responses(Motion(FREE_BODY, fit.unknowns.inertia, np.zeros(0)), sign * start[None], [at])
    except RunawayError:
        return 0
    W = sign * W
    A = fit.weighted[1]
    scale = np.linalg.norm(A, axis=0)
    covariance = np.linalg.pinv((A / scale).T @ (A / scale), rcond=1e-12) / np.outer(scale, scale)
    unit = np.broadcast_to(np.eye(3), (len(rows), 3, 3))
    s = fit.unknowns.scale
    P = np.concatenate([sign * s * D[:, :, 3:] @ TRACELESS, unit, W[:, :, None], s * D[:, :, :3]], axis=2)
    variance = floor**2 + np.einsum("nip,pq,niq->ni", P, covariance, P)
    off = ((rates[rows] - s * W - fit.unknowns.bias) ** 2 / variance).mean(axis=1)
    smooth = np.convolve(off, np.ones(SMOOTHED) / SMOOTHED, "same") if len(off) >= SMOOTHED else off
    bad = np.flatnonzero((smooth > OFF) | (off > 4 * OFF))
    return len(rows) if not len(bad) else max(int(bad[0]) - SMOOTHED, 0)
