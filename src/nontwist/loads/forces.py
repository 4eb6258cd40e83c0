"""Director forces, the generalised load Q = (f¹, f², f³) of the paper: terms of a load.

They do the virtual work ``δW = Σ f^i·δd_i``. Rotations ``δd_i = δθ × d_i`` see their moment Σ d_i × f^i alone; the
director form sees all of them, and what has no moment changes its multipliers λ.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from ..geometry.arrays import Array
from ..spec import Spec
from .calls import Call, array, state
from .terms import ForceTerm, Frame, Record, along, function_in_words, nonzero_intervals, smoothness, within

SPACE_AND_BODY = 18  # numbers of a node: forces in space, then along the directors


class DirectorForces(ForceTerm):
    """A term of kind "forces": three forces on the directors, from the time and the state.

    A subclass has the text ``forces(t, directors, angular_velocity)``, which returns them in space, a row for each.
    """

    kind = "forces"

    @property
    def called(self) -> Callable[..., Any]:
        """The text."""
        found: Callable[..., Any] = getattr(self, "forces")  # noqa: B009 - of subclasses
        return found


@dataclass(frozen=True, eq=False)
class ForceTable(DirectorForces):
    """Forces on the three directors, linear between its times and zero outside."""

    in_kernels = True
    forces_of: Annotated[Array, Spec("the forces on d1, d2, d3", option="values", unit="N m", shape=("times", 3, 3))]
    times: Annotated[Array, Spec("", unit="s", shape=(None,), rule="increasing", is_fixed=True)]
    frame: Frame

    def __post_init__(self) -> None:
        super().__post_init__()
        self._set(**smoothness(self.times))

    @property
    def values(self) -> Array:
        """The forces."""
        return self.forces_of

    @cached_property
    def support(self) -> Array:
        """Between times at one of which a force is not zero."""
        return nonzero_intervals(self.times, self.forces_of)

    def columns(self, times: Any) -> list[Any]:
        """Return the nine interpolated numbers in their frame, one after the other."""
        return within(self.times, self.forces_of.reshape(len(self.times), 9), times)

    def rows(self, times: Array) -> Array:
        """Return the interpolated forces in their frame, (n, 3, 3)."""
        return np.stack(self.columns(times), axis=1).reshape(len(times), 3, 3)

    def forces_at(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the forces in space."""
        rows: Array = self.rows(np.array([t]))[0]
        return rows if self.frame == "space" else rows @ directors

    @classmethod
    def words(cls, record: Record) -> str:
        """Return how long the table is."""
        return f"table of {len(record['times'])} director forces {along(record['frame'])}"


@dataclass(frozen=True, eq=False)
class ForceFunction(DirectorForces):
    """What a function of time, directors and angular velocity gives, rows of (3, 3) in `frame`."""

    director_forces: Callable[..., Any]
    frame: Frame

    @property
    def called(self) -> Callable[..., Any]:
        """The function."""
        return self.director_forces

    def text(self, call: Call, x: Sequence[Any]) -> list[Any]:
        """Return the forces in space."""
        rows = call(self.called, state(x), (3, 3))
        if self.frame == "body":
            rows = (array(rows, 3, 3) @ array(x[:9], 3, 3)).ravel().tolist()
        return rows

    @classmethod
    def words(cls, record: Record) -> str:
        """Return factor and name."""
        return function_in_words(record, f"director forces of {record['director_forces']}", record["frame"])
