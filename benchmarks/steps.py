"""The cost of a stored step of order 2, over 1000 steps of 0.005 s, compared with the same step written by hand in C.

"kernel" is the time of the compiled functions alone. The C step is compiled with `cc -O3 -march=native`, solves to
round-off, and must agree with the package.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from nontwist import integrate, propagator, simulate, stepper
from nontwist.geometry.attitudes import director_velocities
from nontwist.geometry.attitudes import directors as directors_of
from nontwist.integrators import INTEGRATORS, Problem
from nontwist.loads import Load
from nontwist.models.stack import stacked

from .rows import Row
from .timing import kernel_calls, shuffled
from .workloads import Array, Workload, workload

N = 1000
# Integrator, motion, ns a step.
GOALS = (
    ("split", "A", 60),
    ("split", "B", 60),
    ("lie-midpoint", "A", 60),
    ("lie-midpoint", "B", 60),
    ("lie-midpoint", "C", 150),
    ("energy-momentum", "A", 150),
    ("energy-momentum", "B", 150),
    ("energy-momentum", "C", 250),
)
AS_C, AGREE = 1.5, 1e-10


def rows() -> list[Row]:
    """Measure all."""
    calls: dict[Any, Callable[[], Any]] = {}
    notes, differences = {}, []
    for name, key, _ in GOALS:
        if name not in INTEGRATORS or 2 not in INTEGRATORS[name].orders:
            notes[name, key] = "not measured: not there yet"
            continue
        march = marching(name, key)
        calls[name, key, "march"] = march
        kernel = kernel_calls(march)
        if kernel is None:
            notes[name, key] = "not measured: no compiled step yet"
        else:
            calls[name, key, "kernel"] = kernel
        c = in_c(name, workload(key))
        if isinstance(c, str):
            notes[name, key, "C"] = c
        else:
            differences.append(c(True)[1])
            calls[name, key, "C"], calls[name, key, "C, states only"] = c(True)[0], c(False)[0]
    times = {key: 1e9 * s / N for key, s in shuffled(calls, 15).items()}
    found = []
    for name, key, goal in GOALS:
        label, kernel = f"{name}, {key}", times.get((name, key, "kernel"))
        note = "" if kernel is not None else notes[name, key]
        found.append(Row(f"{label}: kernel", kernel, "ns/step", goal, at_most=True, note=note))
        c_time = times.get((name, key, "C"))
        ratio = kernel / c_time if kernel is not None and c_time is not None else None
        note = "" if ratio is not None else notes.get((name, key, "C"), notes.get((name, key), ""))
        found.append(Row(f"{label}: kernel / C", ratio, "×", AS_C, at_most=True, note=note))
        for part in ("march", "C", "C, states only"):
            if (name, key, part) in times:
                found.append(Row(f"   {part}", times[name, key, part], "ns/step"))
    if differences:
        found.append(Row("the C steps differ from the package's by at most", max(differences), "", AGREE, at_most=True))
    return [*found, *overhead()]


def problem(w: Workload) -> Problem:
    """Return the prepared problem, all steps stored."""
    start = np.eye(4)[3:], np.array([w.velocity], dtype=float)
    return Problem(stacked(w.system), *start, w.load or Load(), 0.0, w.t_end, N, np.arange(N + 1), intervals=True)


def marching(name: str, key: str) -> Callable[[], Any]:
    """Return the march of an integrator of order 2."""
    scheme, prepared = INTEGRATORS[name](order=2), problem(workload(key))  # type: ignore[call-arg]
    return lambda: scheme.march(prepared)


def overhead() -> list[Row]:
    """Return what calls cost that do next to nothing: 10 steps, end state only; a step of a closed loop; a dataset."""
    names = [name for name, cls in INTEGRATORS.items() if 2 in cls.orders]
    w = workload("C")
    calls = {
        name: lambda name=name: integrate(
            w.system,
            t_end=0.01,
            step=0.001,
            material_angular_velocity=w.velocity,
            integrator=name,
            order=2,
            store="end",
        )
        for name in names
    }
    how = {"material_angular_velocity": w.velocity}
    midpoint: dict[str, Any] = {"integrator": "lie-midpoint", "order": 2}
    thousand = {"t_end": 1, "step": 0.001, **midpoint, **how}
    once, loop = propagator(w.system, t_end=0.01, step=0.001, **midpoint), stepper(w.system, 1e-6)
    loop.reset(**how)
    others: dict[str, Callable[[], Any]] = {
        "propagator: a call of 10 steps": lambda: once(**how),
        "stepper: a step": loop.step,
        "integrate: 1000 steps, all stored": lambda: integrate(w.system, **thousand),
        "simulate: the same as a dataset": lambda: simulate(w.system, **thousand),
    }
    named = {f"integrate, {name}: a call of 10 steps": call for name, call in calls.items()}
    return [Row(name, 1e6 * s, "µs") for name, s in shuffled(named | others).items()]


@cache
def library() -> ctypes.CDLL | str:
    """Compile the C steps; the reason where that cannot be."""
    cc = shutil.which("cc")
    if cc is None:
        return "no C compiler"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "steps.so"
        source = Path(__file__).with_suffix(".c")
        command = [cc, "-O3", "-march=native", "-shared", "-fPIC", str(source), "-o", str(path), "-lm"]
        result = subprocess.run(command, capture_output=True, text=True)
        if result.returncode:
            return f"the C compiler failed: {result.stderr.splitlines()[0] if result.stderr else result.returncode}"
        return ctypes.CDLL(str(path))


def in_c(name: str, w: Workload) -> str | Callable[[bool], tuple[Callable[[], Any], float]]:
    """Return what gives the C run, with multipliers or without, and its difference from the package."""
    found = library()
    if isinstance(found, str):
        return found
    director_scheme = name == "energy-momentum"
    function = getattr(found, name.replace("-", "_"))
    function.restype = ctypes.c_long
    h, fixed = w.t_end / N, int(w.has_axis)
    body = np.ascontiguousarray(w.system.euler_inertia if director_scheme else w.system.convected_inertia)
    middles = (np.arange(N) + 0.5) * h
    moments = None if w.load is None else np.ascontiguousarray(w.load.sample(middles, "body"))
    start = np.cross(w.velocity, np.eye(3)) if director_scheme else np.array(w.velocity)
    p, velocity = np.empty(4), np.empty_like(start)
    columns = fixed + (6 if director_scheme else 0)
    directors, velocities, multipliers = np.empty((N, 3, 3)), np.empty((N, 3, 3)), np.zeros((N, columns))

    def run(with_multipliers: bool) -> tuple[Callable[[], Any], float]:
        arrays = (moments, p, velocity, directors, velocities, multipliers if with_multipliers and columns else None)
        addresses = [ctypes.c_void_p(None if a is None else a.ctypes.data) for a in arrays]
        size, step = ctypes.c_long(N), ctypes.c_double(h)
        inertia, axis = ctypes.c_void_p(body.ctypes.data), ctypes.c_int(fixed)

        def call() -> int:
            p[:], velocity[...] = (1, 0, 0, 0), start
            return int(function(size, step, inertia, axis, *addresses))

        if call() != N:
            raise RuntimeError(f"the C step of {name} failed on {w.key}")
        call.keep = (body, arrays)  # type: ignore[attr-defined]
        own = marching(name, w.key)()
        p_own, W, N_own, _ = own.states.part(0, slice(1, None))
        q = directors_of(p_own)
        difference = max(abs(directors - q).max(), relative(velocities, director_velocities(q, W, N_own)))
        if arrays[-1] is not None:
            difference = max(difference, relative(multipliers, own.intervals.multipliers[0]) / 10)
        return call, float(difference)

    return run


def relative(a: Array, b: Array) -> float:
    """Return the largest difference relative to the largest entry."""
    return float(abs(a - b).max() / max(1.0, abs(b).max()))
