"""The tables ``[[event]]``: where something happens on the way of a run, which may end it.

`EVENTS` is the visible list: a new kind is one class and one line.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from ..driver.named_events import NamedEvent, axis_crosses, spin_below
from .section import AN_AXIS, Axis, OneOf, Positive, Section

NAME = r"^[^\x00-\x20\x7f]([^\x00-\x1f\x7f]*[^\x00-\x20\x7f])?$"  # a line without blanks at its ends
DIRECTION = "-1 (only where its value falls), 1 (only where it rises) or 0 (both)"


class EventSection(Section):
    """An event, with what all kinds have in common."""

    terminal: bool | Annotated[int, Field(ge=0)] = Field(
        default=False, description="true where the run ends there, or a whole number: after how many of them"
    )
    name: Annotated[str, Field(pattern=NAME, max_length=60)] | None = Field(
        default=None, description="a text of up to 60 characters; by default axis_crosses or spin_below"
    )
    if TYPE_CHECKING:
        kind: str
        direction: int

    @abstractmethod
    def event(self) -> NamedEvent:
        """Return the event; a ValueError where its numbers make none."""

    @property
    def named(self) -> str:
        """The name of the event."""
        return self.name or self.kind.replace("-", "_")


class AxisCrosses(EventSection):
    """An axis of the body crosses a plane, or a cone about its normal."""

    kind: Literal["axis-crosses"]
    axis: Axis = Field(default=[0.0, 0.0, 1.0], description=AN_AXIS + "components along the directors")
    normal: Axis = Field(default=[0.0, 0.0, 1.0], description=AN_AXIS + "of the plane, in space")
    cosine: Annotated[float, Field(gt=-1, lt=1)] = Field(
        default=0.0, description="a number between -1 and 1: of the angle between axis and normal, 0 for the plane"
    )
    direction: Literal[-1, 0, 1] = Field(default=0, description=DIRECTION)

    def event(self) -> NamedEvent:
        """Return the event."""
        how = {"direction": self.direction, "terminal": self.terminal, "name": self.named}
        return axis_crosses(self.axis, self.normal, cosine=self.cosine, **how)  # type: ignore[arg-type]


class SpinBelow(EventSection):
    """The angular velocity, or its part along an axis of the body, falls below a value."""

    kind: Literal["spin-below"]
    value: Positive = Field(description="a positive number, rad/s")
    axis: Axis | None = Field(default=None, description=AN_AXIS + "components along the directors")
    direction: Literal[-1, 0, 1] = Field(default=-1, description=DIRECTION)

    def event(self) -> NamedEvent:
        """Return the event."""
        how = {"direction": self.direction, "terminal": self.terminal, "name": self.named}
        return spin_below(self.value, self.axis, **how)  # type: ignore[arg-type]


EVENTS: dict[str, type[EventSection]] = {"axis-crosses": AxisCrosses, "spin-below": SpinBelow}
AnyEvent = Annotated[EventSection, OneOf(EVENTS)]
