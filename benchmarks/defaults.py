"""The cost of each method over that of the cheapest at the same error: the reason for the default.

Problems are generated: bodies of every kind that turn by 0.1 to 60 rad under up to three loads, whose kinks are nodes.
The number of steps is increased by a third at a time until the error at the end is 1e-12; the reference is `gauss` 16.
In parentheses: on how many problems the method is the cheapest.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from nontwist.driver.grid import stretches_of
from nontwist.driver.planning import planned
from nontwist.driver.starts import start_of_one
from nontwist.integrators import INTEGRATORS, Integrator

from .rows import Row, Table, digits

sys.path.append(str(Path(__file__).parent.parent / "tests"))  # where problems are generated
from tolerance_problems import generated

PROBLEMS = 40
TARGETS = (1e-3, 1e-6, 1e-9, 1e-12)
LONGEST, MOST = 0.02, 60_000  # seconds and steps beyond which none is tried
GROWTH, PASSES = 4 / 3, 3
State = tuple[Any, Any]


def rows() -> list[Row]:
    """Return what the default costs."""
    name = f"gauss {INTEGRATORS['gauss']().order}"  # type: ignore[attr-defined]
    return [
        Row(f"{name} at {target:.0e}: cost over the cheapest method", median(name, target), "×") for target in TARGETS
    ]


def tables() -> list[Table]:
    """Return the cost of every method."""
    names = sorted({name for costs in measure() for name in costs}, key=lambda name: (name.split()[0], len(name), name))
    cells = []
    for name in names:
        found = [median(name, target) for target in TARGETS]
        wins = [sum(cheapest(costs, k) == name for costs in measure()) for k in range(len(TARGETS))]
        shown = ["–" if np.isinf(cost) else digits(cost) for cost in found]
        cells.append([name, *(f"{cost} ({count})" for cost, count in zip(shown, wins, strict=True))])
    header = ["method", *(f"at {target:.0e}" for target in TARGETS)]
    title = f"cost, median of {len(measure())} problems (on how many the cheapest)"
    return [Table(title, header, cells)]


def cheapest(costs: dict[str, list[float]], k: int) -> str:
    """Return the cheapest method at a target."""
    return min(costs, key=lambda name: costs[name][k])


def median(name: str, target: float) -> float:
    """Return the median over problems of the cost of a method, relative to the cheapest."""
    k = TARGETS.index(target)
    return float(np.median([costs[name][k] / costs[cheapest(costs, k)][k] for costs in measure() if name in costs]))


@cache
def measure() -> list[dict[str, list[float]]]:
    """Return the seconds in which each method reaches the targets, for each problem; infinite where it does not."""
    methods = [cls(order=k) for name, cls in INTEGRATORS.items() if name != "continuous" for k in cls.orders]  # type: ignore[call-arg]
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for seed in range(PROBLEMS):
            problem = Generated(seed)
            costs = {f"{method.name} {method.order}": problem.seconds(method) for method in methods}  # type: ignore[attr-defined]
            found.append({name: seconds for name, seconds in costs.items() if seconds is not None})
    return found


class Generated:
    """A generated problem, with the state at its end."""

    def __init__(self, seed: int) -> None:
        self.task = task = generated(seed)
        start = task.start
        W = start["material_angular_velocity"]
        self.begin = start_of_one(task.body, None, start["rotation"], None, W, None, start["project"])
        steps, before, self.truth = 16, None, None
        while self.truth is None:
            state = self.run(INTEGRATORS["gauss"](order=16), steps)[0]  # type: ignore[call-arg]
            if state is not None and before is not None and (distance(state, before) < 1e-13 or steps > MOST):
                self.truth = state
            before, steps = state, 2 * steps

    def run(self, method: Integrator, steps: int, passes: int = 1) -> tuple[State | None, float, int]:
        """Return the state at the end, the least seconds, and the number of steps; None where the run fails."""
        task = self.task
        grid = stretches_of(task.load, 0.0, task.t_end, task.t_end / steps)
        plan = planned(task.body, task.load, method, None, 0.0, task.t_end, None, None, "end")
        problem = replace(plan.problem(self.begin, grid, np.array([0, grid.steps])), intervals=True)
        march, best = method.prepared(problem), np.inf
        for _ in range(passes):
            start = perf_counter()
            found, squares, _ = march(self.begin.quaternion[0], self.begin.velocity[0], 1.0)
            best = min(best, perf_counter() - start)
        if squares == np.inf:
            return None, best, grid.steps
        states = march.read(found)["states"]
        return (states.quaternion[-1], states.velocity[-1]), best, grid.steps

    def seconds(self, method: Integrator) -> list[float] | None:
        """Return the seconds to each target, above which all finer steps stay; None where the body is not taken."""
        steps, found = 2.0, []
        while True:
            try:
                state, time, taken = self.run(method, round(steps), PASSES)
            except ValueError:
                return None
            found.append((time, np.inf if state is None else distance(state, self.truth)))
            if found[-1][1] < TARGETS[-1] or time > LONGEST or taken > MOST:
                break
            steps = max(steps * GROWTH, steps + 1)
        return [self._within(found, target) for target in TARGETS]

    @staticmethod
    def _within(found: list[tuple[float, float]], target: float) -> float:
        coarse = max((k for k, (_, error) in enumerate(found) if error > target), default=-1)
        return min((time for time, _ in found[coarse + 1 :]), default=np.inf)


def distance(a: State, b: State) -> float:
    """Return the angle between two attitudes, or the distance of the velocities relative to their size."""
    (p, V), (q, W) = a, b
    chord = min(np.linalg.norm(p - q), np.linalg.norm(p + q))
    speed = max(np.linalg.norm(V), np.linalg.norm(W), 1e-300)
    return float(max(4 * np.arcsin(min(1, chord / 2)), np.linalg.norm(V - W) / speed))
