"""A run in words: its body, load and integrator, from the record that it carries."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..models.bodies import BODIES
from ..models.system import DirectorSystem

LONGEST = 60  # characters of a value that was given as data


def name_in_words(system: DirectorSystem) -> str:
    """Return what the body is called."""
    return BODIES[system.name].words if system.name in BODIES else system.name


def body_in_words(system: DirectorSystem) -> str:
    """Return constraint, principal moments and dead forces."""
    moments = np.linalg.eigvalsh(system.convected_inertia)
    words = f"principal moments {', '.join(f'{J:.4g}' for J in moments)} kg m²"
    if system.axis is None:
        words = f"free to turn; {words}"
    else:
        axis = "d₃" if np.array_equal(system.axis, [0, 0, 1]) else f"the body axis {_vector(system.axis)}"
        words = f"no turning about {axis}; {words}"
    return words + ("; gravity" if system.dead_force.any() else "")


def load_in_words(load: str) -> str:
    """Return the terms of a load, from the JSON that a run carries."""
    return "; ".join(_term(term) for term in json.loads(load)) or "none"


def integrator_in_words(attrs: Mapping[str, Any]) -> str:
    """Return the integrator, its options and the step."""
    options = json.loads(attrs.get("integrator", "{}"))
    words = [str(options.pop("name", "not recorded"))]
    words += [f"{key} {value}" for key, value in options.items() if value is not None]
    if "step" in attrs:
        words.append(f"step {float(attrs['step']):.6g} s")
    return ", ".join(words)


def _term(term: dict[str, Any]) -> str:
    term, kind, scale = dict(term), term.get("kind"), float(term.get("scale", 1.0))
    along = {"body": "along the directors", "space": "along fixed axes"}.get(str(kind), "")
    if "pulse" in term:
        span = f"from {term['start']:.4g} to {term['end']:.4g} s"
        return f"{term['shape']} pulse {_vector(term['pulse'], scale)} N m {along}, {span}"
    if "sine" in term:
        phase = f", phase {term['phase']:.4g} rad" if term["phase"] else ""
        return f"sine {_vector(term['sine'], scale)} N m {along}, {term['frequency']:.4g} Hz{phase}"
    if "damping" in term:
        C = scale * np.array(term["damping"])
        isotropic = np.array_equal(C, C[0, 0] * np.eye(3))
        return f"damping {C[0, 0]:.4g} N m s" if isotropic else "damping by a matrix"
    if "times" in term:
        return f"table of {len(term['times'])} moments {along}"
    rest = ", ".join(f"{key} {value}" for key, value in term.items() if key not in ("kind", "scale"))
    return f"{'' if scale == 1 else f'{scale:.4g} × '}{rest[:LONGEST]} {along}".strip()


def _vector(v: Any, scale: float = 1.0) -> str:
    return f"({', '.join(f'{scale * float(x):.4g}' for x in v)})".replace("-", "−")
