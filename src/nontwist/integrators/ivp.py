"""Initial value problems of a stack of bodies, their time grid, and their outcomes: the interface of every integrator.

A run is a stack of one. The result depends on the problem alone, and no member on another: a stack may be split
anywhere, over any number of threads, and each member has the same bits.

The time grid consists of segments of equal steps. A run from t_start to t_end in N equal steps has the nodes ``t_k =
t_start + (t_end - t_start) k / N``. Where a load has kinks and the step is left open, there is a segment of equal steps
between any two of them, so that each kink is a node: in a segment from b to c, between the nodes of the numbers m and
n, ``t_k = b + (c - b) (k - m) / (n - m)``.

A run that continues another one on its grid has the nodes of the whole. Its first segment then begins before the run
does, with a node of a negative number, and the step is, bit for bit, that of the run before. The first and the last
node of a run are t_start and t_end bit for bit, as are all borders of segments, and no node lies outside.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import Status as Status
from ..geometry.arrays import Array
from ..geometry.attitudes import States, director_velocities, directors
from ..loads import Load
from ..loads.load import with_torques
from ..machine import cached_property
from ..models.stack import SystemStack, members_of, stacked
from ..models.system import DirectorSystem

FIT = 1e-9  # of a number of steps
RESOLVED = 4  # units in the last place of a time within which an output is at a node


class Segments(NamedTuple):
    """Segments of equal steps, one after the other."""

    borders: tuple[float, ...]  # s: where each begins, and where the last one ends
    numbers: tuple[int, ...]  # of the nodes there, counted from the start of the run
    sizes: tuple[float, ...]  # s: the step of each

    @property
    def steps(self) -> int:
        """Number of steps of the run."""
        return self.numbers[-1]

    @property
    def longest(self) -> float:
        """The longest step, s."""
        return max(self.sizes)

    def steps_until(self, time: float) -> int:
        """Return how many steps, the last one not a whole one perhaps, lead to a time of the grid."""
        j = min(max(int(np.searchsorted(self.borders, time)) - 1, 0), len(self.sizes) - 1)
        return self.numbers[j] + int(np.ceil((time - self.borders[j]) / self.sizes[j] * (1 - FIT)))

    def after(self, number: int) -> Segments:
        """Return what is left after the node of this number, with the segment that it lies in or ends."""
        j = max(int(np.searchsorted(self.numbers, number)) - 1, 0)
        return Segments(self.borders[j:], tuple(k - number for k in self.numbers[j:]), self.sizes[j:])


def segmented(borders: Any, counts: Any) -> Segments:
    """Return segments with so many steps between the borders, counted from the first of them."""
    if len(counts) == 1:
        (begin, end), (steps,) = borders, counts
        return Segments((float(begin), float(end)), (0, int(steps)), ((float(end) - float(begin)) / int(steps),))
    ends, steps = np.asarray(borders, dtype=np.float64), np.asarray(counts, dtype=np.int64)
    numbers = np.concatenate([[0], np.cumsum(steps)])
    return Segments(tuple(ends.tolist()), tuple(numbers.tolist()), tuple((np.diff(ends) / steps).tolist()))


ONE = np.ones(1)

# What is observed at every step, and how many numbers it has; energy is K + V less the work of the load.
OBSERVED = {
    "kinetic_energy": 1,
    "potential_energy": 1,
    "energy": 1,
    "spatial_momentum": 3,
    "material_momentum": 3,
    "twist_rate": 1,
    "vertical_momentum": 1,
    "reaction_moment": 1,
}
COLUMNS = sum(OBSERVED.values())
FIRST, LEAST, MOST, INTEGRAL = range(4)
MEANS = "multipliers", "moment", "dead_moment"  # of intervals


class Failure(NamedTuple):
    """Where and how a march stopped."""

    status: Status
    step: int  # number of the step that failed, from 0; with given output times that of the last valid state
    residual: float
    turn: float  # rad the body turns in that step
    reason: str | Exception = ""

    @property
    def cause(self) -> Exception | None:
        """What a function of a user raised."""
        return self.reason if isinstance(self.reason, Exception) else None


@dataclass(frozen=True, eq=False)
class IVP:
    """Initial value problems of m bodies on one time grid."""

    systems: SystemStack  # of one body or of m
    quaternion: Array  # (m, 4) Λ at t_start, scalar last, of unit length
    velocity: Array  # (m, 3) W at t_start
    load: Load
    t_start: float
    t_end: float
    steps: int
    stored: NDArray[np.int64]  # numbers of the nodes whose states are stored, including 0 and `steps`
    load_scale: Array = field(default_factory=lambda: ONE)  # (1,) or (m,)
    wheel_torque: Array | None = None  # (1, w) or (m, w) beside the torques of the load, N m
    output_times: Array | None = None  # on the grid or not; None: those of the nodes `stored`
    off_grid: bool = False  # whether the integrator ignores the grid and integrates from one output time to the next
    normal: Array | None = None  # (m, 6) N at t_start
    intervals: bool = False  # whether means over the stored intervals are computed
    observed: bool = False  # whether statistics over all steps are computed
    progress: Callable[[float], None] | None = None  # called with the completed fraction
    memory: Array | None = None  # (m, k) the `Outcome.memory` of the run that ended in this state
    segments: Segments | None = None  # sections of equal steps; None: all steps are equal
    on_gpu: bool = False  # whether an ensemble is marched on a GPU
    internal: Array | None = None  # (m, k) z of loads with memory at t_start, None: theirs
    marched: Any = None  # the `Outcome.march` of this problem without output times, where all nodes are known already

    def __len__(self) -> int:
        return len(self.quaternion)

    @property
    def system(self) -> DirectorSystem:
        """The body of a problem of one."""
        return self.systems[0]

    @property
    def is_free(self) -> bool:
        """Whether no load acts, gravity included."""
        return not self.load.terms and not self.systems.has_dead_force

    @property
    def directors(self) -> Array:
        """Directors of a problem of one at t_start, rows of (3, 3)."""
        return directors(self.quaternion[0])

    @property
    def velocities(self) -> Array:
        """Director velocities of a problem of one at t_start, rows of (3, 3)."""
        return director_velocities(self.directors, self.velocity[0], None if self.normal is None else self.normal[0])

    def member(self, i: int) -> IVP:
        """Return the problem of one member; its load is scaled, and its wheels have their torques."""
        scale, torques = float(self.load_scale[i if len(self.load_scale) > 1 else 0]), self.wheel_torque
        if len(self) == 1 and scale == 1 and torques is None:
            return self
        systems = self.systems if len(self.systems) == 1 else stacked(self.systems[i])
        load = scale * self.load if self.load.terms else self.load
        if torques is not None:
            load = with_torques(load, torques[i if len(torques) > 1 else 0])
        return self._of(slice(i, i + 1), systems, load=load, load_scale=ONE, wheel_torque=None)

    def part(self, first: int, last: int) -> IVP:
        """Return the problem of some members."""
        own, each = slice(first, last), {"load_scale": self.load_scale, "wheel_torque": self.wheel_torque}
        parts = {name: x if x is None or len(x) == 1 else x[own] for name, x in each.items()}
        return self._of(own, members_of(self.systems, first, last), **parts)

    def _of(self, own: slice, systems: SystemStack, **changes: Any) -> IVP:
        arrays = {name: getattr(self, name) for name in ("quaternion", "velocity", "normal", "memory", "internal")}
        parts: dict[str, Any] = {name: None if array is None else array[own] for name, array in arrays.items()}
        return replace(self, systems=systems, progress=None, marched=None, on_gpu=False, **parts, **changes)

    def failed(self, states: int, status: Status, reason: str | Exception) -> Failure:
        """Return the failure of the step, or after the output time, that follows so many good `states`."""
        if self.off_grid and self.output_times is not None:
            last = states - 1
        elif self.output_times is None:
            last = int(self.stored[max(states - 1, 0)])
        else:
            reached = self.stored_times[states - 1] if states else self.t_start
            last = int(np.searchsorted(self.times(np.arange(self.steps)), reached, side="right")) - 1
        return Failure(status, last, np.nan, np.nan, reason)

    # ---- the time grid

    @cached_property
    def grid(self) -> Segments:
        """The sections of equal steps."""
        return self.segments or segmented((self.t_start, self.t_end), (self.steps,))

    def step_at(self, k: Any) -> Any:
        """Return the size of step number `k`, s, or of each of several."""
        return self._arrays[2][self.segment_of(k)]

    @cached_property
    def stored_times(self) -> Array:
        """Times at which states are stored, s."""
        return self.times(self.stored) if self.output_times is None else self.output_times

    def times(self, k: Any) -> Array:
        """Return the times of the nodes with the numbers `k`, s; step number k is between the nodes k and k + 1."""
        k = np.asarray(k)
        inner = self._at(k, self.segment_of(k))
        return np.where(k == self.steps, self.t_end, np.where(k == 0, self.t_start, inner))

    def nodes(self, steps: NDArray[np.int64], middles: Array) -> Array:
        """Return the times at the fractions `middles` of the steps with these numbers, step by step, s."""
        k = steps[:, None]
        return self._at(k, self.segment_of(k), middles).ravel()

    def steps_until(self, time: Array | float) -> Any:
        """Return the number of steps that begin before a time, or before each of several times."""
        return np.ceil(self._steps_at(time, "left")).astype(np.int64)

    def steps_ended(self, time: Array | float) -> Any:
        """Return the number of steps that end at or before a time, or each of several times."""
        return np.floor(self._steps_at(time, "right")).astype(np.int64)

    def _steps_at(self, time: Array | float, side: Literal["left", "right"]) -> Array:
        """Return times as numbers of steps; a border is the end, or else the beginning, of a segment."""
        borders, numbers, sizes = self._arrays
        j = np.clip(np.searchsorted(borders, time, side=side) - 1, 0, len(sizes) - 1)
        return np.clip(numbers[j] + (time - borders[j]) / sizes[j], 0, numbers[j + 1])

    def began(self, step: int) -> float:
        """Return the time at which a step begins, s; off the grid, the output time with this number, or t_start."""
        if self.output_times is None or not self.off_grid:
            return float(self.times(step))
        return float(self.output_times[step]) if step >= 0 else self.t_start

    def segment_of(self, k: Any) -> Any:
        """Return the numbers of the sections that contain the steps `k`."""
        if len(self.grid.sizes) == 1:
            return np.zeros(np.shape(k), np.int64)
        return np.searchsorted(self._arrays[1][1:-1], k, side="right")

    def _at(self, k: Any, j: Any, parts: Any = 0.0) -> Array:
        """Return the times at the fractions `parts` of the steps `k`, which are in the segments `j`."""
        borders, numbers, _ = self._arrays
        b, c, n = borders[j], borders[j + 1], numbers[j]
        inside = b + (c - b) * ((k - n) + parts) / (numbers[j + 1] - n)
        return np.minimum(np.maximum(np.minimum(np.maximum(inside, b), c), self.t_start), self.t_end)

    @cached_property
    def _arrays(self) -> tuple[Array, NDArray[np.int64], Array]:
        return np.array(self.grid.borders), np.array(self.grid.numbers, dtype=np.int64), np.array(self.grid.sizes)


class Outputs:
    """Where the outputs of a problem lie on its grid.

    Attributes
    ----------
    node : (k,) int array, number of the last node that is not after the output
    since : (k,) array, s, time since that node; 0 where the output is the node
    length : (k,) array, s, time since the output before, of the first since the start
    times : (k,) array, s
    has_start : bool, whether there is output at the start, which is left out of these arrays
    """

    def __init__(self, problem: IVP) -> None:
        times, last = np.asarray(problem.output_times), problem.steps
        node = np.clip(problem.steps_ended(times), 0, last - 1)
        j, ends = problem.segment_of(node), abs(np.array(problem.grid.borders))
        rounding = RESOLVED * np.spacing(np.maximum(ends[j], ends[j + 1]))
        node -= problem.times(node) > times + rounding
        node += problem.times(np.minimum(node + 1, last)) <= times + rounding
        since = times - problem.times(node)
        since[since <= rounding] = 0.0
        self.has_start = bool(node[0] == 0 and since[0] == 0.0)
        self.length = np.diff(times, prepend=problem.t_start)[self.has_start :]
        self.times = times[self.has_start :]
        self.node, self.since = node[self.has_start :], since[self.has_start :]

    def __len__(self) -> int:
        return len(self.node)

    def before(self, step: int) -> int:
        """Return how many outputs lie before the end of a step, those at its beginning among them."""
        return int(np.searchsorted(self.node, step, side="right"))


class March(NamedTuple):
    """The stored states of one run as directors; of a run that failed, those before the failure.

    The multipliers have a column for each of 11, 22, 33, 23, 13, 12 if the integrator computes them, then one for the
    nonholonomic constraint if the body has an axis.
    """

    directors: Array  # (n+1, 3, 3)
    velocities: Array  # (n+1, 3, 3)
    multipliers: Array  # (n, c) means over the stored intervals: c = 6 (λ), 7 (λ, μ), 1 (μ) or 0
    moment: Array  # (n, 3) mean moment of the load
    load_work: Array  # (n,)
    newton_iterations: NDArray[np.int64] | None  # (n,) maximum over the interval
    failure: Failure | None = None
    velocity_integrals: Array | None = None  # (n, 6) as in `Intervals`

    @property
    def means(self) -> Intervals:
        """What is known of the intervals, but for iterations."""
        return Intervals(self.multipliers[None], self.moment[None], self.load_work[None], None)


class Intervals(NamedTuple):
    """What is known of the stored intervals of all members; columns as in `March`. None: the integrator has none."""

    multipliers: Array  # (m, n, c) means
    moment: Array  # (m, n, 3) mean
    load_work: Array  # (m, n)
    newton_iterations: NDArray[np.int64] | None  # (m, n)
    dead_moment: Array | None = None  # (m, n, 3) mean moment of dead forces on bodies with a constrained axis
    twist: Array | None = None  # (m, n) rad, about the constrained axis or E3
    dissipated_energy: Array | None = None  # (m, n) J, what dry friction takes
    velocity_integrals: Array | None = None  # (m, n, 6) ∫ W dt and ∫ t W dt, for the work of motors and of dry friction

    @property
    def of_one(self) -> dict[str, Any]:
        """The fields of one body, but for what works are made of."""
        found = {name: None if array is None else array[0] for name, array in self._asdict().items()}
        del found["velocity_integrals"]
        return found

    def integrals(self, lengths: Array) -> Array:
        """Return the integrals over the first intervals, of these lengths, side by side, (m, n, columns)."""
        n, by = len(lengths), lengths[:, None]
        return np.concatenate([by * x[:, :n] if name in MEANS else x[:, :n] for name, x in self._columns()], axis=2)

    def of_integrals(self, integrals: Array, lengths: Array, iterations: NDArray[np.int64] | None) -> Intervals:
        """Return other intervals from columns as `integrals` returns them, and iterations (m, n)."""
        found, first, by = dict[str, Any](newton_iterations=iterations), 0, lengths[:, None]
        for name, x in self._columns():
            own = integrals[..., first : first + x.shape[2]]
            found[name] = own / by if name in MEANS else own if getattr(self, name).ndim == 3 else own[..., 0]
            first += x.shape[2]
        return Intervals(**found)

    def _columns(self) -> Iterator[tuple[str, Array]]:
        """Yield the names of what is summed, and the columns, (m, n, ...)."""
        for name, x in self._asdict().items():
            if x is not None and name != "newton_iterations":
                yield name, x if x.ndim == 3 else x[..., None]


class Outcome(NamedTuple):
    """The stored states of all members; those after the first `good` ones are undefined."""

    states: States  # (m, k, ...)
    good: NDArray[np.int64]  # (m,) number of states that are good, from the first
    failures: Array  # (m, 4): status, step, residual, turn
    reasons: dict[int, str | Exception]  # of members that have failed otherwise than by a turn or a stalled iteration
    intervals: Intervals | None = None
    observed: Array | None = None  # (m, 4, COLUMNS): at first, least, greatest, integral over time
    memory: Array | None = None  # (1, ...) what a march of one body carries at its end, to continue bit for bit
    end: int | None = None  # number of steps at the last state of a run, where it is not one that was to be stored
    march: Any = None  # what found those of one body, from which others can be found between nodes

    def times(self, problem: IVP) -> Array:
        """Return the times of the states: of a run that was stopped the last one is that of no output."""
        found = problem.stored_times.copy()
        if self.end is not None:
            found[self.good[0] - 1] = problem.times(self.end)
        return found

    def at(self, whole: IVP, problem: IVP) -> Outcome:
        """Return the outcome of a problem at the outputs of another one, which are some of its own."""
        k, times = len(problem.stored_times), self.times(whole)
        indices = np.searchsorted(whole.stored_times, problem.stored_times)
        if self.end is None:
            good = np.searchsorted(indices, self.good)
        else:  # the last state is that of no output
            good = np.searchsorted(indices, self.good - 1) + 1
            indices[good[0] - 1] = self.good[0] - 1
        states = States(*(None if array is None else array[:, indices] for array in self.states))  # type: ignore[arg-type]
        found, own = self._replace(states=states, good=good, intervals=None), self.intervals
        if not problem.intervals or own is None or not k:
            return found
        sums, used = own.integrals(np.diff(times)), own.newton_iterations
        sums = np.add.reduceat(sums[:, : indices[-1]], indices[:-1], axis=1)
        most = None if used is None else np.maximum.reduceat(used[:, : indices[-1]], indices[:-1], axis=1)
        means = own.of_integrals(sums, np.diff(times[indices]), most)
        return found._replace(intervals=means)

    def failure(self, i: int = 0) -> Failure | None:
        """Return how a member failed, None where it did not."""
        status, step, residual, turn = self.failures[i].tolist()
        return Failure(Status(int(status)), int(step), residual, turn, self.reasons.get(i, "")) if status else None


def empty_outcome(problem: IVP) -> Outcome:
    """Return an outcome in which all states but the first are to be written."""
    m, k = len(problem), len(problem.stored_times)
    quaternion, velocity = np.full((m, k, 4), np.nan), np.full((m, k, 3), np.nan)
    quaternion[:, 0], velocity[:, 0] = problem.quaternion, problem.velocity
    return Outcome(States(quaternion, velocity), np.full(m, k), np.zeros((m, 4)), {})


def started(state: States) -> dict[str, Any]:
    """Return the fields of a problem of one body that starts with a state."""
    own = {name: getattr(state, name) for name in ("quaternion", "velocity", "normal", "internal")}
    return {"memory": None, **{name: None if x is None else x[None] for name, x in own.items()}}


def onward(problem: IVP, first: int, last: int, state: States | None = None) -> IVP:
    """Return the part of a problem of one body between two nodes of its grid.

    Parameters
    ----------
    problem : IVP
    first, last : int
        Numbers of the nodes.
    state : States, optional
        At the first one; by default that at which the problem starts.
    """
    t_start, t_end = problem.times(np.array([first, last])).tolist()
    n, start = last - first, {} if state is None else started(state)
    grid: dict[str, Any] = {"steps": n, "stored": np.array([0, n]), "segments": problem.grid.after(first)}
    return replace(
        problem, t_start=t_start, t_end=t_end, output_times=None, progress=None, marched=None, **grid, **start
    )
