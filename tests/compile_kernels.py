"""Compile the kernels that most tests call, in two processes: two workers of pytest would compile each of them twice.

`make test` calls this when a module of the package has changed; Numba keeps the machine code.
"""

from __future__ import annotations

import subprocess
import sys

import numpy as np

from nontwist import Load, integrate, moment, nontwisting, nontwisting_frame, simulate_ensemble, sine, standard

HOW = {"t_end": 0.1, "step": 0.01, "material_angular_velocity": (1, 2, 0)}
BODY, SPACE = sine((1, 0, 0), 1), sine((1, 0, 0), 1, frame="space")


def still(t, d, w):
    return 0.0 * t, 0.0, 0.0


def runs(integrator: str, *loads: Load) -> None:
    """Run a standard and a non-twisting body."""
    for body in (standard([3, 4, 5]), nontwisting([3, 4, 5])):
        for load in loads:
            integrate(body, integrator=integrator, load=load, **HOW)


def in_lanes() -> None:
    """Compile ensembles, and the frames of samples."""
    for name in ("lie-midpoint", "energy-momentum", "exact"):
        simulate_ensemble(nontwisting([3, 4, 5]), integrator=name, **HOW)
    nontwisting_frame(np.eye(3))
    runs("energy-momentum", Load(), SPACE)


def one_by_one() -> None:
    """Compile single runs."""
    state = moment(still, compiled=True)
    runs("exact", Load())
    runs("lie-midpoint", Load(), SPACE, state)
    runs("split", BODY, SPACE, state)
    runs("energy-momentum", state)


PARTS = {"in_lanes": in_lanes, "one_by_one": one_by_one}

if __name__ == "__main__":
    if len(sys.argv) > 1:
        PARTS[sys.argv[1]]()
    else:
        started = [subprocess.Popen([sys.executable, __file__, name]) for name in PARTS]
        sys.exit(max(process.wait() for process in started))
