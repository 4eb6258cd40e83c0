"""The way back from a `Problem` to a run file: its objects as tables.

A term of the load has its fields as keys, and a body its J, so the file makes the same numbers; of a J of more than 14
digits, which a body does not keep, up to round-off. Of a
weight that nobody gave as such a constant force on the directors is known, m c ⊗ g: of such a matrix of rank one, g is
taken of length 9.81 m/s² and m as 1 kg, or, where J is too small for that, so large that m |c|² is nothing.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import numpy as np

from ..driver.named_events import NamedEvent
from ..driver.problem import Problem, prepared
from ..geometry.arrays import Array
from ..geometry.values import as_path
from ..integrators import INTEGRATORS
from ..io.whole import written
from ..loads import LOADS, Term, as_load
from ..loads.terms import EVER, Pulse
from ..models.bodies import BODIES
from ..models.system import DirectorSystem, as_system
from ..spec import specs
from . import body
from .document import RunFile, checked
from .files import Folder, plain
from .load_tables import TABLES, keys_of

FALL, RANK, LIGHT, DIGITS = 9.81, 1e-12, 1e-10, 14


def write(problem: Problem, path: str | os.PathLike[str], force: bool = False) -> None:
    """Write a problem as a run file; errors as `Problem.write`."""
    place = as_path(path, "path")
    if place.suffix != ".toml":
        raise ValueError(f"a run file has the suffix .toml, got {place.name!r}")
    made = file_of(problem, place)
    with written(place, force=force) as file:
        file.write(made.text().encode())


def file_of(problem: Problem, place: Path) -> RunFile:
    """Return the run file that says what a problem says; a ValueError where it has what none can say."""
    if problem.file is not None:
        file: RunFile = problem.file
        if file.folder.resolve() == place.parent.resolve():
            return file
        if file.sweep is not None:
            raise ValueError(f"a sweep is written into the folder of its file, {file.folder}, alone")
    system = as_system(problem.system)
    begin, events = (made := prepared(problem)).begin, made.events
    start: dict[str, Any] = {"angular_velocity": {"body": begin.velocity[0].tolist()}}
    if not np.array_equal(begin.quaternion[0], [0, 0, 0, 1]):
        start["rotation"] = {"quaternion": begin.quaternion[0].tolist(), "order": "xyzw"}
    if begin.internal is not None:
        raise ValueError("start= has internal states of wheels or memory, which a run file takes from a run alone")
    plan = made.plan
    time = {"t_start": plan.t_start, "t_end": plan.t_end, "times": plan.output_times}
    time |= {key: getattr(problem, key) for key in ("step", "tolerance", "store")}
    tables = {
        "body": body_table(system),
        "start": start,
        "load": [load_table(term) for term in as_load(problem.load).terms],
        "time": {key: plain(value) for key, value in time.items() if value is not None},
        "integrator": integrator_table(problem),
        "event": [event_table(one.function) for one in events],
    }
    return checked(str(place), tables, Folder(place.parent))


def body_table(system: DirectorSystem) -> dict[str, Any]:
    """Return the table of a body: of the first kind, that of its name before others, that makes this body."""
    own = system.name.split(" ")[0]
    for kind in sorted((name for name in BODIES if name not in body.TABLES), key=lambda name: name != own):
        table = _table_of(kind, system)
        with suppress(ValueError):
            made = body.Body.model_validate(table).system(Folder(Path()))
            pairs = ((getattr(made, name), getattr(system, name)) for name in ("axis", "inertia", "dead_force"))
            if (made.spin is None) == (system.spin is None) and all(_is_same(*pair) for pair in pairs):
                return table
    raise ValueError(f"no kind of run files makes the body {system.name!r}")


def _is_same(made: Array | None, own: Array | None) -> bool:
    if made is None or own is None:
        return made is own
    return bool(abs(made - own).max() <= RANK * abs(own).max())


def _table_of(kind: str, system: DirectorSystem) -> dict[str, Any]:
    table: dict[str, Any] = {"kind": kind, "inertia": _inertia(system).tolist()}
    if "axis" in BODIES[kind].takes and system.axis is not None:
        table["axis"] = system.axis.tolist()
    if not system.physical:
        table["physical"] = False
    if (spin := system.spin) is not None:
        turning = {"times": spin.times.tolist(), "values": spin.values.tolist()}
        table["spin"] = turning if spin.times.size > 1 else float(spin.values[0])
    if system.weight and system.dead_force.any():
        table |= system.weight
    elif system.dead_force.any():
        left, sizes, right = np.linalg.svd(system.dead_force)
        if sizes[1] > RANK * sizes[0]:
            raise ValueError("the body has forces on several directors, as no weight has: a run file has none")
        first = sizes[0] * left[:, 0] / FALL  # m c
        held = np.linalg.eigvalsh(system.euler_inertia - np.outer(first, first))[0] >= 0
        mass = 1.0 if held else float(first @ first / (LIGHT * np.trace(system.inertia)))
        table |= {"mass": mass, "centre_of_mass": (first / mass).tolist(), "gravity": (FALL * right[0]).tolist()}
    return table


def _inertia(system: DirectorSystem) -> Array:
    """Return J as it was given where it had at most 14 digits, so that it makes the same E, bit for bit."""
    J = system.inertia
    last = DIGITS - 1 - int(np.floor(np.log10(abs(J).max())))
    short = np.array([[round(x, last) for x in row] for row in J.tolist()])
    is_same = np.array_equal(np.trace(short) / 2 * np.eye(3) - short, system.euler_inertia)
    return short if is_same else J


def load_table(term: Term) -> dict[str, Any]:
    """Return the table of a term of the load."""
    kind = next(kind for kind, cls in LOADS.items() if cls is type(term))
    is_known = kind in TABLES
    if not is_known or any(callable(getattr(term, one.name)) for one in fields(term)):
        what = f"a load of the kind {kind}" + " with a function" * is_known
        raise ValueError(f"{what} has no place in a run file; save the run instead")
    table = {"kind": kind} | ({} if term.scale == 1 else {"scale": term.scale})
    if isinstance(term, Pulse) and (term.start, term.end) == (-EVER, EVER):
        return table | {"kind": "constant", "frame": term.frame, "moment": plain(term.pulse)}
    if kind == "rotor" and np.size(term.times) == 1:  # type: ignore[attr-defined]
        return table | {"axis": plain(term.rotor), "momentum": float(term.values[0])}  # type: ignore[attr-defined]
    known = {"damping": "coefficient", "rotor": "axis"} if kind in ("damping", "rotor") else keys_of(type(term))
    for name, (_, default, _) in specs(type(term)).items():
        value = getattr(term, name)
        if value is not None and (default is MISSING or not np.array_equal(value, default)):
            table[known.get(name, name)] = plain(value)
    return table


def integrator_table(problem: Problem) -> dict[str, Any]:
    """Return the table of the integrator: its name, its order, and its other options where they are no defaults."""
    scheme, order = problem.integrator, problem.order
    if isinstance(scheme, str):
        return {"name": scheme} | ({} if order is None else {"order": int(order)})
    if INTEGRATORS.get(scheme.name) is not type(scheme):
        raise ValueError(f"INTEGRATORS has no entry for {type(scheme).__name__}")
    own = {one.name: getattr(scheme, one.name) for one in fields(scheme) if getattr(scheme, one.name) != one.default}
    order = getattr(scheme, "order", None) if scheme.orders else None
    options = {key: plain(value) for key, value in own.items() if key != "order"}
    table: dict[str, Any] = {"name": scheme.name} | ({} if order is None else {"order": int(order)})
    return table | ({"options": options} if options else {})


def event_table(event: Any) -> dict[str, Any]:
    """Return the table of an event that `axis_crosses` or `spin_below` made."""
    if not isinstance(event, NamedEvent):
        raise ValueError("an event that is a function has no place in a run file: axis_crosses, spin_below have")
    table = {"kind": event.kind, "name": event.__name__, "terminal": plain(event.terminal)}
    table["direction"] = int(np.sign(event.direction))
    own = {key: plain(value) for key, value in event.keys.items() if value is not None}
    return table | own
