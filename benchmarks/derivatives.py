"""Ten directions compared with the run without them, and a gradient by 1002 numbers.

The directions are the start (six), the principal moments of inertia and the duration, over 1000 steps. A propagator is
prepared and returns the end; `sensitivities` and `simulate` return datasets of all states.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from nontwist import body_moment, gradient, integrate, nontwisting, propagator, sensitivities, simulate

from .rows import Row
from .timing import shuffled
from .workloads import workload

SCHEMES = (("lie-midpoint", 2), ("energy-momentum", 2), ("gauss", 4), ("gauss", 8), ("gauss", 16))
TEN = ("material_angular_velocity", "rotation", "principal_inertia", "duration")
STEPS, STEP, LONG_STEP = 1000, 0.005, 0.05  # the long one for gauss of orders above 4
KNOTS, FINE = 334, 10_000


def rows() -> list[Row]:
    """Measure all."""
    return [*directions(), *table()]


def directions() -> list[Row]:
    """Measure ten directions over the run without them."""
    calls: dict[Any, Callable[[], Any]] = {}
    for name, order in SCHEMES:
        for key in "BCT":
            w, h = workload(key), LONG_STEP if order > 4 else STEP
            how = {"t_end": STEPS * h, "step": h, "integrator": name, "order": order, "load": w.load}
            start, case = {"material_angular_velocity": w.velocity}, (name, order, key)
            run = propagator(w.system, **how)
            calls[*case, "run"] = partial(run, **start)
            calls[*case, "jacobian"] = partial(run.jacobian, wrt=TEN, **start)
            calls[*case, "simulate"] = partial(simulate, w.system, **how, **start)
            calls[*case, "sensitivities"] = partial(sensitivities, w.system, wrt=TEN, **how, **start)
    times, found = shuffled(calls), []
    for top, below in (("jacobian", "run"), ("sensitivities", "simulate")):
        for name, order in SCHEMES:
            for key in "BCT":
                ratio = times[name, order, key, top] / times[name, order, key, below]
                words = "a propagator: Jacobian / run" if below == "run" else "sensitivities / simulate"
                found.append(Row(f"{name} {order}, {key}: {words}", ratio, "×"))
    return found


def table() -> list[Row]:
    """Measure the gradient of a function of the last state by a table of the load."""
    times = np.linspace(0, 5, KNOTS)
    push = body_moment(times, np.random.default_rng(0).normal(size=(KNOTS, 3)))
    how = {"t_end": 5, "step": 5 / FINE, "load": push, "store": "end", "material_angular_velocity": (6, -18, 0)}
    last, found = np.array([np.zeros(3), np.ones(3)]), []
    for name, order in (("lie-midpoint", 2), ("gauss", 4)):
        known = how | {"integrator": name, "order": order}
        both = shuffled(
            {
                "run": partial(integrate, nontwisting([3, 4, 5]), **known),
                "all": partial(gradient, nontwisting([3, 4, 5]), d_rotation=last, wrt="values", **known),
            }
        )
        what = f"{name} {order}, {FINE} steps: gradient by {3 * KNOTS} numbers / run"
        found.append(Row(what, both["all"] / both["run"], "×"))
    return found
