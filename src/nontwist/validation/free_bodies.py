"""Free motion: the closed-form solutions compared with many digits, DOP853 and the invariants.

The digits in many_digits.json come from the elliptic functions of the textbook (Landau & Lifshitz §37) at 40 digits and
agree with the Taylor series of the equations at 50. The tolerance is max(1e-13, 10 u), where u is the change of the
attitude if the last bit of one input changes: near the separatrix, 2K J_mid = |π|² (1 ± ε), the problem is
ill-conditioned. After 10⁶ turns the tolerance is 1e-15 per radian.

Montgomery's angle 2KT/|π| - Ω needs the solid angle Ω of the closed curve u = Π/|Π|: the integral of (1 - cos θ) dφ
about a pole p inside, cos θ = u·p, φ' = p·(u × u')/(1 - cos² θ). It is computed by the trapezoidal rule, which
converges exponentially on a closed curve.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.resources import files
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from .. import exact
from ..driver.runs import integrate
from ..fitting import fit_inertia
from ..geometry import rotations
from ..geometry.arrays import Array
from ..integrators import Split
from ..io.results import with_euler
from ..loads import rotor, wheel
from ..models.bodies import standard
from .checks import Check
from .problems import FINE, FULL_J, PAPER_J, SAMPLES, attitude, error, solved, turns_apart, velocity

RED, TOP, SYMMETRIC = "eq-nonholonomic-red", "Landau & Lifshitz §37; Whittaker §69", "Landau & Lifshitz §35"
GYROSTAT, FIT = "Wittenburg 1977", "nontwist.fitting.shooting"


def many_digits() -> Any:
    """Return the motions whose attitude is known to all digits of a double."""
    return json.loads(files(__package__).joinpath("many_digits.json").read_text(encoding="utf-8"))


def nontwisting_body() -> Iterator[Check]:
    """Compare every solution and integrator with the rotation about a fixed axis."""
    W, body = np.array([6.0, -18, 0]), SAMPLES["nontwisting"]
    turned = Rotation.from_rotvec(np.outer([2.5, 5], W)).as_matrix()
    gap = exact.free_nontwisting(PAPER_J, W, [2.5, 5])[0] - turned
    yield error("non-twisting body, 95 rad: exact.free_nontwisting", gap, 1e-13, RED, "closed form")
    for k in Split.orders:
        run = integrate(body, t_end=5, step=2.5, material_angular_velocity=W, integrator="split", order=k)
        gap = attitude(run)[1:] - turned
        yield error(f"non-twisting body, 95 rad: split {k}, two steps", gap, 1e-13, RED, "closed form")
    run = integrate(body, times=[0, 1], material_angular_velocity=W, integrator=FINE)
    gap = attitude(run)[-1] - Rotation.from_rotvec(W).as_matrix()
    yield error("non-twisting body, 19 rad: continuous equations", gap, 1e-11, RED, "closed form")


def digits() -> Iterator[Check]:
    """Compare every branch of the standard body with 40 digits, and its invariants at 400 phases."""
    for motion in many_digits()["free"]:
        J, W, t = np.array(motion["moments"]), np.array(motion["velocity"]), motion["time"]
        angle = float(np.linalg.norm(W)) * t
        allowed = max(1e-13, 10 * motion["one_ulp"]) if angle < 100 else 1e-15 * angle
        gap = np.linalg.norm(exact.free_standard(J, W, [t])[0][0] - motion["attitude"]) / np.sqrt(2)
        yield error(f"standard body, {motion['name']}: Λ", gap, allowed, TOP, "many digits")
        if "separatrix" in motion["name"]:
            R, w = exact.free_standard(J, W, np.linspace(0, t, 400))
            pi = J * W
            change = np.ravel(R @ (J * w)[..., None] - pi[:, None]) / np.linalg.norm(pi)
            kept = np.append(change, (w**2 @ J) / (J @ W**2) - 1)
            yield error(f"standard body, {motion['name']}: π, K, relative", kept, 2e-14, TOP, "invariant")


def continuous() -> Iterator[Check]:
    """Compare the standard body with DOP853, on both sides of the separatrix and with axes that are not principal."""
    motions = {"full inertia": (FULL_J, np.array([3.0, -6, 1]))}
    motions["moments of no body (2, 1, 2/3)"] = np.diag([2, 1, 2 / 3]), np.array([1.0, -2, 4])
    for motion in many_digits()["free"]:
        if "1e-08" in motion["name"]:
            motions[motion["name"].split(",")[0]] = np.diag(motion["moments"]), 15 * np.array(motion["velocity"])
    for name, (J, W) in motions.items():
        run = integrate(standard(J, physical=False), times=[0, 1, 2], material_angular_velocity=W, integrator=FINE)
        R, w = exact.free_standard(J, W, run.time, physical=False)
        gaps = np.append(R - attitude(run), w - velocity(run))
        yield error(f"standard body, {name}, 2 s: Λ, W against DOP853", gaps, 1e-11, TOP, "independent")


def symmetric() -> Iterator[Check]:
    """Compare bodies with equal moments with two rotations one after the other, permanent rotations against one."""
    t, W = np.linspace(-2, 9, 12), np.array([1.0, 2, -3])
    for name, (A, C) in {"oblate": (3, 5), "prolate": (3, 1), "sphere": (2, 2)}.items():
        precession = Rotation.from_rotvec(np.outer(t, W * [1, 1, C / A]))
        spin = Rotation.from_rotvec(np.outer(t, [0, 0, (A - C) / A * W[2]]))
        for solution in (exact.symmetric_top, exact.free_standard):
            gap = solution([A, A, C], W, t)[0] - (precession * spin).as_matrix()
            title = f"symmetric body, {name}: exact.{solution.__name__}"
            yield error(title, gap, 1e-13, SYMMETRIC, "closed form")
    gaps = []
    for axis in ([2.0, 0, 0], [0, -2.0, 0], [0, 0, 2.0]):
        turned = Rotation.from_rotvec(np.outer(t, axis)).as_matrix()
        gaps.append(exact.free_standard([3, 4, 5], axis, t)[0] - turned)
    yield error("spin about each principal axis: Λ", gaps, 1e-13, "eq-standard", "closed form")


def gyrostat() -> Iterator[Check]:
    """Compare a body with rotors with one rotation, where π is parallel to W, with DOP853, and its invariants."""
    t, W = np.linspace(-2, 9, 12), np.array([0.5, -0.3, 0.8])
    for size in (8.0, 3.6):
        gap = (
            exact.free_gyrostat(FULL_J, size * W - FULL_J @ W, W, t)[0]
            - Rotation.from_rotvec(np.outer(t, W)).as_matrix()
        )
        yield error(f"gyrostat, permanent rotation, π = {size:g} W: Λ", gap, 1e-12, GYROSTAT, "closed form")
    c, W = np.array([1.0, -2, 0.5]), np.array([0.4, -1.1, 0.7])
    load = rotor("x", c[0]) + rotor("y", c[1]) + rotor("z", c[2])
    run = integrate(standard(FULL_J), times=[0, 4, 8], material_angular_velocity=W, load=load, integrator=FINE)
    R, w = exact.free_gyrostat(FULL_J, c, W, run.time)
    yield error(
        "gyrostat, 8 s: Λ, W against DOP853",
        np.append(R - attitude(run), w - velocity(run)),
        1e-11,
        GYROSTAT,
        "independent",
    )
    R, w = exact.free_gyrostat(FULL_J, c, W, np.linspace(0, 100, 400))
    pi = FULL_J @ W + c
    change = np.ravel(np.einsum("kij,kj->ki", R, w @ FULL_J + c) - pi) / np.linalg.norm(pi)
    kept = np.append(change, np.einsum("ki,ij,kj->k", w, FULL_J, w) / (W @ FULL_J @ W) - 1)
    yield error("gyrostat, 100 s: π, K, relative", kept, 1e-13, GYROSTAT, "invariant")


def driven_wheel() -> Iterator[Check]:
    """Compare a hub of 2 kg m², and a wheel that a motor drives with 0.2 N m from 5 to 10 s, with their momenta."""
    inertia, speed = 0.159155, 628.0
    load = wheel("z", inertia, speed=speed, torque=([5, 10], [0.2, 0.2]))
    for scheme in ("gauss", "lie-midpoint", "energy-momentum"):
        body = standard([2, 2, 2 + inertia])
        run = integrate(body, t_end=10, step=0.5, angular_velocity=(0, 0, 0.35), load=load, integrator=scheme)
        gap = [run.material_angular_velocity[-1, 2] + 0.15, run.wheel_momentum[-1, 0] - inertia * (speed + 0.35) - 1]
        yield error(f"driven wheel, {scheme}: W₃ of the hub, momentum", gap, 1e-12, GYROSTAT, "closed form")


def montgomery() -> Iterator[Check]:
    """Compare the geometric phase, and the state after one period of the momentum."""
    moments = np.diag([3.0, 4, 5])
    motions = {
        "largest moment": (moments, [1.0, 1, 5]),
        "smallest moment": (moments, [5.0, 1, -1]),
        "inertia of the paper": (PAPER_J, [6.0, -18, 1]),
        "full inertia": (FULL_J, [1.0, -2, -3]),
    }
    for name, (J, start) in motions.items():
        W = np.array(start)
        pi, T = J @ W, exact.momentum_period(J, W)
        size = float(np.linalg.norm(pi))
        _, w = exact.free_standard(J, W, np.arange(4000) * T / 4000)
        u = w @ J / size
        pole = u.mean(0) / np.linalg.norm(u.mean(0))
        area = (np.cross(u, np.cross(u, w)) @ pole / (1 + u @ pole)).mean() * T
        angle = exact.montgomery_angle(J, W)
        gap = turns_apart(angle, W @ pi * T / size - area)
        yield error(f"Montgomery's angle, {name}, rad", gap, 1e-9, "Montgomery 1991", "closed form")
        R, back = (x[0] for x in exact.free_standard(J, W, [T]))
        gaps = np.append(R - rotations.exp(angle * pi / size), back - W)
        yield error(f"after one period of the momentum, {name}: Λ, W", gaps, 1e-12, "Montgomery 1991", "closed form")


def euler_angles() -> Iterator[Check]:
    """Turn a symmetric body about its momentum, along z: by Euler angles ZXZ, φ and ψ at constant rates and θ not."""
    J1, J3, theta, size, t = 2.0, 3.0, 0.7, 5.0, np.linspace(0, 3, 31)
    rates = np.array([size / J1, 0, size * np.cos(theta) * (1 / J3 - 1 / J1)])
    W = size * np.array([0, np.sin(theta) / J1, np.cos(theta) / J3])
    tilted = Rotation.from_euler("ZXZ", [0, theta, 0])
    body = standard([J1, J1, J3])
    run = integrate(body, times=t, tolerance=1e-13, rotation=tilted, material_angular_velocity=W).to_dataset()
    found = with_euler(run, "ZXZ")
    gap = np.unwrap(found.euler_angles.values, axis=0) - [0, theta, 0] - np.outer(t, rates)
    yield error("symmetric body: Euler angles", gap, 1e-13, SYMMETRIC, "closed form")
    gap = found.euler_rates.values - rates
    yield error("symmetric body: rates of Euler angles, rad/s", gap, 1e-13, SYMMETRIC, "closed form")


def fitted() -> Iterator[Check]:
    """Fit moments to angular velocities that DOP853 finds, alone and with a rotor that gives the scale."""
    J, W0, t, axis = np.array([1.0, 1.6, 2.1]), [3.0, 2.0, 4.0], np.linspace(0, 2, 801), np.array([0.0, 0.6, 0.8])

    def rates(t: float, y: Array) -> Array:
        return np.append(np.cross(J * y[:3] + y[3] * axis, y[:3]) / J, 0.0)

    for name, h in {"of a throw": 0.0, "of a throw with a rotor, kg m²": 0.8}.items():
        W = solved(rates, t, [*W0, h])[:, :3]
        how: dict[str, Any] = {"rotor": {"axis": axis, "inertia": 0.1, "speed": h / 0.1}} if h else {}
        found = fit_inertia((t, W), interval="all", noise=1e-6, bias=1e-9, scale=1e-9, **how).principal.moments
        yield error(f"moments {name}, fitted", found - (J if h else J / J.sum()), 1e-9, FIT, "independent")


CHECKS = (nontwisting_body, digits, continuous, symmetric, gyrostat, driven_wheel, montgomery, euler_angles, fitted)
