r"""The bodies that are fitted: what acts on them, what is fitted, and in which unit.

Their equations are those of `motions`, with a damping of one number or three, and a rotor of inertia I at the speed Ω,
I Ω its momentum.

**The unit.** Multiply J, m c, C and I by one number and the motion is the same. So J is fitted in a unit u. In free
motion nothing fixes it: u is tr J, and J has trace 1, five numbers. With a known moment m g |c|, or a rotor of known
momentum, J has six numbers, and u is any constant near tr J. Where m |c| is not known, u and J are in units of it, and
J/(m|c|) is a length.

**A constraint.** Where a body may not turn about its axis n, ``n·J n`` has no part in the motion, and is no direction
in which J is fitted.

**Orientation.** Where attitudes are recorded their quaternion is part of the state (`orienting`).

**The axis of a rotor** is known, or fitted: (a, Ω) and (-a, -Ω) are one rotor, so its sign is that of the speed, which
the motion tells.

**The sign of the centre.** Its direction is known, or fitted. Then (n, γ) and (-n, -γ) give the same W: the sign is
not in a gyroscope's recording.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ..geometry.arrays import Array, as_array, as_axis, as_direction, as_floats, as_number, as_positive
from ..geometry.tensors import BASIS, ENTRIES
from ..geometry.values import among, nearest, shown

G = 9.81
PIVOT = ("mass", "centre", "distance", "g")
WHEEL = ("axis", "inertia", "speed", "unit", "error")
COUNTS = {"one": 1, "three": 3}
ATTITUDES = ("use", "euler", "angle_unit", "scalar_first", "rotation_vector", "normalize", "inverse")

# Six entries of symmetric matrices without a trace, of Frobenius norm 1, orthogonal to each other: (6, 5).
TRACELESS = np.zeros((6, 5))
TRACELESS[:3, 0], TRACELESS[:3, 1] = np.array([1, -1, 0]) / np.sqrt(2), np.array([1, 1, -2]) / np.sqrt(6)
TRACELESS[3:, 2:] = np.eye(3) / np.sqrt(2)
WHOLE = np.concatenate([TRACELESS, np.array([[1, 1, 1, 0, 0, 0]]).T / np.sqrt(3)], axis=1)  # with the trace: (6, 6)


def entries(J: Array) -> Array:
    """Return the six entries of a symmetric matrix."""
    return np.array([J[..., i, j] for i, j in ENTRIES]).T if J.ndim > 2 else np.array([J[i, j] for i, j in ENTRIES])


def symmetric(v: Array) -> Array:
    """Return the symmetric matrix of six entries."""
    return np.tensordot(v, BASIS, axes=(-1, 0))


@dataclass(frozen=True)
class Pivot:
    """Gravity about a fixed point.

    `distance`, m, is |c|, `direction` n of length 1 where the centre is known; `mass` is None where m |c| is not known.
    """

    mass: float | None
    distance: float
    direction: Array | None
    gravity: float

    @property
    def moment(self) -> float:
        """The moment m g |c|, N m, or g where m |c| is the unit."""
        return self.gravity * (1.0 if self.mass is None else self.mass * self.distance)


@dataclass(frozen=True)
class Wheel:
    """A rotor: its axis, of length 1, its inertia, kg m², and the relative error of I Ω that is the same throughout.

    `axis` is None where it is fitted.
    """

    axis: Array | None
    inertia: float
    error: float


class Kind(NamedTuple):
    """Which terms the equations of a body have, and which of their numbers are fitted."""

    has_pivot: bool
    points: bool
    oriented: bool
    has_wheel: bool
    has_axis: bool
    has_factor: bool
    damping: int
    is_damped: bool
    is_constrained: bool

    @property
    def size(self) -> int:
        """How many numbers of a state are fitted where it starts: W, γ about a pivot, the quaternion of an attitude."""
        return 3 + 3 * self.has_pivot + 4 * self.oriented

    @property
    def hidden(self) -> int:
        """How many numbers of a state are not fitted: the speed and its rate."""
        return 2 * self.has_wheel

    @property
    def more(self) -> int:
        """How many numbers are fitted beside J: n, a, the factor of the speed, and the damping over the unit."""
        return 3 * self.points + 3 * self.has_axis + self.has_factor + self.damping


@dataclass(frozen=True)
class Model:
    """What acts on the body, and the unit of its inertia.

    `damping` is how many coefficients are fitted, 0, 1 or 3; `damped` are those that are known, (3,), N m s.
    """

    pivot: Pivot | None = None
    damping: int = 0
    damped: Array | None = None
    wheel: Wheel | None = None
    constraint: Array | None = None
    unit: float = 1.0
    oriented: bool = False

    @cached_property
    def kind(self) -> Kind:
        """Which terms there are."""
        is_damped = self.damping > 0 or self.damped is not None
        has_wheel, is_constrained = self.wheel is not None, self.constraint is not None
        has = self.pivot is not None, self.points, self.oriented, has_wheel, self.has_axis, self.has_factor
        return Kind(*has, self.damping, is_damped, is_constrained)

    @property
    def size(self) -> int:
        """How many numbers of a state are fitted where it starts."""
        return self.kind.size

    @property
    def more(self) -> int:
        """How many numbers are fitted beside J."""
        return self.kind.more

    @property
    def is_absolute(self) -> bool:
        """Whether J has six numbers, not five."""
        return self.pivot is not None or self.wheel is not None

    @property
    def has_scale(self) -> bool:
        """Whether J follows in kg m²."""
        return self.wheel is not None or (self.pivot is not None and self.pivot.mass is not None)

    @property
    def is_free(self) -> bool:
        """Whether nothing acts on the body."""
        return not self.is_absolute and not self.damping and self.damped is None

    @property
    def words(self) -> str:
        """How the body moves, in words."""
        acting = {"about a pivot": self.pivot, "with a rotor": self.wheel, "with a constraint": self.constraint}
        how = [words for words, one in acting.items() if one is not None]
        return " ".join(how + ["with damping"] * self.kind.is_damped) or "freely"

    @property
    def points(self) -> bool:
        """Whether the direction of the centre of mass is fitted."""
        return self.pivot is not None and self.pivot.direction is None

    @property
    def has_axis(self) -> bool:
        """Whether the axis of the rotor is fitted."""
        return self.wheel is not None and self.wheel.axis is None

    @property
    def directions_beside(self) -> list[slice]:
        """Which numbers beside J have the length 1 together: n and a, where they are fitted."""
        return [slice(3 * k, 3 * k + 3) for k in range(self.points + self.has_axis)]

    @property
    def directions(self) -> list[slice]:
        """Which numbers of a state have the length 1 together."""
        first = 3 + 3 * (self.pivot is not None)
        return [slice(3, 6)] * (self.pivot is not None) + [slice(first, first + 4)] * self.oriented

    @property
    def has_factor(self) -> bool:
        """Whether a factor of the rotor's momentum is fitted, with a prior."""
        return self.wheel is not None and self.wheel.error > 0

    def factor(self, more: Array) -> float:
        """Return the factor of the rotor's momentum."""
        return float(more[3 * len(self.directions_beside)]) if self.has_factor else 1.0

    def axis(self, more: Array) -> Array:
        """Return the axis of the rotor; 0 without one."""
        if self.wheel is None:
            return np.zeros(3)
        return more[self.directions_beside[-1]] if self.wheel.axis is None else self.wheel.axis

    @cached_property
    def basis(self) -> Array:
        """The directions in which J can change the motion, six entries each, in columns."""
        if self.constraint is None:
            return WHOLE if self.is_absolute else TRACELESS
        size = np.sqrt([1, 1, 1, 2, 2, 2])
        return np.asarray(np.linalg.svd((self.idle * size[:, None]).T)[2][1:].T / size[:, None])

    @property
    def idle(self) -> Array:
        """The directions in which J does not change the motion, six entries each, in columns."""
        if self.constraint is None:
            return np.zeros((6, 0))
        return entries(np.outer(self.constraint, self.constraint))[:, None]

    @property
    def coordinates(self) -> int:
        """How many numbers `chart` has for J."""
        return 6 if self.is_absolute else 5

    @property
    def weight(self) -> float:
        """The second moment m |c|² over the unit, 0 where it is not known."""
        if self.pivot is None or self.pivot.mass is None:
            return 0.0
        return self.pivot.mass * self.pivot.distance**2 / self.unit

    def direction(self, more: Array) -> Array:
        """Return n; 0 without a pivot."""
        if self.pivot is None:
            return np.zeros(3)
        return more[:3] if self.pivot.direction is None else self.pivot.direction

    def damping_of(self, more: Array) -> Array:
        """Return the damping over the unit, (3,)."""
        if self.damped is not None:
            return self.damped / self.unit
        return np.broadcast_to(more[len(more) - self.damping :], (3,)) if self.damping else np.zeros(3)

    def in_unit(self, more: Array, factor: float) -> tuple[Model, Array]:
        """Return the model with a unit that is larger by a factor, and what is fitted beside J."""
        changed = more.copy()
        changed[len(more) - self.damping :] /= factor
        return replace(self, unit=self.unit * factor), changed

    def centred(self, more: Array) -> Array:
        """Return m c cᵀ over the unit, which the second moments about the pivot exceed; 0 where it is not known."""
        return self.weight * np.outer(*[self.direction(more)] * 2) if self.weight else np.zeros((3, 3))


FREE_BODY = Model()


def as_model(gravity: Any, damping: Any, rotor: Any, constraint: Any) -> Model:
    """Return the model; a ValueError says what is wrong with its parts."""
    pivot = None if gravity is None else as_pivot(gravity)
    wheel = None if rotor is None else as_wheel(rotor)
    if pivot is not None and pivot.mass is None and wheel is not None:
        raise ValueError("gravity is 'unknown', but a rotor gives the scale: give mass and distance, or centre")
    axis = None
    if constraint is not None:
        axis, _ = _directed(constraint, "constraint", "it must be an axis of the body, about which it does not turn")
        if pivot is None and wheel is None:
            raise ValueError(
                "constraint needs gravity or a rotor: without them the motion does not determine the scale of the "
                "inertia, and nothing at all of a body that may not turn about a principal axis"
            )
    if damping is None:
        return Model(pivot, wheel=wheel, constraint=axis)
    if isinstance(damping, str):
        if not among(damping, COUNTS):
            raise ValueError(f"damping must be 'one', 'three', or coefficients in N m s; got {shown(damping)}")
        return Model(pivot, COUNTS[damping], wheel=wheel, constraint=axis)
    C = as_floats(damping, "damping")
    C = np.full(3, as_number(damping, "damping")) if C.ndim == 0 else as_array(damping, "damping", (3,))
    if C.min() < 0:
        raise ValueError(f"damping must not be negative, got {C.min():g} N m s")
    model = Model(pivot, damped=C, wheel=wheel, constraint=axis)
    if not model.has_scale:
        raise ValueError(
            f"damping is {shown(damping)} N m s, but nothing gives the scale of the inertia; use 'one' or 'three' to "
            "fit the damping"
        )
    return model


def as_pivot(gravity: Any) -> Pivot:
    """Return gravity about a pivot."""
    if isinstance(gravity, str) and gravity == "unknown":
        return Pivot(None, 1.0, None, G)
    if not isinstance(gravity, Mapping):
        raise ValueError(
            f"gravity must be a mapping with mass and centre or distance, or 'unknown'; got {shown(gravity)}"
        )
    given = of_keys(gravity, PIVOT, "gravity")
    g = float(as_positive(given.get("g", G), "gravity: g", (), "m/s²"))
    if "centre" in given and "distance" in given:
        raise ValueError("gravity has both centre and distance: the length of centre is the distance; leave one out")
    if ("mass" in given) != ("centre" in given or "distance" in given):
        lacks = "centre or distance" if "mass" in given else "mass"
        raise ValueError(f"gravity lacks {lacks}; if unknown, use 'unknown' to fit J/(m|c|)")
    if "mass" not in given:
        raise ValueError("gravity lacks mass, and centre or distance; if unknown, use 'unknown' to fit J/(m|c|)")
    mass = float(as_positive(given["mass"], "gravity: mass", (), "kg"))
    if "distance" in given:
        return Pivot(mass, float(as_positive(given["distance"], "gravity: distance", (), "m")), None, g)
    c, distance = _directed(given["centre"], "gravity: centre", "the pivot is then the centre of mass, without moment")
    return Pivot(mass, distance, c, g)


def as_wheel(rotor: Any) -> Wheel:
    """Return a rotor, without its speed."""
    if not isinstance(rotor, Mapping):
        raise ValueError(f"rotor must be a mapping with axis, inertia and speed; got {shown(rotor)}")
    given = of_keys(rotor, WHEEL, "rotor")
    for key in ("axis", "inertia", "speed"):
        if key not in given:
            raise ValueError(f"rotor lacks {key}: it needs axis, inertia and speed")
    if not isinstance(given["speed"], str):
        as_number(given["speed"], "rotor: speed")
    axis = None if among(given["axis"], ("fit",)) else as_direction(given["axis"], "rotor: axis")
    error = as_number(given.get("error", 0.0), "rotor: error")
    if not 0 <= error < 1:
        raise ValueError(f"rotor: error must be from 0 to less than 1, of the momentum; got {error:g}")
    return Wheel(axis, float(as_positive(given["inertia"], "rotor: inertia", (), "kg m²")), error)


def as_orientation(orientation: Any) -> tuple[str, dict[str, Any]]:
    """Return whether attitudes are fitted, "", "only" or "both", and how `read_motion` reads them."""
    if orientation is None:
        return "", {}
    given = {"use": orientation} if isinstance(orientation, str) else orientation
    if not isinstance(given, Mapping):
        raise ValueError(f"orientation must be 'only', 'both', or a mapping with how to read it; got {shown(given)}")
    given = of_keys(given, ATTITUDES, "orientation")
    use = given.pop("use", "only")
    if not among(use, ("only", "both")):
        raise ValueError(f"orientation must be 'only', or 'both' with the angular velocity; got {shown(use)}")
    words = {"true": True, "false": False}  # of a command
    return use, {key: words.get(value, value) if isinstance(value, str) else value for key, value in given.items()}


def of_keys(given: Mapping[Any, Any], keys: tuple[str, ...], name: str) -> dict[str, Any]:
    """Return a mapping of known keys."""
    for key in given:
        if not among(key, keys):
            raise ValueError(f"{name} has an unknown key {shown(key)}: {nearest(key, keys)}")
    return dict(given)


def _directed(value: Any, name: str, zero: str) -> tuple[Array, float]:
    """Return a direction and a length."""
    v = as_axis(value, name)
    largest = abs(v).max()
    if not largest > 0:
        raise ValueError(f"{name} is zero: {zero}")
    size = float(np.linalg.norm(v / largest))
    return v / largest / size, size * float(largest)
