"""The table ``[sweep]``: which numbers of the file vary from member to member, and how.

A grid or a list is an axis of a product. All else is drawn, and every drawing is a map from the unit cube: uniform by
scaling, normal by its quantile function, a direction by Archimedes (height and longitude), a rotation by Shoemake's
three numbers (Graphics Gems III, 1992; the image of the uniform measure is Haar's). What fills the cube, random or
quasi-random, is then one choice for the whole sweep.

`KINDS` is the visible list: a new kind is one class and one line.
"""

from __future__ import annotations

import math
import re
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag

from ..analysis.statistics import STATISTICS
from ..analysis.variables import NODES, ROTORS, STATE
from ..geometry.arrays import Array
from ..geometry.values import guess
from ..integrators import INTEGRATORS, Integrator
from .section import Fault, OneOf, Positive, Section, by_shape, shown

if TYPE_CHECKING:
    from ..driver.prepared import Prepared

KEPT = (*NODES, *ROTORS)
MOST_KEYS, MOST_VALUES = 100, 10_000_000
NUMBERS = "a number, or a list of numbers of the form that the key has"


def _depth(value: Any) -> str:
    first = value[0] if isinstance(value, list) and value else None
    return "<numbers>" if not isinstance(first, list) else "<rows>" if not _nested(first) else "<matrices>"


def _nested(row: list[Any]) -> bool:
    return bool(row) and isinstance(row[0], list)


Numbers = Annotated[
    Annotated[float, Tag("<number>")] | Annotated[list[float], Tag("<values>")], Discriminator(by_shape)
]


class Over(Section):
    """What one key of the file goes over."""

    key: str = Field(
        description="a number of the file, or a list of numbers, as a dotted path in quotes: "
        '"start.angular_velocity.body", "body.axis.0", "load.0.scale"; entries of lists count from 0'
    )
    kind: str


class Listed(Over):
    """Values that all members share out: an axis of the product."""

    @abstractmethod
    def points(self) -> Array:
        """Return the values, (count, ...)."""

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of `points`."""
        shape: tuple[int, ...] = self.points().shape
        return shape


class Drawn(Over):
    """Values that each member draws: a map from the unit cube."""

    @property
    @abstractmethod
    def dimension(self) -> int:
        """How many numbers of the unit interval make a value."""

    @abstractmethod
    def values(self, u: Array) -> Array:
        """Return the values, (m, ...), of points `u`, (m, dimension), inside of the unit cube."""


class Grid(Listed):
    """Equidistant values."""

    kind: Literal["grid"]
    start: float = Field(description="a number: the first value")
    end: float = Field(description="a number: the last value")
    count: Annotated[int, Field(ge=1, le=MOST_VALUES)] = Field(
        description=f"a whole number >= 1 of values, both ends among them, at most {MOST_VALUES:.0e}"
    )
    spacing: Literal["linear", "log"] = Field(
        default="linear", description='"linear", or "log" for equal ratios between ends of one sign'
    )

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of `points`, which are not made for it."""
        return (self.count,)

    def points(self) -> Array:
        """Return the values."""
        if self.spacing == "log":
            return np.geomspace(self.start, self.end, self.count)
        return np.linspace(self.start, self.end, self.count)


class Values(Listed):
    """The values themselves."""

    kind: Literal["list"]
    values: Annotated[
        Annotated[list[float], Tag("<numbers>")]
        | Annotated[list[list[float]], Tag("<rows>")]
        | Annotated[list[list[list[float]]], Tag("<matrices>")],
        Discriminator(_depth),
    ] = Field(description="a list of numbers, or a list of lists of the form that the key has")

    def points(self) -> Array:
        """Return the values; a ValueError where they are not all of one form."""
        try:
            return np.array(self.values, dtype=np.float64)
        except ValueError as error:
            raise ValueError("its entries are of different lengths") from error


class Uniform(Drawn):
    """Uniform between two numbers, component by component."""

    kind: Literal["uniform"]
    low: Numbers = Field(description=f"{NUMBERS}: the lower end")
    high: Numbers = Field(description=f"{NUMBERS}: the upper end, not below low")

    @property
    def dimension(self) -> int:
        """One for each component."""
        return np.size(self.low)

    def values(self, u: Array) -> Array:
        """Return the values."""
        low, high = np.array(self.low), np.array(self.high)
        found: Array = low + (high - low) * u.reshape(len(u), *low.shape)
        return found


class Normal(Drawn):
    """Normal, component by component independent."""

    kind: Literal["normal"]
    mean: Numbers = Field(description=NUMBERS)
    deviation: Numbers = Field(description=f"{NUMBERS}, not negative: the standard deviation")

    @property
    def dimension(self) -> int:
        """One for each component."""
        return np.size(self.mean)

    def values(self, u: Array) -> Array:
        """Return the values."""
        from scipy.special import ndtri

        mean, deviation = np.array(self.mean), np.array(self.deviation)
        found: Array = mean + deviation * ndtri(u).reshape(len(u), *mean.shape)
        return found


class Sphere(Drawn):
    """Vectors of one length, their directions uniform on the sphere."""

    kind: Literal["sphere"]
    radius: Positive = Field(default=1.0, description="a positive number: the length of the vectors")
    dimension: ClassVar[int] = 2

    def values(self, u: Array) -> Array:
        """Return the vectors."""
        z, longitude = 2 * u[:, 0] - 1, 2 * math.pi * u[:, 1]
        across = np.sqrt((1 - z) * (1 + z))
        return self.radius * np.stack([across * np.cos(longitude), across * np.sin(longitude), z], axis=1)


class Attitudes(Drawn):
    """Rotations, uniform on SO(3)."""

    kind: Literal["rotation"]
    dimension: ClassVar[int] = 3

    def values(self, u: Array) -> Array:
        """Return unit quaternions, scalar last."""
        a, b = np.sqrt(1 - u[:, 0]), np.sqrt(u[:, 0])
        s, t = 2 * math.pi * u[:, 1], 2 * math.pi * u[:, 2]
        return np.stack([a * np.sin(s), a * np.cos(s), b * np.sin(t), b * np.cos(t)], axis=1)


KINDS: dict[str, type[Over]] = {
    "grid": Grid,
    "list": Values,
    "uniform": Uniform,
    "normal": Normal,
    "sphere": Sphere,
    "rotation": Attitudes,
}
AnyOver = Annotated[Over, OneOf(KINDS)]

if TYPE_CHECKING:
    from typing import TypeAlias

    Variable: TypeAlias = str
    Reduction: TypeAlias = str
else:
    Variable, Reduction = Literal[KEPT], Literal[STATISTICS]


class Sweep(Section):
    """Many runs of the file, each with numbers of its own; what is kept is the state at t_end."""

    over: Annotated[list[AnyOver], Field(min_length=1, max_length=MOST_KEYS)] = Field(
        description=f"tables [[sweep.over]], in double brackets, 1 to {MOST_KEYS}, each with a key and a kind"
    )
    combine: Literal["product", "together"] = Field(
        default="product",
        description='"product" of all grids and lists, the last one fastest, or "together": entry by entry',
    )
    samples: Annotated[int, Field(ge=1)] = Field(
        default=1, description="a whole number >= 1: members at each point of the grids and lists"
    )
    sampling: Literal["random", "sobol", "halton"] = Field(
        default="random", description='"random", or one of the quasi-random sequences "sobol", "halton"'
    )
    seed: Annotated[int, Field(ge=0)] = Field(default=0, description="a whole number >= 0")
    variables: list[Variable] = Field(
        default=[*STATE], description="a list of " + ", ".join(f'"{name}"' for name in KEPT) + ", kept at t_end"
    )
    reduce: list[Reduction] = Field(
        default=[], description="a list of " + ", ".join(f'"{name}"' for name in STATISTICS) + ", over all steps"
    )

    @property
    def axes(self) -> list[Listed]:
        """The grids and lists."""
        return [one for one in self.over if isinstance(one, Listed)]

    @property
    def drawn(self) -> list[Drawn]:
        """What is drawn."""
        return [one for one in self.over if isinstance(one, Drawn)]

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the axes of the product."""
        lengths = tuple(one.shape[0] for one in self.axes)
        return lengths[:1] if self.combine == "together" else lengths

    @property
    def members(self) -> int:
        """How many runs there are."""
        return math.prod(self.shape) * self.samples


# What a table `[sweep]` may not hold though each of its values is of the right form.
#
# `table_problems` looks at the table alone, `key_problems` at the file that it varies: whether its keys are numbers
# there, and whether the values have their form.


MOST_MEMBERS, MOST_SOBOL = 10**11, 2**32
MOST_WORDS = 100  # keys that a misspelt one is compared with, and that are named
EXCLUDED = (
    "title",
    "output",
    "sweep",
    "event",
    "time.store",
    "time.times",
)  # no numbers of the motion, which cannot be swept
Tables = dict[str, Any]


def table_problems(sweep: Sweep) -> Iterator[Fault]:
    """Yield what is wrong with the table by itself."""
    valid = True
    for k, one in enumerate(sweep.over):
        for problem in _values(f"sweep.over.{k}", one):
            valid = False
            yield problem
        for other in sweep.over[:k]:
            if _within(one.key, other.key) or _within(other.key, one.key):
                given = f"{shown(one.key)}, beside {shown(other.key)}"
                yield Fault(f"sweep.over.{k}.key", given, "each number once")
    if sweep.samples > 1 and not sweep.drawn:
        yield Fault("sweep.samples", f"{sweep.samples} (nothing is drawn)", "left out, or a key that is drawn")
    if not valid:
        return
    lengths = [one.shape[0] for one in sweep.axes]
    if sweep.combine == "together" and len(set(lengths)) > 1:
        given = f'"together" ({", ".join(map(str, lengths))} values)'
        yield Fault("sweep.combine", given, 'grids and lists of one length; or "product"')
    most = MOST_SOBOL if sweep.sampling == "sobol" and sweep.drawn else MOST_MEMBERS
    if sweep.members > most:
        yield Fault("sweep", f"{min(sweep.members, 10**300):.3g} members", f"at most {most:.3g}")


def _within(key: str, outer: str) -> bool:
    return key == outer or key.startswith(f"{outer}.")


def _values(at: str, one: Any) -> Iterator[Fault]:
    fields = type(one).model_fields
    if isinstance(one, Grid) and one.spacing == "log" and not one.start * one.end > 0:
        yield Fault(f"{at}.start", f'{shown(one.start)} to {shown(one.end)}, spacing = "log"', "ends of one sign")
    if isinstance(one, Values):
        try:
            if not one.points().size:
                yield Fault(f"{at}.values", "an empty list", f"{fields['values'].description}")
        except ValueError as error:
            yield Fault(f"{at}.values", f"{shown(one.values)} ({error})", f"{fields['values'].description}")
    pairs: dict[type, tuple[str, str]] = {Uniform: ("low", "high"), Normal: ("mean", "deviation")}
    if type(one) in pairs:
        first, second = pairs[type(one)]
        a, b = np.array(getattr(one, first)), np.array(getattr(one, second))
        given = f"{shown(getattr(one, second))} ({first} = {shown(getattr(one, first))})"
        if a.shape != b.shape:
            yield Fault(f"{at}.{second}", given, f"of the same form as {first}")
        elif (b < (a if isinstance(one, Uniform) else 0)).any():
            yield Fault(f"{at}.{second}", given, f"{fields[second].description}")


def key_problems(sweep: Sweep, data: Tables, prepared: Prepared | None) -> Iterator[Fault]:
    """Yield what does not fit the rest of the file, which is in order.

    Parameters
    ----------
    sweep : Sweep
    data : dict
        The file with all defaults, as plain data.
    prepared : Prepared or None
        The run of the file without its sweep, if there is one.
    """
    known = numeric_keys(data)
    outer = [key for key in known if not any(key[: dot.start()] in known for dot in re.finditer(r"\.", key))]
    for k, one in enumerate(sweep.over):
        at, shape = f"sweep.over.{k}", _shape(one)
        if one.key == "start.rotation" or isinstance(one, Attitudes):
            if not (one.key == "start.rotation" and isinstance(one, Attitudes)):
                given = f"{shown(one.key)}, kind = {shown(one.kind)}"
                yield Fault(f"{at}.key", given, 'key = "start.rotation" and kind = "rotation" go together')
        elif one.key not in known:
            more = ", ..." if len(outer) > MOST_WORDS else ""
            words = ", ".join(["start.rotation", *outer[:MOST_WORDS]]) + more
            near = guess(one.key, islice(known, MOST_WORDS))
            accepted = f"{near}known are {words}, and entries of these, as in body.axis.0"
            yield Fault(f"{at}.key", shown(one.key), accepted)
        elif known[one.key] != shape:
            form = f"{_form(shape)} (the key holds {_form(known[one.key])})"
            yield Fault(f"{at}.kind", f"{shown(one.kind)}: {form}", "values of the form that the key has")
    integrator = INTEGRATORS[data["integrator"]["name"]]
    yield from step_problems(data["time"].get("step"), integrator, prepared)
    curved = [k for k, load in enumerate(data.get("load") or ()) if _is_curved(load)]
    if sweep.reduce and curved:
        accepted = f"no reductions with load.{curved[0]}, a potential that is not linear: leave reduce out"
        yield Fault("sweep.reduce", shown(sweep.reduce), accepted)
    if sweep.reduce and any(load["kind"] == "dry_friction" for load in data.get("load") or ()):
        yield Fault("sweep.reduce", shown(sweep.reduce), "no reductions under dry_friction: leave reduce out")
    if sweep.reduce and integrator.any_times:
        yield Fault("sweep.reduce", shown(sweep.reduce), f"left out: {integrator.name} takes no steps to reduce over")


def step_problems(step: float | None, integrator: type[Integrator], prepared: Prepared | None) -> Iterator[Fault]:
    """Yield that a step is missing, which all members take, with one that suits the run without the sweep."""
    if step is not None or integrator.any_times:
        return
    accepted = "a step, s, which all members take"
    with suppress(ValueError):  # too many steps
        if prepared is not None:
            prepared = prepared.on_grid  # members store the states at their steps
            order = getattr(prepared.scheme, "order", None)
            at = f" with integrator.order = {order}" if order else ""
            accepted += f"; {_suggested_step(prepared):.12g}{at} suits the file without [sweep], and "
            accepted += "nontwist precision FILE --target 1e-8 finds one that has this error"
    yield Fault("time.step", "missing", accepted)


def _suggested_step(prepared: Prepared) -> float:
    """Return a step that divides the span, no longer than those of the run, if possible with one digit."""
    span, longest = prepared.plan.t_end - prepared.plan.t_start, prepared.grid.longest
    power = 10.0 ** math.floor(math.log10(longest))
    for step in (5 * power, 2 * power, power, power / 2, power / 5, power / 10):
        if step <= longest and math.isclose(span / step, round(span / step), rel_tol=1e-12):
            return step
    return span / math.ceil(span / longest)


def _is_curved(load: dict[str, Any]) -> bool:
    """Whether a load is a potential that is not linear."""
    kind = load["kind"]
    if kind == "spring":
        return bool(load["rest_length"])
    return kind == "gravity_gradient" or (kind == "potential" and bool(np.any(load["quadratic"])))


def _shape(one: Any) -> tuple[int, ...]:
    if isinstance(one, Drawn):
        return (3,) if isinstance(one, Sphere) else np.shape(getattr(one, "low", getattr(one, "mean", ())))
    shape: tuple[int, ...] = one.shape[1:]
    return shape


def _form(shape: tuple[int, ...]) -> str:
    return f"{' × '.join(map(str, shape))} numbers" if shape else "a number"


def numeric_keys(data: Any, at: str = "") -> dict[str, tuple[int, ...]]:
    """Return the dotted paths of all numbers in plain data, and of all arrays of numbers, with their shapes."""
    found: dict[str, tuple[int, ...]] = {}
    if at in EXCLUDED or isinstance(data, (bool, str)):
        return found
    if isinstance(data, (int, float)):
        return {at: ()}
    entries = data.items() if isinstance(data, dict) else enumerate(data)
    if isinstance(data, list) and (shape := _regular(data)) is not None:
        found[at] = shape
    for key, value in entries:
        found |= numeric_keys(value, f"{at}.{key}" if at else str(key))
    return found


def _regular(data: list[Any]) -> tuple[int, ...] | None:
    """Return the shape of a list of numbers, or of lists of them, that is an array; None where it is none."""
    try:
        array = np.array(data)
    except ValueError:
        return None
    return array.shape if array.dtype.kind in "if" and array.size else None
