"""The first GPU beside all cores: whole calls of `simulate_ensemble`, end states of many bodies from random starts."""

from __future__ import annotations

from functools import partial
from typing import Any

from nontwist import simulate_ensemble
from nontwist.errors import InputError
from nontwist.kernels import gpu

from .ensembles import starts
from .rows import Row
from .timing import fastest
from .workloads import workload

MEMBERS = 10**4, 10**5, 10**6, 10**7
CASES: dict[str, dict[str, Any]] = {
    "lie-midpoint 2, 1000 steps": {"step": 0.005, "integrator": "lie-midpoint"},
    "gauss 8, 100 steps": {"step": 0.05, "integrator": "gauss", "order": 8},
}


def rows() -> list[Row]:
    """Measure free bodies and heavy tops; the note says how far the end states are apart."""
    try:
        gpu.gpu()
    except InputError as error:
        return [Row("a GPU", None, "", note=str(error))]
    found = []
    for label, how in CASES.items():
        for key in "CT":
            w = workload(key)
            for members in MEMBERS:
                run = partial(simulate_ensemble, w.system, material_angular_velocity=starts(key, members), **how)
                calls = {device: partial(run, t_end=5, load=w.load, device=device) for device in ("cpu", "gpu")}
                p, q = (call().quaternion.values for call in calls.values())
                seconds = fastest(calls, 3)
                name, note = f"{label}, {key}, {members} bodies", f"apart by {abs(p - q).max():.1e}"
                found.append(Row(f"{name}: all cores / GPU", seconds["cpu"] / seconds["gpu"], "×", note=note))
                found.append(Row(f"{name}: members/s on the GPU", members / seconds["gpu"], "1/s"))
    return found
