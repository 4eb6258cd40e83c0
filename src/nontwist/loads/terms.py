"""The terms of loads, as values: equal where they say the same, and made of data, or of a function.

A term is a frozen dataclass. Each of its fields is declared once, by a type and a `Spec`: what it means, its unit, its
shape. From these follow the check of arguments, the record in every run and the way back, the key of a run file, the
words of the viewer, and the derivatives of a run by the numbers of the field. What the term does is one text.
"""

from __future__ import annotations

import re
from abc import ABC
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, fields
from itertools import product
from math import inf, prod
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, increasing
from ..geometry.values import short_repr, vector_text
from ..kernels.dual import Dual, plain
from ..kernels.elements import select, sin
from ..machine import cached_property
from ..spec import Spec, as_specified, specs
from ..units import in_datasets
from .functions import Call, array, checked, name_of, slopes_function, state, term_function

if TYPE_CHECKING:
    from .load import Load

XYZ, BODY = ("x", "y", "z"), ("1", "2", "3")
MOST_NUMBERS = 24  # of a term whose text of the state is differentiated by them
LONGEST = 60  # characters of a function's name in words
FRAME = '"body" (components along the moving directors) or "space" (along fixed axes)'
Kind = Literal["body", "space", "state", "forces", "potential", "memory"]
# Texts, and their kinds.
TEXTS: dict[str, Kind] = {"moment": "state", "body_moment": "body", "space_moment": "space", "response": "memory"}
Frame = Annotated[Literal["body", "space"], Spec(FRAME)]
Moment = Callable[[float, Array, Array], ArrayLike]
Record = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Term(ABC):
    """Base class of all terms of loads: a frozen dataclass whose own fields are recorded in a run.

    A subclass has one text: ``moment(t, directors, angular_velocity)``, the spatial moment, or ``body_moment(t)`` or
    ``space_moment(t)``, its components along the directors or fixed axes. Terms that are forces on the directors are
    subclasses of `nontwist.loads.DirectorForces`, and potentials of `nontwist.loads.Potential`. Terms can be added, and
    multiplied by numbers, and are loads by themselves.

    Parameters
    ----------
    scale : float
        The factor. Multiplying a load multiplies it.
    breakpoints : tuple of float, s
        Times at which the term or a derivative of it jumps: nodes of the time grid.
    resolution : float, s
        The longest step that resolves the term.
    compiled : bool
        Whether a text of the state is compiled.

    Raises
    ------
    ValueError
        A field is not as its `Spec` says, or the class has no text.
    """

    is_linear = False  # between its breakpoints, in time
    counts: ClassVar[tuple[int, int]] = (9, 3)  # numbers of the state that a text gets, before the time
    in_kernels: ClassVar[bool] = False  # whether the kernels know it, so that no text is called while a run marches
    # Of a moment that is a text of many times at once: its components at (n,) times, one after the other.
    columns: ClassVar[Any] = None
    gives: ClassVar[tuple[int, ...]] = (3,)  # the shape of what a text of the state gives
    _: KW_ONLY
    scale: float = 1.0
    breakpoints: tuple[float, ...] = ()
    resolution: float = inf
    compiled: bool = True

    def __post_init__(self) -> None:
        for name in specs(type(self)):
            self._set(**{name: as_specified(self, name)})
        _ = self.kind

    @property
    def kind(self) -> Kind:
        """What the text gives, and of what."""
        if found := [kind for name, kind in TEXTS.items() if hasattr(self, name)]:
            return found[0]
        raise ValueError(f"{type(self).__name__} has no text: give it a method {' or '.join(TEXTS)}")

    @property
    def load(self) -> Load:
        """The term as a load."""
        from .load import Load

        return Load((self,))

    def __add__(self, other: Any) -> Load:
        return self.load + other

    def __sub__(self, other: Any) -> Load:
        return self.load - other

    def __mul__(self, factor: float) -> Load:
        return self.load * factor

    __rmul__ = __mul__

    def __truediv__(self, divisor: float) -> Load:
        return self.load / divisor

    def __neg__(self) -> Load:
        return -self.load

    # ---- its record

    @classmethod
    def words(cls, record: Record) -> str:
        """Describe the record of a term, its `description`, in words."""
        name = re.sub("(?<=[a-z])(?=[A-Z])", " ", cls.__name__).lower()
        return f"{factor_in_words(record)}{name}: {', '.join(cls._said(record))}"

    @classmethod
    def _said(cls, record: Record) -> Iterator[str]:
        for name, (_, _, spec) in specs(cls).items():
            value = record[name]
            plain = value if isinstance(value, str) else vector_text(value) if len(np.shape(value)) == 1 else ""
            yield f"{name} {plain or short_repr(value)} {spec.unit}".strip()

    @classmethod
    def sample(cls) -> Self | None:
        """Return a term that `nontwist validate` checks the balance of energy with; None, by default: no check."""
        return None

    @property
    def description(self) -> dict[str, Any]:
        """The record of the term: kind, factor and own fields as plain data; of a function its name."""
        own = [name for name in own_fields(type(self)) if getattr(self, name) is not None]
        return {name: _as_data(getattr(self, name)) for name in ("kind", "scale", *own)}

    @classmethod
    def of_record(cls, record: Record) -> Self:
        """Return the term of a record, without its factor."""
        given = {"frame": record["kind"]} | dict(record) if issubclass(cls, OfTime) else record
        return cls(**{name: given[name] for name in specs(cls) if name in given})

    # ---- when it acts, and what it does then

    @cached_property
    def support(self) -> Array:
        """Disjoint intervals of time outside which the term is known to be zero, (k, 2), s, sorted."""
        return np.array([[-inf, inf]])

    @property
    def called(self) -> Callable[..., Any]:
        """The text: a function of time, or of time, directors and angular velocity."""
        texts = TEXTS | {"forces": "forces", "potential": "potential"}
        return getattr(self, next(name for name, kind in texts.items() if kind == self.kind))

    def samples(self, times: Array) -> Array:
        """Return the components of a moment of time at (n,) times, (n, 3), without the factor."""
        if self.columns is not None:
            return np.stack(self.columns(times), axis=1)
        return np.array([checked(self.called, (float(t),), (3,)) for t in times]).reshape(len(times), 3)

    def text(self, call: Call, x: Sequence[Any]) -> list[Any]:
        """Return what a text gives, row by row, by a way to call functions (`functions`).

        `x` are directors, angular velocity and time, or the time alone, and the `numbers` of the term behind them.
        """
        count = 1 if self.kind in ("body", "space") else 13
        return call(self.with_numbers(x[count:]).called, tuple(x[:1]) if count == 1 else state(x), self.gives)

    def moment_at(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the spatial moment of a term that depends on the state, (3,), N m, without the factor, in Python."""
        x = [*directors.ravel().tolist(), *angular_velocity.tolist(), t]
        return np.array(self.text(checked, x)).reshape(self.gives)

    # ---- its parameters

    @property
    def varying(self) -> list[str]:
        """The names of the fields that are parameters of derivatives."""
        free = ((name, kind, spec) for name, (kind, _, spec) in specs(type(self)).items() if not spec.is_fixed)
        known = [name for name, kind, spec in free if kind is float or spec.shape]
        if self.in_kernels or self.kind in ("body", "space"):
            return known
        counts = np.cumsum([np.size(getattr(self, name)) for name in known])
        return [name for name, count in zip(known, counts, strict=True) if count <= MOST_NUMBERS]

    @property
    def numbers(self) -> list[float]:
        """The numbers of these fields, one behind the other."""
        return [x for name in self.varying for x in np.ravel(getattr(self, name)).tolist()]

    def with_numbers(self, numbers: Sequence[Any]) -> Self:
        """Return a copy whose parameters hold these numbers, of any kind, for its text; itself without any."""
        if not len(numbers):
            return self
        first, values = 0, dict[str, Any]()
        for name in self.varying:
            shape = np.shape(getattr(self, name))
            own = numbers[first : first + prod(shape)]
            values[name], first = array(own, *shape) if shape else own[0], first + prod(shape)
        return self._copy(**values)

    def seeded(self, name: str) -> Self:
        """Return a copy with the numbers of a field as duals, for its text; of texts of many times at once as rows."""
        value = getattr(self, name)
        rows = np.reshape(value, (-1, 1)) if self.columns is not None else np.ravel(value).tolist()
        duals = [Dual(x, [float(i == j) for j in range(len(rows))]) for i, x in enumerate(rows)]
        return self._copy(**{name: array(duals, *value.shape) if np.ndim(value) else duals[0]})

    @property
    def derivative(self) -> Callable[..., Any] | None:
        """The derivatives of a moment of the state, as `nontwist.moment` takes them; None: those of the text."""
        return None

    @cached_property
    def c_function(self) -> Any:
        """The text of the state as a C function, on demand; None if it runs in Python."""
        return term_function(self) if self.compiled else None

    @cached_property
    def slopes(self) -> Any:
        """A C function that differentiates the text as well; None: its derivatives are others."""
        return slopes_function(self) if self.compiled and self.derivative is None else None

    # ---- as a value

    def _copy(self, **changes: Any) -> Self:
        term = object.__new__(type(self))
        vars(term).update(vars(self), **changes)
        return term

    def _set(self, **values: Any) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def scaled(self, factor: float) -> Self:
        """Return the term times `factor`; its compiled function is reused."""
        return self._copy(scale=factor * self.scale)

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
    """A term that acts by forces on the directors."""

    gives = (3, 3)

    def forces_at(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the forces in space, (3, 3), the row i on the director i, N m, without the factor, in Python."""
        return super().moment_at(t, directors, angular_velocity)

    def moment_at(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return their moment ``Σ d_i × f^i``, (3,), N m, without the factor."""
        return np.cross(directors, self.forces_at(t, directors, angular_velocity)).sum(axis=0)


class Tabulated(Term):
    """A term that is linear between its times and zero outside."""

    times: Array
    values: Any

    def __post_init__(self) -> None:
        super().__post_init__()
        self._set(**smoothness(self.times))

    @cached_property
    def support(self) -> Array:
        """Between times at one of which a value is not zero."""
        return nonzero_intervals(self.times, self.values)

    def columns(self, times: Any) -> list[Any]:
        """Return the interpolated numbers, one after the other."""
        return within(self.times, self.values.reshape(len(self.times), -1), times)


class OfTime(Term):
    """A moment of time, along the directors or fixed axes as its field `frame` says."""

    frame: Any
    kind = property(lambda self: self.frame)


@dataclass(frozen=True, eq=False)
class Pulse(OfTime):
    """A moment of fixed direction that lasts from start to end."""

    frame: Frame
    pulse: Annotated[Array, Spec("the peak", option="amplitude", unit="N m", shape=(3,))]
    start: Annotated[float, Spec("", unit="s", is_fixed=True)] = 0.0
    end: Annotated[float, Spec("after start", unit="s", is_fixed=True)] = field(kw_only=True)
    shape: Annotated[Literal["triangle", "rectangle", "half-sine"], Spec("")] = "triangle"

    def __post_init__(self) -> None:
        super().__post_init__()
        a, b = self.start, self.end
        if not a < b:
            raise ValueError(f"pulse must end after it starts, got start = {a:g} s, end = {b:g} s")
        kinks = (a, *(a + s * (b - a) for s in PULSES[self.shape][1]), b)
        self._set(breakpoints=kinks, resolution=(b - a) / 20)

    @property
    def is_linear(self) -> bool:  # type: ignore[override]
        """Whether it is, between its breakpoints."""
        return self.shape != "half-sine"

    @cached_property
    def support(self) -> Array:
        """From its start to its end."""
        return np.array([[self.start, self.end]])

    def columns(self, times: Any) -> Any:
        """Return the profile times the peak."""
        s = (times - self.start) / (self.end - self.start)
        profile = select((times >= self.start) & (times < self.end), PULSES[self.shape][0](s), 0.0)
        return [x * profile for x in self.pulse]

    @classmethod
    def words(cls, record: Record) -> str:
        """Return shape, peak and span."""
        peak, start, end = _peak(record, "pulse"), record["start"], record["end"]
        if start > -EVER and end < EVER:
            return f"{record['shape']} pulse {peak}, from {start:.6g} to {end:.6g} s"
        span = [f"from {start:.6g} s on"] * (start > -EVER) + [f"until {end:.6g} s"] * (end < EVER)
        return ", ".join([f"constant {peak}", *span])


EVER = 1e60  # s: a pulse from -EVER to EVER is a constant moment
PULSES: dict[str, tuple[Callable[[Any], Any], tuple[float, ...]]] = {
    "triangle": (lambda s: 1 - abs(2 * s - 1), (0.5,)),
    "rectangle": (lambda s: 0.0 * s + 1.0, ()),
    "half-sine": (lambda s: sin(np.pi * s), ()),
}


@dataclass(frozen=True, eq=False)
class Sine(OfTime):
    """The moment amplitude sin(2π frequency t + phase)."""

    frame: Frame
    sine: Annotated[Array, Spec("the peak", option="amplitude", unit="N m", shape=(3,))]
    frequency: Annotated[float, Spec("", unit="Hz", rule="positive")]
    phase: Annotated[float, Spec("", unit="rad")] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._set(resolution=1 / (20 * self.frequency))

    def columns(self, times: Any) -> Any:
        """Return the wave times the peak."""
        wave = sin(self.phase + 2 * np.pi * self.frequency * times)
        return [x * wave for x in self.sine]

    @classmethod
    def words(cls, record: Record) -> str:
        """Return peak, frequency and phase."""
        phase = f", phase {record['phase']:.6g} rad" if record["phase"] else ""
        return f"sine {_peak(record, 'sine')}, {record['frequency']:.6g} Hz{phase}"


@dataclass(frozen=True, eq=False)
class Table(Tabulated, OfTime):
    """A table, linear between its times and zero outside."""

    frame: Frame
    times: Annotated[Array, Spec("", unit="s", shape=(None,), rule="increasing", is_fixed=True)]
    values: Annotated[Array, Spec("one for each time", unit="N m", shape=("times", 3))]
    is_linear = True

    @classmethod
    def words(cls, record: Record) -> str:
        """Return how long the table is, and its largest moment."""
        most = abs(record["scale"]) * np.linalg.norm(record["values"], axis=1).max()
        return f"table of {len(record['times'])} moments of up to {most:.4g} N m {along(record['kind'])}"


@dataclass(frozen=True, eq=False)
class Function(OfTime):
    """What a function of Python gives: of time, or of time, directors and angular velocity."""

    frame: str
    function: Callable[..., Any]
    derivative: Callable[..., Any] | None = None  # by directors and angular velocity

    @property
    def called(self) -> Callable[..., Any]:
        """The function."""
        return self.function

    @classmethod
    def words(cls, record: Record) -> str:
        """Return factor and name."""
        return function_in_words(record, f"function {record['function']}", record["kind"])


@dataclass(frozen=True, eq=False)
class Damping(Term):
    """Viscous damping ``-Λ C Λᵀ w``, which the kernels know: it is not called while a run marches."""

    in_kernels = True
    damping: Annotated[Array, Spec("C", unit="N m s", shape=(3, 3))]

    def moment(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the moment."""
        return -(self.damping @ (directors @ angular_velocity)) @ directors

    @classmethod
    def words(cls, record: Record) -> str:
        """Return the coefficient of isotropic damping."""
        C = record["scale"] * np.array(record["damping"])
        isotropic = np.array_equal(C, C[0, 0] * np.eye(3))
        return f"damping {C[0, 0]:.6g} N m s" if isotropic else "damping by a matrix"


class Momentum(Term):
    """A momentum h n along an axis of the body, which the kernels know: it is not called as they march.

    On the body it acts with the moment ``-(h Λn)' = Λ (h n × W - h' n)``.
    """

    in_kernels = True
    is_linear = True
    direction: Any  # the axis n, (3,)

    def history(self, times: Array) -> tuple[Array, Array]:
        """Return h and h' at (n,) times, without the factor."""
        raise NotImplementedError

    def momentum(self, times: Array) -> Array:
        """Return h n at (n,) times, (n, 3), without the factor."""
        return self.history(times)[0][:, None] * self.direction

    def moment(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the moment."""
        (h,), (rate,) = self.history(np.array([t]))
        return (h * np.cross(self.direction, directors @ angular_velocity) - rate * self.direction) @ directors


@dataclass(frozen=True, eq=False)
class Rotor(Momentum):
    """A symmetric rotor that turns about an axis of the body.

    ``h a`` is its momentum relative to the body, h piecewise linear between `times` and constant outside.
    """

    rotor: Annotated[Array, Spec("", option="axis of the rotor", shape=(3,), rule="direction in the body")]
    times: Annotated[Array, Spec("", unit="s", shape=(None,), is_fixed=True)]
    values: Annotated[Array, Spec("h", unit="kg m² s⁻¹", shape=("times",))]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.times.size > 1:
            self._set(breakpoints=smoothness(self.times)["breakpoints"])

    @property
    def direction(self) -> Array:
        """The axis a."""
        return self.rotor

    def history(self, times: Array) -> tuple[Array, Array]:
        """Return h and h' at (n,) times, without the factor."""
        return np.interp(times, self.times, self.values), chord(self.times, self.values, times)

    @classmethod
    def words(cls, record: Record) -> str:
        """Return the momentum and the axis."""
        h, about = record["scale"] * np.array(record["values"]), f"about {vector_text(record['rotor'])}"
        if len(h) == 1:
            return f"rotor of {h[0]:.6g} kg m² s⁻¹ {about}"
        return f"rotor {about}, table of {len(h)} momenta from {h.min():.4g} to {h.max():.4g} kg m² s⁻¹"


# ---- tables


def smoothness(times: Array) -> dict[str, Any]:
    """Return where a table has kinks, and how close they are; a ValueError where times do not increase."""
    return {"breakpoints": tuple(times.tolist()), "resolution": increasing(times, jumps=True)}


def within(known: Array, values: Array, times: Any) -> list[Any]:
    """Return columns of values that are linear between `known` times, and 0 outside; of times with derivatives too."""
    t = plain(times)
    inside = (t >= known[0]) & (t < known[-1])
    found = [np.where(inside, np.interp(t, known, column), 0.0) for column in values.T]
    if t is times:
        return found
    return [times.chain(y, (chord(known, column, t),), (times,)) for y, column in zip(found, values.T, strict=True)]


def chord(known: Array, values: Array, times: Array) -> Array:
    """Return the slope of a table at times: 0 outside."""
    if len(known) == 1:
        return np.zeros(len(times))
    k = np.clip(np.searchsorted(known, times, side="right") - 1, 0, len(known) - 2)
    inside = (times >= known[0]) & (times < known[-1])
    return np.where(inside, np.diff(values)[k] / np.diff(known)[k], 0.0)


def nonzero_intervals(times: Array, values: Array) -> Array:
    """Return where values that are linear between `times`, and 0 outside, are not zero: from when to when, (k, 2)."""
    rows = np.asarray(values.reshape(len(times), -1).any(axis=1))
    change = np.diff(np.concatenate([[False], rows[1:] | rows[:-1], [False]]).astype(np.int64))
    return np.stack([times[change == 1], times[change == -1]], axis=1)


# ---- fields and records


def own_fields(cls: type[Term]) -> list[str]:
    """Return the names of the fields that other terms lack; the first is that by which a record is recognised."""
    common = [one.name for one in fields(Term)] + ["frame"] * issubclass(cls, OfTime)
    return [one.name for one in fields(cls) if one.name not in common]


def labels_of(shape: tuple[int | str | None, ...], size: int, axes: Sequence[str]) -> list[str]:
    """Return a label for each number of a field: of tables the place of the time, from 0, then those of components."""
    if shape and isinstance(shape[0], str):
        inner = labels_of(shape[1:], 1, axes)
        return [f"{k},{one}" if one else str(k) for k in range(size) for one in inner]
    places = [[str(k + 1) for k in range(int(n or 0))] for n in shape]
    if shape and shape[-1] == 3:
        places[-1] = list(axes)
    return ["".join(one) for one in product(*places)]


def parameters_of(term: Term) -> dict[str, tuple[list[str], str]]:
    """Return the parameters of a term: a label for each number, and their unit."""
    found: dict[str, tuple[list[str], str]] = {"scale": ([""], "1")}
    for name in term.varying:
        _, _, spec = specs(type(term))[name]
        size = len(getattr(term, name)) if spec.shape else 1
        if spec.rule == "symmetric":
            labels = ["11", "22", "33", "23", "13", "12"]
        else:
            labels = labels_of(spec.shape, size, XYZ if "space" in (term.kind, getattr(term, "frame", "")) else BODY)
        found["values" if name == "forces_of" else name] = labels, in_datasets(spec.unit) or "1"
    return found


def _as_data(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else name_of(value) if callable(value) else value


def along(frame: Any) -> str:
    """Return in words what components are along."""
    return {"body": "along the directors", "space": "along fixed axes"}.get(str(frame), "")


def factor_in_words(record: Record) -> str:
    """Return the factor of a term, if it has one, and a cross."""
    return "" if record["scale"] == 1 else f"{record['scale']:.6g} × "


def function_in_words(record: Record, name: str, frame: Any = None) -> str:
    """Return in words a term that is a function: its factor, its name, and what its components are along."""
    return f"{factor_in_words(record)}{name[:LONGEST]} {along(frame)}".strip()


def _peak(record: Record, name: str) -> str:
    return f"{vector_text(record[name], record['scale'])} N m {along(record['kind'])}"
