"""The tables ``[time]``, ``[integrator]`` and ``[output]``."""

from __future__ import annotations

import math
from dataclasses import MISSING, fields
from functools import cache
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import Discriminator, Field, Tag, create_model

from ..integrators import DEFAULT, INTEGRATORS
from ..integrators import Integrator as Scheme
from ..integrators.time_grid import FIT
from .folder import Folder
from .section import OneOf, Positive, Section, by_key

MOST_TIMES = 10_000_000  # output times


def _times_form(value: Any) -> str | None:
    return by_key("file", "every")(value) if isinstance(value, (dict, Section)) else "<values>"


class TimesFile(Section):
    """Output times in a column of a CSV file with a line of headers."""

    file: str = Field(
        min_length=1, description="a CSV file in quotes, relative to the run file: headers, then rows of numbers, s"
    )
    column: str | None = Field(
        default=None, description="the header of the times (s), in quotes; not needed where there is one column"
    )
    sha256: str | None = Field(
        default=None, description="the hash of the CSV file, in quotes: another content is refused"
    )


class TimesEvery(Section):
    """Output times at equal distances, from the start, and the end."""

    every: Positive = Field(
        description="a positive number, s: output at t_start, so much later, and so on, and at t_end"
    )


class Time(Section):
    """From when to when, in which steps."""

    t_end: float = Field(description="a number after t_start, s")
    t_start: float = Field(default=0.0, description="a number, s")
    step: Positive | None = Field(
        default=None,
        description="a positive number that divides the span, s; left out: at most 0.05 rad a step, or with gauss an "
        "error of 1e-8 at most",
    )
    tolerance: Annotated[float, Field(gt=0, le=0.1)] | None = Field(
        default=None,
        description="a positive number up to 0.1, rad, in place of step: a bound of the error of the attitude, and of "
        "that of the angular velocity relative to its largest size",
    )
    store: Annotated[int, Field(ge=1)] | Literal["end"] = Field(
        default=1, description='a whole number of steps >= 1, or "end" for the first and the last state only'
    )
    times: (
        Annotated[
            Annotated[TimesFile, Tag("<file>")]
            | Annotated[TimesEvery, Tag("<every>")]
            | Annotated[list[float], Field(min_length=1), Tag("<values>")],
            Discriminator(_times_form),
        ]
        | None
    ) = Field(
        default=None,
        description="increasing numbers from t_start to t_end, s: output at these times, without store; or a table "
        "with the key every (s), or with the keys file and column",
    )

    def output_times(self, folder: Folder) -> list[float] | None:
        """Return the output times, None where there are none; a ValueError where the file cannot be read."""
        if isinstance(self.times, TimesEvery):
            return self._equidistant(self.times.every)
        if not isinstance(self.times, TimesFile):
            return self.times
        chosen = None if self.times.column is None else [self.times.column]
        found: list[float] = folder.table(self.times.file, chosen, self.times.sha256, 1).columns[0].tolist()
        return found

    def _equidistant(self, every: float) -> list[float]:
        span = self.t_end - self.t_start
        if not span / every < MOST_TIMES:
            raise ValueError(f"it makes {span / every:.3g} times, at most {MOST_TIMES:.0e} are possible")
        count = math.ceil(span / every * (1 - FIT))
        return [*(self.t_start + every * k for k in range(count)), self.t_end]

    def recorded(self, folder: Folder) -> dict[str, Any]:
        """Return what is recorded in the place of `times`: the hash of the file as it was read."""
        if not isinstance(self.times, TimesFile):
            return {}
        one = self.times
        chosen = None if one.column is None else [one.column]
        hashed = {"sha256": folder.table(one.file, chosen, one.sha256, 1).sha256}
        return {"times": one.model_dump(exclude_none=True) | hashed}


class Integrator(Section):
    """The integrator, its order and its own options."""

    name: Annotated[str, OneOf(INTEGRATORS, open=True)] = DEFAULT
    order: int | None = Field(default=None, description="a whole number: an order that the integrator has")
    options: dict[str, Any] = Field(default={}, description="a table of the integrator's own options")

    @classmethod
    def keys(cls) -> list[str]:
        """Return the keys, and those of `options` of all integrators."""
        kinds: list[Any] = [*INTEGRATORS.values()]
        options = dict.fromkeys(key for kind in kinds for key in options_of(kind).model_fields)
        return [*super().keys(), *(f"options.{key}" for key in options)]

    def scheme(self) -> Scheme:
        """Return the integrator; a ValueError where it has no such order or option."""
        order = {} if self.order is None else {"order": self.order}
        return INTEGRATORS[self.name](**order, **self.options)


class Output(Section):
    """Where the result goes."""

    path: Annotated[str, Field(pattern=r"^[^\x00]+\.nc$")] | None = Field(
        default=None, description='a file name with the ending ".nc", like result.nc, relative to the run file'
    )
    figures: list[Literal["momenta", "energy", "path"]] = Field(
        default=[], description='a list of "momenta", "energy", "path": figures drawn next to the result'
    )


@cache
def options_of(scheme: type[Scheme]) -> type[Section]:
    """Return the table of the options of an integrator, without `order`."""
    hints = get_type_hints(scheme)
    own: dict[str, Any] = {
        f.name: (hints[f.name], ... if f.default is MISSING else f.default) for f in fields(scheme) if f.name != "order"
    }
    return create_model("Options", __base__=Section, **own)
