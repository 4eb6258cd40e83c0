"""Motions that are not reversible: forced, damped and gyroscopic bodies, general Suslov axes.

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
from ..driver.runs import integrate
from ..geometry.rotations import hat
from ..loads import Load, damping, sine
from ..models.bodies import with_gravity
from ..models.system import DirectorSystem
from .checks import Check
from .problems import KICK, SAMPLES, SCHEMES, SHARP, Arguments, energy, error, order

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


CHECKS = (against_dop853, long_runs)
