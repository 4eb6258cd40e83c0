"""How time and memory grow: with members, steps, outputs, parameters of a gradient, directions of a Jacobian.

Each is enlarged alone, from a size where the call itself no longer counts; the exponent is the slope of log time, or of
log memory, between the two largest sizes. 10^8 members cost 10^8 times a member, in blocks of what memory is at hand.
"""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from nontwist import body_moment, gradient, integrate, propagator, simulate_ensemble

from .rows import Row
from .timing import fastest
from .workloads import workload

DIRECTIONS = ("material_angular_velocity", "rotation", "principal_inertia")  # three of each
LAST = np.array([np.zeros(3), np.ones(3)])
SIZES = {
    "members": (2**13, 2**15, 2**17),
    "steps": (10**4, 10**5, 10**6),
    "outputs": (10**4, 10**5, 10**6),
    "parameters of a gradient": (300, 3000, 30_000),
    "directions of a Jacobian": (3, 6, 9),
}


def work(what: str, size: int) -> Callable[[], Any]:
    """Return a call in which one thing has a size."""
    w = workload("C")
    start = {"material_angular_velocity": w.velocity}
    if what == "members":
        W = np.array(w.velocity) * np.random.default_rng(1).uniform(0.9, 1.1, (size, 1))
        how = {"integrator": "lie-midpoint", "order": 2, "t_end": 0.5, "step": 0.005, "threads": 1}
        return partial(simulate_ensemble, w.system, material_angular_velocity=W, **how)
    if what == "steps":
        return partial(integrate, w.system, t_end=5, step=5 / size, store="end", **start)
    if what == "outputs":
        return partial(integrate, w.system, times=np.linspace(0, 5, size), step=0.01, **start)
    if what.startswith("parameters"):
        push = body_moment(np.linspace(0, 5, size // 3), np.random.default_rng(0).normal(size=(size // 3, 3)))
        how = {"t_end": 5, "step": 5 / 10_000, "load": push, "integrator": "lie-midpoint", "order": 2, "store": "end"}
        return partial(gradient, w.system, d_rotation=LAST, wrt="values", **how, **start)
    run = propagator(w.system, t_end=5, step=0.001, integrator="lie-midpoint", order=2)
    return partial(run.jacobian, wrt=DIRECTIONS[: size // 3], **start)


def rows() -> list[Row]:
    """Measure all."""
    found = []
    for what, sizes in SIZES.items():
        calls = {size: work(what, size) for size in sizes}
        seconds, peaks = fastest(calls, 3), {}
        for size, call in calls.items():
            tracemalloc.start()
            call()
            peaks[size] = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
        *_, few, many = sizes
        for name, of in (("time", seconds), ("memory", peaks)):
            slope = float(np.log(of[many] / of[few]) / np.log(many / few))
            found.append(Row(f"{what}: {name} grows with the power", slope, ""))
        found.append(Row(f"{what}: {many} of them", 1e3 * seconds[many], "ms"))
        found.append(Row(f"{what}: memory of these", peaks[many] / 1e6, "MB"))
    return found
