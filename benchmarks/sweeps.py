"""The gain by threads in a sweep with its store: case 1 with random starts, each to its end state."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nontwist import sweep

from .rows import Row
from .timing import fastest

INTEGRATORS = {
    "closed form": 'name = "exact"',
    "1000 steps of order 2": 'name = "lie-midpoint"\norder = 2',
}
FILE = """
[body]
kind = "nontwisting"
inertia = [[3, -0.14285714285714285, 0], [-0.14285714285714285, 4, 0], [0, 0, 5]]
[time]
t_end = 5.0
step = 0.005
[integrator]
{integrator}
[sweep]
samples = {members}
[[sweep.over]]
key = "start.angular_velocity.body"
kind = "uniform"
low = [-20, -20, 0]
high = [20, 20, 0]
"""
MEMBERS = {"closed form": 2**20, "1000 steps of order 2": 2**17}


def swept(name: str, count: int, **how: Any) -> Callable[[], None]:
    """Return the sweep of that many members into an empty store."""

    def call() -> None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "sweep.toml"
            file.write_text(FILE.format(integrator=INTEGRATORS[name], members=count), encoding="utf-8")
            sweep(file, Path(folder) / "store", **how)

    return call


def rows() -> list[Row]:
    """Measure whole sweeps, their stores included, with one and two threads."""
    found = []
    for name, count in MEMBERS.items():
        seconds = fastest({n: swept(name, count, workers=n, block=count // 16) for n in (1, 2)}, 3)
        found.append(Row(f"{count} members, {name}: two threads / one", seconds[1] / seconds[2], "×"))
        found.append(Row(f"{name}: members/s/core, the store included", count / seconds[1], "1/s"))
    return found
