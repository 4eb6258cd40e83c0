"""The split form of the continuous equations on random states; other identities: nontwist.validation."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conftest import BODIES, PAPER_J
from nontwist import standard
from nontwist.analysis import variables as obs
from nontwist.models.equations import split_momentum, split_rates, split_velocity


def random_state(body, seed):
    """Directors, tangent velocities that obey the constraint, a moment."""
    rng = np.random.default_rng(seed)
    q, W = Rotation.random(rng=rng).as_matrix().T, 3 * rng.normal(size=3)
    if body.axis is not None:
        W -= (W @ body.axis) * body.axis
    return q, np.cross(W @ q, q), 2 * rng.normal(size=3)


def split(body, q, v):
    return split_momentum(body, q, obs.spatial_momentum(q, v, body.euler_inertia))


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
@pytest.mark.parametrize("name", BODIES)
def test_momenta_and_their_rates_split_along_the_axis(name, seed):
    """π = π_⊥ + π_∥ d with π_⊥·d = 0 at all times, π' = m - μ d, and μ = π_⊥·d3' + m·d3 of the non-twisting body."""
    body = BODIES[name]()
    q, v, m = random_state(body, seed)
    pi, (perp, par) = obs.spatial_momentum(q, v, body.euler_inertia), split(body, q, v)
    n = np.array([0, 0, 1.0]) if body.axis is None else body.axis
    d, d_dot = n @ q, n @ v
    assert perp + par * d == pytest.approx(pi, abs=1e-12)
    assert perp @ d == pytest.approx(0, abs=1e-12)
    assert split_velocity(body, q, perp, par) == pytest.approx(obs.angular_velocity(q, v), abs=1e-12)
    rates = split_rates(body, q, perp, par, m)
    assert rates.momentum_perp @ d + perp @ d_dot == pytest.approx(0, abs=1e-12)
    pi_dot = rates.momentum_perp + rates.momentum_par * d + par * d_dot
    moment = m + np.cross(q, body.dead_force).sum(0)
    assert pi_dot == pytest.approx(moment - rates.mu * d, abs=1e-12)
    if name == "nontwisting":
        assert par == pytest.approx(0, abs=1e-12)
        assert rates.mu == pytest.approx(perp @ d_dot + m @ d, abs=1e-12)
