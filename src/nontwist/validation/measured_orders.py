"""Orders of every integrator, measured against the continuous equations.

Errors are those of the nine director components at 2 s. Steps are small enough for the leading term of the error and
large enough to keep it well above that of the reference, DOP853 at 3e-14. A Suslov body whose axis is not principal is
among the problems because an energy test alone would not see a wrong test direction of a scheme.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator

import numpy as np

from ..analysis.resampling import resample
from ..driver import integrate, simulate
from ..exact import free_standard
from ..geometry.arrays import Array
from ..integrators import INTEGRATORS
from ..loads import Load, moment
from ..models.catalogue import standard
from .checks import Check
from .measures import slope
from .problems import BODIES, SHARP, Arguments, pushed

TOLERANCE = 0.2
PROBLEMS: dict[str, tuple[str, tuple[float, float, float], Load]] = {
    "non-twisting body, load in the moving frame": ("non-twisting", (1, -2, 0), pushed("body")),
    "standard body, load in space": ("standard", (1, -2, 3), pushed("space")),
    "Suslov body, load in space": ("Suslov", (1, -2, 0), pushed("space")),
    "heavy top": ("heavy top", (1, 0.5, 4), Load()),
}
COUNTS = {2: (64, 128, 256), 4: (32, 64, 128), 6: (24, 32, 48), 8: (20, 24, 32)}
SPLIT_COUNTS = {2: (64, 128, 256), 4: (32, 64, 128), 6: (14, 18, 24), 8: (12, 14, 16)}
SOURCES = {
    "lie-midpoint": "Hairer, Lubich & Wanner, V.3; Kahan & Li 1997",
    "energy-momentum": "eq-discrete-nonholonomic; Suzuki 1990",
    "split": "eq-nonholonomic-red; Blanes, Casas & Ros 2000; Kahan & Li 1997",
}


def orders() -> Iterator[Check]:
    """Measure every order that a stepping integrator offers, on every body that it takes."""
    for problem, (name, w, load) in PROBLEMS.items():
        distances = errors_of(name, w, load)
        for scheme, cls in INTEGRATORS.items():
            if scheme == "split" and name == "Suslov":
                continue
            for k in cls.orders:
                counts = (SPLIT_COUNTS if scheme == "split" else COUNTS)[k]
                measured = slope(counts, distances(scheme, k, counts), k)
                source = SOURCES.get(scheme, cls.__module__)
                yield Check(f"{scheme} {k}: {problem}", k, measured, TOLERANCE, source, "order")


def loads_of_the_state() -> Iterator[Check]:
    """Do the same for a load that depends on attitude and velocity."""

    def swing(t: float, d: Array, w: Array) -> Array:
        return np.array([2 * d[2, 1], -2 * d[2, 0], np.sin(t)]) - 0.1 * w

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "the load .* runs in Python")
        distances, counts = errors_of("non-twisting", (1, -2, 0), moment(swing)), (16, 32)
        for scheme, source in SOURCES.items():
            measured = slope(counts, distances(scheme, 4, counts), 4)
            yield Check(f"{scheme} 4: non-twisting body, load of the state", 4, measured, TOLERANCE, source, "order")


def errors_of(
    name: str, w: tuple[float, float, float], load: Load
) -> Callable[[str, int, tuple[int, ...]], list[float]]:
    """Return a function that gives the errors of runs of a problem: of a scheme and order, for numbers of steps."""
    how: Arguments = {"t_end": 2, "angular_velocity": w, "project": True, "load": load, "store": "end"}
    end = integrate(BODIES[name], step=1, integrator=SHARP, **how).directors[-1]

    def errors(scheme: str, k: int, counts: tuple[int, ...]) -> list[float]:
        runs = [integrate(BODIES[name], step=2 / n, integrator=scheme, order=k, **how) for n in counts]
        return [float(np.linalg.norm(run.directors[-1] - end)) for run in runs]

    return errors


def resampling() -> Iterator[Check]:
    """Measure the order of interpolation on SO(3), on free motion in closed form."""
    J, w, times = [1, 2, 2.5], (1, 2, 3), np.linspace(0.013, 1.987, 57)
    truth, errors, counts = free_standard(J, w, times)[0], [], (20, 40, 80)
    for n in counts:
        run = simulate(standard(J), t_end=2, step=2 / n, angular_velocity=w, integrator="exact")
        errors.append(abs(resample(run, times).directors.values - truth.mT).max())
    measured = slope(counts, errors, 4)
    yield Check("resample, free standard body", 4, measured, TOLERANCE, "nontwist.analysis.resampling", "order")


CHECKS = (orders, loads_of_the_state, resampling)
