"""Many bodies at once, including the whole call of `simulate_ensemble`; shortest times of alternating calls.

heyoka.py integrates in batches, at the loosest tolerance that reaches the error on all bodies that are compared.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from nontwist import (
    DirectorSystem,
    heavy_top,
    integrate,
    lyapunov_ensemble,
    moment,
    simulate_ensemble,
    standard,
    suslov,
)

from .peers import heyoka_integrator, initial
from .rows import Row
from .timing import fastest, kernel_calls
from .workloads import Array, J, attitude, workload

MEMBERS, BODIES, STEPS, MANY, SEEN, LANES = 32768, 2048, 1000, 10**6, 256, 16
MIDPOINT: dict[str, Any] = {"integrator": "lie-midpoint", "order": 2}
Timed = dict[Hashable, Callable[[], Any]]


def rows() -> list[Row]:
    """Measure all."""
    return [*closed_forms(), *steps(), *gravity_gradients(), *exponents(), *threads(), *a_million(), *memory()]


def starts(key: str, members: int) -> Array:
    """Return random angular velocities."""
    plane = [1, 1, 0] if workload(key).has_axis else 1
    found: Array = np.random.default_rng(1).normal(scale=10, size=(members, 3)) * plane
    return found


def closed_forms() -> list[Row]:
    """Compare end states of free bodies with random starts, one core."""
    found = []
    for key in "CA":
        w, many = workload(key), starts(key, MEMBERS)
        how = {"t_end": w.t_end, "integrator": "exact", "threads": 1}
        ours = partial(simulate_ensemble, w.system, material_angular_velocity=many, **how)
        calls: Timed = {"ours": ours}
        few = partial(simulate_ensemble, w.system, material_angular_velocity=many[:1024], **how)
        label = f"{key}, {MEMBERS} bodies to 1e-09: heyoka.py in batches / simulate_ensemble"
        if find_spec("heyoka") is None:
            found.append(Row(label, None, "×", note="heyoka.py is not installed"))
        else:
            theirs, theirs_few = heyoka_reaching(key, many, ours().quaternion.values[:, -1])
            calls |= {"theirs": theirs, "few": few, "theirs, few": theirs_few}
        seconds = fastest(calls)
        if "theirs" in seconds:
            found.append(Row(label, seconds["theirs"] / seconds["ours"], "×"))
            found.append(Row("   the same with 1024 bodies", seconds["theirs, few"] / seconds["few"], "×"))
        found.append(Row(f"   closed form {key}: a body", 1e6 * seconds["ours"] / MEMBERS, "µs"))
        found.append(Row(f"   closed form {key}: members/s/core", MEMBERS / seconds["ours"], "1/s"))
    return found


def heyoka_reaching(key: str, many: Array, ends: Array) -> tuple[Callable[[], Array], Callable[[], Array]]:
    """Return heyoka.py on all starts and on 1024, at the loosest tolerance with errors below 1e-9 on some of them."""
    exact = [attitude(np.roll(p, 1)) for p in ends[:SEEN]]
    for tol in 10.0 ** np.arange(-6, -16.1, -0.5):
        found = heyoka_batches(key, many[:SEEN], float(tol))()
        errors = [np.linalg.norm(attitude(y) - R) / np.sqrt(2) for y, R in zip(found, exact, strict=True)]
        if max(errors) <= 1e-9:
            break
    return heyoka_batches(key, many, float(tol)), heyoka_batches(key, many[:1024], float(tol))


def heyoka_batches(key: str, many: Array, tol: float) -> Callable[[], Array]:
    """Return the loop over batches, as many bodies in each as the processor has lanes."""
    import heyoka as hy

    w, lanes = workload(key), hy.recommended_simd_size()
    y0 = np.tile(initial(w), (len(many), 1))
    y0[:, 4:] = many[:, : y0.shape[1] - 4]
    one = heyoka_integrator(w, tol)
    ta = hy.taylor_adaptive_batch(one.sys, np.ascontiguousarray(y0[:lanes].T), tol=tol)
    ends = [w.t_end] * lanes

    def run() -> Array:
        found = np.empty_like(y0)
        for k in range(0, len(y0), lanes):
            ta.state[:] = y0[k : k + lanes].T
            ta.set_time(0.0)
            ta.propagate_until(ends)
            found[k : k + lanes] = ta.state.T
        return found

    return run


def steps() -> list[Row]:
    """Compare steps of second order, on one core: ratios of the compiled functions, short calls that take turns."""
    cases: dict[str, tuple[DirectorSystem, Any, Any]] = {
        key: (workload(key).system, workload(key).velocity, workload(key).load) for key in "ABCT"
    }
    cases["Suslov body"] = suslov(J, [1, 2, 3]), (6.0, -18.0, 10.0), None
    calls: Timed = {}
    for name in ("lie-midpoint", "energy-momentum"):
        for case, (body, velocity, load) in cases.items():
            how = {"t_end": 5, "step": 5 / STEPS, "load": load, "integrator": name, "order": 2}
            W = np.array(velocity) * np.random.default_rng(2).uniform(0.9, 1.1, (LANES, 1))
            for key, call in {
                "lanes": partial(simulate_ensemble, body, material_angular_velocity=W, threads=1, **how),
                "alone": partial(integrate, body, material_angular_velocity=velocity, store="end", **how),
            }.items():
                kernel = kernel_calls(call)
                assert kernel is not None
                calls[name, case, key] = kernel
    times = fastest(calls, 60)
    found = []
    for name in ("lie-midpoint", "energy-momentum"):
        for case in cases:
            lanes, alone = 1e9 * times[name, case, "lanes"] / (LANES * STEPS), 1e9 * times[name, case, "alone"] / STEPS
            label = f"{name} 2, {case}: one at a time / {LANES} in lanes"
            found.append(Row(label, alone / lanes, "×"))
            found += [Row("   a step in lanes", lanes, "ns"), Row("   a step, one at a time", alone, "ns")]
    w, W = workload("C"), starts("C", BODIES)
    whole = partial(
        simulate_ensemble, w.system, t_end=5, step=5 / STEPS, **MIDPOINT, material_angular_velocity=W, threads=1
    )
    seconds = fastest({"whole": whole})["whole"]
    return [
        *found,
        Row(f"lie-midpoint 2, C, {BODIES} bodies, the whole call", 1e9 * seconds / (BODIES * STEPS), "ns/step"),
    ]


def gravity_gradient(t: float, d: Array, w: Array) -> tuple[float, float, float]:
    """Return the moment 3 n² r × J r of a circular orbit, J = diag(3, 4, 5), n = 0.1 rad/s."""
    x, y = np.cos(0.1 * t), np.sin(0.1 * t)
    a, b, c = d[0, 0] * x + d[0, 1] * y, d[1, 0] * x + d[1, 1] * y, d[2, 0] * x + d[2, 1] * y
    u, v, z = 0.03 * b * c, -0.06 * c * a, 0.03 * a * b
    return (
        u * d[0, 0] + v * d[1, 0] + z * d[2, 0],
        u * d[0, 1] + v * d[1, 1] + z * d[2, 1],
        u * d[0, 2] + v * d[1, 2] + z * d[2, 2],
    )


def gravity_gradients() -> list[Row]:
    """Measure a compiled load of the state in lanes: the kernel alone, and 120 steps of 10^5 bodies in two threads."""
    found, few, many = [], 512, 10**5
    W = np.random.default_rng(0).normal(scale=(0.5, 0.5, 5), size=(many, 3))
    for name in ("lie-midpoint", "energy-momentum"):
        body, load = standard([3, 4, 5]), moment(gravity_gradient, compiled=True)
        how = {"t_end": 0.6, "step": 0.005, "order": 2, "load": load, "integrator": name}
        run = partial(simulate_ensemble, body, **how)
        kernel = kernel_calls(partial(run, material_angular_velocity=W[:few], threads=1))
        assert kernel is not None
        calls: Timed = {"kernel": kernel, "whole": partial(run, material_angular_velocity=W, threads=2)}
        seconds = fastest(calls)
        label = f"gravity gradient, {name}"
        found.append(Row(f"{label}: a step and body", 1e9 * seconds["kernel"] / (few * 120), "ns"))
        found.append(Row(f"{label}: 10^5 bodies, 120 steps", seconds["whole"], "s"))
    return found


def exponents() -> list[Row]:
    """Measure a map of Lyapunov exponents of a heavy top, thrown at 3 rad/s, over 10^3 rad in steps of 0.3 rad."""
    rng, points, whole, count = np.random.default_rng(3), 64, 512, 3334
    W = rng.normal(size=(points**2, 3))
    W *= 3 / np.linalg.norm(W, axis=1, keepdims=True)
    top, span = heavy_top([1, 2, 2.5], mass=0.5, centre_of_mass=(0.3, 0, 0.4)), 1000 / 3
    how = {"t_end": span, "step": span / count, **MIDPOINT, "threads": 2}
    seconds = fastest({"map": partial(lyapunov_ensemble, top, material_angular_velocity=W, **how)}, 2)["map"]
    step, minutes = 1e9 * seconds / (points**2 * count), seconds * (whole / points) ** 2 / 60
    label = f"Lyapunov map of {whole} × {whole} throws, {count} steps, two threads: {points} × {points} of them, scaled"
    return [Row(label, minutes, "min"), Row("   a step and body, with its tangents", step, "ns")]


def threads() -> list[Row]:
    """How much quicker two threads are."""
    found = []
    w = workload("C")
    for label, how, members in (
        (f"C, {STEPS} steps of order 2", {"step": 5 / STEPS, **MIDPOINT}, 8 * BODIES),
        ("C, closed form", {"integrator": "exact"}, 4 * MEMBERS),
    ):
        W = starts("C", members)
        calls: Timed = {
            n: partial(simulate_ensemble, w.system, t_end=5, material_angular_velocity=W, threads=n, **how)  # type: ignore[arg-type]
            for n in (1, 2)
        }
        seconds = fastest(calls)
        found.append(Row(f"{label}: two threads / one", seconds[1] / seconds[2], "×"))
        found.append(Row("   members/s/core", members / seconds[1], "1/s"))
    return found


def a_million() -> list[Row]:
    """Take a million members of case 1 to their end states, two threads."""
    w, W = workload("A"), starts("A", MANY)
    how = {"t_end": 5, "material_angular_velocity": W, "threads": 2}
    calls: Timed = {
        "closed form": partial(simulate_ensemble, w.system, integrator="exact", **how),
        f"{STEPS} steps of order 2": partial(simulate_ensemble, w.system, step=5 / STEPS, **MIDPOINT, **how),
    }
    limits = (5, 60)
    seconds = fastest(calls, 2)
    return [
        Row(f"10^6 members of case 1, {key}, two threads", s, "s")
        for (key, s), limit in zip(seconds.items(), limits, strict=True)
    ]


def memory() -> list[Row]:
    """Peak of what a call takes beside its arguments, per million members, and the dataset itself."""
    import tracemalloc

    W, body = starts("A", MANY), workload("A").system
    few = {"step": 0.05, **MIDPOINT}
    everything = {"reduce": ["drift", "extrema", "averages", "total_twist"]}
    cases: dict[str, dict[str, Any]] = {
        "closed form, end state": {"integrator": "exact"},
        "steps, end state": few,
        "steps, end state and all statistics": {**few, **everything},
        "steps, all variables at the end": {**few, "variables": "all"},
    }
    found = []
    for label, how in cases.items():
        tracemalloc.start()
        many = simulate_ensemble(body, t_end=5, material_angular_velocity=W, **how)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        found.append(Row(f"memory for 10^6 members, {label}", peak / 1e6, "MB"))
        found.append(Row("   the dataset of it", many.nbytes / 1e6, "MB"))
    return found
