"""G2–G4: where the structure of the problem is used, against heyoka.py at the same error, ratios of times.

heyoka.py runs at the loosest tolerance that reaches the error. "kernel" counts the package's compiled functions alone.
What the package does not have yet is named, not measured.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Hashable
from importlib.util import find_spec
from typing import Any

import numpy as np

import nontwist
from nontwist import INTEGRATORS, integrate

from .peers import heyoka_end, heyoka_grid
from .rows import Row
from .timing import kernel_calls, shuffled
from .workloads import Array, Workload, attitude, workload

NOT_YET = "not measured: not there yet"
Timed = dict[Hashable, Callable[[], Any]]


def rows() -> list[Row]:
    """Measure all."""
    if find_spec("heyoka") is None:
        return [Row("G2, G3, G4", None, "×", note="heyoka.py is not installed")]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return [*free_end(), *outputs(), *loaded()]


def free_end() -> list[Row]:
    """G2: C from a new start to its end through `exact.free_standard`."""
    w = workload("C")
    goals = ((1e-9, 5, 30), (1e-13, 15, 80))
    label = "G2 C to {:.0e}: heyoka.py / exact.free_standard"
    exact = getattr(nontwist, "exact", None)
    if not hasattr(exact, "free_standard"):
        return [Row(label.format(t), None, "×", goal, note=NOT_YET) for t, goal, _ in goals]
    inertia, end = w.system.convected_inertia, np.array([w.t_end])

    def ours() -> Array:
        return exact.free_standard(inertia, w.velocity, end)[0][-1]  # type: ignore[union-attr]

    calls: Timed = {"ours": ours}
    kernel = kernel_calls(ours)
    if kernel is not None:
        calls["kernel"] = kernel
    for target, *_ in goals:
        calls[target] = heyoka_at(w, target)
    times = shuffled(calls, 15)
    error = w.error(ours())
    found = [Row("G2 error of exact.free_standard", error, "", 1e-13, True)]
    for target, goal, kernel_goal in goals:
        found.append(Row(label.format(target), times[target] / times["ours"], "×", goal))
        ratio = times[target] / times["kernel"] if "kernel" in times else None
        note = "" if ratio else "not measured: no compiled function is called"
        found.append(Row(f"   kernel, {target:.0e}", ratio, "×", kernel_goal, note=note))
    return found


def outputs() -> list[Row]:
    """G3: 1001 outputs of the free bodies through `integrate(..., integrator="exact")`."""
    found = []
    for key, target in (("C", 1e-13), ("A", 1e-12)):
        label = f"G3 {key}, 1001 outputs to {target:.0e}: heyoka.py / exact"
        if "exact" not in INTEGRATORS:
            found.append(Row(label, None, "×", 2, note=NOT_YET))
            continue
        w = workload(key)
        times = np.linspace(0, w.t_end, 1001)

        def ours(w: Workload = w, times: Array = times) -> Any:
            return integrate(w.system, times=times, material_angular_velocity=w.velocity, integrator="exact")

        found.append(against_grid(label, w, times, ours, target, 2))
    return found


def loaded() -> list[Row]:
    """G4: B with 1001 outputs through `integrate(..., integrator="split")`, and its compiled step to the end state."""
    labels = "G4 B, 1001 outputs to 1e-09: heyoka.py / split", "G4 B, end state to 1e-09: heyoka.py / kernel of split"
    w = workload("B")
    if "split" not in INTEGRATORS:
        return [Row(label, None, "×", goal, note=NOT_YET) for label, goal in zip(labels, (1.5, 5), strict=True)]

    def run(order: int, N: int, store: Any) -> Callable[[], Any]:
        common = {"t_end": w.t_end, "step": w.t_end / N, "load": w.load, "material_angular_velocity": w.velocity}
        return lambda: integrate(w.system, integrator="split", order=order, store=store, **common)

    times = np.linspace(0, w.t_end, 1001)
    stored = reaching(w, lambda N: [(o, run(o, N, N // 1000)) for o in INTEGRATORS["split"].orders], 1000)
    ends = reaching(w, lambda N: [(o, run(o, N, "end")) for o in INTEGRATORS["split"].orders], 10)
    found = [Row(labels[0], None, "×", 1.5, note="1e-9 not reached")]
    if stored:
        found = [against_grid(f"{labels[0]} {stored[0]}", w, times, stored[1], 1e-9, 1.5)]
    kernel = kernel_calls(ends[1]) if ends else None
    if kernel is None:
        return [*found, Row(labels[1], None, "×", 5, note="no compiled function is called")]
    seconds = shuffled({"ours": kernel, "theirs": heyoka_at(w, 1e-9)}, 15)
    return [*found, Row(labels[1], seconds["theirs"] / seconds["ours"], "×", 5)]


def reaching(
    w: Workload, calls: Callable[[int], list[tuple[int, Callable[[], Any]]]], first: int
) -> tuple[int, Callable[[], Any]] | None:
    """Return the order and the call that reach 1e-9 soonest, over numbers of steps that are `first` times 2^k."""
    found: dict[Hashable, tuple[int, Callable[[], Any]]] = {}
    N = first
    while N <= 64 * 1000:
        for order, call in calls(N):
            if order not in {o for o, _ in found.values()} and w.error(call().directors[-1].T) <= 1e-9:
                found[order, N] = order, call
        N *= 2
    if not found:
        return None
    seconds = shuffled({key: call for key, (_, call) in found.items()})
    return found[min(seconds, key=lambda key: seconds[key])]


def against_grid(label: str, w: Workload, times: Array, ours: Callable[[], Any], target: float, goal: float) -> Row:
    """Compare with heyoka.py at the loosest tolerance whose end state reaches the target."""
    error = w.error(ours().directors[-1].T)
    if error > target:
        return Row(label, None, "×", goal, note=f"missed: the error is {error:.1g}")
    for tol in 10.0 ** np.arange(-8, -16.1, -0.5):
        theirs = heyoka_grid(w, float(tol), times)
        if w.error(attitude(theirs()[-1])) <= target:
            seconds = shuffled({"ours": ours, "theirs": theirs}, 15)
            return Row(label, seconds["theirs"] / seconds["ours"], "×", goal)
    return Row(label, None, "×", goal, note="heyoka.py does not reach this error")


def heyoka_at(w: Workload, target: float) -> Callable[[], Any]:
    """Return heyoka.py to t_end at the loosest tolerance that reaches the target."""
    for tol in 10.0 ** np.arange(-4, -17.1, -0.5):
        call = heyoka_end(w, float(tol))
        if w.error(attitude(call())) <= target:
            return call
    return call
