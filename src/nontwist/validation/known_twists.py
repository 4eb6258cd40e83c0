"""The twist of known motions, and how it differs from the swing–twist angle.

A triad given by ZYZ angles (φ, θ, χ) twists about its own z axis by ψ = ∫ (χ' + φ' cos θ) dt, here by Gauss quadrature.
The swing–twist angle τ of the rotation since the start differs from ψ by the solid angle Ω of the path of the axis,
closed by a great circle: τ - ψ = Ω modulo 2π.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from ..driver.runs import simulate
from ..loads import sine
from ..recordings.twisting import twist
from .checks import Check
from .problems import SAMPLES, all_are, error, order, turns_apart
from .sampled_frames import ORDERS, integral, path, turning

COUNTS = (160, 320, 640)


def orders() -> Iterator[Check]:
    """Measure the order of the twist of a motion in ZYZ angles."""
    exact = 4 + integral(turning, np.linspace(0, 2, 41))[-1]
    for k in ORDERS:
        errors = []
        for n in COUNTS:
            t = np.linspace(0, 2, n + 1)
            theta, phi = path(t)
            R = Rotation.from_euler("ZYZ", np.stack([phi, theta, t**2], axis=1))
            errors.append(abs(float(twist(R, t, order=k).twist_angle[-1]) - exact))
        yield order(f"twist of order {k}, ZYZ angles", k, COUNTS, errors, 0.1, "eq-w_twist")


def codman() -> Iterator[Check]:
    """Raise an arm that hangs sideways, swing it to the front, lower it: no twist, a quarter turn of swing–twist."""
    s, down = np.linspace(0, np.pi / 2, 91), Rotation.from_rotvec([np.pi, 0, 0])
    up = Rotation.from_rotvec(np.outer(s, [0, -1, 0])) * down
    front = Rotation.from_rotvec(np.outer(s, [0, 0, 1])) * up[-1]
    back = Rotation.from_rotvec(np.outer(s, [-1, 0, 0])) * front[-1]
    end = twist(Rotation.concatenate([up, front[1:], back[1:]]), order=2).isel(time=-1)
    yield error("Codman's paradox: twist, rad", float(end.twist_angle), 1e-12, "Codman 1934", "closed form")
    name = "Codman's paradox: swing–twist angle, rad"
    yield all_are(name, -np.pi / 2, end.swing_twist_angle, 1e-12, "Codman 1934", "closed form")


def random_motions() -> Iterator[Check]:
    """Compare τ - ψ with Ω on five random motions, and the twist of a joint with its own turn."""
    gaps, t = [], np.linspace(0, 4, 400)
    f = np.stack([np.sin((k + 1) * 0.7 * t + k) for k in range(3)], axis=1)
    spin = Rotation.from_rotvec(np.outer(t, [0, 0, 0.3]))
    for seed in range(5):
        a, b, n = np.split(np.random.default_rng(seed).normal(size=(7, 3)), [3, 6])
        R = Rotation.from_rotvec(f @ a) * Rotation.from_rotvec(f[::-1] @ b) * Rotation.from_rotvec([0.5, -1, 2])
        found = twist(R, t, axis=n[0])
        gaps.append(turns_apart(found.swing_twist_angle - found.twist_angle, found.solid_angle))
    yield error("τ - ψ - Ω of random motions, rad", gaps, 1e-6, "subs-non-twisting-frame", "invariant")
    gap = twist(R * spin, t, relative_to=R).twist_angle.values - 0.3 * t
    yield error("joint that turns at 0.3 rad/s: relative twist, rad", gap, 1e-12, "eq-w_twist", "closed form")


def runs() -> Iterator[Check]:
    """Measure the twist of simulated bodies: none, and ∫ w·d3 by Simpson's rule."""
    load = sine([3, 2, 0], 0.7)
    run = simulate(SAMPLES["nontwisting"], t_end=3, step=0.005, order=2, angular_velocity=(1, 2, 0), load=load)
    psi = twist(run, order=2).twist_angle.values
    yield error("loaded non-twisting body: twist, rad", psi, 1e-12, "eq-non-twisting", "invariant")
    run = simulate(SAMPLES["standard"], times=np.linspace(0, 3, 1201), angular_velocity=(1, 2, 3), integrator="exact")
    rate = run.twist_rate.values
    simpson = (rate[0] - rate[-1] + np.tile([4.0, 2.0], 600) @ rate[1:]) / 1200
    gap = float(twist(run).twist_angle[-1]) - simpson
    yield error("free standard body: twist less ∫ w·d3, rad", gap, 1e-7, "eq-w_twist", "closed form")


CHECKS = (orders, codman, random_motions, runs)
