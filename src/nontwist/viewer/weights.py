"""What weighs on a body: the vertical, the centre of mass, and the box that hangs from the pivot.

A run stores the dead forces f^i = m ρ_i g of the weight, not its factors. Where they have one direction in space, they
determine the directions of g and ρ but for the sign of both, (ρ, g) or (-ρ, -g), and no length. The run file of a run
may state mass and centre of mass; then E = E_c + m ρ ⊗ ρ gives the Euler inertia about the centre of mass, and all
lengths but for a common factor 1/√m.
"""

from __future__ import annotations

import tomllib
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..geometry.arrays import Array
from ..models.catalogue import with_gravity
from ..models.system import DirectorSystem

HALF_DIAGONAL, THINNEST = 0.55, 0.03  # of the box; the sphere has the radius 1
REACH = 0.66  # of a box that hangs: its furthest corner from the pivot
TOWARDS = 0.62  # of the point in the direction of a centre of mass whose distance is not known
SAME = 1e-9


class Weight(NamedTuple):
    """The direction of gravity in space, that of the centre of mass in the body, and √m ρ where it is known."""

    down: Array
    towards: Array
    scaled: Array | None = None

    def box(self, system: DirectorSystem) -> dict[str, Array]:
        """Return the box of this body, and the centre of mass, in components of the body."""
        if self.scaled is None:
            return box_of(system.euler_inertia) | {"centre_of_mass": TOWARDS * self.towards}
        E, edges = np.linalg.eigh(system.euler_inertia - np.outer(self.scaled, self.scaled))
        half, centre = np.sqrt(3 * np.maximum(E, 0.0)), self.scaled
        signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
        scale = REACH / np.linalg.norm(centre + signs * half @ edges.T, axis=1).max()
        return {
            "half": np.maximum(scale * half, THINNEST),
            "edges": edges.T,
            "centre": scale * centre,
            "centre_of_mass": scale * centre,
        }


def box_of(euler_inertia: Array) -> dict[str, Array]:
    """Return half sides, edges as rows, and the middle of the box with an Euler inertia about it."""
    E, edges = np.linalg.eigh(euler_inertia)
    half = HALF_DIAGONAL * np.sqrt(np.maximum(E, 0.0) / np.trace(euler_inertia))
    return {"half": np.maximum(half, THINNEST), "edges": edges.T, "centre": np.zeros(3)}


def weight_of(system: DirectorSystem, run_file: str) -> Weight | None:
    """Return what weighs on a body whose dead forces have one direction in space; None for others.

    The run file decides the sign of gravity; without one it points towards -z, or else towards -y, -x.
    """
    left, size, right = np.linalg.svd(system.dead_force)
    if size[1] > SAME * size[0] or size[0] == 0:
        return None
    body: dict[str, Any] = tomllib.loads(run_file).get("body", {})
    if {"mass", "centre_of_mass"} <= body.keys():
        given = {key: body[key] for key in ("mass", "centre_of_mass", "gravity") if key in body}
        rho = np.array(given["centre_of_mass"], dtype=float)
        alone = with_gravity(replace(system, dead_force=np.zeros((3, 3))), **given).dead_force
        if abs(alone - system.dead_force).max() <= SAME * size[0]:
            down = rho @ system.dead_force
            return Weight(down / np.linalg.norm(down), rho / np.linalg.norm(rho), float(np.sqrt(given["mass"])) * rho)
    towards, down = left[:, 0], right[0]
    first = next(x for x in down[::-1] if abs(x) > SAME)
    sign = -1.0 if first > 0 else 1.0
    return Weight(sign * down, sign * towards)
