"""A prescribed spin: the rate c(t) at which a body turns about its constrained axis n, ``w·Λn = c(t)``.

With c = 0 that is the constraint of the paper. For the body on the frame, n = E3 principal, the equations are

    J1 W1' = (J2 - J3) c W2 + M1,    J2 W2' = (J3 - J1) c W1 + M2,    W3 = c,    μ = (J1 - J2) W1 W2 + M3 - J3 c',

μ the moment that the drive takes up. Its power is -μ c, so the energy is not kept, not even where c is constant. Free
motion keeps ``2 J3 K - |Π|² = J1 (J3 - J1) W1² + J2 (J3 - J2) W2²``, whatever c(t) is. Where J3 is the largest or the
smallest moment this is a definite form, and W1, W2 stay bounded. Where it is the **middle** one they grow like exp(σt),
``σ = |c| sqrt((J3 - J1)(J2 - J3)/(J1 J2))``: a motion of the body, which every scheme shows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..geometry.arrays import Array, as_array, as_floats, increasing
from ..geometry.values import short_repr


@dataclass(frozen=True, eq=False)
class Spin:
    """A rate as a table, piecewise linear between its times and constant outside; one time where it is constant.

    Attributes
    ----------
    times : (k,) array, s
    values : (k,) array, rad/s
    """

    times: Array
    values: Array

    def at(self, times: Any) -> Array:
        """Return the rate at (n,) times, rad/s."""
        return np.interp(times, self.times, self.values)

    @property
    def is_constant(self) -> bool:
        """Whether the rate is the same at all times."""
        return bool((self.values == self.values[0]).all())

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which the rate of change jumps, s."""
        return () if self.is_constant else tuple(self.times.tolist())

    def is_like(self, other: Spin) -> bool:
        """Whether the table is the same."""
        return np.array_equal(self.times, other.times) and np.array_equal(self.values, other.values)


def as_spin(value: Any) -> Spin | None:
    """Return `value`, a number, (times, values), a `Spin` or None, as a spin; None where it is zero at all times."""
    if value is None or isinstance(value, Spin):
        return None if value is None or not value.values.any() else value
    if isinstance(value, tuple | list) and len(value) == 2 and np.ndim(value[0]) == 1:
        times = as_array(value[0], "times of spin", (None,))
        values = as_array(value[1], "values of spin", (times.size,))
        increasing(times, " of spin", "a table of spin")
    else:
        number = as_floats(value, "spin")
        if number.ndim:
            raise ValueError(f"spin must be a number (rad/s) or a pair of times and values, got {short_repr(value)}")
        times, values = np.zeros(1), as_array(number, "spin", ())[None]
    times.flags.writeable = values.flags.writeable = False
    return Spin(times, values) if values.any() else None
