"""The cost of each method over that of the cheapest at the same error: the reason for the default.

Problems are generated: bodies of every kind that turn by 0.1 to 60 rad under up to three loads, whose kinks are nodes.
The number of steps of a propagator is increased by a third at a time until the error at the end is 1e-12; the reference
is `gauss` 16 with so many steps that twice as many change nothing.
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from nontwist import propagator
from nontwist.errors import SimulationError
from nontwist.integrators import INTEGRATORS

from .rows import Row

sys.path.append(str(Path(__file__).parent.parent / "tests"))  # where problems are generated
from tolerance_problems import generated

PROBLEMS = 40
TARGETS = (1e-3, 1e-6, 1e-9, 1e-12)
LONGEST, MOST = 0.02, 60_000  # seconds and steps beyond which none is tried
GROWTH, PASSES = 4 / 3, 3


def rows() -> list[Row]:
    """Return what every method costs at each error, and on how many problems it is the cheapest."""
    methods = [(name, order) for name, cls in INTEGRATORS.items() if name != "continuous" for order in cls.orders]
    costs = np.array([costs_of(generated(seed), methods) for seed in range(PROBLEMS)])  # (problem, method, target)
    relative, found = costs / costs.min(axis=1, keepdims=True), []
    for m, (name, order) in enumerate(methods):
        for k, target in enumerate(TARGETS):
            cost, wins = float(np.median(relative[:, m, k])), int(np.sum(relative[:, m, k] == 1))
            label = f"{name} {order} at {target:.0e}: cost over the cheapest method"
            found.append(Row(label, cost if np.isfinite(cost) else None, "×", f"the cheapest {wins} times"))
    return found


def costs_of(task: Any, methods: list[tuple[str, int]]) -> list[list[float]]:
    """Return the seconds in which each method reaches the targets; infinite where it does not."""
    truth, before, steps = ended(task, "gauss", 16, 16)[0], np.inf, 16
    while distance(truth, before) > 1e-13 and steps <= MOST:
        steps *= 2
        before, truth = truth, ended(task, "gauss", 16, steps)[0]
    return [[least(explored(task, *method, truth), target) for target in TARGETS] for method in methods]


def ended(task: Any, name: str, order: int, steps: int, passes: int = 1) -> tuple[Any, float]:
    """Return the quaternion and the velocity at the end and the least seconds; infinite where the run fails."""
    how = {"t_end": task.t_end, "step": task.t_end / steps, "load": task.load, "integrator": name, "order": order}
    run, best, found = propagator(task.body, project=True, **how), np.inf, np.inf
    for _ in range(passes):
        begin = perf_counter()
        try:
            end = run(**{key: value for key, value in task.start.items() if key != "project"})
        except SimulationError:
            return np.inf, np.inf
        best = min(best, perf_counter() - begin)
        found = end.states.quaternion[-1], end.states.velocity[-1]
    return found, best


def explored(task: Any, name: str, order: int, truth: Any) -> list[tuple[float, float]]:
    """Return seconds and errors of more and more steps; none where the body is not taken."""
    steps, found = 2.0, []
    while not found or (found[-1][1] >= TARGETS[-1] and found[-1][0] <= LONGEST and steps <= MOST):
        try:
            end, seconds = ended(task, name, order, round(steps), PASSES)
        except ValueError:
            return []
        found.append((seconds, distance(end, truth)))
        steps = max(steps * GROWTH, steps + 1)
    return found


def least(found: list[tuple[float, float]], target: float) -> float:
    """Return the least seconds to a target, above which all finer steps stay."""
    coarse = max((k for k, (_, error) in enumerate(found) if error > target), default=-1)
    return min((seconds for seconds, _ in found[coarse + 1 :]), default=np.inf)


def distance(a: Any, b: Any) -> float:
    """Return the angle between two attitudes, or the distance of the velocities relative to their size."""
    if a is np.inf or b is np.inf:
        return np.inf
    (p, V), (q, W) = a, b
    chord = min(np.linalg.norm(p - q), np.linalg.norm(p + q))
    speed = max(np.linalg.norm(V), np.linalg.norm(W), 1e-300)
    return float(max(4 * np.arcsin(min(1, chord / 2)), np.linalg.norm(V - W) / speed))
