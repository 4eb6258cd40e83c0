"""Dry friction: a moment that is bounded, and otherwise what keeps a rate at zero.

With the rate r = a·W about an axis a of the body, the moment along a is ``-limit sign r`` while r is not zero; while it
is, it is any moment between -limit and limit. Without an axis it is ``-limit w/|w|``, and at w = 0 any of a size up to
the limit. That is no function of the state, so kernels do not call it: `driver.rubbing` takes a run apart where a rate
vanishes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array
from ..geometry.values import vector_text
from ..spec import Spec
from .terms import Record, Table, Term, factor_in_words

PARALLEL = 1e-12  # of unit vectors
ROUND_OFF = 32 * float(np.finfo(np.float64).eps)  # of |W|: a rate that is zero


@dataclass(frozen=True, eq=False)
class DryFriction(Term):
    """Dry friction about an axis of the body, or against w, which is not called as kernels march."""

    in_kernels = True
    dry_friction: Annotated[
        float, Spec("the largest moment", option="limit", unit="N m", rule="not negative", is_fixed=True)
    ]
    axis: Annotated[
        Array | None, Spec("by default against w", shape=(3,), rule="direction in the body", is_fixed=True)
    ] = None

    @property
    def limit(self) -> float:
        """The largest moment, with the factor, N m."""
        return self.scale * self.dry_friction

    def rates(self, velocities: ArrayLike) -> Array:
        """Return the rates that it acts against, (...), of W (..., 3), rad/s: a·W, or |W| without an axis."""
        W = np.asarray(velocities, dtype=np.float64)
        return np.linalg.norm(W, axis=-1) if self.axis is None else W @ self.axis

    def moment(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the moment where the body slides, and 0 where it may stick."""
        W = directors @ angular_velocity
        if self.axis is not None:
            return -self.dry_friction * np.sign(self.axis @ W) * self.axis @ directors
        size = np.linalg.norm(W)
        return -self.dry_friction * angular_velocity / size if size else np.zeros(3)

    def scaled(self, factor: float) -> Self:
        """Return the term times `factor`, which must not be negative."""
        if factor < 0:
            raise ValueError(f"dry_friction must not be negative: it is multiplied by {factor:g}")
        return super().scaled(factor)

    @classmethod
    def words(cls, record: Record) -> str:
        """Return the limit and the axis."""
        about = f" about {vector_text(record['axis'])}" if "axis" in record else ""
        return f"{factor_in_words(record)}dry friction of up to {record['dry_friction']:.6g} N m{about}"


class Sliding(Table):
    """The moment of dry friction about axes while the body slides, along the frame, constant: its work is asked for."""


def require_distinct_axes(terms: tuple[Any, ...]) -> None:
    """Raise a ValueError where two dry frictions act about one axis, or one against w beside another."""
    own = [term for term in terms if isinstance(term, DryFriction)]
    for a, b in combinations([term.axis for term in own], 2):
        if a is None or b is None:
            raise ValueError(
                "dry_friction against w cannot act beside another dry_friction: give each an axis, or all in one limit"
            )
        if abs(np.cross(a, b)).max() <= PARALLEL:
            raise ValueError(f"two loads dry_friction about one axis, {vector_text(a)}: give one, of the sum of limits")
