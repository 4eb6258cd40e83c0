"""Validation of the equations of motion, and of the numbers of the paper.

**equations**: The continuous equations: both descriptions against each other, and the paper's theorems, on random
states.

The split form (eq-standard and eq-nonholonomic, the sign corrected: docs/errata.md, 3) and the director form with its
multipliers share no code. They are compared on ten random states of a body of every kind under a random moment.

**paper**: The numerical part of the paper: its six tables, its multiplier, and the closed form of its free discrete
motion.

The loads of cases 2 and 3 are the printed ones divided by 20 (docs/errata.md, 1). Printed invariants are truncated to
six decimals, so they may differ by up to 1e-6. The second quotients contain the error of the paper's Newton iteration,
which was stopped at 1e-10.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from .. import exact
from ..analysis import variables as obs
from ..analysis.statistics import second_quotient
from ..driver.runs import integrate, simulate
from ..geometry import rotations
from ..geometry.arrays import Array
from ..loads import damping, sine
from ..models.bodies import BODIES, D3, sample_bodies
from ..models.equations import constraint_matrices, director_rates, split_momentum, split_rates
from ..models.system import DirectorSystem, euler_inertia, split_inertia
from ..paper.tables import CASES, MISPRINT, QUOTIENT_TOLERANCE, STEP, SUFFIX, T_END, invariants_table, quotient_table
from .checks import Check
from .compiled_steps import MidpointLoad, director_step
from .problems import FINE, PAPER_J, SAMPLES, Arguments, all_are, attitude, error, pushed

STATES = 10
WEAK, KEPT = "eq_weak_form_rigid_body_alternative", "eq-material_perpendicular_momenta_preservation"


def random_state(body: DirectorSystem, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return directors, tangent velocities that obey the constraint, and a moment."""
    q, W = rotations.exp(rng.normal(size=3)), 3 * rng.normal(size=3)
    if body.axis is not None:
        W -= (W @ body.axis) * body.axis
    return q, np.cross(W @ q, q), 2 * rng.normal(size=3)


def both_forms() -> Iterator[Check]:
    """Compare the rates of both forms, the power, and the multiplier."""
    rng, power, mu = np.random.default_rng(4), [], []
    rates_apart: list[Array] = []
    for body in sample_bodies().values():
        E, J, n = body.euler_inertia, body.convected_inertia, body.axis
        for _ in range(STATES):
            q, v, m = random_state(body, rng)
            w, (v_dot, multipliers) = obs.angular_velocity(q, v), director_rates(body, q, v, m)
            perp, par = split_momentum(body, q, obs.spatial_momentum(q, v, E))
            rates = split_rates(body, q, perp, par, m)
            d, d_dot = (q[2], v[2]) if n is None else (n @ q, n @ v)
            pi_dot = rates.momentum_perp + rates.momentum_par * d + par * d_dot
            rates_apart += [pi_dot - np.cross(q, E @ v_dot).sum(0), *(rates.directors - v)]
            power.append(np.sum(v * (E @ v_dot)) - w @ m - np.sum(body.dead_force * v))
            if n is not None:
                W, M = q @ w, q @ (m + np.cross(q, body.dead_force).sum(axis=0))
                formula = n @ np.linalg.solve(J, np.cross(J @ W, W) + M) / (n @ np.linalg.solve(J, n))
                mu += [rates.mu - formula, multipliers[6] - formula]
    yield error("π' and d_i' of both forms", rates_apart, 1e-12, f"eq-standard; {WEAK}", "independent")
    yield error("K' - w·m, W", power, 1e-11, "eq-kinetic-density", "invariant")
    yield error("μ - n·J⁻¹(JW × W + M)/(n·J⁻¹n), N m", mu, 1e-11, "eq-nonholonomic", "closed form")


def transported_momentum() -> Iterator[Check]:
    """Check that π_⊥ of the free non-twisting body is transported along d3, and that Π1 and Π2 are constant."""
    body, rng = SAMPLES["nontwisting"], np.random.default_rng(5)
    transport: list[Array] = []
    momenta: list[Array] = []
    for _ in range(STATES):
        q, v, _ = random_state(body, rng)
        perp, par = split_momentum(body, q, obs.spatial_momentum(q, v, body.euler_inertia))
        rate = split_rates(body, q, perp, par, np.zeros(3)).momentum_perp
        transport.append(rate - (rate @ q[2]) * q[2])
        momenta.append((v @ perp + q @ rate)[:2])
    yield error("∇π_⊥ along d3', free non-twisting body", transport, 1e-12, "eq-nonholonomic-red", "invariant")
    yield error("Π1', Π2', free non-twisting body", momenta, 1e-12, KEPT, "invariant")


def identities() -> Iterator[Check]:
    """Write the kinetic energy in four ways, each momentum in two."""
    rng, J, E = np.random.default_rng(6), PAPER_J, euler_inertia(PAPER_J)
    J_perp, J_par = split_inertia(J)
    energies: list[float] = []
    momenta: list[Array] = []
    for _ in range(STATES):
        q, v, _ = random_state(SAMPLES["standard"], rng)
        w, K = obs.angular_velocity(q, v), float(obs.kinetic_energy(v, E))
        W, j, w_perp = q @ w, q.T @ J @ q, np.cross(q[2], v[2])
        split = w_perp @ (q.T @ J_perp @ q) @ w_perp / 2 + J_par * (w @ q[2]) ** 2 / 2
        energies += [w @ j @ w / 2 - K, W @ J @ W / 2 - K, split - K]
        pi = obs.spatial_momentum(q, v, E)
        momenta += [pi - j @ w, q @ pi - J @ W]
    source = "eq-kinetic-density-convected; eq-director-K"
    yield error("kinetic energy, four ways, J", energies, 1e-12, source, "invariant")
    source = "eq-dir-momenta; eq-inertia-inertia"
    yield error("momenta π = j w, Π = J W, kg m² s⁻¹", momenta, 1e-12, source, "invariant")


def variations() -> Iterator[Check]:
    """Vary a curve Λ(t) to exp(ι θ(t)) Λ(t): δW_⊥ = Λᵀ (I - d3 ⊗ d3) θ', δW_∥ = d3·θ'; by central differences."""
    a, b, c, e = *np.random.default_rng(7).normal(size=(3, 3)), 1e-3
    t, weights, offsets = 0.4, np.array([1, -8, 8, -1]) / (12 * e), e * np.array([-2, -1, 1, 2])

    def curve(s: Array, iota: float) -> Array:
        theta = np.stack([np.sin(2 * s), np.cos(s), s**2], axis=-1) + a
        still = rotations.exp(a + b * np.sin(s)[..., None]) @ rotations.exp(c * s[..., None])
        return rotations.exp(iota * theta) @ still

    def velocity(iota: float) -> Array:
        rate = np.einsum("k,kij->ij", weights, curve(t + offsets, iota))
        W = curve(np.array(t), iota).T @ rate
        return rotations.vee((W - W.T) / 2)

    R, rate = curve(np.array(t), 0.0), np.array([2 * np.cos(2 * t), -np.sin(t), 2 * t])
    varied = weights @ np.array([velocity(iota) for iota in offsets])
    perp, par = rotations.velocity_variation(R.T, rate)
    gap = varied - [*perp[:2], par]
    yield error("variation of W_⊥ and W_∥, rad/s", gap, 1e-8, "eq-variation-convected", "independent")


def runs() -> Iterator[Check]:
    """Run both forms over a second, by DOP853 at 1e-13."""
    load = sine([1, 2, 0.5], 0.7) + pushed("space") + damping([0.1, 0.2, 0.3])
    how: Arguments = {"t_end": 1, "step": 0.5, "angular_velocity": (1, -2, 0.5), "project": True, "load": load}
    for name in ("suslov", "heavy_top"):
        split, director = (
            integrate(SAMPLES[name], integrator=replace(FINE, form=form), **how) for form in ("split", "director")
        )
        gaps = [split.directors - director.directors, split.director_velocities - director.director_velocities]
        title = f"{BODIES[name].words} under load, 1 s: both forms"
        yield error(title, gaps, 1e-11, f"eq-nonholonomic; {WEAK}", "independent")


BODY = SAMPLES["nontwisting"]
SCHEME: Arguments = {"integrator": "energy-momentum", "order": 2}
W1 = np.array(CASES[1].angular_velocity)


def tables() -> Iterator[Check]:
    """Compare the sixty printed numbers."""
    for number, case in CASES.items():
        kick: Arguments = {"t_end": T_END, "material_angular_velocity": case.angular_velocity, "load": case.load()}
        runs = [simulate(BODY, step=STEP / k, **kick, **SCHEME) for k in (1, 2, 4)]
        invariants, quotient = invariants_table(number, runs[0]), quotient_table(number, second_quotient(*runs))
        for name, table, label, tolerance, how in (
            ("invariants", invariants, "invariants", 1e-6, "digit by digit"),
            ("Q_II", quotient, "sqp", QUOTIENT_TOLERANCE, f"within {QUOTIENT_TOLERANCE:g}"),
        ):
            agreeing, source = sum(r.agrees for r in table.rows), f"tab-{label}_{SUFFIX[number]}"
            yield Check(f"case {number}: {name} that agree {how}", len(table.rows), agreeing, 0, source, "printed")
            differences = [r.difference for r in table.rows]
            yield error(f"case {number}: {name}, worst difference", differences, tolerance, source, "printed")


def multiplier() -> Iterator[Check]:
    """Compare μ of case 1 with Π·(W × E3) = 468/7 at every step."""
    run = integrate(BODY, t_end=T_END, step=STEP, material_angular_velocity=W1, **SCHEME)
    source = "eq-nonholonomic (docs/errata.md, 3)"
    yield all_are("case 1: μ, N m", 468 / 7, run.multipliers[:, -1], 1e-9, source, "closed form")


def closed_form() -> Iterator[Check]:
    """Compare free runs with rotations by θ_h = 2 atan(|w| h/2) a step about a fixed axis, and their Q_II."""
    h, source = STEP, "eq-discrete-nonholonomic (docs/errata.md, 6)"
    run = integrate(BODY, t_end=1, step=h, material_angular_velocity=W1, **SCHEME)
    turn, angle = attitude(run)[1], 2 * np.arctan(float(np.linalg.norm(W1)) * h / 2)
    gap = float(np.arcsin(np.linalg.norm(turn - turn.T) / np.sqrt(8))) - angle
    yield error("case 1: angle of a step less θ_h, rad", gap, 1e-15, source, "closed form")
    states = exact.discrete_free(PAPER_J, W1, h, 200)[0]
    yield error("case 1: attitudes, turned by n θ_h", attitude(run) - states, 1e-11, source, "closed form")
    runs = [simulate(BODY, t_end=1, step=h / k, material_angular_velocity=W1, **SCHEME) for k in (1, 2, 4)]
    closed = exact.discrete_second_quotient(W1, h, runs[0].time.values[20:])
    relative = second_quotient(*runs).values[19:] / closed - 1
    yield error("case 1: Q_II from 0.1 s to 1 s, relative", relative, 1e-8, "eq:second_quotient", "closed form")


def remainder() -> Iterator[Check]:
    """Check that Q_II tends to 4 with the square of the step, in case 3."""

    def gap(h: float) -> float:
        kick: Arguments = {"t_end": 1, "material_angular_velocity": CASES[3].angular_velocity, "load": CASES[3].load()}
        return 4 - float(second_quotient(*(simulate(BODY, step=h / k, **kick, **SCHEME) for k in (1, 2, 4)))[-1])

    name = "case 3: 4 - Q_II, ratio of h = 0.02 s to 0.01 s"
    yield Check(name, 4, gap(0.02) / gap(0.01), 0.1, "eq:second_quotient (docs/errata.md, 8)", "order")


def impulse() -> Iterator[Check]:
    """Compare Π1 of the continuous equations after the load of case 2 with half its peak."""
    run = simulate(BODY, times=[0, 1], load=CASES[2].load(), integrator=FINE)
    expected, measured = CASES[2].printed_peak[0] / (2 * MISPRINT), float(run.material_momentum[-1, 0])
    name = "case 2: Π1 at 1 s, kg m² s⁻¹, printed peak over 40"
    yield Check(name, expected, measured, 1e-8, "eq-loads_time_variation (docs/errata.md, 1)", "closed form")


def parameter() -> Iterator[Check]:
    """Check that the parameter a moves λ12 alone, by -(½ - a) μ."""
    q, load = np.eye(3), MidpointLoad(np.array([1.0, 2.0, 0.0]), np.array([0.5, 0.0, 1.0]))
    v, no_force = np.cross(np.array([2.0, -3.0, 0.0]), q), np.zeros((3, 3))
    half, zero = (
        director_step(q, v, 0.01, BODY.euler_inertia, constraint_matrices(D3, a), no_force, load) for a in (0.5, 0)
    )
    source = "eq_weak_form_rigid_body_alternative (docs/errata.md, 5)"
    moved = [zero.directors - half.directors, zero.velocities - half.velocities]
    yield error("a = 0 for ½: change of the state", moved, 1e-12, source, "closed form")
    shifted = half.multipliers - np.array([0, 0, 0, 0, 0, half.multipliers[6] / 2, 0])
    gap = zero.multipliers - shifted
    yield error("a = 0 for ½: multipliers, λ12 less μ/2, N m", gap, 1e-11, source, "closed form")


CHECKS = {
    "equations": (both_forms, transported_momentum, identities, variations, runs),
    "paper": (tables, multiplier, closed_form, remainder, impulse, parameter),
}
