"""The curves of the page: what is shown of a run over time, in which order, and with which units.

Angles are in degrees, as everywhere on the page. What is round-off of a quantity is zero: its digits say nothing, and a
curve of them would look like motion; angles are zero where they are less than the error of their sampling as well.
"""

from __future__ import annotations

import base64
import json
import tomllib
from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array, as_array, as_positive
from ..geometry.values import vector_text
from ..loads.kinds import rotors_of
from ..loads.wheels import columns_of
from ..models.bodies import BODIES
from ..models.system import DirectorSystem

if TYPE_CHECKING:
    import xarray

# What weighs on a body: the vertical, the centre of mass, and the box that hangs from the pivot.
#
# A run stores the dead forces f^i = m ρ_i g of the weight, not its factors. Where they have one direction in space,
# they determine the directions of g and ρ but for the sign of both, (ρ, g) or (-ρ, -g), and no length. A run of a run
# file records mass and centre of mass, stated or those of a shape; then E = E_c + m ρ ⊗ ρ gives the Euler inertia about
# the centre of mass, and all lengths but for a common factor 1/√m.

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


# Descriptions of the body and the integrator of a run, from its attributes.


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


POINTS = 2000  # of a curve
ROUND_OFF = 1e-10  # of the largest value of a quantity, or, for twists, of a radian


def panels(run: xarray.Dataset, twisted: xarray.Dataset) -> list[dict[str, Any]]:
    """Return the panels of a run, what tells of the twist first; of a recording the angles alone.

    Times count from the start.
    """
    time = twisted["time"].values - twisted["time"].values[0]
    psi, area = {"ψ": twisted["twist_angle"].values}, {"Ω": twisted["solid_angle"].values}
    angle = max(1.0, float(twisted["error_estimate"].max()) / ROUND_OFF) if "error_estimate" in twisted else 1.0
    found = [_panel(time, "Twist", "°", "", psi, angle, np.degrees(1.0))]
    if "spatial_momentum" not in run:
        return [*found, _panel(time, "Solid angle of the path", "°", "", area, angle, np.degrees(1.0))]
    pi, Pi = (run[name].transpose("time", ...).values.T for name in ("spatial_momentum", "material_momentum"))
    K, V = run["kinetic_energy"].values, run["potential_energy"].values
    size = float(np.linalg.norm(Pi, axis=0).max())
    if "reaction_moment" in run:
        start = run["time"].values[0]
        mu, W = run["reaction_moment"], run["material_angular_velocity"].transpose("time", ...).values
        scale = max(size * float(np.linalg.norm(W, axis=1).max()), float(abs(mu).max()))
        found.append(_panel(mu["midtime"].values - start, "Reaction moment", "N m", "", {"−μ": mu.values}, scale))
    if wheels := [momentum for _, momentum in momenta_of_rotors(run)]:
        h = {str(k + 1): values for k, values in enumerate(wheels[:3])} if len(wheels) > 1 else {"": wheels[0]}
        found.append(_panel(time, "Rotor momentum", "kg m²/s", "h", h, max(size, float(np.max(np.abs(wheels))))))
    energies = {"K": K, "V": V, "K+V": K + V} if abs(V).max() > 0 else {"K": K}
    return [
        *found,
        _panel(time, "Spatial momentum", "kg m²/s", "π", dict(zip("xyz", pi, strict=True)), size),
        _panel(time, "Material momentum", "kg m²/s", "Π", dict(zip("123", Pi, strict=True)), size),
        _panel(
            time, "Energy" if len(energies) > 1 else "Kinetic energy", "J", "", energies, float((abs(K) + abs(V)).max())
        ),
    ]


def _panel(
    time: Array, title: str, unit: str, letter: str, curves: dict[str, Array], scale: float, factor: float = 1.0
) -> dict[str, Any]:
    drawn = []
    for name, values in curves.items():
        kept = extremes(values)
        is_round_off = abs(values).max() < ROUND_OFF * scale  # all of it: a curve that grows out of it keeps its start
        clean = values[kept] * (0.0 if is_round_off else factor)
        symbol = {"letter": letter or name, "index": name if letter else ""}
        drawn.append({**symbol, "time": packed(time[kept]), "values": packed(clean)})
    return {"title": title, "unit": unit, "curves": drawn}


def extremes(y: Array) -> NDArray[np.int64]:
    """Return the indices of about `POINTS` points: both ends and the extremes of each section, so no peak is lost."""
    if y.size <= POINTS:
        return np.arange(y.size)
    ends = np.linspace(0, y.size, POINTS // 2).astype(int)
    kept = [a + extreme(y[a:b]) for a, b in pairwise(ends) for extreme in (np.argmin, np.argmax)]
    return np.unique([0, *kept, y.size - 1])


def packed(values: Array) -> str:
    """Return the numbers in base64, float32, little-endian."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")


def momenta_of_rotors(run: xarray.Dataset) -> list[tuple[Array, Array]]:
    """Return the axis in the body and the momentum relative to it, at all times, of each rotor and wheel of a run."""
    records, times = json.loads(run.attrs.get("load", "[]")), run["time"].values
    rotors = [(one.direction, one.scale * one.history(times)[0]) for one in rotors_of(records).rotors]
    if "wheel_speed" not in run:
        return rotors
    speeds, wheels = run["wheel_speed"].transpose("wheel", "time").values, columns_of(records)
    return rotors + [(one.axis, one.inertia * speed) for one, speed in zip(wheels, speeds, strict=True)]
