"""The Suslov body, W·n = 0 with an axis n that is not principal: velocities in closed form, attitudes by quadrature.

The digits in many_digits.json are sums of the Taylor series of the equations at 50 digits; two orders and step sizes
agree. The motion leads from one permanent rotation to the opposite one; it conserves the energy, but not Π1 and Π2.
lie-midpoint reaches the final rotation to round-off. The director scheme alternates about it by O(h²), which does not
decay (docs/errata.md, 7), so this is not checked for it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .. import exact
from ..driver.runs import integrate
from ..models.bodies import TILTED
from .checks import Check
from .free_bodies import many_digits
from .problems import FINE, FULL_J, KICK, SAMPLES, Arguments, attitude, drift, energy, error, order, velocity

SOURCE = "Suslov 1946; Bloch §8"
SCHEMES = ("lie-midpoint", "energy-momentum")


def digits() -> Iterator[Check]:
    """Compare the closed form with many digits, for both signs of cos θ0, forwards and backwards."""
    data = many_digits()
    for motion in data["suslov"]:
        R, W = exact.suslov(data["suslov_inertia"], [0, 0, 2], motion["velocity"], [motion["time"]])
        title = f"closed form, {motion['name']}, {motion['time']:g} s"
        yield error(f"{title}: W, rad/s", W[0] - motion["velocity_at_the_end"], 1e-13, SOURCE, "many digits")
        yield error(f"{title}: Λ", R[0] - motion["attitude"], 1e-12, SOURCE, "many digits")


def continuous() -> Iterator[Check]:
    """Compare the closed form with DOP853."""
    run = integrate(SAMPLES["suslov"], times=[0, 1, 2], material_angular_velocity=KICK, integrator=FINE)
    R, W = exact.suslov(FULL_J, TILTED, KICK, run.time)
    gaps = np.append(R - attitude(run), W - velocity(run))
    yield error("closed form, 2 s: Λ, W against DOP853", gaps, 1e-11, SOURCE, "independent")


def asymptotes() -> Iterator[Check]:
    """Check the energy, and the permanent rotations that the motion tends to."""
    W = exact.suslov_velocity(FULL_J, TILTED, KICK, [-400, -1, 0, 1, 400])
    K = np.einsum("ki,ij,kj->k", W, FULL_J, W)
    yield error("closed form: energy, relative", K / K[2] - 1, 1e-14, SOURCE, "invariant")
    yield error("closed form: W at 400 s plus W at -400 s, rad/s", W[-1] + W[0], 1e-14, SOURCE, "closed form")
    how: Arguments = {"t_end": 120, "step": 0.1, "material_angular_velocity": KICK, "order": 2}
    runs = {scheme: integrate(SAMPLES["suslov"], integrator=scheme, **how) for scheme in SCHEMES}
    for scheme, run in runs.items():
        yield error(f"{scheme} 2, 1200 steps: energy, relative", drift(energy(run)), 1e-12, SOURCE, "invariant")
    gap = velocity(runs["lie-midpoint"])[-1] - W[-1]
    yield error("lie-midpoint 2, 1200 steps: final W, rad/s", gap, 1e-9, SOURCE, "closed form")


def orders() -> Iterator[Check]:
    """Measure order 2 of both schemes against the closed form, to 0.01."""
    counts, t_end = (200, 400, 800), 4.0
    how: Arguments = {"t_end": t_end, "material_angular_velocity": KICK, "order": 2, "store": "end"}
    R, W = (x[0] for x in exact.suslov(FULL_J, TILTED, KICK, [t_end]))
    for scheme in SCHEMES:
        runs = [integrate(SAMPLES["suslov"], step=t_end / n, integrator=scheme, **how) for n in counts]
        turned = [np.linalg.norm(attitude(run)[-1] - R) for run in runs]
        speed = [np.linalg.norm(velocity(run)[-1] - W) for run in runs]
        yield order(f"{scheme} 2: Λ and W at 4 s", 2, counts, [turned, speed], 0.01, SOURCE)


CHECKS = (digits, continuous, asymptotes, orders)
