"""Compile the kernels that most tests call, in two processes: two workers of pytest would compile each of them twice.

`make test` calls this when a module of the package has changed; Numba keeps the machine code.
"""

from __future__ import annotations

import subprocess
import sys

import numpy as np

from nontwist import (
    Load,
    heavy_top,
    integrate,
    moment,
    nontwisting,
    nontwisting_frame,
    simulate_ensemble,
    sine,
    standard,
)

HOW = {"t_end": 0.1, "step": 0.01, "material_angular_velocity": (1, 2, 0)}
FEW = [[1, 2, 0], [2, 1, 0], [1, 1, 0]]
BODY, SPACE = sine((1, 0, 0), 1), sine((1, 0, 0), 1, frame="space")


def still(t, d, w):
    return 0.0 * t, 0.0, 0.0


def runs(integrator: str, *loads: Load, ensembles: bool = False) -> None:
    """Run a standard and a non-twisting body, one or three of each."""
    for body in (standard([3, 4, 5]), nontwisting([3, 4, 5])):
        for load in loads:
            if ensembles:
                simulate_ensemble(body, integrator=integrator, load=load, **{**HOW, "material_angular_velocity": FEW})
            else:
                integrate(body, integrator=integrator, load=load, **HOW)


def in_lanes() -> None:
    """Compile ensembles, and what needs no engine."""
    runs("lie-midpoint", Load(), BODY, SPACE, ensembles=True)
    runs("energy-momentum", Load(), BODY, SPACE, ensembles=True)
    runs("gauss", Load(), SPACE, ensembles=True)
    heavy = heavy_top([3, 4, 5], 1.0, [0, 0, 1])
    simulate_ensemble(heavy, **{**HOW, "material_angular_velocity": FEW})
    simulate_ensemble(nontwisting([3, 4, 5]), integrator="exact", **HOW)
    nontwisting_frame(np.eye(3))


def one_by_one() -> None:
    """Compile single runs."""
    state = moment(still, compiled=True)
    integrate(standard([3, 4, 5]), times=[0.015], **HOW)
    runs("lie-midpoint", Load(), BODY, SPACE, state)
    runs("energy-momentum", Load(), BODY, SPACE, state)
    runs("gauss", Load(), BODY, SPACE)
    for integrator in ("lie-midpoint", "energy-momentum", "split", "gauss"):
        integrate(heavy_top([3, 4, 5], 1.0, [0, 0, 1]), integrator=integrator, **HOW)
    runs("exact", Load())
    runs("split", BODY, SPACE, state)


PARTS = {"in_lanes": in_lanes, "one_by_one": one_by_one}

if __name__ == "__main__":
    if len(sys.argv) > 1:
        PARTS[sys.argv[1]]()
    else:
        started = [subprocess.Popen([sys.executable, __file__, name]) for name in PARTS]
        sys.exit(max(process.wait() for process in started))
