"""The cost of a stored step of order 2, over 1000 steps of 0.005 s.

"kernel" is the time of the compiled functions alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from nontwist import integrate, propagator, simulate, stepper
from nontwist.integrators import INTEGRATORS, IVP
from nontwist.loads import Load
from nontwist.models.stack import stacked

from .rows import Row
from .timing import kernel_calls, shuffled
from .workloads import Workload, workload

N = 1000
STEPPED = {"split": "AB", "lie-midpoint": "ABC", "energy-momentum": "ABC"}  # integrator, motions


def rows() -> list[Row]:
    """Measure all."""
    calls: dict[Any, Callable[[], Any]] = {}
    for name, keys in STEPPED.items():
        for key in keys:
            march = calls[name, key, "march"] = marching(name, key)
            kernel = kernel_calls(march)
            assert kernel is not None
            calls[name, key, "kernel"] = kernel
    times = {key: 1e9 * s / N for key, s in shuffled(calls, 15).items()}
    found = []
    for name, keys in STEPPED.items():
        for key in keys:
            found.append(Row(f"{name}, {key}: kernel", times[name, key, "kernel"], "ns/step"))
            found.append(Row("   march", times[name, key, "march"], "ns/step"))
    return [*found, *overhead()]


def problem(w: Workload) -> IVP:
    """Return the prepared problem, all steps stored."""
    start = np.eye(4)[3:], np.array([w.velocity], dtype=float)
    return IVP(stacked(w.system), *start, w.load or Load(), 0.0, w.t_end, N, np.arange(N + 1), intervals=True)


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
