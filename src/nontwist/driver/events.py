"""Events: where functions of the state cross zero on the way of a run, as in SciPy's `solve_ivp`.

The functions are evaluated at all nodes of the run, and so often inside each step that the body turns by at most about
a quarter of a radian from one time to the next. The states there, and all that follow, are those of the run itself
(`integrators.dense`, `engine.workspace`), so an event at t is where ``event(t, state(t))`` changes its sign, and
``times=[t]`` gives its state. Between two times of opposite sign the root is that of the polynomial through values of
the function, where it has one; otherwise it is found by Brent's method, to 1e-12 h + 4 eps |t|.

Between two times of one sign a function may fall to zero and rise again. Beside a value that is low, less than those
before and after and than a third of their sum, it is evaluated at more times, and at the lowest point of the polynomial
through them: where its sign is another one there, it has crossed zero twice. Where no polynomial follows it, as at the
corner of a magnitude, the lowest point is searched for. A function that touches zero is missed.

A run with events goes from node to node in parts, each of which continues the one before bit for bit, and ends in the
part in which a terminal event occurs. What is stored of it is put together from pieces.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebroots, chebval, chebvander
from numpy.typing import NDArray

from ..analysis.trajectory import Events
from ..geometry.arrays import Array, as_number
from ..geometry.attitudes import States
from ..geometry.values import as_whole, short_repr
from ..integrators.costs import largest_velocity
from ..integrators.integrator import IVP, Failure, Integrator, Outcome, Status
from ..integrators.ivp import Intervals, onward, started
from ..integrators.load_samples import wheel_columns
from . import completion
from .named_events import NamedEvent
from .starts import BodyState, body_state, wheel_axes_of

TURN, MOST = 0.25, 64  # rad between two times; how many of them there may be in a step
FIRST, LARGEST = 64, 4096  # steps of the first part, of the largest
TIMES = 10**6  # in a run without steps, at most
RTOL, XTOL = 4 * float(np.finfo(np.float64).eps), 1e-12
DEGREE, ROOT = 11, 1e-12  # of a polynomial; what is left of the function at a root, over its largest value
CORNER = 1e-6  # of the largest coefficient: what the last ones of a polynomial have where it does not follow
KNOTS = -np.cos(np.pi * np.arange(DEGREE + 1) / DEGREE)
THROUGH = np.linalg.inv(chebvander(KNOTS, DEGREE)).T  # values at the knots times this: the series through them
NEWTON = 6  # iterations for the root of a polynomial, from where its chord between two knots is zero
LOW, ZERO = 1 / 3, 1e-9  # of the sum of the values before and after: a low value, one that is as good as zero
SAME = 16  # units in the last place between an output time and the node that it is, to round-off
MESSAGE = "the event {} ended the run at t = {:.12g} s"


class Event(NamedTuple):
    """A checked event function."""

    function: Callable[[float, Any], Any]
    name: str
    terminal: int  # number of occurrences after which the run ends, 0: it does not
    direction: float

    def values(self, states: Sequence[BodyState]) -> Array:
        """Return the values of the function at states; a ValueError that names it where it fails."""
        found = np.empty(len(states))
        for k, state in enumerate(states):
            try:
                found[k] = as_number(self.function(state.time, state), "its value")
            except Exception as error:
                what = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
                if type(state).__name__ in what:
                    has = ", ".join(name for name in dir(state) if not name.startswith("_"))
                    what += f"; the state has the attributes {has}"
                raise ValueError(f"the event {self.name} fails at t = {state.time:.12g} s: {what}") from error
        return found

    def counts(self, is_rising: bool) -> bool:
        """Whether a crossing in this direction is one of the event."""
        return self.direction == 0 or (self.direction > 0) == is_rising


def as_events(events: Any) -> tuple[Event, ...]:
    """Return checked events.

    Parameters
    ----------
    events : callable or list of callables, or None
        ``event(t, state)``, with the attributes `terminal` and `direction` as in SciPy's `solve_ivp`.

    Raises
    ------
    ValueError
        Not functions, or an attribute that is wrong; the message names the event.
    """
    functions = [events] if callable(events) else () if events is None else events
    if not isinstance(functions, (list, tuple)):
        raise ValueError(f"events must be a function of time and state, or a list of them, got {short_repr(events)}")
    found = list[Event]()
    for i, function in enumerate(functions):
        if not callable(function):
            raise ValueError(f"events[{i}] must be a function of time and state, got {short_repr(function)}")
        given = getattr(function, "__name__", "")
        has_name = isinstance(given, str) and given.strip() and given.isprintable() and given != "<lambda>"
        name = given if has_name else f"event_{i}"
        while name in [event.name for event in found]:
            name = f"{name}_{i}"
        terminal, direction = getattr(function, "terminal", False), getattr(function, "direction", 0.0)
        if not isinstance(terminal, (bool, np.bool_)):
            terminal = as_whole(terminal, f"terminal of the event {name}", 0)
        direction = as_number(direction, f"direction of the event {name}")
        found.append(Event(function, name, int(terminal), direction))
    return tuple(found)


# ---- a run in pieces


class Piece(NamedTuple):
    """A part of a run of one body: times with its start and end, states there, what is known of the intervals."""

    times: Array
    states: States
    means: Intervals | None  # of one member


def joined(pieces: Sequence[Piece], problem: IVP, failure: Failure | None = None, memory: Any = None) -> Outcome:
    """Return the outcome of a problem that was marched in pieces, each from the end of the one before."""
    beyond = problem.stored_times[problem.stored_times > pieces[-1].times[-1]]
    times = np.concatenate([pieces[0].times, *(one.times[1:] for one in pieces[1:]), beyond])

    def whole(arrays: tuple[Any, ...], axis: int) -> Any:
        """Return arrays of one member, one after the other, and what has not been reached."""
        if any(one is None for one in arrays):
            return None
        none = np.nan if arrays[0].dtype == np.float64 else 0
        after = (*arrays[0].shape[:axis], len(beyond), *arrays[0].shape[axis + 1 :])
        found = np.concatenate([*arrays, np.full(after, none, arrays[0].dtype)], axis=axis)
        return found if axis else found[None]

    rest = (one.states.part(slice(1, None)) for one in pieces[1:])
    states = States(*(whole(arrays, 0) for arrays in zip(pieces[0].states, *rest, strict=True)))
    means = [one.means for one in pieces if one.means is not None]
    intervals = Intervals(*(whole(arrays, 1) for arrays in zip(*means, strict=True))) if means else None
    failures = np.zeros((1, 4)) if failure is None else np.array([failure[:4]], dtype=np.float64)
    reasons = {} if failure is None else {0: failure.reason}
    found = Outcome(states, np.array([len(times) - len(beyond)]), failures, reasons, intervals, None, memory)
    return found.at(replace(problem, output_times=times), problem)


class Part(NamedTuple):
    """A part of a run, with its states at the times at which functions are evaluated, the first its start."""

    scheme: Integrator
    problem: IVP
    outcome: Outcome
    first: int  # number of its first node

    @property
    def times(self) -> Array:
        """The times that have been reached."""
        return self.problem.stored_times[: int(self.outcome.good[0])]

    def pieces(self, wanted: Array, end: Root | None) -> Iterator[Piece]:
        """Yield what is kept up to the event that ends the run: states that are wanted, the first and the last."""
        since = np.inf if end is None else float(self.times[end.check])
        own = self.times[self.times <= since]
        times = np.union1d(own[[0, -1]], own[np.isin(own, wanted)])
        outcome = self.outcome.at(self.problem, replace(self.problem, output_times=times))
        yield Piece(times, outcome.states.part(0), outcome.intervals)
        if end is not None and end.time > since:
            last = np.array([since, end.time])
            outcome = self.beyond(end.check, last)
            yield Piece(last, outcome.states.part(0), outcome.intervals)

    def at(self, checks: Sequence[int], times: Array) -> States:
        """Return the states at rows of times, (n, k), each between the time of such a number and the next."""
        wanted, places = np.unique(times, return_inverse=True)
        if (found := self._inside(wanted)) is not None:
            return found.part(places.reshape(times.shape))
        rows = [self.beyond(check, row).states.part(0) for check, row in zip(checks, times, strict=True)]
        return States(*(None if one[0] is None else np.array(one) for one in zip(*rows, strict=True)))  # type: ignore[arg-type]

    def _inside(self, times: Array) -> States | None:
        """Return states at times between the nodes; None where one step after the other costs less than all."""
        load, failure = self.problem.load, self.outcome.failure()
        is_quick = load.is_compiled and not (load.is_dry or self.problem.off_grid or failure)
        if self.problem.marched is None and not is_quick:
            return None
        found = completion.unchecked(self.scheme, replace(self.problem, output_times=times, intervals=False))
        own = found.states.part(0)  # with the signs of those before
        p = self.outcome.states.part(0).quaternion[np.searchsorted(self.times, times, side="right") - 1]
        own.quaternion[np.sum(own.quaternion * p, axis=1) < 0] *= -1
        return own

    def beyond(self, check: int, times: Array) -> Outcome:
        """Return the outcome at times from that of the number `check` to the next node."""
        problem, t = self.problem, float(self.times[check])
        if problem.off_grid:
            state = self.outcome.states.part(0, check)
            one = replace(problem, **started(state), t_start=t, t_end=float(times[-1]), output_times=times)
            return completion.checked_march(self.scheme, one)
        nodes = problem.times(np.arange(problem.steps + 1))
        node = int(np.searchsorted(nodes, t, side="right")) - 1
        state = self.outcome.states.part(0, int(np.searchsorted(self.times, nodes[node])))
        return completion.checked_march(
            self.scheme, replace(onward(problem, node, node + 1, state), output_times=times)
        )


def parts(scheme: Integrator, problem: IVP) -> Iterator[Part]:
    """Yield the parts of a run, one after the other, up to the one that fails or reaches the end."""
    wanted = problem.stored_times
    if problem.off_grid:
        fastest = largest_velocity(problem.systems, problem.velocity, problem.load, problem.t_start, problem.t_end)
        count = min(TIMES, int(np.ceil((problem.t_end - problem.t_start) * fastest / TURN)))
        times = np.linspace(problem.t_start, problem.t_end, count + 2)
        problem = replace(problem, output_times=np.union1d(times, wanted))
        yield Part(scheme, problem, completion.checked_march(scheme, problem), 0)
        return
    has_series, inside = scheme.has_series(problem.systems, problem.load), 1
    node, size, state, memory = 0, FIRST, None, problem.memory
    while node < problem.steps:
        last = min(node + size, problem.steps)
        one = replace(onward(problem, node, last, state), memory=memory)
        if has_series:  # all other states are found between those at nodes
            found = completion.checked_march(scheme, replace(one, stored=np.arange(one.steps + 1)))
            if found.failure() is None:
                fastest = np.sqrt(np.square(found.states.velocity).sum(axis=-1).max())
                inside = min(MOST, max(1, int(np.ceil(one.grid.longest * fastest / TURN))))
                one = replace(one, marched=found.march)
        while True:
            times = checked_times(one, inside, wanted)
            outcome = completion.checked_march(scheme, replace(one, output_times=times))
            good = int(outcome.good[0])
            turns = np.sqrt(np.square(outcome.states.velocity[0, : good - 1]).sum(axis=1)) * np.diff(times[:good])
            if inside >= MOST or not turns.size or turns.max() <= 1.1 * TURN:
                break
            inside = min(MOST, int(np.ceil(inside * turns.max() / TURN)))
        yield Part(scheme, replace(one, output_times=times), outcome, node)
        if outcome.failure() is not None:
            return
        node, size, state, memory = last, min(2 * size, LARGEST), outcome.states.part(0, -1), outcome.memory


def checked_times(problem: IVP, inside: int, wanted: Array) -> Array:
    """Return the nodes of a part, times between them that divide each step in so many, and those that are wanted."""
    nodes = problem.times(np.arange(problem.steps + 1))
    between = nodes[:-1, None] + np.diff(nodes)[:, None] * (np.arange(1, inside) / inside)
    mine = wanted[(wanted >= nodes[0]) & (wanted <= nodes[-1])]
    return np.unique(np.concatenate([nodes, between.ravel(), mine]))


# ---- the search


class Crossing(NamedTuple):
    """A change of sign of an event between two times, after the check of this number, and the values there."""

    event: int
    check: int
    times: tuple[float, float]
    values: tuple[float, float]


class Root(NamedTuple):
    """An event that has occurred, and the last time before it at which functions were evaluated."""

    time: float
    event: int
    state: States
    check: int


class Search:
    """The search for events in a part of a run."""

    def __init__(self, events: tuple[Event, ...], part: Part) -> None:
        self.events, self.part = events, part

    def roots(self) -> list[Root]:
        """Return the events in the order of their times."""
        times, states = self.part.times, self.part.outcome.states.part(0)
        is_apart = np.diff(times) > SAME * np.spacing(abs(times[1:]))
        found, crossed, near = list[Root](), list[Crossing](), list[Crossing]()
        for number, event in enumerate(self.events):
            values = self._along(event, times, states)
            signs = np.sign(values)
            changes = signs[1:] * signs[:-1]
            for k in np.flatnonzero(((changes < 0) | dips(values)) & is_apart).tolist():
                own = Crossing(number, k, tuple(times[k : k + 2]), tuple(values[k : k + 2]))
                (crossed if changes[k] < 0 else near).append(own)
            is_there = (signs[:-1] != 0) & ((signs[1:] == 0) | ((changes < 0) & ~is_apart))
            for k in (np.flatnonzero(is_there) + 1).tolist():
                if event.counts(signs[k - 1] < 0):
                    found.append(Root(float(times[k]), number, states.part(k), k))
        crossed += self._hidden(near) if near else ()
        counted = [one for one in crossed if self.events[one.event].counts(one.values[1] > 0)]
        found += self._solved(counted) if counted else ()
        return sorted(found, key=lambda root: root.time)

    def _hidden(self, near: list[Crossing]) -> Iterator[Crossing]:
        """Yield pairs of crossings where a function has another sign between two times of one sign."""
        times, values, series = self._through(near)
        sign = np.sign(values[:, 0])
        for i, one in enumerate(near):
            k = int(np.argmin(sign[i] * values[i]))
            t, x, turns = float(times[i, k]), float(values[i, k]), chebroots(chebder(series[i])).real.clip(-1, 1)
            depths = sign[i] * chebval(turns, series[i])
            if sign[i] * x > 0 > depths.min(initial=0.0):
                begin, end = times[i, [0, -1]].tolist()
                t = (begin + end) / 2 + (end - begin) / 2 * float(turns[depths.argmin()])
                x = self._value(one, t)
            if sign[i] * x > 0 and abs(series[i, -2:]).max() > CORNER * abs(series[i]).max():
                ends = times[i, max(k - 1, 0)], times[i, min(k + 1, DEGREE)]
                t, x = self._lowest(one, ends, float(sign[i]))
            if sign[i] * x < -ROOT * abs(values[i]).max():
                yield one._replace(times=(one.times[0], t), values=(one.values[0], x))
                yield one._replace(times=(t, one.times[1]), values=(x, one.values[1]))

    def _lowest(self, one: Crossing, ends: tuple[float, float], sign: float) -> tuple[float, float]:
        """Return where a function, times a sign, is lowest between two times, and its value there."""
        from scipy.optimize import minimize_scalar

        begin, length = ends[0], ends[1] - ends[0]
        found = minimize_scalar(
            lambda since: sign * self._value(one, begin + since),
            bounds=(0.0, length),
            method="bounded",
            options={"xatol": XTOL * length},
        )
        return begin + float(found.x), sign * float(found.fun)

    def _value(self, one: Crossing, t: float) -> float:
        """Return the value of a function at one time."""
        return float(self._values([one], np.array([[t]]))[0][0, 0])

    def _solved(self, crossed: list[Crossing]) -> Iterator[Root]:
        """Yield the roots, of polynomials through values of the functions where these have one, else by Brent."""
        times, values, series = self._through(crossed)
        middle, half = times[:, [0, -1]].mean(axis=1), np.diff(times[:, [0, -1]])[:, 0] / 2
        rows, slopes = np.arange(len(crossed)), chebder(series, axis=1)
        k = np.argmax(np.sign(values[:, 1:]) != np.sign(values[:, :1]), axis=1)  # the knot before the crossing
        (low, high), begin = (values[rows, k], values[rows, k + 1]), KNOTS[k]
        x = begin + (KNOTS[k + 1] - begin) * low / (low - high)
        for _ in range(NEWTON):
            V = chebvander(x, DEGREE)
            with np.errstate(divide="ignore", invalid="ignore"):
                x = np.clip(x - (V * series).sum(axis=1) / (V[:, :-1] * slopes).sum(axis=1), -1, 1)
        roots = middle + half * np.where(np.isfinite(x), x, 0)
        left, states = self._values(crossed, roots[:, None])
        is_root = abs(left[:, 0]) <= ROOT * abs(values).max(axis=1)
        for i, one in enumerate(crossed):
            if is_root[i]:
                yield Root(float(roots[i]), one.event, states.part(i, 0), one.check)
            else:
                yield self._between(one)

    def _through(self, looked: list[Crossing]) -> tuple[Array, Array, Array]:
        """Return times and values at all knots between two times, (n, knots), and the Chebyshev series through them."""
        a, b = np.array([one.times for one in looked]).T[..., None]
        times = (a + b) / 2 + (b - a) / 2 * KNOTS
        times[:, [0, -1]] = np.concatenate([a, b], axis=1)
        ends = np.array([one.values for one in looked])
        values = np.concatenate([ends[:, :1], self._values(looked, times[:, 1:-1])[0], ends[:, 1:]], axis=1)
        return times, values, values @ THROUGH

    def _values(self, looked: list[Crossing], times: Array) -> tuple[Array, States]:
        """Return the values of the functions at times of their own, (n, k), and the states."""
        states = self.part.at([one.check for one in looked], times)
        values, numbers = np.empty(times.shape), np.array([one.event for one in looked])
        for number in {one.event for one in looked}:
            rows = numbers == number
            values[rows] = self._along(self.events[number], times[rows], states.part(rows))
        return values, states

    def _along(self, event: Event, times: Array, states: States) -> Array:
        """Return the values of a function at times and the states there, along any leading axes."""
        if isinstance(event.function, NamedEvent):
            return event.function.along(states.quaternion, states.velocity)
        if times.ndim > 1:
            return np.array([self._along(event, row, states.part(k)) for k, row in enumerate(times)])
        return event.values(self._bodies(times, states))

    def _between(self, one: Crossing) -> Root:
        """Return the root by Brent's method."""
        from scipy.optimize import brentq

        known = dict(zip(one.times, one.values, strict=True))

        def value(t: float) -> float:
            return known[t] if t in known else self._value(one, t)

        problem = self.part.problem
        longest = problem.t_end - problem.t_start if problem.off_grid else problem.grid.longest
        t = float(brentq(value, *one.times, xtol=max(XTOL * longest, np.finfo(np.float64).tiny), rtol=RTOL))
        return Root(t, one.event, self.part.at([one.check], np.array([[t]])).part(0, 0), one.check)

    def _bodies(self, times: Array, states: States) -> list[BodyState]:
        """Return states along times as values."""
        p, W, t, load = states.quaternion.tolist(), states.velocity.tolist(), times.tolist(), self.part.problem.load
        z: Any = [()] * len(t) if states.internal is None else states.internal.tolist()
        axes, columns = wheel_axes_of(load), [k for _, k in wheel_columns(load)]
        return [body_state(*one, axes, columns) for one in zip(t, p, W, z, strict=False)]


def dips(values: Array) -> NDArray[np.bool_]:
    """Return between which values of one sign there may be some of the other: beside one that is low, but not zero."""
    signs, beside = np.sign(values), np.pad(values, 1, mode="reflect")
    own, before, after = signs * values, signs * beside[:-2], signs * beside[2:]
    is_low = (own <= np.minimum(before, after)) & (own < LOW * (before + after)) & (own > ZERO * (before + after))
    return (signs[1:] * signs[:-1] > 0) & (is_low[1:] | is_low[:-1])


# ---- the march


class Ended(NamedTuple):
    """A run with events: the times of its states, its outcome, its events, and which of them ended it."""

    times: Array
    outcome: Outcome
    events: Events
    ended_by: int | None

    @property
    def message(self) -> str | None:
        """How an event ended the run."""
        return None if self.ended_by is None else MESSAGE.format(self.events.names[self.ended_by], self.times[-1])


def march_to_events(scheme: Integrator, problem: IVP, events: tuple[Event, ...]) -> Ended:
    """March one body, and find events.

    Raises
    ------
    ValueError
        An event function fails; and as the integrator.
    """
    pieces, roots, wanted = list[Piece](), list[Root](), problem.stored_times
    part: Part | None = None
    end: Root | None = None
    failure: Failure | None = None
    try:
        for part in parts(scheme, problem):
            for root in Search(events, part).roots():
                roots.append(root)
                if sum(one.event == root.event for one in roots) == events[root.event].terminal:
                    end = root
                    break
            pieces += part.pieces(wanted, end)
            if end is not None:
                break
            if (failure := part.outcome.failure()) is not None:
                failure = failure._replace(step=failure.step + part.first)
    except KeyboardInterrupt as stop:
        if part is None or not pieces:
            raise
        failure = Failure(Status.INTERRUPTED, part.first, np.nan, np.nan, str(stop))
    assert part is not None
    reached, until = pieces[-1].times[-1], wanted if end is None else np.append(wanted[wanted < end.time], end.time)
    times = until[until <= reached]
    is_last = len(times) > 0 and times[-1] == part.times[-1]
    outcome = joined(pieces, replace(problem, output_times=times), failure, part.outcome.memory if is_last else None)
    found = [root.state for root in roots]
    occurred = Events(
        tuple(event.name for event in events),
        np.array([root.event for root in roots], dtype=np.int64),
        np.array([root.time for root in roots]),
        np.array([state.quaternion for state in found]).reshape(-1, 4),
        np.array([state.velocity for state in found]).reshape(-1, 3),
    )
    return Ended(times, outcome, occurred, None if end is None else end.event)
