"""Events that have names: an axis of the body crosses a plane, a spin falls below a value."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_axis, as_number
from ..geometry.attitudes import entries
from .starts import BodyState


class NamedEvent:
    """An event function with a name, made by `axis_crosses` or `spin_below`; kind and keys are those in run files."""

    def __init__(
        self, kind: str, value: Callable[..., Array], keys: dict[str, Any], name: str, terminal: bool | int, side: float
    ) -> None:
        self.kind, self.keys, self._value = kind, keys, value
        self.__name__, self.terminal, self.direction = name, terminal, side

    def __call__(self, t: float, state: BodyState) -> float:
        """Return the value whose zeros are the events."""
        return float(self.along(np.array(state.quaternion), np.array(state.material_angular_velocity)))

    def along(self, quaternion: Array, W: Array) -> Array:
        """Return the values along any leading axes."""
        return self._value(quaternion, W, **self.keys)

    def __repr__(self) -> str:
        return f"<event {self.__name__}>"


def _height(quaternion: Array, W: Array, axis: Array, normal: Array, cosine: float) -> Array:
    return np.asarray(np.einsum("i,ij...,j->...", normal, entries(quaternion), axis)) - cosine


def _excess(quaternion: Array, W: Array, value: float, axis: Array | None) -> Array:
    speed = np.sqrt(np.square(W).sum(axis=-1)) if axis is None else abs(np.einsum("...i,i->...", W, axis))
    return np.asarray(speed - value)


def axis_crosses(
    axis: ArrayLike = (0, 0, 1),
    normal: ArrayLike = (0, 0, 1),
    *,
    cosine: float = 0.0,
    direction: float = 0.0,
    terminal: bool | int = False,
    name: str = "axis_crosses",
) -> NamedEvent:
    """Return the event that an axis of the body crosses a plane, or a cone about its normal.

    Parameters
    ----------
    axis : (3,) array, or "x", "y", "z", "-x", "-y", "-z"
        Components along the directors, of any length.
    normal : (3,) array, or such a letter
        Normal of the plane, in space, of any length.
    cosine : float
        Cosine of the angle between axis and normal: 0 for the plane, otherwise a cone.
    direction : float
        > 0: only towards the side of the normal; < 0: only away from it.
    terminal : bool or int
        Whether the first such event ends the run, or the number of the event that ends it.
    name : str

    Returns
    -------
    callable
        For ``events=`` of `simulate`.

    Raises
    ------
    ValueError
        An axis or a normal has length 0, or the cosine is not between -1 and 1.

    Examples
    --------
    >>> from nontwist import axis_crosses, nontwisting, simulate
    >>> level = axis_crosses(terminal=True)
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=9, angular_velocity=(2, 0, 0), events=level, integrator="exact")
    >>> run.message
    'the event axis_crosses ended the run at t = 0.785398163397 s'
    """
    x = as_number(cosine, "cosine")
    if not -1 < x < 1:
        raise ValueError(f"cosine must be between -1 and 1, got {x:g}")
    keys = {"axis": _unit(axis, "axis"), "normal": _unit(normal, "normal"), "cosine": x}
    return NamedEvent("axis-crosses", _height, keys, name, terminal, direction)


def spin_below(
    value: float,
    axis: ArrayLike | None = None,
    *,
    direction: float = -1.0,
    terminal: bool | int = False,
    name: str = "spin_below",
) -> NamedEvent:
    """Return the event that the angular speed of the body falls below a value.

    Parameters
    ----------
    value : float, rad/s
    axis : (3,) array, or "x", "y", "z", "-x", "-y", "-z", optional
        Components along the directors: the magnitude of the component of W along this axis counts. By default the
        magnitude of W.
    direction : float
        < 0: when the speed falls below the value, the default; > 0: when it rises above it; 0: both.
    terminal : bool or int
        Whether the first such event ends the run, or the number of the event that ends it.
    name : str

    Returns
    -------
    callable
        For ``events=`` of `simulate`.

    Raises
    ------
    ValueError
        `value` is not positive, or the axis has length 0.

    Examples
    --------
    >>> from nontwist import damping, simulate, spin_below, standard
    >>> slow, W = spin_below(0.5, terminal=True), (0, 0, 1)
    >>> run = simulate(standard([2, 2, 2]), t_end=9, load=damping(1), material_angular_velocity=W, events=slow)
    >>> run.t_events.values.round(3)  # 2 ln 2 s
    array([1.386])
    """
    x = as_number(value, "value")
    if not x > 0:
        raise ValueError(f"value must be positive, got {x:g}")
    keys = {"value": x, "axis": None if axis is None else _unit(axis, "axis")}
    return NamedEvent("spin-below", _excess, keys, name, terminal, direction)


def _unit(value: ArrayLike, name: str) -> Any:
    x = as_axis(value, name)
    size = float(sqrt(x @ x))
    if not size > 0:
        raise ValueError(f"{name} must not be zero")
    return x / size
