"""The tables ``[time]``, ``[integrator]`` and ``[output]``."""

from __future__ import annotations

from dataclasses import MISSING, fields
from functools import cache
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import Field, create_model

from ..integrators import INTEGRATORS, LieMidpoint
from ..integrators import Integrator as Scheme
from .section import OneOf, Positive, Section


class Time(Section):
    """From when to when, in which steps."""

    t_end: float = Field(description="a number after t_start, s")
    t_start: float = Field(default=0.0, description="a number, s")
    step: Positive | None = Field(
        default=None, description="a positive number that divides the span, s; left out: at most 0.05 rad a step"
    )
    tolerance: Annotated[float, Field(gt=0, le=0.1)] | None = Field(
        default=None,
        description="a positive number up to 0.1, rad, in place of step: a bound of the error of the attitude, and of "
        "that of the angular velocity relative to its largest size",
    )
    store: Annotated[int, Field(ge=1)] | Literal["end"] = Field(
        default=1, description='a whole number of steps >= 1, or "end" for the first and the last state only'
    )


class Integrator(Section):
    """The integrator, its order and its own options."""

    name: Annotated[str, OneOf(INTEGRATORS)] = LieMidpoint.name
    order: int | None = Field(default=None, description="a whole number: an order that the integrator has")
    options: dict[str, Any] = Field(default={}, description="a table of the integrator's own options")

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
        default=[], description='a list of "momenta", "energy", "path": figures drawn beside the result'
    )


@cache
def options_of(scheme: type[Scheme]) -> type[Section]:
    """Return the table of the options of an integrator, without `order`."""
    hints = get_type_hints(scheme)
    own: dict[str, Any] = {
        f.name: (hints[f.name], ... if f.default is MISSING else f.default) for f in fields(scheme) if f.name != "order"
    }
    return create_model("Options", __base__=Section, **own)
