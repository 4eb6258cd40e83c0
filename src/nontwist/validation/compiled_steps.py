"""The compiled steps compared with reference implementations that share no code.

The director scheme in two or three unknowns is compared with the paper's form in 16, and lie-midpoint with its
equations in NumPy, over 200 steps of 0.005 s. A random body moves under moments along its directors and along fixed
axes, the heavy body also with damping. λ and μ have the round-off of the velocities times |E|/h: their bound is
1e-11 max(1, |λ|) + 10 ε |E| |q̇|/h, and the number below is the largest fraction of it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..analysis.trajectory import Trajectory
from ..driver.runs import integrate
from ..integrators import Integrator
from ..loads import Load, body_moment, damping, space_moment
from .checks import Check
from .problems import Arguments, error, random_body, random_kinds, random_start
from .reference_steps import ReferenceEnergyMomentum, ReferenceLieMidpoint

STEP, SPAN = 0.005, 1.0
PLAIN: dict[str, tuple[Integrator, str]] = {
    "energy-momentum": (ReferenceEnergyMomentum(), "eq-discrete-nonholonomic"),
    "lie-midpoint": (ReferenceLieMidpoint(), "nontwist.integrators.lie_midpoint"),
}


def parity() -> Iterator[Check]:
    """Compare states and multipliers of a random body of every kind."""
    for seed, (words, (kind, heavy)) in enumerate(random_kinds().items()):
        rng = np.random.default_rng(seed)
        body, start, load = random_body(kind, heavy, rng), random_start(rng), random_load(rng)
        if heavy:
            load = load + damping(rng.uniform(0, 0.3, size=3))
        how: Arguments = {"t_end": SPAN, "step": STEP, "load": load, **start}
        for scheme, (plain, source) in PLAIN.items():
            one, other = integrate(body, integrator=scheme, order=2, **how), integrate(body, integrator=plain, **how)
            speed = max(1.0, float(abs(other.director_velocities).max()))
            gaps = [one.directors - other.directors, (one.director_velocities - other.director_velocities) / speed]
            yield error(f"{scheme}, {words}: states", gaps, 1e-11, source, "independent")
            if one.multipliers.size:
                title = f"{scheme}, {words}: λ and μ, fraction of the bound"
                yield error(title, share(one, other), 1.0, source, "independent")


def random_load(rng: np.random.Generator) -> Load:
    """Return a moment along the directors and one along fixed axes, both smooth."""
    a, b = rng.normal(size=(2, 3))
    return body_moment(lambda t: a * np.sin(2 * t)) + space_moment(lambda t: b * np.cos(t))


def share(one: Trajectory, other: Trajectory) -> float:
    """Return the largest difference of the multipliers over what round-off allows."""
    fastest = float(np.linalg.norm(other.director_velocities, axis=(1, 2)).max())
    noise = 10 * np.finfo(float).eps * float(np.linalg.norm(one.system.euler_inertia)) * fastest / STEP
    bound = 1e-11 * np.maximum(1, abs(other.multipliers)) + noise
    return float((abs(one.multipliers - other.multipliers) / bound).max())


CHECKS = (parity,)
