"""Descriptions of the body and the integrator of a run, from its attributes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..geometry.arrays import Array
from ..geometry.values import vector_text
from ..models.bodies import BODIES
from ..models.system import DirectorSystem
from .weights import Weight

SLAB_IN_WORDS = "generic, since a recording has no inertia: its longest edge need not be that of the body"


def name_in_words(system: DirectorSystem) -> str:
    """Return the name of the body."""
    return BODIES[system.name].words if system.name in BODIES else system.name


def body_in_words(system: DirectorSystem) -> str:
    """Return constraint, principal moments and dead forces."""
    moments = np.linalg.eigvalsh(system.convected_inertia)
    words = f"principal moments {', '.join(f'{J:.4g}' for J in moments)} kg m²"
    if system.axis is None:
        words = f"free to turn; {words}"
    else:
        axis = "d₃" if np.array_equal(system.axis, [0, 0, 1]) else f"the body axis {vector_text(system.axis)}"
        turning = f"no spin about {axis}"
        if system.spin is not None:
            rate = f"{system.spin.values[0]:.4g} rad/s" if system.spin.is_constant else "given by a table"
            turning = f"prescribed spin about {axis}: {rate}"
        words = f"{turning}; {words}"
    return words + ("; gravity" if system.dead_force.any() else "")


def box_in_words(weight: Weight | None) -> str:
    """Return what the box of a run is, and where it is."""
    if weight is None:
        return "the inertia of the body"
    if weight.scaled is None:
        return "the inertia about the pivot; the line points to the centre of mass, at a distance that is not recorded"
    return "the inertia about the centre of mass, to which the line leads from the pivot"


def arrows_in_words(axis: Array) -> dict[str, str]:
    """Return what the arrows are where they are not the directors."""
    if np.array_equal(axis, [0, 0, 1]):
        return {}
    return {"Arrows": f"n: the body axis {vector_text(axis)}; t₁, t₂: fixed in the body, perpendicular to n"}


def to_watch(system: DirectorSystem | None, rotors: int = 0) -> str:
    """Return a sentence on what to watch, and what its rotors are; None stands for a recording."""
    if rotors:
        wheels = "wheel is its rotor, the arrow" if rotors == 1 else f"{rotors} wheels are its rotors, the arrows"
        momentum = "its momentum" if rotors == 1 else "their momenta"
        return f"{to_watch(system)} The {wheels} h {momentum} relative to the body."
    if system is None:
        return (
            "The wedge is the twist: the angle by which the body has turned about its axis, relative to a non-twisting "
            "frame."
        )
    if system.axis is None:
        return "The body may turn about its own axis: the wedge is its twist, relative to a non-twisting frame."
    axis = "d₃" if np.array_equal(system.axis, [0, 0, 1]) else "n"
    if system.spin is not None:
        rate = "at a prescribed rate, enforced by the reaction moment"
        return f"The body turns about {axis} {rate}. The wedge is its twist."
    return f"The body may not turn about {axis}: the wedge remains closed. The reaction moment enforces this."


def integrator_in_words(attrs: Mapping[str, Any]) -> str:
    """Return the integrator, its options and the step."""
    options = json.loads(attrs.get("integrator", "{}"))
    words = [str(options.pop("name", "not recorded"))]
    words += [f"{key} {value}" for key, value in options.items() if value]
    if "step" in attrs:
        words.append(f"step {float(attrs['step']):.6g} s")
    return ", ".join(words)
