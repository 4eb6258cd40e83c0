"""The gain by threads, and the cost of Dask for each block: case 1 with random starts, each to its end state.

`nontwist sweep --dry-run` forecasts time, size and number of files of a sweep.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from time import perf_counter

import numpy as np

from nontwist import sweep
from nontwist.sweeps.members import Members
from nontwist.sweeps.plan import plan
from nontwist.sweeps.workers import duration

from .rows import Row, Table

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
SCALED = {"closed form": 2**20, "1000 steps of order 2": 2**17}
OVERHEAD = {"block": 64, "blocks": 200}


def members(name: str, count: int) -> Members:
    """Return the members of case 1 with random starts."""
    return Members.of(FILE.format(integrator=INTEGRATORS[name], members=count), Path())


def rows() -> list[Row]:
    """Measure all."""
    return [*scaling(), *dask_overhead()]


def scaling() -> list[Row]:
    """Time whole sweeps, their stores included, with one and two threads."""
    found = []
    for name, count in SCALED.items():
        file = members(name, count).file
        seconds = {n: least(partial(sweep, file, workers=n, block=count // 16)) for n in (1, 2)}
        found.append(Row(f"{count} members, {name}: two threads / one", seconds[1] / seconds[2], "×"))
        found.append(Row("   members/s/core, the store included", count / seconds[1], "1/s"))
    return found


def dask_overhead() -> list[Row]:
    """Time small blocks, on a cluster of one process and in one thread: what a block costs besides its members."""
    from distributed import Client, LocalCluster

    size, blocks = OVERHEAD["block"], OVERHEAD["blocks"]
    file = members("closed form", size * blocks).file
    with (
        LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as cluster,
        Client(cluster) as client,
    ):
        clustered = least(partial(sweep, file, dask=client, block=size))
    threaded = least(partial(sweep, file, workers=1, block=size))
    return [
        Row(f"a block of {size} members in one thread, written, marked and verified", 1e3 * threaded / blocks, "ms"),
        Row("what Dask adds to a block", 1e3 * (clustered - threaded) / blocks, "ms"),
        Row("   part of a block of 5 s", 100 * (clustered - threaded) / blocks / 5, "%"),
    ]


def least(call: Callable[..., object], passes: int = 3) -> float:
    """Return the least time of a sweep into an empty store."""
    times = []
    for turn in range(passes + 1):
        with tempfile.TemporaryDirectory() as folder:
            begin = perf_counter()
            call(store=Path(folder) / "store")
            times += [perf_counter() - begin] * bool(turn)
    return min(times)


@cache
def each(name: str) -> float:
    """Return the seconds of a member on one core."""
    return float(np.median([plan(members(name, 10**6), 1).seconds_each for _ in range(5)]))


def tables() -> list[Table]:
    """Forecast the cost of many members on many cores like this one."""
    cells = []
    for name in INTEGRATORS:
        for count in (10**8, 10**9):
            for cores in (1, 100, 1000):
                made = plan(members(name, count), cores)
                work = count * each(name)
                cells.append(
                    [
                        f"10^{len(str(count)) - 1}, {name}",
                        str(cores),
                        duration(work / cores),
                        f"{work / 3600:.3g}",
                        f"{made.bytes / 1e9:.3g} GB",
                        f"{made.files}",
                        f"{made.block}",
                    ]
                )
    header = ["members", "cores", "time", "core hours", "store", "files", "members of a block"]
    return [Table("Forecast: many members on cores like this one", header, cells)]
