"""A fitted motion as a run file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..geometry.arrays import Array
from ..models.catalogue import heavy_top, standard, suslov

if TYPE_CHECKING:
    from .result import Fit, Part

SHARE = 0.5  # of the second moments along the centre: what an unknown mass takes of them


def as_run(fit: Fit, part: Part) -> dict[str, Any]:
    """Return the tables of a run file of the motion of one recording."""
    model = fit.solution.problem.model
    said = "the rotor is a load" if model.wheel is not None else "moments of inertia in parts of their sum"
    J, W = fit.solution.unknowns.inertia * fit.size, part.start
    body: dict[str, Any] = {"kind": standard(J, physical=model.physical).name, "inertia": J.tolist()}
    if not model.physical:
        body["physical"] = False
    if model.constraint is not None:
        n = model.constraint
        body |= {"kind": suslov(J, n, physical=model.physical).name, "axis": n.tolist()}
        W = W - n * (n @ W)
    start: dict[str, Any] = {"angular_velocity": {"body": W.tolist()}}
    if len(part.attitude):
        start["rotation"] = {"matrix": Rotation.from_quat(part.attitude).as_matrix().tolist()}
    if model.pivot is not None:
        n, _ = fit.centre
        mass, distance, said = model.pivot.mass, model.pivot.distance, "the heading at the start is arbitrary"
        if mass is None:  # m |c| = 1 kg m, |c| so short that a body has these second moments
            E = np.trace(J) / 2 * np.eye(3) - J
            distance = SHARE / float(n @ np.linalg.solve(E, n))
            mass, said = 1 / distance, "moments of inertia in units of m|c|; " + said
        weight = {"mass": mass, "centre_of_mass": (distance * n).tolist(), "gravity": [0.0, 0.0, -model.pivot.gravity]}
        body |= weight
        if model.constraint is None:
            body["kind"] = heavy_top(J, mass, distance * n, physical=model.physical).name
        start["rotation"] = {"matrix": _upright(part.down).tolist()}
    if model.constraint is not None:
        said += "; the moment of inertia about the constrained axis is arbitrary"
    run: dict[str, Any] = {"title": f"Motion as fitted; {said}", "body": body, "start": start}
    run["time"] = {"t_start": float(part.time[0]), "t_end": float(part.time[-1])}
    loads: list[dict[str, Any]] = []
    C, _ = fit.damping
    if C.any():
        loads.append({"kind": "damping", "coefficient": C.tolist()})
    if model.wheel is not None and part.speed is not None:
        momentum = model.wheel.inertia * model.factor(fit.solution.unknowns.more) * part.speed[1]
        table = {"times": part.speed[0].tolist(), "values": momentum.tolist()}
        loads.append({"kind": "rotor", "axis": model.axis(fit.solution.unknowns.more).tolist(), **table})
    if loads:
        run["load"] = loads
    return run


def _upright(down: Array) -> Array:
    """Return a rotation from body to space that takes `down`, in body components, to -z."""
    up = -down / np.linalg.norm(down)
    side = np.cross(up, np.eye(3)[int(np.argmin(abs(up)))])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(up, side), up])
