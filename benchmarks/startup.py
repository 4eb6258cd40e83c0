"""G10: start-up, each figure the median of new processes.

Beyond NumPy: ``import numpy, nontwist`` less ``import numpy``. The first result is one `simulate` of 1000 steps; cold
means that Numba finds an empty cache.
"""

from __future__ import annotations

import os
import random
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter

from .rows import Row

FIRST = (
    "import nontwist as nt; nt.simulate(nt.{body}([3, 4, 5]), t_end=5, step=0.005, "
    "material_angular_velocity=(6, -18, 0), integrator={integrator!r})"
)
CODES = {
    "nothing": "pass",
    "numpy": "import numpy",
    "nontwist": "import numpy, nontwist",
    "names": "import numpy; from nontwist import integrate, nontwisting, standard",
    "default": FIRST.format(body="nontwisting", integrator="lie-midpoint"),
    "paper": FIRST.format(body="nontwisting", integrator="energy-momentum"),
}
PASSES, COLD_PASSES = 7, 3


def rows() -> list[Row]:
    """Measure all."""
    commands = {name: [sys.executable, "-c", code] for name, code in CODES.items()}
    commands["help"] = [sys.executable, "-m", "nontwist", "--help"]
    commands["script"] = [str(Path(sys.executable).with_name("nontwist")), "--help"]
    if not Path(commands["script"][0]).exists():
        del commands["script"]
    times: dict[str, list[float]] = {name: [] for name in commands}
    order = list(commands)
    for name in order:
        child(commands[name])
    for _ in range(PASSES):
        random.shuffle(order)
        for name in order:
            times[name].append(child(commands[name]))
    warm = {name: median(found) for name, found in times.items()}
    cold = {name: median(child_with_empty_cache(commands[name]) for _ in range(COLD_PASSES)) for name in FIRSTS}
    return [
        Row("G10 import nontwist beyond NumPy", warm["nontwist"] - warm["numpy"], "s", 0.2, True),
        Row("   with the names for a run", warm["names"] - warm["numpy"], "s"),
        Row("   Python and NumPy alone", warm["numpy"], "s"),
        Row("G10 nontwist --help", warm.get("script", warm["help"]), "s", 0.4, True),
        Row("   python -m nontwist --help", warm["help"], "s"),
        *(Row(f"G10 first result, {label}, warm cache", warm[name], "s", 2, True) for name, label in FIRSTS.items()),
        *(Row(f"G10 first result, {label}, cold cache", cold[name], "s", 10, True) for name, label in FIRSTS.items()),
    ]


FIRSTS = {"default": "lie-midpoint", "paper": "energy-momentum"}


def child(command: list[str], **variables: str) -> float:
    """Return the seconds of a process."""
    start = perf_counter()
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True, env=os.environ | variables)
    return perf_counter() - start


def child_with_empty_cache(command: list[str]) -> float:
    """Return the seconds of a process in which Numba finds nothing compiled."""
    with tempfile.TemporaryDirectory() as folder:
        return child(command, NUMBA_CACHE_DIR=folder)
