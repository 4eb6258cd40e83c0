"""The table ``[sweep]``: which numbers of the file vary from member to member, and how.

A grid or a list is an axis of a product. All else is drawn, and every drawing is a map from the unit cube: uniform by
scaling, normal by its quantile function, a direction by Archimedes (height and longitude), a rotation by Shoemake's
three numbers (Graphics Gems III, 1992; the image of the uniform measure is Haar's). What fills the cube, random or
quasi-random, is then one choice for the whole sweep.

`KINDS` is the visible list: a new kind is one class and one line.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag

from ..analysis.statistics import STATISTICS
from ..analysis.variables import NODES, ROTORS, STATE
from ..geometry.arrays import Array
from .section import OneOf, Positive, Section, by_shape

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
