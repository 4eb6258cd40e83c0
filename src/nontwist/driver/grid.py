"""The time grid: steps that divide the span, segments between the kinks of a load, the automatic step."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry.arrays import Array, as_array, as_number, increasing
from ..geometry.values import as_whole, counted, short_repr
from ..integrators import Integrator
from ..integrators.ivp import FIT, Segments, segmented
from ..loads import Load, body_moment
from ..loads.terms import Tabulated
from ..machine import free_memory as free_memory  # which tests replace here
from ..models.stack import SystemStack

TURN = 0.05  # rad a step
FEWEST, MOST = 100, 10_000_000  # steps of the automatic step
MOST_STEPS = 10**11
REACH = 100_000  # step counts around the requested one that are tried for breakpoints on the grid
BLOCK, TRIES = 250_000, 10_000_000  # pairs of counts and fractions that are tried at a time, and in all
STATE = 800  # bytes of a stored state and its interval, as arrays and in the dataset
HIGHER = 5  # times longer are the steps that resolve a load with an order above 2
NODES_APART = 16  # units in the last place of a time that a step must have
CLOSEST = 16 * NODES_APART  # of the first steps, which may be refined
SMALL = 2**26  # bytes that are assumed to be free


class Piecewise(NamedTuple):
    """Numbers that hold from one time to the next, the last one to the end of a run."""

    times: Array  # (n,) s
    values: Array  # (n,)

    @property
    def largest(self) -> float:
        """The largest of them."""
        return float(self.values.max())

    def lengths(self, t_end: float) -> Array:
        """Return how long each of them holds, s."""
        return np.append(self.times[1:], t_end) - self.times

    def at(self, times: Array) -> Array:
        """Return those that hold from some times on."""
        return self.values[np.searchsorted(self.times, times, side="right") - 1]

    def measured(self, times: Array, values: Array) -> Piecewise:
        """Return the largest of the values at increasing times in each piece, or beside it where it has none."""
        first = np.searchsorted(times, self.times, side="right") - 1
        last = np.append(np.searchsorted(times, self.times[1:]), len(times) - 1)
        found = [values[i : j + 1].max() for i, j in zip(first.tolist(), last.tolist(), strict=True)]
        return self._replace(values=np.array(found))


def steady(time: float, value: float) -> Piecewise:
    """Return one number that holds from a time on."""
    return Piecewise(np.array([time]), np.array([value]))


def count_steps(span: float, step: float) -> int:
    """Return N = span / step.

    Raises
    ------
    ValueError
        The step is not positive, not finite, longer than the span, takes more than 1e11 steps, or does not divide the
        span to 1e-9 N; the message names valid steps.
    """
    h = as_number(step, "step")
    if h <= 0:
        raise ValueError(f"step must be positive, got {h:g} s")
    if h > span * (1 + FIT):
        raise ValueError(f"step = {h:g} s is longer than the span of {span:g} s")
    if is_too_short(span, h):
        raise ValueError(
            f"step = {h:.12g} s is too short: that is {span / h:.3g} steps; for at most "
            f"{MOST_STEPS:g} steps use step = {span / MOST_STEPS:.12g} s"
        )
    N = round(span / h)
    if abs(span / h - N) > FIT * N:
        few = int(span / h)
        raise ValueError(
            f"step = {h:.12g} s does not divide the span of {span:.12g} s; "
            f"the nearest that do are {span / (few + 1):.12g} s and {span / few:.12g} s"
        )
    return N


def is_too_short(span: float, step: float) -> bool:
    """Whether a step takes more than `MOST_STEPS` steps."""
    return span / step >= MOST_STEPS + 0.5


@lru_cache(maxsize=64)
def require_resolution(t_start: float, t_end: float, grid: Segments) -> None:
    """Raise a ValueError, with a valid step, when steps are so short that their nodes may coincide."""
    span, ends = t_end - t_start, abs(np.array(grid.borders))
    apart = np.spacing(np.maximum(ends[1:], ends[:-1]))
    j = int(np.argmin(grid.sizes / apart))
    h, resolution, largest = grid.sizes[j], float(apart[j]), float(max(ends[j : j + 2]))
    if h >= NODES_APART * resolution or grid.steps == 1:
        return
    enough = span / max(1, int(span / (2 * NODES_APART * resolution)))
    raise ValueError(
        f"step = {h:.3g} s is too short: times up to {largest:.12g} s are resolved to {resolution:.2g} s; "
        f"step = {enough:.12g} s would do, or times counted from a start at 0"
    )


def joined_grid(before: Segments | None, grid: Segments) -> Segments:
    """Return a grid of equal steps, as part of that of the previous run where steps of that lead to the same nodes.

    That is, to round-off of the times, and `before` is counted from the end of the previous run.
    """
    if before is None or grid.numbers[0] or len(grid.sizes) > 1:
        return grid
    (t_start, t_end), N, origin, n, h = grid.borders, grid.steps, before.borders[0], before.numbers[0], before.sizes[0]
    rounding = 4 * float(np.spacing(max(abs(origin), abs(t_start), abs(t_end))))
    if max(abs(n * h + (t_start - origin)), abs(N * h - (t_end - t_start))) > rounding:
        return grid
    return Segments((origin, t_end), (n, N), (h,))


def rest_of_grid(before: Segments | None, load: Load, t_start: float, t_end: float) -> Segments | None:
    """Return what a run that was stopped has left of its grid, None where it has not, or kinks of `load` are off it."""
    if before is None or before.steps == 0 or before.borders[-1] != t_end:
        return None
    first = before.borders[0] - before.numbers[0] * before.sizes[0]  # time of the node number 0
    if abs(first - t_start) > 4 * float(np.spacing(max(abs(t_start), abs(t_end)))):
        return None
    return before if set(kinks(load, t_start, t_end).tolist()) <= set(before.borders) else None


def with_spin_kinks(load: Load, systems: SystemStack) -> Load:
    """Return a load for time grids: with the kinks of a prescribed spin as breakpoints of its own."""
    if systems.spin is None or not (times := systems.spin.breakpoints):
        return load
    return load + body_moment(times, np.zeros((len(times), 3)))


def kinks(load: Load, t_start: float, t_end: float) -> Array:
    """Return the breakpoints of a load between start and end; of those that times do not tell apart the first."""
    found = np.array(load.breakpoints, dtype=np.float64)
    apart = NODES_APART * float(np.spacing(max(abs(t_start), abs(t_end))))
    found = found[(found > t_start + apart) & (found < t_end - apart)]
    if found.size and (np.diff(found) <= apart).any():
        kept = [found[0]]
        for t in found[1:]:
            if t > kept[-1] + apart:
                kept.append(t)
        found = np.array(kept)
    return found


def segments_of(
    load: Load,
    t_start: float,
    t_end: float,
    longest: float | Piecewise,
    even: bool = False,
    higher: int = 1,
    *,
    resolves: bool = True,
    decay: float = 0.0,
    part: float = 1.0,
) -> Segments:
    """Return a grid whose nodes hold the kinks of a load, with steps up to `longest` that resolve its pulses and sines.

    With `even` each segment has an even number of steps, or one; `higher` times longer ones resolve the load. Unless it
    `resolves` the load, kinks are all that it looks at. Modes that decay at rates up to `decay`, 1/s, are resolved as
    by `graded`.

    Raises
    ------
    ValueError
        Too many steps.
    """
    borders = np.concatenate([[t_start], kinks(load, t_start, t_end), [t_end]])
    if not isinstance(longest, Piecewise):
        longest = steady(t_start, longest)
    borders, each = graded(borders, longest.largest, decay, part)
    if len(longest.times) > 1:
        is_apart = abs(longest.times[:, None] - borders).min(axis=1) > CLOSEST * np.spacing(abs(longest.times))
        whole = np.union1d(borders, longest.times[is_apart])
        each = np.minimum(each[np.searchsorted(borders, whole[:-1], side="right") - 1], longest.at(whole[:-1]))
        borders = whole
    middles, resolution = (borders[1:] + borders[:-1]) / 2, np.full(len(borders) - 1, np.inf)
    for term in load.terms if resolves else ():  # a table is linear between its kinks
        if not isinstance(term, Tabulated) and term.resolution < np.inf:
            acts = (term.support[0, 0] < middles) & (middles < term.support[-1, 1])
            resolution[acts] = np.minimum(resolution[acts], term.resolution)
    least = np.diff(borders) / np.minimum(each, higher * resolution)
    if not (count := float(least.sum())) <= MOST:
        raise ValueError(
            f"the automatic step would take {count:.3g} steps, more than {MOST:.0e}; choose a step of about "
            f"{(t_end - t_start) / count:.2g} s with gauss"
        )
    counts = np.maximum(1, np.ceil(least * (1 - 1e-12)))
    return segmented(borders, np.where(even & (counts > 1), 2 * np.ceil(counts / 2), counts))


def graded(borders: Array, longest: float, decay: float, part: float) -> tuple[Array, Array]:
    """Return borders, with those of shorter steps behind each in between, and the longest steps there, s.

    At the time t behind a border steps are at most ``part max(t, 1/decay)``: there are borders at t = 1/decay, twice,
    four times, ... as much, until steps are as long as `longest`.
    """
    if not part < longest * decay:
        return borders, np.full(len(borders) - 1, longest)
    begins = 2.0 ** np.arange(np.ceil(np.log2(longest * decay / part)) + 1) / decay
    pieces, sizes = [], []
    for b, c in pairwise(borders.tolist()):
        inner = begins[(begins < (c - b) / 2) & (part * begins > CLOSEST * np.spacing(abs(b) + begins))]
        pieces.append(b + np.append(0.0, inner))
        sizes.append(np.minimum(part * np.append(inner[:1], inner), longest) if inner.size else [longest])
    return np.append(np.concatenate(pieces), borders[-1]), np.concatenate(sizes)


def stored_steps(N: int, store: int | Literal["end"]) -> NDArray[np.int64]:
    """Return the step numbers that are kept: every `store`-th and the last, or with "end" the first and the last."""
    stored_count(N, store)
    if isinstance(store, str):
        return np.array([0, N])
    every = min(store, N)
    kept = np.arange(0, N + every, every, dtype=np.int64)
    kept[-1] = N
    return kept


def stored_count(N: int, store: int | Literal["end"]) -> int:
    """Return how many states are kept; a ValueError where `store` is none, or where they do not fit into memory."""
    every = as_store(store)
    if isinstance(every, str):
        return 2
    _require_memory(N, every)
    return -(-N // every) + 1


def as_store(store: Any) -> int | Literal["end"]:
    """Return `store`; a ValueError where it is neither a number of steps nor "end"."""
    if isinstance(store, str) and store == "end":
        return "end"
    try:
        return as_whole(store, "store", 1)
    except ValueError as error:
        raise ValueError(f"store must be a whole number of steps >= 1 or 'end', got {short_repr(store)}") from error


def _require_memory(N: int, store: int) -> None:
    """Raise a ValueError, with the `store` that fits, when a run would not fit into the memory that is free."""
    needed = N // store * STATE
    if needed < SMALL or needed <= (free := free_memory()):
        return
    fits = -(-N * STATE // free)
    raise ValueError(
        f"{N // store:.3g} stored states need {needed / 1e9:.3g} GB, {free / 1e9:.3g} GB are free; "
        f"store={float(f'{fits * 1.05:.1e}'):.0f} fits, or store='end'"
    )


def checked_output_times(
    scheme: Integrator, times: ArrayLike, t_start: float, t_end: float | None, step: float | None, store: object
) -> Array:
    """Return the checked output times; an integrator that takes no steps has no step."""
    if store != 1 or (scheme.any_times and step is not None):
        raise ValueError("with times= leave " + ("step= and store= out" if scheme.any_times else "store= out"))
    output_times = as_array(times, "times", (None,))
    if output_times.size == 0:
        raise ValueError("times is empty")
    if output_times.size > 1:
        increasing(output_times)
    if output_times[0] < t_start or (t_end is not None and output_times[-1] > t_end):
        outside = output_times[0] if output_times[0] < t_start else output_times[-1]
        end = "" if t_end is None else f" to {t_end:g} s"
        raise ValueError(f"times contains {outside:g} s, outside of the run from {t_start:g} s{end}")
    return output_times


def inside(breakpoints: tuple[float, ...], t_start: float, t_end: float) -> Array:
    """Return the breakpoints between start and end as fractions of the span."""
    if not breakpoints:
        return np.empty(0)
    x = (np.array(breakpoints) - t_start) / (t_end - t_start)
    return x[(x > 0) & (x < 1)]


def fits(x: Array, N: int) -> bool:
    """Whether all fractions `x` of the span lie on the grid of N steps."""
    return bool(np.all(abs(x * N - np.rint(x * N)) <= FIT * N))


def fitting_count(x: Array, N: int, candidates: range) -> int | None:
    """Return the count nearest `N` among `candidates` whose grid holds all fractions `x` of the span.

    None where there is none, or none is found among `TRIES` pairs of a count and a fraction: each fraction removes
    counts, so that few counts are compared with many fractions.
    """
    left, first, tried = np.array(candidates, dtype=np.float64), 0, 0
    while first < len(x) and left.size:
        some = x[first : first + max(1, BLOCK // left.size), None]
        first, tried = first + len(some), tried + len(some) * left.size
        if tried > TRIES:
            return None
        left = left[(abs(some * left - np.rint(some * left)) <= FIT * left).all(axis=0)]
    return int(left[np.argmin(abs(left - N))]) if left.size else None


def off_grid_message(load: Load, t_start: float, t_end: float, N: int, what: str = "load") -> str | None:
    """Return the warning for breakpoints of `load`, called `what`, off the grid, with the nearest step that fits."""
    x = inside(load.breakpoints, t_start, t_end)
    if not x.size or fits(x, N):
        return None
    span = t_end - t_start
    off = x[abs(x * N - np.rint(x * N)) > FIT * N]
    better = fitting_count(x, N, range(max(1, N // 2, N - REACH), min(2 * N + 1000, N + REACH)))
    advice = f"step = {span / better:.12g} s fits" if better else "no step near it fits them all"
    return (
        f"{counted(len(off), 'breakpoint')} of the {what} off the grid of step {span / N:.12g} s, the first at "
        f"t = {t_start + span * off[0]:.12g} s: accuracy drops there; {advice}"
    )


def load_messages(load: Load, systems: SystemStack, t_start: float, t_end: float, grid: Segments) -> list[str]:
    """Return the warnings for a load and a spin on a grid: breakpoints off the nodes, tables that end too early."""
    messages = []
    if len(grid.sizes) == 1:
        tables = {"load": load, "spin": with_spin_kinks(Load(), systems)}
        messages = [off_grid_message(table, t_start, t_end, grid.steps, what) for what, table in tables.items()]
    for term in load.terms:
        if isinstance(term, Tabulated) and term.times[-1] < t_end and term.values[-1].any():
            messages.append(
                f"a table of the load ends at t = {term.times[-1]:.12g} s with a non-zero value and is 0 from there to "
                f"{t_end:.12g} s"
            )
    return [message for message in messages if message]


def even_step(longest: float, load: Load, t_start: float, t_end: float) -> float | None:
    """Return the longest step up to `longest` that divides the span into a grid with the breakpoints of `load`.

    None where none is found within `REACH` more steps than `longest` takes.
    """
    span = t_end - t_start
    least = int(np.ceil(span / longest * (1 - FIT)))
    count = fitting_count(inside(load.breakpoints, t_start, t_end), least, range(least, least + REACH + 1))
    return None if count is None else span / count
