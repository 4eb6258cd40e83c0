"""Many bodies at once, the whole call of `simulate_ensemble`; shortest times of alternating calls.

heyoka.py integrates in batches of its widest vectors, a batch after the other on every core that ours takes, at the
loosest tolerance that reaches the error on all bodies that are compared; ours at the largest step that does.
"""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np

from nontwist import moment, propagator, simulate_ensemble, standard

from .peers import heyoka_integrator, initial
from .rows import Row
from .timing import fastest
from .workloads import Array, Workload, attitude, workload

MEMBERS, STEPS, MANY, SEEN, LANES = 32768, 1000, 10**6, 128, 512
MIDPOINT: dict[str, Any] = {"integrator": "lie-midpoint", "order": 2}
Timed = dict[Hashable, Callable[[], Any]]
Ends = Callable[[], Array]


def rows() -> list[Row]:
    """Measure all."""
    return [*against_heyoka(), *lanes(), *gravity_gradients(), *threads(), *memory()]


def starts(key: str, members: int) -> Array:
    """Return random angular velocities: free bodies of any, those under a load of about their own."""
    w, rng = workload(key), np.random.default_rng(1)
    plane = [1, 1, 0] if w.has_axis else 1
    if w.mass or w.knots:
        return w.velocity * rng.uniform(0.9, 1.1, (members, 3))
    found: Array = rng.normal(scale=10, size=(members, 3)) * plane
    return found


def against_heyoka() -> list[Row]:
    """Compare end states with random starts: free bodies on one core, bodies under loads on all that there are."""
    found = []
    for key, threads in {"C": 1, "A": 1, "T": 2, "B": 2}.items():
        w, many = workload(key), starts(key, MEMBERS)
        setting, ours = own_reaching(w, many, threads)
        theirs = heyoka_reaching(w, many, threads)
        seconds = fastest({"ours": ours, "theirs": theirs})
        label = f"{key}, {MEMBERS} bodies to 1e-09: heyoka.py in batches / simulate_ensemble"
        found.append(Row(label, seconds["theirs"] / seconds["ours"], "×", note=f"{setting}, {threads} threads"))
        found.append(Row(f"{key}: a body", 1e6 * seconds["ours"] / MEMBERS, "µs"))
    return found


def own_reaching(w: Workload, many: Array, threads: int) -> tuple[str, Callable[[], Any]]:
    """Return the fastest ensemble with errors below 1e-9 on some of the bodies, and its setting in words."""
    run = partial(simulate_ensemble, w.system, load=w.load, threads=threads)
    if not w.mass and not w.knots:
        return "exact", partial(run, t_end=w.t_end, integrator="exact", material_angular_velocity=many)
    settings = []
    for name, order in (("gauss", 8), ("gauss", 12), ("gauss", 16), ("split", 6)):
        truth = run(t_end=w.t_end, step=0.01, integrator="gauss", order=16, material_angular_velocity=many[:SEEN])
        for N in (10, 20, 30, 40, 60, 80, 120, 160, 240):
            how = {"t_end": w.t_end, "step": w.t_end / N, "integrator": name, "order": order}
            ends = run(material_angular_velocity=many[:SEEN], **how)
            if worst(ends.quaternion.values[:, -1], truth.quaternion.values[:, -1]) < 1e-9:
                settings.append((f"{name} {order}, {N} steps", partial(run, material_angular_velocity=many, **how)))
                break
    seconds = fastest(dict(settings), 2)
    best = min(seconds, key=seconds.__getitem__)
    return str(best), dict(settings)[best]


def worst(ends: Array, truth: Array) -> float:
    """Return the largest error of attitudes, ``|Λ - Λ_ref|_F / √2``, of quaternions in any order."""
    return max(float(np.linalg.norm(attitude(p) - attitude(q))) for p, q in zip(ends, truth, strict=True)) / np.sqrt(2)


def heyoka_reaching(w: Workload, many: Array, threads: int) -> Ends:
    """Return heyoka.py on all starts, at the loosest tolerance with errors below 1e-9 on some of them."""
    truth = heyoka_batches(w, many[:SEEN], 1e-16, 1)()
    for tol in 10.0 ** np.arange(-6, -16.1, -0.5):
        if worst(heyoka_batches(w, many[:SEEN], float(tol), 1)(), truth) <= 1e-9:
            break
    return heyoka_batches(w, many, float(tol), threads)


def heyoka_batches(w: Workload, many: Array, tol: float, threads: int) -> Ends:
    """Return the loop over batches, as many bodies in each as the processor has lanes, on that many threads."""
    import heyoka as hy

    width = hy.recommended_simd_size()
    y0 = np.tile(initial(w), (len(many), 1))
    n = y0.shape[1] - 4
    y0[:, 4:] = many[:, :n]
    one = heyoka_integrator(w, tol)
    batches = [hy.taylor_adaptive_batch(one.sys, y0[:width].T.copy(), tol=tol) for _ in range(threads)]
    found = np.empty_like(y0)

    def work(ta: Any, first: int, last: int) -> None:
        for k in range(first, last, width):
            ta.state[:] = y0[k : k + width].T
            ta.set_time(0.0)
            for _, t1, m0, m1 in w.pieces:
                if w.knots:
                    ta.pars[:] = np.concatenate([m0[:n], m1[:n]])[:, None]
                ta.propagate_until([t1] * width)
            found[k : k + width] = ta.state.T

    share = len(many) // threads
    pool = ThreadPoolExecutor(threads)

    def run() -> Array:
        list(pool.map(work, batches, range(0, len(many), share), range(share, len(many) + 1, share)))
        return found

    return run


def lanes() -> list[Row]:
    """Compare steps of second order on one core: many bodies in lanes, and one at a time."""
    calls: Timed = {}
    for name in ("lie-midpoint", "energy-momentum"):
        for key in "ABCT":
            w = workload(key)
            how = {"t_end": 5, "step": 5 / STEPS, "load": w.load, "integrator": name, "order": 2}
            W = w.velocity * np.random.default_rng(2).uniform(0.9, 1.1, (LANES, 1))
            calls[name, key, LANES] = partial(
                simulate_ensemble, w.system, material_angular_velocity=W, threads=1, **how
            )
            one = propagator(w.system, store="end", **how)
            calls[name, key, 1] = partial(one, material_angular_velocity=w.velocity)
    times = fastest(calls, 20)
    found = []
    for name, key, count in calls:
        where = "in lanes" if count > 1 else "one at a time"
        step = 1e9 * times[name, key, count] / (count * STEPS)
        found.append(Row(f"{name} 2, {key}: a step and body, {where}", step, "ns"))
    return found


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
    """Measure a compiled load of the state in lanes: 120 steps of 10^5 bodies in one thread."""
    W = np.random.default_rng(0).normal(scale=(0.5, 0.5, 5), size=(10**5, 3))
    calls: Timed = {}
    for name in ("lie-midpoint", "energy-momentum"):
        load = moment(gravity_gradient, compiled=True)
        how = {"t_end": 0.6, "step": 0.005, "order": 2, "load": load, "integrator": name, "threads": 1}
        calls[name] = partial(simulate_ensemble, standard([3, 4, 5]), material_angular_velocity=W, **how)
    label = "gravity gradient, compiled, {}: a step and body"
    return [Row(label.format(name), 1e9 * s / (120 * len(W)), "ns") for name, s in fastest(calls, 3).items()]


def threads() -> list[Row]:
    """Return how much quicker two threads are."""
    found = []
    for label, key, how, members in (
        (f"C, {STEPS} steps of order 2", "C", {"step": 5 / STEPS, **MIDPOINT}, MEMBERS // 2),
        ("T, 100 steps of order 8", "T", {"step": 0.05, "integrator": "gauss", "order": 8}, MEMBERS),
        ("C, closed form", "C", {"integrator": "exact"}, 4 * MEMBERS),
    ):
        run = partial(simulate_ensemble, workload(key).system, t_end=5, **how)
        W = starts(key, members)
        calls: Timed = {n: partial(run, material_angular_velocity=W, threads=n) for n in (1, 2)}
        seconds = fastest(calls, 3)
        found.append(Row(f"{label}: two threads / one", seconds[1] / seconds[2], "×"))
        found.append(Row(f"{label}: members/s/core", members / seconds[1], "1/s"))
    return found


def memory() -> list[Row]:
    """Return the time of 10^6 end states of case 1, two threads, and the peak of memory beside the arguments."""
    W, found = starts("A", MANY), []
    cases: dict[str, dict[str, Any]] = {
        "closed form": {"integrator": "exact"},
        f"{STEPS} steps of order 2": {"step": 5 / STEPS, **MIDPOINT},
    }
    for label, how in cases.items():
        call = partial(simulate_ensemble, workload("A").system, t_end=5, material_angular_velocity=W, threads=2, **how)
        found.append(Row(f"10^6 members, {label}", fastest({"": call}, 1)[""], "s"))
        tracemalloc.start()
        call()
        found.append(Row(f"10^6 members, {label}: memory", tracemalloc.get_traced_memory()[1] / 1e6, "MB"))
        tracemalloc.stop()
    return found
