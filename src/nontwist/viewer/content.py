"""The data of the page of a run or a recording: attitudes, twist, curves and the body.

Attitudes are those of a triad (t1, t2, n) fixed in the body whose third director is the axis n, the triad of
`nontwist.twist`; for n = E3 it is the body's own. The non-twisting frame (eq-non-twisting) is this triad turned back
about its third director by the twist angle ψ, so that quaternions and ψ determine both, and frame and ψ the triad: what
`twist` returns of a recording is enough for a page.

A box of mass m with the sides a_i has the Euler inertia E_i = m a_i²/12 (eq-euler-inertia): its sides are as √E_i, and
eigenvectors of E are its edges. The mass scales the box only; here its half diagonal is given. Of a body that weighs
the box is at the centre of mass where the run records it (`weight_of`).

The curves of the page: what is shown of a run over time, in which order, and with which units.

Angles are in degrees, as everywhere on the page. What is round-off of a quantity is zero: its digits say nothing, and a
curve of them would look like motion; angles are zero where they are less than the error of their sampling as well.
"""

from __future__ import annotations

import base64
import json
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..analysis.datasets import RUN, as_dataset, of_member
from ..analysis.joining import loads_in_words, parts_of
from ..analysis.trajectory import Trajectory
from ..geometry.arrays import Array, Dataset, as_array, as_positive
from ..geometry.attitudes import quaternions, turns
from ..geometry.frames import triad_about
from ..geometry.values import as_list, short_repr, vector_text
from ..loads.kinds import rotors_of
from ..loads.memory_terms import recorded_wheels
from ..models.bodies import BODIES
from ..models.system import DirectorSystem
from ..recordings.twisting import twist

POINTS = 2000  # of a curve
ROUND_OFF = 1e-10  # of the largest value of a quantity, or, for twists, of a radian


def panels(run: Dataset, twisted: Dataset) -> list[dict[str, Any]]:
    """Return the panels of a run, what tells of the twist first; of a recording the angles alone.

    Times count from the start.
    """
    time = twisted["time"].values - twisted["time"].values[0]
    psi, area = {"ψ": twisted["twist_angle"].values}, {"Ω": twisted["solid_angle"].values}
    angle = max(1.0, float(twisted["error_estimate"].max()) / ROUND_OFF) if "error_estimate" in twisted else 1.0
    found = [_panel(time, "Twist", "°", "", psi, angle, np.degrees(1.0))]
    if "spatial_momentum" not in run:
        return [*found, _panel(time, "Solid angle of the path", "°", "", area, angle, np.degrees(1.0))]
    pi, Pi = (run[name].values.T for name in ("spatial_momentum", "material_momentum"))
    K, V = run["kinetic_energy"].values, run["potential_energy"].values
    size = float(np.linalg.norm(Pi, axis=0).max())
    if "reaction_moment" in run:
        start = run["time"].values[0]
        mu, W = run["reaction_moment"], run["material_angular_velocity"].values
        scale = max(size * float(np.linalg.norm(W, axis=1).max()), float(abs(mu).max()))
        found.append(_panel(mu["midtime"].values - start, "Reaction moment", "N m", "", {"−μ": mu.values}, scale))
    if wheels := [momentum for _, momentum in momenta_of_rotors(run)]:
        h = {str(k + 1): values for k, values in enumerate(wheels[:3])} if len(wheels) > 1 else {"": wheels[0]}
        found.append(_panel(time, "Rotor momentum", "kg m²/s", "h", h, max(size, float(np.max(np.abs(wheels))))))
    energies, title = ({"K": K, "V": V, "K+V": K + V}, "Energy") if abs(V).max() > 0 else ({"K": K}, "Kinetic energy")
    return [
        *found,
        _panel(time, "Spatial momentum", "kg m²/s", "π", dict(zip("xyz", pi, strict=True)), size),
        _panel(time, "Material momentum", "kg m²/s", "Π", dict(zip("123", Pi, strict=True)), size),
        _panel(time, title, "J", "", energies, float((abs(K) + abs(V)).max())),
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


def momenta_of_rotors(run: Dataset) -> list[tuple[Array, Array]]:
    """Return the axis in the body and the momentum relative to it, at all times, of each rotor and wheel of a run."""
    records, times = json.loads(run.attrs.get("load", "[]")), run["time"].values
    rotors = [(one.direction, one.scale * one.history(times)[0]) for one in rotors_of(records).rotors]
    if "wheel_speed" not in run:
        return rotors
    speeds, wheels = run["wheel_speed"].transpose("wheel", "time").values, recorded_wheels(records)
    return rotors + [(one.axis, one.inertia * speed) for one, speed in zip(wheels, speeds, strict=True)]


PLACES = ("first", "second")
STATES = 5000  # attitudes
SLAB = (0.26, 0.46, 0.07)  # half sides of what is drawn for a recording, whose body nobody knows
NEEDED = ("directors", "spatial_momentum", "material_momentum", "kinetic_energy", "potential_energy")
FAR = 0.5  # rad: the motion between attitudes further apart is interpolated visibly


def contents(runs: Sequence[Any], labels: str | Sequence[str] | None = None) -> list[dict[str, Any]]:
    """Return the data of one run or of two, with these labels, or their titles, or names of bodies that differ.

    Raises
    ------
    ValueError
        As `content`, naming the run; or the labels are not one string for each run.
    """
    given = [labels] if isinstance(labels, str) else None if labels is None else as_list(labels, "labels")
    if given is not None and not (len(given) == len(runs) and all(isinstance(one, str) for one in given)):
        many = "two strings, one for each run" if len(runs) == 2 else "one string"
        raise ValueError(f"labels must be {many}, got {short_repr(labels)}")
    two = len(runs) == 2
    found = []
    for run, place in zip(runs, PLACES, strict=False):
        try:
            found.append(content(run))
        except ValueError as error:
            raise ValueError(f"the {place} run: {error}" if two else str(error)) from error
    titles, names = ([each[key] for each in found] for key in ("title", "name"))
    if given is not None:
        names = list(given)
    elif two and all(titles) and titles[0] != titles[1]:
        names = titles
    elif two and names[0] == names[1]:
        files = [Path(run.encoding["source"]).stem if "source" in getattr(run, "encoding", {}) else "" for run in runs]
        differ = all(files) and files[0] != files[1]
        which = files if differ else [f"{place} run" for place in PLACES]
        names = [f"{name}, {one}" for name, one in zip(names, which, strict=True)]
    for one, name in zip(found, names, strict=True):
        one["name"] = name
    return found


def content(run: Any) -> dict[str, Any]:
    """Return the data of one run, or of one recording; numbers in base64, float32, little-endian.

    Raises
    ------
    ValueError
        No run, twist result or motion of one body, or fewer than two states.
    """
    run = run.to_dataset() if isinstance(run, Trajectory) else run
    run = of_member(run)
    if "system" not in getattr(run, "attrs", {}):
        return _recording(run)
    run, system = _checked(run)
    first, last = run["time"].values[[0, -1]]
    n = np.array([0.0, 0.0, 1.0]) if system.axis is None else system.axis
    triad, twisted = triad_about(n), twist(run, axis=n)
    run = run.sel(time=twisted["time"])  # of states closer in time than round-off, the first
    attitudes = triad @ run["directors"].values
    box, weighing = box_of(system, run.attrs, triad)
    about = {
        "Body": body_in_words(system),
        "Load": "; ".join(loads_in_words(parts_of(run))),
        "Integrator": integrator_in_words(run.attrs),
        "Box": box,
    }
    data = _motion(run, twisted, attitudes, n, about)
    times, events = _shown(run["time"].values), run["t_events"].values if "t_events" in run.variables else np.empty(0)
    wheels = [
        {"axis": (triad @ axis).tolist(), "momentum": packed(np.interp(times, run["time"].values, momentum))}
        for axis, momentum in momenta_of_rotors(run)
    ]
    return data | {
        "title": tomllib.loads(run.attrs.get("run_file", "")).get("title", ""),
        "name": BODIES[system.name].words if system.name in BODIES else system.name,
        "watch": to_watch(system, len(wheels)),
        "rotors": wheels,
        "events": events[(events >= first) & (events <= last)].tolist(),
        **weighing,
    }


def _recording(motion: Any) -> dict[str, Any]:
    """Return the data of what `twist` has returned, or takes."""
    given = getattr(motion, "data_vars", {})
    twisted = motion if "twist_angle" in given and "frame" in given else _twisted(motion)
    twisted = as_dataset(twisted, "a result of twist", ("time",))
    if twisted["time"].attrs.get("units") != "s":
        raise ValueError("the recording has no times; use view(twist(motion, time))")
    if twisted.attrs.get("axis_frame", "body") != "body":
        raise ValueError("this is the twist about an axis fixed in space; the page shows axes fixed in the body")
    psi, frame = twisted["twist_angle"].values, twisted["frame"].values
    c, s = np.cos(psi)[:, None], np.sin(psi)[:, None]
    f1, f2, f3 = frame.swapaxes(0, 1)
    attitudes = np.stack([c * f1 + s * f2, c * f2 - s * f1, f3], axis=1)
    axis = np.array(twisted.attrs.get("axis", [0.0, 0.0, 1.0]))
    about = {
        "Motion": twisted.attrs.get("title", "a recording"),
        "Box": "generic, since a recording has no inertia: its longest edge need not be that of the body",
    }
    return _motion(twisted, twisted, attitudes, axis, about) | {
        "title": "",
        "name": "recorded motion",
        "watch": to_watch(None),
        "rotors": [],
        "events": [],
        "box": {"half": list(SLAB), "edges": np.eye(3).tolist(), "centre": [0.0, 0.0, 0.0]},
        "weight": None,
    }


def _twisted(motion: Any) -> Dataset:
    try:
        return twist(motion)
    except (TypeError, ValueError) as error:
        page = "; view(run).save(path) writes a page" * str(motion).endswith(".html")
        raise ValueError(
            "view accepts runs of simulate, read with open_run where they are files, recordings with their times, and "
            f"what twist returns for them; got {motion!r:.80} ({error}){page}"
        ) from error


def _motion(run: Dataset, twisted: Dataset, attitudes: Array, axis: Array, about: dict[str, str]) -> dict[str, Any]:
    """Return what runs and recordings have in common; `attitudes` are triads, rows, the third along the body `axis`."""
    time = twisted["time"].values
    if time.size < 2:
        raise ValueError("the run has a single state; nothing moves (simulate with store=1)")
    p = quaternions(attitudes)
    kept = _shown(np.arange(time.size))
    turn = turns(p[kept][:-1], p[kept][1:])
    angles, labels = {"twist": "twist_angle", "swing": "swing_twist_angle", "area": "solid_angle"}, ["d₁", "d₂", "d₃"]
    if not np.array_equal(axis, [0, 0, 1]):
        labels = ["t₁", "t₂", "n"]
        words = f"n: the body axis {vector_text(axis)}; t₁, t₂: fixed in the body, perpendicular to n"
        about = about | {"Arrows": words}
    return {
        "labels": labels,
        "about": about | {"States": _states_in_words(kept.size, time.size, float(turn.max()), "system" in run.attrs)},
        "thinned": bool(kept.size < time.size or turn.max() > FAR),
        "start": float(time[0]),
        "end": float(time[-1]),
        "turned": float(turn.sum()),
        "time": packed(time[kept] - time[0]),
        "attitude": packed(p[kept]),
        **{key: packed(twisted[name].values[kept]) for key, name in angles.items()},
        "panels": panels(run, twisted),
    }


def _shown(values: NDArray[Any]) -> NDArray[Any]:
    """Return those of as many values as states that the page shows."""
    which = np.linspace(0, values.size - 1, min(values.size, STATES)).round().astype(int)
    return values[np.unique(which)]


def _checked(run: Dataset) -> tuple[Dataset, DirectorSystem]:
    if "member" in run.dims:
        raise ValueError(f"this is an ensemble of {run.sizes['member']} runs; view(run.isel(member=0)) shows one")
    if lacking := [name for name in NEEDED if name not in run.variables]:
        raise ValueError(f"not a run of simulate: it lacks {', '.join(lacking)}")
    run = as_dataset(run, RUN, ("time", *NEEDED))
    if run.sizes["time"] < 2:
        raise ValueError("the run has a single state; nothing moves (simulate with store=1)")
    return run, DirectorSystem.from_json(run.attrs["system"])


def _states_in_words(count: int, stored: int, turn: float, is_run: bool) -> str:
    words = f"all {stored} shown" if count == stored else f"{count} of {stored} shown, evenly; curves keep every peak"
    if turn > FAR:
        words += (
            f". Between two of them the body turns by up to {turn:.2g} rad: the motion drawn in between is interpolated"
        )
        if count < stored:
            words += ". A part is shown in more detail: run.sel(time=slice(0, 10)), or --from 0 --to 10"
        elif is_run:
            words += ". More states: resample(run, times), or times= of simulate"
    return words


def as_script(data: dict[str, Any]) -> str:
    """Return JSON that is safe inside of a script element, whatever its strings hold."""
    return json.dumps(data, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")


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


def box_of(system: DirectorSystem, attrs: Mapping[str, Any], triad: Array) -> tuple[str, dict[str, Any]]:
    """Return what the box of a run is, in words, and the data of the box and of what weighs on it.

    They are in components of the triad, gravity in those of space.
    """
    down, centre, is_known = weight_of(system, attrs)
    inertia = system.euler_inertia - np.outer(centre, centre) if is_known else system.euler_inertia
    E, edges = np.linalg.eigh(inertia)
    E = np.maximum(E, 0.0)
    if is_known:
        words = "the inertia about the centre of mass, to which the line leads from the pivot"
        half, signs = np.sqrt(3 * E), np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
        scale = REACH / np.linalg.norm(centre + signs * half @ edges.T, axis=1).max()
        half, middle, end = scale * half, scale * centre, scale * centre
    else:
        words = "the inertia about the pivot; the line points to the centre of mass, at a distance that is not recorded"
        half, middle, end = HALF_DIAGONAL * np.sqrt(E / np.trace(inertia)), np.zeros(3), TOWARDS * centre
    turned = {"edges": edges.T @ triad.T, "centre": middle @ triad.T}
    box = {key: value.tolist() for key, value in ({"half": np.maximum(half, THINNEST)} | turned).items()}
    if down is None:
        return "the inertia of the body", {"box": box, "weight": None}
    return words, {"box": box, "weight": {"down": down.tolist(), "centre_of_mass": (end @ triad.T).tolist()}}


def weight_of(system: DirectorSystem, attrs: Mapping[str, Any]) -> tuple[Array | None, Array, bool]:
    """Return the direction of gravity in space, that of the centre of mass in the body, and whether this is √m ρ.

    Without mass and centre of mass, in the attributes of the run or else in its run file, gravity points towards -z, or
    else towards -y, -x. It is None where dead forces have more than one direction in space, or there are none.
    """
    left, size, right = np.linalg.svd(system.dead_force)
    if size[1] > SAME * size[0] or size[0] == 0:
        return None, np.zeros(3), False
    body: dict[str, Any] = tomllib.loads(attrs.get("run_file", "")).get("body", {})
    body |= {key: attrs[key] for key in FACTORS if key in attrs}
    if {"mass", "centre_of_mass"} <= body.keys():
        mass = float(as_positive(body["mass"], "mass", (), "kg"))
        rho = as_array(body["centre_of_mass"], "centre_of_mass", (3,))
        gravity = as_array(body.get("gravity", GRAVITY), "gravity", (3,))
        if abs(mass * np.outer(rho, gravity) - system.dead_force).max() <= SAME * size[0]:
            return gravity / np.linalg.norm(gravity), np.sqrt(mass) * rho, True
    first = next(x for x in right[0][::-1] if abs(x) > SAME)
    sign = -1.0 if first > 0 else 1.0
    return sign * right[0], sign * left[:, 0], False


# Descriptions of the body and the integrator of a run, from its attributes.


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
