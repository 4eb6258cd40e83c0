"""Validation of motions in closed form, and of the fit of an inertia.

**free**: Free motion: the closed-form solutions compared with many digits, DOP853 and the invariants.

The digits in many_digits.json come from the elliptic functions of the textbook (Landau & Lifshitz §37) at 40 digits and
agree with the Taylor series of the equations at 50. The tolerance is max(1e-13, 10 u), where u is the change of the
attitude if the last bit of one input changes: near the separatrix, 2K J_mid = |π|² (1 ± ε), the problem is
ill-conditioned. After 10⁶ turns the tolerance is 1e-15 per radian.

Montgomery's angle 2KT/|π| - Ω needs the solid angle Ω of the closed curve u = Π/|Π|: the integral of (1 - cos θ) dφ
about a pole p inside, cos θ = u·p, φ' = p·(u × u')/(1 - cos² θ). It is computed by the trapezoidal rule, which
converges exponentially on a closed curve.

**suslov**: The Suslov body, W·n = 0 with an axis n that is not principal: velocities in closed form, attitudes by
quadrature.

The digits in many_digits.json are sums of the Taylor series of the equations at 50 digits; two orders and step sizes
agree. The motion leads from one permanent rotation to the opposite one; it conserves the energy, but not Π1 and Π2.
lie-midpoint reaches the final rotation to round-off. The director scheme alternates about it by O(h²), which does not
decay (docs/errata.md, 7), so this is not checked for it.

**tops**: Heavy tops: Lagrange's closed-form solution, steady precession, and the benchmark of Brüls, Cardona & Arnold.

For a symmetric top, let A be the moment of inertia across its axis, about the fixed point; C that about the axis; l the
height of the centre of mass along it; p = C W·axis and π_z the two conserved momenta; and E the energy less p²/2C. The
height u of the axis satisfies (Whittaker, Analytical Dynamics, §71; Landau & Lifshitz, Mechanics, §35)

    u'² = (1 - u²) (2E - 2mgl u)/A - (π_z - p u)²/A² = (2mgl/A) (u - u1)(u - u2)(u - u3),      u1 <= u <= u2 < u3,

so from a start at u2 it is u = u1 + (u2 - u1) sn²(K(k) + t √(mgl (u3 - u1)/2A)), k² = (u2 - u1)/(u3 - u1).

Benchmark: m = 15 kg, centre of mass at (0, 1, 0) m, J = diag(0.234375, 0.46875, 0.234375) kg m² about it (the package
takes J about the fixed point), W = (0, 150, -4.61538) rad/s, 2 s. Here π_z = -p up to rounding: the axis falls to the
vertical and then turns about it very fast, which makes this a hard test.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from typing import Any

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipk

from .. import exact
from ..driver.runs import integrate
from ..fitting import fit_inertia
from ..fitting.telling import quantile
from ..geometry import rotations
from ..geometry.arrays import Array
from ..integrators import Split
from ..io.run_files import with_euler
from ..loads import rotor, wheel
from ..models.bodies import TILTED, heavy_top, nontwisting, standard, with_gravity
from .checks import Check
from .problems import (
    FINE,
    FULL_J,
    KICK,
    PAPER_J,
    SAMPLES,
    Arguments,
    attitude,
    drift,
    energy,
    error,
    momentum,
    order,
    solved,
    spun,
    turns_apart,
    velocity,
)

RED, TOP, SYMMETRIC = "eq-nonholonomic-red", "Landau & Lifshitz §37; Whittaker §69", "Landau & Lifshitz §35"
GYROSTAT, FIT, SLOW = "Wittenburg 1977", "nontwist.fitting.shooting", "nontwist.fitting.slow_noise"


def many_digits() -> Any:
    """Return the motions whose attitude is known to all digits of a double."""
    return json.loads(files(__package__).joinpath("many_digits.json").read_text(encoding="utf-8"))


def nontwisting_body() -> Iterator[Check]:
    """Compare every solution and integrator with the rotation about a fixed axis."""
    W, body = np.array([6.0, -18, 0]), SAMPLES["nontwisting"]
    turned = spun([2.5, 5], W).as_matrix()
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
        precession = spun(t, W * [1, 1, C / A])
        spin = spun(t, [0, 0, (A - C) / A * W[2]])
        for solution in (exact.symmetric_top, exact.free_standard):
            gap = solution([A, A, C], W, t)[0] - (precession * spin).as_matrix()
            title = f"symmetric body, {name}: exact.{solution.__name__}"
            yield error(title, gap, 1e-13, SYMMETRIC, "closed form")
    gaps = []
    for axis in ([2.0, 0, 0], [0, -2.0, 0], [0, 0, 2.0]):
        turned = spun(t, axis).as_matrix()
        gaps.append(exact.free_standard([3, 4, 5], axis, t)[0] - turned)
    yield error("spin about each principal axis: Λ", gaps, 1e-13, "eq-standard", "closed form")


def gyrostat() -> Iterator[Check]:
    """Compare a body with rotors with one rotation, where π is parallel to W, with DOP853, and its invariants."""
    t, W = np.linspace(-2, 9, 12), np.array([0.5, -0.3, 0.8])
    for size in (8.0, 3.6):
        gap = exact.free_gyrostat(FULL_J, size * W - FULL_J @ W, W, t)[0] - spun(t, W).as_matrix()
        yield error(f"gyrostat, permanent rotation, π = {size:g} W: Λ", gap, 1e-12, GYROSTAT, "closed form")
    c, W = np.array([1.0, -2, 0.5]), np.array([0.4, -1.1, 0.7])
    load = rotor("x", c[0]) + rotor("y", c[1]) + rotor("z", c[2])
    run = integrate(standard(FULL_J), times=[0, 4, 8], material_angular_velocity=W, load=load, integrator=FINE)
    R, w = exact.free_gyrostat(FULL_J, c, W, run.time)
    gaps = np.append(R - attitude(run), w - velocity(run))
    yield error("gyrostat, 8 s: Λ, W against DOP853", gaps, 1e-11, GYROSTAT, "independent")
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


def under_slow_noise() -> Iterator[Check]:
    """Simulate noise that goes on for a 40th of a throw: how often intervals of a linear fit hold its inertia."""
    rng, t = np.random.default_rng(0), np.linspace(0, 2, 200)
    run = integrate(standard([1, 1.6, 2.1]), times=t, material_angular_velocity=[3, 2, 4], integrator=FINE)
    fit = fit_inertia((t, velocity(run) + 1e-3 * rng.normal(size=(200, 3))), interval="all").solution
    (rows,), found, phi = fit.residuals.rates, list[Array](), np.exp(-40 / 200)
    A = rows.A @ fit.of_columns[rows.columns]  # in these unknowns their covariance is 1
    for e in rng.normal(size=(24, 200, 3)):
        e = lfilter([np.sqrt(1 - phi**2)], [1, -phi], np.concatenate([e, e]), axis=0)[200:].ravel()
        x = -A.T @ e
        one = replace(fit, residuals=fit.residuals._replace(rates=[rows._replace(r=e + A @ x)]))
        errors = np.sqrt(np.linalg.inv(one.trusted).diagonal()) * one.spread / one.problem.noise
        found.append(abs(fit.unit[: fit.own] @ x) < quantile(one) * errors)
    measured = float(np.mean(found))
    yield Check("intervals of 95 % under slow noise: share that holds", 0.94, measured, 0.04, SLOW, "independent")


SUSLOV = "Suslov 1946; Bloch §8"
SUSLOV_SCHEMES = ("lie-midpoint", "energy-momentum")


def suslov_digits() -> Iterator[Check]:
    """Compare the closed form with many digits, for both signs of cos θ0, forwards and backwards."""
    data = many_digits()
    for motion in data["suslov"]:
        R, W = exact.suslov(data["suslov_inertia"], [0, 0, 2], motion["velocity"], [motion["time"]])
        title = f"closed form, {motion['name']}, {motion['time']:g} s"
        yield error(f"{title}: W, rad/s", W[0] - motion["velocity_at_the_end"], 1e-13, SUSLOV, "many digits")
        yield error(f"{title}: Λ", R[0] - motion["attitude"], 1e-12, SUSLOV, "many digits")


def suslov_continuous() -> Iterator[Check]:
    """Compare the closed form with DOP853."""
    run = integrate(SAMPLES["suslov"], times=[0, 1, 2], material_angular_velocity=KICK, integrator=FINE)
    R, W = exact.suslov(FULL_J, TILTED, KICK, run.time)
    gaps = np.append(R - attitude(run), W - velocity(run))
    yield error("closed form, 2 s: Λ, W against DOP853", gaps, 1e-11, SUSLOV, "independent")


def asymptotes() -> Iterator[Check]:
    """Check the energy, and the permanent rotations that the motion tends to."""
    W = exact.suslov_velocity(FULL_J, TILTED, KICK, [-400, -1, 0, 1, 400])
    K = np.einsum("ki,ij,kj->k", W, FULL_J, W)
    yield error("closed form: energy, relative", K / K[2] - 1, 1e-14, SUSLOV, "invariant")
    yield error("closed form: W at 400 s plus W at -400 s, rad/s", W[-1] + W[0], 1e-14, SUSLOV, "closed form")
    how: Arguments = {"t_end": 120, "step": 0.1, "material_angular_velocity": KICK, "order": 2}
    runs = {scheme: integrate(SAMPLES["suslov"], integrator=scheme, **how) for scheme in SUSLOV_SCHEMES}
    for scheme, run in runs.items():
        yield error(f"{scheme} 2, 1200 steps: energy, relative", drift(energy(run)), 1e-12, SUSLOV, "invariant")
    gap = velocity(runs["lie-midpoint"])[-1] - W[-1]
    yield error("lie-midpoint 2, 1200 steps: final W, rad/s", gap, 1e-9, SUSLOV, "closed form")


def suslov_orders() -> Iterator[Check]:
    """Measure order 2 of both schemes against the closed form, to 0.01."""
    counts, t_end = (200, 400, 800), 4.0
    how: Arguments = {"t_end": t_end, "material_angular_velocity": KICK, "order": 2, "store": "end"}
    R, W = (x[0] for x in exact.suslov(FULL_J, TILTED, KICK, [t_end]))
    for scheme in SUSLOV_SCHEMES:
        runs = [integrate(SAMPLES["suslov"], step=t_end / n, integrator=scheme, **how) for n in counts]
        turned = [np.linalg.norm(attitude(run)[-1] - R) for run in runs]
        speed = [np.linalg.norm(velocity(run)[-1] - W) for run in runs]
        yield order(f"{scheme} 2: Λ and W at 4 s", 2, counts, [turned, speed], 0.01, SUSLOV)


MASS, HEIGHT, GRAVITY = 15.0, 1.0, 9.81
CENTRE = np.array([0.0, HEIGHT, 0.0])
ABOUT_CENTRE = np.diag([0.234375, 0.46875, 0.234375])
INERTIA = ABOUT_CENTRE + MASS * (CENTRE @ CENTRE * np.eye(3) - np.outer(CENTRE, CENTRE))
ACROSS, ALONG, TORQUE = INERTIA[0, 0], INERTIA[1, 1], MASS * GRAVITY * HEIGHT
W0 = np.array([0.0, 150.0, -4.61538])
BENCHMARK_TOP = heavy_top(INERTIA, MASS, CENTRE, (0, 0, -GRAVITY))
DOP853 = replace(FINE, form="director")  # the quicker form
PENDULUM = "Landau & Lifshitz §11"
BENCHMARK, LAGRANGE = "Brüls, Cardona & Arnold 2012", "Whittaker §71; Landau & Lifshitz §35"


def lagrange(t: Array) -> Array:
    """Return the height of the axis at the times `t` of the benchmark, which starts at rest at u = 0."""
    p, pi_z, E = ALONG * W0[1], ACROSS * W0[2], ACROSS * W0[2] ** 2 / 2
    quadratic = np.polymul([-1, 0, 1], np.array([-2 * TORQUE, 2 * E]) / ACROSS)
    cubic = np.polysub(quadratic, np.polymul([-p, pi_z], [-p, pi_z]) / ACROSS**2)
    u1, u2, u3 = np.sort(np.roots(cubic).real)
    m, rate = (u2 - u1) / (u3 - u1), np.sqrt(TORQUE * (u3 - u1) / (2 * ACROSS))
    return u1 + (u2 - u1) * ellipj(ellipk(m) + rate * t, m)[0] ** 2


def benchmark() -> Iterator[Check]:
    """Compare the top at 2 s, three ways; follow its energy over 10⁵ steps."""
    how: Arguments = {"t_end": 2, "material_angular_velocity": W0}
    end = integrate(BENCHMARK_TOP, step=2, integrator=DOP853, **how)
    run = integrate(BENCHMARK_TOP, step=5e-4, store=400, integrator="gauss", order=8, **how)
    gap = attitude(run)[-1] - attitude(end)[-1]
    yield error("benchmark: Λ at 2 s, gauss 8 against DOP853", gap, 1e-9, BENCHMARK, "independent")
    gap = (velocity(run)[-1] - velocity(end)[-1]) / W0[1]
    yield error("benchmark: W at 2 s, the same, relative", gap, 1e-9, BENCHMARK, "independent")
    gap = attitude(run)[:, 2, 1] - lagrange(run.time)
    yield error("benchmark: height, gauss 8 against Lagrange, m", gap, 1e-11, LAGRANGE, "closed form")
    for scheme, k in (("lie-midpoint", 2), ("gauss", 8), ("energy-momentum", 2)):
        run = integrate(BENCHMARK_TOP, step=2e-5, store=100, integrator=scheme, order=k, **how)
        title = f"benchmark, {scheme} {k}, 10⁵ steps"
        yield error(f"{title}: energy, relative", drift(energy(run)), 1e-12, BENCHMARK, "invariant")
        yield error(f"{title}: π·e3, relative", drift(momentum(run)[:, 2]), 1e-12, LAGRANGE, "invariant")


def pendulum() -> Iterator[Check]:
    """Let a point on a massless rod, J3 = 0, swing in a plane from rest, 2 rad from the lowest place."""
    body, t, amplitude = with_gravity(nontwisting([1, 1, 0]), 1, (0, 0, -1)), np.linspace(0, 6, 13), 2.0
    run = integrate(body, times=t, rotation=Rotation.from_rotvec([amplitude, 0, 0]), integrator=DOP853)
    k = np.sin(amplitude / 2)
    sn = ellipj(ellipk(k**2) + np.sqrt(9.81) * t, k**2)[0]
    gap = attitude(run)[:, 2, 2] - (1 - 2 * (k * sn) ** 2)
    yield error("pendulum, a point on a rod without mass: cosine of its angle", gap, 1e-10, PENDULUM, "closed form")


def precession() -> Iterator[Check]:
    """Let the same body precess evenly, 1 rad from the vertical: A Ω² cos θ - p Ω + mgl = 0, Ω the slower rate."""
    theta, spin, p = 1.0, 200.0, ALONG * 200.0
    c = np.cos(theta)
    rate = (p - np.sqrt(p**2 - 4 * ACROSS * TORQUE * c)) / (2 * ACROSS * c)
    start, up = Rotation.from_rotvec([np.pi / 2 - theta, 0, 0]), np.array([0, 0, 1.0])
    W = rate * start.inv().apply(up) + (spin - rate * c) * CENTRE
    how: Arguments = {"rotation": start, "material_angular_velocity": W, "integrator": "gauss", "order": 8}
    run = integrate(BENCHMARK_TOP, t_end=1, step=2.5e-4, store=1000, **how)
    turned = spun(rate * run.time, up) * start
    turned *= spun((spin - rate * c) * run.time, CENTRE)
    gap = attitude(run) - turned.as_matrix()
    yield error("steady precession, 200 rad: Λ by gauss 8", gap, 1e-11, LAGRANGE, "closed form")


CHECKS = {
    "free": (
        nontwisting_body,
        digits,
        continuous,
        symmetric,
        gyrostat,
        driven_wheel,
        montgomery,
        euler_angles,
        fitted,
        under_slow_noise,
    ),
    "suslov": (suslov_digits, suslov_continuous, asymptotes, suslov_orders),
    "tops": (benchmark, pendulum, precession),
}
