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
from collections import ChainMap
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import combinations, islice
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from ..analysis.statistics import STATISTICS
from ..analysis.variables import NODES, OBSERVABLES, ROTORS, STATE, WHEELS
from ..driver.grid import even_step
from ..driver.single_run import Prepared
from ..geometry.arrays import Array
from ..geometry.values import guess
from ..integrators import Integrator
from .files import Fault, shown
from .load_tables import LoadSection
from .section import BY_FORM, Faults, OneOf, Positive, Section, entry

KEPT = (*NODES, *ROTORS, *WHEELS)
MOST_KEYS, MOST_VALUES = 100, 10_000_000
NUMBERS = 'a number, or a list of numbers of the form that the key has (of matrices kind = "list")'
Numbers = Annotated[float | list[float], BY_FORM]


class Over(Section):
    """What one key of the file goes over."""

    key: str = entry(
        'a number of the file, or a list of numbers, as a dotted path in quotes: "start.angular_velocity.body", '
        '"body.axis.0", "load.0.scale"; entries of lists count from 0'
    )
    kind: str

    @property
    @abstractmethod
    def form(self) -> tuple[int, ...]:
        """The shape of a value; a ValueError where the values are of several forms, or none."""


class Listed(Over):
    """Values that all members share out: an axis of the product."""

    @abstractmethod
    def points(self) -> Array:
        """Return the values, (count, ...)."""

    @property
    def length(self) -> int:
        """How many values there are."""
        return len(self.points())


class Drawn(Over):
    """Values that each member draws: a map from the unit cube."""

    @property
    def dimension(self) -> int:
        """How many numbers of the unit interval make a value: one for each component."""
        return math.prod(self.form)

    @abstractmethod
    def values(self, u: Array) -> Array:
        """Return the values, (m, ...), of points `u`, (m, dimension), inside of the unit cube."""


class Grid(Listed):
    """Equidistant values."""

    kind: Literal["grid"]
    start: float = entry("a number: the first value")
    end: float = entry("a number: the last value")
    count: int = entry(
        f"a whole number >= 1 of values, both ends among them, at most {MOST_VALUES:.0e}", ge=1, le=MOST_VALUES
    )
    spacing: Literal["linear", "log"] = entry('"linear", or "log" for equal ratios between ends of one sign', "linear")

    @property
    def form(self) -> tuple[int, ...]:
        """That of a number."""
        if self.spacing == "log" and not self.start * self.end > 0:
            raise ValueError(f'start must have the sign of end = {self.end:g} where spacing is "log"')
        return ()

    @property
    def length(self) -> int:
        """How many values there are, which are not made for it."""
        return self.count

    def points(self) -> Array:
        """Return the values."""
        return (np.geomspace if self.spacing == "log" else np.linspace)(self.start, self.end, self.count)


class Values(Listed):
    """The values themselves."""

    kind: Literal["list"] = "list"
    values: Annotated[list[float] | list[list[float]] | list[list[list[float]]], BY_FORM] = entry(
        "a list of numbers, or a list of lists of the form that the key has"
    )

    @property
    def form(self) -> tuple[int, ...]:
        """The shape of an entry."""
        points = self.points()
        if not points.size:
            raise ValueError("values is empty")
        return points.shape[1:]

    def points(self) -> Array:
        """Return the values; a ValueError where they are not all of one form."""
        try:
            return np.array(self.values, dtype=np.float64)
        except ValueError as error:
            raise ValueError("its entries are of different lengths") from error


class Uniform(Drawn):
    """Uniform between two numbers, component by component."""

    kind: Literal["uniform"]
    low: Numbers = entry(f"{NUMBERS}: the lower end")
    high: Numbers = entry(f"{NUMBERS}: the upper end, not below low")

    @property
    def form(self) -> tuple[int, ...]:
        """That of both ends."""
        return _form_of("high", self.high, "low", self.low, self.low)

    def values(self, u: Array) -> Array:
        """Return the values."""
        low, high = np.array(self.low), np.array(self.high)
        return low + (high - low) * u.reshape(len(u), *low.shape)


class Normal(Drawn):
    """Normal, component by component independent."""

    kind: Literal["normal"]
    mean: Numbers = entry(NUMBERS)
    deviation: Numbers = entry(f"{NUMBERS}, not negative: the standard deviation")

    @property
    def form(self) -> tuple[int, ...]:
        """That of the mean."""
        return _form_of("deviation", self.deviation, "mean", self.mean, 0.0)

    def values(self, u: Array) -> Array:
        """Return the values."""
        from scipy.special import ndtri

        mean, deviation = np.array(self.mean), np.array(self.deviation)
        return mean + deviation * ndtri(u).reshape(len(u), *mean.shape)


def _form_of(name: str, value: Any, other: str, numbers: Any, least: Any) -> tuple[int, ...]:
    """Return the shape of two values; a ValueError where they differ in it, or one is below the least."""
    if np.shape(value) != np.shape(numbers):
        raise ValueError(f"{name} must be of the same form as {other} = {shown(numbers)}")
    if np.any(np.array(value) < least):
        raise ValueError(f"{name} must not be below {shown(least)}")
    return np.shape(value)


class Sphere(Drawn):
    """Vectors of one length, their directions uniform on the sphere."""

    kind: Literal["sphere"]
    radius: Positive = entry("a positive number: the length of the vectors", 1.0)
    form: ClassVar[tuple[int, ...]] = (3,)
    dimension: ClassVar[int] = 2

    def values(self, u: Array) -> Array:
        """Return the vectors."""
        z, longitude = 2 * u[:, 0] - 1, 2 * math.pi * u[:, 1]
        across = np.sqrt((1 - z) * (1 + z))
        return self.radius * np.stack([across * np.cos(longitude), across * np.sin(longitude), z], axis=1)


class Attitudes(Drawn):
    """Rotations, uniform on SO(3)."""

    kind: Literal["rotation"]
    form: ClassVar[tuple[int, ...]] = ()
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
AnyOver = Annotated[Over, OneOf(KINDS, default="list")]

Reduction = Annotated[str, OneOf(dict.fromkeys(STATISTICS))]
Variable = Annotated[str, OneOf(ChainMap(OBSERVABLES, dict.fromkeys(KEPT)))]


def _quoted(names: Any) -> str:
    return "a list of " + ", ".join(f'"{name}"' for name in names)


class Sweep(Section):
    """Many runs of the file, each with numbers of its own; what is kept is the state at t_end."""

    over: list[AnyOver] = entry(
        f'tables [[sweep.over]], in double brackets, 1 to {MOST_KEYS}, each with a key and a kind, "list" by default',
        min_length=1,
        max_length=MOST_KEYS,
    )
    combine: Literal["product", "together"] = entry(
        '"product" of all grids and lists, the last one fastest, or "together": entry by entry', "product"
    )
    samples: int = entry("a whole number >= 1: members at each point of the grids and lists", 1, ge=1)
    sampling: Literal["random", "sobol", "halton"] = entry(
        '"random", or one of the quasi-random sequences "sobol", "halton"', "random"
    )
    seed: int = entry("a whole number >= 0", 0, ge=0)
    variables: list[Variable] = entry(f"{_quoted(KEPT)}, kept at t_end", [*STATE])
    reduce: list[Reduction] = entry(f"{_quoted(STATISTICS)}, over all steps", [])

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
        lengths = tuple(one.length for one in self.axes)
        return lengths[:1] if self.combine == "together" else lengths

    @property
    def members(self) -> int:
        """How many runs there are."""
        return math.prod(self.shape) * self.samples

    def ensembles(self, loads: Sequence[LoadSection]) -> int:
        """Return how many ensembles the members form beside these loads: one for each value of other keys."""
        apart = [one for one in self.over if not is_axis(one.key, loads)]
        lengths = [one.length if isinstance(one, Listed) else self.members for one in apart]
        return min(math.prod(set(lengths) if self.combine == "together" else lengths), self.members)


def is_axis(key: str, loads: Sequence[LoadSection]) -> bool:
    """Whether members may differ in this key within one ensemble."""
    if key == "load.0.scale":
        return len(loads) == 1 and loads[0].is_swept
    return key.startswith(("start.rotation", "start.angular_velocity.", "body."))


# What a table `[sweep]` may not hold though each of its values is of the right form.
#
# `table_problems` looks at the table alone, `key_problems` at the file that it varies: whether its keys are numbers
# there, and whether the values have their form.


MOST_MEMBERS, MOST_SOBOL = 10**11, 2**32
MOST_WORDS = 100  # keys that a misspelt one is compared with, and that are named
# No numbers of the motion, which cannot be swept.
EXCLUDED = ("title", "output", "sweep", "event", "time.store", "time.times")


def table_problems(sweep: Sweep, faults: Faults) -> None:
    """Find what is wrong with the table by itself."""
    before = len(faults)
    for k, one in enumerate(sweep.over):
        with faults.of(f"sweep.over.{k}", one, "values"):
            _ = one.form
    is_valid = len(faults) == before
    for (_, other), (k, one) in combinations(enumerate(sweep.over), 2):
        if f"{one.key}.".startswith(f"{other.key}.") or f"{other.key}.".startswith(f"{one.key}."):
            given = f"{shown(one.key)}, beside {shown(other.key)}"
            faults.append(Fault(f"sweep.over.{k}.key", given, "each number once"))
    if sweep.samples > 1 and not sweep.drawn:
        given = f"{sweep.samples} (nothing is drawn)"
        faults.append(Fault("sweep.samples", given, "left out, or a key that is drawn"))
    if not is_valid:
        return
    if sweep.drawn and not sweep.axes and "samples" not in sweep.model_fields_set:
        accepted = "a whole number >= 1: how many members draw their values"
        faults.append(Fault("sweep.samples", "missing", accepted))
    lengths = [one.length for one in sweep.axes]
    if sweep.combine == "together" and len(set(lengths)) > 1:
        given = f'"together" ({", ".join(map(str, lengths))} values)'
        faults.append(Fault("sweep.combine", given, 'grids and lists of one length; or "product"'))
    most = MOST_SOBOL if sweep.sampling == "sobol" and sweep.drawn else MOST_MEMBERS
    if sweep.members > most:
        faults.append(Fault("sweep", f"{min(sweep.members, 10**300):.3g} members", f"at most {most:.3g}"))


def key_problems(sweep: Sweep, data: dict[str, Any]) -> Iterator[Fault]:
    """Yield what does not fit the rest of the file, which is in order; `data` is the file with all defaults."""
    known = numeric_keys(data)
    outer = [key for key in known if not any(key[: dot.start()] in known for dot in re.finditer(r"\.", key))]
    for k, one in enumerate(sweep.over):
        at = f"sweep.over.{k}"
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
        else:
            with suppress(ValueError):  # values of several forms, or none
                if known[one.key] != one.form:
                    form = f"{_form(one.form)} (the key holds {_form(known[one.key])})"
                    accepted = "values of the form that the key has"
                    if (one.form, known[one.key]) == ((3,), (3, 3)):
                        accepted += f", as numpy.diag makes them of three; or {one.key}.0.0, {one.key}.1.1, ... alone"
                    yield Fault(f"{at}.kind", f"{shown(one.kind)}: {form}", accepted)


def step_problems(step: float | None, integrator: type[Integrator], prepared: Prepared | None) -> Iterator[Fault]:
    """Yield that a step is missing, which all members take, with one that suits the run without the sweep."""
    if step is not None or integrator.any_times:
        return
    accepted = "a step, s, which all members take"
    with suppress(ValueError):  # too many steps
        if prepared is not None:
            prepared = prepared.on_grid  # members store the states at their steps
            plan, order = prepared.plan, getattr(prepared.scheme, "order", None)
            at = f" with integrator.order = {order}" if order else ""
            even = even_step(prepared.grid.longest, plan.grid_load, plan.t_start, plan.t_end)
            accepted += f"; {even:.12g}{at} suits the file without [sweep], and " if even else "; "
            accepted += "nontwist precision FILE --target 1e-8 finds one that has this error"
    yield Fault("time.step", "missing", accepted)


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
    with suppress(ValueError):
        array = np.array(data)
        return array.shape if array.dtype.kind in "if" and array.size else None
    return None
