"""The curves of the page: what is shown of a run over time, in which order, and with which units.

Angles are in degrees, as everywhere on the page. What is round-off of a quantity is zero: its digits say nothing, and a
curve of them would look like motion; angles are zero where they are less than the error of their sampling as well.
"""

from __future__ import annotations

import base64
import json
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..loads.kinds import rotors_of
from ..loads.wheels import columns_of

if TYPE_CHECKING:
    import xarray

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


def extremes(y: Array, most: int = POINTS) -> NDArray[np.int64]:
    """Return the indices of about `most` points: both ends and the extremes of each section, so no peak is lost."""
    if y.size <= most:
        return np.arange(y.size)
    size = -(-y.size // (most // 2 - 1))
    sections = np.append(y, np.full(-y.size % size, np.nan)).reshape(-1, size)
    low = np.where(np.isnan(sections), np.inf, sections).argmin(axis=1)
    high = np.where(np.isnan(sections), -np.inf, sections).argmax(axis=1)
    first = np.arange(len(sections)) * size
    return np.unique(np.concatenate([first + low, first + high, [0, y.size - 1]]))


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
