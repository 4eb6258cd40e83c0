r"""The bodies that are fitted: what acts on them, what is fitted, in which unit, and inertias as free numbers.

Their equations are those of `motions`, with a damping of one number or three, and a rotor of inertia I at the speed Ω,
I Ω its momentum.

**The unit.** Multiply J, m c, C and I by one number and the motion is the same. So J is fitted in a unit u. In free
motion nothing fixes it: u is tr J, and J has trace 1, five numbers. With a known moment m g |c|, or a rotor of known
momentum, J has six numbers, and u is any constant near tr J. Where m |c| is not known, u and J are in units of it, and
J/(m|c|) is a length.

**Inertias as free numbers.** A body has the second moments ``E = ∫ρ x xᵀ``, positive semidefinite, and
``J = tr(E) I - E``. With the mass and its moment they are those of a body where the pseudo-inertia
``[[E, m c], [m cᵀ, m]]`` is positive semidefinite. Its block Cholesky factor is ``[[L, √m c], [0, √m]]``, so
``E = m c cᵀ + L Lᵀ`` with L lower triangular and free, c given or itself fitted. Without a known mass the first term is
0, as m may be as small as one likes where m c is known. Of trace 1, ``tr E = 1/2``, and the entries of L are a
direction whose length does not count. All L are bodies, and all bodies are reached; on a flat one the diagonal of L has
a zero, and J is smooth there. Its derivative is not of full rank at such a body, so intervals never use L: they use J
itself. The equations alone ask for less than a body: any positive definite ``J = L Lᵀ``.

**A constraint.** Where a body may not turn about its axis n, ``n·J n`` has no part in the motion, and is no direction
in which J is fitted.

**Orientation.** Where attitudes are recorded their quaternion is part of the state (`measuring`).

**The axis of a rotor** is known, or fitted: (a, Ω) and (-a, -Ω) are one rotor, so its sign is that of the speed, which
the motion tells.

**The sign of the centre.** Its direction is known, or fitted. Then (n, γ) and (-n, -γ) give the same W: the sign is
not in a gyroscope's recording.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..geometry.arrays import Array, as_array, as_axis, as_direction, as_floats, as_number, as_positive
from ..geometry.attitudes import BASIS, ENTRIES
from ..geometry.values import among, nearest, short_repr
from ..machine import cached_property

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
TWICE = np.array([1, 1, 1, 2, 2, 2])  # as often are entries in the product of two symmetric matrices
ROWS, COLUMNS = zip(*ENTRIES, strict=True)
LOWER = np.tril_indices(3)
MIXED = np.eye(6) - 1 / 3  # a reflection: no number is one entry of L alone, whose slope may vanish
FLAT = 1e-4  # second moment, of tr J, below which no fit starts: on the wall of flat bodies L has no slope across it


def entries(J: Array) -> Array:
    """Return the six entries of a symmetric matrix, or of several, (..., 6)."""
    return J[..., ROWS, COLUMNS]


def symmetric(v: Array) -> Array:
    """Return the symmetric matrix of six entries, or of several."""
    return np.tensordot(v, BASIS, axes=(-1, 0))


def lower(v: Array) -> Array:
    """Return lower triangular matrices by six numbers, (..., 6)."""
    L = np.zeros((*v.shape[:-1], 3, 3))
    L[..., *LOWER] = v @ MIXED
    return L


def unit_vector(v: Array) -> Array:
    """Return a vector over its length; 0 as it is."""
    return v / max(float(np.linalg.norm(v)), 1e-300)


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


@dataclass(frozen=True)
class Model:
    """What acts on the body, and the unit of its inertia.

    `damping` is how many coefficients are fitted, 0, 1 or 3; `damped` are those that are known, (3,), N m s. Not
    `physical`, J is any positive definite matrix.
    """

    pivot: Pivot | None = None
    damping: int = 0
    damped: Array | None = None
    wheel: Wheel | None = None
    constraint: Array | None = None
    unit: float = 1.0
    oriented: bool = False
    physical: bool = True

    @cached_property
    def places(self) -> dict[str, slice]:
        """Where numbers lie that are fitted beside J: the directions n and a, a factor of I Ω, the damping over u."""
        counts = {
            "centre": 3 * (self.pivot is not None and self.pivot.direction is None),
            "axis": 3 * (self.wheel is not None and self.wheel.axis is None),
            "factor": int(self.wheel is not None and self.wheel.error > 0),
            "damping": self.damping,
        }
        ends = np.cumsum([*counts.values()]).tolist()
        return {name: slice(end - k, end) for (name, k), end in zip(counts.items(), ends, strict=True) if k}

    @property
    def more(self) -> int:
        """How many numbers are fitted beside J."""
        return max((place.stop for place in self.places.values()), default=0)

    @property
    def size(self) -> int:
        """How many numbers of a state are fitted where it starts: W, γ about a pivot, the quaternion of an attitude."""
        return 3 + 3 * (self.pivot is not None) + 4 * self.oriented

    @property
    def directions(self) -> list[slice]:
        """Which numbers of a state have the length 1 together: γ, and the quaternion."""
        first = 3 + 3 * (self.pivot is not None)
        return [slice(3, 6)] * (self.pivot is not None) + [slice(first, first + 4)] * self.oriented

    @property
    def directions_beside(self) -> list[slice]:
        """Which numbers beside J have the length 1 together."""
        return [self.places[name] for name in ("centre", "axis") if name in self.places]

    @property
    def is_absolute(self) -> bool:
        """Whether J has six numbers, not five."""
        return self.pivot is not None or self.wheel is not None

    @property
    def has_scale(self) -> bool:
        """Whether J follows in kg m²."""
        return self.wheel is not None or (self.pivot is not None and self.pivot.mass is not None)

    @property
    def is_damped(self) -> bool:
        """Whether there is damping, known or fitted."""
        return self.damping > 0 or self.damped is not None

    @property
    def is_free(self) -> bool:
        """Whether nothing acts on the body."""
        return not self.is_absolute and not self.is_damped

    @property
    def words(self) -> str:
        """How the body moves, in words."""
        acting = {"about a pivot": self.pivot, "with a rotor": self.wheel, "with a constraint": self.constraint}
        how = [words for words, one in acting.items() if one is not None]
        return " ".join(how + ["with damping"] * self.is_damped) or "freely"

    def direction(self, more: Array) -> Array:
        """Return the direction n of the centre; 0 without a pivot."""
        if self.pivot is None:
            return np.zeros(3)
        return more[self.places["centre"]] if self.pivot.direction is None else self.pivot.direction

    def axis(self, more: Array) -> Array:
        """Return the axis of the rotor; 0 without one."""
        if self.wheel is None:
            return np.zeros(3)
        return more[self.places["axis"]] if self.wheel.axis is None else self.wheel.axis

    def factor(self, more: Array) -> float:
        """Return the factor of the rotor's momentum."""
        return float(more[self.places["factor"]][0]) if "factor" in self.places else 1.0

    def damping_of(self, more: Array) -> Array:
        """Return the damping over the unit, (3,)."""
        if self.damped is not None:
            return self.damped / self.unit
        return np.broadcast_to(more[self.places["damping"]], (3,)) if self.damping else np.zeros(3)

    def in_unit(self, more: Array, factor: float) -> tuple[Model, Array]:
        """Return the model with a unit that is larger by a factor, and what is fitted beside J."""
        changed = more.copy()
        changed[len(more) - self.damping :] /= factor
        return replace(self, unit=self.unit * factor), changed

    @cached_property
    def basis(self) -> Array:
        """The directions in which J can change the motion, six entries each, in columns."""
        if self.constraint is None:
            return WHOLE if self.is_absolute else TRACELESS
        size = np.sqrt(TWICE)
        return np.asarray(np.linalg.svd((self.idle * size[:, None]).T)[2][1:].T / size[:, None])

    @property
    def idle(self) -> Array:
        """The directions in which J does not change the motion, six entries each, in columns."""
        if self.constraint is None:
            return np.zeros((6, 0))
        return entries(np.outer(self.constraint, self.constraint))[:, None]

    @property
    def weight(self) -> float:
        """The second moment m |c|² over the unit, 0 where it is not known."""
        if self.pivot is None or self.pivot.mass is None or not self.physical:
            return 0.0
        return self.pivot.mass * self.pivot.distance**2 / self.unit

    def centred(self, more: Array) -> Array:
        """Return m c cᵀ over the unit, which the second moments about the pivot exceed; 0 where it is not known."""
        return self.weight * np.outer(*[self.direction(more)] * 2) if self.weight else np.zeros((3, 3))

    def moments(self, J: Array) -> Array:
        """Return what is positive semidefinite of an inertia, or of several: E, or J itself."""
        return np.trace(J, axis1=-2, axis2=-1)[..., None, None] / 2 * np.eye(3) - J if self.physical else J

    def of_moments(self, E: Array) -> Array:
        """Return the inertia of second moments, or of several."""
        return np.trace(E, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - E if self.physical else E

    def thinnest(self, J: Array, more: Array) -> Array:
        """Return the smallest second moment beside m c cᵀ, or that of several inertias: negative beyond the wall."""
        return np.asarray(np.linalg.eigvalsh(self.moments(J) - self.centred(more))[..., 0])

    def nearest(self, J: Array, more: Array, least: float = FLAT) -> Array:
        """Return the closest inertia that a body can have, off the wall by a part of tr J."""
        centred = self.centred(more)
        values, vectors = np.linalg.eigh(self.moments(J) - centred)
        E = (vectors * np.maximum(values, least * abs(np.trace(J)))) @ vectors.T + centred
        found = self.of_moments(E)
        return found if self.is_absolute else found / np.trace(found)

    def cholesky(self, J: Array, more: Array, least: float = FLAT) -> Array:
        """Return the entries of L of the closest inertia that a body can have; of length 1 where J has trace 1."""
        E = self.moments(self.nearest(J, more, least)) - self.centred(more)
        return np.asarray(np.linalg.cholesky(E / self._share)[LOWER] @ MIXED)

    def inertia(self, v: Array, more: Array) -> tuple[Array, Array]:
        """Return J by the entries of L, and the derivatives of its entries by these and what is beside J, (6, k)."""
        E = self.centred(more) + self._share * lower(v) @ lower(v).T
        half = self._share * lower(np.eye(6)) @ lower(v).T
        slope = np.zeros((6, 6 + len(more)))
        slope[:, :6] = entries(self.of_moments(half + half.mT)).T
        if self.weight and "centre" in self.places:
            half = self.weight * np.eye(3)[:, :, None] * self.direction(more)
            slope[:, 6:9] = entries(self.of_moments(half + half.mT)).T
        return self.of_moments(E), slope

    @property
    def _share(self) -> float:
        """The trace of E where that of J is 1."""
        return 0.5 if self.physical else 1.0


def as_model(gravity: Any, damping: Any, rotor: Any, constraint: Any, physical: bool = True) -> Model:
    """Return the model; a ValueError says what is wrong with its parts."""
    pivot = None if gravity is None else as_pivot(gravity)
    wheel = None if rotor is None else as_wheel(rotor)
    if pivot is not None and pivot.mass is None and wheel is not None:
        raise ValueError("gravity is 'unknown', but a rotor gives the scale: give mass and distance, or centre")
    axis = None if constraint is None else as_direction(constraint, "constraint")
    if axis is not None and pivot is None and wheel is None:
        raise ValueError(
            "constraint needs gravity or a rotor: without them the motion does not determine the scale of the "
            "inertia, and nothing at all of a body that may not turn about a principal axis"
        )
    model = Model(pivot, wheel=wheel, constraint=axis, physical=physical)
    if damping is None:
        return model
    if isinstance(damping, str):
        if not among(damping, COUNTS):
            raise ValueError(f"damping must be 'one', 'three', or coefficients in N m s; got {short_repr(damping)}")
        return replace(model, damping=COUNTS[damping])
    shape = (3,) if as_floats(damping, "damping").ndim else ()
    C = np.ones(3) * as_array(damping, "damping", shape)
    if C.min() < 0:
        raise ValueError(f"damping must not be negative, got {C.min():g} N m s")
    if not model.has_scale:
        raise ValueError(
            f"damping is {short_repr(damping)} N m s, but nothing gives the scale of the inertia; use 'one' or "
            "'three' to fit the damping"
        )
    return replace(model, damped=C)


def as_pivot(gravity: Any) -> Pivot:
    """Return gravity about a pivot."""
    if isinstance(gravity, str) and gravity == "unknown":
        return Pivot(None, 1.0, None, G)
    if not isinstance(gravity, Mapping):
        raise ValueError(
            f"gravity must be a mapping with mass and centre or distance, or 'unknown'; got {short_repr(gravity)}"
        )
    given = of_keys(gravity, PIVOT, "gravity")
    g = float(as_positive(given.get("g", G), "gravity: g", (), "m/s²"))
    if "centre" in given and "distance" in given:
        raise ValueError("gravity has both centre and distance: the length of centre is the distance; leave one out")
    places = "centre" in given or "distance" in given
    if not (places and "mass" in given):
        lacks = "centre or distance" if "mass" in given else "mass" if places else "mass, and centre or distance"
        raise ValueError(f"gravity lacks {lacks}; if unknown, use 'unknown' to fit J/(m|c|)")
    mass = float(as_positive(given["mass"], "gravity: mass", (), "kg"))
    if "distance" in given:
        return Pivot(mass, float(as_positive(given["distance"], "gravity: distance", (), "m")), None, g)
    c = as_axis(given["centre"], "gravity: centre")
    if not (distance := float(np.linalg.norm(c))) > 0:
        raise ValueError("gravity: centre is zero: the pivot is then the centre of mass, without moment")
    return Pivot(mass, distance, c / distance, g)


def as_wheel(rotor: Any) -> Wheel:
    """Return a rotor, without its speed."""
    if not isinstance(rotor, Mapping):
        raise ValueError(f"rotor must be a mapping with axis, inertia and speed; got {short_repr(rotor)}")
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
        raise ValueError(
            f"orientation must be 'only', 'both', or a mapping with how to read it; got {short_repr(given)}"
        )
    given = of_keys(given, ATTITUDES, "orientation")
    use = given.pop("use", "only")
    if not among(use, ("only", "both")):
        raise ValueError(f"orientation must be 'only', or 'both' with the angular velocity; got {short_repr(use)}")
    words = {"true": True, "false": False}  # of a command
    return use, {key: words.get(value, value) if isinstance(value, str) else value for key, value in given.items()}


def of_keys(given: Mapping[Any, Any], keys: tuple[str, ...], name: str) -> dict[str, Any]:
    """Return a mapping of known keys."""
    for key in given:
        if not among(key, keys):
            raise ValueError(f"{name} has an unknown key {short_repr(key)}: {nearest(key, keys)}")
    return dict(given)
