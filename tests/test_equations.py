"""The continuous equations in both forms, and the paper's theorems about them, on random states."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conftest import BODIES, PAPER_J
from nontwist import nontwisting, rotations, split_inertia, standard
from nontwist.analysis import observables as obs
from nontwist.models.equations import director_rates, split_momentum, split_rates, split_velocity


def random_state(body, seed):
    """Directors, tangent velocities that obey the constraint, a moment."""
    rng = np.random.default_rng(seed)
    q, W = Rotation.random(rng=rng).as_matrix().T, 3 * rng.normal(size=3)
    if body.axis is not None:
        W -= (W @ body.axis) * body.axis
    return q, np.cross(W @ q, q), 2 * rng.normal(size=3)


def split(body, q, v):
    return split_momentum(body, q, obs.spatial_momentum(q, v, body.euler_inertia))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("name", BODIES)
def test_the_two_descriptions_agree(name, seed):
    body = BODIES[name]()
    q, v, m = random_state(body, seed)
    perp, par = split(body, q, v)
    rates = split_rates(body, q, perp, par, m)
    v_dot, multipliers = director_rates(body, q, v, m)
    assert split_velocity(body, q, perp, par) == pytest.approx(obs.angular_velocity(q, v), abs=1e-12)
    assert rates.directors == pytest.approx(v, abs=1e-12)
    pi_dot = np.cross(q, body.euler_inertia @ v_dot).sum(0)
    n = np.array([0, 0, 1.0]) if body.axis is None else body.axis
    d, d_dot = n @ q, n @ v
    assert rates.momentum_perp + rates.momentum_par * d + par * d_dot == pytest.approx(pi_dot, abs=1e-12)
    if body.axis is not None:
        assert rates.mu == pytest.approx(multipliers[6], abs=1e-12)
    assert rates.momentum_perp @ d + perp @ d_dot == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_balance_of_momentum_of_the_standard_body(seed):
    """Eq-standard with the sign corrected is π' = m."""
    body = BODIES["standard"]()
    q, v, m = random_state(body, seed)
    perp, par = split(body, q, v)
    rates = split_rates(body, q, perp, par, m)
    pi_dot = rates.momentum_perp + rates.momentum_par * q[2] + par * v[2]
    assert pi_dot == pytest.approx(m, abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_the_sign_that_the_paper_prints_breaks_the_balance(seed):
    """With ``π_∥' + π_⊥·d3' = 0`` the spatial momentum of a free body would not be kept (erratum 3)."""
    body = standard(PAPER_J)
    q, v, _ = random_state(body, seed)
    perp, par = split(body, q, v)
    rates = split_rates(body, q, perp, par, np.zeros(3))
    printed = -perp @ v[2]
    assert rates.momentum_par == pytest.approx(-printed, abs=1e-12)
    assert abs(rates.momentum_perp + printed * q[2] + par * v[2]).max() > 0.1


@pytest.mark.parametrize("seed", range(5))
def test_multiplier_of_the_nontwisting_body(seed):
    """μ = π_⊥·d3' + m·d3; for a general unit axis μ = n·J⁻¹(JW × W + M) / n·J⁻¹n."""
    body = nontwisting(PAPER_J)
    q, v, m = random_state(body, seed)
    perp, par = split(body, q, v)
    assert par == pytest.approx(0, abs=1e-12)
    mu = split_rates(body, q, perp, par, m).mu
    assert mu == pytest.approx(perp @ v[2] + m @ q[2], abs=1e-12)
    for name in ("nontwisting", "suslov"):
        body = BODIES[name]()
        q, v, m = random_state(body, seed)
        J, n, W = body.convected_inertia, body.axis, q @ obs.angular_velocity(q, v)
        general = n @ np.linalg.solve(J, np.cross(J @ W, W) + q @ m) / (n @ np.linalg.solve(J, n))
        assert split_rates(body, q, *split(body, q, v), m).mu == pytest.approx(general, abs=1e-11)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("name", BODIES)
def test_power_and_conservation(name, seed):
    """K' = w·m for every body; Π1' = Π2' = 0 for the free non-twisting one."""
    body = BODIES[name]()
    q, v, m = random_state(body, seed)
    v_dot, _ = director_rates(body, q, v, m)
    w = obs.angular_velocity(q, v)
    power = np.sum(v * (body.euler_inertia @ v_dot))
    assert power == pytest.approx(w @ m + np.sum(body.dead_force * v), abs=1e-11)
    if name == "nontwisting":
        v_dot, _ = director_rates(body, q, v, np.zeros(3))
        pi, pi_dot = obs.spatial_momentum(q, v, body.euler_inertia), np.cross(q, body.euler_inertia @ v_dot).sum(0)
        Pi_dot = v @ pi + q @ pi_dot
        assert Pi_dot[:2] == pytest.approx([0, 0], abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_parallel_transport_of_the_momentum(seed):
    """∇ π_⊥ = 0 along d3 for the free non-twisting body (eq-nonholonomic-red)."""
    body = nontwisting(PAPER_J)
    q, v, _ = random_state(body, seed)
    rates = split_rates(body, q, *split(body, q, v), np.zeros(3))
    covariant = rates.momentum_perp - (rates.momentum_perp @ q[2]) * q[2]
    assert covariant == pytest.approx(np.zeros(3), abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_identities_of_the_kinetic_energy(seed):
    """eq-kinetic-density, eq-kinetic-density-convected, eq-momenta, eq-pi-split-components, eq-inertia-inertia."""
    body = standard(PAPER_J)
    q, v, _ = random_state(body, seed)
    J, R = PAPER_J, q.T
    w = obs.angular_velocity(q, v)
    W, j = q @ w, R @ J @ R.T
    J_perp, J_par = split_inertia(J)
    W_perp, w_perp = W * [1, 1, 0], np.cross(q[2], v[2])
    j_perp, w_par = R @ J_perp @ R.T, w @ q[2]
    K = float(obs.kinetic_energy(v, body.euler_inertia))
    assert w @ j @ w / 2 == pytest.approx(K)
    assert pytest.approx(K) == W @ J @ W / 2
    assert W_perp @ J_perp @ W_perp / 2 + J_par * W[2] ** 2 / 2 == pytest.approx(K)
    assert w_perp @ j_perp @ w_perp / 2 + J_par * w_par**2 / 2 == pytest.approx(K)
    assert w_perp == pytest.approx(w - w_par * q[2], abs=1e-12)
    pi = obs.spatial_momentum(q, v, body.euler_inertia)
    assert pi == pytest.approx(j @ w, abs=1e-12)
    assert q @ pi == pytest.approx(J @ W, abs=1e-12)
    assert split_momentum(body, q, pi)[0] == pytest.approx(j_perp @ w_perp, abs=1e-12)
    assert split_momentum(body, q, pi)[1] == pytest.approx(J_par * w_par, abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_variations_of_the_convected_angular_velocities(seed):
    """eq-variation-convected by central differences of the perturbed curve eq-one-parameter."""
    rng = np.random.default_rng(seed)
    a, b, c = rng.normal(size=(3, 3))

    def curve(t):
        return rotations.exp(a + b * np.sin(t)) @ rotations.exp(c * t)

    def theta(t):
        return np.array([np.sin(2 * t), np.cos(t), t**2]) + a

    def convected(iota, t=0.4, e=1e-4):
        R = [rotations.exp(iota * theta(s)) @ curve(s) for s in (t - 2 * e, t - e, t + e, t + 2 * e)]
        R0 = rotations.exp(iota * theta(t)) @ curve(t)
        rate = R0.T @ (R[0] - 8 * R[1] + 8 * R[2] - R[3]) / (12 * e)
        return np.array([rate[2, 1], rate[0, 2], rate[1, 0]])

    e = 1e-3
    variation = (convected(-2 * e) - 8 * convected(-e) + 8 * convected(e) - convected(2 * e)) / (12 * e)
    theta_dot = np.array([2 * np.cos(0.8), -np.sin(0.4), 0.8])
    R = curve(0.4)
    d3 = R[:, 2]
    assert variation * [1, 1, 0] == pytest.approx(R.T @ (np.eye(3) - np.outer(d3, d3)) @ theta_dot, abs=1e-8)
    assert variation[2] == pytest.approx(d3 @ theta_dot, abs=1e-8)
