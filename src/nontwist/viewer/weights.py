"""What weighs on a body: the vertical, the centre of mass, and the box that hangs from the pivot.

A run stores the dead forces f^i = m ρ_i g of the weight, not its factors. Where they have one direction in space, they
determine the directions of g and ρ but for the sign of both, (ρ, g) or (-ρ, -g), and no length. A run of a run file
records mass and centre of mass, stated or those of a shape; then E = E_c + m ρ ⊗ ρ gives the Euler inertia about the
centre of mass, and all lengths but for a common factor 1/√m.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..geometry.arrays import Array, as_array, as_positive
from ..models.system import DirectorSystem

HALF_DIAGONAL, THINNEST = 0.55, 0.03  # of the box; the sphere has the radius 1
REACH = 0.66  # of a box that hangs: its furthest corner from the pivot
TOWARDS = 0.62  # of the point in the direction of a centre of mass whose distance is not known
SAME = 1e-9
FACTORS, GRAVITY = ("mass", "centre_of_mass", "gravity"), (0.0, 0.0, -9.81)


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


def weight_of(system: DirectorSystem, attrs: Mapping[str, Any]) -> Weight | None:
    """Return what weighs on a body whose dead forces have one direction in space; None for others.

    The attributes of the run, or its run file alone, decide the sign of gravity; without them it points towards -z, or
    else towards -y, -x.
    """
    left, size, right = np.linalg.svd(system.dead_force)
    if size[1] > SAME * size[0] or size[0] == 0:
        return None
    body: dict[str, Any] = tomllib.loads(attrs.get("run_file", "")).get("body", {})
    body |= {key: attrs[key] for key in FACTORS if key in attrs}
    if {"mass", "centre_of_mass"} <= body.keys():
        mass = float(as_positive(body["mass"], "mass", (), "kg"))
        rho = as_array(body["centre_of_mass"], "centre_of_mass", (3,))
        gravity = as_array(body.get("gravity", GRAVITY), "gravity", (3,))
        if abs(mass * np.outer(rho, gravity) - system.dead_force).max() <= SAME * size[0]:
            return Weight(gravity / np.linalg.norm(gravity), rho / np.linalg.norm(rho), np.sqrt(mass) * rho)
    towards, down = left[:, 0], right[0]
    first = next(x for x in down[::-1] if abs(x) > SAME)
    sign = -1.0 if first > 0 else 1.0
    return Weight(sign * down, sign * towards)
