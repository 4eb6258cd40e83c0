"""The cost of a stored step of order 2, over 1000 steps of 0.005 s, and of calls that do next to nothing."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from nontwist import integrate, propagator, simulate, stepper
from nontwist.integrators import INTEGRATORS

from .rows import Row
from .timing import shuffled
from .workloads import workload

STEPS = 1000
STEPPED = {"split": "AB", "lie-midpoint": "ABC", "energy-momentum": "ABC"}  # integrator, motions
ONE_STEP: dict[str, Any] = {"integrator": "lie-midpoint", "order": 2}


def rows() -> list[Row]:
    """Measure all."""
    calls: dict[Any, Callable[[], Any]] = {}
    for name, keys in STEPPED.items():
        for key in keys:
            w = workload(key)
            run = propagator(w.system, t_end=5, step=5 / STEPS, integrator=name, order=2, load=w.load, store=1)
            calls[f"{name}, {key}: a stored step"] = partial(run, material_angular_velocity=w.velocity)
    return [*(Row(name, 1e9 * s / STEPS, "ns") for name, s in shuffled(calls, 15).items()), *overhead()]


def overhead() -> list[Row]:
    """Return the cost of 10 steps with the end state, of a step of a closed loop, and of a dataset."""
    w = workload("C")
    start = {"material_angular_velocity": w.velocity}
    ten = {"t_end": 0.01, "step": 0.001, "store": "end"}
    thousand = {"t_end": 1, "step": 0.001, **ONE_STEP, **start}
    once, hundred = (propagator(w.system, t_end=k * 0.001, step=0.001, store="end", **ONE_STEP) for k in (10, 100))
    loop, top = stepper(w.system, 1e-6), workload("T")
    loop.reset(**start)
    calls: dict[Any, Callable[[], Any]] = {
        f"integrate, {name}: a call of 10 steps": partial(integrate, w.system, **ten, **start, integrator=name, order=2)
        for name, cls in INTEGRATORS.items()
        if 2 in cls.orders
    }
    calls |= {
        "propagator: a call of 10 steps": partial(once, **start),
        "propagator: a call of 100 steps": partial(hundred, **start),
        "stepper: a step": loop.step,
        "integrate: 1000 steps, all stored": partial(integrate, w.system, **thousand),
        "simulate: the same as a dataset": partial(simulate, w.system, **thousand),
        "simulate: heavy top, 5 s, no step": partial(
            simulate, top.system, t_end=5, material_angular_velocity=top.velocity
        ),
    }
    found = shuffled(calls)
    ten_alone, more = found["propagator: a call of 10 steps"], found["propagator: a call of 100 steps"]
    beside = Row("propagator: a call beside its steps", 1e6 * (ten_alone - (more - ten_alone) / 9), "µs")
    return [*(Row(name, 1e6 * s, "µs") for name, s in found.items()), beside]
