"""What acts on a body that is fitted, as a caller states it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..geometry.arrays import Array, as_array, as_axis, as_direction, as_floats, as_number, as_positive
from ..geometry.values import among, nearest, shown
from .bodies import Model, Pivot, Wheel

G = 9.81
PIVOT = ("mass", "centre", "distance", "g")
WHEEL = ("axis", "inertia", "speed", "unit", "error")
COUNTS = {"one": 1, "three": 3}
ATTITUDES = ("use", "euler", "angle_unit", "scalar_first", "rotation_vector", "normalize", "inverse")


def as_model(gravity: Any, damping: Any, rotor: Any, constraint: Any) -> Model:
    """Return the model; a ValueError says what is wrong with its parts."""
    pivot = None if gravity is None else as_pivot(gravity)
    wheel = None if rotor is None else as_wheel(rotor)
    if pivot is not None and pivot.mass is None and wheel is not None:
        raise ValueError("gravity is 'unknown', but a rotor gives the scale: give mass and distance, or centre")
    axis = None
    if constraint is not None:
        axis, _ = _direction(constraint, "constraint", "it must be an axis of the body, about which it does not turn")
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
    given = _known(gravity, PIVOT, "gravity")
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
    c, distance = _direction(given["centre"], "gravity: centre", "the pivot is then the centre of mass, without moment")
    return Pivot(mass, distance, c, g)


def as_wheel(rotor: Any) -> Wheel:
    """Return a rotor, without its speed."""
    if not isinstance(rotor, Mapping):
        raise ValueError(f"rotor must be a mapping with axis, inertia and speed; got {shown(rotor)}")
    given = _known(rotor, WHEEL, "rotor")
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
    given = _known(given, ATTITUDES, "orientation")
    use = given.pop("use", "only")
    if not among(use, ("only", "both")):
        raise ValueError(f"orientation must be 'only', or 'both' with the angular velocity; got {shown(use)}")
    words = {"true": True, "false": False}  # of a command
    return use, {key: words.get(value, value) if isinstance(value, str) else value for key, value in given.items()}


def _known(given: Mapping[Any, Any], keys: tuple[str, ...], name: str) -> dict[str, Any]:
    """Return a mapping of known keys."""
    for key in given:
        if not among(key, keys):
            raise ValueError(f"{name} has an unknown key {shown(key)}: {nearest(key, keys)}")
    return dict(given)


def _direction(value: Any, name: str, zero: str) -> tuple[Array, float]:
    """Return a direction and a length."""
    v = as_axis(value, name)
    largest = abs(v).max()
    if not largest > 0:
        raise ValueError(f"{name} is zero: {zero}")
    size = float(np.linalg.norm(v / largest))
    return v / largest / size, size * float(largest)
