"""Validation of bodies under load.

**loaded**: Bodies under load: closed-form solutions, quadratures, and the order of the multiplier μ.

**The multiplier.** Testing J W' = J W × W + M - μ n with J⁻¹ n, where n·W' = 0, gives

    μ = n·J⁻¹ (J W × W + M)/(n·J⁻¹ n),

where M is the moment in body components, including gravity; for the non-twisting body this is Π·(W × E3) + M3. The
discrete μ of a step is compared with this value at the middle of the step, on states of the continuous equations; the
error is the largest of all steps.

The μ of the director scheme alternates by O(h) about values of order 2 (`integrators.energy_momentum`, Order), so the
mean of two steps is compared. In the paper's cases, where W or W' is 0 at the start, every single μ is compared.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from .. import exact
from ..analysis import variables as obs
from ..analysis.trajectory import Trajectory
from ..driver.runs import integrate
from ..geometry.arrays import Array
from ..integrators import Exact
from ..loads import Load, body_moment, damping, dry_friction, gravity_gradient, memory_load, pulse, sine, wheel
from ..models.bodies import heavy_top, standard, with_gravity
from ..models.system import DirectorSystem
from ..paper.tables import CASES
from .checks import Check
from .problems import FINE, KICK, PAPER_J, SAMPLES, Arguments, attitude, error, momentum, order, pushed, solved

BODY = SAMPLES["nontwisting"]
ELLIPSE = "nontwist.loads.potentials"
FRICTION, BEARING, OIL = "nontwist.driver.rubbing", "nontwist.driver.contacts", "nontwist.driver.grid"
LAG = "nontwist.loads.memory_terms"
RED, TRIANGLE, SPLIT = "eq-nonholonomic-red", "eq-loads_time_variation", "eq-nonholonomic"


def fixed_axis() -> Iterator[Check]:
    """Turn from rest about a fixed axis (case 2 of the paper): angles are double integrals of the triangle."""
    peak, times = np.array([-123.625, -53.75, 0]), np.array([0.5, 1, 2, 3])
    rate = np.linalg.solve(PAPER_J, peak)
    R, W = exact.loaded_nontwisting(PAPER_J, [0, 0, 0], pulse(peak), times)
    angle, speed = [1 / 24, 1 / 4, 3 / 4, 5 / 4], [1 / 4, 1 / 2, 1 / 2, 1 / 2]
    gap = R - Rotation.from_rotvec(np.outer(angle, rate)).as_matrix()
    yield error("triangle about a fixed axis: Λ", gap, 1e-13, TRIANGLE, "closed form")
    yield error("triangle about a fixed axis: W, rad/s", W - np.outer(speed, rate), 1e-13, TRIANGLE, "closed form")


def quadratures() -> Iterator[Check]:
    """Integrate the moment to Π_⊥: with a kink and a jump that no breakpoint names, and by Gauss' nodes of `split`."""
    load, t = body_moment(lambda s: (abs(s - 0.7), 2.0 * (s >= 1.3), 5.0)), np.array([0.2, 1.0, 2.0])
    Pi = exact.loaded_momentum([3, 4, 5], [1, -2, 0], load, t, t_start=0.1)
    integral = np.stack([3.18 + np.sign(t - 0.7) * (t - 0.7) ** 2 / 2, -8 + 2 * np.maximum(t - 1.3, 0)], axis=1)
    yield error("Π_⊥ under a moment with a kink and a jump", Pi[:, :2] - integral, 2e-14, RED, "closed form")
    for k in (2, 4, 6):
        run = integrate(BODY, t_end=2, step=0.5, load=powers(k), integrator="split", order=k)
        Pi, t = obs.material(run.directors, momentum(run)), run.time
        gap = Pi[:, :2] - np.stack([t**k / k, t**2 / 2 - t], axis=1)
        yield error(f"split {k}: Π_⊥ under a polynomial of degree {k - 1}", gap, 1e-14, RED, "closed form")


def powers(k: int) -> Load:
    """Return the moment (t^(k-1), t - 1, 0) along the moving directors."""
    return body_moment(lambda t: (t ** (k - 1), t - 1, 0))


def integrators() -> Iterator[Check]:
    """Compare integrators with DOP853 at 1e-13: states, work and reaction of `exact`; case 3 of the paper."""
    load = pulse(PAPER_J @ [4, -8, 0], 0.3, 0.9) + body_moment([0, 1, 2], [[0, 0, 1], [0, 0, 2], [0, 0, 0]])
    how: Arguments = {"material_angular_velocity": (1, -2, 0), "load": load}
    fine = integrate(BODY, times=[0, 0.35, 1, 1.7], integrator=FINE, **how)
    run = integrate(BODY, times=fine.time, integrator=Exact(), **how)
    gap = run.directors - fine.directors
    yield error("exact, loaded about a fixed axis: directors", gap, 1e-11, SPLIT, "independent")
    gaps = np.append(run.multipliers - fine.multipliers, run.load_work - fine.load_work)
    yield error("exact, loaded about a fixed axis: mean μ, work", gaps, 1e-10, SPLIT, "independent")
    case: Arguments = {"material_angular_velocity": CASES[3].angular_velocity, "load": CASES[3].load()}
    end = attitude(integrate(BODY, times=[0, 5], integrator=FINE, **case))[-1]
    for scheme, k in (("split", 6), ("gauss", 8)):
        run = integrate(BODY, t_end=5, step=0.005, store="end", integrator=scheme, order=k, **case)
        yield error(f"case 3 at 5 s: Λ by {scheme} {k}", attitude(run)[-1] - end, 1e-11, "sec-results", "independent")


def orbit() -> Iterator[Check]:
    """Let a body tumble on an ellipse: the orbit by Newton's law of gravity beside Euler's equations, by DOP853."""
    n, e, J, W0 = 1.0, 0.3, np.array([3.0, 4.0, 5.0]), np.array([0.1, 0.2, 1.2])

    def rates(t: float, y: Array) -> Array:
        q, W, r, v = y[:9].reshape(3, 3), y[9:12], y[12:15], y[15:]
        size = np.sqrt(r @ r)
        c = q @ r / size
        moment = 3 * n**2 / size**3 * np.cross(c, J * c)
        return np.concatenate([np.cross(W @ q, q).ravel(), (np.cross(J * W, W) + moment) / J, v, -(n**2) * r / size**3])

    fastest = n * np.sqrt((1 + e) / (1 - e))
    start = np.concatenate([np.eye(3).ravel(), W0, [1 - e, 0, 0], [0, fastest, 0]])
    end = solved(rates, [0, 10], start)[-1, :9].reshape(3, 3).T
    how: Arguments = {"material_angular_velocity": W0, "load": gravity_gradient(n, eccentricity=e)}
    run = integrate(standard(J), t_end=10, step=0.02, integrator="gauss", order=8, **how)
    yield error("tumbling on an ellipse: Λ after 10 s", attitude(run)[-1] - end, 1e-10, ELLIPSE, "independent")


MOTIONS: dict[str, tuple[DirectorSystem, tuple[float, float, float], Load]] = {
    "case 2 of the paper": (BODY, CASES[2].angular_velocity, CASES[2].load()),
    "case 3 of the paper": (BODY, CASES[3].angular_velocity, CASES[3].load()),
    "load in space": (BODY, (1, -2, 0), sine((3, 1, 0.3), 0.5, phase=1, frame="space")),
    "Suslov body": (SAMPLES["suslov"], KICK, pushed("space")),
    "heavy Suslov body": (with_gravity(SAMPLES["suslov"], 0.5, (0.1, 0.2, 0.3)), KICK, pushed("body")),
}
COUNTS, T_END = (150, 300, 600), 1.5


def exact_multiplier(states: Trajectory, load: Load) -> Array:
    """Return μ = n·J⁻¹(JW × W + M)/(n·J⁻¹n) at the times of `states`."""
    J, n = states.system.convected_inertia, states.system.axis
    assert n is not None
    q, w = states.directors, obs.angular_velocity(states.directors, states.director_velocities)
    m = np.array([load.moment(t, d, v) for t, d, v in zip(states.time, q, w, strict=True)])
    m += np.cross(q, states.system.dead_force).sum(1)
    W, M, row = obs.material(q, w), obs.material(q, m), np.linalg.solve(J, n)
    return (np.cross(W @ J, W) + M) @ row / (n @ row)


def multipliers() -> Iterator[Check]:
    """Measure the order at which μ of a step tends to the exact one at its middle."""
    times = np.unique([T_END * k / (2 * n) for n in COUNTS for k in range(2 * n + 1)])
    for name, (body, W, load) in MOTIONS.items():
        how: Arguments = {"material_angular_velocity": W, "load": load}
        mu = exact_multiplier(integrate(body, times=times, integrator=FINE, **how), load)
        for scheme in ("lie-midpoint", "energy-momentum"):
            paired, errors = scheme == "energy-momentum" and "paper" not in name, []
            for n in COUNTS:
                run = integrate(body, t_end=T_END, step=T_END / n, integrator=scheme, order=2, **how)
                found, middle = run.multipliers[:, -1], np.arange(n) + 0.5
                if paired:
                    found, middle = (found[1:] + found[:-1]) / 2, middle[:-1] + 0.5
                errors.append(abs(found - mu[np.searchsorted(times, middle * T_END / n - 1e-9)]).max())
            title = f"{scheme} 2: μ{', mean of two steps' if paired else ''}, {name}"
            yield order(title, 2, COUNTS, errors, 0.1, f"{SPLIT}; eq-discrete-nonholonomic")


def friction() -> Iterator[Check]:
    """Let a pendulum with dry friction swing to rest: by its energy each swing ends where weight has done the work."""
    weight, c, angle = 9.81, 1.0, -1.0
    while abs(weight * np.sin(angle)) > c:
        start, side = angle, np.sign(angle)

        def gained(x: float, start: float = start, side: float = side) -> float:
            return float(weight * (np.cos(x) - np.cos(start)) - c * side * (start - x))

        angle = brentq(gained, -start, start - 1e-3 * side)
    pendulum, tilted = heavy_top([1.01, 1.01, 0.01], 1, (0, 0, 1)), Rotation.from_euler("x", np.pi - 1)
    for axis in ("x", None):
        run = integrate(pendulum, t_end=6, step=0.02, load=dry_friction(c, axis), rotation=tilted)
        at = np.arctan2(run.directors[-1, 2, 1], -run.directors[-1, 2, 2])
        about = f"about {axis}" if axis else "against w"
        gaps = np.append(run.material_angular_velocity[-1], at - angle)
        yield error(f"pendulum under dry friction {about}: W and angle at rest", gaps, 1e-12, FRICTION, "closed form")


def bearing() -> Iterator[Check]:
    """Let a wheel run down by viscous and dry friction: ``Ω' = -(b Ω + c) (1/I + 1/(J - I))``, until Ω = 0."""
    inertia, b, c, first = 0.2, 0.1, 0.05, 3.0
    rate = b * (1 / inertia + 1 / (5 - inertia))
    load = wheel("z", inertia, speed=first, viscous=b, coulomb=c)
    run = integrate(standard(PAPER_J), t_end=8, step=0.05, load=load, angular_velocity=(0, 0, 0.3)).to_dataset()
    speed = np.maximum((first + c / b) * np.exp(-rate * run.time.values) - c / b, 0.0)
    total, lost = run.total_momentum.values, run.total_kinetic_energy.values[0] - run.total_kinetic_energy.values
    name = "wheel that runs down by dry friction, and stands"
    yield error(f"{name}: Ω", run.wheel_speed.values[:, 0] - speed, 1e-13, BEARING, "closed form")
    gaps = np.append(total - total[0], lost - run.wheel_loss.values[:, 0])
    yield error(f"{name}: momentum of both, energy less loss", gaps, 1e-13, BEARING, "invariant")


def skew_wheels() -> Iterator[Check]:
    """Drive one of two skew wheels: ``h' = u - b Ω`` of each beside ``Π' = Π × W`` of the whole, by DOP853."""
    J, n = np.array([3.0, 4.0, 5.0]), np.array([[1.0, 2, 0], [0, 1, -2]]) / np.sqrt(5)
    I, first, u, b = np.array([0.3, 0.2]), np.array([5.0, -3]), np.array([0.4, 0]), np.array([0.02, 0.05])
    carrier = np.diag(J) - n.T @ (I[:, None] * n)

    def rates(t: float, y: Array) -> Array:
        W, h = y[:3], y[3:]
        torque = u - b * (h / I - n @ W)
        return np.append(np.linalg.solve(carrier, np.cross(carrier @ W + h @ n, W) - torque @ n), torque)

    W0 = np.array([1.0, -2, 0.5])
    start = np.append(W0, I * (first + n @ W0))
    end = solved(rates, [0, 5], start)[-1]
    wheels = [wheel(n[k], I[k], speed=first[k], torque=u[k], viscous=b[k]) for k in (0, 1)]
    how: Arguments = {"load": wheels[0] + wheels[1], "material_angular_velocity": W0}
    run = integrate(standard(J), t_end=5, step=0.02, integrator="gauss", **how)
    gaps = np.append(run.material_angular_velocity[-1], run.wheel_momentum[-1]) - end
    yield error("two skew wheels, one of them driven: W, h", gaps, 1e-12, BEARING, "independent")


def oil() -> Iterator[Check]:
    """Let a pendulum creep down in oil, c θ' = -m g l sin θ but for the beginning: by Radau, without a step chosen."""
    inertia, weight, c = 1.01, 9.81, 1e4
    found = solve_ivp(
        lambda t, y: [y[1], -(weight * np.sin(y[0]) + c * y[1]) / inertia],
        (0, 10 * c / weight),
        [1.0, 0.0],
        method="Radau",
        jac=lambda t, y: [[0.0, 1.0], [-weight * np.cos(y[0]) / inertia, -c / inertia]],
        rtol=1e-12,
        atol=1e-15,
    )
    pendulum, tilted = heavy_top([inertia, inertia, 0.01], 1, (0, 0, 1)), Rotation.from_euler("x", np.pi - 1)
    run = integrate(pendulum, t_end=10 * c / weight, load=damping(c), rotation=tilted, store="end")
    angle = np.arctan2(-run.directors[-1, 2, 1], -run.directors[-1, 2, 2])
    yield error("pendulum in thick oil: angle by default", angle / found.y[0, -1] - 1, 1e-11, OIL, "independent")


def lagging_magnets() -> Iterator[Check]:
    """Let two magnets follow a field with a lag and saturation, z' = f(t, z, Λ, W), beside Euler's equations."""
    J, field, W0 = np.array([1.0, 2.0, 3.0]), np.array([0.3, 0.2, 1.0]), np.array([0.5, 1.2, -0.4])

    def derivative(t: float, z: Array, directors: Array, W: Array) -> Any:
        b = directors @ field
        return (1.2 * b[0] - z[0]) / 0.4 + 0.3 * W[2], np.tanh(3 * b[1] + z[0]) - z[1] * np.cos(t)

    def moment(t: float, z: Array, directors: Array, W: Array) -> Any:
        b = directors @ field
        return z[1] * b[2] - 0.1 * z[1] * W[0], -z[0] * b[2] - 0.1 * z[1] * W[1], z[0] * b[1] - z[1] * b[0]

    def rates(t: float, y: Array) -> Array:
        q, W, z = y[:9].reshape(3, 3), y[9:12], y[12:]
        turned = np.cross(W @ q, q).ravel()
        return np.concatenate([turned, (moment(t, z, q, W) + np.cross(J * W, W)) / J, derivative(t, z, q, W)])

    z0 = [0.1, -0.2]
    end = solved(rates, [0, 4], [*np.eye(3).ravel(), *W0, *z0])[-1, 9:]
    load = memory_load(derivative, moment, z0, frame="body", compiled=True)
    run = integrate(standard(J), t_end=4, step=0.02, integrator="gauss", material_angular_velocity=W0, load=load)
    assert run.states.internal is not None
    gaps = np.append(run.material_angular_velocity[-1], run.states.internal[-1]) - end
    yield error("magnets that follow a field with a lag: W, z", gaps, 1e-12, LAG, "independent")


CHECKS = {
    "loaded": (
        fixed_axis,
        quadratures,
        integrators,
        multipliers,
        orbit,
        friction,
        bearing,
        skew_wheels,
        oil,
        lagging_magnets,
    )
}
