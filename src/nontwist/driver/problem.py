"""`Problem`: a body, its start, its load, its times and its integrator, described once for all that solves it."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import FrozenInstanceError
from types import MappingProxyType
from typing import Any, Literal, TypedDict, TypeVar, Unpack

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.values import unknown_keyword
from ..integrators import DEFAULT, Integrator
from ..loads import Load, Term, as_load
from ..loads.load import with_torques
from ..models.stack import SystemStack, stacked
from ..models.system import DirectorSystem, as_system
from ..spec import with_keywords
from .events import as_events
from .planning import Plan, planned, resolve_integrator
from .single_run import Forecast, Prepared, forecast
from .starts import BodyState, Starts, starts

Event = Callable[[float, BodyState], float]
Events = Event | Sequence[Event]


class OfStart(TypedDict, total=False):
    """Keywords for the start."""

    start: Any
    rotation: Any
    scalar_first: bool | None
    material_angular_velocity: ArrayLike | None
    angular_velocity: ArrayLike | None
    project: bool


class OfSpan(TypedDict, total=False):
    """Keywords for times, load and integrator."""

    t_end: float | None
    step: float | None
    tolerance: float | None
    t_start: float | None
    load: Load | Term | None
    integrator: str | Integrator
    order: int | None


class OfMotion(OfSpan, OfStart, total=False):
    """Keywords for one motion whose stored states nobody chooses."""


class OfStored(OfMotion, total=False):
    """Keywords for one motion whose nodes are stored."""

    store: int | Literal["end"]


class OfRun(OfStored, total=False):
    """Keywords for one run."""

    times: ArrayLike | None
    events: Events | None


class OfMany(OfMotion, total=False):
    """Keywords for many motions."""

    load_scale: ArrayLike
    wheel_torque: ArrayLike | None


class OfEnsemble(OfMany, total=False):
    """Keywords for an ensemble."""

    times: ArrayLike | None
    store: int | Literal["end"]


class OfStarts(OfSpan, total=False):
    """Keywords for many starts that are given one by one."""

    times: ArrayLike | None
    store: int | Literal["end"]
    project: bool


class OfLoop(TypedDict, total=False):
    """Keywords for steps that are taken one by one."""

    step: float
    load: Load | Term | None
    integrator: str | Integrator
    order: int | None


class OfNodes(TypedDict, total=False):
    """Keywords for runs at nodes that do not depend on what is varied."""

    t_end: float
    step: float
    t_start: float | None
    rotation: Any
    scalar_first: bool | None
    material_angular_velocity: ArrayLike
    load: Load | Term | None
    integrator: str | Integrator
    order: int | None
    store: int | Literal["end"]
    project: bool


class OfComparison(OfStart, total=False):
    """Keywords for what integrators are compared on."""

    t_end: float | None
    t_start: float | None
    load: Load | Term | None


class OfProblem(OfRun, OfEnsemble, total=False):
    """All keywords of a problem."""


DEFAULTS: dict[str, Any] = {"integrator": DEFAULT, "store": 1, "project": False, "load_scale": 1.0}
STARTS = tuple(OfStart.__annotations__)
F = TypeVar("F", bound=Callable[..., Any])


def takes(group: type, *last: str, **defaults: Any) -> Callable[[F], F]:
    """Give a function the keys of a group as keywords of its signature, in place of ``**keywords``.

    `defaults` are those that differ from the ones of a problem; `last` are its own keywords that stand behind them.
    """

    def described(function: F) -> F:
        forms = {name: getattr(form, "__forward_arg__", form) for name, form in group.__annotations__.items()}
        known = DEFAULTS | defaults
        with_keywords(function, {name: (form, known.get(name)) for name, form in forms.items()}, last)
        return function

    return described


def refuse_unknown(function: str, keywords: Mapping[str, Any], group: type) -> None:
    """Raise a TypeError where a group has no such keyword."""
    known = group.__annotations__
    for name in keywords.keys() - known.keys():
        raise unknown_keyword(function, name, known)


class Problem:
    """A body, its start, its load, its times and its integrator, for every function that solves it.

    It cannot be changed; `replace` returns another. What is wrong is found where it is solved.

    Parameters
    ----------
    system : DirectorSystem or SystemStack
        The body, or many.
    t_end, step, tolerance, t_start, load, integrator, order, times, store, events, project
        As in `simulate`.
    start, rotation, scalar_first, material_angular_velocity, angular_velocity
        As in `simulate`; of many starts as in `simulate_ensemble`.
    load_scale, wheel_torque
        As in `simulate_ensemble`.

    Raises
    ------
    TypeError
        There is no such keyword.

    Examples
    --------
    One description for a run, its derivatives and its chaos:

    >>> from nontwist import Problem, lyapunov, sensitivities, simulate, standard
    >>> problem = Problem(standard([3, 4, 5]), t_end=20, material_angular_velocity=(0.1, 2, 0))
    >>> simulate(problem).time.values[-1].item()
    20.0
    >>> sensitivities(problem, wrt="inertia", t_end=5).sizes["parameter"]
    6
    >>> lyapunov(problem.replace(integrator="lie-midpoint", step=0.1)).sizes["exponent"]
    6
    """

    system: DirectorSystem | SystemStack
    given: Mapping[str, Any]
    file: Any = None  # the run file that it was read from, as it stands

    @takes(OfProblem)
    def __init__(self, system: DirectorSystem | SystemStack, **keywords: Unpack[OfProblem]) -> None:
        refuse_unknown("Problem", keywords, OfProblem)
        vars(self).update(system=system, given=MappingProxyType(_kept(keywords)))

    def __setattr__(self, name: str, value: Any) -> None:
        raise FrozenInstanceError(f"a problem cannot be changed: problem.replace({name}=...) returns another")

    def __delattr__(self, name: str) -> None:
        raise FrozenInstanceError(f"a problem cannot be changed: problem.replace({name}=None) returns another")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Problem) or self.system != other.system:
            return False
        one, two = _whole(self.given), _whole(other.given)
        return one.keys() == two.keys() and all(_are_equal(value, two[key]) for key, value in one.items())

    def __hash__(self) -> int:
        return hash((self.system, frozenset(_whole(self.given))))

    def __reduce__(self) -> tuple[Any, ...]:
        return problem_with, (self.system, dict(self.given), self.file)

    def __getattr__(self, name: str) -> Any:
        if name not in OfProblem.__annotations__:
            raise AttributeError(f"a problem has no {name!r}")
        return self.given.get(name, DEFAULTS.get(name))

    def __repr__(self) -> str:
        body = getattr(self.system, "name", repr(self.system))
        return f"Problem({', '.join([body, *(f'{key}={value!r}' for key, value in self.given.items())])})"

    def replace(self, system: DirectorSystem | SystemStack | None = None, **changes: Unpack[OfProblem]) -> Problem:
        """Return the problem with other values; None takes one away.

        Parameters
        ----------
        system : DirectorSystem or SystemStack, optional
            Another body.
        **changes
            Keywords of a problem.

        Returns
        -------
        Problem

        Raises
        ------
        TypeError
            There is no such keyword.
        ValueError
            The times of a run file are changed whose loads begin and end with the run.
        """
        refuse_unknown("replace", changes, OfProblem)
        given = {**self.given, **_kept(changes)}
        kept = {key: value for key, value in given.items() if value is not None}
        return problem_with(self.system if system is None else system, kept)

    @classmethod
    def read(cls, path: str | os.PathLike[str], set: Iterable[str] = ()) -> Problem:
        """Read and check a run file: a problem in TOML.

        Parameters
        ----------
        path : path
            A TOML file; see the page of run files, or ``nontwist example``.
        set : iterable of str
            Values to set, as "key=value" with the value in TOML: ``"body.mass=2.5"``, ``"load.0.amplitude=[0, 0, 1]"``;
            ``"key="`` removes a key. A step replaces the tolerance of the file, and the other way round.

        Returns
        -------
        Problem
            `simulate` records the file in the attributes of a run of it.

        Raises
        ------
        RunFileError
            A ValueError with one line for each problem: "file: key: what was given -> what is accepted".
        ValueError
            `path` is not a path, or `set` has no strings.
        OSError
            The file cannot be read; it is a FIFO or a device.

        Examples
        --------
        >>> from nontwist import Problem, nontwisting, simulate
        >>> problem = Problem(nontwisting([3, 4, 5]), t_end=1, material_angular_velocity=(6, -18, 0))
        >>> problem.write("run.toml")
        >>> run = simulate(Problem.read("run.toml", set=["time.t_end=2"]))
        >>> run.time.values[-1].item(), "run_file" in run.attrs
        (2.0, True)
        """
        from ..runfile.document import read_run_file

        return read_run_file(path, set).problem

    def write(self, path: str | os.PathLike[str], *, force: bool = False) -> None:
        """Write the problem as a run file, from which `read` makes a problem with the same motion.

        Parameters
        ----------
        path : path
            With the suffix ``.toml``.
        force : bool
            Replace an existing file.

        Raises
        ------
        ValueError
            `path` is none; functions in Python, many bodies and many starts have no place in a run file; the message
            names them.
        FileExistsError
            The file exists, and `force` is False.

        Notes
        -----
        The numbers are the same, but for the round-off of an inertia of more than 14 digits.
        The motion depends on mass times centre of mass alone: the file of a body of which no more is known, as of a
        saved run, has the mass 1 kg, or more where its inertia requires it.
        """
        from ..runfile.writing import write

        write(self, path, force)

    def forecast(self) -> Forecast:
        """Return what a run will be like: steps, states, time, memory, warnings; nothing is run.

        Returns
        -------
        Forecast

        Raises
        ------
        ValueError
            As `simulate`.
        """
        return forecast(prepared(self))


def prepared(problem: Problem) -> Prepared:
    """Return a problem made ready to run; errors as `simulate`."""
    if "load_scale" in problem.given:
        raise ValueError("load_scale is that of an ensemble; multiply the load of one run: load=2 * load")
    if "wheel_torque" in problem.given:
        raise ValueError("wheel_torque is that of an ensemble; those of one run are in its load: wheel(torque=...)")
    begin = start_of(problem)
    plan, events = plan_of(problem, begin), as_events(problem.events)
    shows: Literal["between", "nothing"] = "between" if events or plan.output_times is None else "nothing"
    return Prepared(plan._replace(shows=shows), begin, events)


def start_of(problem: Problem) -> Starts:
    """Return the checked start of one run; errors as `simulate`."""
    how = {"t_start": problem.t_start, "load": as_load(problem.load), **keywords_of(problem, OfStart)}
    return starts(as_system(problem.system), **how)


def starts_of(problem: Problem) -> Starts:
    """Return the checked starts of many runs; errors as `simulate_ensemble`."""
    how = {name: getattr(problem, name) for name in ("t_start", "load_scale", "wheel_torque")}
    return starts(problem.system, **how, **keywords_of(problem, OfStart), many=True, load=as_load(problem.load))


def plan_of(problem: Problem, begin: Starts | None = None, **fixed: Any) -> Plan:
    """Return the checked plan, which continues the run that a start ends; errors as `simulate`.

    `fixed` are keywords that the caller decides.
    """
    how = {**keywords_of(problem, OfSpan), "store": problem.store, "times": problem.times, **fixed}
    if begin is not None and begin.wheel_torque is not None:  # which members have motors for
        how["load"] = with_torques(as_load(problem.load), np.zeros(begin.wheel_torque.shape[1]))
    return planned(stacked(problem.system), start_time=None if begin is None else begin.time, **how)


def every_stored(problem: Problem) -> int | Literal["end"]:
    """Return which states are stored where the ends are by default: all that `times` asks for."""
    every: int | Literal["end"] = problem.store
    return 1 if problem.times is not None and every == "end" else every


def keywords_of(problem: Problem, group: Any) -> dict[str, Any]:
    """Return the keywords of a group that a problem has."""
    return {key: problem.given[key] for key in group.__annotations__ if key in problem.given}


def _kept(keywords: Any) -> dict[str, Any]:
    """Return keywords with copies of arrays and lists, whose owner may change them; those of arrays are read-only."""
    kept = {key: value.copy() if isinstance(value, (np.ndarray, list)) else value for key, value in keywords.items()}
    for value in kept.values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    return kept


def _whole(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return keywords with the defaults of what they leave out, and an integrator of a stated order as an instance."""
    known = {**DEFAULTS, "load": Load(), **{key: value for key, value in given.items() if value is not None}}
    if "start" not in known:
        velocity = {} if "angular_velocity" in known else {"material_angular_velocity": np.zeros(3)}
        known = {"t_start": 0.0, **velocity, **known}
    with suppress(ValueError, TypeError):
        if known.get("order") is not None:
            known["integrator"] = resolve_integrator(known["integrator"], known["order"])
            del known["order"]
    return known


def _are_equal(one: Any, other: Any) -> bool:
    """Whether two values of a keyword are the same: numbers, also in arrays, loads, rotations, runs, or functions."""
    if one is other or hasattr(one, "identical"):
        return one is other or bool(type(one) is type(other) and one.identical(other))
    one, other = (value.as_matrix() if hasattr(value, "as_matrix") else value for value in (one, other))
    return np.array_equal(one, other)


def problem_with(system: DirectorSystem | SystemStack, given: Mapping[str, Any], file: Any = None) -> Problem:
    """Return the problem with these keywords, which are known; `file` is the run file that says the same."""
    problem = Problem.__new__(Problem)
    vars(problem).update(system=system, given=MappingProxyType(dict(given)), file=file)
    return problem


def posed(
    function: str,
    system: DirectorSystem | SystemStack | Sequence[DirectorSystem] | Problem,
    keywords: Mapping[str, Any],
    group: type,
    aside: Collection[str] = ("store",),
    **defaults: Any,
) -> Problem:
    """Return the problem that a function is to solve: one that it is given, with changes, or a body with keywords.

    Raises
    ------
    TypeError
        The group has no such keyword.
    ValueError
        The problem has what the function does not take, and does not leave `aside`.
    """
    own = keywords
    if isinstance(system, Sequence) and not isinstance(system, str):
        system = SystemStack.of(system)
    if isinstance(system, Problem):  # None takes away what it has, and the function does not take
        own = {name: x for name, x in keywords.items() if x is not None or name not in OfProblem.__annotations__}
    refuse_unknown(function, own, group)
    if not isinstance(system, Problem):
        return problem_with(system, {**defaults, **keywords})
    found, known = {**system.given, **keywords}, group.__annotations__.keys()
    found = {name: value for name, value in found.items() if name in known or value is not None}
    for name in found.keys() - known:
        if name not in aside:
            raise ValueError(f"{function} does not take {name}; problem.replace({name}=None) is without")
    return problem_with(system.system, {**defaults, **found}) if keywords or defaults else system
