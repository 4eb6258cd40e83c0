"""Frames and twist of sampled directors: samples per second, and a million rows from file to file."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import pandas
from scipy.spatial.transform import Rotation

from nontwist import TwistCounter
from nontwist.curves import link, nontwisting_frame, writhe

from .rows import Row
from .timing import fastest

N = 1_000_000
CHILD = """
import resource, subprocess, sys, time
begin = time.perf_counter()
subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, check=True)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss, time.perf_counter() - begin)
"""


def rows() -> list[Row]:
    """Measure all."""
    return [*sampled(), *live(), *recording()]


def attitudes(t: np.ndarray) -> np.ndarray:
    """Return quaternions, scalar last, of an arm that swings and turns."""
    swings = np.stack([np.sin(0.7 * t), 0.8 * np.cos(0.9 * t), 0.1 * t], axis=1)
    return Rotation.from_rotvec(swings).as_quat()


def sampled() -> list[Row]:
    """Return frames along a million directors, and the writhe and the link of curves of 10⁴ points."""
    directors = Rotation.from_quat(attitudes(np.linspace(0, 100, N))).as_matrix()[:, :, 2]
    t = 2 * np.pi * np.arange(10_000) / 10_000
    r = 2 + np.cos(3 * t)
    trefoil = np.stack([r * np.cos(2 * t), r * np.sin(2 * t), -np.sin(3 * t)], axis=1)
    times = fastest(
        {
            2: partial(nontwisting_frame, directors, order=2),
            4: partial(nontwisting_frame, directors, order=4),
            "writhe of 10⁴ points": partial(writhe, trefoil),
            "link of two curves of 10⁴ points": partial(link, trefoil, trefoil + 0.1),
        },
        3,
    )
    found = [Row(f"frames of order {order}", N / times.pop(order) / 1e6, "10⁶ samples/s") for order in (2, 4)]
    return [*found, *(Row(str(name), seconds, "s") for name, seconds in times.items())]


def live() -> list[Row]:
    """Return the cost of twist counted live: one attitude at a time, and many streams in one array."""
    samples = [tuple(q) for q in attitudes(np.linspace(0, 10, 1000)).tolist()]
    blocks, found = [np.tile(q, (100_000, 1)) for q in samples[:5]], []
    for order in (2, 4):
        one, many = (TwistCounter("z", order, scalar_first=False) for _ in range(2))
        calls = {
            "one": lambda one=one: [one.update(q) for q in samples],
            "many": lambda many=many: [many.update(block) for block in blocks],
        }
        times = fastest(calls, 3)
        found.append(Row(f"TwistCounter, order {order}: an update", 1e3 * times["one"], "µs"))
        found.append(Row(f"TwistCounter, order {order}: 10⁵ streams", 0.5 / times["many"], "10⁶ updates/s"))
    return found


def recording() -> list[Row]:
    """Return the time of `nontwist twist` on a million rows, and its memory beyond that of the command on ten."""
    t = np.arange(N) / 1000
    table = pandas.DataFrame(np.column_stack([t, attitudes(t)]), columns=["t", "qx", "qy", "qz", "qw"])
    with tempfile.TemporaryDirectory() as folder:
        found = []
        for name, count in (("few", 10), ("rows", N)):
            path = Path(folder) / f"{name}.csv"
            table[:count].to_csv(path, index=False, float_format="%.9g")
            command = [sys.executable, "-m", "nontwist", "twist", str(path), "--no-figure", "--out", f"{folder}/{name}"]
            done = subprocess.run([sys.executable, "-c", CHILD, *command], capture_output=True, text=True, check=True)
            found.append([float(word) for word in done.stdout.split()])
    (base, _), (peak, seconds) = found
    return [
        Row("twist of 10⁶ rows, CSV to NetCDF", seconds, "s"),
        Row("twist of 10⁶ rows: memory beyond that of ten", (peak - base) / 1024, "MB"),
    ]
