"""Director forces, the generalised load Q = (f¹, f², f³) of the paper: terms of a load.

They do the virtual work ``δW = Σ f^i·δd_i``. Rotations ``δd_i = δθ × d_i`` see their moment Σ d_i × f^i alone; the
director form sees all of them, and what has no moment changes its multipliers λ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ..geometry.arrays import Array
from .terms import ForceTerm, Kind, Record, along, called, function_in_words, spans, within

SPACE_AND_BODY = 18  # numbers of a node: forces in space, then along the directors


@dataclass(frozen=True, eq=False)
class DirectorForces(ForceTerm):
    """A term of kind "forces": three forces on the directors, from the time and the state.

    A subclass defines `forces`. Unless it is one of the package, Python calls it at every stage of a run.
    """

    kinds: ClassVar[tuple[Kind, ...]] = ("forces",)


@dataclass(frozen=True, eq=False)
class ForceTable(DirectorForces):
    """Forces that are piecewise linear between `times`, and 0 outside; `end_value` is the size of the last ones."""

    forces_of: Array  # (k, 3, 3)
    times: Array
    frame: str
    end_value: float

    @cached_property
    def acting(self) -> Array:
        """Between times at one of which a force is not zero."""
        return spans(self.times, self.forces_of)

    def rows(self, times: Array) -> Array:
        """Return the interpolated forces in their frame, (n, 3, 3)."""
        return within(self.times, self.forces_of.reshape(-1, 9), times).reshape(-1, 3, 3)

    def forces(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the forces in space."""
        rows: Array = self.rows(np.array([t]))[0]
        return rows if self.frame == "space" else rows @ directors

    @staticmethod
    def words(record: Record) -> str:
        """Return how long the table is."""
        return f"table of {len(record['times'])} director forces {along(record['frame'])}"


@dataclass(frozen=True, eq=False)
class ForceFunction(DirectorForces):
    """What a function of time, directors and angular velocity gives, rows of (3, 3) in `frame`."""

    director_forces: Callable[..., Any]
    frame: str

    def forces(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the forces in space."""
        function = getattr(self.director_forces, "py_func", self.director_forces)
        rows = called(function, t, directors.copy(), angular_velocity.copy(), shape=(3, 3))
        return rows if self.frame == "space" else rows @ directors

    @cached_property
    def traceable(self) -> Any:
        """The function as a text; None where it runs in Python."""
        from .compiled import forces_of

        return forces_of(self.director_forces, self.frame == "body") if self.compile else None

    @staticmethod
    def words(record: Record) -> str:
        """Return factor and name."""
        return function_in_words(record, f"director forces of {record['director_forces']}", record["frame"])
