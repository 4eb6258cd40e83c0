"""Start-up times, each the median of new processes.

"beyond NumPy" is less the time of ``import numpy``. The first result is 1000 steps of `integrate`, or of
`simulate_ensemble` for 64 bodies. Modules are present as bytecode; kernels are compiled in memory.
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

BEGIN = (
    "import nontwist as nt; b = nt.nontwisting([3, 4, 5]); "
    "how = dict(t_end=5, step=0.005, integrator={name!r}, material_angular_velocity=W); "
)
ONE = "W = (6, -18, 0); " + BEGIN + "nt.integrate(b, **how)"
MANY = (
    "import numpy as np; W = np.random.default_rng(1).normal(size=(64, 3)) * [1, 1, 0]; "
    + BEGIN
    + "nt.simulate_ensemble(b, **how)"
)
SIMULATED = "W = (6, -18, 0); " + BEGIN + "nt.simulate(b, **how)"
WITHOUT_DASK = "import sys; sys.modules['dask'] = None; "
SCHEMES = ("gauss", "lie-midpoint", "energy-momentum", "split", "exact", "continuous")
CODES = {
    "numpy": "import numpy",
    "names": "import numpy; from nontwist import integrate, nontwisting, standard",
    **{f"{name}: first result": ONE.format(name=name) for name in SCHEMES},
    **{f"{name}: first ensemble": WITHOUT_DASK + MANY.format(name=name) for name in SCHEMES[:-1]},
    "gauss: first dataset": WITHOUT_DASK + SIMULATED.format(name="gauss"),
    "gauss: first dataset, beside Dask": SIMULATED.format(name="gauss"),
}
PASSES = 5


def rows() -> list[Row]:
    """Measure all."""
    with tempfile.TemporaryDirectory() as folder:
        home, results = Path(folder) / "home", Path(folder) / "results"
        home.mkdir(mode=0o555)
        results.mkdir()
        places = {"HOME": str(home), "XDG_CACHE_HOME": str(home)}
        bytecode = {"PYTHONPYCACHEPREFIX": str(results / "bytecode"), "PYTHONDONTWRITEBYTECODE": ""}
        return _rows(places | bytecode, results)


def _rows(variables: dict[str, str], folder: Path) -> list[Row]:
    commands = {name: [sys.executable, "-c", code] for name, code in CODES.items()} | _of_the_command_line(folder)
    times: dict[str, list[float]] = {name: [] for name in commands}
    order = list(commands)
    for name in order:
        child(commands[name], **variables)
    for _ in range(PASSES):
        random.shuffle(order)
        for name in order:
            times[name].append(child(commands[name], **variables))
    warm = {name: median(found) for name, found in times.items()}
    return [
        Row("import nontwist, with the names for a run, beyond NumPy", warm["names"] - warm["numpy"], "s"),
        Row("Python and NumPy alone", warm["numpy"], "s"),
        *(Row(name, warm[name], "s") for name in commands if name not in ("names", "numpy")),
    ]


def _of_the_command_line(folder: Path) -> dict[str, list[str]]:
    """Return commands of `nontwist`, which write to `folder`."""
    script = Path(sys.executable).with_name("nontwist")
    command = [str(script)] if script.exists() else [sys.executable, "-m", "nontwist"]
    run, recording = str(folder / "run.toml"), str(Path(__file__).parents[1] / "examples" / "imu" / "quaternion.csv")
    child([*command, "example", "case3", "--out", run])
    twist = [*command, "twist", recording, "--inverse", "--degrees", "--force"]
    return {
        "nontwist --help": [*command, "--help"],
        "nontwist check FILE": [*command, "check", run],
        "nontwist run FILE": [*command, "run", run, "--out", str(folder / "run.nc"), "--force"],
        "nontwist twist FILE, no figures": [*twist, "--no-figure", "--out", str(folder / "twist")],
        "nontwist twist FILE": [*twist, "--out", str(folder / "figures")],
    }


def child(command: list[str], **variables: str) -> float:
    """Return the seconds of a process."""
    start = perf_counter()
    output = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    subprocess.run(command, **output, check=True, env=os.environ | variables)  # type: ignore[call-overload]
    return perf_counter() - start
