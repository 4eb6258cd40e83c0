"""The terms of loads, as values: equal where they say the same, and made of data, or of a function.

A term is a frozen dataclass. Its own fields, as plain data, are its record in every run, and `words` tells such a
record in words, without the term. `kinds.TERMS` is the visible list, by the first of these fields: a new kind of term
is one class and one line.
"""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, fields
from functools import cached_property
from math import inf
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_floats
from ..geometry.values import shown, vector_text

REMEDY = "let it return 3 finite numbers (N m) at every time and state, or try a smaller step"
LONGEST = 60  # characters of a function's name in words
Kind = Literal["body", "space", "state", "forces", "potential"]
Moment = Callable[[float, Array, Array], ArrayLike]
Record = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Term(ABC):
    """Base class of all terms of loads: a frozen dataclass whose own fields are recorded in a run.

    A term of kind "body" or "space" has a method ``samples(times)`` that returns its components, (n, 3), without the
    factor; one of kind "state" has a method or property `function` of time, directors and angular velocity, which
    returns the spatial moment. Terms of kind "forces" are subclasses of `nontwist.loads.forces.DirectorForces`.

    Parameters
    ----------
    kind : str
        "body", "space", "state", "forces" or "potential".
    scale : float
        The factor. Multiplying a load multiplies it.
    breakpoints : tuple of float, s
        Times at which the term or a derivative of it jumps: nodes of the time grid.
    resolution : float, s
        The longest step that resolves the term.
    compile : bool
        Whether `function` is compiled, of terms of kind "state".

    Raises
    ------
    ValueError
        The kind is unknown, or is not one of this class, or the class lacks the method of its kind.
    """

    kinds: ClassVar[tuple[Kind, ...]] = ("body", "space", "state")  # that the class can have
    is_linear = False  # between its breakpoints, in time

    kind: Kind
    _: KW_ONLY
    scale: float = 1.0
    breakpoints: tuple[float, ...] = ()
    resolution: float = inf
    compile: bool = False

    def __post_init__(self) -> None:
        if self.kind not in (kinds := get_args(Kind)):
            raise ValueError(f"kind of a term must be one of {', '.join(kinds)}, got {shown(self.kind)}")
        if self.kind not in self.kinds:
            known = ", ".join(map(repr, self.kinds))
            raise ValueError(
                f"{type(self).__name__} cannot be a term of kind {self.kind!r}, only {known}: "
                "director forces are subclasses of nontwist.loads.forces.DirectorForces, and nontwist.potential "
                "makes potentials"
            )
        needed = {"body": "samples", "space": "samples", "state": "function"}.get(self.kind)
        if needed is not None and not (needed in vars(self) or hasattr(type(self), needed)):
            raise ValueError(f"a term of kind {self.kind!r} needs {needed}, which {type(self).__name__} lacks")

    if TYPE_CHECKING:

        def samples(self, times: Array) -> Array:
            """Return the components at (n,) times, (n, 3), without the factor."""

        @property
        def function(self) -> Callable[..., Any]:
            """The function of time, directors and angular velocity that returns the spatial moment, N m."""

    @staticmethod
    @abstractmethod
    def words(record: Record) -> str:
        """Describe the record of a term, its `description`, in words."""

    @classmethod
    def sample(cls) -> Self | None:
        """Return a term that `nontwist validate` checks the balance of energy with; None, by default: no check."""
        return None

    @property
    def derivative(self) -> Callable[..., Any] | None:
        """The derivatives of `function`, as `nontwist.moment` takes them; None: they are central differences."""
        return None

    @property
    def description(self) -> dict[str, Any]:
        """The record of the term: kind, factor and own fields as plain data; of a function its name."""
        own = [name for name in own_fields(type(self)) if getattr(self, name) is not None]
        return {name: _plain(getattr(self, name)) for name in ("kind", "scale", *own)}

    @cached_property
    def acting(self) -> Array:
        """Disjoint intervals of time outside which the term is known to be zero, (k, 2), s, sorted."""
        return np.array([[-inf, inf]])

    @cached_property
    def traceable(self) -> Any:
        """The function as a text that can be compiled and differentiated (`compiled`); None if it runs in Python."""
        from .compiled import moment_of

        function = getattr(self, "function", None)
        if not self.compile or function is None or self._is_c:
            return None
        key = next(iter(own_fields(type(self))), "function")
        return moment_of(function, getattr(function, "__name__", repr(function)) if key == "function" else repr(key))

    @cached_property
    def compiled(self) -> Any:
        """The function as a C function, on demand; None if it runs in Python."""
        return self.traceable.compiled if self.traceable else self.function if self.compile and self._is_c else None

    @cached_property
    def slopes(self) -> Any:
        """A C function that differentiates the function as well; None: its derivatives are others."""
        return self.traceable.slopes if self.traceable and self.derivative is None else None

    @property
    def _is_c(self) -> bool:
        from .c_functions import CFunction

        return isinstance(getattr(self, "function", None), CFunction)

    def moment(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the spatial moment of a term of kind "state", (3,), N m, without the factor, in Python."""
        function = getattr(self.function, "py_func", self.function) if self.compile else self.function
        return called(function, t, directors.copy(), angular_velocity.copy())

    def scaled(self, factor: float) -> Self:
        """Return the term times `factor`; its compiled function is reused."""
        term = object.__new__(type(self))
        vars(term).update(vars(self), scale=factor * self.scale)
        return term

    def __getstate__(self) -> dict[str, Any]:
        return {one.name: getattr(self, one.name) for one in fields(self)}  # without what is compiled

    def _key(self) -> tuple[Any, ...]:
        values = self.__getstate__().values()  # + 0.0: of -0.0 and 0.0 the bytes differ
        return type(self), *((value + 0.0).tobytes() if isinstance(value, np.ndarray) else value for value in values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Term) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())


class ForceTerm(Term):
    """A term that acts by forces on the directors; `forces` returns them in space, (3, 3) rows, without the factor."""

    @abstractmethod
    def forces(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the forces in space, (3, 3), the row i on the director i, N m, without the factor, in Python."""

    def moment(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return their moment ``Σ d_i × f^i``, (3,), N m, without the factor."""
        found: Array = np.cross(directors, self.forces(t, directors, angular_velocity)).sum(axis=0)
        return found


@dataclass(frozen=True, eq=False)
class Pulse(Term):
    """A moment of fixed direction that lasts from `start` to `end`."""

    pulse: Array
    start: float
    end: float
    shape: str

    @property
    def is_linear(self) -> bool:  # type: ignore[override]
        """Whether it is, between its breakpoints."""
        return self.shape != "half-sine"

    @cached_property
    def acting(self) -> Array:
        """From its start to its end."""
        return np.array([[self.start, self.end]])

    def samples(self, times: Array) -> Array:
        """Return the profile times the peak."""
        s = (times - self.start) / (self.end - self.start)
        return np.where((s >= 0) & (s < 1), PULSES[self.shape][0](s), 0.0)[:, None] * self.pulse

    @staticmethod
    def words(record: Record) -> str:
        """Return shape, peak and span."""
        return f"{record['shape']} pulse {_peak(record, 'pulse')}, from {record['start']:.6g} to {record['end']:.6g} s"


PULSES: dict[str, tuple[Callable[[Array], Array], tuple[float, ...]]] = {
    "triangle": (lambda s: 1 - abs(2 * s - 1), (0.5,)),
    "rectangle": (np.ones_like, ()),
    "half-sine": (lambda s: np.sin(np.pi * s), ()),
}


@dataclass(frozen=True, eq=False)
class Sine(Term):
    """The moment ``sine sin(2π frequency t + phase)``."""

    sine: Array
    frequency: float
    phase: float

    def samples(self, times: Array) -> Array:
        """Return the wave times the peak."""
        return np.sin(2 * np.pi * self.frequency * times + self.phase)[:, None] * self.sine

    @staticmethod
    def words(record: Record) -> str:
        """Return peak, frequency and phase."""
        phase = f", phase {record['phase']:.6g} rad" if record["phase"] else ""
        return f"sine {_peak(record, 'sine')}, {record['frequency']:.6g} Hz{phase}"


@dataclass(frozen=True, eq=False)
class Table(Term):
    """A moment that is piecewise linear between `times`, and 0 outside; `end_value` is the size of the last one."""

    times: Array
    values: Array
    end_value: float
    is_linear = True

    @cached_property
    def acting(self) -> Array:
        """Between times at one of which the moment is not zero."""
        return spans(self.times, self.values)

    def samples(self, times: Array) -> Array:
        """Return the interpolated moments."""
        return within(self.times, self.values, times)

    @staticmethod
    def words(record: Record) -> str:
        """Return how long the table is, and its largest moment."""
        most = abs(record["scale"]) * np.linalg.norm(record["values"], axis=1).max()
        return f"table of {len(record['times'])} moments of up to {most:.4g} N m {along(record['kind'])}"


@dataclass(frozen=True, eq=False)
class Function(Term):
    """What a function of Python gives: of time, or of time, directors and angular velocity."""

    function: Callable[..., Any]
    derivative: Callable[..., Any] | None = None  # of a moment of the state by directors and angular velocity

    def samples(self, times: Array) -> Array:
        """Return what the function gives, time by time."""
        return np.array([called(self.function, float(t)) for t in times]).reshape(-1, 3)

    @staticmethod
    def words(record: Record) -> str:
        """Return factor and name."""
        return function_in_words(record, f"function {record['function']}", record["kind"])


@dataclass(frozen=True, eq=False)
class Damping(Term):
    """Viscous damping ``-Λ C Λᵀ w``, which the kernels know: it is not called while a run marches."""

    damping: Array  # C, (3, 3)

    def function(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the moment."""
        return -(self.damping @ (directors @ angular_velocity)) @ directors

    @staticmethod
    def words(record: Record) -> str:
        """Return the coefficient of isotropic damping."""
        C = record["scale"] * np.array(record["damping"])
        isotropic = np.array_equal(C, C[0, 0] * np.eye(3))
        return f"damping {C[0, 0]:.6g} N m s" if isotropic else "damping by a matrix"


@dataclass(frozen=True, eq=False)
class Rotor(Term):
    """A symmetric rotor that turns about an axis of the body, which the kernels know: it is not called as they march.

    ``h a`` is its momentum relative to the body, h piecewise linear between `times` and constant outside; on the body
    it acts with the moment ``-(h Λa)' = Λ (h a × W - h' a)``.
    """

    rotor: Array  # a, (3,), a unit vector
    times: Array
    values: Array  # h
    is_linear = True

    def momentum(self, times: Array) -> Array:
        """Return h a at (n,) times, (n, 3), without the factor."""
        return np.interp(times, self.times, self.values)[:, None] * self.rotor

    def function(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the moment."""
        k = int(np.searchsorted(self.times, t, side="right"))
        inside = 0 < k < len(self.times)
        rate = (self.values[k] - self.values[k - 1]) / (self.times[k] - self.times[k - 1]) if inside else 0.0
        h = np.interp(t, self.times, self.values)
        return (h * np.cross(self.rotor, directors @ angular_velocity) - rate * self.rotor) @ directors

    @staticmethod
    def words(record: Record) -> str:
        """Return the momentum and the axis."""
        h, about = record["scale"] * np.array(record["values"]), f"about {vector_text(record['rotor'])}"
        if len(h) == 1:
            return f"rotor of {h[0]:.6g} kg m² s⁻¹ {about}"
        return f"rotor {about}, table of {len(h)} momenta from {h.min():.4g} to {h.max():.4g} kg m² s⁻¹"


def within(known: Array, values: Array, times: Array) -> Array:
    """Return values that are linear between `known` times, and 0 outside."""
    inside = (times >= known[0]) & (times < known[-1])
    columns = [np.interp(times, known, column) for column in values.T]
    return np.where(inside[:, None], np.stack(columns, axis=1), 0.0)


def spans(times: Array, values: Array) -> Array:
    """Return where values that are linear between `times`, and 0 outside, are not zero: from when to when, (k, 2)."""
    rows = np.any(values.reshape(len(times), -1) != 0, axis=1, keepdims=True)[:, 0]
    change = np.diff(np.concatenate([[False], rows[1:] | rows[:-1], [False]]).astype(np.int64))
    return np.stack([times[change == 1], times[change == -1]], axis=1)


def called(function: Callable[..., ArrayLike], t: float, *state: Array, shape: tuple[int, ...] = (3,)) -> Array:
    """Call a user's function at `t` and check what it returns."""
    remedy = REMEDY if shape == (3,) else REMEDY.replace("3 finite", "3 rows of 3 finite")
    given = "the time" + ", the directors and the angular velocity" * bool(state)
    return checked_value(function, "load", (t, *state), given, shape, lambda: f"t = {t:.12g} s", remedy)


def checked_value(
    function: Callable[..., ArrayLike],
    what: str,
    arguments: tuple[Any, ...],
    given: str,
    shape: tuple[int, ...],
    place: Callable[[], str],
    remedy: str,
) -> Array:
    """Call a user's function and check what it returns; messages say what is `given`, and at which `place`."""
    name = f"the {what} {getattr(function, '__name__', None) or repr(function)}"
    try:
        value = as_floats(function(*arguments), name)
    except Exception as error:
        if isinstance(error, TypeError) and not _takes(function, *arguments):
            remedy = f"it is called with {given}"
        raise ValueError(f"{name} raised {type(error).__name__} at {place()}: {error}; {remedy}") from error
    if value.shape != shape:
        numbers = {(): "a number", (3,): "3 numbers"}.get(shape) or f"{shape[0]} rows of 3 numbers"
        raise ValueError(f"{name} must return {numbers}, at {place()} it returned shape {value.shape}; {remedy}")
    if not np.isfinite(value).all():
        raise ValueError(f"{name} is not finite at {place()}: {value.tolist()}; {remedy}")
    return value


def _takes(function: Callable[..., Any], *arguments: Any) -> bool:
    """Return whether a function can be called with these arguments, as far as its signature says."""
    try:
        inspect.signature(function).bind(*arguments)
    except TypeError:
        return False
    except ValueError:  # without a signature
        pass
    return True


def name_of(function: Callable[..., Any]) -> str:
    """Return what a function is called, its module first."""
    return f"{getattr(function, '__module__', '?')}.{getattr(function, '__qualname__', repr(function))}"


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else name_of(value) if callable(value) else value


def along(frame: Any) -> str:
    """Return in words what components are along."""
    return {"body": "along the directors", "space": "along fixed axes"}.get(str(frame), "")


def function_in_words(record: Record, name: str, frame: Any = None) -> str:
    """Return in words a term that is a function: its factor, its name, and what its components are along."""
    factor = "" if record["scale"] == 1 else f"{record['scale']:.6g} × "
    return f"{factor}{name[:LONGEST]} {along(frame)}".strip()


def _peak(record: Record, name: str) -> str:
    return f"{vector_text(record[name], record['scale'])} N m {along(record['kind'])}"


def own_fields(cls: type[Term]) -> list[str]:
    """Return the names of the fields that other terms lack; the first is the key of the class in `TERMS`."""
    return [one.name for one in fields(cls) if one not in fields(Term)]


def unregistrable(name: str, cls: type[Term]) -> str | None:
    """Return why a class cannot be the entry `name` of `TERMS`, and what to do; None if it can."""
    if not (isinstance(cls, type) and issubclass(cls, Term)):
        return f"TERMS[{name!r}] must be a subclass of Term, got {shown(cls)}"
    own = own_fields(cls)
    if not own:
        return f"{cls.__name__} has no field of its own: add one, and @dataclass(frozen=True, eq=False) above the class"
    if name != own[0]:
        return f"TERMS[{name!r}] is the class {cls.__name__}, whose first field is {own[0]!r}: use this as the key"
    return None
