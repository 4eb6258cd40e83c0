"""A fitted motion as a run file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.arrays import Array
from ..models.catalogue import heavy_top, standard

if TYPE_CHECKING:
    from .result import Fit, Part

SHARE = 0.5  # of the second moments along the centre: what an unknown mass takes of them


def as_run(fit: Fit, part: Part) -> dict[str, Any]:
    """Return the tables of a run file of the motion of one recording."""
    model, said = fit.solution.problem.model, "moments of inertia in parts of their sum"
    body: dict[str, Any] = {"kind": standard(fit.inertia).name, "inertia": fit.inertia.tolist()}
    start: dict[str, Any] = {"angular_velocity": {"body": part.start.tolist()}}
    if model.pivot is not None:
        n, _ = fit.centre
        mass, distance, said = model.pivot.mass, model.pivot.distance, "the heading at the start is arbitrary"
        if mass is None:  # m |c| = 1 kg m, |c| so short that a body has these second moments
            E = np.trace(fit.inertia) / 2 * np.eye(3) - fit.inertia
            distance = SHARE / float(n @ np.linalg.solve(E, n))
            mass, said = 1 / distance, "moments of inertia in units of m|c|; " + said
        weight = {"mass": mass, "centre_of_mass": (distance * n).tolist(), "gravity": [0.0, 0.0, -model.pivot.gravity]}
        body |= {"kind": heavy_top(fit.inertia, mass, distance * n).name, **weight}
        start["rotation"] = {"matrix": _upright(part.down).tolist()}
    run: dict[str, Any] = {"title": f"Motion as fitted; {said}", "body": body, "start": start}
    run["time"] = {"t_start": float(part.time[0]), "t_end": float(part.time[-1])}
    C, _ = fit.damping
    if C.any():
        run["load"] = [{"kind": "damping", "coefficient": C.tolist()}]
    return run


def _upright(down: Array) -> Array:
    """Return a rotation from body to space that takes `down`, in body components, to -z."""
    up = -down / np.linalg.norm(down)
    side = np.cross(up, np.eye(3)[int(np.argmin(abs(up)))])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(up, side), up])
