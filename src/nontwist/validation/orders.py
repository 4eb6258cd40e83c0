"""Validation of orders, also of motions that are not reversible.

**orders**: Orders of every integrator, measured against the continuous equations.

Errors are those of the nine director components at 2 s. Steps are small enough for the leading term of the error and
large enough to keep it well above the error of the reference, DOP853 at 3e-14. A Suslov body whose axis is not
principal is among the problems because an energy test alone would not detect a wrong test direction in a scheme.

**nonreversible**: Motions that are not reversible: forced, damped and gyroscopic bodies, general Suslov axes.

Reversible examples are favourable to nonholonomic integrators: near conservation may then come from the symmetry, not
from the method (Modin & Verdier 2020). Motion without load is reversible, even about a general Suslov axis: it runs
backwards if the sign of W is changed. It comes first below, for comparison. A moment that is odd in the velocity or
depends on time breaks this symmetry. The loads are a damping -C W with positive C; a moment along fixed axes that
oscillates; and the moment W × b of a rotor inside the body, which is a damping with skew C: it does no work, so K + V
must be conserved although the motion is not reversible. Inertias are full, the axis is not principal, and the centre of
mass is arbitrary.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..analysis import variables as obs
from ..driver.runs import integrate, resample, simulate
from ..exact import free_standard
from ..geometry.arrays import Array
from ..geometry.rotations import hat
from ..integrators import INTEGRATORS, IVP
from ..loads import Load, damping, moment, sine
from ..models.bodies import BODIES, sample_bodies, standard, with_gravity
from ..models.stack import stacked
from ..models.system import DirectorSystem
from .checks import Check
from .problems import KICK, SAMPLES, SCHEMES, SHARP, Arguments, energy, error, order, pushed

TOLERANCE = 0.2
HIGHEST = 8  # order that shows in these motions; higher ones reach round-off in a few steps (see test_gauss.py)
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
        if name not in PROBLEMS:  # it may be light
            load = float(np.trace(body.inertia) / np.trace(SAMPLES["suslov"].inertia)) * load
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
    yield order("resample, free standard body", 2, counts, errors, TOLERANCE, "nontwist.driver.runs")


SOURCE = "Modin & Verdier 2020"
DRIVE = sine((3, -2, 1), 0.4, phase=0.5, frame="space")
DRAG = damping([0.4, 0.2, 0.3])
ROTOR = damping(hat((1.5, -1.0, 2.0)))
HEAVY = with_gravity(SAMPLES["suslov"], 0.5, (0.1, 0.2, 0.3))

MOTIONS: dict[str, tuple[DirectorSystem, Load]] = {
    "Suslov body, free": (SAMPLES["suslov"], Load()),
    "Suslov body, forced": (SAMPLES["suslov"], DRIVE),
    "Suslov body, forced and damped": (SAMPLES["suslov"], DRIVE + DRAG),
    "heavy Suslov body with a rotor": (HEAVY, ROTOR),
    "non-twisting body, forced and damped": (SAMPLES["nontwisting"], DRIVE + DRAG),
    "heavy top with a rotor, damped": (SAMPLES["heavy_top"], ROTOR + DRAG),
}


def against_dop853() -> Iterator[Check]:
    """Compare attitudes and the work of the load at 2 s, and measure orders."""
    counts = (64, 128)
    for name, (body, load) in MOTIONS.items():
        how: Arguments = {"t_end": 2, "angular_velocity": KICK, "project": True, "load": load, "store": "end"}
        fine = integrate(body, step=1, integrator=SHARP, **how)
        run = integrate(body, step=0.01, integrator="gauss", order=8, **how)
        gap = run.directors[-1] - fine.directors[-1]
        yield error(f"{name}: directors at 2 s, gauss 8", gap, 1e-11, SOURCE, "independent")
        if load.terms:
            work = run.load_work - fine.load_work
            yield error(f"{name}: work of the load to 2 s, J", work, 1e-10, SOURCE, "independent")
        for scheme, k in SCHEMES:
            runs = [integrate(body, step=2 / n, integrator=scheme, order=k, **how) for n in counts]
            errors = [np.linalg.norm(run.directors[-1] - fine.directors[-1]) for run in runs]
            yield order(f"{name}: order of {scheme} {k}", k, counts, errors, 0.2, SOURCE)


def long_runs() -> Iterator[Check]:
    """Follow K + V over 10⁵ steps of a body that is not reversible, and the balance of work of a damped one."""
    how: Arguments = {"t_end": 1000, "step": 0.01, "angular_velocity": KICK, "project": True, "store": 100}
    for scheme, k in SCHEMES[:2]:
        run = integrate(HEAVY, load=ROTOR, integrator=scheme, order=k, **how)
        total = energy(run)
        kinetic = obs.kinetic_energy(run.director_velocities, HEAVY.euler_inertia).max()
        title = f"heavy Suslov body with a rotor, {scheme} {k}, 10⁵ steps: K + V, relative"
        yield error(title, (total - total[0]) / kinetic, 1e-12, SOURCE, "invariant")
    for scheme, k in SCHEMES:
        run = integrate(HEAVY, load=DRIVE + DRAG, integrator=scheme, order=k, **how)
        balance = np.diff(energy(run)) - run.load_work
        title = f"heavy Suslov body, forced and damped, {scheme} {k}, 10⁵ steps: K + V less work, relative"
        yield error(title, balance / abs(energy(run)).max(), 1e-12, SOURCE, "invariant")


CHECKS = {"orders": (orders, resampling), "nonreversible": (against_dop853, long_runs)}
