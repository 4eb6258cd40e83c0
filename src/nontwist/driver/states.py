"""The state of a body at one time, as a value: what events and closed loops look at."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.arrays import Array

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Vector = tuple[float, float, float]


class BodyState:
    """The state of a body at one time, as passed to an event function.

    All numbers are floats or tuples of floats, but for the array of the directors.

    Examples
    --------
    >>> from nontwist import simulate, standard
    >>> def level(t, state):
    ...     return state.directors[2, 2]
    >>> run = simulate(standard([3, 4, 5]), t_end=1, angular_velocity=(2, 0, 0), events=level, integrator="exact")
    >>> run.t_events.values.round(6)
    array([0.785398])
    """

    __slots__ = ("_numbers", "_time")
    _numbers: tuple[float, ...]
    _time: float

    @property
    def time(self) -> float:
        """Time t, s."""
        return self._time

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """Unit quaternion of Λ, body to space, scalar last; its sign does not jump from state to state."""
        return self._numbers[0:4]  # type: ignore[return-value]

    @property
    def material_angular_velocity(self) -> Vector:
        """Angular velocity W in body components, rad/s."""
        return self._numbers[4:7]  # type: ignore[return-value]

    @property
    def internal_state(self) -> tuple[float, ...]:
        """The internal states z of loads with memory, one behind the other; none: ()."""
        return self._numbers[7:]

    @property
    def angular_velocity(self) -> Vector:
        """Angular velocity w = ΛW in space, rad/s."""
        x, y, z, s, a, b, c = self._numbers[:7]
        p, q, r = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
        return a + s * p + y * r - z * q, b + s * q + z * p - x * r, c + s * r + x * q - y * p

    @property
    def directors(self) -> Array:
        """The directors d_i, rows of (3, 3): the axes of the body in space."""
        x, y, z, s = self._numbers[:4]
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y + s * z), 2 * (x * z - s * y)],
                [2 * (x * y - s * z), 1 - 2 * (x * x + z * z), 2 * (y * z + s * x)],
                [2 * (x * z + s * y), 2 * (y * z - s * x), 1 - 2 * (x * x + y * y)],
            ]
        )

    @property
    def rotation(self) -> Rotation:
        """Attitude Λ, body to space, as a `scipy.spatial.transform.Rotation`, made on access."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self._numbers[:4])

    def __repr__(self) -> str:
        from ..geometry.values import vector_text

        p, W = vector_text(self.quaternion), vector_text(self.material_angular_velocity)
        return f"<{type(self).__name__}: t = {self._time:.12g} s, quaternion {p}, W {W} rad/s>"


def body_state(time: float, quaternion: Any, velocity: Any, internal: Any = ()) -> BodyState:
    """Return the state of a quaternion, scalar last, W, and internal states, lists of floats."""
    state = BodyState()
    state._time, state._numbers = time, (*quaternion, *velocity, *internal)
    return state
