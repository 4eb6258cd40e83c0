"""The continuous equations: both descriptions against each other, and the paper's theorems, on random states.

The split form (eq-standard and eq-nonholonomic, the sign corrected: docs/errata.md, 3) and the director form with its
multipliers share no code. They are compared on ten random states of a body of every kind under a random moment.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..analysis import variables as obs
from ..driver.runs import integrate
from ..geometry import rotations
from ..geometry.arrays import Array
from ..loads import damping, sine
from ..models.bodies import BODIES, sample_bodies
from ..models.equations import director_rates, split_momentum, split_rates
from ..models.system import DirectorSystem, euler_inertia, split_inertia
from .checks import Check
from .problems import FINE, PAPER_J, SAMPLES, Arguments, error, pushed

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
    yield error(
        "momenta π = j w, Π = J W, kg m² s⁻¹", momenta, 1e-12, "eq-dir-momenta; eq-inertia-inertia", "invariant"
    )


def variations() -> Iterator[Check]:
    """Vary a curve Λ(t) to exp(ι θ(t)) Λ(t): δW_⊥ = Λᵀ (I - d3 ⊗ d3) θ', δW_∥ = d3·θ'; by central differences."""
    a, b, c, e = *np.random.default_rng(7).normal(size=(3, 3)), 1e-3
    t, weights, offsets = 0.4, np.array([1, -8, 8, -1]) / (12 * e), e * np.array([-2, -1, 1, 2])

    def curve(s: Array, iota: float) -> Array:
        theta = np.stack([np.sin(2 * s), np.cos(s), s**2], axis=-1) + a
        still = rotations.exp(a + b * np.sin(s)[..., None]) @ rotations.exp(c * s[..., None])
        moved: Array = rotations.exp(iota * theta) @ still
        return moved

    def velocity(iota: float) -> Array:
        rate = np.einsum("k,kij->ij", weights, curve(t + offsets, iota))
        return rotations.vee(skew(curve(np.array(t), iota).T @ rate))

    R, rate = curve(np.array(t), 0.0), np.array([2 * np.cos(2 * t), -np.sin(t), 2 * t])
    varied = weights @ np.array([velocity(iota) for iota in offsets])
    perp, par = rotations.velocity_variation(R.T, rate)
    gap = varied - [*perp[:2], par]
    yield error("variation of W_⊥ and W_∥, rad/s", gap, 1e-8, "eq-variation-convected", "independent")


def skew(A: Array) -> Array:
    """Return the skew part of a matrix."""
    part: Array = (A - A.T) / 2
    return part


def runs() -> Iterator[Check]:
    """Run both forms over a second, by DOP853 at 1e-13."""
    load = sine([1, 2, 0.5], 0.7) + pushed("space") + damping([0.1, 0.2, 0.3])
    how: Arguments = {"t_end": 1, "step": 0.5, "angular_velocity": (1, -2, 0.5), "project": True, "load": load}
    for name in ("suslov", "heavy_top"):
        split, director = (
            integrate(SAMPLES[name], integrator=replace(FINE, form=form), **how) for form in ("split", "director")
        )
        gaps = [split.directors - director.directors, split.director_velocities - director.director_velocities]
        yield error(
            f"{BODIES[name].words} under load, 1 s: both forms", gaps, 1e-11, f"eq-nonholonomic; {WEAK}", "independent"
        )


CHECKS = (both_forms, transported_momentum, identities, variations, runs)
