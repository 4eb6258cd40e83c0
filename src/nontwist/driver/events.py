"""Events: where functions of the state cross zero on the way of a run, as in SciPy's `solve_ivp`.

The functions are evaluated at all nodes of the run, and so often inside each step that the body turns by at most about
a quarter of a radian from one time to the next. The states there, and all that follow, are those of the run itself
(`integrators.dense`, `engine.outputs`), so an event at t is where ``event(t, state(t))`` changes its sign, and
``times=[t]`` gives its state. Between two times of opposite sign the root is that of the polynomial through values of
the function, where it has such a root and states are found by power series; otherwise it is found by Brent's method, to
1e-12 h + 4 eps |t|. A sign that changes twice between two times is missed, and so is a function that touches zero.

A run with events goes from node to node in parts, each of which continues the one before bit for bit, and ends in the
part in which a terminal event occurs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_axis, as_number
from ..geometry.attitudes import States
from ..geometry.values import as_whole, shown
from ..integrators.base import IVP, Integrator, Outcome
from ..integrators.costs import largest_velocity
from ..integrators.problem import onward, started
from . import completion
from .starts import BodyState, body_state

TURN, MOST = 0.25, 64  # rad between two times; how many of them there may be in a step
FIRST, LARGEST = 64, 4096  # steps of the first part, of the largest
TIMES = 10**6  # in a run without steps, at most
RTOL, XTOL = 4 * float(np.finfo(np.float64).eps), 1e-12
DEGREE, ROOT = 11, 1e-12  # of a polynomial; what is left of the function at a root, over its largest value
KNOTS = -np.cos(np.pi * np.arange(DEGREE + 1) / DEGREE)


class Event(NamedTuple):
    """A checked event function."""

    function: Callable[[float, Any], Any]
    name: str
    terminal: int  # number of occurrences after which the run ends, 0: it does not
    direction: float

    def value(self, t: float, p: Any, W: Any, z: Any = ()) -> float:
        """Return the value of the function at a state; a ValueError that names it where it fails."""
        try:
            return float(as_number(self.function(t, body_state(t, p, W, z)), "its value"))
        except Exception as error:
            what = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
            raise ValueError(f"the event {self.name} fails at t = {t:.12g} s: {what}") from error

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
        raise ValueError(f"events must be a function of time and state, or a list of them, got {shown(events)}")
    found = list[Event]()
    for i, function in enumerate(functions):
        if not callable(function):
            raise ValueError(f"events[{i}] must be a function of time and state, got {shown(function)}")
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


class Part(NamedTuple):
    """A part of a run, with its states at the times at which functions are evaluated, the first its start."""

    scheme: Integrator
    problem: IVP
    outcome: Outcome
    first: int  # number of its first node

    @property
    def times(self) -> Array:
        """The times that have been reached."""
        return self.problem.output[: int(self.outcome.good[0])]

    def inside(self, times: Array) -> States | None:
        """Return states at times between the nodes; None where there is no series."""
        problem = self.problem
        if problem.off_grid or self.outcome.failure() is not None:
            return None
        nodes, own = problem.times(np.arange(problem.steps + 1)), self.outcome.states.part(0)
        found = completion.between(
            self.scheme, replace(problem, asked=times), own.part(np.searchsorted(self.times, nodes))
        )
        if found is not None:  # with the signs of those before
            p = own.quaternion[np.searchsorted(self.times, times, side="right") - 1]
            found.quaternion[np.sum(found.quaternion * p, axis=1) < 0] *= -1
        return found

    def beyond(self, check: int, times: Array) -> Outcome:
        """Return the outcome at times from that of the number `check` to the next node."""
        problem, t = self.problem, float(self.times[check])
        if problem.off_grid:
            state = self.outcome.states.part(0, check)
            one = replace(problem, **started(state), t_start=t, t_end=float(times[-1]), asked=times)
            return completion.march(self.scheme, one)
        nodes = problem.times(np.arange(problem.steps + 1))
        node = int(np.searchsorted(nodes, t, side="right")) - 1
        state = self.outcome.states.part(0, int(np.searchsorted(self.times, nodes[node])))
        return completion.march(self.scheme, replace(onward(problem, node, node + 1, state), asked=times))


class Root(NamedTuple):
    """An event that has occurred, and the last time before it at which functions were evaluated."""

    time: float
    event: int
    state: States
    part: Part
    check: int


class Crossing(NamedTuple):
    """A change of sign: of an event, after the time of this number, with the values there and at the next."""

    event: int
    check: int
    values: tuple[float, float]


def parts(scheme: Integrator, problem: IVP) -> Iterator[Part]:
    """Yield the parts of a run, one after the other, up to the one that fails or reaches the end."""
    wanted = problem.output
    if problem.off_grid:
        fastest = largest_velocity(problem.systems, problem.velocity, problem.load, problem.t_start, problem.t_end)
        count = min(TIMES, int(np.ceil((problem.t_end - problem.t_start) * fastest / TURN)))
        times = np.linspace(problem.t_start, problem.t_end, count + 2)
        problem = replace(problem, asked=np.union1d(times, wanted))
        yield Part(scheme, problem, completion.march(scheme, problem), 0)
        return
    node, size, state, memory, inside = 0, FIRST, None, problem.memory, 1
    while node < problem.steps:
        last = min(node + size, problem.steps)
        one = replace(onward(problem, node, last, state), memory=memory)
        while True:
            times = checked_times(one, inside, wanted)
            outcome = completion.march(scheme, replace(one, asked=times))
            good = int(outcome.good[0])
            turns = np.sqrt(np.square(outcome.states.velocity[0, : good - 1]).sum(axis=1)) * np.diff(times[:good])
            if inside >= MOST or not turns.size or turns.max() <= 1.1 * TURN:
                break
            inside = min(MOST, int(np.ceil(inside * turns.max() / TURN)))
        yield Part(scheme, replace(one, asked=times), outcome, node)
        if outcome.failure() is not None:
            return
        node, size, state, memory = last, min(2 * size, LARGEST), outcome.states.part(0, -1), outcome.memory


def checked_times(problem: IVP, inside: int, wanted: Array) -> Array:
    """Return the nodes of a part, times between them that divide each step in so many, and those that are wanted."""
    nodes = problem.times(np.arange(problem.steps + 1))
    between = nodes[:-1, None] + np.diff(nodes)[:, None] * (np.arange(1, inside) / inside)
    mine = wanted[(wanted >= nodes[0]) & (wanted <= nodes[-1])]
    return np.unique(np.concatenate([nodes, between.ravel(), mine]))


class Search:
    """The search for events in the parts of a run."""

    def __init__(self, events: tuple[Event, ...]) -> None:
        self.events, self.signs, self.left = events, [0.0] * len(events), [event.terminal for event in events]

    def roots(self, part: Part) -> Iterator[Root]:
        """Yield the events of a part in the order of their times, up to one that ends the run."""
        found, crossed, states = list[Root](), list[Crossing](), part.outcome.states
        times, p, W = part.times.tolist(), states.quaternion[0].tolist(), states.velocity[0].tolist()
        z: Any = [()] * len(times) if states.internal is None else states.internal[0].tolist()
        for number, event in enumerate(self.events):
            before, value = self.signs[number], 0.0
            for k, t in enumerate(times):
                last, value = value, event.value(t, p[k], W[k], z[k])
                sign = float(np.sign(value))
                if before * sign < 0 and event.counts(sign > 0):
                    crossed.append(Crossing(number, k - 1, (last, value)))
                elif before and not sign and event.counts(before < 0):
                    found.append(Root(t, number, states.part(0, k), part, k))
                before = sign
            self.signs[number] = before
        found += self._by_polynomials(part, crossed) or (self._between(part, *each) for each in crossed)
        for root in sorted(found, key=lambda root: root.time):
            yield root
            if self.left[root.event]:
                self.left[root.event] -= 1
                if not self.left[root.event]:
                    return

    def _by_polynomials(self, part: Part, crossed: list[Crossing]) -> list[Root]:
        """Return the roots of polynomials through values of the functions; none where a function is no polynomial."""
        if not crossed:
            return []
        from numpy.polynomial.chebyshev import chebroots, chebvander

        a, b = (part.times[[each.check + k for each in crossed]] for k in range(2))
        middle, half = (a + b) / 2, (b - a) / 2
        times = middle[:, None] + half[:, None] * KNOTS[1:-1]
        if (inner := self._values(part, crossed, times)) is None:
            return []
        ends = np.array([each.values for each in crossed])
        values = np.concatenate([ends[:, :1], inner[0], ends[:, 1:]], axis=1)
        roots = np.full(len(crossed), np.nan)
        for k, series in enumerate(np.linalg.solve(chebvander(KNOTS, DEGREE), values.T).T):
            own = chebroots(series)
            own = own.real[(abs(own.imag) < ROOT) & (abs(own.real) < 1)]
            if len(own) == 1:
                roots[k] = middle[k] + half[k] * own[0]
        if np.isnan(roots).any() or (found := self._values(part, crossed, roots[:, None])) is None:
            return []
        left, states = found
        if not (abs(left[:, 0]) <= ROOT * abs(values).max(axis=1)).all():
            return []
        known = zip(crossed, roots.tolist(), states, strict=True)
        return [Root(t, one.event, own[0], part, one.check) for one, t, own in known]

    def _values(self, part: Part, crossed: list[Crossing], times: Array) -> tuple[Array, list[list[States]]] | None:
        """Return the values of the functions that have crossed zero at times of their own, (n, k), and the states."""
        wanted, places = np.unique(times, return_inverse=True)
        if (found := part.inside(wanted)) is None:
            return None
        states = [[found.part(int(k)) for k in row] for row in places.reshape(times.shape)]
        values = np.empty(times.shape)
        for k, each in enumerate(crossed):
            for i, (t, x) in enumerate(zip(times[k].tolist(), states[k], strict=True)):
                z = () if x.internal is None else x.internal.tolist()
                values[k, i] = self.events[each.event].value(t, x.quaternion.tolist(), x.velocity.tolist(), z)
        return values, states

    def _between(self, part: Part, number: int, check: int, values: tuple[float, float]) -> Root:
        """Return the root between the time of the number `check` and the next, at which the function has `values`."""
        from scipy.optimize import brentq

        event, (a, b) = self.events[number], part.times[check : check + 2].tolist()
        known = {a: values[0], b: values[1]}
        reached = dict[float, States]()

        def value(t: float) -> float:
            if t not in known:
                reached[t] = state = part.beyond(check, np.array([t])).states.part(0, 0)
                z = () if state.internal is None else state.internal.tolist()
                known[t] = event.value(t, state.quaternion.tolist(), state.velocity.tolist(), z)
            return known[t]

        longest = part.problem.t_end - part.problem.t_start if part.problem.off_grid else part.problem.grid.longest
        t = float(brentq(value, a, b, xtol=max(XTOL * longest, np.finfo(np.float64).tiny), rtol=RTOL))
        at_end = {a: check, b: check + 1}
        if t in at_end:
            return Root(t, number, part.outcome.states.part(0, at_end[t]), part, at_end[t])
        value(t)
        return Root(t, number, reached[t], part, check)


# Events that have names: an axis of the body crosses a plane, a spin falls below a value.


class NamedEvent:
    """An event function with a name, made by `axis_crosses` or `spin_below`; its kind and keys in run files."""

    kind = ""
    fields: tuple[str, ...] = ()

    def __init__(self, name: str, terminal: bool | int, direction: float) -> None:
        self.__name__, self.terminal, self.direction = name, terminal, direction

    def __call__(self, t: float, state: BodyState) -> float:
        """Return the value whose zeros are the events."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<event {self.__name__}>"


class _AxisCrosses(NamedEvent):
    kind, fields = "axis-crosses", ("axis", "normal", "cosine")

    def __init__(self, axis: Any, normal: Any, cosine: float, *rest: Any) -> None:
        super().__init__(*rest)
        self.axis, self.normal, self.cosine = axis, normal, cosine

    def __call__(self, t: float, state: BodyState) -> float:
        return float(self.normal @ (self.axis @ state.directors)) - self.cosine


class _SpinBelow(NamedEvent):
    kind, fields = "spin-below", ("value", "axis")

    def __init__(self, value: float, axis: Any, *rest: Any) -> None:
        super().__init__(*rest)
        self.value, self.axis = value, axis

    def __call__(self, t: float, state: BodyState) -> float:
        x, y, z = state.material_angular_velocity
        if self.axis is None:
            return sqrt(x * x + y * y + z * z) - self.value
        a, b, c = self.axis
        return float(abs(a * x + b * y + c * z)) - self.value


def axis_crosses(
    axis: ArrayLike = (0, 0, 1),
    normal: ArrayLike = (0, 0, 1),
    *,
    cosine: float = 0.0,
    direction: float = 0.0,
    terminal: bool | int = False,
    name: str = "axis_crosses",
) -> NamedEvent:
    """Return the event that an axis of the body crosses a plane, or a cone about its normal.

    Parameters
    ----------
    axis : (3,) array, or "x", "y", "z", "-x", "-y", "-z"
        Components along the directors, of any length.
    normal : (3,) array, or such a letter
        Normal of the plane, in space, of any length.
    cosine : float
        Cosine of the angle between axis and normal: 0 for the plane, otherwise a cone.
    direction : float
        > 0: only towards the side of the normal; < 0: only away from it.
    terminal : bool or int
        Whether the first such event ends the run, or the number of the event that ends it.
    name : str

    Returns
    -------
    callable
        For ``events=`` of `simulate`.

    Raises
    ------
    ValueError
        An axis or a normal has length 0, or the cosine is not between -1 and 1.

    Examples
    --------
    >>> from nontwist import axis_crosses, nontwisting, simulate
    >>> level = axis_crosses(terminal=True)
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=9, angular_velocity=(2, 0, 0), events=level, integrator="exact")
    >>> run.message
    'the event axis_crosses ended the run at t = 0.785398163397 s'
    """
    x = as_number(cosine, "cosine")
    if not -1 < x < 1:
        raise ValueError(f"cosine must be between -1 and 1, got {x:g}")
    return _AxisCrosses(_unit(axis, "axis"), _unit(normal, "normal"), x, name, terminal, direction)


def spin_below(
    value: float,
    axis: ArrayLike | None = None,
    *,
    direction: float = -1.0,
    terminal: bool | int = False,
    name: str = "spin_below",
) -> NamedEvent:
    """Return the event that the angular speed of the body falls below a value.

    Parameters
    ----------
    value : float, rad/s
    axis : (3,) array, or "x", "y", "z", "-x", "-y", "-z", optional
        Components along the directors: the magnitude of the component of W along this axis counts. By default the
        magnitude of W.
    direction : float
        < 0: when the speed falls below the value, the default; > 0: when it rises above it; 0: both.
    terminal : bool or int
        Whether the first such event ends the run, or the number of the event that ends it.
    name : str

    Returns
    -------
    callable
        For ``events=`` of `simulate`.

    Raises
    ------
    ValueError
        `value` is not positive, or the axis has length 0.

    Examples
    --------
    >>> from nontwist import damping, simulate, spin_below, standard
    >>> slow, W = spin_below(0.5, terminal=True), (0, 0, 1)
    >>> run = simulate(standard([2, 2, 2]), t_end=9, load=damping(1), material_angular_velocity=W, events=slow)
    >>> run.t_events.values.round(3)  # 2 ln 2 s
    array([1.386])
    """
    x = as_number(value, "value")
    if not x > 0:
        raise ValueError(f"value must be positive, got {x:g}")
    along = None if axis is None else tuple(_unit(axis, "axis").tolist())
    return _SpinBelow(x, along, name, terminal, direction)


def _unit(value: ArrayLike, name: str) -> Any:
    x = as_axis(value, name)
    size = float(sqrt(x @ x))
    if not size > 0:
        raise ValueError(f"{name} must not be zero")
    return x / size
