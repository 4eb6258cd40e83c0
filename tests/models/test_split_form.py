"""The split form against the formulas of the paper and Euler's equations; of motions: nontwist.validation."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conftest import BODIES, PAPER_J, random_inertia
from nontwist import nontwisting, sphere, split_form, standard
from nontwist.models.equations import split_rates as rates_of_one_state
from nontwist.split_form import split_inertia
from refusals import refused_as

E3 = np.array([0.0, 0, 1])


def states(body, count=20, seed=0):
    """Directors, angular velocities that obey the constraint, momenta, moments; and d = Λn."""
    rng = np.random.default_rng(seed)
    q, W, m = Rotation.random(count, rng=rng).as_matrix(), 3 * rng.normal(size=(count, 3)), rng.normal(size=(count, 3))
    n = E3 if body.axis is None else body.axis
    if body.axis is not None:
        W -= (W @ n)[:, None] * n
    to_space = np.einsum("kix,ki->kx", q, W), np.einsum("kix,ki->kx", q, W @ body.inertia)
    return q, *to_space, m, n @ q


def close(found, expected, bound=1e-13):
    np.testing.assert_allclose(found, expected, rtol=0, atol=bound)


@pytest.mark.parametrize("name", BODIES)
def test_split_and_join(name):
    body = BODIES[name]()
    q, w, pi, _, d = states(body)
    perp, par = split_form.momentum(body, q, pi)
    close(perp + par[:, None] * d, pi)
    close(np.sum(perp * d, axis=1), 0)
    if name != "suslov":  # eq-pi-perp
        Pi = np.einsum("kix,kx->ki", q, pi)[..., None]
        close(perp, Pi[:, 0] * q[:, 0] + Pi[:, 1] * q[:, 1])
    close(split_form.velocity(body, q, perp, par), w)
    w_perp, spin = split_form.momentum(body, q, w)  # eq-omegas-perp: w_⊥ = d × d'
    close(w_perp, np.cross(d, np.cross(w, d)))
    close(spin, np.sum(w * d, axis=1))


@pytest.mark.parametrize("make", [standard, nontwisting])
def test_energy_and_momentum_parts(make):
    """½ w_⊥·j_⊥ w_⊥ and ½ j_∥ w_∥², π_⊥ = j_⊥ w_⊥ and π_∥ = j_∥ w_∥, with J split in the body and carried to space."""
    body, (J_perp, J_par) = make(PAPER_J), split_inertia(PAPER_J)
    q, w, pi, _, d = states(body)
    j_perp, spin = q.mT @ J_perp @ q, np.sum(w * d, axis=1)
    energy_perp, energy_par = split_form.energy(body, q, w)
    np.testing.assert_allclose(energy_perp, np.einsum("kx,kxy,ky->k", w, j_perp, w) / 2, rtol=1e-13)
    np.testing.assert_allclose(energy_par, J_par * spin**2 / 2, rtol=1e-13, atol=1e-28)
    perp, par = split_form.momentum(body, q, pi)
    close(perp, np.einsum("kxy,ky->kx", j_perp, w))
    close(par, J_par * spin)
    for other in (standard(random_inertia(np.random.default_rng(1))), BODIES["suslov"]()):  # they add up
        q, w, pi, *_ = states(other)
        np.testing.assert_allclose(sum(split_form.energy(other, q, w)), np.sum(w * pi, axis=1) / 2, rtol=1e-13)
    assert abs(split_form.energy(other, q, w)[1]).max() < 1e-14  # no spin: none of its energy


@pytest.mark.parametrize("name", BODIES)
def test_rates_are_those_of_euler(name):
    """J W' = J W × W + M - μ n with n·W' = 0, solved as one linear system, against the split form.

    With the sign that the paper prints, ``π_∥' + π_⊥·d3' = 0``, a free body would not keep its momentum (erratum 3).
    """
    body = BODIES[name]()
    q, w, pi, m, d = states(body)
    q_dot, perp_dot, par_dot, mu = split_form.rates(body, q, *split_form.momentum(body, q, pi), m)
    d_dot = np.cross(w, d)
    close(q_dot, np.cross(w[:, None], q))
    for k, moment in enumerate(m + np.cross(q, body.dead_force).sum(1)):
        W, J = q[k] @ w[k], body.inertia
        n = np.zeros(3) if body.axis is None else body.axis
        matrix = np.block([[J, n[:, None]], [n[None], np.array([[float(body.axis is None)]])]])
        *W_dot, multiplier = np.linalg.solve(matrix, [*(np.cross(J @ W, W) + q[k] @ moment), 0])
        pi_dot = (J @ W_dot - np.cross(J @ W, W)) @ q[k]
        assert mu[k] == pytest.approx(multiplier, abs=1e-12)
        perp, par = split_form.momentum(body, q[k], pi[k])
        close(perp_dot[k] + par_dot[k] * d[k] + par * d_dot[k], pi_dot, 1e-12)
        # the printed equations, the sign corrected: the tangent part, then the part along d
        close(sphere.project(d[k], perp_dot[k]) + par * d_dot[k], sphere.project(d[k], moment), 1e-12)
        assert par_dot[k] - perp @ d_dot[k] + mu[k] == pytest.approx(moment @ d[k], abs=1e-12)
        assert abs(par_dot[k] + perp @ d_dot[k] + mu[k] - moment @ d[k]) > 1e-3


def test_leading_axes():
    body = BODIES["heavy_top"]()
    q, _, pi, m, _ = states(body, 6)
    perp, par = split_form.momentum(body, q, pi)
    stacked = split_form.rates(body, q.reshape(2, 3, 3, 3), *(x.reshape(2, 3, *x.shape[1:]) for x in (perp, par, m)))
    assert [a.shape for a in stacked] == [(2, 3, 3, 3), (2, 3, 3), (2, 3), (2, 3)]
    for k in range(6):
        one = rates_of_one_state(body, q[k], perp[k], float(par[k]), m[k])
        for a, b in zip(stacked, one, strict=True):
            np.testing.assert_array_equal(a.reshape(6, *a.shape[2:])[k], b)
    assert split_form.rates(body, q, 0 * perp, 0, (1, 2, 3))[1].shape == (6, 3)
    assert split_form.momentum(body, q[0], pi)[0].shape == (6, 3)
    none = q[:0], perp[:0], par[:0]
    found = *split_form.rates(body, *none), *split_form.energy(body, *none[:2]), split_form.velocity(body, *none)
    assert [a.shape for a in found] == [(0, 3, 3), (0, 3), (0,), (0,), (0,), (0,), (0, 3)]


LEFT = np.stack([np.eye(3), np.diag([1, 1, -1.0])])
test_refusals = refused_as(
    [
        lambda: split_form.momentum(standard(PAPER_J), LEFT, np.zeros(3)),
        lambda: split_form.rates(standard(PAPER_J), np.eye(3), [[1, 0, 0], [1, 0, 1e-8]], 0),
        lambda: split_form.energy(standard(PAPER_J), LEFT[[0, 0]], np.zeros((3, 3))),
    ]
)
