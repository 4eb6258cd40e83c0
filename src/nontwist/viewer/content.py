"""The data of the page of a run: attitudes, twist, curves and the body.

Attitudes are those of a triad (t1, t2, n) fixed in the body whose third director is the axis n, the triad of
`nontwist.twist`; for n = E3 it is the body's own. The non-twisting frame (eq-non-twisting) is this triad turned back
about its third director by the twist angle ψ, so that quaternions and ψ determine both.

A box of mass m with the sides a_i has the Euler inertia E_i = m a_i²/12 (eq-euler-inertia): its sides are as √E_i, and
eigenvectors of E are its edges. The mass scales the box only; here its half diagonal is given.
"""

from __future__ import annotations

import base64
import json
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..analysis.datasets import RUN, as_dataset
from ..analysis.trajectory import Trajectory
from ..analysis.twisting import twist
from ..geometry.arrays import Array
from ..geometry.attitudes import quaternions
from ..geometry.directors import triad_about
from ..loads.terms import load_in_words
from ..models.system import DirectorSystem
from .words import body_in_words, integrator_in_words, name_in_words

if TYPE_CHECKING:
    import xarray

STATES, POINTS = 5000, 2000  # attitudes, and points of a curve; with two runs and Plotly this stays below 6 MB
HALF_DIAGONAL, THINNEST = 0.55, 0.03  # of the box; the sphere has the radius 1
NEEDED = ("directors", "spatial_momentum", "material_momentum", "kinetic_energy", "potential_energy")
FAR = 0.5  # rad: the motion between attitudes further apart is interpolated visibly


def content(run: xarray.Dataset | Trajectory) -> dict[str, Any]:
    """Return the data of one run; numbers in base64, float32, little-endian.

    Raises
    ------
    ValueError
        Not a run of one body, or fewer than two states.
    """
    run, system = _checked(run.to_dataset() if isinstance(run, Trajectory) else run)
    n = np.array([0.0, 0.0, 1.0]) if system.axis is None else system.axis
    twisted = twist(run, axis=n)
    time, q = run["time"].values, run["directors"].transpose("time", "director", "axis").values
    own = np.array_equal(n, [0, 0, 1])
    triad = triad_about(n)
    p = quaternions(triad @ q)
    shown = np.unique(np.linspace(0, time.size - 1, min(time.size, STATES)).round().astype(int))
    turn = 2 * np.arccos(np.minimum(abs(np.sum(p[shown][1:] * p[shown][:-1], axis=1)), 1.0))
    return {
        "name": name_in_words(system),
        "about": {
            "Body": body_in_words(system),
            "Load": load_in_words(json.loads(run.attrs.get("load", "[]"))),
            "Integrator": integrator_in_words(run.attrs),
            "States": _states_in_words(shown.size, time.size, float(turn.max())),
        },
        "labels": ["d₁", "d₂", "d₃"] if own else ["t₁", "t₂", "n"],
        "thinned": bool(shown.size < time.size or turn.max() > FAR),
        "start": float(time[0]),
        "end": float(time[-1]),
        "turned": float(turn.sum()),
        "time": _packed(time[shown] - time[0]),
        "attitude": _packed(p[shown]),
        "twist": _packed(twisted["twist_angle"].values[shown]),
        "box": _box(system, triad),
        "panels": [_panel(time - time[0], *panel) for panel in _panels(run, twisted)],
    }


def _checked(run: xarray.Dataset) -> tuple[xarray.Dataset, DirectorSystem]:
    if not hasattr(run, "data_vars"):
        raise ValueError(f"view takes runs of simulate, read with open_run where they are files; got {run!r:.80}")
    if lacking := [name for name in NEEDED if name not in run.data_vars] + ["system"] * ("system" not in run.attrs):
        raise ValueError(f"not a run of simulate: it lacks {', '.join(lacking)}")
    if "member" not in run.dims:
        as_dataset(run, RUN, ("time", *NEEDED))
    else:
        raise ValueError(f"this is an ensemble of {run.sizes['member']} runs; view(run.isel(member=0)) shows one")
    if run.sizes["time"] < 2:
        raise ValueError("the run has a single state; nothing moves (simulate with store=1)")
    return run, DirectorSystem.from_json(run.attrs["system"])


def _panels(run: xarray.Dataset, twisted: xarray.Dataset) -> list[tuple[str, str, str, dict[str, Array]]]:
    pi, Pi = (run[name].values.T for name in ("spatial_momentum", "material_momentum"))
    K, V = run["kinetic_energy"].values, run["potential_energy"].values
    energies = {"K": K, "V": V, "K+V": K + V} if abs(V).max() > 0 else {"K": K}
    return [
        ("Spatial momentum", "kg m²/s", "π", dict(zip("xyz", pi, strict=True))),
        ("Material momentum", "kg m²/s", "Π", dict(zip("123", Pi, strict=True))),
        ("Energy" if len(energies) > 1 else "Kinetic energy", "J", "", energies),
        ("Twist", "rad", "", {"ψ": twisted["twist_angle"].values}),
    ]


def _panel(time: Array, title: str, unit: str, letter: str, curves: dict[str, Array]) -> dict[str, Any]:
    packed = []
    for name, values in curves.items():
        kept = _extremes(values)
        symbol = {"letter": letter or name, "index": name if letter else ""}
        packed.append({**symbol, "time": _packed(time[kept]), "values": _packed(values[kept])})
    return {"title": title, "unit": unit, "curves": packed}


def _extremes(y: Array) -> NDArray[np.int64]:
    """Return the indices of about `POINTS` points: both ends and the extremes of each section, so no peak is lost."""
    if y.size <= POINTS:
        return np.arange(y.size)
    ends = np.linspace(0, y.size, POINTS // 2).astype(int)
    kept = [a + extreme(y[a:b]) for a, b in pairwise(ends) for extreme in (np.argmin, np.argmax)]
    return np.unique([0, *kept, y.size - 1])


def _box(system: DirectorSystem, triad: Array) -> dict[str, list[Any]]:
    """Half sides, and edges as rows in the components of the triad."""
    E, edges = np.linalg.eigh(system.euler_inertia)
    half = np.sqrt(np.maximum(E, 0.0) / np.trace(system.euler_inertia))
    half = np.maximum(HALF_DIAGONAL * half, THINNEST)
    return {"half": half.tolist(), "edges": (triad @ edges).T.tolist()}


def _packed(values: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")


def _states_in_words(shown: int, stored: int, turn: float) -> str:
    words = f"all {stored} shown" if shown == stored else f"{shown} of {stored} shown, evenly; curves keep every peak"
    if turn > FAR:
        words += (
            f". Between two of them the body turns by up to {turn:.2g} rad: the motion drawn in between is "
            "interpolated. A part of the run shows more: run.sel(time=slice(0, 10))"
        )
    return words


def as_script(data: dict[str, Any]) -> str:
    """Return JSON that is safe inside of a script element, whatever its strings hold."""
    return json.dumps(data, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
