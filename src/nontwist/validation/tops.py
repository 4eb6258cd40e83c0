"""Heavy tops: Lagrange's closed-form solution, steady precession, and the benchmark of Brüls, Cardona & Arnold.

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

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipk

from ..driver.runs import integrate
from ..geometry.arrays import Array
from ..models.bodies import heavy_top, nontwisting, with_gravity
from .checks import Check
from .problems import FINE, Arguments, attitude, drift, energy, error, momentum, velocity

MASS, HEIGHT, GRAVITY = 15.0, 1.0, 9.81
CENTRE = np.array([0.0, HEIGHT, 0.0])
ABOUT_CENTRE = np.diag([0.234375, 0.46875, 0.234375])
INERTIA = ABOUT_CENTRE + MASS * (CENTRE @ CENTRE * np.eye(3) - np.outer(CENTRE, CENTRE))
ACROSS, ALONG, TORQUE = INERTIA[0, 0], INERTIA[1, 1], MASS * GRAVITY * HEIGHT
W0 = np.array([0.0, 150.0, -4.61538])
TOP = heavy_top(INERTIA, MASS, CENTRE, (0, 0, -GRAVITY))
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
    u: Array = u1 + (u2 - u1) * ellipj(ellipk(m) + rate * t, m)[0] ** 2
    return u


def benchmark() -> Iterator[Check]:
    """Compare the top at 2 s, three ways; follow its energy over 10⁵ steps."""
    how: Arguments = {"t_end": 2, "material_angular_velocity": W0}
    end = integrate(TOP, step=2, integrator=DOP853, **how)
    run = integrate(TOP, step=5e-4, store=400, integrator="gauss", order=8, **how)
    gap = attitude(run)[-1] - attitude(end)[-1]
    yield error("benchmark: Λ at 2 s, gauss 8 against DOP853", gap, 1e-9, BENCHMARK, "independent")
    gap = (velocity(run)[-1] - velocity(end)[-1]) / W0[1]
    yield error("benchmark: W at 2 s, the same, relative", gap, 1e-9, BENCHMARK, "independent")
    gap = attitude(run)[:, 2, 1] - lagrange(run.time)
    yield error("benchmark: height, gauss 8 against Lagrange, m", gap, 1e-11, LAGRANGE, "closed form")
    for scheme, k in (("lie-midpoint", 2), ("gauss", 8), ("energy-momentum", 2)):
        run = integrate(TOP, step=2e-5, store=100, integrator=scheme, order=k, **how)
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
    run = integrate(TOP, t_end=1, step=2.5e-4, store=1000, **how)
    turned = Rotation.from_rotvec(np.outer(rate * run.time, up)) * start
    turned *= Rotation.from_rotvec(np.outer((spin - rate * c) * run.time, CENTRE))
    gap = attitude(run) - turned.as_matrix()
    yield error("steady precession, 200 rad: Λ by gauss 8", gap, 1e-11, LAGRANGE, "closed form")


CHECKS = (benchmark, pendulum, precession)
