"""From the parts of a run with events to its outcome: stored states, means between them, events."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..analysis.trajectory import Events
from ..geometry.arrays import Array
from ..geometry.attitudes import States, stacked_states
from ..integrators.base import IVP, Failure, Integrator, Outcome, Status
from ..integrators.problem import Intervals
from .events import Event, Part, Root, Search, parts

MESSAGE = "the event {} ended the run at t = {:.12g} s"


class Ended(NamedTuple):
    """A run with events: the times of its states, its outcome, its events, and how an event ended it."""

    times: Array
    outcome: Outcome
    events: Events
    message: str | None


class Kept:
    """What is kept of a run: states, integrals over time since the start, iterations since the state before."""

    def __init__(self, wanted: Array) -> None:
        self.wanted, self.used = wanted, 0
        self.times, self.states = list[Array](), list[States]()
        self.integrals, self.iterations = list[Array](), list[int]()
        self.total: Array | float = 0.0
        self.like: Intervals | None = None

    def take(self, part: Part, until: float) -> None:
        """Take the states of a part that are wanted, up to a time."""
        times, own, count = part.times, part.outcome.intervals, len(part.times)
        assert own is not None
        passed = own.integrals(np.diff(times))[0]
        totals = self.total + np.concatenate([np.zeros((1, passed.shape[1])), np.cumsum(passed, axis=0)])
        self.like = own
        used = [0] * count if own.newton_iterations is None else [0, *own.newton_iterations[0, : count - 1].tolist()]
        is_wanted = np.isin(times, self.wanted) & (times <= until)
        for k in range(1 if part.first else 0, count):
            if times[k] > until:
                break
            self.used = max(self.used, used[k])
            if is_wanted[k]:
                self.add(float(times[k]), part.outcome.states.part(0, k), totals[k])
        self.total = totals[-1]

    def add(self, time: float, state: States, integral: Array) -> None:
        """Keep a state."""
        self.times.append(np.array(time))
        self.states.append(state)
        self.integrals.append(integral)
        self.iterations.append(self.used)
        self.used = 0

    def end(self, root: Root) -> None:
        """Keep the state of the event that ends the run."""
        if self.times and self.times[-1] == root.time:
            return
        part, since = root.part, float(root.part.times[root.check])
        own = part.outcome.intervals
        assert own is not None
        before = own.integrals(np.diff(part.times))[0]
        integral = np.asarray(self.total) - before[root.check :].sum(axis=0)
        if root.time > since:
            rest = part.beyond(root.check, np.array([since, root.time])).intervals
            assert rest is not None
            integral = integral + rest.integrals(np.array([root.time - since]))[0, 0]
            if rest.newton_iterations is not None:
                self.used = max(self.used, int(rest.newton_iterations.max()))
        self.add(root.time, root.state, integral)

    def outcome(self, last: Outcome, failure: Failure | None) -> Outcome:
        """Return the outcome of the run, whose last part has the outcome `last`, and which has failed, or not."""
        n, like = len(self.times), self.like
        assert like is not None
        none = like.integrals(np.zeros(0))[0]
        between = np.diff(np.array(self.integrals), axis=0) if n > 1 else none
        counts = None if like.newton_iterations is None else np.array([self.iterations[1:]], dtype=np.int64)
        means = like.of_integrals(between[None], np.diff(np.array(self.times)), counts)
        states = stacked_states(self.states) if n else last.states.part(0, slice(0))
        failures = np.zeros((1, 4)) if failure is None else np.array([failure[:4]], dtype=np.float64)
        reasons = {} if failure is None else {0: failure.reason}
        ends = n > 0 and last.states.quaternion.shape[1] > 0
        is_last = ends and np.array_equal(self.states[-1].velocity, last.states.velocity[0, -1])
        memory = last.memory if is_last else None
        return Outcome(states.part(None), np.array([n]), failures, reasons, means, None, memory)


def march(scheme: Integrator, problem: IVP, events: tuple[Event, ...]) -> Ended:
    """March one body, and find events.

    Raises
    ------
    ValueError
        An event function fails; and as the integrator.
    """
    search, kept, roots = Search(events), Kept(problem.output), list[Root]()
    part: Part | None = None
    end, failure = None, None
    try:
        for part in parts(scheme, problem):
            roots += search.roots(part)
            if roots and events[roots[-1].event].terminal and not search.left[roots[-1].event]:
                end = roots[-1]
            kept.take(part, np.inf if end is None else end.time)
            if end is not None:
                kept.end(end)
                break
            if (failure := part.outcome.failure()) is not None:
                failure = failure._replace(step=failure.step + part.first)
    except KeyboardInterrupt as stop:
        if part is None or not kept.times:
            raise
        failure = Failure(Status.INTERRUPTED, part.first, np.nan, np.nan, str(stop))
    assert part is not None
    found, names = [root.state for root in roots], tuple(event.name for event in events)
    occurred = Events(
        names,
        np.array([root.event for root in roots], dtype=np.int64),
        np.array([root.time for root in roots]),
        np.array([state.quaternion for state in found]).reshape(-1, 4),
        np.array([state.velocity for state in found]).reshape(-1, 3),
    )
    message = None if end is None else MESSAGE.format(names[end.event], end.time)
    return Ended(np.array(kept.times), kept.outcome(part.outcome, failure), occurred, message)
