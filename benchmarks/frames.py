"""Frames and twist of sampled directors: samples per second, and a million rows from file to file."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas
from scipy.spatial.transform import Rotation

from nontwist import TwistCounter
from nontwist.curves import link, nontwisting_frame, writhe
from nontwist.geometry.frame_kernels import smooth_rolls, transport
from nontwist.geometry.frames import first_d1, unit_directors

from .peers import ABSENT
from .rows import Row, seconds

N = 1_000_000


def directors(n: int) -> np.ndarray:
    """Return n samples of θ = 1 + 0.4 sin 3t, φ = 2t + 0.3 cos t."""
    t = np.linspace(0, 100, n)
    a, b = 1 + 0.4 * np.sin(3 * t), 2 * t + 0.3 * np.cos(t)
    return np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], axis=1)


def rows() -> list[Row]:
    """Measure all."""
    return [*kernels(), *live(), *curves(), *peers(), *recording()]


def kernels() -> list[Row]:
    """Kernel speed on one core, from checked unit directors to frames."""
    u = directors(N)[None].copy()
    d1, frames = first_d1(None, u[:, 0], ()), np.empty((1, N, 3, 3))
    roll, node = np.zeros((1, N)), np.ones((1, N), dtype=np.int64)
    room = np.empty(N, dtype=np.int64), np.empty((3, N))

    def second() -> None:
        unit_directors(u)
        transport(u, d1, roll, node, frames)

    def fourth() -> None:
        unit_directors(u)
        smooth_rolls(u, 0, roll4, node4, *room)
        transport(u, d1, roll4, node4, frames)

    roll4, node4 = roll.copy(), node.copy()
    return [
        Row("frames of order 2, kernel", N / seconds(second) / 1e6, "10⁶ samples/s"),
        Row("frames of order 4, kernel", N / seconds(fourth) / 1e6, "10⁶ samples/s"),
    ]


def live() -> list[Row]:
    """Twist counted live: one attitude at a time, and many streams in one array."""
    t = np.linspace(0, 10, 1000)
    attitudes = Rotation.from_rotvec(np.stack([np.sin(0.7 * t), 0.8 * np.cos(0.9 * t), 0.1 * t], axis=1)).as_quat()
    found = []
    for order in (2, 4):
        for form, samples in {
            "four floats": [tuple(q) for q in attitudes.tolist()],
            "an array": list(attitudes),
        }.items():
            counter = TwistCounter("z", order, scalar_first=False)

            def one(counter: TwistCounter = counter, samples: Any = samples) -> None:
                for q in samples:
                    counter.update(q)

            found.append(Row(f"TwistCounter, order {order}: {form}", 1e3 * seconds(one), "µs"))
        many = TwistCounter("z", order, scalar_first=False)
        blocks = [np.tile(q, (100_000, 1)) for q in attitudes[:5]]

        def batch(many: TwistCounter = many, blocks: Any = blocks) -> None:
            for block in blocks:
                many.update(block)

        found.append(Row(f"TwistCounter, order {order}: 10⁵ streams", 0.5 / seconds(batch), "10⁶ updates/s"))
    return found


def curves() -> list[Row]:
    """Writhe of a trefoil of ten thousand points, and its link with a neighbour."""
    t = 2 * np.pi * np.arange(10_000) / 10_000
    r = 2 + np.cos(3 * t)
    points = np.stack([r * np.cos(2 * t), r * np.sin(2 * t), -np.sin(3 * t)], axis=1)
    beside = points + 0.1
    return [
        Row("writhe of 10⁴ points", seconds(lambda: writhe(points), 3), "s"),
        Row("link of two curves of 10⁴ points", seconds(lambda: link(points, beside), 3), "s"),
    ]


def peers() -> list[Row]:
    """Compare the public call with other packages, where they are installed."""
    n = 20_000
    u = directors(n)
    own = {order: seconds(lambda order=order: nontwisting_frame(u, order=order)) for order in (2, 4)}
    found = []
    try:
        import quaternion
    except ImportError:
        found.append(Row("quaternion.minimal_rotation", None, "× slower", note=ABSENT))
    else:
        v, t = u[:2000], np.linspace(0, 100, n)[:2000]
        first = np.cross([0, 0, 1.0], v)
        turn = quaternion.from_rotation_vector(
            first / np.linalg.norm(first, axis=1)[:, None] * np.arccos(v[:, 2])[:, None]
        )
        theirs = seconds(lambda: quaternion.minimal_rotation(turn, t, iterations=2), 3) * n / 2000
        found.append(Row("quaternion.minimal_rotation", theirs / own[4], "× slower than order 4"))
    try:
        import coordinax  # noqa: F401
    except ImportError:
        found.append(Row("coordinax Bishop frame", None, "× slower", note=ABSENT))
    else:
        found.append(Row("coordinax Bishop frame", None, "× slower", note="its releases up to 0.23.5 have none"))
    return found


def recording() -> list[Row]:
    """`nontwist twist` on a million rows: whole command, and its memory beyond the imports."""
    t = np.arange(N) / 1000
    x, y, z, w = Rotation.from_rotvec(np.stack([np.sin(0.7 * t), 0.8 * np.cos(0.9 * t), 0.1 * t], axis=1)).as_quat().T
    imports = (
        "import nontwist.cli, nontwist.recordings.twisting, nontwist.io, nontwist.geometry.frame_kernels, pandas, "
        "xarray, h5netcdf, rich.table"
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rows.csv"
        pandas.DataFrame({"t": t, "qw": w, "qx": x, "qy": y, "qz": z}).to_csv(path, index=False, float_format="%.9g")
        base, _ = _child([sys.executable, "-c", imports])
        command = [sys.executable, "-m", "nontwist", "twist", str(path), "--no-figure", "--out", f"{folder}/out"]
        _child(command)
        peak, wall = _child([*command, "--force"])
    return [
        Row("twist of 10⁶ rows, CSV to NetCDF", wall, "s"),
        Row("its memory beyond the imports", (peak - base) / 1024, "MB"),
    ]


def _child(command: list[str]) -> tuple[float, float]:
    """Peak memory (kB) and seconds of a child process."""
    import time

    code = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, check=True);"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    start = time.perf_counter()
    out = subprocess.run([sys.executable, "-c", code, *command], capture_output=True, text=True, check=True).stdout
    return float(out.split()[-1]), time.perf_counter() - start
