"""Orders of every integrator, measured against the continuous equations.

Errors are those of the nine director components at 2 s. Steps are small enough for the leading term of the error and
large enough to keep it well above the error of the reference, DOP853 at 3e-14. A Suslov body whose axis is not
principal is among the problems because an energy test alone would not detect a wrong test direction in a scheme.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..driver.resampling import resample
from ..driver.runs import integrate, simulate
from ..exact import free_standard
from ..geometry.arrays import Array
from ..integrators import INTEGRATORS, IVP
from ..loads import Load, moment
from ..models.bodies import BODIES, sample_bodies, standard
from ..models.stack import stacked
from ..models.system import DirectorSystem
from .checks import Check
from .problems import SAMPLES, SHARP, Arguments, order, pushed

TOLERANCE = 0.2
HIGHEST = 8  # order that shows in these motions; higher ones reach round-off within a few steps (tests/test_gauss.py)
# The velocity at the start, the load, and its description; by default the last of these.
PROBLEMS: dict[str, tuple[tuple[float, float, float], Load, str]] = {
    "nontwisting": ((1, -2, 0), pushed("body"), ", load in the moving frame"),
    "standard": ((1, -2, 3), pushed("space"), ", load in space"),
    "heavy_top": ((1, 0.5, 4), Load(), ""),
    "suslov": ((1, -2, 0), pushed("space"), ", load in space"),
}


def swing(t: float, d: Array, w: Array) -> Array:
    """Return a moment that depends on attitude and velocity, N m."""
    return np.array([2 * d[2, 1] - 0.1 * w[0], -2 * d[2, 0] - 0.1 * w[1], np.sin(t) - 0.1 * w[2]])


def orders() -> Iterator[Check]:
    """Measure every order of every integrator, on every kind of body that it accepts, and under a load of the state."""
    for name, body in sample_bodies().items():
        w, load, words = PROBLEMS.get(name, PROBLEMS["suslov"])
        yield from measured(f"{BODIES[name].words}{words}", body, w, load)
    title, load = "non-twisting body, load of the state", moment(swing, compiled=True)
    yield from measured(title, SAMPLES["nontwisting"], (1, -2, 0), load)


def measured(title: str, body: DirectorSystem, w: tuple[float, float, float], load: Load) -> Iterator[Check]:
    """Measure the orders of all integrators on a problem, if they accept it."""
    how: Arguments = {"t_end": 2, "angular_velocity": w, "project": True, "load": load, "store": "end"}
    end = integrate(body, step=1, integrator=SHARP, **how).directors[-1]
    task = IVP(stacked(body), np.eye(4)[3:], np.zeros((1, 3)), load, 0.0, 2.0, 1, np.array([0, 1]))
    for name, cls in INTEGRATORS.items():
        for k in () if cls.variants()[0].refusal(task) else [k for k in cls.orders if k <= HIGHEST]:
            counts = cls.measuring(k)
            runs = [integrate(body, step=2 / n, integrator=name, order=k, **how) for n in counts]
            errors = [np.linalg.norm(run.directors[-1] - end) for run in runs]
            source = cls.sources.get("order", cls.__module__)
            yield order(f"{name} {k}: {title}", k, counts, errors, TOLERANCE, source)


def resampling() -> Iterator[Check]:
    """Measure the order of a run at other times, on free motion in closed form."""
    J, w, times = [1, 2, 2.5], (1, 2, 3), np.linspace(0.013, 1.987, 57)
    truth, errors, counts = free_standard(J, w, times)[0], [], (20, 40, 80)
    for n in counts:
        run = simulate(standard(J), t_end=2, step=2 / n, angular_velocity=w, integrator="energy-momentum")
        errors.append(abs(resample(run, times).directors.values - truth.mT).max())
    yield order("resample, free standard body", 2, counts, errors, TOLERANCE, "nontwist.driver.resampling")


CHECKS = (orders, resampling)
