"""A run in pieces: within each the equations are smooth, and it ends where a function of the state falls to zero.

What jumps with the state, dry friction of a body or in the bearing of a wheel, has modes: in each it is a smooth load,
or a constraint. A march in pieces goes from mode to mode. The functions that can end a mode are events (`events`): the
step ends at the root of the first, and the rest of the step follows in the next modes. Means over intervals are sums
over pieces.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..geometry.attitudes import States
from ..integrators.base import IVP, Failure, Integrator, Outcome, Status
from ..integrators.problem import Intervals, onward, scratch, started
from ..loads import Load
from . import completion
from .events import Event, march_to_events

TINY = float(np.finfo(np.float64).tiny)
CLOSE, ULPS = 1e-11, 64  # of a step, and units in the last place of a time: what lies nearer to a node is at it
STEPS = 4096  # that are marched before modes are looked at again
MOST = 50  # changes of modes at one time
RESTLESS = "dry friction changes between sticking and sliding without end"
Modes = dict[int, int]  # of each contact: the sign of its rate while it slides, 0 while it sticks


class Change(NamedTuple):
    """What ends a mode: a function that falls to zero; how its contact slides then, 0: its rate is zero."""

    contact: int
    sign: int
    value: Callable[[float, Any], float]


class Piece(NamedTuple):
    """A part of a run in which modes stay: times with its start and end, states there, means in between."""

    times: Array
    states: States
    means: Intervals | None


class InPieces:
    """A march of a problem of one body from its start to its end.

    A subclass says in which modes a march begins (`begin`), and marches while they stay (`phase`).

    Attributes
    ----------
    load : Load
        What acts in all modes.
    modes : dict
    at_nodes : bool
        Whether pieces have the states at all nodes.
    """

    def __init__(self, scheme: Integrator, problem: IVP, load: Load) -> None:
        self.scheme, self.problem, self.load, self.body = scheme, problem, load, problem.system
        self.t, self.modes, self.pieces, self.at_nodes = problem.t_start, Modes(), list[Piece](), False
        z = None if problem.internal is None else problem.internal[0].copy()
        self.state = States(problem.quaternion[0].copy(), problem.velocity[0].copy(), internal=z)
        self.failure: Failure | None = None
        self.nodes = problem.times(np.arange(problem.steps + 1))

    def begin(self) -> None:
        """Choose the first modes."""
        raise NotImplementedError

    def phase(self) -> None:
        """March while modes stay, to a node at most."""
        raise NotImplementedError

    def told(self, piece: Piece, means: Intervals) -> Intervals:
        """Return the means of a part, with what the march itself knows of it."""
        return means

    def march(self) -> Outcome:
        """March to the end, or to a failure."""
        self.begin()
        begin, end, last, count = self.problem.t_start, self.problem.t_end, self.t, 0
        while self.t < end and self.failure is None:
            self.phase()
            count, last = (0, self.t) if self.t > last else (count + 1, last)
            if count > MOST:
                self.fail(RESTLESS)
            if self.problem.progress:
                self.problem.progress((self.t - begin) / (end - begin))
        return self._outcome()

    def fail(self, reason: str) -> None:
        """End the march here."""
        self.failure = Failure(Status.LOAD, self.number(), np.nan, np.nan, reason)

    # ---- problems

    def number(self, t: float | None = None) -> int:
        """Return the number of the step at whose beginning, or in which, a time is, by default that of the march."""
        return int(np.searchsorted(self.nodes, self.t if t is None else t, side="right")) - 1

    def until(self, most: int = STEPS) -> IVP:
        """Return the problem from here to the next node, from a node over `most` steps."""
        k = self.number()
        if self.t > self.nodes[k]:
            return self.to(float(self.nodes[k + 1]))
        one = onward(self.problem, k, min(k + most, self.problem.steps), self.state)
        return replace(one, load=self.load)

    def to(self, t: float) -> IVP:
        """Return the problem of one step from here to a time."""
        grid: dict[str, Any] = {"steps": 1, "stored": np.array([0, 1]), "stretches": None, "progress": None}
        return replace(self.problem, t_start=self.t, t_end=t, asked=None, load=self.load, **grid, **started(self.state))

    def at_node(self, t: float) -> float:
        """Return a time, or that of the node that it nearly is."""
        k = min(self.number(t) + 1, self.problem.steps)
        node = float(self.nodes[k])
        return node if node - t <= max(CLOSE * (node - self.nodes[k - 1]), ULPS * np.spacing(abs(node))) else t

    # ---- pieces

    def marched(self, one: IVP, changes: Sequence[Change], at_nodes: bool = False) -> tuple[Piece, Change | None]:
        """March a smooth problem to its end or to the first change."""
        known = self.problem.output
        inner = known[(known > one.t_start) & (known < one.t_end)]
        ends = one.times(np.arange(one.steps + 1) if at_nodes or self.at_nodes else np.array([0, one.steps]))
        asked = np.union1d(inner, ends) if changes or inner.size or one.steps > 1 else None
        one = replace(one, asked=asked, intervals=True)
        numbers = list[int]()
        if changes:
            events = tuple(Event(_positive(each.value, one.t_start), "friction", 1, -1.0) for each in changes)
            times, outcome, _, ended_by = march_to_events(self.scheme, one, events)
            numbers = [] if ended_by is None else [ended_by]
        else:
            times, outcome = one.output, completion.march(self.scheme, one)
        n, failure = int(outcome.good[0]), outcome.failure()
        if failure is not None:
            self.failure = failure._replace(step=failure.step + self.number())
        p, W, *_, z = outcome.states
        states = States(p[0, :n].copy(), W[0, :n].copy(), internal=None if z is None else z[0, :n].copy())
        means = outcome.intervals
        if means is not None:
            cut: Any = (None if x is None else x[:, : max(n - 1, 0)] for x in means)
            means = Intervals(*cut)
        times = times[:n].copy()
        if numbers and n:
            times[-1] = self.at_node(float(times[-1]))
        return Piece(times, states, means), changes[numbers[0]] if numbers else None

    def keep(self, piece: Piece) -> None:
        """Add a part to the run; move to its end."""
        if len(piece.times) > 1:
            assert piece.means is not None
            self.pieces.append(piece._replace(means=self.told(piece, piece.means)))
        if len(piece.times):
            self.t = float(piece.times[-1])
            self.state = States(*(None if x is None else x[-1].copy() for x in piece.states))  # type: ignore[arg-type]

    def _outcome(self) -> Outcome:
        """Return the outcome at the times that are asked for: intervals are sums of parts."""
        known, problem, failure = self.pieces, self.problem, self.failure
        output = problem.output
        times = np.concatenate([[problem.t_start], *(piece.times[1:] for piece in known)])
        count = int(np.searchsorted(output, times[-1], side="right"))
        places = np.searchsorted(times, output[:count], side="right") - 1
        states = scratch(problem).states
        if problem.internal is not None:
            states = states._replace(internal=np.full((1, len(output), problem.internal.shape[1]), np.nan))
        for name in ("quaternion", "velocity", "internal"):
            if (into := getattr(states, name)) is not None:
                reached = [getattr(problem, name), *(getattr(piece.states, name)[1:] for piece in known)]
                into[0, :count] = np.concatenate(reached)[places]
        failures = np.zeros((1, 4)) if failure is None else np.array([failure[:4]], dtype=np.float64)
        reasons: dict[int, str] = {} if failure is None else {0: failure.reason}
        found = Outcome(states, np.array([count]), failures, reasons)
        return found._replace(intervals=self._means(places)) if problem.intervals and known else found

    def _means(self, places: NDArray[np.int64]) -> Intervals:
        """Return the means over the intervals between the times of these numbers, of all; NaN beyond the last."""
        parts = [piece.means for piece in self.pieces if piece.means is not None]
        integrals = np.concatenate(
            [part.integrals(np.diff(piece.times))[0] for part, piece in zip(parts, self.pieces, strict=True)]
        )
        n, missing = max(len(places) - 1, 0), len(self.problem.output) - 1
        sums = np.zeros((missing, integrals.shape[1]))
        lengths = np.ones(missing)
        lengths[:n] = np.diff(self.problem.output[: len(places)])
        most = np.zeros((1, missing), dtype=np.int64)
        used = [part.newton_iterations for part in parts]
        for k, (a, b) in enumerate(pairwise(places.tolist())):
            sums[k] = integrals[a:b].sum(axis=0)
        counts = None if any(x is None for x in used) else np.concatenate([x[0] for x in used if x is not None])
        if counts is not None:
            most[0, :n] = [counts[a:b].max() for a, b in pairwise(places.tolist())]
        return parts[0].of_integrals(sums[None], lengths, None if counts is None else most)


def _positive(value: Callable[[float, Any], float], start: float) -> Callable[[float, Any], float]:
    """Return a function that is positive where a mode begins: it may vanish there."""
    return lambda t, state: value(t, state) if t > start else max(value(t, state), TINY)
